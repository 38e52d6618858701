"""A scene solved at one position, over its range or over time, and what is read off it."""

from collections.abc import Iterator
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
    Motion,
    Port,
    Scene,
    SceneError,
    advantage,
    inertial_loads,
    instant_centers,
    quantity,
    spring_loads,
)
from kinpole_ros.planar import body_point_derivative

# From a limit, where no rate is finite, the first position keeps this share of the range.
_ASIDE = 1e-3
_TURN = 2 * np.pi
# A value this near to a limit is the limit as printed, with nine digits; so far beyond it is
# looked for.
_PRINTED, _BEYOND = 5e-9, 1e-6
# Of what the fastest body has, rates below this are rounding.
_NOISE = 1e-9

Limits = tuple[float | None, float | None]


class Solved(NamedTuple):
    """
    A scene at T positions: `inputs` (d, T) of its drivers, `motion` by time, at the rates `rates`
    (d, T).

    `limits` are the lowest and highest input if a limit ends the range there, else None. `times`
    (T,), s, are there where the positions are those of the drivers' own course.
    """

    scene: Scene
    inputs: np.ndarray
    rates: np.ndarray
    motion: Motion
    limits: Limits = (None, None)
    times: np.ndarray | None = None

    def at(self, k: int) -> 'Solved':
        """The same at position `k` alone."""
        one = [k]
        motion = Motion(*(part[..., one] for part in self.motion))
        times = None if self.times is None else self.times[one]
        return self._replace(
            inputs=self.inputs[:, one], rates=self.rates[:, one], motion=motion, times=times
        )

    @property
    def values(self) -> np.ndarray:
        """Variables (n, T)."""
        return np.asarray(self.motion.values[0])


def over_time(scene: Scene, times: np.ndarray) -> Solved:
    """The scene as its drivers move it, at times (T,) in s."""
    inputs = np.stack([driver.motion(times) for driver in scene.mechanism.drivers], axis=1)
    return Solved(scene, inputs[0], inputs[1], _sound(scene.mechanism.motion(times)), times=times)


def course(scene: Scene, duration: str | None, count: int) -> Solved:
    """
    The drivers' own course from 0 s on, at `count` times.

    `duration` has a unit, or is in s; without, it ends when all drivers have been through theirs.
    """
    if duration is None:
        end = scene.course
        if end <= 0:
            raise SceneError(f'the drivers of {scene.name} go on for ever: give --time 2, in s')
    else:
        end = quantity('--time', duration, 'time')
        if end <= 0:
            raise SceneError(f'--time is {duration!r}: give one greater than 0, as 2 or 500 ms')
    return over_time(scene, np.linspace(0.0, end, count))


def drawn(whole: Solved, here: Solved) -> Solved:
    """The position of `here`, driven at the rate of the range `whole` if that is one."""
    if whole.times is not None:
        return here
    return _at_rate(whole.scene, here.inputs[0], float(whole.rates[0, 0]))


def unit_note(scene: Scene, at: str) -> str:
    """
    Say which unit a value of the one driver without a unit was taken in, and how to give another.

    Empty where the value has a unit.
    """
    try:
        value = float(at)
    except ValueError:
        return ''
    if scene.mechanism.kind(0) == 'angle':
        degrees = np.degrees(value)
        return (
            f'--at {at} has no unit: taken as {value:g} rad = {degrees:.5g} deg; '
            f"for degrees write --at '{at} deg'"
        )
    return f"--at {at} has no unit: taken as {value:g} m; for centimeters write --at '{at} cm'"


def at_value(scene: Scene, at: str) -> Solved:
    """The scene with its one driver at a value, which has a unit or is in SI."""
    _one_driver(scene, '--at')
    value = quantity('--at', at, scene.mechanism.kind(0))
    try:
        return _at_input(scene, value)
    except (SceneError, LinkageError) as error:
        if not (note := unit_note(scene, at)):
            raise
        raise SceneError(f'{error}; {note}') from None


def _at_input(scene: Scene, value: float) -> Solved:
    """The scene with its one driver at a value, rad or m."""
    limit = _limit(scene, value)
    if limit is None:
        return _at_rate(scene, np.array([value]), _rate(scene))
    # Rates have no bound there: those of a value off by its last digit are none of its own.
    solved = _at_rate(scene, np.array([limit]), _rate(scene))
    motion = solved.motion
    for part in (motion.position, motion.angle, motion.values):
        part[1:] = np.nan
    return solved._replace(motion=motion._replace(regular=np.zeros_like(motion.regular)))


