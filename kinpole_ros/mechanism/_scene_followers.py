"""Cams and Geneva drives as a scene states them."""

from cmath import exp, phase
from collections.abc import Sequence
from math import pi, remainder
from typing import Any

import numpy as np

from kinpole_ros.mechanism._followers import Cam, Follower, Geneva
from kinpole_ros.mechanism._joint_kinds import GROUND, Joint, Revolute, Slot
from kinpole_ros.mechanism._laws import RISES, cam, geneva
from kinpole_ros.mechanism._scene_values import (
    Form,
    Points,
    SceneError,
    named_point,
    need,
    one_of,
    positive,
    quantity,
    refuse_one_body,
    refuse_unknown,
)


def carrier_of(names: Sequence[str], points: Points) -> tuple[str, complex] | None:
    """The third body that has the points of both names, and the vector from one to the other."""
    (first_body, a), (last_body, b) = (name.split('.') for name in names)
    for carrier in dict.fromkeys(body for body, _ in points.values()):
        first, last = points.get(f'{carrier}.{a}'), points.get(f'{carrier}.{b}')
        if carrier not in (first_body, last_body) and first and last:
            return carrier, last[1] - first[1]
    return None


def _geneva(
    where: str, entry: dict[str, Any], points: Points, _joints: Sequence[Joint]
) -> Follower:
    """The wheel's angle over the crank's, whose pin runs into its slots without shock."""
    refuse_unknown(where, entry, GENEVA.keys)
    where = f"{where[:-1]}, geneva'"
    need(where, entry, ('on', 'slots'), GENEVA.example)
    wheel, hub = named_point(where, entry['geneva'], points)
    crank, center = named_point(f'{where}: on', entry['on'], points)
    refuse_one_body(where, crank, wheel)
    slots = entry['slots']
    if not isinstance(slots, int) or isinstance(slots, bool) or not 3 <= slots <= 100:
        raise SceneError(f'{where}: slots is {slots!r}: give a whole number from 3 to 100')
    carrier = carrier_of([entry['on'], entry['geneva']], points)
    if carrier is None or carrier[1] == 0:
        raise SceneError(
            f'{where}: no body holds the distance of {entry["on"]} and {entry["geneva"]}: give '
            'it points of these names, as ground: {O: [0, 0], W: [0.1, 0]}'
        )
    toward = phase(carrier[1])
    pin = quantity(f'{where}: pin', entry.get('pin', 0.0), 'angle')
    slot = quantity(f'{where}: slot', entry.get('slot', 0.0), 'angle')
    # All slots of the wheel are equal: it starts with the least turn.
    offset = remainder(toward + pi - slot, 2 * pi / slots)
    law = geneva(slots, toward - pin, offset)
    hubs = tuple(entry[key].rpartition('.')[2] for key in ('on', 'geneva'))
    shape = Geneva(wheel, hub, slot, crank, center, pin, slots, abs(carrier[1]))
    return Follower(where, wheel, crank, carrier[0], law, hubs, shape)


def _cam(where: str, entry: dict[str, Any], points: Points, joints: Sequence[Joint]) -> Follower:
    refuse_unknown(where, entry, CAM.keys)
    where = f"{where[:-1]}, cam'"
    need(where, entry, ('moves', 'angles', 'lift'), CAM.example)
    bodies = list(dict.fromkeys(body for body, _ in points.values()))
    slides = [s for joint in joints if not joint.is_span for s in joint.loop_form().free_slides]
    turning = [body for body in bodies if body != GROUND]
    of = one_of(f'{where}: cam', entry['cam'], turning)
    moved = one_of(f'{where}: moves', entry['moves'], slides + turning)
    seen = one_of(f'{where}: of', entry.get('of', GROUND), bodies)
    if len({of, moved, seen}) < 3:
        raise SceneError(f'{where}: cam, moves and of are to be three: {of!r} is two')
    kinds = {'angles': 'angle', 'lift': 'length' if moved in slides else 'angle'}
    for key in kinds:
        if not isinstance(entry[key], list):
            raise SceneError(f'{where}: {key} is {entry[key]!r}: give a list, as [0, 1, 0]')
    angles, lifts = (
        [quantity(f'{where}: {key}', value, kind) for value in entry[key]]
        for key, kind in kinds.items()
    )
    if len(angles) != len(lifts) or len(angles) < 3 or min(np.diff(angles)) <= 0:
        raise SceneError(
            f'{where}: {len(angles)} angles and {len(lifts)} lifts: give three or more, as many of '
            'each, the angles rising'
        )
    if abs(angles[-1] - angles[0] - 2 * pi) > 1e-9 or lifts[0] != lifts[-1]:
        raise SceneError(
            f'{where}: a cam goes once round: end it 360 deg after its first angle, with the lift '
            'that it has there'
        )
    law = one_of(f'{where}: law', entry.get('law', RISES[0]), RISES)
    follower = Follower(where, moved, of, seen, cam(angles, lifts, law))
    return _with_roller(follower, entry, points, joints) if 'roller' in entry else follower


