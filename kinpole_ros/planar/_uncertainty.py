"""
First-order uncertainty of quantities computed from a pose and its derivatives.

Every quantity of this package is a function of a body's reference point z (complex, m), its angle
(rad) and their time derivatives. `Linear` holds the value with its partial derivatives, and
`covariance` and `variance` propagate the covariance of the pose through them.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real


class Linear(NamedTuple):
    """
    A quantity with its partial derivatives by the derivatives of a pose.

    The first-order change of the value is sum(by_position * dz) + sum(by_angle * dangle), where
    dz = d(position[position_orders]) and dangle = d(angle[angle_orders]). Of a real quantity it is
    the real part of that sum.

    Attributes
    ----------
    value
        Of shape (...); complex for a vector of the plane, real for a number.
    by_position, by_angle
        Partial derivatives (n, ...), complex, one for each order of the two slices.
    position_orders, angle_orders
        Orders of time derivative on which the value depends.

    """

    value: Complex
    by_position: Complex
    by_angle: Complex
    position_orders: slice
    angle_orders: slice


def covariance(linear: Linear, position_covariance: Real, angle_covariance: Real) -> Real:
    """
    Covariance of a vector quantity, to first order.

    Parameters
    ----------
    linear
        The quantity (...) with its partial derivatives.
    position_covariance
        Between the orders of derivative of one coordinate of the reference point (K, K, ...), in
        SI units. Both coordinates have the same covariance and are independent.
    angle_covariance
        Between the orders of derivative of the angle (K, K, ...), in SI units.

    Returns
    -------
    ndarray
        Of shape (..., 2, 2), in the quantity's unit squared.

    Notes
    -----
    J C J^T with the Jacobian J. An isotropic error stays isotropic under a complex factor, so the
    position contributes a multiple of the unit matrix.

    """
    _, by_position, by_angle, p, a = linear
    by = _components(by_angle)
    result = np.einsum('km...,xk...,ym...->...xy', angle_covariance[a, a], by, by)
    isotropic = mean_square(by_position, position_covariance[p, p])
    result[..., 0, 0] += isotropic
    result[..., 1, 1] += isotropic
    return result


def variance(linear: Linear, position_covariance: Real, angle_covariance: Real) -> Real:
    """
    Variance of a real quantity, to first order.

    Parameters
    ----------
    linear
        The quantity (...) with its partial derivatives.
    position_covariance, angle_covariance
        As in `covariance`.

    Returns
    -------
    ndarray
        Of shape (...), in the quantity's unit squared.

    """
    _, by_position, by_angle, p, a = linear
    by = by_angle.real
    from_angle = np.einsum('km...,k...,m...->...', angle_covariance[a, a], by, by)
    return np.asarray(from_angle + mean_square(by_position, position_covariance[p, p]))


def mean_square(factors: Complex, matrix: Real) -> Real:
    """
    Mean square (...) of one coordinate of sum(factors * e), for isotropic errors e of the plane.

    `matrix` (n, n, ...) is the covariance of either coordinate of the errors.
    """
    by = _components(factors)
    return np.asarray(np.einsum('km...,xk...,xm...->...', matrix, by, by))


def _components(factors: Complex) -> Real:
    return np.array((factors.real, factors.imag))
