"""
Message classes without ROS: those of rosbags, made and read as the classes of rclpy are.

Their constructors take fields by name and have defaults for all. Sequences of numbers are numpy
arrays, and a byte is an int.
"""

from collections.abc import Callable
from dataclasses import field, make_dataclass
from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

_STORE: Any = get_typestore(Stores.ROS2_JAZZY)
# The only default in the .msg files in use that is not zero; rosbags does not read defaults.
_DEFAULTS = {('geometry_msgs/msg/Quaternion', 'w'): 1.0}
_DTYPES = {'byte': 'u1', 'char': 'u1', 'octet': 'u1'}


@cache
def message_class(name: str) -> Any:
    """The class of a message type, 'package/msg/Name' or 'package/Name'; LookupError if unknown."""
    package, *_, short = name.split('/')
    name = f'{package}/msg/{short}'
    fields = [
        (own, Any, field(default_factory=_default(kind, _DEFAULTS.get((name, own)))))
        for own, kind in _STORE.fielddefs[name][1]
    ]
    # The store makes what it reads of these classes too.
    _STORE.types[name] = make_dataclass(short, fields, bases=(_STORE.types[name],))
    return _STORE.types[name]


def type_name(cls: Any) -> str:
    """Full name of a message class, such as 'geometry_msgs/msg/PointStamped'."""
    return str(cls.__msgtype__)


def serialize_message(message: Any) -> bytes:
    """The message as CDR, little endian."""
    return bytes(_STORE.serialize_cdr(message, message.__msgtype__, little_endian=True))


def deserialize_message(data: bytes, cls: Any) -> Any:
    """
    Read a message of this class from CDR data; bad data raises various errors of rosbags.

    Bytes after the message are ignored, as rclpy does. Unlike in rclpy, text must be UTF-8.
    """
    # The method of the store refuses bytes after the message.
    kind = _STORE.get_msgdef(cls.__msgtype__)
    read = kind.deserialize_cdr_le if data[1] else kind.deserialize_cdr_be
    return read(data[4:], 0, kind.cls, _STORE)[0]


def fields(cls: Any) -> dict[str, str]:
    """Types of the fields, as a .msg file has them."""
    return {name: _msg_type(kind) for name, kind in _STORE.fielddefs[cls.__msgtype__][1]}


def constants(cls: Any) -> dict[str, Any]:
    """Constants of a message type, as rclpy has them: a byte is bytes."""
    return {
        name: bytes([value]) if kind in _DTYPES else value
        for name, kind, value in _STORE.fielddefs[cls.__msgtype__][0]
    }


def octets(data: bytes) -> Any:
    """The value of a field of type uint8[]."""
    return np.frombuffer(data, np.uint8)


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


# The classes in use.
Time = message_class('builtin_interfaces/msg/Time')
DiagnosticArray = message_class('diagnostic_msgs/msg/DiagnosticArray')
DiagnosticStatus = message_class('diagnostic_msgs/msg/DiagnosticStatus')
KeyValue = message_class('diagnostic_msgs/msg/KeyValue')
Point = message_class('geometry_msgs/msg/Point')
PointStamped = message_class('geometry_msgs/msg/PointStamped')
Pose = message_class('geometry_msgs/msg/Pose')
PoseArray = message_class('geometry_msgs/msg/PoseArray')
PoseStamped = message_class('geometry_msgs/msg/PoseStamped')
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
WITH_TF = False
