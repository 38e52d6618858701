"""
How a linkage passes on what drives it: its mechanical advantage and its transmission angles.

Both are of velocities alone; loads, friction and inertia do not come in.
"""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.mechanism._assembly import largest_length
from kinpole_ros.mechanism._joints import Belt
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._solution import SINGULAR, solve
from kinpole_ros.mechanism._statics import (
    Force,
    Moving,
    Torque,
    check_loads,
    power_of,
    unit_drive,
)
from kinpole_ros.planar._plane import ROUNDING, Real

# Where power goes in or out: along a force, with a torque, or with a variable by its name.
Port = Force | Torque | str


def advantage(mechanism: Mechanism, values: Real, into: Port, out: Port) -> Real:
    """
    Mechanical advantage: what the linkage exerts at `out` over what is exerted at `into`.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.
    into, out
        A force (only its point and direction count), a torque (only its body), or a variable by its
        name, as a driver or a slide. With several drivers the input is one of them, the others are
        held.

    Returns
    -------
    ndarray
        Of shape (T,), N or N m over N or N m. Infinite where the output stands still while the
        input moves (a toggle), zero the other way round, NaN at dead points of the driver.

    Raises
    ------
    LinkageError
        For a port that is not there, or an input that is none of several drivers.

    Notes
    -----
    All power that goes in comes out, so it is the rate of `into` over that of `out` (seed 003).

    """
    names = [driver.name for driver in mechanism.drivers]
    if not names:
        raise LinkageError('without a driver nothing moves: there is no advantage, add a driver')
    if len(names) > 1 and (into not in names or out in names):
        raise LinkageError(
            f'with {len(names)} drivers the advantage is that of one of them, the others held: '
            f'give {names[0]} or another as the input, and a force or torque as the output'
        )
    k = names.index(into) if isinstance(into, str) and into in names else 0
    moving = unit_drive(mechanism, values, k)
    length = largest_length(mechanism.assembly, values)
    fastest = np.maximum(np.abs(moving.velocity), np.abs(moving.omega) * length).max(axis=0)
    rates = []
    for port in (into, out):
        if isinstance(port, str):
            rates.append(_rate(mechanism, moving, k, port, fastest, length))
            continue
        check_loads(mechanism, [port])
        if isinstance(port, Force):
            size = np.abs(port.force)
            if not np.all(size > 0):
                raise LinkageError(f'the force on {port.body} needs a direction, to be a port')
            port, least = port._replace(force=port.force / size), fastest
        else:
            port, least = port._replace(torque=1.0), fastest / length
        rate = power_of(mechanism, port, moving)
        rates.append(np.where(np.abs(rate) > ROUNDING * least, rate, 0.0))
    with np.errstate(divide='ignore', invalid='ignore'):
        ratio = rates[0] / rates[1]
    # The sign of an infinite advantage is that of a rounding error: there is none.
    return np.where(moving.determined, np.where(np.isinf(ratio), np.inf, ratio), np.nan)


def _rate(
    mechanism: Mechanism, moving: Moving, k: int, port: str, fastest: Real, length: float
) -> Real:
    """The rate (T,) of a variable, or of a driver, at unit rate of driver `k`."""
    names = [driver.name for driver in mechanism.drivers]
    if port in names:
        return np.full(len(moving.determined), float(names.index(port) == k))
    kinds = mechanism.assembly.kinds
    if port not in kinds:
        raise LinkageError(f'no variable {port}: there are {", ".join(kinds)}')
    rate = moving.rates[list(kinds).index(port)]
    least = fastest if kinds[port] == 'length' else fastest / length
    return np.where(np.abs(rate) > ROUNDING * least, rate, 0.0)


def transmission_angles(mechanism: Mechanism, values: Real) -> dict[tuple[str, ...], Real]:
    """
    Transmission angles, by the two variables of each dyad.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.

    Returns
    -------
    dict
        By names of variables (T,), rad, 0 to π/2: the acute angle between the dyad's two links; of
        a link and a slide, that between the link and the normal to the slide. Loops that are no
        dyads, or have a belt, have none.

    Notes
    -----
    The sine is the determinant of the dyad's equations over the lengths of their columns, so it is
    zero at a dead point.

    """
    linkage = mechanism.linkage
    inputs = np.zeros((2, len(mechanism.drivers), values.shape[1]))
    inputs[0] = np.stack([driver.row for driver in mechanism.drivers]) @ values
    sines = np.abs(solve(linkage, inputs, values, 2, close=False).determinant)
    sines[sines <= SINGULAR] = 0.0
    found = {
        _names(mechanism, block.unknown): np.arcsin(np.minimum(sine, 1.0))
        for block, sine in zip(linkage.blocks, sines, strict=True)
        if block.dyad
    }
    belts = {joint.name for joint in mechanism.assembly.joints if isinstance(joint, Belt)}
    return {names: angle for names, angle in found.items() if belts.isdisjoint(names)}


def _names(mechanism: Mechanism, unknown: Sequence[int]) -> tuple[str, ...]:
    variables = mechanism.assembly.loops.variables
    return tuple(variables[mechanism.linkage.unknown[k]] for k in unknown)
