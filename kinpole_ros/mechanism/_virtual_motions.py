"""
Virtual motions of a linkage: those in which one joint or driver gives way, all others held.

Each joint is a chain from one body to the other, z_other - z_one = Σ vectors, with a linear tie
where it has one (`loop_form`). Differentiated, chains, ties and drivers are a matrix A times the
velocities of all bodies and variables. Its inverse has the motions in which one row gives way at
unit rate; by virtual work (seed 003) the power of the loads in such a motion is minus the force,
moment or effort of that row, as in A^T λ = -Q.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import largest_length
from kinpole_ros.mechanism._joint_kinds import (
    ACROSS,
    ALONG,
    GROUND,
    Joint,
    Pose,
    Rolling,
    Strut,
)
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


class VirtualMotions(NamedTuple):
    """
    The motions of a linkage at T positions in which one row of its matrix gives way.

    `labels` are (joint, direction) of the rows; None where a row is of no joint, or bears nothing.
    `contact` and `axis` (J, T) are the points and directions of the joints. `rates` (2B + n, rows,
    T) are the velocities x and y of all bodies, then of all variables, at unit rate of one row, all
    others held; NaN where no load can tell the force of that row. `stress` (rows, T) is the share
    of each row in the reactions that are possible without any load. `rank` (T,) is that of the
    matrix, `determined` (T,) where it and the drivers determine all poses. `driven_struts` are
    (joint, direction, row) of struts whose force is the effort of a driver.
    """

    labels: list[Label]
    contact: Complex
    axis: Complex
    rates: Real
    stress: Real
    rank: np.ndarray
    determined: np.ndarray
    driven_struts: list[tuple[int, int, int]]

    @property
    def drivers(self) -> list[int]:
        """The rows of the drivers."""
        return [row for row, label in enumerate(self.labels) if label == DRIVER]

    @property
    def bearings(self) -> list[tuple[int, int, int]]:
        """The rows that bear a reaction, as (joint, direction, row), in the order of the joints."""
        rows = enumerate(self.labels)
        return sorted((k, way, r) for r, (k, way) in rows if k is not None and way is not None)


def virtual_motions(mechanism: Mechanism, values: Real, poses: dict[str, Pose]) -> VirtualMotions:
    """The motions at variables (n, T), by singular values."""
    assembly, joints = mechanism.assembly, mechanism.assembly.joints
    meeting = [joint.contact(poses[joint.one], poses[joint.other]) for joint in joints]
    shape = 2, len(joints), values.shape[1]
    at, axis = np.reshape([[p for p, _ in meeting], [a for _, a in meeting]], shape) + 0j
    labels, matrix = _matrix(mechanism, values, poses, axis)
    is_angle = assembly.loops.is_angle
    lengths = np.where(is_angle, largest_length(assembly, values), 1.0)
    column = np.concatenate((np.ones(2 * len(mechanism.bodies)), lengths))
    matrix = matrix / column[:, None]
    size = np.sqrt((matrix**2).sum(axis=1))
    size[size == 0] = 1.0
    matrix = np.moveaxis(matrix / size[:, None], -1, 0)
    is_finite = np.isfinite(matrix).all(axis=(1, 2), keepdims=True)
    u, s, vt = np.linalg.svd(np.where(is_finite, matrix, 0.0))
    is_zero = s <= _SINGULAR_VALUE * s[:, :1]
    rank = (~is_zero).sum(axis=1)
    with np.errstate(divide='ignore'):
        inverse_values = np.where(is_zero, 0.0, 1 / s)[:, None]
    most = s.shape[1]
    inverse = vt[:, :most].swapaxes(1, 2) * inverse_values @ u[:, :, :most].swapaxes(1, 2)
    # Rates that are rounding, so that what stands still has no power.
    inverse[np.abs(inverse) <= ROUNDING * np.abs(inverse).max(axis=1, keepdims=True)] = 0.0
    motions = np.moveaxis(inverse, 0, -1) / column[:, None, None] / size
    stress = np.zeros(size.shape)
    if (rank < len(size)).any():
        # Left null space: reactions that balance each other without a load.
        beyond = np.arange(u.shape[2]) >= rank[:, None]
        balanced = np.moveaxis(np.where(beyond[:, None, :], u, 0.0), 0, -1)
        stress = np.sqrt((balanced**2).sum(axis=1))
        for row, (k, direction) in enumerate(labels):
            if direction == ALONG and labels[row + 1 : row + 2] == [(k, ACROSS)]:
                assert k is not None
                _turn_pin(k, slice(row, row + 2), balanced / size[:, None], axis, motions, stress)
    # The one limit for a dead point is that of the rates.
    determined = (rank == len(column)) & mechanism.rates(values).regular
    motions[:, (stress > UNSTRESSED) | ~determined] = np.nan
    return VirtualMotions(
        labels, at, axis, motions, stress, rank, determined, _driven_struts(mechanism, labels)
    )


def _turn_pin(
    k: int, pin: slice, balanced: Real, axis: Complex, motions: Real, stress: Real
) -> None:
    """Turn the axis of pin k along the main axis of the forces that it can have without a load."""
    with np.errstate(invalid='ignore'):
        forces = balanced[pin][0] + 1j * balanced[pin][1]
    main = (forces**2).sum(axis=0)
    axis[k] = np.where(np.abs(main) > UNSTRESSED**2, np.exp(0.5j * np.angle(main)), 1.0)
    turned = forces * axis[k].conj()
    stress[pin] = np.sqrt((turned.real**2).sum(axis=0)), np.sqrt((turned.imag**2).sum(axis=0))
    x, y = motions[:, pin].swapaxes(0, 1).copy()
    motions[:, pin.start] = axis[k].real * x + axis[k].imag * y
    motions[:, pin.start + 1] = axis[k].real * y - axis[k].imag * x


def _matrix(
    mechanism: Mechanism, values: Real, poses: dict[str, Pose], axis: Complex
) -> tuple[list[Label], Real]:
    """The labels of all rows, and the rows (R, 2B + n, T)."""
    loops, joints = mechanism.assembly.loops, mechanism.assembly.joints
    first, count = 2 * len(mechanism.bodies), values.shape[1]
    labels: list[Label] = []
    rows: list[Real] = []

    def add(label: Label, row: Real) -> None:
        labels.append(label)
        rows.append(row)

    def linear(row: Real) -> Real:
        """A row of a linear equation (n,) or (n, T) between the variables."""
        still = np.zeros((first, count))
        return np.concatenate((still, np.broadcast_to(row.reshape(len(row), -1), values.shape)))

    for k, joint in enumerate(joints):
        form = joint.loop_form()
        along, across, tied = form.bears
        chain = _chain(mechanism, joint, values, poses) * axis[k].conj()
        add((k, along), chain.real)
        # Other joints hold the distance of teeth with a pressure angle.
        if not has_teeth(joint):
            add((k, across), chain.imag)
        # Before the last tie of a belt are those that hubs on a carrier meet in any case.
        for tie in form.ties[-1:]:
            row = np.array([tie.weights.get(name, 0.0) for name in loops.variables])
            add((k, tied), linear(row))
    if not joints:
        for row in _loop_rows(mechanism, values):
            add((None, None), row)
        for tie_row in loops.ties:
            add((None, None), linear(tie_row))
    for law in loops.laws:
        rate = law.function(law.of @ values)[1]
        add((None, None), linear(law.row[:, None] - law.of[:, None] * rate))
    for driver_row in mechanism.driver_rows:
        add(DRIVER, linear(driver_row))
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


def _loop_rows(mechanism: Mechanism, values: Real) -> Iterator[Real]:
    """The rows (2B + n, T) of vectors: the origins of their bodies, and their loops."""
    assembly = mechanism.assembly
    count = len(assembly.bodies)
    chains = np.concatenate((assembly.origins, assembly.loops.loops))
    slopes = loop_jacobian(assembly.loops._replace(loops=chains), values)[1]
    for k, slope in enumerate(slopes):
        chain = np.concatenate((np.zeros((2 * count, values.shape[1])), -slope))
        if k < count:
            chain[[k, count + k]] = np.array([[1.0], [1j]])
        yield chain.real
        yield chain.imag


def _driven_struts(mechanism: Mechanism, labels: Sequence[Label]) -> list[tuple[int, int, int]]:
    """Where the effort of a driver is the force of a strut, as (joint, direction, row)."""
    names, rows = mechanism.assembly.loops.variables, mechanism.driver_rows
    found = []
    for k, joint in enumerate(mechanism.assembly.joints):
        if isinstance(joint, Strut):
            row = next(r for r, (of, _) in enumerate(labels) if of == k)
            for direction, name in ((ALONG, joint.name), (ACROSS, f'{joint.name}.angle')):
                if rows[:, names.index(name)].any():
                    found.append((k, direction, row + direction))
    return found


def has_teeth(joint: Joint) -> bool:
    """Whether a joint is one of teeth with a pressure angle."""
    return isinstance(joint, Rolling) and joint.pressure is not None
