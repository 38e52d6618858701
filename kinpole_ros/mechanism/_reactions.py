"""
What the joints of a linkage bear.

In two ways that share the position only: from the multipliers of the constraints in absolute
coordinates (x, y, θ of each body), and by giving way in one constraint at a time and asking for the
work done in the motion so freed (seed 003).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import (
    GROUND,
    Assembly,
    Joint,
    Revolute,
    Rolling,
    Slot,
    Strut,
    assemble,
)
from kinpole_ros.mechanism._loops import LinkageError, reduce
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._statics import (
    LOST,
    Force,
    Load,
    at_rest,
    check_loads,
    driver_rows,
    efforts,
    inverse_values,
    largest_length,
    let_move,
    power_of,
    stacked_svd,
    vectors_at,
)
from kinpole_ros.planar._plane import Complex, Real

# A constraint with less than this share in a state of self-stress has none.
_NO_SHARE = 1e-6


class Reactions(NamedTuple):
    """
    What the joints (J) bear and the drivers (d) exert, at T positions.

    All forces, N, are those that the joint's body `one` exerts on its body `other`, acting at `at`
    (J, T) complex, m: the pin, or the point of contact. `axis` (J, T) is the joint's own direction,
    complex of length 1: of the slot, the strut or the tangent, with the wheel to its left. `along`
    it (J, T) there is the friction of a wheel or the thrust of a strut, `across`, 90 degrees to the
    left, the normal force, of a wheel positive if it is pressed on. `moment` (J, T), N m, about
    `at` is borne by prismatic joints only. What a driver exerts is in `effort` (d, T) alone, as in
    Efforts, but for struts, whose force it is.

    NaN where `determined` (T,) is not, and where joints share a load in a way that statics alone
    does not tell; `undetermined` says why. A pin's axis is the ground's x, or that of what cannot
    be determined, so that its `across` can.
    """

    joints: tuple[str, ...]
    along: Real
    across: Real
    moment: Real
    at: Complex
    axis: Complex
    effort: Real
    determined: np.ndarray

    @property
    def force(self) -> Complex:
        """The whole force (J, T), complex, in the ground's axes; NaN if a part of it is."""
        return np.asarray((self.along + 1j * self.across) * self.axis)

    @property
    def unique(self) -> np.ndarray:
        """Where (J, T) statics alone tells all that a joint bears."""
        return np.isfinite(self.along + self.across + self.moment)


def reactions(mechanism: Mechanism, values: Real, loads: Sequence[Load]) -> Reactions:
    """
    What each joint bears at variables (n, T): the multipliers λ of the constraint Jacobian A.

    With the loads Q in absolute coordinates, A^T λ = -Q: one row of A for each direction in which a
    joint holds, and one for each driver. Raises LinkageError for a linkage given by vectors alone,
    which has no joints, or a load on a body that is not there.
    """
    check_loads(mechanism, loads)
    system = _system(mechanism, values)
    u, s, vt = system.svd
    applied = system.pull(loads, mechanism) / system.column[:, None]
    determined = system.rank == len(system.column)
    along = inverse_values(s) * (vt @ applied.T[..., None])[..., 0][:, : s.shape[1]]
    found = -(u[:, :, : s.shape[1]] @ along[..., None])[..., 0].T / system.size
    for first in system.pins:
        pin = (found[first] + 1j * found[first + 1]) * system.axis[system.rows[first][0]].conj()
        found[first], found[first + 1] = pin.real, pin.imag
    found[system.stress > _NO_SHARE] = np.nan
    found[:, ~determined] = np.nan
    parts = np.zeros((3, len(system.at), values.shape[1]))
    parts[:, :, ~determined] = np.nan
    for (k, part), row in zip(system.rows, found, strict=False):
        parts[part, k] = row
    return _reactions(mechanism, values, system, parts, found[len(system.rows) :], determined)


def freed_reactions(mechanism: Mechanism, values: Real, loads: Sequence[Load]) -> Reactions:
    """
    The same as `reactions`, found by freeing one constraint at a time (seed 003).

    Each joint is put on a carriage that can slide on the body `one`; at unit rate of that slide,
    all drivers held, the loads do work that only the freed reaction balances. The motion is that of
    the loops of the linkage so changed. Takes a solution for each constraint.
    """
    check_loads(mechanism, loads)
    system = _system(mechanism, values)
    total = efforts(mechanism, values, loads)
    parts = np.zeros((3, len(system.at), values.shape[1]))
    for k, part in system.rows:
        way = None if part == 2 else 1j**part * system.axis[k]
        parts[part, k] = _freed(mechanism, values, loads, system, k, way)
    held = at_rest(mechanism, values).known
    parts[:, :, ~held] = np.nan
    return _reactions(mechanism, values, system, parts, total.effort, held)


