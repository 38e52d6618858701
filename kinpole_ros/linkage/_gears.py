"""
Radii of gears that add up to the length of the arm between their hubs.

The poses tell each of these lengths by itself, each with its noise. As joints of a mechanism they
leave no room for that: gears whose radii do not add up never mesh.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._unknowns import Solved
from kinpole_ros.mechanism import Equations, Part, part_sum
from kinpole_ros.planar._plane import Real

# Newton steps. A radius is off by a share of 1e-4, which squared twice is below rounding.
_STEPS = 3
_Point = tuple[str, tuple[Part, ...]]  # of a body


class _Arm(NamedTuple):
    """A body between the hubs of two gears: its points there, and the numbers of the radii."""

    center: tuple[Part, ...]
    hub: tuple[Part, ...]
    circle: int
    radius: int


def meshed(equations: Equations, solved: Solved) -> Solved:
    """
    Correct the dimensions of a solution such that all gears mesh, each by as little as its
    covariance allows; `equations` are those of its scene.
    """
    arms = list(_arms(equations))
    if not arms:
        return solved
    values, covariance = solved.values.copy(), solved.covariance
    own = [k for k, number in enumerate(solved.free) if number < len(values)]
    numbers = [solved.free[k] for k in own]
    for _ in range(_STEPS):
        lacking, by = _lacking(arms, values)
        slopes = np.zeros((len(arms), len(covariance)))
        slopes[:, own] = by[:, numbers]
        gain = covariance @ slopes.T @ np.linalg.pinv(slopes @ covariance @ slopes.T)
        values[numbers] -= (gain @ lacking)[own]
    left = np.eye(len(covariance)) - gain @ slopes
    return solved._replace(values=values, covariance=left @ covariance @ left.T)


def _arms(equations: Equations) -> Iterator[_Arm]:
    nodes = _nodes(equations)
    for joint in equations.joints:
        if joint.circle is None or joint.radius is None:
            continue
        # By body, what is at the center of the circle, and at the hub of the wheel.
        centers, hubs = (
            dict(next((node for node in nodes if point in node), {point}))
            for point in ((joint.one, joint.a), (joint.other, joint.b))
        )
        if both := sorted(centers.keys() & hubs.keys()):
            yield _Arm(centers[both[0]], hubs[both[0]], joint.circle, joint.radius)


def _nodes(equations: Equations) -> list[set[_Point]]:
    """The points of bodies that pins hold together."""
    nodes: list[set[_Point]] = []
    for joint in equations.joints:
        if joint.along is None and joint.radius is None:
            points: set[_Point] = {(joint.one, joint.a), (joint.other, joint.b)}
            for node in [node for node in nodes if node & points]:
                points |= node
                nodes.remove(node)
            nodes.append(points)
    return nodes


def _lacking(arms: Sequence[_Arm], values: Real) -> tuple[Real, Real]:
    """How much longer each arm is than its radii add up to, m, and that by the dimensions."""
    lacking, slopes = np.empty(len(arms)), np.empty((len(arms), len(values)))
    for row, arm in enumerate(arms):
        (a, by_a), (b, by_b) = part_sum(arm.center, values), part_sum(arm.hub, values)
        total = values[arm.circle] + values[arm.radius]
        lacking[row] = abs(b - a) - abs(total)
        slopes[row] = ((by_b - by_a) * np.conj(b - a)).real / abs(b - a)
        slopes[row, [arm.circle, arm.radius]] -= np.sign(total)
    return lacking, slopes
