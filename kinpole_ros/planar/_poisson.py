"""
Poisson's decomposition: translation with a point A of the body plus rotation about A (seed 001).

Vectors have shape (..., 2) and are in the ground's axes; rates have shape (...). w x r is the
vector r rotated by +90 degrees, times w.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._plane import Real, check_vectors


def relative_velocity(omega: ArrayLike, r_ba: ArrayLike) -> Real:
    """
    Velocity of a point B of a body relative to its point A.

    Parameters
    ----------
    omega
        Angular velocity (...), rad/s.
    r_ba
        From A to B (..., 2), m.

    Returns
    -------
    ndarray
        w x r_BA, of shape (..., 2), m/s. The velocity of B is that of A plus this.

    Notes
    -----
    Seed 001, eq. 2 and 3.

    """
    return _cross(omega, check_vectors(r_ba, 'r_ba'))


def relative_acceleration(omega: ArrayLike, alpha: ArrayLike, r_ba: ArrayLike) -> Real:
    """
    Acceleration of a point B of a body relative to its point A.

    Parameters
    ----------
    omega, alpha
        Angular velocity and acceleration (...), rad/s and rad/s^2.
    r_ba
        From A to B (..., 2), m.

    Returns
    -------
    ndarray
        a x r_BA + w x (w x r_BA), of shape (..., 2), m/s^2.

    Notes
    -----
    Seed 001, eq. 4.

    """
    r = check_vectors(r_ba, 'r_ba')
    return _cross(alpha, r) + _cross(omega, _cross(omega, r))


def transport(derivative_a: ArrayLike, omega_ab: ArrayLike, vector: ArrayLike) -> Real:
    """
    Time derivative of a vector as seen from space b, from that as seen from space a.

    Parameters
    ----------
    derivative_a
        Derivative as seen from a (..., 2), per s.
    omega_ab
        Angular velocity of a with respect to b (...), rad/s.
    vector
        The vector (..., 2), in the axes of its derivatives.

    Returns
    -------
    ndarray
        derivative_a + omega_ab x vector, of shape (..., 2), per s, in the same axes.

    Notes
    -----
    Seed 001, eq. 16.

    """
    return check_vectors(derivative_a, 'derivative_a') + _cross(
        omega_ab, check_vectors(vector, 'vector')
    )


def pole_from_reference(v_a: ArrayLike, omega: ArrayLike) -> Real:
    """
    Vector from a point A of the body to its pole (ICR).

    Parameters
    ----------
    v_a
        Velocity of A (..., 2), m/s.
    omega
        Angular velocity (...), rad/s.

    Returns
    -------
    ndarray
        w x v_A / w^2, of shape (..., 2), m. NaN where omega is 0.

    Notes
    -----
    Seed 001, eq. 21.

    """
    return _cross(1 / _nonzero(omega), check_vectors(v_a, 'v_a'))


def moving_centrode_from_reference(v_a: ArrayLike, omega: ArrayLike, angle: ArrayLike) -> Real:
    """
    Vector from A to the pole in the body's axes. Its path is the moving centrode.

    Parameters
    ----------
    v_a
        Velocity of A (..., 2), m/s.
    omega
        Angular velocity (...), rad/s.
    angle
        Angle of the body's axes (...), rad.

    Returns
    -------
    ndarray
        Of shape (..., 2), m. NaN where omega is 0.

    Notes
    -----
    Seed 001, eq. 22.

    """
    arm = pole_from_reference(v_a, omega)
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = arm[..., 0], arm[..., 1]
    return np.stack((cosine * x + sine * y, cosine * y - sine * x), axis=-1)


def fixed_centrode_from_reference(r_a: ArrayLike, v_a: ArrayLike, omega: ArrayLike) -> Real:
    """
    Position of the pole in the ground's frame. Its path is the fixed centrode.

    Parameters
    ----------
    r_a, v_a
        Position and velocity of A (..., 2), m and m/s.
    omega
        Angular velocity (...), rad/s.

    Returns
    -------
    ndarray
        Of shape (..., 2), m. NaN where omega is 0.

    Notes
    -----
    Seed 001, eq. 23.

    """
    return check_vectors(r_a, 'r_a') + pole_from_reference(v_a, omega)


def centrode_velocities(
    v_a: ArrayLike, a_a: ArrayLike, omega: ArrayLike, alpha: ArrayLike
) -> tuple[Real, Real]:
    """
    Velocities of the pole along the fixed and along the moving centrode.

    Parameters
    ----------
    v_a, a_a
        Velocity and acceleration of A (..., 2), m/s and m/s^2.
    omega, alpha
        Angular velocity and acceleration (...), rad/s and rad/s^2.

    Returns
    -------
    fixed, moving : ndarray
        Of shape (..., 2), m/s. NaN where omega is 0.

    Notes
    -----
    Seed 001: the first is the derivative of eq. 23, the second that of eq. 22 by eq. 16. They are
    computed independently, and are equal by eq. 15.

    """
    w = _nonzero(omega)
    arm = pole_from_reference(v_a, omega)
    # Derivative of eq. 21, in the ground's axes.
    arm_rate = (
        _cross(1 / w, check_vectors(a_a, 'a_a')) - arm * (np.asarray(alpha, float) / w)[..., None]
    )
    return check_vectors(v_a, 'v_a') + arm_rate, transport(arm_rate, -w, arm)


def _nonzero(omega: ArrayLike) -> Real:
    w = np.asarray(omega, float)
    return np.where(w == 0, np.nan, w)


def _cross(omega: ArrayLike, vector: Real) -> Real:
    turned = np.stack((-vector[..., 1], vector[..., 0]), axis=-1)
    return np.asarray(omega, float)[..., None] * turned
