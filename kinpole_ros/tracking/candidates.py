"""
All ways to place one body on the points of a frame.

Pairs of points that are as distant as two markers of the body fix a pose in the plane (the
congruent sets of 4PCS, Aiger, Mitra and Cohen-Or 2008). Mirrored bodies do not fit.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import fit_pose
from kinpole_ros.planar._plane import Complex, Real

# A pose found by two points is off by up to so many times the limit of a marker.
PAIR_LIMITS = 3.0
# Poses that are tried of one body in one frame, by its longest pairs first.
_MAX_POSES = 4096
# Larger clouds are not searched, and no more pairs of markers are tried.
_MAX_POINTS = 512


class Candidates(NamedTuple):
    """
    H ways to place one body on points, best first.

    `indices` (H, n) are the points of the markers, `count` (H,) how many markers have one, and
    `variance` (H,), m^2, the mean square of a residual per degree of freedom.
    """

    indices: np.ndarray
    position: Complex
    turn: Complex
    count: np.ndarray
    variance: Real

    def at(self, which: np.ndarray) -> 'Candidates':
        """Return some of the candidates."""
        return Candidates._make(array[which] for array in self)


def fit_points(
    points: Complex, shape: Complex, indices: np.ndarray
) -> tuple[Complex, Complex, Real]:
    """
    Fit shapes to points.

    Parameters
    ----------
    points : (m,) complex
        Points, m.
    shape : (..., n) complex
        Markers in the frame of the body, m; finite.
    indices : (..., n) int
        Points of the markers, -1 for none.

    Returns
    -------
    position, turn : (...) complex
        Poses: m, and of length 1.
    worst : (...) float
        Largest residual, m; infinite where there is no pose.

    """
    used = indices >= 0
    target = np.append(points, np.nan)[np.where(used, indices, -1)]
    fit = fit_pose(target, shape, used.astype(float))
    residual = np.where(used, np.abs(fit.residual), 0.0)
    worst = np.where(np.isnan(residual), np.inf, residual).max(axis=-1)
    return fit.position, np.exp(1j * fit.angle), np.where(np.isfinite(fit.angle), worst, np.inf)


def find_candidates(points: Complex, free: np.ndarray, shape: Complex, limit: float) -> Candidates:
    """
    Find all ways to place a body of two markers or more on points.

    Parameters
    ----------
    points : (m,) complex
        Points in the plane, m.
    free : (f,) int
        The points that may be its markers.
    shape : (n,) complex
        Its markers, m, NaN for none.
    limit : float
        Largest residual of a marker, m.

    Returns
    -------
    Candidates
        The ways, those with the most markers first.

    """
    width, markers = len(shape), np.flatnonzero(~np.isnan(shape))
    target, source = points[free], shape[markers]
    i, j = np.triu_indices(len(markers), 1)
    length = np.abs(source[j] - source[i])
    order = np.argsort(-length, kind='stable')[:_MAX_POINTS]
    i, j, length = (array[order][length[order] > 2 * limit] for array in (i, j, length))
    pairs = _congruent_pairs(target, length, limit) if len(length) else None
    if pairs is None:
        none = np.zeros(0, complex)
        return Candidates(np.zeros((0, width), int), none, none, np.zeros(0, int), np.zeros(0))
    p, q, k = pairs
    step = (target[q] - target[p]) / (source[j[k]] - source[i[k]])
    turn = step / np.abs(step)
    position = (target[p] + target[q] - turn * (source[i[k]] + source[j[k]])) / 2
    indices = np.full((len(p), width), -1)
    indices[:, markers] = _nearest(target, position, turn, source, PAIR_LIMITS * limit)
    count = (indices >= 0).sum(axis=1)
    # A pose by two markers alone is no use where another pose has more.
    indices = np.unique(indices[count >= min(3, count.max())], axis=0)
    filled = np.where(np.isnan(shape), 0, shape)
    position, turn, _ = fit_points(target, filled, indices)
    indices[:, markers] = _nearest(target, position, turn, source, limit)
    indices = np.unique(indices, axis=0)
    position, turn, worst = fit_points(target, filled, indices)
    used = indices >= 0
    count = used.sum(axis=1)
    good = (worst <= limit) & (count >= 2) & np.isfinite(turn)
    best_first = np.flatnonzero(good)[np.argsort(-count[good], kind='stable')]
    chosen = np.where(used, indices, 0)
    residual = np.abs(target[chosen] - position[:, None] - turn[:, None] * filled)
    variance = np.square(residual).sum(axis=1, where=used) / np.maximum(2 * count - 3, 1)
    indices = np.where(used, free[chosen], -1)
    return Candidates(indices, position, turn, count, variance).at(best_first)


def _congruent_pairs(
    points: Complex, lengths: Real, limit: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Pairs of points p, q as distant as a pair k of markers; None where there are none."""
    if not 2 <= len(points) <= _MAX_POINTS:
        return None
    distance = np.abs(points - points[:, None])
    pairs, total = [], 0
    for k, length in enumerate(lengths):
        p, q = np.nonzero(np.abs(distance - length) <= 2 * limit)
        total += len(p)
        if total > _MAX_POSES and k:
            break
        p, q = p[:_MAX_POSES], q[:_MAX_POSES]
        pairs.append((p, q, np.full(len(p), k)))
    p, q, k = (np.concatenate(arrays) for arrays in zip(*pairs, strict=True))
    return (p, q, k) if len(p) else None


def _nearest(
    points: Complex, position: Complex, turn: Complex, shape: Complex, limit: float
) -> np.ndarray:
    """The points (H, n) nearest to the markers, each once, -1 where none is within the limit."""
    markers = position[:, None] + turn[:, None] * shape
    indices = np.empty(markers.shape, int)
    least = np.empty(markers.shape)
    for n in range(len(shape)):
        distance = np.abs(markers[:, n, None] - points)
        indices[:, n] = distance.argmin(axis=1)
        least[:, n] = distance[np.arange(len(distance)), indices[:, n]]
    # A point that is nearest to two markers is that of the nearer one.
    for n in range(1, len(shape)):
        for before in range(n):
            same = indices[:, n] == indices[:, before]
            farther = least[:, n] >= least[:, before]
            least[same & farther, n] = np.inf
            least[same & ~farther, before] = np.inf
    return np.where(least <= limit, indices, -1)
