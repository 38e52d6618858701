"""
Marker messages read straight from their bytes, messages of one layout at once.

Making the objects of rclpy takes milliseconds for an array of 100 markers, though only stamps and
coordinates differ from one message to the next. So the first message of a layout is read with
rclpy. The layout keeps the offsets of stamp and coordinates in it, and a mask of the bytes that
decide what these mean. Messages that agree with it in the masked bytes are read by a few array
operations. If they differ in the names of markers alone, as where markers come and go, the names
are read again.
"""

import struct
from collections.abc import Callable, Iterable, Iterator
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.messages._cdr import LITTLE, TIME
from kinpole_ros.messages._cloud import cloud_layout, id_column
from kinpole_ros.messages._markers import (
    blank_unseen,
    marker_names,
    read_markers,
    shown_entries,
    transformed,
)
from kinpole_ros.messages._offsets import MarkerOffsets, MessageOffsets
from kinpole_ros.messages._types import (
    END_OF_TIME,
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    SECOND,
    Marker,
    MessageError,
    deserialize_message,
)
from kinpole_ros.tracking.frame import MarkerFrames, part_of

# Markers that come and go make many layouts: limits of their number and of their memory in bytes.
_MAX_LAYOUTS = 64
_MAX_RENAMED_LAYOUTS = 8  # of one mask, so that they do not push out the other layouts
_MAX_LAYOUT_BYTES = 1 << 25
_MAX_CONCATENATED_BYTES = 1 << 23
_MAX_COMPARED_BYTES = 1 << 18  # at once: what a cache holds
_LEAD = 4  # bytes before each message in a row, which align its doubles
_ID = struct.Struct('<i')
_NS = np.array([1_000_000_000, 1])

Names = Callable[[bytes], tuple[str, ...] | None]
Points = Callable[[np.ndarray], np.ndarray]


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
        rows = _rows(messages)
        k = 0
        while k < len(messages):
            layout = self._matching_layout(messages[k])
            if layout is None:
                results.append(self._read_new(messages[k], rows[k : k + 1]))
                k += 1
                continue
            end = layout.end_of_run(rows, k)
            frames = layout.read(rows[k:end])
            stamps = frames.stamps
            if (stamps[0] if len(stamps) == 1 else stamps.max()) < END_OF_TIME:
                results.append(frames)
                k = end
                continue
            valid = int((stamps >= END_OF_TIME).argmax())
            if valid:
                results.append(part_of(frames, slice(valid)))
            results.append(self._read_with_rclpy(messages[k + valid])[0])
            k += valid + 1

    def _matching_layout(self, data: bytes) -> '_Layout | None':
        """Return the known layout of a message, or one that differs in names alone."""
        same_size = [layout for layout in self._layouts if layout.size == len(data)]
        compared = max((layout.compared for layout in same_size), default=0)
        # One whole number: comparing it takes a tenth of what arrays take for one message.
        number = int.from_bytes(data[:compared], 'little')
        for layout in same_size:
            if number & layout.mask == layout.key:
                if layout is not self._layouts[0]:
                    self._layouts = [layout, *(one for one in self._layouts if one is not layout)]
                return layout
        for layout in same_size:
            renamed = layout.renamed(number & layout.mask, data)
            if renamed is not None:
                same = [k for k, one in enumerate(self._layouts) if one.mask == layout.mask]
                if len(same) >= _MAX_RENAMED_LAYOUTS:
                    del self._layouts[same[-1]]
                self._remember(renamed)
                return renamed
        return None

    def _remember(self, layout: '_Layout') -> None:
        self._layouts.insert(0, layout)
        while len(self._layouts) > _MAX_LAYOUTS or (
            sum(one.memory for one in self._layouts) > _MAX_LAYOUT_BYTES
        ):
            self._layouts.pop()

    def _read_new(self, data: bytes, row: np.ndarray) -> MarkerFrames | MessageError:
        """Read a message with rclpy, and remember its layout if that gives the same."""
        frames, offsets, message = self._read_with_rclpy(data)
        if isinstance(frames, MessageError) or row.nbytes > _MAX_LAYOUT_BYTES:
            return frames
        if offsets.order == '<' and (frames.identities or self._kind != 'marker_array'):
            layout = _make_layout(self._kind, self._identity, _Reading(offsets, message, frames))
            if layout.names is not None and layout.names(data) != frames.identities:
                layout = layout._replace(names=None, fixed=layout.mask)
            layout = layout._replace(key=int.from_bytes(data, 'little') & layout.mask)
            if _equal(layout.read(row), frames):
                self._remember(layout)
        return frames

    def _read_with_rclpy(self, data: bytes) -> tuple[MarkerFrames | MessageError, Any, Any]:
        """Return the frame of a message, its offsets and the message as an object."""
        try:
            offsets = MessageOffsets(self._kind, data)
            message = _deserialized(self._kind, data)
            return read_markers(message, self._identity), offsets, message
        except MessageError as error:
            return error, None, None


