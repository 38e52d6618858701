"""
Uncertainty of what is computed from a pose and its derivatives, to first order.

Every quantity of this package is a function of the derivatives of a body's reference point z
(complex, m) and of its angle (rad). A `Linear` carries the quantity together with its partial
derivatives by each of these, so one rule serves them all.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real


class Linear(NamedTuple):
    """
    A quantity and its first-order dependence on the derivatives of a pose.

    `value` has shape (...), complex for a vector of the plane and real for a number. The change of
    the value is the sum of by_position[k] * dz(k) and by_angle[k] * dangle(k) over the orders k of
    the derivatives; where the value is real, the real part of that sum.
    """

    value: Complex
    by_position: Mapping[int, Complex]
    by_angle: Mapping[int, Complex]


def covariance(linear: Linear, position_covariance: Real, angle_covariance: Real) -> Real:
    """
    Covariance (..., 2, 2) of a vector quantity.

    `position_covariance` (K, K, ...) holds the covariances between the orders of derivative of one
    axis of the reference point (both axes alike, and independent); `angle_covariance` (K, K, ...)
    those of the angle. A circular error stays circular under a complex factor, so the share of the
    position is a multiple of the unit matrix.
    """
    isotropic = _quadratic(linear.by_position, position_covariance)
    result = np.empty((*np.shape(isotropic + np.abs(linear.value)), 2, 2))
    with np.errstate(invalid='ignore', over='ignore'):
        factors, applied = _applied(linear.by_angle, angle_covariance)
        for row, part in enumerate((factors.real, factors.imag)):
            for column, other in enumerate((applied.real, applied.imag)):
                if row <= column:
                    shared = (part * other).sum(axis=0)
                    result[..., row, column] = shared + (isotropic if row == column else 0.0)
    result[..., 1, 0] = result[..., 0, 1]
    return result


def variance(linear: Linear, position_covariance: Real, angle_covariance: Real) -> Real:
    """Variance (...) of a real quantity; the covariances as in `covariance`."""
    real = {k: np.asarray(g.real, complex) for k, g in linear.by_angle.items()}
    return _quadratic(linear.by_position, position_covariance) + _quadratic(real, angle_covariance)


def _quadratic(factors: Mapping[int, Complex], matrix: Real) -> Real:
    """Sum of Re(f_k conj(f_m)) matrix[k, m]."""
    if not factors:
        return np.zeros(())
    # Where a quantity is not finite its factors are not either; that is the caller's to see.
    with np.errstate(invalid='ignore', over='ignore'):
        f, applied = _applied(factors, matrix)
        return np.asarray((f.real * applied.real + f.imag * applied.imag).sum(axis=0))


def _applied(factors: Mapping[int, Complex], matrix: Real) -> tuple[Complex, Complex]:
    """Factors (n, ...) by order, and the sums over m of matrix[k, m] times f_m (n, ...)."""
    orders = list(factors)
    shape = np.broadcast_shapes(*map(np.shape, factors.values()))
    f = np.empty((len(orders), *shape), complex)
    for k, factor in enumerate(factors.values()):
        f[k] = factor
    given = matrix[orders][:, orders]
    # Axes that only one of them has come first, as numpy has it.
    lacking = f.ndim - given.ndim + 1
    if lacking > 0:
        given = given.reshape(*given.shape[:2], *lacking * (1,), *given.shape[2:])
    elif lacking < 0:
        f = f.reshape(len(f), *-lacking * (1,), *f.shape[1:])
    return f, (given * f).sum(axis=1)
