"""
How long windows are: how many blocks of samples, and of how many of them, so that enough is seen.

Windows of as many cells, at the same place, have the same models: they are treated at once.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from derivatives_reference._cells import Cells
from derivatives_reference._models import FEWEST_SAMPLES

# More samples than this in a window are averaged in blocks.
MOST = 128
# So much of a window is there.
_PRESENT = 0.5
# Windows that are not full have few sizes, since models of each take time to make: by so much one
# is larger than what there is of it, at most.
_LARGER = 1.25
_SIZES = [FEWEST_SAMPLES]
while _SIZES[-1] * _LARGER <= MOST:
    _SIZES.append(int(_SIZES[-1] * _LARGER))
# If more cells than that are lacking, two of them make one.
LACKING = 24


class Group(NamedTuple):
    """
    Signals `which` (S,) with windows of `size` cells, each of `block` samples, `ahead` newer.

    All of them or none are `exact`.
    """

    which: np.ndarray | slice
    size: int
    block: int
    ahead: int
    exact: int


def groups_of(cells: Cells, window: float) -> list[Group]:
    """Signals by their windows, those left out of which there is too little."""
    count = len(cells.samples)
    whole = np.maximum(np.rint(window / cells.interval).astype(int) + 1, FEWEST_SAMPLES)
    blocks = -(-whole // MOST)
    sizes = whole // blocks
    if cells.weight is not None or np.count_nonzero(sizes * blocks > count):
        sizes, blocks = _all_sizes(cells, whole, blocks)
    keys = np.array((sizes, blocks, cells.ahead, cells.exact))
    if not np.count_nonzero(keys != keys[:, :1]):
        return [Group(slice(None), *keys[:, 0].tolist())] if sizes[0] else []
    each, number = np.unique(keys, axis=1, return_inverse=True)
    return [
        Group(np.flatnonzero(number.reshape(-1) == k), *key)
        for k, key in enumerate(each.T.tolist())
        if key[0]
    ]


def _all_sizes(
    cells: Cells, whole: np.ndarray, blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    How many blocks (S,) windows have, 0 for none, and how many cells (S,) a block.

    That is `blocks` (S,), or twice as many, and so on, until little of them is lacking: frames may
    come in bunches.
    """
    if cells.weight is None:
        there = np.ones((len(cells.samples), len(whole)), bool)
    else:
        there = (cells.weight > 0).all(axis=1)
    oldest = len(there) - there[::-1].argmax(axis=0)
    # Instants lie among what is seen, not before it.
    possible = (cells.ahead >= 0) & (cells.ahead < oldest)
    possible &= np.count_nonzero(there, axis=0) >= FEWEST_SAMPLES
    sizes, longest = np.zeros(len(whole), int), blocks.copy()
    while np.count_nonzero(possible):
        for block in np.unique(blocks[possible]).tolist():
            some = np.flatnonzero(possible & (blocks == block))
            seen, last = _blocks_seen(there[:, some], block), oldest[some] // block
            ladder = _ladder(whole[some] // block, last, cells.exact[some])
            found = _sizes(seen, cells.ahead[some] // block, ladder)
            lacking = found - seen[np.minimum(found, len(seen)) - 1, np.arange(len(some))]
            known = found > 0
            sizes[some[known]], longest[some[known]] = found[known], block
            possible[some[known & (lacking <= LACKING)]] = False
        blocks = np.where(possible, 2 * blocks, blocks)
        possible &= whole // blocks >= FEWEST_SAMPLES
    return sizes, longest


def _blocks_seen(there: np.ndarray, block: int) -> np.ndarray:
    """Of how many (n, S) blocks up to each something is `there` (N, S), a block being so many."""
    if block > 1:
        there = np.pad(there, ((0, -len(there) % block), (0, 0)))
        there = there.reshape(-1, block, there.shape[1]).any(axis=1)
    return there.cumsum(axis=0)


def _sizes(seen: np.ndarray, ahead: np.ndarray, ladder: Iterator[np.ndarray]) -> np.ndarray:
    """
    How many blocks (S,) the windows have, the first of the `ladder` of which enough is there.

    0 for none. So many (n, S) are `seen` up to each, and so many (S,) are `ahead` of the instant.
    """
    sizes, signals = np.zeros(len(ahead), int), np.arange(len(ahead))
    for size in ladder:
        there = seen[np.minimum(size, len(seen)) - 1, signals]
        enough = there >= np.maximum(_PRESENT * size, FEWEST_SAMPLES)
        enough &= (ahead < size) & (size >= FEWEST_SAMPLES)
        sizes = np.where((sizes == 0) & enough, size, sizes)
        if not np.count_nonzero(sizes == 0):
            break
    return sizes


def _ladder(full: np.ndarray, last: np.ndarray, exact: np.ndarray) -> Iterator[np.ndarray]:
    """
    Sizes (S,) to try one after the other, from the `full` ones on, 0 for none.

    They are not far beyond the `last` that is there, and for samples that are all but `exact` they
    are what is there.
    """
    there = np.minimum(full, last)
    # Where stamps are not even a window has one frame more or less.
    usual = np.where(last == full - 1, last, full)
    for most in (usual, *_SIZES[::-1]):
        size = np.where(exact, there, np.minimum(full, most))
        yield np.where(size <= _LARGER * last, size, 0)
    # If the instant is the oldest of it.
    yield there
