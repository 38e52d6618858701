"""
What the joints of a scene lack at given poses, g(poses, dimensions), with its derivatives.

All functions take T instants at once. A pose is complex m and an angle with whole turns.
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


class Residuals(NamedTuple):
    """
    What is lacking (T, m), m or rad: two rows for a pin, in the ground's axes, less for others.

    `by_pose` (T, m, bodies, 3) are its derivatives by x, y (m) and angle of each body, and
    `by_dimension` (T, m, dimensions) those by the dimensions. `joint` (m,) numbers the joints.
    """

    value: Real
    by_pose: Real
    by_dimension: Real
    joint: np.ndarray

    def without(self, rows: np.ndarray) -> 'Residuals':
        """The same without some rows."""
        left = ~rows
        value, by_pose, by_dimension = (part[:, left] for part in self[:3])
        return Residuals(value, by_pose, by_dimension, self.joint[left])


# How each wheel stood at first, by the number of its joint.
Anchors = dict[int, Anchor]


def residuals(
    equations: Equations, values: Real, position: Complex, angle: Real, anchors: Anchors
) -> Residuals:
    """
    Residuals of the bodies of `equations` at poses (T, bodies), with the dimensions at `values`.

    How wheels stand at the first instant is kept in `anchors`, since no scene tells which teeth are
    in mesh.
    """
    bodies = {body: k for k, body in enumerate(equations.bodies)}
    value, by_pose, by_dimension, numbers = [], [], [], []
    for number in range(len(equations.joints)):
        joint, sizes = joint_at(equations, number, values)
        one, other = bodies[joint.one], bodies[joint.other]
        poses = Pose(position[:, one], angle[:, one]), Pose(position[:, other], angle[:, other])
        if isinstance(joint, Rolling):
            anchors.setdefault(number, wheel_state(joint, *poses))
        rows = constraint_rows(joint, *poses, anchors.get(number))
        by = np.zeros((*rows.value.shape, len(bodies), 3))
        by[:, :, one] += rows.slope[:, :, :3]
        by[:, :, other] += rows.slope[:, :, 3:6]
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
    """The numbers of the dimensions by what people may call wrong: a point, a length, an angle."""
    found: dict[str, list[int]] = {}
    for k, one in enumerate(dimensions):
        if one.path:
            found.setdefault(one.name, []).append(k)
    return found
