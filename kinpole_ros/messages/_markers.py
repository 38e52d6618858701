"""Messages of markers as arrays: each of the four types becomes MarkerFrames, and back."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np

from kinpole_ros.messages._cdr import (
    ALIGNMENT,
    HEAD,
    LITTLE,
    serialize_message,
    stamp_bytes,
)
from kinpole_ros.messages._cloud import cloud_ids, cloud_points, make_cloud
from kinpole_ros.messages._types import (
    END_OF_TIME,
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    ColorRGBA,
    Header,
    Marker,
    MarkerArray,
    MessageError,
    Point,
    PointCloud2,
    Pose,
    PoseArray,
    Vector3,
    ns_to_stamp,
    stamp_to_ns,
)
from kinpole_ros.tracking.frame import MarkerFrames

_SHOWN_CHARACTERS = 80  # of a name, which may be as long as the message
_LISTS = (Marker.CUBE_LIST, Marker.SPHERE_LIST, Marker.POINTS)  # drawn at each of their points
_SINGLE = (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER)  # drawn once, at their pose
_IDENTITIES = ('auto', 'index', 'id', 'ns', 'ns_id', 'shape')
_xyz = attrgetter('x', 'y', 'z')


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
    identity = 'index' if identity == 'shape' else identity
    if isinstance(message, MarkerArray):
        header, identities, points = _read_marker_array(message, identity)
    else:
        points = _unnamed_points(message)
        header = message.header
        identities = _identities(message, identity, len(points))
    stamps = np.array([_checked_stamp(header.stamp)])
    blank_unseen(points)
    return MarkerFrames(stamps, header.frame_id, identities, points[None])


def _unnamed_points(message: Any) -> np.ndarray:
    """Points (n, 3), m, of a message without names, in the frame of its header."""
    if isinstance(message, PointCloud2):
        return cloud_points(message)
    if isinstance(message, Marker):
        return _marker_points(message)
    if isinstance(message, PoseArray):
        return _positions(pose.position for pose in message.poses)
    raise MessageError(
        f'{type(message).__name__} is not a message of markers: '
        f'publish one of {", ".join(ROS_TYPE_NAMES.values())}'
    )


def _checked_stamp(stamp: Any) -> int:
    """A stamp in ns; raises MessageError for one that no ROS time has."""
    if stamp.sec < 0:
        raise MessageError(
            f'header.stamp is {stamp.sec} s; see that the driver sets it to the time of capture, '
            'counted from 1970 or from its start'
        )
    ns = stamp_to_ns(stamp)
    if ns >= END_OF_TIME:
        raise MessageError(
            f'header.stamp has {stamp.nanosec} ns after {stamp.sec} s, more than a ROS time holds; '
            'see that the driver sets nanosec to less than 1e9'
        )
    return ns


def to_message(
    kind: str, stamp_ns: int, frame_id: str, names: Sequence[str], points: np.ndarray
) -> Any:
    """
    Make a message of markers, the inverse of `read_markers`.

    Parameters
    ----------
    kind : str
        A key of `MARKER_TYPES`.
    stamp_ns : int
        Stamp, ns.
    frame_id : str
        Frame of the points.
    names : sequence of str
        Names of the n markers. Only a MarkerArray holds them, as ns, with the row as id.
    points : ndarray
        Positions (n, 3), m. A MarkerArray leaves out a row that is not finite. In the other types
        the index is the identity, so they hold a row of NaN.

    Returns
    -------
    object
        The message.

    Raises
    ------
    ValueError
        For another kind or shape, or a stamp that a ROS time cannot hold.
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


