"""
Statics of a linkage: efforts of its drivers and reactions in its joints, by virtual work.

Both are the power of the loads in a motion in which one driver or joint gives way at unit rate
(`_virtual_motions`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import poses_of
from kinpole_ros.mechanism._dead_points import loose_variables
from kinpole_ros.mechanism._joint_kinds import (
    ACROSS,
    ALONG,
    GROUND,
    TURN,
    Joint,
    Pose,
)
from kinpole_ros.mechanism._loads import (
    Force,
    Load,
    check_loads,
    generalized_forces,
    load_part,
)
from kinpole_ros.mechanism._loops import LinkageError, weigh
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._virtual_motions import (
    MOST_NUMBERS,
    UNSTRESSED,
    VirtualMotions,
    driver_motions,
    powers,
    virtual_motions,
    without_rounding,
)
from kinpole_ros.planar._plane import Complex, Real


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


class _Efforts(NamedTuple):
    """Shares (loads, d, T) of loads in the efforts (d, T), and where these are determined (T,)."""

    share: Real
    effort: Real
    determined: np.ndarray


class _JointForces(NamedTuple):
    """Points and axes (J, T) of the joints, and forces along and across and moments (3, J, T)."""

    at: Complex
    axis: Complex
    components: Real


@dataclass(frozen=True, eq=False)
class Statics:
    """
    The forces that balance loads on a linkage at T positions.

    All reactions, N, are those that the joint's body `one` exerts on its body `other`, acting at
    `at`: the pin, or the point of contact. `axis` is the joint's own direction: of the slot, the
    strut or the tangent, with the wheel to its left. `along` it acts the friction of a wheel or the
    thrust of a strut; `across`, 90 degrees to the left, the normal force, which presses a wheel on
    if it is positive. The effort of a driver is in `effort` alone, except for struts, whose force
    it is. The axis of a pin is the ground's x axis, or the direction that is not determined, so
    that its `across` is.

    Everything is NaN where not `determined`, and reactions also where joints share a load in a way
    that statics alone does not determine; `undetermined` gives the reason. Reactions raise
    LinkageError for a linkage without joints, and with cams.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.
    loads
        Forces, N, and torques, N m.

    Raises
    ------
    LinkageError
        For a load on a body that does not exist.

    Notes
    -----
    Seed 003: virtual work for the efforts, and one constraint released at a time for reactions.
    Both are computed when first asked for, the efforts from the rates alone.

    """

    mechanism: Mechanism
    values: Real
    loads: Sequence[Load]

    def __post_init__(self) -> None:
        check_loads(self.mechanism, self.loads)

    @property
    def share(self) -> Real:
        """The part (loads, d, T) of each load in the efforts, N or N m."""
        return self._efforts.share

    @property
    def effort(self) -> Real:
        """Efforts of the drivers (d, T), N or N m, positive along their rates."""
        return self._efforts.effort

    @property
    def determined(self) -> np.ndarray:
        """Positions (T,) at which joints and drivers determine the poses of all bodies."""
        return self._efforts.determined

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints (J)."""
        return tuple(joint.name for joint in self.mechanism.assembly.joints)

    @property
    def at(self) -> Complex:
        """Points (J, T), complex, m, at which the reactions act."""
        return self._joint_forces.at

    @property
    def axis(self) -> Complex:
        """Directions (J, T) of the joints, complex of length 1."""
        return self._joint_forces.axis

    @property
    def along(self) -> Real:
        """Reactions (J, T), N, along the axes of the joints."""
        return self._joint_forces.components[ALONG]

    @property
    def across(self) -> Real:
        """Reactions (J, T), N, across the axes of the joints, to the left."""
        return self._joint_forces.components[ACROSS]

    @property
    def moment(self) -> Real:
        """Moments (J, T), N m, of prismatic joints."""
        return self._joint_forces.components[TURN]

    @property
    def force(self) -> Complex:
        """The force (J, T), complex, in the ground's axes; NaN if a component of it is."""
        return np.asarray((self.along + 1j * self.across) * self.axis)

    @property
    def unique(self) -> np.ndarray:
        """Whether (J, T) statics alone determines the reaction of a joint."""
        return np.isfinite(self._joint_forces.components).all(axis=0)

    def load_rates(self, driver: int = 0) -> list[Complex | Real]:
        """
        Velocities (T,) of the loads' points or bodies at unit rate of a driver, the others held.

        Complex, in the ground's axes, for a force; the angular velocity for a torque.
        """
        bodies, poses = self.mechanism.bodies, poses_of(self.mechanism.assembly, self.values)
        motion = driver_motions(self.mechanism, self.values).rates[:, driver]
        x, y, omega = motion.reshape(3, len(bodies), -1)
        rates: list[Complex | Real] = []
        for load in self.loads:
            if load.body == GROUND:
                rates.append(np.zeros(self.values.shape[1]))
                continue
            b = bodies.index(load.body)
            rate = omega[b]
            if isinstance(load, Force):
                turning = 1j * omega[b] * load.point * poses[load.body].turn
                rate = np.empty(turning.shape, complex)
                for part, first, last in ('real', x[b], turning.real), ('imag', y[b], turning.imag):
                    size = np.abs(first) + np.abs(last)
                    setattr(rate, part, without_rounding(first + last, size))
            rates.append(rate)
        return rates

    @cached_property
    def releases(self) -> list[Release]:
        """
        Each constraint of each joint let go, one at a time, in the order of the joints.

        The loads are followed by those with which teeth with a pressure angle separate.
        """
        if reason := why_no_reactions(self.mechanism):
            raise LinkageError(reason)
        poses = poses_of(self.mechanism.assembly, self.values)
        motions = virtual_motions(self.mechanism, self.values, poses)
        forces = generalized_forces(self.mechanism, self.values, self.loads)
        forces = _with_teeth(self.mechanism, self.values, poses, motions, forces)
        power = powers(forces, np.abs(forces), motions.rates)
        released = []
        for k, direction, row in motions.bearings:
            way = None if direction == TURN else 1j**direction * motions.axis[k]
            released.append(Release(self.joints[k], way, power[:, row]))
        return released

    @cached_property
    def _efforts(self) -> _Efforts:
        return _Efforts(*self._in_parts(_efforts))

    @cached_property
    def _joint_forces(self) -> _JointForces:
        if reason := why_no_reactions(self.mechanism):
            raise LinkageError(reason)
        return _JointForces(*self._in_parts(_joint_forces))

    def _in_parts(
        self, compute: Callable[[Mechanism, Real, Sequence[Load]], tuple[np.ndarray, ...]]
    ) -> list[np.ndarray]:
        """What `compute` gives, (..., T), for as many positions at a time as memory is bounded."""
        count, size = self.values.shape[1], 2 * len(self.mechanism.bodies) + len(self.values)
        most = MOST_NUMBERS // size**2 + 1
        parts = [slice(first, first + most) for first in range(0, max(count, 1), most)]
        computed = [
            compute(
                self.mechanism, self.values[:, part], [load_part(one, part) for one in self.loads]
            )
            for part in parts
        ]
        return [np.concatenate(arrays, axis=-1) for arrays in zip(*computed, strict=True)]


