"""Points in the bytes of messages, read by compiled code, and transformed."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import MessageLayout
from kinpole_ros.messages._types import END_OF_TIME


class PointLayout(NamedTuple):
    """
    Where points are in a message.

    Point k begins at byte `offsets[k]`. Its coordinates x, y and z begin `axes` bytes behind that,
    and are floats of `widths` bytes, 4 or 8. A coordinate of width 0 is missing, and is read as 0.
    """

    offsets: np.ndarray
    is_big_endian: bool
    axes: tuple[int, ...] = (0, 8, 16)
    widths: tuple[int, ...] = (8, 8, 8)


def layout_of_messages(
    points: PointLayout, size: int, stamp: int, order: str, mask: np.ndarray, key: np.ndarray
) -> MessageLayout:
    """
    Return the layout of messages of `size` bytes that agree with `key` in the bits of `mask`.

    Both are (n,) uint8. Their stamps are at byte `stamp`, in the byte order `order`.
    """
    layout = MessageLayout(
        message_bytes=size,
        compared=len(mask),
        stamp_offset=stamp,
        is_stamp_big_endian=order == '>',
        end_of_time=END_OF_TIME,
        point_count=len(points.offsets),
        is_big_endian=points.is_big_endian,
        axis_offsets=points.axes,
        axis_widths=points.widths,
    )
    layout.bind('mask', mask)
    layout.bind('key', key)
    layout.bind('point_offsets', np.ascontiguousarray(points.offsets, np.int64))
    return layout


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


def blank_unseen(points: np.ndarray) -> None:
    """Set every row of `points` (..., 3) that is not finite to NaN, in place."""
    finite = np.isfinite(points)
    if np.count_nonzero(finite) < finite.size:
        points[~finite.all(axis=-1)] = np.nan
