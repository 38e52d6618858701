"""
Rigid bodies in space, before any plane is known.

Markers are grouped by the distances that stay constant (complete linkage).
"""

from collections.abc import Iterable, Sequence
from itertools import combinations, permutations
from typing import NamedTuple, TypeVar

import numpy as np

from kinpole_ros.linkage._columns import quantiles
from kinpole_ros.linkage._joints import Joint
from kinpole_ros.linkage._solid import (
    GROUND_NUMBER,
    SolidPose,
    SpaceJoint,
    fit_fixed_point,
    fit_solid,
    fit_space_joint,
    relative_turns,
    turn_between,
)
from kinpole_ros.planar._plane import Real

_FRAMES, _POSED = 1000, 400  # of distances and of poses: more would not tell more
_FEWEST = 30  # frames in which two markers or bodies must be seen together
_TAIL = 0.01  # share of the frames at either end of a range that may be of another marker
_TAIL_WIDTH = 4.6527  # that range of a normal distribution, in standard deviations
_RIGID = 2.5  # spread of a distance over its noise, up to which it is rigid
_SOFTER = 3.0  # times the spread of two groups up to which both together are one body
# Spread of a distance over the usual distance of two markers of one body: below the first all are
# rigid (a loose marker), beyond the second none is (skin over a joint).
_LOOSE, _SOFTEST = 0.002, 0.04
_NOISIEST = 0.1  # noise over that distance, by which nobody can tell
_OVER = 2.0  # times the softness of the bodies, for a marker over a joint
# The same over the distance itself, and times the largest of a body, for skin over a joint.
_STRAIN, _OVER_JOINT = 0.025, 1.3
# Usual distance of two markers of one body over that of any two, or of so many that are nearest
# where several people or machines are in view.
_SEGMENT, _NEAREST = 1 / 3, 48
# Rms turn of two bodies that have a marker in common, and of those that have a body between them.
_TURNED_OVER, _TURNED_BETWEEN = np.radians(10), np.radians(15)
_CLOSES = 1.5  # times the residuals of two bodies that a joint that closes a loop may leave over
_ALONG = np.cos(np.radians(25))  # of the axis of a hinge, for two markers on it


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
        place = {number: k for k, number in enumerate(kept)} | {GROUND_NUMBER: GROUND_NUMBER}
        joints = [
            joint._replace(one=place[joint.one], other=place[joint.other])
            for joint in self.joints
            if joint.one in place and joint.other in place
        ]
        bodies, solid = [self.bodies[k] for k in kept], [self.solid[k] for k in kept]
        return SpaceBodies(bodies, solid, joints, self.spread)


def _sampled(points: Real, frames: int) -> Real:
    """Some `frames` of `points` (T, ...), evenly spaced."""
    return points[:: max(1, len(points) // frames)]


def distance_spreads(points: Real) -> tuple[Real, Real]:
    """
    Spread and median (n, n) of the distances of all pairs of points (T, n, 3), NaN for none.

    The spread is a standard deviation by the range without its tails, infinite for pairs that are
    hardly ever seen together.
    """
    rows = np.ascontiguousarray(_sampled(points, _FRAMES).transpose(1, 0, 2))
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
    some = _sampled(points, _POSED)
    solid = [fit_solid(some[:, body]) for body in bodies]
    limit = _SOFTEST * segment
    limits = np.minimum(_STRAIN * usual, _OVER_JOINT * limit) + 1e-300
    grown = [
        _grow(body, spread, min(limit, max(height, _OVER * soft)), bodies, solid)
        for body, height in zip(bodies, heights, strict=True)
    ]
    solid = [fit_solid(some[:, body]) for body in grown]
    for k, pose in enumerate(solid):
        # A marker off a thin body may turn it about its length: then it is not of it.
        if pose is not None and pose.noise > limit:
            grown[k], solid[k] = bodies[k], fit_solid(some[:, bodies[k]])
    grown += _bridges(some, grown, solid, spread / limits)
    grown.sort(key=lambda body: -len(body))
    solid = [fit_solid(some[:, body]) for body in grown]
    joints = tree_of(_joints_of(solid, combinations(range(len(solid)), 2)), len(solid))
    fixed = [fit_fixed_point(pose, number) for number, pose in enumerate(solid)]
    joints += [joint for joint in fixed if joint is not None]
    return SpaceBodies(grown, solid, joints, spread)


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
    near = np.sort(np.where(usual > 0, usual, np.inf), axis=1)[:, :_NEAREST]
    near = near[np.isfinite(near)]
    segment = _SEGMENT * float(np.median(near)) if len(near) else 0.0
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
        if pose is None or pose is own or turn_between(own, pose) < _TURNED_OVER:
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
    tried = _joints_of(solid, combinations(range(len(solid)), 2))
    turned = [[turn_between(one, other) for other in solid] for one in solid]
    while True:
        part = _parts(len(solid), tree_of(tried, len(solid)))
        best: tuple[float, list[int], SolidPose] | None = None
        for number, other in permutations(range(len(bodies)), 2):
            one, end = solid[number], solid[other]
            if part[number] == part[other] or one is None or end is None:
                continue
            if turned[number][other] < _TURNED_BETWEEN:
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
        tried += _joints_of(solid, ((k, len(solid) - 1) for k in range(len(solid) - 1)))


def _on_axis(one: SolidPose, other: SolidPose) -> list[tuple[int, int]]:
    """Pairs of markers of `one` that are along the axis about which it turns against `other`."""
    turns = relative_turns(one, other)
    axis = np.linalg.eigh(np.cov(turns.T))[1][:, 2]
    pairs = combinations(range(len(one.shape)), 2)
    lines = {pair: one.shape[pair[0]] - one.shape[pair[1]] for pair in pairs}
    return [
        pair for pair, line in lines.items() if abs(line @ axis) > _ALONG * np.linalg.norm(line)
    ]


def _joints_of(solid: list[SolidPose | None], pairs: Iterable[tuple[int, int]]) -> list[SpaceJoint]:
    joints = (fit_space_joint(solid[one], solid[other], (one, other)) for one, other in pairs)
    return [joint for joint in joints if joint is not None]


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
