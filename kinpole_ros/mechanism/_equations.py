"""
A scene as equations between the poses of its bodies, with its dimensions as unknowns.

What `_assembly` writes as loops to be solved is here what measured poses have to meet: each joint
says where a point of one body is on another, whatever drives the mechanism. Each dimension is named
and remembers where the scene's file has it.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from kinpole_ros.mechanism._assembly import GROUND, Belt, Joint, Revolute, Rolling, Slot, Strut
from kinpole_ros.mechanism._vectors import Vectors

Path = tuple[str | int, ...]


class Dimension(NamedTuple):
    """
    A length (m) or angle (rad) of a scene: `name` for people, `value`, `kind`, and its `path`.

    Both coordinates of a point have the point's name; `axis` says which. The path is that in the
    scene's file, empty for what no scene states.
    """

    name: str
    value: float
    kind: str
    path: Path
    axis: int = 0


class Part(NamedTuple):
    """Of a sum of vectors: `sign` times (x, y), or times a length at an angle (`polar`)."""

    sign: float
    polar: bool
    first: int
    second: int


class Equation(NamedTuple):
    """
    What a joint says: the point `b` of the body `other` is at the point `a` of `one` (a pin).

    With `along` it may be off it in that direction only (a slot); with `turned` the bodies do not
    turn against each other (a guide). With `radius` it is the hub of a wheel that rolls: on the
    line, or without `along` on a `circle`. Points are sums of parts, all else numbers of
    dimensions.
    """

    name: str
    one: str
    a: tuple[Part, ...]
    other: str
    b: tuple[Part, ...]
    along: int | None = None
    turned: int | None = None
    radius: int | None = None
    circle: int | None = None
    start: int | None = None


class Equations(NamedTuple):
    """
    All equations of a scene, between `bodies` (the ground last), and its dimensions.

    `frames` says of each body of the scene in which of the `bodies` its frame lies, and where its
    origin is there: vectors that turn with each other are one body.
    """

    bodies: tuple[str, ...]
    dimensions: tuple[Dimension, ...]
    joints: tuple[Equation, ...]
    frames: dict[str, tuple[str, tuple[Part, ...]]]


class _Dimensions:
    """A growing list of dimensions, each kept once."""

    def __init__(self) -> None:
        self.rows: list[Dimension] = []
        self._places: dict[tuple[Path, int], int] = {}

    def add(self, name: str, value: float, kind: str, path: Path, axis: int = 0) -> int:
        key = path, axis
        if not path or key not in self._places:
            self._places[key] = len(self.rows)
            self.rows.append(Dimension(name, value, kind, path, axis))
        return self._places[key]

    def point(self, body: str, point: str, place: complex) -> tuple[Part, ...]:
        """The coordinates of a body's point."""
        rows = [
            self.add(f'{body}.{point}', value, 'length', ('bodies', body, point), axis)
            for axis, value in enumerate((place.real, place.imag))
        ]
        return (Part(1.0, False, rows[0], rows[1]),)


def equations_of_joints(
    bodies: Sequence[str], joints: Sequence[Joint], said: Mapping[int, dict[str, Any]]
) -> Equations:
    """
    Those of bodies (without the ground) on joints.

    `said` are the last of these, by their places in the file's list.
    """
    rows = _Dimensions()
    found = []
    places = [-1] * (len(joints) - len(said)) + list(said)
    for k, joint in zip(places, joints, strict=True):
        if isinstance(joint, Strut | Belt):
            continue
        if isinstance(joint, Revolute):
            point = joint.name.partition('.')[0]
            a = rows.point(joint.one, point, joint.a)
            b = rows.point(joint.other, point, joint.b)
            found.append(Equation(joint.name, joint.one, a, joint.other, b))
            continue
        words = said[k]
        kind = next(key for key in ('slot', 'prismatic', 'rolling') if key in words)
        a = rows.point(joint.one, words['on'].partition('.')[2], joint.a)
        b = rows.point(joint.other, words[kind].partition('.')[2], joint.b)
        path: Path = ('joints', k)
        equation = Equation(joint.name, joint.one, a, joint.other, b)

        def number(key: str, value: float, kind: str, at: Path = path, of: Joint = joint) -> int:
            return rows.add(f'{of.name}.{key}', value, kind, (*at, key))

        if isinstance(joint, Slot):
            equation = equation._replace(along=number('along', joint.along, 'angle'))
            if joint.turned is not None:
                equation = equation._replace(turned=number('turned', joint.turned, 'angle'))
        elif isinstance(joint, Rolling):
            on_line = not joint.circle
            of_start = 'length' if on_line else 'angle'
            equation = equation._replace(
                radius=number('radius', joint.radius, 'length'),
                # Which tooth is in which gap no scene can know.
                start=rows.add(f'{joint.name}.start', joint.start, of_start, ()),
            )
            if on_line:
                equation = equation._replace(along=number('along', joint.along, 'angle'))
            else:
                equation = equation._replace(circle=number('circle', joint.circle, 'length'))
        found.append(equation)
    own: dict[str, tuple[str, tuple[Part, ...]]] = {body: (body, ()) for body in bodies}
    return Equations((*bodies, GROUND), tuple(rows.rows), tuple(found), own)


