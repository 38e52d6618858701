"""
What the joints of a linkage bear, from the multipliers of its constraints (`_constraints`).

`_freed` finds the same in another way.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import GROUND, Joint, Rolling, Strut
from kinpole_ros.mechanism._constraints import (
    NO_SHARE,
    Constraints,
    constraints,
    value_of,
    why_no_reactions,
)
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._statics import (
    Force,
    Load,
    at_rest,
    check_loads,
    driver_rows,
    inverse_values,
)
from kinpole_ros.planar._plane import Complex, Real


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
    What each joint bears: the multipliers λ of the constraint Jacobian A.

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
        For a linkage given by vectors alone, which has no joints, or a load on a body that is not
        there.

    Notes
    -----
    With the loads Q in absolute coordinates, A^T λ = -Q: one row of A for each direction in which a
    joint holds, and one for each driver.

    """
    check_loads(mechanism, loads)
    system = constraints(mechanism, values)
    parts, effort = _multipliers(mechanism, system, loads)
    separating = separating_forces(mechanism, system, parts[0])
    if separating:
        teeth, (parts, effort) = parts[0], _multipliers(mechanism, system, [*loads, *separating])
        add_teeth(mechanism, parts, teeth)
    determined = system.rank == len(system.column)
    return assembled(mechanism, values, system, parts, effort, determined)


def _multipliers(
    mechanism: Mechanism, system: Constraints, loads: Sequence[Load]
) -> tuple[Real, Real]:
    """What the rows of all joints bear (3, J, T), and those of the drivers (d, T)."""
    u, s, vt = system.svd
    applied = system.pull(loads, mechanism) / system.column[:, None]
    along = inverse_values(s) * (vt @ applied.T[..., None])[..., 0][:, : s.shape[1]]
    found = -(u[:, :, : s.shape[1]] @ along[..., None])[..., 0].T / system.size
    for first in system.pins:
        pin = (found[first] + 1j * found[first + 1]) * system.axis[system.rows[first][0]].conj()
        found[first], found[first + 1] = pin.real, pin.imag
    lost = system.rank < len(system.column)
    found[system.stress > NO_SHARE] = np.nan
    found[:, lost] = np.nan
    parts = np.zeros((3, *system.at.shape))
    parts[:, :, lost] = np.nan
    for (k, part), row in zip(system.rows, found, strict=False):
        parts[part, k] = row
    return parts, found[len(system.rows) :]


def has_teeth(joint: Joint) -> bool:
    """Whether a joint is one of teeth with a pressure angle."""
    return isinstance(joint, Rolling) and joint.pressure is not None


def separating_forces(mechanism: Mechanism, system: Constraints, along: Real) -> list[Load]:
    """
    The forces by which teeth with a pressure angle separate each other, as loads, from what they
    transmit, `along` (J, T): that does not depend on them, as they do no work.
    """
    found: list[Load] = []
    for k, joint in enumerate(mechanism.assembly.joints):
        if not isinstance(joint, Rolling) or joint.pressure is None:
            continue
        push = np.abs(along[k]) * np.tan(joint.pressure) * 1j * system.axis[k]
        for body, force in ((joint.one, -push), (joint.other, push)):
            if body != GROUND:
                arm = system.at[k] - system.frame.origin[body]
                found.append(Force(body, arm * np.exp(-1j * system.frame.angle[body]), force))
    return found


def add_teeth(mechanism: Mechanism, parts: Real, along: Real) -> None:
    """Fill in what teeth with a pressure angle bear across, which is no row of their own."""
    for k, joint in enumerate(mechanism.assembly.joints):
        if isinstance(joint, Rolling) and joint.pressure is not None:
            parts[1, k] = np.abs(along[k]) * np.tan(joint.pressure)


def loose_teeth(mechanism: Mechanism, values: Real) -> tuple[str, ...]:
    """The joints with a pressure angle, at one position (n,), if nothing else holds their hubs."""
    joints = mechanism.assembly.joints
    toothed = [j for j in joints if isinstance(j, Rolling) and j.pressure is not None]
    if not toothed or why_no_reactions(mechanism):
        return ()
    smooth = tuple(j._replace(pressure=None) if j in toothed else j for j in joints)
    assembly = mechanism.assembly._replace(joints=smooth)
    held = Mechanism(assembly, mechanism.drivers, mechanism.start)
    ranks = [constraints(one, values[:, None]).rank[0] for one in (mechanism, held)]
    return tuple(joint.name for joint in toothed) if ranks[0] < ranks[1] else ()


def undetermined(mechanism: Mechanism, values: Real) -> tuple[str, ...]:
    """
    Why efforts or reactions are NaN at one position.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n,), m and rad.

    Returns
    -------
    tuple of str
        A line each, none if they are not.

    """
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
    if why_no_reactions(mechanism):
        return (f'{dead}: {open_ended}',) if names else ()
    system = constraints(mechanism, here)
    stressed = system.stress[:, 0] > NO_SHARE
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


def assembled(
    mechanism: Mechanism,
    values: Real,
    system: Constraints,
    parts: Real,
    effort: Real,
    determined: np.ndarray,
) -> Reactions:
    """Assemble what joints bear (3, J, T), and what drivers exert through struts."""
    joints = mechanism.assembly.joints
    names, rows = mechanism.assembly.loops.variables, driver_rows(mechanism)
    for k, joint in enumerate(joints):
        if isinstance(joint, Strut):
            length = value_of(mechanism, values, joint.name)
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
