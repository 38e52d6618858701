"""
Stretches of a bag, by which several processes replay one bag.

What is learned, of shapes, noise, pins and the clock, depends on all frames before. So the process
of a stretch also learns from these, which takes a fraction of the time, and gives the results of
the stretch alone. They are those of the whole bag, to the last bit.
"""

import shutil
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from kinpole_ros.bags._tables import join_parquet
from kinpole_ros.bags._writer import BagWriter

# Diagnostics are of a second, and drawings show the centrodes of the two seconds before.
_WARM_UP = 3_000_000_000  # ns
# Share of the time of a replay. Measured with bags of markers alone: 0.13 where stamps jitter, 0.21
# where they are even; and up to 0.4 where no bag of results is written.
_LEARNING_SHARE = 0.25


class Stretch:
    """
    The frames between two seams, each at a share of the bag's bytes, 0 to 1.

    A seam is where the stamps are 3 s from those of the first frames beyond that share. Results are
    estimated from these first frames on, and written from the seam on.
    """

    def __init__(self, first: float = 0.0, last: float = 1.0) -> None:
        self.is_estimated = self.is_written = False
        self.is_over = False
        self._first, self._last = _Seam(first), _Seam(last)

    def update(self, share: float, stamps: np.ndarray) -> None:
        """The next frames have these `stamps`; with them this share of the bag has been read."""
        stamp = int(stamps[0])
        self.is_written = self._first.is_passed(share, stamp)
        self.is_estimated = self._first.stamp is not None
        self.is_over = self._last.is_passed(share, stamp)


class _Seam:
    def __init__(self, share: float) -> None:
        self._share = share
        self.stamp: int | None = None
        self._passed = False

    def is_passed(self, share: float, stamp: int) -> bool:
        if self.stamp is None and share >= self._share:
            self.stamp = stamp
            self._passed = self._share <= 0
        if self.stamp is not None and self._share < 1:
            self._passed = self._passed or abs(stamp - self.stamp) >= _WARM_UP
        return self._passed


def equal_stretches(count: int) -> list[Stretch]:
    """Return stretches that take `count` processes the same time."""
    ratio = 1 - _LEARNING_SHARE
    ends = [(1 - ratio**k) / (1 - ratio**count) for k in range(count + 1)]
    return [Stretch(first, last) for first, last in pairwise(ends)]


def join_files(sources: Sequence[Path], target: Path, kind: str) -> None:
    """Join the results of stretches, 'mcap', 'parquet' or 'csv', as one replay writes them."""
    if kind == 'mcap':
        with BagWriter(target) as writer:
            for source in sources:
                writer.append(source)
    elif kind == 'parquet':
        join_parquet(sources, target)
    else:
        with target.open('wb') as table:
            for number, source in enumerate(sources):
                with source.open('rb') as file:
                    if number:
                        file.readline()
                    shutil.copyfileobj(file, table, 1 << 20)
