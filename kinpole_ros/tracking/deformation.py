"""
Bodies that are not rigid: what markers that move against each other do to the results.

Soft tissue wobbles, a lens bends what it sees, a loose marker moves with the motion. All of that is
slow, so no noise accounts for it, and part of it looks like a motion of the body: of the 2n
coordinates of n markers a rigid fit takes three and leaves 2n - 3. What it leaves can be seen, and
what it takes has as much error per degree of freedom, with the same spectrum. So residuals are
differentiated by stencils of the span and degree by which the poses are, about the same instant.
Their mean squares, less those of the noise, are variances of the derivatives.
"""

from functools import lru_cache
from math import factorial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.statistics import chi_square, student

# The cause of residuals that are slow, as `Tracker.causes` has it.
TISSUE = 'tissue'
# Stencils apart by this share of their length have independent errors; nearer ones, by the other,
# are looked at, from this many windows before the window on.
INDEPENDENT, APART, EARLIER = 1 / 2, 1 / 8, 1 / 2
# Lengths of stencils are powers of this, and their degrees in this range.
LADDER = 1 + APART
DEGREES = 2, 8
# A body is deformed where residuals change more than noise by this many standard deviations.
SIGMAS = 4.0


def hold_hidden(residual: Complex) -> Complex:
    """Residuals (N, B, n) with those of hidden markers as they were last, 0 before the first."""
    hidden = np.isnan(residual)
    if not hidden.any():
        return residual
    row = np.where(hidden, -1, np.arange(len(residual))[:, None, None])
    row = np.maximum.accumulate(row, axis=0)
    found = np.take_along_axis(residual, np.maximum(row, 0), axis=0)
    return np.where(row < 0, 0, found)


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
        Factor by which noise counts for more, where hidden markers are held where they were.

    """
    count = max(4, half_window)
    bodies = residual.shape[1]
    seen = ~np.isnan(residual)
    free = freedom.max(axis=0, initial=0.0)
    if len(residual) < 2 * count:
        return np.zeros(bodies), np.ones(bodies)
    row = stencils(count, (count - 1) // 2, 1, 1)[1]
    # By blas, one marker after the other: an einsum of windows is ten times slower.
    rates = sliding_window_view(hold_hidden(residual), count, axis=0) @ row
    squares = (rates.real**2 + rates.imag**2).sum(axis=-1)
    there = seen.any(axis=-1)[count - 1 :]
    share = seen.sum(axis=-1)[count - 1 :] / np.maximum(seen.any(axis=0).sum(axis=-1), 1)
    frames = there.sum(axis=0)
    with np.errstate(divide='ignore', invalid='ignore'):
        held = np.where(frames > 0, 2 * frames / share.sum(axis=0) - 1, 1.0)
        sure = chi_square(free * frames / (INDEPENDENT * count), SIGMAS)
        sure = sure / chi_square(degrees, -SIGMAS)
        most = frames * free * (row @ row) * held * noise**2 * sure
        deformed = np.where(there, squares, 0.0).sum(axis=0) > most
    return np.where(deformed, free, 0.0), held


def deformation_covariance(
    residual: Complex,
    now: int,
    oldest: int,
    interval: float,
    span: float,
    degree: float,
    noise: float,
    freedom: float,
    order: int,
) -> Real:
    """
    Covariance (K, K) of derivatives of the slow residuals of one body, (m/s^k)^2, K = order + 1.

    That of one coordinate, per degree of freedom.

    Parameters
    ----------
    residual : array, shape (N, n), complex, m
        Residuals up to the newest of the window, hidden markers held.
    now, oldest : int
        Rows of the instant and of the oldest frame of the window.
    interval, span : float, s
        Mean interval of the frames, and length of the stencils.
    degree : float
        Degree of the stencils.
    noise : float, m
        Standard deviation of a coordinate.
    freedom : float
        As `deformed_freedom` returns it.
    order : int
        The highest derivative.

    """
    newest = len(residual) - 1
    held = newest - oldest
    found = np.zeros((order + 1, order + 1))
    if not (np.isfinite(span) and held > DEGREES[0] + 1):
        return found
    degree = max(degree, DEGREES[0])
    integer = min(round(degree), DEGREES[1])
    # One of a lower degree that is shorter by as much follows as fast a motion.
    length = (span / interval + 1) * (integer + 1) / (degree + 1)
    length = LADDER ** np.rint(np.log(length) / np.log(LADDER))
    integer = min(integer, held - 2)
    count = int(np.clip(np.rint(length), integer + 2, held))
    rows = stencils(count, min((count - 1) // 2, newest - now), integer, order)
    step = max(1, round(APART * count))
    first = max(oldest - round(EARLIER * held), 0)
    part = residual[first + (newest - count - first) % step : newest]
    derived = sliding_window_view(part, count, axis=0)[::step] @ rows.T
    looked = len(derived)
    products = np.einsum('tni,tnj->ij', derived.conj(), derived).real
    mean = products / (looked * freedom)
    squares = np.diag(mean)
    white = noise**2 * (rows**2).sum(axis=1)
    with np.errstate(divide='ignore', invalid='ignore'):
        share = np.sqrt(np.where(squares > white, 1 - white / squares, 0.0))
    independent = 1 + (looked - 1) * step / (INDEPENDENT * count)
    share *= np.sqrt(student(np.asarray(freedom * independent)))
    share /= interval ** np.arange(order + 1.0)
    return np.asarray(share[:, None] * share * mean)


@lru_cache(maxsize=512)
def stencils(count: int, ahead: int, degree: int, order: int) -> Real:
    """
    Rows (order + 1, count) that differentiate samples at steps of 1, `ahead` before the last.

    By local polynomials of `degree`, or of the order of the derivative where that is higher.
    """
    places = (np.arange(count) - (count - 1 - ahead)) / count
    rows = []
    for k in range(order + 1):
        basis = np.vander(places, min(max(degree, k), count - 1) + 1, increasing=True)
        row = np.linalg.pinv(basis)[k] if k < count else np.zeros(count)
        rows.append(row * factorial(k) / float(count) ** k)
    return np.array(rows)
