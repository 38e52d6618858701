"""
Marker messages read straight from their bytes, messages of one layout at once.

Making the objects of rclpy takes milliseconds for an array of 100 markers, though only stamps and
coordinates differ from one message to the next. So the first message of a layout is read with
rclpy. The layout keeps the offsets of stamp and coordinates in it, and a mask of the bytes that
decide what these mean. Messages that agree with it in the masked bytes are read by compiled code.
If they differ in the names of markers alone, as where markers come and go, the names are read
again.
"""

import struct
from collections.abc import Callable, Iterable, Iterator
from ctypes import byref
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.core.bindings import MessageLayout, library, pass_new_array
from kinpole_ros.messages._cdr import LITTLE
from kinpole_ros.messages._cloud import cloud_layout, id_column
from kinpole_ros.messages._markers import (
    blank_unseen,
    marker_names,
    read_markers,
    shown_entries,
    transformed,
)
from kinpole_ros.messages._offsets import MarkerOffsets, MessageOffsets
from kinpole_ros.messages._points import PointLayout, layout_of_messages
from kinpole_ros.messages._types import (
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    Marker,
    MessageError,
    deserialize_message,
)
from kinpole_ros.tracking.frame import MarkerFrames

# Markers that come and go make many layouts: limits of their number and of their memory in bytes.
_MAX_LAYOUTS = 64
_MAX_RENAMED_LAYOUTS = 8  # of one mask, so that they do not push out the other layouts
_MAX_LAYOUT_BYTES = 1 << 25
_MAX_CONCATENATED_BYTES = 1 << 23
_ID = struct.Struct('<i')

Names = Callable[[bytes], tuple[str, ...] | None]


class MarkerReader:
    """
    Reads serialized messages of one type of markers, with the results of `read_markers`.

    `kind` is a key of MARKER_TYPES, `identity` as in `read_markers`.
    """

    def __init__(self, kind: str, identity: str = 'auto') -> None:
        self._kind = kind
        self._identity = 'index' if identity == 'shape' else identity
        # In the order of their last use, the newest first.
        self._layouts: list[_Layout] = []

    def read(self, messages: Iterable[bytes]) -> list[MarkerFrames | MessageError]:
        """
        Read serialized messages in order; one that cannot be read gives the error.

        Consecutive messages of one layout are one result: the frames of the first result are those
        of the first len(stamps) messages, and so on. An error stands for one message.
        """
        results: list[MarkerFrames | MessageError] = []
        for size, group in groupby(messages, len):
            same_size = list(group)
            step = 1 + _MAX_CONCATENATED_BYTES // (size + 1)
            for first in range(0, len(same_size), step):
                self._read_same_size(same_size[first : first + step], results)
        return results

    def read_numbered(
        self, messages: Iterable[bytes]
    ) -> Iterator[tuple[MarkerFrames | MessageError, np.ndarray]]:
        """Yield the results of `read`, each with the numbers (T,) of its messages."""
        first = 0
        for result in self.read(messages):
            count = 1 if isinstance(result, MessageError) else len(result.stamps)
            yield result, np.arange(first, first + count)
            first += count

    def _read_same_size(
        self, messages: list[bytes], results: list[MarkerFrames | MessageError]
    ) -> None:
        data, k = b''.join(messages), 0
        while k < len(messages):
            layout, count = self._matching_layout(data, k, len(messages))
            if layout is not None:
                results.append(layout.read(data, k, count))
                k += count
            elif not self._remember_renamed(messages[k]):
                results.append(self._read_new(messages[k]))
                k += 1

    def _matching_layout(self, data: bytes, first: int, count: int) -> tuple['_Layout | None', int]:
        """Return the known layout of message `first`, and how many messages from it on have it."""
        size = len(data) // count
        for k, layout in enumerate(self._layouts):
            if layout.size == size:
                matches = layout.count_matches(data, first, count)
                if matches:
                    if k:
                        self._layouts.insert(0, self._layouts.pop(k))
                    return layout, matches
        return None, 0

    def _remember_renamed(self, data: bytes) -> bool:
        """Remember the layout of a message that differs from a known one in names alone, if any."""
        for layout in self._layouts:
            renamed = layout.renamed(data) if layout.size == len(data) else None
            # A stamp beyond the end of time is of no layout.
            if renamed is not None and renamed.count_matches(data, 0, 1):
                same = [k for k, one in enumerate(self._layouts) if one.mask is layout.mask]
                if len(same) >= _MAX_RENAMED_LAYOUTS:
                    del self._layouts[same[-1]]
                self._remember(renamed)
                return True
        return False

    def _remember(self, layout: '_Layout') -> None:
        self._layouts.insert(0, layout)
        while len(self._layouts) > _MAX_LAYOUTS or (
            sum(one.memory for one in self._layouts) > _MAX_LAYOUT_BYTES
        ):
            self._layouts.pop()

    def _read_new(self, data: bytes) -> MarkerFrames | MessageError:
        """Read a message with rclpy, and remember its layout if that gives the same."""
        try:
            offsets = MessageOffsets(self._kind, data)
            message = _deserialized(self._kind, data)
            frames = read_markers(message, self._identity)
        except MessageError as error:
            return error
        if len(data) > _MAX_LAYOUT_BYTES or offsets.order != '<':
            return frames
        if frames.identities or self._kind != 'marker_array':
            reading = _Reading(offsets, message, frames)
            layout = _make_layout(self._kind, self._identity, reading, data)
            if _equal(layout.read(data, 0, 1), frames):
                self._remember(layout)
        return frames


