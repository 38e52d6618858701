"""
Poses of bodies in space, the axes that they turn about, and the joints between them.

A body needs three markers that are not on one line. Joints are fitted to pairs of poses (Ehrig et
al. 2006 and 2007).
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._body_poses import GROUND_NUMBER
from kinpole_ros.linkage._found_joints import SKIN_STRAIN
from kinpole_ros.linkage.limits import PAIR_FRAMES
from kinpole_ros.planar._plane import Real

# Width of a body over its length. Narrower bodies do not show how they turn about their length.
_MIN_WIDTH = 0.1
# Rounds of fitting the poses to the shape, and the shape to the poses.
_ROUNDS = 4
# Rms turn of two bodies against each other, without which no joint is found, rad.
_MIN_TURN = np.radians(5)
# Residual of a joint over that of the markers of its bodies.
_MAX_RESIDUAL = 3.0
# Turn of a hinge about other axes, over that about its main axis.
_HINGE_RATIO = 0.4
# Distance of a joint from the markers of a body, over the size of the body.
_MAX_DISTANCE = 5.0


class SolidPose(NamedTuple):
    """
    Poses of a body in space over F frames.

    `rotation` (F, 3, 3) and `position` (F, 3) are those of the mean of its markers, NaN where not
    known. `shape` (n, 3) are its markers about their mean. `noise` is the rms residual of a marker
    per axis, `size` the largest distance of two markers.
    """

    rotation: Real
    position: Real
    shape: Real
    noise: float
    size: float


class SpaceJoint(NamedTuple):
    """
    A joint of two bodies, by number: a common point, or a common axis.

    `on_one` and `on_other` (3,) are the center, from the means of their markers. `axis` (3,) is
    that of a hinge on the other body at its mean orientation, None for a ball joint. The ground is
    GROUND_NUMBER, and never `one`. `residual` is the rms distance of the two points per axis,
    `expected` what the residuals of the markers explain of it.
    """

    one: int
    other: int
    on_one: Real
    on_other: Real
    axis: Real | None
    residual: float
    expected: float


def fit_solid(points: Real) -> SolidPose | None:
    """
    Fit the poses of a body of markers (F, n, 3), NaN for none; None for markers on one line.

    Generalized Procrustes: poses by the shape, the shape by the poses (Gower 1975).
    """
    seen = np.isfinite(points[..., 0])
    if not seen.any():
        return None
    full = int(seen.sum(axis=1).argmax())
    shape = np.where(seen[full, :, None], points[full], np.nan)
    shape = shape - finite_mean(shape)
    for _ in range(_ROUNDS):
        used = seen & np.isfinite(shape[:, 0])
        rotation, position = _procrustes(np.nan_to_num(shape), points, used)
        local = np.einsum('fji,fnj->fni', rotation, points - position[:, None])
        mean = finite_mean(local)
        if not np.isfinite(mean).any():
            return None
        shape = mean - finite_mean(mean)
    residual = local - mean
    fitted = np.isfinite(residual[..., 0])
    freedom = np.maximum(3 * fitted.sum(axis=1) - 6, 0).sum()
    noise = float(np.sqrt(np.nansum(residual**2) / max(freedom, 1)))
    shape = np.nan_to_num(shape)
    lengths = np.linalg.svd(shape - shape.mean(axis=0), compute_uv=False)
    if len(shape) < 3 or lengths[1] <= _MIN_WIDTH * lengths[0] or not fitted.any():
        return None
    size = float(np.linalg.norm(shape[:, None] - shape, axis=-1).max())
    return SolidPose(rotation, position, shape, noise, size)


def finite_mean(values: Real) -> Real:
    """Means of `values` (T, ...) over the first axis without NaN; NaN for none."""
    count = np.isfinite(values).sum(axis=0)
    return np.where(count > 0, np.nansum(values, axis=0) / np.maximum(count, 1), np.nan)


def _procrustes(shape: Real, points: Real, used: np.ndarray) -> tuple[Real, Real]:
    """Rotation (F, 3, 3) and position (F, 3) that bring the shape (n, 3) to points (F, n, 3)."""
    weight = used / np.maximum(used.sum(axis=1, keepdims=True), 1)
    mean = np.einsum('fn,fni->fi', weight, np.where(used[..., None], points, 0.0))
    center = weight @ shape
    arms = np.where(used[..., None], points - mean[:, None], 0.0)
    u, _, vt = np.linalg.svd(np.einsum('fni,fnj->fij', arms, shape - center[:, None]))
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    rotation = u @ vt
    rotation[used.sum(axis=1) < 3] = np.nan
    return rotation, mean - np.einsum('fij,fj->fi', rotation, center)


def rotation_vectors(rotation: Real) -> Real:
    """Rotation vectors (F, 3), rad, of matrices (F, 3, 3): axis times angle."""
    cosine = np.clip((np.trace(rotation, axis1=-2, axis2=-1) - 1) / 2, -1.0, 1.0)
    angle = np.arccos(cosine)
    skew = np.stack([rotation[:, a, b] - rotation[:, b, a] for a, b in ((2, 1), (0, 2), (1, 0))], 1)
    sine = np.linalg.norm(skew, axis=1, keepdims=True)
    # Near half a turn the skew part vanishes, and the symmetric part gives the axis.
    square = np.clip((np.diagonal(rotation, axis1=1, axis2=2) - cosine[:, None]), 0.0, None)
    square = square / np.maximum(1 - cosine, 1e-12)[:, None]
    axis = np.sqrt(square) * np.where(skew < 0, -1.0, 1.0)
    is_near_half = (cosine < -0.9)[:, None]
    return angle[:, None] * np.where(is_near_half, axis, skew / np.maximum(sine, 1e-12))


def mean_rotation(rotation: Real) -> Real:
    """The rotation (3, 3) nearest to the mean of rotations (F, 3, 3), NaN for none."""
    u, _, vt = np.linalg.svd(finite_mean(rotation))
    u[:, 2] *= np.sign(np.linalg.det(u @ vt))
    return np.asarray(u @ vt)


def turn_scatter(pose: SolidPose) -> Real:
    """Mean products (3, 3) of a body's rotation vectors from its mean orientation, rad²."""
    turns = rotation_vectors(pose.rotation @ mean_rotation(pose.rotation).T)
    turns = turns[np.isfinite(turns[:, 0])]
    return np.asarray(turns.T @ turns / max(len(turns), 1))


