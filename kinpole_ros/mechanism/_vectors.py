"""
The loop form of a scene: vectors r e^{iθ}, sums of them that close, and points as chains of them.

As courses write it (seed 003): `L1: r1 + r2 + r3 + r4 = 0` and `θ3p = θ3 + 135°`. Every vector that
turns is a body, too, its origin where the vector starts, its angle that of the vector less the
constant of its equation.
"""

import re
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly
from kinpole_ros.mechanism._loops import Loops
from kinpole_ros.mechanism._units import SceneError, direction, quantity
from kinpole_ros.planar._plane import Real

UNKNOWN = 'unknown'
_NAME = r'[A-Za-z_]\w*'
_SUM = re.compile(rf'\s*([-+])?\s*({_NAME})')
_ANGLE = re.compile(rf'\s*({_NAME})\s*(?:([-+])\s*(.+))?')

Chain = dict[str, int]


class Vector(NamedTuple):
    """Length and angle as numbers, or as the name of a variable plus a number (for the angle)."""

    length: float | None
    turns_with: str | None
    angle: float


class Vectors(NamedTuple):
    """All vectors by name, and the two nodes between which each lies: those that loops share."""

    vectors: dict[str, Vector]
    ends: dict[str, tuple[frozenset, frozenset]]


def read_vectors(
    vectors: dict[str, Any], loops: Any, points: dict[str, Any]
) -> tuple[Assembly, dict[str, tuple[str, complex]], Vectors]:
    """
    The assembly of `vectors` and `loops`, the `points` as (body, place in its frame), and nodes.

    Variables are named NAME.length and NAME.angle. Raises SceneError for whatever is malformed.
    """
    read = {name: _vector(name, vectors) for name in vectors}
    sums = _sums(loops, read)
    chains = {name: _sum(f"'points: {name}'", text, read) for name, text in points.items()}
    unused = set(read) - {name for chain in [*sums, *chains.values()] for name in chain}
    if unused:
        name = sorted(unused)[0]
        raise SceneError(f"'vectors: {name}' is in no loop and no point: use it, or leave it out")
    variables = [f'{name}.length' for name, one in read.items() if one.length is None]
    variables += [f'{name}.angle' for name, one in read.items() if one.turns_with == name]
    column = {name: k for k, name in enumerate(variables)}
    order = {name: k for k, name in enumerate(read)}
    lengths, angles = (np.zeros((len(read), len(variables))) for _ in range(2))
    for name, one in read.items():
        if one.length is None:
            lengths[order[name], column[f'{name}.length']] = 1.0
        if one.turns_with:
            angles[order[name], column[f'{one.turns_with}.angle']] = 1.0

    def dense(chain: Chain) -> Real:
        row = np.zeros(len(read))
        row[[order[name] for name in chain]] = list(chain.values())
        return row

    tails = _tails(sums, list(chains.values()))
    bodies = [name for name, one in read.items() if one.turns_with]
    count = len(variables)
    assembly = Assembly(
        Loops(
            tuple(variables),
            lengths,
            np.array([one.length or 0.0 for one in read.values()]),
            angles,
            np.array([one.angle for one in read.values()]),
            np.array([dense(chain) for chain in sums]),
            np.zeros((0, count)),
            np.zeros(0),
            np.zeros((0, count)),
            tuple(tuple(chain) for chain in sums),
        ),
        tuple(bodies),
        np.array([dense(tails[body]) for body in bodies]).reshape(-1, len(read)),
        np.array([angles[order[body]] for body in bodies]).reshape(-1, count),
        (),
    )
    placed = {name: _on_body(name, chain, tails, read) for name, chain in chains.items()}
    return assembly, placed, Vectors(read, _ends(sums, list(chains.values()), tails))


def _vector(name: str, vectors: dict[str, Any]) -> Vector:
    where = f"'vectors: {name}'"
    said = vectors[name]
    if not re.fullmatch(_NAME, name):
        raise SceneError(f'{where}: name a vector with letters, digits and _, as r3p')
    if not isinstance(said, dict) or set(said) != {'length', 'angle'}:
        raise SceneError(f'{where} is {said!r}: give {{length: 20 cm, angle: 30 deg}}, or unknown')
    length = None
    if said['length'] != UNKNOWN:
        length = quantity(f'{where}: length', said['length'], 'length')
        if length <= 0:
            raise SceneError(f'{where}: length is {said["length"]!r}: give one greater than 0')
    turns_with, angle = _angle(name, vectors, ())
    return Vector(length, turns_with, angle)


def _angle(name: str, vectors: dict[str, Any], seen: tuple[str, ...]) -> tuple[str | None, float]:
    """Which vector's angle it is plus how much, through however many equations."""
    where = f"'vectors: {name}': angle"
    if name in seen:
        raise SceneError(f'{where} is defined by itself: make one of {", ".join(seen)} unknown')
    said = vectors[name].get('angle') if isinstance(vectors[name], dict) else None
    if said == UNKNOWN:
        return name, 0.0
    found = _ANGLE.fullmatch(said) if isinstance(said, str) else None
    if found is None:
        return None, quantity(where, said, 'angle')
    other, sign, plus = found.groups()
    if other not in vectors:
        raise SceneError(f"{where} is that of '{other}', which is no vector: {_one_of(vectors)}")
    turns_with, angle = _angle(other, vectors, (*seen, name))
    more = quantity(where, plus, 'angle') if plus else 0.0
    return turns_with, angle + (-more if sign == '-' else more)


