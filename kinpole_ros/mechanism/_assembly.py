"""
Bodies and joints as vector loops: what hangs on what, and which chains have to close.

From the ground on, each body is reached through one joint, which gives its place as a sum of terms
r e^{iθ}; every joint beyond that closes a loop.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._laws import Function, Law
from kinpole_ros.mechanism._loops import LinkageError, Loops
from kinpole_ros.planar._plane import Complex, Real

GROUND = 'ground'


class Revolute(NamedTuple):
    """A pin through the point `a` of the body `one` and the point `b` of `other` (complex, m)."""

    name: str
    one: str
    a: complex
    other: str
    b: complex


class Slot(NamedTuple):
    """
    The point `b` of `other` slides on a line of `one`, through `a` in the direction `along` (rad).

    With `turned` (rad) it is a prismatic joint: the angle of `other` is that of `one` plus so much.
    The slide, from `a` on, is a variable of the joint's name.
    """

    name: str
    one: str
    a: complex
    along: float
    other: str
    b: complex
    turned: float | None = None


class Rolling(NamedTuple):
    """
    A wheel, the body `other` with its hub at `b` and `radius` (m), rolls on `one` without slip.

    On a line through `a` in the direction `along`, lying to its left; or on a circle of radius
    `circle` about `a`, outside of it, or inside if `circle` is negative. The variable of the
    joint's name is the slide of the hub along the line, or the direction from the point of contact
    to the hub (outside, that of the hub from `a`, inside its opposite); with all angles zero it is
    `start`. With a `pressure` angle (rad) teeth bear it: they push each other apart with the
    tangent of it times what they transmit, and other joints hold the hub at its distance.
    """

    name: str
    one: str
    a: complex
    other: str
    b: complex
    radius: float
    along: float = 0.0
    circle: float = 0.0
    start: float = 0.0
    pressure: float | None = None


class Strut(NamedTuple):
    """
    A cylinder or spring from the point `a` of `one` to `b` of `other`: it holds nothing by itself.

    Its length is a variable of its name, which a driver may prescribe; its direction another,
    NAME.angle.
    """

    name: str
    one: str
    a: complex
    other: str
    b: complex


class Belt(NamedTuple):
    """
    One taut strand of a belt, chain or rope, from a wheel on the body `one` to one on `other`.

    The wheels have their hubs at `a` and `b` and `radii` (m), positive where the strand lies to the
    left of the hub; zero ties its end to the point. It does not slip, and the distance of the hubs
    is held by nothing else than its length. Its variables are those of a strut: the length of the
    straight part, which is `length` where this points to `direction` (rad) and the wheels are at
    angle zero; and the direction, NAME.angle. A `carrier` that holds both hubs turns the strand,
    whose length then stays.
    """

    name: str
    one: str
    a: complex
    other: str
    b: complex
    radii: tuple[float, float]
    length: float
    direction: float
    carrier: str | None = None


class Follower(NamedTuple):
    """
    The variable `moved` is a `function` of the angle of the body `of`: of a cam, or Geneva drive.

    The angle is that seen from the body `seen`, and `moved` too if it is that of a body. The
    function depends on where points with the names `hubs` are.
    """

    name: str
    moved: str
    of: str
    seen: str
    function: Function
    hubs: tuple[str, ...] = ()


Joint = Revolute | Slot | Rolling | Strut | Belt


class Assembly(NamedTuple):
    """
    The loops of bodies and joints, and where the bodies are.

    `bodies` (B) without the ground; their origins are `places` (B, terms) times the terms, complex;
    their angles `turns` (B, n) times the variables. `joints` are as given.
    """

    loops: Loops
    bodies: tuple[str, ...]
    places: Real
    turns: Real
    joints: tuple[Joint, ...]

    @property
    def kinds(self) -> dict[str, str]:
        """Whether each variable, by name, is an 'angle' (rad) or a 'length' (m)."""
        is_length = (self.loops.lengths != 0).any(axis=0)
        return {
            name: 'length' if length else 'angle'
            for name, length in zip(self.loops.variables, is_length, strict=True)
        }


class _Terms:
    """A growing list of terms r e^{iθ}, each kept once."""

    def __init__(self, variables: Sequence[str]) -> None:
        self._variables = list(variables)
        self._rows: dict[tuple[object, ...], int] = {}
        self.lengths: list[Real] = []
        self.length0: list[float] = []
        self.angles: list[Real] = []
        self.angle0: list[float] = []

    def add(self, r: float | str, body: str, offset: float) -> int:
        """The term of length r (m, or a variable) at the angle of `body` plus `offset`."""
        if not isinstance(r, str) and r < 0:
            r, offset = -r, offset + np.pi
        key = (r, body, offset)
        if key not in self._rows:
            self._rows[key] = len(self.length0)
            self.lengths.append(self._row(r if isinstance(r, str) else None))
            self.length0.append(0.0 if isinstance(r, str) else r)
            self.angles.append(self._row(None if body == GROUND else body))
            self.angle0.append(offset)
        return self._rows[key]

    def _row(self, variable: str | None) -> Real:
        row = np.zeros(len(self._variables))
        if variable is not None:
            row[self._variables.index(variable)] = 1.0
        return row


Chain = dict[int, float]


def assemble(
    bodies: Sequence[str], joints: Sequence[Joint], followers: Sequence[Follower] = ()
) -> Assembly:
    """
    Write `bodies` (without the ground), `joints` and followers as loops, without drivers.

    Raises LinkageError for a body that no joint connects with the ground.
    """
    variables = list(bodies)
    for joint in joints:
        if not isinstance(joint, Revolute):
            variables.append(joint.name)
        if isinstance(joint, Strut | Belt):
            variables.append(f'{joint.name}.angle')
    terms = _Terms(variables)
    sides = [_sides(terms, joint) for joint in joints]
    places: dict[str, Chain] = {GROUND: {}}
    # The joints on the way from the ground.
    way: dict[str, tuple[str, ...]] = {GROUND: ()}
    used: set[int] = set()
    # Through joints that hold a place first: a strut or belt only places what nothing else does.
    for through_struts in (False, True):
        grown = True
        while grown:
            grown = False
            for k, joint in enumerate(joints):
                if k in used or (isinstance(joint, Strut | Belt) and not through_struts):
                    continue
                known = [body for body in (joint.one, joint.other) if body in places]
                if len(known) != 1:
                    continue
                here, there = sides[k] if known[0] == joint.one else sides[k][::-1]
                reached = joint.other if known[0] == joint.one else joint.one
                places[reached] = _sum(places[known[0]], here, there)
                way[reached] = (*way[known[0]], joint.name)
                used.add(k)
                grown = True
                if through_struts:
                    break
            if through_struts and grown:
                continue
    lost = [body for body in bodies if body not in places]
    if lost:
        raise LinkageError(
            f'no joint connects {", ".join(lost)} with the ground: add one, or leave it out'
        )
    chains, around = [], []
    for k, joint in enumerate(joints):
        # Hubs on a carrier close a loop that never moves.
        if k not in used and not (isinstance(joint, Belt) and joint.carrier):
            around.append(_around(way[joint.one], joint.name, way[joint.other]))
            one = _sum(places[joint.one], sides[k][0], {})
            chains.append(_sum(one, {}, _sum(places[joint.other], sides[k][1], {})))
    count = len(terms.length0)
    ties, tie0 = _ties(joints, variables)
    loops = Loops(
        tuple(variables),
        np.array(terms.lengths).reshape(count, len(variables)),
        np.array(terms.length0),
        np.array(terms.angles).reshape(count, len(variables)),
        np.array(terms.angle0),
        np.array([_dense(chain, count) for chain in chains]).reshape(len(chains), count),
        ties,
        tie0,
        np.zeros((0, len(variables))),
        tuple(around),
        tuple(_law(follower, bodies, variables) for follower in followers),
    )
    starts = {joint.name: joint.start for joint in joints if isinstance(joint, Rolling)}
    return Assembly(
        _tie_equal(loops, np.array([starts.get(name, 0.0) for name in variables])),
        tuple(bodies),
        np.array([_dense(places[body], count) for body in bodies]).reshape(len(bodies), count),
        np.eye(len(bodies), len(variables)),
        tuple(joints),
    )


def _law(follower: Follower, bodies: Sequence[str], variables: Sequence[str]) -> Law:
    def seen(name: str) -> Real:
        less = follower.seen if name in bodies else GROUND
        return np.array([(name == other) - float(less == other) for other in variables])

    rows = seen(follower.moved), seen(follower.of)
    return Law(follower.name, *rows, follower.function, follower.hubs)


def _around(there: Sequence[str], closing: str, back: Sequence[str]) -> tuple[str, ...]:
    """The joints of a loop: from where two ways part to the joint where they meet, and back."""
    shared = 0
    for one, other in zip(there, back, strict=False):
        if one != other:
            break
        shared += 1
    return (*there[shared:], closing, *reversed(back[shared:]))


def _sides(terms: _Terms, joint: Joint) -> tuple[Chain, Chain]:
    """The joint's vector equation: terms from the origin of `one`, and from that of `other`."""
    one: Chain = _point(terms, joint.one, joint.a)
    other: Chain = _point(terms, joint.other, joint.b)
    if isinstance(joint, Slot):
        one[terms.add(joint.name, joint.one, joint.along)] = 1.0
    elif isinstance(joint, Rolling) and joint.circle:
        one[terms.add(joint.circle + joint.radius, joint.name, 0.0)] = 1.0
    elif isinstance(joint, Rolling):
        one[terms.add(joint.name, joint.one, joint.along)] = 1.0
        one[terms.add(joint.radius, joint.one, joint.along + np.pi / 2)] = 1.0
    elif isinstance(joint, Strut | Belt):
        one[terms.add(joint.name, f'{joint.name}.angle', 0.0)] = 1.0
    if isinstance(joint, Belt) and joint.radii[0] != joint.radii[1]:
        step = joint.radii[0] - joint.radii[1]
        one[terms.add(step, f'{joint.name}.angle', np.pi / 2)] = 1.0
    return one, other


