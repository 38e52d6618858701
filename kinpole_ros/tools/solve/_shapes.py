"""
The lines by which a scene is drawn, the same in every picture.

They are links, wheels, cams, Geneva wheels and slots on the bodies, and cylinders, springs and
belts between them.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.mechanism import GROUND, Belt, Scene, Slot, Spring, Strut, polygon
from kinpole_ros.mechanism._arc_slot import ArcSlot
from kinpole_ros.mechanism._assembly import poses_of
from kinpole_ros.mechanism._belt import strand
from kinpole_ros.mechanism._joint_kinds import Rim
from kinpole_ros.mechanism._vector_joints import joints_of
from kinpole_ros.tools.solve._solution import SolvedScene

# As shares of its least length: the barrel of a cylinder, half the width of a
# cylinder or spring; and the straight ends and the turns of a spring.
_BARREL, _HALF_WIDTH, _SPRING_END, _SPRING_TURNS = 0.7, 0.06, 0.12, 7
INK = '#1c2127'
BODY_COLORS = ('#000000', '#0060a8', '#a83200', '#00785a', '#7a4fa0', '#777777')
# A vector shorter than this, m, has no direction.
_NO_LENGTH = 1e-12

_BodyPoint = tuple[str, complex]


class DrawnLine(NamedTuple):
    """
    A line of points (n,), complex, m; its `kind` is 'link', 'wheel', 'contour', 'guide' or 'span'.

    It is in the frame of its `body`, or, with no body, in the plane.
    """

    kind: str
    body: str
    points: np.ndarray


class DrawnSpan(NamedTuple):
    """
    A cylinder or spring between two points of bodies.

    Its `lines` are points (n, 3): the share of the way between its ends, then m along and m to the
    left. Where it is shorter than `least`, m, the second part shrinks.
    """

    ends: tuple[_BodyPoint, _BodyPoint]
    least: float
    lines: tuple[np.ndarray, ...]

    def between(self, a: complex, b: complex) -> list[np.ndarray]:
        """Return its lines in the plane, with its ends at `a` and `b`."""
        length = abs(b - a)
        direction = (b - a) / length if length > _NO_LENGTH else 1.0
        shrink = min(1.0, length / self.least)
        return [
            a + direction * (length * share + shrink * along + 1j * left)
            for share, along, left in (line.T for line in self.lines)
        ]


def rims_of(scene: Scene, body: str) -> list[Rim]:
    """Return the circles of a body that roll, are rolled on, or carry belts."""
    rims = [rim for joint in scene.mechanism.assembly.joints for rim in joint.rims()]
    return list(dict.fromkeys(rim for rim in rims if rim.body == body))


def outline_of(scene: Scene, body: str) -> np.ndarray:
    """Return points of a body (n,), complex, m, in its frame: named, on spokes, of its vector."""
    points = [point for owner, point in scene.points.values() if owner == body]
    for rim in rims_of(scene, body):
        points += [rim.hub, rim.hub + rim.radius]  # a spoke shows that a wheel turns
    if not scene.mechanism.assembly.joints:
        points += [0j, body_vector(scene, body)]
    return np.array(list(dict.fromkeys(points)) or [0j])


def body_vector(scene: Scene, body: str) -> complex:
    """Return the vector that is the body, m, in a scene of vector loops without joints."""
    # Each vector that turns is a body, in the same order.
    loops = scene.mechanism.assembly.loops
    term = np.flatnonzero(loops.angles.any(axis=1))[scene.mechanism.bodies.index(body)]
    return complex(loops.length0[term] * np.exp(1j * loops.angle0[term]))


class SceneLines:
    """
    The lines of a scene over its motion.

    `on_bodies` are those on the bodies, in their frames; slots are as long as the motion needs.
    `spans` are cylinders and springs, of which the sizes follow from their least lengths.
    """

    def __init__(self, motion: SolvedScene) -> None:
        scene, assembly = motion.scene, motion.scene.mechanism.assembly
        values = dict(zip(assembly.loops.variables, motion.values, strict=True))
        self.on_bodies = [*_links_and_wheels(scene), *_guides(scene, values)]
        self.on_bodies += [
            DrawnLine('contour', body, points)
            for follower in assembly.followers
            for body, points in (follower.shape.outlines() if follower.shape else ())
        ]
        self.spans: list[DrawnSpan] = []
        poses = poses_of(assembly, motion.values)
        spans: list[Strut | Spring] = [j for j in joints_of(scene) if isinstance(j, Strut)]
        spans += [spring for spring in scene.springs if isinstance(spring, Spring)]
        for one in spans:
            ends = (one.one, one.a), (one.other, one.b)
            tail, head = (poses[body].point(point) for body, point in ends)
            least, lines = float(np.abs(head - tail).min()), _spring
            if isinstance(one, Strut):
                # Not from where it could begin, but from where its driver begins.
                names = one.name, f'{one.name}.length'
                driven = (d.low for d in scene.mechanism.drivers if d.name in names)
                least, lines = max(least, *driven, _NO_LENGTH), _cylinder
            self.spans.append(DrawnSpan(ends, least, lines(least)))
        self._struts = [one.name for one in spans if isinstance(one, Strut)]

    def at(self, here: SolvedScene) -> list[DrawnLine]:
        """Return all lines in the plane, at the first position of `here`."""
        poses = poses_of(here.scene.mechanism.assembly, here.values[:, :1])

        def place(body: str, points: Any) -> Any:
            return poses[body].position[0] + points * poses[body].turn[0]

        lines = [one._replace(points=place(one.body, one.points)) for one in self.on_bodies]
        return [*lines, *self.between_bodies(here)]

    def between_bodies(self, here: SolvedScene) -> Iterator[DrawnLine]:
        """Yield cylinders, springs, belts and vectors in the plane, at the first position."""
        poses = poses_of(here.scene.mechanism.assembly, here.values[:, :1])
        belts = [one for one in here.scene.mechanism.assembly.joints if isinstance(one, Belt)]
        for span in self.spans:
            tail, head = (complex(poses[body].point(z)[0]) for body, z in span.ends)
            yield from (DrawnLine('span', '', line) for line in span.between(tail, head))
        for belt in belts:
            tail = complex(poses[belt.one].point(belt.a)[0])
            head = complex(poses[belt.other].point(belt.b)[0])
            yield from (DrawnLine('span', '', line) for line in belt_strands(belt, tail, head))
        has_vectors = not here.scene.mechanism.assembly.joints
        for side in polygon(here.scene, here.motion, 0).sides if has_vectors else ():
            if side.name not in self._struts:
                kind = 'link' if side.body else 'guide'
                yield DrawnLine(kind, side.body, np.array([side.tail, side.head]))


def _links_and_wheels(scene: Scene) -> Iterator[DrawnLine]:
    """Yield the links of a scene with joints, and all wheels with a spoke."""
    assembly, circle = scene.mechanism.assembly, np.exp(1j * np.linspace(0, 2 * np.pi, 73))
    for body in (*assembly.bodies, GROUND):
        corners = np.array([z for owner, z in scene.points.values() if owner == body])
        if body != GROUND and len(corners) > 1 and assembly.joints:
            closed = np.append(corners, corners[:1]) if len(corners) > 2 else corners
            yield DrawnLine('link', body, closed)
        for rim in rims_of(scene, body):
            line = np.append(0, circle) if rim.is_wheel else circle
            yield DrawnLine('wheel', body, rim.hub + rim.radius * line)


def _guides(scene: Scene, values: dict[str, np.ndarray]) -> Iterator[DrawnLine]:
    """Yield the ways of points in slots, for variables (T,) by name."""
    for joint in scene.mechanism.assembly.joints:
        if isinstance(joint, Slot):
            ends = np.array([values[joint.name].min(), values[joint.name].max()])
            yield DrawnLine('guide', joint.one, joint.a + ends * np.exp(1j * joint.along))
        elif isinstance(joint, ArcSlot):
            turned = values[joint.name] - values.get(joint.one, 0.0)
            turned = np.linspace(turned.min(), min(turned.max(), turned.min() + 2 * np.pi), 73)
            yield DrawnLine('guide', joint.one, joint.a + joint.circle * np.exp(1j * turned))


def _cylinder(least: float) -> tuple[np.ndarray, ...]:
    """Return the barrel and the rod of a cylinder with this least length, m."""
    barrel, half = _BARREL * least, _HALF_WIDTH * least
    around = [(barrel / 8, -half), (barrel, -half), (barrel, half), (barrel / 8, half)]
    box = np.array([(0.0, x, y) for x, y in (*around, around[0])])
    return box, np.array([(0, 0, 0), (0, barrel / 8, 0)]), np.array([(0, barrel, 0), (1, 0, 0)])


def _spring(least: float) -> tuple[np.ndarray, ...]:
    """Return the zigzag of a spring with this least length, m."""
    shares = np.linspace(_SPRING_END, 1 - _SPRING_END, 2 * _SPRING_TURNS + 2)
    left = _HALF_WIDTH * least * np.array([0, *([1, -1] * _SPRING_TURNS), 0])
    zigzag = np.column_stack((shares, np.zeros_like(shares), left))
    return (np.concatenate(([[0.0, 0, 0]], zigzag, [[1.0, 0, 0]])),)


def belt_strands(belt: Belt, a: complex, b: complex) -> list[np.ndarray]:
    """Return the straight parts of a belt with hubs at `a` and `b`: both of one that is closed."""
    strands = []
    for side in (1, -1) if belt.is_carried else (1,):
        first, last = (side * radius for radius in belt.radii)
        _, axis = strand(belt.changed(radii=(first, last)), np.array(b - a))
        strands.append(np.array([a + 1j * first * axis, b + 1j * last * axis]))
    return strands


def drawn_data(motion: SolvedScene) -> dict[str, list[dict[str, Any]]]:
    """
    Return for the page what links and wheels do not show: belts, spans, and lines on bodies.

    Bodies are names, the ground ''; an end of a span has the name of its point.
    """
    scene, drawn = motion.scene, SceneLines(motion)
    names = {point: name.rpartition('.')[2] for name, point in scene.points.items()}

    def body_name(body: str) -> str:
        return body if body in scene.mechanism.bodies else ''

    def end(body: str, at: complex) -> dict[str, Any]:
        name = names.get((body, at), '')
        return {'body': body_name(body), 'name': name, 'at': [at.real, at.imag]}

    belts = [joint for joint in scene.mechanism.assembly.joints if isinstance(joint, Belt)]
    return {
        'belts': [
            {
                'ends': [
                    end(belt.one, belt.a) | {'radius': belt.radii[0]},
                    end(belt.other, belt.b) | {'radius': belt.radii[1]},
                ],
                'closed': belt.carrier is not None,
            }
            for belt in belts
        ],
        'spans': [
            {
                'ends': [end(*one) for one in span.ends],
                'least': span.least,
                'lines': [line.tolist() for line in span.lines],
            }
            for span in drawn.spans
        ],
        'shapes': [
            {
                'body': body_name(line.body),
                'kind': line.kind,
                'points': np.round([line.points.real, line.points.imag], 6).T.tolist(),
            }
            for line in drawn.on_bodies
            if line.kind in ('contour', 'guide') or (line.kind, line.body) == ('wheel', GROUND)
        ],
    }
