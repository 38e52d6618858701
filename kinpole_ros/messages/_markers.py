"""Four message types carry markers; here each becomes MarkerFrames, so only one form goes on."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np

from kinpole_ros.messages._cloud import MessageError, cloud_ids, cloud_places, make_cloud
from kinpole_ros.messages._types import (
    ColorRGBA,
    Header,
    Marker,
    MarkerArray,
    Point,
    PointCloud2,
    Pose,
    PoseArray,
    PoseStamped,
    TFMessage,
    Time,
    Vector3,
)
from kinpole_ros.tracking.frame import MarkerFrames

MARKER_TYPES: dict[str, type] = {
    'marker_array': MarkerArray,
    'marker': Marker,
    'pose_array': PoseArray,
    'point_cloud2': PointCloud2,
}
ROS_TYPE_NAMES: dict[str, str] = {
    'marker_array': 'visualization_msgs/msg/MarkerArray',
    'marker': 'visualization_msgs/msg/Marker',
    'pose_array': 'geometry_msgs/msg/PoseArray',
    'point_cloud2': 'sensor_msgs/msg/PointCloud2',
}
# All that can come in: markers, or poses of bodies.
INPUT_TYPES: dict[str, type] = {
    **MARKER_TYPES,
    'pose_stamped': PoseStamped,
    'body_poses': PoseArray,
    'tf': TFMessage,
}
INPUT_TYPE_NAMES: dict[str, str] = {
    **ROS_TYPE_NAMES,
    'pose_stamped': 'geometry_msgs/msg/PoseStamped',
    'body_poses': 'geometry_msgs/msg/PoseArray',
    'tf': 'tf2_msgs/msg/TFMessage',
}
# Where stamps end, in ns.
END_OF_TIME = 2**31 * 1_000_000_000
# Characters of a name that are shown: it may be as long as the message.
_MOST_SHOWN = 80
# Types of markers that stand for the points in them.
_LISTS = (Marker.CUBE_LIST, Marker.SPHERE_LIST, Marker.POINTS)
# Types that stand for one thing at their pose.
_SINGLE = (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER)
_IDENTITIES = ('auto', 'index', 'id', 'ns', 'ns_id', 'shape')
_xyz = attrgetter('x', 'y', 'z')


def read_markers(message: Any, identity: str = 'auto') -> MarkerFrames:
    """Markers of a MarkerArray, Marker, PoseArray or PointCloud2, in m in the header's frame.

    One frame is returned (T = 1). A row with a coordinate that is not finite becomes NaN as a whole
    and keeps its place.
    `identity` is auto, index, id, ns, ns_id or shape, which reads as index does: by what shape they
    are of is for the tracker to find. A MarkerArray offers all of them, auto meaning
    ns_id ('ns/id', or 'id' where ns is empty), and its index counts every entry of the array, so
    that one deleted marker does not rename the rest. The other types have only the index, except
    that id reads an integer field `id` of a PointCloud2.

    A Marker gives its `points`, moved by its pose. A MarkerArray gives one landmark per marker,
    at its position, less those it deletes; its header is that of the first marker left. An array
    without markers has none, so no time, and cannot be read, nor can one whose markers left are in
    several frames, or all of them lists of points.

    Raises MessageError, a ValueError, when the message cannot be read this way, and ValueError
    when `identity` is none of the above.
    """
    if identity not in _IDENTITIES:
        raise ValueError(f"identity '{identity}' is unknown: use one of {', '.join(_IDENTITIES)}")
    identity = 'index' if identity == 'shape' else identity
    if isinstance(message, MarkerArray):
        header, identities, points = _read_marker_array(message, identity)
    else:
        if isinstance(message, PointCloud2):
            points = cloud_places(message).points(message.data)[0]
        elif isinstance(message, Marker):
            points = _marker_points(message)
        elif isinstance(message, PoseArray):
            points = _positions(pose.position for pose in message.poses)
        else:
            raise MessageError(
                f'{type(message).__name__} is not a message of markers: '
                f'publish one of {", ".join(ROS_TYPE_NAMES.values())}'
            )
        header = message.header
        identities = _identities(message, identity, len(points))
    if header.stamp.sec < 0:
        raise MessageError(
            f'header.stamp is {header.stamp.sec} s; see that the driver sets it to the time of '
            'capture, counted from 1970 or from its start'
        )
    stamp = stamp_to_ns(header.stamp)
    if stamp >= END_OF_TIME:
        raise MessageError(
            f'header.stamp has {header.stamp.nanosec} ns after {header.stamp.sec} s, more than a '
            'ROS time holds; see that the driver sets nanosec to less than 1e9'
        )
    blank_unseen(points)
    stamps = np.array([stamp])
    return MarkerFrames(stamps, header.frame_id, identities, points[None])


def to_message(
    kind: str, stamp_ns: int, frame_id: str, names: Sequence[str], points: np.ndarray
) -> Any:
    """Make a message of markers, the inverse of read_markers.

    `kind` is a key of MARKER_TYPES, `stamp_ns` in ns, `points` (n, 3) in m in `frame_id`, and
    `names` the n names, which only a MarkerArray can carry (as ns, with the row as id). It leaves
    out a marker with a coordinate that is not finite, where the other types keep a row of NaN,
    because there the place in the array is the identity. Raises ValueError for another kind or
    shape, or a stamp that ROS cannot hold.
    """
    points = np.array(points, dtype=np.float64)
    if points.shape != (len(names), 3):
        raise ValueError(f'points have shape {points.shape}, expected ({len(names)}, 3)')
    blank_unseen(points)
    header = Header(stamp=ns_to_stamp(stamp_ns), frame_id=frame_id)
    if kind == 'point_cloud2':
        return make_cloud(header, points)
    positions = [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
    if kind == 'pose_array':
        return PoseArray(header=header, poses=[Pose(position=p) for p in positions])
    if kind == 'marker':
        return _sphere(header, 'markers', 0, type=Marker.SPHERE_LIST, points=positions)
    if kind == 'marker_array':
        rows = enumerate(zip(names, positions, strict=True))
        return MarkerArray(
            markers=[
                _sphere(header, name, row, type=Marker.SPHERE, pose=Pose(position=p))
                for row, (name, p) in rows
                if not math.isnan(p.x)
            ]
        )
    raise ValueError(f"kind '{kind}' is unknown: use one of {', '.join(MARKER_TYPES)}")


def stamp_to_ns(stamp: Time) -> int:
    """Return a builtin_interfaces Time as an exact count of ns."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def ns_to_stamp(ns: int) -> Time:
    """Make a builtin_interfaces Time of ns; ValueError outside what it holds (years 1970-2038)."""
    sec, nanosec = divmod(int(ns), 1_000_000_000)
    if not 0 <= ns < END_OF_TIME:
        raise ValueError(f'stamp {ns} ns is out of range: a ROS time holds 0 to 2^31 s')
    return Time(sec=sec, nanosec=nanosec)


