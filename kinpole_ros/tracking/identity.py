"""
Which point of a frame is which marker of which body, by the shapes of the bodies.

Names lie: a tracker exchanges two markers of two links, gives a marker that comes back another
name, or has no names at all. What cannot lie is that the distances between the markers of a body
stay as they are. So points are first looked for where the bodies are to be expected, and what that
does not settle by pairs of points as distant as two markers of a body (the congruent pairs of
4PCS, Aiger, Mitra and Cohen-Or 2008, here of two points, which fix a pose in the plane). Whatever
fits in more than one way is left out. Mirrored bodies do not fit.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.levels import SURE

# A point is where a marker is expected if the second nearest is so many times as far.
_NEARER = 2.0
# A pose found by two points, and a marker expected by it, are off by up to so many times the limit.
_BY_TWO = 3.0
# Poses that are tried of one body in one frame: those by its longest pairs, which tell most.
_MOST_POSES = 4096
# In a cloud with more points nothing is searched for, nor by more pairs than the longest.
_MOST = 512


class Match(NamedTuple):
    """
    Points of a frame as markers.

    `place` (B, n) says which point is the marker, -1 for none; `position` (B,), complex, m, and
    `turn` (B,), of length 1, are the poses, NaN for a body that was not found; `uncertain` (B,)
    says where one was found in several ways that fit as well. `variance` (B,) is that of one
    coordinate of a marker in the way that fits best, m^2, NaN for a body that was not searched for.
    """

    place: np.ndarray
    position: Complex
    turn: Complex
    uncertain: np.ndarray
    variance: Real


class Expected(NamedTuple):
    """
    What else is known of a frame.

    `position` and `turn` (B,) are where bodies are to be expected, NaN where nothing tells. `named`
    (B, n) are the points by name, -1 for none, and `held` (B,) the bodies that fit by name.
    `variance` is that of the noise of one coordinate of a marker, m^2, infinite while not known.
    `pins` (B, 2) are where bodies are pinned to the ground, in their frames and in the plane,
    complex, m, NaN for a body without; None where there are none.
    """

    position: Complex
    turn: Complex
    named: np.ndarray
    held: np.ndarray
    variance: float = np.inf
    pins: Complex | None = None


class Ways(NamedTuple):
    """
    H ways to find one body among points: place (H, n), the pose, and how many markers fit.

    `variance` (H,) is the mean square of a residual per degree of freedom, m^2.
    """

    place: np.ndarray
    position: Complex
    turn: Complex
    count: np.ndarray
    variance: Real

    def at(self, which: np.ndarray) -> 'Ways':
        return Ways(*(part[which] for part in self))


def match(points: Complex, shapes: Complex, limit: Real, expected: Expected) -> Match:
    """
    Match `points` (m,), complex, m, NaN for none, to bodies of the `shapes` (B, n), NaN for none.

    A marker may be off its place by `limit` (B,), m.
    """
    known = ~np.isnan(shapes)
    shape = np.where(known, shapes, 0)
    place = np.where(expected.held[:, None] & known, expected.named, -1)
    if len(points):
        near = _where_expected(points, shape, known & ~expected.held[:, None], expected)
        place = np.where(expected.held[:, None], place, near)
    position, turn, off = fit_place(points, shape, place)
    count = (place >= 0).sum(axis=1)
    # Two markers of several agree in one distance only, so whoever else has that must not be near.
    found = (off <= limit) & (count >= 2)
    uncertain = np.zeros(len(shapes), bool)
    variance = np.full(len(shapes), np.nan)
    position = np.where(found, position, np.nan)
    turn = np.where(found, turn, np.nan)
    found &= np.isfinite(turn)
    place[~found] = -1
    if found.any():
        place = _gathered(points, shape, known, limit, position, turn, place)
    lost = np.flatnonzero(~found & (known.sum(axis=1) >= 2))
    if len(lost) and len(points):
        free = np.flatnonzero(~np.isnan(points))
        free = free[~np.isin(free, place)]
        ways = {b: find_ways(points, free, shapes[b], float(limit[b])) for b in lost.tolist()}
        pinned = {b: _keep_pin(some, b, limit[b], expected) for b, some in ways.items()}
        ways = {
            b: _likely(b, pinned[b] or some, shape[b], known[b], expected)
            for b, some in ways.items()
        }
        for b, some in ways.items():
            # Two points of many are always as far apart as two markers.
            variance[b] = some.variance[some.count > 2].min(initial=np.inf)
        variance[np.isinf(variance)] = np.nan
        # Bodies that are at their pins come first.
        for first in (True, False):
            part = {b: some for b, some in ways.items() if (pinned[b] is not None) == first}
            taken = place[place >= 0]
            part = {b: some.at(~np.isin(some.place, taken).any(axis=1)) for b, some in part.items()}
            _settle(part, place, position, turn, uncertain)
        if not uncertain.all():
            place = _gathered(points, shape, known, limit, position, turn, place)
    return Match(place, position, turn, uncertain, variance)


def merge_names(found: Match, named: np.ndarray) -> np.ndarray | None:
    """
    Places (B, n) by name, but for bodies that have a point which is not named for them.

    None where there is no such body: what is amiss within one is not a matter of names.
    """
    foreign = np.array(
        [
            ((row >= 0) & ~np.isin(row, own)).any()
            for row, own in zip(found.place, named, strict=True)
        ]
    )
    foreign &= np.isfinite(found.turn)
    if not foreign.any():
        return None
    claimed = found.place[foreign]
    claimed = claimed[claimed >= 0]
    lost = np.isin(named, claimed)
    place = np.where(lost, -1, named)
    for b in np.flatnonzero(foreign | (lost.any(axis=1) & np.isfinite(found.turn))):
        # Markers of which no place is known yet stay where their names say.
        own = np.where(np.isin(place[b], found.place[b]), -1, place[b])
        place[b] = np.where(found.place[b] >= 0, found.place[b], own)
    return place


def _where_expected(
    points: Complex, shape: Complex, wanted: np.ndarray, expected: Expected
) -> np.ndarray:
    """Points (B, n) that are nearest to where `wanted` markers are expected, and they to them."""
    place = np.full(shape.shape, -1)
    there = expected.position[:, None] + expected.turn[:, None] * shape
    wanted = wanted & ~np.isnan(there)
    flat = there[wanted]
    if not len(flat):
        return place
    far = np.abs(flat[:, None] - points)
    far[np.isnan(far)] = np.inf
    held = expected.named[expected.held]
    far[:, held[held >= 0]] = np.inf
    rows = np.arange(len(flat))
    nearest = far.argmin(axis=1)
    least = far[rows, nearest]
    far[rows, nearest] = np.inf
    second = far.min(axis=1)
    far[rows, nearest] = least
    mutual = far.argmin(axis=0)[nearest] == rows
    place[wanted] = np.where(mutual & (_NEARER * least < second), nearest, -1)
    return place


def fit_place(points: Complex, shape: Complex, place: np.ndarray) -> tuple[Complex, Complex, Real]:
    """Poses (...) of shapes (..., n) at points, and how far off the worst marker is."""
    seen = place >= 0
    there = np.where(seen, points[np.where(seen, place, 0)], 0) if len(points) else 0 * shape
    there = np.where(np.isnan(there), 0, there)
    count = np.maximum(seen.sum(axis=-1), 1)
    own = np.where(seen, shape, 0)
    mean, middle = there.sum(axis=-1) / count, own.sum(axis=-1) / count
    arms = np.where(seen, there - mean[..., None], 0)
    own = np.where(seen, own - middle[..., None], 0)
    cross = (own.conj() * arms).sum(axis=-1)
    with np.errstate(invalid='ignore', divide='ignore'):
        turn = cross / np.abs(cross)
    off = np.abs(arms - turn[..., None] * own)
    worst = np.where(np.isnan(off), np.inf, off).max(axis=-1)
    return mean - turn * middle, turn, worst


def _gathered(
    points: Complex,
    shape: Complex,
    known: np.ndarray,
    limit: Real,
    position: Complex,
    turn: Complex,
    place: np.ndarray,
) -> np.ndarray:
    """
    The same with the markers that are missing, where there is one point in their place.

    A point within the limit of two markers, or one of two points at a marker, is left out.
    """
    missing = known & (place < 0) & np.isfinite(turn)[:, None]
    if not missing.any():
        return place
    body = np.nonzero(missing)[0]
    far = np.abs((position[body] + turn[body] * shape[missing])[:, None] - points)
    fits = far <= limit[body][:, None]
    fits[:, place[place >= 0]] = False
    alone = (fits.sum(axis=1, keepdims=True) == 1) & (fits.sum(axis=0) == 1)
    fits &= alone
    place = place.copy()
    place[missing] = np.where(fits.any(axis=1), fits.argmax(axis=1), -1)
    return place


def find_ways(points: Complex, free: np.ndarray, shape: Complex, limit: float) -> Ways:
    """All ways to find a shape (n,) of two markers or more among some points, best first."""
    n = len(shape)
    marker = np.flatnonzero(~np.isnan(shape))
    there, own = points[free], shape[marker]
    i, j = np.triu_indices(len(marker), 1)
    long = np.abs(own[j] - own[i])
    order = np.argsort(-long, kind='stable')[:_MOST]
    i, j, long = (part[order][long[order] > 2 * limit] for part in (i, j, long))
    nothing = Ways(
        np.zeros((0, n), int),
        np.zeros(0, complex),
        np.zeros(0, complex),
        np.zeros(0, int),
        np.zeros(0),
    )
    if not len(long) or not 2 <= len(there) <= _MOST:
        return nothing
    distance = np.abs(there - there[:, None])
    first, second, pair = [], [], []
    total = 0
    for k in range(len(long)):
        p, q = np.nonzero(np.abs(distance - long[k]) <= 2 * limit)
        total += len(p)
        if total > _MOST_POSES and k:
            break
        first.append(p[:_MOST_POSES])
        second.append(q[:_MOST_POSES])
        pair.append(np.full(len(first[-1]), k))
    p, q, k = map(np.concatenate, (first, second, pair))
    if not len(p):
        return nothing
    step = (there[q] - there[p]) / (own[j[k]] - own[i[k]])
    turn = step / np.abs(step)
    position = (there[p] + there[q] - turn * (own[i[k]] + own[j[k]])) / 2
    inner = np.full((len(p), n), -1)
    inner[:, marker] = _nearest(there, position, turn, own, _BY_TWO * limit)
    count = (inner >= 0).sum(axis=1)
    # Of those by two markers alone nothing is gained where there is more.
    inner = np.unique(inner[count >= min(3, count.max())], axis=0)
    filled = np.where(np.isnan(shape), 0, shape)
    position, turn, _ = fit_place(there, filled, inner)
    inner[:, marker] = _nearest(there, position, turn, own, limit)
    inner = np.unique(inner, axis=0)
    position, turn, off = fit_place(there, filled, inner)
    count = (inner >= 0).sum(axis=1)
    good = (off <= limit) & (count >= 2) & np.isfinite(turn)
    order = np.flatnonzero(good)[np.argsort(-count[good], kind='stable')]
    place = np.where(inner >= 0, free[np.where(inner >= 0, inner, 0)], -1)
    off = np.abs(there[np.where(inner >= 0, inner, 0)] - position[:, None] - turn[:, None] * filled)
    square = np.square(off).sum(axis=1, where=inner >= 0)
    variance = square / np.maximum(2 * count - 3, 1)
    return Ways(place, position, turn, count, variance).at(order)


def _nearest(
    there: Complex, position: Complex, turn: Complex, own: Complex, most: float
) -> np.ndarray:
    """The points (H, n) nearest to the markers, each once, -1 where none is within `most`."""
    markers = position[:, None] + turn[:, None] * own
    place = np.empty(markers.shape, int)
    least = np.empty(markers.shape)
    for n in range(len(own)):
        far = np.abs(markers[:, n, None] - there)
        place[:, n] = far.argmin(axis=1)
        least[:, n] = far[np.arange(len(far)), place[:, n]]
    # A point that is nearest to two markers is that of the nearer one.
    for n in range(1, len(own)):
        for before in range(n):
            same = place[:, n] == place[:, before]
            farther = least[:, n] >= least[:, before]
            least[same & farther, n] = np.inf
            least[same & ~farther, before] = np.inf
    return np.where(least <= most, place, -1)


def _keep_pin(ways: Ways, b: int, limit: float, expected: Expected) -> Ways | None:
    """Those of the ways that keep the pin of body `b` where it is on the ground; None for none."""
    if expected.pins is None:
        return None
    own, ground = expected.pins[b]
    near = np.abs(ways.position + ways.turn * own - ground) <= _BY_TWO * limit
    return ways.at(near) if near.any() else None


def _likely(b: int, ways: Ways, shape: Complex, known: np.ndarray, expected: Expected) -> Ways:
    """Those of the ways to find body `b` that nothing speaks against, each pose once."""
    few = min(3, int(known.sum()))
    named = (ways.place == expected.named[b]) & (ways.place >= 0)
    agree = named.sum(axis=1)
    ahead = np.full(len(agree), np.inf)
    if len(agree) and np.isfinite(expected.turn[b]):
        there = expected.position[b] + expected.turn[b] * shape[known]
        here = ways.position[:, None] + ways.turn[:, None] * shape[known]
        ahead = np.sqrt(np.square(np.abs(here - there)).mean(axis=1))
    size = 2 * np.abs(shape[known] - shape[known].mean()).max()
    # Two markers of more fit too easily, unless they are about where they are to be.
    near = ahead < size / 4
    ways_kept = (ways.count >= few) | near | (agree >= 2)
    ways, agree, ahead = ways.at(ways_kept), agree[ways_kept], ahead[ways_kept]
    if not len(ways.count):
        return ways
    # A name counts as much as a fit: a marker that is off for once does not make its body another.
    score = ways.count + agree
    best = score == score.max()
    # Of these, a way with residuals far beyond the noise is wrong where another has less.
    best &= ways.variance <= max(
        SURE**2 * expected.variance, _NEARER**2 * ways.variance.min(where=best, initial=np.inf)
    )
    ways, agree, ahead = ways.at(best), agree[best], ahead[best]
    if len(agree) > 1 and (agree.max() > agree).sum() == len(agree) - 1:
        return ways.at(agree == agree.max())
    if len(agree) > 1 and np.isfinite(ahead[0]):
        least, second = np.partition(ahead, 1)[:2]
        if _NEARER * least < second:
            return ways.at(ahead == least)
    return ways


def _settle(
    ways: dict[int, Ways],
    place: np.ndarray,
    position: Complex,
    turn: Complex,
    uncertain: np.ndarray,
) -> None:
    """
    Take the ways that are the only ones for a body, and none of whose points another body wants.

    Whoever fits with more markers comes first. Fills `place`, `position`, `turn` and `uncertain`.
    """
    open_ = {b: some for b, some in ways.items() if len(some.count)}
    while open_:
        most = max(int(some.count.max()) for some in open_.values())
        best = {b: some for b, some in open_.items() if some.count.max() == most}
        alone = {b: some for b, some in best.items() if len(some.count) == 1}
        claims = [p for some in best.values() for p in set(some.place[some.place >= 0].tolist())]
        clear = {
            b: some
            for b, some in alone.items()
            if all(claims.count(p) == 1 for p in some.place[0].tolist() if p >= 0)
        }
        if not clear:
            for b in best:
                uncertain[b] = True
                del open_[b]
            # What they may have is nobody's.
            taken = np.array(sorted(set(claims)))
        else:
            for b, some in clear.items():
                place[b], position[b], turn[b] = some.place[0], some.position[0], some.turn[0]
                del open_[b]
            taken = np.unique(np.concatenate([some.place[0] for some in clear.values()]))
        for b, some in list(open_.items()):
            left = some.at(~np.isin(some.place, taken[taken >= 0]).any(axis=1))
            if len(left.count):
                open_[b] = left
            else:
                del open_[b]
