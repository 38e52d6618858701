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
    a_n: the n-th derivative of the points of a turning body, per m from the pole of that order.

    `angle` (K, ...) holds the angle and its derivatives (rad, rad/s, ...), K > order; order 1 to 4.
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
    `rotation_coefficient` and its partial derivatives (n, ...) by the 1st to n-th of the angle.

    By the k-th it is i times n choose k times the coefficient of order n - k, of which a_0 is 1.
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
    The point of the body whose n-th derivative vanishes: ICR, IAP, IJP or ISP for order 1 to 4.

    `position` (K, ...) complex and `angle` (K, ...) hold the reference point and the angle with
    their derivatives, K > order; `turn` is what `rotation` gives, if it was asked before. Value in
    m, in the frame of `position`; not finite where the body does not turn. Seed 000:
    r - (wR)^-1 v and its like.
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
    A point at `arm` (m, complex, in the body's frame) from the reference point: where it is (m), or
    its derivative of order 1 to 4 (m/s^n), with its dependence on the pose. Shapes as in `pole`.
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
    The n-th derivative (m/s^n), order 1 to 4, of the body's point now at `point`.

    Written with the reference point, so that it holds for a body that does not turn as well; where
    it turns this is a_n (P - pole of order n), the form of seed 000.
    """
    return np.asarray(position[order] + rotation_coefficient(order, angle) * (point - position[0]))
