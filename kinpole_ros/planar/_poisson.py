"""
Poisson's decomposition: translation with a reference point A plus rotation about it (seed 001).

All vectors have shape (..., 2), all rates shape (...); w x r is the vector r turned by +90 degrees
times w. A is any point of the body.
"""

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._plane import Real, check_vectors


def relative_velocity(omega: ArrayLike, r_ba: ArrayLike) -> Real:
    """
    Velocity of a point B of a body relative to its point A, w x r_BA.

    Parameters
    ----------
    omega
        Angular velocity (...), rad/s.
    r_ba
        From A to B (..., 2), m, in the ground's axes.

    Returns
    -------
    ndarray
        Of shape (..., 2), m/s, in the ground's axes; added to v_A it is v_B.

    Notes
    -----
    Seed 001, eq. 2 and 3.

    """
    return _cross(omega, check_vectors(r_ba, 'r_ba'))


def relative_acceleration(omega: ArrayLike, alpha: ArrayLike, r_ba: ArrayLike) -> Real:
    """
    Acceleration of a point B of a body relative to its point A, a x r_BA + w x (w x r_BA).

    Parameters
    ----------
    omega, alpha
        Angular velocity and acceleration (...), rad/s and rad/s^2.
    r_ba
        From A to B (..., 2), m, in the ground's axes.

    Returns
    -------
    ndarray
        Of shape (..., 2), m/s^2, in the ground's axes.

    Notes
    -----
    Seed 001, eq. 4.

    """
    r = check_vectors(r_ba, 'r_ba')
    return _cross(alpha, r) + _cross(omega, _cross(omega, r))


def transport(derivative_a: ArrayLike, omega_ab: ArrayLike, vector: ArrayLike) -> Real:
    """
    The derivative of a vector as seen from space b, from that as seen from space a.

    Parameters
    ----------
    derivative_a
        Derivative as seen from a (..., 2), per s.
    omega_ab
        Angular velocity of a with respect to b (...), rad/s.
    vector
        The vector (..., 2), in the same axes as its derivatives.

    Returns
    -------
    ndarray
        Derivative as seen from b (..., 2), per s, in the same axes.

    Notes
    -----
    Seed 001, eq. 16.

    """
    return check_vectors(derivative_a, 'derivative_a') + _cross(
        omega_ab, check_vectors(vector, 'vector')
    )


def pole_from_reference(v_a: ArrayLike, omega: ArrayLike) -> Real:
    """
    The pole of a body as seen from its point A, w x v_A / w^2.

    Parameters
    ----------
    v_a
        Velocity of A (..., 2), m/s, in the ground's axes.
    omega
        Angular velocity (...), rad/s.

    Returns
    -------
    ndarray
        From A to the pole (..., 2), m, in the ground's axes; NaN where the body does not turn.

    Notes
    -----
    Seed 001, eq. 21.

    """
    w = np.asarray(omega, float)
    turning = np.where(w == 0, np.nan, w)
    return _cross(1 / turning, check_vectors(v_a, 'v_a'))


def moving_centrode_from_reference(v_a: ArrayLike, omega: ArrayLike, angle: ArrayLike) -> Real:
    """
    The pole from A in the body's axes: its locus is the moving centrode.

    Parameters
    ----------
    v_a
        Velocity of A (..., 2), m/s, in the ground's axes.
    omega
        Angular velocity (...), rad/s.
    angle
        Angle of the body's axes (...), rad.

    Returns
    -------
    ndarray
        Of shape (..., 2), m; NaN where the body does not turn.

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
    The pole in the ground's axes: its locus is the fixed centrode.

    Parameters
    ----------
    r_a, v_a
        Place and velocity of A (..., 2), m and m/s, in the ground's axes.
    omega
        Angular velocity (...), rad/s.

    Returns
    -------
    ndarray
        Of shape (..., 2), m; NaN where the body does not turn.

    Notes
    -----
    Seed 001, eq. 23.

    """
    return check_vectors(r_a, 'r_a') + pole_from_reference(v_a, omega)


def centrode_velocities(
    v_a: ArrayLike, a_a: ArrayLike, omega: ArrayLike, alpha: ArrayLike
) -> tuple[Real, Real]:
    """
    Velocity of the pole along the fixed and along the moving centrode.

    Parameters
    ----------
    v_a, a_a
        Velocity and acceleration of A (..., 2), m/s and m/s^2, in the ground's axes.
    omega, alpha
        Angular velocity and acceleration (...), rad/s and rad/s^2.

    Returns
    -------
    fixed, moving : ndarray
        Of shape (..., 2), m/s, in the ground's axes; NaN where the body does not turn.

    Notes
    -----
    Each is computed by itself, from eq. 23 and from eq. 22 with eq. 16 of seed 001; that they are
    equal is eq. 15.

    """
    w = np.asarray(omega, float)
    turning = np.where(w == 0, np.nan, w)
    arm = pole_from_reference(v_a, w)
    # d/dt of eq. 21 in ground axes.
    arm_rate = (
        _cross(1 / turning, check_vectors(a_a, 'a_a'))
        - arm * (np.asarray(alpha, float) / turning)[..., None]
    )
    return check_vectors(v_a, 'v_a') + arm_rate, transport(arm_rate, -w, arm)


def _cross(omega: ArrayLike, vector: Real) -> Real:
    turned = np.stack((-vector[..., 1], vector[..., 0]), axis=-1)
    return np.asarray(omega, float)[..., None] * turned
