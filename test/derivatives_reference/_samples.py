"""
Windows of samples that are not even: some are missing, or good for less, or not in their places.

Models are of even samples. One that is off its place is moved there along what is found of the
motion, which is then found again.
"""

from typing import NamedTuple

import numpy as np

from derivatives_reference._evidence import KNOWN, Lacking, move
from derivatives_reference._models import Modes, modes_of, slopes_of
from kinpole_ros.planar._plane import Real

# A sample that is missing is first put on a parabola through so many others.
_NEAREST = 6
# How often samples are moved, and those that are all but exact, until they move by less than so
# many deviations. Meanwhile the noise counts for so many samples: it is more while they are not in
# their places.
_ROUNDS, _MORE_ROUNDS, _SETTLED, _KNOWN = 6, 38, 0.05, 1.0
_SIGNAL = [0, 1, 1]


class Window(NamedTuple):
    """The arguments of `stencils_of`."""

    size: int
    at: float
    block: int
    orders: int
    exact: bool

    @property
    def models(self) -> tuple[int, int, bool]:
        """The arguments of `modes_of`."""
        return self.size, self.block, self.exact


class Placed(NamedTuple):
    """Samples (n, 3, S) in their places, over their noise, and how much larger that is (2, S)."""

    samples: Real
    scale: Real


def place(window: Window, samples: Real, weights: Real | None, off: Real | None) -> Placed:
    """
    Put `samples` (n, 3, S) in their places, of which they are `off` (n, S) by so many samples.

    Unless they are there. Those with `weights` (n, 2, S) of 0, unless they are all 1, are put where
    the others let one expect them.
    """
    if weights is not None:
        samples = _filled(samples, weights[:, 1] <= 0, off)
    if off is None:
        return Placed(samples, np.ones((2, 1)))
    modes, slopes = modes_of(*window.models), slopes_of(*window.models)
    seen, lacking = seen_of(weights, samples)
    samples, left = _moved(modes, slopes, samples, off, seen, lacking)
    # By how much samples are not in their places yet is noise.
    scale = np.sqrt(1 + left**2)
    return Placed(samples / scale[_SIGNAL], scale)


def _moved(
    modes: Modes, slopes: Real, samples: Real, off: Real, seen: Real, lacking: Lacking | None
) -> tuple[Real, Real]:
    """
    Samples moved from where they are `off` their places along what is found of the motion.

    And by how much (2, S) they still were in the last round, those of angle and position.
    """
    given, samples = samples, _moved_by_neighbors(samples, off)
    left = np.empty((2, off.shape[1]))
    least = 0.0 if modes.exact else _SETTLED
    # Angles and positions settle by themselves.
    settled = np.zeros(left.shape, bool)

    def move_on(known: float, rounds: int) -> None:
        """Move signals until they hardly do, at most so often."""
        for _ in range(rounds):
            which = np.flatnonzero(~(settled[0] & settled[1]))
            if not len(which):
                return
            parts = given[..., which], samples[..., which], off[:, which], seen[:, which]
            lacks = lacking and Lacking(lacking.cells[:, which], lacking.weight[..., which])
            moved = move(modes, slopes, *parts, lacks, known)
            kept = settled[:, which]
            moved = np.where(kept[_SIGNAL], parts[1], moved)
            change = total((moved - parts[1]) ** 2) / len(moved)
            # Of both coordinates, whichever way the axes lie.
            change = np.sqrt((change[0], (change[1] + change[2]) / 2))
            samples[..., which] = moved
            left[:, which] = np.where(kept, left[:, which], change)
            settled[:, which] = kept | (change <= least)

    # What is off by little is in its place at once.
    move_on(KNOWN, 1)
    move_on(_KNOWN, _MORE_ROUNDS if modes.exact else _ROUNDS)
    move_on(KNOWN, 2)
    return samples, left


def total(values: Real) -> Real:
    """
    Sums along the first axis, always from first to last.

    Numpy's own order depends on how many columns there are, so that what a signal has alone and
    among others would not be the same to the last bit.
    """
    return np.asarray(np.add.accumulate(values, axis=0)[-1])


def seen_of(weights: Real | None, samples: Real) -> tuple[Real, Lacking | None]:
    """How many of `samples` (n, 3, S) with these weights are seen (2, S), and what is lacking."""
    if weights is None:
        return np.full((2, samples.shape[2]), float(len(samples))), None
    return total(weights), lacking_of(weights)


def lacking_of(weights: Real) -> Lacking | None:
    """Which cells of windows with `weights` (n, 2, S) count for less than 1."""
    less = (weights < 1).any(axis=1)
    most = int(less.sum(axis=0).max())
    if not most:
        return None
    cells = np.argsort(~less, axis=0, kind='stable')[:most]
    return Lacking(cells, np.moveaxis(weights[cells, :, np.arange(less.shape[1])], 2, 1))


def _filled(samples: Real, missing: np.ndarray, off: Real | None) -> Real:
    """Samples with those `missing` (n, S) on parabolas through the nearest of the others."""
    cell, signal = missing.nonzero()
    if not len(cell):
        return samples
    distance = np.abs(np.arange(len(samples)) - cell[:, None]).astype(float)
    distance[missing.T[signal]] = np.inf
    # Of two that are as near the older one.
    near = np.argsort(distance, axis=1, kind='stable')[:, :_NEAREST]
    place = (near - cell[:, None]) / _NEAREST
    if off is not None:
        place += off[near, signal[:, None]] / _NEAREST
    powers = place[..., None] ** np.arange(3)
    turned = powers.swapaxes(1, 2)
    # (M, 1, _NEAREST): what a parabola is at the cell.
    first = np.linalg.inv(turned @ powers)[:, :1] @ turned
    filled = samples.copy()
    filled[cell, :, signal] = (first @ samples[near, :, signal[:, None]])[:, 0]
    return filled


def _moved_by_neighbors(samples: Real, off: Real) -> Real:
    """Samples moved to their places by parabolas through their neighbors."""
    place = np.arange(len(samples))[:, None] + off
    a, b, c = place[:-2], place[1:-1], place[2:]
    y = samples
    first = (y[1:-1] - y[:-2]) / (b - a)[:, None]
    second = (y[2:] - y[1:-1]) / (c - b)[:, None]
    bend = (second - first) / (c - a)[:, None]
    slope = first + bend * (b - a)[:, None]
    at = off[1:-1, None]
    moved = samples.copy()
    moved[1:-1] -= at * slope - at**2 * bend
    moved[0] -= off[0] * first[0]
    moved[-1] -= off[-1] * second[-1]
    return moved
