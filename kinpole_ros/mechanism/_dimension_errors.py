"""
Effects of errors of dimensions and of play in joints on the motion of a linkage.

The loops are closed again for each change of a dimension, from the position without it: a standard
deviation up and down for the first order, at random for the samples.
"""

import re
from collections.abc import Mapping, Sequence, Set
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly, assemble, body_motion
from kinpole_ros.mechanism._equations import Path
from kinpole_ros.mechanism._joint_kinds import Joint, Rolling
from kinpole_ros.mechanism._loop_closure import solve
from kinpole_ros.mechanism._loops import LinkageError, reduce
from kinpole_ros.mechanism._scene import Scene
from kinpole_ros.mechanism._scene_bodies import read_bodies
from kinpole_ros.mechanism._scene_values import Points, SceneError, vector
from kinpole_ros.mechanism._start import mobility
from kinpole_ros.mechanism._vectors import read_vectors
from kinpole_ros.planar._plane import Real

# Half the width of a uniform distribution over its standard deviation.
_UNIFORM = np.sqrt(3)
# A body that turns with less than this share of the fastest rate has no center.
_MIN_RATE = 1e-6
# Positions that are solved together: more leave the cache.
_MOST_POSITIONS = 8192
# The angle of a vector relative to that of another.
_RELATIVE_ANGLE = re.compile(r'\s*([A-Za-z_]\w*)')


class Tolerance(NamedTuple):
    """
    A length, m, or angle, rad, of a scene with a standard `deviation`.

    `path` and `axis` are those in the scene's file. If `is_play`, it is a coordinate of a pin that
    may be anywhere within a circle with a radius of twice the deviation; or, with the name of a
    slot or of gears for a path, the position of that joint, which may be anywhere within √3 of it.
    """

    name: str
    deviation: float
    value: float
    path: Path
    axis: int
    is_play: bool = False


class ToleranceSpread(NamedTuple):
    """
    Quantities (Q), by `names` as (body or point, what), at T positions.

    `value` (Q, T) is without errors; `parts` (E, Q, T) is the effect of each error's deviation to
    first order; `samples` (N, Q, T) are with all errors at random. NaN where the loops do not
    close.
    """

    names: tuple[tuple[str, str], ...]
    value: Real
    parts: Real
    samples: Real

    @property
    def deviation(self) -> Real:
        """Standard deviations (Q, T) to first order."""
        return np.asarray(np.sqrt((self.parts**2).sum(axis=0)))


class _Linkage(NamedTuple):
    """A linkage with other dimensions, and its points."""

    assembly: Assembly
    points: Points


def tolerances_of(
    scene: Scene, deviations: Mapping[str, float], play: Mapping[str, float]
) -> list[Tolerance]:
    """
    The errors that are not zero of a scene's dimensions by their names, and the play of its joints.

    `deviations`, m or rad, are of a point (rocker.B), one coordinate of it (rocker.B x), a length
    or angle (r2.length), or all of a body, vector or joint; 'length' and 'angle' are all of a kind.
    The last that names a dimension holds. `play`, m, by the name of a joint is radial of a pin, to
    either side of a slot or guide, half the backlash of wheels. Raises SceneError for a name that
    is no dimension of the scene, or no joint that has play.
    """
    errors: dict[tuple[Path, int], Tolerance] = {}
    rows = {
        f'{row.name} {"xy"[row.axis]}' if row.path[0] == 'bodies' else row.name: row
        for row in scene.equations.dimensions
        if row.path
    }
    for name, deviation in deviations.items():
        own = {
            label: row
            for label, row in rows.items()
            if name in (label, row.name, row.kind) or row.name.startswith(f'{name}.')
        }
        if not own and name not in ('length', 'angle'):
            names = ', '.join(dict.fromkeys(row.name for row in rows.values()))
            raise SceneError(f'{name} is no dimension that joints use: give some of {names}')
        for label, row in own.items():
            errors[row.path, row.axis] = Tolerance(label, deviation, row.value, row.path, row.axis)
    joints = {joint.name: joint for joint in scene.mechanism.assembly.joints if joint.has_play}
    plays = []
    for name, radius in play.items():
        if name not in joints:
            raise SceneError(
                f'{name} is no pin, slot or pair of gears, which alone have play: give some of '
                f'{", ".join(joints) or "none"}'
            )
        pin = joints[name]
        if pin.center().kind != 'pin':
            plays.append(Tolerance(f'play {name}', radius / _UNIFORM, 0.0, (name,), 0, True))
            continue
        path: Path = ('bodies', pin.other, name.partition('.')[0])
        for axis, value in enumerate((pin.b.real, pin.b.imag)):
            # The coordinates of a point anywhere in a circle deviate by half its radius.
            plays.append(
                Tolerance(f'play {name} {"xy"[axis]}', radius / 2, value, path, axis, True)
            )
    return [error for error in (*errors.values(), *plays) if error.deviation > 0]


