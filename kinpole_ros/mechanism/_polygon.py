"""
Velocity and acceleration polygons of a linkage: image points, and vectors between them with parts.

The polygon of order 0 is the linkage itself, so that its links can be compared with the vectors
(seed 001, eq. 2 to 4 and Fig. 2; seed 003, part 3).
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly, poses_of
from kinpole_ros.mechanism._belt import Belt
from kinpole_ros.mechanism._joint_kinds import GROUND
from kinpole_ros.mechanism._mechanism import Motion
from kinpole_ros.mechanism._motions import rotation_derivatives
from kinpole_ros.mechanism._scene import Scene
from kinpole_ros.planar._plane import Complex, Real

# Image points nearer than this share of the largest vector are one.
_COINCIDENT = 1e-9

# Points of each body by name, complex, m, in its frame.
BodyPoints = dict[str, dict[str, complex]]


class Side(NamedTuple):
    """
    A vector of a polygon: the derivative of r e^{iθ} from one point of the linkage to another.

    `name` is its head and, if that moves, its tail ('BA' is B relative to A), or that of a vector
    of a loop. It starts at the image `tail`; `parts`, in this order normal, tangential, Coriolis,
    slide and winding, add up to it. `body` is that on which it is a line, empty for slides, struts
    and belts.
    """

    name: str
    body: str
    tail: complex
    parts: dict[str, complex]

    @property
    def vector(self) -> complex:
        """The sum of the parts."""
        return sum(self.parts.values(), 0j)

    @property
    def head(self) -> complex:
        """The image point at which it ends."""
        return self.tail + self.vector


class Polygon(NamedTuple):
    """
    Image points by name, m/s^order relative to the pole at 0, and the vectors between them.

    Points of one image share an entry, their names separated by commas; those of the ground are at
    the pole. `shapes` are the images of bodies of three and more points, which are similar to
    these.
    """

    order: int
    points: dict[str, complex]
    sides: tuple[Side, ...]
    shapes: tuple[tuple[complex, ...], ...]


def polygon(scene: Scene, motion: Motion, order: int) -> Polygon:
    """
    Construct the polygon of a scene at one position.

    Parameters
    ----------
    scene
        The scene.
    motion
        Its motion at that position, which is the first of (..., T).
    order
        1 for velocities, 2 for accelerations, 0 for the linkage itself.

    Returns
    -------
    Polygon
        In m/s^order, complex, in the ground's axes.

    Notes
    -----
    Seed 001, eq. 2 to 4: v_B = v_A + w x r_BA and a_B = a_A + α x r_BA + w x (w x r_BA).

    """
    assembly = scene.mechanism.assembly
    parts = motion.position, motion.angle, motion.values
    position, angle, values = (part[:3, :, 0] for part in parts)
    turn = rotation_derivatives(angle)

    def image(body: str, point: complex, at: int = order) -> complex:
        """The position of a point of a body, or a derivative of that."""
        if body == GROUND:
            return 0j if at else point
        b = assembly.bodies.index(body)
        return complex(position[at, b] + point * turn[at, b])

    def rate(body: str) -> float:
        return 0.0 if body == GROUND else float(angle[1, assembly.bodies.index(body)])

    points = _body_points(scene, values[0])
    sides = list(_loop_sides(scene, position[order], values, order))
    shapes, drawn, on_ground = [], set(points[GROUND]), points[GROUND]
    for b, body in enumerate(assembly.bodies):
        images = {name: image(body, point) for name, point in points[body].items()}
        # From the ground, or from a body before.
        first = min(images, key=lambda name: (name not in on_ground, name not in drawn), default='')
        drawn |= {*images}
        # A wheel's point of contact with the ground has no velocity, but an acceleration.
        largest = max(map(abs, images.values()), default=0.0)
        at_rest = first in on_ground and abs(images[first]) <= _COINCIDENT * largest
        for name in images if assembly.joints else ():
            arm = image(body, points[body][name], 0) - image(body, points[body][first], 0)
            if arm:
                length = np.array([abs(arm), 0.0, 0.0])
                components = _components(order, length, np.append(np.angle(arm), angle[1:, b]))
                label = name if at_rest else _relative_name(name, first)
                sides.append(Side(label, body, images[first], components))
        if len(images) > 2:
            shapes.append(tuple(images.values()))
    sides += _joint_sides(assembly, points, image, rate, values, order)
    return Polygon(order, _merged(points, image), tuple(sides), tuple(shapes))


def _relative_name(head: str, tail: str) -> str:
    """The name of a vector from one point to another."""
    return head + tail if len(head) == len(tail) == 1 else f'{head}/{tail}'


def _body_points(scene: Scene, values: Real) -> BodyPoints:
    """The points of each body by name, in its frame, those of contact of wheels and belts first."""
    assembly = scene.mechanism.assembly
    poses = poses_of(assembly, values[:, None])
    points: BodyPoints = {body: {} for body in poses}
    rolling = [joint for joint in assembly.joints if joint.center().kind == 'contact']
    for joint in rolling:
        at, _ = joint.contact(poses[joint.one], poses[joint.other])
        for body in (joint.one, joint.other):
            pose = poses[body]
            name = 'contact' if len(rolling) == 1 else f'contact {joint.name}'
            points[body][name] = complex(((at - pose.position) * pose.turn.conj())[0])
    for belt in assembly.joints:
        if isinstance(belt, Belt):
            _, axis = belt.contact(poses[belt.one], poses[belt.other])
            ends = (belt.one, belt.a), (belt.other, belt.b)
            for (body, hub), radius in zip(ends, belt.radii, strict=True):
                if radius:
                    arm = 1j * radius * complex((axis * poses[body].turn.conj())[0])
                    points[body][_end_name(belt, body)] = hub + arm
    for name, (body, point) in scene.points.items():
        points[body][name.rpartition('.')[2]] = point
    return points


def _end_name(belt: Belt, body: str) -> str:
    """The name of the point at which a belt leaves the wheel on a body."""
    return f'{belt.name} on {body}'


def _merged(points: BodyPoints, image: Callable[[str, complex], complex]) -> dict[str, complex]:
    """Image points of all bodies; a name with two different images is that of a body."""
    images = [
        (body, name, image(body, z)) for body, row in points.items() for name, z in row.items()
    ]
    near = _COINCIDENT * max((abs(z) for *_, z in images), default=0.0)
    named: dict[str, complex] = {}
    for body, name, z in images:
        if name in named and abs(named[name] - z) > near:
            name = f'{name} of {body}'
        named.setdefault(name, z)
    groups: dict[complex, list[str]] = {}
    for name, z in named.items():
        groups.setdefault(next((w for w in groups if abs(w - z) <= near), z), []).append(name)
    return {', '.join(names): z for z, names in groups.items()}


def _components(order: int, length: Real, turn: Real) -> dict[str, complex]:
    """The derivative of r e^{iθ} by its components, from r and θ with two derivatives each."""
    (r, dr, ddr), e = length, np.exp(1j * turn[0])
    if order == 0:
        return {'': complex(r * e)}
    if order == 1:
        return {'tangential': complex(1j * r * turn[1] * e), 'slide': complex(dr * e)}
    return {
        'normal': complex(-r * turn[1] ** 2 * e),
        'tangential': complex(1j * r * turn[2] * e),
        'Coriolis': complex(2j * dr * turn[1] * e),
        'slide': complex(ddr * e),
    }


def _joint_sides(
    assembly: Assembly,
    points: BodyPoints,
    image: Callable[[str, complex], complex],
    rate: Callable[[str], float],
    values: Real,
    order: int,
) -> Iterator[Side]:
    """
    Vectors along slides and struts, from the point `a` of one body to `b` of the other.

    Also along belts, from wheel to wheel. The free part of a strand keeps its length, so its ends
    differ by what turns it. The point of the wheel below an end has the velocity of the end. Its
    acceleration has r (φ' - θ')² to the hub more, since it is on a circle as seen from the strand:
    the winding.
    """
    rows = dict(zip(assembly.loops.variables, values.T, strict=True)) | {GROUND: np.zeros(3)}
    for joint in assembly.joints:
        if isinstance(joint, Belt):
            length, turn = rows[joint.name], rows[f'{joint.name}.angle']
            parts = _components(order, np.array([length[0], 0.0, 0.0]), turn)
            if order == 2:
                first, last = (
                    radius * (turn[1] - rate(body)) ** 2
                    for radius, body in zip(joint.radii, (joint.one, joint.other), strict=True)
                )
                parts['winding'] = complex(1j * (first - last) * np.exp(1j * turn[0]))
            at = points[joint.one].get(_end_name(joint, joint.one), joint.a)
            yield Side(joint.name, '', image(joint.one, at), parts)
        terms = joint.loop_form().terms
        if len(terms) != 1 or not terms[0].slide or joint.rims():
            continue
        turn = rows[terms[0].turn] + np.array([terms[0].offset, 0.0, 0.0])
        head, tail = (
            next(name for name, z in points[body].items() if z == point)
            for body, point in ((joint.other, joint.b), (joint.one, joint.a))
        )
        components = _components(order, rows[joint.name], turn)
        at_rest = terms[0].turn == GROUND
        label = head if at_rest else _relative_name(head, tail)
        yield Side(label, '', image(joint.one, joint.a), components)


def _loop_sides(scene: Scene, tails: Complex, values: Real, order: int) -> Iterator[Side]:
    """The moving vectors of a scene in loop form, by their names, each at its tail in the loop."""
    assembly = scene.mechanism.assembly
    if assembly.joints:
        return
    loops = assembly.loops
    # The dimensions are those of the vectors, in their order.
    lengths = [row.name for row in scene.equations.dimensions if row.name.endswith('.length')]
    terms = {name.removesuffix('.length'): k for k, name in enumerate(lengths)}
    length, turn = loops.lengths @ values.T, loops.angles @ values.T
    length[:, 0] += loops.length0
    turn[:, 0] += loops.angle0
    components = {name: _components(order, length[k], turn[k]) for name, k in terms.items()}
    starts = dict(zip(assembly.bodies, tails.tolist(), strict=True))
    for signs, around in zip(loops.loops, loops.around, strict=True):
        # A slide in a fixed direction is no body: it starts at the end of the vector before it.
        first = next((k for k, name in enumerate(around) if name in starts), 0)
        at = None
        for name in around[first:] + around[:first]:
            vector, forward = sum(components[name].values()), signs[terms[name]] > 0
            if at is None:
                at = starts.get(name, 0j) + (0 if forward else vector)
            starts.setdefault(name, at if forward else at - vector)
            at += vector if forward else -vector
    for name, k in terms.items():
        if name in starts and (loops.lengths[k].any() or loops.angles[k].any()):
            body = name if name in assembly.bodies else ''
            yield Side(name, body, starts[name], components[name])
