"""
Bodies and joints as vector loops, and the poses of the bodies at given variables.

From the ground on, each body is reached through one joint, which gives its position as a sum of
terms r e^{iθ}. Every further joint closes a loop.
"""

from collections.abc import Sequence
from itertools import product
from math import comb
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._followers import Follower
from kinpole_ros.mechanism._joint_kinds import GROUND, Joint, Pose, Term
from kinpole_ros.mechanism._laws import Law
from kinpole_ros.mechanism._loops import LinkageError, Loops, term_lengths, weigh
from kinpole_ros.mechanism._motions import rotation_derivatives
from kinpole_ros.planar._plane import Complex, Real

# A sum of terms: weights by the numbers of the terms.
Chain = dict[int, float]


class Assembly(NamedTuple):
    """
    The loops of bodies and joints, and where the bodies are.

    `bodies` (B) are those without the ground. Their origins are `origins` (B, terms) times the
    terms, complex; their angles are `turns` (B, n) times the variables. `joints` and `followers`
    are as given.
    """

    loops: Loops
    bodies: tuple[str, ...]
    origins: Real
    turns: Real
    joints: tuple[Joint, ...]
    followers: tuple[Follower, ...] = ()

    @property
    def kinds(self) -> dict[str, str]:
        """Whether each variable, by name, is an 'angle' (rad) or a 'length' (m)."""
        names = np.where(self.loops.is_angle, 'angle', 'length').tolist()
        return dict(zip(self.loops.variables, names, strict=True))


def largest_length(assembly: Assembly, values: Real) -> float:
    """The largest length (m) in the loops, at variables (n, T)."""
    length = np.abs(term_lengths(assembly.loops, values))
    return float(np.max(length, where=np.isfinite(length), initial=0.0)) or 1.0


def body_motion(assembly: Assembly, values: Real) -> tuple[Complex, Real]:
    """Origins (orders, B, T), complex, and angles (orders, B, T) from variables (orders, n, T)."""
    loops, used = assembly.loops, assembly.origins.any(axis=0)
    length, angle = weigh(loops.lengths[used], values), weigh(loops.angles[used], values)
    length[0] += loops.length0[used, None]
    angle[0] += loops.angle0[used, None]
    turn = rotation_derivatives(angle)
    terms = [
        sum(comb(k, j) * length[j] * turn[k - j] for j in range(k + 1)) for k in range(len(values))
    ]
    terms = np.reshape(terms, turn.shape)
    return weigh(assembly.origins[:, used], terms), weigh(assembly.turns, values)


def poses_of(assembly: Assembly, values: Real) -> dict[str, Pose]:
    """Poses of all bodies by name, the ground first, at variables (n, T)."""
    values = np.asarray(values, float)
    position, angle = body_motion(assembly, values[None])
    still = np.zeros(values.shape[1])
    moving = map(Pose, position[0], angle[0])
    return {GROUND: Pose(still + 0j, still)} | dict(zip(assembly.bodies, moving, strict=True))


def joint_extent(assembly: Assembly, poses: dict[str, Pose]) -> tuple[Complex, float]:
    """The middle (T,) of the joints, complex, m, and the size of the linkage, m."""
    points = [
        poses[body].point(point)
        for joint in assembly.joints
        for body, point in ((joint.one, joint.a), (joint.other, joint.b))
    ]
    positions = np.stack(points or [pose.position for pose in poses.values()])
    middle = positions.mean(axis=0)
    size = float(np.abs(positions - middle).max(initial=0.0))
    wheels = [rim.radius for one in assembly.joints for rim in one.rims() if rim.is_wheel]
    return middle, max(size, *wheels, 0.0) or 1.0


