"""
Rigid bodies, their axes and their joints in space, before any plane is known.

Markers are grouped by the distances that stay constant (complete linkage). A body of three markers
or more that are not on one line has a pose in each frame, and its rotation vectors have an axis.
Joints are fitted to pairs of poses (Ehrig et al. 2006 and 2007).
"""

from collections.abc import Sequence
from itertools import combinations, permutations
from typing import NamedTuple, TypeVar

import numpy as np

from kinpole_ros.linkage._columns import quantiles
from kinpole_ros.linkage._joints import GIVES, Joint
from kinpole_ros.planar._plane import Real

_FRAMES = 1000  # that are looked at: more would not tell more
_FEWEST = 30  # frames in which two markers or bodies must be seen together
_TAIL = 0.01  # share of the frames at either end of a range that may be of another marker
_TAIL_WIDTH = 4.6527  # that range of a normal distribution, in standard deviations
_RIGID = 2.5  # spread of a distance over its noise, up to which it is rigid
_SOFTER = 3.0  # times the spread of two groups up to which both together are one body
# Spread of a distance over the usual distance of two markers of one body: below the first all are
# rigid (a loose marker), beyond the second none is (skin over a joint).
_LOOSE, _SOFTEST = 0.002, 0.04
_NOISIEST = (
    0.1  # noise over the usual distance of two markers of one body, that hides what is rigid
)
_OVER = 2.0  # times the softness of the bodies, for a marker over a joint
# The same over the distance itself, and times the largest of a body, for skin over a joint.
_STRAIN, _OVER_JOINT = 0.025, 1.3
_SEGMENT = 1 / 3  # usual distance of two markers of one body over that of any two
_THIN = 0.1  # width over length: markers nearer to one line do not show the turn about it
_TURNED = np.radians(8)  # rms turn of two bodies below which they cannot be told apart, or joined
_ROUNDS = 4  # of poses by the shape, and the shape by the poses
# Times the residuals of two bodies that a joint may leave over; the same where it closes a loop.
_FITS, _CLOSES = 3.0, 1.5
_ALONG = np.cos(np.radians(25))  # of the axis of a hinge, for two markers on it
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
    that of a hinge on the other body at the mean orientation, None for a ball joint. `residual` is
    the rms of what is left over per axis, `expected` what the residuals of the markers explain.
    """

    one: int
    other: int
    on_one: Real
    on_other: Real
    axis: Real | None
    residual: float
    expected: float


class SpaceBodies(NamedTuple):
    """
    Rigid bodies in space: columns of their markers, largest first, a marker over a joint in two.

    `solid` are their poses in sampled frames, None for markers on one line; `joints` are between
    bodies by number. `spread` (n, n) is that of the distances of all markers.
    """

    bodies: list[list[int]]
    solid: list[SolidPose | None]
    joints: list[SpaceJoint]
    spread: Real

    def only(self, kept: list[int]) -> 'SpaceBodies':
        """The same with some of the bodies, in this order."""
        place = {number: k for k, number in enumerate(kept)}
        joints = [
            joint._replace(one=place[joint.one], other=place[joint.other])
            for joint in self.joints
            if joint.one in place and joint.other in place
        ]
        bodies, solid = [self.bodies[k] for k in kept], [self.solid[k] for k in kept]
        return SpaceBodies(bodies, solid, joints, self.spread)


def sampled(points: Real) -> Real:
    """Some frames of `points` (T, ...), evenly spaced: enough to see what is rigid."""
    return points[:: max(1, len(points) // _FRAMES)]


def distance_spreads(points: Real) -> tuple[Real, Real]:
    """
    Spread and median (n, n) of the distances of all pairs of points (T, n, 3), NaN for none.

    The spread is a standard deviation by the range without its tails, infinite for pairs that are
    hardly ever seen together.
    """
    rows = np.ascontiguousarray(sampled(points).transpose(1, 0, 2))
    spread = np.full((len(rows), len(rows)), np.inf)
    usual = np.zeros(spread.shape)
    for k in range(len(rows) - 1):
        off = rows[k + 1 :] - rows[k]
        distance = np.sqrt(np.einsum('ntk,ntk->nt', off, off))
        (low, middle, high), count = quantiles(distance, (_TAIL, 0.5, 1 - _TAIL))
        known = count >= _FEWEST
        spread[k, k + 1 :] = spread[k + 1 :, k] = np.where(
            known, (high - low) / _TAIL_WIDTH, np.inf
        )
        usual[k, k + 1 :] = usual[k + 1 :, k] = np.where(known, middle, 0.0)
    return spread, usual


def find_bodies(points: Real, noise: Real) -> SpaceBodies:
    """
    Find the rigid bodies of markers (T, n, 3), NaN for none, and what joins them in space.

    `noise` (n,) is that of the markers per axis.
    """
    bodies, heights, spread, usual, soft, segment = _groups(points, noise)
    some = sampled(points)
    solid = [fit_solid(some[:, body]) for body in bodies]
    limit = _SOFTEST * segment
    limits = np.minimum(_STRAIN * usual, _OVER_JOINT * limit) + 1e-300
    grown = [
        _grow(body, spread, min(limit, max(height, _OVER * soft)), bodies, solid)
        for body, height in zip(bodies, heights, strict=True)
    ]
    solid = [fit_solid(some[:, body]) for body in grown]
    grown += _bridges(some, grown, solid, spread / limits)
    grown.sort(key=lambda body: -len(body))
    solid = [fit_solid(some[:, body]) for body in grown]
    return SpaceBodies(grown, solid, space_joints(solid), spread)


def soft_bodies(points: Real, noise: Real, bodies: list[list[int]]) -> list[list[int]] | None:
    """
    Group the markers (T, n, 3) of a plane anew where a body of `bodies` is none, or there is none.

    None where distances of all these change by no more than those of markers on skin.
    """
    new, _, spread, _, _, segment = _groups(points, noise)
    inside = [
        float(spread[np.ix_(body, body)][np.triu_indices(len(body), 1)].max()) for body in bodies
    ]
    if inside and max(inside) <= _SOFTEST * segment:
        return None
    return sorted(new, key=lambda body: -len(body))


def _groups(
    points: Real, noise: Real
) -> tuple[list[list[int]], list[float], Real, Real, float, float]:
    """
    Markers (T, n, 3) that keep their distances, and by how much these change in each group.

    Also the spreads and medians (n, n) of all distances, how soft bodies are, and how large.
    """
    spread, usual = distance_spreads(points)
    segment = _SEGMENT * float(np.median(usual[usual > 0])) if usual.any() else 0.0
    nearest = spread.min(axis=1, initial=np.inf)
    nearest = nearest[np.isfinite(nearest)]
    soft = min(float(np.median(nearest)) if len(nearest) else 0.0, _SOFTEST / 2 * segment)
    bodies, heights = _clusters(spread, usual, noise, soft, segment)
    # As soft as the bodies are that are clear, others may be, too.
    clear = [height for body, height in zip(bodies, heights, strict=True) if len(body) > 2]
    if clear:
        soft = max(soft, float(np.median(clear)))
        bodies, heights = _clusters(spread, usual, noise, soft, segment)
    return bodies, heights, spread, usual, soft, segment


def _clusters(
    spread: Real, usual: Real, noise: Real, soft: float, segment: float
) -> tuple[list[list[int]], list[float]]:
    """
    Merge markers two by two, those with the least spread (n, n) first, as long as they are rigid.

    Two groups are one body where the largest spread between them is explained by the noise, or is
    not much more than within them or than `soft`. Returns groups of two or more, and their spreads.
    """
    count = len(spread)
    groups = [[k] for k in range(count)]
    height, between, width = np.zeros(count), spread.copy(), usual.copy()
    white = np.minimum(_RIGID * np.where(np.isfinite(noise), noise, 0.0), _NOISIEST * segment)
    while count > 1:
        one, other = np.unravel_index(between.argmin(), between.shape)
        merged = between[one, other]
        if not np.isfinite(merged):
            break
        loose = _LOOSE * min(width[one, other], segment)
        skin = _SOFTER * max(height[one], height[other], soft, loose)
        if merged > max(min(skin, _SOFTEST * segment), float(np.hypot(white[one], white[other]))):
            between[one, other] = between[other, one] = np.inf
            continue
        groups[one], groups[other] = groups[one] + groups[other], []
        height[one], white[one] = merged, max(white[one], white[other])
        for matrix in (between, width):
            matrix[one] = matrix[:, one] = np.maximum(matrix[one], matrix[other])
        between[one, one] = np.inf
        between[other] = between[:, other] = np.inf
    kept = [k for k, group in enumerate(groups) if len(group) > 1]
    return [sorted(groups[k]) for k in kept], [float(height[k]) for k in kept]


def _grow(
    body: list[int],
    spread: Real,
    limit: float,
    bodies: list[list[int]],
    solid: list[SolidPose | None],
) -> list[int]:
    """
    A body with markers over its joints, which keep their distances to all of its own.

    At most two of each other body, since three would make both one, and only of those that turn
    against it: of others nobody can tell.
    """
    grown = list(body)
    own = solid[bodies.index(body)]
    if own is None:
        return body
    for other, pose in zip(bodies, solid, strict=True):
        if pose is None or pose is own or _turn(own, pose) < _TURNED:
            continue
        worst = spread[np.ix_(other, body)].max(axis=1)
        near = [other[k] for k in np.argsort(worst, kind='stable')[:2] if worst[k] <= limit]
        grown += [k for k in near if k not in grown]
    return sorted(grown)


def _bridges(
    points: Real, bodies: list[list[int]], solid: list[SolidPose | None], apart: Real
) -> list[list[int]]:
    """
    Bodies whose markers are all over joints, as a thigh's at hip and knee.

    They join bodies that nothing else connects: two markers of one, on the axis about which it
    turns against the other, keep their distances (`apart` (n, n) up to 1) to one or two of that.
    """
    found: list[list[int]] = []
    while True:
        part = _parts(len(solid), space_joints(solid))
        best: tuple[float, list[int], SolidPose] | None = None
        for number, other in permutations(range(len(bodies)), 2):
            one, end = solid[number], solid[other]
            if part[number] == part[other] or one is None or end is None:
                continue
            for a, b in _on_axis(one, end):
                two = [bodies[number][a], bodies[number][b]]
                worst = apart[np.ix_(two, bodies[other])].max(axis=0)
                near = [bodies[other][k] for k in np.argsort(worst)[:2] if worst[k] <= 1]
                if not near or worst.min() > (1.0 if best is None else best[0]):
                    continue
                body = sorted({*two, *near})
                pose = fit_solid(points[:, body])
                joints = fit_space_joint(pose, one, (0, 1)), fit_space_joint(pose, end, (0, 1))
                if pose is not None and all(joints):
                    best = float(worst.min()), body, pose
        if best is None:
            return found
        found.append(best[1])
        solid = [*solid, best[2]]


def _on_axis(one: SolidPose, other: SolidPose) -> list[tuple[int, int]]:
    """Pairs of markers of `one` that are along the axis about which it turns against `other`."""
    turns = rotation_vectors(one.rotation.transpose(0, 2, 1) @ other.rotation)
    turns = turns[np.isfinite(turns[:, 0])]
    axis = np.linalg.eigh(np.cov(turns.T))[1][:, 2]
    pairs = combinations(range(len(one.shape)), 2)
    lines = {pair: one.shape[pair[0]] - one.shape[pair[1]] for pair in pairs}
    return [
        pair for pair, line in lines.items() if abs(line @ axis) > _ALONG * np.linalg.norm(line)
    ]


def space_joints(solid: list[SolidPose | None]) -> list[SpaceJoint]:
    """Joints of all pairs of bodies, as `tree_of` leaves them."""
    tried = [
        joint
        for one, other in combinations(range(len(solid)), 2)
        if (joint := fit_space_joint(solid[one], solid[other], (one, other))) is not None
    ]
    return tree_of(tried, len(solid))


AnyJoint = TypeVar('AnyJoint', SpaceJoint, Joint)


def tree_of(tried: list[AnyJoint], count: int) -> list[AnyJoint]:
    """
    Joints of `count` bodies, those that fit best first, as long as they close no loop.

    A joint that closes one must fit to within the residuals of the markers: two thighs on a pelvis
    that hardly turns seem to have one.
    """
    joints: list[AnyJoint] = []
    for joint in sorted(tried, key=lambda joint: joint.residual):
        part = _parts(count, joints)
        if part[joint.one] != part[joint.other] or joint.residual < _CLOSES * joint.expected:
            joints.append(joint)
    return joints


def _parts(count: int, joints: Sequence[SpaceJoint | Joint]) -> list[int]:
    """For each of `count` bodies a number, the same for those that joints connect."""
    part = list(range(count))
    for joint in joints:
        one, other = part[joint.one], part[joint.other]
        part = [one if k == other else k for k in part]
    return part


def _turn(one: SolidPose, other: SolidPose | None) -> float:
    """Rms turn of two bodies against each other, rad; infinite where one does not show its turn."""
    if other is None:
        return np.inf
    turns = rotation_vectors(one.rotation.transpose(0, 2, 1) @ other.rotation)
    seen = np.isfinite(turns[:, 0])
    return float(np.sqrt(np.mean(np.sum(turns[seen] ** 2, axis=1)))) if seen.any() else 0.0


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
    """The rotation (3, 3) nearest to the mean of rotations (F, 3, 3), NaN for none."""
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


def fit_space_joint(
    one: SolidPose | None, other: SolidPose | None, numbers: tuple[int, int]
) -> SpaceJoint | None:
    """
    The center that two bodies have in common, least squares (Ehrig et al. 2006), None without one.

    R₁ c₁ + t₁ = R₂ c₂ + t₂ in all frames. Of a hinge any point of the axis will do: the right
    singular vector of the smallest singular value is along it; the point taken is that nearest to
    the markers of both.
    """
    if one is None or other is None:
        return None
    both = np.isfinite(one.rotation[:, 0, 0]) & np.isfinite(other.rotation[:, 0, 0])
    if both.sum() < _FEWEST or _turn(one, other) < _TURNED:
        return None
    rows = np.concatenate((one.rotation[both], -other.rotation[both]), axis=2).reshape(-1, 6)
    right = (other.position - one.position)[both].reshape(-1)
    left, values, ways = np.linalg.svd(rows, full_matrices=False)
    relative = rotation_vectors(one.rotation[both].transpose(0, 2, 1) @ other.rotation[both])
    spread = np.linalg.eigvalsh(np.cov(relative.T))
    hinge = bool(spread[1] < _HINGE**2 * spread[2])
    kept = 5 if hinge else 6
    found = ways[:kept].T @ (left[:, :kept].T @ right / values[:kept])
    residual = float(np.sqrt(np.mean((rows @ found - right) ** 2)))
    on_one, on_other = found[:3], found[3:]
    axis = mean_rotation(other.rotation) @ ways[5, 3:] if hinge else None
    expected = float(np.hypot(_lever(one, on_one), _lever(other, on_other)))
    reach = float(np.linalg.norm(on_one)), float(np.linalg.norm(on_other))
    far = reach[0] > _FAR * one.size or reach[1] > _FAR * other.size
    if far or residual > max(_FITS * expected, GIVES * sum(reach)):
        return None
    if axis is not None:
        axis = axis / np.linalg.norm(axis)
    return SpaceJoint(*numbers, on_one, on_other, axis, residual, expected)


def _lever(pose: SolidPose, place: Real) -> float:
    """What the residuals of the markers of a body make of a place on it, per axis."""
    return pose.noise * float(
        np.sqrt(1 / len(pose.shape) + place @ place / max(float(np.sum(pose.shape**2)), 1e-30))
    )
