"""The usual form of a scene: bodies with named points, pins where they share one, other joints."""

import re
from cmath import phase
from collections.abc import Sequence
from itertools import combinations
from math import pi, remainder
from typing import Any

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly, assemble
from kinpole_ros.mechanism._equations import Equations, equations_of_joints
from kinpole_ros.mechanism._joints import (
    GROUND,
    Belt,
    Joint,
    Revolute,
    Rolling,
    Slot,
    Strut,
    strand,
)
from kinpole_ros.mechanism._laws import RISES, Follower, cam, geneva
from kinpole_ros.mechanism._units import SceneError, quantity, vector

Points = dict[str, tuple[str, complex]]
_WORD = re.compile(r'\w[\w-]*')
_KEYS = {
    'slot': ('slot', 'on', 'along', 'name'),
    'prismatic': ('prismatic', 'on', 'along', 'turned', 'name'),
    'rolling': ('rolling', 'radius', 'on', 'along', 'circle', 'start', 'pressure', 'name'),
    'strut': ('strut', 'name'),
    'belt': ('belt', 'radii', 'length', 'direction', 'name'),
    'geneva': ('geneva', 'on', 'slots', 'pin', 'slot'),
    'cam': ('cam', 'moves', 'of', 'angles', 'lift', 'law'),
}
_EXAMPLES = {
    'slot': '{slot: rod.B, on: ground.O, along: 0 deg}',
    'prismatic': '{prismatic: block.Q, on: ground.O, along: 90 deg, turned: 0 deg}',
    'rolling': '{rolling: wheel.H, radius: 0.1, on: ground.O, along: 0 deg}',
    'strut': '{strut: [ground.D, lift.E], name: cylinder}',
    'belt': '{belt: [motor.H, fan.K], radii: [3 cm, 9 cm], name: belt}',
    'geneva': '{geneva: wheel.W, on: crank.O, slots: 4}',
    'cam': '{cam: shaft, moves: valve, angles: [0 deg, 90 deg, 360 deg], lift: [0, 1 cm, 0]}',
}


def mapping(where: str, value: Any, example: str) -> dict[str, Any]:
    """`value` if it is a mapping with text for keys, and not empty; else SceneError."""
    if not isinstance(value, dict) or not value:
        raise SceneError(f'{where} holds no keys and values: write {example}')
    for key in value:
        if not isinstance(key, str):
            raise SceneError(
                f"{where} has a name {key!r} that is not text: write it in quotes, '{key}'"
            )
    return value


def refuse_unknown(where: str, data: dict[str, Any], known: tuple[str, ...]) -> None:
    """Raise SceneError for the first key that is not among `known`."""
    for key in data:
        if key not in known:
            raise SceneError(f"{where}: unknown key '{key}': use {', '.join(known)}")


def need(where: str, data: dict[str, Any], keys: tuple[str, ...], example: str) -> None:
    """Raise SceneError for the first of `keys` that is not there."""
    for key in keys:
        if key not in data:
            raise SceneError(f"{where}: the key '{key}' is missing: add it, as in {example}")


def named_point(where: str, value: Any, points: Points) -> tuple[str, complex]:
    """The body and place of a point written as BODY.POINT; raises SceneError."""
    # A list cannot be looked up.
    if not isinstance(value, str) or value not in points:
        known = ', '.join(points)
        raise SceneError(f'{where} is {value!r}, which is no point: give one of {known}')
    return points[value]


