"""
Poles of a body, relative poles of two bodies, and the motion of points fixed to a body.

A body is given by a reference point z and an angle, with their time derivatives. The n-th
derivative of a point P fixed to the body is

    P(n) = z(n) + a_n (P - z),    a_n = exp(-i angle) d^n/dt^n exp(i angle),

where the rotation coefficients a_1 to a_4 are the matrices w R, B, H and G of seed 000, written as
complex numbers. The pole of order n is the point of the body where P(n) = 0.
"""

from __future__ import annotations

from math import comb

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._plane import ROUNDING, Complex, Real, check_vectors, complex_of
from kinpole_ros.planar._uncertainty import Linear


def rotation_coefficient(order: int, angle: Real) -> Complex:
    """
    Rotation coefficient a_n (...), 1/s^n, at an angle with its derivatives (K, ...), rad; n 1 to 4.

    Seed 000, pages 1 and 2, with R = i and angular velocity w, acceleration a, jerk j and snap s:

    - a_1 = i w
    - a_2 = -w^2 + i a (matrix B)
    - a_3 = -3 w a + i (j - w^3) (matrix H)
    - a_4 = w^4 - 4 w j - 3 a^2 + i (s - 6 w^2 a) (matrix G)
    """
    w = np.asarray(angle[1])
    if order == 1:
        return complex_of(0.0, w)
    # Products, since numpy computes w**3 and w**4 through logarithms.
    ww, a = w * w, angle[2]
    if order == 2:
        return complex_of(-ww, a)
    j = angle[3]
    if order == 3:
        return complex_of(-3 * w * a, j - ww * w)
    if order == 4:
        return complex_of(ww * ww - 4 * w * j - 3 * a * a, angle[4] - 6 * ww * a)
    raise ValueError(f'order must be 1 to 4, not {order}')


def rotation(order: int, angle: Real) -> tuple[Complex, Complex]:
    """
    Rotation coefficient a_n (...) and its partial derivatives (n, ...) by those of the angle.

    That by the k-th derivative of the angle is i binom(n, k) a_(n-k), a_0 = 1.
    """
    a = rotation_coefficient(order, angle)
    by_angle = np.empty((order, *a.shape), complex)
    by_angle[-1] = 1j
    for k in range(1, order):
        by_angle[k - 1] = 1j * comb(order, k) * rotation_coefficient(order - k, angle)
    return a, by_angle


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def pole(
    order: int, position: Complex, angle: Real, turn: tuple[Complex, Complex] | None = None
) -> Linear:
    """
    The point of the body whose n-th derivative vanishes: ICR, IAP, IJP or ISP.

    Parameters
    ----------
    order
        1 to 4 for ICR, IAP, IJP and ISP.
    position, angle
        Reference point (K, ...), complex, m, and angle (K, ...), rad, with their derivatives;
        K > order.
    turn
        The result of `rotation`, if it has been computed already.

    Returns
    -------
    Linear
        Of shape (...), complex, m, in the frame of `position`. Not finite where a_n = 0.

    Notes
    -----
    z - z(n) / a_n. Seed 000, pages 1 and 2: ICR = r - (w R)^-1 v, IAP = r - B^-1 acc, and so on.

    Examples
    --------
    A wheel of radius 0.5 m that rolls along the x axis has its ICR at the point of contact.

    >>> position, angle = np.array([2.0 + 0.5j, 1.0]), np.array([0.0, -2.0])
    >>> print(pole(1, position, angle).value)
    (2+0j)

    """
    a, by_turn = rotation(order, angle) if turn is None else turn
    by_position = np.empty((2, *a.shape), complex)
    by_position[0] = 1.0
    by_position[1] = inverse = -1 / a
    arm = position[order] * inverse
    by_angle = arm * inverse * by_turn
    orders = slice(0, order + 1, order), slice(1, order + 1)
    return Linear(position[0] + arm, by_position, by_angle, *orders)


def point_motion(order: int, arm: Complex, position: Complex, angle: Real) -> Linear:
    """
    The n-th derivative z(n) + a_n exp(i angle) arm of a point of a body, with partial derivatives.

    `arm` (...), complex, m, leads from the reference point to it in the body's frame; order 0 is
    its position.
    """
    turned = arm * np.exp(1j * angle[0])
    orders = slice(order, order + 1), slice(0, order + 1)
    by_angle = np.empty((order + 1, *np.shape(turned)), complex)
    if order == 0:
        by_angle[0] = 1j * turned
        value = position[0] + turned
    else:
        a, by_rates = rotation(order, angle)
        value = position[order] + a * turned
        by_angle[0], by_angle[1:] = 1j * a * turned, by_rates * turned
    return Linear(value, np.ones((1, *np.shape(turned)), complex), by_angle, *orders)


