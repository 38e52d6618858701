"""Motions in closed form, the truth that solved and measured ones are held against."""

from math import pi

import numpy as np
import numpy.typing as npt

from kinpole_ros.mechanism import BodyMotion, rotation_derivatives
from kinpole_ros.mechanism._motions import ORDERS


def rolling_wheel(
    t: npt.ArrayLike, *, radius: float, start: float, turns_per_second: float, phase: float
) -> dict[str, BodyMotion]:
    """Return the motion of a wheel that rolls on the line y = 0 at a constant rate.

    The body 'wheel' has its hub for reference point, at (start, radius) when t = 0. Rolling along
    +x is turning clockwise, so positive `turns_per_second` means ω < 0. The ICR is the contact
    point, the fixed centrode the line, the moving centrode the rim.
    """
    angle = _steady_turn(t, -turns_per_second, phase)
    position = -radius * angle + 0j
    position[0] += start + radius * (phase + 1j)
    return {'wheel': BodyMotion(position, angle)}


def cardan(
    t: npt.ArrayLike, *, length: float, turns_per_second: float, phase: float
) -> dict[str, BodyMotion]:
    """Return the motion of a rod whose ends slide on the axes: A on the y axis, B on the x axis.

    The body 'rod' has its midpoint for reference point and its x axis from A to B, whose angle θ
    turns at a constant rate: A = (0, −L sin θ), B = (L cos θ, 0), midpoint (L/2) e^{−iθ}. The ICR
    is L e^{−iθ}: the fixed centrode is the circle of radius L about the origin, the moving one the
    circle on the rod as diameter (Cardan's circles).
    """
    angle = _steady_turn(t, turns_per_second, phase)
    return {'rod': BodyMotion(length / 2 * rotation_derivatives(-angle), angle)}


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
