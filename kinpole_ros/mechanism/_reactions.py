"""
Reactions in the joints of a linkage: Lagrange multipliers of the constraints between its bodies.

The constraint Jacobian A is in absolute coordinates (x, y, θ of each body). It has one row for each
direction in which a joint constrains its bodies (`constraint_rows`) and one for each driver. With
the loads Q in these coordinates A^T λ = -Q. The column of the inverse of A that belongs to a row is
the motion of the bodies where the joint gives way in that direction alone, as seed 003 has it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import largest_length, poses_of
from kinpole_ros.mechanism._joints import (
    ACROSS_AXIS,
    ALONG_AXIS,
    GROUND,
    POSE_COLUMNS,
    TURN,
    Joint,
    Pose,
    Revolute,
    Rolling,
    Strut,
    constraint_rows,
    contact,
    variable_rates,
)
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._statics import (
    SINGULAR_VALUE,
    Force,
    Load,
    at_rest,
    check_loads,
    driver_rows,
    inverse_values,
    stacked_svd,
)
from kinpole_ros.planar._plane import Complex, Real

# A constraint with less than this share in a state of self-stress has a unique reaction.
_UNSTRESSED = 1e-6


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
        """Where (J, T) statics alone determines the reaction of a joint."""
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
        Of J joints at T positions, N and N m, in the ground's axes.

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
    system = _constraints(mechanism, values)
    powers = system.powers(mechanism, [*loads, *_tooth_loads(mechanism, system, loads)])
    multipliers = system.multipliers(powers)
    parts = np.zeros((3, *system.contact.shape))
    parts[:, :, ~system.determined] = np.nan
    for (k, direction), multiplier in zip(system.rows, multipliers, strict=False):
        parts[direction, k] = multiplier
    effort = multipliers[len(system.rows) :]
    names, rows = mechanism.assembly.loops.variables, driver_rows(mechanism)
    for k, joint in enumerate(mechanism.assembly.joints):
        if isinstance(joint, Rolling) and joint.pressure is not None:
            parts[ACROSS_AXIS, k] = np.abs(parts[ALONG_AXIS, k]) * np.tan(joint.pressure)
        elif isinstance(joint, Strut):
            length = values[names.index(joint.name)]
            for direction, name, arm in (
                (ALONG_AXIS, joint.name, 1.0),
                (ACROSS_AXIS, f'{joint.name}.angle', length),
            ):
                weight = rows[:, names.index(name)]
                if weight.any():
                    parts[direction, k] += weight[weight != 0] @ effort[weight != 0] / arm
    return Reactions(
        tuple(joint.name for joint in mechanism.assembly.joints),
        parts[ALONG_AXIS],
        parts[ACROSS_AXIS],
        parts[TURN],
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
    system = _constraints(mechanism, values)
    loads = [*loads, *_tooth_loads(mechanism, system, loads)]
    powers = system.powers(mechanism, loads)
    released = []
    for row, (k, direction) in enumerate(system.rows):
        way = None if direction == TURN else 1j**direction * system.axis[k]
        name = mechanism.assembly.joints[k].name
        released.append(Release(name, way, powers[:, row]))
    return released, loads


class _Constraints(NamedTuple):
    """
    The inverse of the constraint Jacobian at T positions, and what the constraints determine.

    `rows` are (joint, direction) of the R rows, which those of the drivers follow. `contact` and
    `axis` (J, T) are the points and directions of the joints. `motions` (3B, R + d, T) are the
    velocities of all bodies at unit rate of one row, all others held, NaN where no load can tell
    its multiplier. `stress` (R + d, T) is the share of each row in the reactions that are possible
    without any load.
    """

    poses: dict[str, Pose]
    rows: list[tuple[int, int]]
    contact: Complex
    axis: Complex
    motions: Real
    stress: Real
    rank: np.ndarray

    @property
    def determined(self) -> np.ndarray:
        """Where (T,) the constraints determine the poses of all bodies."""
        return np.asarray(self.rank == len(self.motions))

    def multipliers(self, powers: Real) -> Real:
        """Multipliers (R + d, T) of the rows at the powers of all loads in their motions."""
        return np.where(np.isnan(self.motions[0]), np.nan, -powers.sum(axis=0))

    def powers(self, mechanism: Mechanism, loads: Sequence[Load]) -> Real:
        """Powers (loads, R + d, T) of the loads in the motions."""
        powers = np.empty((len(loads), *self.motions.shape[1:]))
        for power, load in zip(powers, loads, strict=True):
            if load.body == GROUND:
                power[...] = 0.0
                continue
            first = 3 * mechanism.bodies.index(load.body)
            x, y, turn = self.motions[first : first + 3]
            if isinstance(load, Force):
                pose, force = self.poses[load.body], np.asarray(load.force, complex)
                arm = pose.point(load.point) - pose.position
                power[...] = force.real * x + force.imag * y + (arm.conj() * force).imag * turn
            else:
                power[...] = load.torque * turn
        return powers


def _constraints(mechanism: Mechanism, values: Real) -> _Constraints:
    """The constraints of all joints and drivers at variables (n, T)."""
    if reason := why_no_reactions(mechanism):
        raise LinkageError(reason)
    joints, poses = mechanism.assembly.joints, poses_of(mechanism.assembly, values)
    meeting = [contact(joint, poses[joint.one], poses[joint.other]) for joint in joints]
    at, axis = (np.array(part) for part in zip(*meeting, strict=True))
    rows, matrix = _jacobian(mechanism, poses)
    column = np.ones(3 * len(mechanism.bodies))
    column[2::3] = largest_length(mechanism.assembly, values)
    matrix = matrix / column[:, None]
    size = np.sqrt((matrix**2).sum(axis=1))
    u, s, vt = stacked_svd(matrix / size[:, None])
    rank = (s > SINGULAR_VALUE * s[:, :1]).sum(axis=1)
    # Left null space: reactions that balance each other without a load.
    beyond = np.arange(u.shape[2]) >= rank[:, None]
    balanced = np.moveaxis(np.where(beyond[:, None, :], u, 0.0), 0, -1)
    most = s.shape[1]
    inverse = (vt[:, :most].swapaxes(1, 2) * inverse_values(s)[:, None]) @ u[:, :, :most].swapaxes(
        1, 2
    )
    motions = np.moveaxis(inverse, 0, -1) / column[:, None, None] / size
    stress = np.sqrt((balanced**2).sum(axis=1))
    for row, (k, direction) in enumerate(rows):
        if not isinstance(joints[k], Revolute) or direction != ALONG_AXIS:
            continue
        # The main axis of the forces that a pin can have without a load, and across it the rest.
        pin = slice(row, row + 2)
        with np.errstate(invalid='ignore'):
            forces = balanced[row] / size[row] + 1j * balanced[row + 1] / size[row + 1]
        main = (forces**2).sum(axis=0)
        axis[k] = np.where(np.abs(main) > _UNSTRESSED**2, np.exp(0.5j * np.angle(main)), 1.0)
        turned = forces * axis[k].conj()
        stress[pin] = np.sqrt((turned.real**2).sum(axis=0)), np.sqrt((turned.imag**2).sum(axis=0))
        x, y = motions[:, row].copy(), motions[:, row + 1].copy()
        motions[:, row] = axis[k].real * x + axis[k].imag * y
        motions[:, row + 1] = axis[k].real * y - axis[k].imag * x
    motions[:, (stress > _UNSTRESSED) | (rank < len(column))] = np.nan
    return _Constraints(poses, rows, at, axis, motions, stress, rank)


def _jacobian(mechanism: Mechanism, poses: dict[str, Pose]) -> tuple[list[tuple[int, int]], Real]:
    """The rows of the joints, as (joint, direction), and all derivatives (R + d, 3B, T)."""
    bodies, count = mechanism.bodies, len(poses[GROUND].angle)

    def spread(joint: Joint, slope: Real) -> Real:
        """Derivatives (3B, T) by all bodies from those (T, 6) by the two of a joint."""
        row = np.zeros((3 * len(bodies), count))
        for body, columns in ((joint.one, slope[:, :3]), (joint.other, slope[:, 3:])):
            if body != GROUND:
                first = 3 * bodies.index(body)
                row[first : first + 3] = columns.T
        return row

    rows: list[tuple[int, int]] = []
    matrix: list[Real] = []
    rates: dict[str, Real] = {}
    driven = driver_rows(mechanism)
    names = mechanism.assembly.loops.variables
    for k, joint in enumerate(mechanism.assembly.joints):
        pair = poses[joint.one], poses[joint.other]
        constraint = constraint_rows(joint, *pair)
        for r in np.argsort(constraint.direction).tolist():
            direction = constraint.direction[r]
            # Nothing but other joints keeps teeth with a pressure angle from moving apart.
            if direction == ALONG_AXIS or not _has_teeth(joint):
                rows.append((k, direction))
                matrix.append(spread(joint, constraint.slope[:, r, :POSE_COLUMNS]))
        for name, slope in variable_rates(joint, *pair).items():
            rates[name] = spread(joint, slope)
    for b, body in enumerate(bodies):
        rates[body] = np.zeros((3 * len(bodies), count))
        rates[body][3 * b + 2] = 1.0
    for row in driven:
        used = {names[k]: row[k] for k in np.flatnonzero(row)}
        matrix.append(sum((weight * rates[name] for name, weight in used.items()), np.zeros(())))
    return rows, np.array(matrix)


def _has_teeth(joint: Joint) -> bool:
    """Whether a joint is one of teeth with a pressure angle."""
    return isinstance(joint, Rolling) and joint.pressure is not None


def _tooth_loads(mechanism: Mechanism, system: _Constraints, loads: Sequence[Load]) -> list[Load]:
    """
    The forces by which teeth with a pressure angle separate each other, as loads.

    They follow from the force that the teeth transmit, which does not depend on them, since they do
    no work.
    """
    joints = mechanism.assembly.joints
    if not any(map(_has_teeth, joints)):
        return []
    transmitted = system.multipliers(system.powers(mechanism, loads))
    separating: list[Load] = []
    for row, (k, _) in enumerate(system.rows):
        joint = joints[k]
        if isinstance(joint, Rolling) and joint.pressure is not None:
            separating += _separating(joint, system, k, transmitted[row])
    return separating


def _separating(joint: Rolling, system: _Constraints, k: int, transmitted: Real) -> list[Load]:
    """The two forces that separate the teeth of joint k, which transmit a force (T,)."""
    push = np.abs(transmitted) * np.tan(joint.pressure or 0.0) * 1j * system.axis[k]
    loads: list[Load] = []
    for body, force in ((joint.one, -push), (joint.other, push)):
        if body != GROUND:
            pose = system.poses[body]
            arm = (system.contact[k] - pose.position) * np.exp(-1j * pose.angle)
            loads.append(Force(body, arm, force))
    return loads


def loose_teeth(mechanism: Mechanism, values: Real) -> tuple[str, ...]:
    """The joints with a pressure angle, at one position (n,), if nothing else holds their hubs."""
    joints = mechanism.assembly.joints
    toothed = [joint for joint in joints if _has_teeth(joint)]
    if not toothed or why_no_reactions(mechanism):
        return ()
    smooth = tuple(j._replace(pressure=None) if isinstance(j, Rolling) else j for j in joints)
    assembly = mechanism.assembly._replace(joints=smooth)
    without_pressure = Mechanism(assembly, mechanism.drivers, mechanism.start)
    ranks = [_constraints(m, values[:, None]).rank[0] for m in (mechanism, without_pressure)]
    return tuple(joint.name for joint in toothed) if ranks[0] < ranks[1] else ()


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
    loose = at_rest(mechanism, here).loose[:, 0]
    variables = mechanism.assembly.loops.variables
    names = ', '.join(name for name, is_loose in zip(variables, loose, strict=True) if is_loose)
    dead = f'dead point of the loop of {names}' if names else 'dead point'
    drivers = ', '.join(driver.name for driver in mechanism.drivers) or 'nothing'
    open_ended = f'{drivers} cannot hold it there, and no effort balances every load'
    joints = mechanism.assembly.joints
    if why_no_reactions(mechanism):
        return (f'{dead}: {open_ended}',) if names else ()
    system = _constraints(mechanism, here)
    stressed = system.stress[:, 0] > _UNSTRESSED
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


def why_no_reactions(mechanism: Mechanism) -> str:
    """
    The reason for which a linkage has no reactions in its joints.

    Parameters
    ----------
    mechanism
        The linkage.

    Returns
    -------
    str
        The reason, empty if it has them.

    """
    if not mechanism.assembly.joints:
        return 'vectors have no joints: for what these bear write bodies and joints'
    if mechanism.assembly.loops.laws:
        return (
            'what joints bear depends on where a cam or a Geneva wheel is touched, which its law '
            'does not say: only the efforts of the drivers are determined'
        )
    return ''
