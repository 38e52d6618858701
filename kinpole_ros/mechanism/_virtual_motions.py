"""
Virtual motions of a linkage: those in which one joint or driver gives way, all others held.

Each joint is a chain from one body to the other, z_other - z_one = Σ vectors, with a linear tie
where it has one (`loop_form`). Differentiated, chains, ties and drivers are a matrix A times the
velocities of all bodies and variables. Its inverse has the motions in which one row gives way at
unit rate; by virtual work (seed 003) the power of the loads in such a motion is minus the force,
moment or effort of that row, as in A^T λ = -Q.
"""

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import largest_length
from kinpole_ros.mechanism._joint_kinds import ACROSS, ALONG, GROUND, Joint, Pose
from kinpole_ros.mechanism._loops import loop_jacobian
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.planar._plane import ROUNDING, Complex, Real

# The joint whose row it is, and the direction in which it bears a reaction.
Label = tuple[int | None, int | None]
# The label of a row that is a driver's.
DRIVER: Label = (-1, None)
# Next to a dead point positions, and so singular values, have errors of rounding over the least
# singular value: below the root of rounding that value counts as zero.
_SINGULAR_VALUE = np.sqrt(ROUNDING)
# A row with less than this share in a state of self-stress has a unique reaction.
UNSTRESSED = 1e-6
# Numbers of all matrices that are inverted at a time: 4 MB, and a few times that at work.
MOST_NUMBERS = 500_000


class VirtualMotions(NamedTuple):
    """
    The motions of a linkage at T positions in which one row of its matrix gives way.

    `labels` are (joint, direction) of the rows; the direction is None where a row bears nothing.
    `contact` and `axis` (J, T) are the points and directions of the joints. `rates` (3B, rows, T)
    are the velocities x and y, then the angular velocities of all bodies at unit rate of one row,
    all others held; NaN where no load can tell the force of that row. `stress` (rows, T) is the
    share of each row in the reactions that are possible without any load. `rank` (T,) is that of
    the matrix, `determined` (T,) where it and the drivers determine all poses.
    """

    labels: list[Label]
    contact: Complex
    axis: Complex
    rates: Real
    stress: Real
    rank: np.ndarray
    determined: np.ndarray

    @property
    def bearings(self) -> list[tuple[int, int, int]]:
        """The rows that bear a reaction, as (joint, direction, row), in the order of the joints."""
        rows = enumerate(self.labels)
        return sorted((k, way, r) for r, (k, way) in rows if k is not None and way is not None)


class DriverMotions(NamedTuple):
    """
    The motions of a linkage at T positions in which one driver (d) moves, the others held.

    `rates` (3B, d, T) as those of `VirtualMotions`, from the rates of the loops. NaN where they are
    not `regular` (T,), and of drivers that cannot move alone.
    """

    rates: Real
    regular: np.ndarray


def driver_motions(mechanism: Mechanism, values: Real) -> DriverMotions:
    """The motions of the drivers at variables (n, T)."""
    moving = mechanism.unit_rates(values)
    rates = np.concatenate((moving.velocity.real, moving.velocity.imag, moving.omega), axis=1)
    bodies = len(mechanism.bodies)
    sizes = np.abs(rates)
    sizes[:, 2 * bodies :] *= largest_length(mechanism.assembly, values)
    rates = rates.swapaxes(0, 1)
    # Rates that are rounding, so that what stands still has no power.
    sizes = sizes.swapaxes(0, 1)
    rates = np.where(sizes <= ROUNDING * sizes.max(axis=0, initial=0.0), 0.0, rates)
    loops = mechanism.assembly.loops
    if any(len(block.unknown) < 2 * len(block.loops.loops) for block in mechanism.linkage.blocks):
        # One of more drivers than degrees of freedom opens loops when it moves alone.
        slopes = loop_jacobian(loops, values)[1]
        opening = np.abs(np.einsum('mnt,dnt->mdt', slopes, moving.variables)).max(axis=0)
        fastest = np.abs(moving.variables).max(axis=1)
        rates[:, opening > UNSTRESSED * np.abs(slopes).max(axis=(0, 1)) * fastest] = np.nan
    return DriverMotions(rates, moving.regular)