def body_point_derivative(order: int, point: Complex, position: Complex, angle: Real) -> Complex:
    """
    The n-th derivative of the body's point that coincides with `point`.

    Parameters
    ----------
    order
        1 to 4.
    point
        Of shape (...), complex, m, in the frame of `position`.
    position, angle
        Reference point (K, ...), complex, m, and angle (K, ...), rad, with their derivatives;
        K > order.

    Returns
    -------
    ndarray
        Of shape (...), complex, m/s^order, in the frame of `position`.

    Notes
    -----
    z(n) + a_n (P - z). Seed 000 writes a_n (P - pole), which fails where the body does not rotate.

    """
    return np.asarray(position[order] + rotation_coefficient(order, angle) * (point - position[0]))


def relative_center(
    omega_j: ArrayLike, icr_j: ArrayLike, omega_i: ArrayLike, icr_i: ArrayLike
) -> Real:
    """
    Relative instant center of body j with respect to body i, from both ICRs.

    Parameters
    ----------
    omega_j, omega_i
        Angular velocities (...), rad/s.
    icr_j, icr_i
        Instant centers of rotation (..., 2), m, in the ground's frame.

    Returns
    -------
    ndarray
        Of shape (..., 2), m, in the ground's frame. NaN where both angular velocities are equal
        within rounding, or where an ICR is NaN.

    Notes
    -----
    (w_j ICR_j - w_i ICR_i) / (w_j - w_i), seed 000, page 3, 'Relative velocity'.

    """
    w_j, w_i = np.asarray(omega_j, float), np.asarray(omega_i, float)
    p_j, p_i = check_vectors(icr_j, 'icr_j'), check_vectors(icr_i, 'icr_i')
    difference = w_j - w_i
    rounding = 8 * np.finfo(float).eps * np.maximum(np.abs(w_j), np.abs(w_i))
    relative_rate = np.where(np.abs(difference) > rounding, difference, np.nan)
    # Relative to ICR_i, so that an origin far away costs no digits.
    return np.asarray(p_i + (w_j / relative_rate)[..., None] * (p_j - p_i))


def relative_pole(
    position_j: Complex, angle_j: Real, position_i: Complex, angle_i: Real
) -> tuple[Linear, Linear]:
    """
    Relative instant center of body j with respect to body i, from both bodies' poses.

    Parameters
    ----------
    position_j, position_i
        Reference points with their derivatives (K, ...), complex, m; K > 1.
    angle_j, angle_i
        Angles with their derivatives (K, ...), rad; K > 1.

    Returns
    -------
    by_j, by_i : Linear
        The center (...), complex, m, twice: with its partial derivatives by the pose of body j and
        by the pose of body i. The sum of both covariances is that of the center. Not finite where
        the angular velocities are equal.

    Notes
    -----
    (q_j - q_i) / (i (w_j - w_i)) with q = i w z - v of each body. Unlike `relative_center` it does
    not need the ICRs, so it holds where one of the bodies does not rotate.

    """
    w_j, w_i = angle_j[1], angle_i[1]
    between = position_j[0] - position_i[0]
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        # 1j / (w_j - w_i) would raise ZeroDivisionError for scalars.
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
    Signed distance of the third of three centers from the line through the first two.

    Parameters
    ----------
    centers
        Relative centers of the bodies ik, kj and ij (3, ...), complex, m. With the ground as k:
        the pins of i and of j, and their relative center.
    covariance
        Of each center (3, ..., 2, 2), m^2.

    Returns
    -------
    distance : ndarray
        Of shape (...), m, positive to the left of the line from the first center to the second.
        NaN where these two coincide within rounding.
    deviations : ndarray
        The distance over its standard deviation (...), to first order.

    Notes
    -----
    The distance is zero by Kennedy's theorem (seed 003). Three centers computed from one set of
    velocities lie on a line by algebra, so the centers must be measured independently: for
    instance pins from poses, and the relative center from velocities. The residual then shows pins
    with play, bodies that are not rigid, and velocities that lag. It does not show a joint that is
    elsewhere on the line.

    """
    first, second, third = np.asarray(centers, complex)
    line = second - first
    length = np.abs(line)
    rounding = ROUNDING * np.maximum(np.abs(first), np.abs(second))
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        unit = np.where(length > rounding, line, np.nan) / length
        # Coordinates of the third center along the line and to the left of it.
        local = (third - first) * unit.conj()
        fraction = local.real / length
        weights = np.stack((1 - fraction, fraction, np.ones(np.shape(fraction)))) ** 2
        normal, matrix = 1j * unit, np.asarray(covariance, float)
        across = (
            normal.real**2 * matrix[..., 0, 0]
            + 2 * normal.real * normal.imag * matrix[..., 0, 1]
            + normal.imag**2 * matrix[..., 1, 1]
        )
        return local.imag, local.imag / np.sqrt((weights * across).sum(axis=0))