def _read_marker_array(
    message: MarkerArray, identity: str
) -> tuple[Header, tuple[str, ...], np.ndarray]:
    markers = message.markers
    kept = remaining(markers)
    points = _positions(markers[k].pose.position for k in kept)
    header = markers[kept[0] if kept else 0].header if markers else Header()
    if not kept and header == Header():
        raise MessageError(
            'MarkerArray without markers has no stamp; see that the driver sends nothing when it '
            'sees nothing, or markers with coordinates that are not finite'
        )
    # A frame that is not named is that of the others.
    frame_ids = {markers[k].header.frame_id for k in kept} - {''}
    if len(frame_ids) > 1:
        shown = ', '.join(repr(name)[:_MOST_SHOWN] for name in sorted(frame_ids)[:2])
        raise MessageError(
            f'MarkerArray has markers in {len(frame_ids)} frames, as {shown}: publish all of them '
            'in one, such as that of the ground'
        )
    header = Header(stamp=header.stamp, frame_id=''.join(frame_ids) or header.frame_id)
    # A mixture may be a drawing among markers.
    if kept and all(len(markers[k].points) > 1 and markers[k].type in _LISTS for k in kept):
        raise MessageError(
            'MarkerArray has lists of points, and a marker of an array is but one point: send a '
            'list as a Marker, or each point as a marker of the array'
        )
    if identity == 'index':
        return header, tuple(map(str, kept)), points
    return header, marker_names([(markers[k].ns, markers[k].id) for k in kept], identity), points


def marker_names(keys: Sequence[tuple[str, int]], identity: str) -> tuple[str, ...]:
    """Identities of markers from their ns and id; raises MessageError for one that comes twice."""
    if identity == 'id':
        identities = tuple([str(number) for _, number in keys])
    elif identity == 'ns':
        identities = tuple([ns for ns, _ in keys])
    else:
        identities = tuple([f'{ns}/{number}' if ns else str(number) for ns, number in keys])
    _check_unique(identities, 'MarkerArray', identity)
    return identities