def propagate_tolerances(
    scene: Scene,
    errors: Sequence[Tolerance],
    values: Real,
    rates: Real,
    samples: int = 0,
    seed: int = 0,
) -> ToleranceSpread:
    """
    The effects of errors of dimensions on the motion of a linkage, with its drivers unchanged.

    `values` (n, T), m and rad, are its variables, `rates` (d, T) those of its drivers. Quantities
    are for each body its angle, angular velocity and ICR, for each point its position; rad, rad/s
    and m. Raises LinkageError for a dimension that cannot change by itself, as the distance of two
    gears.
    """
    count, rows = len(errors), scene.mechanism.driver_rows
    deviations = np.diag([error.deviation for error in errors]).reshape(count, count)
    floating = _floating(scene, values[:, 0])
    linkages = [_changed(scene.data, errors, np.zeros(count), floating)]
    floated = linkages[0].assembly
    rows, values = (_widened(scene, floated, array) for array in (rows.T, values))
    rows = rows.T * np.isin(floated.loops.variables, scene.mechanism.assembly.loops.variables)
    for error, deviation in zip(errors, deviations, strict=True):
        try:
            for change in (deviation, -deviation):
                linkages.append(_changed(scene.data, errors, change, floating))
                reduce(linkages[-1].assembly.loops._replace(drives=rows))
        except LinkageError as wrong:
            raise LinkageError(f'{error.name} cannot be off by itself: {wrong}') from None
    drawn = _drawn(errors, samples, np.random.default_rng(seed))
    linkages += [_changed(scene.data, errors, change, floating) for change in drawn]
    moving = _moving(scene.mechanism.assembly, scene.points)
    inputs = np.stack((rows @ values, rates))
    found = _quantities(linkages, list(moving), rows, inputs, values)
    up, down = found[1 : 2 * count + 1 : 2], found[2 : 2 * count + 1 : 2]
    for error, part in zip(errors, up - down, strict=True):
        if np.isnan(part).all():
            raise LinkageError(_why_nowhere(scene, error))
    names = _names(scene.mechanism.assembly, list(moving))
    return ToleranceSpread(names, found[0], (up - down) / 2, found[2 * count + 1 :])


def _why_nowhere(scene: Scene, error: Tolerance) -> str:
    """The message about an error with which the loops close at no position."""
    blocks = scene.mechanism.linkage.blocks
    if any(len(block.unknown) < 2 * len(block.loops.loops) for block in blocks):
        return (
            f'{error.name} cannot be off by itself: the loops close nowhere then, since they hold '
            'one distance twice, as three parallel cranks do'
        )
    size = f'{error.deviation:.4g} m or rad'
    return f'{error.name} is off by {size}, and the loops close nowhere then: give less'


def _drawn(errors: Sequence[Tolerance], count: int, rng: np.random.Generator) -> Real:
    """Changes (N, E) at random: normal, or anywhere in a pin's circle or a slot."""
    drawn = rng.normal(size=(count, len(errors))) * [error.deviation for error in errors]
    for k, error in enumerate(errors):
        if error.is_play and len(error.path) == 1:
            drawn[:, k] = error.deviation * _UNIFORM * rng.uniform(-1, 1, count)
        if not error.is_play or len(error.path) == 1 or error.axis:
            continue
        radius = 2 * error.deviation * np.sqrt(rng.random(count))
        turn = 2 * np.pi * rng.random(count)
        drawn[:, k], drawn[:, k + 1] = radius * np.cos(turn), radius * np.sin(turn)
    return np.asarray(drawn)


