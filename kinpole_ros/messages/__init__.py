"""ROS messages to arrays and back: nothing behind this package handles a message itself."""

from ._cloud import MessageError
from ._markers import (
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    ns_to_stamp,
    read_markers,
    stamp_to_ns,
    to_message,
)

__all__ = [
    'MARKER_TYPES',
    'ROS_TYPE_NAMES',
    'MessageError',
    'ns_to_stamp',
    'read_markers',
    'stamp_to_ns',
    'to_message',
]
