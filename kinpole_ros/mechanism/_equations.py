"""
The joints of a scene as equations between poses, with the dimensions of the scene as unknowns.

`_constraints` has the equations; here each of their numbers is a dimension with a name and with its
path in the scene's file, so that a fit can change it and a message can name it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.mechanism._joint_kinds import GROUND, Joint, Revolute, Slot
from kinpole_ros.mechanism._vectors import LoopVectors
from kinpole_ros.planar._plane import Complex, Real

Path = tuple[str | int, ...]


class Dimension(NamedTuple):
    """
    A length (m) or angle (rad) of a scene: `name` for messages, `value`, `kind`, and its `path`.

    Both coordinates of a point have the point's name; `axis` tells which one it is. The path is
    that in the scene's file, empty for what no scene states.
    """

    name: str
    value: float
    kind: str
    path: Path
    axis: int = 0


class Part(NamedTuple):
    """
    A vector in a sum, by the numbers of two dimensions: `sign` times (x, y), or, if `polar`, times
    a length at an angle.
    """

    sign: float
    polar: bool
    first: int
    second: int


class Equation(NamedTuple):
    """
    A joint of some `kind` whose points and sizes are dimensions.

    Its points are sums of parts, its `sizes` the numbers of dimensions by the names of its fields.
    """

    kind: Callable[..., Joint]
    name: str
    one: str
    a: tuple[Part, ...]
    other: str
    b: tuple[Part, ...]
    sizes: dict[str, int]


class Equations(NamedTuple):
    """
    All equations of a scene, between `bodies` (the ground last), and its dimensions.

    `frames` gives for each body of the scene the one of the `bodies` in which its frame lies, and
    its origin there: vectors that turn with each other are one body.
    """

    bodies: tuple[str, ...]
    dimensions: tuple[Dimension, ...]
    joints: tuple[Equation, ...]
    frames: dict[str, tuple[str, tuple[Part, ...]]]


def part_sum(parts: Sequence[Part], values: Real) -> tuple[complex, Complex]:
    """The sum of vectors of a body, m, in its frame, and its derivatives (D,) by the dimensions."""
    total, slope = 0j, np.zeros(len(values), complex)
    for part in parts:
        first, second = values[part.first], values[part.second]
        if part.polar:
            turn = part.sign * np.exp(1j * second)
            total += first * turn
            slope[part.first] += turn
            slope[part.second] += 1j * first * turn
        else:
            total += part.sign * (first + 1j * second)
            slope[part.first] += part.sign
            slope[part.second] += 1j * part.sign
    return total, slope


def joint_at(equations: Equations, number: int, values: Real) -> tuple[Joint, Real]:
    """
    The joint of an equation at dimensions `values` (D,), m and rad.

    The `start` of a wheel is the difference to the scene's own, since no scene tells which teeth
    are in mesh. Also the derivatives (4 + s, D) of both points and of its sizes by the dimensions,
    in the order of the columns of `constraint_rows` from the seventh on.
    """
    equation = equations.joints[number]
    (a, by_a), (b, by_b) = part_sum(equation.a, values), part_sum(equation.b, values)
    sizes = {key: float(values[number]) for key, number in equation.sizes.items()}
    by_dimension = np.zeros((4 + len(sizes), len(values)))
    by_dimension[:4] = by_a.real, by_a.imag, by_b.real, by_b.imag
    by_dimension[range(4, 4 + len(sizes)), list(equation.sizes.values())] = 1.0
    if 'start' in sizes:
        sizes['start'] -= equations.dimensions[equation.sizes['start']].value
    points: dict[str, Any] = {'one': equation.one, 'a': a, 'other': equation.other, 'b': b}
    return equation.kind(name=equation.name, **points, **sizes), by_dimension


class _Dimensions:
    """A growing list of dimensions, each of a path once."""

    def __init__(self) -> None:
        self.rows: list[Dimension] = []
        self._numbers: dict[tuple[Path, int], int] = {}

    def add(self, name: str, value: float, kind: str, path: Path, axis: int = 0) -> int:
        key = path, axis
        if not path or key not in self._numbers:
            self._numbers[key] = len(self.rows)
            self.rows.append(Dimension(name, value, kind, path, axis))
        return self._numbers[key]

    def point(self, body: str, point: str, position: complex) -> tuple[Part, ...]:
        """The coordinates of a body's point."""
        rows = [
            self.add(f'{body}.{point}', value, 'length', ('bodies', body, point), axis)
            for axis, value in enumerate((position.real, position.imag))
        ]
        return (Part(1.0, False, rows[0], rows[1]),)


