"""
Errors of bodies that are not rigid, whose markers move against each other.

Soft tissue wobbles, a lens distorts, a loose marker moves. Such errors are slow, so they are no
noise, and a part of them looks like motion of the body: a rigid fit uses three of the 2n
coordinates of n markers, and leaves 2n - 3 in the residuals. Both have the same error per degree of
freedom, with the same spectrum. So the residuals are differentiated by stencils of the same span
and degree as the poses, at the same instant. Their mean squares, less those of the noise, are added
to the variances of the derivatives.
"""

from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.statistics import chi_square, student
from kinpole_ros.tracking.thresholds import N_SIGMA

# The cause of slow residuals, as `Tracker.causes` returns it.
TISSUE = 'tissue'
# Stencils have independent errors at a distance of this share of their length. They are applied at
# the second share, from so many windows before the window on.
INDEPENDENT_SHARE, STEP_SHARE, EARLIER_WINDOWS = 1 / 2, 1 / 8, 1 / 2
# Lengths of stencils are powers of this, and their degrees in this range.
LENGTH_RATIO = 1 + STEP_SHARE
DEGREES = 2, 8


def hold_hidden(residual: Complex) -> Complex:
    """Return residuals (N, B, n) with the last ones of hidden markers, 0 before the first."""
    hidden = np.isnan(residual)
    if not hidden.any():
        return residual
    row = np.where(hidden, -1, np.arange(len(residual))[:, None, None])
    row = np.maximum.accumulate(row, axis=0)
    last = np.take_along_axis(residual, np.maximum(row, 0), axis=0)
    return np.where(row < 0, 0, last)


def deformed_freedom(
    residual: Complex, freedom: Real, noise: Real, degrees: Real, half_window: int
) -> tuple[Real, Real]:
    """
    Find the bodies whose markers move against each other by more than their noise.

    Parameters
    ----------
    residual : array, shape (N, B, n), complex, m
        Residuals of fits, NaN for none.
    freedom : array, shape (N, B)
        Degrees of freedom of each fit.
    noise, degrees : array, shape (B,)
        Standard deviation of a coordinate of a marker, m, and its degrees of freedom.
    half_window : int
        Number of frames of half a window, by which residuals are smoothed.

    Returns
    -------
    array, shape (B,)
        Degrees of freedom, 2n - 3, of the residuals of deformed bodies; 0 for the others.
    array, shape (B,)
        Factor of the noise, larger if residuals of hidden markers are held.

    """
    count = max(4, half_window)
    bodies = residual.shape[1]
    seen = ~np.isnan(residual)
    free = freedom.max(axis=0, initial=0.0)
    if len(residual) < 2 * count:
        return np.zeros(bodies), np.ones(bodies)
    row = stencils(count, (count - 1) // 2, 1, 1)[1]
    # A matrix product; an einsum of windows is ten times slower.
    rates = sliding_window_view(hold_hidden(residual), count, axis=0) @ row
    squares = (rates.real**2 + rates.imag**2).sum(axis=-1)
    visible = seen.any(axis=-1)[count - 1 :]
    share = seen.sum(axis=-1)[count - 1 :] / np.maximum(seen.any(axis=0).sum(axis=-1), 1)
    frames = visible.sum(axis=0)
    with np.errstate(divide='ignore', invalid='ignore'):
        factor = np.where(frames > 0, 2 * frames / share.sum(axis=0) - 1, 1.0)
        quantile = chi_square(free * frames / (INDEPENDENT_SHARE * count), N_SIGMA)
        quantile = quantile / chi_square(degrees, -N_SIGMA)
        limit = frames * free * (row @ row) * factor * noise**2 * quantile
        deformed = np.where(visible, squares, 0.0).sum(axis=0) > limit
    return np.where(deformed, free, 0.0), factor


class ResultWindow(NamedTuple):
    """Rows of an instant and of the oldest frame of its window; mean interval of its frames, s."""

    now: int
    oldest: int
    interval: float


def deformation_covariance(
    residual: Complex,
    window: ResultWindow,
    span: float,
    degree: float,
    noise: float,
    freedom: float,
    order: int,
) -> Real:
    """
    Compute the covariance of the derivatives of the slow residuals of one body.

    Parameters
    ----------
    residual : array, shape (N, n), complex, m
        Residuals up to the newest of the window, hidden markers held.
    window : ResultWindow
        The window of the instant, in rows of the residuals.
    span, degree : float
        Length of the stencils, s, and their degree.
    noise : float, m
        Standard deviation of a coordinate.
    freedom : float
        As `deformed_freedom` returns it.
    order : int
        The highest derivative.

    Returns
    -------
    array, shape (order + 1, order + 1), (m/s^k)^2
        The covariance of one coordinate, per degree of freedom.

    """
    now, oldest, interval = window
    newest = len(residual) - 1
    frames = newest - oldest
    if not (np.isfinite(span) and frames > DEGREES[0] + 1):
        return np.zeros((order + 1, order + 1))
    count, integer = _stencil_size(frames, span / interval + 1, degree)
    rows = stencils(count, min((count - 1) // 2, newest - now), integer, order)
    step = max(1, round(STEP_SHARE * count))
    first = max(oldest - round(EARLIER_WINDOWS * frames), 0)
    part = residual[first + (newest - count - first) % step : newest]
    derived = sliding_window_view(part, count, axis=0)[::step] @ rows.T
    number = len(derived)
    products = np.einsum('tni,tnj->ij', derived.conj(), derived).real
    mean = products / (number * freedom)
    squares = np.diag(mean)
    white = noise**2 * (rows**2).sum(axis=1)
    with np.errstate(divide='ignore', invalid='ignore'):
        share = np.sqrt(np.where(squares > white, 1 - white / squares, 0.0))
    independent = 1 + (number - 1) * step / (INDEPENDENT_SHARE * count)
    share *= np.sqrt(student(np.asarray(freedom * independent)))
    share /= interval ** np.arange(order + 1.0)
    return np.asarray(share[:, None] * share * mean)


def _stencil_size(frames: int, length: float, degree: float) -> tuple[int, int]:
    """Return samples and degree of stencils for a window, about as those of `length` samples."""
    degree = max(degree, DEGREES[0])
    integer = min(round(degree), DEGREES[1])
    # A stencil of a lower degree has to be shorter to follow the same motion.
    length = length * (integer + 1) / (degree + 1)
    length = LENGTH_RATIO ** np.rint(np.log(length) / np.log(LENGTH_RATIO))
    integer = min(integer, frames - 2)
    return int(np.clip(np.rint(length), integer + 2, frames)), integer


@lru_cache(maxsize=512)
def stencils(count: int, ahead: int, degree: int, order: int) -> Real:
    """
    Return rows (order + 1, count) that differentiate samples, `ahead` samples before the last.

    Each is a local polynomial of `degree`, or of the order of its derivative if that is higher.
    """
    times = (np.arange(count) - (count - 1 - ahead)) / count
    rows = []
    for k in range(order + 1):
        basis = np.vander(times, min(max(degree, k), count - 1) + 1, increasing=True)
        row = np.linalg.pinv(basis)[k] if k < count else np.zeros(count)
        rows.append(row * factorial(k) / float(count) ** k)
    return np.array(rows)
