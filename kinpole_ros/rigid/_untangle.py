"""
Markers that are not where the body can have them: left out, or put back where two were exchanged.

Also which of the first frames of a body tell of its shape, when some of them are outliers.

Looked at only where a rigid fit leaves far more than it does as a rule, or a body seems to jump by
half a turn, so what is tried here need not be fast.
"""

from collections import Counter
from itertools import combinations

import numpy as np

from kinpole_ros.planar import Fit, fit_pose
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid._noise import mean_square, tame_part

EXCHANGED = 'markers_exchanged'
LEFT_OUT = 'markers_left_out'
MIRRORED = 'markers_mirrored'
DROPPED = 'markers_of_misfits'

# rad. Of several exchanges that fit those count that turn a body no farther than so off where it is
# to be: any two of an equilateral triangle may be exchanged, and it fits.
_NEAR = 0.25 * np.pi
# What is off by so many times what a marker may be off spoils a shape that is learned from it for
# longer than to begin anew takes.
_SPOILS = 3.0


def correct_swaps(
    points: Complex,
    shape: Complex,
    weights: Real,
    limit: float,
    angle: float = np.nan,
    erring: Real | float = 1.0,
) -> tuple[Complex, str, np.ndarray]:
    """
    Correct one body's markers (n,) that do not fit its `shape` (n,) with `weights` (n,).

    It is to be at `angle`, rad, NaN if nobody knows; `erring` (n,) is how many times as far as the
    others a marker may be off. Tries, in this order, every exchange of two
    markers, leaving out one marker, and leaving out two; the first kind that leaves no marker
    farther than `limit` (m) from its place is taken, at its best. Returns the markers, NaN where
    left out, what was done, and to which of them. A body that none of it mends, or that fits
    mirrored, is left out as a whole.
    """
    seen = np.flatnonzero(weights > 0)
    pairs = list(combinations(seen, 2))
    exchanges = np.tile(points, (len(pairs), 1))
    for row, (i, j) in enumerate(pairs):
        exchanges[row, [i, j]] = points[[j, i]]
    nothing = np.full_like(points, complex(np.nan, np.nan))
    if len(seen) > 2:
        best, worst = _best(
            exchanges, shape, np.tile(weights, (len(pairs), 1)), limit, angle, erring
        )
        if worst <= limit:
            return exchanges[best], EXCHANGED, np.array(pairs[best])
        mirrored = points[None].conj()
        if _best(mirrored, shape, weights[None], erring=erring)[1] <= limit:
            return nothing, MIRRORED, seen
    for leave in (1, 2):
        # At least two markers have to remain that agree on the distance between them.
        if len(seen) - leave < 2:
            break
        sets = list(combinations(seen, leave))
        lighter = np.tile(weights, (len(sets), 1))
        for row, left in enumerate(sets):
            lighter[row, list(left)] = 0.0
        best, worst = _best(np.tile(points, (len(sets), 1)), shape, lighter, erring=erring)
        if worst <= limit:
            return np.where(lighter[best] > 0, points, nothing), LEFT_OUT, np.array(sets[best])
    return nothing, DROPPED, seen


def half_turn(shape: Complex, weights: Real, limit: float) -> np.ndarray | None:
    """
    Which marker (n,) takes whose place as the body turns by half a turn about its mean.

    Of the markers of weight, none of which may come to lie farther than `limit` (m) from the place
    it takes; None where the shape (n,) has no such symmetry.
    """
    seen = np.flatnonzero(weights > 0)
    arms = shape[seen] - shape[seen].mean()
    distance = np.abs(arms[:, None] + arms)
    other = distance.argmin(axis=1)
    if distance.min(axis=1).max() > limit or (other[other] != np.arange(len(seen))).any():
        return None
    order = np.arange(len(shape))
    order[seen] = seen[other]
    return order


def agreed(
    points: Complex, suspect: float, least: float
) -> tuple[Complex, Fit, Counter[str]] | None:
    """
    The shape (n,) of one body that most of its frames (T, n) agree on, if some are outliers: else
    None.

    The frame is taken that leaves least in all but the worst three tenths of the others. A marker
    may be off it by `suspect` times the root of that, or by the share `least` of the size.
    Frames in which one is farther off are corrected, and the shape is the mean of all. Also returns
    the fits of the frames to it, and what was corrected.
    """
    seen = ~np.isnan(points)
    count = seen.sum(axis=-1)
    full = points[count == count.max()]
    shared = (seen & ~np.isnan(full)[:, None]).astype(float)
    every = fit_pose(np.broadcast_to(points, shared.shape), full[:, None], shared)
    left = tame_part(mean_square(every.residual, every.freedom)[0])
    best = int(np.where(np.isnan(left), np.inf, left).argmin())
    shape = full[best] - full[best, ~np.isnan(full[best])].mean()
    size = np.abs(shape[~np.isnan(shape)]).max()
    limit = max(suspect * np.sqrt(left[best]), least * size)
    off = every.residual[best]
    worst = np.where(np.isnan(off), 0.0, np.abs(off)).max(axis=-1)
    if worst.max() <= _SPOILS * limit:
        return None
    points, corrected = points.copy(), Counter[str]()
    for frame in np.flatnonzero(worst > limit):
        points[frame], what, which = correct_swaps(points[frame], shape, shared[best, frame], limit)
        corrected[what] += len(which)
    weights = (~np.isnan(points) & ~np.isnan(shape)).astype(float)
    fits = fit_pose(points, np.broadcast_to(shape, points.shape), weights)
    fitted = ~np.isnan(fits.residual)
    off = fits.residual.sum(axis=0, where=fitted) / np.maximum(fitted.sum(axis=0), 1)
    shape = np.where(np.isnan(shape), 0.0, shape + off)
    return shape, fit_pose(points, np.broadcast_to(shape, points.shape), weights), corrected


def _best(
    points: Complex,
    shape: Complex,
    weights: Real,
    limit: float = 0.0,
    angle: float = np.nan,
    erring: Real | float = 1.0,
) -> tuple[int, float]:
    """
    Which row (m, n) fits the shape best, by its worst marker, and how far off that is.

    Over how many times as far as others a marker may be off, if `erring` says so.

    One near the expected `angle` goes before the others, if its markers are off by no more than
    the `limit`, m.
    """
    fit = fit_pose(points, np.broadcast_to(shape, points.shape), weights)
    residual = np.abs(fit.residual) / erring
    worst = np.where(np.isnan(residual), 0.0, residual).max(axis=-1)
    worst = np.where(np.isnan(residual).all(axis=-1), np.inf, worst)
    with np.errstate(invalid='ignore'):
        near = (np.cos(fit.angle - angle) > np.cos(_NEAR)) & (worst <= limit)
    best = int(np.where(near | ~near.any(), worst, np.inf).argmin())
    return best, float(worst[best])
