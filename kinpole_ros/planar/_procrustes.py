"""Weighted orthogonal Procrustes in the plane: the pose of a body of known shape."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import ROUNDING, Complex, Real


class Fit(NamedTuple):
    """
    Poses (...) fitted to markers (..., n), with their residuals and precision.

    Weights are relative: a marker of weight 1 has the variance v in each coordinate, a marker of
    weight w has v / w. `freedom`, `spread` and `weight` are of the shape and the weights alone, so
    they are finite also where the points coincide and the pose is NaN.

    Attributes
    ----------
    position
        Origin of the body's frame (...), complex, m.
    angle
        Rotation of the body's frame (...), rad, in [-pi, pi]. Half a turn may have either sign.
    residual
        Marker minus fitted marker, in the body's axes (..., n), complex, m; NaN without weight.
    freedom
        Degrees of freedom of each residual (..., n): its expected square is freedom * v / w. That
        is 2 less the part that the fit absorbs; for m markers with weight they sum to 2m - 3.
    spread
        Weighted sum of squares of the markers about their mean (...), m^2. The variance of the
        angle is v / spread.
    weight
        Weight of the position along its least certain axis (...): the variance there is v / weight,
        with 1 / weight = 1 / sum(weights) + |mean|^2 / spread. The second term is the error of the
        angle, which moves the origin across its distance from the mean of the markers.

    """

    position: Complex
    angle: Real
    residual: Complex
    freedom: Real
    spread: Real
    weight: Real


class ProcrustesFactors(NamedTuple):
    """
    What a fit needs of the shape and the weights alone.

    Attributes
    ----------
    seen
        Markers with weight (..., n), bool.
    arms
        From the weighted mean of the shape to each marker (..., n), complex, m; NaN without weight.
    mean_factor
        Factors of the points in their weighted mean (..., n): its value is
        sum(mean_factor * points).
    turn_factor
        Factors of the points about their mean in c of `fit_pose` (..., n), complex, m: c is
        sum(turn_factor * (points - their mean)).
    mean
        Weighted mean of the shape (...), complex, m, in the body's frame.
    distinct
        Whether the markers with weight do not all coincide (...), bool.
    freedom, spread, weight
        As in `Fit`.

    """

    seen: np.ndarray
    arms: Complex
    mean_factor: Real
    turn_factor: Complex
    mean: Complex
    distinct: np.ndarray
    freedom: Real
    spread: Real
    weight: Real


def fit_pose(points: Complex, shape: Complex, weights: Real) -> Fit:
    """
    Fit the pose of a body to its markers by weighted least squares.

    Parameters
    ----------
    points
        Markers in the ground's frame (..., n), complex, m.
    shape
        The same markers in the body's frame (..., n), complex, m.
    weights
        Inverse variances of the markers up to a factor (..., n), >= 0. A marker of weight 0 is
        ignored and may be NaN.

    Returns
    -------
    Fit
        Poses (...). NaN where fewer than two markers have weight, where these coincide, or where
        no rotation is better than the others.

    Notes
    -----
    With points p and shape s about their weighted means, the rotation is c / |c| with
    c = sum(weights conj(s) p). Schoenemann 1966; complex form, Kendall 1984.

    Examples
    --------
    >>> shape = np.array([0.0, 1.0, 1.0j])
    >>> fit = fit_pose(2.0 + 1j * shape, shape, np.ones(3))  # turned by 90 degrees
    >>> print(fit.position.round(9), np.degrees(fit.angle).round(9))
    (2+0j) 90.0

    """
    return fit_pose_with_factors(points, procrustes_factors(shape, weights))


def procrustes_factors(shape: Complex, weights: Real) -> ProcrustesFactors:
    """What `fit_pose` needs of the shape (..., n), complex, m, and the weights (..., n) alone."""
    seen = weights > 0
    total = weights.sum(axis=-1)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        mean_factor = weights / total[..., None]
        mean = (mean_factor * np.where(seen, shape, 0)).sum(axis=-1)
        arms = np.where(seen, shape - mean[..., None], np.nan)
        square = np.where(seen, weights * (arms.real**2 + arms.imag**2), 0)
        spread = square.sum(axis=-1)
        # The translation absorbs 2 w / sum(weights) of a residual, the rotation w |arm|^2 / spread.
        absorbed = 2 * mean_factor + square / spread[..., None]
        weight = 1 / (1 / total + (mean.real**2 + mean.imag**2) / spread)
    return ProcrustesFactors(
        seen,
        arms,
        mean_factor,
        turn_factor=np.where(seen, weights * arms.conj(), 0),
        mean=mean,
        distinct=_are_distinct(arms, mean, seen),
        freedom=np.where(seen, np.maximum(2 - absorbed, 0), 0),
        spread=spread,
        weight=weight,
    )


def fit_pose_with_factors(points: Complex, factors: ProcrustesFactors) -> Fit:
    """Fit poses as `fit_pose` does, for many points (..., n), complex, m, of one shape."""
    points = np.where(factors.seen, points, 0)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        points_mean = np.add.reduce(factors.mean_factor * points, -1)
        arms = points - points_mean[..., None]
        cross = np.add.reduce(factors.turn_factor * arms, -1)
        length = np.abs(cross)
        # Zero but for rounding: no rotation is best, as for an equilateral triangle and its mirror.
        largest = np.add.reduce(np.abs(factors.turn_factor) * np.abs(arms), -1)
        is_fitted = factors.distinct & _are_distinct(arms, points_mean, factors.seen)
        is_fitted &= length > ROUNDING * largest
        turn = np.where(is_fitted, cross / length, np.nan)
        position = points_mean - turn * factors.mean
    residual = arms * turn.conj()[..., None] - factors.arms
    # Filled instead of broadcast, which takes a live node longer.
    freedom = np.empty(points.shape)
    spread, weight = np.empty(points_mean.shape), np.empty(points_mean.shape)
    freedom[...], spread[...], weight[...] = factors.freedom, factors.spread, factors.weight
    return Fit(position, np.arctan2(turn.imag, turn.real), residual, freedom, spread, weight)


def _are_distinct(arms: Complex, mean: Complex, seen: np.ndarray) -> np.ndarray:
    """Whether some point that is seen is farther from the mean than rounding."""
    farthest = np.maximum.reduce(np.abs(arms), -1, where=seen, initial=0.0)
    return np.asarray(farthest > ROUNDING * np.abs(mean))
