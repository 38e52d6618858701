"""
Offsets of the fields in the serialized bytes of messages of markers and poses.

A message may come from anywhere, so the sizes in it are followed through the bytes before memory is
taken for what they claim. Offsets are counted from the start of the message.
"""

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

from kinpole_ros.messages._cdr import HEAD, LITTLE
from kinpole_ros.messages._types import END_OF_TIME, INPUT_TYPE_NAMES, SECOND, MessageError
from kinpole_ros.settings import MESSAGE_TYPES, MessageType
from kinpole_ros.settings.message_types import Field

# Parts of a message; beyond, they take seconds and hundreds of MB. A marker takes as long as 16
# points.
_MAX_OBJECTS = 1 << 18
_MARKER = 16
# Bytes and alignment of the kinds of fields in MESSAGE_TYPES.
_SIZES = {
    'int8': (1, 1),
    'uint16': (2, 2),
    'int32': (4, 4),
    'uint32': (4, 4),
    'float64': (8, 8),
    'point': (24, 8),
    'pose': (56, 8),
    'covariance': (288, 8),
}
_ORDERS = {b'\x00\x00': '>', LITTLE: '<'}


class Items(NamedTuple):
    """A sequence or string: offset of its first item, and number of items."""

    start: int
    number: int


class MarkerOffsets(NamedTuple):
    """Offsets of the fields of a Marker; at `number` are its id, type and action."""

    stamp: int
    frame_id: Items
    ns: Items
    number: int
    pose: int
    points: Items


class PoseOffsets(NamedTuple):
    """Offsets of poses: of one with a child_frame_id, or of several without."""

    stamp: int
    frame_id: Items
    child: Items
    poses: Items


class CloudField(NamedTuple):
    """A PointField."""

    name: str
    offset: int
    datatype: int
    number: int


class Cloud(NamedTuple):
    """What a PointCloud2 says of its data, which are at `data`."""

    height: int
    width: int
    fields: Sequence[CloudField]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: Items