def main_axis(pose: SolidPose) -> Real:
    """Direction (3,) of the axis that a body turns about the most."""
    return np.asarray(np.linalg.eigh(turn_scatter(pose))[1][:, 2])


def out_of_plane(pose: SolidPose, normal: Real) -> tuple[float, float, float]:
    """
    How far a body leaves a plane: rms distance, and rms turn about axes in the plane, rad.

    The last value is the rms turn about the normal (3,), rad.
    """
    height = pose.position @ normal
    off = float(np.sqrt(finite_mean((height - finite_mean(height)) ** 2)))
    turns = turn_scatter(pose)
    about = float(normal @ turns @ normal)
    return off, float(np.sqrt(max(np.trace(turns) - about, 0.0))), float(np.sqrt(max(about, 0.0)))


def relative_turns(first: SolidPose, second: SolidPose) -> Real:
    """Rotation vectors (k, 3) of `second` in the frame of `first`, from their mean, rad."""
    relative = first.rotation.transpose(0, 2, 1) @ second.rotation
    relative = relative[np.isfinite(relative[:, 0, 0])]
    return rotation_vectors(relative @ mean_rotation(relative).T)


def turn_between(first: SolidPose | None, second: SolidPose | None) -> float:
    """Rms turn of two bodies against each other, rad; infinite where one has no orientation."""
    if first is None or second is None:
        return np.inf
    turns = relative_turns(first, second)
    return float(np.sqrt(np.mean(np.sum(turns**2, axis=1)))) if len(turns) else 0.0


