"""The usual form of a scene: bodies with named points, pins where they share one, other joints."""

import re
from cmath import phase
from functools import partial
from itertools import combinations
from math import pi
from typing import Any

import numpy as np

from kinpole_ros.mechanism._arc_slot import ArcSlot
from kinpole_ros.mechanism._assembly import Assembly, assemble
from kinpole_ros.mechanism._belt import Belt, strand
from kinpole_ros.mechanism._equations import Equations, equations_of_joints
from kinpole_ros.mechanism._joint_kinds import (
    GROUND,
    Joint,
    Revolute,
    Rolling,
    Slot,
    Strut,
)
from kinpole_ros.mechanism._scene_followers import CAM, GENEVA, carrier_of
from kinpole_ros.mechanism._scene_values import (
    Form,
    Points,
    SceneError,
    mapping,
    named_point,
    need,
    positive,
    quantity,
    refuse_one_body,
    refuse_unknown,
    vector,
)

_Point = tuple[str, complex]  # body, and position in its frame, m
_WORD = re.compile(r'\w[\w-]*')


def read_bodies(bodies: Any, joints: Any) -> tuple[Assembly, Points, Equations]:
    """
    The assembly of `bodies` and `joints`, all points by their names BODY.POINT, and the equations.

    Raises SceneError for malformed entries, LinkageError for bodies that no joint connects.
    """
    named = _bodies(bodies)
    points = {f'{body}.{name}': (body, z) for body, own in named.items() for name, z in own.items()}
    if joints is not None and not isinstance(joints, list):
        example = FORMS['slot'].example
        raise SceneError(f"'joints' is no list: write each as - {example}")
    all_joints: list[Joint] = [*_pins(named)]
    taken = {*named, *(pin.name for pin in all_joints)}
    names: dict[int, tuple[str, str]] = {}
    followers: dict[str, dict[str, Any]] = {}
    for k, entry in enumerate(joints or []):
        where = f"'joints: {k + 1}'"
        if isinstance(entry, dict) and ('cam' in entry or 'geneva' in entry):
            followers[where] = entry
            continue
        joint = _joint(where, entry, points)
        if not joint.is_span:
            names[k] = entry['on'], next(entry[kind] for kind in FORMS if kind in entry)
        if joint.name in taken and 'name' not in entry:
            # The hub of a wheel is often a pin as well.
            joint = _renamed(joint, taken)
        all_joints.append(joint)
        taken.add(joint.name)
    _refuse_equal_names(named, all_joints)
    _refuse_short_links(named, all_joints)
    moving = [body for body in named if body != GROUND]
    laws = [
        FORMS['geneva' if 'geneva' in entry else 'cam'].read(where, entry, points, all_joints)
        # A Geneva wheel may carry a cam.
        for where, entry in sorted(followers.items(), key=lambda item: 'cam' in item[1])
    ]
    measured = [joint for joint in all_joints if not joint.is_span]
    equations = equations_of_joints(moving, measured, names)
    return assemble(moving, all_joints, laws), points, equations


def _renamed(joint: Joint, taken: set[str]) -> Joint:
    """The joint with a name of its own, by its bodies: planet.H, or planet.H.sun."""
    for name in (f'{joint.other}.{joint.name}', f'{joint.other}.{joint.name}.{joint.one}'):
        if name not in taken:
            return joint.changed(name=name)
    return joint


def _refuse_equal_names(bodies: dict[str, dict[str, complex]], joints: list[Joint]) -> None:
    taken = set(bodies)
    for joint in joints:
        if joint.name in taken:
            what = 'body' if joint.name in bodies else 'joint'
            raise SceneError(
                f"'joints': a {what} is named '{joint.name}' already: add name: to the joint, with "
                'another'
            )
        taken.add(joint.name)


def _bodies(bodies: Any) -> dict[str, dict[str, complex]]:
    """Points by name, complex, m, of each body by name."""
    example = 'crank: {O: [0, 0], A: [0.12, 0]}'
    named = {}
    for body, entry in mapping("'bodies'", bodies, example).items():
        where = f"'bodies: {body}'"
        if not _WORD.fullmatch(body):
            raise SceneError(f'{where}: name a body with letters, digits, _ and -')
        own = {}
        for name, value in mapping(where, entry, '{O: [0, 0], A: [0.12, 0]}').items():
            if not _WORD.fullmatch(name):
                raise SceneError(f"{where}: name the point '{name}' with letters, digits, _ and -")
            own[name] = vector(f"{where}: '{name}'", value)
        named[body] = own
    if GROUND not in named:
        raise SceneError("'bodies' has no ground: add one, as ground: {O: [0, 0]}")
    if len(named) == 1:
        raise SceneError(f"'bodies' has nothing but the ground: add a body, as {example}")
    return named


