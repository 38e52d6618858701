"""The pose of a body of known shape that fits its markers best, frame by frame."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import ROUNDING, Complex, Real

_TINY = np.finfo(float).tiny


class Fit(NamedTuple):
    """
    Poses of shape (...) fitted to markers, and how well they are held.

    `position` is where the origin of the body's frame is (complex, m), `angle` its turn (rad, in
    (-pi, pi]); `residual` (..., n) is marker minus fitted marker in the body's axes, NaN for none;
    `freedom` (..., n) is the expected square of each residual over the variance of one coordinate:
    2 less what the fit takes up, so that it adds up to 2n - 3 degrees of freedom. `spread` (the
    weighted sum of squares of the seen markers about their mean, m^2) and `weight` are the inverse
    variances of the angle and of the position, along the coordinate that is known least, over that
    of a coordinate of a marker.
    """

    position: Complex
    angle: Real
    residual: Complex
    freedom: Real
    spread: Real
    weight: Real


class Grip(NamedTuple):
    """
    What a fit takes of shape and weights alone, (..., n) or (...): see `grip_of`.

    `arms` lead from the weighted `mean` of the markers to each of them, NaN for those without
    weight; `share` and `pull` are their factors in the mean of the points and in their turn.
    """

    seen: np.ndarray
    arms: Complex
    share: Real
    pull: Complex
    mean: Complex
    distinct: np.ndarray
    freedom: Real
    spread: Real
    weight: Real


def grip_of(shape: Complex, weights: Real) -> Grip:
    """
    What `fit_pose` takes of shape and weights alone, to be used for many points.

    Parameters
    ----------
    shape
        Markers in the body's frame (..., n), complex, m.
    weights
        How far each counts (..., n), >= 0.

    Returns
    -------
    Grip
        What `fit_by_grip` takes.

    """
    seen = weights > 0
    total = weights.sum(axis=-1)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        share = weights / total[..., None]
        mean = (share * np.where(seen, shape, 0)).sum(axis=-1)
        arms = np.where(seen, shape - mean[..., None], np.nan)
        square = np.where(seen, weights * (arms.real**2 + arms.imag**2), 0)
        spread = square.sum(axis=-1)
        taken = 2 * share + square / spread[..., None]
        weight = 1 / (1 / total + (mean.real**2 + mean.imag**2) / spread)
    return Grip(
        seen,
        arms,
        share,
        np.where(seen, weights * arms.conj(), 0),
        mean,
        _distinct(arms, mean, seen),
        np.where(seen, np.maximum(2 - taken, 0), 0),
        spread,
        weight,
    )


def fit_pose(points: Complex, shape: Complex, weights: Real) -> Fit:
    """
    Weighted orthogonal Procrustes in the plane: the pose of a body that fits its markers best.

    Parameters
    ----------
    points
        Markers (..., n), complex, m, in the ground's frame.
    shape
        The same in the body's frame (..., n), complex, m.
    weights
        How far each counts (..., n), >= 0. A marker of weight 0 may hold anything, NaN included.

    Returns
    -------
    Fit
        Poses of shape (...); NaN where fewer than two markers have weight or all of them coincide.

    Notes
    -----
    Schoenemann 1966; complex form, Kendall 1984.

    """
    return fit_by_grip(points, grip_of(shape, weights))


def fit_by_grip(points: Complex, grip: Grip) -> Fit:
    """
    `fit_pose` by what is known of shape and weights, for many points.

    Parameters
    ----------
    points
        Of shape (..., n), complex, m, in the ground's frame.
    grip
        What `grip_of` gives, whose axes before n may be 1.

    Returns
    -------
    Fit
        Poses of shape (...).

    """
    points = np.where(grip.seen, points, 0)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        mean = np.add.reduce(grip.share * points, -1)
        arms = points - mean[..., None]
        cross = np.add.reduce(grip.pull * arms, -1)
        length = np.abs(cross)
        fitted = grip.distinct & _distinct(arms, mean, grip.seen) & (length > _TINY)
        turn = np.where(fitted, cross / length, np.nan)
        position = mean - turn * grip.mean
    residual = arms * turn.conj()[..., None] - grip.arms
    # For all points, where they are the same for all.
    freedom, spread, weight = np.empty(points.shape), np.empty(mean.shape), np.empty(mean.shape)
    freedom[...], spread[...], weight[...] = grip.freedom, grip.spread, grip.weight
    return Fit(position, np.arctan2(turn.imag, turn.real), residual, freedom, spread, weight)


def _distinct(arms: Complex, mean: Complex, seen: np.ndarray) -> np.ndarray:
    """Where points that are seen are farther from their mean than rounding."""
    farthest = np.maximum.reduce(np.abs(arms), -1, where=seen, initial=0.0)
    return np.asarray(farthest > ROUNDING * np.abs(mean))
