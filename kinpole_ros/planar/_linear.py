"""
Uncertainty of what is computed from a pose and its derivatives, to first order.

Every quantity of this package is a function of the derivatives of a body's reference point z
(complex, m) and of its angle (rad). A `Linear` carries the quantity along with its partial
derivatives by each of these, so one rule serves them all.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real


class Linear(NamedTuple):
    """
    A quantity and its first-order dependence on the derivatives of a pose.

    `value` has shape (...), complex for a vector of the plane and real for a number. The change of
    the value is the sum of by_position * dz and of by_angle * dangle, (n, ...) each, over the
    orders of derivative that `position_orders` and `angle_orders` choose of the pose's (K, ...);
    where the value is real, the real part of that sum.
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
        The quantity (...), and how it depends on the pose.
    position_covariance
        Between the orders of derivative of one axis of the reference point (K, K, ...), in SI
        units; both axes have the same, and are independent.
    angle_covariance
        The same of the angle (K, K, ...).

    Returns
    -------
    ndarray
        Of shape (..., 2, 2), in the quantity's unit squared.

    Notes ----- A circular error stays circular under a complex factor, so the share of the position
    is a multiple of the unit matrix.

    """
    _, by_position, by_angle, p, a = linear
    by = _axes(by_angle)
    result = np.einsum('km...,xk...,ym...->...xy', angle_covariance[a, a], by, by)
    even = mean_square(by_position, position_covariance[p, p])
    result[..., 0, 0] += even
    result[..., 1, 1] += even
    return result


def variance(linear: Linear, position_covariance: Real, angle_covariance: Real) -> Real:
    """
    Variance of a real quantity, to first order.

    Parameters
    ----------
    linear
        The quantity (...), and how it depends on the pose.
    position_covariance, angle_covariance
        As in `covariance`.

    Returns
    -------
    ndarray
        Of shape (...), in the quantity's unit squared.

    """
    _, by_position, by_angle, p, a = linear
    by = by_angle.real
    of_angle = np.einsum('km...,k...,m...->...', angle_covariance[a, a], by, by)
    return np.asarray(of_angle + mean_square(by_position, position_covariance[p, p]))


def mean_square(factors: Complex, matrix: Real) -> Real:
    """
    Mean square of the sum of factors[k] e[k].

    Parameters
    ----------
    factors
        Of shape (n, ...), complex.
    matrix
        Covariances of the errors e (n, n, ...).

    Returns
    -------
    ndarray
        Of shape (...): of errors equal on both axes that of either axis of the sum, and of its real
        part.

    """
    by = _axes(factors)
    return np.asarray(np.einsum('km...,xk...,xm...->...', matrix, by, by))


def _axes(factors: Complex) -> Real:
    return np.array((factors.real, factors.imag))
