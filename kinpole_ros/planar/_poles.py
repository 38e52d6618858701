"""
Poles of any order, and the motion of any point of a body.

A body is given by its reference point z and its angle with their derivatives. A point P fixed to
the body has the n-th derivative z(n) + a_n (P - z), where a_n is the n-th derivative of
exp(i angle) over exp(i angle): the seeds' wR, B, H and G (seed 000). The pole of order n is where
that vanishes.
"""

from math import comb

import numpy as np

from kinpole_ros.planar._linear import Linear
from kinpole_ros.planar._plane import Complex, Real, complex_of


def rotation_coefficient(order: int, angle: Real) -> Complex:
    """
    The n-th derivative of the points of a turning body, per m from the pole of that order.

    Parameters
    ----------
    order
        1 to 4.
    angle
        Angle with its derivatives (K, ...), rad, K > order.

    Returns
    -------
    ndarray
        a_n (...), complex, 1/s^order.

    Notes
    -----
    Seed 000: w R, B = a R - w^2, H and G.

    """
    w = np.asarray(angle[1])
    if order == 1:
        return complex_of(0.0, w)
    # Not w**3 nor w**4, which take the time of a logarithm.
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
    `rotation_coefficient`, and its partial derivatives by those of the angle.

    Parameters
    ----------
    order
        1 to 4.
    angle
        Angle with its derivatives (K, ...), rad, K > order.

    Returns
    -------
    value : ndarray
        Of shape (...), complex, 1/s^order.
    partials : ndarray
        By the 1st to n-th derivative of the angle (order, ...): by the k-th it is i times n choose
        k times the coefficient of order n - k, of which a_0 is 1.

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
        1 to 4 for ICR to ISP.
    position, angle
        Reference point (K, ...), complex, m, and angle (K, ...), rad, with their derivatives,
        K > order.
    turn
        What `rotation` gives, if it was asked before.

    Returns
    -------
    Linear
        In m, complex (...), in the frame of `position`; not finite where the body does not turn.

    Notes
    -----
    r - (wR)^-1 v and its like, seed 000.

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
    Where a point fixed to a body is, or a derivative of it, with its dependence on the pose.

    Parameters
    ----------
    order
        0 for the place, or which derivative, 1 to 4.
    arm
        From the reference point (...), complex, m, in the body's frame.
    position, angle
        Reference point (K, ...), complex, m, and angle (K, ...), rad, with their derivatives,
        K > order.

    Returns
    -------
    Linear
        In m/s^order, complex (...), in the frame of `position`.

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
    A derivative of the body's point that is now at `point`.

    Parameters
    ----------
    order
        Which derivative, 1 to 4.
    point
        Where the point is (...), complex, m.
    position, angle
        Reference point (K, ...), complex, m, and angle (K, ...), rad, with their derivatives,
        K > order.

    Returns
    -------
    ndarray
        Of shape (...), complex, m/s^order, in the frame of `position`.

    Notes ----- Written with the reference point, so that it holds for a body that does not turn as
    well; where it turns this is a_n (P - pole of order n), the form of seed 000.

    """
    return np.asarray(position[order] + rotation_coefficient(order, angle) * (point - position[0]))
