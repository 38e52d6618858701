"""A body's exact motion up to snap, and a four-bar's by closed forms, without any solver.

Points of the plane are complex numbers, z = x + i y. A body turned by θ then carries its point w
to z + w e^{iθ}, and a vector loop is a sum of terms r e^{iθ}. SI units, rad, counterclockwise
positive.
"""

from math import comb, pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

ORDERS = 5
"""Position, velocity, acceleration, jerk, snap."""


class BodyMotion(NamedTuple):
    """A body's motion at the times asked for; row k of each array is the k-th time derivative.

    `position` is complex, (5, ...): the body's reference point z = x + i y, in m, m/s, ... m/s⁴.
    `angle` is real, (5, ...): the orientation, continuous over turns, in rad, rad/s, ... rad/s⁴.
    The last axes are those of the times.
    """

    position: np.ndarray
    angle: np.ndarray


def rotation_derivatives(angle: np.ndarray) -> np.ndarray:
    """
    e^{iθ} and its time derivatives.

    Parameters
    ----------
    angle
        θ and its own derivatives (orders, ...), rad.

    Returns
    -------
    ndarray
        Of shape (orders, ...), complex.

    Notes
    -----
    Since (e^{iθ})' = i θ' e^{iθ}, Leibniz' rule gives each order from the ones below. At θ = 0 they
    are iω, iα − ω², i(ω̈ − ω³) − 3ωα, i(ω⃛ − 6ω²α) + ω⁴ − 4ωω̈ − 3α²: the matrices ωR, B, H, G
    of the poles.

    """
    result = np.empty(angle.shape, dtype=complex)
    result[0] = np.exp(1j * angle[0])
    for k in range(1, len(angle)):
        result[k] = 1j * sum(comb(k - 1, j) * angle[j + 1] * result[k - 1 - j] for j in range(k))
    return result


def marker_positions(motion: BodyMotion, body_points: np.ndarray) -> np.ndarray:
    """
    Where points fixed to a body are, at the times of a motion.

    Parameters
    ----------
    motion
        Of a body at times (...).
    body_points
        Of shape (n, 2), m, from the body's reference point, along its own axes.

    Returns
    -------
    ndarray
        Of shape (..., n, 2), m, in the ground's frame.

    """
    points = body_points[:, 0] + 1j * body_points[:, 1]
    placed = motion.position[0][..., None] + np.exp(1j * motion.angle[0])[..., None] * points
    return np.stack((placed.real, placed.imag), axis=-1)


def four_bar(
    t: npt.ArrayLike,
    *,
    ground: float,
    crank: float,
    coupler: float,
    rocker: float,
    branch: str,
    turns_per_second: float,
    phase: float,
) -> dict[str, BodyMotion]:
    """Return the motion of a crank-rocker four-bar whose crank turns at a constant rate.

    The crank turns about the origin and the rocker about (ground, 0); A is the crank's far end, B
    the rocker's, and the coupler joins them. Reference points and x axes: 'crank' the origin,
    toward A; 'coupler' A, toward B; 'rocker' (ground, 0), toward B. `phase` is the crank's angle
    when t = 0. On the branch 'open' B lies to the left of the line from A to the rocker's pivot, on
    'crossed' to the right. Raises ValueError where the lengths make no crank-rocker.
    """
    _check_crank_rocker(ground, crank, coupler, rocker)
    crank_angle = _steady_turn(t, turns_per_second, phase)
    crank_arm = crank * rotation_derivatives(crank_angle)

    # The triangle A, rocker's pivot, B. The crank is shorter than the ground, so this diagonal
    # never points backward and its angle needs no unwrapping.
    diagonal = ground - crank_arm[0]
    distance, direction = np.abs(diagonal), np.angle(diagonal)
    side = 1.0 if branch == 'open' else -1.0
    coupler_angle, rocker_angle = np.zeros_like(crank_angle), np.zeros_like(crank_angle)
    coupler_angle[0] = direction + side * _triangle_angle(rocker, coupler, distance)
    rocker_angle[0] = direction + pi - side * _triangle_angle(coupler, rocker, distance)

    # The loop  crank e^{iθ2} + coupler e^{iθ3} = ground + rocker e^{iθ4}, differentiated k times,
    # holds the unknown k-th derivatives of θ3 and θ4 only as  coupler i θ3⁽ᵏ⁾ e^{iθ3} and
    # rocker i θ4⁽ᵏ⁾ e^{iθ4}; all else is known, and is what the derivatives amount to while those
    # two are still zero. Turned by −θ4, its real part is free of θ4⁽ᵏ⁾, and by −θ3, of θ3⁽ᵏ⁾.
    toward_b, rocker_arm = np.exp(1j * coupler_angle[0]), np.exp(1j * rocker_angle[0])
    sine = np.sin(rocker_angle[0] - coupler_angle[0])
    for k in range(1, ORDERS):
        known = (
            rocker * rotation_derivatives(rocker_angle)[k]
            - coupler * rotation_derivatives(coupler_angle)[k]
            - crank_arm[k]
        )
        coupler_angle[k] = (known * rocker_arm.conj()).real / (coupler * sine)
        rocker_angle[k] = (known * toward_b.conj()).real / (rocker * sine)

    pivot = np.zeros_like(crank_arm)
    pivot[0] = ground
    return {
        'crank': BodyMotion(np.zeros_like(crank_arm), crank_angle),
        'coupler': BodyMotion(crank_arm, coupler_angle),
        'rocker': BodyMotion(pivot, rocker_angle),
    }


def _steady_turn(t: npt.ArrayLike, turns_per_second: float, phase: float) -> np.ndarray:
    """Return an angle that grows at a constant rate, with its derivatives: (5, ...)."""
    times = np.asarray(t, dtype=float)
    angle = np.zeros((ORDERS, *times.shape))
    angle[1] = 2 * pi * turns_per_second
    angle[0] = phase + angle[1] * times
    return angle


def _triangle_angle(opposite: float, side: float, other: np.ndarray) -> np.ndarray:
    """Return the angle between two sides of a triangle, from the half-angle tangent.

    Unlike the arc cosine it keeps its digits where the triangle is nearly flat.
    """
    return 2 * np.arctan2(
        np.sqrt((opposite - side + other) * (opposite + side - other)),
        np.sqrt((side + other - opposite) * (side + other + opposite)),
    )


def _check_crank_rocker(ground: float, crank: float, coupler: float, rocker: float) -> None:
    """Raise ValueError unless the linkage closes and the crank turns fully (Grashof)."""
    lengths = {'ground': ground, 'crank': crank, 'coupler': coupler, 'rocker': rocker}
    longest = max(lengths, key=lambda link: lengths[link])
    total = sum(lengths.values())
    # At equality the linkage falls flat and has no derivatives: lengths that sum to it but for
    # rounding count as equal.
    flat = total * (1 - 1e-9)
    if 2 * lengths[longest] >= flat:
        raise ValueError(
            f'the four-bar cannot be assembled: {longest} ({lengths[longest]:g} m) must be shorter '
            f'than the sum of the other three links ({total - lengths[longest]:g} m)'
        )
    if crank > min(lengths.values()) or 2 * (crank + lengths[longest]) >= flat:
        raise ValueError(
            f'the crank does not turn fully while the rocker rocks: crank ({crank:g} m) must be '
            f'the shortest link, and crank + {longest} ({crank + lengths[longest]:g} m) less than '
            f'the sum of the other two ({total - crank - lengths[longest]:g} m)'
        )