def over_range(scene: Scene, count: int) -> Solved:
    """
    The scene at `count` positions over all the way that the linkage gives its one driver.

    Derivatives that rounding has drowned, next to change points, are NaN.
    """
    _one_driver(scene, '--sweep')
    low, high, limits = _range(scene)
    return _at_rate(scene, np.linspace(low, high, count), _rate(scene), limits)


def everywhere(scene: Scene, count: int) -> Solved:
    """All the way that the linkage gives its one driver, else the drivers' own course."""
    try:
        return over_range(scene, count)
    except SceneError:
        # Several drivers, or one that nothing stops.
        return course(scene, None, count)


def _one_driver(scene: Scene, option: str) -> None:
    if len(scene.mechanism.drivers) != 1:
        raise SceneError(
            f'{scene.name} has {len(scene.mechanism.drivers)} drivers: {option} is for one; give '
            '--time 2, for how they all move in 2 s'
        )


def _rate(scene: Scene) -> float:
    """As fast as it is driven at time 0, or one unit per second if that is at rest."""
    return float(scene.mechanism.drivers[0].motion(np.zeros(1))[1, 0]) or 1.0


def _limit(scene: Scene, value: float) -> float | None:
    """Where the one driver turns back, if that is this value but for the digits printed."""
    if not scene.mechanism.linkage.blocks:
        return None
    size = max(1.0, abs(value))
    path = scene.mechanism.path(value - _BEYOND * size, value + _BEYOND * size)
    ends = [dead.at for dead in path.dead_points if dead.turns_back]
    return next((end for end in ends if abs(end - value) <= _PRINTED * size), None)


def _at_rate(
    scene: Scene, values: np.ndarray, rate: float, limits: Limits = (None, None)
) -> Solved:
    """The scene at values (T,) of its one driver, which moves at a steady rate."""
    inputs = np.zeros((5, 1, len(values)))
    inputs[0, 0], inputs[1] = values, rate
    motion = _sound(scene.mechanism.at_inputs(inputs, None))
    return Solved(scene, inputs[0], inputs[1], motion, limits)


def _sound(motion: Motion) -> Motion:
    for k in range(1, len(motion.values)):
        for part in (motion.position, motion.angle, motion.values):
            part[k][:, motion.sound <= k] = np.nan
    return motion


def _range(scene: Scene) -> tuple[float, float, Limits]:
    """The range of the one driver: a full turn, or up to the limits."""
    mechanism = scene.mechanism
    driver, angle = mechanism.drivers[0], mechanism.kind(0) == 'angle'
    start = float(driver.motion(np.zeros(1))[0, 0])
    endless = SceneError(
        f'nothing ends the way of {driver.name}: there is no range; give --time 2, for how far it '
        'is driven in 2 s'
    )
    if not mechanism.linkage.blocks:
        if not angle:
            raise endless
        return start, start + _TURN, (None, None)
    # A length goes as far as the linkage lets it.
    reach = _TURN if angle else 2 * float(mechanism.assembly.loops.length0.sum())
    path = mechanism.path(start - reach, start + reach)
    if path.period:
        return start, start + path.period, (None, None)
    found = float(path.inputs[0]), float(path.inputs[-1])
    ends = [dead.at for dead in path.dead_points if dead.turns_back]
    limits: list[float | None] = [None, None]
    near = 1e-3 * (found[1] - found[0])
    aside = _ASIDE * (found[1] - found[0])
    low, high = found
    for end in ends:
        if abs(end - found[0]) < near:
            limits[0], low = end, end + aside
        elif abs(end - found[1]) < near:
            limits[1], high = end, end - aside
    if not angle and None in limits:
        raise endless
    if limits == [None, None]:
        low, high = start, start + _TURN
    return low, high, (limits[0], limits[1])


def point_motions(solved: Solved) -> dict[str, np.ndarray]:
    """The named points of the moving bodies, each (4, T) complex: place to jerk."""
    motion = solved.motion
    bodies = list(solved.scene.mechanism.bodies)
    found = {}
    for name, (body, point) in solved.scene.points.items():
        if body in bodies:
            position, angle = (
                part[:, bodies.index(body)] for part in (motion.position, motion.angle)
            )
            place = position[0] + point * np.exp(1j * angle[0])
            rates = [body_point_derivative(k, place, position, angle) for k in (1, 2, 3)]
            found[name] = np.stack([place, *rates])
    return found


