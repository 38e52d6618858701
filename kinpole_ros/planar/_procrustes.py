"""The pose of a body of known shape that fits its markers best, frame by frame."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import ROUNDING, Complex, Real


class Fit(NamedTuple):
    """
    Poses of shape (...) fitted to markers, and how well they are held.

    `position` is where the origin of the body's frame is (complex, m), `angle` its turn (rad, in
    (-pi, pi]); `residual` (..., n) is marker minus fitted marker in the body's axes, NaN for none;
    `spread` is the weighted sum of squares of the seen markers about their mean in the body's
    frame (m^2), `mean` that mean, `total` the sum of weights. `freedom` (..., n) is the expected
    square of each residual over the variance of one coordinate: 2 less what the fit takes up, so
    that it adds up to 2n - 3 degrees of freedom.
    """

    position: Complex
    angle: Real
    residual: Complex
    spread: Real
    mean: Complex
    total: Real
    freedom: Real


def fit_pose(points: Complex, shape: Complex, weights: Real) -> Fit:
    """
    Weighted orthogonal Procrustes in the plane (Schoenemann 1966; complex form, Kendall 1984).

    `points` (..., n) complex, m, in the ground frame, `shape` (..., n) in the body's frame,
    `weights` (..., n) >= 0. A marker of weight 0 may hold anything, NaN included. Angle and
    position are NaN where fewer than two markers have weight or all of them coincide.
    """
    seen = weights > 0
    p = np.where(seen, points, 0)
    s = np.where(seen, shape, 0)
    total = weights.sum(axis=-1)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        point_mean = (weights * p).sum(axis=-1) / total
        shape_mean = (weights * s).sum(axis=-1) / total
        p = p - point_mean[..., None]
        s = s - shape_mean[..., None]
        square = weights * (s.real**2 + s.imag**2)
        spread = square.sum(axis=-1)
        cross = (weights * p * s.conj()).sum(axis=-1)
        apart = _apart(p, point_mean, seen) & _apart(s, shape_mean, seen)
        length = np.abs(cross)
        turn = np.where(apart & (length > np.finfo(float).tiny), cross / length, np.nan)
        position = point_mean - turn * shape_mean
        taken = weights * (2 / total)[..., None] + square / spread[..., None]
        freedom = np.where(seen, np.maximum(2 - taken, 0), 0)
    residual = np.where(seen, p * turn.conj()[..., None] - s, np.nan)
    return Fit(position, np.angle(turn), residual, spread, shape_mean, total, freedom)


def _apart(arms: Complex, mean: Complex, seen: np.ndarray) -> np.ndarray:
    """Where points that are seen lie apart from their mean by more than rounding."""
    farthest = np.abs(arms).max(axis=-1, where=seen, initial=0.0)
    return np.asarray(farthest > ROUNDING * np.abs(mean))