def remaining(markers: Sequence[Marker]) -> Sequence[int]:
    """Places of the markers that a viewer would show once it has worked through the array."""
    if all(marker.action < Marker.DELETE for marker in markers):
        return range(len(markers))
    # Backwards, because a deletion strikes only what stands before it.
    kept: list[int] = []
    deleted: set[tuple[str, int]] = set()
    for place in reversed(range(len(markers))):
        marker = markers[place]
        if marker.action == Marker.DELETEALL:
            break
        if marker.action == Marker.DELETE:
            deleted.add((marker.ns, marker.id))
        elif (marker.ns, marker.id) not in deleted:
            kept.append(place)
    return kept[::-1]


def _marker_points(marker: Marker) -> np.ndarray:
    """Points of a Marker, (n, 3), taken from its local frame to that of its header."""
    if marker.action in (Marker.DELETE, Marker.DELETEALL):
        return np.empty((0, 3))
    if not marker.points and marker.type in _SINGLE:
        raise MessageError(
            'Marker has no points, and these are the markers: send all markers of a frame in one '
            'message, as a MarkerArray or as the points of a Marker'
        )
    q, place = marker.pose.orientation, marker.pose.position
    pose = np.array([[place.x, place.y, place.z, q.x, q.y, q.z, q.w]])
    return moved(_positions(marker.points)[None], pose)[0]


def moved(points: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """
    Points (T, n, 3) of local frames in the frame these are in.

    `poses` (T, 7) are x, y and z of the place and x, y, z and w of the turn, of any length.
    """
    x, y, z, w = poses.T[3:]
    # RViz too takes the quaternion of a message nobody filled in, all zeros, as identity.
    turned = (x != 0) | (y != 0) | (z != 0) | ~np.isfinite(w)
    # A pose that is not finite makes every row NaN by itself; numpy need not warn of it.
    with np.errstate(invalid='ignore', over='ignore'):
        if turned.any():
            norm = np.where(turned, np.hypot(np.hypot(x, y), np.hypot(z, w)), 1.0)
            x, y, z, w = x / norm, y / norm, z / norm, w / norm
            rows = (
                (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
                (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
                (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
            )
            # Written out, since a matrix product rounds otherwise when there are more instants.
            columns = points[..., 0], points[..., 1], points[..., 2]
            points = np.stack(
                [sum(a[:, None] * c for a, c in zip(row, columns, strict=True)) for row in rows],
                axis=-1,
            )
        return points + poses[:, None, :3]


def _identities(message: Any, identity: str, n: int) -> tuple[str, ...]:
    """Identities of a message that knows its markers by their place."""
    if identity in ('auto', 'index'):
        return _indices(n)
    if identity == 'id' and isinstance(message, PointCloud2):
        identities = cloud_ids(message)
        _check_unique(identities, 'PointCloud2', identity)
        return identities
    raise MessageError(
        f"{type(message).__name__} has no identities but the index, so none by '{identity}': "
        'set marker_identity to auto or index'
    )


# Few entries, because each of a dense cloud is megabytes, and a tracker sees few different n.
@lru_cache(maxsize=16)
def _indices(n: int) -> tuple[str, ...]:
    return tuple(map(str, range(n)))


def _check_unique(identities: tuple[str, ...], kind: str, identity: str) -> None:
    if len(set(identities)) < len(identities):
        name, times = Counter(identities).most_common(1)[0]
        raise MessageError(
            f"{kind} has the identity {name[:_MOST_SHOWN]!r} {times} times by '{identity}': "
            'set another marker_identity (index always works)'
        )


def _positions(positions: Iterable[Any]) -> np.ndarray:
    """Array (n, 3) of objects with x, y and z."""
    flat = chain.from_iterable(map(_xyz, positions))
    return np.fromiter(flat, np.float64).reshape(-1, 3)


def blank_unseen(points: np.ndarray) -> None:
    """Make NaN of every row of `points` (..., 3) that is not finite, in place."""
    finite = np.isfinite(points)
    if np.count_nonzero(finite) < finite.size:
        points[~finite.all(axis=-1)] = np.nan


def _sphere(header: Header, ns: str, number: int, **fields: Any) -> Marker:
    return Marker(
        header=header,
        ns=ns,
        id=number,
        action=Marker.ADD,
        scale=Vector3(x=0.01, y=0.01, z=0.01),
        color=ColorRGBA(r=1.0, g=0.6, b=0.0, a=1.0),
        **fields,
    )
