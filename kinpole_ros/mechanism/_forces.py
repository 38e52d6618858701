"""
Forces that depend on where a linkage is and how it moves: springs, and the inertia of its masses.

They become loads like any other, so that virtual work and bearing loads have them too (seed 003:
"dynamic forces can be inserted into the virtual work equation").
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import GROUND
from kinpole_ros.mechanism._constraints import frame_of
from kinpole_ros.mechanism._mechanism import Mechanism, Motion
from kinpole_ros.mechanism._statics import Force, Load, Torque
from kinpole_ros.planar import body_point_derivative
from kinpole_ros.planar._plane import Real


class Spring(NamedTuple):
    """
    A spring from the point `a` of the body `one` to `b` of `other` (complex, m, in their frames).

    It pulls with `stiffness` (N/m) times what it is longer than `free` (m), or pushes if shorter.
    """

    one: str
    a: complex
    other: str
    b: complex
    stiffness: float
    free: float


class Torsion(NamedTuple):
    """
    A spring that turns the body `other` to the angle `free` (rad) as seen from `one`.

    Its torque is `stiffness` (N m/rad) times what is left to there.
    """

    one: str
    other: str
    stiffness: float
    free: float


class Mass(NamedTuple):
    """A body's `mass` (kg) at `center` (complex, m, in its frame), `moment` (kg m²) about that."""

    body: str
    mass: float
    center: complex
    moment: float


def spring_loads(
    mechanism: Mechanism, values: Real, springs: Sequence[Spring | Torsion]
) -> list[Load]:
    """
    What springs do to the moving bodies, a load for each end that moves.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.
    springs
        Between points, N/m, or between bodies, N m/rad.

    Returns
    -------
    list of Force or Torque
        N and N m, each of shape (T,). NaN where the ends of one with a free length meet, and it has
        no direction.

    """
    frame, found = frame_of(mechanism.assembly, values), list[Load]()
    for spring in springs:
        if isinstance(spring, Torsion):
            turned = frame.angle[spring.other] - frame.angle[spring.one]
            torque = spring.stiffness * (spring.free - turned)
            loads: list[Load] = [Torque(spring.other, torque), Torque(spring.one, -torque)]
        else:
            way = frame.at(spring.other, spring.b) - frame.at(spring.one, spring.a)
            with np.errstate(divide='ignore', invalid='ignore'):
                beyond = 1 - spring.free / np.abs(way) if spring.free else 1.0
                pull = spring.stiffness * beyond * way
            loads = [Force(spring.one, spring.a, pull), Force(spring.other, spring.b, -pull)]
        found += [load for load in loads if load.body != GROUND]
    return found


def inertial_loads(mechanism: Mechanism, motion: Motion, masses: Sequence[Mass]) -> list[Load]:
    """
    What masses resist a motion with: d'Alembert's forces -m a at their centers, torques -I α.

    Parameters
    ----------
    mechanism
        The linkage.
    motion
        Its motion at T instants, up to accelerations or more.
    masses
        Masses, kg, with centers, m, and moments, kg m^2.

    Returns
    -------
    list of Force or Torque
        N and N m, each of shape (T,).

    """
    found: list[Load] = []
    for mass in masses:
        b = mechanism.bodies.index(mass.body)
        position, angle = motion.position[:, b], motion.angle[:, b]
        place = position[0] + mass.center * np.exp(1j * angle[0])
        acceleration = body_point_derivative(2, place, position, angle)
        found.append(Force(mass.body, mass.center, -mass.mass * acceleration))
        found.append(Torque(mass.body, -mass.moment * angle[2]))
    return found
