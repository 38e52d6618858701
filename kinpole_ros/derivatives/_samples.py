"""
Windows of samples that are not even: some are missing, or good for less, or not in their places.

Models are of even samples. One that is off its place is moved there along what is found of the
motion, which is then found again.
"""

import numpy as np

from kinpole_ros.derivatives._evidence import Found, derive, evidence_of, mixture, probabilities
from kinpole_ros.derivatives._lacking import Lacking
from kinpole_ros.derivatives._models import Modes, modes_of, slopes_of, stencils_of
from kinpole_ros.planar._plane import Real

# A sample that is missing is first put on a parabola through so many others.
_NEAREST = 6
# How often samples are moved. For that their noise counts for so many samples: as long as they are
# not in their places, they are off by more.
_ROUNDS, _KNOWN = 4, 1.0
_SIGNAL = [0, 1, 1]


def derive_incomplete(
    window: tuple[int, float, int, int, bool], samples: Real, weights: Real, off: Real
) -> Found:
    """
    The same as `derive`, of `samples` (n, 3, S) with `weights` (n, 2, S), 0 to 1, of angle and
    position, all of them `off` (n, S) their places by so many samples.

    The arguments of `stencils_of` are the `window`.
    """
    count, _, block, _, exact = window
    modes = modes_of(count, block, exact)
    seen, lacking = weights.sum(axis=0), _lacking(weights)
    samples = _filled(samples, weights[:, 1] <= 0, off)
    if np.count_nonzero(off):
        samples = _moved(modes, slopes_of(count, block, exact), samples, off, seen, lacking)
    return derive(modes, stencils_of(*window), samples, seen, lacking)


def _moved(
    modes: Modes, slopes: Real, samples: Real, off: Real, seen: Real, lacking: Lacking | None
) -> Real:
    """Samples moved from where they are `off` their places along what is found of the motion."""
    bodies = off.shape[1]
    given, samples = samples.copy(), _moved_by_neighbors(samples, off)
    for _ in range(_ROUNDS):
        found = evidence_of(modes, samples, seen, lacking, _KNOWN)
        likely = probabilities(modes, found)
        if lacking is not None and found.lacks is not None:
            by = likely.reshape(-1, 2, bodies)[:, _SIGNAL]
            wrong = np.einsum('xmcs,mcs->xsc', found.lacks.error, by)
            where = lacking.cells, slice(None), np.arange(bodies)
            missing = (lacking.weight <= 0).all(axis=1)[..., None]
            given[where] = np.where(missing, samples[where] - wrong, given[where])
        share = mixture(modes, likely).reshape(-1, 2, bodies)[:, _SIGNAL]
        some = share.any(axis=(1, 2)).nonzero()[0]
        motion = found.modes.reshape(-1, 3, bodies)[some] * share[some]
        samples = given.copy()
        power = np.ones(off.shape)
        for order, slope in enumerate(slopes[:, some], 1):
            power = power * off / order
            samples -= power[:, None] * np.tensordot(slope, motion, ((0,), (0,)))
    return samples


def _lacking(weights: Real) -> Lacking | None:
    """Which cells of windows with `weights` (n, 2, S) count for less than 1."""
    less = (weights < 1).any(axis=1)
    most = int(less.sum(axis=0).max())
    if not most:
        return None
    cells = np.argsort(~less, axis=0, kind='stable')[:most]
    return Lacking(cells, np.moveaxis(weights[cells, :, np.arange(less.shape[1])], 2, 1))


def _filled(samples: Real, missing: np.ndarray, off: Real) -> Real:
    """Samples with those `missing` (n, S) on parabolas through the nearest of the others."""
    cell, signal = missing.nonzero()
    if not len(cell):
        return samples
    distance = np.abs(np.arange(len(samples)) - cell[:, None]).astype(float)
    distance[missing.T[signal]] = np.inf
    near = np.argpartition(distance, _NEAREST - 1, axis=1)[:, :_NEAREST]
    place = (near + off[near, signal[:, None]] - cell[:, None]) / _NEAREST
    powers = place[..., None] ** np.arange(3)
    first = np.linalg.pinv(powers)[:, :1]  # (M, 1, _NEAREST): what a parabola is at the cell
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
