"""
Residuals of a scene's joints at given poses, with their derivatives by poses and dimensions.

All functions take T instants at once. A pose is a complex position, m, and an angle with whole
turns.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import (
    Anchor,
    Dimension,
    Equations,
    Pose,
    Rolling,
    constraint_rows,
    joint_at,
    wheel_state,
)
from kinpole_ros.planar._plane import Complex, Real

# How each wheel stood at first, by the number of its joint.
Anchors = dict[int, Anchor]


class Residuals(NamedTuple):
    """
    Residuals (T, m), m or rad: two rows for a pin, in the ground's axes, or those of its kind.

    `by_pose` (T, m, bodies, 3) are their derivatives by x, y (m) and angle of each body, and
    `by_dimension` (T, m, dimensions) those by the dimensions. `joint` (m,) numbers the joints.
    """

    value: Real
    by_pose: Real
    by_dimension: Real
    joint: np.ndarray

    def without(self, rows: np.ndarray) -> 'Residuals':
        """The same without the rows of a mask (m,)."""
        value, by_pose, by_dimension = (array[:, ~rows] for array in self[:3])
        return Residuals(value, by_pose, by_dimension, self.joint[~rows])


def residuals(
    equations: Equations, values: Real, position: Complex, angle: Real, anchors: Anchors
) -> Residuals:
    """
    Residuals of the bodies of `equations` at poses (T, bodies), with dimensions of these `values`.

    How wheels stand at the first instant is kept in `anchors`, since no scene says which teeth are
    in mesh.
    """
    bodies = {body: k for k, body in enumerate(equations.bodies)}
    value, by_pose, by_dimension, numbers = [], [], [], []
    for number in range(len(equations.joints)):
        joint, sizes = joint_at(equations, number, values)
        i, j = bodies[joint.one], bodies[joint.other]
        poses = Pose(position[:, i], angle[:, i]), Pose(position[:, j], angle[:, j])
        if isinstance(joint, Rolling):
            anchors.setdefault(number, wheel_state(joint, *poses))
        rows = constraint_rows(joint, *poses, anchors.get(number))
        by = np.zeros((*rows.value.shape, len(bodies), 3))
        by[:, :, i] += rows.slope[:, :, :3]
        by[:, :, j] += rows.slope[:, :, 3:6]
        value.append(rows.value)
        by_pose.append(by)
        by_dimension.append(rows.slope[:, :, 6:] @ sizes)
        numbers += [number] * len(rows.direction)
    return Residuals(
        np.concatenate(value, axis=1),
        np.concatenate(by_pose, axis=1),
        np.concatenate(by_dimension, axis=1),
        np.array(numbers),
    )


def point_dimensions(dimensions: Sequence[Dimension]) -> dict[str, list[int]]:
    """Numbers of the dimensions that the scene's file states, by name: of both coordinates."""
    numbers: dict[str, list[int]] = {}
    for k, dimension in enumerate(dimensions):
        if dimension.path:
            numbers.setdefault(dimension.name, []).append(k)
    return numbers
