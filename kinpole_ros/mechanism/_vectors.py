"""
The loop form of a scene: vectors r e^{iθ}, sums of them that close, and points as chains of them.

As courses write it (seed 003): `L1: r1 + r2 + r3 + r4 = 0` and `θ3p = θ3 + 135°`. Every vector that
turns is a body, too. Its origin is the tail of the vector, its angle that of the vector less the
constant of its equation.
"""

import re
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly
from kinpole_ros.mechanism._loops import Loops
from kinpole_ros.mechanism._scene_values import Points, SceneError, direction, positive, quantity
from kinpole_ros.planar._plane import Real

_UNKNOWN = 'unknown'
_NAME = r'[A-Za-z_]\w*'
_SUM = re.compile(rf'\s*([-+])?\s*({_NAME})')
_ANGLE = re.compile(rf'\s*({_NAME})\s*(?:([-+])\s*(.+))?')

# A sum of vectors: signs by name.
Chain = dict[str, int]
Node = frozenset[tuple[str, int]]


class Vector(NamedTuple):
    """
    A vector of `length`, m, None if it is unknown, and `angle`, rad.

    The angle is relative to that of the vector `turns_with`, which may be itself, or to the ground.
    """

    length: float | None
    turns_with: str | None
    angle: float


class LoopVectors(NamedTuple):
    """All vectors by name, and the two nodes between which each lies: those that loops share."""

    vectors: dict[str, Vector]
    ends: dict[str, tuple[Node, Node]]


def read_vectors(
    vectors: dict[str, Any], loops: Any, points: dict[str, Any]
) -> tuple[Assembly, Points, LoopVectors]:
    """
    The assembly of `vectors` and `loops`, the `points` on their bodies, and the nodes.

    Variables are named NAME.length and NAME.angle. Raises SceneError for malformed entries.
    """
    read = {name: _vector(name, vectors) for name in vectors}
    if not isinstance(loops, list) or not loops:
        raise SceneError("'loops' is no list: give the sums that close, as [r1 + r2 + r3 + r4]")
    sums = [_sum(f"'loops: {k + 1}'", text, read) for k, text in enumerate(loops)]
    chains = {name: _sum(f"'points: {name}'", text, read) for name, text in points.items()}
    if unused := set(read) - {name for chain in [*sums, *chains.values()] for name in chain}:
        name = min(unused)
        raise SceneError(f"'vectors: {name}' is in no loop and no point: use it, or leave it out")
    variables = [f'{name}.length' for name, vector in read.items() if vector.length is None]
    variables += [f'{name}.angle' for name, vector in read.items() if vector.turns_with == name]
    order = {name: k for k, name in enumerate(read)}
    lengths, angles = (np.zeros((len(read), len(variables))) for _ in range(2))
    for name, vector in read.items():
        if vector.length is None:
            lengths[order[name], variables.index(f'{name}.length')] = 1.0
        if vector.turns_with:
            angles[order[name], variables.index(f'{vector.turns_with}.angle')] = 1.0

    def dense(chains: list[Chain]) -> Real:
        rows = np.zeros((len(chains), len(read)))
        for row, chain in zip(rows, chains, strict=True):
            row[[order[name] for name in chain]] = list(chain.values())
        return rows

    tails = _tails(sums, list(chains.values()))
    bodies = [name for name, vector in read.items() if vector.turns_with]
    count = len(variables)
    assembly = Assembly(
        Loops(
            variables=tuple(variables),
            lengths=lengths,
            length0=np.array([vector.length or 0.0 for vector in read.values()]),
            angles=angles,
            angle0=np.array([vector.angle for vector in read.values()]),
            loops=dense(sums),
            ties=np.zeros((0, count)),
            tie0=np.zeros(0),
            drives=np.zeros((0, count)),
            around=tuple(tuple(chain) for chain in sums),
        ),
        tuple(bodies),
        dense([tails[body] for body in bodies]),
        angles[[order[body] for body in bodies]],
        (),
    )
    on_body = {name: _on_body(name, chain, tails, read) for name, chain in chains.items()}
    return assembly, on_body, LoopVectors(read, _ends(sums, list(chains.values()), tails))


def _vector(name: str, vectors: dict[str, Any]) -> Vector:
    where, entry = f"'vectors: {name}'", vectors[name]
    if not re.fullmatch(_NAME, name):
        raise SceneError(f'{where}: name a vector with letters, digits and _, as r3p')
    if not isinstance(entry, dict) or set(entry) != {'length', 'angle'}:
        raise SceneError(f'{where} is {entry!r}: give {{length: 20 cm, angle: 30 deg}}, or unknown')
    length = None
    if entry['length'] != _UNKNOWN:
        length = positive(f'{where}: length', entry['length'], 'length')
    return Vector(length, *_angle(name, vectors, ()))


