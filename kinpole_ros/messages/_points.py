"""Points in the bytes of messages, read by compiled code."""

from ctypes import byref
from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import MessageLayout, address_of, library
from kinpole_ros.messages._types import END_OF_TIME


class PointLayout(NamedTuple):
    """
    Where points are in a message.

    Point k begins at byte `offsets[k]`. Its coordinates x, y and z begin `axes` bytes behind that,
    and are floats of `widths` bytes, 4 or 8. A coordinate of width 0 is missing, and is read as 0.
    """

    offsets: np.ndarray
    axes: tuple[int, ...] = (0, 8, 16)
    widths: tuple[int, ...] = (8, 8, 8)
    is_big_endian: bool = False


def layout_of_messages(
    points: PointLayout, size: int, stamp: int, mask: np.ndarray, key: np.ndarray
) -> MessageLayout:
    """
    Return the layout of messages of `size` bytes that agree with `key` in the bits of `mask`.

    Both are (n,) uint8. Their stamps are at byte `stamp`.
    """
    count, is_big_endian = len(points.offsets), points.is_big_endian
    layout = MessageLayout(
        *(size, len(mask), stamp, END_OF_TIME, count, is_big_endian), points.axes, points.widths
    )
    layout.bind('mask', mask)
    layout.bind('key', key)
    layout.bind('points', np.ascontiguousarray(points.offsets, np.int64))
    return layout


def read_points(layout: PointLayout, data: bytes) -> np.ndarray:
    """Return the points (n, 3) in `data`; one that is not finite is NaN."""
    nothing, points = np.zeros(0, np.uint8), np.empty((len(layout.offsets), 3))
    library.kinpole_read_points(
        byref(layout_of_messages(layout, 0, 0, nothing, nothing)), data, address_of(points)
    )
    return points