def strand(joint: Belt, hubs: Complex) -> tuple[Real, Complex]:
    """Length and direction, complex of length 1, of a belt's strand, from hub to hub (complex)."""
    step = joint.radii[0] - joint.radii[1]
    length = np.sqrt(np.maximum(np.abs(hubs) ** 2 - step**2, 0.0))
    return length, hubs / (length + 1j * step)


def _point(terms: _Terms, body: str, place: complex) -> Chain:
    return {terms.add(abs(place), body, float(np.angle(place))): 1.0} if place else {}


def _ties(joints: Sequence[Joint], variables: Sequence[str]) -> tuple[Real, Real]:
    """Linear equations between the variables: guided angles, and rolling and belts without slip."""
    rows, right = [], []
    for joint in joints:
        if isinstance(joint, Belt) and joint.carrier:
            angle = f'{joint.name}.angle'
            rows += [[float(name == joint.name) for name in variables]]
            rows += [[float(name == angle) - (name == joint.carrier) for name in variables]]
            right += [joint.length, joint.direction]
        row = dict.fromkeys(variables, 0.0) | {GROUND: 0.0}
        if isinstance(joint, Slot) and joint.turned is not None:
            row[joint.other], row[joint.one] = 1.0, -1.0
            value = joint.turned
        elif isinstance(joint, Rolling) and joint.circle:
            # The point of contact moves as a point of either: (R + r) φ' = R θ' + r θ_wheel'.
            row[joint.name] = joint.circle + joint.radius
            row[joint.one], row[joint.other] = -joint.circle, -joint.radius
            value = (joint.circle + joint.radius) * joint.start
        elif isinstance(joint, Rolling):
            row[joint.name], row[joint.other], row[joint.one] = 1.0, joint.radius, -joint.radius
            value = joint.start
        elif isinstance(joint, Belt):
            # What a wheel unwinds: s' = r1 (φ' - θ1') - r2 (φ' - θ2').
            first, last = joint.radii
            row[joint.name], row[f'{joint.name}.angle'] = 1.0, last - first
            row[joint.one], row[joint.other] = first, -last
            value = joint.length + (last - first) * joint.direction
        else:
            continue
        rows.append([row[name] for name in variables])
        right.append(value)
    return np.array(rows).reshape(-1, len(variables)), np.array(right)


