"""Points in the bytes of messages, read by compiled code."""

from ctypes import byref
from typing import NamedTuple

import numpy as np

from kinpole_ros.core import bindings
from kinpole_ros.core.bindings import address_of, library, pass_new_array
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


class MessageLayout(bindings.MessageLayout):
    """
    Messages of `size` bytes that agree with `key` in the bits of `mask`, both (n,) uint8.

    Their stamps are at byte `stamp`. It is that of points.h.
    """

    def __init__(
        self, points: PointLayout, size: int, stamp: int, mask: np.ndarray, key: np.ndarray
    ) -> None:
        count, is_big_endian = len(points.offsets), points.is_big_endian
        super().__init__(
            *(size, len(mask), stamp, END_OF_TIME, count, is_big_endian), points.axes, points.widths
        )
        self.bind('mask', mask)
        self.bind('key', key)
        self.bind('points', np.ascontiguousarray(points.offsets, np.int64))
        self._self = byref(self)

    def count_matches(self, data: bytes, first: int, count: int) -> int:
        """Return how many messages from `first` on are of the layout; `data` are `count`."""
        matches: int = library.kinpole_count_matches(self._self, data, first, count)
        return matches

    def read(self, data: bytes, first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return stamps (T,), ns, and points (T, n, 3) of `count` messages from `first` on."""
        stamps, points = np.empty(count, np.int64), np.empty((count, self.count, 3))
        into = pass_new_array(stamps), pass_new_array(points)
        library.kinpole_read_messages(self._self, data, first, count, *into)
        return stamps, points


def read_points(layout: PointLayout, data: bytes) -> np.ndarray:
    """Return the points (n, 3) in `data`; one that is not finite is NaN."""
    nothing, points = np.zeros(0, np.uint8), np.empty((len(layout.offsets), 3))
    library.kinpole_read_points(
        byref(MessageLayout(layout, 0, 0, nothing, nothing)), data, address_of(points)
    )
    return points
