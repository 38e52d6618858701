"""
Poles, velocity and curvature of centrodes with their covariances, compiled, as the pipeline needs.

`pole`, `icr_velocity` and `centrode_curvature` give the same with all their derivatives.
"""

from ctypes import c_int, c_longlong, c_void_p

import numpy as np

from kinpole_ros.compiled import library, pass_array
from kinpole_ros.planar._plane import Complex, Real

_kinpole_figures = library.kinpole_figures
_kinpole_figures.argtypes = [c_int, c_longlong, c_longlong, *[c_void_p] * 7]
_kinpole_figures.restype = None
# As _kernel.c numbers what it makes; poles have their order.
_VELOCITY, _CURVATURE = 5, 6


def pole_figures(
    order: int, position: Complex, angle: Real, position_covariance: Real, angle_covariance: Real
) -> tuple[Complex, Real, Real]:
    """
    The pole of a body and how well it is known.

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
    return _compiled(order, position, angle, position_covariance, angle_covariance)


def velocity_figures(
    position: Complex, angle: Real, position_covariance: Real, angle_covariance: Real
) -> tuple[Complex, Real]:
    """
    The velocity of the ICR and how well it is known.

    Parameters
    ----------
    position, angle, position_covariance, angle_covariance
        As for `pole_figures`, from order 0 to 2 and more.

    Returns
    -------
    tuple
        The velocity (...), complex, m/s, and its covariance (..., 2, 2).
    """
    return _compiled(_VELOCITY, position, angle, position_covariance, angle_covariance)[:2]


def curvature_figures(
    position: Complex, angle: Real, position_covariance: Real, angle_covariance: Real
) -> tuple[Real, Real]:
    """
    The curvature of the fixed centrode and how well it is known.

    Parameters
    ----------
    position, angle, position_covariance, angle_covariance
        As for `pole_figures`, from order 0 to 3 and more.

    Returns
    -------
    tuple
        The curvature (...), 1/m, and its variance (...).
    """
    value, spread, _ = _compiled(_CURVATURE, position, angle, position_covariance, angle_covariance)
    return value.real, spread[..., 0, 0]


def _compiled(
    what: int, position: Complex, angle: Real, of_position: Real, of_angle: Real
) -> tuple[Complex, Real, Real]:
    orders, *shape = angle.shape
    needed = {_VELOCITY: 2, _CURVATURE: 3}.get(what, what)
    covariances = (orders, *angle.shape)
    if not 1 <= needed < orders <= 5 or not (
        position.shape == angle.shape and of_position.shape == of_angle.shape == covariances
    ):
        raise ValueError(
            f'orders 0 to {needed} of position and angle and their covariances, of one shape, are '
            f'needed; shapes are {position.shape}, {angle.shape}, {of_position.shape}, '
            f'{of_angle.shape}'
        )
    value, spread, sure = np.empty(shape, complex), np.empty((*shape, 2, 2)), np.empty(shape)
    _kinpole_figures(
        what,
        sure.size,
        orders,
        pass_array(position, complex),
        *map(pass_array, (angle, of_position, of_angle)),
        pass_array(value, complex),
        *map(pass_array, (spread, sure)),
    )
    return value, spread, sure
