"""A scene solved at one position, over the range of its driver, or over time."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros import files
from kinpole_ros.mechanism import (
    Centers,
    Force,
    LinkageError,
    Load,
    Mechanism,
    Motion,
    Port,
    Scene,
    SceneError,
    advantage,
    instant_centers,
    quantity,
)
from kinpole_ros.mechanism._loads import inertial_loads, spring_loads
from kinpole_ros.planar import body_point_derivative

# At a limit rates are infinite, so a range starts this fraction of its length inside.
_LIMIT_MARGIN = 1e-3
# A value within this relative distance of a limit is the limit, printed with nine digits.
_LIMIT_ROUNDING = 5e-9
# Limits are searched this far (relative) on both sides of a value.
_LIMIT_SEARCH = 1e-6
# Rates below this fraction of the fastest body's are rounding.
_RATE_ROUNDING = 1e-9

Limits = tuple[float | None, float | None]


class SolvedScene(NamedTuple):
    """
    A scene at T positions.

    `inputs` (d, T) and `rates` (d, T) are the values of its drivers and their rates; `motion` has
    derivatives with respect to time. `limits` are the lowest and highest input, None where the
    range does not end at a limit of the linkage. `times` (T,), s, is None for positions that do not
    follow the motion that the drivers prescribe.
    """

    scene: Scene
    inputs: np.ndarray
    rates: np.ndarray
    motion: Motion
    limits: Limits = (None, None)
    times: np.ndarray | None = None

    def at(self, k: int | Sequence[int]) -> 'SolvedScene':
        """Return the position `k` alone, or several in this order."""
        k = [k] if isinstance(k, int) else list(k)
        times = None if self.times is None else self.times[k]
        motion = Motion(*(part[..., k] for part in self.motion))
        return self._replace(
            inputs=self.inputs[:, k], rates=self.rates[:, k], motion=motion, times=times
        )

    @property
    def values(self) -> np.ndarray:
        """The variables of the loops (n, T)."""
        return np.asarray(self.motion.values[0])


def over_time(scene: Scene, times: np.ndarray) -> SolvedScene:
    """Solve the motion that the drivers prescribe, at times (T,) in s."""
    inputs = np.stack([driver.motion(times) for driver in scene.mechanism.drivers], axis=1)
    motion = _without_rounding(scene.mechanism.motion(times))
    return SolvedScene(scene, inputs[0], inputs[1], motion, times=times)


def over_duration(scene: Scene, duration: str | None, count: int) -> SolvedScene:
    """
    Solve the motion that the drivers prescribe, at `count` times from 0 s.

    `duration` has a unit, or is in s; None ends when all drivers have ended.
    """
    if duration is None:
        end = scene.course
        if end <= 0:
            raise SceneError(f'the drivers of {scene.name} have no end; give --time 2, in s')
    else:
        end = quantity('--time', duration, 'time')
        if end <= 0:
            raise SceneError(f'--time is {duration!r}; it must be greater than 0, as 2 or 500 ms')
    return over_time(scene, np.linspace(0.0, end, count))


def unit_note(scene: Scene, at: str) -> str:
    """Return which unit a driver value without a unit was taken in; '' for one with a unit."""
    try:
        value = float(at)
    except ValueError:
        return ''
    if scene.mechanism.kind(0) == 'angle':
        return (
            f'--at {at} has no unit: taken as {value:g} rad = {np.degrees(value):.5g} deg; '
            f"for degrees write --at '{at} deg'"
        )
    return f"--at {at} has no unit: taken as {value:g} m; for centimeters write --at '{at} cm'"


def at_value(scene: Scene, at: str) -> SolvedScene:
    """Solve the scene with its one driver at a value with a unit, or in rad or m."""
    _check_one_driver(scene, '--at')
    value = quantity('--at', at, scene.mechanism.kind(0))
    try:
        return _at_input(scene, value)
    except (SceneError, LinkageError) as error:
        if not (note := unit_note(scene, at)):
            raise
        raise SceneError(f'{error}; {note}') from None


def _at_input(scene: Scene, value: float) -> SolvedScene:
    """Solve the scene with its one driver at a value in rad or m."""
    limit = _limit_near(scene, value)
    if limit is None:
        return at_rate(scene, np.array([value]), driver_rate(scene))
    # Rates are infinite at a limit; those at the rounded value would be arbitrary.
    solution = at_rate(scene, np.array([limit]), driver_rate(scene))
    motion = solution.motion
    for part in (motion.position, motion.angle, motion.values):
        part[1:] = np.nan
    return solution._replace(motion=motion._replace(regular=np.zeros_like(motion.regular)))


def over_range(scene: Scene, count: int) -> SolvedScene:
    """
    Solve the scene at `count` positions over the range that the linkage allows its one driver.

    Derivatives next to change points that are mostly rounding are NaN.
    """
    _check_one_driver(scene, '--sweep')
    low, high, limits = _range(scene)
    return at_rate(scene, np.linspace(low, high, count), driver_rate(scene), limits)


def over_full_motion(scene: Scene, count: int) -> SolvedScene:
    """Solve the range of the one driver, or else the motion that the drivers prescribe."""
    try:
        return over_range(scene, count)
    except SceneError:  # several drivers, or one without a limit
        return over_duration(scene, None, count)


def _check_one_driver(scene: Scene, option: str) -> None:
    count = len(scene.mechanism.drivers)
    if count != 1:
        raise SceneError(
            f'{scene.name} has {count} drivers, and {option} needs one; give --time 2, for the '
            'motion of all drivers in 2 s'
        )


def driver_rate(scene: Scene) -> float:
    """Return the rate of the first driver at time 0, or one unit per second if it is at rest."""
    return float(scene.mechanism.drivers[0].motion(np.zeros(1))[1, 0]) or 1.0


def _limit_near(scene: Scene, value: float) -> float | None:
    """Return the limit of the driver that a value stands for, but for the digits printed."""
    if not scene.mechanism.linkage.blocks:
        return None
    size = max(1.0, abs(value))
    path = scene.mechanism.path(value - _LIMIT_SEARCH * size, value + _LIMIT_SEARCH * size)
    limits = [dead.at for dead in path.dead_points if dead.turns_back]
    return next((limit for limit in limits if abs(limit - value) <= _LIMIT_ROUNDING * size), None)


def at_rate(
    scene: Scene, values: np.ndarray, rate: float, limits: Limits = (None, None)
) -> SolvedScene:
    """Solve the scene at values (T,) of its one driver, which moves at a constant rate."""
    inputs = np.zeros((5, 1, len(values)))
    inputs[0, 0], inputs[1] = values, rate
    motion = _without_rounding(scene.mechanism.at_inputs(inputs, None))
    return SolvedScene(scene, inputs[0], inputs[1], motion, limits)


def _without_rounding(motion: Motion) -> Motion:
    """Replace derivatives that have no correct digits by NaN."""
    for k in range(1, len(motion.values)):
        for part in (motion.position, motion.angle, motion.values):
            part[k][:, motion.sound <= k] = np.nan
    return motion


def _range(scene: Scene) -> tuple[float, float, Limits]:
    """Return the range of the one driver: a full turn, or up to the limits."""
    mechanism = scene.mechanism
    driver, is_angle = mechanism.drivers[0], mechanism.kind(0) == 'angle'
    start = float(driver.motion(np.zeros(1))[0, 0])
    unlimited = SceneError(
        f'the driver {driver.name} has no limits, so it has no range; give --time 2, for its '
        'motion in 2 s'
    )
    if not mechanism.linkage.blocks:
        if not is_angle:
            raise unlimited
        return start, start + 2 * np.pi, (None, None)
    # A length is limited by the linkage, which extends no further than all its lengths.
    extent = 2 * np.pi if is_angle else 2 * float(mechanism.assembly.loops.length0.sum())
    path = mechanism.path(start - extent, start + extent)
    if path.period:
        return start, start + path.period, (None, None)
    low, high = first, last = float(path.inputs[0]), float(path.inputs[-1])
    limits: list[float | None] = [None, None]
    margin = _LIMIT_MARGIN * (last - first)
    for limit in (dead.at for dead in path.dead_points if dead.turns_back):
        if abs(limit - first) < margin:
            limits[0], low = limit, limit + margin
        elif abs(limit - last) < margin:
            limits[1], high = limit, limit - margin
    if not is_angle and None in limits:
        raise unlimited
    if limits == [None, None]:
        low, high = start, start + 2 * np.pi
    return low, high, (limits[0], limits[1])


def point_motions(solution: SolvedScene) -> dict[str, np.ndarray]:
    """Return the named points of the moving bodies, each (4, T) complex: position to jerk."""
    motion = solution.motion
    bodies = solution.scene.mechanism.bodies
    motions = {}
    for name, (body, point) in solution.scene.points.items():
        if body in bodies:
            position, angle = (z[:, bodies.index(body)] for z in (motion.position, motion.angle))
            at = position[0] + point * np.exp(1j * angle[0])
            rates = [body_point_derivative(k, at, position, angle) for k in (1, 2, 3)]
            motions[name] = np.stack([at, *rates])
    return motions


def centers_of(solution: SolvedScene) -> Centers:
    """Return the instant centers; with several drivers, for their rates."""
    rates = solution.rates if len(solution.rates) > 1 else None
    return instant_centers(solution.scene.mechanism, solution.values, rates)


def angle_rates(motion: Motion) -> np.ndarray:
    """Return angles and their derivatives (5, B, T), without the rounding of bodies at rest."""
    angles = np.array(motion.angle)
    fastest = np.nanmax(np.abs(angles[1]), initial=0.0)
    for order in range(1, len(angles)):
        angles[order][np.abs(angles[order]) < _RATE_ROUNDING * fastest**order] = 0.0
    return angles


class ActingLoads(NamedTuple):
    """All loads on the bodies: those of the scene, of springs, and of the inertia of masses."""

    external: list[Load]
    springs: list[Load]
    inertia: list[Load]

    @property
    def loads(self) -> list[Load]:
        """The loads in one list."""
        return [*self.external, *self.springs, *self.inertia]


def acting_loads(solution: SolvedScene) -> ActingLoads:
    """Return the loads at all positions."""
    scene, mechanism = solution.scene, solution.scene.mechanism
    return ActingLoads(
        [*scene.loads],
        spring_loads(mechanism, solution.values, scene.springs),
        inertial_loads(mechanism, solution.motion, scene.masses),
    )


def require_loads(solution: SolvedScene) -> ActingLoads:
    """Return the loads at the first position; raise SceneError if there are none."""
    loads = acting_loads(solution.at(0))
    if not loads.loads:
        raise SceneError(
            f'{solution.scene.name} has no loads; add them, as loads: [{{weight: 10 kg, at: '
            'BODY.POINT}]'
        )
    return loads


def advantages(solution: SolvedScene) -> dict[tuple[str, str], np.ndarray]:
    """
    Return mechanical advantages (T,) over the one driver, by name and unit of the output.

    The output is a torque on a body or a force along a length, in its positive direction, or a
    force against a load of the scene. With several drivers there are none, since they depend on
    the other drivers.
    """
    scene, mechanism = solution.scene, solution.scene.mechanism
    if len(mechanism.drivers) != 1:
        return {}
    driver, is_angle = mechanism.drivers[0].name, mechanism.kind(0) == 'angle'
    ports: dict[tuple[str, str], Port] = {}
    for name, kind in mechanism.assembly.kinds.items():
        # Nothing pushes on the direction of a strut, or of the hub of a gear.
        is_direction = (
            kind == 'angle' and mechanism.assembly.joints and name not in mechanism.bodies
        )
        if name != driver and not is_direction:
            ports[name, _ADVANTAGE_UNITS[is_angle, kind == 'angle']] = name
    for load in scene.loads:
        if isinstance(load, Force) and load.force:
            ports[f'the force at {point_name(scene, load)}', _ADVANTAGE_UNITS[is_angle, False]] = (
                load
            )
    return {
        key: advantage(mechanism, solution.values, driver, port)
        if isinstance(port, str)
        else advantage_of(mechanism, solution.values, driver, port)
        for key, port in ports.items()
    }


def advantage_of(mechanism: Mechanism, values: np.ndarray, into: Port, load: Load) -> np.ndarray:
    """Return the advantage (T,) of what the mechanism exerts against a load."""
    if isinstance(load, Force):
        return advantage(mechanism, values, into, load._replace(force=-np.asarray(load.force)))
    gain = advantage(mechanism, values, into, load)
    return np.where(np.isinf(gain), gain, -np.sign(load.torque) * gain)


# By whether the driver, and whether the output, is an angle.
_ADVANTAGE_UNITS = {
    (True, True): '',
    (False, False): '',
    (True, False): 'N/(N m)',
    (False, True): 'N m/N',
}


def point_name(scene: Scene, load: Force) -> str:
    """Return the name of the point at which a force acts."""
    return next(n for n, point in scene.points.items() if point == (load.body, load.point))


def driver_unit(scene: Scene, k: int) -> tuple[str, float]:
    """Return the unit in which the values of driver `k` are shown, and its size in SI."""
    return ('deg', np.pi / 180) if scene.mechanism.kind(k) == 'angle' else ('m', 1.0)


def variable_lengths(scene: Scene) -> dict[str, int]:
    """Return the indices of the variables that are lengths, such as slides, by name."""
    kinds = scene.mechanism.assembly.kinds
    return {name: n for n, (name, kind) in enumerate(kinds.items()) if kind == 'length'}


def driver_text(scene: Scene, k: int, value: float, digits: int = 9) -> str:
    """Return a value of driver `k` with its unit."""
    unit, size = driver_unit(scene, k)
    return f'{value / size if abs(value) > 1e-12 else 0.0:.{digits}g} {unit}'


@contextmanager
def open_output(path: str | Path) -> Iterator[Path]:
    """Yield a path to write to, which replaces `path` at the end; raise SceneError on failure."""
    try:
        with files.whole_file(path) as part:
            yield part
    except OSError as error:
        raise SceneError(
            f'{path} cannot be written: {error.strerror}; '
            'fix: check the path, its rights and the space on the disk'
        ) from None
