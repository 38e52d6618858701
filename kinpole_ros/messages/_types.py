"""
Classes of messages, their types by name, and stamps, with ROS or without.

A constructor takes fields in order or by name and has defaults for all, as those of rclpy do. A
sequence of numbers is a numpy array, and a byte is an int. Types that are not in _definitions.py
are those of rosbags. It turns messages to bytes and back, and is imported then, which takes 0.1 s.
Classes of rclpy are needed only for publishers and subscriptions: see _installed.py.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, ClassVar

import numpy as np

from kinpole_ros.messages._definitions import DEFINITIONS
from kinpole_ros.messages._installed import installed_fields
from kinpole_ros.settings import MESSAGE_TYPES

# The only default in the .msg files in use that is not zero; rosbags does not read defaults.
_DEFAULTS = {('geometry_msgs/msg/Quaternion', 'w'): 1.0}
_DTYPES = {'byte': 'u1', 'char': 'u1', 'octet': 'u1'}


class MessageError(ValueError):
    """A message that cannot be read; the text names the field and says how to fix it."""


class NoMarkersError(MessageError):
    """A message without markers, and so without a stamp."""


class _Message:
    """A message: its fields are attributes, and the constants of its type are of the class."""

    __msgtype__: ClassVar[str]
    # The type of each field, as a .msg file has it, and a function that makes its default.
    _kinds: ClassVar[dict[str, str]]
    _makers: ClassVar[dict[str, Callable[[], Any]]]

    def __init__(self, *values: Any, **by_name: Any) -> None:
        by_name.update(zip(self._makers, values, strict=False))
        if len(values) > len(self._makers) or by_name.keys() - self._makers.keys():
            raise TypeError(f'the fields of {self.__msgtype__} are {", ".join(self._makers)}')
        for name, make in self._makers.items():
            setattr(self, name, by_name[name] if name in by_name else make())

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        values = ', '.join(f'{name}={value!r}' for name, value in vars(self).items())
        return f'{type(self).__name__}({values})'


def message_class(name: str) -> Any:
    """
    Return a message class by name, 'package/msg/Name' or 'package/Name'.

    Raises LookupError for a type that is neither known nor installed.
    """
    return _message_class(f'{name.partition("/")[0]}/msg/{name.rpartition("/")[2]}')


@cache
def _message_class(name: str) -> Any:
    constants: dict[str, int] = {}
    kinds: dict[str, str] = {}
    for line in _definition_lines(name):
        kind, _, field = line.partition(' ')
        field, is_constant, value = field.partition('=')
        if is_constant:
            constants[field] = int(value)
        else:
            kinds[field] = kind
    makers = {field: _maker(kind, _DEFAULTS.get((name, field))) for field, kind in kinds.items()}
    own = {'__msgtype__': name, '_kinds': kinds, '_makers': makers}
    return type(name.rpartition('/')[2], (_Message,), {**constants, **own})


def _definition_lines(name: str) -> list[str]:
    """Return the lines of a .msg file: fields, and constants if they are known."""
    if name in DEFINITIONS:
        return DEFINITIONS[name].split('; ')
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    if name in store.fielddefs:
        text, _ = store.generate_msgdef(name, ros_version=2)
        lines = text.partition('=' * 80)[0].splitlines()
    else:
        lines = [f'{kind} {field}' for field, kind in installed_fields(name).items()]
    if all('=' in line.partition(' ')[2] for line in lines):
        # As in a message of ROS 2: C has no empty structures.
        lines.append('uint8 structure_needs_at_least_one_member')
    return lines


def _maker(kind: str, default: Any = None) -> Callable[[], Any]:
    """Return a function that makes the default of a field of a type."""
    if default is not None:
        return lambda: default
    item, is_list, count = kind.partition('[')
    if is_list:
        number = int(count[:-1]) if count[:-1].isdecimal() else 0
        if '/' in item or 'string' in item:
            make = _maker(item)
            return lambda: [make() for _ in range(number)]
        return lambda: np.zeros(number, _DTYPES.get(item, item))
    if '/' in item:
        return message_class(item)
    if 'string' in item:
        return str
    return bool if item == 'bool' else float if item.startswith('float') else int


@cache
def _typestore() -> Any:
    """Return the types of rosbags that are registered so far."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.EMPTY)


@cache
def _registered(name: str) -> Any:
    """Return how rosbags reads and writes messages of a type, as instances of the class here."""
    from rosbags.typesys import get_types_from_msg

    store, cls = _typestore(), message_class(name)
    for kind in cls._kinds.values():
        if '/' in kind:
            _registered(type_name(message_class(kind.partition('[')[0])))
    store.register(get_types_from_msg('\n'.join(_definition_lines(name)), name))
    store.types[name] = cls
    return store.get_msgdef(name)


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
    name = type_name(message_class(type_name(cls)))
    _registered(name)
    return str(_typestore().generate_msgdef(name, ros_version=2)[0])


def serialize_message(message: Any) -> bytes:
    """
    Serialize a message to plain CDR, little endian, with zeros in the padding.

    One of rclpy has the padding that rclpy leaves.
    """
    if not hasattr(message, '__msgtype__'):
        from rclpy.serialization import serialize_message as serialize_of_rclpy

        return bytes(serialize_of_rclpy(message))
    _registered(message.__msgtype__)
    return bytes(_typestore().serialize_cdr(message, message.__msgtype__, little_endian=True))


def deserialize_message(data: bytes, cls: Any) -> Any:
    """
    Read a message in CDR of either byte order; MessageError for other data.

    Bytes behind it are ignored, as by rclpy, and text must be UTF-8.
    """
    try:
        # The method of the store refuses bytes behind the message.
        kind = _registered(type_name(cls))
        read = kind.deserialize_cdr_le if data[1] else kind.deserialize_cdr_be
        return read(data[4:], 0, kind.cls, _typestore())[0]
    except Exception as error:  # of many kinds
        reason = ' '.join(str(error).split()) or type(error).__name__
        raise MessageError(
            f'{len(data)} bytes are no {type_name(cls)} ({reason}); see that nothing is damaged'
        ) from None


def fields(cls: Any) -> dict[str, str]:
    """Return the types of the fields of a message class by name, as a .msg file has them."""
    return dict(message_class(type_name(cls))._kinds)


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
