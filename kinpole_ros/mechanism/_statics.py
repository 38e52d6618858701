"""
Statics of a linkage by virtual work: efforts of its drivers, mechanical advantage, transmission.

Loads and drivers do no net work in any motion that the joints allow (seed 003), which gives the
efforts without the reactions in the joints (`_reactions`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import body_motion, largest_length
from kinpole_ros.mechanism._joints import GROUND, Belt
from kinpole_ros.mechanism._loads import Force, Holder, Load, Torque, check_loads
from kinpole_ros.mechanism._loops import Block, LinkageError, loop_jacobian, term_lengths
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._solution import SINGULAR
from kinpole_ros.planar._plane import ROUNDING, Complex, Real

# Share of the largest rate of a term at which a loop counts as opening.
_OPENING = np.sqrt(ROUNDING)
# A port for power, in or out: along a force, with a torque, or with a variable by its name.
Port = Force | Torque | str


class Efforts(NamedTuple):
    """
    The efforts of the drivers that balance the loads.

    `effort` (d, T), N for a slide or length and N m for an angle, is positive along the rate of the
    driver. `share` (K, d, T) is the part of each load; they add up to the effort. NaN where not
    `determined` (d, T).
    """

    effort: Real
    share: Real
    determined: np.ndarray


def efforts(mechanism: Mechanism, values: Real, loads: Sequence[Load]) -> Efforts:
    """
    Efforts of the drivers that balance loads, by virtual work.

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
    Efforts
        Those of d drivers at T positions, N or N m.

    Raises
    ------
    LinkageError
        For a load on a body that does not exist.

    Notes
    -----
    Seed 003.

    """
    check_loads(mechanism, loads)
    drivers, count = len(mechanism.drivers), values.shape[1]
    share = np.zeros((len(loads), drivers, count))
    determined = np.zeros((drivers, count), bool)
    for k in range(drivers):
        moving = unit_drive(mechanism, values, k)
        determined[k] = moving.determined
        for load_share, load in zip(share, loads, strict=True):
            power = power_of(mechanism, load, moving)
            load_share[k] = np.where(moving.determined, -power, np.nan)
    effort = np.where(determined, share.sum(axis=0), np.nan)
    return Efforts(effort, share, determined)


def holding(
    mechanism: Mechanism, values: Real, loads: Sequence[Load], holder: Holder
) -> tuple[Real, Load]:
    """
    The force or torque that balances loads in place of the one driver, which is free.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.
    loads
        Forces, N, and torques, N m.
    holder
        The force or torque that holds them.

    Returns
    -------
    effort : ndarray
        Its size (T,), N or N m. NaN at dead points, and where the holder does not move along
        itself.
    load : Force or Torque
        The same as a load.

    Raises
    ------
    LinkageError
        For another number of drivers, or a body that does not exist.

    Notes
    -----
    By virtual work in the motion of the driver (seed 003).

    """
    if len(mechanism.drivers) != 1:
        raise LinkageError(
            f'{len(mechanism.drivers)} drivers cannot be replaced by what holds {holder.body}: '
            'leave one of them'
        )
    unit: Load = Torque(holder.body, 1.0)
    if holder.point is not None:
        angles = dict(zip(mechanism.bodies, mechanism.assembly.turns @ values, strict=True))
        angle = holder.along + angles.get(holder.of, np.zeros(values.shape[1]))
        unit = Force(holder.body, holder.point, np.exp(1j * angle))
    share = efforts(mechanism, values, [unit, *loads]).share[:, 0]
    with np.errstate(divide='ignore', invalid='ignore'):
        size = -share[1:].sum(axis=0) / share[0]
    size = np.where(np.isfinite(size), size, np.nan)
    if isinstance(unit, Force):
        return size, unit._replace(force=size * unit.force)
    return size, unit._replace(torque=size)


def load_rates(
    mechanism: Mechanism, values: Real, loads: Sequence[Load], driver: int = 0
) -> list[Complex | Real]:
    """
    Velocities of the points or bodies of loads at unit rate of a driver, the others held.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.
    loads
        Forces, N, and torques, N m.
    driver
        The number of the driver.

    Returns
    -------
    list of ndarray
        For each load (T,): the velocity of the force's point, complex, in the ground's axes, or the
        angular velocity of the torque's body. NaN at dead points.

    Notes
    -----
    The rates in the virtual work Σ F·v + Σ T ω = 0 of seed 003.

    """
    moving = unit_drive(mechanism, values, driver)
    return [np.where(moving.determined, rate_of(mechanism, load, moving), np.nan) for load in loads]


class Moving(NamedTuple):
    """
    Bodies (B) at T positions that move at unit rate of one driver.

    `angle`, `velocity` and `omega` are (B, T), `rates` (n, T) those of the variables. `determined`
    (T,) is where the loops determine them.
    """

    angle: Real
    velocity: Complex
    omega: Real
    rates: Real
    determined: np.ndarray


def unit_drive(mechanism: Mechanism, values: Real, k: int) -> Moving:
    """All bodies at unit rate of driver k, the others held."""
    solution = mechanism.rates(values, k)
    position, angle = body_motion(mechanism.assembly, solution.values)
    rates, determined = solution.values[1], solution.regular & np.isfinite(values).all(axis=0)
    if any(len(block.unknown) < 2 * len(block.loops.loops) for block in mechanism.linkage.blocks):
        # With redundant constraints the rates of least squares need not keep all loops closed.
        loops = mechanism.assembly.loops
        slope = loop_jacobian(loops, values)[1]
        gap = np.abs(np.einsum('mnt,nt->mt', slope, rates)).max(axis=0)
        length = term_lengths(loops, values)
        terms = np.hypot(loops.lengths @ rates, length * (loops.angles @ rates))
        determined &= gap <= _OPENING * terms.max(axis=0)
    return Moving(angle[0], position[1], angle[1], rates, determined)


def rate_of(mechanism: Mechanism, load: Load, moving: Moving) -> Complex | Real:
    """The velocity (T,), complex, of a force's point, or the angular one of a torque's body."""
    if load.body == GROUND:
        return np.zeros(moving.omega.shape[1:])
    b = mechanism.bodies.index(load.body)
    if isinstance(load, Torque):
        return np.asarray(moving.omega[b])
    arm = load.point * np.exp(1j * moving.angle[b])
    return np.asarray(moving.velocity[b] + 1j * moving.omega[b] * arm)


def power_of(mechanism: Mechanism, load: Load, moving: Moving) -> Real:
    """Power (T,) of a load on moving bodies."""
    effort = load.torque if isinstance(load, Torque) else load.force
    return np.asarray((np.conj(effort) * rate_of(mechanism, load, moving)).real)


def advantage(mechanism: Mechanism, values: Real, into: Port, out: Port) -> Real:
    """
    Mechanical advantage: the force or torque at `out` over that at `into`.

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
        The advantage (T,), N or N m over N or N m. Infinite where the output stands still while the
        input moves (a toggle), zero the other way round, NaN at dead points of the driver.

    Raises
    ------
    LinkageError
        For a port that does not exist, or an input that is none of several drivers.

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
            port, scale = port._replace(force=port.force / size), fastest
        else:
            port, scale = port._replace(torque=1.0), fastest / length
        rate = power_of(mechanism, port, moving)
        rates.append(np.where(np.abs(rate) > ROUNDING * scale, rate, 0.0))
    with np.errstate(divide='ignore', invalid='ignore'):
        ratio = rates[0] / rates[1]
    # The sign of an infinite advantage is that of a rounding error: it has none.
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
    scale = fastest if kinds[port] == 'length' else fastest / length
    return np.where(np.abs(rate) > ROUNDING * scale, rate, 0.0)


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
    sines = np.abs(mechanism.rates(values).determinant)
    sines[sines <= SINGULAR] = 0.0
    angles = {
        _names(mechanism, block.unknown): np.arcsin(np.minimum(sine, 1.0))
        for block, sine in zip(mechanism.linkage.blocks, sines, strict=True)
        if _is_dyad(block)
    }
    belts = {joint.name for joint in mechanism.assembly.joints if isinstance(joint, Belt)}
    return {names: angle for names, angle in angles.items() if belts.isdisjoint(names)}


def _is_dyad(block: Block) -> bool:
    """Whether a block is one loop of two links, or a link and a slide, each an unknown."""
    loops, unknown = block.loops, list(block.unknown)
    turns, slides = (rows[rows[:, unknown].any(axis=1)] for rows in (loops.angles, loops.lengths))
    distinct = [*np.unique(turns, axis=0), *np.unique(slides, axis=0)]
    if len(loops.loops) != 1 or not len(turns) or len(distinct) != 2 or len(unknown) != 2:
        return False
    by = np.array(distinct)[:, unknown] != 0
    # A slide turns with the link, or it does not.
    turning = loops.angles[loops.lengths[:, unknown].any(axis=1)][:, unknown].any(axis=1)
    return bool(by.sum() == 2 and by.any(axis=0).all() and (turning.all() or not turning.any()))


def _names(mechanism: Mechanism, unknown: Sequence[int]) -> tuple[str, ...]:
    variables = mechanism.assembly.loops.variables
    return tuple(variables[mechanism.linkage.unknown[k]] for k in unknown)