def _efforts(mechanism: Mechanism, values: Real, loads: Sequence[Load]) -> _Efforts:
    """Efforts by the rates of the drivers."""
    motions, determined = driver_motions(mechanism, values)
    forces = generalized_forces(mechanism, values, loads)
    share = 0.0 - powers(forces, np.abs(forces), motions)
    effort = without_rounding(share.sum(axis=0), np.abs(share).sum(axis=0))
    # Nothing but joints with teeth can lack more than the loops tell: what holds their hubs.
    if _has_teeth(mechanism) and not why_no_reactions(mechanism):
        poses = poses_of(mechanism.assembly, values)
        determined = virtual_motions(mechanism, values, poses).determined
        share[..., ~determined] = np.nan
    return _Efforts(share, effort + 0.0 * motions.sum(axis=0), determined)


def _joint_forces(mechanism: Mechanism, values: Real, loads: Sequence[Load]) -> _JointForces:
    """Reactions by the power of all loads in the motion in which each row gives way."""
    joints, poses = mechanism.assembly.joints, poses_of(mechanism.assembly, values)
    motions = virtual_motions(mechanism, values, poses)
    forces = generalized_forces(mechanism, values, loads)
    forces = _with_teeth(mechanism, values, poses, motions, forces)
    force = 0.0 - powers(forces.sum(axis=0), np.abs(forces).sum(axis=0), motions.rates)
    components = np.zeros((3, *motions.axis.shape))
    for k, direction, row in motions.bearings:
        components[direction, k] = force[row]
    efforts = force[len(force) - len(mechanism.drivers) :]
    names, rows = mechanism.assembly.loops.variables, mechanism.driver_rows
    for k, joint in enumerate(joints):
        if joint.pressure is not None:
            components[ACROSS, k] = np.abs(components[ALONG, k]) * np.tan(joint.pressure)
        elif joint.is_span and joint.is_driven:
            # The effort of a driver is the force of a strut, or over its length that across it.
            length, angle = names.index(joint.name), names.index(f'{joint.name}.angle')
            components[ALONG, k] = weigh(rows[:, [length]].T, efforts)[0]
            components[ACROSS, k] = weigh(rows[:, [angle]].T, efforts)[0] / values[length]
    components[:, :, ~motions.determined] = np.nan
    return _JointForces(motions.contact, motions.axis, components)