def centers_of(solved: Solved) -> Centers:
    several = len(solved.rates) > 1
    return instant_centers(solved.scene.mechanism, solved.values, solved.rates if several else None)


def rates_of(motion: Motion) -> np.ndarray:
    """Angles and their derivatives (5, B, T), zero where they are rounding next to the fastest."""
    found = np.array(motion.angle)
    fastest = np.nanmax(np.abs(found[1]), initial=0.0)
    for order in range(1, len(found)):
        found[order][np.abs(found[order]) < _NOISE * fastest**order] = 0.0
    return found


class Acting(NamedTuple):
    """All that acts on the bodies: the scene's `loads`, `springs` and the `inertia` of masses."""

    loads: list[Load]
    springs: list[Load]
    inertia: list[Load]

    @property
    def all(self) -> list[Load]:
        return [*self.loads, *self.springs, *self.inertia]


def loaded_by(solved: Solved) -> Acting:
    """What acts at the first position; raises SceneError where that is nothing."""
    acts = acting(solved.at(0))
    if not acts.all:
        raise SceneError(
            f'{solved.scene.name} has no loads: add them, as loads: [{{weight: 10 kg, at: '
            'BODY.POINT}]'
        )
    return acts


def acting(solved: Solved) -> Acting:
    """What acts at all positions (T,)."""
    scene, mechanism = solved.scene, solved.scene.mechanism
    return Acting(
        [*scene.loads],
        spring_loads(mechanism, solved.values, scene.springs),
        inertial_loads(mechanism, solved.motion, scene.masses),
    )


def advantages(solved: Solved) -> dict[tuple[str, str], np.ndarray]:
    """
    Mechanical advantages (T,) of bodies, lengths and forces over the one driver, by name and unit.

    That of a body is of a torque on it, that of a length of a force along it, that of a force of
    one at its point in its direction. None with several drivers, where they depend on these.
    """
    scene, mechanism = solved.scene, solved.scene.mechanism
    if len(mechanism.drivers) != 1:
        return {}
    driver, kinds = mechanism.drivers[0].name, mechanism.assembly.kinds
    angle = mechanism.kind(0) == 'angle'
    ports: dict[tuple[str, str], Port] = {}
    for name, kind in kinds.items():
        # The direction of a strut, or of a gear's hub, is nothing to push on.
        way = kind == 'angle' and mechanism.assembly.joints and name not in mechanism.bodies
        if name != driver and not way:
            ports[name, _UNITS[angle, kind == 'angle']] = name
    for load in scene.loads:
        if isinstance(load, Force) and load.force:
            name = next(n for n, place in scene.points.items() if place == (load.body, load.point))
            ports[f'the force at {name}', _UNITS[angle, False]] = load
    return {key: advantage(mechanism, solved.values, driver, port) for key, port in ports.items()}


# Of an advantage, by whether the driver and whether the output is an angle.
_UNITS = {(True, True): '', (False, False): '', (True, False): 'N/(N m)', (False, True): 'N m/N'}


def driver_unit(scene: Scene, k: int) -> tuple[str, float]:
    """The unit the values of a driver are shown in, and how large that is in SI."""
    return ('deg', np.pi / 180) if scene.mechanism.kind(k) == 'angle' else ('m', 1.0)


def lengths(scene: Scene) -> dict[str, int]:
    """The slides and other lengths that change, by name, and which variables they are."""
    kinds = scene.mechanism.assembly.kinds
    return {name: n for n, (name, kind) in enumerate(kinds.items()) if kind == 'length'}


def shown(scene: Scene, k: int, value: float, digits: int = 9) -> str:
    unit, size = driver_unit(scene, k)
    return f'{value / size if abs(value) > 1e-12 else 0.0:.{digits}g} {unit}'


@contextmanager
def writing(path: str | Path) -> Iterator[Path]:
    """A place to write it to until it is whole; says which file it was that could not be."""
    try:
        with files.whole_file(path) as part:
            yield part
    except OSError as error:
        raise SceneError(
            f'{path} cannot be written: {error.strerror}; '
            'fix: check the path, its rights and the space on the disk'
        ) from None
