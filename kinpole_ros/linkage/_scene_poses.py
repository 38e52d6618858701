"""
Measured poses of a scene's bodies, frame by frame, with their covariances.

The frames of tracked bodies lie anywhere in the bodies. The scene's markers show how the scene's
frames lie in them.
"""

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import Equations, part_sum
from kinpole_ros.planar import fit_pose
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.estimate import Estimate, FramePoses
from kinpole_ros.tracking.thresholds import NEGLIGIBLE


class BodyMatch(NamedTuple):
    """
    A body that is both tracked and in the scene.

    `tracked` and `in_scene` are its numbers in both. `markers` (k,) are those of its tracked
    markers that the scene has, at `positions` (k,) in the scene's frame of it, complex, m.
    """

    tracked: int
    in_scene: int
    markers: np.ndarray
    positions: Complex

    def fit_frame(self, shape: Complex) -> tuple[Complex, Real]:
        """Origin (T,) and angle (T,) of the scene's frame in the tracked one, by shapes (T, n)."""
        markers = shape[..., self.markers]
        fit = fit_pose(markers, self.positions, np.isfinite(markers).astype(float))
        return fit.position, fit.angle


class ScenePoses(NamedTuple):
    """
    Poses (T, B) of bodies in the plane of the markers: `position` (complex, m) and `angle` (rad).

    `cofactor` (T, B, 3, 3) is the covariance of x, y and angle over the square of the `noise`
    (T, B) of a marker, m. `seen` (T, B) says where a pose is known, and `bodies` (B,) numbers the
    bodies in the equations.
    """

    stamp: np.ndarray
    position: Complex
    angle: Real
    cofactor: Real
    noise: Real
    seen: np.ndarray
    bodies: tuple[int, ...]

    @property
    def covariance(self) -> Real:
        """Covariance of x, y and angle (T, B, 3, 3)."""
        return self.cofactor * self.noise[..., None, None] ** 2

    def at_instants(self, rows: np.ndarray | slice) -> 'ScenePoses':
        """The poses of some instants."""
        return ScenePoses._make([*(array[rows] for array in self[:-1]), self.bodies])

    def of_bodies(self, columns: np.ndarray) -> 'ScenePoses':
        """The poses of some of the B bodies."""
        arrays = (array[:, columns] for array in self[1:-1])
        bodies = tuple(self.bodies[k] for k in columns.tolist())
        return ScenePoses._make([self.stamp, *arrays, bodies])


def scene_poses(
    equations: Equations, values: Real, matches: Mapping[str, BodyMatch], estimate: Estimate
) -> ScenePoses | None:
    """
    Poses of the bodies of `equations` from estimates (T, B) or (B,); None if they keep no poses.

    The dimensions have these `values`, which place a scene's frames on one body.
    """
    if estimate.frame_poses is None:
        return None
    arrays = estimate.stamp, estimate.shape, estimate.missing, *estimate.frame_poses
    if not np.ndim(estimate.stamp):
        arrays = tuple(np.asarray(array)[None] for array in arrays)
    stamp, shapes, missing = arrays[:3]
    measured = FramePoses(*arrays[3:])
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
        seen = (measured.angle_information[:, b] > 0) & (missing[:, b] == '')
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
    return ScenePoses._make([stamp, *columns, tuple(bodies)])


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
    count = len(poses.stamp)
    return poses if count <= limit else poses.at_instants(np.arange(limit) * count // limit)


def match_markers(first: Complex, second: Complex) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Pair the markers (m,) and (n,) of two drawings of one rigid body by their positions alone.

    Each drawing has a frame of its own; the one with fewer markers is a part of the other. Returns
    the numbers of the paired markers in both. None where no pose puts each marker of the smaller on
    one of the larger, to 1% of the size.
    """
    is_swapped = len(first) > len(second)
    few, many = (second, first) if is_swapped else (first, second)
    if len(few) < 2:
        return None
    # Any two markers of the larger drawing may be the two that are farthest apart in the smaller.
    a, b = np.unravel_index(np.abs(few[:, None] - few).argmax(), (len(few), len(few)))
    least, best = np.inf, None
    for i, j in permutations(range(len(many)), 2):
        turn = np.exp(1j * np.angle((many[j] - many[i]) / (few[b] - few[a])))
        shift = (many[i] + many[j] - turn * (few[a] + few[b])) / 2
        nearest = np.abs(turn * few[:, None] + shift - many).argmin(axis=1)
        if len(set(nearest.tolist())) < len(few):
            continue
        fit = fit_pose(many[nearest], few, np.ones(len(few)))
        worst = float(np.abs(fit.residual).max())
        if worst < least:
            least, best = worst, nearest
    if best is None or least > NEGLIGIBLE * abs(few[b] - few[a]):
        return None
    order = np.arange(len(few))
    return (best, order) if is_swapped else (order, best)
