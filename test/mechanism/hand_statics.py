"""
Reactions in the joints by giving way in one constraint at a time, as seed 003 teaches it.

Each joint is put on a carriage that can slide on the body `one`. At unit rate of that slide, all
drivers held, the loads do work that only the freed reaction balances. The motion is that of the
vector loops of the linkage so changed, so this shares with `kinpole_ros.mechanism.Statics` the
position and the axes of the joints only, and proves it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinpole_ros.mechanism._assembly import Assembly, assemble, body_motion, poses_of
from kinpole_ros.mechanism._belt import Belt
from kinpole_ros.mechanism._equilibrium import (
    Statics,
    separating_loads,
    why_no_reactions,
)
from kinpole_ros.mechanism._joint_kinds import GROUND, Pose, Revolute, Rolling, Slot, Strut
from kinpole_ros.mechanism._loads import Force, Load
from kinpole_ros.mechanism._loops import (
    LinkageError,
    ReducedLoops,
    loop_jacobian,
    reduce,
    term_directions,
    term_lengths,
    with_laws,
)
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._virtual_motions import virtual_motions
from kinpole_ros.planar._plane import ROUNDING, Complex, Real


class Moving(NamedTuple):
    """Bodies (B) in motion: `angle`, `velocity` and `omega` (B, T), and where determined (T,)."""

    angle: Real
    velocity: Complex
    omega: Real
    determined: np.ndarray


class Freed(NamedTuple):
    """Reactions (J, T) and efforts (d, T), named as those of Statics."""

    along: Real
    across: Real
    moment: Real
    axis: Complex
    effort: Real
    determined: np.ndarray

    @property
    def force(self) -> Complex:
        """The force (J, T), complex, in the ground's axes."""
        return np.asarray((self.along + 1j * self.across) * self.axis)

    @property
    def unique(self) -> np.ndarray:
        """Whether (J, T) statics alone determines the reaction of a joint."""
        return np.isfinite(self.along + self.across + self.moment)


def power_of(mechanism: Mechanism, load: Load, moving: Moving) -> Real:
    """Power (T,) of a load on moving bodies."""
    if load.body == GROUND:
        return np.zeros(moving.omega.shape[1])
    b = mechanism.bodies.index(load.body)
    if not isinstance(load, Force):
        return np.asarray(load.torque * moving.omega[b])
    arm = load.point * np.exp(1j * moving.angle[b])
    rate = moving.velocity[b] + 1j * moving.omega[b] * arm
    return np.asarray((np.conj(load.force) * rate).real)


# Below the root of rounding a singular value is zero but for errors of the position.
SINGULAR_VALUE = np.sqrt(ROUNDING)


def move(linkage: ReducedLoops, assembly: Assembly, values: Real, rates: Real) -> Moving:
    """
    Let the drivers move at `rates` (d, T), at variables (n, T) that close the loops.

    Linear in the rates and by singular values, so nothing is searched for.
    """
    loops, unknowns = linkage.loops, linkage.free.shape[1]
    _, slope = loop_jacobian(loops, values)
    rate = linkage.driven @ with_laws(linkage, np.stack((loops.drives @ values, rates)))[1]
    determined = np.isfinite(values).all(axis=0)
    if unknowns:
        columns = np.einsum('mnt,nu->mut', slope, linkage.free)
        gap = np.einsum('mnt,nt->mt', slope, rate)
        matrix = np.concatenate((columns.real, columns.imag))
        size = np.sqrt((matrix**2).sum(axis=0))
        size[~(size > 0)] = 1.0
        scaled = np.moveaxis(np.where(determined, matrix / size, 0.0), -1, 0)
        singular = np.linalg.svd(scaled, compute_uv=False)
        rank = (singular > SINGULAR_VALUE * singular[:, :1]).sum(axis=1)
        inverse = np.linalg.pinv(scaled, rcond=SINGULAR_VALUE)
        step = inverse @ np.concatenate((gap.real, gap.imag)).T[..., None]
        rate -= linkage.free @ (step[..., 0].T / size)
        determined &= rank == unknowns
    length, turn = term_lengths(loops, values), term_directions(loops, values)
    terms = turn * (loops.lengths @ rate + 1j * length * (loops.angles @ rate))
    with np.errstate(invalid='ignore'):
        # The rates of least squares need not keep all loops closed where constraints are too many.
        gap = np.abs(loops.loops @ terms).max(axis=0, initial=0.0)
        determined &= gap <= SINGULAR_VALUE * np.abs(terms).max(axis=0, initial=0.0)
    position, angle = body_motion(assembly, np.stack((values, rate)))
    return Moving(angle[0], position[1], angle[1], determined)


def balance(
    rate: npt.ArrayLike, *loads: tuple[npt.ArrayLike, npt.ArrayLike]
) -> npt.NDArray[np.float64]:
    """
    The effort at a port that moves at `rate` so that all powers add up to zero, seed 003.

    Each of `loads` is (force, velocity), both complex, N and m/s, or (torque, angular velocity),
    N m and rad/s. The effort is a force along `rate` in m/s, or a torque where it is in rad/s;
    positive if it acts along the motion. NaN where the port stands still. Shapes (...).
    """
    power = sum(np.real(np.multiply(effort, np.conj(along))) for effort, along in loads)
    moving = np.asarray(rate, float)
    return np.asarray(-power / np.where(moving == 0, np.nan, moving))


