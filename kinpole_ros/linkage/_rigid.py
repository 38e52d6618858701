"""Which markers keep their distances, and so are of one rigid body."""

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage.limits import PAIR_FRAMES
from kinpole_ros.planar._plane import Complex, Real

_SAMPLED_FRAMES = 3000
# The variation of a distance over its noise is that of a rigid pair below the first ratio, and not
# beyond the second. Between, lens distortion and soft mounts shift the limit: it is put in the
# widest gap.
RIGID_RATIO, _LOOSE_RATIO = 2.5, 40.0
# A pair of markers that is a body of its own must be as rigid as noise alone makes it.
_NOISE_RATIO = 1.5
# Two cliques are one body if the distances between them vary by less than this many limits.
_BEND_RATIO = 1.5
# Share of the frames at each end of a range that may be of another marker, and the width of the
# range without them for a normal distribution, in standard deviations.
_TAIL, _TAIL_WIDTH = 0.01, 4.6527


class Groups(NamedTuple):
    """
    Columns of the markers of each body, largest body first.

    A marker on the axis of a pin may be in two bodies. `fixed` are markers that stand still,
    `single` markers that move and are rigid with no other.
    """

    bodies: list[list[int]]
    fixed: list[int]
    single: list[int]


def sampled(points: np.ndarray, frames: int) -> np.ndarray:
    """About `frames` of the points (T, ...), evenly spaced."""
    return points[:: max(1, len(points) // frames)]


def quantiles(rows: Real, shares: Sequence[float]) -> tuple[Real, np.ndarray]:
    """
    Quantiles (len(shares), n) of the finite values of each row (n, T), as numpy.quantile has them.

    NaN for a row without values. Also returns the number of values (n,). numpy.nanquantile takes
    one row at a time.
    """
    ordered = np.sort(rows, axis=1)
    counts = np.isfinite(ordered).sum(axis=1)
    numbers, last = np.arange(len(rows)), np.maximum(counts - 1, 0)
    result = np.full((len(shares), len(rows)), np.nan)
    for row, share in zip(result, shares, strict=True):
        position = last * share
        below = np.floor(position).astype(np.int64)
        fraction = position - below
        low, high = ordered[numbers, below], ordered[numbers, np.minimum(below + 1, last)]
        step = high - low
        row[:] = np.where(fraction < 0.5, low + step * fraction, high - step * (1 - fraction))
    return result, counts


def spreads(rows: Real) -> tuple[Real, Real]:
    """
    Standard deviation (n,) of each row (n, T) by its range without the tails, and its median.

    The deviation is infinite for a row of too few values.
    """
    (low, median, high), counts = quantiles(rows, (_TAIL, 0.5, 1 - _TAIL))
    return np.where(counts < PAIR_FRAMES, np.inf, (high - low) / _TAIL_WIDTH), median


def distance_spreads(points: np.ndarray, frames: int) -> tuple[Real, Real]:
    """
    Standard deviations and medians (n, n) of the distances of all pairs of points.

    Points are (T, n) complex or (T, n, 3), NaN for none; about `frames` of them are used. Pairs
    that are hardly ever seen in the same frames have an infinite deviation and the median 0.
    """
    rows = np.ascontiguousarray(np.moveaxis(sampled(points, frames), 1, 0))
    deviation = np.full((len(rows), len(rows)), np.inf)
    median = np.zeros(deviation.shape)
    for k in range(len(rows) - 1):
        off = rows[k + 1 :] - rows[k]
        distance = np.abs(off) if off.ndim == 2 else np.sqrt(np.einsum('ntk,ntk->nt', off, off))
        row, middle = spreads(distance)
        deviation[k, k + 1 :] = deviation[k + 1 :, k] = row
        median[k, k + 1 :] = median[k + 1 :, k] = np.where(np.isinf(row), 0.0, middle)
    return deviation, median


def complete_linkage(
    distance: Real, may_merge: Callable[[int, int, float], bool] = lambda i, j, height: True
) -> Iterator[tuple[int, int, float]]:
    """
    Merge clusters two by two, those first whose largest distance (n, n) is least.

    Yields each merger (i, j, height): cluster j becomes a part of i. Infinite distances are never
    merged, nor pairs that `may_merge` rejects.
    """
    between = distance.copy()
    np.fill_diagonal(between, np.inf)
    while len(between) > 1:
        i, j = (int(k) for k in np.unravel_index(between.argmin(), between.shape))
        height = float(between[i, j])
        if not np.isfinite(height):
            return
        if not may_merge(i, j, height):
            between[i, j] = between[j, i] = np.inf
            continue
        yield i, j, height
        between[i] = between[:, i] = np.maximum(between[i], between[j])
        between[i, i] = np.inf
        between[j] = between[:, j] = np.inf


def group(tracks: Complex, noise: Real) -> Groups:
    """Group tracks (T, n), complex, NaN for none, whose `noise` (n,) is per axis, into bodies."""
    count = tracks.shape[1]
    rows = np.ascontiguousarray(sampled(tracks, _SAMPLED_FRAMES).T)
    noise = _complete_noise(noise, rows)
    deviation, _ = distance_spreads(tracks, _SAMPLED_FRAMES)
    ratio = deviation / np.hypot(noise[:, None], noise)
    motion = np.maximum(spreads(rows.real)[0], spreads(rows.imag)[0]) / noise
    limit = _limit(ratio)
    is_rigid = ratio < limit
    is_fixed = motion < min(limit, 2 * RIGID_RATIO)
    # One marker that stands still is enough to show what turns about it.
    is_rigid[np.ix_(is_fixed, is_fixed)] = False
    cliques = [sorted(clique) for clique in _cliques(is_rigid) if len(clique) > 1]
    bodies = _merged_cliques(cliques, ratio, limit)
    fixed = is_fixed.nonzero()[0].tolist()
    return Groups(bodies, fixed, single_markers(bodies, fixed, count))


def single_markers(bodies: list[list[int]], fixed: list[int], count: int) -> list[int]:
    """Those of `count` markers that are of no body and do not stand still."""
    return sorted(set(range(count)).difference(fixed, *bodies))


def _complete_noise(noise: Real, rows: Complex) -> Real:
    """Noise (n,) with the median where it is NaN, and no less than rounding of the rows (n, T)."""
    finite = noise[np.isfinite(noise)]
    complete = np.where(np.isfinite(noise), noise, np.median(finite) if len(finite) else 0.0)
    points = rows[np.isfinite(rows)]
    extent = np.abs(points - points.mean()).max() if len(points) else 0.0
    return np.maximum(complete, 1e-9 * float(extent))


def _limit(ratio: Real) -> float:
    """
    Where the ratios (n, n) of rigid pairs end: in the middle of the widest gap that is possible.

    Gaps are between the heights at which clusters of markers merge. A marker near a pin keeps its
    distance to some markers of the next body, but not to all.
    """
    clusters = complete_linkage(np.where(ratio < _LOOSE_RATIO, ratio, np.inf))
    heights = np.array([height for _, _, height in clusters])
    between = np.sort(heights[heights > RIGID_RATIO])
    if not len(between):
        return 2 * RIGID_RATIO
    least = np.max(heights[heights <= RIGID_RATIO], initial=1.0)
    steps = np.log(np.concatenate(([least], between, [_LOOSE_RATIO])))
    k = int(np.diff(steps).argmax())
    return max(RIGID_RATIO, float(np.exp((steps[k] + steps[k + 1]) / 2)))


def _cliques(edges: np.ndarray) -> list[set[int]]:
    """All maximal cliques of a graph (n, n) (Bron and Kerbosch 1973, with pivots)."""
    neighbors = [set(row.nonzero()[0].tolist()) for row in edges]
    cliques: list[set[int]] = []

    def grow(clique: set[int], candidates: set[int], excluded: set[int]) -> None:
        if not candidates and not excluded:
            cliques.append(clique)
            return
        pivot = max(candidates | excluded, key=lambda k: len(neighbors[k] & candidates))
        for k in sorted(candidates - neighbors[pivot]):
            grow(clique | {k}, candidates & neighbors[k], excluded & neighbors[k])
            candidates = candidates - {k}
            excluded = excluded | {k}

    grow(set(), set(range(len(neighbors))), set())
    return cliques


def _merged_cliques(cliques: list[list[int]], ratio: Real, limit: float) -> list[list[int]]:
    """
    Bodies of cliques. Cliques that share two markers are one body: two markers fix a planar body.

    That is not so where most of their other distances change: then a marker is near a pin and of
    one body only. Two markers alone are a body if one of them is in no larger body, since
    distances are also constant by chance, as between two cranks in step. If both are in larger
    bodies by then, they must be as rigid as these.
    """
    large = [set(clique) for clique in cliques if len(clique) > 2]
    large.sort(key=lambda c: (-len(c), max(ratio[pair] for pair in combinations(sorted(c), 2))))
    bodies: list[set[int]] = []
    for clique in large:
        near = [body for body in bodies if len(body & clique) > 1]
        match = next((body for body in near if _are_rigid(body, clique, ratio, limit)), None)
        if match is not None:
            match |= clique
        elif len(clique.difference(*bodies)) > 1 or not near:
            bodies.append(clique)
    members = set().union(*bodies)
    pairs = [set(clique) for clique in cliques if len(clique) == 2 and not set(clique) <= members]
    for pair in sorted(pairs, key=lambda pair: ratio[tuple(pair)]):
        if not pair <= members or ratio[tuple(pair)] < _NOISE_RATIO:
            bodies.append(pair)
            members |= pair
    return [sorted(body) for body in bodies]


def _are_rigid(body: set[int], clique: set[int], ratio: Real, limit: float) -> bool:
    """Whether markers that only one of both has keep their distances to those of the other."""
    between = ratio[np.ix_(sorted(body - clique), sorted(clique - body))]
    between = between[np.isfinite(between)]
    return len(between) == 0 or bool(np.median(between) < _BEND_RATIO * limit)