def powers(forces: Real, sizes: Real, rates: Real) -> Real:
    """
    Powers (..., rows, T) of forces (..., 3B, T) in motions (3B, rows, T), zero where rounding.

    `sizes` (..., 3B, T) are those of the terms of which the forces are sums.
    """
    power = np.einsum('...bt,brt->...rt', forces, rates)
    return without_rounding(power, np.einsum('...bt,brt->...rt', sizes, np.abs(rates)))


def without_rounding(total: Real, size: Real) -> Real:
    """Sums (...), zero where they are rounding of terms whose absolute values sum up to `size`."""
    return np.where(np.abs(total) <= ROUNDING * size, 0.0, total)


def virtual_motions(mechanism: Mechanism, values: Real, poses: dict[str, Pose]) -> VirtualMotions:
    """The motions at variables (n, T) of a linkage with joints, without laws."""
    assembly, bodies = mechanism.assembly, len(mechanism.bodies)
    meeting = [joint.contact(poses[joint.one], poses[joint.other]) for joint in assembly.joints]
    at, axis = (np.array(part, complex) for part in zip(*meeting, strict=True))
    labels, matrix = _matrix(mechanism, values, poses, axis)
    lengths = np.where(
        mechanism.assembly.loops.is_angle, largest_length(mechanism.assembly, values), 1.0
    )
    column = np.concatenate((np.ones(2 * bodies), lengths))[:, None]
    matrix /= column
    size = np.sqrt(np.einsum('rct,rct->rt', matrix, matrix))
    size[size == 0] = 1.0
    matrix = np.ascontiguousarray(np.moveaxis(matrix / size[:, None], -1, 0))
    matrix[~np.isfinite(matrix).all(axis=(1, 2))] = np.eye(len(size), len(column))
    inverse, rank, balanced = _inverse(matrix)
    # Rates that are rounding, so that what stands still has no power.
    inverse[np.abs(inverse) <= ROUNDING * np.abs(inverse).max(axis=1, keepdims=True)] = 0.0
    rates = np.moveaxis(inverse[:, : 3 * bodies], 0, -1) / column[: 3 * bodies, None] / size
    stress = np.sqrt((balanced**2).sum(axis=1))
    if stress.any():
        for row, (k, direction) in enumerate(labels):
            if direction == ALONG and labels[row + 1 : row + 2] == [(k, ACROSS)]:
                assert k is not None
                _turn_pin(k, slice(row, row + 2), balanced / size[:, None], axis, rates, stress)
    # The one limit for a dead point is that of the rates.
    determined = (rank == len(column)) & mechanism.rates(values).regular
    rates[:, (stress > UNSTRESSED) | ~determined] = np.nan
    return VirtualMotions(labels, at, axis, rates, stress, rank, determined)


def _inverse(matrix: Real) -> tuple[Real, np.ndarray, Real]:
    """
    Inverses (T, C, R) of matrices (T, R, C), their ranks (T,), and left null spaces (R, ., T).

    Singular values tell the rank only of matrices that are not square, or whose condition is near
    the limit: a decomposition takes six times as long as an inverse. The condition is that of the
    Frobenius norm, which is never below that of the singular values.
    """
    count, rows, columns = matrix.shape
    inverse, rank = np.empty((count, columns, rows)), np.full(count, columns)
    near = np.ones(count, bool)
    if rows == columns:
        # A matrix that is exactly singular leaves all to the singular values.
        with suppress(np.linalg.LinAlgError):
            inverse = np.linalg.inv(matrix)
            squares = [np.einsum('tij,tij->t', m, m) for m in (matrix, inverse)]
            near = ~(np.sqrt(squares[0] * squares[1]) * _SINGULAR_VALUE < 1)
    if not near.any():
        return inverse, rank, np.zeros((rows, 0, count))
    u, s, vt = np.linalg.svd(matrix[near])
    is_zero = s <= _SINGULAR_VALUE * s[:, :1]
    rank[near] = (~is_zero).sum(axis=1)
    with np.errstate(divide='ignore'):
        inverse_values = np.where(is_zero, 0.0, 1 / s)[:, None]
    most = s.shape[1]
    inverse[near] = vt[:, :most].swapaxes(1, 2) * inverse_values @ u[:, :, :most].swapaxes(1, 2)
    # Reactions that balance each other without a load.
    balanced = np.zeros((rows, rows, count))
    beyond = np.arange(rows) >= rank[near, None]
    balanced[:, :, near] = np.moveaxis(np.where(beyond[:, None], u, 0.0), 0, -1)
    return inverse, rank, balanced


