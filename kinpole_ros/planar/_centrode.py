"""The ICR as it wanders: its velocity along the centrodes and the centrodes' curvature."""

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._linear import Linear
from kinpole_ros.planar._plane import Complex, Real, check_vectors, to_complex, to_plane


def icr_velocity(position: Complex, angle: Real) -> Linear:
    """
    Velocity u of the ICR along both centrodes (m/s), seed 000 'centrode velocity', seed 001 eq. 15.

    `position` (K, ...) complex and `angle` (K, ...) hold reference point and angle with their
    derivatives, K > 2. Not finite where the body does not turn. With v and acc those of
    the reference point it is (w R acc - B v) / w^2.
    """
    v, acc = position[1:3]
    # Complex, lest each product converts them.
    w, a = angle[1:3] + 0j
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        q = 1 / w
        n, i_q = a * q, 1j * q
        by_position = np.array((1 - n * i_q, i_q))
        by_angle = i_q * q * np.array((2 * n * v - acc, -v))
        value = (by_position * position[1:3]).sum(axis=0)
    return Linear(value, by_position, by_angle, slice(1, 3), slice(1, 3))


def icr_acceleration(position: Complex, angle: Real) -> Linear:
    """
    Second time derivative of the ICR (m/s^2), seed 000. Shapes as in `icr_velocity`, K > 3.

    (-(w j - 2 a^2) R v + (w^3 - 2 w a R) acc + w^2 R jerk) / w^3.
    """
    v, acc, jerk = position[1:4]
    w, a, j = angle[1:4] + 0j
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        q = 1 / w
        n, m, i_q = 2 * a * q, j * q, 1j * q
        nn = n * n / 2
        by_position = np.array(((nn - m) * i_q, 1 - n * i_q, i_q))
        by_w = (2 * m - 3 * nn) * v + 2 * n * acc - jerk
        by_angle = i_q * q * np.array((by_w, 2 * (n * v - acc), -v))
        value = (by_position * position[1:4]).sum(axis=0)
    return Linear(value, by_position, by_angle, slice(1, 4), slice(1, 4))


def centrode_curvature(position: Complex, angle: Real, u: Linear | None = None) -> Linear:
    """
    Signed curvature of the fixed centrode (1/m), positive where it turns left along u, seed 000.

    In a mechanism of one degree of freedom it does not depend on the speed. Shapes as in
    `icr_velocity`, K > 3; `u` is what that gives, if it was asked before. Not finite where the ICR
    stands still.
    """
    u = icr_velocity(position, angle) if u is None else u
    du = icr_acceleration(position, angle)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        # Im(conj(u) du) / |u|^3, written as Im(g) / |u| with g = du / u. A change of u and du
        # changes g by (change of du - g * change of u) / u, and |u| by |u| Re(change of u / u).
        inverse, slowness = 1 / u.value, 1 / np.abs(u.value)
        g = du.value * inverse
        value = g.imag * slowness
        by_du = -1j * slowness * inverse
        by_u = -g * by_du - value * inverse
        by_position, by_angle = by_du * du.by_position, by_du * du.by_angle
        by_position[:2] += by_u * u.by_position
        by_angle[:2] += by_u * u.by_angle
    return Linear(value, by_position, by_angle, slice(1, 4), slice(1, 4))


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