def _sums(loops: Any, vectors: dict[str, Vector]) -> list[Chain]:
    if not isinstance(loops, list) or not loops:
        raise SceneError("'loops' is no list: give the sums that close, as [r1 + r2 + r3 + r4]")
    return [_sum(f"'loops: {k + 1}'", text, vectors) for k, text in enumerate(loops)]


def _sum(where: str, text: Any, vectors: dict[str, Vector]) -> Chain:
    """The vectors of a sum, in order, each with its sign."""
    chain: Chain = {}
    at = 0
    while isinstance(text, str) and at < len(text.rstrip()):
        found = _SUM.match(text, at)
        if found is None or (chain and not found[1]):
            chain = {}
            break
        name = found[2]
        if name not in vectors:
            raise SceneError(f"{where} holds '{name}', which is no vector: {_one_of(vectors)}")
        if name in chain:
            raise SceneError(f"{where} holds '{name}' twice: a chain goes along a vector once")
        chain[name] = -1 if found[1] == '-' else 1
        at = found.end()
    if not chain:
        raise SceneError(f'{where} is {text!r}: give a sum of vectors, as r2 + r3 - r1')
    return chain


def _one_of(vectors: dict[str, Any]) -> str:
    return f'use one of {", ".join(vectors)}'


def _tails(sums: list[Chain], chains: list[Chain]) -> dict[str, Chain]:
    """
    Where each vector starts, as a sum from the origin.

    The chains of points start at the origin; a loop does where a chain or an earlier loop has a
    vector of it, or else with its first.
    """
    tails: dict[str, Chain] = {}
    for chain in chains:
        _walk(list(chain.items()), {}, tails)
    for loop in sums:
        steps = list(loop.items())
        first = next(
            (k for k, (name, sign) in enumerate(steps) if name in tails and sign > 0), None
        )
        if first is None:
            _walk(steps, {}, tails)
        else:
            _walk(steps[first:] + steps[:first], tails[steps[first][0]], tails)
    return tails


def _walk(steps: list[tuple[str, int]], here: Chain, tails: dict[str, Chain]) -> None:
    for name, sign in steps:
        after = _plus(here, name, sign)
        tails.setdefault(name, here if sign > 0 else after)
        here = after


def _ends(
    sums: list[Chain], chains: list[Chain], tails: dict[str, Chain]
) -> dict[str, tuple[frozenset, frozenset]]:
    """The nodes at tail and head of each vector; those that close a loop are one."""
    same: dict[frozenset, frozenset] = {}

    def node(label: frozenset) -> frozenset:
        while label in same:
            label = same[label]
        return label

    def join(one: frozenset, other: frozenset) -> None:
        one, other = node(one), node(other)
        if one != other:
            # The origin, which is the ground's, stays.
            keep, drop = (one, other) if len(one) <= len(other) else (other, one)
            same[drop] = keep

    found: dict[str, tuple[frozenset, frozenset]] = {}
    for k, chain in enumerate([*chains, *sums]):
        steps = list(chain.items())
        here: Chain = {}
        if k >= len(chains):
            first, sign = steps[0]
            here = tails[first] if sign > 0 else _plus(tails[first], first, 1)
        begin = here
        for name, sign in steps:
            after = _plus(here, name, sign)
            ends = [frozenset(end.items()) for end in ((here, after)[::sign])]
            known = found.setdefault(name, (ends[0], ends[1]))
            for one, other in zip(known, ends, strict=True):
                join(one, other)
            here = after
        if k >= len(chains):
            join(frozenset(begin.items()), frozenset(here.items()))
    return {name: (node(tail), node(head)) for name, (tail, head) in found.items()}


def _plus(chain: Chain, name: str, sign: int) -> Chain:
    total = dict(chain)
    total[name] = total.get(name, 0) + sign
    return {key: value for key, value in total.items() if value}


def _on_body(
    name: str, chain: Chain, tails: dict[str, Chain], vectors: dict[str, Vector]
) -> tuple[str, complex]:
    """The body on which a point is fixed, and where: the last vector's, if it can be."""
    for body in [*reversed(chain), *vectors]:
        with_it = vectors[body].turns_with
        if with_it is None:
            continue
        rest = dict(chain)
        for other, sign in tails[body].items():
            rest = _plus(rest, other, -sign)
        parts = [(vectors[other], sign) for other, sign in rest.items()]
        if all(one.turns_with == with_it and one.length is not None for one, _ in parts):
            place = sum(
                (sign * (one.length or 0.0) * direction(one.angle) for one, sign in parts), 0j
            )
            return body, place
    raise SceneError(
        f"'points: {name}' lies on no body: end it with a vector that turns and keeps its length"
    )
