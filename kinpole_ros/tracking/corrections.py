"""
Markers that are not where the body can have them: left out, or put back where two were exchanged.

Also which of the first frames of a body tell of its shape, when some of them are outliers.

Looked at only where a rigid fit leaves far more than it does as a rule, or a body seems to jump by
half a turn, so what is tried here need not be fast.
"""

from collections import Counter
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import fit_pose
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.identity import find_candidates, fit_points
from kinpole_ros.tracking.statistics import mean_square, tame_part

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
_NOWHERE = complex(np.nan, np.nan)


class Correction(NamedTuple):
    """
    The markers (n,) of one body as corrected, complex, m, NaN where left out.

    `order` (n,) says which of the given markers is at each place now, and `counts` how many were
    corrected in which way.
    """

    points: Complex
    order: np.ndarray
    counts: Counter[str]


def correct_markers(
    points: Complex,
    shape: Complex,
    weights: Real,
    limit: float,
    angle: float = np.nan,
    erring: Real | float = 1.0,
) -> Correction:
    """
    Correct the markers of one body that do not fit its shape.

    Tries, in this order, to permute the markers, to leave one out, to permute all but one, and to
    leave two out. The first kind that brings the remaining markers within the limit is taken, at
    its best. A body that none of these corrects, or that fits mirrored, is left out as a whole.

    Parameters
    ----------
    points, shape : (n,) complex
        Markers, NaN where hidden, and their places in the frame of the body, m.
    weights : (n,) float
        Weights of the places, 0 where the place of a marker is not known.
    limit : float
        Largest residual of a marker, m.
    angle : float
        Predicted angle of the body, rad; NaN if unknown.
    erring : (n,) float
        Factor of the limit by place, for a marker with more noise than the others.

    Returns
    -------
    Correction
        The corrected markers.

    """
    own = np.arange(len(points))
    seen = np.flatnonzero((weights > 0) & ~np.isnan(points))
    whole = np.where(np.isin(own, seen), own, -1)
    known = np.where(weights > 0, shape, _NOWHERE)

    def leave_out(count: int) -> list[np.ndarray]:
        return [np.where(np.isin(own, out), -1, whole) for out in combinations(seen, count)]

    def corrected(orders: np.ndarray | list[np.ndarray]) -> Correction | None:
        """The markers at the best of some orders (m, n), -1 for nothing; None if none fits."""
        if not len(orders):
            return None
        rows = np.where(np.array(orders) < 0, _NOWHERE, points[orders])
        there = np.where(np.isnan(rows), 0.0, weights)
        best, worst = _best(rows, shape, there, limit, angle, erring)
        return _moved(points, seen, orders[best]) if worst <= limit else None

    if len(seen) > 2:
        ways = find_candidates(points, seen, known, limit).indices
        found = corrected(_completed(ways, points, seen, known, limit * erring))
        if found is not None:
            return found
        mirrored = np.where(whole < 0, _NOWHERE, points.conj())[None]
        if _best(mirrored, shape, np.where(whole < 0, 0.0, weights), erring=erring)[1] <= limit:
            return _nothing_of(points, seen, MIRRORED)
        found = corrected(leave_out(1))
        if found is None and len(seen) > 3:
            found = corrected(ways[(ways >= 0).sum(axis=1) == len(seen) - 1])
        # Of two markers that remain nothing would tell whether they are right.
        if found is None and len(seen) > 4:
            found = corrected(leave_out(2))
        if found is not None:
            return found
    return _nothing_of(points, seen, DROPPED)


def _nothing_of(points: Complex, seen: np.ndarray, kind: str) -> Correction:
    """A body that is left out as a whole, with all markers `seen`."""
    nothing = np.full_like(points, _NOWHERE)
    return Correction(nothing, np.arange(len(points)), Counter({kind: len(seen)}))


def _moved(points: Complex, seen: np.ndarray, order: np.ndarray) -> Correction:
    """The markers in this order (n,), -1 where nothing is."""
    own = np.arange(len(order))
    placed = np.where(order < 0, _NOWHERE, points[order])
    moved = np.count_nonzero((order >= 0) & (order != own))
    # Markers that are hidden or left out stay where they are, or take the empty places.
    left = np.setdiff1d(own, order)
    stays = (order < 0) & np.isin(own, left)
    order = np.where(stays, own, order)
    order[order < 0] = np.setdiff1d(left, own[stays])
    counts = Counter({EXCHANGED: moved, LEFT_OUT: len(seen) - np.count_nonzero(~np.isnan(placed))})
    return Correction(placed, order, +counts)


def _completed(
    ways: np.ndarray, points: Complex, seen: np.ndarray, known: Complex, most: Real
) -> np.ndarray:
    """
    The `ways` (m, n) to place markers that hold all that are `seen`.

    A marker that may err by more than the others, as `most` (n,) says, m, goes to the nearest place
    left.
    """
    ways = ways.copy()
    for way in ways:
        left = np.setdiff1d(seen, way)
        if not len(left):
            continue
        position, turn, _ = fit_points(points, np.nan_to_num(known), way)
        for marker in left:
            off = np.abs(position + turn * known - points[marker])
            off = np.where((way < 0) & (off <= most), off, np.inf)
            if np.isfinite(off).any():
                way[off.argmin()] = marker
    return ways[(ways >= 0).sum(axis=1) == len(seen)]


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
) -> tuple[Complex, Complex, Counter[str]] | None:
    """
    The shape (n,) of one body that most of its frames (T, n) agree on, if some are outliers: else
    None.

    The frame is taken that leaves least in all but the worst three tenths of the others. A marker
    may be off it by `suspect` times the root of that, or by the share `least` of the size.
    Frames in which one is farther off are corrected, and the shape is the mean of all. Also returns
    the markers (T, n) as corrected, and what was corrected.
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
        found = correct_markers(points[frame], shape, (~np.isnan(shape)).astype(float), limit)
        points[frame] = found.points
        corrected.update(found.counts)
    weights = (~np.isnan(points) & ~np.isnan(shape)).astype(float)
    fits = fit_pose(points, np.broadcast_to(shape, points.shape), weights)
    fitted = ~np.isnan(fits.residual)
    off = fits.residual.sum(axis=0, where=fitted) / np.maximum(fitted.sum(axis=0), 1)
    shape = np.where(np.isnan(shape), 0.0, shape + off)
    return shape, points, corrected


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
