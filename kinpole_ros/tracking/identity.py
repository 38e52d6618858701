"""
Which point of a frame is which marker of which body, by the shapes of the bodies.

Names of markers may be wrong: a tracker exchanges two markers, gives a marker that comes back
another name, or has no names at all. The distances between the markers of a body stay the same.
Points are first sought near the predicted markers. A body that is not found there is sought
everywhere (see `candidates`). A body that fits in several ways is left out.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.candidates import PAIR_LIMITS, Candidates, find_candidates, fit_points
from kinpole_ros.tracking.frame_counter import MOST_CHARGED_LOSSES
from kinpole_ros.tracking.frame_intervals import LOSS_NATS
from kinpole_ros.tracking.rejection import DISTANCE_RATIO, EXCHANGE_NATS, OUTLIER_NATS
from kinpole_ros.tracking.statistics import median
from kinpole_ros.tracking.thresholds import MIN_DOF, RECENT_FRAMES, ROUNDED

# Degrees of freedom of the errors of predictions: few, since they have impacts among them.
TAIL = 4.0
# nats. Of two ways to place a body neither is taken if their costs differ by less.
LEAD_NATS = 3.0


class Match(NamedTuple):
    """
    The points that are the markers of B bodies.

    `indices` (B, n) are the points of the markers, -1 for none. `position` (B,), complex, m, and
    `turn` (B,), of length 1, are the poses, NaN for a body that is not found. `uncertain` (B,)
    marks bodies that fit equally well in several ways. `variance` (B,), m^2, is that of one
    coordinate of a marker in the best fit, NaN for a body that was not searched for.
    """

    indices: np.ndarray
    position: Complex
    turn: Complex
    uncertain: np.ndarray
    variance: Real


class Prediction(NamedTuple):
    """
    The poses expected of B bodies, if 0, 1... frames before were lost without notice.

    `angle` and `position` (B, L), rad and complex, m, NaN for none, and the standard deviations
    (B,) of the first, infinite if unknown.
    """

    angle: Real
    angle_deviation: Real
    position: Complex
    position_deviation: Real

    def costs(self, b: int, angle: Real, position: Complex, limit: float) -> Real:
        """
        Return how unlikely poses (H,) of a body are, nats: by Student's distribution, as for hits.

        Markers are off by up to `limit`, m.
        """
        if not np.isfinite(self.angle_deviation[b]):
            return np.zeros(len(angle))
        turned = _wrap(angle[:, None] - self.angle[b]) / (self.angle_deviation[b] + ROUNDED)
        moved = np.abs(position[:, None] - self.position[b])
        moved /= self.position_deviation[b] + ROUNDED * limit
        nats = (TAIL + 1) / 2 * np.log1p((turned**2 + moved**2) / TAIL)
        return np.asarray((nats + LOSS_NATS * np.arange(nats.shape[1])).min(axis=1))


def unpredicted(bodies: int) -> Prediction:
    """Return that nothing is known of so many bodies."""
    nothing, unknown = np.full((bodies, 1), np.nan), np.full(bodies, np.inf)
    return Prediction(nothing, unknown, nothing.astype(complex), unknown)


class Expected(NamedTuple):
    """
    What is known of a frame before its points are matched.

    `predicted` are the poses. `named` (B, n) are the points by name, -1 for none, and `fits`
    (B,) the bodies that fit by name.
    `variance`, m^2, is the noise of one coordinate of a marker, infinite while not measured.
    `pins` (B, 2), complex, m, are points of bodies that are pinned to the ground, in the frame of
    the body and in the plane, NaN for a body without; None where no body has one.
    """

    predicted: Prediction
    named: np.ndarray
    fits: np.ndarray
    variance: float = np.inf
    pins: Complex | None = None


def match(points: Complex, shapes: Complex, limit: Real, expected: Expected) -> Match:
    """
    Match points to the markers of bodies.

    Parameters
    ----------
    points : (m,) complex
        Points in the plane, m, NaN for none.
    shapes : (B, n) complex
        Markers in the frames of the bodies, m, NaN for none.
    limit : (B,) float
        Largest residual of a marker, m.
    expected : Expected
        Predictions, names and pins.

    Returns
    -------
    Match
        The points of the markers, and the poses.

    """
    has_marker = ~np.isnan(shapes)
    shape = np.where(has_marker, shapes, 0)
    indices = np.where(expected.fits[:, None] & has_marker, expected.named, -1)
    if len(points):
        near = _near_predictions(points, shape, has_marker & ~expected.fits[:, None], expected)
        indices = np.where(expected.fits[:, None], indices, near)
    position, turn, worst = fit_points(points, shape, indices)
    # Of several markers two agree in one distance only, so `count` alone does not decide: whatever
    # lies near the prediction has to fit as well.
    matched = (worst <= limit) & ((indices >= 0).sum(axis=1) >= 2) & np.isfinite(turn)
    indices[~matched] = -1
    result = Match(
        indices,
        np.where(matched, position, np.nan),
        np.where(matched, turn, np.nan),
        np.zeros(len(shapes), bool),
        np.full(len(shapes), np.nan),
    )
    if matched.any():
        _add_hidden(points, shape, has_marker, limit, result)
    missing = np.flatnonzero(~matched & (has_marker.sum(axis=1) >= 2))
    if len(missing) and len(points):
        _search(points, shapes, missing, limit, expected, result)
        if not result.uncertain.all():
            _add_hidden(points, shape, has_marker, limit, result)
    return result


def _search(
    points: Complex,
    shapes: Complex,
    bodies: np.ndarray,
    limit: Real,
    expected: Expected,
    result: Match,
) -> None:
    """Search for bodies by pairs of points, and write those that are found into the result."""
    free = np.flatnonzero(~np.isnan(points))
    free = free[~np.isin(free, result.indices)]
    on_pins, candidates = {}, {}
    for b in bodies.tolist():
        every_way = find_candidates(points, free, shapes[b], float(limit[b]))
        at_pin = _at_pin(every_way, b, limit[b], expected)
        on_pins[b] = at_pin is not None
        candidates[b] = _likeliest(b, at_pin or every_way, shapes[b], limit[b], expected)
        # Two points of many are always as far apart as two markers.
        likeliest = candidates[b]
        variance = likeliest.variance[likeliest.count > 2].min(initial=np.inf)
        result.variance[b] = variance if np.isfinite(variance) else np.nan
    # Bodies at their pins choose first.
    for first in (True, False):
        taken = result.indices[result.indices >= 0]
        open_ = {
            b: one.at(~np.isin(one.indices, taken).any(axis=1))
            for b, one in candidates.items()
            if on_pins[b] == first
        }
        _assign(open_, result)


def merge_names(found: Match, named: np.ndarray) -> np.ndarray | None:
    """
    Merge a match with the names of the points, which hold for all other bodies.

    Parameters
    ----------
    found : Match
        What the shapes say.
    named : (B, n) int
        Points of the markers by their names, -1 for none.

    Returns
    -------
    (B, n) int or None
        Points of the markers. None where no body has a point with the name of another body's: what
        is wrong within one body is not a matter of names.

    """
    foreign = np.array(
        [
            ((row >= 0) & ~np.isin(row, own)).any()
            for row, own in zip(found.indices, named, strict=True)
        ]
    )
    foreign &= np.isfinite(found.turn)
    if not foreign.any():
        return None
    claimed = found.indices[foreign]
    claimed = claimed[claimed >= 0]
    lost = np.isin(named, claimed)
    indices = np.where(lost, -1, named)
    for b in np.flatnonzero(foreign | (lost.any(axis=1) & np.isfinite(found.turn))):
        # A marker whose place on the body is not known yet keeps its name.
        own = np.where(np.isin(indices[b], found.indices[b]), -1, indices[b])
        indices[b] = np.where(found.indices[b] >= 0, found.indices[b], own)
    return indices


def predict_poses(stamps: np.ndarray, angles: Real, positions: Complex) -> Prediction:
    """
    Predict the poses of B bodies by their last velocities.

    Parameters
    ----------
    stamps : (N + 1,) int64
        Stamps of the frames before, and of the frame to predict, ns.
    angles, positions : (N, B)
        Poses in the frames before, rad and complex, m; NaN where a body was not seen. One that was
        seen once stays where it was.

    Returns
    -------
    Prediction
        The poses; nothing is known of a body that was not seen of late.

    """
    count, seen, steps = angles.shape[1], np.isfinite(angles), np.diff(stamps)
    if not seen.any():
        return unpredicted(count)
    # Late stamps do not change the number of frames.
    frames = np.maximum(np.rint(steps / max(median(steps), 1)), 1)
    last = len(angles) - 1 - seen[::-1].argmax(axis=0)
    age = np.append(frames[::-1].cumsum()[::-1], 0)[last]
    signals = np.concatenate((angles, positions), axis=1)
    speeds = np.diff(signals, axis=0)
    speeds[:, :count] = _wrap(speeds[:, :count].real)
    speed, error = _speeds_of(speeds / frames[:-1, None], seen[1:] & seen[:-1])
    ahead = age[:, None] + np.arange(MOST_CHARGED_LOSSES + 1)
    ahead = np.where((seen.any(axis=0) & (age <= RECENT_FRAMES))[:, None], ahead, np.nan)
    angle_error, position_error = ahead[:, 0] * (ahead[:, 0] + 1) / 2 * error.reshape(2, count)
    return Prediction(
        angles[last, np.arange(count)][:, None] + ahead * speed[:count, None].real,
        angle_error,
        positions[last, np.arange(count)][:, None] + ahead * speed[count:, None],
        position_error,
    )


def _speeds_of(speeds: Complex, seen: np.ndarray) -> tuple[Complex, Real]:
    """
    Return the last speeds (2 B,) of (N, 2 B), 0 for none, and their rms change from frame to frame.

    `seen` (N, B) are those that are known.
    """
    count, width = len(seen), speeds.shape[1]
    if not count:
        return np.zeros(width, complex), np.full(width, np.inf)
    seen = np.concatenate((seen, seen), axis=1)
    last = count - 1 - seen[::-1].argmax(axis=0)
    speed = np.where(seen.any(axis=0), speeds[last, np.arange(width)], 0)
    speeds, both = np.where(seen, speeds, 0), seen[1:] & seen[:-1]
    number = both.sum(axis=0)
    changes = np.where(both, np.diff(speeds, axis=0), 0)
    square = (changes.real**2 + changes.imag**2).sum(axis=0) / np.maximum(number, 1)
    if (number < MIN_DOF).any():
        # Until there are enough, a change is as large as the speed.
        known = seen.sum(axis=0)
        most = np.where(known, (np.abs(speeds) ** 2).sum(axis=0) / np.maximum(known, 1), np.inf)
        square = np.where(number < MIN_DOF, most, square)
    return speed, np.sqrt(square)


def _wrap(angle: Real) -> Real:
    """Return angles within half a turn."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _near_predictions(
    points: Complex, shape: Complex, sought: np.ndarray, expected: Expected
) -> np.ndarray:
    """Points (B, n) that are nearest to `sought` markers (B, n) and these to them, -1 for none."""
    indices = np.full(shape.shape, -1)
    pose = expected.predicted
    predicted = pose.position[:, :1] + np.exp(1j * pose.angle[:, :1]) * shape
    sought = sought & ~np.isnan(predicted)
    markers = predicted[sought]
    if not len(markers):
        return indices
    distance = np.abs(markers[:, None] - points)
    distance[np.isnan(distance)] = np.inf
    named = expected.named[expected.fits]
    distance[:, named[named >= 0]] = np.inf
    rows = np.arange(len(markers))
    nearest = distance.argmin(axis=1)
    least = distance[rows, nearest]
    distance[rows, nearest] = np.inf
    second = distance.min(axis=1)
    distance[rows, nearest] = least
    mutual = distance.argmin(axis=0)[nearest] == rows
    indices[sought] = np.where(mutual & (DISTANCE_RATIO * least < second), nearest, -1)
    return indices


