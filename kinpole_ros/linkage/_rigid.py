"""Which tracks keep their distances, and so are of one rigid body."""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._columns import quantiles
from kinpole_ros.planar._plane import Complex, Real

# Frames of a pair of tracks that distances are looked at in, and fewer than which say nothing.
_FRAMES = 3000
_FEWEST = 30
# Spreads of a distance over its noise: below the first all are rigid, beyond the last none is. The
# widest gap up to there parts them, which a lens or a soft mount moves up.
_RIGID, _LOOSE = 2.5, 40.0
# A ratio that noise alone makes.
_PLAIN = 1.5
# Times the limit that distances of one body may vary by where it bends.
_NEARLY = 1.5
# Share of the frames at either end of a distance's range that may be of another marker.
_TAIL = 0.01
_TAIL_WIDTH = 4.6527  # that range of a normal distribution, in standard deviations


class Groups(NamedTuple):
    """
    `bodies` are lists of columns, largest first; a column on the axis of a pin may be in two.

    `fixed` are columns that stand still and `single` those that are rigid with nothing.
    """

    bodies: list[list[int]]
    fixed: list[int]
    single: list[int]


def group(tracks: Complex, noise: Real) -> Groups:
    """Bodies of tracks (T, n), complex, NaN for none, whose `noise` (n,) is per axis."""
    count = tracks.shape[1]
    some = tracks[:: max(1, len(tracks) // _FRAMES)]
    finite = noise[np.isfinite(noise)]
    known = np.where(np.isfinite(noise), noise, np.median(finite) if len(finite) else 0.0)
    places = some[np.isfinite(some)]
    extent = np.abs(places - places.mean()).max() if len(places) else 0.0
    floor = 1e-9 * float(extent)
    known = np.maximum(np.nan_to_num(known), floor)
    ratio = np.full((count, count), np.inf)
    rows = np.ascontiguousarray(some.T)
    for one in range(count - 1):
        spread = _spreads(np.abs(rows[one] - rows[one + 1 :]))
        row = spread / np.hypot(known[one], known[one + 1 :])
        ratio[one, one + 1 :] = ratio[one + 1 :, one] = row
    still = np.maximum(_spreads(rows.real), _spreads(rows.imag)) / known
    limit = _limit(ratio)
    rigid = ratio < limit
    fixed = (still < min(limit, 2 * _RIGID)).nonzero()[0].tolist()
    # Of those that stand still one is enough to tell what turns about it.
    standing = np.isin(np.arange(count), fixed)
    rigid[np.ix_(standing, standing)] = False
    cliques = [sorted(c) for c in _cliques(rigid) if len(c) > 1]
    bodies = _merge(cliques, ratio, limit)
    held = {k for body in bodies for k in body}
    single = [k for k in range(count) if k not in held and not standing[k]]
    return Groups(bodies, fixed, single)


def _spreads(rows: Real) -> Real:
    """Standard deviations of rows (n, T), NaN for none, as of their ranges without their tails."""
    (low, high), counts = quantiles(rows, (_TAIL, 1 - _TAIL))
    return np.where(counts < _FEWEST, np.inf, (high - low) / _TAIL_WIDTH)


def _limit(ratio: Real) -> float:
    """
    Where the ratios (n, n) of rigid pairs end: in the middle of the widest gap that is possible.

    Gaps are those between the ratios at which clusters of markers merge (complete linkage): a
    marker near a pin keeps its distance to some of the next body, but not to all.
    """
    merged = np.concatenate([_linkage(ratio[np.ix_(k, k)]) for k in _separate(ratio < _LOOSE)])
    inside = np.sort(merged[(merged > _RIGID) & (merged < _LOOSE)])
    if not len(inside):
        return 2 * _RIGID
    least = np.max(merged[merged <= _RIGID], initial=1.0)
    steps = np.log(np.concatenate(([least], inside, [_LOOSE])))
    k = int(np.diff(steps).argmax())
    return max(_RIGID, float(np.exp((steps[k] + steps[k + 1]) / 2)))


def _separate(edges: np.ndarray) -> list[list[int]]:
    """Sets of numbers that no edge (n, n) joins to another set: clusters are in one of them."""
    rest = set(range(len(edges)))
    found: list[list[int]] = []
    while rest:
        reached = [min(rest)]
        rest.remove(reached[0])
        for k in reached:
            more = [m for m in edges[k].nonzero()[0].tolist() if m in rest]
            reached += more
            rest.difference_update(more)
        found.append(sorted(reached))
    return found


def _linkage(ratio: Real) -> Real:
    """The largest ratios in clusters of markers (n,), merged two by two with it least each time."""
    between = ratio.copy()
    np.fill_diagonal(between, np.inf)
    heights = []
    while len(between) > 1:
        one, other = sorted(np.unravel_index(between.argmin(), between.shape))
        heights.append(between[one, other])
        between[one] = between[:, one] = np.maximum(between[one], between[other])
        between = np.delete(np.delete(between, other, axis=0), other, axis=1)
    return np.array(heights)


def _cliques(edges: np.ndarray) -> list[set[int]]:
    """All maximal cliques of a graph (n, n) (Bron and Kerbosch 1973, with pivots)."""
    near = [set(row.nonzero()[0].tolist()) for row in edges]
    found: list[set[int]] = []

    def grow(clique: set[int], rest: set[int], done: set[int]) -> None:
        if not rest and not done:
            found.append(clique)
            return
        pivot = max(rest | done, key=lambda k: len(near[k] & rest))
        for k in sorted(rest - near[pivot]):
            grow(clique | {k}, rest & near[k], done & near[k])
            rest = rest - {k}
            done = done | {k}

    grow(set(), set(range(len(near))), set())
    return found


def _merge(cliques: list[list[int]], ratio: Real, limit: float) -> list[list[int]]:
    """
    Bodies of cliques: those that share two markers are one, since two hold a body of the plane.

    Unless most of their other distances change: then some marker is near a pin, and is on one of
    them only. Two markers alone are a body if one of them is in no larger one: distances
    are constant by chance, too, as between markers of two cranks in step. And if both are
    on bodies by then, only if they are as rigid as these.
    """
    large = [c for c in cliques if len(c) > 2]
    large.sort(key=lambda c: (-len(c), max(ratio[pair] for pair in combinations(c, 2))))
    bodies: list[set[int]] = []
    for clique in large:
        near = [body for body in bodies if len(body & set(clique)) > 1]
        one = next((body for body in near if _agree(body, set(clique), ratio, limit)), None)
        if one is not None:
            one |= set(clique)
        elif len(set(clique).difference(*bodies)) > 1 or not near:
            bodies.append(set(clique))
    held = set().union(*bodies) if bodies else set()
    pairs = [set(c) for c in cliques if len(c) == 2 and not set(c) <= held]
    for pair in sorted(pairs, key=lambda pair: ratio[tuple(pair)]):
        if not pair <= held or ratio[tuple(pair)] < _PLAIN:
            bodies.append(pair)
            held |= pair
    return [sorted(body) for body in bodies]


def _agree(one: set[int], other: set[int], ratio: Real, limit: float) -> bool:
    """Whether the markers that only one of two has keep their distances, as far as known."""
    between = ratio[np.ix_(sorted(one - other), sorted(other - one))]
    known = between[np.isfinite(between)]
    return len(known) == 0 or bool(np.median(known) < _NEARLY * limit)
