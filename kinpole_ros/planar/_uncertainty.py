"""
First-order uncertainty of quantities computed from a pose and its derivatives.

Every quantity of this package is a function of a body's reference point z (complex, m), its angle
(rad) and their time derivatives. `Linear` holds the value with its partial derivatives, and
`covariance` and `variance` propagate the covariance of the pose through them. `pole_figures`,
`velocity_figures` and `curvature_figures` do both steps at once in compiled code, for the tracker.
"""

from ctypes import c_int, c_longlong, c_void_p
from typing import NamedTuple

import numpy as np

from kinpole_ros.compiled import library, pass_array
from kinpole_ros.planar._plane import Complex, Real

_kinpole_figures = library.kinpole_figures
_kinpole_figures.argtypes = [c_int, c_longlong, c_longlong, *[c_void_p] * 7]
_kinpole_figures.restype = None
# The quantities of _kernel.c; 1 to 4 are the poles of these orders.
_VELOCITY, _CURVATURE = 5, 6


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
    Mean square of one coordinate of sum(factors * e), for errors e of the plane.

    Parameters
    ----------
    factors
        Of shape (n, ...), complex.
    matrix
        Covariance (n, n, ...) of either coordinate of the errors, which are independent.

    Returns
    -------
    ndarray
        Of shape (...). It is the same for both coordinates.

    """
    by = _components(factors)
    return np.asarray(np.einsum('km...,xk...,xm...->...', matrix, by, by))


def _components(factors: Complex) -> Real:
    return np.array((factors.real, factors.imag))


def pole_figures(
    order: int, position: Complex, angle: Real, position_covariance: Real, angle_covariance: Real
) -> tuple[Complex, Real, Real]:
    """
    Pole of a body with its covariance: `pole` and `covariance`, compiled.

    Parameters
    ----------
    order
        1 to 4 for ICR, IAP, IJP and ISP.
    position, angle
        Reference point (K, ...), complex, m, and angle (K, ...), rad, with their derivatives;
        order < K <= 5.
    position_covariance, angle_covariance
        As in `covariance`.

    Returns
    -------
    pole : ndarray
        Of shape (...), complex, m.
    covariance : ndarray
        Of shape (..., 2, 2), m^2.
    significance : ndarray
        Magnitude of the rotation coefficient of that order over its standard deviation (...); see
        `rotation`.

    Raises
    ------
    ValueError
        If the shapes do not fit each other or the order.

    """
    return _compiled(order, position, angle, position_covariance, angle_covariance)


def velocity_figures(
    position: Complex, angle: Real, position_covariance: Real, angle_covariance: Real
) -> tuple[Complex, Real]:
    """
    Velocity of the ICR with its covariance: `icr_velocity` and `covariance`, compiled.

    Parameters
    ----------
    position, angle, position_covariance, angle_covariance
        As in `pole_figures`; 3 <= K <= 5.

    Returns
    -------
    velocity : ndarray
        Of shape (...), complex, m/s.
    covariance : ndarray
        Of shape (..., 2, 2), m^2/s^2.

    """
    return _compiled(_VELOCITY, position, angle, position_covariance, angle_covariance)[:2]


def curvature_figures(
    position: Complex, angle: Real, position_covariance: Real, angle_covariance: Real
) -> tuple[Real, Real]:
    """
    Curvature of the fixed centrode with its variance: `centrode_curvature`, compiled.

    Parameters
    ----------
    position, angle, position_covariance, angle_covariance
        As in `pole_figures`; 4 <= K <= 5.

    Returns
    -------
    curvature : ndarray
        Of shape (...), 1/m.
    variance : ndarray
        Of shape (...), 1/m^2.

    """
    value, matrix, _ = _compiled(_CURVATURE, position, angle, position_covariance, angle_covariance)
    return value.real, matrix[..., 0, 0]


def _compiled(
    quantity: int, position: Complex, angle: Real, of_position: Real, of_angle: Real
) -> tuple[Complex, Real, Real]:
    """Call the kernel, which reads as many orders as the shapes checked here say."""
    orders, *shape = angle.shape
    highest = {_VELOCITY: 2, _CURVATURE: 3}.get(quantity, quantity)
    square = (orders, *angle.shape)
    if not 1 <= highest < orders <= 5 or not (
        position.shape == angle.shape and of_position.shape == of_angle.shape == square
    ):
        raise ValueError(
            f'orders 0 to {highest} of position and angle and their covariances, of one shape, are '
            f'needed; shapes are {position.shape}, {angle.shape}, {of_position.shape}, '
            f'{of_angle.shape}'
        )
    value, matrix, significance = (
        np.empty(shape, complex),
        np.empty((*shape, 2, 2)),
        np.empty(shape),
    )
    _kinpole_figures(
        quantity,
        significance.size,
        orders,
        pass_array(position, complex),
        *map(pass_array, (angle, of_position, of_angle)),
        pass_array(value, complex),
        *map(pass_array, (matrix, significance)),
    )
    return value, matrix, significance
