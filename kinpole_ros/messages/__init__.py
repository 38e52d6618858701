"""ROS messages to arrays and back: nothing behind this package handles a message itself."""

from kinpole_ros.messages._cdr import diagnostics_data
from kinpole_ros.messages._cloud import MessageError
from kinpole_ros.messages._diagnostics import (
    SMOOTHED,
    DiagnosticsMaker,
    left_out,
    marker_faults,
    not_rigid,
    not_there,
    unseen,
)
from kinpole_ros.messages._loci import nothing_drawn
from kinpole_ros.messages._markers import (
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    ns_to_stamp,
    read_markers,
    stamp_to_ns,
    to_message,
)
from kinpole_ros.messages._reader import MarkerReader
from kinpole_ros.messages._results import DRAWING, Output, result_outputs

__all__ = [
    'DRAWING',
    'MARKER_TYPES',
    'ROS_TYPE_NAMES',
    'SMOOTHED',
    'DiagnosticsMaker',
    'MarkerReader',
    'MessageError',
    'Output',
    'diagnostics_data',
    'left_out',
    'marker_faults',
    'not_rigid',
    'not_there',
    'nothing_drawn',
    'ns_to_stamp',
    'read_markers',
    'result_outputs',
    'stamp_to_ns',
    'to_message',
    'unseen',
]
