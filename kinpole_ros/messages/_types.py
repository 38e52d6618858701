"""
Classes of messages, their types by name, and stamps, with ROS or without.

The definitions are those of rosbags. Its classes are extended so that a constructor takes fields by
name and has defaults for all, as those of rclpy do. A sequence of numbers is a numpy array, and a
byte is an int. Classes of rclpy are needed only for publishers and subscriptions: see
_installed.py.
"""

import re
from collections.abc import Callable
from dataclasses import field, make_dataclass
from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from kinpole_ros.messages._installed import installed_fields
from kinpole_ros.settings import MESSAGE_TYPES

_STORE: Any = get_typestore(Stores.ROS2_JAZZY)
# The only default in the .msg files in use that is not zero; rosbags does not read defaults.
_DEFAULTS = {('geometry_msgs/msg/Quaternion', 'w'): 1.0}
_DTYPES = {'byte': 'u1', 'char': 'u1', 'octet': 'u1'}


class MessageError(ValueError):
    """A message that cannot be read; the text names the field and says how to fix it."""


def message_class(name: str) -> Any:
    """
    Return a message class by name, 'package/msg/Name' or 'package/Name'.

    Raises LookupError for a type that is neither known nor installed.
    """
    package, short = name.partition('/')[0], name.rpartition('/')[2]
    name = f'{package}/msg/{short}'
    if name not in _STORE.fielddefs:
        fields = installed_fields(name)
        for kind in fields.values():
            if '/' in kind:
                message_class(re.sub(r'\[.*', '', kind))
        lines = (f'{kind} {field}' for field, kind in fields.items())
        _STORE.register(get_types_from_msg('\n'.join(lines), name))
    return _message_class(name)


@cache
def _message_class(name: str) -> Any:
    fields = [
        (own, Any, field(default_factory=_default(kind, _DEFAULTS.get((name, own)))))
        for own, kind in _STORE.fielddefs[name][1]
    ]
    # The store makes what it reads of these classes too.
    bases = (_STORE.types[name],)
    _STORE.types[name] = make_dataclass(name.rpartition('/')[2], fields, bases=bases)
    return _STORE.types[name]


def type_name(cls: Any) -> str:
    """Return the full name of a message class, as 'geometry_msgs/msg/PointStamped'."""
    if name := getattr(cls, '__msgtype__', ''):
        return str(name)
    package, kind = cls.__module__.split('.')[:2]
    return f'{package}/{kind}/{cls.__name__}'


def definition(cls: Any) -> str:
    """
    Return the text of a message type and of all types in it, in rosbag2's form ('ros2msg').

    These are the type itself, then those that it contains, once each, below a line of 80 '=' and a
    line 'MSG: package/Name'.
    """
    return str(_STORE.generate_msgdef(type_name(message_class(type_name(cls))), ros_version=2)[0])


def serialize_message(message: Any) -> bytes:
    """
    Serialize a message to plain CDR, little endian, with zeros in the padding.

    One of rclpy has the padding that rclpy leaves.
    """
    if not hasattr(message, '__msgtype__'):
        from rclpy.serialization import serialize_message as serialize_of_rclpy

        return bytes(serialize_of_rclpy(message))
    return bytes(_STORE.serialize_cdr(message, message.__msgtype__, little_endian=True))


def deserialize_message(data: bytes, cls: Any) -> Any:
    """
    Read a message in CDR of either byte order; MessageError for other data.

    Bytes behind it are ignored, as by rclpy, and text must be UTF-8.
    """
    try:
        # The method of the store refuses bytes behind the message.
        kind = _STORE.get_msgdef(type_name(cls))
        read = kind.deserialize_cdr_le if data[1] else kind.deserialize_cdr_be
        return read(data[4:], 0, kind.cls, _STORE)[0]
    except Exception as error:  # of many kinds
        reason = ' '.join(str(error).split()) or type(error).__name__
        raise MessageError(
            f'{len(data)} bytes are no {type_name(cls)} ({reason}); see that nothing is damaged'
        ) from None


def fields(cls: Any) -> dict[str, str]:
    """Return the types of the fields of a message class by name, as a .msg file has them."""
    return {name: _msg_type(kind) for name, kind in _STORE.fielddefs[type_name(cls)][1]}


