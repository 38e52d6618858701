"""
Rigid bodies of markers in space, before any plane is known, and the joints between them.

Markers are grouped by the distances that stay constant (complete linkage). On skin no distance
does, so the limit is set by how soft the bodies are that are clear.
"""

from collections.abc import Iterable, Sequence
from itertools import combinations, permutations
from typing import NamedTuple, TypeVar

import numpy as np

from kinpole_ros.linkage._body_poses import GROUND_NUMBER
from kinpole_ros.linkage._found_joints import FoundJoint
from kinpole_ros.linkage._rigid import RIGID_RATIO, complete_linkage, distance_spreads, sampled
from kinpole_ros.linkage._solid import (
    SolidPose,
    SpaceJoint,
    fit_fixed_point,
    fit_solid,
    fit_space_joint,
    relative_turns,
    turn_between,
)
from kinpole_ros.planar._plane import Complex, Real

# Frames in which distances are measured, and in which poses are fitted; more change nothing.
DISTANCE_FRAMES, _POSE_FRAMES = 1000, 400
# Two groups are one body if distances between them vary by up to this many times those within.
_SOFTER = 3.0
# The segment, the usual distance of two markers of one body, is this share of the median distance
# of a marker to its nearest ones. Farther ones may be of other people or machines.
_SEGMENT, _NEAREST = 1 / 3, 48
# Shares of the segment by which a distance varies: below the first it is rigid (a loose marker),
# beyond the second it is not (skin over a joint). Noise counts up to the third.
_LOOSE, _SOFTEST, _MAX_NOISE = 0.002, 0.04, 0.1
# A marker over a joint is on both bodies up to this many times their softness.
_JOINT_SOFTNESS = 2.0
# Distances within a bridge vary by up to this share of themselves, and this many times _SOFTEST.
_STRAIN, _BRIDGE_RATIO = 0.025, 1.3
# Least rms turn of two bodies that share a marker, and of two that a bridge connects.
_SHARING_TURN, _BRIDGE_TURN = np.radians(10), np.radians(15)
# Residual of a joint that closes a loop, over the residuals of its bodies.
_MAX_LOOP_RESIDUAL = 1.5
# Two markers are on an axis if the cosine of their line to it is above this.
_MIN_AXIS_COSINE = np.cos(np.radians(25))


class SpaceBodies(NamedTuple):
    """
    Rigid bodies in space: columns of their markers, largest first, a marker over a joint in two.

    `solid` are their poses in sampled frames, None for markers on one line. `joints` are between
    bodies by number. `deviation` (n, n) is the standard deviation of the distances of all markers.
    """

    bodies: list[list[int]]
    solid: list[SolidPose | None]
    joints: list[SpaceJoint]
    deviation: Real

    def subset(self, numbers: list[int]) -> 'SpaceBodies':
        """The bodies of these numbers, in this order, with the joints between them."""
        new = {number: k for k, number in enumerate(numbers)} | {GROUND_NUMBER: GROUND_NUMBER}
        joints = [
            joint._replace(one=new[joint.one], other=new[joint.other])
            for joint in self.joints
            if joint.one in new and joint.other in new
        ]
        bodies, solid = [self.bodies[k] for k in numbers], [self.solid[k] for k in numbers]
        return SpaceBodies(bodies, solid, joints, self.deviation)


class _Clusters(NamedTuple):
    """
    Markers that keep their distances, and the largest deviation of a distance in each group.

    `deviation` and `median` (n, n) are those of all distances, `softness` the usual deviation
    within a body, `segment` the usual distance.
    """

    groups: list[list[int]]
    heights: list[float]
    deviation: Real
    median: Real
    softness: float
    segment: float


