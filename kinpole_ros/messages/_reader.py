"""
Marker messages read from their bytes, messages of one layout at once.

Making objects of a message takes milliseconds for an array of 100 markers, though only stamps and
coordinates differ from one message to the next. So the layout of the first message keeps the
offsets of stamp and coordinates in it, and a mask of the bytes that decide what these mean.
Messages that agree with it in the masked bytes are read by compiled code. If they differ in the
names of markers alone, as where markers come and go, the names are read again.
"""

from collections.abc import Iterable, Iterator
from ctypes import byref
from functools import lru_cache
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.core.bindings import MessageLayout, library, pass_new_array
from kinpole_ros.messages._cdr import LITTLE
from kinpole_ros.messages._cloud import cloud_layout, id_column
from kinpole_ros.messages._marker_array import (
    SINGLE,
    Names,
    check_unique,
    entry_of,
    header_of,
    marker_names,
    names_at,
    shown_entries,
)
from kinpole_ros.messages._offsets import Items, MessageOffsets, stamp_at, text_at
from kinpole_ros.messages._points import (
    PointLayout,
    blank_unseen,
    layout_of_messages,
    transformed,
)
from kinpole_ros.messages._types import (
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    Marker,
    MessageError,
    serialize_message,
    type_name,
)
from kinpole_ros.tracking.frame import MarkerFrames

_IDENTITIES = ('auto', 'index', 'id', 'ns', 'ns_id', 'shape')
# Markers that come and go make many layouts: limits of their number and of their memory in bytes.
_MAX_LAYOUTS = 64
_MAX_RENAMED_LAYOUTS = 8  # of one mask, so that they do not push out the other layouts
_MAX_LAYOUT_BYTES = 1 << 25
_MAX_CONCATENATED_BYTES = 1 << 23


def read_markers(message: Any, identity: str = 'auto') -> MarkerFrames:
    """
    Read the markers of a MarkerArray, Marker, PoseArray or PointCloud2.

    A MarkerArray gives one marker for each of its entries, at its position, except those that it
    deletes. Its header is that of the first entry. A Marker gives its `points`, moved by its pose.

    Parameters
    ----------
    message : object
        The message, of a class in `MARKER_TYPES`.
    identity : str
        How markers are named: auto, index, id, ns, ns_id or shape. A MarkerArray has all of them;
        auto means ns_id ('ns/id', or 'id' where ns is empty), and the index counts every entry, so
        that a deleted marker does not rename others. The other types have the index alone, and a
        PointCloud2 the id, its integer field `id`. shape reads as index does: the tracker assigns
        the markers by the shapes of the bodies.

    Returns
    -------
    MarkerFrames
        One frame (T = 1), m, in the frame of the header. A marker with a coordinate that is not
        finite is NaN.

    Raises
    ------
    MessageError
        Where the message cannot be read so: without a stamp, as an empty MarkerArray, with markers
        in several frames, or with lists of points as entries.
    ValueError
        For another identity.
    """
    if identity not in _IDENTITIES:
        raise ValueError(f"identity '{identity}' is unknown: use one of {', '.join(_IDENTITIES)}")
    kinds = {ROS_TYPE_NAMES[kind]: kind for kind in MARKER_TYPES}
    kind = kinds.get(type_name(type(message)))
    if kind is None:
        raise MessageError(
            f'{type(message).__name__} is not a message of markers: '
            f'publish one of {", ".join(kinds)}'
        )
    (result,) = MarkerReader(kind, identity).read([serialize_message(message)])
    if isinstance(result, MessageError):
        raise result
    return result


