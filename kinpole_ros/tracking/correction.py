"""
Correct the markers of a frame that is not usual: names first, then markers that do not fit.

A tracker may exchange two markers of a body, or see one where it is not. A body that does not fit
its shape is fitted with its markers permuted, or without the fewest of them.
"""

from collections import Counter
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import fit_pose
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.candidates import find_candidates, fit_points
from kinpole_ros.tracking.placed_frames import PlacedFrames
from kinpole_ros.tracking.rejection import (
    DROPPED,
    EXCHANGED,
    LEFT_OUT,
    MAX_SEARCH_INTERVAL,
    MAX_SQUARE_RATIO,
    MIRRORED,
    NAME_DOUBTFUL,
    NEAR_ANGLE,
    NO_MARKER_REPEATS,
    ODD,
    REVERSED,
    SLOW_STEP,
)
from kinpole_ros.tracking.state import NameSearch, State, put_bodies, restart_bodies
from kinpole_ros.tracking.statistics import mean_square
from kinpole_ros.tracking.thresholds import MIN_SAMPLES, RECENT_FRAMES

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


def correct_next(state: State, placed: PlacedFrames, k: int) -> Complex:
    """Return the markers (B, n) that frame `k` is fitted to, NaN for those left out."""
    bodies, counts = state.bodies, state.totals.counts
    restarts, is_arranged = state.matcher.arrange(placed, k, counts)
    if restarts:
        bodies = restart_bodies(state, bodies, np.ones(bodies.count, bool))
        put_bodies(state, bodies)
    markers, heights = placed.points[k], placed.heights[k]
    if len(bodies.placement.unseen):
        # Not from a marker that repeats: see `forget_held_markers`.
        last = state.history['markers'][-2:]
        may_be_held = (bodies.repetition == NO_MARKER_REPEATS)[:, None]
        is_held = may_be_held & (last == markers).all(axis=0)
        bodies = bodies.begin(np.where(is_held, complex(np.nan, np.nan), markers))
        put_bodies(state, bodies)
    if bodies.placement.incomplete and (bodies.placement.unknown_slots & ~np.isnan(markers)).any():
        # New markers are learned as soon as they are seen.
        state.next_update = min(state.next_update, state.frame_count + 1)
    unusual = state.step.try_next(markers)
    is_name_doubtful = unusual & NAME_DOUBTFUL or len(state.assignment.layout_of(placed).unassigned)
    if is_name_doubtful and _correct_names(state, placed, k, unusual, is_arranged):
        unusual = state.step.try_next(markers)
    if not unusual & ODD:
        return markers
    odd = (state.step.tracks['unusual'] & ODD) > 0
    end = state.history.end
    rows = slice(max(state.history.first, end - 2 * MIN_SAMPLES), end)
    angles = state.history.columns['angle'][rows]
    fitted, order, corrected = correct_frame(bodies, angles, markers, odd)
    counts.update(corrected)
    if (order != np.arange(order.shape[1])).any():
        markers[...] = np.take_along_axis(markers, order, axis=1)
        heights[...] = np.take_along_axis(heights, order, axis=1)
        state.assignment.exchange(placed, k, order)
    return fitted


def _correct_names(
    state: State, placed: PlacedFrames, k: int, unusual: int, is_arranged: bool
) -> bool:
    """Correct wrong names of markers in the frame; return whether there were any."""
    if not unusual & NAME_DOUBTFUL:
        markers = placed.points[k]
        unseen = np.isnan(markers)
        if is_arranged or not unseen.any():
            return False
        if not state.matcher.is_doubtful(placed, k, state.bodies.fit(markers), unseen):
            return False
    # Bodies that are not rigid are doubtful in every frame, and a search takes long.
    if state.frame_count < state.name_search.due:
        return False
    # A frame that was matched by shape has no names.
    corrected = not is_arranged and state.matcher.correct_names(placed, k, state.totals.counts)
    futile = 0 if corrected else state.name_search.futile + 1
    pause = min(2 ** max(futile - 1, 0), MAX_SEARCH_INTERVAL)
    state.name_search = NameSearch(futile, state.frame_count + pause)
    return corrected


