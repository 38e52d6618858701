"""
Scene files: a mechanism, how it is driven and where its markers sit, in a few lines of YAML.

Whatever is wrong in one is refused in a line that names the file, the key and the fix.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import yaml

from kinpole_ros.files import cut_line, read_limited
from kinpole_ros.files.bounded_yaml import MOST_YAML, Loader, load_yaml
from kinpole_ros.mechanism._assembly import GROUND, Assembly, Strut
from kinpole_ros.mechanism._drive import Drive, constant_rate, sine, smooth_step, table
from kinpole_ros.mechanism._equations import Equations, equations_of_vectors
from kinpole_ros.mechanism._joints import (
    Points,
    mapping,
    named_point,
    need,
    read_bodies,
    refuse_unknown,
)
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Driver, Mechanism
from kinpole_ros.mechanism._motions import BodyMotion
from kinpole_ros.mechanism._share import share_folder
from kinpole_ros.mechanism._start import close_near, mobility, start_near
from kinpole_ros.mechanism._statics import Force, Holder, Load, Torque
from kinpole_ros.mechanism._units import SceneError, quantity, vector
from kinpole_ros.mechanism._vectors import read_vectors

_GRAVITY = 9.80665
# rad. A start says roughly which way loops close; what gears alone determine is to be right.
_ROUGHLY, _GEARED = pi / 2, 0.02
_EITHER = ('drivers', 'start', 'loads', 'held_by', 'markers', 'free')
_RATE_EXAMPLE = '{drive: crank, rate: 1 rev/s, start: 0 deg}'


@dataclass(frozen=True, eq=False)
class Scene:
    """A mechanism in exact motion, with markers on its bodies.

    `markers` maps a body's name to its markers in the body's own frame, (n, 2) in m, and
    `marker_names` to the n names, unique in the scene; a body without markers is in neither.
    `motion(t)` takes times of any shape (...), in s, and returns the BodyMotion of every body by
    name, arrays (5, ...) in the ground's frame; it raises SceneError for a time at which the
    mechanism cannot follow its drivers. `points` maps names ('coupler.P', or of the loop form 'P')
    to the body and the place in its frame (complex, m); `loads` are those on it (N, N m), and
    `held_by` what is asked to balance them, if that is not the drivers. `equations` are what its
    joints say of the bodies' poses, whatever drives them; `free` names the dimensions that are to
    be fitted, none for all.
    """

    name: str
    markers: dict[str, np.ndarray]
    marker_names: dict[str, tuple[str, ...]]
    motion: Callable[[npt.ArrayLike], dict[str, BodyMotion]]
    mechanism: Mechanism
    points: Points
    loads: tuple[Load, ...]
    held_by: Holder | None
    equations: Equations
    free: tuple[str, ...]


class _Driven(NamedTuple):
    """A driver and when it does what it does for the first time: `begin` to `end`, s."""

    driver: Driver
    begin: float
    end: float


def scenes_folder() -> Path:
    """Return the folder of the scenes that come with the package.

    Raises FileNotFoundError where they are not installed.
    """
    return share_folder() / 'config' / 'scenes'


def scene_names() -> list[str]:
    """Return the names that `load_scene` knows without a path, sorted.

    Raises FileNotFoundError where the scenes are not installed.
    """
    return sorted(path.stem for path in scenes_folder().glob('*.yaml'))


def load_scene(source: str | Path | Mapping[str, Any]) -> Scene:
    """Return the scene of a YAML file, given by path or by bare name ('four_bar'), or as it is.

    A bare name has neither folder nor suffix and means a file in `scenes_folder()`. What has lines
    is a scene's text, and a mapping what such a text holds. Raises SceneError for a file that
    cannot be read, a key that is missing, unknown or ill-valued, and a mechanism that cannot move
    as asked.
    """
    if isinstance(source, Mapping):
        path, data = Path('scene'), dict(source)
    elif isinstance(source, str) and '\n' in source:
        path, data = Path('scene'), _parsed('scene', source)
    else:
        path = _scene_path(source)
        data = _read(path)
    try:
        # Absurd numbers overflow on their way to being refused.
        with np.errstate(all='ignore'):
            return _scene(path, data)
    except (SceneError, LinkageError) as error:
        raise SceneError(f'{path}: {cut_line(str(error))}') from None


def _scene(path: Path, data: Any) -> Scene:
    mapping('the file', data, 'bodies, drivers, start and markers, as in config/scenes')
    if 'vectors' in data:
        refuse_unknown('a scene of vectors', data, ('vectors', 'loops', 'points', *_EITHER))
        vectors = mapping("'vectors'", data['vectors'], 'r2: {length: 20 cm, angle: unknown}')
        need('the file', data, ('loops', 'drivers'), 'config/scenes/loader_cylinder.yaml')
        chains = mapping("'points'", data['points'], 'P: r2 + r3p') if 'points' in data else {}
        assembly, points, read = read_vectors(vectors, data['loops'], chains)
        equations = equations_of_vectors(read)
    else:
        refuse_unknown('the file', data, ('bodies', 'joints', *_EITHER))
        need('the file', data, ('bodies', 'drivers'), 'config/scenes/four_bar.yaml')
        assembly, points, equations = read_bodies(data['bodies'], data.get('joints'))
    driven = _drivers(data['drivers'], assembly)
    said = _start(data.get('start'), assembly)
    drivers = tuple(one.driver for one in driven)
    rows = np.array([driver.row for driver in drivers])
    inputs = np.array([driver.motion(np.zeros(()))[0] for driver in drivers])
    start = start_near(assembly, said, rows, inputs)
    _check_mobility(assembly, start, len(drivers))
    mechanism = Mechanism(assembly, drivers, start)
    _check_range(mechanism, driven)
    _check_start(mechanism, said)
    loads = _loads(data.get('loads'), points, assembly.bodies)
    held_by = _held_by(data['held_by'], points, assembly.bodies) if 'held_by' in data else None
    if held_by and (not loads or len(drivers) != 1):
        raise SceneError(
            "'held_by' holds the loads instead of the one driver: give loads, and one driver"
        )
    markers = _markers(data.get('markers'), assembly.bodies)
    return Scene(
        name=path.stem,
        markers={
            body: np.array([(z.real, z.imag) for z in named.values()])
            for body, named in markers.items()
        },
        marker_names={body: tuple(named) for body, named in markers.items()},
        motion=lambda t: _motion(path, mechanism, t),
        mechanism=mechanism,
        points=points,
        loads=loads,
        held_by=held_by,
        equations=equations,
        free=_free(data.get('free')),
    )


def _motion(path: Path, mechanism: Mechanism, t: npt.ArrayLike) -> dict[str, BodyMotion]:
    try:
        found = mechanism.motion(t)
    except LinkageError as error:
        raise SceneError(f'{path}: {error}') from None
    if not found.regular.all():
        dead = np.flatnonzero(~found.regular)
        first = dead[np.ravel(t)[dead].argmin()]
        loop = mechanism.dead_loop(found.values[0].reshape(len(mechanism.start), -1)[:, first])
        raise SceneError(
            f'{path}: at {np.ravel(t)[first]:.9g} s the mechanism is in a dead point of the loop '
            f'{", ".join(loop)}, where its drivers do not tell how it moves on: drive it '
            'otherwise, or take other times'
        )
    return {
        body: BodyMotion(found.position[:, k], found.angle[:, k])
        for k, body in enumerate(mechanism.bodies)
    }


# What drives it


def _drivers(said: Any, assembly: Assembly) -> list[_Driven]:
    if not isinstance(said, list) or not said:
        raise SceneError(f"'drivers' is no list: write each as - {_RATE_EXAMPLE}")
    driven = [_driver(f"'drivers: {k + 1}'", one, assembly) for k, one in enumerate(said)]
    names = [one.driver.name for one in driven]
    for name in names:
        if names.count(name) > 1:
            raise SceneError(f"'drivers': '{name}' is driven twice: leave one out")
    return driven


def _driver(where: str, said: Any, assembly: Assembly) -> _Driven:
    mapping(where, said, _RATE_EXAMPLE)
    need(where, said, ('drive',), _RATE_EXAMPLE)
    kinds = assembly.kinds
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
    return _Driven(
        Driver(name if of == GROUND else f'{name} of {of}', row, motion, low, high), begin, end
    )


def _drive(where: str, said: dict[str, Any], kind: str) -> tuple[Drive, float, float]:
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


def _start(said: Any, assembly: Assembly) -> dict[str, float]:
    """About where angles and slides are at time 0."""
    kinds = assembly.kinds
    if said is None:
        lengths = assembly.loops.length0[assembly.loops.length0 != 0]
        # A vector of unknown length has to begin with some length.
        usual = float(lengths.mean()) if len(lengths) and not assembly.joints else 0.0
        return {name: usual for name, kind in kinds.items() if kind == 'length' and usual}
    read = mapping("'start'", said, 'coupler: 45 deg')
    refuse_unknown("'start'", read, tuple(kinds))
    return {name: quantity(f"'start': {name}", value, kinds[name]) for name, value in read.items()}


# Whether it moves as it is driven


def _check_mobility(assembly: Assembly, start: np.ndarray, drivers: int) -> None:
    """Raise SceneError unless there are as many drivers as degrees of freedom."""
    near, _ = close_near(assembly.loops, start)
    count, by_rank = mobility(assembly, near)
    counts = (
        f"Gruebler's count gives {count} degrees of freedom, the rank of the loops at the start "
        f'{by_rank}'
    )
    if max(count, by_rank) <= 0:
        raise SceneError(f'the bodies cannot move: {counts}: take a joint away')
    if drivers not in (count, by_rank):
        fix = f'drive {by_rank}' if by_rank > 0 else 'check the joints'
        raise SceneError(f"'drivers' are {drivers}, but {counts}: {fix}")


def _check_range(mechanism: Mechanism, driven: list[_Driven]) -> None:
    """Raise SceneError where the drivers ask for more than the linkage gives."""
    if not mechanism.linkage.blocks:
        return
    driver = driven[0].driver
    if len(driven) == 1:
        low, high, what = driver.low, driver.high, f'{driver.name} ='
    else:
        low = min(0.0, *(one.begin for one in driven))
        high, what = max(one.end for one in driven), 'the time'
    path = mechanism.path(low, high)
    reach = path.inputs[0], path.inputs[-1]
    slack = 1e-9 * max(1.0, abs(low), abs(high))
    if path.period or (reach[0] <= low + slack and reach[1] >= high - slack):
        return
    dead = next((dead for dead in path.dead_points if dead.turns_back), None)
    why = '' if dead is None else f', a dead point of the loop {", ".join(dead.loop)}'

    def way(first: float, last: float) -> str:
        size, unit = 1.0, 's'
        if len(driven) == 1:
            size, unit = (180 / pi, 'deg') if mechanism.kind(0) == 'angle' else (1.0, 'm')
        return f'{first * size:.6g} to {last * size:.6g} {unit}'

    raise SceneError(
        f"'drivers' ask for {what} {way(low, high)}, but the linkage goes from {way(*reach)}{why}: "
        'drive it less far, or change lengths'
    )


def _check_start(mechanism: Mechanism, said: Mapping[str, float]) -> None:
    """Raise SceneError where a body is not at time 0 about where the scene says that it is."""
    loops, kinds = mechanism.assembly.loops, mechanism.assembly.kinds
    values = mechanism.motion(np.zeros(1), 3).values[0, :, 0]
    # What loops do not hold follows from gears and drivers alone, and is said exactly.
    in_loops = (loops.loops[:, :] != 0).any(axis=0)
    loose = (loops.angles[in_loops] != 0).any(axis=0)
    for k, name in enumerate(loops.variables):
        if name not in said or kinds[name] != 'angle':
            continue
        off = abs((values[k] - said[name] + pi) % (2 * pi) - pi)
        if off > (_ROUGHLY if loose[k] else _GEARED):
            now, meant = (np.degrees(x) % 360 for x in (values[k], said[name]))
            fix = (
                'another branch: start it there'
                if loose[k]
                else ('drivers and gears have it there: correct it, or give the joint its start')
            )
            raise SceneError(
                f"'start: {name}' is {meant:.6g} deg, but at time 0 it is at {now:.6g} deg; {fix}"
            )


# Loads and markers


def _loads(said: Any, points: Points, bodies: tuple[str, ...]) -> tuple[Load, ...]:
    if said is not None and not isinstance(said, list):
        raise SceneError("'loads' is no list: write each as - {force: [0, -100], at: coupler.P}")
    loads: list[Load] = []
    for k, one in enumerate(said or []):
        where = f"'loads: {k + 1}'"
        mapping(where, one, '{force: [0, -100], at: coupler.P}')
        kind = next((k for k in ('force', 'weight', 'torque') if k in one), None)
        if kind is None:
            raise SceneError(
                f'{where} is {one!r}: give force: [0, -100] or weight: 10 kg and at: BODY.POINT, '
                'or torque: 5 and on: BODY'
            )
        where_to = 'on' if kind == 'torque' else 'at'
        refuse_unknown(where, one, (kind, where_to))
        need(where, one, (where_to,), f'{{{kind}: ..., {where_to}: ...}}')
        if kind == 'torque':
            if one['on'] not in bodies:
                raise SceneError(
                    f'{where}: on is {one["on"]!r}: give a moving body, one of {", ".join(bodies)}'
                )
            loads.append(Torque(one['on'], quantity(f'{where}: torque', one['torque'], 'torque')))
            continue
        body, place = named_point(f'{where}: at', one['at'], points)
        if body == GROUND:
            raise SceneError(f'{where}: at is {one["at"]!r} on the ground: load a moving body')
        if kind == 'weight':
            force = -1j * _GRAVITY * quantity(f'{where}: weight', one['weight'], 'mass')
        else:
            force = vector(f'{where}: force', one['force'], 'force')
        loads.append(Force(body, place, force))
    return tuple(loads)


def _held_by(said: Any, points: Points, bodies: tuple[str, ...]) -> Holder:
    where, example = "'held_by'", '{at: bar.P, along: 90 deg, of: bar} or {on: bar}'
    mapping(where, said, example)
    for key in ('on', 'of'):
        if key in said and said[key] not in (*bodies, *([GROUND] if key == 'of' else [])):
            raise SceneError(
                f'{where}: {key} is {said[key]!r}: give a moving body, one of {", ".join(bodies)}'
            )
    if 'on' in said:
        refuse_unknown(f'{where}, a torque', said, ('on',))
        return Holder(said['on'])
    refuse_unknown(where, said, ('at', 'along', 'of'))
    need(where, said, ('at', 'along'), example)
    body, place = named_point(f'{where}: at', said['at'], points)
    if body == GROUND:
        raise SceneError(f'{where}: at is {said["at"]!r} on the ground: hold a moving body')
    along = quantity(f'{where}: along', said['along'], 'angle')
    return Holder(body, place, along, said.get('of', GROUND))


def _markers(said: Any, bodies: tuple[str, ...]) -> dict[str, dict[str, complex]]:
    """Return body -> marker's name -> place, checked."""
    if said is None:
        return {}
    on_bodies = mapping("'markers'", said, f'{bodies[0]}: {{m1: [0.01, 0.02], m2: [0.05, 0.0]}}')
    refuse_unknown("'markers'", on_bodies, bodies)
    owner: dict[str, str] = {}
    result = {}
    for body, listed in on_bodies.items():
        where = f"'markers: {body}'"
        named = mapping(where, listed, '{m1: [0.01, 0.02], m2: [0.05, 0.0]}')
        if len(named) < 2:
            raise SceneError(f'{where} is one marker, which shows no turning: give two or more')
        for name in named:
            if name in owner:
                raise SceneError(
                    f"{where}: '{owner[name]}' has a marker '{name}' too: give each its own name"
                )
            owner[name] = body
        result[body] = {name: vector(f"{where}: '{name}'", z) for name, z in named.items()}
        if len(set(result[body].values())) < 2:
            raise SceneError(
                f'{where} are all at one place, which shows no turning: put them at several places'
            )
    return result


