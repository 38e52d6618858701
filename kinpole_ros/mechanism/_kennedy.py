"""
Instant centers by Kennedy's theorem: which follow from the joints, in which order, and where.

The centers of three bodies lie on a line; two such lines meet in a center. Points and lines are
unit vectors of homogeneous coordinates, from the middle of the linkage and in units of its size. A
center at infinity is then a point like others, with w = 0. The line through two points and the
point on two lines are both the cross product, and its length tells how sharply they determine it.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import joint_extent, poses_of
from kinpole_ros.mechanism._joint_kinds import GROUND, Joint
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.planar._plane import Complex, Real

# Farther away than this, in sizes of the linkage, a center is at infinity but for rounding.
_INFINITY = 1e9
# Lines and points less distinct than this leave fewer than nine digits.
_SHARP = 1e-6
# Points nearer to each other than this, in sizes of the linkage, at all positions, are one.
_COINCIDENT = 1e-12
# Lines are tried at this many positions before the best ones are used at all of them.
_TRIAL_POSITIONS = 33

Pair = tuple[int, int]


class KennedyStep(NamedTuple):
    """
    How one center is found: that of the bodies `pair` (i, j), numbered from the ground, 0.

    By the `rule` 'joint' it is that of the joint number `by[0]`. By 'lines' it is on the two lines
    `by`, where k is the line through the centers ik and kj, and ~m the normal to the slot, or the
    strand of the belt, of the joint number m. By 'same' it coincides with the centers ik and kj,
    k = `by[0]`, which always coincide. By 'rates' Kennedy's theorem does not determine it, since
    `by` are all lines that it gives.
    """

    pair: Pair
    rule: str
    by: tuple[int, ...]


def bodies_of(mechanism: Mechanism) -> tuple[str, ...]:
    """All bodies in the order of their numbers, the ground first."""
    return (GROUND, *mechanism.bodies)


def number_of(bodies: Sequence[str], name: str) -> int:
    """The number of a body; raises LinkageError for a name that is none."""
    if name not in bodies:
        raise LinkageError(f'there is no body {name}: name one of {", ".join(bodies)}')
    return bodies.index(name)


def pairs_of(mechanism: Mechanism) -> tuple[Pair, ...]:
    """All pairs (i, j) of numbers of bodies, i < j."""
    return tuple(combinations(range(len(mechanism.bodies) + 1), 2))


def deduce(mechanism: Mechanism, values: Real) -> tuple[KennedyStep, ...]:
    """
    The chain of deduction that leads from the joints to all centers, in order.

    Primary centers come first; then again and again, of all centers on two known lines, the one
    that is determined best over the positions `values` (n, T); last those that only the rates give.
    """
    values = np.asarray(values, float)
    trial = np.unique(np.linspace(0, values.shape[1] - 1, _TRIAL_POSITIONS).astype(int))
    centers = _CenterMap(mechanism, values[:, trial])
    steps = []
    for m, joint in enumerate(centers.joints):
        pair = centers.pair_of(joint)
        if pair not in centers.centers and joint.center().kind not in ('', 'line'):
            steps.append(KennedyStep(pair, 'joint', (m,)))
            centers.add(steps[-1])
    remaining = [pair for pair in pairs_of(mechanism) if pair not in centers.centers]
    while remaining:
        # Rounded, so that of choices that are equal but for rounding the first is taken.
        choices = [(round(centers.sharpness(step), 9), step) for step in centers.steps(remaining)]
        best, step = max(choices, key=lambda choice: choice[0], default=(0.0, None))
        if step is None or best < _SHARP:
            break
        steps.append(step)
        centers.add(step)
        remaining.remove(step.pair)
    for pair in remaining:
        steps.append(KennedyStep(pair, 'rates', tuple(centers.lines(pair))))
    return tuple(steps)


def kennedy_centers(mechanism: Mechanism, steps: Sequence[KennedyStep], values: Real) -> Real:
    """
    Centers `places` (3, c, T), as in Centers, at the variables `values` (n, T), by `steps`.

    NaN where the steps leave them to the rates, and where two lines coincide (within 1e-6).
    """
    values = np.asarray(values, float)
    centers = _CenterMap(mechanism, values)
    for step in steps:
        if step.rule != 'rates':
            centers.add(step)
    missing = np.full((3, values.shape[1]), np.nan), np.zeros(values.shape[1])
    located = [centers.centers.get(pair, missing) for pair in pairs_of(mechanism)]
    points = [np.where(sharp > _SHARP, point, np.nan) for point, sharp in located]
    return outward(np.stack(points, axis=1), centers.middle, centers.size)


def explain(mechanism: Mechanism, steps: Sequence[KennedyStep]) -> list[str]:
    """
    The chain of deduction of instant centers in lines, as written by hand.

    Parameters
    ----------
    mechanism
        The linkage.
    steps
        The steps of its `Centers`.

    Returns
    -------
    list of str
        The first has the numbers of the bodies, from 1 for the ground; then 'I13: line I12-I23
        meets line I14-I34', and so on.

    """
    bodies, joints = bodies_of(mechanism), mechanism.assembly.joints

    def center(i: int, j: int) -> str:
        return center_name(len(bodies), *_ordered(i, j))

    def line(pair: Pair, code: int) -> str:
        if code < 0:
            return joints[~code].center().text
        return f'line {center(pair[0], code)}-{center(code, pair[1])}'

    lines = [', '.join(f'{k + 1} {name}' for k, name in enumerate(bodies))]
    for pair, rule, by in steps:
        if rule == 'joint':
            text = joints[by[0]].center().text
        elif rule == 'lines':
            text = ' meets '.join(line(pair, code) for code in by)
        elif rule == 'same':
            text = f'where {center(pair[0], by[0])} and {center(by[0], pair[1])} are one'
        else:
            lines_by = ' and '.join(line(pair, code) for code in by) or 'no line'
            text = f'from the rates: Kennedy has {"only " if by else ""}{lines_by} for it'
        lines.append(f'{center(*pair)}: {text}')
    return lines


def center_name(count: int, i: int, j: int) -> str:
    """The name of the center of bodies i and j of `count`: I13, from ten bodies on I1,3."""
    return f'I{i + 1}{"," if count > 9 else ""}{j + 1}'


class _CenterMap:
    """
    The centers deduced so far: `centers` maps a pair to its point (3, T) and its sharpness (T,).

    The sharpness is about the share of the digits that are left: that of the lines or points it is
    deduced from, times the length of the cross product.
    """

    def __init__(self, mechanism: Mechanism, values: Real) -> None:
        self._bodies = bodies_of(mechanism)
        self.joints = mechanism.assembly.joints
        poses = poses_of(mechanism.assembly, values)
        self.middle, self.size = joint_extent(mechanism.assembly, poses)
        self._contacts = [j.contact(poses[j.one], poses[j.other]) for j in self.joints]
        self.centers: dict[Pair, tuple[Real, Real]] = {}
        self._slots: dict[Pair, list[int]] = {}
        for m, joint in enumerate(self.joints):
            if joint.center().kind == 'line':
                self._slots.setdefault(self.pair_of(joint), []).append(m)

    def pair_of(self, joint: Joint) -> Pair:
        """The numbers of the bodies of a joint."""
        return _ordered(number_of(self._bodies, joint.one), number_of(self._bodies, joint.other))

    def add(self, step: KennedyStep) -> None:
        """Add the center that a step deduces."""
        self.centers[step.pair] = self._center(step)

    def sharpness(self, step: KennedyStep) -> float:
        """How well a step determines its center, at most positions."""
        return float(np.median(np.nan_to_num(self._center(step)[1])))

    def steps(self, remaining: Sequence[Pair]) -> Iterator[KennedyStep]:
        """All steps that are possible now for the remaining pairs."""
        for pair in remaining:
            lines = self.lines(pair)
            for k in lines:
                if k >= 0 and self._line(pair, k)[1].max() < _COINCIDENT:
                    yield KennedyStep(pair, 'same', (k,))
            for two in combinations(lines, 2):
                yield KennedyStep(pair, 'lines', two)

    def lines(self, pair: Pair) -> list[int]:
        """The known lines through a center, as in Step."""
        i, j = pair
        return [
            k
            for k in range(len(self._bodies))
            if k not in pair and _ordered(i, k) in self.centers and _ordered(k, j) in self.centers
        ] + [~m for m in self._slots.get(pair, [])]

    def _center(self, step: KennedyStep) -> tuple[Real, Real]:
        if step.rule == 'joint':
            m = step.by[0]
            is_far = self.joints[m].center().kind == 'infinity'
            point = self._normal(m) if is_far else self._contact(m)
            return point, np.ones(point.shape[1])
        if step.rule == 'same':
            return self.centers[_ordered(step.pair[0], step.by[0])]
        return cross(*(self._line(step.pair, code) for code in step.by))

    def _line(self, pair: Pair, code: int) -> tuple[Real, Real]:
        """A line (3, T), and how sharp it is (T,)."""
        if code >= 0:
            ends = (_ordered(pair[0], code), _ordered(code, pair[1]))
            return cross(*(self.centers[end] for end in ends))
        m, sharp = ~code, np.ones(len(self.middle))
        line, _ = cross((self._contact(m), sharp), (self._normal(m), sharp))
        return line, sharp

    def _contact(self, m: int) -> Real:
        """The pin, point of contact or center of curvature of a joint (3, T)."""
        (at, axis), center = self._contacts[m], self.joints[m].center()
        at = at + center.distance * center.turn * axis
        return _homogeneous((at - self.middle) / self.size, 1.0)

    def _normal(self, m: int) -> Real:
        """The point at infinity (3, T) at a right angle to a slot, or along a belt."""
        return _homogeneous(self.joints[m].center().turn * self._contacts[m][1], 0.0)


def _ordered(i: int, j: int) -> Pair:
    return (i, j) if i < j else (j, i)


def _homogeneous(point: Complex, w: float) -> Real:
    return unit(np.stack((point.real, point.imag, np.full(point.shape, w))))[0]


def cross(first: tuple[Real, Real], second: tuple[Real, Real]) -> tuple[Real, Real]:
    """The line through two points, or the point on two lines, and how sharp it is."""
    (a, b, c), (x, y, z) = first[0], second[0]
    # numpy's own cross product takes twice as long for few positions.
    vectors, length = unit(np.stack((b * z - c * y, c * x - a * z, a * y - b * x)))
    return vectors, length * np.minimum(first[1], second[1])


def unit(vectors: Real) -> tuple[Real, Real]:
    """Vectors (3, ...) divided by their lengths (...), and these; NaN for those of length 0."""
    length = np.sqrt((vectors**2).sum(axis=0))
    with np.errstate(invalid='ignore', divide='ignore'):
        return vectors / length, length


def outward(vectors: Real, middle: Complex, size: float) -> Real:
    """Centers (3, c, T) as in Centers, from homogeneous coordinates of the linkage's own."""
    x, y, w = vectors
    with np.errstate(invalid='ignore', divide='ignore'):
        is_far = np.hypot(x, y) > _INFINITY * np.abs(w)
        point = middle + size * (x + 1j * y) / w
        # A direction and its opposite are one: upward, and to the right if level.
        is_steep = np.abs(y) > np.abs(x) / _INFINITY
        scale = np.where(is_steep, np.sign(y), np.sign(x)) / np.hypot(x, y)
        finite = np.stack((point.real, point.imag, np.ones(x.shape)))
        infinite = np.stack((x * scale, np.where(is_steep, y * scale, 0.0), np.zeros(x.shape)))
        centers = np.where(is_far, infinite, finite)
    return np.where(np.isnan(vectors).any(axis=0), np.nan, centers)