def read_bodies(bodies: Any, joints: Any) -> tuple[Assembly, Points, Equations]:
    """
    The assembly of what `bodies` and `joints` hold, all points by their names BODY.POINT, and
    the equations of the joints.

    Raises SceneError for whatever is malformed, LinkageError for bodies that hang on nothing.
    """
    read = _bodies(bodies)
    points = {
        f'{body}.{name}': (body, z) for body, named in read.items() for name, z in named.items()
    }
    if joints is not None and not isinstance(joints, list):
        raise SceneError(f"'joints' is no list: write each as - {_EXAMPLES['slot']}")
    found: list[Joint] = [*_pins(read)]
    taken = {*read, *(pin.name for pin in found)}
    described: dict[int, dict[str, Any]] = {}
    followers: dict[str, dict[str, Any]] = {}
    for k, said in enumerate(joints or []):
        if isinstance(said, dict) and ('cam' in said or 'geneva' in said):
            followers[f"'joints: {k + 1}'"] = said
            continue
        described[k] = said
        joint = _joint(f"'joints: {k + 1}'", said, points)
        if joint.name in taken and 'name' not in said:
            # The hub of a wheel is often a pin as well.
            joint = _renamed(joint, taken)
        found.append(joint)
        taken.add(joint.name)
    taken = set(read)
    for joint in found:
        if joint.name in taken:
            what = 'body' if joint.name in read else 'joint'
            raise SceneError(
                f"'joints': a {what} is named '{joint.name}' already: add name: to the joint, with "
                'another'
            )
        taken.add(joint.name)
    _refuse_flat(read, found)
    moving = [body for body in read if body != GROUND]
    laws = [
        (_geneva if 'geneva' in said else _cam)(where, said, points, found)
        # A Geneva wheel may carry a cam.
        for where, said in sorted(followers.items(), key=lambda item: 'cam' in item[1])
    ]
    return (
        assemble(moving, found, laws),
        points,
        equations_of_joints(moving, found, described),
    )


def _renamed(joint: Joint, taken: set[str]) -> Joint:
    """The joint with a name of its own, by its bodies: planet.H, or planet.H.sun."""
    for name in (f'{joint.other}.{joint.name}', f'{joint.other}.{joint.name}.{joint.one}'):
        if name not in taken:
            return joint._replace(name=name)
    return joint


def _bodies(bodies: Any) -> dict[str, dict[str, complex]]:
    example = 'crank: {O: [0, 0], A: [0.12, 0]}'
    read = {}
    for body, said in mapping("'bodies'", bodies, example).items():
        where = f"'bodies: {body}'"
        if not _WORD.fullmatch(body):
            raise SceneError(f'{where}: name a body with letters, digits, _ and -')
        named = {}
        for name, place in mapping(where, said, '{O: [0, 0], A: [0.12, 0]}').items():
            if not _WORD.fullmatch(name):
                raise SceneError(f"{where}: name the point '{name}' with letters, digits, _ and -")
            named[name] = vector(f"{where}: '{name}'", place)
        read[body] = named
    if GROUND not in read:
        raise SceneError("'bodies' has no ground: add one, as ground: {O: [0, 0]}")
    if len(read) == 1:
        raise SceneError(f"'bodies' has nothing but the ground: add a body, as {example}")
    return read


def _pins(bodies: dict[str, dict[str, complex]]) -> list[Revolute]:
    """A pin for each name of a point that several bodies have."""
    pins = []
    for name in dict.fromkeys(name for named in bodies.values() for name in named):
        first, *others = [body for body, named in bodies.items() if name in named]
        for other in others:
            called = name if len(others) == 1 else f'{name}.{other}'
            pins.append(Revolute(called, first, bodies[first][name], other, bodies[other][name]))
    return pins


def _joint(where: str, said: Any, points: Points) -> Joint:
    kind = next((kind for kind in _KEYS if isinstance(said, dict) and kind in said), None)
    if kind is None:
        kinds = ', '.join(_KEYS)
        raise SceneError(f'{where} is {said!r}: give one of {kinds}, as {_EXAMPLES["slot"]}')
    refuse_unknown(where, said, _KEYS[kind])
    where = f"{where[:-1]}, {kind}'"
    name = said.get('name')
    if name is not None and not (isinstance(name, str) and _WORD.fullmatch(name)):
        raise SceneError(f'{where}: name is {name!r}: give letters, digits, _ and -')
    if kind in ('strut', 'belt'):
        need(where, said, (kind, 'name'), _EXAMPLES[kind])
        ends = said[kind]
        if not isinstance(ends, list) or len(ends) != 2:
            raise SceneError(f'{where} is {ends!r}: give its two ends, as {_EXAMPLES[kind]}')
        (one, a), (other, b) = (named_point(where, end, points) for end in ends)
        _refuse_same(where, one, other)
        joint = Strut(str(name), one, a, other, b)
        return joint if kind == 'strut' else _belt(where, said, joint, ends, points)
    need(where, said, ('on',) + (('radius',) if kind == 'rolling' else ()), _EXAMPLES[kind])
    other, b = named_point(where, said[kind], points)
    one, a = named_point(f'{where}: on', said['on'], points)
    _refuse_same(where, one, other)
    name = name or str(said[kind]).rpartition('.')[2]
    if kind == 'rolling':
        return _rolling(where, said, name, (one, a), (other, b))
    need(where, said, ('along',), _EXAMPLES[kind])
    along = quantity(f'{where}: along', said['along'], 'angle')
    if kind == 'slot':
        return Slot(name, one, a, along, other, b)
    turned = quantity(f'{where}: turned', said.get('turned', 0.0), 'angle')
    return Slot(name, one, a, along, other, b, turned)