def freed_reactions(mechanism: Mechanism, values: Real, loads: Sequence[Load]) -> Freed:
    """
    The same as of `Statics`, at the cost of a solution for each constraint.

    Raises LinkageError for several positions of teeth with a pressure angle, whose line of action
    differs from one to the next.
    """
    joints = mechanism.assembly.joints
    if values.shape[1] > 1 and any(joint.pressure is not None for joint in joints):
        raise LinkageError('teeth with a pressure angle are freed at one position at a time')
    system = Statics(mechanism, values, loads)
    if reason := why_no_reactions(mechanism):
        raise LinkageError(reason)
    loads, poses = list(loads), poses_of(mechanism.assembly, values)
    teeth = np.zeros((len(joints), values.shape[1]))
    for k, joint in enumerate(joints):
        if joint.pressure is not None:
            powers = _freed(mechanism, values, loads, poses, system.axis, k, system.axis[k])
            teeth[k] = -powers.sum(axis=0)
    separating = [
        load
        for k, joint in enumerate(joints)
        if joint.pressure is not None
        for load in separating_loads(joint, poses, system.at[k], system.axis[k], teeth[k])
    ]
    effort = system.effort
    loads += separating
    parts = np.zeros((3, *system.at.shape))
    for k, part, _ in virtual_motions(mechanism, values, poses).bearings:
        way = None if part == 2 else 1j**part * system.axis[k]
        parts[part, k] = -_freed(mechanism, values, loads, poses, system.axis, k, way).sum(axis=0)
    names, rows = mechanism.assembly.loops.variables, mechanism.driver_rows
    for k, joint in enumerate(joints):
        if joint.pressure is not None:
            parts[1, k] = np.abs(teeth[k]) * np.tan(joint.pressure)
    still = np.zeros((len(mechanism.drivers), values.shape[1]))
    held = move(mechanism.linkage, mechanism.assembly, values, still).determined
    parts[:, :, ~held] = np.nan
    for k, joint in enumerate(joints):
        if isinstance(joint, Strut):
            length = values[names.index(joint.name)]
            for part, name, arm in ((0, joint.name, 1.0), (1, f'{joint.name}.angle', length)):
                weight = rows[:, names.index(name)]
                if weight.any():
                    parts[part, k] += weight[weight != 0] @ effort[weight != 0] / arm
    return Freed(*parts, system.axis, effort, held)


def _freed(
    mechanism: Mechanism,
    values: Real,
    loads: Sequence[Load],
    poses: dict[str, Pose],
    axis: Complex,
    k: int,
    way: Complex | None,
) -> Real:
    """Powers (loads, T) with joint k let go along `way` (T,), in the ground's axes, or to turn."""
    old, count, drivers = mechanism.assembly, values.shape[1], len(mechanism.drivers)
    # The hubs of a belt may move apart.
    joints = [one.changed(carrier=None) if isinstance(one, Belt) else one for one in old.joints]
    joint, bodies = joints[k], list(old.bodies)
    # What is driven besides the drivers: at which rate, and variables with their weights.
    freed: list[tuple[Real, dict[str, float]]]
    slides, carriages = (f'{k} x', f'{k} y'), (f'{k} carriage x', f'{k} carriage y')
    if way is None:
        assert isinstance(joint, Slot)
        joints[k] = joint.changed(turned=None)
        freed = [(np.ones(count), {joint.other: 1.0, joint.one: -1.0})]
    else:
        joints[k] = joint.changed(one=carriages[1])
        bodies += carriages
        below = (joint.one, carriages[0])
        for slide, one, other, turn in zip(slides, below, carriages, (0.0, np.pi / 2), strict=True):
            joints.append(Slot(slide, one, 0j, other, 0j, turn, 0.0))
        seen = way * np.exp(-1j * poses[joint.one].angle)
        freed = [(seen.real, {slides[0]: 1.0}), (seen.imag, {slides[1]: 1.0})]
    turned = [poses[joint.one].angle] * (len(bodies) - len(old.bodies))
    for m, other_joint in enumerate(old.joints):
        if m != k and other_joint.pressure is not None:
            # Nothing but their push keeps teeth from going apart.
            angle = poses[other_joint.one].angle
            away = float(np.angle(1j * axis[m] * np.exp(-1j * angle))[0])
            slide, carriage = f'{m} off', f'{m} off carriage'
            joints.append(Slot(slide, other_joint.one, 0j, carriage, 0j, away, 0.0))
            joints[m] = other_joint.changed(one=carriage)
            bodies.append(carriage)
            turned.append(angle)
    new = assemble(bodies, joints)
    names = new.loops.variables
    kept = [names.index(name) for name in old.loops.variables]
    here = np.zeros((len(names), count))
    here[kept] = values
    for name, angle in zip(bodies[len(old.bodies) :], turned, strict=True):
        here[names.index(name)] = angle
    rows = np.zeros((drivers + len(freed), len(names)))
    rows[:drivers, kept] = mechanism.driver_rows
    rates = np.zeros((len(rows), count))
    for row, (rate, weights) in enumerate(freed, start=drivers):
        rates[row] = rate
        for name in set(weights) - {GROUND}:
            rows[row, names.index(name)] = weights[name]
    if way is not None and not isinstance(joint, Revolute):
        # A slide is now that on the carriage; drivers hold the whole.
        slid = (way * axis[k].conj()).real
        if isinstance(joint, Rolling) and joint.circle:
            slid = -slid / (joint.circle + joint.radius)
        rates[:drivers] = -rows[:drivers, [names.index(joint.name)]] * slid
    moving = move(reduce(new.loops._replace(drives=rows)), new, here, rates)
    # The carriages come last, and bear no load.
    powers = [power_of(mechanism, load, moving) for load in loads]
    return np.where(moving.determined, np.reshape(powers, (len(loads), count)), np.nan)
