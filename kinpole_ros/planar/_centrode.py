"""The ICR as it wanders: its velocity along the centrodes and the centrodes' curvature."""

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._linear import Linear
from kinpole_ros.planar._plane import Complex, Real, check_vectors, to_complex, to_plane


def icr_velocity(position: Complex, angle: Real) -> Linear:
    """
    Velocity u of the ICR along both centrodes (m/s), seed 000 'centrode velocity', seed 001 eq. 15.

    `position` (K, ...) complex and `angle` (K, ...) hold reference point and angle with their
    derivatives, K > 2. Not finite where the body does not turn.
    """
    v, acc, w, a = position[1], position[2], angle[1], angle[2]
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        # Not 1j / w: of one body alone w is a number, and Python refuses to divide 1j by 0.
        q = 1 / w
        value = v + 1j * acc * q - 1j * v * a * q**2
        by_position = {1: 1 - 1j * a * q**2, 2: 1j * q}
        by_angle = {1: -1j * acc * q**2 + 2j * v * a * q**3, 2: -1j * v * q**2}
    return Linear(value, by_position, by_angle)


def icr_acceleration(position: Complex, angle: Real) -> Linear:
    """Second time derivative of the ICR (m/s^2), seed 000. Shapes as in `icr_velocity`, K > 3."""
    v, acc, jerk = position[1], position[2], position[3]
    w, a, j = angle[1], angle[2], angle[3]
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        q = 1 / w
        value = acc + 1j * jerk * q - (2j * acc * a + 1j * v * j) * q**2 + 2j * v * a**2 * q**3
        by_position = {1: -1j * j * q**2 + 2j * a**2 * q**3, 2: 1 - 2j * a * q**2, 3: 1j * q}
        by_angle = {
            1: -1j * jerk * q**2 + (4j * acc * a + 2j * v * j) * q**3 - 6j * v * a**2 * q**4,
            2: -2j * acc * q**2 + 4j * v * a * q**3,
            3: -1j * v * q**2,
        }
    return Linear(value, by_position, by_angle)


def centrode_curvature(position: Complex, angle: Real) -> Linear:
    """
    Signed curvature of the fixed centrode (1/m), positive where it turns left along u, seed 000.

    In a mechanism of one degree of freedom it does not depend on the speed. Shapes as in
    `icr_velocity`, K > 3. Not finite where the ICR stands still.
    """
    u = icr_velocity(position, angle)
    du = icr_acceleration(position, angle)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        speed = np.abs(u.value)
        value = (np.conj(u.value) * du.value).imag / speed**3
        # With k = Im(conj(u) du) / |u|^3, a change of u and du changes k by the real part of
        # by_u * change of u + by_du * change of du.
        by_u = 1j * np.conj(du.value) / speed**3 - 3 * value * np.conj(u.value) / speed**2
        by_du = -1j * np.conj(u.value) / speed**3
        zero = np.zeros_like(u.value)
        by_position, by_angle = (
            {
                k: by_u * first.get(k, zero) + by_du * second.get(k, zero)
                for k in second.keys() | first.keys()
            }
            for first, second in ((u.by_position, du.by_position), (u.by_angle, du.by_angle))
        )
    return Linear(value, by_position, by_angle)


def moving_centrode_curvature(fixed: Real, omega: Real, speed: Real) -> Real:
    """
    Signed curvature (1/m) of the moving centrode where it touches the fixed one.

    `fixed` is the curvature of the fixed centrode (1/m), `omega` the rate of the body (rad/s),
    `speed` the speed of the ICR along the centrodes (m/s). The two differ by omega / speed, since
    in the body's frame the tangent turns by omega less (seed 001, eq. 15 and 16).
    """
    return np.asarray(fixed - omega / speed)


def moving_centrode(icr: ArrayLike, reference: ArrayLike, angle: ArrayLike) -> Real:
    """
    The ICR as seen from the body: where it is on the moving centrode (m), shape (..., 2).

    `icr` and `reference` (..., 2) are the ICR and the body's reference point in the ground frame,
    `angle` (...) is the body's angle in rad. Seed 000, 'moving centrode'.
    """
    arm = to_complex(check_vectors(icr, 'icr')) - to_complex(check_vectors(reference, 'reference'))
    return to_plane(arm * np.exp(-1j * np.asarray(angle, float)))