def _free(said: Any) -> tuple[str, ...]:
    """Names of dimensions, which are looked up where they are fitted."""
    if said is None:
        return ()
    if not isinstance(said, list) or not all(isinstance(name, str) for name in said):
        raise SceneError(f"'free' is {said!r}: give a list of names, as [rocker.B, coupler]")
    return tuple(said)


# Files


class _Loader(Loader):
    """With numbers as people write them."""

    longest, most = 1000, 5000


def _number(loader: _Loader, node: yaml.ScalarNode) -> int | float:
    text = loader.construct_scalar(node)
    return int(text) if re.fullmatch(r'[-+]?\d+', text) else float(text)


_Loader.add_constructor('tag:yaml.org,2002:float', _number)
_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$', re.ASCII),
    list('-+.0123456789'),
)


def _scene_path(path_or_name: str | Path) -> Path:
    """Return the file that is meant; raise SceneError where there is none."""
    path = Path(path_or_name)
    known = ''
    if path.suffix == '' and len(path.parts) <= 1:
        try:
            path = scenes_folder() / f'{path_or_name}.yaml'
            here = f' as {path_or_name}.yaml' if Path(f'{path_or_name}.yaml').is_file() else ''
            known = f'{here}, or a name: {", ".join(scene_names())}'
        except FileNotFoundError as error:
            raise SceneError(str(error)) from None
    if not path.exists():
        raise SceneError(f'{path}: there is no such scene file: give the path of one{known}')
    return path


def _read(path: Path) -> Any:
    """Return what the YAML file holds."""
    try:
        return _parsed(path, read_limited(path, MOST_YAML))
    except OSError as error:
        raise SceneError(
            f'{path}: cannot be read: {error.strerror}; give the path of a scene file'
        ) from None


def scene_text(path_or_name: str | Path) -> str:
    """Return the text of a scene's file, given as `load_scene` takes it; raises SceneError."""
    path = _scene_path(path_or_name)
    try:
        return read_limited(path, MOST_YAML).decode()
    except (OSError, ValueError) as error:
        raise SceneError(f'{path}: cannot be read: {error}') from None


def _parsed(path: str | Path, text: str | bytes) -> Any:
    """Return what the YAML text holds; `path` names it in messages."""
    try:
        return load_yaml(text, _Loader)
    # ValueError: a whole number of thousands of digits.
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, 'problem_mark', None)
        line = f'line {mark.line + 1}: ' if mark else ''
        problem = getattr(error, 'problem', None) or ' '.join(str(error).split())
        raise SceneError(f'{path}: {line}not a usable YAML file: {problem}') from None