def _add_hidden(
    points: Complex, shape: Complex, has_marker: np.ndarray, limit: Real, result: Match
) -> None:
    """
    Add markers that have no point yet, of bodies with a pose, where one point is in their place.

    A point within the limit of two markers is left out, and so is one of two points at a marker.
    """
    indices, position, turn = result.indices, result.position, result.turn
    missing = has_marker & (indices < 0) & np.isfinite(turn)[:, None]
    if not missing.any():
        return
    body = np.nonzero(missing)[0]
    distance = np.abs((position[body] + turn[body] * shape[missing])[:, None] - points)
    fits = distance <= limit[body][:, None]
    fits[:, indices[indices >= 0]] = False
    fits &= (fits.sum(axis=1, keepdims=True) == 1) & (fits.sum(axis=0) == 1)
    indices[missing] = np.where(fits.any(axis=1), fits.argmax(axis=1), -1)


def _at_pin(candidates: Candidates, b: int, limit: float, expected: Expected) -> Candidates | None:
    """Candidates that keep the pin of body `b` where it is on the ground, if there are any."""
    if expected.pins is None:
        return None
    own, ground = expected.pins[b]
    distance = np.abs(candidates.position + candidates.turn * own - ground)
    near = distance <= PAIR_LIMITS * limit
    return candidates.at(near) if near.any() else None