class MarkerReader:
    """
    Reads serialized messages of one type of markers: see `read_markers`.

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
        """Read a message of a layout that is not known, and remember the layout."""
        try:
            layout = _make_layout(self._kind, self._identity, data)
        except MessageError as error:
            return error
        if len(data) <= _MAX_LAYOUT_BYTES:
            self._remember(layout)
        return layout.read(data, 0, 1)


class _Layout(NamedTuple):
    """
    Messages of `size` bytes that agree with `key` in the bits of `mask`.

    Where they are the points of a Marker, the pose that transforms these is at byte `pose`. `names`
    returns the identities of a message that agrees in `fixed`, a part of the mask, or None where
    they are not plain ASCII. Without `names`, `fixed` is the mask.
    """

    size: int
    order: str
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
        key, stamp = start & self.mask, self.fields.stamp_offset
        fields = layout_of_messages(self.points, self.size, stamp, self.order, self.mask, key)
        return self._replace(fields=fields, key=key, identities=identities)

    def count_matches(self, data: bytes, first: int, end: int) -> int:
        """Return how many messages from `first` to before `end` are of the layout."""
        matches: int = library.kinpole_count_matches(byref(self.fields), data, first, end)
        return matches

    def read(self, data: bytes, first: int, count: int) -> MarkerFrames:
        """Read `count` messages from `first` on, which are all of this layout."""
        stamps, points = np.empty(count, np.int64), np.empty((count, self.fields.point_count, 3))
        into = pass_new_array(stamps), pass_new_array(points)
        library.kinpole_read_messages(byref(self.fields), data, first, first + count, *into)
        if self.pose is not None:
            start, strides = first * self.size + self.pose, (self.size, 8)
            poses = np.ndarray((count, 7), f'{self.order}f8', data, start, strides)
            points = transformed(points, poses)
            blank_unseen(points)
        return MarkerFrames(stamps, self.frame_id, self.identities, points)


class _Mask:
    """The bytes of a message that decide what its numbers mean."""

    def __init__(self, size: int) -> None:
        self.bytes = np.zeros(size, np.uint8)

    def add(self, start: int, size: int) -> None:
        """Add `size` bytes from an offset on."""
        self.bytes[start : start + size] = 0xFF


class _Markers(NamedTuple):
    """What the markers of a message are; `names` and `pose` as in a layout."""

    points: PointLayout
    stamp: int
    frame_id: Items
    identities: tuple[str, ...]
    names: Names | None = None
    pose: int | None = None


def _make_layout(kind: str, identity: str, data: bytes) -> _Layout:
    """Return the layout of a message; MessageError for one that cannot be read."""
    offsets = MessageOffsets(kind, data)
    # The bytes that decide what the numbers mean, and those of names.
    mask, naming = _Mask(offsets.size), _Mask(offsets.size)
    mask.add(0, len(LITTLE))
    for start, end in offsets.layout:
        mask.add(start, end - start)
    for start in offsets.sizes:
        mask.add(start, 4)
    if kind == 'marker_array':
        found = _in_array(offsets, data, identity, mask, naming)
    elif kind == 'point_cloud2':
        found = _in_cloud(offsets, data, identity, mask)
    else:
        in_one = _in_marker if kind == 'marker' else _in_pose_array
        found = in_one(offsets, data, mask)
        if identity not in ('auto', 'index'):
            raise _no_identity(kind, identity)
    # Raises its error; the compiled code reads the stamps.
    stamp_at(data, found.stamp, offsets.order)
    mask.add(*found.frame_id)
    # The sign of the seconds of the stamp: negative ones are refused.
    mask.add(found.stamp + (3 if offsets.order == '<' else 0), 1)
    combined = mask.bytes | naming.bytes
    compared = int(combined.nonzero()[0][-1]) + 1
    combined, fixed, names = combined[:compared].copy(), mask.bytes[:compared].copy(), found.names
    if names is None or names(data) != found.identities:
        names, fixed = None, combined
    key = np.frombuffer(data, np.uint8, compared) & combined
    about = offsets.size, found.stamp, offsets.order
    return _Layout(
        *(offsets.size, offsets.order, layout_of_messages(found.points, *about, combined, key)),
        *(found.points, combined, key, fixed, names, found.pose),
        *(text_at(data, found.frame_id), found.identities),
    )


def _in_array(
    offsets: MessageOffsets, data: bytes, identity: str, mask: _Mask, naming: _Mask
) -> _Markers:
    """Return what a MarkerArray has, and add the bytes that decide it."""
    markers, order = offsets.markers, offsets.order
    entries = [entry_of(marker, data, order) for marker in markers]
    rows = shown_entries(entries)
    stamp, frame_id = header_of(offsets, data, entries, rows)
    for k in rows:
        mask.add(*markers[k].frame_id)
    # Where all entries are lists of points, their types decide whether they are refused.
    has_lists = all(markers[k].points.number > 1 for k in rows)
    is_deleting = any(entry.action >= Marker.DELETE for entry in entries)
    for marker in markers:
        mask.add(marker.number + 8, 4)
        if has_lists:
            mask.add(marker.number + 4, 4)
        if is_deleting or identity not in ('index', 'id'):
            naming.add(*marker.ns)
        if is_deleting or identity not in ('index', 'ns'):
            naming.add(marker.number, 4)
    points = PointLayout(np.array([markers[k].pose for k in rows], np.int64), order == '>')
    if identity == 'index':
        return _Markers(points, stamp, frame_id, tuple(map(str, rows)))
    names = None if is_deleting else names_at(markers, identity, order)
    keys = [(entries[k].ns, entries[k].number) for k in rows]
    return _Markers(points, stamp, frame_id, marker_names(keys, identity), names)


def _in_marker(offsets: MessageOffsets, data: bytes, mask: _Mask) -> _Markers:
    """Return what a Marker has, and add the bytes that decide it: action, and type if it counts."""
    (marker,) = offsets.markers
    entry = entry_of(marker, data, offsets.order)
    start, count = marker.points
    mask.add(marker.number + 8, 4)
    if not count:
        mask.add(marker.number + 4, 4)
    if entry.action in (Marker.DELETE, Marker.DELETEALL):
        count = 0
    elif not count and entry.kind in SINGLE:
        raise MessageError(
            'Marker has no points, and these are the markers: send all markers of a frame in one '
            'message, as a MarkerArray or as the points of a Marker'
        )
    points = PointLayout(start + 24 * np.arange(count), offsets.order == '>')
    return _Markers(points, marker.stamp, marker.frame_id, _indices(count), pose=marker.pose)


def _in_pose_array(offsets: MessageOffsets, _: bytes, __: _Mask) -> _Markers:
    start, count = offsets.items
    points = PointLayout(start + 56 * np.arange(count), offsets.order == '>')
    return _Markers(points, offsets.stamp, offsets.frame_id, _indices(count))


def _in_cloud(offsets: MessageOffsets, data: bytes, identity: str, mask: _Mask) -> _Markers:
    """Return what a PointCloud2 has, and add the bytes of its ids if they are the names."""
    points = cloud_layout(offsets.cloud)
    if identity in ('auto', 'index'):
        identities = _indices(len(points.offsets))
    elif identity == 'id':
        identities = tuple(map(str, id_column(offsets.cloud, data).ravel().tolist()))
        check_unique(identities, 'PointCloud2', identity)
        column = id_column(offsets.cloud, mask.bytes)
        np.invert(column, out=column)
    else:
        raise _no_identity('point_cloud2', identity)
    return _Markers(points, offsets.stamp, offsets.frame_id, identities)


# Few entries: that of a dense cloud takes megabytes, and n changes seldom.
@lru_cache(maxsize=16)
def _indices(n: int) -> tuple[str, ...]:
    return tuple(map(str, range(n)))


def _no_identity(kind: str, identity: str) -> MessageError:
    """Return the error of markers that have no identities but the index."""
    name = ROS_TYPE_NAMES[kind].rpartition('/')[2]
    return MessageError(
        f"{name} has no identities but the index, so none by '{identity}': "
        'set marker_identity to auto or index'
    )
