"""
Efforts that balance the loads of a linkage that moves slowly, by virtual work.

No power is made or lost: loads and drivers do no net work in any motion the joints allow (seed
003), which gives the efforts without a word on what the joints bear (`_reactions`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinpole_ros.mechanism._assembly import GROUND, Assembly
from kinpole_ros.mechanism._loops import Linkage, LinkageError, with_laws
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.planar._plane import ROUNDING, Complex, Real

# Next to a dead point positions are off by rounding over the least singular value, and so is that
# value: below the root of rounding it may as well be zero.
LOST = np.sqrt(ROUNDING)
# What could move by less than this share does not.
_NO_SHARE = 1e-6


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
    What holds the loads instead of a driver: a force on `body` at `point` of its frame (m) in the
    direction `along` (rad) as seen from the body `of`; or, if `point` is None, a torque on `body`.
    """

    body: str
    point: complex | None = None
    along: float = 0.0
    of: str = GROUND


class Efforts(NamedTuple):
    """
    What the drivers exert to balance the loads.

    `effort` (d, T), N for a slide or length and N m for an angle, positive along the driver's rate;
    `share` (K, d, T) is that of each load, which add up to it. NaN where not `determined` (d, T).
    """

    effort: Real
    share: Real
    determined: np.ndarray


def balance(
    rate: npt.ArrayLike, *loads: tuple[npt.ArrayLike, npt.ArrayLike]
) -> npt.NDArray[np.float64]:
    """
    The effort at a port that moves at `rate` so that all powers add up to zero, seed 003.

    Each of `loads` is (force, velocity), both complex, N and m/s, or (torque, angular velocity),
    N m and rad/s. The effort is a force along `rate` in m/s, or a torque where it is in rad/s;
    positive if it acts along the motion. NaN where the port stands still. Shapes (...).
    """
    power = sum(np.real(np.multiply(effort, np.conj(along))) for effort, along in loads)
    moving = np.asarray(rate, float)
    return np.asarray(-power / np.where(moving == 0, np.nan, moving))


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
        For a load on a body that is not there.

    Notes
    -----
    Seed 003.

    """
    check_loads(mechanism, loads)
    drivers, count = len(mechanism.drivers), values.shape[1]
    share = np.zeros((len(loads), drivers, count))
    determined = np.zeros((drivers, count), bool)
    for k in range(drivers):
        moving = let_drive(mechanism, values, k)
        determined[k] = moving.known
        for share_of, load in zip(share, loads, strict=True):
            share_of[k] = np.where(moving.known, -power_of(mechanism, load, moving), np.nan)
    effort = np.where(determined, share.sum(axis=0), np.nan)
    return Efforts(effort, share, determined)


def holding(
    mechanism: Mechanism, values: Real, loads: Sequence[Load], holder: Holder
) -> tuple[Real, Load]:
    """
    What balances loads in place of the one driver, which is free.

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
        For another number of drivers, or a body that is not there.

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
        turns = dict(zip(mechanism.bodies, mechanism.assembly.turns @ values, strict=True))
        way = np.exp(1j * (holder.along + turns.get(holder.of, np.zeros(values.shape[1]))))
        unit = Force(holder.body, holder.point, way)
    share = efforts(mechanism, values, [unit, *loads]).share[:, 0]
    with np.errstate(divide='ignore', invalid='ignore'):
        size = -share[1:].sum(axis=0) / share[0]
    size = np.where(np.isfinite(size), size, np.nan)
    if isinstance(unit, Force):
        return size, unit._replace(force=size * unit.force)
    return size, unit._replace(torque=size)


class Moving(NamedTuple):
    """
    Bodies (B) at T positions that move at some rates of the drivers.

    `angle`, `velocity` and `omega` are (B, T), `rates` (n, T) those of the variables; `known` (T,)
    is where the loops determine them, and stay closed; `loose` (n, T) are the variables that could
    move with all drivers held.
    """

    angle: Real
    velocity: Complex
    omega: Real
    rates: Real
    known: np.ndarray
    loose: np.ndarray