class _Terms:
    """All terms of the loops, each once, with their numbers."""

    def __init__(self) -> None:
        self.numbers: dict[Term, int] = {}

    def add(self, term: Term) -> int:
        """The number of a term."""
        if term.length < 0:
            term = term._replace(length=-term.length, offset=term.offset + np.pi)
        return self.numbers.setdefault(term, len(self.numbers))

    def point(self, body: str, point: complex) -> Chain:
        """The vector from the origin of a body to one of its points."""
        return {self.add(Term(abs(point), float(np.angle(point)), body)): 1.0} if point else {}

    def sides(self, joint: Joint) -> tuple[Chain, Chain]:
        """The vectors from the origin of `one` and from that of `other` to where they meet."""
        first, second = self.point(joint.one, joint.a), self.point(joint.other, joint.b)
        return first | {self.add(term): 1.0 for term in joint.loop_form().terms}, second


def assemble(
    bodies: Sequence[str], joints: Sequence[Joint], followers: Sequence[Follower] = ()
) -> Assembly:
    """
    Write `bodies` (without the ground), `joints` and followers as loops, without drivers.

    Raises LinkageError for a body that no joint connects with the ground.
    """
    own = [name for joint in joints for name in joint.loop_form().variables]
    variables, terms = [*bodies, *own], _Terms()
    sides = [terms.sides(joint) for joint in joints]
    origins, routes, used = _spanning_tree(joints, sides)
    if loose := [body for body in bodies if body not in origins]:
        raise LinkageError(
            f'no joint connects {", ".join(loose)} with the ground: add one, or leave it out'
        )
    chains, around = [], []
    for k, joint in enumerate(joints):
        # Hubs on a carrier close a loop that never moves.
        if k not in used and not joint.is_carried:
            around.append(_around(routes[joint.one], joint.name, routes[joint.other]))
            first = _sum(origins[joint.one], sides[k][0], {})
            chains.append(_sum(first, {}, _sum(origins[joint.other], sides[k][1], {})))
    count = len(terms.numbers)
    ties = [tie for joint in joints for tie in joint.loop_form().ties]
    loops = Loops(
        variables=tuple(variables),
        lengths=_columns([term.slide for term in terms.numbers], variables),
        length0=np.array([0.0 if term.slide else term.length for term in terms.numbers]),
        angles=_columns([term.turn for term in terms.numbers], variables),
        angle0=np.array([term.offset for term in terms.numbers]),
        loops=np.array([_dense(chain, count) for chain in chains]).reshape(len(chains), count),
        ties=np.array([[tie.weights.get(name, 0.0) for name in variables] for tie in ties]).reshape(
            -1, len(variables)
        ),
        tie0=np.array([tie.value for tie in ties]),
        drives=np.zeros((0, len(variables))),
        around=tuple(around),
        laws=tuple(_law(follower, bodies, variables) for follower in followers),
    )
    starts = {joint.name: joint.start for joint in joints}
    return Assembly(
        _parallel_arms_as_ties(loops, np.array([starts.get(name, 0.0) for name in variables])),
        tuple(bodies),
        np.array([_dense(origins[body], count) for body in bodies]).reshape(len(bodies), count),
        np.eye(len(bodies), len(variables)),
        tuple(joints),
        tuple(followers),
    )


def _columns(names: Sequence[str], variables: Sequence[str]) -> Real:
    """Rows of zeros with a one at the variable of each name, if there is such a variable."""
    return np.array([[float(name == one) for one in variables] for name in names]).reshape(
        len(names), len(variables)
    )


def _spanning_tree(
    joints: Sequence[Joint], sides: Sequence[tuple[Chain, Chain]]
) -> tuple[dict[str, Chain], dict[str, tuple[str, ...]], set[int]]:
    """Origins of the bodies, the joints on the way to each, and the joints that were used."""
    origins: dict[str, Chain] = {GROUND: {}}
    routes: dict[str, tuple[str, ...]] = {GROUND: ()}
    used: set[int] = set()

    def reaches(k: int) -> bool:
        """Whether a joint leads to a new body, which is then added."""
        joint, (first, second) = joints[k], sides[k]
        near, far = joint.one, joint.other
        if near not in origins:
            near, far, first, second = far, near, second, first
        if near not in origins or far in origins:
            return False
        origins[far] = _sum(origins[near], first, second)
        routes[far] = (*routes[near], joint.name)
        used.add(k)
        return True

    rigid = [k for k, joint in enumerate(joints) if not joint.is_span]
    while sum([reaches(k) for k in rigid]):
        pass
    # A strut or belt only leads to a body that nothing else leads to.
    while any(reaches(k) for k in range(len(joints))):
        pass
    return origins, routes, used