def _with_roller(
    follower: Follower, entry: dict[str, Any], points: Points, joints: Sequence[Joint]
) -> Follower:
    """The cam with its shape, which holds where cam and follower are on the body `of`."""
    where, seen, moved = follower.name, follower.seen, follower.moved
    need(where, entry, ('radius',), '{..., roller: stem.R, radius: 5 mm}')
    body, roller = named_point(f'{where}: roller', entry['roller'], points)
    radius = positive(f'{where}: radius', entry['radius'], 'length')
    axle = _pin(joints, follower.of, seen)
    guide = next((one for one in joints if one.name == moved and isinstance(one, Slot)), None)
    pivot = _pin(joints, moved, seen) if guide is None else None
    if axle is None or not (guide or pivot):
        raise SceneError(
            f'{where}: roller: the cam is to turn about a pin on {seen}, and the follower to slide '
            f'or to turn about a pin there: leave the roller out, or add them'
        )
    base, arm, along = 0j, 0j, None
    if guide is not None:
        turned, along = guide.turned, guide.along
        if guide.one != seen or guide.other != body or (turned is None and roller != guide.b):
            raise SceneError(
                f'{where}: roller is {entry["roller"]!r}: give a point of {guide.other}, which '
                f'slides on {seen} without turning'
            )
        base = guide.a + (roller - guide.b) * exp(1j * (turned or 0.0))
    elif pivot is not None:
        base, arm = pivot[1], roller - pivot[0]
        if body != moved or not arm:
            raise SceneError(
                f'{where}: roller is {entry["roller"]!r}: give a point of {moved} beside its pin'
            )
    shape = Cam(follower.of, *axle, body, roller, radius, follower.function, base, arm, along)
    contour = shape.contour()
    if np.abs(contour.pitch - shape.hub).min() <= radius:
        raise SceneError(f'{where}: the roller reaches the hub of {follower.of}: move it away')
    # Points on which the shape depends.
    at = {(follower.of, axle[0]), (seen, axle[1]), (body, roller), (seen, base)}
    if guide is not None:
        at |= {(seen, guide.a), (body, guide.b)}
    hubs = tuple(name.partition('.')[2] for name, point in points.items() if point in at)
    return follower._replace(hubs=hubs, shape=shape)


def _pin(joints: Sequence[Joint], body: str, on: str) -> tuple[complex, complex] | None:
    """The point of a `body`, and that of the body `on`, that a pin holds together."""
    for joint in joints:
        if isinstance(joint, Revolute) and {joint.one, joint.other} == {body, on}:
            return (joint.a, joint.b) if joint.one == body else (joint.b, joint.a)
    return None


GENEVA = Form(
    ('geneva', 'on', 'slots', 'pin', 'slot'), '{geneva: wheel.W, on: crank.O, slots: 4}', _geneva
)
CAM = Form(
    ('cam', 'moves', 'of', 'angles', 'lift', 'law', 'roller', 'radius'),
    '{cam: shaft, moves: valve, angles: [0 deg, 90 deg, 360 deg], lift: [0, 1 cm, 0]}',
    _cam,
)