def _belt(where: str, said: dict[str, Any], ends: Strut, names: list[str], points: Points) -> Belt:
    need(where, said, ('radii',), _EXAMPLES['belt'])
    radii = vector(f'{where}: radii', said['radii'])
    first, last = radii.real, radii.imag
    belt = Belt(*ends, (first, last), 0.0, 0.0)
    if held := _carrier(names, points):
        carrier, hubs = held
        if abs(hubs) <= abs(first - last):
            raise SceneError(
                f'{where}: on {carrier} its hubs are {abs(hubs):.6g} m apart: no strand of radii '
                f'{first:.6g} and {last:.6g} m fits: move them apart'
            )
        size, along = strand(belt, np.array(hubs))
        return belt._replace(length=float(size), direction=phase(along), carrier=carrier)
    need(where, said, ('length', 'direction'), '{..., length: 1 m, direction: -90 deg}')
    length = quantity(f'{where}: length', said['length'], 'length')
    if length <= 0:
        raise SceneError(f'{where}: length is {said["length"]!r}: give one greater than 0')
    return belt._replace(
        length=length, direction=quantity(f'{where}: direction', said['direction'], 'angle')
    )


def _carrier(names: Sequence[str], points: Points) -> tuple[str, complex] | None:
    """The third body that has the points of both names, and the second as seen from the first."""
    (one, a), (other, b) = (name.split('.') for name in names)
    for carrier in dict.fromkeys(body for body, _ in points.values()):
        first, last = points.get(f'{carrier}.{a}'), points.get(f'{carrier}.{b}')
        if carrier not in (one, other) and first and last:
            return carrier, last[1] - first[1]
    return None


def _geneva(where: str, said: dict[str, Any], points: Points, joints: Sequence[Joint]) -> Follower:
    """The wheel's angle over the crank's, whose pin runs into its slots without shock."""
    refuse_unknown(where, said, _KEYS['geneva'])
    where = f"{where[:-1]}, geneva'"
    need(where, said, ('on', 'slots'), _EXAMPLES['geneva'])
    wheel, _ = named_point(where, said['geneva'], points)
    crank, _ = named_point(f'{where}: on', said['on'], points)
    _refuse_same(where, crank, wheel)
    slots = said['slots']
    if not isinstance(slots, int) or isinstance(slots, bool) or not 3 <= slots <= 100:
        raise SceneError(f'{where}: slots is {slots!r}: give a whole number from 3 to 100')
    held = _carrier([said['on'], said['geneva']], points)
    if held is None or held[1] == 0:
        raise SceneError(
            f'{where}: no body holds {said["on"]} and {said["geneva"]} apart: give it points of '
            'these names, as ground: {O: [0, 0], W: [0.1, 0]}'
        )
    carrier, toward = held[0], phase(held[1])
    pin = quantity(f'{where}: pin', said.get('pin', 0.0), 'angle')
    slot = quantity(f'{where}: slot', said.get('slot', 0.0), 'angle')
    # Of the wheel's slots one is as good as another: it starts with the least turn.
    offset = remainder(toward + pi - slot, 2 * pi / slots)
    law = geneva(slots, toward - pin, offset)
    hubs = tuple(said[key].rpartition('.')[2] for key in ('on', 'geneva'))
    return Follower(where, wheel, crank, carrier, law, hubs)


