"""
Velocity and acceleration polygons of a linkage: image points, and vectors between them with parts.

The polygon of order 0 is the linkage itself, so that its links can be held against the vectors
(seed 001, eq. 2 to 4 and Fig. 2; seed 003, part 3).
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly
from kinpole_ros.mechanism._joints import GROUND, Rolling, Slot, Strut
from kinpole_ros.mechanism._mechanism import Motion
from kinpole_ros.mechanism._motions import rotation_derivatives
from kinpole_ros.mechanism._scene import Scene
from kinpole_ros.planar._plane import Complex, Real

# Image points nearer than this share of the largest vector are one.
_SAME = 1e-9

Places = dict[str, dict[str, complex]]


class Side(NamedTuple):
    """
    A vector of a polygon: the derivative of r e^{iθ} from one point of the linkage to another.

    `name` is its head and, if that moves, its tail ('BA' is B as seen from A), or that of a vector
    of a loop. It starts at the image `tail`; `parts`, in this order normal, tangential, Coriolis
    and slide, add up to it. `body` is that on which it is a line, empty for slides and struts.
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
    Image points by name, m/s^order as seen from the pole at 0, and the vectors between them.

    Points of one image share an entry, their names joined by commas; those of the ground are at the
    pole. `shapes` are the images of bodies of three and more points, which are similar to these.
    """

    order: int
    points: dict[str, complex]
    sides: tuple[Side, ...]
    shapes: tuple[tuple[complex, ...], ...]


def polygon(scene: Scene, motion: Motion, order: int) -> Polygon:
    """
    Draw up the polygon of a scene at one position.

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
    bodies = scene.mechanism.bodies
    position, angle, values = (
        part[:3, :, 0] for part in (motion.position, motion.angle, motion.values)
    )
    turn = rotation_derivatives(angle)

    def image(body: str, place: complex, at: int = order) -> complex:
        """Where a point of a body is, or the derivative of that."""
        if body == GROUND:
            return 0j if at else place
        b = bodies.index(body)
        return complex(position[at, b] + place * turn[at, b])

    places = _places(scene, image)
    sides = list(_loop_sides(scene, position[order], values, order))
    shapes, known = [], set(places[GROUND])
    for b, body in enumerate(bodies):
        images = {name: image(body, place) for name, place in places[body].items()}
        # From the ground, or from a body before.
        first = min(
            images, key=lambda name: (name not in places[GROUND], name not in known), default=''
        )
        known |= {*images}
        # Where a wheel touches the ground it has no velocity, but an acceleration.
        largest = max(map(abs, images.values()), default=0.0)
        at_rest = first in places[GROUND] and abs(images[first]) <= _SAME * largest
        for name in images if scene.mechanism.assembly.joints else ():
            arm = image(body, places[body][name], 0) - image(body, places[body][first], 0)
            if arm:
                length = np.array([abs(arm), 0.0, 0.0])
                parts = _parts(order, length, np.append(np.angle(arm), angle[1:, b]))
                of = name if at_rest else _of(name, first)
                sides.append(Side(of, body, images[first], parts))
        if len(images) > 2:
            shapes.append(tuple(images.values()))
    sides += _joint_sides(scene.mechanism.assembly, places, image, values, order)
    return Polygon(order, _merged(places, image), tuple(sides), tuple(shapes))


def _of(head: str, tail: str) -> str:
    """The name of a vector from one point to another."""
    return head + tail if len(head) == len(tail) == 1 else f'{head}/{tail}'


def _places(scene: Scene, image: Callable[[str, complex, int], complex]) -> Places:
    """The points of each body by name, in its frame, those at which wheels touch first."""
    found: Places = {body: {} for body in (GROUND, *scene.mechanism.bodies)}
    rolling = [j for j in scene.mechanism.assembly.joints if isinstance(j, Rolling)]
    for joint in rolling:
        hub, middle = image(joint.other, joint.b, 0), image(joint.one, joint.a, 0)
        along = image(joint.one, np.exp(1j * joint.along), 0) - image(joint.one, 0j, 0)
        way = (
            (hub - middle) * np.sign(joint.circle) / abs(hub - middle)
            if joint.circle
            else 1j * along
        )
        for body in (joint.one, joint.other):
            x = image(body, 1, 0) - image(body, 0j, 0)
            place = (hub - joint.radius * way - image(body, 0j, 0)) / x
            found[body]['contact' if len(rolling) == 1 else f'contact {joint.name}'] = place
    for name, (body, place) in scene.points.items():
        found[body][name.rpartition('.')[2]] = place
    return found


def _merged(places: Places, image: Callable[[str, complex], complex]) -> dict[str, complex]:
    """Image points of all bodies; one of two names with different images is named by its body."""
    named: dict[str, complex] = {}
    every = [
        (body, name, image(body, z)) for body, row in places.items() for name, z in row.items()
    ]
    near = _SAME * max((abs(z) for *_, z in every), default=0.0)
    for body, name, z in every:
        if name in named and abs(named[name] - z) > near:
            name = f'{name} of {body}'
        named.setdefault(name, z)
    groups: dict[complex, list[str]] = {}
    for name, z in named.items():
        groups.setdefault(next((w for w in groups if abs(w - z) <= near), z), []).append(name)
    return {', '.join(names): z for z, names in groups.items()}


def _parts(order: int, length: Real, turn: Real) -> dict[str, complex]:
    """The derivative of r e^{iθ} by its parts, from r and θ with two derivatives each."""
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
    places: Places,
    image: Callable[[str, complex], complex],
    values: Real,
    order: int,
) -> Iterator[Side]:
    """Along slides and struts, from the point `a` of one body to `b` of the other."""
    rows = dict(zip(assembly.loops.variables, values.T, strict=True)) | {GROUND: np.zeros(3)}
    for joint in assembly.joints:
        if isinstance(joint, Strut):
            turn = rows[f'{joint.name}.angle']
        elif isinstance(joint, Slot):
            turn = rows[joint.one] + np.array([joint.along, 0.0, 0.0])
        else:
            continue
        head, tail = (
            next(name for name, z in places[body].items() if z == place)
            for body, place in ((joint.other, joint.b), (joint.one, joint.a))
        )
        parts = _parts(order, rows[joint.name], turn)
        resting = isinstance(joint, Slot) and joint.one == GROUND
        yield Side(head if resting else _of(head, tail), '', image(joint.one, joint.a), parts)


def _loop_sides(scene: Scene, tails: Complex, values: Real, order: int) -> Iterator[Side]:
    """The vectors of a scene in loop form that move, by their names, each where its loop has it."""
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
    parts = {name: _parts(order, length[k], turn[k]) for name, k in terms.items()}
    starts = dict(zip(assembly.bodies, tails.tolist(), strict=True))
    for signs, around in zip(loops.loops, loops.around, strict=True):
        # A slide in a fixed direction is no body: it starts where the vector before it ends.
        first = next((k for k, name in enumerate(around) if name in starts), 0)
        here = None
        for name in around[first:] + around[:first]:
            vector, forward = sum(parts[name].values()), signs[terms[name]] > 0
            if here is None:
                here = starts.get(name, 0j) + (0 if forward else vector)
            starts.setdefault(name, here if forward else here - vector)
            here += vector if forward else -vector
    for name, k in terms.items():
        if name in starts and (loops.lengths[k].any() or loops.angles[k].any()):
            body = name if name in assembly.bodies else ''
            yield Side(name, body, starts[name], parts[name])