def undetermined(mechanism: Mechanism, values: Real) -> tuple[str, ...]:
    """Why efforts or reactions are NaN at one position (n,): a line each, none if they are not."""
    here = np.asarray(values, float)[:, None]
    if not np.isfinite(here).all():
        return ('the loops do not close here: no forces without a position',)
    loose = at_rest(mechanism, here).loose[:, 0]
    variables = mechanism.assembly.loops.variables
    names = ', '.join(name for name, is_so in zip(variables, loose, strict=True) if is_so)
    dead = f'dead point of the loop of {names}' if names else 'dead point'
    drivers = ', '.join(driver.name for driver in mechanism.drivers) or 'nothing'
    open_ended = f'{drivers} cannot hold it there, and no effort balances every load'
    joints = mechanism.assembly.joints
    if not joints:
        return (f'{dead}: {open_ended}',) if names else ()
    system = _system(mechanism, here)
    stressed = system.stress[:, 0] > _NO_SHARE
    rows = zip(system.rows, stressed, strict=False)
    shared = ', '.join(dict.fromkeys(joints[k].name for (k, _), is_so in rows if is_so))
    if names or system.rank[0] < len(system.column):
        where = f', in the joints {shared}' if shared else ''
        return (f'{dead}{where}: {open_ended}',)
    if not stressed.any():
        return ()
    held = [
        driver.name
        for driver, is_so in zip(mechanism.drivers, stressed[len(system.rows) :], strict=True)
        if is_so
    ]
    more = f', nor are the efforts of {", ".join(held)}' if held else ', the efforts are'
    return (
        f'overconstrained: the reactions in the joints {shared} are not unique{more}; how they '
        'share a load is a matter of stiffness and fit',
    )


class _Frame(NamedTuple):
    """Poses of all bodies, the ground among them: origin and angle (T,) by name."""

    origin: dict[str, Complex]
    angle: dict[str, Real]

    def at(self, body: str, point: complex) -> Complex:
        return np.asarray(self.origin[body] + point * np.exp(1j * self.angle[body]))


class _System(NamedTuple):
    """
    The constraint Jacobian at T positions, made dimensionless, and its singular values.

    `rows` are (joint, part), 0 for along, 1 for across, 2 for the moment, before those of the
    drivers; the two rows of `pins`, by their first, are along the ground's axes. `size` (R, T) and
    `column` (3B,) are what rows and columns were divided by; `svd` is that of the stack (T, R, 3B).
    `stress` (R, T) is the share of each reaction, with pins in their axes as in Reactions, in what
    the joints can bear with no load at all.
    """

    frame: _Frame
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


def _system(mechanism: Mechanism, values: Real) -> _System:
    """The rows of all joints and drivers, and what they determine."""
    joints, bodies = _joints(mechanism), mechanism.bodies
    frame = _frame(mechanism.assembly, values)
    count = values.shape[1]
    at = np.zeros((len(joints), count), complex)
    axis = np.ones((len(joints), count), complex)
    rows: list[tuple[int, int]] = []
    matrix: list[Real] = []
    for k, joint in enumerate(joints):
        at[k], axis[k] = _place(mechanism, frame, values, joint)
        for part in {Revolute: (0, 1), Slot: (1,), Rolling: (0, 1), Strut: ()}[type(joint)]:
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
        way = np.where(np.abs(main) > _NO_SHARE**2, np.exp(0.5j * np.angle(main)), 1.0)
        axis[rows[first][0]] = way
        turned = bears * way.conj()
        stress[first] = np.sqrt((turned.real**2).sum(axis=0))
        stress[first + 1] = np.sqrt((turned.imag**2).sum(axis=0))
    return _System(frame, rows, pins, at, axis, size, column, (u, s, vt), rank, stress)


def _place(
    mechanism: Mechanism, frame: _Frame, values: Real, joint: Joint
) -> tuple[Complex, Complex]:
    """Where the joint's force acts, and the joint's own direction (T,)."""
    pin = frame.at(joint.other, joint.b)
    if isinstance(joint, Revolute):
        return pin, np.ones_like(pin)
    if isinstance(joint, Strut):
        return pin, np.exp(1j * _value(mechanism, values, f'{joint.name}.angle'))
    if isinstance(joint, Rolling) and joint.circle:
        normal = np.exp(1j * _value(mechanism, values, joint.name))
        return pin - joint.radius * normal, -1j * normal
    along = np.exp(1j * (frame.angle[joint.one] + joint.along))
    return (pin - 1j * joint.radius * along if isinstance(joint, Rolling) else pin), along


