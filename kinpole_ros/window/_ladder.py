"""
The windows about an instant: a geometric ladder of lengths.

Each reaches as far ahead as it does back where it can. Long ones are made of means of samples, by
which a polynomial is as well known.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real

HIGHEST_ORDER = 4
FEWEST_SAMPLES = 7
HIGHEST_DEGREE = 12
_LADDER = 1.33
# Windows of more samples are made of means: a polynomial of this degree is as well known by them.
_FINEST = 128


def longest(count: int) -> int:
    """Samples in the longest window of those that `count` samples have room for."""
    means, each = _ladder(count)[-1]
    return means * each


@lru_cache(maxsize=256)
def newest_needed(count: int, after: int) -> int:
    """How many of `count` samples, the newest, the windows about one with `after` after it hold."""
    needed = 0
    for means, each in _ladder(count):
        blocks, ahead = count // each, after // each
        ahead = max(min(ahead, (means - 1) // 2), means - (blocks - ahead))
        needed = max(needed, (after // each - ahead + means) * each)
    return needed


@lru_cache(maxsize=256)
def _ladder(count: int) -> list[tuple[int, int]]:
    """Windows up to `count` samples: of how many means of how many samples each they are made."""
    windows = [(min(FEWEST_SAMPLES, count), 1)]
    while True:
        means, each = windows[-1]
        longer = max(int(means * each * _LADDER), means * each + 2)
        while longer > _FINEST * each:
            each *= 3
        # Odd numbers are symmetric about the instant.
        means = longer // 2 * 2 + 1 if each == 1 else (longer // each - 1) // 2 * 2 + 1
        if means * each > count:
            return windows
        windows.append((means, each))


class Windows(NamedTuple):
    """
    The l windows of one scale about an instant, in g sets of weights: see `_Scale`.

    They reach from the mean `first` to the mean `last` (l,); `given` (g, l, N') are the square
    roots of the weights of their samples; `lengths` and `means` (g, l) say how many samples and
    means have weight in each, and `highest` of which degree its richest fit is.
    """

    each: int
    start: int
    first: np.ndarray
    last: np.ndarray
    inside: np.ndarray
    root: Real  # (g, B)
    given: Real
    lengths: np.ndarray
    means: np.ndarray
    highest: np.ndarray


def windows_about(now: int, weights: Real) -> list[Windows]:
    """All windows about the sample `now`: each reaches as far ahead as it does back."""
    sets, count = weights.shape
    ladder = _ladder(count)
    result = []
    for each in sorted({each for _, each in ladder}):
        sizes = np.array([means for means, each_ in ladder if each_ == each])
        blocks = count // each
        # The newest samples count most.
        start = count - blocks * each
        here = (now - start) // each
        ahead = np.maximum(np.minimum(blocks - 1 - here, (sizes - 1) // 2), sizes - 1 - here)
        first, last = here + ahead - sizes + 1, here + ahead
        lowest, blocks = first.min(), last.max() - first.min() + 1
        start, first, last = start + lowest * each, first - lowest, last - lowest
        index = np.arange(blocks)
        inside = (index >= first[:, None]) & (index <= last[:, None])
        taken = weights[:, start : start + blocks * each]
        given = taken[:, None] * np.repeat(inside, each, axis=-1)
        by_mean = given.reshape(sets, len(sizes), blocks, each)
        means = (by_mean > 0).any(axis=-1).sum(axis=-1)
        highest = np.maximum(means - 3, np.minimum(means - 1, HIGHEST_ORDER))
        result.append(
            Windows(
                each,
                start,
                first,
                last,
                inside,
                np.sqrt(taken.reshape(sets, blocks, each).sum(axis=-1)),
                np.sqrt(given),
                (given > 0).sum(axis=-1),
                means,
                np.minimum(highest, HIGHEST_DEGREE),
            )
        )
    return result


@lru_cache(maxsize=64)
def even_windows(now: int, count: int) -> list[Windows]:
    """The same where all samples have weight 1."""
    return windows_about(now, np.ones((1, count)))
