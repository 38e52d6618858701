"""
Figures with their covariances as the pipeline uses them: compiled if that could be built.

Else they are of numpy, by `pole`, `icr_velocity` and `centrode_curvature`. Both do the same:
_kernel.c says why it is there twice.
"""

from importlib import import_module
from typing import Any

import numpy as np

from kinpole_ros.planar._centrode import centrode_curvature, icr_velocity
from kinpole_ros.planar._linear import covariance, mean_square, variance
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.planar._poles import pole, rotation

_kernel: Any
try:
    _kernel = import_module('kinpole_ros.planar._kernel')
except ImportError:
    _kernel = None

# As _kernel.c numbers what it makes; poles have their order.
_VELOCITY, _CURVATURE = 5, 6


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def pole_figures(
    order: int, position: Complex, angle: Real, position_covariance: Real, angle_covariance: Real
) -> tuple[Complex, Real, Real]:
    """
    The pole of a body and how well it is known, compiled if that could be built.

    Parameters
    ----------
    order
        Of the pole, 1 to 4.
    position, angle
        Derivatives (K, ...) from order 0 on, complex, m/s^k, and rad/s^k.
    position_covariance, angle_covariance
        Those (K, K, ...) between the orders, of one coordinate.

    Returns
    -------
    tuple
        The pole (...), complex, m, its covariance (..., 2, 2), and how many standard deviations the
        body's turn of that order is (...): see `rotation`.
    """
    covariances = position_covariance, angle_covariance
    if _kernel is not None:
        return _compiled(order, position, angle, *covariances)
    turn = a, by_angle = rotation(order, angle)
    found = pole(order, position, angle, turn)
    noise = mean_square(by_angle, angle_covariance[1 : order + 1, 1 : order + 1])
    return found.value, covariance(found, *covariances), np.abs(a) / np.sqrt(noise)


def velocity_figures(
    position: Complex, angle: Real, position_covariance: Real, angle_covariance: Real
) -> tuple[Complex, Real]:
    """
    The velocity of the ICR and how well it is known, compiled if that could be built.

    Parameters
    ----------
    position, angle, position_covariance, angle_covariance
        As for `pole_figures`, from order 0 to 2 and more.

    Returns
    -------
    tuple
        The velocity (...), complex, m/s, and its covariance (..., 2, 2).
    """
    covariances = position_covariance, angle_covariance
    if _kernel is not None:
        return _compiled(_VELOCITY, position, angle, *covariances)[:2]
    found = icr_velocity(position, angle)
    with np.errstate(invalid='ignore', over='ignore'):
        return found.value, covariance(found, *covariances)


def curvature_figures(
    position: Complex, angle: Real, position_covariance: Real, angle_covariance: Real
) -> tuple[Real, Real]:
    """
    The curvature of the fixed centrode and how well it is known, compiled if that could be built.

    Parameters
    ----------
    position, angle, position_covariance, angle_covariance
        As for `pole_figures`, from order 0 to 3 and more.

    Returns
    -------
    tuple
        The curvature (...), 1/m, and its variance (...).
    """
    covariances = position_covariance, angle_covariance
    if _kernel is not None:
        value, spread, _ = _compiled(_CURVATURE, position, angle, *covariances)
        return value.real, spread[..., 0, 0]
    found = centrode_curvature(position, angle)
    with np.errstate(invalid='ignore', over='ignore'):
        return found.value.real, variance(found, *covariances)


def _compiled(
    what: int, position: Complex, angle: Real, of_position: Real, of_angle: Real
) -> tuple[Complex, Real, Real]:
    shape = angle.shape[1:]
    value, spread, sure = np.empty(shape, complex), np.empty((*shape, 2, 2)), np.empty(shape)
    _kernel.figure(
        what,
        np.ascontiguousarray(position, complex),
        np.ascontiguousarray(angle, float),
        np.ascontiguousarray(of_position, float),
        np.ascontiguousarray(of_angle, float),
        value,
        spread,
        sure,
    )
    return value, spread, sure
