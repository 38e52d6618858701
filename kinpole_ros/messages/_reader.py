"""
Marker messages straight from their bytes, those of one layout at once.

Making rclpy's objects takes milliseconds for an array of 100 markers, though all that differs from
one message to the next are stamps and coordinates. So the first message of a layout is read the
ordinary way, and where in its bytes the figures are is remembered, with all bytes that decide what
the figures mean. Messages that agree in these are read by a few array operations. Where markers of
an array come and go, so that its names alone differ from those before, the names are read anew.
"""

import struct
from collections.abc import Callable, Iterable, Iterator
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.messages._cloud import MessageError, cloud_places, id_column
from kinpole_ros.messages._markers import (
    END_OF_TIME,
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    blank_unseen,
    marker_names,
    moved,
    read_markers,
    remaining,
)
from kinpole_ros.messages._types import Marker, deserialize_message
from kinpole_ros.messages._walk import LITTLE, MarkerPlaces, Walk
from kinpole_ros.tracking.frame import MarkerFrames, part_of

# Markers that come and go make many layouts; more than these, or larger ones, are not remembered.
_MOST_LAYOUTS = 64
# Of those that differ by names alone, which must not push out the others.
_MOST_NAMES = 8
_MOST_BYTES = 1 << 25
# Of messages concatenated, and of those compared at once, which a cache should hold.
_MOST_CONCATENATED = 1 << 23
_MOST_COMPARED = 1 << 18
# In a row of concatenated messages so many bytes come before each, to align its doubles.
_LEAD = 4
_ID = struct.Struct('<i')
_NS = np.array([1_000_000_000, 1])


class MarkerReader:
    """
    Reads serialized messages of one type, by the `identity` that read_markers knows.

    `kind` is a key of MARKER_TYPES. What it gives is what read_markers makes of the same messages.
    """

    def __init__(self, kind: str, identity: str = 'auto') -> None:
        self._kind = kind
        self._identity = 'index' if identity == 'shape' else identity
        # The ones used last come first.
        self._layouts: list[_Layout] = []

    def read(self, messages: Iterable[bytes]) -> list[MarkerFrames | MessageError]:
        """
        Frames of serialized messages, in order; in place of one that cannot be read, the error.

        Consecutive messages of one layout are one result, so the frames of the first result are of
        the first len(stamps) messages, and so on. An error stands for one message.
        """
        found: list[MarkerFrames | MessageError] = []
        for size, group in groupby(messages, len):
            same_size = list(group)
            most = 1 + _MOST_CONCATENATED // (size + 1)
            for first in range(0, len(same_size), most):
                self._read_same_size(same_size[first : first + most], found)
        return found

    def read_numbered(
        self, messages: Iterable[bytes]
    ) -> Iterator[tuple[MarkerFrames | MessageError, np.ndarray]]:
        """The same with the numbers (T,) of the messages that the frames are of."""
        done = 0
        for part in self.read(messages):
            count = 1 if isinstance(part, MessageError) else len(part.stamps)
            yield part, np.arange(done, done + count)
            done += count

    def _read_same_size(
        self, messages: list[bytes], found: list[MarkerFrames | MessageError]
    ) -> None:
        """Read messages of equal size."""
        rows = _rows(messages)
        k = 0
        while k < len(messages):
            layout = self._fitting(rows[k : k + 1], messages[k])
            if layout is None:
                found.append(self._read_anew(messages[k], rows[k : k + 1]))
                k += 1
            else:
                end = layout.end_of_run(rows, k)
                frames = layout.read(rows[k:end])
                stamps = frames.stamps
                if (stamps[0] if len(stamps) == 1 else stamps.max()) >= END_OF_TIME:
                    good = int((stamps >= END_OF_TIME).argmax())
                    if good:
                        found.append(part_of(frames, slice(good)))
                    found.append(self._read_ordinarily(messages[k + good])[0])
                    end = k + good + 1
                else:
                    found.append(frames)
                k = end

    def _fitting(self, row: np.ndarray, data: bytes) -> '_Layout | None':
        """The layout of a message (1, words), if it is one of those remembered, but for names."""
        masked: dict[int, bytes] = {}
        for k, layout in enumerate(self._layouts):
            if layout.size == len(data):
                mask = layout.mask
                # Layouts that differ in names have one mask.
                if id(mask) not in masked:
                    masked[id(mask)] = (row[:, : len(mask)] & mask).tobytes()
                if masked[id(mask)] == layout.key:
                    if k:
                        self._layouts.insert(0, self._layouts.pop(k))
                    return layout
        for layout in self._layouts:
            if layout.size == len(data):
                renamed = layout.renamed(masked[id(layout.mask)], data)
                if renamed is not None:
                    same = [k for k, one in enumerate(self._layouts) if one.mask is layout.mask]
                    if len(same) >= _MOST_NAMES:
                        del self._layouts[same[-1]]
                    self._remember(renamed)
                    return renamed
        return None

    def _remember(self, layout: '_Layout') -> None:
        self._layouts.insert(0, layout)
        while len(self._layouts) > _MOST_LAYOUTS or (
            sum(kept.memory for kept in self._layouts) > _MOST_BYTES
        ):
            self._layouts.pop()

    def _read_anew(self, data: bytes, row: np.ndarray) -> MarkerFrames | MessageError:
        """Read a message the ordinary way, and remember its layout if that reads it as well."""
        frames, walk, message = self._read_ordinarily(data)
        # One that is too large to be remembered need not be worked out.
        if isinstance(frames, MessageError) or row.nbytes > _MOST_BYTES:
            return frames
        layout = _layout(self._kind, self._identity, walk, message, frames, data, row)
        if layout is not None and _equal(layout.read(row), frames):
            self._remember(layout)
        return frames

    def _read_ordinarily(self, data: bytes) -> tuple[MarkerFrames | MessageError, Any, Any]:
        """What rclpy and read_markers make of a message, with its places and the message."""
        try:
            walk = Walk(self._kind, data)
            message = _deserialized(self._kind, data)
            return read_markers(message, self._identity), walk, message
        except MessageError as error:
            return error, None, None


