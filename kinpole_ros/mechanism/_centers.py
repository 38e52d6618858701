"""
Instant centers of all pairs of bodies: by Kennedy's theorem from the joints, else by the rates.

Points and lines are unit vectors of homogeneous coordinates, from a point in the midst of the
linkage and in units of its size. So a center at infinity is a point like others, with w = 0; the
line through two points and the point on two lines are both the cross product, and its length tells
how sharply they determine it.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import GROUND, Joint, Revolute, Rolling, Slot, Strut
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism, body_motion
from kinpole_ros.planar._plane import Complex, Real

# Farther off than so many sizes of the linkage, a center is at infinity but for rounding.
_INFINITY = 1e9
# Two bodies whose rates differ by this share of the largest one have equal motions.
_EQUAL_RATES = 1e-9
# Lines and points less distinct than this leave fewer than nine digits.
_SHARP = 1e-6
# Points nearer to each other than this, in sizes of the linkage, at all positions, are one.
_SAME = 1e-12
# Positions at which lines are tried, before the best ones are used at all.
_TRIED = 33

Pair = tuple[int, int]


class Step(NamedTuple):
    """
    How one center is found: that of the bodies `pair` (i, j), numbers from 0, the ground's.

    By `rule` 'joint' it is that of the joint number `by[0]`. By 'lines' it is on the two lines
    `by`, where k is the line through the centers ik and kj, and ~m the normal to the slot of the
    joint number m. By 'same' it is where the centers ik and kj are, k = `by[0]`, which are always
    one. By 'rates' Kennedy's theorem does not reach it, for all it has are the lines `by`.
    """

    pair: Pair
    rule: str
    by: tuple[int, ...]


class Centers(NamedTuple):
    """
    All n(n - 1)/2 instant centers of n bodies, the ground first, at T positions.

    `pairs` (c) are the bodies i < j of each; `places` (3, c, T) holds (x, y, 1) of a center at
    (x, y), m, in the ground frame, (cos, sin, 0) of one at infinity, NaN where there is none.
    `by_rates` (c, T) tells which are from the rates; `steps` (c) how the others were deduced.
    """

    bodies: tuple[str, ...]
    pairs: tuple[Pair, ...]
    places: Real
    by_rates: np.ndarray
    steps: tuple[Step, ...]

    @property
    def points(self) -> Complex:
        """Centers (c, T) as complex numbers, m; NaN where at infinity or none."""
        x, y, w = self.places
        return np.where(w == 1, x + 1j * y, complex(np.nan, np.nan))

    @property
    def directions(self) -> Real:
        """Directions (c, T) toward centers at infinity, rad, from 0 to π; NaN for all others."""
        x, y, w = self.places
        return np.where(w == 0, np.arctan2(y, x), np.nan)

    def row(self, one: str, other: str) -> int:
        """The row of the center of two bodies; raises LinkageError for what is not a pair."""
        numbers = sorted(_number(self.bodies, name) for name in (one, other))
        if numbers[0] == numbers[1]:
            raise LinkageError(f'{one} has no center with itself: name two bodies')
        return self.pairs.index((numbers[0], numbers[1]))


def instant_centers(mechanism: Mechanism, values: Real, rates: Real | None = None) -> Centers:
    """
    All instant centers at the variables `values` (n, T): Kennedy's, and what is left by the rates.

    `rates` (d) or (d, T) are those of the drivers, needed where there are several; Kennedy's
    centers do not depend on them, and hold also where the drivers do not determine the motion.
    Raises LinkageError where they are needed and not given.
    """
    steps = deduce(mechanism, values)
    places = kennedy_centers(mechanism, steps, values)
    missing = np.isnan(places[2])
    if missing.any():
        places = np.where(missing, centers_by_rates(mechanism, values, rates), places)
    return Centers(_names(mechanism), _pairs(mechanism), places, missing, steps)


def centers_by_rates(mechanism: Mechanism, values: Real, rates: Real | None = None) -> Real:
    """
    All instant centers, `places` (3, c, T) as in Centers, from the rates alone.

    With velocities c + iωP of the points P of each body, the center is at i (c_j - c_i) /
    (ω_j - ω_i), so where the rates are equal it is at infinity, at a right angle to the velocity.
    NaN where two bodies have equal motions, or the drivers do not determine the motion (a dead
    point). Arguments and errors as in `instant_centers`.
    """
    values = np.asarray(values, float)
    velocity, turning = mechanism.unit_rates(values)
    if rates is None:
        if len(velocity) != 1:
            raise LinkageError(
                f'centers depend on the rates of the {len(velocity)} drivers: give them'
            )
        rates = np.ones(1)
    weights = np.asarray(rates, float).reshape(len(velocity), 1, -1)
    middle, size = extent(mechanism, values)
    position, _ = _poses(mechanism, values)
    omega = np.concatenate((np.zeros((1, len(middle))), (weights * turning).sum(axis=0)))
    shift = (weights * velocity).sum(axis=0) - 1j * omega[1:] * (position[1:] - middle)
    shift = np.concatenate((np.zeros((1, len(middle)), complex), shift)) / size
    largest = np.sqrt(np.abs(shift) ** 2 + omega**2).max(axis=0)
    i, j = np.array(_pairs(mechanism)).reshape(-1, 2).T
    toward, w = 1j * (shift[j] - shift[i]), omega[j] - omega[i]
    vectors, length = _unit(np.stack((toward.real, toward.imag, w)))
    return _outward(np.where(length > _EQUAL_RATES * largest, vectors, np.nan), middle, size)


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
        pair = _ordered(*(_number(known.bodies, body) for body in (joint.one, joint.other)))
        if pair not in known.centers and not _is_line(joint) and not isinstance(joint, Strut):
            steps.append(Step(pair, 'joint', (m,)))
            known.add(steps[-1])
    left = [pair for pair in _pairs(mechanism) if pair not in known.centers]
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
    found = [known.centers.get(pair, nothing) for pair in _pairs(mechanism)]
    places = np.stack([np.where(sharp > _SHARP, place, np.nan) for place, sharp in found], axis=1)
    return _outward(places, known.middle, known.size)


def explain(mechanism: Mechanism, steps: Sequence[Step]) -> list[str]:
    """
    The chain of deduction in lines, as written by hand; the first tells the bodies' numbers.

    The ground is 1: 'I13: line I12-I23 meets line I14-I34'.
    """
    bodies, joints = _names(mechanism), mechanism.assembly.joints

    def center(i: int, j: int) -> str:
        return center_name(len(bodies), *_ordered(i, j))

    def line(pair: Pair, code: int) -> str:
        if code < 0:
            return f'the normal to slot {joints[~code].name} through its pin'
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
    """What the center of two of `count` bodies is called, i < j from 0: I13, from ten on I1,3."""
    return f'I{i + 1}{"," if count > 9 else ""}{j + 1}'


def extent(mechanism: Mechanism, values: Real) -> tuple[Complex, float]:
    """The middle (T,) of the joints, complex, m, at variables (n, T), and the linkage's size, m."""
    position, turn = _poses(mechanism, values)
    bodies = _names(mechanism)
    points = [
        position[k] + turn[k] * point
        for joint in mechanism.assembly.joints
        for k, point in (
            (_number(bodies, joint.one), joint.a),
            (_number(bodies, joint.other), joint.b),
        )
    ]
    places = np.stack(points) if points else position
    middle = places.mean(axis=0)
    size = float(np.abs(places - middle).max(initial=0.0))
    wheels = [joint.radius for joint in mechanism.assembly.joints if isinstance(joint, Rolling)]
    return middle, max(size, *wheels, 0.0) or 1.0


