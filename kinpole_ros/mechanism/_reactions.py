"""
Reactions in the joints of a linkage: Lagrange multipliers of the constraints between its bodies.

The constraint Jacobian A (`_constraints`) has one row for each direction in which a joint holds its
bodies, and one for each driver. With the loads Q in the same coordinates A^T λ = -Q. The column of
the inverse of A that belongs to a row is the motion of the bodies where the joint gives way in that
direction alone, as seed 003 has it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._constraints import (
    ACROSS_AXIS,
    ALONG_AXIS,
    TURN,
    UNSTRESSED,
    Constraints,
    constraints,
    has_teeth,
    why_no_reactions,
)
from kinpole_ros.mechanism._dead_points import loose_variables
from kinpole_ros.mechanism._joints import GROUND, Rolling, Strut
from kinpole_ros.mechanism._loads import Force, Load, check_loads
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.planar._plane import Complex, Real


class Reactions(NamedTuple):
    """
    Forces in the joints (J) and efforts of the drivers (d) at T positions.

    All forces, N, are those that the joint's body `one` exerts on its body `other`, acting at `at`
    (J, T), complex, m: the pin, or the point of contact. `axis` (J, T) is the joint's own
    direction, complex of length 1: of the slot, the strut or the tangent, with the wheel to its
    left. `along` it (J, T) acts the friction of a wheel or the thrust of a strut; `across`, 90
    degrees to the left, the normal force, which presses a wheel on if it is positive. `moment`
    (J, T), N m, about `at` is that of prismatic joints. The effort of a driver is in `effort`
    (d, T) alone, as in Efforts, except for struts, whose force it is.

    NaN where `determined` (T,) is not, and where joints share a load in a way that statics alone
    does not determine; `undetermined` gives the reason. The axis of a pin is the ground's x axis,
    or the direction that is not determined, so that its `across` is.
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
        """The force (J, T), complex, in the ground's axes; NaN if a component of it is."""
        return np.asarray((self.along + 1j * self.across) * self.axis)

    @property
    def unique(self) -> np.ndarray:
        """Whether (J, T) statics alone determines the reaction of a joint."""
        return np.isfinite(self.along + self.across + self.moment)


class Release(NamedTuple):
    """
    A joint let go in one direction at 1 m/s, or 1 rad/s, all drivers held.

    `way` (T,), complex of length 1, is the direction in which its body `other` moves relative to
    `one`, None for a turn. `powers` (loads, T), W, are those of the loads then: the reaction is
    minus their sum.
    """

    joint: str
    way: Complex | None
    powers: Real