def _cam(where: str, said: dict[str, Any], points: Points, joints: Sequence[Joint]) -> Follower:
    refuse_unknown(where, said, _KEYS['cam'])
    where = f"{where[:-1]}, cam'"
    need(where, said, ('moves', 'angles', 'lift'), _EXAMPLES['cam'])
    bodies = list(dict.fromkeys(body for body, _ in points.values()))
    slides = [joint.name for joint in joints if isinstance(joint, Slot)]
    turning = [body for body in bodies if body != GROUND]
    seen = said.get('of', GROUND)
    for key, value, known in (
        ('cam', said['cam'], turning),
        ('moves', said['moves'], slides + turning),
        ('of', seen, bodies),
    ):
        if value not in known:
            raise SceneError(f'{where}: {key} is {value!r}: give one of {", ".join(known)}')
    if len({said['cam'], said['moves'], seen}) < 3:
        raise SceneError(f'{where}: cam, moves and of are to be three: {said["cam"]!r} is two')
    kinds = {'angles': 'angle', 'lift': 'length' if said['moves'] in slides else 'angle'}
    for key in kinds:
        if not isinstance(said[key], list):
            raise SceneError(f'{where}: {key} is {said[key]!r}: give a list, as [0, 1, 0]')
    angles, lifts = (
        [quantity(f'{where}: {key}', one, kind) for one in said[key]] for key, kind in kinds.items()
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
    law = said.get('law', RISES[0])
    if law not in RISES:
        raise SceneError(f'{where}: law is {law!r}: give one of {", ".join(RISES)}')
    return Follower(where, said['moves'], said['cam'], seen, cam(angles, lifts, law))


def _rolling(
    where: str, said: dict[str, Any], name: str, on: tuple[str, complex], hub: tuple[str, complex]
) -> Rolling:
    radius = quantity(f'{where}: radius', said['radius'], 'length')
    if radius <= 0:
        raise SceneError(f'{where}: radius is {said["radius"]!r}: give one greater than 0')
    pressure = None
    if 'pressure' in said:
        pressure = quantity(f'{where}: pressure', said['pressure'], 'angle')
        if not 0 <= pressure < pi / 2:
            raise SceneError(
                f'{where}: pressure is {said["pressure"]!r}: give an angle from 0 to less than '
                '90 deg, as 20 deg'
            )
    if ('along' in said) == ('circle' in said):
        raise SceneError(
            f'{where}: give along: 0 deg for a line, or circle: 0.2 for a circle of that radius'
        )
    if 'along' in said:
        along = quantity(f'{where}: along', said['along'], 'angle')
        start = quantity(f'{where}: start', said.get('start', 0.0), 'length')
        return Rolling(name, *on, *hub, radius, along=along, start=start, pressure=pressure)
    circle = quantity(f'{where}: circle', said['circle'], 'length')
    if circle == 0 or (circle < 0 and -circle <= radius):
        raise SceneError(
            f'{where}: circle is {said["circle"]!r}: give the radius to roll on, or, to roll '
            'inside of it, one less than minus that of the wheel'
        )
    # Inside, the hub lies opposite to the direction that says where it is: by default along x.
    usual = pi if circle < 0 else 0.0
    start = quantity(f'{where}: start', said.get('start', usual), 'angle')
    return Rolling(name, *on, *hub, radius, circle=circle, start=start, pressure=pressure)


def _refuse_same(where: str, one: str, other: str) -> None:
    if one == other:
        raise SceneError(f"{where}: both its points are on '{one}': give points of two bodies")


def _refuse_flat(bodies: dict[str, dict[str, complex]], joints: list[Joint]) -> None:
    """Refuse links of no length: two joints at one place of a body that are not one point."""
    places: dict[str, set[complex]] = {body: set() for body in bodies}
    for joint in joints:
        places[joint.one].add(joint.a)
        places[joint.other].add(joint.b)
    for body, used in places.items():
        if body == GROUND:
            # Which is no link: bodies may turn about one place of it.
            continue
        names = {z: name for name, z in bodies[body].items()}
        twice = [name for name, z in bodies[body].items() if z in used and names[z] != name]
        for name in twice:
            other = names[bodies[body][name]]
            raise SceneError(
                f"'bodies: {body}': '{name}' and '{other}' are at the same place, a link of length "
                '0: move one, or give them one name'
            )
        for near, far in combinations(used, 2):
            if abs(near - far) <= 1e-9 * max(map(abs, used)):
                raise SceneError(
                    f"'bodies: {body}': '{names[near]}' and '{names[far]}' are at the same place "
                    'but for rounding, a link of length 0: move one, or give them one name'
                )
