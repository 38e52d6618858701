"""
Loads on a linkage, and the efforts of its drivers that balance them, by virtual work.

Loads and drivers do no net work in any motion that the joints allow (seed 003), which gives the
efforts without the reactions in the joints (`_reactions`). Springs and the inertia of masses become
loads like any other (seed 003: "dynamic forces can be inserted into the virtual work equation").
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinpole_ros.mechanism._assembly import Assembly, poses_of
from kinpole_ros.mechanism._joints import GROUND
from kinpole_ros.mechanism._loops import Linkage, LinkageError, loop_jacobian, loop_rates, with_laws
from kinpole_ros.mechanism._mechanism import Mechanism, Motion
from kinpole_ros.planar import body_point_derivative
from kinpole_ros.planar._plane import ROUNDING, Complex, Real

# Next to a dead point positions, and so singular values, have errors of rounding over the least
# singular value: below the root of rounding that value counts as zero.
SINGULAR_VALUE = np.sqrt(ROUNDING)
# A variable that moves by less than this share with all drivers held counts as at rest.
_AT_REST = 1e-6


class Force(NamedTuple):
    """A force, N, complex in the ground's axes, at `point`, m, of the body's frame: () or (T,)."""

    body: str
    point: complex | Complex
    force: npt.ArrayLike


class Torque(NamedTuple):
    """A torque on `body`, N m, () or (T,)."""

    body: str
    torque: npt.ArrayLike


Load = Force | Torque


class Holder(NamedTuple):
    """
    A force or torque that holds the loads instead of a driver.

    The force is on `body` at `point` of its frame (m), in the direction `along` (rad) in the frame
    of the body `of`. If `point` is None it is a torque on `body`.
    """

    body: str
    point: complex | None = None
    along: float = 0.0
    of: str = GROUND


class Spring(NamedTuple):
    """
    A spring from the point `a` of the body `one` to `b` of `other` (complex, m, in their frames).

    It pulls with `stiffness` (N/m) times its length beyond `free` (m), or pushes if it is shorter.
    """

    one: str
    a: complex
    other: str
    b: complex
    stiffness: float
    free: float


class Torsion(NamedTuple):
    """
    A spring that turns the body `other` to the angle `free` (rad) relative to `one`.

    Its torque is `stiffness` (N m/rad) times the angle that remains.
    """

    one: str
    other: str
    stiffness: float
    free: float


class Mass(NamedTuple):
    """A body's `mass` (kg) at `center` (complex, m, in its frame), `moment` (kg m²) about that."""

    body: str
    mass: float
    center: complex
    moment: float


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
        Of d drivers at T positions, N or N m.

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
        Of shape (T,), N or N m. NaN at dead points, and where the holder does not move along
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
        Of each load (T,): the velocity of the force's point, complex, in the ground's axes, or the
        angular velocity of the torque's body. NaN at dead points.

    Notes
    -----
    The rates in the virtual work Σ F·v + Σ T ω = 0 of seed 003.

    """
    moving = unit_drive(mechanism, values, driver)
    return [np.where(moving.determined, rate_of(mechanism, load, moving), np.nan) for load in loads]


def spring_loads(
    mechanism: Mechanism, values: Real, springs: Sequence[Spring | Torsion]
) -> list[Load]:
    """
    Forces and torques of springs on the moving bodies, a load for each end that moves.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.
    springs
        Between points, N/m, or between bodies, N m/rad.

    Returns
    -------
    list of Force or Torque
        N and N m, each of shape (T,). NaN where the ends of one with a free length meet, and it has
        no direction.

    """
    poses, loads = poses_of(mechanism.assembly, values), list[Load]()
    for spring in springs:
        one, other = poses[spring.one], poses[spring.other]
        if isinstance(spring, Torsion):
            torque = spring.stiffness * (spring.free - (other.angle - one.angle))
            ends: list[Load] = [Torque(spring.other, torque), Torque(spring.one, -torque)]
        else:
            between = other.point(spring.b) - one.point(spring.a)
            with np.errstate(divide='ignore', invalid='ignore'):
                extension = 1 - spring.free / np.abs(between) if spring.free else 1.0
                pull = spring.stiffness * extension * between
            ends = [Force(spring.one, spring.a, pull), Force(spring.other, spring.b, -pull)]
        loads += [load for load in ends if load.body != GROUND]
    return loads


def inertial_loads(mechanism: Mechanism, motion: Motion, masses: Sequence[Mass]) -> list[Load]:
    """
    D'Alembert's forces of masses: -m a at their centers, and torques -I α.

    Parameters
    ----------
    mechanism
        The linkage.
    motion
        Its motion at T instants, up to accelerations or higher.
    masses
        Masses, kg, with centers, m, and moments, kg m^2.

    Returns
    -------
    list of Force or Torque
        N and N m, each of shape (T,).

    """
    loads: list[Load] = []
    for mass in masses:
        b = mechanism.bodies.index(mass.body)
        position, angle = motion.position[:, b], motion.angle[:, b]
        center = position[0] + mass.center * np.exp(1j * angle[0])
        acceleration = body_point_derivative(2, center, position, angle)
        loads.append(Force(mass.body, mass.center, -mass.mass * acceleration))
        loads.append(Torque(mass.body, -mass.moment * angle[2]))
    return loads


class Moving(NamedTuple):
    """
    Bodies (B) at T positions that move at given rates of the drivers.

    `angle`, `velocity` and `omega` are (B, T), `rates` (n, T) those of the variables. `determined`
    (T,) is where the loops determine them and stay closed. `loose` (n, T) are the variables that
    could move with all drivers held.
    """

    angle: Real
    velocity: Complex
    omega: Real
    rates: Real
    determined: np.ndarray
    loose: np.ndarray


def move(linkage: Linkage, assembly: Assembly, values: Real, rates: Real) -> Moving:
    """
    Let the drivers move at `rates` (d, T), at variables (n, T) that close the loops.

    It is linear in the rates and needs no iteration, so it works at dead points.
    """
    loops, unknowns = linkage.loops, linkage.free.shape[1]
    _, slope = loop_jacobian(loops, values)
    inputs = np.stack((loops.drives @ values, rates))
    rate = linkage.driven @ with_laws(linkage, inputs)[1]
    loose = np.zeros(values.shape, bool)
    determined = np.isfinite(values).all(axis=0)
    if unknowns:
        columns = np.einsum('mnt,nu->mut', slope, linkage.free)
        gap = np.einsum('mnt,nt->mt', slope, rate)
        matrix = np.concatenate((columns.real, columns.imag))
        size = np.sqrt((matrix**2).sum(axis=0))
        size[~(size > 0)] = 1.0
        u, s, vt = stacked_svd(matrix / size)
        along = u.swapaxes(1, 2) @ np.concatenate((gap.real, gap.imag)).T[..., None]
        most = s.shape[1]
        across = inverse_values(s)[..., None] * along[:, :most]
        rate -= linkage.free @ ((vt[:, :most].swapaxes(1, 2) @ across)[..., 0].T / size)
        rank = (s > SINGULAR_VALUE * s[:, :1]).sum(axis=1)
        determined &= rank == unknowns
        null_space = np.where(np.arange(unknowns)[:, None] >= rank[:, None, None], vt, 0.0)
        moves = linkage.free @ (np.moveaxis(null_space, 0, -1) / size)
        loose = (np.abs(moves) > _AT_REST).any(axis=0)
    terms = loop_rates(loops, values, rate)
    with np.errstate(invalid='ignore'):
        # With redundant constraints the rates of least squares need not keep all loops closed.
        gap = np.abs(loops.loops @ terms).max(axis=0, initial=0.0)
        determined &= gap <= SINGULAR_VALUE * np.abs(terms).max(axis=0, initial=0.0)
    turns = assembly.turns
    return Moving(turns @ values, assembly.places @ terms, turns @ rate, rate, determined, loose)


def unit_drive(mechanism: Mechanism, values: Real, k: int) -> Moving:
    """All bodies at unit rate of driver k, the others held."""
    rates = np.zeros((len(mechanism.drivers), values.shape[1]))
    rates[k] = 1.0
    return move(mechanism.linkage, mechanism.assembly, values, rates)


def at_rest(mechanism: Mechanism, values: Real) -> Moving:
    """No motion at all, with the variables that could move."""
    rates = np.zeros((len(mechanism.drivers), values.shape[1]))
    return move(mechanism.linkage, mechanism.assembly, values, rates)


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


def stacked_svd(matrix: Real) -> tuple[Real, Real, Real]:
    """Singular value decompositions of (R, C, T), T first; zero where entries are not finite."""
    invalid = ~np.isfinite(matrix).all(axis=(0, 1))
    u, s, vt = np.linalg.svd(np.moveaxis(np.where(invalid, 0.0, matrix), -1, 0))
    return u, s, vt


def inverse_values(s: Real) -> Real:
    """Inverses of singular values (T, K), zero for those that are zero but for rounding."""
    with np.errstate(divide='ignore'):
        return np.where(s > SINGULAR_VALUE * s[:, :1], 1 / s, 0.0)


def driver_rows(mechanism: Mechanism) -> Real:
    """The rows (d, n) of the drivers."""
    rows = np.array([driver.row for driver in mechanism.drivers])
    return rows.reshape(-1, len(mechanism.start))


def check_loads(mechanism: Mechanism, loads: Sequence[Load]) -> None:
    """Raise LinkageError for a load on a body that does not exist."""
    for load in loads:
        if load.body not in (*mechanism.bodies, GROUND):
            raise LinkageError(
                f'a load is on {load.body}, which is no body: there are '
                f'{", ".join(mechanism.bodies)}'
            )