def marker_arrays(
    stamps: np.ndarray, frame_id: str, names: Sequence[str], points: np.ndarray
) -> list[bytes]:
    """
    Return the messages that `to_message` makes MarkerArrays of, serialized, without its objects.

    Parameters
    ----------
    stamps : ndarray
        Stamps (T,), ns.
    frame_id : str
        Frame of the points.
    names : sequence of str
        Names of the n markers.
    points : ndarray
        Positions (T, n, 3), m; a marker with a coordinate that is not finite is left out.

    Returns
    -------
    list of bytes
        T messages in CDR.
    """
    messages = [b''] * len(stamps)
    seen = np.isfinite(points).all(axis=-1)
    masks, group = np.unique(seen, axis=0, return_inverse=True)
    for number, mask in enumerate(masks):
        rows = np.flatnonzero(group.reshape(-1) == number)
        markers = np.flatnonzero(mask)
        data = bytearray(LITTLE.ljust(HEAD, b'\0') + len(markers).to_bytes(4, 'little'))
        starts, positions = [], []
        for k in markers.tolist():
            data += bytes(-len(data) % 4)
            block, position = _marker_block(frame_id, names[k], k, (len(data) - HEAD) % ALIGNMENT)
            starts.append(len(data))
            positions.append(len(data) + position)
            data += block
        table = np.tile(np.frombuffer(data, np.uint8), (len(rows), 1))
        if starts:
            stamp_at = np.array(starts)[:, None] + np.arange(8)
            table[:, stamp_at] = stamp_bytes(stamps[rows])[:, None]
            point_at = np.array(positions)[:, None] + np.arange(24)
            shown = points[rows[:, None], markers].astype('<f8')
            table[:, point_at] = shown.view(np.uint8)
        for row, message in zip(rows.tolist(), table, strict=True):
            messages[row] = message.tobytes()
    return messages


@lru_cache(maxsize=20_000)
def _marker_block(frame_id: str, name: str, number: int, phase: int) -> tuple[bytes, int]:
    """Return a marker that begins at `phase` modulo 8, and where its position is."""
    corner = Point(x=1.0 / 3.0, y=2.0 / 3.0, z=4.0 / 3.0)
    header = Header(frame_id=frame_id)
    marker = _sphere(header, name, number, type=Marker.SPHERE, pose=Pose(position=corner))
    # Alone it begins at the first field, in an array behind the length of that.
    message = marker if phase == 0 else MarkerArray(markers=[marker])
    block = serialize_message(message)[HEAD + phase :]
    return block, block.index(np.array((corner.x, corner.y, corner.z), '<f8').tobytes())


def _read_marker_array(
    message: MarkerArray, identity: str
) -> tuple[Header, tuple[str, ...], np.ndarray]:
    markers = message.markers
    rows = shown_entries(markers)
    points = _positions(markers[k].pose.position for k in rows)
    header = markers[rows[0] if rows else 0].header if markers else Header()
    if not rows and header == Header():
        raise MessageError(
            'MarkerArray without markers has no stamp; see that the driver sends nothing when it '
            'sees nothing, or markers with coordinates that are not finite'
        )
    # A marker without a frame is in the frame of the other markers.
    frame_ids = {markers[k].header.frame_id for k in rows} - {''}
    if len(frame_ids) > 1:
        shown = ', '.join(repr(name)[:_SHOWN_CHARACTERS] for name in sorted(frame_ids)[:2])
        raise MessageError(
            f'MarkerArray has markers in {len(frame_ids)} frames, as {shown}: publish all of them '
            'in one, such as that of the ground'
        )
    header = Header(stamp=header.stamp, frame_id=''.join(frame_ids) or header.frame_id)
    # If only some entries are lists they may be a drawing, and the others are the markers.
    if rows and all(len(markers[k].points) > 1 and markers[k].type in _LISTS for k in rows):
        raise MessageError(
            'MarkerArray has lists of points, and a marker of an array is but one point: send a '
            'list as a Marker, or each point as a marker of the array'
        )
    if identity == 'index':
        return header, tuple(map(str, rows)), points
    return header, marker_names([(markers[k].ns, markers[k].id) for k in rows], identity), points


