"""The drivers of a scene as they are written, and its loads, springs and masses."""

from collections.abc import Iterator
from math import pi
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly
from kinpole_ros.mechanism._joint_kinds import GROUND
from kinpole_ros.mechanism._laws import Function, constant_rate, sine, smooth_step, table
from kinpole_ros.mechanism._loads import Force, Holder, Load, Mass, Spring, Torque, Torsion
from kinpole_ros.mechanism._mechanism import Driver
from kinpole_ros.mechanism._scene_values import (
    Points,
    SceneError,
    mapping,
    named_point,
    need,
    positive,
    quantity,
    refuse_unknown,
    vector,
)

_GRAVITY = 9.80665  # m/s^2, the standard one
_RATE_EXAMPLE = '{drive: crank, rate: 1 rev/s, start: 0 deg}'
_LOAD_EXAMPLE = '{force: [0, -100], at: coupler.P}'
_SPRING_EXAMPLE = '{between: [ground.S, crank.A], stiffness: 2 N/mm, free: 10 cm}'
_MASS_EXAMPLE = '{mass: 2 kg, center: [5 cm, 0], moment: 20 kg cm2}'


class Driven(NamedTuple):
    """A driver, and from `begin` to `end`, s, the time of its first way through its range."""

    driver: Driver
    begin: float
    end: float


