"""The ICR as it wanders: its velocity along the centrodes and the centrodes' curvature."""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._linear import Linear
from kinpole_ros.planar._plane import (
    Complex,
    Real,
    check_vectors,
    complex_of,
    to_complex,
    to_plane,
)

# Numbers or arrays: a frame that comes alone is computed in numbers.
Number: TypeAlias = Any
Terms: TypeAlias = tuple[Number, tuple[Number, ...], tuple[Number, ...]]


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
        In m/s, complex (...), in the frame of `position`; not finite where the body does not turn.

    Notes
    -----
    (w R acc - B v) / w^2, with v and acc those of the reference point: seed 000, 'centrode
    velocity', and seed 001, eq. 15.

    """
    return _linear(velocity_terms(position[1:3], complex_of(0.0, angle[1:3])), 3)


def velocity_terms(position: Sequence[Number], turn: Sequence[Number]) -> Terms:
    """
    The velocity of the ICR, and its derivatives by those of the reference point and the angle.

    Parameters
    ----------
    position
        v and acc of the reference point, complex: numbers, or arrays of one shape.
    turn
        i w and i a, of the same shape. They are complex since a product with a real array takes
        three times as long, and the signs are the same.

    Returns
    -------
    value, by_position, by_angle
        u = v + q (acc + n v), m/s, complex, with q = -1 / i w and n = q i a, and its derivatives by
        v and acc and by w and a.

    """
    (v, acc), (t1, t2) = position, turn
    q = -1 / t1
    n = t2 * q
    nv, iqq = n * v, 1j * q * q
    inner = acc + nv
    return v + q * inner, (1 + n * q, q), (iqq * (inner + nv), iqq * v)


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
        What `icr_velocity` gives, if it was asked before.

    Returns
    -------
    Linear
        In m/s^2, complex (...); not finite where the body does not turn.

    Notes
    -----
    (-(w j - 2 a^2) R v + (w^3 - 2 w a R) acc + w^2 R jerk) / w^3, seed 000.

    """
    u = icr_velocity(position, angle) if u is None else u
    turn = complex_of(0.0, angle[2:4])
    return _linear(acceleration_terms(position[1:4], turn, u.by_position, u.by_angle), 4)


def acceleration_terms(
    position: Sequence[Number],
    turn: Sequence[Number],
    u_by_position: Sequence[Number],
    u_by_angle: Sequence[Number],
) -> Terms:
    """
    The acceleration of the ICR, and its derivatives by those of the reference point and the angle.

    Parameters
    ----------
    position
        v, acc and jerk of the reference point, complex: numbers, or arrays of one shape.
    turn
        i a and i j, of the same shape.
    u_by_position, u_by_angle
        Derivatives of the velocity of the ICR, as `velocity_terms` gives them.

    Returns
    -------
    value, by_position, by_angle
        In m/s^2, complex, and its derivatives by v, acc and jerk and by w, a and j.

    """
    (v, acc, jerk), (t2, t3) = position, turn
    # du is the rate of u; so its derivative by one of the pose's derivatives is the rate of that of
    # u by the same, and that of u by the one before. The rate of q is n q, that of n is c.
    by_v, q = u_by_position
    by_w, by_a = u_by_angle
    n, m = t2 * q, t3 * q
    iqq, nn, twice = 1j * q * q, n * n, n + n
    c = m + nn
    rate = twice * by_w + iqq * (jerk + twice * acc + (c + c) * v)
    by_v, by_acc = (c + nn) * q, by_v + n * q
    return by_v * v + by_acc * acc + q * jerk, (by_v, by_acc, q), (rate, by_w + by_w, by_a)


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
        What `icr_velocity` gives, if it was asked before.

    Returns
    -------
    Linear
        In 1/m, (...); not finite where the ICR stands still.

    Notes
    -----
    Seed 000. In a mechanism of one degree of freedom it does not depend on the speed.

    """
    u = icr_velocity(position, angle) if u is None else u
    du = icr_acceleration(position, angle, u)
    return _linear(curvature_terms(u[:3], du[:3]), 4)


def curvature_terms(velocity: Terms, acceleration: Terms) -> Terms:
    """
    Curvature of the fixed centrode, and its derivatives by those of reference point and angle.

    Parameters
    ----------
    velocity, acceleration
        What `velocity_terms` and `acceleration_terms` give: of numbers, or arrays of one shape.

    Returns
    -------
    value, by_position, by_angle
        Im(conj(u) du) / abs(u)^3, 1/m, and its derivatives by v, acc and jerk and by w, a and j;
        the change is the real part of their sum.

    """
    u, *u_by = velocity
    du, *du_by = acceleration
    # Written as Im(g) / |u| with g = du / u. A change of u and du changes g by
    # (change of du - g * change of u) / u, and |u| by |u| Re(change of u / u).
    inverse = 1 / u
    slowness = abs(inverse)
    g = du * inverse
    by_du = inverse * slowness * -1j
    # g.real + 2 i g.imag
    by_u = by_du * (0.5 * g.conjugate() - 1.5 * g)
    by_position, by_angle = (
        (by_du * d0 + by_u * u0, by_du * d1 + by_u * u1, by_du * d2)
        for (u0, u1), (d0, d1, d2) in zip(u_by, du_by, strict=True)
    )
    return g.imag * slowness, by_position, by_angle


def _linear(terms: Terms, end: int) -> Linear:
    """Terms by the orders 1 to `end`, in arrays."""
    value, by_position, by_angle = terms
    return Linear(value, np.array(by_position), np.array(by_angle), slice(1, end), slice(1, end))


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
    The two differ by omega / speed, since in the body's frame the tangent turns by omega less (seed
    001, eq. 15 and 16).

    """
    return np.asarray(fixed - omega / speed)


def moving_centrode(icr: ArrayLike, reference: ArrayLike, angle: ArrayLike) -> Real:
    """
    The ICR as seen from the body: where it is on the moving centrode.

    Parameters
    ----------
    icr, reference
        ICR and reference point of the body (..., 2), m, in the ground's frame.
    angle
        Angle of the body (...), rad.

    Returns
    -------
    ndarray
        Of shape (..., 2), m, from the reference point, in the body's axes.

    Notes
    -----
    Seed 000, 'moving centrode'.

    """
    arm = to_complex(check_vectors(icr, 'icr')) - to_complex(check_vectors(reference, 'reference'))
    return to_plane(arm * np.exp(-1j * np.asarray(angle, float)))
