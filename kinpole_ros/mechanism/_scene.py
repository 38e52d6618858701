"""
Scene files: a mechanism, its drivers and the markers on its bodies, in a few lines of YAML.

Errors are one line with the file, the key and the fix.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinpole_ros.files import cut_line
from kinpole_ros.mechanism._assembly import Assembly
from kinpole_ros.mechanism._checks import (
    check_belts,
    check_mobility,
    check_range,
    check_start,
    check_teeth,
)
from kinpole_ros.mechanism._equations import Equations, equations_of_vectors
from kinpole_ros.mechanism._loads import Holder, Load, Mass, Spring, Torsion
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._motions import BodyMotion
from kinpole_ros.mechanism._scene_bodies import read_bodies
from kinpole_ros.mechanism._scene_file import is_text, parse_scene, read_scene, scene_path
from kinpole_ros.mechanism._scene_inputs import (
    read_drivers,
    read_held_by,
    read_loads,
    read_masses,
    read_springs,
)
from kinpole_ros.mechanism._scene_values import (
    Points,
    SceneError,
    mapping,
    need,
    quantity,
    refuse_unknown,
    vector,
)
from kinpole_ros.mechanism._start import start_near
from kinpole_ros.mechanism._vectors import read_vectors

_COMMON_KEYS = ('drivers', 'start', 'loads', 'held_by', 'springs', 'masses', 'markers', 'free')
_MARKERS_EXAMPLE = '{m1: [0.01, 0.02], m2: [0.05, 0.0]}'


@dataclass(frozen=True, eq=False)
class Scene:
    """A mechanism in exact motion, with markers on its bodies.

    `markers` maps a body's name to its markers in the body's own frame, (n, 2) in m, and
    `marker_names` to the n names, unique in the scene; a body without markers is in neither.
    `motion(t)` takes times of any shape (...), in s, and returns the BodyMotion of every body by
    name, arrays (5, ...) in the ground's frame; it raises SceneError for a time at which the
    mechanism cannot follow its drivers. `points` maps names ('coupler.P', or of the loop form 'P')
    to the body and the position in its frame (complex, m). `loads` are those on it (N, N m);
    `springs` and `masses` add loads that depend on position and motion; `held_by` balances them, if
    not the drivers do. `equations` are those of its joints between the poses of the bodies; `free`
    names the dimensions to be fitted, none for all. After `course`, s, all drivers have been
    through their ranges once; 0 where one has no end. `data` are those of the file.
    """

    name: str
    markers: dict[str, np.ndarray]
    marker_names: dict[str, tuple[str, ...]]
    motion: Callable[[npt.ArrayLike], dict[str, BodyMotion]]
    mechanism: Mechanism
    points: Points
    loads: tuple[Load, ...]
    held_by: Holder | None
    springs: tuple[Spring | Torsion, ...]
    masses: tuple[Mass, ...]
    equations: Equations
    free: tuple[str, ...]
    course: float
    data: Mapping[str, Any]


def load_scene(source: str | Path | Mapping[str, Any]) -> Scene:
    """
    Read the scene of a YAML file, of its text, or of the data in such a text.

    Parameters
    ----------
    source
        A path; a bare name ('four_bar'), which has neither folder nor suffix and means a file in
        `scenes_folder()`; a text, which has lines; or a mapping.

    Returns
    -------
    Scene
        The mechanism with its points, markers and loads, in SI units.

    Raises
    ------
    SceneError
        For a file that cannot be read, a key that is missing, unknown or ill-valued, and a
        mechanism that cannot move as asked.

    """
    if isinstance(source, Mapping):
        path, data = Path('scene'), _with_key_on(dict(source))
    elif is_text(source):
        path, data = Path('scene'), parse_scene('scene', str(source))
    else:
        path = scene_path(source)
        data = read_scene(path)
    try:
        # Absurd numbers overflow before they are refused.
        with np.errstate(all='ignore'):
            return _scene(path, data)
    except (SceneError, LinkageError) as error:
        raise SceneError(f'{path}: {cut_line(str(error))}') from None


def _with_key_on(data: Any) -> Any:
    """Data with the key `on` where YAML 1.1, as of `yaml.safe_load`, reads it as True."""
    if isinstance(data, dict):
        return {'on' if key is True else key: _with_key_on(value) for key, value in data.items()}
    return [_with_key_on(value) for value in data] if isinstance(data, list) else data


def _scene(path: Path, data: Any) -> Scene:
    mapping('the file', data, 'bodies, drivers, start and markers, as in config/scenes')
    if 'vectors' in data:
        refuse_unknown('a scene of vectors', data, ('vectors', 'loops', 'points', *_COMMON_KEYS))
        vectors = mapping("'vectors'", data['vectors'], 'r2: {length: 20 cm, angle: unknown}')
        need('the file', data, ('loops', 'drivers'), 'config/scenes/loader_cylinder.yaml')
        chains = mapping("'points'", data['points'], 'P: r2 + r3p') if 'points' in data else {}
        assembly, points, read = read_vectors(vectors, data['loops'], chains)
        equations = equations_of_vectors(read)
    else:
        refuse_unknown('the file', data, ('bodies', 'joints', *_COMMON_KEYS))
        need('the file', data, ('bodies', 'drivers'), 'config/scenes/four_bar.yaml')
        assembly, points, equations = read_bodies(data['bodies'], data.get('joints'))
    driven = read_drivers(data['drivers'], assembly)
    stated = _start(data.get('start'), assembly)
    drivers = tuple(one.driver for one in driven)
    rows = np.array([driver.row for driver in drivers])
    inputs = np.array([driver.motion(np.zeros(()))[0] for driver in drivers])
    start = start_near(assembly, stated, rows, inputs)
    check_mobility(assembly, start, len(drivers))
    mechanism = Mechanism(assembly, drivers, start)
    check_belts(mechanism, stated)
    check_range(mechanism, driven)
    check_start(mechanism, stated)
    check_teeth(mechanism)
    loads = read_loads(data.get('loads'), points, assembly.bodies)
    held_by = read_held_by(data['held_by'], points, assembly.bodies) if 'held_by' in data else None
    springs = read_springs(data.get('springs'), points, assembly.bodies)
    masses = read_masses(data.get('masses'), assembly.bodies)
    if held_by and (not (loads or springs or masses) or len(drivers) != 1):
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
        springs=springs,
        masses=masses,
        equations=equations,
        free=_free(data.get('free')),
        course=max(one.end for one in driven) if all(one.end for one in driven) else 0.0,
        data=data,
    )


def _motion(path: Path, mechanism: Mechanism, t: npt.ArrayLike) -> dict[str, BodyMotion]:
    try:
        motion = mechanism.motion(t)
    except LinkageError as error:
        raise SceneError(f'{path}: {error}') from None
    if not motion.regular.all():
        dead = np.flatnonzero(~motion.regular)
        first = dead[np.ravel(t)[dead].argmin()]
        values = motion.values[0].reshape(len(mechanism.start), -1)[:, first]
        raise SceneError(
            f'{path}: at {np.ravel(t)[first]:.9g} s the mechanism is in a dead point of the loop '
            f'{", ".join(mechanism.dead_loop(values))}, where its drivers do not tell how it moves '
            'on: drive it otherwise, or take other times'
        )
    return {
        body: BodyMotion(motion.position[:, k], motion.angle[:, k])
        for k, body in enumerate(mechanism.bodies)
    }


def _start(entry: Any, assembly: Assembly) -> dict[str, float]:
    """The stated angles and slides at time 0, which need be roughly right only."""
    kinds = assembly.kinds
    if entry is None:
        lengths = assembly.loops.length0[assembly.loops.length0 != 0]
        # A vector of unknown length has to begin with some length.
        usual = float(lengths.mean()) if len(lengths) and not assembly.joints else 0.0
        return {name: usual for name, kind in kinds.items() if kind == 'length' and usual}
    stated = mapping("'start'", entry, 'coupler: 45 deg')
    refuse_unknown("'start'", stated, tuple(kinds))
    return {
        name: quantity(f"'start': {name}", value, kinds[name]) for name, value in stated.items()
    }


def _markers(entries: Any, bodies: tuple[str, ...]) -> dict[str, dict[str, complex]]:
    """The markers of each body by name, complex, m."""
    if entries is None:
        return {}
    by_body = mapping("'markers'", entries, f'{bodies[0]}: {_MARKERS_EXAMPLE}')
    refuse_unknown("'markers'", by_body, bodies)
    owner: dict[str, str] = {}
    markers = {}
    for body, entry in by_body.items():
        where = f"'markers: {body}'"
        named = mapping(where, entry, _MARKERS_EXAMPLE)
        if len(named) < 2:
            raise SceneError(f'{where} is one marker, which shows no turning: give two or more')
        for name in named:
            if name in owner:
                raise SceneError(
                    f"{where}: '{owner[name]}' has a marker '{name}' too: give each its own name"
                )
            owner[name] = body
        markers[body] = {name: vector(f"{where}: '{name}'", z) for name, z in named.items()}
        if len(set(markers[body].values())) < 2:
            raise SceneError(
                f'{where} are all at one place, which shows no turning: put them at several places'
            )
    return markers


def _free(names: Any) -> tuple[str, ...]:
    """Names of dimensions to be fitted, which `linkage` looks up."""
    if names is None:
        return ()
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise SceneError(f"'free' is {names!r}: give a list of names, as [rocker.B, coupler]")
    return tuple(names)