def _law(follower: Follower, bodies: Sequence[str], variables: Sequence[str]) -> Law:
    def row(name: str) -> Real:
        relative_to = follower.seen if name in bodies else GROUND
        return np.array([(name == one) - float(relative_to == one) for one in variables])

    moved, of = row(follower.moved), row(follower.of)
    return Law(follower.name, moved, of, follower.function, follower.hubs)


def _around(route: Sequence[str], closing: str, back: Sequence[str]) -> tuple[str, ...]:
    """The joints of a loop, from the body at which the two routes from the ground separate."""
    shared = 0
    for first, second in zip(route, back, strict=False):
        if first != second:
            break
        shared += 1
    return (*route[shared:], closing, *reversed(back[shared:]))


def _parallel_arms_as_ties(loops: Loops, near: Real) -> Loops:
    """
    Write loops of two equal lengths, as of an arm and the wheels whose hubs it has, as ties.

    Such a loop closes where both point the same way, which is one linear equation. As a loop it
    would be two equations for one unknown, singular at every position. The sum or difference of
    two loops may be of this form too, as where the arm is the coupler of a four-bar. Whole turns
    are those next to `near` (n,), the variables with all angles zero. Raises LinkageError for two
    lengths that differ.
    """
    rows, right, kept_loops = [], [], list(range(len(loops.loops)))
    for m in range(len(loops.loops)):
        partners = [k for k in kept_loops if k != m]
        for k, sign in ((m, 0.0), *product(partners, (1.0, -1.0))):
            arms = _two_arms(loops, loops.loops[m] + sign * loops.loops[k])
            if arms is None:
                continue
            turns, value, (first, second) = arms
            if abs(first - second) > 1e-9 * max(first, second):
                around = ', '.join(dict.fromkeys((*loops.around[m], *loops.around[k])))
                raise LinkageError(
                    f'the loop {around} never closes: its two lengths are {first:.9g} and '
                    f'{second:.9g} m: make them equal'
                )
            rows.append(turns)
            right.append(value + 2 * np.pi * np.round((turns @ near - value) / (2 * np.pi)))
            kept_loops.remove(m)
            break
    if not rows:
        return loops
    return loops._replace(
        loops=loops.loops[kept_loops],
        around=tuple(loops.around[m] for m in kept_loops),
        ties=np.concatenate((loops.ties, rows)),
        tie0=np.concatenate((loops.tie0, right)),
    )


def _two_arms(loops: Loops, loop: Real) -> tuple[Real, float, tuple[float, float]] | None:
    """
    The two lengths of a sum of terms (terms,) that has two, None for any other sum.

    Returned are `turns` (n,), `value` and both lengths; turns @ variables = value where the two
    point against each other. All terms that turn by the same angle are one length.
    """
    used = np.flatnonzero(loop)
    if loops.lengths[used].any():
        return None
    vectors = loop * loops.length0 * np.exp(1j * loops.angle0)
    arms = []
    for turns in sorted(set(map(tuple, loops.angles[used].tolist())), reverse=True):
        arm = complex(vectors[used[(loops.angles[used] == turns).all(axis=1)]].sum())
        if abs(arm) > 1e-9 * np.abs(vectors).max():
            arms.append((arm, np.array(turns)))
        if len(arms) > 2:
            return None
    if len(arms) < 2:
        return None
    (first, turns), (second, against) = arms
    return turns - against, float(np.angle(-second / first)), (abs(first), abs(second))


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