class _Layout(NamedTuple):
    """
    Messages of `size` bytes that agree with `key` in the bits of `mask`.

    Where they are the points of a Marker, the pose that transforms these is at byte `pose`. `names`
    returns the identities of a message that agrees in `fixed`, a part of the mask, or None where
    they are not plain ASCII. Without `names`, `fixed` is the mask.
    """

    size: int
    fields: MessageLayout
    points: PointLayout
    mask: np.ndarray
    key: np.ndarray
    fixed: np.ndarray
    names: Names | None
    pose: int | None
    frame_id: str
    identities: tuple[str, ...]

    @property
    def memory(self) -> int:
        """Bytes that the layout takes."""
        return 3 * self.mask.nbytes + self.points.offsets.nbytes

    def renamed(self, data: bytes) -> '_Layout | None':
        """Return the layout of a message that differs in the names of its markers alone."""
        start = np.frombuffer(data, np.uint8, len(self.mask))
        if self.names is None or ((start ^ self.key) & self.fixed).any():
            return None
        identities = self.names(data)
        if identities is None:
            return None
        key = start & self.mask
        fields = layout_of_messages(self.points, self.size, self.fields.stamp, self.mask, key)
        return self._replace(fields=fields, key=key, identities=identities)

    def count_matches(self, data: bytes, first: int, count: int) -> int:
        """Return how many messages from `first` on are of the layout; `data` are `count`."""
        matches: int = library.kinpole_count_matches(byref(self.fields), data, first, count)
        return matches

    def read(self, data: bytes, first: int, count: int) -> MarkerFrames:
        """Read `count` messages from `first` on, which are all of this layout."""
        stamps, points = np.empty(count, np.int64), np.empty((count, self.fields.count, 3))
        into = pass_new_array(stamps), pass_new_array(points)
        library.kinpole_read_messages(byref(self.fields), data, first, count, *into)
        if self.pose is not None:
            start, strides = first * self.size + self.pose, (self.size, 8)
            points = transformed(points, np.ndarray((count, 7), '<f8', data, start, strides))
            blank_unseen(points)
        return MarkerFrames(stamps, self.frame_id, self.identities, points)


def _deserialized(kind: str, data: bytes) -> Any:
    try:
        return deserialize_message(data, MARKER_TYPES[kind])
    except Exception as error:  # rclpy raises the errors of its middleware
        raise MessageError(
            f'{len(data)} bytes are no {ROS_TYPE_NAMES[kind]} '
            f'({" ".join(str(error).split()) or type(error).__name__}); see that nothing is damaged'
        ) from None


def _equal(a: MarkerFrames, b: MarkerFrames) -> bool:
    return (
        bool((a.stamps == b.stamps).all())
        and a.points.shape == b.points.shape
        and np.array_equal(a.points, b.points, equal_nan=True)
    )


