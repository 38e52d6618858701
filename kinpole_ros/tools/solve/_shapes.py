"""The shapes of the bodies of a scene: points, vectors, wheels and belts."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from kinpole_ros.mechanism import GROUND, Belt, Scene
from kinpole_ros.mechanism._joint_kinds import Rim
from kinpole_ros.tools.solve._solution import SolvedScene


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


def belts_of(scene: Scene) -> list[dict[str, Any]]:
    """Return the belts as the page has them: bodies, hubs in their frames, and radii."""

    def end(body: str, hub: complex, radius: float) -> dict[str, Any]:
        name = body if body in scene.mechanism.bodies else ''
        return {'body': name, 'at': [hub.real, hub.imag], 'radius': radius}

    belts = (joint for joint in scene.mechanism.assembly.joints if isinstance(joint, Belt))
    return [
        {
            'ends': [
                end(belt.one, belt.a, belt.radii[0]),
                end(belt.other, belt.b, belt.radii[1]),
            ],
            'closed': belt.carrier is not None,
        }
        for belt in belts
    ]


def wheel_lines(here: SolvedScene) -> Iterator[tuple[int, np.ndarray]]:
    """
    Yield lines of wheels and belts at the first position, complex, with the number of the body.

    They are wheels with a spoke, the circles that wheels roll on, and the strands of belts; the
    number of the ground is -1.
    """
    mechanism = here.scene.mechanism
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 73))
    wheel = np.append(0, circle)

    def on_body(body: str, z: complex | np.ndarray) -> tuple[int, Any]:
        if body not in mechanism.bodies:
            return -1, z
        b = mechanism.bodies.index(body)
        return b, here.motion.position[0, b, 0] + z * np.exp(1j * here.motion.angle[0, b, 0])

    for body in (*mechanism.bodies, GROUND):
        for rim in rims_of(here.scene, body):
            yield on_body(body, rim.hub + rim.radius * (wheel if rim.is_wheel else circle))
    values = dict(zip(mechanism.assembly.loops.variables, here.values[:, 0], strict=True))
    for joint in mechanism.assembly.joints:
        if isinstance(joint, Belt):
            ends = np.array([0.0, values[joint.name]]) + 1j * joint.radii[0]
            strand = ends * np.exp(1j * values[f'{joint.name}.angle'])
            yield -1, on_body(joint.one, joint.a)[1] + strand
