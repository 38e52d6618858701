"""Scene files: a mechanism, how it is driven and where its markers sit, in a few lines of YAML.

Whatever is wrong in one is refused in a line that names the file, the key and the mend.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import yaml

from kinpole_ros.mechanism._motions import BodyMotion, cardan, four_bar, rolling_wheel
from kinpole_ros.mechanism._share import share_folder


class SceneError(ValueError):
    """A scene file that cannot be used: one line with the file, the key and the mend."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A mechanism in exact motion, with markers on its bodies.

    `markers` maps a body's name to its markers in the body's own frame, (n, 2) in m, and
    `marker_names` to the n names, unique in the scene; a body without markers is in neither.
    `motion(t)` takes times of any shape (...), in s, and returns the BodyMotion of every body by
    name, arrays (5, ...) in the ground's frame.
    """

    name: str
    markers: dict[str, np.ndarray]
    marker_names: dict[str, tuple[str, ...]]
    motion: Callable[[npt.ArrayLike], dict[str, BodyMotion]]


class _Mechanism(NamedTuple):
    """What a scene of one mechanism must and may say; keys are the arguments of `motion`."""

    motion: Callable[..., dict[str, BodyMotion]]
    bodies: tuple[str, ...]
    lengths: tuple[str, ...]
    optional: tuple[str, ...]
    choices: dict[str, tuple[str, ...]]


_MECHANISMS = {
    'rolling_wheel': _Mechanism(rolling_wheel, ('wheel',), ('radius',), ('start',), {}),
    'cardan': _Mechanism(cardan, ('rod',), ('length',), (), {}),
    'four_bar': _Mechanism(
        four_bar,
        ('crank', 'coupler', 'rocker'),
        ('ground', 'crank', 'coupler', 'rocker'),
        (),
        {'branch': ('open', 'crossed')},
    ),
}


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


def load_scene(path_or_name: str | Path) -> Scene:
    """Return the scene of a YAML file, given by path or by bare name ('four_bar').

    A bare name has neither folder nor suffix and means a file in `scenes_folder()`. Raises
    SceneError for a file that cannot be read, a key that is missing, unknown or ill-valued, and a
    mechanism that cannot move as asked.
    """
    path = _scene_path(path_or_name)
    data = _mapping(f'{path}: the file', _read(path), 'lines such as mechanism: four_bar')
    kind = _choice(path, data, 'mechanism', tuple(_MECHANISMS))
    mechanism = _MECHANISMS[kind]
    optional = ('phase', *mechanism.optional)
    required = ('turns_per_second', *mechanism.lengths, *mechanism.choices, 'markers')
    _refuse_unknown(f'{path}', data, ('mechanism', *required, *optional))
    for key in required:
        if key not in data:
            raise SceneError(f"{path}: the key '{key}' is missing: add it, a {kind} needs it")

    arguments: dict[str, Any] = {
        key: _number(f"{path}: '{key}'", data.get(key, 0.0))
        for key in ('turns_per_second', *mechanism.lengths, *optional)
    }
    for key in mechanism.lengths:
        if arguments[key] <= 0:
            raise SceneError(f"{path}: '{key}' is {data[key]}: give a length greater than 0, in m")
    for key, allowed in mechanism.choices.items():
        arguments[key] = _choice(path, data, key, allowed)

    markers = _markers(path, data['markers'], mechanism.bodies)
    motion = partial(mechanism.motion, **arguments)
    try:
        motion(0.0)
    except ValueError as error:
        raise SceneError(f'{path}: {error}') from None
    return Scene(
        name=path.stem,
        markers={body: np.array(list(points.values())) for body, points in markers.items()},
        marker_names={body: tuple(points) for body, points in markers.items()},
        motion=motion,
    )


class _Loader(yaml.SafeLoader):
    """YAML that refuses a key given twice, of which PyYAML would silently keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return the mapping, or raise as the base class does for other faults."""
        seen = set()
        for key, _ in node.value:
            name = str(key.value)
            if name in seen:
                problem = f"the key '{name}' is given twice: keep one"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            seen.add(name)
        return super().construct_mapping(node, deep)


def _scene_path(path_or_name: str | Path) -> Path:
    """Return the file that is meant; raise SceneError where there is none."""
    path = Path(path_or_name)
    known = ''
    if path.suffix == '' and len(path.parts) <= 1:
        try:
            path = scenes_folder() / f'{path_or_name}.yaml'
            known = f', or a name: {", ".join(scene_names())}'
        except FileNotFoundError as error:
            raise SceneError(str(error)) from None
    if not path.is_file():
        raise SceneError(f'{path}: there is no such scene file: give the path of one{known}')
    return path


def _read(path: Path) -> Any:
    """Return what the YAML file holds."""
    try:
        return yaml.load(path.read_bytes(), _Loader)
    except OSError as error:
        raise SceneError(f'{path}: cannot be read: {error.strerror}') from None
    # ValueError: PyYAML lets through what int() or a date makes of a malformed scalar.
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, 'problem_mark', None)
        line = f'line {mark.line + 1}: ' if mark else ''
        problem = getattr(error, 'problem', None) or ' '.join(str(error).split())
        raise SceneError(f'{path}: {line}not a usable YAML file: {problem}') from None


def _mapping(where: str, value: Any, example: str) -> dict[str, Any]:
    """Return `value` if it is a mapping with text for keys, and not empty."""
    if not isinstance(value, dict) or not value:
        raise SceneError(f'{where} holds no keys and values: write {example}')
    for key in value:
        if not isinstance(key, str):
            raise SceneError(
                f"{where} has a name {key!r} that is not text: write it in quotes, '{key}'"
            )
    return value


def _refuse_unknown(where: str, data: dict[str, Any], known: tuple[str, ...]) -> None:
    """Raise SceneError for the first key that is not among `known`."""
    for key in data:
        if key not in known:
            raise SceneError(f"{where}: unknown key '{key}': use {', '.join(known)}")


def _choice(path: Path, data: dict[str, Any], key: str, allowed: tuple[str, ...]) -> str:
    """Return the value of a key that names one of a few things."""
    if data.get(key) not in allowed:
        given = f'is {data[key]!r}, which is unknown' if key in data else 'is missing'
        raise SceneError(f"{path}: the key '{key}' {given}: give one of {', '.join(allowed)}")
    return data[key]


def _number(where: str, value: Any) -> float:
    """Return `value` as a finite number."""
    # PyYAML reads 1e-3, which has no point, as text.
    if isinstance(value, (int, float, str)) and not isinstance(value, bool):
        try:
            number = float(value)
        except (ValueError, OverflowError):
            number = float('nan')
        if isfinite(number):
            return number
    raise SceneError(f'{where} is {value!r}: give a finite number')


def _markers(
    path: Path, value: Any, bodies: tuple[str, ...]
) -> dict[str, dict[str, tuple[float, float]]]:
    """Return body -> marker's name -> (x, y), checked."""
    example = f'{bodies[0]}: {{m1: [0.01, 0.02], m2: [0.05, 0.0]}}'
    on_bodies = _mapping(f"{path}: 'markers'", value, example)
    _refuse_unknown(f"{path}: 'markers'", on_bodies, bodies)
    owner: dict[str, str] = {}
    result: dict[str, dict[str, tuple[float, float]]] = {}
    for body, listed in on_bodies.items():
        where = f"{path}: 'markers: {body}'"
        points = _mapping(where, listed, '{m1: [0.01, 0.02], m2: [0.05, 0.0]}')
        if len(points) < 2:
            raise SceneError(f'{where} is one marker, which shows no turning: give two or more')
        for name, point in points.items():
            if name in owner:
                raise SceneError(
                    f"{where}: '{owner[name]}' has a marker '{name}' too: give each its own name"
                )
            owner[name] = body
            if not isinstance(point, list) or len(point) != 2:
                raise SceneError(f"{where}: '{name}' is {point!r}: give [x, y] in m")
        result[body] = {
            name: (_number(f"{where}: '{name}'", x), _number(f"{where}: '{name}'", y))
            for name, (x, y) in points.items()
        }
    return result