def _with_teeth(
    mechanism: Mechanism,
    values: Real,
    poses: dict[str, Pose],
    motions: VirtualMotions,
    forces: Real,
) -> Real:
    """
    Generalized forces (loads, 3B, T), and those by which teeth separate each other.

    These do no work, so the force that teeth transmit does not depend on them.
    """
    if not _has_teeth(mechanism):
        return forces
    joints = mechanism.assembly.joints
    transmitted = powers(forces.sum(axis=0), np.abs(forces).sum(axis=0), motions.rates)
    loads: list[Load] = []
    for row, (k, direction) in enumerate(motions.labels):
        if k is not None and direction == ALONG and joints[k].pressure is not None:
            at, axis = motions.contact[k], motions.axis[k]
            loads += separating_loads(joints[k], poses, at, axis, transmitted[row])
    return np.concatenate((forces, generalized_forces(mechanism, values, loads)))


def _has_teeth(mechanism: Mechanism) -> bool:
    """Whether any wheels have teeth with a pressure angle."""
    return any(joint.pressure is not None for joint in mechanism.assembly.joints)


def separating_loads(
    joint: Joint, poses: dict[str, Pose], at: Complex, axis: Complex, transmitted: Real
) -> list[Load]:
    """The two forces that separate the teeth of a joint, which transmit a force (T,)."""
    push = np.abs(transmitted) * np.tan(joint.pressure or 0.0) * 1j * axis
    loads: list[Load] = []
    for body, force in ((joint.one, -push), (joint.other, push)):
        if body != GROUND:
            arm = (at - poses[body].position) * poses[body].turn.conj()
            loads.append(Force(body, arm, force))
    return loads


def loose_teeth(mechanism: Mechanism, values: Real) -> tuple[str, ...]:
    """The joints with a pressure angle, at one position (n,), if nothing else holds their hubs."""
    joints = mechanism.assembly.joints
    toothed = [joint.name for joint in joints if joint.pressure is not None]
    if not toothed or why_no_reactions(mechanism):
        return ()
    smooth = (one.changed(pressure=None) if one.name in toothed else one for one in joints)
    assembly = mechanism.assembly._replace(joints=tuple(smooth))
    rigid = Mechanism(assembly, mechanism.drivers, mechanism.start)
    here = values[:, None]
    poses = poses_of(assembly, here)
    ranks = [virtual_motions(one, here, poses).rank[0] for one in (mechanism, rigid)]
    return tuple(toothed) if ranks[0] < ranks[1] else ()


def why_no_reactions(mechanism: Mechanism) -> str:
    """The reason for which a linkage has no reactions in its joints, empty if it has them."""
    if not mechanism.assembly.joints:
        return 'vectors have no joints: for what these bear write bodies and joints'
    if mechanism.assembly.loops.laws:
        return (
            'what joints bear depends on where a cam or a Geneva wheel is touched, which its law '
            'does not say: only the efforts of the drivers are determined'
        )
    return ''


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
    if why_no_reactions(mechanism):
        return (f'{dead}: {open_ended}',) if names else ()
    system = virtual_motions(mechanism, here, poses_of(mechanism.assembly, here))
    stressed = system.stress[:, 0] > UNSTRESSED
    of_joints = (
        mechanism.assembly.joints[k].name for k, _, row in system.bearings if stressed[row]
    )
    shared = ', '.join(dict.fromkeys(of_joints))
    if names or not system.determined[0]:
        where = f', in the joints {shared}' if shared else ''
        return (f'{dead}{where}: {open_ended}',)
    if not stressed.any():
        return ()
    driver_stress = stressed[len(stressed) - len(mechanism.drivers) :].tolist()
    unknown = [
        driver.name for driver, is_so in zip(mechanism.drivers, driver_stress, strict=True) if is_so
    ]
    ending = f', nor are the efforts of {", ".join(unknown)}' if unknown else ', the efforts are'
    return (
        f'overconstrained: the reactions in the joints {shared} are not unique{ending}; how they '
        'share a load is a matter of stiffness and fit',
    )
