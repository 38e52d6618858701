"""
A stretch of a bag: how one bag is done by several processes.

What is learned, of shapes, noise, pins and the clock, hangs on all frames before. So whoever does a
stretch learns from these too, which takes a fraction of the time, and gives the figures of the
stretch alone. They are those of the whole bag, to the last bit.
"""

from itertools import pairwise

import numpy as np

# Diagnostics tell of a second, and drawings show the centrodes of the two seconds before.
_AHEAD = 3_000_000_000
# Of the time a replay takes. Measured with bags of markers alone: 0.13 where stamps jitter, 0.21
# where they are even; and up to 0.4 where no bag of results is written.
_LEARNING = 0.25


class Stretch:
    """
    The frames between two seams, each named by a share of the bag's bytes, 0 to 1.

    A seam is where the stamps are 3 s from those of the first frames beyond that share. Figures
    are known from these first frames on.
    """

    def __init__(self, first: float, last: float) -> None:
        self.is_known = self.is_wanted = False
        self.is_over = False
        self._first, self._last = _Seam(first), _Seam(last)

    def look(self, done: float, stamps: np.ndarray) -> None:
        """The next frames have these `stamps`; with them so much of the bag has been read."""
        stamp = int(stamps[0])
        self.is_wanted = self._first.is_passed(done, stamp)
        self.is_known = self._first.stamp is not None
        self.is_over = self._last.is_passed(done, stamp)


class _Seam:
    def __init__(self, share: float) -> None:
        self._share = share
        self.stamp: int | None = None
        self._passed = False

    def is_passed(self, done: float, stamp: int) -> bool:
        if self.stamp is None and done >= self._share:
            self.stamp = stamp
            self._passed = self._share <= 0
        if self.stamp is not None and self._share < 1:
            self._passed = self._passed or abs(stamp - self.stamp) >= _AHEAD
        return self._passed


def stretches(count: int) -> list[tuple[float, float]]:
    """Shares of a bag such that `count` processes take the same time, one for each."""
    left = 1 - _LEARNING
    ends = [(1 - left**k) / (1 - left**count) for k in range(count + 1)]
    return list(pairwise(ends))