class _Layout(NamedTuple):
    """
    Messages of `size` bytes that agree with `key` in `mask`, both whole numbers, little endian.

    They have no bits beyond the first `compared` bytes. `points` returns the positions (T, n, 3) of
    rows; the stamp is at the 32-bit word `stamp`. `names` returns the identities of a message that
    agrees in `fixed`, a part of the mask, or None where they are not plain ASCII. Without `names`,
    `fixed` is the mask.
    """

    size: int
    compared: int
    mask: int
    key: int
    stamp: int
    frame_id: str
    identities: tuple[str, ...]
    points: Points
    memory: int
    fixed: int
    names: Names | None

    def renamed(self, key: int, data: bytes) -> '_Layout | None':
        """Return the layout of a message that differs in the names of its markers alone."""
        if self.names is None or (key ^ self.key) & self.fixed:
            return None
        identities = self.names(data)
        return None if identities is None else self._replace(key=key, identities=identities)

    def end_of_run(self, rows: np.ndarray, first: int) -> int:
        """Return the end of the messages of this layout that begin at row `first`."""
        end, count = first + 1, 1
        if end == len(rows):
            return end
        words = (_LEAD + self.compared + 7) // 8
        mask, key = (_words(number, words) for number in (self.mask, self.key))
        max_count = 1 + _MAX_COMPARED_BYTES // mask.nbytes
        while end < len(rows):
            differs = ((rows[end : end + count, :words] & mask) != key).any(axis=1)
            if differs.any():
                return end + int(differs.argmax())
            end += len(differs)
            # Few at first: where two layouts alternate, more would be compared for nothing.
            count = min(2 * count, max_count)
        return end

    def read(self, rows: np.ndarray) -> MarkerFrames:
        """Read messages (T, words) that are all of this layout."""
        if len(rows) == 1:
            seconds, ns = TIME.unpack_from(rows, 4 * self.stamp)
            stamps = np.array([seconds * SECOND + ns])
        else:
            stamps = rows.view('<u4')[:, self.stamp : self.stamp + 2].dot(_NS)
        points = self.points(rows)
        blank_unseen(points)
        return MarkerFrames(stamps, self.frame_id, self.identities, points)


def _words(number: int, count: int) -> np.ndarray:
    """The bytes of a whole number in so many words of a row."""
    return np.frombuffer((number << 8 * _LEAD).to_bytes(8 * count, 'little'), '<u8')


def _rows(messages: list[bytes]) -> np.ndarray:
    """Messages of equal size as rows of 64-bit words, each after _LEAD bytes and padded."""
    size = len(messages[0])
    fill = -(_LEAD + size) % 8
    pieces = [bytes(_LEAD + fill)] * (2 * len(messages) + 1)
    pieces[0] = bytes(_LEAD)
    pieces[1::2] = messages
    words = (_LEAD + size + fill) // 8
    concatenated = np.frombuffer(b''.join(pieces), '<u8', len(messages) * words)
    return concatenated.reshape(len(messages), words)


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

    def number(self) -> int:
        """The bytes as a whole number, little endian."""
        return int.from_bytes(self.bytes.tobytes(), 'little')


def _make_layout(kind: str, identity: str, reading: _Reading) -> _Layout:
    """Make the layout of a message that was read with rclpy, but for its key."""
    offsets, message, frames = reading
    mask, naming = _Mask(offsets.size), _Mask(offsets.size)
    mask.add(0, len(LITTLE))
    for start, end in offsets.layout:
        mask.add(start, end - start)
    for start in offsets.sizes:
        mask.add(start, 4)
    stamp, frame_id = offsets.stamp, offsets.frame_id
    names = None
    points: Points
    if kind == 'marker_array':
        rows = shown_entries(message.markers)
        stamp, frame_id = offsets.markers[rows[0]][:2]
        points = _positions_at(np.array([offsets.markers[k].pose for k in rows], np.intp))
        names = _add_array(mask, naming, reading, identity)
    elif kind == 'marker':
        (marker,) = offsets.markers
        stamp, frame_id = marker[:2]
        # Action, and type where that decides whether it is refused.
        mask.add(marker.number + 8, 4)
        if not marker.points.number:
            mask.add(marker.number + 4, 4)
        points = _transformed_at(marker.pose, marker.points.start, frames.points.shape[1])
    elif kind == 'pose_array':
        points = _positions_at(offsets.items.start + 56 * np.arange(offsets.items.number))
    else:
        first, cloud = _LEAD + offsets.items.start, cloud_layout(message)

        def points(rows: np.ndarray) -> np.ndarray:
            return cloud.points(rows, first, len(rows), rows.strides[0])

        if identity == 'id':
            column = id_column(message, mask.bytes, offsets.items.start)
            np.invert(column, out=column)
    mask.add(frame_id.start, frame_id.number)
    # The sign of the seconds of the stamp: negative ones are refused.
    mask.add(stamp + 3, 1)
    fixed = mask.number()
    combined = fixed | naming.number()
    compared = -(-combined.bit_length() // 8)
    return _Layout(
        offsets.size,
        compared,
        combined,
        0,
        (_LEAD + stamp) // 4,
        frames.frame_id,
        frames.identities,
        points,
        # The indices of the points take as much again as the points.
        3 * compared + 8 * frames.points.size,
        combined if names is None else fixed,
        names,
    )


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


def _positions_at(offsets: np.ndarray) -> Points:
    """Return a function that reads the positions at these offsets, three doubles each."""
    index = (offsets[:, None] + _LEAD) // 8 + np.arange(3)
    return lambda rows: rows.view('<f8').take(index, axis=1)


def _transformed_at(pose: int, start: int, count: int) -> Points:
    """Return a function that reads the points of a Marker and transforms them by its pose."""
    first_pose, first_point = (_LEAD + pose) // 8, (_LEAD + start) // 8

    def points(rows: np.ndarray) -> np.ndarray:
        doubles = rows.view('<f8')
        local = doubles[:, first_point : first_point + 3 * count].reshape(len(rows), count, 3)
        return transformed(local, doubles[:, first_pose : first_pose + 7])

    return points
