"""ROS messages to arrays and back: no other package handles the fields of a message."""

from kinpole_ros.messages._detections import DETECTIONS, Detections, read_detections
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
from kinpole_ros.messages._state import STATE, read_state, read_states, state_fields
from kinpole_ros.messages._tf_chains import chains_of, multiply_out
from kinpole_ros.messages._types import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    INPUT_TYPE_NAMES,
    INPUT_TYPES,
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    DiagnosticArray,
    MessageError,
    NoMarkersError,
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
    'CAMERA_INFO',
    'COLORS',
    'COMPRESSED_IMAGE',
    'DETECTIONS',
    'DRAWING',
    'IMAGE',
    'INPUT_TYPES',
    'INPUT_TYPE_NAMES',
    'MARKER_TYPES',
    'PAGE_TOPICS',
    'RECEIVED',
    'RESTARTS',
    'ROS_TYPE_NAMES',
    'STATE',
    'TF',
    'VIEW',
    'Detections',
    'DiagnosticArray',
    'DiagnosticsMaker',
    'MarkerReader',
    'MessageError',
    'NoMarkersError',
    'Output',
    'PoseReader',
    'String',
    'chains_of',
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
    'multiply_out',
    'ns_to_stamp',
    'outputs_of',
    'poses_data',
    'quantity_lists',
    'read_detections',
    'read_event',
    'read_markers',
    'read_state',
    'read_states',
    'reader_of',
    'result_outputs',
    'serialize_message',
    'stamp_to_ns',
    'state_fields',
    'to_message',
    'type_name',
    'view_of',
]
