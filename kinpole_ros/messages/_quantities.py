"""
Messages of one quantity of all bodies or pairs: a header, then doubles.

The messages of a single frame, as in the node, are made for all bodies at once: a call costs far
more than a row.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from kinpole_ros.messages._cdr import rows_of_bytes, stamped_doubles, stamped_head
from kinpole_ros.tracking.estimate import Estimate, Numbers, Vectors
from kinpole_ros.tracking.plane import Plane

if TYPE_CHECKING:
    from kinpole_ros.linkage.theory import Theory

# The messages of an estimate: indices of its instants, in order, and a message for each.
Built: TypeAlias = tuple[list[int], list[bytes]]
Build: TypeAlias = Callable[[Estimate], Built]
# An index of arrays (T, B): some instants of one body, or some bodies at one instant.
Index: TypeAlias = tuple[slice | np.ndarray, int] | tuple[int, slice | np.ndarray]
# Where a quantity is determined, (T,) or (T, B), and a function that returns its doubles (N, n).
Rows: TypeAlias = tuple[np.ndarray, Callable[[Index], np.ndarray]]
# The rows of an estimate, of one body or of all.
Quantity: TypeAlias = Callable[[Estimate, int | slice], Rows]

_UNMEASURED = 1e6  # m², rad², ...: a variance that a planar measurement says nothing about
# The same in a plane oblique to the axes of the frame, where it adds to all cells of the matrix and
# must not round away what is measured: standard deviations down to 1e-7 m are kept.
_UNMEASURED_OBLIQUE = 1e2
# The cells of a 3 x 3 matrix, those below the diagonal from above it: equal to the last bit.
_SYMMETRIC = [0, 1, 2, 1, 4, 5, 2, 5, 8]


def builds_of(
    count: int, quantity: Quantity, children: Sequence[str] | None = None, is_list: bool = False
) -> list[Build]:
    """
    Return a function for each of `count` bodies or pairs that makes the messages of a quantity.

    `children` are the second strings of messages that have one; `is_list` as in `stamped_doubles`.
    """
    names: Sequence[str | None] = [None] * count if children is None else children
    last_estimate: Estimate | None = None
    last_built: list[Built] = []

    def of_one(estimate: Estimate, k: int) -> Built:
        determined, rows = quantity(estimate, k)
        instants = determined.nonzero()[0]
        if not len(instants):
            return [], []
        chosen = slice(None) if len(instants) == len(determined) else instants
        values = rows((chosen, k))
        stamps = estimate.stamp[chosen]
        data = stamped_doubles(stamps, estimate.frame_id, values, names[k], is_list)
        return instants.tolist(), data

    def of_all(estimate: Estimate) -> list[Built]:
        determined, rows = quantity(estimate, slice(None))
        numbers = determined[0].nonzero()[0]
        built: list[Built] = [([], [])] * count
        if len(numbers):
            values = rows((0, slice(None) if len(numbers) == count else numbers))
            stamp = int(estimate.stamp[0])
            for k, row in zip(numbers.tolist(), rows_of_bytes(values), strict=True):
                head = stamped_head(stamp, estimate.frame_id, names[k], is_list)
                built[k] = [0], [head + row]
        return built

    def build(k: int, estimate: Estimate) -> Built:
        nonlocal last_estimate, last_built
        if estimate is not last_estimate:
            if len(estimate) > 1:
                return of_one(estimate, k)
            last_estimate, last_built = estimate, of_all(estimate)
        return last_built[k]

    return [partial(build, k) for k in range(count)]


def with_deviation(
    count: int, quantity: Callable[[bool], Quantity]
) -> tuple[list[Build], list[Build]]:
    """Return the functions of a quantity, and those of its standard deviation."""
    return builds_of(count, quantity(False)), builds_of(count, quantity(True))


def numbers(values: Callable[[Estimate], Numbers], given: Plane, deviation: bool) -> Quantity:
    """Write a number as a vector along the normal, or its standard deviation."""

    def quantity(estimate: Estimate, which: int | slice) -> Rows:
        value, variance, determined = values(estimate)

        def rows(index: Index) -> np.ndarray:
            chosen = np.sqrt(variance[index]) if deviation else value[index]
            return (estimate.plane or given).along_normal(chosen)

        return determined[:, which], rows

    return quantity


def vectors(
    values: Callable[[Estimate], Vectors],
    given: Plane,
    bodies: np.ndarray | None,
    deviation: bool = False,
) -> Quantity:
    """
    Write a vector in the plane, or its standard deviations along the axes of the frame.

    With `bodies` the vectors are points, at the heights of these bodies above the plane.
    """

    def quantity(estimate: Estimate, which: int | slice) -> Rows:
        value, covariance, determined = values(estimate)

        def rows(index: Index) -> np.ndarray:
            plane = estimate.plane or given
            if deviation:
                axes = plane.basis[:2]
                variances = np.einsum('ia,tij,ja->ta', axes, covariance[index], axes)
                return np.asarray(np.sqrt(np.maximum(variances, 0.0)))
            heights = 0.0 if bodies is None else estimate.height[index[0], bodies[index[1]]]
            return plane.in_space(value[index], heights)

        return determined[:, which], rows

    return quantity


def points_with_covariance(values: Callable[[Estimate], Vectors], given: Plane) -> Quantity:
    """Write a point of each body as a pose with covariance."""

    def quantity(estimate: Estimate, which: int | slice) -> Rows:
        value, covariance, determined = values(estimate)

        def rows(index: Index) -> np.ndarray:
            chosen = value[index]
            poses = np.zeros((len(chosen), 43))
            plane = estimate.plane or given
            poses[:, :3] = plane.in_space(chosen, estimate.height[index])
            poses[:, 6] = 1.0
            axes = plane.basis[:2]
            # Seven numbers of the pose, then a 6 x 6 matrix.
            cells = poses[:, 7:].reshape(-1, 6, 6)
            cells[:, :3, :3] = axes.T @ covariance[index] @ axes
            return poses

        return determined[:, which], rows

    return quantity


def balance_wrench(theory: 'Theory', given: Plane, deviation: bool) -> Quantity:
    """Write the torque or force that balances the loads of the scene, or its deviation."""
    from kinpole_ros.linkage.theory import balance, balance_direction

    def quantity(estimate: Estimate, which: int | slice) -> Rows:
        value, variance, determined = (part[:, None] for part in balance(theory, estimate))
        direction = balance_direction(theory, estimate)
        plane = estimate.plane or given

        def rows(index: Index) -> np.ndarray:
            values = np.sqrt(variance[index]) if deviation else value[index]
            wrench = np.zeros((len(values), 6))
            if direction is None:
                wrench[:, 3:] = plane.along_normal(values)
            else:
                force = plane.in_space(values * direction[:, None][index], 0.0)
                wrench[:, :3] = np.abs(force) if deviation else force
            return wrench

        return determined[:, which], rows

    return quantity


def frame_poses(estimate: Estimate, given: Plane, index: Index) -> np.ndarray:
    """
    Return the poses (N, 7) of the frames of bodies: x, y, z, m, and a quaternion x, y, z, w.

    They are in the frame of the markers; `given` is the plane of an estimate that has none.
    """
    plane = estimate.plane or given
    half_turn = np.exp(0.5j * estimate.angle[0][index])
    poses = np.empty((len(half_turn), 7))
    poses[:, :3] = plane.in_space(estimate.origin(0)[index], estimate.height[index])
    poses[:, 3:6], poses[:, 6] = plane.along_normal(half_turn.imag), half_turn.real
    return poses


def odometry(given: Plane) -> Quantity:
    """Write the pose of each body in the frame of the markers, its twist in its own (REP-105)."""
    return lambda e, which: (e.missing[:, which] == '', partial(_odometry_rows, e, given))


def _odometry_rows(estimate: Estimate, given: Plane, index: Index) -> np.ndarray:
    velocity = estimate.origin(1)[index]
    angle, rate = estimate.angle[0][index], estimate.angle[1][index]
    rows = np.zeros((len(angle), 85))
    pose, twist = rows[:, :43], rows[:, 43:]
    plane = estimate.plane or given
    pose[:, :7] = frame_poses(estimate, given, index)
    turn = np.exp(0.5j * angle) ** 2
    twist[:, :3] = plane.in_space(velocity / turn, 0.0)
    twist[:, 3:6] = plane.along_normal(rate)
    of_angle = np.moveaxis(estimate.angle_covariance, (0, 1), (-2, -1))[index][:, :2, :2].copy()
    of_angle[:, 1, 1] = estimate.rate(1).variance[index]
    # Derivatives of pose and twist by the angle and the rate: the origin turns about the reference
    # point, and the velocity of that point is seen from the body.
    arm = estimate.reference[index]
    by_angle = np.zeros((2, len(angle), 3, 2))
    for part, column, lever in (
        (0, 0, arm * turn),
        (1, 0, estimate.position[1][index] / turn),
        (1, 1, arm),
    ):
        by_angle[part, :, 0, column] = lever.imag
        by_angle[part, :, 1, column] = -lever.real
    by_angle[0, :, 2, 0] = by_angle[1, :, 2, 1] = 1.0
    covariance = np.einsum('ptij,tjk,ptlk->ptil', by_angle, of_angle, by_angle)
    measured, unmeasured = _planar_axes(plane)
    for order, part in enumerate((pose, twist)):
        variance = estimate.position_covariance[order, order][index]
        symmetric = covariance[order].reshape(-1, 9)[:, _SYMMETRIC].reshape(-1, 3, 3)
        symmetric[:, 0, 0] += variance
        symmetric[:, 1, 1] += variance
        cells = measured @ symmetric @ measured.T
        cells = (cells + cells.swapaxes(1, 2)) / 2 + unmeasured
        part[:, -36:] = cells.reshape(-1, 36)
    return rows


def _planar_axes(plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the axes (6, 3) of x, y and angle of the plane in a pose in space, as ROS orders it.

    Also the covariance (6, 6) of the directions that a planar measurement says nothing about.
    """
    axes = plane.basis[:2]
    measured, unmeasured = np.zeros((6, 3)), np.zeros((6, 6))
    measured[:3, :2], measured[3:, 2] = axes.T, plane.normal
    unmeasured[:3, :3] = np.outer(plane.normal, plane.normal)
    unmeasured[3:, 3:] = axes.T @ axes
    return measured, unmeasured * (_UNMEASURED if plane.axes else _UNMEASURED_OBLIQUE)