def _pins(bodies: dict[str, dict[str, complex]]) -> list[Revolute]:
    """A pin for each name of a point that several bodies have."""
    pins = []
    for name in dict.fromkeys(name for own in bodies.values() for name in own):
        first, *second = [body for body, own in bodies.items() if name in own]
        for body in second:
            pin_name = name if len(second) == 1 else f'{name}.{body}'
            pins.append(Revolute(pin_name, first, bodies[first][name], body, bodies[body][name]))
    return pins


def _joint(where: str, entry: Any, points: Points) -> Joint:
    kind = next((kind for kind in FORMS if isinstance(entry, dict) and kind in entry), None)
    if kind is None:
        raise SceneError(
            f'{where} is {entry!r}: give one of {", ".join(FORMS)}, as ' + FORMS['slot'].example
        )
    refuse_unknown(where, entry, FORMS[kind].keys)
    where = f"{where[:-1]}, {kind}'"
    name = entry.get('name')
    if name is not None and not (isinstance(name, str) and _WORD.fullmatch(name)):
        raise SceneError(f'{where}: name is {name!r}: give letters, digits, _ and -')
    joint: Joint = FORMS[kind].read(where, entry, points)
    return joint


def _strut(where: str, entry: dict[str, Any], points: Points, kind: str = 'strut') -> Strut:
    example = FORMS[kind].example
    need(where, entry, (kind, 'name'), example)
    ends = entry[kind]
    if not isinstance(ends, list) or len(ends) != 2:
        raise SceneError(f'{where} is {ends!r}: give its two ends, as {example}')
    first, last = (named_point(where, end, points) for end in ends)
    refuse_one_body(where, first[0], last[0])
    return Strut(str(entry['name']), *first, *last)


def read_ends(
    where: str, entry: dict[str, Any], points: Points, kind: str, size: str
) -> tuple[str, _Point, _Point]:
    """The name of a joint, its point `on` a body, and the one that slides or rolls there."""
    need(where, entry, ('on', 'radius')[: 1 + (size == 'radius')], FORMS[kind].example)
    moving = named_point(where, entry[kind], points)
    base = named_point(f'{where}: on', entry['on'], points)
    refuse_one_body(where, base[0], moving[0])
    need(where, entry, (size,), FORMS[kind].example)
    return entry.get('name') or str(entry[kind]).rpartition('.')[2], base, moving


def _slot(where: str, entry: dict[str, Any], points: Points, kind: str = 'slot') -> Joint:
    is_arc = 'circle' in entry and 'along' not in entry
    name, base, moving = read_ends(where, entry, points, kind, 'circle' if is_arc else 'along')
    turned = None
    if kind == 'prismatic':
        turned = quantity(f'{where}: turned', entry.get('turned', 0.0), 'angle')
    if is_arc:
        circle = positive(f'{where}: circle', entry['circle'], 'length')
        return ArcSlot(name, *base, *moving, circle, turned)
    if 'circle' in entry:
        raise SceneError(f'{where}: along is of a line, circle of an arc: leave one out')
    return Slot(name, *base, *moving, quantity(f'{where}: along', entry['along'], 'angle'), turned)


def _belt(where: str, entry: dict[str, Any], points: Points) -> Belt:
    ends, names = _strut(where, entry, points, 'belt'), entry['belt']
    need(where, entry, ('radii',), FORMS['belt'].example)
    radii = entry['radii']
    if not isinstance(radii, list | tuple) or len(radii) != 2:
        raise SceneError(f'{where}: radii is {radii!r}: give both radii as [3 cm, 9 cm]')
    first, last = (quantity(f'{where}: radii', radius, 'length') for radius in radii)
    belt = Belt(ends.name, ends.one, ends.a, ends.other, ends.b, (first, last), 0.0, 0.0)
    if carrier := carrier_of(names, points):
        body, hubs = carrier
        if abs(hubs) <= abs(first - last):
            raise SceneError(
                f'{where}: on {body} the distance of its hubs is {abs(hubs):.6g} m: no strand of '
                f'radii {first:.6g} and {last:.6g} m fits: move one hub away'
            )
        length, axis = strand(belt, np.array(hubs))
        return belt.changed(length=float(length), direction=phase(axis), carrier=body)
    need(where, entry, ('length', 'direction'), '{..., length: 1 m, direction: -90 deg}')
    return belt.changed(
        length=positive(f'{where}: length', entry['length'], 'length'),
        direction=quantity(f'{where}: direction', entry['direction'], 'angle'),
    )