def let_move(linkage: Linkage, assembly: Assembly, values: Real, rates: Real) -> Moving:
    """
    Let the drivers move at `rates` (d, T), at variables (n, T) that close the loops.

    Linear in the rates, so nothing is searched for: dead points stay where they are.
    """
    loops, unknowns = linkage.loops, linkage.free.shape[1]
    length, turn = vectors_at(assembly, values)
    arm = 1j * length * turn
    # The terms' derivatives by what is unknown, and all that does not hold it.
    by = (loops.lengths @ linkage.free)[:, :, None] * turn[:, None]
    by = by + (loops.angles @ linkage.free)[:, :, None] * arm[:, None]
    columns = np.tensordot(loops.loops, by, 1)
    given = linkage.driven @ with_laws(linkage, np.stack((loops.drives @ values, rates)))[1]
    driven = (loops.lengths @ given) * turn + (loops.angles @ given) * arm
    gap = loops.loops @ driven
    found = np.zeros((unknowns, values.shape[1]))
    loose = np.zeros(values.shape, bool)
    known = np.isfinite(values).all(axis=0)
    if unknowns:
        matrix = np.concatenate((columns.real, columns.imag))
        size = np.sqrt((matrix**2).sum(axis=0))
        size[~(size > 0)] = 1.0
        u, s, vt = stacked_svd(matrix / size)
        along = u.swapaxes(1, 2) @ np.concatenate((gap.real, gap.imag)).T[..., None]
        most = s.shape[1]
        across = inverse_values(s)[..., None] * along[:, :most]
        found = -(vt[:, :most].swapaxes(1, 2) @ across)[..., 0].T / size
        rank = (s > LOST * s[:, :1]).sum(axis=1)
        known &= rank == unknowns
        free = np.where(np.arange(unknowns)[:, None] >= rank[:, None, None], vt, 0.0)
        moves = linkage.free @ (np.moveaxis(free, 0, -1) / size)
        loose = (np.abs(moves) > _NO_SHARE).any(axis=0)
    terms = np.einsum('tuT,uT->tT', by, found) + driven
    with np.errstate(invalid='ignore'):
        # As the rates of least squares need not where constraints are too many.
        left = np.abs(loops.loops @ terms).max(axis=0, initial=0.0)
        known &= left <= LOST * np.abs(terms).max(axis=0, initial=0.0)
    rate = linkage.free @ found + given
    turned, turning = assembly.turns @ values, assembly.turns @ rate
    return Moving(turned, assembly.places @ terms, turning, rate, known, loose)


def let_drive(mechanism: Mechanism, values: Real, k: int) -> Moving:
    """All bodies at unit rate of driver k, the others held."""
    rates = np.zeros((len(mechanism.drivers), values.shape[1]))
    rates[k] = 1.0
    return let_move(mechanism.linkage, mechanism.assembly, values, rates)


def at_rest(mechanism: Mechanism, values: Real) -> Moving:
    """No motion at all, and what could move even so."""
    rates = np.zeros((len(mechanism.drivers), values.shape[1]))
    return let_move(mechanism.linkage, mechanism.assembly, values, rates)


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
    """Power (T,) of a load on bodies that move so."""
    effort = load.torque if isinstance(load, Torque) else load.force
    return np.asarray((np.conj(effort) * rate_of(mechanism, load, moving)).real)


def load_rates(
    mechanism: Mechanism, values: Real, loads: Sequence[Load], driver: int = 0
) -> list[Complex | Real]:
    """
    How fast what loads act on moves per unit rate of a driver, the others held.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.
    loads
        Forces, N, and torques, N m.
    driver
        Which driver.

    Returns
    -------
    list of ndarray
        Of each load (T,): the velocity of the force's point, complex, in the ground's axes, or the
        angular velocity of the torque's body. NaN at dead points.

    Notes
    -----
    What the virtual work Σ F·v + Σ T ω = 0 of seed 003 is made of.

    """
    moving = let_drive(mechanism, values, driver)
    return [np.where(moving.known, rate_of(mechanism, load, moving), np.nan) for load in loads]


def stacked_svd(matrix: Real) -> tuple[Real, Real, Real]:
    """Singular values of (R, C, T), T first; all zero where a position is none."""
    none = ~np.isfinite(matrix).all(axis=(0, 1))
    u, s, vt = np.linalg.svd(np.moveaxis(np.where(none, 0.0, matrix), -1, 0))
    return u, s, vt


def inverse_values(s: Real) -> Real:
    """Inverses of singular values (T, K), zero for those that are zero but for rounding."""
    with np.errstate(divide='ignore'):
        return np.where(s > LOST * s[:, :1], 1 / s, 0.0)


def vectors_at(assembly: Assembly, values: Real) -> tuple[Real, Complex]:
    """Lengths (terms, T) of the terms and their directions e^{iθ}."""
    loops = assembly.loops
    length = loops.lengths @ values + loops.length0[:, None]
    return length, np.exp(1j * (loops.angles @ values + loops.angle0[:, None]))


def largest_length(assembly: Assembly, values: Real) -> float:
    """The linkage's largest length (m), to hold angles against."""
    length = np.abs(vectors_at(assembly, values)[0])
    return float(np.max(length, where=np.isfinite(length), initial=0.0)) or 1.0


def driver_rows(mechanism: Mechanism) -> Real:
    """The drivers' rows (d, n)."""
    rows = np.array([driver.row for driver in mechanism.drivers])
    return rows.reshape(-1, len(mechanism.start))


def check_loads(mechanism: Mechanism, loads: Sequence[Load]) -> None:
    for load in loads:
        if load.body not in (*mechanism.bodies, GROUND):
            raise LinkageError(
                f'a load is on {load.body}, which is no body: there are '
                f'{", ".join(mechanism.bodies)}'
            )