def _floating(scene: Scene, values: Real) -> frozenset[str]:
    """The wheels whose hubs other joints hold at their distance too, at variables (n,)."""
    assembly, floating = scene.mechanism.assembly, frozenset[str]()
    if assembly.loops.laws:
        return floating
    freedom = mobility(assembly, values)[1]
    for joint in assembly.joints:
        if isinstance(joint, Rolling):
            names = floating | {joint.name}
            floated = assemble(assembly.bodies, [_floated(j, names) for j in assembly.joints])
            if mobility(floated, _widened(scene, floated, values))[1] == freedom:
                floating = names
    return floating


def _floated(joint: Joint, names: Set[str]) -> Joint:
    is_floating = isinstance(joint, Rolling) and joint.name in names
    return joint.changed(floats=True) if is_floating else joint


def _widened(scene: Scene, floated: Assembly, values: Real) -> Real:
    """Variables (n, ...) of a scene with the distances of wheels that float."""
    known = dict(zip(scene.mechanism.assembly.loops.variables, values, strict=True))
    for joint in floated.joints:
        if isinstance(joint, Rolling) and joint.floats:
            distance = joint.arm if joint.circle else joint.radius
            known[f'{joint.name}.distance'] = np.full(values.shape[1:], distance)
    return np.array([known[name] for name in floated.loops.variables])


def _changed(
    data: Mapping[str, Any], errors: Sequence[Tolerance], changes: Real, floating: Set[str]
) -> _Linkage:
    """The linkage and its points with changed dimensions, and wheels that are `floating`."""
    keys = ('bodies', 'joints', 'vectors', 'loops', 'points')
    new = {key: data[key] for key in keys if key in data}
    play: dict[str, float] = {}
    for error, change in zip(errors, changes.tolist(), strict=True):
        if error.is_play and len(error.path) == 1:
            play[str(error.path[0])] = change
        elif change:
            new = _with_change(new, error, change, error.path)
    if 'vectors' in new:
        assembly, points, _ = read_vectors(new['vectors'], new['loops'], new.get('points', {}))
    else:
        assembly, points, _ = read_bodies(new['bodies'], new.get('joints'))
    if play or floating:
        joints = [
            _floated(j.displaced(play[j.name]) if j.name in play else j, floating)
            for j in assembly.joints
        ]
        laws = assembly.loops.laws
        assembly = assemble(assembly.bodies, joints)
        assembly = assembly._replace(loops=assembly.loops._replace(laws=laws))
    return _Linkage(assembly, points)


def _with_change(entry: Any, error: Tolerance, change: float, path: Path) -> Any:
    """The data of a scene, or a part of them, with a change at a path."""
    if path:
        new = entry.copy()
        # A scene may leave out what is zero, such as the angle of a slider.
        written = new.get(path[0]) if isinstance(new, dict) else new[path[0]]
        new[path[0]] = _with_change(written, error, change, path[1:])
        return new
    if error.path[0] == 'bodies':
        # A point has two coordinates, each with an error and the play of a pin.
        point = vector(error.name, entry) + 1j**error.axis * change
        return [point.real, point.imag]
    if isinstance(entry, str) and (base := _RELATIVE_ANGLE.match(entry)):
        return f'{base[1]} + {np.degrees(error.value + change):.15g} deg'
    return error.value + change


def _moving(assembly: Assembly, points: Points) -> dict[str, tuple[int, complex]]:
    """The points of the moving bodies: number of the body, and position in its frame."""
    return {
        name: (assembly.bodies.index(body), point)
        for name, (body, point) in points.items()
        if body in assembly.bodies
    }


