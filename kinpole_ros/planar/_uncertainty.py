"""
First-order uncertainty of quantities computed from a pose and its derivatives.

Every quantity of this package is a function of a body's reference point z (complex, m), its angle
(rad) and their time derivatives. `Linear` holds the value with its partial derivatives, and
`covariance` and `variance` propagate the covariance of the pose through them. `propagate` does so
for any function, without its partial derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
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


def propagate(
    function: Callable[[Complex, Real], Complex],
    position: Complex,
    angle: Real,
    position_covariance: Real,
    angle_covariance: Real,
) -> tuple[Complex, Real]:
    """
    Value and covariance of any function of a pose and its derivatives.

    Parameters
    ----------
    function
        Returns numbers or vectors of the plane (..., *shape), complex, of poses like the following
        with axes (...) behind the first.
    position, angle
        Reference point (K, *shape), complex, m, and angle (K, *shape), rad, with their derivatives.
    position_covariance, angle_covariance
        Of them (K, K, *shape), as for `covariance`.

    Returns
    -------
    value : ndarray
        Of shape (*shape), complex.
    covariance : ndarray
        Of shape (*shape, 2, 2), in its unit squared; not finite where the function is not.

    Notes
    -----
    Differences over one standard deviation along each axis of the covariance. With the slope g and
    the bend h along an axis, the variance is g^2 + h^2 / 2, to which the square of the mean shift,
    h / 2, is added. So it is exact to first order, and to second order without the products of
    two axes.

    """
    orders, *shape = angle.shape
    place, turn = _roots(position_covariance), _roots(angle_covariance)
    count = 3 * orders
    positions, angles = (
        np.repeat(array[:, None], 2 * count + 1, axis=1) for array in (position, angle)
    )
    axes = np.zeros((orders, count, *shape), complex)
    axes[:, :orders], axes[:, orders : 2 * orders] = place, 1j * place
    for sign, first in ((1, 1), (-1, 1 + count)):
        positions[:, first : first + count] += sign * axes
        angles[:, first + 2 * orders : first + count] += sign * turn
    with np.errstate(all='ignore'):
        values = function(positions, angles)
        value, above, below = values[0], values[1 : 1 + count], values[1 + count :]
        slope, bend = _components((above - below) / 2), _components(above + below - 2 * value)
        shift = bend.sum(axis=1) / 2
        result = np.einsum('xk...,yk...->...xy', slope, slope)
        result += np.einsum('xk...,yk...->...xy', bend, bend) / 2
        return value, result + np.einsum('x...,y...->...xy', shift, shift)


def _roots(matrix: Real) -> Real:
    """Return columns (K, K, ...) whose products sum to a covariance (K, K, ...); NaN as it is."""
    matrix = np.moveaxis(matrix, (0, 1), (-2, -1))
    scale = np.sqrt(np.maximum(np.einsum('...kk->...k', matrix), 0.0))
    is_known = np.isfinite(matrix).all(axis=(-2, -1), keepdims=True)
    with np.errstate(divide='ignore', invalid='ignore'):
        even = matrix / (scale[..., :, None] * scale[..., None, :])
    values, vectors = np.linalg.eigh(np.where(np.isfinite(even), even, 0.0))
    roots = scale[..., None] * vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return np.moveaxis(np.where(is_known, roots, np.nan), (-2, -1), (0, 1))


def mean_square(factors: Complex, matrix: Real) -> Real:
    """
    Mean square (...) of one coordinate of sum(factors * e), for isotropic errors e of the plane.

    `matrix` (n, n, ...) is the covariance of either coordinate of the errors.
    """
    by = _components(factors)
    return np.asarray(np.einsum('km...,xk...,xm...->...', matrix, by, by))


def _components(factors: Complex) -> Real:
    return np.array((factors.real, factors.imag))