def equations_of_joints(
    bodies: Sequence[str], joints: Sequence[Joint], points: Mapping[int, tuple[str, str]]
) -> Equations:
    """
    The equations of bodies (without the ground) on joints.

    The last joints are those of `points`, which has the names of their points `a` and `b` by their
    numbers in the list of the scene's file; the first are pins.
    """
    rows = _Dimensions()
    equations = []
    numbers = [-1] * (len(joints) - len(points)) + list(points)
    for k, joint in zip(numbers, joints, strict=True):
        pin = joint.name.partition('.')[0]
        names = [name.partition('.')[2] for name in points[k]] if k >= 0 else [pin, pin]
        a, b = rows.point(joint.one, names[0], joint.a), rows.point(joint.other, names[1], joint.b)
        sizes = {
            key: rows.add(
                f'{joint.name}.{key}',
                getattr(joint, key),
                kind,
                # No scene tells which teeth are in mesh.
                () if key == 'start' else ('joints', k, key),
            )
            for key, kind in joint.sizes().items()
        }
        equations.append(Equation(type(joint), joint.name, joint.one, a, joint.other, b, sizes))
    own: dict[str, tuple[str, tuple[Part, ...]]] = {body: (body, ()) for body in bodies}
    return Equations((*bodies, GROUND), tuple(rows.rows), tuple(equations), own)


# Vector loops. A vector that turns with another is on the body of that one: each is a line between
# two nodes, and a node that two bodies have is a pin, or a slot where the way there slides.


class _Node(NamedTuple):
    """The position of a node on a body: a sum of parts, and the directions in which it slides."""

    position: tuple[Part, ...]
    slides: tuple[tuple[float, int], ...]


def equations_of_vectors(read: LoopVectors) -> Equations:
    """The equations of vector loops."""
    rows = _Dimensions()
    lines: dict[str, Part] = {}
    for name, vector in read.vectors.items():
        path: Path = ('vectors', name)
        length = vector.length if vector.length is not None else 0.0
        is_same = vector.turns_with and vector.turns_with != name and not vector.angle
        free_angle = vector.turns_with == name or is_same
        of_length = (*path, 'length') if vector.length is not None else ()
        first = rows.add(f'{name}.length', length, 'length', of_length)
        of_angle = () if free_angle else (*path, 'angle')
        second = rows.add(f'{name}.angle', vector.angle, 'angle', of_angle)
        lines[name] = Part(1.0, True, first, second)
    bodies: dict[str, dict[object, _Node]] = {}
    frames: dict[str, tuple[str, tuple[Part, ...]]] = {}
    for name in [*(n for n, vector in read.vectors.items() if vector.turns_with), GROUND]:
        turns_with = None if name == GROUND else read.vectors[name].turns_with
        origin = frozenset() if name == GROUND else read.ends[name][0]
        carrier = next(
            (
                body
                for body, nodes in bodies.items()
                if body != GROUND
                and read.vectors[body].turns_with == turns_with
                and origin in nodes
                and not nodes[origin].slides
            ),
            None,
        )
        if carrier is not None and name != GROUND:
            frames[name] = carrier, bodies[carrier][origin].position
            continue
        bodies[name] = _nodes_on(read, turns_with, origin, lines)
        frames[name] = name, ()
    del frames[GROUND]
    return Equations(tuple(bodies), tuple(rows.rows), tuple(_node_equations(bodies)), frames)


def _nodes_on(
    read: LoopVectors, turns_with: str | None, origin: object, lines: dict[str, Part]
) -> dict[object, _Node]:
    """All nodes on a body, from its origin along vectors that turn with it, rigid ones first."""
    nodes = {origin: _Node((), ())}
    own = [name for name, vector in read.vectors.items() if vector.turns_with == turns_with]

    def grows(rigid: bool) -> bool:
        """Whether any vector leads to new nodes, which are then added."""
        before = len(nodes)
        for name in own:
            fixed = read.vectors[name].length is not None
            if name not in read.ends or (rigid and not fixed):
                continue
            tail, head = read.ends[name]
            for near, far, sign in ((tail, head, 1.0), (head, tail, -1.0)):
                if near not in nodes or far in nodes:
                    continue
                node, part = nodes[near], lines[name]._replace(sign=sign)
                if fixed:
                    nodes[far] = node._replace(position=(*node.position, part))
                else:
                    nodes[far] = node._replace(slides=(*node.slides, (sign, part.second)))
        return len(nodes) > before

    for rigid in (True, False):
        while grows(rigid):
            pass
    return nodes


def _node_equations(bodies: dict[str, dict[object, _Node]]) -> Iterator[Equation]:
    """A pin or slot for each node that several bodies have."""
    for node in dict.fromkeys(node for nodes in bodies.values() for node in nodes):
        having = [(body, nodes[node]) for body, nodes in bodies.items() if node in nodes]
        rigid = [(body, at) for body, at in having if not at.slides]
        if not rigid or len(having) < 2:
            continue
        first, position = rigid[0]
        for body, at in having:
            if body != first and len(at.slides) <= 1:
                kind, sizes = (Slot, {'along': at.slides[0][1]}) if at.slides else (Revolute, {})
                name, place = f'{first}-{body}', position.position
                yield Equation(kind, name, body, at.position, first, place, sizes)
