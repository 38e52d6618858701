"""
Statics of a linkage: efforts of its drivers and reactions in its joints, by virtual work.

Both are the power of the loads in a motion in which one driver or joint gives way at unit rate
(`_virtual_motions`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import poses_of
from kinpole_ros.mechanism._dead_points import loose_variables
from kinpole_ros.mechanism._joint_kinds import ACROSS, ALONG, GROUND, TURN, Pose, Rolling
from kinpole_ros.mechanism._loads import Force, Load, check_loads
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._virtual_motions import (
    UNSTRESSED,
    VirtualMotions,
    has_teeth,
    virtual_motions,
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


class UnitMotion(NamedTuple):
    """
    The bodies (B) at T positions when one driver moves at unit rate, the others held.

    `velocity` (B, T), complex, is that of their origins, `omega` (B, T) the angular one, `rates`
    (n, T) those of the variables; NaN where they are not determined.
    """

    velocity: Complex
    omega: Real
    rates: Real


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

    """

    mechanism: Mechanism
    values: Real
    loads: Sequence[Load]

    def __post_init__(self) -> None:
        check_loads(self.mechanism, self.loads)

    @cached_property
    def poses(self) -> dict[str, Pose]:
        """Poses of all bodies by name, the ground first."""
        return poses_of(self.mechanism.assembly, self.values)

    @cached_property
    def motions(self) -> VirtualMotions:
        """The motions in which one joint or driver gives way."""
        return virtual_motions(self.mechanism, self.values, self.poses)

    @cached_property
    def determined(self) -> np.ndarray:
        """Positions (T,) at which joints and drivers determine the poses of all bodies."""
        return self.motions.determined

    @cached_property
    def share(self) -> Real:
        """The part (loads, d, T) of each load in the efforts, N or N m."""
        return -self._powers(self.loads)[:, self.motions.drivers]

    @cached_property
    def effort(self) -> Real:
        """Efforts of the drivers (d, T), N or N m, positive along their rates."""
        return self.share.sum(axis=0) + 0.0 * self.motions.rates[0, self.motions.drivers]

    def unit_motion(self, driver: int) -> UnitMotion:
        """All bodies at unit rate of a driver, the others held."""
        motion = self.motions.rates[:, self.motions.drivers][:, driver]
        x, y, rates = np.split(motion, [len(self.poses) - 1, 2 * len(self.poses) - 2])
        return UnitMotion(x + 1j * y, self.mechanism.assembly.turns @ rates, rates)

    def load_rates(self, driver: int = 0) -> list[Complex | Real]:
        """
        Velocities (T,) of the loads' points or bodies at unit rate of a driver, the others held.

        Complex, in the ground's axes, for a force; the angular velocity for a torque.
        """
        motion = self.unit_motion(driver)
        rates: list[Complex | Real] = []
        for load in self.loads:
            if load.body == GROUND:
                rates.append(np.zeros(self.values.shape[1]))
                continue
            b = self.mechanism.bodies.index(load.body)
            rate = motion.omega[b]
            if isinstance(load, Force):
                rate = motion.velocity[b] + 1j * rate * load.point * self.poses[load.body].turn
            rates.append(rate)
        return rates

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints (J)."""
        return tuple(joint.name for joint in self.mechanism.assembly.joints)

    @property
    def at(self) -> Complex:
        """Points (J, T), complex, m, at which the reactions act."""
        return self.motions.contact

    @property
    def axis(self) -> Complex:
        """Directions (J, T) of the joints, complex of length 1."""
        return self.motions.axis

    @property
    def along(self) -> Real:
        """Reactions (J, T), N, along the axes of the joints."""
        return self._reactions[ALONG]

    @property
    def across(self) -> Real:
        """Reactions (J, T), N, across the axes of the joints, to the left."""
        return self._reactions[ACROSS]

    @property
    def moment(self) -> Real:
        """Moments (J, T), N m, of prismatic joints."""
        return self._reactions[TURN]

    @property
    def force(self) -> Complex:
        """The force (J, T), complex, in the ground's axes; NaN if a component of it is."""
        return np.asarray((self.along + 1j * self.across) * self.axis)

    @property
    def unique(self) -> np.ndarray:
        """Whether (J, T) statics alone determines the reaction of a joint."""
        return np.isfinite(self.along + self.across + self.moment)

    @cached_property
    def acting(self) -> list[Load]:
        """The loads with those by which teeth with a pressure angle separate each other."""
        joints = self.mechanism.assembly.joints
        if not any(map(has_teeth, joints)):
            return list(self.loads)
        # These do no work, so the force that teeth transmit does not depend on them.
        transmitted = -self._powers(self.loads).sum(axis=0)
        acting = list(self.loads)
        for row, (k, direction) in enumerate(self.motions.labels):
            if k is not None and direction == ALONG and has_teeth(joints[k]):
                acting += separating_loads(self, k, transmitted[row])
        return acting

    @cached_property
    def releases(self) -> list[Release]:
        """Each constraint of each joint let go, one at a time, in the order of the joints."""
        if reason := why_no_reactions(self.mechanism):
            raise LinkageError(reason)
        powers, joints = self._powers(self.acting), self.mechanism.assembly.joints
        released = []
        for k, direction, row in self.motions.bearings:
            way = None if direction == TURN else 1j**direction * self.axis[k]
            released.append(Release(joints[k].name, way, powers[:, row]))
        return released

    @cached_property
    def _reactions(self) -> Real:
        """Reactions (3, J, T): along the axis, across it, and moments."""
        if reason := why_no_reactions(self.mechanism):
            raise LinkageError(reason)
        forces = 0.0 * self.motions.rates[0] - self._powers(self.acting).sum(axis=0)
        components = np.zeros((3, *self.at.shape))
        components[:, :, ~self.determined] = np.nan
        for k, direction, row in self.motions.bearings:
            components[direction, k] = forces[row]
        for k, joint in enumerate(self.mechanism.assembly.joints):
            if isinstance(joint, Rolling) and joint.pressure is not None:
                components[ACROSS, k] = np.abs(components[ALONG, k]) * np.tan(joint.pressure)
        for k, direction, row in self.motions.driven_struts:
            components[direction, k] = forces[row]
        return components

    def _powers(self, loads: Sequence[Load]) -> Real:
        """Powers (loads, rows, T) of loads in the virtual motions."""
        assembly, motions = self.mechanism.assembly, self.motions.rates
        count = len(assembly.bodies)
        turning = np.einsum('bn,nrt->brt', assembly.turns, motions[2 * count :])
        powers = np.zeros((len(loads), *motions.shape[1:]))
        for power, load in zip(powers, loads, strict=True):
            if load.body == GROUND:
                continue
            b = assembly.bodies.index(load.body)
            if isinstance(load, Force):
                force = np.asarray(load.force, complex)
                arm = load.point * self.poses[load.body].turn
                power += force.real * motions[b] + force.imag * motions[count + b]
                power += (np.conj(arm) * force).imag * turning[b]
            else:
                power += load.torque * turning[b]
        return powers