def _rolling(where: str, entry: dict[str, Any], points: Points) -> Rolling:
    name, base, hub = read_ends(where, entry, points, 'rolling', 'radius')
    radius = positive(f'{where}: radius', entry['radius'], 'length')
    pressure = None
    if 'pressure' in entry:
        pressure = quantity(f'{where}: pressure', entry['pressure'], 'angle')
        if not 0 <= pressure < pi / 2:
            raise SceneError(
                f'{where}: pressure is {entry["pressure"]!r}: give an angle from 0 to less than '
                '90 deg, as 20 deg'
            )
    if ('along' in entry) == ('circle' in entry):
        raise SceneError(
            f'{where}: give along: 0 deg for a line, or circle: 0.2 for a circle of that radius'
        )
    if 'along' in entry:
        along = quantity(f'{where}: along', entry['along'], 'angle')
        start = quantity(f'{where}: start', entry.get('start', 0.0), 'length')
        return Rolling(name, *base, *hub, radius, along=along, start=start, pressure=pressure)
    circle = quantity(f'{where}: circle', entry['circle'], 'length')
    if circle == 0 or (circle < 0 and -circle <= radius):
        raise SceneError(
            f'{where}: circle is {entry["circle"]!r}: give the radius to roll on, or, to roll '
            'inside of it, one less than minus that of the wheel'
        )
    # Inside a circle the hub lies opposite to that direction: by default along x.
    usual = pi if circle < 0 else 0.0
    start = quantity(f'{where}: start', entry.get('start', usual), 'angle')
    return Rolling(name, *base, *hub, radius, circle=circle, start=start, pressure=pressure)


def _refuse_short_links(bodies: dict[str, dict[str, complex]], joints: list[Joint]) -> None:
    """Refuse links of no length: two joints at one point of a body that have two names."""
    joint_points: dict[str, set[complex]] = {body: set() for body in bodies}
    for joint in joints:
        joint_points[joint.one].add(joint.a)
        joint_points[joint.other].add(joint.b)
    for body, used in joint_points.items():
        if body == GROUND:
            # The ground is no link: bodies may turn about one point of it.
            continue
        names = {z: name for name, z in bodies[body].items()}
        for name, z in bodies[body].items():
            if z in used and names[z] != name:
                raise SceneError(
                    f"'bodies: {body}': '{name}' and '{names[z]}' are at the same place, a link of "
                    'length 0: move one, or give them one name'
                )
        for near, far in combinations(used, 2):
            if abs(near - far) <= 1e-9 * max(map(abs, used)):
                raise SceneError(
                    f"'bodies: {body}': '{names[near]}' and '{names[far]}' are at the same place "
                    'but for rounding, a link of length 0: move one, or give them one name'
                )


# By the key that each has alone. A joint that is no span has its point `a` in `on`.
FORMS = {
    'slot': Form(
        ('slot', 'on', 'along', 'circle', 'name'),
        '{slot: rod.B, on: ground.O, along: 0 deg}',
        _slot,
    ),
    'prismatic': Form(
        ('prismatic', 'on', 'along', 'circle', 'turned', 'name'),
        '{prismatic: block.Q, on: ground.O, along: 90 deg, turned: 0 deg}',
        partial(_slot, kind='prismatic'),
    ),
    'rolling': Form(
        ('rolling', 'radius', 'on', 'along', 'circle', 'start', 'pressure', 'name'),
        '{rolling: wheel.H, radius: 0.1, on: ground.O, along: 0 deg}',
        _rolling,
    ),
    'strut': Form(('strut', 'name'), '{strut: [ground.D, lift.E], name: cylinder}', _strut),
    'belt': Form(
        ('belt', 'radii', 'length', 'direction', 'name'),
        '{belt: [motor.H, fan.K], radii: [3 cm, 9 cm], name: belt}',
        _belt,
    ),
    'geneva': GENEVA,
    'cam': CAM,
}