class _Layout(NamedTuple):
    """
    Messages of `size` bytes that agree with `key` where `mask` has ones, both in words of 64 bits.

    `points` takes the positions (T, n, 3) out of rows; the stamp is at the 32-bit word `stamp`.
    `names` reads the identities from a message that agrees where `fixed` has ones, None where they
    are not plain; without it, all that is in the mask is fixed.
    """

    size: int
    mask: np.ndarray
    key: bytes
    stamp: int
    frame_id: str
    identities: tuple[str, ...]
    points: Callable[[np.ndarray], np.ndarray]
    memory: int
    fixed: np.ndarray
    names: Callable[[bytes], tuple[str, ...] | None] | None

    def renamed(self, key: bytes, data: bytes) -> '_Layout | None':
        """The layout of a message that differs by the names of its markers, if it is one."""
        if self.names is None:
            return None
        differing = np.frombuffer(key, '<u8') ^ np.frombuffer(self.key, '<u8')
        if (differing & self.fixed).any():
            return None
        identities = self.names(data)
        return None if identities is None else self._replace(key=key, identities=identities)

    def end_of_run(self, rows: np.ndarray, first: int) -> int:
        """Where the messages of this layout end that begin at row `first`, which is one."""
        end, count = first + 1, 1
        if end == len(rows):  # as a rule where they come singly
            return end
        most = 1 + _MOST_COMPARED // self.mask.nbytes
        agreed = np.frombuffer(self.key, '<u8')
        while end < len(rows):
            some = rows[end : end + count, : len(self.mask)]
            other = ((some & self.mask) != agreed).any(axis=1)
            if other.any():
                return end + int(other.argmax())
            end += len(some)
            # Where layouts take turns, little is compared in vain.
            count = min(2 * count, most)
        return end

    def read(self, rows: np.ndarray) -> MarkerFrames:
        """Frames of messages (T, words) that are all of this layout."""
        stamps = rows.view('<u4')[:, self.stamp : self.stamp + 2].dot(_NS)
        points = self.points(rows)
        blank_unseen(points)
        return MarkerFrames(stamps, self.frame_id, self.identities, points)


def _rows(messages: list[bytes]) -> np.ndarray:
    """Messages of equal size as rows of 64-bit words, each after _LEAD bytes and filled up."""
    size = len(messages[0])
    fill = -(_LEAD + size) % 8
    parts = [bytes(_LEAD + fill)] * (2 * len(messages) + 1)
    parts[0] = bytes(_LEAD)
    parts[1::2] = messages
    words = (_LEAD + size + fill) // 8
    concatenated = np.frombuffer(b''.join(parts), '<u8', len(messages) * words)
    return concatenated.reshape(len(messages), words)


def _deserialized(kind: str, data: bytes) -> Any:
    try:
        return deserialize_message(data, MARKER_TYPES[kind])
    except Exception as error:  # rclpy raises what its middleware makes of it
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


