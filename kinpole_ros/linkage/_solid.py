"""
Poses of bodies in space, the axes that they turn about, and the joints of two of them.

A body of three markers or more that are not on one line has a pose in each frame, and its rotation
vectors have an axis. Joints are fitted to pairs of poses (Ehrig et al. 2006 and 2007).
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._joints import GIVES
from kinpole_ros.planar._plane import Real

GROUND_NUMBER = -1  # of the ground, where bodies go by number
_FEWEST = 30  # frames in which two bodies must be seen together
_THIN = 0.1  # width over length: markers nearer to one line do not show the turn about it
_ROUNDS = 4  # of poses by the shape, and the shape by the poses
_TURNED = np.radians(5)  # rms turn of two bodies below which no joint of theirs can be found
_FITS = 3.0  # times the residuals of two bodies that a joint may leave over
_HINGE = 0.4  # turn about other axes over that about the main one, up to which it is a hinge
_FAR = 5.0  # sizes of a body that a joint may be away from its markers


class SolidPose(NamedTuple):
    """
    Poses of a body in space over F frames.

    `rotation` (F, 3, 3) and `position` (F, 3) of the mean of its markers, NaN where not known.
    `shape` (n, 3) are its markers about their mean. `noise` is the rms residual of a marker per
    axis, `size` the largest distance of two markers.
    """

    rotation: Real
    position: Real
    shape: Real
    noise: float
    size: float


class SpaceJoint(NamedTuple):
    """
    A joint of two bodies, by number, where both have one point in common, or one axis.

    `on_one` and `on_other` (3,) are the center about the means of their markers; `axis` (3,) is
    that of a hinge on the other body at the mean orientation, None for a ball joint. The number of
    the ground is -1, and it is never `one`. `residual` is the rms of what is left over per axis,
    `expected` what the residuals of the markers explain.
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
    full = int(seen.sum(axis=1).argmax())
    shape = np.where(seen[full, :, None], points[full], np.nan)
    if not seen.any():
        return None
    shape = shape - mean_of(shape)
    for _ in range(_ROUNDS):
        known = np.isfinite(shape[:, 0])
        rotation, position = _poses(np.nan_to_num(shape), points, seen & known)
        local = np.einsum('fji,fnj->fni', rotation, points - position[:, None])
        shape = mean_of(local)
        if not np.isfinite(shape).any():
            return None
        shape = shape - mean_of(shape)
    off = local - mean_of(local)
    used = np.isfinite(off[..., 0])
    freedom = np.maximum(3 * used.sum(axis=1) - 6, 0).sum()
    noise = float(np.sqrt(np.nansum(off**2) / max(freedom, 1)))
    shape = np.nan_to_num(shape)
    values = np.linalg.svd(shape - shape.mean(axis=0), compute_uv=False)
    if len(shape) < 3 or values[1] <= _THIN * values[0] or not used.any():
        return None
    size = float(np.linalg.norm(shape[:, None] - shape, axis=-1).max())
    return SolidPose(rotation, position, shape, noise, size)


def mean_of(values: Real) -> Real:
    """Compute the means of `values` (T, ...) over the first axis without NaN, NaN for none."""
    count = np.isfinite(values).sum(axis=0)
    return np.where(count > 0, np.nansum(values, axis=0) / np.maximum(count, 1), np.nan)


def _poses(shape: Real, points: Real, used: np.ndarray) -> tuple[Real, Real]:
    """Rotation (F, 3, 3) and position (F, 3) that bring the shape (n, 3) to points (F, n, 3)."""
    weight = used / np.maximum(used.sum(axis=1, keepdims=True), 1)
    there = np.where(used[..., None], points, 0.0)
    mean, center = np.einsum('fn,fni->fi', weight, there), weight @ shape
    off = np.where(used[..., None], points - mean[:, None], 0.0)
    left, _, right = np.linalg.svd(np.einsum('fni,fnj->fij', off, shape - center[:, None]))
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    rotation = left @ right
    rotation[used.sum(axis=1) < 3] = np.nan
    return rotation, mean - np.einsum('fij,fj->fi', rotation, center)


def rotation_vectors(rotation: Real) -> Real:
    """Rotation vectors (F, 3), rad, of matrices (F, 3, 3): axis times angle."""
    cosine = np.clip((np.trace(rotation, axis1=-2, axis2=-1) - 1) / 2, -1.0, 1.0)
    angle = np.arccos(cosine)
    # The axis by the symmetric part near half a turn, where the other one vanishes.
    skew = np.stack([rotation[:, a, b] - rotation[:, b, a] for a, b in ((2, 1), (0, 2), (1, 0))], 1)
    square = np.clip((np.diagonal(rotation, axis1=1, axis2=2) - cosine[:, None]), 0.0, None)
    square = square / np.maximum(1 - cosine, 1e-12)[:, None]
    axis = np.sqrt(square) * np.where(skew < 0, -1.0, 1.0)
    sine = np.linalg.norm(skew, axis=1, keepdims=True)
    near_half = (cosine < -0.9)[:, None]
    return angle[:, None] * np.where(near_half, axis, skew / np.maximum(sine, 1e-12))


def mean_rotation(rotation: Real) -> Real:
    """Compute the rotation (3, 3) nearest to the mean of rotations (F, 3, 3), NaN for none."""
    left, _, right = np.linalg.svd(mean_of(rotation))
    left[:, 2] *= np.sign(np.linalg.det(left @ right))
    return np.asarray(left @ right)


