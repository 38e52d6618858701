"""Motions in closed form, the truth that solved and measured ones are held against."""

import numpy.typing as npt

from kinpole_ros.mechanism import BodyMotion, rotation_derivatives
from kinpole_ros.mechanism._motions import _steady_turn


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