def _names(assembly: Assembly, moving: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """The names of `_quantities`, in their order."""
    of_bodies = [
        (body, quantity)
        for quantity in ('angle', 'angular velocity', 'ICR x', 'ICR y')
        for body in assembly.bodies
    ]
    return (*of_bodies, *((name, 'x') for name in moving), *((name, 'y') for name in moving))


def _quantities(
    linkages: Sequence[_Linkage], points: Sequence[str], rows: Real, inputs: Real, values: Real
) -> Real:
    """
    All quantities (linkages, Q, T) for inputs (2, d, T), next to variables (n, T).

    Linkages that differ in lengths and angles alone are solved together.
    """
    of_topology: dict[tuple[bytes | int, ...], list[int]] = {}
    for k, (assembly, _) in enumerate(linkages):
        loops = assembly.loops
        same = loops.lengths, loops.angles, loops.loops, loops.ties, assembly.origins
        # The arguments of laws are dimensions too.
        key = *(array.tobytes() for array in same), k if loops.laws else -1
        of_topology.setdefault(key, []).append(k)
    most = _MOST_POSITIONS // values.shape[1] + 1
    found = np.empty(0)
    for numbers in of_topology.values():
        for first in range(0, len(numbers), most):
            part = numbers[first : first + most]
            solved = _solved([linkages[k] for k in part], points, rows, inputs, values)
            if not found.size:
                found = np.empty((len(linkages), *solved.shape[1:]))
            found[part] = solved
    return found


def _solved(
    linkages: Sequence[_Linkage], points: Sequence[str], rows: Real, inputs: Real, values: Real
) -> Real:
    """All quantities (linkages, Q, T) of linkages that differ in lengths and angles alone."""
    count, positions = len(linkages), values.shape[1]
    assembly, own = _with_inputs([linkage.assembly for linkage in linkages], rows)
    all_inputs = np.zeros((2, len(assembly.loops.drives), count, positions))
    all_inputs[:, : len(rows)] = inputs[:, :, None]
    all_inputs[0, len(rows) :] = own.T[:, :, None]
    guess = np.zeros((len(assembly.loops.variables), count, positions))
    guess[: len(values)] = values[:, None]
    flat_inputs, flat_guess = (a.reshape(*a.shape[:-2], -1) for a in (all_inputs, guess))
    solution = solve(reduce(assembly.loops), flat_inputs, flat_guess, 2)
    position, angle = (
        part.reshape(*part.shape[:-1], count, positions)
        for part in body_motion(assembly, solution.values)
    )
    fastest = np.nanmax(np.abs(angle[1]), axis=(0, 2), keepdims=True, initial=0.0)
    with np.errstate(divide='ignore', invalid='ignore'):
        icr = position[0] + 1j * position[1] / angle[1]
    icr[np.abs(angle[1]) <= _MIN_RATE * fastest] = np.nan
    turn = np.exp(1j * angle[0])
    moved = np.empty((len(points), count, positions), complex)
    for row, name in zip(moved, points, strict=True):
        b = assembly.bodies.index(linkages[0].points[name][0])
        arms = np.array([linkage.points[name][1] for linkage in linkages])
        row[...] = position[0, b] + arms[:, None] * turn[b]
    return np.concatenate((*angle, icr.real, icr.imag, moved.real, moved.imag)).swapaxes(0, 1)


def _with_inputs(assemblies: Sequence[Assembly], rows: Real) -> tuple[Assembly, Real]:
    """
    One linkage for several (K) that differ in lengths and angles alone: these are inputs (K, .).

    They follow those of the drivers with the given `rows` (d, n), and each is a variable or the
    right side of a tie.
    """
    assembly, loops = assemblies[0], assemblies[0].loops
    length0, angle0, tie0 = (
        np.array([getattr(one.loops, name) for one in assemblies])
        for name in ('length0', 'angle0', 'tie0')
    )
    by_length, by_angle, by_tie = (
        (array != array[0]).any(axis=0) for array in (length0, angle0, tie0)
    )
    terms, count = loops.lengths.shape
    added = np.eye(terms)[:, by_length], np.eye(terms)[:, by_angle]
    more = added[0].shape[1] + added[1].shape[1]

    def wider(array: Real) -> Real:
        return np.pad(array, ((0, 0), (0, more)))

    new = loops._replace(
        variables=(*loops.variables, *(f'input {k + 1}' for k in range(more))),
        lengths=np.hstack((loops.lengths, added[0], np.zeros_like(added[1]))),
        length0=np.where(by_length, 0.0, loops.length0),
        angles=np.hstack((loops.angles, np.zeros_like(added[0]), added[1])),
        angle0=np.where(by_angle, 0.0, loops.angle0),
        ties=wider(loops.ties[~by_tie]),
        tie0=loops.tie0[~by_tie],
        drives=np.vstack((wider(rows), wider(loops.ties[by_tie]), np.eye(count + more)[count:])),
    )
    own = np.hstack((tie0[:, by_tie], length0[:, by_length], angle0[:, by_angle]))
    return assembly._replace(loops=new, turns=wider(assembly.turns)), own