class _Reading(NamedTuple):
    """A message read with rclpy: its offsets, the object, and its frame."""

    offsets: MessageOffsets
    message: Any
    frames: MarkerFrames


class _Mask:
    """The bytes of a message that decide what its numbers mean."""

    def __init__(self, size: int) -> None:
        self.bytes = np.zeros(size, np.uint8)

    def add(self, start: int, size: int) -> None:
        """Add `size` bytes from an offset on."""
        self.bytes[start : start + size] = 0xFF


def _make_layout(kind: str, identity: str, reading: _Reading, data: bytes) -> _Layout:
    """Make the layout of a message that was read with rclpy."""
    offsets, message, frames = reading
    mask, naming = _Mask(offsets.size), _Mask(offsets.size)
    mask.add(0, len(LITTLE))
    for start, end in offsets.layout:
        mask.add(start, end - start)
    for start in offsets.sizes:
        mask.add(start, 4)
    stamp, frame_id = offsets.stamp, offsets.frame_id
    names, pose = None, None
    if kind == 'marker_array':
        rows = shown_entries(message.markers)
        stamp, frame_id = offsets.markers[rows[0]][:2]
        points = PointLayout(np.array([offsets.markers[k].pose for k in rows]))
        names = _add_array(mask, naming, reading, identity)
    elif kind == 'marker':
        (marker,) = offsets.markers
        stamp, frame_id, pose = marker.stamp, marker.frame_id, marker.pose
        # Action, and type where that decides whether it is refused.
        mask.add(marker.number + 8, 4)
        if not marker.points.number:
            mask.add(marker.number + 4, 4)
        points = PointLayout(marker.points.start + 24 * np.arange(frames.points.shape[1]))
    elif kind == 'pose_array':
        points = PointLayout(offsets.items.start + 56 * np.arange(offsets.items.number))
    else:
        points = cloud_layout(message)
        points = points._replace(offsets=points.offsets + offsets.items.start)
        if identity == 'id':
            column = id_column(message, mask.bytes, offsets.items.start)
            np.invert(column, out=column)
    mask.add(frame_id.start, frame_id.number)
    # The sign of the seconds of the stamp: negative ones are refused.
    mask.add(stamp + 3, 1)
    combined = mask.bytes | naming.bytes
    compared = int(combined.nonzero()[0][-1]) + 1
    combined, fixed = combined[:compared].copy(), mask.bytes[:compared].copy()
    if names is None or names(data) != frames.identities:
        names, fixed = None, combined
    key = np.frombuffer(data, np.uint8, compared) & combined
    fields = layout_of_messages(points, offsets.size, stamp, combined, key)
    about = names, pose, frames.frame_id, frames.identities
    return _Layout(offsets.size, fields, points, combined, key, fixed, *about)


def _add_array(mask: _Mask, naming: _Mask, reading: _Reading, identity: str) -> Names | None:
    """Add the bytes of a MarkerArray to the masks; return the reader of its names, if any."""
    offsets, message, _ = reading
    rows = shown_entries(message.markers)
    for k in rows:
        mask.add(*offsets.markers[k].frame_id)
    # Where all entries are lists of points, their types decide whether they are refused.
    has_lists = all(offsets.markers[k].points.number > 1 for k in rows)
    is_deleting = any(marker.action >= Marker.DELETE for marker in message.markers)
    for marker in offsets.markers:
        mask.add(marker.number + 8, 4)
        if has_lists:
            mask.add(marker.number + 4, 4)
        if is_deleting or identity not in ('index', 'id'):
            naming.add(*marker.ns)
        if is_deleting or identity not in ('index', 'ns'):
            naming.add(marker.number, 4)
    return None if is_deleting or identity == 'index' else _names_at(offsets.markers, identity)


def _names_at(markers: list[MarkerOffsets], identity: str) -> Names:
    """Return a function that reads the identities of the markers of an array."""

    def names(data: bytes) -> tuple[str, ...] | None:
        keys = []
        for _, _, (start, length), number, *_ in markers:
            ns, end, remainder = data[start : start + length].partition(b'\0')
            if not end or remainder or not ns.isascii():
                return None
            keys.append((ns.decode(), _ID.unpack_from(data, number)[0]))
        try:
            return marker_names(keys, identity)
        except MessageError:
            return None

    return names
