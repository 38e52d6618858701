"""Loads on a linkage: forces and torques, and those of springs and of the inertia of masses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinpole_ros.mechanism._assembly import poses_of
from kinpole_ros.mechanism._joint_kinds import GROUND
from kinpole_ros.mechanism._loops import LinkageError, weigh
from kinpole_ros.mechanism._mechanism import Mechanism, Motion
from kinpole_ros.planar import body_point_derivative
from kinpole_ros.planar._plane import Complex, Real


class Force(NamedTuple):
    """A force, N, complex in the ground's axes, at `point`, m, of the body's frame: () or (T,)."""

    body: str
    point: complex | Complex
    force: npt.ArrayLike


class Torque(NamedTuple):
    """A torque on `body`, N m, () or (T,)."""

    body: str
    torque: npt.ArrayLike


Load = Force | Torque


class Holder(NamedTuple):
    """
    A force or torque that holds the loads instead of a driver.

    The force is on `body` at `point` of its frame (m), in the direction `along` (rad) in the frame
    of the body `of`. If `point` is None it is a torque on `body`.
    """

    body: str
    point: complex | None = None
    along: float = 0.0
    of: str = GROUND


class Spring(NamedTuple):
    """
    A spring from the point `a` of the body `one` to `b` of `other` (complex, m, in their frames).

    It pulls with `stiffness` (N/m) times its length beyond `free` (m), or pushes if it is shorter.
    """

    one: str
    a: complex
    other: str
    b: complex
    stiffness: float
    free: float


class Torsion(NamedTuple):
    """
    A spring that turns the body `other` to the angle `free` (rad) relative to `one`.

    Its torque is `stiffness` (N m/rad) times the angle that remains.
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


def check_loads(mechanism: Mechanism, loads: Sequence[Load]) -> None:
    """Raise LinkageError for a load on a body that does not exist."""
    for load in loads:
        if load.body not in (*mechanism.bodies, GROUND):
            raise LinkageError(
                f'a load is on {load.body}, which is no body: there are '
                f'{", ".join(mechanism.bodies)}'
            )


def load_part(load: Load, part: slice) -> Load:
    """A load at some of the positions: what it has for each (T,) is cut."""
    fields = {name: value for name, value in load._asdict().items() if np.size(value) > 1}
    return load._replace(**{name: value[part] for name, value in fields.items()})


def generalized_forces(mechanism: Mechanism, values: Real, loads: Sequence[Load]) -> Real:
    """
    Forces x and y, and moments about the origins, (loads, 3B, T), of loads on the bodies.

    At variables `values` (n, T).
    """
    bodies, angles = mechanism.bodies, weigh(mechanism.assembly.turns, values)
    forces = np.zeros((len(loads), 3, *angles.shape))
    for row, load in zip(forces, loads, strict=True):
        if load.body == GROUND:
            continue
        b = bodies.index(load.body)
        if isinstance(load, Force):
            force = np.asarray(load.force, complex)
            moment = (np.conj(load.point * np.exp(1j * angles[b])) * force).imag
            row[0, b], row[1, b], row[2, b] = force.real, force.imag, moment
        else:
            row[2, b] = load.torque
    return forces.reshape(len(loads), 3 * len(bodies), values.shape[1])


def spring_loads(
    mechanism: Mechanism, values: Real, springs: Sequence[Spring | Torsion]
) -> list[Load]:
    """
    Forces (N) and torques (N m), each (T,), of springs on the bodies at variables (n, T).

    NaN where the ends of one with a free length meet, and it has no direction.
    """
    poses, loads = poses_of(mechanism.assembly, values), list[Load]()
    for spring in springs:
        one, other = poses[spring.one], poses[spring.other]
        if isinstance(spring, Torsion):
            torque = spring.stiffness * (spring.free - (other.angle - one.angle))
            ends: list[Load] = [Torque(spring.other, torque), Torque(spring.one, -torque)]
        else:
            between = other.point(spring.b) - one.point(spring.a)
            with np.errstate(divide='ignore', invalid='ignore'):
                extension = 1 - spring.free / np.abs(between) if spring.free else 1.0
                pull = spring.stiffness * extension * between
            ends = [Force(spring.one, spring.a, pull), Force(spring.other, spring.b, -pull)]
        loads += [load for load in ends if load.body != GROUND]
    return loads


def inertial_loads(mechanism: Mechanism, motion: Motion, masses: Sequence[Mass]) -> list[Load]:
    """D'Alembert's forces (T,) of masses, -m a at their centers, and torques -I α."""
    loads: list[Load] = []
    for mass in masses:
        b = mechanism.bodies.index(mass.body)
        position, angle = motion.position[:, b], motion.angle[:, b]
        center = position[0] + mass.center * np.exp(1j * angle[0])
        acceleration = body_point_derivative(2, center, position, angle)
        loads.append(Force(mass.body, mass.center, -mass.mass * acceleration))
        loads.append(Torque(mass.body, -mass.moment * angle[2]))
    return loads