def _angle(name: str, vectors: dict[str, Any], seen: tuple[str, ...]) -> tuple[str | None, float]:
    """The vector to which an angle is relative, and the angle, through any number of equations."""
    where = f"'vectors: {name}': angle"
    if name in seen:
        raise SceneError(f'{where} is defined by itself: make one of {", ".join(seen)} unknown')
    value = vectors[name].get('angle') if isinstance(vectors[name], dict) else None
    if value == _UNKNOWN:
        return name, 0.0
    match = _ANGLE.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        return None, quantity(where, value, 'angle')
    base, sign, plus = match.groups()
    if base not in vectors:
        raise SceneError(f"{where} is that of '{base}', which is no vector: {_use_one_of(vectors)}")
    turns_with, angle = _angle(base, vectors, (*seen, name))
    offset = quantity(where, plus, 'angle') if plus else 0.0
    return turns_with, angle + (-offset if sign == '-' else offset)


def _sum(where: str, text: Any, vectors: dict[str, Vector]) -> Chain:
    """The vectors of a sum, in order, each with its sign."""
    chain: Chain = {}
    at = 0
    while isinstance(text, str) and at < len(text.rstrip()):
        match = _SUM.match(text, at)
        if match is None or (chain and not match[1]):
            chain = {}
            break
        name = match[2]
        if name not in vectors:
            raise SceneError(f"{where} holds '{name}', which is no vector: {_use_one_of(vectors)}")
        if name in chain:
            raise SceneError(f"{where} holds '{name}' twice: a chain goes along a vector once")
        chain[name] = -1 if match[1] == '-' else 1
        at = match.end()
    if not chain:
        raise SceneError(f'{where} is {text!r}: give a sum of vectors, as r2 + r3 - r1')
    return chain


def _use_one_of(vectors: dict[str, Any]) -> str:
    return f'use one of {", ".join(vectors)}'


def _tails(sums: list[Chain], chains: list[Chain]) -> dict[str, Chain]:
    """
    The tail of each vector, as a sum from the origin.

    The chains of points start at the origin; a loop does where a chain or an earlier loop has a
    vector of it, or else with its first.
    """
    tails: dict[str, Chain] = {}
    for chain in chains:
        _add_tails(list(chain.items()), {}, tails)
    for loop in sums:
        steps = list(loop.items())
        first = next(
            (k for k, (name, sign) in enumerate(steps) if name in tails and sign > 0), None
        )
        if first is None:
            _add_tails(steps, {}, tails)
        else:
            _add_tails(steps[first:] + steps[:first], tails[steps[first][0]], tails)
    return tails


def _add_tails(steps: list[tuple[str, int]], origin: Chain, tails: dict[str, Chain]) -> None:
    for name, sign in steps:
        after = _plus(origin, name, sign)
        tails.setdefault(name, origin if sign > 0 else after)
        origin = after


def _ends(
    sums: list[Chain], chains: list[Chain], tails: dict[str, Chain]
) -> dict[str, tuple[Node, Node]]:
    """The nodes at tail and head of each vector; those that close a loop are one."""
    merged: dict[Node, Node] = {}

    def node(label: Node) -> Node:
        while label in merged:
            label = merged[label]
        return label

    def merge(first: Node, second: Node) -> None:
        first, second = node(first), node(second)
        if first != second:
            # The origin, which is the ground's, stays.
            keep, drop = (first, second) if len(first) <= len(second) else (second, first)
            merged[drop] = keep

    ends: dict[str, tuple[Node, Node]] = {}
    for k, chain in enumerate([*chains, *sums]):
        is_loop = k >= len(chains)
        name, sign = next(iter(chain.items()))
        at = (tails[name] if sign > 0 else _plus(tails[name], name, 1)) if is_loop else Chain()
        begin = at
        for name, sign in chain.items():
            after = _plus(at, name, sign)
            tail, head = (frozenset(end.items()) for end in ((at, after)[::sign]))
            first_tail, first_head = ends.setdefault(name, (tail, head))
            merge(first_tail, tail)
            merge(first_head, head)
            at = after
        if is_loop:
            merge(frozenset(begin.items()), frozenset(at.items()))
    return {name: (node(tail), node(head)) for name, (tail, head) in ends.items()}


def _plus(chain: Chain, name: str, sign: int) -> Chain:
    total = chain | {name: chain.get(name, 0) + sign}
    return {key: value for key, value in total.items() if value}


def _on_body(
    name: str, chain: Chain, tails: dict[str, Chain], vectors: dict[str, Vector]
) -> tuple[str, complex]:
    """The body on which a point is fixed, the last vector's if possible, and its position there."""
    for body in [*reversed(chain), *vectors]:
        turns_with = vectors[body].turns_with
        if turns_with is None:
            continue
        local = dict(chain)
        for vector, sign in tails[body].items():
            local = _plus(local, vector, -sign)
        position = 0j
        for vector, sign in local.items():
            length = vectors[vector].length
            if vectors[vector].turns_with != turns_with or length is None:
                break
            position += sign * length * direction(vectors[vector].angle)
        else:
            return body, position
    raise SceneError(
        f"'points: {name}' lies on no body: end it with a vector that turns and keeps its length"
    )