def _default(kind: Any, default: Any) -> Callable[[], Any]:
    """Return a function that makes the default of a field."""
    if default is not None:
        return lambda: default
    node, what = kind
    if node == Nodetype.NAME:
        return message_class(what)
    if node == Nodetype.BASE:
        of_text = {'string': str, 'wstring': str, 'bool': bool}
        return of_text.get(what[0], float if what[0].startswith('float') else int)
    item, count = what[0], what[1] if node == Nodetype.ARRAY else 0
    one = _default(item, None)
    if item[0] == Nodetype.NAME or item[1][0] in ('string', 'wstring'):
        return lambda: [one() for _ in range(count)]
    dtype = _DTYPES.get(item[1][0], item[1][0])
    return lambda: np.zeros(count, dtype)


def _msg_type(kind: Any) -> str:
    node, what = kind
    if node == Nodetype.NAME:
        return str(what).replace('/msg/', '/')
    if node == Nodetype.BASE:
        return f'{what[0]}<={what[1]}' if what[1] else str(what[0])
    bound = what[1] if node == Nodetype.ARRAY else f'<={what[1]}' if what[1] else ''
    return f'{_msg_type(what[0])}[{bound}]'


# Pictures, and the camera that took them.
IMAGE, COMPRESSED_IMAGE = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
# The classes in use.
Time = message_class('builtin_interfaces/msg/Time')
DiagnosticArray = message_class('diagnostic_msgs/msg/DiagnosticArray')
DiagnosticStatus = message_class('diagnostic_msgs/msg/DiagnosticStatus')
KeyValue = message_class('diagnostic_msgs/msg/KeyValue')
Point = message_class('geometry_msgs/msg/Point')
PointStamped = message_class('geometry_msgs/msg/PointStamped')
Pose = message_class('geometry_msgs/msg/Pose')
PoseArray = message_class('geometry_msgs/msg/PoseArray')
PoseWithCovarianceStamped = message_class('geometry_msgs/msg/PoseWithCovarianceStamped')
Vector3 = message_class('geometry_msgs/msg/Vector3')
Vector3Stamped = message_class('geometry_msgs/msg/Vector3Stamped')
WrenchStamped = message_class('geometry_msgs/msg/WrenchStamped')
Odometry = message_class('nav_msgs/msg/Odometry')
Path = message_class('nav_msgs/msg/Path')
JointState = message_class('sensor_msgs/msg/JointState')
PointCloud2 = message_class('sensor_msgs/msg/PointCloud2')
PointField = message_class('sensor_msgs/msg/PointField')
ColorRGBA = message_class('std_msgs/msg/ColorRGBA')
Header = message_class('std_msgs/msg/Header')
String = message_class('std_msgs/msg/String')
TFMessage = message_class('tf2_msgs/msg/TFMessage')
Marker = message_class('visualization_msgs/msg/Marker')
MarkerArray = message_class('visualization_msgs/msg/MarkerArray')

INPUT_TYPE_NAMES = {kind: row.type_name for kind, row in MESSAGE_TYPES.items()}
ROS_TYPE_NAMES = {kind: row.type_name for kind, row in MESSAGE_TYPES.items() if not row.has_poses}
# The types that can be written too, and those of markers among them.
INPUT_TYPES: dict[str, type] = {
    kind: message_class(row.type_name) for kind, row in MESSAGE_TYPES.items() if not row.item
}
MARKER_TYPES = {kind: cls for kind, cls in INPUT_TYPES.items() if kind in ROS_TYPE_NAMES}
SECOND = 1_000_000_000  # ns
END_OF_TIME = 2**31 * SECOND  # ns: the first stamp that a ROS time cannot hold


def stamp_to_ns(stamp: Any) -> int:
    """Return a builtin_interfaces Time as an exact number of ns."""
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def ns_to_stamp(ns: int) -> Any:
    """Return a builtin_interfaces Time; ValueError beyond the years 1970 to 2038 that it holds."""
    sec, nanosec = divmod(int(ns), SECOND)
    if not 0 <= ns < END_OF_TIME:
        raise ValueError(f'stamp {ns} ns is out of range: a ROS time holds 0 to 2^31 s')
    return Time(sec=sec, nanosec=nanosec)
