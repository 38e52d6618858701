"""
Poisson's decomposition: translation with a reference point A plus rotation about it (seed 001).

All vectors have shape (..., 2), all rates shape (...); w x r is the vector r turned by +90 degrees
times w. A is any point of the body.
"""

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._plane import Real, check_vectors


def relative_velocity(omega: ArrayLike, r_ba: ArrayLike) -> Real:
    """Velocity of B relative to A, w x r_BA (m/s), eq. 3; with v_A it gives v_B, eq. 2."""
    return _cross(omega, check_vectors(r_ba, 'r_ba'))


def relative_acceleration(omega: ArrayLike, alpha: ArrayLike, r_ba: ArrayLike) -> Real:
    """Acceleration of B relative to A, a x r_BA + w x (w x r_BA) (m/s^2), eq. 4."""
    r = check_vectors(r_ba, 'r_ba')
    return _cross(alpha, r) + _cross(omega, _cross(omega, r))


def transport(derivative_a: ArrayLike, omega_ab: ArrayLike, vector: ArrayLike) -> Real:
    """
    The derivative of a vector seen from space b, from that seen in space a, eq. 16.

    `omega_ab` is the rate of a with respect to b. Both derivatives in the same axes.
    """
    return check_vectors(derivative_a, 'derivative_a') + _cross(
        omega_ab, check_vectors(vector, 'vector')
    )


def pole_from_reference(v_a: ArrayLike, omega: ArrayLike) -> Real:
    """The pole as seen from A, w x v_A / w^2 (m), eq. 21. NaN where the body does not turn."""
    w = np.asarray(omega, float)
    turning = np.where(w == 0, np.nan, w)
    return _cross(1 / turning, check_vectors(v_a, 'v_a'))


def moving_centrode_from_reference(v_a: ArrayLike, omega: ArrayLike, angle: ArrayLike) -> Real:
    """The pole from A in the body's axes (m), eq. 22: its locus is the moving centrode."""
    arm = pole_from_reference(v_a, omega)
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = arm[..., 0], arm[..., 1]
    return np.stack((cosine * x + sine * y, cosine * y - sine * x), axis=-1)


def fixed_centrode_from_reference(r_a: ArrayLike, v_a: ArrayLike, omega: ArrayLike) -> Real:
    """The pole in the ground's axes (m), eq. 23: its locus is the fixed centrode."""
    return check_vectors(r_a, 'r_a') + pole_from_reference(v_a, omega)


def centrode_velocities(
    v_a: ArrayLike, a_a: ArrayLike, omega: ArrayLike, alpha: ArrayLike
) -> tuple[Real, Real]:
    """
    Velocity of the pole along the fixed and along the moving centrode (m/s), ground axes.

    Both are computed by themselves, from eq. 23 and from eq. 22 with eq. 16; that they are equal
    is eq. 15. NaN where the body does not turn.
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
