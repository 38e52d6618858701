"""
Correct the markers of a frame that is not usual: names first, then markers that do not fit.

A tracker may exchange two markers of a body, or see one where it is not. Of all ways to place a
body that does not fit on its markers, the likeliest is taken.
"""

from collections import Counter
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import fit_pose
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.candidates import find_candidates, fit_points
from kinpole_ros.tracking.identity import Prediction, predict_poses
from kinpole_ros.tracking.placed_frames import PlacedFrames
from kinpole_ros.tracking.rejection import (
    DROPPED,
    EXCHANGE_NATS,
    EXCHANGED,
    LEFT_OUT,
    MAX_SEARCH_INTERVAL,
    MAX_SQUARE_RATIO,
    MIRROR_NATS,
    MIRRORED,
    NAME_DOUBTFUL,
    NO_MARKER_REPEATS,
    ODD,
    OUTLIER_NATS,
)
from kinpole_ros.tracking.state import NameSearch, State, put_bodies, restart_bodies
from kinpole_ros.tracking.statistics import mean_square
from kinpole_ros.tracking.thresholds import MIN_SAMPLES

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
    stamp = placed.frames.stamps[k]
    predicted = predict_poses(*state.history.poses_before(stamp, 2 * MIN_SAMPLES))
    fitted, order, corrected = correct_frame(bodies, predicted, markers, odd)
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
    bodies: Bodies, predicted: Prediction, markers: Complex, odd: np.ndarray
) -> tuple[Complex, np.ndarray, Counter[str]]:
    """
    Correct the markers of the bodies of one frame that do not fit.

    Exchanged markers are put into their slots. Markers that do not fit are left out. A body that
    cannot be corrected has no pose.

    Parameters
    ----------
    bodies : Bodies
        What is known.
    predicted : Prediction
        The poses that are expected.
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
        fitted[b], order[b], of_body = _correct_body(bodies, predicted, markers[b], b)
        counts.update(of_body)
    return fitted, order, counts


def _correct_body(bodies: Bodies, predicted: Prediction, markers: Complex, b: int) -> Correction:
    """Correct the markers (n,) of one body."""
    fitting, weights, shape = bodies.fitting, bodies.placement.weights[b], bodies.shape[b]
    limits = fitting.limit[b] * np.sqrt(bodies.relative[b])
    points, order, counts = correct_markers(markers, shape, weights, limits, predicted, b)
    if not (fitting.mature[b] and counts):
        # Nothing is left out while residuals are not known.
        return Correction(markers[order], order, Counter())
    fit = fit_pose(points, shape, np.where(np.isnan(points), 0.0, weights))
    square = mean_square(fit.residual / np.sqrt(bodies.relative[b]), fit.freedom)[0]
    if square > MAX_SQUARE_RATIO * bodies.misfit[b]:
        # Where one marker is wrong another may be, by less than makes it an outlier.
        counts[DROPPED] += int(np.count_nonzero(~np.isnan(points)))
        points = np.full_like(points, _NOWHERE)
    # Exchanged markers are counted in every frame that has them: see `count_exchanged`.
    del counts[EXCHANGED]
    return Correction(points, order, counts)


def correct_markers(
    points: Complex,
    shape: Complex,
    weights: Real,
    limits: Real,
    predicted: Prediction,
    b: int = 0,
) -> Correction:
    """
    Correct the markers of one body that do not fit its shape.

    Each way to place the body on them costs what makes it unlikely, in nats: residuals, markers
    that are left out or exchanged, a mirrored body, a pose that was not expected. The least cost
    wins. A body that none of them places, or that is mirrored, is left out.

    Parameters
    ----------
    points, shape : (n,) complex
        Markers in the plane, NaN where hidden, and their slots in the frame of the body, m.
    weights : (n,) float
        Weights of the slots, 0 for a marker whose place on the body is not known.
    limits : (n,) float
        Residuals of outliers, m.
    predicted, b : Prediction, int
        The poses that are expected, and which of them is of this body.

    Returns
    -------
    Correction
        The corrected markers.

    """
    slots = np.arange(len(points))
    seen = np.flatnonzero((weights > 0) & ~np.isnan(points))
    in_order = np.where(np.isin(slots, seen), slots, -1)
    without_one = np.where(slots == seen[:, None], -1, in_order)
    others = _orders(points, seen, shape, weights, limits)
    orders = np.vstack((in_order, in_order, without_one, others))
    # The second row is the mirrored body. Two markers are their own mirror image.
    is_mirrored = np.arange(len(orders)) == 1
    rows = np.where(orders < 0, _NOWHERE, points[orders])
    rows[1] = rows[1].conj()
    fit = fit_pose(rows, np.broadcast_to(shape, rows.shape), np.where(np.isnan(rows), 0.0, weights))
    number = (orders >= 0).sum(axis=1)
    has_moved = ((orders >= 0) & (orders != slots)).any(axis=1)
    costs = np.nansum(np.abs(fit.residual / limits) ** 2, axis=1) * OUTLIER_NATS
    costs += OUTLIER_NATS * (len(seen) - number) + EXCHANGE_NATS * has_moved
    surprise = predicted.costs(b, fit.angle, fit.position, limits.min())
    costs += np.where(is_mirrored, MIRROR_NATS, surprise)
    # Two of more markers are as far apart as others by chance.
    credible = (2 * number > len(seen)) & (~has_moved | (number > 2) | (number == len(seen)))
    credible &= np.isfinite(fit.angle) & ~(is_mirrored & (len(seen) == 2))
    best = int(np.where(credible, costs, np.inf).argmin())
    # If all markers are anywhere, there is no pose, which is worth one of them.
    if not (credible[best] and costs[best] < OUTLIER_NATS * (len(seen) - 1)):
        return _leave_out_body(points, seen, DROPPED)
    if is_mirrored[best]:
        return _leave_out_body(points, seen, MIRRORED)
    return _apply_order(points, seen, orders[best])


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


def _orders(
    points: Complex, seen: np.ndarray, shape: Complex, weights: Real, limits: Real
) -> np.ndarray:
    """
    Return the orders (m, n) in which markers that are `seen` fit the shape, -1 for those left out.

    A marker with more noise than the others goes to the nearest free slot within its limit.
    """
    learned = np.where(weights > 0, shape, _NOWHERE)
    orders = find_candidates(points, seen, learned, limits.min()).indices
    positions, turns, _ = fit_points(points, np.nan_to_num(learned), orders)
    for order, position, turn in zip(orders, positions, turns, strict=True):
        for marker in np.setdiff1d(seen, order):
            distance = np.abs(position + turn * learned - points[marker])
            distance = np.where((order < 0) & (distance <= limits), distance, np.inf)
            if np.isfinite(distance).any():
                order[distance.argmin()] = marker
    return orders
