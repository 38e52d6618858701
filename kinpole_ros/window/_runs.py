"""
Which instants can be differentiated together: those whose windows are the same.

A stretch of frames from one recorder is one run, as a rule. What parts it are windows with more or
fewer frames in them, and frames that weigh less than others because markers are hidden in them.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import TypeAlias

import numpy as np

from kinpole_ros.window._ladder import newest_needed

# The frames (T,) that instants are, and the oldest and newest in their windows.
Windows: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
# Weights are worth fits of their own where the variance without them is so many times as large.
_WORTH = 1.1
# Instants times signals that are differentiated at once: more gain next to nothing.
_MOST_AT_ONCE = 2048


def runs(
    stamps: np.ndarray,
    windows: Windows,
    signals: np.ndarray,
    information: np.ndarray,
    noise: np.ndarray,
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]]:
    """
    What `differentiate` takes: times, samples, weights and noise (M, G), of runs of instants.

    The instants are the frames `windows` (now, oldest, newest), each (T,), of frames at `stamps`
    (frames,), ns, with their signals (frames, G, 2); `information` (frames, G) are inverse
    variances over that of `noise` (T, G). Instants whose windows are the same, of frames of the
    same weight, are done at once: as a rule all of them.
    """
    now, oldest, newest = windows
    even, spread = _evenly(information, oldest, newest)
    levels = noise * spread
    after = newest - now
    held = newest - oldest + 1
    if held.min() == held.max() and after.min() == after.max():
        held = np.full(len(now), newest_needed(int(held[0]), int(after[0])))
    else:
        # Where stamps are uneven a window has a frame more now and then, which nobody needs.
        each, which = np.unique(np.stack((held, after)), axis=1, return_inverse=True)
        held = np.array([newest_needed(*pair) for pair in each.T.tolist()])[which.reshape(-1)]
    # Where the next run may begin: what comes before is not the same, or not to be mixed.
    begins = ((held[1:] != held[:-1]) | ~(even[1:] & even[:-1])).nonzero()[0] + 1
    most_at_once = max(1, _MOST_AT_ONCE // noise.shape[1])
    for begin, stop in itertools.pairwise((0, *begins, len(now))):
        for first in range(begin, stop, most_at_once):
            some = slice(first, min(stop, first + most_at_once))
            rows = newest[some] + np.arange(1 - held[first], 1)[:, None]
            weights, level = None, levels[some]
            if not even[first]:
                most = information[rows[:, 0]].max(axis=0)
                most = np.where(most > 0, most, 1.0)
                weights = information[rows[:, 0]] / most
                level = noise[some] / np.sqrt(most)
            yield stamps[rows] - stamps[now[some]], signals[rows], weights, level


def joined(found: Sequence[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, ...]:
    """Arrays (..., T, B) of some runs of instants, as of one."""
    if len(found) == 1:
        return found[0]
    return tuple(np.concatenate(parts, axis=-2) for parts in zip(*found, strict=True))


def _evenly(
    information: np.ndarray, oldest: np.ndarray, newest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    In which windows (T,), of frames `oldest` to `newest` (T,), all frames may weigh the same.

    That is where weights would gain next to nothing. Also the root (T, G) of the mean of the
    inverse of `information` (frames, G): the deviation of a sample that is as good as the others;
    (1, G) where all frames are as good.
    """
    part = information[oldest[0] : newest[-1] + 1]
    alike = part == part[0]
    if np.count_nonzero(alike) == alike.size:
        return np.ones(len(oldest), bool), 1 / np.sqrt(np.where(part[:1] > 0, part[:1], 1.0))
    with np.errstate(divide='ignore'):
        inverse = np.where(part > 0, 1 / part, 0.0)
    # With one place more, for the end of the last window.
    sums = np.zeros((3, part.shape[1], len(part) + 1))
    sums[..., :-1] = part.T, inverse.T, part.T <= 0
    count = (newest - oldest + 1)[:, None]
    # Window by window: differences of running sums lose all that is beside one immense inverse.
    bounds = np.stack((oldest, newest + 1), axis=1).reshape(-1) - oldest[0]
    seen, spread, dark = np.add.reduceat(sums, bounds, axis=-1)[..., ::2].transpose(0, 2, 1)
    # A signal that is not there at all is no reason to weigh the others.
    even = (dark == count) | ((dark == 0) & (seen * spread < _WORTH * count**2))
    return even.all(axis=1), np.sqrt(np.where(dark < count, spread / count, 1.0))