class _Known:
    """
    Centers found so far: `centers` maps a pair to its place (3, T), and how sharp it is (T,).

    The sharpness is about the share of the digits left: those of what it is found from, times the
    length of the cross product.
    """

    def __init__(self, mechanism: Mechanism, values: Real) -> None:
        self.bodies = _names(mechanism)
        self.joints = mechanism.assembly.joints
        self.middle, self.size = extent(mechanism, values)
        position, self.turn = _poses(mechanism, values)
        self.position = (position - self.middle) / self.size
        self.centers: dict[Pair, tuple[Real, Real]] = {}
        self.slots: dict[Pair, list[int]] = {}
        for m, joint in enumerate(self.joints):
            if _is_line(joint):
                pair = _ordered(*(_number(self.bodies, name) for name in (joint.one, joint.other)))
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
            if k not in pair and _ordered(i, k) in self.centers and _ordered(k, j) in self.centers
        ] + [~m for m in self.slots.get(pair, [])]

    def _center(self, step: Step) -> tuple[Real, Real]:
        if step.rule == 'joint':
            place = self._joint(self.joints[step.by[0]])
            return place, np.ones(place.shape[1])
        if step.rule == 'same':
            return self.centers[_ordered(step.pair[0], step.by[0])]
        return _cross(*(self._line(step.pair, code) for code in step.by))

    def _line(self, pair: Pair, code: int) -> tuple[Real, Real]:
        """A line (3, T), and how sharp it is (T,)."""
        if code >= 0:
            ends = (_ordered(pair[0], code), _ordered(code, pair[1]))
            return _cross(*(self.centers[end] for end in ends))
        joint = self.joints[~code]
        pin = _homogeneous(self._point(joint.other, joint.b), 1.0)
        line, _ = _cross((pin, np.ones(1)), (self._normal(joint), np.ones(1)))
        return line, np.ones(line.shape[1])

    def _joint(self, joint: Joint) -> Real:
        """The center (3, T) of the two bodies that a joint determines."""
        if isinstance(joint, Slot):
            return self._normal(joint)
        if not isinstance(joint, Rolling):
            return _homogeneous(self._point(joint.one, joint.a), 1.0)
        hub = self._point(joint.other, joint.b)
        if joint.circle:
            middle = self._point(joint.one, joint.a)
            share = joint.circle / (joint.circle + joint.radius)
            return _homogeneous(middle + share * (hub - middle), 1.0)
        up = 1j * np.exp(1j * joint.along) * self.turn[_number(self.bodies, joint.one)]
        return _homogeneous(hub - joint.radius / self.size * up, 1.0)

    def _normal(self, joint: Joint) -> Real:
        """The point at infinity (3, T) at a right angle to a slot."""
        assert isinstance(joint, Slot)
        along = np.exp(1j * joint.along) * self.turn[_number(self.bodies, joint.one)]
        return _homogeneous(1j * along, 0.0)

    def _point(self, body: str, place: complex) -> Complex:
        k = _number(self.bodies, body)
        return self.position[k] + self.turn[k] * place / self.size


