"""What drives a scene: its drivers as they are written, and when they do what they do."""

from math import pi
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly
from kinpole_ros.mechanism._joints import GROUND, Belt, Strut
from kinpole_ros.mechanism._laws import Function, constant_rate, sine, smooth_step, table
from kinpole_ros.mechanism._mechanism import Driver
from kinpole_ros.mechanism._scene_bodies import mapping, need, refuse_unknown
from kinpole_ros.mechanism._units import SceneError, quantity

_RATE_EXAMPLE = '{drive: crank, rate: 1 rev/s, start: 0 deg}'


class Driven(NamedTuple):
    """A driver and when it does what it does for the first time: `begin` to `end`, s."""

    driver: Driver
    begin: float
    end: float


def read_drivers(said: Any, assembly: Assembly) -> list[Driven]:
    if not isinstance(said, list) or not said:
        raise SceneError(f"'drivers' is no list: write each as - {_RATE_EXAMPLE}")
    driven = [_driver(f"'drivers: {k + 1}'", one, assembly) for k, one in enumerate(said)]
    names = [one.driver.name for one in driven]
    for name in names:
        if names.count(name) > 1:
            raise SceneError(f"'drivers': '{name}' is driven twice: leave one out")
    return driven


def _driver(where: str, said: Any, assembly: Assembly) -> Driven:
    mapping(where, said, _RATE_EXAMPLE)
    need(where, said, ('drive',), _RATE_EXAMPLE)
    belts = [joint.name for joint in assembly.joints if isinstance(joint, Belt)]
    kinds = assembly.kinds
    for variable in (name for belt in belts for name in (belt, f'{belt}.angle')):
        if said['drive'] == variable:
            raise SceneError(f"{where}: '{variable}' is of a belt, which only holds: drive a wheel")
    name, of = said['drive'], said.get('of', GROUND)
    for key, value in (('drive', name), ('of', of)):
        if not isinstance(value, str) or (value not in kinds and (key, value) != ('of', GROUND)):
            known = ', '.join(kinds)
            raise SceneError(
                f'{where}: {key} is {value!r}, which cannot be driven: give one of {known}'
            )
    if of != GROUND and (of == name or kinds[of] != kinds[name]):
        raise SceneError(f"{where}: '{name}' of '{of}' is no difference: name two bodies")
    row = np.array([(other == name) - float(other == of) for other in kinds])
    where = f"{where[:-1]}, {name}'"
    motion, begin, end = _drive(where, said, kinds[name])
    # Not the ends alone: a table's spline may swing beyond its values.
    with np.errstate(all='ignore'):
        values, *derivatives = motion(np.linspace(begin, end, 2001))
    if not np.isfinite(derivatives).all():
        raise SceneError(f'{where}: its derivatives are beyond all numbers: give it more time')
    low, high = float(values.min()), float(values.max())
    strut = any(isinstance(joint, Strut) and joint.name == name for joint in assembly.joints)
    if strut and low <= 0:
        raise SceneError(f'{where}: its length goes down to {low:.6g} m: keep it greater than 0')
    return Driven(
        Driver(name if of == GROUND else f'{name} of {of}', row, motion, low, high), begin, end
    )


def _drive(where: str, said: dict[str, Any], kind: str) -> tuple[Function, float, float]:
    """The motion said, and when it begins and has been through all of its range."""
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
    form = next((form for form in forms if form in said), None)
    if form is None:
        raise SceneError(
            f'{where} says not how: give rate; or mean, amplitude, frequency; or from, to, '
            'duration; or times, values'
        )
    required, optional = forms[form]
    refuse_unknown(where, said, ('drive', 'of', *required, *optional))
    need(where, said, tuple(required), '{drive: ..., ' + ': ..., '.join(required) + ': ...}')
    if form == 'times':
        times, values = (_numbers(f'{where}: {key}', said[key], required[key]) for key in required)
        if len(times) != len(values) or len(times) < 2 or min(np.diff(times)) <= 0:
            raise SceneError(
                f'{where}: {len(times)} times and {len(values)} values: give two or more, as many '
                'of each, the times rising'
            )
        return table(times, values), times[0], times[-1]
    number = {
        key: quantity(f'{where}: {key}', said.get(key, 0.0), kind)
        for key, kind in {**required, **optional}.items()
    }
    for key in ('frequency', 'duration'):
        if number.get(key, 1.0) <= 0:
            raise SceneError(f'{where}: {key} is {said[key]!r}: give one greater than 0')
    if form == 'rate':
        # An angle goes through all of its range in a turn; a slide only as far as it is asked.
        turns = kind == 'angle' and number['rate'] != 0
        return (
            constant_rate(number['rate'], number['start']),
            0.0,
            2 * pi / abs(number['rate']) if turns else 0.0,
        )
    if form == 'amplitude':
        motion = sine(number['mean'], number['amplitude'], number['frequency'], number['phase'])
        return motion, 0.0, 1 / number['frequency']
    step = smooth_step(number['from'], number['to'], number['begin'], number['duration'])
    return step, number['begin'], number['begin'] + number['duration']


def _numbers(where: str, said: Any, kind: str) -> list[float]:
    if not isinstance(said, list):
        raise SceneError(f'{where} is {said!r}: give a list, as [0, 1, 2.5]')
    return [quantity(where, one, kind) for one in said]