def turn_scatter(pose: SolidPose) -> Real:
    """Mean products (3, 3) of the rotation vectors of a body from its mean orientation, rad²."""
    turns = rotation_vectors(pose.rotation @ mean_rotation(pose.rotation).T)
    turns = turns[np.isfinite(turns[:, 0])]
    return np.asarray(turns.T @ turns / max(len(turns), 1))


def main_axis(pose: SolidPose) -> Real:
    """Compute the direction (3,) of the axis that a body turns about the most."""
    return np.asarray(np.linalg.eigh(turn_scatter(pose))[1][:, 2])


def out_of_plane(pose: SolidPose, normal: Real) -> tuple[float, float, float]:
    """
    Compute how far a body leaves its plane: rms along the normal, and turn about other axes, rad.

    The last value is the rms turn about the normal.
    """
    height = pose.position @ normal
    off = float(np.sqrt(mean_of((height - mean_of(height)) ** 2)))
    turns = turn_scatter(pose)
    about = float(normal @ turns @ normal)
    return off, float(np.sqrt(max(np.trace(turns) - about, 0.0))), float(np.sqrt(max(about, 0.0)))


def relative_turns(one: SolidPose, other: SolidPose) -> Real:
    """Rotation vectors (k, 3) of a body in the frame of another one, from their mean, rad."""
    relative = one.rotation.transpose(0, 2, 1) @ other.rotation
    relative = relative[np.isfinite(relative[:, 0, 0])]
    return rotation_vectors(relative @ mean_rotation(relative).T)


def turn_between(one: SolidPose | None, other: SolidPose | None) -> float:
    """Rms turn of two bodies against each other, rad; infinite where one does not show its turn."""
    if one is None or other is None:
        return np.inf
    turns = relative_turns(one, other)
    return float(np.sqrt(np.mean(np.sum(turns**2, axis=1)))) if len(turns) else 0.0


def fit_space_joint(
    one: SolidPose | None,
    other: SolidPose | None,
    numbers: tuple[int, int],
    gives: float = GIVES,
) -> SpaceJoint | None:
    """
    Fit the center that two bodies have in common (Ehrig et al. 2006); None where they have none.

    It may give by this share of its distances from their markers.

    R₁ c₁ + t₁ = R₂ c₂ + t₂ in all frames. Of a hinge any point of the axis will do: the eigenvector
    of the smallest eigenvalue of the normal equations is along it; the point taken is that nearest
    to the markers of both.
    """
    if one is None or other is None:
        return None
    both = np.isfinite(one.rotation[:, 0, 0]) & np.isfinite(other.rotation[:, 0, 0])
    if both.sum() < _FEWEST or turn_between(one, other) < _TURNED:
        return None
    first, second = one.rotation[both], other.rotation[both]
    offset = (other.position - one.position)[both]
    between = first.transpose(0, 2, 1) @ second
    spread = np.linalg.eigvalsh(np.cov(relative_turns(one, other).T))
    hinge = bool(spread[1] < _HINGE**2 * spread[2])
    # Of rows [R₁, -R₂], and of right sides t₂ - t₁.
    cross = -between.mean(axis=0)
    values, ways = np.linalg.eigh(np.block([[np.eye(3), cross], [cross.T, np.eye(3)]]))
    on_first = np.einsum('fij,fi->j', first, offset) / len(offset)
    on_second = -np.einsum('fij,fi->j', second, offset) / len(offset)
    kept = slice(1 if hinge else 0, None)
    values = np.maximum(values[kept], 1e-12)
    found = ways[:, kept] @ (ways[:, kept].T @ np.concatenate((on_first, on_second)) / values)
    rest = first @ found[:3] - second @ found[3:] - offset
    residual = float(np.sqrt(np.mean(rest**2)))
    on_one, on_other = found[:3], found[3:]
    axis = mean_rotation(second) @ ways[3:, 0] if hinge else None
    expected = float(np.hypot(_lever(one, on_one), _lever(other, on_other)))
    reach = float(np.linalg.norm(on_one)), float(np.linalg.norm(on_other))
    far = reach[0] > _FAR * one.size or reach[1] > _FAR * other.size
    if far or residual > max(_FITS * expected, gives * sum(reach)):
        return None
    if axis is not None:
        axis = axis / np.linalg.norm(axis)
    return SpaceJoint(*numbers, on_one, on_other, axis, residual, expected)


def fit_fixed_point(pose: SolidPose | None, number: int) -> SpaceJoint | None:
    """
    Fit the point, or axis, of a body that stands still; None where it has none.

    `on_other` is where it is in the frame of the markers.
    """
    if pose is None:
        return None
    # The ground about where the body is, so that distances from it mean something.
    middle = mean_of(pose.position)
    still = np.broadcast_to(np.eye(3), pose.rotation.shape)
    at = np.broadcast_to(middle, pose.position.shape)
    ground = SolidPose(still, at, np.zeros((1, 3)), 0.0, pose.size)
    joint = fit_space_joint(pose, ground, (number, GROUND_NUMBER), 0.0)
    return joint and joint._replace(on_other=middle + joint.on_other)


def _lever(pose: SolidPose, place: Real) -> float:
    """What the residuals of the markers of a body make of a place on it, per axis."""
    return pose.noise * float(
        np.sqrt(1 / len(pose.shape) + place @ place / max(float(np.sum(pose.shape**2)), 1e-30))
    )