def separating_loads(statics: Statics, k: int, transmitted: Real) -> list[Load]:
    """The two forces that separate the teeth of joint k, which transmit a force (T,)."""
    joint = statics.mechanism.assembly.joints[k]
    assert isinstance(joint, Rolling)
    push = np.abs(transmitted) * np.tan(joint.pressure or 0.0) * 1j * statics.axis[k]
    loads: list[Load] = []
    for body, force in ((joint.one, -push), (joint.other, push)):
        if body != GROUND:
            pose = statics.poses[body]
            arm = (statics.at[k] - pose.position) * pose.turn.conj()
            loads.append(Force(body, arm, force))
    return loads


def loose_teeth(mechanism: Mechanism, values: Real) -> tuple[str, ...]:
    """The joints with a pressure angle, at one position (n,), if nothing else holds their hubs."""
    joints = mechanism.assembly.joints
    toothed = [joint.name for joint in joints if has_teeth(joint)]
    if not toothed or why_no_reactions(mechanism):
        return ()
    smooth = tuple(j._replace(pressure=None) if isinstance(j, Rolling) else j for j in joints)
    assembly = mechanism.assembly._replace(joints=smooth)
    rigid = Mechanism(assembly, mechanism.drivers, mechanism.start)
    ranks = [Statics(one, values[:, None], ()).motions.rank[0] for one in (mechanism, rigid)]
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
    statics = Statics(mechanism, here, ())
    system = statics.motions
    stressed = system.stress[:, 0] > UNSTRESSED
    of_joints = (statics.joints[k] for k, _, row in system.bearings if stressed[row])
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