def _layout(
    kind: str,
    identity: str,
    walk: Walk,
    message: Any,
    frames: MarkerFrames,
    data: bytes,
    row: np.ndarray,
) -> _Layout | None:
    """The layout of a message that was read the ordinary way; None where there is no such thing."""
    if not walk.little or (kind == 'marker_array' and not frames.identities):
        return None
    stamp, frame_id = walk.stamp, walk.frame_id
    spans = [(0, len(LITTLE)), *walk.layout]
    words = list(walk.sizes)
    points: Callable[[np.ndarray], np.ndarray]
    names = None
    mask = np.zeros(row.nbytes, np.uint8)
    naming = np.zeros_like(mask)
    if kind == 'marker_array':
        kept = remaining(message.markers)
        stamp, frame_id = walk.markers[kept[0]][:2]
        frame_ids = [walk.markers[k].frame_id for k in kept]
        spans += [(place.start, place.start + place.number) for place in frame_ids]
        words += [marker.number + 8 for marker in walk.markers]
        if all(walk.markers[k].points.number > 1 for k in kept):
            # Whether they are lists of points, which are refused.
            words += [marker.number + 4 for marker in walk.markers]
        deleting = any(marker.action >= Marker.DELETE for marker in message.markers)
        for _, _, ns, number, *_ in walk.markers:
            if deleting or identity not in ('index', 'id'):
                naming[_LEAD + ns.start : _LEAD + ns.start + ns.number] = 0xFF
            if deleting or identity not in ('index', 'ns'):
                naming[_LEAD + number : _LEAD + number + 4] = 0xFF
        if not deleting and identity != 'index':
            names = _namer(walk.markers, identity)
        points = _taker(np.array([walk.markers[k].pose for k in kept], np.intp))
    elif kind == 'marker':
        (marker,) = walk.markers
        stamp, frame_id = marker[:2]
        words.append(marker.number + 8)
        if not marker.points.number:
            # Whether it is one thing alone, which is refused.
            words.append(marker.number + 4)
        points = _mover(marker.pose, marker.points.start, frames.points.shape[1])
    elif kind == 'pose_array':
        points = _taker(walk.items.start + 56 * np.arange(walk.items.number))
    else:
        cloud = _LEAD + walk.items.start
        places = cloud_places(message)

        def points(rows: np.ndarray) -> np.ndarray:
            return places.points(rows, cloud, len(rows), rows.strides[0])

        if identity == 'id':
            column = id_column(message, mask, cloud)
            np.invert(column, out=column)
    spans.append((frame_id.start, frame_id.start + frame_id.number))
    mask.view('<u4')[(np.array(words, np.intp) + _LEAD) // 4] = 0xFFFFFFFF
    # The sign of the stamp's seconds: those before the beginning of time are refused.
    mask[_LEAD + stamp + 3] = 0x80
    for start, end in spans:
        mask[_LEAD + start : _LEAD + end] = 0xFF
    fixed, every = mask.view('<u8'), (mask | naming).view('<u8')
    words_used = int(every.nonzero()[0][-1]) + 1
    every = every[:words_used].copy()
    return _Layout(
        walk.size,
        every,
        (row[:, :words_used] & every).tobytes(),
        (_LEAD + stamp) // 4,
        frames.frame_id,
        frames.identities,
        points,
        # The places of the points of an array take as much again.
        3 * every.nbytes + 8 * frames.points.size,
        fixed[:words_used].copy() if names is not None else every,
        names if names is not None and names(data) == frames.identities else None,
    )


def _namer(markers: list[MarkerPlaces], identity: str) -> Callable[[bytes], tuple[str, ...] | None]:
    """Reads the identities of an array's markers from its bytes; None where they are not plain."""

    def names(data: bytes) -> tuple[str, ...] | None:
        keys = []
        for _, _, (start, length), number, *_ in markers:
            ns, end, rest = data[start : start + length].partition(b'\0')
            if not end or rest or not ns.isascii():
                return None
            keys.append((ns.decode(), _ID.unpack_from(data, number)[0]))
        try:
            return marker_names(keys, identity)
        except MessageError:
            return None

    return names


def _taker(starts: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Positions whose three doubles begin at each of the places `starts` of the message."""
    index = (starts[:, None] + _LEAD) // 8 + np.arange(3)
    return lambda rows: rows.view('<f8').take(index, axis=1)


def _mover(pose: int, start: int, count: int) -> Callable[[np.ndarray], np.ndarray]:
    """Points of a Marker, moved by its pose."""
    first, places = (_LEAD + pose) // 8, (_LEAD + start) // 8

    def points(rows: np.ndarray) -> np.ndarray:
        doubles = rows.view('<f8')
        local = doubles[:, places : places + 3 * count].reshape(len(rows), count, 3)
        return moved(local, doubles[:, first : first + 7])

    return points