def _entries(key: str, listed: Any, example: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """The entries of a list, each with the words that name it in messages."""
    if not isinstance(listed, list):
        raise SceneError(f"'{key}' is no list: write each as - {example}")
    for k, entry in enumerate(listed):
        where = f"'{key}: {k + 1}'"
        yield where, mapping(where, entry, example)


def read_drivers(listed: Any, assembly: Assembly) -> list[Driven]:
    """The drivers of a scene; raises SceneError."""
    entries = _entries('drivers', listed or None, _RATE_EXAMPLE)
    drivers = [_driver(where, entry, assembly) for where, entry in entries]
    names = [driven.driver.name for driven in drivers]
    for name in names:
        if names.count(name) > 1:
            raise SceneError(f"'drivers': '{name}' is driven twice: leave one out")
    return drivers


def _driver(where: str, entry: dict[str, Any], assembly: Assembly) -> Driven:
    need(where, entry, ('drive',), _RATE_EXAMPLE)
    kinds = assembly.kinds
    for joint in assembly.joints:
        if not joint.is_driven and entry['drive'] in (joint.name, f'{joint.name}.angle'):
            variable = entry['drive']
            raise SceneError(f"{where}: '{variable}' is of a belt, which only holds: drive a wheel")
    name, of = entry['drive'], entry.get('of', GROUND)
    for key, value in (('drive', name), ('of', of)):
        if not isinstance(value, str) or (value not in kinds and (key, value) != ('of', GROUND)):
            raise SceneError(
                f'{where}: {key} is {value!r}, which cannot be driven: give one of '
                f'{", ".join(kinds)}'
            )
    if of != GROUND and (of == name or kinds[of] != kinds[name]):
        raise SceneError(f"{where}: '{name}' of '{of}' is no difference: name two bodies")
    row = np.array([(variable == name) - float(variable == of) for variable in kinds])
    where = f"{where[:-1]}, {name}'"
    motion, begin, end = _motion(where, entry, kinds[name])
    # Not the ends alone: the spline of a table may swing beyond its values.
    with np.errstate(all='ignore'):
        values, *derivatives = motion(np.linspace(begin, end, 2001))
    if not np.isfinite(derivatives).all():
        raise SceneError(f'{where}: its derivatives are beyond all numbers: give it more time')
    low, high = float(values.min()), float(values.max())
    is_strut = any(joint.is_span and joint.name == name for joint in assembly.joints)
    if is_strut and low <= 0:
        raise SceneError(f'{where}: its length goes down to {low:.6g} m: keep it greater than 0')
    label = name if of == GROUND else f'{name} of {of}'
    return Driven(Driver(label, row, motion, low, high), begin, end)


def _motion(where: str, entry: dict[str, Any], kind: str) -> tuple[Function, float, float]:
    """The motion of a driver, and when it begins and ends its first way through its range."""
    rate = {'angle': 'angular velocity', 'length': 'velocity'}[kind]
    forms: dict[str, tuple[dict[str, str], dict[str, str]]] = {
        'rate': ({'rate': rate}, {'start': kind}),
        'amplitude': (
            {'amplitude': kind, 'frequency': 'frequency'},
            {'mean': kind, 'phase': 'angle'},
        ),
        'to': ({'from': kind, 'to': kind, 'duration': 'time'}, {'begin': 'time'}),
        'times': ({'times': 'time', 'values': kind}, {}),
    }
    form = next((form for form in forms if form in entry), None)
    if form is None:
        raise SceneError(
            f'{where} says not how: give rate; or mean, amplitude, frequency; or from, to, '
            'duration; or times, values'
        )
    required, optional = forms[form]
    refuse_unknown(where, entry, ('drive', 'of', *required, *optional))
    need(where, entry, tuple(required), '{drive: ..., ' + ': ..., '.join(required) + ': ...}')
    if form == 'times':
        times, values = (_numbers(f'{where}: {key}', entry[key], required[key]) for key in required)
        if len(times) != len(values) or len(times) < 2 or min(np.diff(times)) <= 0:
            raise SceneError(
                f'{where}: {len(times)} times and {len(values)} values: give two or more, as many '
                'of each, the times rising'
            )
        return table(times, values), times[0], times[-1]
    number = {
        key: (positive if key in ('frequency', 'duration') else quantity)(
            f'{where}: {key}', entry.get(key, 0.0), kind
        )
        for key, kind in {**required, **optional}.items()
    }
    if form == 'rate':
        # An angle is through its range after a turn; a slide only goes as far as it is asked.
        end = 2 * pi / abs(number['rate']) if kind == 'angle' and number['rate'] else 0.0
        return constant_rate(number['rate'], number['start']), 0.0, end
    if form == 'amplitude':
        motion = sine(number['mean'], number['amplitude'], number['frequency'], number['phase'])
        return motion, 0.0, 1 / number['frequency']
    step = smooth_step(number['from'], number['to'], number['begin'], number['duration'])
    return step, number['begin'], number['begin'] + number['duration']


def _numbers(where: str, listed: Any, kind: str) -> list[float]:
    if not isinstance(listed, list):
        raise SceneError(f'{where} is {listed!r}: give a list, as [0, 1, 2.5]')
    return [quantity(where, value, kind) for value in listed]


def read_loads(listed: Any, points: Points, bodies: tuple[str, ...]) -> tuple[Load, ...]:
    """The loads of a scene; raises SceneError."""
    if listed is None:
        return ()
    loads: list[Load] = []
    for where, entry in _entries('loads', listed, _LOAD_EXAMPLE):
        kind = next((kind for kind in ('force', 'weight', 'torque') if kind in entry), None)
        if kind is None:
            raise SceneError(
                f'{where} is {entry!r}: give force: [0, -100] or weight: 10 kg and at: BODY.POINT, '
                'or torque: 5 and on: BODY'
            )
        target = 'on' if kind == 'torque' else 'at'
        refuse_unknown(where, entry, (kind, target))
        need(where, entry, (target,), f'{{{kind}: ..., {target}: ...}}')
        if kind == 'torque':
            body = _moving_body(f'{where}: on', entry['on'], bodies)
            loads.append(Torque(body, quantity(f'{where}: torque', entry['torque'], 'torque')))
            continue
        point = _moving_point(where, entry['at'], points, 'load')
        if kind == 'weight':
            force = -1j * _GRAVITY * quantity(f'{where}: weight', entry['weight'], 'mass')
        else:
            force = vector(f'{where}: force', entry['force'], 'force')
        loads.append(Force(*point, force))
    return tuple(loads)


def _moving_body(where: str, value: Any, bodies: tuple[str, ...]) -> str:
    if value not in bodies:
        moving = ', '.join(body for body in bodies if body != GROUND)
        raise SceneError(f'{where} is {value!r}: give a moving body, one of {moving}')
    return str(value)


def _moving_point(where: str, value: Any, points: Points, verb: str) -> tuple[str, complex]:
    body, point = named_point(f'{where}: at', value, points)
    if body == GROUND:
        raise SceneError(f'{where}: at is {value!r} on the ground: {verb} a moving body')
    return body, point


def read_held_by(entry: Any, points: Points, bodies: tuple[str, ...]) -> Holder:
    """The force or torque that holds the loads of a scene; raises SceneError."""
    where, example = "'held_by'", '{at: bar.P, along: 90 deg, of: bar} or {on: bar}'
    mapping(where, entry, example)
    if 'on' in entry:
        body = _moving_body(f'{where}: on', entry['on'], bodies)
    if 'of' in entry:
        _moving_body(f'{where}: of', entry['of'], (*bodies, GROUND))
    if 'on' in entry:
        refuse_unknown(f'{where}, a torque', entry, ('on',))
        return Holder(body)
    refuse_unknown(where, entry, ('at', 'along', 'of'))
    need(where, entry, ('at', 'along'), example)
    point = _moving_point(where, entry['at'], points, 'hold')
    along = quantity(f'{where}: along', entry['along'], 'angle')
    return Holder(*point, along, entry.get('of', GROUND))


def read_springs(
    listed: Any, points: Points, bodies: tuple[str, ...]
) -> tuple[Spring | Torsion, ...]:
    """The springs of a scene; raises SceneError."""
    if listed is None:
        return ()
    entries = _entries('springs', listed, _SPRING_EXAMPLE)
    return tuple(_spring(where, entry, points, bodies) for where, entry in entries)


def _spring(
    where: str, entry: dict[str, Any], points: Points, bodies: tuple[str, ...]
) -> Spring | Torsion:
    keys = ('between', 'stiffness', 'free')
    refuse_unknown(where, entry, keys)
    need(where, entry, keys, _SPRING_EXAMPLE)
    ends = entry['between']
    if not isinstance(ends, list) or len(ends) != 2 or not all(isinstance(e, str) for e in ends):
        raise SceneError(
            f'{where}: between is {ends!r}: give two points, as [ground.S, crank.A], or two '
            'bodies, as [ground, crank], for a spring that turns them'
        )
    turns = all(end in (*bodies, GROUND) and end not in points for end in ends)
    if turns:
        first, last = ends
    else:
        (first, a), (last, b) = (named_point(f'{where}: between', end, points) for end in ends)
    if first == last:
        raise SceneError(f"{where}: both its ends are on '{first}': give two bodies")
    kinds = ('torsional stiffness', 'angle') if turns else ('stiffness', 'length')
    stiffness = positive(f'{where}: stiffness', entry['stiffness'], kinds[0])
    if turns:
        return Torsion(first, last, stiffness, quantity(f'{where}: free', entry['free'], kinds[1]))
    free = quantity(f'{where}: free', entry['free'], kinds[1])
    if free < 0:
        raise SceneError(f'{where}: free is {entry["free"]!r}: give a length of 0 or more')
    return Spring(first, a, last, b, stiffness, free)


def read_masses(entries: Any, bodies: tuple[str, ...]) -> tuple[Mass, ...]:
    """The masses of a scene's bodies; raises SceneError."""
    if entries is None:
        return ()
    by_body = mapping("'masses'", entries, f'{bodies[0]}: {_MASS_EXAMPLE}')
    refuse_unknown("'masses'", by_body, bodies)
    masses = []
    for body, entry in by_body.items():
        where = f"'masses: {body}'"
        mapping(where, entry, _MASS_EXAMPLE)
        refuse_unknown(where, entry, ('mass', 'center', 'moment'))
        need(where, entry, ('mass', 'center'), _MASS_EXAMPLE)
        values = []
        for key, kind in (('mass', 'mass'), ('moment', 'moment of inertia')):
            value = quantity(f'{where}: {key}', entry.get(key, 0.0), kind)
            if value < 0:
                raise SceneError(f'{where}: {key} is {entry[key]!r}: give one of 0 or more')
            values.append(value)
        center = vector(f'{where}: center', entry['center'])
        masses.append(Mass(body, values[0], center, values[1]))
    return tuple(masses)