def _turn_pin(k: int, pin: slice, balanced: Real, axis: Complex, rates: Real, stress: Real) -> None:
    """Turn the axis of pin k along the main axis of the forces that it can have without a load."""
    with np.errstate(invalid='ignore'):
        forces = balanced[pin][0] + 1j * balanced[pin][1]
    main = (forces**2).sum(axis=0)
    axis[k] = np.where(np.abs(main) > UNSTRESSED**2, np.exp(0.5j * np.angle(main)), 1.0)
    turned = forces * axis[k].conj()
    stress[pin] = np.sqrt((turned.real**2).sum(axis=0)), np.sqrt((turned.imag**2).sum(axis=0))
    x, y = rates[:, pin].swapaxes(0, 1).copy()
    rates[:, pin.start] = axis[k].real * x + axis[k].imag * y
    rates[:, pin.start + 1] = axis[k].real * y - axis[k].imag * x


def _matrix(
    mechanism: Mechanism, values: Real, poses: dict[str, Pose], axis: Complex
) -> tuple[list[Label], Real]:
    """The labels of all rows, and the rows (R, 2B + n, T)."""
    names, first = mechanism.assembly.loops.variables, 2 * len(mechanism.bodies)
    labels: list[Label] = []
    rows: list[Real] = []

    def add_linear(label: Label, weights: Real) -> None:
        """Add a linear equation with `weights` (n,) between the variables."""
        labels.append(label)
        rows.append(np.zeros((first + len(names), values.shape[1])))
        rows[-1][first:] = weights[:, None]

    for k, joint in enumerate(mechanism.assembly.joints):
        form = joint.loop_form()
        along, across, tied = form.bears
        chain = _chain(mechanism, joint, values, poses) * axis[k].conj()
        labels.append((k, along))
        rows.append(chain.real)
        # Other joints hold the distance of teeth with a pressure angle.
        if joint.pressure is None:
            labels.append((k, across))
            rows.append(chain.imag)
        # Before the last tie of a belt are those that hubs on a carrier meet in any case.
        for tie in form.ties[-1:]:
            add_linear((k, tied), np.array([tie.weights.get(name, 0.0) for name in names]))
    for driver_row in mechanism.driver_rows:
        add_linear(DRIVER, driver_row)
    return labels, np.array(rows)


def _chain(mechanism: Mechanism, joint: Joint, values: Real, poses: dict[str, Pose]) -> Complex:
    """How fast (2B + n, T) the point `b` leaves the end of the joint's vectors from `a`."""
    bodies, names = mechanism.bodies, mechanism.assembly.loops.variables
    count = len(bodies)
    chain = np.zeros((2 * count + len(names), values.shape[1]), complex)
    for body, point, sign in ((joint.other, joint.b, 1.0), (joint.one, joint.a, -1.0)):
        if body != GROUND:
            b = bodies.index(body)
            chain[b] += sign
            chain[count + b] += 1j * sign
            if point:
                chain[2 * count + names.index(body)] += sign * 1j * point * poses[body].turn
    for term in joint.loop_form().terms:
        angle = 0.0 if term.turn == GROUND else values[names.index(term.turn)]
        vector = term.length * np.exp(1j * (angle + term.offset))
        if term.slide:
            slide = names.index(term.slide)
            chain[2 * count + slide] -= vector
            vector = vector * values[slide]
        if term.turn != GROUND:
            chain[2 * count + names.index(term.turn)] -= 1j * vector
    return chain
