"""Where the markers of a message are in its bytes, and which bytes decide that."""

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.messages._cloud import cloud_layout, id_column
from kinpole_ros.messages._marker_array import (
    SINGLE,
    Names,
    check_unique,
    drawings_of,
    drawn_points,
    entry_of,
    header_of,
    in_lists,
    marker_names,
    names_at,
    shown_entries,
)
from kinpole_ros.messages._offsets import Items, MessageOffsets
from kinpole_ros.messages._points import PointLayout
from kinpole_ros.messages._types import ROS_TYPE_NAMES, Marker, MessageError


class Mask:
    """The bytes of a message that decide what its numbers mean."""

    def __init__(self, size: int) -> None:
        self.bytes = np.zeros(size, np.uint8)

    def add(self, start: int, size: int) -> None:
        """Add `size` bytes from an offset on."""
        self.bytes[start : start + size] = 0xFF


class MarkersAt(NamedTuple):
    """What the markers of a message are; `names`, `poses` and `drawings` as in a layout."""

    points: PointLayout
    stamp: int
    frame_id: Items
    identities: tuple[str, ...]
    names: Names | None = None
    poses: tuple[tuple[int, int, int], ...] = ()
    drawings: Mapping[str, int] = MappingProxyType({})


def markers_in(
    kind: str, identity: str, offsets: MessageOffsets, data: bytes, mask: Mask, naming: Mask
) -> MarkersAt:
    """
    Return what a message has, and add the bytes that decide it, and those of names.

    Raises MessageError for one that cannot be read.
    """
    if kind == 'marker_array':
        return _in_array(offsets, data, identity, mask, naming)
    if kind == 'point_cloud2':
        return _in_cloud(offsets, data, identity, mask)
    in_one = _in_marker if kind == 'marker' else _in_pose_array
    found = in_one(offsets, data, mask)
    if identity not in ('auto', 'index'):
        raise _no_identity(kind, identity)
    return found


def _in_array(
    offsets: MessageOffsets, data: bytes, identity: str, mask: Mask, naming: Mask
) -> MarkersAt:
    """Return what a MarkerArray has, and add the bytes that decide it."""
    markers, order = offsets.markers, offsets.order
    entries = [entry_of(marker, data, order) for marker in markers]
    shown = shown_entries(entries)
    drawn = drawn_points(markers, entries, shown)
    rows, indices = [k for k, _ in drawn], [index for _, index in drawn]
    stamp, frame_id = header_of(offsets, data, rows, shown)
    for k in rows:
        mask.add(*markers[k].frame_id)
    is_deleting = any(entry.action >= Marker.DELETE for entry in entries)
    for marker in markers:
        mask.add(marker.number + 4, 8)  # type and action
        if is_deleting or identity not in ('index', 'id'):
            naming.add(*marker.ns)
        if is_deleting or identity not in ('index', 'ns'):
            naming.add(marker.number, 4)
    starts = [markers[k].pose if n is None else markers[k].points.start + 24 * n for k, n in drawn]
    points = PointLayout(np.array(starts, np.int64), order == '>')
    lists = {k: rows.index(k) for k, index in drawn if index == 0}
    poses = [(markers[k].pose, first, first + rows.count(k)) for k, first in lists.items()]
    about: dict[str, Any] = {'poses': tuple(poses), 'drawings': drawings_of(entries, shown)}
    if identity == 'index':
        identities = in_lists(list(map(str, rows)), indices)
        return MarkersAt(points, stamp, frame_id, identities, **about)
    of_points = [markers[k] for k in rows]
    names = None if is_deleting else names_at(of_points, indices, identity, order)
    keys = [(entries[k].ns, entries[k].number) for k in rows]
    identities = marker_names(keys, indices, identity)
    return MarkersAt(points, stamp, frame_id, identities, names, **about)


def _in_marker(offsets: MessageOffsets, data: bytes, mask: Mask) -> MarkersAt:
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
    return MarkersAt(
        points, marker.stamp, marker.frame_id, _indices(count), poses=((marker.pose, 0, count),)
    )


def _in_pose_array(offsets: MessageOffsets, _: bytes, __: Mask) -> MarkersAt:
    start, count = offsets.items
    points = PointLayout(start + 56 * np.arange(count), offsets.order == '>')
    return MarkersAt(points, offsets.stamp, offsets.frame_id, _indices(count))


def _in_cloud(offsets: MessageOffsets, data: bytes, identity: str, mask: Mask) -> MarkersAt:
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
    return MarkersAt(points, offsets.stamp, offsets.frame_id, identities)


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
