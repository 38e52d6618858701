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
from kinpole_ros.tracking.rejection import DISTANCE_RATIO
from kinpole_ros.tracking.statistics import median
from kinpole_ros.tracking.thresholds import MIN_DOF, N_SIGMA, RECENT_FRAMES, ROUNDED

# Degrees of freedom of the errors of predictions: few, since they have impacts among them.
TAIL = 4.0


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


class Expected(NamedTuple):
    """
    What is known of a frame before its points are matched.

    `position` and `turn` (B,) are the predicted poses, NaN where there is no prediction. `named`
    (B, n) are the points by name, -1 for none, and `fits` (B,) the bodies that fit by name.
    `variance`, m^2, is the noise of one coordinate of a marker, infinite while not measured.
    `pins` (B, 2), complex, m, are points of bodies that are pinned to the ground, in the frame of
    the body and in the plane, NaN for a body without; None where no body has one.
    """

    position: Complex
    turn: Complex
    named: np.ndarray
    fits: np.ndarray
    variance: float = np.inf
    pins: Complex | None = None


class Prediction(NamedTuple):
    """
    The poses expected of a body in a frame, if 0, 1... frames before it were lost without notice.

    `angle` and `position`, rad and complex, m, each with the standard deviation of the first. By
    default nothing is known.
    """

    angle: Real = np.full(1, np.nan)
    angle_deviation: float = np.inf
    position: Complex = np.full(1, complex(np.nan, np.nan))
    position_deviation: float = np.inf

    def costs(self, angle: Real, position: Complex, limit: float) -> Real:
        """
        Return how unlikely poses (H,) are, nats, by Student's distribution: a body may be hit.

        Markers are off by up to `limit`, m.
        """
        if np.isinf(self.angle_deviation):
            return np.zeros(len(angle))
        turned = angle[:, None] - self.angle
        turned -= 2 * np.pi * np.rint(turned / (2 * np.pi))
        turned /= self.angle_deviation + ROUNDED
        moved = np.abs(position[:, None] - self.position)
        moved /= self.position_deviation + ROUNDED * limit
        nats = (TAIL + 1) / 2 * np.log1p((turned**2 + moved**2) / TAIL)
        return np.asarray((nats + LOSS_NATS * np.arange(nats.shape[1])).min(axis=1))


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
        candidates[b] = _likeliest(b, at_pin or every_way, shapes[b], expected)
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


def predict_pose(stamps: np.ndarray, angles: Real, positions: Complex) -> Prediction:
    """
    Predict the pose of a body by its last velocity.

    Parameters
    ----------
    stamps : (N + 1,) int64
        Stamps of the frames before, and of the frame to predict, ns.
    angles, positions : (N,)
        Poses in the frames before, rad and complex, m; NaN where the body was not seen. A body
        that was seen once stays where it was.

    Returns
    -------
    Prediction
        The pose; NaN for a body that was not seen of late.

    """
    steps = np.diff(stamps)
    # Late stamps do not change the number of frames.
    frames = np.maximum(np.rint(steps / max(median(steps), 1)), 1) if len(steps) else steps
    number = np.concatenate(((0,), np.cumsum(frames)))
    seen = np.flatnonzero(np.isfinite(angles))
    if not len(seen) or number[-1] - number[seen[-1]] > RECENT_FRAMES:
        return Prediction()
    ahead = number[-1] - number[seen[-1]] + np.arange(MOST_CHARGED_LOSSES + 1)
    frames = np.diff(number[seen])
    parts: list[Complex | float] = []
    for signal in (np.unwrap(angles[seen]), positions[seen]):
        speeds = np.diff(signal) / frames
        parts.append(signal[-1] + ahead * (speeds[-1] if len(speeds) else 0))
        changes = np.abs(2 * np.diff(speeds) / (frames[1:] + frames[:-1]))
        error = np.sqrt(np.mean(changes**2)) if len(seen) >= MIN_DOF else np.inf
        parts.append(ahead[0] * (ahead[0] + 1) / 2 * error)
    return Prediction(*parts)


def _near_predictions(
    points: Complex, shape: Complex, sought: np.ndarray, expected: Expected
) -> np.ndarray:
    """Points (B, n) that are nearest to `sought` markers (B, n) and these to them, -1 for none."""
    indices = np.full(shape.shape, -1)
    predicted = expected.position[:, None] + expected.turn[:, None] * shape
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


def _likeliest(b: int, candidates: Candidates, shape: Complex, expected: Expected) -> Candidates:
    """Candidates of body `b` that fit the most markers, names, and the prediction."""
    markers = shape[~np.isnan(shape)]
    named = (candidates.indices == expected.named[b]) & (candidates.indices >= 0)
    agree = named.sum(axis=1)
    off = np.full(len(agree), np.inf)
    if len(agree) and np.isfinite(expected.turn[b]):
        predicted = expected.position[b] + expected.turn[b] * markers
        placed = candidates.position[:, None] + candidates.turn[:, None] * markers
        off = np.sqrt(np.square(np.abs(placed - predicted)).mean(axis=1))
    size = 2 * np.abs(markers - markers.mean()).max()
    # Two markers of more fit too easily, unless they are near the prediction.
    enough = candidates.count >= min(3, len(markers))
    plausible = enough | (off < size / 4) | (agree >= 2)
    candidates, agree, off = candidates.at(plausible), agree[plausible], off[plausible]
    if not len(agree):
        return candidates
    # A name counts as much as a fitting marker: one marker that is off does not exchange bodies.
    score = candidates.count + agree
    best = score == score.max()
    # Residuals far beyond the noise are wrong where another candidate has smaller ones.
    least = candidates.variance.min(where=best, initial=np.inf)
    best &= candidates.variance <= max(N_SIGMA**2 * expected.variance, DISTANCE_RATIO**2 * least)
    candidates, agree, off = candidates.at(best), agree[best], off[best]
    if len(agree) > 1 and (agree == agree.max()).sum() == 1:
        return candidates.at(agree == agree.max())
    if len(agree) > 1 and np.isfinite(off[0]):
        least, second = np.partition(off, 1)[:2]
        if DISTANCE_RATIO * least < second:
            return candidates.at(off == least)
    return candidates


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
