"""ROS messages to arrays and back: no other package handles the fields of a message."""

from kinpole_ros.messages._detections import DETECTIONS, read_detections
from kinpole_ros.messages._diagnostics import RECEIVED, RESTARTS, DiagnosticsMaker
from kinpole_ros.messages._drawing import COLORS, deletion_of_all
from kinpole_ros.messages._events import read_event
from kinpole_ros.messages._installed import installed_class
from kinpole_ros.messages._markers import marker_arrays, to_message
from kinpole_ros.messages._poses import (
    AUTO_TYPES,
    PoseReader,
    kind_of,
    marker_reader,
    poses_data,
    reader_of,
)
from kinpole_ros.messages._reader import MarkerReader, read_markers
from kinpole_ros.messages._results import (
    DRAWING,
    TF,
    Output,
    joint_build,
    live_outputs,
    outputs_of,
    result_outputs,
)
from kinpole_ros.messages._rig import RIG, RigChanges, plane_of_rig, read_rig, rig_of
from kinpole_ros.messages._state import (
    STATE,
    StateBlock,
    read_state,
    read_state_blocks,
    read_states,
    state_fields,
)
from kinpole_ros.messages._types import (
    INPUT_TYPE_NAMES,
    INPUT_TYPES,
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    DiagnosticArray,
    MessageError,
    PointCloud2,
    String,
    definition,
    deserialize_message,
    fields,
    message_class,
    ns_to_stamp,
    serialize_message,
    stamp_to_ns,
    type_name,
)
from kinpole_ros.messages._view import PAGE_TOPICS, VIEW, quantity_lists, view_of

__all__ = [
    'AUTO_TYPES',
    'COLORS',
    'DETECTIONS',
    'DRAWING',
    'INPUT_TYPES',
    'INPUT_TYPE_NAMES',
    'MARKER_TYPES',
    'PAGE_TOPICS',
    'RECEIVED',
    'RESTARTS',
    'RIG',
    'ROS_TYPE_NAMES',
    'STATE',
    'TF',
    'VIEW',
    'DiagnosticArray',
    'DiagnosticsMaker',
    'MarkerReader',
    'MessageError',
    'Output',
    'PointCloud2',
    'PoseReader',
    'RigChanges',
    'StateBlock',
    'String',
    'definition',
    'deletion_of_all',
    'deserialize_message',
    'fields',
    'installed_class',
    'joint_build',
    'kind_of',
    'live_outputs',
    'marker_arrays',
    'marker_reader',
    'message_class',
    'ns_to_stamp',
    'outputs_of',
    'plane_of_rig',
    'poses_data',
    'quantity_lists',
    'read_detections',
    'read_event',
    'read_markers',
    'read_rig',
    'read_state',
    'read_state_blocks',
    'read_states',
    'reader_of',
    'result_outputs',
    'rig_of',
    'serialize_message',
    'stamp_to_ns',
    'state_fields',
    'to_message',
    'type_name',
    'view_of',
]
