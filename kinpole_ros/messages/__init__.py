"""ROS messages to arrays and back: nothing behind this package handles a message itself."""

from kinpole_ros.messages._cdr import diagnostics_data
from kinpole_ros.messages._cloud import MessageError
from kinpole_ros.messages._diagnostics import (
    RECEIVED,
    RESTARTS,
    SMOOTHED,
    DiagnosticsMaker,
    left_out,
    marker_faults,
    not_there,
    unseen,
)
from kinpole_ros.messages._drawing import COLORS, nothing_drawn
from kinpole_ros.messages._events import read_event
from kinpole_ros.messages._identities import identity_lines
from kinpole_ros.messages._markers import (
    INPUT_TYPE_NAMES,
    INPUT_TYPES,
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    ns_to_stamp,
    read_markers,
    stamp_to_ns,
    to_message,
)
from kinpole_ros.messages._padding import with_zero_padding
from kinpole_ros.messages._poses import AUTO_TYPES, PoseReader, kind_of, poses_data, reader_of
from kinpole_ros.messages._reader import MarkerReader
from kinpole_ros.messages._results import DRAWING, Output, outputs_of, result_outputs, theory_of
from kinpole_ros.messages._space import (
    plane_words,
    shape_fault,
    tilt_fault,
    unit_fault,
)
from kinpole_ros.messages._stack import TF
from kinpole_ros.messages._stamps import jitter_fault
from kinpole_ros.messages._state import STATE, read_state, state_fields
from kinpole_ros.messages._types import (
    WITH_ROS,
    WITH_TF,
    DiagnosticArray,
    String,
    constants,
    deserialize_message,
    fields,
    message_class,
    octets,
    serialize_message,
    type_name,
)
from kinpole_ros.messages._view import PAGE_TOPICS, VIEW, figures_of, live_outputs, view_of

__all__ = [
    'AUTO_TYPES',
    'COLORS',
    'DRAWING',
    'INPUT_TYPES',
    'INPUT_TYPE_NAMES',
    'MARKER_TYPES',
    'PAGE_TOPICS',
    'RECEIVED',
    'RESTARTS',
    'ROS_TYPE_NAMES',
    'SMOOTHED',
    'STATE',
    'TF',
    'VIEW',
    'WITH_ROS',
    'WITH_TF',
    'DiagnosticArray',
    'DiagnosticsMaker',
    'MarkerReader',
    'MessageError',
    'Output',
    'PoseReader',
    'String',
    'constants',
    'deserialize_message',
    'diagnostics_data',
    'fields',
    'figures_of',
    'identity_lines',
    'jitter_fault',
    'kind_of',
    'left_out',
    'live_outputs',
    'marker_faults',
    'message_class',
    'not_there',
    'nothing_drawn',
    'ns_to_stamp',
    'octets',
    'outputs_of',
    'plane_words',
    'poses_data',
    'read_event',
    'read_markers',
    'read_state',
    'reader_of',
    'result_outputs',
    'serialize_message',
    'shape_fault',
    'stamp_to_ns',
    'state_fields',
    'theory_of',
    'tilt_fault',
    'to_message',
    'type_name',
    'unit_fault',
    'unseen',
    'view_of',
    'with_zero_padding',
]
