"""A scene solved at one position or over the range of its driver, and what is read off it."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import Centers, Motion, Scene, SceneError, instant_centers, quantity
from kinpole_ros.planar import body_point_derivative

# From a limit, where no rate is finite, the first position keeps this share of the range.
_ASIDE = 1e-3
_TURN = 2 * np.pi
# A value this near to a limit is the limit as printed; so far beyond it is looked for.
_PRINTED, _BEYOND = 1e-10, 1e-6


class Solved(NamedTuple):
    """
    A scene at T positions: `inputs` (d, T) of its drivers, `motion` by time, at the rates `rates`.

    `limits` are the lowest and highest input if a limit ends the range there, else None.
    """

    scene: Scene
    inputs: np.ndarray
    rates: np.ndarray
    motion: Motion
    limits: tuple[float | None, float | None]

    @property
    def values(self) -> np.ndarray:
        """Variables (n, T)."""
        return np.asarray(self.motion.values[0])


def solve_positions(scene: Scene, at: str | None, count: int | None) -> Solved:
    """
    The scene at one position, or at `count` over the range of its one driver.

    Derivatives that rounding has drowned, next to change points, are NaN.
    """
    mechanism = scene.mechanism
    now = np.stack([driver.motion(np.zeros(1)) for driver in scene.mechanism.drivers], axis=1)
    if at is None and count is None:
        motion = _sound(mechanism.motion(np.zeros(1)))
        return Solved(scene, now[0], now[1, :, 0], motion, (None, None))
    if len(mechanism.drivers) != 1:
        raise SceneError(
            f'{scene.name} has {len(mechanism.drivers)} drivers: --at, --sweep, --plot and --pitch '
            'are for one; leave them out, or hold the others'
        )
    # As fast as it is driven at time 0, or one unit per second if that is at rest.
    rate = float(now[1, 0, 0]) or 1.0
    limits: tuple[float | None, float | None] = (None, None)
    if count is None:
        values = np.array([quantity('--at', at, scene.mechanism.kind(0))])
        solved = _at_rate(scene, values, rate, limits)
        return _at_limit(solved) if _is_limit(scene, float(values[0])) else solved
    low, high, limits = _range(scene, float(now[0, 0, 0]))
    values = np.linspace(low, high, count)
    return _at_rate(scene, values, rate, limits)


def _is_limit(scene: Scene, value: float) -> bool:
    """Whether the one driver turns back at this value, but for the digits that are printed."""
    size = max(1.0, abs(value))
    if not scene.mechanism.linkage.blocks:
        return False
    path = scene.mechanism.path(value - _BEYOND * size, value + _BEYOND * size)
    ends = [dead.at for dead in path.dead_points if dead.turns_back]
    return any(abs(end - value) <= _PRINTED * size for end in ends)


def _at_limit(solved: Solved) -> Solved:
    """The same where rates have no bound: what is off by the last digit is none of its own."""
    motion = solved.motion
    for part in (motion.position, motion.angle, motion.values):
        part[1:] = np.nan
    return solved._replace(motion=motion._replace(regular=np.zeros_like(motion.regular)))


def drawn(whole: Solved, here: Solved) -> Solved:
    """The position of `here`, driven at the rate of the range `whole`."""
    return _at_rate(whole.scene, here.inputs[0], float(whole.rates[0]), (None, None))


def _at_rate(
    scene: Scene, values: np.ndarray, rate: float, limits: tuple[float | None, float | None]
) -> Solved:
    """The scene at values (T,) of its one driver, which moves at a steady rate."""
    inputs = np.zeros((5, 1, len(values)))
    inputs[0, 0], inputs[1] = values, rate
    motion = _sound(scene.mechanism.at_inputs(inputs, None))
    return Solved(scene, inputs[0], np.array([rate]), motion, limits)


def _sound(motion: Motion) -> Motion:
    for k in range(1, len(motion.values)):
        for part in (motion.position, motion.angle, motion.values):
            part[k][:, motion.sound <= k] = np.nan
    return motion


def _range(scene: Scene, start: float) -> tuple[float, float, tuple[float | None, float | None]]:
    """The range of the one driver: a full turn, what the scene drives, or up to the limits."""
    driver = scene.mechanism.drivers[0]
    angle = scene.mechanism.kind(0) == 'angle'
    if angle:
        low, high = start - _TURN, start + _TURN
    elif driver.low < driver.high:
        low, high = driver.low, driver.high
    elif scene.mechanism.linkage.blocks:
        # Driven at a steady rate, a length goes as far as the linkage lets it.
        reach = float(scene.mechanism.assembly.loops.length0.sum())
        low, high = start - reach, start + reach
    else:
        raise SceneError(
            f'{driver.name} is driven steadily and nothing ends its way: there is no range; drive '
            'it from: ..., to: ..., duration: ...'
        )
    if not scene.mechanism.linkage.blocks:
        return (start, start + _TURN, (None, None)) if angle else (low, high, (None, None))
    path = scene.mechanism.path(low, high)
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
    if limits == [None, None] and angle:
        low, high = start, start + _TURN
    return low, high, (limits[0], limits[1])


def point_motions(solved: Solved) -> dict[str, np.ndarray]:
    """The named points of the moving bodies, each (3, T) complex: place, velocity, acceleration."""
    motion = solved.motion
    bodies = list(solved.scene.mechanism.bodies)
    found = {}
    for name, (body, point) in solved.scene.points.items():
        if body in bodies:
            position, angle = (
                part[:, bodies.index(body)] for part in (motion.position, motion.angle)
            )
            place = position[0] + point * np.exp(1j * angle[0])
            rates = [body_point_derivative(k, place, position, angle) for k in (1, 2)]
            found[name] = np.stack([place, *rates])
    return found


def centers_of(solved: Solved) -> Centers:
    rates = solved.rates if len(solved.rates) > 1 else None
    return instant_centers(solved.scene.mechanism, solved.values, rates)


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