# Vector loops. A vector that turns with another is on the body of that one: each is a line between
# two nodes, and a node that two bodies have is a pin, or a slot where the way there slides.


class _Reached(NamedTuple):
    """Where a node is on a body: a sum of parts, and the direction in which it may slide."""

    place: tuple[Part, ...]
    slides: tuple[tuple[float, int], ...]


def equations_of_vectors(read: Vectors) -> Equations:
    """Those of vector loops."""
    rows = _Dimensions()
    lines: dict[str, Part] = {}
    for name, one in read.vectors.items():
        path: Path = ('vectors', name)
        length = one.length if one.length is not None else 0.0
        of_length = (*path, 'length') if one.length is not None else ()
        of_angle = (
            () if one.turns_with == name or (one.turns_with and not one.angle) else (*path, 'angle')
        )
        first = rows.add(f'{name}.length', length, 'length', of_length)
        second = rows.add(f'{name}.angle', one.angle, 'angle', of_angle)
        lines[name] = Part(1.0, True, first, second)
    bodies: dict[str, dict[object, _Reached]] = {}
    frames: dict[str, tuple[str, tuple[Part, ...]]] = {}
    for name in [*(n for n, one in read.vectors.items() if one.turns_with), GROUND]:
        turns_with = None if name == GROUND else read.vectors[name].turns_with
        origin = frozenset() if name == GROUND else read.ends[name][0]
        home = next(
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
        if home is not None and name != GROUND:
            frames[name] = home, bodies[home][origin].place
            continue
        bodies[name] = _reach(read, turns_with, origin, lines)
        frames[name] = name, ()
    del frames[GROUND]
    return Equations(tuple(bodies), tuple(rows.rows), tuple(_nodes(bodies, rows)), frames)


def _reach(
    read: Vectors, turns_with: str | None, origin: object, lines: dict[str, Part]
) -> dict[object, _Reached]:
    """All nodes on a body, from its origin along vectors that turn with it, rigid ones first."""
    found = {origin: _Reached((), ())}
    own = [name for name, one in read.vectors.items() if one.turns_with == turns_with]
    for rigid in (True, False):
        grown = True
        while grown:
            grown = False
            for name in own:
                fixed = read.vectors[name].length is not None
                ends = read.ends.get(name)
                if ends is None or (rigid and not fixed):
                    continue
                for here, there, sign in ((*ends, 1.0), (*ends[::-1], -1.0)):
                    if here not in found or there in found:
                        continue
                    part = lines[name]._replace(sign=sign)
                    before = found[here]
                    found[there] = (
                        before._replace(place=(*before.place, part))
                        if fixed
                        else before._replace(slides=(*before.slides, (sign, part.second)))
                    )
                    grown = True
    return found


def _nodes(bodies: dict[str, dict[object, _Reached]], rows: _Dimensions) -> Iterator[Equation]:
    """A pin or slot for each node that several bodies have."""
    for node in dict.fromkeys(node for nodes in bodies.values() for node in nodes):
        having = [(body, nodes[node]) for body, nodes in bodies.items() if node in nodes]
        rigid = [(body, at) for body, at in having if not at.slides]
        if not rigid or len(having) < 2:
            continue
        first, place = rigid[0]
        for body, at in having:
            if body == first or len(at.slides) > 1:
                continue
            name = f'{first}-{body}'
            equation = Equation(name, body, at.place, first, place.place)
            yield equation._replace(along=at.slides[0][1]) if at.slides else equation
