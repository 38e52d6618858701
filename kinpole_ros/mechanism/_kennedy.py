"""
Instant centers by Kennedy's theorem: which follow from the joints, in which order, and where.

The centers of three bodies lie on a line; two such lines meet in a center.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import Belt, Joint, Revolute, Rolling, Slot, Strut, strand
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._places import (
    Pair,
    bodies_of,
    cross,
    extent,
    homogeneous,
    number_of,
    ordered,
    outward,
    pairs_of,
    poses_of,
)
from kinpole_ros.planar._plane import Complex, Real

# Lines and points less distinct than this leave fewer than nine digits.
_SHARP = 1e-6
# Points nearer to each other than this, in sizes of the linkage, at all positions, are one.
_SAME = 1e-12
# Positions at which lines are tried, before the best ones are used at all.
_TRIED = 33


class Step(NamedTuple):
    """
    How one center is found: that of the bodies `pair` (i, j), numbers from 0, the ground's.

    By `rule` 'joint' it is that of the joint number `by[0]`. By 'lines' it is on the two lines
    `by`, where k is the line through the centers ik and kj, and ~m the normal to the slot, or the
    strand of the belt, of the joint number m. By 'same' it is where the centers ik and kj are,
    k = `by[0]`, which are always one. By 'rates' Kennedy's theorem does not reach
    it, for all it has are the lines `by`.
    """

    pair: Pair
    rule: str
    by: tuple[int, ...]


def deduce(mechanism: Mechanism, values: Real) -> tuple[Step, ...]:
    """
    The chain of deduction that leads from the joints to all centers, in order.

    Primary centers first; then again and again, of all centers on two known lines, the one that is
    determined best over the positions `values` (n, T); last those that only the rates tell.
    """
    values = np.asarray(values, float)
    count = values.shape[1]
    known = _Known(mechanism, values[:, np.unique(np.linspace(0, count - 1, _TRIED).astype(int))])
    steps = []
    for m, joint in enumerate(known.joints):
        pair = ordered(*(number_of(known.bodies, body) for body in (joint.one, joint.other)))
        if pair not in known.centers and not _is_line(joint) and not isinstance(joint, Strut):
            steps.append(Step(pair, 'joint', (m,)))
            known.add(steps[-1])
    left = [pair for pair in pairs_of(mechanism) if pair not in known.centers]
    while left:
        # Rounded: of choices that are as good but for rounding the first is taken.
        found = [(round(known.sharpness(step), 9), step) for step in known.steps(left)]
        best, step = max(found, key=lambda choice: choice[0], default=(0.0, None))
        if step is None or best < _SHARP:
            break
        steps.append(step)
        known.add(step)
        left.remove(step.pair)
    for pair in left:
        steps.append(Step(pair, 'rates', tuple(known.lines(pair))))
    return tuple(steps)


def kennedy_centers(mechanism: Mechanism, steps: Sequence[Step], values: Real) -> Real:
    """
    Centers `places` (3, c, T), as in Centers, at the variables `values` (n, T), by `steps`.

    NaN where they leave it to the rates, and where two lines coincide (within 1e-6).
    """
    values = np.asarray(values, float)
    known = _Known(mechanism, values)
    for step in steps:
        if step.rule != 'rates':
            known.add(step)
    nothing = np.full((3, values.shape[1]), np.nan), np.zeros(values.shape[1])
    found = [known.centers.get(pair, nothing) for pair in pairs_of(mechanism)]
    places = np.stack([np.where(sharp > _SHARP, place, np.nan) for place, sharp in found], axis=1)
    return outward(places, known.middle, known.size)


def explain(mechanism: Mechanism, steps: Sequence[Step]) -> list[str]:
    """
    The chain of deduction of instant centers in lines, as written by hand.

    Parameters
    ----------
    mechanism
        The linkage.
    steps
        Those of its `Centers`.

    Returns
    -------
    list of str
        The first tells the bodies' numbers, the ground being 1; then 'I13: line I12-I23 meets line
        I14-I34', and so on.

    """
    bodies, joints = bodies_of(mechanism), mechanism.assembly.joints

    def center(i: int, j: int) -> str:
        return center_name(len(bodies), *ordered(i, j))

    def line(pair: Pair, code: int) -> str:
        if code < 0:
            joint = joints[~code]
            if isinstance(joint, Belt):
                return f'the strand of {joint.name}'
            return f'the normal to slot {joint.name} through its pin'
        return f'line {center(pair[0], code)}-{center(code, pair[1])}'

    lines = [', '.join(f'{k + 1} {name}' for k, name in enumerate(bodies))]
    for pair, rule, by in steps:
        if rule == 'joint':
            joint = joints[by[0]]
            text = {
                Revolute: f'pin {joint.name}',
                Slot: f'at infinity, normal to slide {joint.name}',
                Rolling: f'point of contact of {joint.name}',
            }[type(joint)]
        elif rule == 'lines':
            text = ' meets '.join(line(pair, code) for code in by)
        elif rule == 'same':
            text = f'where {center(pair[0], by[0])} and {center(by[0], pair[1])} are one'
        else:
            has = ' and '.join(line(pair, code) for code in by) or 'no line'
            text = f'from the rates: Kennedy has {"only " if by else ""}{has} for it'
        lines.append(f'{center(*pair)}: {text}')
    return lines


def center_name(count: int, i: int, j: int) -> str:
    """
    What the center of two bodies is called: I13, from ten bodies on I1,3.

    Parameters
    ----------
    count
        How many bodies there are.
    i, j
        Their numbers from 0, i < j.

    Returns
    -------
    str
        With numbers from 1.

    """
    return f'I{i + 1}{"," if count > 9 else ""}{j + 1}'


class _Known:
    """
    Centers found so far: `centers` maps a pair to its place (3, T), and how sharp it is (T,).

    The sharpness is about the share of the digits left: those of what it is found from, times the
    length of the cross product.
    """

    def __init__(self, mechanism: Mechanism, values: Real) -> None:
        self.bodies = bodies_of(mechanism)
        self.joints = mechanism.assembly.joints
        self.middle, self.size = extent(mechanism, values)
        position, self.turn = poses_of(mechanism, values)
        self.position = (position - self.middle) / self.size
        self.centers: dict[Pair, tuple[Real, Real]] = {}
        self.slots: dict[Pair, list[int]] = {}
        for m, joint in enumerate(self.joints):
            if _is_line(joint):
                pair = ordered(*(number_of(self.bodies, name) for name in (joint.one, joint.other)))
                self.slots.setdefault(pair, []).append(m)

    def add(self, step: Step) -> None:
        """Find the center that the step tells."""
        self.centers[step.pair] = self._center(step)

    def sharpness(self, step: Step) -> float:
        """How well a step determines its center, at most positions."""
        return float(np.median(np.nan_to_num(self._center(step)[1])))

    def steps(self, left: Sequence[Pair]) -> Iterator[Step]:
        """All that can be deduced now of the pairs that are left."""
        for pair in left:
            lines = self.lines(pair)
            for k in lines:
                if k >= 0 and self._line(pair, k)[1].max() < _SAME:
                    yield Step(pair, 'same', (k,))
            for two in combinations(lines, 2):
                yield Step(pair, 'lines', two)

    def lines(self, pair: Pair) -> list[int]:
        """The lines known of a center, as in Step."""
        i, j = pair
        return [
            k
            for k in range(len(self.bodies))
            if k not in pair and ordered(i, k) in self.centers and ordered(k, j) in self.centers
        ] + [~m for m in self.slots.get(pair, [])]

    def _center(self, step: Step) -> tuple[Real, Real]:
        if step.rule == 'joint':
            place = self._joint(self.joints[step.by[0]])
            return place, np.ones(place.shape[1])
        if step.rule == 'same':
            return self.centers[ordered(step.pair[0], step.by[0])]
        return cross(*(self._line(step.pair, code) for code in step.by))

    def _line(self, pair: Pair, code: int) -> tuple[Real, Real]:
        """A line (3, T), and how sharp it is (T,)."""
        if code >= 0:
            ends = (ordered(pair[0], code), ordered(code, pair[1]))
            return cross(*(self.centers[end] for end in ends))
        joint = self.joints[~code]
        on, far = self._point(joint.other, joint.b), self._normal(joint)
        if isinstance(joint, Belt):
            on = on + 1j * joint.radii[1] / self.size * (far[0] + 1j * far[1])
        line, _ = cross((homogeneous(on, 1.0), np.ones(1)), (far, np.ones(1)))
        return line, np.ones(line.shape[1])

    def _joint(self, joint: Joint) -> Real:
        """The center (3, T) of the two bodies that a joint determines."""
        if isinstance(joint, Slot):
            return self._normal(joint)
        if not isinstance(joint, Rolling):
            return homogeneous(self._point(joint.one, joint.a), 1.0)
        hub = self._point(joint.other, joint.b)
        if joint.circle:
            middle = self._point(joint.one, joint.a)
            share = joint.circle / (joint.circle + joint.radius)
            return homogeneous(middle + share * (hub - middle), 1.0)
        up = 1j * np.exp(1j * joint.along) * self.turn[number_of(self.bodies, joint.one)]
        return homogeneous(hub - joint.radius / self.size * up, 1.0)

    def _normal(self, joint: Joint) -> Real:
        """The point at infinity (3, T) at a right angle to a slot, or along a belt."""
        if isinstance(joint, Belt):
            hubs = self._point(joint.other, joint.b) - self._point(joint.one, joint.a)
            return homogeneous(strand(joint, self.size * hubs)[1], 0.0)
        assert isinstance(joint, Slot)
        along = np.exp(1j * joint.along) * self.turn[number_of(self.bodies, joint.one)]
        return homogeneous(1j * along, 0.0)

    def _point(self, body: str, place: complex) -> Complex:
        k = number_of(self.bodies, body)
        return self.position[k] + self.turn[k] * place / self.size


def _is_line(joint: Joint) -> bool:
    """Whether all that a joint tells of its bodies' center is a line: a pin in a slot, a belt."""
    return isinstance(joint, Belt) or (isinstance(joint, Slot) and joint.turned is None)
