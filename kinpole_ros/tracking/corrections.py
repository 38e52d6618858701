"""
Markers that do not fit their body: left out, or put back where two were exchanged.

Only frames in which the rigid fit leaves unusual residuals, or in which a body seems to jump by
half a turn, come here. So the corrections that are tried need not be fast.
"""

from collections import Counter
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import fit_pose
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.identity import find_candidates, fit_points
from kinpole_ros.tracking.rejection import MAX_SQUARE_RATIO, SPOILING_LIMITS
from kinpole_ros.tracking.statistics import bulk_maximum, mean_square
from kinpole_ros.tracking.thresholds import MIN_SAMPLES, RECENT_FRAMES

EXCHANGED = 'markers_exchanged'
LEFT_OUT = 'markers_left_out'
MIRRORED = 'markers_mirrored'
DROPPED = 'markers_of_misfits'

# rad. An exchange of markers that turns the body farther from its prediction comes last: any two
# markers of an equilateral triangle may be exchanged, and it fits.
_NEAR_ANGLE = 0.25 * np.pi
# Markers may be exchanged if a body is this far, rad, from its predicted angle, while it turns by
# less than the second angle, rad per frame.
_REVERSED, _SLOW_STEP = 0.75 * np.pi, 0.25 * np.pi
_NOWHERE = complex(np.nan, np.nan)


class Correction(NamedTuple):
    """
    The markers (n,) of one body as corrected, complex, m, NaN where left out.

    `order` (n,) says which of the given markers is in each slot now, and `counts` how many were
    corrected in which way.
    """

    points: Complex
    order: np.ndarray
    counts: Counter[str]


def correct_frame(
    bodies: Bodies, history: History, markers: Complex, odd: np.ndarray, counts: Counter[str]
) -> Complex:
    """
    Correct the markers of the bodies of one frame that do not fit.

    Exchanged markers are put into their slots, and the following frames use the same order. Markers
    that do not fit are left out. A body that cannot be corrected has no pose.

    Parameters
    ----------
    bodies, history : Bodies, History
        What is known; the order of exchanged markers is updated in place.
    markers : (B, n) complex
        Markers in the plane, m, NaN for those not seen; put into their slots in place.
    odd : (B,) bool
        Bodies that do not fit.
    counts : Counter
        Numbers of corrected markers by kind, updated.

    Returns
    -------
    (B, n) complex
        The same, with NaN for those left out.

    """
    fitted = markers.copy()
    for b in np.flatnonzero(odd).tolist():
        angles = history['angle'][-2 * MIN_SAMPLES :, b]
        markers[b] = _correct_body(bodies, angles, fitted, markers[b].copy(), b, counts)
    return fitted


def _correct_body(
    bodies: Bodies, angles: Real, markers: Complex, original: Complex, b: int, counts: Counter[str]
) -> Complex:
    """Correct the markers of one body in place; return the original ones in their new order."""
    shape = bodies.shape[b]
    weights = np.where(np.isnan(markers[b]), 0.0, bodies.fitting.weights[b])
    predicted, is_slow = _predict_angle(angles)
    angle = fit_pose(markers[b], shape, weights).angle
    order = np.arange(bodies.width)
    is_reversed = is_slow and np.cos(angle - predicted) < np.cos(_REVERSED)
    if is_reversed and bodies.fitting.limit[b] ** 2 < bodies.fitting.spread[b]:
        turned = half_turn_order(shape, weights, float(bodies.fitting.limit[b]))
        if turned is not None:
            order, markers[b] = turned, markers[b, turned]
    residual = np.abs(fit_pose(markers[b], shape, weights).residual)
    if bodies.fitting.mature[b] and (residual > np.sqrt(bodies.fitting.largest[b])).any():
        noise_ratio = np.sqrt(bodies.relative[b])
        limit = float(bodies.fitting.limit[b])
        correction = correct_markers(
            markers[b], shape, bodies.fitting.weights[b], limit, predicted, noise_ratio
        )
        markers[b], order = correction.points, order[correction.order]
        fit = fit_pose(markers[b], shape, np.where(np.isnan(markers[b]), 0, weights))
        square = mean_square(fit.residual / noise_ratio, fit.freedom)[0]
        if square > MAX_SQUARE_RATIO * bodies.misfit[b]:
            # Where one marker is wrong another may be, by less than makes it an outlier.
            markers[b] = np.nan
        counts.update({kind: n for kind, n in correction.counts.items() if kind != EXCHANGED})
    if (order != np.arange(bodies.width)).any():
        bodies.reorder(b, order)
    return original[order]


def _predict_angle(angles: Real) -> tuple[float, bool]:
    """The angle of a body in the frame after `angles` (N,), and whether it turned slowly."""
    seen = np.flatnonzero(np.isfinite(angles[-RECENT_FRAMES:]))
    seen += max(len(angles) - RECENT_FRAMES, 0)
    if not len(seen):
        return np.nan, False
    last = int(seen[-1])
    predicted = float(angles[last])
    if len(seen) > 1:
        step = _wrap(angles[last] - angles[seen[-2]]) / (last - seen[-2])
        predicted += step * (len(angles) - last)
    steps = np.abs(_wrap(np.diff(angles)))
    is_slow = np.isfinite(steps).sum() >= MIN_SAMPLES // 2 and not (steps > _SLOW_STEP).any()
    return predicted, bool(is_slow and np.abs(predicted - angles[last]) < _SLOW_STEP)


