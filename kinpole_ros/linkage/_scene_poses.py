"""
Measured poses of a scene's bodies with their covariances, and the residuals of its joints there.

The frames of tracked bodies lie anywhere in the bodies. The scene's markers show how the scene's
frames lie in them. A pose is a complex position, m, and an angle with whole turns.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._matches import BodyMatch
from kinpole_ros.mechanism import Equations, Pose
from kinpole_ros.mechanism._constraints import Anchor, anchor_of, constraint_rows
from kinpole_ros.mechanism._equations import joint_at, part_sum
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.reasons import KNOWN
from kinpole_ros.tracking.values import FramePoses

# How each wheel stood at first, by the number of its joint.
Anchors = dict[int, Anchor | None]


class ScenePoses(NamedTuple):
    """
    Poses (T, B) of bodies in the plane of the markers: `position` (complex, m) and `angle` (rad).

    `cofactor` (T, B, 3, 3) is the covariance of x, y and angle over the square of the `noise`
    (T, B) of a marker, m. `seen` (T, B) says where a pose is known, and `bodies` (B,) numbers the
    bodies in the equations.
    """

    position: Complex
    angle: Real
    cofactor: Real
    noise: Real
    seen: np.ndarray
    bodies: tuple[int, ...]

    @property
    def instants(self) -> int:
        """Number of instants T."""
        return len(self.angle)

    @property
    def covariance(self) -> Real:
        """Covariance of x, y and angle (T, B, 3, 3)."""
        return self.cofactor * self.noise[..., None, None] ** 2

    def at_instants(self, rows: np.ndarray | slice) -> 'ScenePoses':
        """The poses of some instants."""
        return ScenePoses._make([*(array[rows] for array in self[:-1]), self.bodies])

    def of_bodies(self, columns: np.ndarray) -> 'ScenePoses':
        """The poses of some of the B bodies."""
        bodies = tuple(self.bodies[k] for k in columns.tolist())
        return ScenePoses._make([*(array[:, columns] for array in self[:-1]), bodies])


def scene_poses(
    equations: Equations, values: Real, matches: Mapping[str, BodyMatch], estimate: Estimate
) -> ScenePoses | None:
    """
    Poses of the bodies of `equations` from estimates (T, B) or (B,); None if they keep no poses.

    The dimensions have these `values`, which place a scene's frames on one body.
    """
    if estimate.frame_poses is None:
        return None
    arrays = estimate.shape, estimate.reason, *estimate.frame_poses
    if not np.ndim(estimate.stamp):
        arrays = tuple(np.asarray(array)[None] for array in arrays)
    shapes, reasons = arrays[:2]
    measured = FramePoses(*arrays[2:])
    rows, bodies = [], []
    for body, match in matches.items():
        home, offset = equations.frames[body]
        number = equations.bodies.index(home)
        if number in bodies:
            continue
        bodies.append(number)
        b = match.tracked
        frame_position, frame_angle = match.fit_frame(shapes[:, b])
        origin = frame_position - np.exp(1j * frame_angle) * part_sum(offset, values)[0]
        seen = (measured.angle_information[:, b] > 0) & (reasons[:, b] == KNOWN)
        seen &= np.isfinite(frame_angle)
        angle_cofactor = 1 / np.where(seen, measured.angle_information[:, b], 1.0)
        position_cofactor = 1 / np.where(seen, measured.position_information[:, b], 1.0)
        turn = np.exp(1j * measured.angle[:, b])
        middle = measured.middle[:, b]
        # The position of the middle is independent of the angle, that of another point is not.
        at_middle = np.maximum(position_cofactor - np.abs(middle) ** 2 * angle_cofactor, 0.0)
        arm = 1j * turn * (origin - middle)
        by_angle = np.stack((arm.real, arm.imag, np.ones(len(arm))), axis=-1)
        cofactor = angle_cofactor[:, None, None] * by_angle[:, :, None] * by_angle[:, None]
        cofactor[:, [0, 1], [0, 1]] += at_middle[:, None]
        position = measured.position[:, b] + turn * origin
        angle = measured.angle[:, b] + frame_angle
        rows.append((position, angle, cofactor, measured.noise[:, b], seen))
    columns = (np.stack(row, axis=1) for row in zip(*rows, strict=True))
    return ScenePoses._make([*columns, tuple(bodies)])


def concatenated(blocks: Sequence[ScenePoses], limit: int) -> ScenePoses:
    """
    Join blocks of poses, of up to `limit` instants, evenly spaced.

    The noise of each body is its rms without the first quarter, when it was hardly known.
    """
    columns = zip(*(block[:-1] for block in blocks), strict=True)
    poses = ScenePoses._make([*map(np.concatenate, columns), blocks[0].bodies])
    for b in range(len(poses.bodies)):
        later = np.flatnonzero(poses.seen[:, b])
        later = later[len(later) // 4 :]
        poses.noise[:, b] = np.sqrt(np.mean(poses.noise[later, b] ** 2)) if len(later) else np.nan
    count = poses.instants
    return poses if count <= limit else poses.at_instants(np.arange(limit) * count // limit)


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
        if number not in anchors:
            anchors[number] = anchor_of(joint, *poses)
        rows = constraint_rows(joint, *poses, anchors[number])
        by = np.zeros((*rows.value.shape, len(bodies), 3))
        by[:, :, i] += rows.slope[:, :, :3]
        by[:, :, j] += rows.slope[:, :, 3:6]
        value.append(rows.value)
        by_pose.append(by)
        by_dimension.append(rows.slope[:, :, 6:] @ sizes)
        numbers += [number] * rows.value.shape[1]
    return Residuals(
        np.concatenate(value, axis=1),
        np.concatenate(by_pose, axis=1),
        np.concatenate(by_dimension, axis=1),
        np.array(numbers),
    )