def find_bodies(points: Real, noise: Real) -> SpaceBodies:
    """
    Find the rigid bodies of markers (T, n, 3), NaN for none, and their joints.

    `noise` (n,) is that of the markers per axis.
    """
    clusters = _cluster(points, noise)
    bodies, deviation = clusters.groups, clusters.deviation
    frames = sampled(points, _POSE_FRAMES)
    solid = [fit_solid(frames[:, body]) for body in bodies]
    limit = _SOFTEST * clusters.segment
    softest = [max(height, _JOINT_SOFTNESS * clusters.softness) for height in clusters.heights]
    grown = [
        _with_joint_markers(k, bodies, solid, deviation, min(limit, soft))
        for k, soft in enumerate(softest)
    ]
    solid = [fit_solid(frames[:, body]) for body in grown]
    for k, pose in enumerate(solid):
        # A marker that is off a thin body may turn it about its length. Then it is not of it.
        if pose is not None and pose.noise > limit:
            grown[k], solid[k] = bodies[k], fit_solid(frames[:, bodies[k]])
    limits = np.minimum(_STRAIN * clusters.median, _BRIDGE_RATIO * limit) + 1e-300
    grown += _bridges(frames, grown, solid, deviation / limits)
    grown.sort(key=lambda body: -len(body))
    solid = [fit_solid(frames[:, body]) for body in grown]
    joints = open_chains(_joints_of(solid, combinations(range(len(solid)), 2)), len(solid))
    fixed = [fit_fixed_point(pose, number) for number, pose in enumerate(solid)]
    joints += [joint for joint in fixed if joint is not None]
    return SpaceBodies(grown, solid, joints, deviation)


def soft_bodies(tracks: Complex, noise: Real, bodies: list[list[int]]) -> list[list[int]] | None:
    """
    Group tracks (T, n) of a plane as soft bodies, if `bodies` are not rigid or there are none.

    None where the distances within all bodies vary by no more than those of markers on skin.
    """
    clusters = _cluster(tracks, noise)
    inside = [
        float(clusters.deviation[np.ix_(body, body)][np.triu_indices(len(body), 1)].max())
        for body in bodies
    ]
    if inside and max(inside) <= _SOFTEST * clusters.segment:
        return None
    return sorted(clusters.groups, key=lambda body: -len(body))


def _cluster(points: np.ndarray, noise: Real) -> _Clusters:
    """Cluster markers, (T, n, 3) or (T, n) complex, by the deviations of their distances."""
    deviation, median = distance_spreads(points, DISTANCE_FRAMES)
    near = np.sort(np.where(median > 0, median, np.inf), axis=1)[:, :_NEAREST]
    near = near[np.isfinite(near)]
    segment = _SEGMENT * float(np.median(near)) if len(near) else 0.0
    steadiest = deviation.min(axis=1, initial=np.inf)
    steadiest = steadiest[np.isfinite(steadiest)]
    softness = float(np.median(steadiest)) if len(steadiest) else 0.0
    softness = min(softness, _SOFTEST / 2 * segment)
    groups, heights = _groups(deviation, median, noise, softness, segment)
    # Other bodies may be as soft as those that are clear.
    clear = [height for body, height in zip(groups, heights, strict=True) if len(body) > 2]
    if clear:
        softness = max(softness, float(np.median(clear)))
        groups, heights = _groups(deviation, median, noise, softness, segment)
    return _Clusters(groups, heights, deviation, median, softness, segment)


def _groups(
    deviation: Real, median: Real, noise: Real, softness: float, segment: float
) -> tuple[list[list[int]], list[float]]:
    """
    Groups of two markers or more, and the largest deviation within each.

    Two groups are one body where the largest deviation between them is explained by the noise, or
    is not much more than within them or than the softness.
    """
    groups = [[k] for k in range(len(deviation))]
    height, width = np.zeros(len(deviation)), median.copy()
    white = RIGID_RATIO * np.where(np.isfinite(noise), noise, 0.0)
    white = np.minimum(white, _MAX_NOISE * segment)

    def may_merge(i: int, j: int, largest: float) -> bool:
        loose = _LOOSE * min(width[i, j], segment)
        skin = _SOFTER * max(height[i], height[j], softness, loose)
        return largest <= max(min(skin, _SOFTEST * segment), float(np.hypot(white[i], white[j])))

    for i, j, largest in complete_linkage(deviation, may_merge):
        groups[i], groups[j] = groups[i] + groups[j], []
        height[i], white[i] = largest, max(white[i], white[j])
        width[i] = width[:, i] = np.maximum(width[i], width[j])
    numbers = [k for k, members in enumerate(groups) if len(members) > 1]
    return [sorted(groups[k]) for k in numbers], [float(height[k]) for k in numbers]