def _wrap(angle: Real | float) -> Real:
    """Angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def correct_markers(
    points: Complex,
    shape: Complex,
    weights: Real,
    limit: float,
    angle: float = np.nan,
    noise_ratio: Real | float = 1.0,
) -> Correction:
    """
    Correct the markers of one body that do not fit its shape.

    Tries, in this order, to permute the markers, to leave one out, to permute all but one, and to
    leave two out. The first kind with all residuals within the limit is taken, at its best. A body
    that none of these corrects, or that fits mirrored, is left out.

    Parameters
    ----------
    points, shape : (n,) complex
        Markers in the plane, NaN where hidden, and their slots in the frame of the body, m.
    weights : (n,) float
        Weights of the slots, 0 for a marker whose place on the body is not known.
    limit : float
        Largest residual of a marker, m.
    angle : float
        Predicted angle of the body, rad; NaN if unknown.
    noise_ratio : (n,) float
        Standard deviation of each marker over that of the others, a factor of the limit.

    Returns
    -------
    Correction
        The corrected markers.

    """
    slots = np.arange(len(points))
    seen = np.flatnonzero((weights > 0) & ~np.isnan(points))
    in_order = np.where(np.isin(slots, seen), slots, -1)
    learned = np.where(weights > 0, shape, _NOWHERE)

    def without(count: int) -> list[np.ndarray]:
        return [np.where(np.isin(slots, out), -1, in_order) for out in combinations(seen, count)]

    best_of = partial(_best_of, points, seen, shape, weights, limit, angle, noise_ratio)
    if len(seen) > 2:
        orders = find_candidates(points, seen, learned, limit).indices
        full = _complete_orders(orders, points, seen, learned, limit * noise_ratio)
        if correction := best_of(full):
            return correction
        if _fits_mirrored(points, shape, weights, in_order, limit, noise_ratio):
            return _leave_out_body(points, seen, MIRRORED)
        correction = best_of(without(1))
        if correction is None and len(seen) > 3:
            correction = best_of(orders[(orders >= 0).sum(axis=1) == len(seen) - 1])
        # Nothing would tell whether two remaining markers are right.
        if correction is None and len(seen) > 4:
            correction = best_of(without(2))
        if correction is not None:
            return correction
    return _leave_out_body(points, seen, DROPPED)


def _best_of(
    points: Complex,
    seen: np.ndarray,
    shape: Complex,
    weights: Real,
    limit: float,
    angle: float,
    noise_ratio: Real | float,
    orders: np.ndarray | list[np.ndarray],
) -> Correction | None:
    """Return the markers in the best of the orders (m, n), -1 for none; None if none fits."""
    if not len(orders):
        return None
    rows = np.where(np.array(orders) < 0, _NOWHERE, points[orders])
    used = np.where(np.isnan(rows), 0.0, weights)
    best, worst = _best_fit(rows, shape, used, limit, angle, noise_ratio)
    return _apply_order(points, seen, orders[best]) if worst <= limit else None


def _fits_mirrored(
    points: Complex,
    shape: Complex,
    weights: Real,
    in_order: np.ndarray,
    limit: float,
    noise_ratio: Real | float,
) -> bool:
    """Whether the markers seen, `in_order` (n,) with -1 for the others, fit the mirrored body."""
    mirrored = np.where(in_order < 0, _NOWHERE, points.conj())[None]
    used = np.where(in_order < 0, 0.0, weights)
    return bool(_best_fit(mirrored, shape, used, noise_ratio=noise_ratio)[1] <= limit)


def _leave_out_body(points: Complex, seen: np.ndarray, kind: str) -> Correction:
    """Leave out all markers of a body, of which some are `seen`."""
    nothing = np.full_like(points, _NOWHERE)
    return Correction(nothing, np.arange(len(points)), Counter({kind: len(seen)}))


def _apply_order(points: Complex, seen: np.ndarray, order: np.ndarray) -> Correction:
    """The markers in this order (n,), -1 for none."""
    slots = np.arange(len(order))
    placed = np.where(order < 0, _NOWHERE, points[order])
    moved = np.count_nonzero((order >= 0) & (order != slots))
    # Hidden markers, and those left out, stay in their slots or take the empty ones.
    unplaced = np.setdiff1d(slots, order)
    stays = (order < 0) & np.isin(slots, unplaced)
    order = np.where(stays, slots, order)
    order[order < 0] = np.setdiff1d(unplaced, slots[stays])
    counts = Counter({EXCHANGED: moved, LEFT_OUT: len(seen) - np.count_nonzero(~np.isnan(placed))})
    return Correction(placed, order, +counts)


def _complete_orders(
    orders: np.ndarray, points: Complex, seen: np.ndarray, shape: Complex, limits: Real
) -> np.ndarray:
    """
    Orders (m, n) that have all markers that are `seen`.

    A marker with more noise than the others, of its own limit (n,), m, goes to the nearest free
    slot.
    """
    orders = orders.copy()
    for order in orders:
        missing = np.setdiff1d(seen, order)
        if not len(missing):
            continue
        position, turn, _ = fit_points(points, np.nan_to_num(shape), order)
        for marker in missing:
            distance = np.abs(position + turn * shape - points[marker])
            distance = np.where((order < 0) & (distance <= limits), distance, np.inf)
            if np.isfinite(distance).any():
                order[distance.argmin()] = marker
    return orders[(orders >= 0).sum(axis=1) == len(seen)]


def half_turn_order(shape: Complex, weights: Real, limit: float) -> np.ndarray | None:
    """
    Return the order of the markers (n,) after half a turn about their mean.

    None if the shape (n,), m, has no such symmetry: if a marker with a weight would be farther than
    `limit`, m, from the slot of another.
    """
    seen = np.flatnonzero(weights > 0)
    arms = shape[seen] - shape[seen].mean()
    distance = np.abs(arms[:, None] + arms)
    opposite = distance.argmin(axis=1)
    is_symmetric = (opposite[opposite] == np.arange(len(seen))).all()
    if distance.min(axis=1).max() > limit or not is_symmetric:
        return None
    order = np.arange(len(shape))
    order[seen] = seen[opposite]
    return order


def consensus_shape(
    points: Complex, sigmas: float, least: float
) -> tuple[Complex, Complex, Counter[str]] | None:
    """
    Find the shape of one body that most of its frames agree on, if some have outliers.

    The frame is taken as the shape that leaves the smallest residuals in all but the worst three
    tenths of the others. Frames with a marker beyond the limit are corrected, and the shape becomes
    the mean of all.

    Parameters
    ----------
    points : (T, n) complex
        Markers, m, NaN for none.
    sigmas, least : float
        Limit of a marker: so many times the rms residual, or this share of the size if larger.

    Returns
    -------
    shape : (n,) complex
        The shape, m.
    points : (T, n) complex
        The corrected markers, m.
    counts : Counter
        Numbers of corrected markers by kind. The result is None without outliers.

    """
    seen = ~np.isnan(points)
    count = seen.sum(axis=-1)
    full = points[count == count.max()]
    shared = (seen & ~np.isnan(full)[:, None]).astype(float)
    fits = fit_pose(np.broadcast_to(points, shared.shape), full[:, None], shared)
    squares = bulk_maximum(mean_square(fits.residual, fits.freedom)[0])
    best = int(np.where(np.isnan(squares), np.inf, squares).argmin())
    shape = full[best] - full[best, ~np.isnan(full[best])].mean()
    size = np.abs(shape[~np.isnan(shape)]).max()
    limit = max(sigmas * np.sqrt(squares[best]), least * size)
    residual = np.abs(fits.residual[best])
    worst = np.where(np.isnan(residual), 0.0, residual).max(axis=-1)
    if worst.max() <= SPOILING_LIMITS * limit:
        return None
    points, counts = points.copy(), Counter[str]()
    angles = np.where(worst > limit, np.nan, fits.angle[best])
    for frame in np.flatnonzero(worst > limit):
        weights = (~np.isnan(shape)).astype(float)
        is_after = np.isfinite(angles[:frame]).any()
        predicted, _ = _predict_angle(angles[:frame] if is_after else angles[:frame:-1])
        correction = correct_markers(points[frame], shape, weights, limit, predicted)
        points[frame] = correction.points
        counts.update(correction.counts)
    weights = (~np.isnan(points) & ~np.isnan(shape)).astype(float)
    residuals = fit_pose(points, np.broadcast_to(shape, points.shape), weights).residual
    fitted = ~np.isnan(residuals)
    mean = residuals.sum(axis=0, where=fitted) / np.maximum(fitted.sum(axis=0), 1)
    return np.where(np.isnan(shape), 0.0, shape + mean), points, counts


def _best_fit(
    points: Complex,
    shape: Complex,
    weights: Real,
    limit: float = 0.0,
    angle: float = np.nan,
    noise_ratio: Real | float = 1.0,
) -> tuple[int, float]:
    """
    The row (m, n) that fits the shape best, and its largest residual, m, over the noise ratio.

    A row near the predicted angle goes first, if its residuals are within the limit, m. Of rows
    with two markers it is the nearest, since a wrong marker may be as far from another as its slot.
    """
    fit = fit_pose(points, np.broadcast_to(shape, points.shape), weights)
    residual = np.abs(fit.residual) / noise_ratio
    worst = np.where(np.isnan(residual), 0.0, residual).max(axis=-1)
    worst = np.where(np.isnan(residual).all(axis=-1), np.inf, worst)
    with np.errstate(invalid='ignore'):
        near = (np.cos(fit.angle - angle) > np.cos(_NEAR_ANGLE)) & (worst <= limit)
    rank = worst
    if near.any() and np.count_nonzero(weights, axis=-1).max() == 2:
        rank = 1 - np.cos(fit.angle - angle)
    best = int(np.where(near | ~near.any(), rank, np.inf).argmin())
    return best, float(worst[best])