def reactions(mechanism: Mechanism, values: Real, loads: Sequence[Load]) -> Reactions:
    """
    Reaction of each joint: the multipliers λ of the constraint Jacobian A.

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
        Those of J joints at T positions, N and N m, in the ground's axes.

    Raises
    ------
    LinkageError
        For a linkage given by vectors alone, which has no joints, or a load on a body that does not
        exist.

    Notes
    -----
    With the loads Q in absolute coordinates, A^T λ = -Q: one row of A for each direction in which a
    joint constrains its bodies, and one for each driver.

    """
    check_loads(mechanism, loads)
    system = constraints(mechanism, values)
    powers = system.powers(mechanism, [*loads, *_tooth_loads(mechanism, system, loads)])
    multipliers = system.multipliers(powers)
    components = np.zeros((3, *system.contact.shape))
    components[:, :, ~system.determined] = np.nan
    for (k, direction), multiplier in zip(system.rows, multipliers, strict=False):
        components[direction, k] = multiplier
    effort = multipliers[len(system.rows) :]
    names, rows = mechanism.assembly.loops.variables, mechanism.driver_rows
    for k, joint in enumerate(mechanism.assembly.joints):
        if isinstance(joint, Rolling) and joint.pressure is not None:
            components[ACROSS_AXIS, k] = np.abs(components[ALONG_AXIS, k]) * np.tan(joint.pressure)
        elif isinstance(joint, Strut):
            length = values[names.index(joint.name)]
            for direction, name, arm in (
                (ALONG_AXIS, joint.name, 1.0),
                (ACROSS_AXIS, f'{joint.name}.angle', length),
            ):
                weight = rows[:, names.index(name)]
                if weight.any():
                    components[direction, k] += weight[weight != 0] @ effort[weight != 0] / arm
    return Reactions(
        tuple(joint.name for joint in mechanism.assembly.joints),
        components[ALONG_AXIS],
        components[ACROSS_AXIS],
        components[TURN],
        system.contact,
        system.axis,
        effort,
        system.determined,
    )


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
        As `reactions`.

    Notes
    -----
    The method of Lagrange multipliers as seed 003 has it.

    """
    check_loads(mechanism, loads)
    system = constraints(mechanism, values)
    loads = [*loads, *_tooth_loads(mechanism, system, loads)]
    powers = system.powers(mechanism, loads)
    released = []
    for row, (k, direction) in enumerate(system.rows):
        way = None if direction == TURN else 1j**direction * system.axis[k]
        name = mechanism.assembly.joints[k].name
        released.append(Release(name, way, powers[:, row]))
    return released, loads


def _tooth_loads(mechanism: Mechanism, system: Constraints, loads: Sequence[Load]) -> list[Load]:
    """
    The forces by which teeth with a pressure angle separate each other, as loads.

    They follow from the force that the teeth transmit, which does not depend on them, since they do
    no work.
    """
    joints = mechanism.assembly.joints
    if not any(map(has_teeth, joints)):
        return []
    transmitted = system.multipliers(system.powers(mechanism, loads))
    separating: list[Load] = []
    for row, (k, _) in enumerate(system.rows):
        joint = joints[k]
        if isinstance(joint, Rolling) and joint.pressure is not None:
            separating += _separating(joint, system, k, transmitted[row])
    return separating


def _separating(joint: Rolling, system: Constraints, k: int, transmitted: Real) -> list[Load]:
    """The two forces that separate the teeth of joint k, which transmit a force (T,)."""
    push = np.abs(transmitted) * np.tan(joint.pressure or 0.0) * 1j * system.axis[k]
    loads: list[Load] = []
    for body, force in ((joint.one, -push), (joint.other, push)):
        if body != GROUND:
            pose = system.poses[body]
            arm = (system.contact[k] - pose.position) * pose.turn.conj()
            loads.append(Force(body, arm, force))
    return loads


def loose_teeth(mechanism: Mechanism, values: Real) -> tuple[str, ...]:
    """The joints with a pressure angle, at one position (n,), if nothing else holds their hubs."""
    joints = mechanism.assembly.joints
    toothed = [joint.name for joint in joints if has_teeth(joint)]
    if not toothed or why_no_reactions(mechanism):
        return ()
    system = constraints(mechanism, values[:, None])
    if system.determined[0]:
        return ()
    smooth = tuple(j._replace(pressure=None) if isinstance(j, Rolling) else j for j in joints)
    assembly = mechanism.assembly._replace(joints=smooth)
    rigid = constraints(Mechanism(assembly, mechanism.drivers, mechanism.start), values[:, None])
    return tuple(toothed) if system.rank[0] < rigid.rank[0] else ()


def undetermined(mechanism: Mechanism, values: Real) -> tuple[str, ...]:
    """
    Reasons for which efforts or reactions are NaN at one position.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n,), m and rad.

    Returns
    -------
    tuple of str
        A line each, empty if they are determined.

    """
    here = np.asarray(values, float)[:, None]
    if not np.isfinite(here).all():
        return ('the loops do not close here: no forces without a position',)
    names = ', '.join(loose_variables(mechanism.linkage, mechanism.rates(here)))
    dead = f'dead point of the loop of {names}' if names else 'dead point'
    drivers = ', '.join(driver.name for driver in mechanism.drivers) or 'nothing'
    open_ended = f'{drivers} cannot hold it there, and no effort balances every load'
    joints = mechanism.assembly.joints
    if why_no_reactions(mechanism):
        return (f'{dead}: {open_ended}',) if names else ()
    system = constraints(mechanism, here)
    stressed = system.stress[:, 0] > UNSTRESSED
    joint_rows = zip(system.rows, stressed, strict=False)
    shared = ', '.join(dict.fromkeys(joints[k].name for (k, _), is_so in joint_rows if is_so))
    if names or not system.determined[0]:
        where = f', in the joints {shared}' if shared else ''
        return (f'{dead}{where}: {open_ended}',)
    if not stressed.any():
        return ()
    driver_stress = stressed[len(system.rows) :].tolist()
    unknown = [
        driver.name for driver, is_so in zip(mechanism.drivers, driver_stress, strict=True) if is_so
    ]
    ending = f', nor are the efforts of {", ".join(unknown)}' if unknown else ', the efforts are'
    return (
        f'overconstrained: the reactions in the joints {shared} are not unique{ending}; how they '
        'share a load is a matter of stiffness and fit',
    )