def fit_space_joint(
    first: SolidPose | None,
    second: SolidPose | None,
    numbers: tuple[int, int],
    strain: float = SKIN_STRAIN,
) -> SpaceJoint | None:
    """
    Fit the center that two bodies have in common (Ehrig et al. 2006); None where they have none.

    R₁ c₁ + t₁ = R₂ c₂ + t₂ in all frames. Of a hinge any point of the axis is a solution: the
    eigenvector of the smallest eigenvalue of the normal equations is along the axis, and the
    center is the point nearest to the markers of both. The residual may be this `strain` of the
    distances from the markers.
    """
    if first is None or second is None:
        return None
    common = np.isfinite(first.rotation[:, 0, 0]) & np.isfinite(second.rotation[:, 0, 0])
    if common.sum() < PAIR_FRAMES or turn_between(first, second) < _MIN_TURN:
        return None
    r1, r2 = first.rotation[common], second.rotation[common]
    offset = (second.position - first.position)[common]
    turns = np.linalg.eigvalsh(np.cov(relative_turns(first, second).T))
    is_hinge = bool(turns[1] < _HINGE_RATIO**2 * turns[2])
    # Normal equations of [R₁, -R₂] [c₁, c₂] = t₂ - t₁, by eigenvectors.
    cross = -(r1.transpose(0, 2, 1) @ r2).mean(axis=0)
    values, vectors = np.linalg.eigh(np.block([[np.eye(3), cross], [cross.T, np.eye(3)]]))
    right = np.concatenate(
        (np.einsum('fij,fi->j', r1, offset), -np.einsum('fij,fi->j', r2, offset))
    ) / len(offset)
    used = slice(1 if is_hinge else 0, None)
    values = np.maximum(values[used], 1e-12)
    centers = vectors[:, used] @ (vectors[:, used].T @ right / values)
    c1, c2 = centers[:3], centers[3:]
    residual = float(np.sqrt(np.mean((r1 @ c1 - r2 @ c2 - offset) ** 2)))
    expected = float(np.hypot(_point_noise(first, c1), _point_noise(second, c2)))
    distances = float(np.linalg.norm(c1)), float(np.linalg.norm(c2))
    is_far = distances[0] > _MAX_DISTANCE * first.size or distances[1] > _MAX_DISTANCE * second.size
    if is_far or residual > max(_MAX_RESIDUAL * expected, strain * sum(distances)):
        return None
    axis = None
    if is_hinge:
        axis = mean_rotation(r2) @ vectors[3:, 0]
        axis = axis / np.linalg.norm(axis)
    return SpaceJoint(*numbers, c1, c2, axis, residual, expected)


def fit_fixed_point(pose: SolidPose | None, number: int) -> SpaceJoint | None:
    """
    Fit the point, or axis, of a body that stands still; None where it has none.

    `on_other` is its position in the frame of the markers.
    """
    if pose is None:
        return None
    # The origin of the ground is put near the body, so that distances from it mean something.
    middle = finite_mean(pose.position)
    rotation = np.broadcast_to(np.eye(3), pose.rotation.shape)
    position = np.broadcast_to(middle, pose.position.shape)
    ground = SolidPose(rotation, position, np.zeros((1, 3)), 0.0, pose.size)
    joint = fit_space_joint(pose, ground, (number, GROUND_NUMBER), 0.0)
    return joint and joint._replace(on_other=middle + joint.on_other)


def _point_noise(pose: SolidPose, point: Real) -> float:
    """Error per axis of a point (3,) of a body, from the residuals of its markers."""
    return pose.noise * float(
        np.sqrt(1 / len(pose.shape) + point @ point / max(float(np.sum(pose.shape**2)), 1e-30))
    )
