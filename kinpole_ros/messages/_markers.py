"""Messages of markers, written from arrays."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from kinpole_ros.messages._cdr import ALIGNMENT, HEAD, LITTLE, stamp_bytes
from kinpole_ros.messages._cloud import make_cloud
from kinpole_ros.messages._points import blank_unseen
from kinpole_ros.messages._types import (
    MARKER_TYPES,
    ColorRGBA,
    Header,
    Marker,
    MarkerArray,
    Point,
    Pose,
    PoseArray,
    Vector3,
    ns_to_stamp,
    serialize_message,
)


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

    `stamps` (T,) are in ns and `points` (T, n, 3) in m; a marker with a coordinate that is not
    finite is left out.
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
