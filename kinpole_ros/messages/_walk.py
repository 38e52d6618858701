"""
Where things are in the serialized bytes of the messages of markers and poses.

A message comes from anywhere, so its sizes are followed through the bytes before anyone takes
memory for what they claim. The encoding is the plain CDR of ROS 2: four bytes that tell it and the
byte order, then the fields one after another, each aligned to its size from there on. Places are
counted from the start of the message; padding holds whatever was in memory.
"""

import struct
from typing import NamedTuple

from kinpole_ros.messages._cdr_writer import HEAD, LITTLE
from kinpole_ros.messages._cloud import MessageError
from kinpole_ros.messages._markers import INPUT_TYPE_NAMES

# What rclpy would make objects of: beyond, they take 5 s and hundreds of MB. A marker takes as long
# as so many points.
_MOST_OBJECTS = 1 << 18
_MARKER = 16
_ORDERS = {b'\x00\x00': '>', LITTLE: '<'}


class Items(NamedTuple):
    """A sequence or string: where its first item is, and how many there are."""

    start: int
    number: int


class MarkerPlaces(NamedTuple):
    """Where the parts of a Marker are; at `number` are its id, type and action."""

    stamp: int
    frame_id: Items
    ns: Items
    number: int
    pose: int
    points: Items


class PosePlaces(NamedTuple):
    """Where the parts of poses are: of one with a child_frame_id, or of several without."""

    stamp: int
    frame_id: Items
    child: Items
    poses: Items


class Walk:
    """
    The places in one message of markers or poses of the type `kind`.

    Raises MessageError when it is cut short, and when it holds more than anyone tracks.

    `size` is that of the message, `little` whether it is little endian, `sizes` where each sequence
    and string tells its length. `markers` has the places in a Marker or MarkerArray; the others
    have a `stamp` and `frame_id`, and what they hold, `items`: poses or the data of a cloud.
    `transforms` has the places of poses of bodies. `layout` are spans of a cloud, from place to
    place, that tell what its data means.
    """

    def __init__(self, kind: str, data: bytes) -> None:
        self.sizes: list[int] = []
        self.markers: list[MarkerPlaces] = []
        self.transforms: list[PosePlaces] = []
        self.stamp = 0
        self.frame_id = self.items = Items(0, 0)
        self.layout: list[tuple[int, int]] = []
        order = _ORDERS.get(data[:2])
        if order is None or len(data) < HEAD:
            raise MessageError(
                f'{len(data)} bytes are no {INPUT_TYPE_NAMES[kind]}: they do not start as plain '
                'CDR; see that the sender sends that and that nothing is damaged'
            )
        self.little, self.order = order == '<', order
        self.size = len(data)
        self._objects = 0
        self._data = data
        self._size = struct.Struct(f'{order}I').unpack_from
        self._at = HEAD
        try:
            getattr(self, f'_{kind}')()
        except struct.error:
            self._at = len(data) + 1
        if self._at > len(data):
            raise MessageError(
                f'{len(data)} bytes are no {INPUT_TYPE_NAMES[kind]}: the sizes in them claim more; '
                'see that the sender sends whole messages and that nothing is damaged'
            )
        if self._objects > _MOST_OBJECTS:
            raise MessageError(
                f'{len(data)} bytes of {INPUT_TYPE_NAMES[kind]} are too much: more than '
                f'{_MOST_OBJECTS // _MARKER} markers, or {_MOST_OBJECTS} poses, points and colors; '
                'send them as a PointCloud2'
            )

    def _marker_array(self) -> None:
        for _ in range(self._length()):
            self._marker()
            if self._objects > _MOST_OBJECTS:
                return

    def _marker(self) -> None:
        """Field after field, as visualization_msgs/msg/Marker has them."""
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
        self.markers.append(MarkerPlaces(stamp, frame_id, ns, number, pose, points))

    def _pose_array(self) -> None:
        self.stamp, self.frame_id = self._header()
        self.items = self._sequence(56, 8)

    def _pose_stamped(self) -> None:
        stamp, frame_id = self._header()
        poses = Items(self._skip(56, 8), 1)
        self.transforms.append(PosePlaces(stamp, frame_id, Items(0, 0), poses))

    def _body_poses(self) -> None:
        self._pose_array()
        self.transforms.append(PosePlaces(self.stamp, self.frame_id, Items(0, 0), self.items))

    def _tf(self) -> None:
        for _ in range(self._length()):
            self._objects += _MARKER
            if self._objects > _MOST_OBJECTS:
                return
            stamp, frame_id = self._header()
            child = self._sequence(1)
            poses = Items(self._skip(56, 8), 1)
            self.transforms.append(PosePlaces(stamp, frame_id, child, poses))

    def _point_cloud2(self) -> None:
        self.stamp, self.frame_id = self._header()
        self._keep(8, 4)  # height, width
        for _ in range(self._length()):
            name = self._sequence(1)
            self.layout.append((name.start, name.start + name.number))
            self._keep(5, 4)  # offset, datatype
            self._keep(4, 4)  # count
        self._keep(1)  # is_bigendian
        self._keep(8, 4)  # point_step, row_step
        self.items = self._sequence(1)
        self._skip(1)  # is_dense

    def _header(self) -> tuple[int, Items]:
        return self._skip(8, 4), self._sequence(1)

    def _keep(self, size: int, align: int = 1) -> None:
        start = self._skip(size, align)
        self.layout.append((start, start + size))

    def _skip(self, size: int, align: int = 1) -> int:
        start = self._at + (HEAD - self._at) % align
        self._at = start + size
        return start

    def _length(self) -> int:
        start = self._skip(4, 4)
        self.sizes.append(start)
        return int(self._size(self._data, start)[0])

    def _sequence(self, size: int, align: int = 1) -> Items:
        """Skip a sequence of items of that size; an empty one is not aligned to its items."""
        count = self._length()
        if size > 1:
            self._objects += count
        return Items(self._skip(count * size, align if count else 1), count)