def _tie_equal(loops: Loops, near: Real) -> Loops:
    """
    Loops of two equal lengths, as of an arm and the wheels whose hubs it joins, as ties.

    They close where the two point the same way, one linear equation; as a loop they are two
    equations that determine one unknown and, at any position, look like a dead point. Two loops may
    hide such a one, as where the arm is the coupler of a four-bar: their sum or difference. Of
    angles that differ by whole turns the tie takes those next to `near` (n,), what the variables
    are with all angles zero. Raises LinkageError for two lengths that differ.
    """
    rows, right, kept = [], [], list(range(len(loops.loops)))
    for m in range(len(loops.loops)):
        others = [k for k in kept if k != m]
        for k, sign in ((m, 0.0), *product(others, (1.0, -1.0))):
            tie = _equal(loops, loops.loops[m] + sign * loops.loops[k])
            if tie is None:
                continue
            turns, value, (one, other) = tie
            if abs(one - other) > 1e-9 * max(one, other):
                around = ', '.join(dict.fromkeys((*loops.around[m], *loops.around[k])))
                raise LinkageError(
                    f'the loop {around} never closes: its two lengths are {one:.9g} and '
                    f'{other:.9g} m: make them equal'
                )
            rows.append(turns)
            right.append(value + 2 * np.pi * np.round((turns @ near - value) / (2 * np.pi)))
            kept.remove(m)
            break
    if not rows:
        return loops
    return loops._replace(
        loops=loops.loops[kept],
        around=tuple(loops.around[m] for m in kept),
        ties=np.concatenate((loops.ties, rows)),
        tie0=np.concatenate((loops.tie0, right)),
    )


