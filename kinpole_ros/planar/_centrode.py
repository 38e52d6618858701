"""
Motion of the ICR along the centrodes, and the curvature of the centrodes.

The fixed centrode is the path of the ICR in the ground's frame, the moving centrode its path in the
body's frame; the moving one rolls on the fixed one (seed 000, page 3; seed 001, section 2).
Symbols: v, acc and jerk are the derivatives of the reference point, w, a and j those of the angle,
u is the velocity of the ICR and du its rate of change.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._plane import Complex, Real, check_vectors, complex_of, to_complex, to_plane
from kinpole_ros.planar._uncertainty import Linear


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def icr_velocity(position: Complex, angle: Real) -> Linear:
    """
    Velocity u of the ICR along both centrodes.

    Parameters
    ----------
    position, angle
        Reference point (K, ...), complex, m, and angle (K, ...), rad, with their derivatives;
        K > 2.

    Returns
    -------
    Linear
        Of shape (...), complex, m/s, in the frame of `position`. Not finite where w = 0.

    Notes
    -----
    (w R acc - B v) / w^2, seed 000, page 3. It is the same along both centrodes (seed 001, eq. 15).
    Written here as u = v + q (acc + n v) with q = -1 / (i w) and n = i a q.

    """
    v, acc = position[1:3]
    # A product of a complex with a real array takes three times as long.
    iw, ia = complex_of(0.0, angle[1:3])
    q = -1 / iw
    n = ia * q
    nv, iqq = n * v, 1j * q * q
    inner = acc + nv
    by_position, by_angle = (1 + n * q, q), (iqq * (inner + nv), iqq * v)
    return _linear(v + q * inner, by_position, by_angle)


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def icr_acceleration(position: Complex, angle: Real, u: Linear | None = None) -> Linear:
    """
    Second time derivative of the ICR.

    Parameters
    ----------
    position, angle
        Reference point (K, ...), complex, m, and angle (K, ...), rad, with their derivatives;
        K > 3.
    u
        The result of `icr_velocity`, if it has been computed already.

    Returns
    -------
    Linear
        Of shape (...), complex, m/s^2, in the frame of `position`. Not finite where w = 0.

    Notes
    -----
    (-(w j - 2 a^2) R v + (w^3 - 2 w a R) acc + w^2 R jerk) / w^3, seed 000, page 9.

    It is the time derivative of u. Its partial derivative by z(k) is therefore the time derivative
    of that of u by z(k), plus that of u by z(k-1); the same holds for the angle. The time
    derivatives of the q and n of `icr_velocity` are n q and c = i j q + n^2.

    """
    u = icr_velocity(position, angle) if u is None else u
    v, acc, jerk = position[1:4]
    ia, ij = complex_of(0.0, angle[2:4])
    by_v, q = u.by_position
    by_w, by_a = u.by_angle
    n, m = ia * q, ij * q
    iqq, nn, twice = 1j * q * q, n * n, n + n
    c = m + nn
    du_by_w = twice * by_w + iqq * (jerk + twice * acc + (c + c) * v)
    by_v, by_acc = (c + nn) * q, by_v + n * q
    value = by_v * v + by_acc * acc + q * jerk
    return _linear(value, (by_v, by_acc, q), (du_by_w, by_w + by_w, by_a))


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def centrode_curvature(position: Complex, angle: Real, u: Linear | None = None) -> Linear:
    """
    Signed curvature of the fixed centrode, positive where it turns left along u.

    Parameters
    ----------
    position, angle
        Reference point (K, ...), complex, m, and angle (K, ...), rad, with their derivatives;
        K > 3.
    u
        The result of `icr_velocity`, if it has been computed already.

    Returns
    -------
    Linear
        Of shape (...), 1/m. Not finite where u = 0.

    Notes
    -----
    (u x du) / |u|^3, seed 000, page 3. In a mechanism of one degree of freedom it does not depend
    on the speed.

    Computed as Im(g) / |u| with g = du / u. A change of u and du changes g by
    (d(du) - g d(u)) / u, and |u| by |u| Re(d(u) / u).

    """
    u = icr_velocity(position, angle) if u is None else u
    du = icr_acceleration(position, angle, u)
    inverse = 1 / u.value
    slowness = abs(inverse)
    g = du.value * inverse
    by_du = inverse * slowness * -1j
    by_u = by_du * (0.5 * g.conjugate() - 1.5 * g)
    by_position, by_angle = (
        (by_du * d0 + by_u * u0, by_du * d1 + by_u * u1, by_du * d2)
        for (u0, u1), (d0, d1, d2) in ((u[1], du[1]), (u[2], du[2]))
    )
    return _linear(g.imag * slowness, by_position, by_angle)


def _linear(
    value: Complex, by_position: tuple[Complex, ...], by_angle: tuple[Complex, ...]
) -> Linear:
    """A Linear with partial derivatives from order 1 on."""
    orders = slice(1, len(by_position) + 1)
    return Linear(value, np.array(by_position), np.array(by_angle), orders, orders)


def moving_centrode_curvature(fixed: Real, omega: Real, speed: Real) -> Real:
    """
    Signed curvature of the moving centrode where it touches the fixed one.

    Parameters
    ----------
    fixed
        Curvature of the fixed centrode (...), 1/m.
    omega
        Angular velocity of the body (...), rad/s.
    speed
        Speed of the ICR along the centrodes (...), m/s.

    Returns
    -------
    ndarray
        Of shape (...), 1/m.

    Notes
    -----
    fixed - omega / speed: seen from the body, the tangent rotates by omega less (seed 001, eq. 15
    and 16).

    """
    return np.asarray(fixed - omega / speed)


def moving_centrode(icr: ArrayLike, reference: ArrayLike, angle: ArrayLike) -> Real:
    """
    Position of the ICR in the body's frame: the point of the moving centrode.

    Parameters
    ----------
    icr, reference
        ICR and reference point of the body (..., 2), m, in the ground's frame.
    angle
        Angle of the body (...), rad.

    Returns
    -------
    ndarray
        From the reference point, in the body's axes (..., 2), m.

    Notes
    -----
    (ICR - z) exp(-i angle); seed 000, page 3, and seed 001, eq. 22.

    """
    arm = to_complex(check_vectors(icr, 'icr')) - to_complex(check_vectors(reference, 'reference'))
    return to_plane(arm * np.exp(-1j * np.asarray(angle, float)))