def marker_names(keys: Sequence[tuple[str, int]], identity: str) -> tuple[str, ...]:
    """Return the identities of markers by ns and id; MessageError where one comes twice."""
    if identity == 'id':
        identities = tuple([str(number) for _, number in keys])
    elif identity == 'ns':
        identities = tuple([ns for ns, _ in keys])
    else:
        identities = tuple([f'{ns}/{number}' if ns else str(number) for ns, number in keys])
    _check_unique(identities, 'MarkerArray', identity)
    return identities


def shown_entries(markers: Sequence[Marker]) -> Sequence[int]:
    """Return the indices of the markers that a viewer shows after the whole array."""
    if all(marker.action < Marker.DELETE for marker in markers):
        return range(len(markers))
    # Backward, because a deletion applies only to the entries before it.
    rows: list[int] = []
    deleted: set[tuple[str, int]] = set()
    for k in reversed(range(len(markers))):
        marker = markers[k]
        if marker.action == Marker.DELETEALL:
            break
        if marker.action == Marker.DELETE:
            deleted.add((marker.ns, marker.id))
        elif (marker.ns, marker.id) not in deleted:
            rows.append(k)
    return rows[::-1]


def _marker_points(marker: Marker) -> np.ndarray:
    """Return the points (n, 3) of a Marker in the frame of its header."""
    if marker.action in (Marker.DELETE, Marker.DELETEALL):
        return np.empty((0, 3))
    if not marker.points and marker.type in _SINGLE:
        raise MessageError(
            'Marker has no points, and these are the markers: send all markers of a frame in one '
            'message, as a MarkerArray or as the points of a Marker'
        )
    q, origin = marker.pose.orientation, marker.pose.position
    pose = np.array([[origin.x, origin.y, origin.z, q.x, q.y, q.z, q.w]])
    return transformed(_positions(marker.points)[None], pose)[0]


def transformed(points: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """
    Transform points (T, n, 3) of local frames by the poses (T, 7) of these frames.

    A pose is x, y, z and a quaternion x, y, z, w of any length.
    """
    quaternions = poses[:, 3:]
    # A quaternion of zeros, as in a message with default fields, is the identity, as in RViz.
    is_turned = quaternions[:, :3].any(axis=1) | ~np.isfinite(quaternions[:, 3])
    # A pose that is not finite makes its points NaN; numpy need not warn of it.
    with np.errstate(invalid='ignore', over='ignore'):
        if is_turned.any():
            x, y, z, w = quaternions.T
            norm = np.where(is_turned, np.hypot(np.hypot(x, y), np.hypot(z, w)), 1.0)
            rotations = rotation_matrices(quaternions / norm[:, None])
            # Not by a matrix product, which rounds differently for other numbers of frames.
            points = (rotations[:, None] * points[:, :, None, :]).sum(axis=-1)
        return points + poses[:, None, :3]


def rotation_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Return the rotation matrices (..., 3, 3) of unit quaternions (..., 4) x, y, z, w."""
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _identities(message: Any, identity: str, n: int) -> tuple[str, ...]:
    """Return the identities of a message whose markers have an index."""
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


# Few entries: that of a dense cloud takes megabytes, and n changes seldom.
@lru_cache(maxsize=16)
def _indices(n: int) -> tuple[str, ...]:
    return tuple(map(str, range(n)))


def _check_unique(identities: tuple[str, ...], kind: str, identity: str) -> None:
    if len(set(identities)) < len(identities):
        name, times = Counter(identities).most_common(1)[0]
        raise MessageError(
            f"{kind} has the identity {name[:_SHOWN_CHARACTERS]!r} {times} times by '{identity}': "
            'set another marker_identity (index always works)'
        )


def _positions(positions: Iterable[Any]) -> np.ndarray:
    """Return an array (n, 3) of objects with x, y and z."""
    flat = chain.from_iterable(map(_xyz, positions))
    return np.fromiter(flat, np.float64).reshape(-1, 3)


def blank_unseen(points: np.ndarray) -> None:
    """Set every row of `points` (..., 3) that is not finite to NaN, in place."""
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
