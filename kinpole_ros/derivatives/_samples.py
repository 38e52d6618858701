"""
Windows of samples that are not even: some are missing, or good for less, or not in their places.

Models are of even samples. One that is off its place is moved there along what is found of the
motion, which is then found again.
"""

import numpy as np

from kinpole_ros.derivatives._evidence import KNOWN, Found, evidence_of, mixture, probabilities
from kinpole_ros.derivatives._fast import derive, move
from kinpole_ros.derivatives._lacking import Lacking
from kinpole_ros.derivatives._models import Modes, modes_of, slopes_of, stencils_of
from kinpole_ros.planar._plane import Real

# A sample that is missing is first put on a parabola through so many others.
_NEAREST = 6
# How often samples are moved, and those that are all but exact. Meanwhile the noise counts for so
# many samples: it is more while they are not in their places.
_ROUNDS, _MORE_ROUNDS, _KNOWN = 8, 20, 1.0
# So many pairs of cells that are lacking are treated at once.
_MOST = 1000
_SIGNAL = [0, 1, 1]


def derive_incomplete(
    window: tuple[int, float, int, int, bool], samples: Real, weights: Real, off: Real
) -> Found:
    """
    The same as `derive`, of `samples` (n, 3, S) with `weights` (n, 2, S), 0 to 1, of angle and
    position, all of them `off` (n, S) their places by so many samples.

    The arguments of `stencils_of` are the `window`.
    """
    lacking = (weights < 1).any(axis=1).sum(axis=0)
    signals = np.arange(len(lacking))
    # What is lacking goes by its square: not too much of it at once.
    if len(signals) > 1 and len(signals) * int(lacking.max()) ** 2 > _MOST:
        half = len(signals) // 2
        parts = [
            derive_incomplete(window, samples[..., some], weights[..., some], off[:, some])
            for some in (signals[:half], signals[half:])
        ]
        return Found(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))
    return _derive_some(window, samples, weights, off)


def _derive_some(
    window: tuple[int, float, int, int, bool], samples: Real, weights: Real, off: Real
) -> Found:
    """The same of a few signals."""
    count, _, block, _, exact = window
    modes = modes_of(count, block, exact)
    seen, lacking = weights.sum(axis=0), _lacking(weights)
    samples = _filled(samples, weights[:, 1] <= 0, off)
    if not np.count_nonzero(off):
        return derive(modes, stencils_of(*window), samples, seen, lacking)
    slopes = slopes_of(count, block, exact)
    samples, left = _moved(modes, slopes, samples, off, seen, lacking)
    # By how much samples are not in their places yet is noise.
    more = 1 + left**2
    scale = np.sqrt(more)
    found = derive(modes, stencils_of(*window), samples / scale[_SIGNAL], seen, lacking)
    return found._replace(mean=found.mean * scale[_SIGNAL], covariance=found.covariance * more)


def _moved(
    modes: Modes, slopes: Real, samples: Real, off: Real, seen: Real, lacking: Lacking | None
) -> tuple[Real, Real]:
    """
    Samples moved from where they are `off` their places along what is found of the motion.

    And by how much (2, S) they still were in the last round, those of angle and position.
    """
    given, samples = samples.copy(), _moved_by_neighbors(samples, off)
    rounds = _MORE_ROUNDS if modes.exact else _ROUNDS
    for k in range(rounds):
        arrays = given, samples, off, seen, lacking, _KNOWN if k < rounds - 2 else KNOWN
        before = samples
        moved = move(modes, slopes, *arrays)
        samples = _moved_once(modes, slopes, *arrays) if moved is None else moved
    change = ((samples - before) ** 2).mean(axis=0)
    return samples, np.sqrt(np.stack((change[0], change[1:].max(axis=0))))


def _moved_once(
    modes: Modes,
    slopes: Real,
    given: Real,
    samples: Real,
    off: Real,
    seen: Real,
    lacking: Lacking | None,
    known: float,
) -> Real:
    """The `given` samples moved along what is found from the `samples`, moved before."""
    bodies = off.shape[1]
    found = evidence_of(modes, samples, seen, lacking, known)
    likely = probabilities(modes, found)
    share = mixture(modes, likely).reshape(-1, 2, bodies)[:, _SIGNAL]
    some = share.any(axis=(1, 2)).nonzero()[0]
    motion = found.modes.reshape(-1, 3, bodies)[some] * share[some]
    moved = given.copy()
    power = np.ones(off.shape)
    for order, slope in enumerate(slopes[:, some], 1):
        power = power * off / order
        moved -= power[:, None] * np.tensordot(slope, motion, ((0,), (0,)))
    if lacking is not None and found.lacks is not None:
        # What is missing is where the others have it.
        by = likely.reshape(-1, 2, bodies)[:, _SIGNAL]
        wrong = np.einsum('xmcs,mcs->xsc', found.lacks.error, by)
        where = lacking.cells, slice(None), np.arange(bodies)
        missing = (lacking.weight <= 0).all(axis=1)[..., None]
        moved[where] = np.where(missing, samples[where] - wrong, moved[where])
    return moved


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