def correct_frame(
    bodies: Bodies, angles: Real, markers: Complex, odd: np.ndarray
) -> tuple[Complex, np.ndarray, Counter[str]]:
    """
    Correct the markers of the bodies of one frame that do not fit.

    Exchanged markers are put into their slots. Markers that do not fit are left out. A body that
    cannot be corrected has no pose.

    Parameters
    ----------
    bodies : Bodies
        What is known.
    angles : (N, B) float
        Angles of the bodies in the frames before, rad, NaN for a body that was not seen.
    markers : (B, n) complex
        Markers in the plane, m, NaN for those not seen.
    odd : (B,) bool
        Bodies that do not fit.

    Returns
    -------
    fitted : (B, n) complex
        The markers in their slots, NaN for those left out.
    order : (B, n) int
        Which of the given markers is in each slot.
    counts : Counter
        Numbers of corrected markers by kind.

    """
    fitted, counts = markers.copy(), Counter[str]()
    order = np.tile(np.arange(markers.shape[1]), (len(markers), 1))
    for b in np.flatnonzero(odd).tolist():
        fitted[b], order[b], of_body = _correct_body(bodies, angles[:, b], markers[b], b)
        counts.update(of_body)
    return fitted, order, counts


def _correct_body(bodies: Bodies, angles: Real, markers: Complex, b: int) -> Correction:
    """Correct the markers (n,) of one body."""
    fitting, placement, shape = bodies.fitting, bodies.placement, bodies.shape[b]
    limit = float(fitting.limit[b])
    weights = np.where(np.isnan(markers), 0.0, placement.weights[b])
    predicted, is_slow = predict_angle(angles)
    fit = fit_pose(markers, shape, weights)
    order, counts = np.arange(len(markers)), Counter[str]()
    is_reversed = is_slow and np.cos(fit.angle - predicted) < np.cos(REVERSED)
    if is_reversed and limit**2 < placement.spread[b]:
        turned = half_turn_order(shape, weights, limit)
        if turned is not None:
            order, markers = turned, markers[turned]
            fit = fit_pose(markers, shape, weights)
    if not (fitting.mature[b] and (np.abs(fit.residual) > np.sqrt(fitting.largest[b])).any()):
        return Correction(markers, order, counts)
    noise_ratio = np.sqrt(bodies.relative[b])
    found = correct_markers(markers, shape, placement.weights[b], limit, predicted, noise_ratio)
    points, counts = found.points, found.counts
    fit = fit_pose(points, shape, np.where(np.isnan(points), 0, weights))
    square = mean_square(fit.residual / noise_ratio, fit.freedom)[0]
    if square > MAX_SQUARE_RATIO * bodies.misfit[b]:
        # Where one marker is wrong another may be, by less than makes it an outlier.
        counts[DROPPED] += int(np.count_nonzero(~np.isnan(points)))
        points = np.full_like(points, _NOWHERE)
    # Exchanged markers are counted in every frame that has them: see `count_exchanged`.
    del counts[EXCHANGED]
    return Correction(points, order[found.order], counts)


def predict_angle(angles: Real) -> tuple[float, bool]:
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
    is_slow = np.isfinite(steps).sum() >= MIN_SAMPLES // 2 and not (steps > SLOW_STEP).any()
    return predicted, bool(is_slow and np.abs(predicted - angles[last]) < SLOW_STEP)


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
    moved = int(np.count_nonzero((order >= 0) & (order != slots)))
    # Hidden markers, and those left out, stay in their slots or take the empty ones.
    unplaced = np.setdiff1d(slots, order)
    stays = (order < 0) & np.isin(slots, unplaced)
    order = np.where(stays, slots, order)
    order[order < 0] = np.setdiff1d(unplaced, slots[stays])
    counts = Counter(
        {EXCHANGED: moved, LEFT_OUT: len(seen) - int(np.count_nonzero(~np.isnan(placed)))}
    )
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
    positions, turns, _ = fit_points(points, np.nan_to_num(shape), orders)
    for order, position, turn in zip(orders, positions, turns, strict=True):
        for marker in np.setdiff1d(seen, order):
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
        near = (np.cos(fit.angle - angle) > np.cos(NEAR_ANGLE)) & (worst <= limit)
    rank = worst
    if near.any() and np.count_nonzero(weights, axis=-1).max() == 2:
        rank = 1 - np.cos(fit.angle - angle)
    best = int(np.where(near | ~near.any(), rank, np.inf).argmin())
    return best, float(worst[best])
