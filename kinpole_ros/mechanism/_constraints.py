"""
The constraint Jacobian of a linkage in absolute coordinates (x, y, θ of each body).

One row for each direction in which a joint holds, and one for each driver.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import (
    GROUND,
    Assembly,
    Belt,
    Joint,
    Revolute,
    Rolling,
    Slot,
    Strut,
)
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._statics import (
    LOST,
    Force,
    Load,
    driver_rows,
    largest_length,
    stacked_svd,
    vectors_at,
)
from kinpole_ros.planar._plane import Complex, Real

# A constraint with less than this share in a state of self-stress has none.
NO_SHARE = 1e-6


class Frame(NamedTuple):
    """Poses of all bodies, the ground among them: origin and angle (T,) by name."""

    origin: dict[str, Complex]
    angle: dict[str, Real]

    def at(self, body: str, point: complex) -> Complex:
        return np.asarray(self.origin[body] + point * np.exp(1j * self.angle[body]))


class Constraints(NamedTuple):
    """
    The constraint Jacobian at T positions, made dimensionless, and its singular values.

    `rows` are (joint, part), 0 for along, 1 for across, 2 for the moment, before those of the
    drivers; the two rows of `pins`, by their first, are along the ground's axes. `size` (R, T) and
    `column` (3B,) are what rows and columns were divided by; `svd` is that of the stack (T, R, 3B).
    `stress` (R, T) is the share of each reaction, with pins in their axes as in Reactions, in what
    the joints can bear with no load at all.
    """

    frame: Frame
    rows: list[tuple[int, int]]
    pins: list[int]
    at: Complex
    axis: Complex
    size: Real
    column: Real
    svd: tuple[Real, Real, Real]
    rank: np.ndarray
    stress: Real

    def pull(self, loads: Sequence[Load], mechanism: Mechanism) -> Real:
        """The loads in absolute coordinates (3B, T)."""
        total = np.zeros((len(self.column), self.at.shape[1]))
        for load in loads:
            if isinstance(load, Force):
                at, force = self.frame.at(load.body, load.point), np.asarray(load.force, complex)
                total += _row(mechanism.bodies, self.frame, GROUND, load.body, at, force)
            else:
                total += _turn_row(
                    mechanism.bodies, GROUND, load.body, total.shape[1]
                ) * np.asarray(load.torque)
        return total


def constraints(mechanism: Mechanism, values: Real) -> Constraints:
    """The rows of all joints and drivers, and what they determine."""
    joints, bodies = _joints(mechanism), mechanism.bodies
    frame = frame_of(mechanism.assembly, values)
    count = values.shape[1]
    at = np.zeros((len(joints), count), complex)
    axis = np.ones((len(joints), count), complex)
    rows: list[tuple[int, int]] = []
    matrix: list[Real] = []
    for k, joint in enumerate(joints):
        at[k], axis[k] = _place(mechanism, frame, values, joint)
        for part in _held(joint):
            rows.append((k, part))
            way = 1j**part * axis[k]
            matrix.append(_row(bodies, frame, joint.one, joint.other, at[k], way))
        if isinstance(joint, Slot) and joint.turned is not None:
            rows.append((k, 2))
            matrix.append(_turn_row(bodies, joint.one, joint.other, count))
    names = mechanism.assembly.loops.variables
    variables = {
        name: _variable(mechanism, frame, values, name, at, axis)
        for name, used in zip(names, driver_rows(mechanism).any(axis=0), strict=True)
        if used
    }
    for driver in mechanism.drivers:
        parts = [driver.row[names.index(name)] * row for name, row in variables.items()]
        matrix.append(np.asarray(sum(parts)))
    column = np.ones(3 * len(bodies))
    column[2 * len(bodies) :] = largest_length(mechanism.assembly, values)
    scaled = np.array(matrix) / column[:, None]
    size = np.sqrt((scaled**2).sum(axis=1))
    u, s, vt = stacked_svd(scaled / size[:, None])
    rank = (s > LOST * s[:, :1]).sum(axis=1)
    beyond = np.arange(u.shape[2]) >= rank[:, None]
    free = np.moveaxis(np.where(beyond[:, None, :], u, 0.0), 0, -1)
    stress = np.sqrt((free**2).sum(axis=1))
    pins = [r for r, (k, part) in enumerate(rows) if isinstance(joints[k], Revolute) and not part]
    for first in pins:
        # The main axis of the forces a pin can bear with no load, and what is left across it.
        with np.errstate(invalid='ignore'):
            bears = free[first] / size[first] + 1j * free[first + 1] / size[first + 1]
        main = (bears**2).sum(axis=0)
        way = np.where(np.abs(main) > NO_SHARE**2, np.exp(0.5j * np.angle(main)), 1.0)
        axis[rows[first][0]] = way
        turned = bears * way.conj()
        stress[first] = np.sqrt((turned.real**2).sum(axis=0))
        stress[first + 1] = np.sqrt((turned.imag**2).sum(axis=0))
    return Constraints(frame, rows, pins, at, axis, size, column, (u, s, vt), rank, stress)


def _held(joint: Joint) -> tuple[int, ...]:
    """The directions a joint holds in by itself: 0 along its axis, 1 across."""
    if isinstance(joint, Rolling) and joint.pressure is not None:
        return (0,)
    return {Revolute: (0, 1), Slot: (1,), Rolling: (0, 1), Strut: (), Belt: (0,)}[type(joint)]


def _place(
    mechanism: Mechanism, frame: Frame, values: Real, joint: Joint
) -> tuple[Complex, Complex]:
    """Where the joint's force acts, and the joint's own direction (T,)."""
    pin = frame.at(joint.other, joint.b)
    if isinstance(joint, Revolute):
        return pin, np.ones_like(pin)
    if isinstance(joint, Strut | Belt):
        along = np.exp(1j * value_of(mechanism, values, f'{joint.name}.angle'))
        return (pin if isinstance(joint, Strut) else pin + 1j * joint.radii[1] * along), along
    if isinstance(joint, Rolling) and joint.circle:
        normal = np.exp(1j * value_of(mechanism, values, joint.name))
        return pin - joint.radius * normal, -1j * normal
    along = np.exp(1j * (frame.angle[joint.one] + joint.along))
    return (pin - 1j * joint.radius * along if isinstance(joint, Rolling) else pin), along


def _variable(
    mechanism: Mechanism, frame: Frame, values: Real, name: str, at: Complex, axis: Complex
) -> Real:
    """The rate of a variable, as a row (3B, T) times the rates of the absolute coordinates."""
    bodies, count = mechanism.bodies, values.shape[1]
    if name in bodies:
        return _turn_row(bodies, GROUND, name, count)
    for k, joint in enumerate(mechanism.assembly.joints):
        if isinstance(joint, Revolute) or name not in (joint.name, f'{joint.name}.angle'):
            continue
        hub = frame.at(joint.other, joint.b)
        if isinstance(joint, Rolling) and joint.circle:
            across, arm = -axis[k], np.full(count, joint.circle + joint.radius)
        elif name != joint.name:
            across, arm = 1j * axis[k], value_of(mechanism, values, joint.name)
        else:
            return _row(bodies, frame, joint.one, joint.other, hub, axis[k])
        # What an arm on `one` turns, as seen from `one`, and with it.
        seen = _row(bodies, frame, joint.one, joint.other, hub, across) / arm
        return seen + _turn_row(bodies, GROUND, joint.one, count)
    raise LinkageError(f'{name} belongs to no body or joint: what drives it has no reaction')


def _row(
    bodies: Sequence[str], frame: Frame, one: str, other: str, at: Complex, along: Complex
) -> Real:
    """Rate (3B, T) at which the point `at` of `other` leaves that of `one` in a direction."""
    count = len(at)
    row = np.zeros((3, len(bodies), count))
    for body, sign in ((one, -1.0), (other, 1.0)):
        if body != GROUND:
            b = bodies.index(body)
            arm = at - frame.origin[body]
            row[:, b] += sign * np.stack(
                np.broadcast_arrays(along.real, along.imag, (arm.conj() * along).imag)
            )
    return row.reshape(3 * len(bodies), count)


def _turn_row(bodies: Sequence[str], one: str, other: str, count: int) -> Real:
    """Rate (3B, T) at which `other` turns as seen from `one`."""
    row = np.zeros((3, len(bodies), count))
    for body, sign in ((one, -1.0), (other, 1.0)):
        if body != GROUND:
            row[2, bodies.index(body)] += sign
    return row.reshape(3 * len(bodies), count)


def frame_of(assembly: Assembly, values: Real) -> Frame:
    length, turn = vectors_at(assembly, values)
    position, angle = assembly.places @ (length * turn), assembly.turns @ values
    still = np.zeros(values.shape[1])
    return Frame(
        {GROUND: still + 0j} | dict(zip(assembly.bodies, position, strict=True)),
        {GROUND: still} | dict(zip(assembly.bodies, angle, strict=True)),
    )


def value_of(mechanism: Mechanism, values: Real, name: str) -> Real:
    return np.asarray(values[mechanism.assembly.loops.variables.index(name)])


def why_no_reactions(mechanism: Mechanism) -> str:
    """
    Why a linkage does not tell what its joints bear.

    Parameters
    ----------
    mechanism
        The linkage.

    Returns
    -------
    str
        The reason, empty if it does tell.

    """
    if not mechanism.assembly.joints:
        return 'vectors have no joints: for what these bear write bodies and joints'
    if mechanism.assembly.loops.laws:
        return (
            'what joints bear depends on where a cam or a Geneva wheel is touched, which its law '
            'does not say: only the efforts of the drivers are determined'
        )
    return ''


def _joints(mechanism: Mechanism) -> tuple[Joint, ...]:
    if reason := why_no_reactions(mechanism):
        raise LinkageError(reason)
    return mechanism.assembly.joints