def _variable(
    mechanism: Mechanism, frame: _Frame, values: Real, name: str, at: Complex, axis: Complex
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
            across, arm = 1j * axis[k], _value(mechanism, values, joint.name)
        else:
            return _row(bodies, frame, joint.one, joint.other, hub, axis[k])
        # What an arm on `one` turns, as seen from `one`, and with it.
        seen = _row(bodies, frame, joint.one, joint.other, hub, across) / arm
        return seen + _turn_row(bodies, GROUND, joint.one, count)
    raise LinkageError(f'{name} belongs to no body or joint: what drives it has no reaction')


def _row(
    bodies: Sequence[str], frame: _Frame, one: str, other: str, at: Complex, along: Complex
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


def _reactions(
    mechanism: Mechanism,
    values: Real,
    system: _System,
    parts: Real,
    effort: Real,
    determined: np.ndarray,
) -> Reactions:
    """Assemble what joints bear (3, J, T), and what drivers exert through struts."""
    joints = mechanism.assembly.joints
    names, rows = mechanism.assembly.loops.variables, driver_rows(mechanism)
    for k, joint in enumerate(joints):
        if isinstance(joint, Strut):
            length = _value(mechanism, values, joint.name)
            for part, name, arm in ((0, joint.name, 1.0), (1, f'{joint.name}.angle', length)):
                weight = rows[:, names.index(name)]
                if weight.any():
                    parts[part, k] += weight[weight != 0] @ effort[weight != 0] / arm
    return Reactions(
        tuple(joint.name for joint in joints),
        parts[0],
        parts[1],
        parts[2],
        system.at,
        system.axis,
        effort,
        determined,
    )


def _freed(
    mechanism: Mechanism,
    values: Real,
    loads: Sequence[Load],
    system: _System,
    k: int,
    way: Complex | None,
) -> Real:
    """What joint k bears (T,) along `way` (T,), in the ground's axes, or as a moment for None."""
    old, count, drivers = mechanism.assembly, values.shape[1], len(mechanism.drivers)
    joint, joints, bodies = old.joints[k], list(old.joints), list(old.bodies)
    # What is driven besides the drivers: at which rate, and variables with their weights.
    freed: list[tuple[Real, dict[str, float]]]
    slides, carriages = (f'{k} x', f'{k} y'), (f'{k} carriage x', f'{k} carriage y')
    if way is None:
        assert isinstance(joint, Slot)
        joints[k] = joint._replace(turned=None)
        freed = [(np.ones(count), {joint.other: 1.0, joint.one: -1.0})]
    else:
        joints[k] = joint._replace(one=carriages[1])
        bodies += carriages
        below = (joint.one, carriages[0])
        for slide, one, other, turn in zip(slides, below, carriages, (0.0, np.pi / 2), strict=True):
            joints.append(Slot(slide, one, 0j, turn, other, 0j, 0.0))
        seen = way * np.exp(-1j * system.frame.angle[joint.one])
        freed = [(seen.real, {slides[0]: 1.0}), (seen.imag, {slides[1]: 1.0})]
    new = assemble(bodies, joints)
    names = new.loops.variables
    kept = [names.index(name) for name in old.loops.variables]
    here = np.zeros((len(names), count))
    here[kept] = values
    here[[names.index(name) for name in bodies[len(old.bodies) :]]] = system.frame.angle[joint.one]
    rows = np.zeros((drivers + len(freed), len(names)))
    rows[:drivers, kept] = driver_rows(mechanism)
    rates = np.zeros((len(rows), count))
    for row, (rate, weights) in enumerate(freed, start=drivers):
        rates[row] = rate
        for name in set(weights) - {GROUND}:
            rows[row, names.index(name)] = weights[name]
    if way is not None and not isinstance(joint, Revolute):
        # A slide is now that on the carriage; drivers hold the whole.
        slid = (way * system.axis[k].conj()).real
        if isinstance(joint, Rolling) and joint.circle:
            slid = -slid / (joint.circle + joint.radius)
        rates[:drivers] = -rows[:drivers, [names.index(joint.name)]] * slid
    moving = let_move(reduce(new.loops._replace(drives=rows)), new, here, rates)
    # The carriages come last, and bear no load.
    powers = [power_of(mechanism, load, moving) for load in loads]
    return np.where(moving.known, -np.asarray(sum(powers, start=np.zeros(count))), np.nan)


def _frame(assembly: Assembly, values: Real) -> _Frame:
    length, turn = vectors_at(assembly, values)
    position, angle = assembly.places @ (length * turn), assembly.turns @ values
    still = np.zeros(values.shape[1])
    return _Frame(
        {GROUND: still + 0j} | dict(zip(assembly.bodies, position, strict=True)),
        {GROUND: still} | dict(zip(assembly.bodies, angle, strict=True)),
    )


def _value(mechanism: Mechanism, values: Real, name: str) -> Real:
    return np.asarray(values[mechanism.assembly.loops.variables.index(name)])


def _joints(mechanism: Mechanism) -> tuple[Joint, ...]:
    if not mechanism.assembly.joints:
        raise LinkageError(
            'a linkage of vectors alone has no joints to bear anything: for reactions write it as '
            'bodies and joints'
        )
    return mechanism.assembly.joints
