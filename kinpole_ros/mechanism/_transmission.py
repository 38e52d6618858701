"""Force transmission: what holds loads in place of a driver, advantage, transmission angles."""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.mechanism._assembly import largest_length
from kinpole_ros.mechanism._centers import EQUAL_RATES
from kinpole_ros.mechanism._equilibrium import Statics
from kinpole_ros.mechanism._loads import Force, Holder, Load, Torque
from kinpole_ros.mechanism._loop_closure import SINGULAR
from kinpole_ros.mechanism._loops import Block, LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism, UnitRates
from kinpole_ros.planar._plane import Real

# A port for power, in or out: along a force, with a torque, or with a variable by its name.
Port = Force | Torque | str


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
    share = Statics(mechanism, values, [unit, *loads]).share[:, 0]
    with np.errstate(divide='ignore', invalid='ignore'):
        size = -share[1:].sum(axis=0) / share[0]
    size = np.where(np.isfinite(size), size, np.nan)
    if isinstance(unit, Force):
        return size, unit._replace(force=size * unit.force)
    return size, unit._replace(torque=size)


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
    ports = [port if isinstance(port, str) else _unit_load(port) for port in (into, out)]
    statics = Statics(mechanism, values, [port for port in ports if not isinstance(port, str)])
    moving, length = mechanism.unit_rates(values), largest_length(mechanism.assembly, values)
    fastest = np.maximum(np.abs(moving.velocity[k]), np.abs(moving.omega[k]) * length).max(axis=0)
    rates, powers = [], iter(-statics.share[:, k])
    for port in ports:
        if isinstance(port, str):
            rate, is_length = _rate(mechanism, moving, k, port)
        else:
            rate, is_length = next(powers), isinstance(port, Force)
        scale = fastest if is_length else fastest / length
        rates.append(np.where(np.abs(rate) > EQUAL_RATES * scale, rate, 0.0))
    with np.errstate(divide='ignore', invalid='ignore'):
        ratio = rates[0] / rates[1]
    # The sign of an infinite advantage is that of a rounding error, of the scene or ours.
    return np.where(statics.determined, np.where(np.isinf(ratio), np.inf, ratio), np.nan)


def _unit_load(port: Load) -> Load:
    """A force of 1 N along the port, or a torque of 1 N m."""
    if isinstance(port, Torque):
        return port._replace(torque=1.0)
    size = np.abs(port.force)
    if not np.all(size > 0):
        raise LinkageError(f'the force on {port.body} needs a direction, to be a port')
    return port._replace(force=port.force / size)


def _rate(mechanism: Mechanism, moving: UnitRates, k: int, port: str) -> tuple[Real, bool]:
    """The rate (T,) of a variable or driver at unit rate of driver `k`, and whether in m/s."""
    names = [driver.name for driver in mechanism.drivers]
    if port in names:
        number = names.index(port)
        rate = np.full(len(moving.regular), float(number == k))
        return rate, mechanism.kind(number) == 'length'
    kinds = mechanism.assembly.kinds
    if port not in kinds:
        raise LinkageError(f'no variable {port}: there are {", ".join(kinds)}')
    return moving.variables[k, list(kinds).index(port)], kinds[port] == 'length'


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
    belts = {joint.name for joint in mechanism.assembly.joints if not joint.is_driven}
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