class MessageOffsets:
    """
    The offsets in one message of markers or poses of the type `kind`, a key of INPUT_TYPES.

    `size` is that of the message in bytes, `order` its byte order as `struct` names it. `sizes` are
    the offsets of the lengths of all sequences and strings. A Marker or MarkerArray has `markers`,
    the other types a `stamp` and a `frame_id`. A PoseArray has `items`, its poses; a PointCloud2 is
    a `cloud`, and `layout` are first and last offsets of the fields that describe its data. `poses`
    has the poses of bodies. `entries` are the offsets of the fields of each item of a type of which
    MESSAGE_TYPES has the fields.

    Raises MessageError for a message that is cut off, or that holds more than 16,384 markers or
    262,144 poses or points.
    """

    def __init__(self, kind: str, data: bytes) -> None:
        self.sizes: list[int] = []
        self.markers: list[MarkerOffsets] = []
        self.poses: list[PoseOffsets] = []
        self.entries: list[dict[str, Any]] = []
        self.stamp = 0
        self.frame_id = self.items = Items(0, 0)
        self.layout: list[tuple[int, int]] = []
        self.cloud = Cloud(0, 0, (), False, 0, 0, self.items)
        row = MESSAGE_TYPES[kind]
        order = _ORDERS.get(data[:2])
        if order is None or len(data) < HEAD:
            raise MessageError(
                f'{len(data)} bytes are no {INPUT_TYPE_NAMES[kind]}: they do not start as plain '
                'CDR; see that the sender sends that and that nothing is damaged'
            )
        self.order, self.size = order, len(data)
        self._objects = 0
        self._data = data
        self._unpack_length = struct.Struct(f'{order}I').unpack_from
        self._at = HEAD
        try:
            if row.item:
                self._list(row)
            else:
                getattr(self, f'_{kind}')()
        except struct.error:
            self._at = len(data) + 1
        if self._at > len(data):
            raise MessageError(
                f'{len(data)} bytes are no {INPUT_TYPE_NAMES[kind]}: the sizes in them claim more; '
                'see that the sender sends whole messages and that nothing is damaged'
            )
        if self._objects > _MAX_OBJECTS:
            raise MessageError(
                f'{len(data)} bytes of {INPUT_TYPE_NAMES[kind]} are too much: more than '
                f'{_MAX_OBJECTS // _MARKER} markers, or {_MAX_OBJECTS} poses, points and colors; '
                'send them as a PointCloud2'
            )

    def _marker_array(self) -> None:
        for _ in range(self._length()):
            self._marker()
            if self._objects > _MAX_OBJECTS:
                return

    def _marker(self) -> None:
        """Pass the fields of a visualization_msgs/msg/Marker in order."""
        self._objects += _MARKER
        stamp, frame_id = self._header()
        ns = self._sequence(1)
        number = self._skip(12, 4)  # id, type, action
        pose = self._skip(56, 8)
        self._skip(24 + 16 + 8 + 1)  # scale, color, lifetime, frame_locked
        points = self._sequence(24, 8)
        self._sequence(16, 4)  # colors
        self._sequence(1)  # texture_resource
        self._header()  # texture: its header, format and data
        self._sequence(1)
        self._sequence(1)
        self._sequence(8, 4)  # uv_coordinates
        self._sequence(1)  # text
        self._sequence(1)  # mesh_resource
        self._sequence(1)  # mesh_file: filename and data
        self._sequence(1)
        self._skip(1)  # mesh_use_embedded_materials
        self.markers.append(MarkerOffsets(stamp, frame_id, ns, number, pose, points))

    def _pose_array(self) -> None:
        self.stamp, self.frame_id = self._header()
        self.items = self._sequence(56, 8)

    def _pose_stamped(self) -> None:
        stamp, frame_id = self._header()
        poses = Items(self._skip(56, 8), 1)
        self.poses.append(PoseOffsets(stamp, frame_id, Items(0, 0), poses))

    def _body_poses(self) -> None:
        self._pose_array()
        self.poses.append(PoseOffsets(self.stamp, self.frame_id, Items(0, 0), self.items))

    def _tf(self) -> None:
        for _ in range(self._length()):
            self._objects += _MARKER
            if self._objects > _MAX_OBJECTS:
                return
            stamp, frame_id = self._header()
            child = self._sequence(1)
            poses = Items(self._skip(56, 8), 1)
            self.poses.append(PoseOffsets(stamp, frame_id, child, poses))

    def _point_cloud2(self) -> None:
        self.stamp, self.frame_id = self._header()
        height, width = self._describe('2I')
        fields: list[CloudField] = []
        for _ in range(self._length()):
            self._objects += 1
            if self._objects > _MAX_OBJECTS:
                return
            name = self._sequence(1)
            self.layout.append((name.start, name.start + name.number))
            offset, datatype = self._describe('IB')
            fields.append(
                CloudField(text_at(self._data, name), offset, datatype, *self._describe('I'))
            )
        (is_bigendian,) = self._describe('?')
        point_step, row_step = self._describe('2I')
        data = self._sequence(1)
        self._skip(1)  # is_dense
        self.cloud = Cloud(height, width, fields, is_bigendian, point_step, row_step, data)

    def _list(self, row: MessageType) -> None:
        """Pass a header, the fields behind it, and a list of markers or bodies."""
        self.stamp, self.frame_id = self._header()
        for _, kind in row.before:
            self._field(kind)
        self.entries = self._fields_of_list(row.item)
        if self.entries and 'header' in self.entries[0]:
            self.stamp, self.frame_id = self.entries[0]['header']

    def _fields_of_list(self, item: tuple[Field, ...]) -> list[dict[str, Any]]:
        entries: list[dict[str, Any]] = []
        for _ in range(self._length()):
            self._objects += _MARKER
            if self._objects > _MAX_OBJECTS:
                break
            entries.append({name: self._field(kind) for name, kind in item})
        return entries

    def _field(self, kind: str | tuple[Field, ...]) -> Any:
        """Pass a field of a kind of MESSAGE_TYPES; return its offset, or those of its parts."""
        if not isinstance(kind, str):
            return self._fields_of_list(kind)
        if kind == 'header':
            return self._header()
        return self._sequence(1) if kind == 'string' else self._skip(*_SIZES[kind])

    def _header(self) -> tuple[int, Items]:
        return self._skip(8, 4), self._sequence(1)

    def _describe(self, form: str) -> tuple[Any, ...]:
        """Pass numbers that describe the data of a cloud, the first of them aligned."""
        numbers = struct.Struct(self.order + form)
        start = self._skip(numbers.size, 1 if form == '?' else 4)
        self.layout.append((start, start + numbers.size))
        return numbers.unpack_from(self._data, start)

    def _skip(self, size: int, align: int = 1) -> int:
        start = self._at + (HEAD - self._at) % align
        self._at = start + size
        return start

    def _length(self) -> int:
        start = self._skip(4, 4)
        self.sizes.append(start)
        return int(self._unpack_length(self._data, start)[0])

    def _sequence(self, size: int, align: int = 1) -> Items:
        """Skip a sequence of items of this size; an empty one is not aligned to its items."""
        count = self._length()
        if size > 1:
            self._objects += count
        return Items(self._skip(count * size, align if count else 1), count)


def text_at(data: bytes, text: Items) -> str:
    """Return a string in a message; what is no UTF-8 in it is replaced."""
    start, number = text
    return data[start : start + number].partition(b'\0')[0].decode(errors='replace')


def check_stamp(data: bytes, at: int, order: str) -> None:
    """Raise MessageError for a stamp that no ROS time has."""
    seconds, nanoseconds = struct.unpack_from(f'{order}iI', data, at)
    if seconds < 0:
        raise MessageError(
            f'header.stamp is {seconds} s; see that the driver sets it to the time of capture, '
            'counted from 1970 or from its start'
        )
    if seconds * SECOND + nanoseconds >= END_OF_TIME:
        raise MessageError(
            f'header.stamp has {nanoseconds} ns after {seconds} s, more than a ROS time holds; '
            'see that the driver sets nanosec to less than 1e9'
        )