def _with_joint_markers(
    number: int,
    bodies: list[list[int]],
    solid: list[SolidPose | None],
    deviation: Real,
    limit: float,
) -> list[int]:
    """
    Markers of a body with those over its joints, which keep their distances to all of its own.

    These are at most two of each other body, since three would make both one, and only of bodies
    that turn against it: of others the distances say nothing.
    """
    own, pose = bodies[number], solid[number]
    if pose is None:
        return own
    grown = list(own)
    for body, partner in zip(bodies, solid, strict=True):
        if partner is None or partner is pose or turn_between(pose, partner) < _SHARING_TURN:
            continue
        worst = deviation[np.ix_(body, own)].max(axis=1)
        near = [body[k] for k in np.argsort(worst, kind='stable')[:2] if worst[k] <= limit]
        grown += [k for k in near if k not in grown]
    return sorted(grown)


def _bridges(
    points: Real, bodies: list[list[int]], solid: list[SolidPose | None], strain: Real
) -> list[list[int]]:
    """
    Bodies whose markers are all over joints, as a thigh's at hip and knee.

    They connect bodies that no joint connects: two markers of one, on the axis about which it turns
    against the other, keep their distances (`strain` (n, n) up to 1) to one or two of the other.
    """
    bridges: list[list[int]] = []
    joints = _joints_of(solid, combinations(range(len(solid)), 2))
    turned = [[turn_between(a, b) for b in solid] for a in solid]
    while True:
        chain = _chain_numbers(len(solid), open_chains(joints, len(solid)))
        best: tuple[float, list[int], SolidPose] | None = None
        for i, j in permutations(range(len(bodies)), 2):
            first, second = solid[i], solid[j]
            if chain[i] == chain[j] or first is None or second is None:
                continue
            if turned[i][j] < _BRIDGE_TURN:
                continue
            for a, b in _on_axis(first, second):
                hinge = [bodies[i][a], bodies[i][b]]
                worst = strain[np.ix_(hinge, bodies[j])].max(axis=0)
                near = [bodies[j][k] for k in np.argsort(worst)[:2] if worst[k] <= 1]
                if not near or worst.min() > (1.0 if best is None else best[0]):
                    continue
                body = sorted({*hinge, *near})
                pose = fit_solid(points[:, body])
                ends = fit_space_joint(pose, first, (0, 1)), fit_space_joint(pose, second, (0, 1))
                if pose is not None and all(ends):
                    best = float(worst.min()), body, pose
        if best is None:
            return bridges
        bridges.append(best[1])
        solid = [*solid, best[2]]
        joints += _joints_of(solid, ((k, len(solid) - 1) for k in range(len(solid) - 1)))


def _on_axis(first: SolidPose, second: SolidPose) -> list[tuple[int, int]]:
    """Pairs of markers of `first` that are along the axis about which it turns against `second`."""
    axis = np.linalg.eigh(np.cov(relative_turns(first, second).T))[1][:, 2]
    pairs = combinations(range(len(first.shape)), 2)
    lines = {pair: first.shape[pair[0]] - first.shape[pair[1]] for pair in pairs}
    return [
        pair
        for pair, line in lines.items()
        if abs(line @ axis) > _MIN_AXIS_COSINE * np.linalg.norm(line)
    ]


def _joints_of(solid: list[SolidPose | None], pairs: Iterable[tuple[int, int]]) -> list[SpaceJoint]:
    joints = (fit_space_joint(solid[i], solid[j], (i, j)) for i, j in pairs)
    return [joint for joint in joints if joint is not None]


AnyJoint = TypeVar('AnyJoint', SpaceJoint, FoundJoint)


def open_chains(candidates: list[AnyJoint], count: int) -> list[AnyJoint]:
    """
    Joints of `count` bodies, those that fit best first, as long as they close no loop.

    A joint that closes a loop must fit to within the residuals of the markers: two thighs on a
    pelvis that hardly turns seem to have one.
    """
    joints: list[AnyJoint] = []
    for joint in sorted(candidates, key=lambda joint: joint.residual):
        chain = _chain_numbers(count, joints)
        closes_loop = chain[joint.one] == chain[joint.other]
        if not closes_loop or joint.residual < _MAX_LOOP_RESIDUAL * joint.expected:
            joints.append(joint)
    return joints


def _chain_numbers(count: int, joints: Sequence[SpaceJoint | FoundJoint]) -> list[int]:
    """A number for each of `count` bodies, the same for bodies that joints connect."""
    chain = list(range(count))
    for joint in joints:
        first, second = chain[joint.one], chain[joint.other]
        chain = [first if k == second else k for k in chain]
    return chain
