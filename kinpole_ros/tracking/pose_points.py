"""
Poses of bodies as points: each stands for its origin and a point on either axis of its frame.

Arrays of poses are (T, B, 3, 3), m, in the order of `POSE_POINTS`.
"""

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.settings import POSE_POINTS
from kinpole_ros.tracking.plane import Plane

# m. Distance from the origin of a pose to the points that stand for its axes.
ARM = abs(POSE_POINTS[0])
# The part of a body's rotation that is in the plane, of 2; with less the body has turned over.
_MIN_ROTATION_IN_PLANE = 0.1


def project_poses(
    poses: np.ndarray, plane: Plane, upside_down: np.ndarray
) -> tuple[Complex, Real, np.ndarray]:
    """
    Project poses into the plane.

    Only the rotation about the normal counts; the rest is how the frame sits on the body, and
    noise. The angle is 0 where the axes of the body are parallel to those of the plane, or turned
    by half a turn about the first of them.

    Parameters
    ----------
    poses : (T, B, 3, 3) float
        Poses in space, m.
    plane : Plane
        The plane of the motion.
    upside_down : (B,) int
        Whether the z axis of a body points against the normal, -1 while not known.

    Returns
    -------
    points : (T, B, 3) complex
        The points of the poses in the plane, m, NaN for none.
    heights : (T, B, 3) float
        Their heights along the normal, m.
    upside_down : (B,) int
        The same as given, of more bodies.

    """
    origin, height = plane.project(poses[:, :, 0])
    axes = _axes_of(poses)
    # The images of the axes of the plane. Summed term by term, since the rounding of a matrix
    # product depends on the number of frames.
    first, second = (
        plane.project(x * axes[0] + y * axes[1] + z * axes[2])[0] for x, y, z in plane.basis[:2]
    )
    turns = np.stack((first - 1j * second, first + 1j * second))
    upside_down = upside_down.copy()
    for b in np.flatnonzero(upside_down < 0).tolist():
        seen = np.flatnonzero(~np.isnan(turns[0, :, b]))
        if len(seen):
            upside_down[b] = int(np.argmax(np.abs(turns[:, seen[0], b])))
    turn = np.where(upside_down > 0, turns[1], turns[0])
    length = np.abs(turn)
    rotates = length > _MIN_ROTATION_IN_PLANE
    turn = np.where(rotates, turn, complex(np.nan, np.nan)) / np.where(rotates, length, 1.0)
    points = origin[..., None] + turn[..., None] * np.array(POSE_POINTS)
    heights = np.where(np.isnan(points.real), np.nan, height[..., None])
    return np.ascontiguousarray(points), np.ascontiguousarray(heights), upside_down


def tilts_of(poses: np.ndarray, plane: Plane, upside_down: np.ndarray) -> Complex:
    """
    Compute how far poses are tilted out of the plane, and in which direction.

    Parameters
    ----------
    poses : (T, B, 3, 3) float
        Poses in space, m.
    plane, upside_down : Plane, (B,) int
        See `project_poses`.

    Returns
    -------
    (T, B) complex
        The normal of the plane as seen from the frame of the body, in Lambert's equal-area
        projection: the sine of half the tilt, in the direction in which the normal leans.

    """
    # Summed term by term, for the reason given in `project_poses`.
    x, y, z = plane.normal
    axes = _axes_of(poses)
    own = x * axes[..., 0] + y * axes[..., 1] + z * axes[..., 2]
    first, second, third = (x * own[0] + y * own[1] + z * own[2] for x, y, z in plane.basis)
    side = np.where(upside_down > 0, -1.0, 1.0)
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.asarray((first + 1j * side * second) / np.sqrt(2 * (1 + side * third)))


def _axes_of(poses: np.ndarray) -> np.ndarray:
    """The unit axes (3, T, B, 3) of the frames of poses (T, B, 3, 3), m."""
    arms = (poses[:, :, 1:] - poses[:, :, :1]) / ARM
    return np.stack((*arms.transpose(2, 0, 1, 3), np.cross(arms[:, :, 0], arms[:, :, 1])))