def _likeliest(
    b: int, ways: Candidates, shape: Complex, limit: float, expected: Expected
) -> Candidates:
    """Ways to place body `b` whose cost, nats, is nearly the least, by all that is known of it."""
    agree = ((ways.indices == expected.named[b]) & (ways.indices >= 0)).sum(axis=1)
    surprise = expected.predicted.costs(b, np.angle(ways.turn), ways.position, limit)
    # Two markers of more fit too easily, unless they are where they are expected.
    fewest = min(3, np.count_nonzero(~np.isnan(shape)))
    is_expected = np.isfinite(expected.predicted.angle_deviation[b]) & (surprise < EXCHANGE_NATS)
    credible = (ways.count >= fewest) | is_expected | (agree >= 2)
    # A name counts as much as a fitting marker: one marker that is off does not exchange bodies.
    costs = surprise - OUTLIER_NATS * (ways.count + agree)
    costs += ways.variance * (2 * ways.count - 3) / (2 * expected.variance)
    costs = np.where(credible, costs, np.inf)
    return ways.at(credible & (costs <= costs.min(initial=np.inf) + LEAD_NATS))


def _assign(candidates: dict[int, Candidates], result: Match) -> None:
    """
    Take candidates that are the only ones of a body, and whose points no other body could have.

    Bodies that fit with more markers choose first.
    """
    open_ = {b: one for b, one in candidates.items() if len(one.count)}
    while open_:
        most = max(int(one.count.max()) for one in open_.values())
        best = {b: one for b, one in open_.items() if one.count.max() == most}
        claims = [p for one in best.values() for p in set(one.indices[one.indices >= 0].tolist())]
        clear = {
            b: one
            for b, one in best.items()
            if len(one.count) == 1
            and all(claims.count(p) == 1 for p in one.indices[0].tolist() if p >= 0)
        }
        for b, one in clear.items():
            result.indices[b] = one.indices[0]
            result.position[b], result.turn[b] = one.position[0], one.turn[0]
        if not clear:
            # Points that several bodies could have are left to none of them.
            result.uncertain[list(best)] = True
        decided = clear or best
        taken = np.concatenate([one.indices.ravel() for one in decided.values()])
        taken = taken[taken >= 0]
        open_ = {
            b: one.at(~np.isin(one.indices, taken).any(axis=1))
            for b, one in open_.items()
            if b not in decided
        }
        open_ = {b: one for b, one in open_.items() if len(one.count)}
