"""
Marker messages read from their bytes, messages of one layout at once.

Making objects of a message takes milliseconds for an array of 100 markers, though only stamps and
coordinates differ from one message to the next. So the layout of the first message keeps the
offsets of stamp and coordinates in it, and a mask of the bytes that decide what these mean.
Messages that agree with it in the masked bytes are read by compiled code. If they differ in the
names of markers alone, as where markers come and go, the names are read again.
"""

from collections.abc import Iterable, Iterator, Mapping
from ctypes import byref
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.core.bindings import MessageLayout, library, pass_new_array
from kinpole_ros.findings import Finding
from kinpole_ros.messages._cdr import LITTLE
from kinpole_ros.messages._marker_array import Names, drawings_finding
from kinpole_ros.messages._marker_layouts import Mask, markers_in
from kinpole_ros.messages._offsets import MessageOffsets, stamp_at, text_at
from kinpole_ros.messages._points import (
    PointLayout,
    blank_unseen,
    layout_of_messages,
    transformed,
)
from kinpole_ros.messages._types import (
    MARKER_TYPES,
    ROS_TYPE_NAMES,
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

    A MarkerArray gives one marker for each sphere, cube and cylinder, at its position, and those in
    lists of them and of points, moved by the pose of the list; not what it deletes. Its header is
    that of the first of them. A Marker gives its `points`, moved by its pose.

    Parameters
    ----------
    message : object
        The message, of a class in `MARKER_TYPES`.
    identity : str
        How markers are named: auto, index, id, ns, ns_id or shape. A MarkerArray has all of them;
        auto means ns_id ('ns/id', or 'id' where ns is empty), and the index counts every entry, so
        that a deleted marker does not rename others. Point k of a list has '/k' behind the name of
        the list. The other types have the index alone, and a
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
        Where the message cannot be read so: without a stamp, as an empty MarkerArray, or with
        markers in several frames.
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
        self._drawings: dict[str, int] = {}  # the most in a message, by their kind

    def fault(self) -> Finding | None:
        """Return what messages had besides markers, if anything."""
        return drawings_finding(self._drawings)

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
        for kind, count in layout.drawings.items():
            self._drawings[kind] = max(count, self._drawings.get(kind, 0))
        return layout.read(data, 0, 1)


class _Layout(NamedTuple):
    """
    Messages of `size` bytes that agree with `key` in the bits of `mask`.

    `poses` are the bytes of poses that transform points of lists, each with the first of these and
    behind the last. `drawings` counts what is no marker. `names` returns the identities of a
    message that agrees in `fixed`, a part of the mask, or None where they are not plain ASCII.
    Without `names`, `fixed` is the mask.
    """

    size: int
    order: str
    fields: MessageLayout
    points: PointLayout
    mask: np.ndarray
    key: np.ndarray
    fixed: np.ndarray
    names: Names | None
    poses: tuple[tuple[int, int, int], ...]
    frame_id: str
    identities: tuple[str, ...]
    drawings: Mapping[str, int]

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
        for pose, begin, end in self.poses:
            start, strides = first * self.size + pose, (self.size, 8)
            poses = np.ndarray((count, 7), f'{self.order}f8', data, start, strides)
            points[:, begin:end] = transformed(points[:, begin:end], poses)
        if self.poses:
            blank_unseen(points)
        return MarkerFrames(stamps, self.frame_id, self.identities, points)


def _make_layout(kind: str, identity: str, data: bytes) -> _Layout:
    """Return the layout of a message; MessageError for one that cannot be read."""
    offsets = MessageOffsets(kind, data)
    # The bytes that decide what the numbers mean, and those of names.
    mask, naming = Mask(offsets.size), Mask(offsets.size)
    mask.add(0, len(LITTLE))
    for start, end in offsets.layout:
        mask.add(start, end - start)
    for start in offsets.sizes:
        mask.add(start, 4)
    found = markers_in(kind, identity, offsets, data, mask, naming)
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
        *(found.points, combined, key, fixed, names, found.poses),
        *(text_at(data, found.frame_id), found.identities, found.drawings),
    )