def _poses(mechanism: Mechanism, values: Real) -> tuple[Complex, Complex]:
    """Origins (n, T), complex, m, and turns e^{iθ} (n, T) of all bodies, the ground first."""
    values = np.asarray(values, float)
    position, angle = body_motion(mechanism.assembly, values[None])
    still = np.zeros((1, values.shape[1]))
    return (
        np.concatenate((still + 0j, position[0])),
        np.exp(1j * np.concatenate((still, angle[0]))),
    )


def _names(mechanism: Mechanism) -> tuple[str, ...]:
    return (GROUND, *mechanism.bodies)


def _number(bodies: Sequence[str], name: str) -> int:
    if name not in bodies:
        raise LinkageError(f'there is no body {name}: name one of {", ".join(bodies)}')
    return bodies.index(name)


def _pairs(mechanism: Mechanism) -> tuple[Pair, ...]:
    return tuple(combinations(range(len(mechanism.bodies) + 1), 2))


def _ordered(i: int, j: int) -> Pair:
    return (i, j) if i < j else (j, i)


def _is_line(joint: Joint) -> bool:
    """Whether all that a joint tells of its bodies' center is a line: a pin in a slot."""
    return isinstance(joint, Slot) and joint.turned is None


def _homogeneous(place: Complex, w: float) -> Real:
    return _unit(np.stack((place.real, place.imag, np.full(place.shape, w))))[0]


def _cross(one: tuple[Real, Real], other: tuple[Real, Real]) -> tuple[Real, Real]:
    """The line through two points, or the point on two lines, and how sharp it is."""
    vectors, length = _unit(np.cross(one[0], other[0], axis=0))
    return vectors, length * np.minimum(one[1], other[1])


def _unit(vectors: Real) -> tuple[Real, Real]:
    """Vectors (3, ...) of length 1, and the lengths (...) they had; NaN for those of length 0."""
    length = np.sqrt((vectors**2).sum(axis=0))
    with np.errstate(invalid='ignore', divide='ignore'):
        return vectors / length, length


def _outward(vectors: Real, middle: Complex, size: float) -> Real:
    """Centers (3, c, T) as in Centers, from homogeneous coordinates of the linkage's own."""
    x, y, w = vectors
    with np.errstate(invalid='ignore', divide='ignore'):
        far = np.hypot(x, y) > _INFINITY * np.abs(w)
        place = middle + size * (x + 1j * y) / w
        # A direction and its opposite are one: upward, and to the right if level.
        way = np.where(np.abs(y) > np.abs(x) / _INFINITY, np.sign(y), np.sign(x)) / np.hypot(x, y)
        near = np.stack((place.real, place.imag, np.ones(x.shape)))
        level = np.where(np.abs(y) > np.abs(x) / _INFINITY, y * way, 0.0)
        found = np.where(far, np.stack((x * way, level, np.zeros(x.shape))), near)
    return np.where(np.isnan(vectors).any(axis=0), np.nan, found)