def _equal(loops: Loops, loop: Real) -> tuple[Real, float, tuple[float, float]] | None:
    """
    Where a sum of terms (terms,) is of two lengths: these, and turns (n,) and value for which
    turns @ variables = value where they point against each other. Else None.

    All that turns by the same angle is one length, as is what stands still.
    """
    some = np.flatnonzero(loop)
    if loops.lengths[some].any():
        return None
    vectors = loop * loops.length0 * np.exp(1j * loops.angle0)
    parts = []
    for turns in np.unique(loops.angles[some], axis=0)[::-1]:
        same = some[(loops.angles[some] == turns).all(axis=1)]
        part = complex(vectors[same].sum())
        if abs(part) > 1e-9 * np.abs(vectors).max():
            parts.append((part, turns))
    if len(parts) != 2:
        return None
    (one, turns), (other, against) = parts
    return turns - against, float(np.angle(-other / one)), (abs(one), abs(other))


def _sum(first: Chain, plus: Chain, minus: Chain) -> Chain:
    total = dict(first)
    for chain, sign in ((plus, 1.0), (minus, -1.0)):
        for term, weight in chain.items():
            total[term] = total.get(term, 0.0) + sign * weight
    return {term: weight for term, weight in total.items() if weight}


def _dense(chain: Chain, count: int) -> Real:
    row = np.zeros(count)
    row[list(chain)] = list(chain.values())
    return row
