"""
What the joints of a linkage bear, by giving way in one constraint at a time (seed 003).

Shares the position only with `_reactions`, and so is its proof.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import GROUND, Belt, Revolute, Rolling, Slot, assemble
from kinpole_ros.mechanism._constraints import Constraints, constraints
from kinpole_ros.mechanism._loops import LinkageError, reduce
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._reactions import (
    Reactions,
    add_teeth,
    assembled,
    has_teeth,
    separating_forces,
)
from kinpole_ros.mechanism._statics import (
    Load,
    at_rest,
    check_loads,
    driver_rows,
    efforts,
    let_move,
    power_of,
)
from kinpole_ros.planar._plane import Complex, Real


class Release(NamedTuple):
    """
    A joint let go in one direction at 1 m/s, or 1 rad/s, all drivers held.

    `way` (T,), complex of length 1, is that of its body `other` as seen from `one`, None for a
    turn. `powers` (loads, T), W, are those of the loads then: minus their sum is what it bears.
    """

    joint: str
    way: Complex | None
    powers: Real


def releases(
    mechanism: Mechanism, values: Real, loads: Sequence[Load]
) -> tuple[list[Release], list[Load]]:
    """
    Let go of each constraint of each joint, one at a time.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.
    loads
        Forces, N, and torques, N m.

    Returns
    -------
    released : list of Release
        In the order of the joints.
    loads : list of Force or Torque
        The loads with those by which teeth with a pressure angle separate each other.

    Raises
    ------
    LinkageError
        As `freed_reactions`.

    Notes
    -----
    The method of Lagrange multipliers as seed 003 has it.

    """
    released, loads, _, _ = _released(mechanism, values, loads)
    return [release for _, release in released], loads


def freed_reactions(mechanism: Mechanism, values: Real, loads: Sequence[Load]) -> Reactions:
    """
    What each joint bears, found by freeing one constraint at a time.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.
    loads
        Forces, N, and torques, N m.

    Returns
    -------
    Reactions
        The same as of `reactions`, at the cost of a solution for each constraint.

    Raises
    ------
    LinkageError
        As `reactions`, and for several positions of teeth with a pressure angle, whose line of
        action differs from one to the next.

    Notes ----- Each joint is put on a carriage that can slide on the body `one`; at unit rate of
    that slide, all drivers held, the loads do work that only the freed reaction balances (seed
    003). The motion is that of the loops of the linkage so changed.

    """
    released, loads, system, teeth = _released(mechanism, values, loads)
    total = efforts(mechanism, values, loads)
    parts = np.zeros((3, len(system.at), values.shape[1]))
    for (k, part), release in released:
        parts[part, k] = -release.powers.sum(axis=0)
    add_teeth(mechanism, parts, teeth)
    held = at_rest(mechanism, values).known
    parts[:, :, ~held] = np.nan
    return assembled(mechanism, values, system, parts, total.effort, held)


def _released(
    mechanism: Mechanism, values: Real, loads: Sequence[Load]
) -> tuple[list[tuple[tuple[int, int], Release]], list[Load], Constraints, Real]:
    """Releases by joint and part, all loads, the constraints, and what teeth transmit (J, T)."""
    check_loads(mechanism, loads)
    joints = mechanism.assembly.joints
    if values.shape[1] > 1 and any(map(has_teeth, joints)):
        raise LinkageError('teeth with a pressure angle are freed at one position at a time')
    system = constraints(mechanism, values)
    teeth = np.zeros((len(joints), values.shape[1]))
    for k, joint in enumerate(joints):
        if has_teeth(joint):
            powers = _freed(mechanism, values, loads, system, k, system.axis[k])
            teeth[k] = -powers.sum(axis=0)
    loads = [*loads, *separating_forces(mechanism, system, teeth)]
    found = []
    for k, part in system.rows:
        way = None if part == 2 else 1j**part * system.axis[k]
        powers = _freed(mechanism, values, loads, system, k, way)
        found.append(((k, part), Release(joints[k].name, way, powers)))
    return found, loads, system, teeth


def _freed(
    mechanism: Mechanism,
    values: Real,
    loads: Sequence[Load],
    system: Constraints,
    k: int,
    way: Complex | None,
) -> Real:
    """Powers (loads, T) with joint k let go along `way` (T,), in the ground's axes, or to turn."""
    old, count, drivers = mechanism.assembly, values.shape[1], len(mechanism.drivers)
    # The hubs of a belt may move apart.
    joints = [one._replace(carrier=None) if isinstance(one, Belt) else one for one in old.joints]
    joint, bodies = joints[k], list(old.bodies)
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
    turned = [system.frame.angle[joint.one]] * (len(bodies) - len(old.bodies))
    for m, other_joint in enumerate(old.joints):
        if m != k and has_teeth(other_joint):
            # Nothing but their push keeps teeth from going apart.
            angle = system.frame.angle[other_joint.one]
            away = float(np.angle(1j * system.axis[m] * np.exp(-1j * angle))[0])
            slide, carriage = f'{m} off', f'{m} off carriage'
            joints.append(Slot(slide, other_joint.one, 0j, away, carriage, 0j, 0.0))
            joints[m] = other_joint._replace(one=carriage)
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
    return np.where(moving.known, np.reshape(powers, (len(loads), count)), np.nan)
