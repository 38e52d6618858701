"""Motion of one body as seen from another: the relative rate and the relative instant center."""

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._linear import Linear
from kinpole_ros.planar._plane import ROUNDING, Complex, Real, check_vectors


def relative_center(
    omega_j: ArrayLike, icr_j: ArrayLike, omega_i: ArrayLike, icr_i: ArrayLike
) -> Real:
    """
    Relative instant center of body j with respect to body i, seed 000, 'Relative velocity'.

    Parameters
    ----------
    omega_j, omega_i
        Angular velocities (...), rad/s.
    icr_j, icr_i
        Instant centers (..., 2), m, in the ground frame.

    Returns
    -------
    ndarray
        The center (..., 2), m, in the ground frame; NaN where both rates are equal within rounding,
        or where an ICR is NaN.

    """
    w_j, w_i = np.asarray(omega_j, float), np.asarray(omega_i, float)
    p_j, p_i = check_vectors(icr_j, 'icr_j'), check_vectors(icr_i, 'icr_i')
    difference = w_j - w_i
    rounding = 8 * np.finfo(float).eps * np.maximum(np.abs(w_j), np.abs(w_i))
    turning = np.where(np.abs(difference) > rounding, difference, np.nan)
    # Written from p_i, so that a far origin does not cost digits.
    return np.asarray(p_i + (w_j / turning)[..., None] * (p_j - p_i))


def relative_pole(
    position_j: Complex, angle_j: Real, position_i: Complex, angle_i: Real
) -> tuple[Linear, Linear]:
    """
    Relative instant center of body j with respect to body i, from both bodies' poses.

    Parameters
    ----------
    position_j, position_i
        Reference points with their derivatives (K, ...), complex, m, K > 1.
    angle_j, angle_i
        Angles with their derivatives (K, ...), rad, K > 1.

    Returns
    -------
    by_j, by_i : Linear
        The center (...), complex, m, twice: as it depends on body j and as it depends on body i;
        their covariances add. Not finite where both turn at one rate.

    Notes ----- Unlike `relative_center` it does not go through the two ICRs, so it holds where one
    of the bodies does not turn. With q = i w z - v of each body it is (q_j - q_i) / (i w_ji).

    """
    w_j, w_i = angle_j[1], angle_i[1]
    between = position_j[0] - position_i[0]
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        # Not 1j / (w_j - w_i): of one pair that is a number, and Python refuses to divide by 0.
        q = 1 / (w_j - w_i)
        arm = (w_j * between + 1j * (position_j[1] - position_i[1])) * q
        by_j, by_i = np.array((w_j * q, 1j * q)), np.array((-w_i * q, -1j * q))
        turn_j, turn_i = np.array((between - arm, arm)) * q
    center, orders = position_i[0] + arm, (slice(0, 2), slice(1, 2))
    return (
        Linear(center, by_j, turn_j[None], *orders),
        Linear(center, by_i, turn_i[None], *orders),
    )


def kennedy_residual(centers: Complex, covariance: Real) -> tuple[Real, Real]:
    """
    How far the last of three centers is from the line through the first two, signed.

    Parameters
    ----------
    centers
        Of three bodies those of ik, kj and ij (3, ...), complex, m, such as with the ground as k
        the pins of i and of j and their relative center.
    covariance
        Of each (3, ..., 2, 2), m^2.

    Returns
    -------
    distance : ndarray
        Of shape (...), m, positive to the left of the way from the first to the second; NaN where
        these are one within rounding.
    deviations : ndarray
        The same over its standard deviation (...), to first order.

    Notes
    -----
    By Kennedy's theorem it is zero, and of three centers computed from one set of velocities it is
    zero by algebra, whatever these are: such a residual cannot fail and shows nothing. The centers
    have to be found independently of each other, as the covariance takes them to be: pins from the
    poses of late, or joints' places on the bodies, and the third from velocities. With two pins on
    the ground it is the difference of the velocities that are measured of the two bodies at their
    pins, in the direction of the line, over the relative rate: it shows a pin that gives or was
    moved, a body that is not rigid, velocities that lag. Velocities across the line escape it, and
    so does a joint between i and j that is elsewhere on the line, or not there at all: that is for
    `center_offset`, or for a second line, through another body.

    """
    first, second, third = np.asarray(centers, complex)
    way = second - first
    length = np.abs(way)
    rounding = ROUNDING * np.maximum(np.abs(first), np.abs(second))
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        along = np.where(length > rounding, way, np.nan) / length
        # (share along the way) + i (distance to the left of it)
        seen = (third - first) * along.conj()
        share = seen.real / length
        weights = np.stack((1 - share, share, np.ones(np.shape(share)))) ** 2
        noise = (weights * _across(1j * along, np.asarray(covariance, float))).sum(axis=0)
        return seen.imag, seen.imag / np.sqrt(noise)


def center_offset(center: Complex, joint: Complex, covariance: Real) -> tuple[Real, Real]:
    """
    Distance of a measured relative center from the joint that it should be at.

    Parameters
    ----------
    center, joint
        Of shape (...), complex, m; `joint` is where a pin is predicted, by a linkage or by its
        place on a body.
    covariance
        The sum of both (..., 2, 2), m^2.

    Returns
    -------
    distance : ndarray
        Of shape (...), m.
    deviations : ndarray
        The same in standard deviations (...), Mahalanobis' distance: its square is on average 2
        where all is well.

    Notes
    -----
    It sees what `kennedy_residual` does not: a joint elsewhere than described, or one with play.

    """
    off = np.asarray(center, complex) - joint
    matrix = np.asarray(covariance, float)
    xx, xy, yy = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 1]
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        square = yy * off.real**2 - 2 * xy * off.real * off.imag + xx * off.imag**2
        return np.abs(off), np.sqrt(square / (xx * yy - xy**2))


def _across(normal: Complex, covariance: Real) -> Real:
    """Variances (...) along a unit vector (...), of covariances (..., 2, 2)."""
    x, y = normal.real, normal.imag
    return np.asarray(
        x**2 * covariance[..., 0, 0]
        + 2 * x * y * covariance[..., 0, 1]
        + y**2 * covariance[..., 1, 1]
    )
