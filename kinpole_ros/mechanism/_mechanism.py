"""
A linkage that is driven: the poses of all its bodies and their motion, at any time or input.

Combines bodies and joints (`_assembly`), the algebra of their loops (`_loops`), the branch they are
on (`_path`) and their drivers (`_laws`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinpole_ros.mechanism._assembly import Assembly, body_motion
from kinpole_ros.mechanism._dead_points import loop_names, most_singular, unit_input
from kinpole_ros.mechanism._loop_closure import Solution, solve, sound_orders
from kinpole_ros.mechanism._loops import LinkageError, ReducedLoops, reduce
from kinpole_ros.mechanism._motions import ORDERS
from kinpole_ros.mechanism._path import Path, PathTable, initial_guess, tabulate, trace
from kinpole_ros.planar._plane import Complex, Real

# Positions at a time: fewer cost more calls, more leave the cache (1e5 of a four-bar to its
# accelerations: 9.2 ms with 6144, 8.6 with 8192, 14.7 with 12500).
_CHUNK = 8192


class Driver(NamedTuple):
    """
    A prescribed variable, or difference of two: variables @ row = value.

    `name` is for messages; `row` (n,); `motion(t)` gives the value and its derivatives (5, ...) at
    times (...) in s; `low` and `high` bound its range, infinite where only the linkage does.
    """

    name: str
    row: Real
    motion: Callable[[Real], Real]
    low: float = -np.inf
    high: float = np.inf


class Motion(NamedTuple):
    """
    All bodies (B) of a linkage, with the derivatives by time or by the input.

    `position` (5, B, ...) of their origins is complex, m; `angle` (5, B, ...), rad; `values`
    (5, n, ...) are the variables. `regular` (...) tells where the derivatives are determined,
    `sound` (...) how many orders have digits, which next to change points are not all.
    """

    position: Complex
    angle: Real
    values: Real
    regular: np.ndarray
    sound: np.ndarray


class UnitRates(NamedTuple):
    """
    Motions of a linkage at T positions, each at unit rate of one of its drivers (d).

    `velocity` (d, B, T), complex, is that of the bodies' origins, `omega` (d, B, T) the angular
    one, `variables` (d, n, T) the rates of the variables; NaN where they are not `regular` (T,).
    """

    velocity: Complex
    omega: Real
    variables: Real
    regular: np.ndarray


@dataclass(eq=False)
class Mechanism:
    """
    Bodies on joints, with drivers.

    `start` (n,) is roughly the position it is drawn in: the branch is the one next to it, at the
    inputs it has at time 0.
    """

    assembly: Assembly
    drivers: tuple[Driver, ...]
    start: Real
    _path: Path | None = field(default=None, init=False)
    _table: PathTable | None = field(default=None, init=False)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names (B,) of the moving bodies."""
        return self.assembly.bodies

    @property
    def driver_rows(self) -> Real:
        """The rows (d, n) of the drivers."""
        return np.array([driver.row for driver in self.drivers]).reshape(-1, len(self.start))

    @cached_property
    def linkage(self) -> ReducedLoops:
        """The loops with the drivers, reduced to their unknowns; raises LinkageError."""
        return reduce(self.assembly.loops._replace(drives=self.driver_rows))

    def motion(self, t: npt.ArrayLike, orders: int = ORDERS) -> Motion:
        """
        The motion of all bodies at times of any shape (...), in s; `orders` 3 is to accelerations.

        Raises LinkageError where the linkage cannot follow its drivers so far, with the time.
        """
        times = np.asarray(t, dtype=float)
        flat = times.ravel()
        motion = self.at_inputs(self._inputs(flat), flat, orders)
        return Motion(*(part.reshape((*part.shape[:-1], *times.shape)) for part in motion))

    def sweep(self, at: Real, orders: int = ORDERS) -> Motion:
        """The motion of all bodies at the inputs `at` (T,) of the one driver, by that input."""
        at = np.asarray(at, dtype=float)
        if len(self.drivers) != 1:
            raise LinkageError('a sweep is over one driver: hold the others')
        return self._at(lambda part: unit_input(at[part], orders), len(at), at, None, orders)

    def unit_rates(self, values: Real) -> UnitRates:
        """The motion at unit rate of each driver, the others held, at variables (n, T) as given."""
        drivers, count = len(self.drivers), values.shape[1]
        solutions = [self.rates(values, k) for k in range(drivers)]
        variables = np.reshape([solution.values[1] for solution in solutions], (-1, *values.shape))
        regular = (solutions or [self.rates(values)])[0].regular
        shape = drivers, len(self.bodies), count
        moving = [body_motion(self.assembly, solution.values) for solution in solutions]
        velocity = np.reshape([position[1] for position, _ in moving], shape)
        omega = np.reshape([angle[1] for _, angle in moving], shape)
        return UnitRates(velocity, omega, variables, regular)

    def rates(self, values: Real, driver: int | None = None) -> Solution:
        """The first-order solution at variables (n, T), at unit rate of one driver or at rest."""
        inputs = np.zeros((2, len(self.drivers), values.shape[1]))
        inputs[0] = self.driver_rows @ values
        if driver is not None:
            inputs[1, driver] = 1.0
        return solve(self.linkage, inputs, values, 2, close=False)

    def dead_loop(self, values: Real) -> tuple[str, ...]:
        """The joints, or vectors, of the loops that are in a dead point at variables (n,)."""
        return loop_names(self.linkage, most_singular(self.rates(values[:, None])))

    def at_inputs(self, inputs: Real, times: Real | None, orders: int = ORDERS) -> Motion:
        """
        The motion of all bodies at `inputs` (orders or more, d, T), by the parameter of these.

        `times` (T,) are those of the inputs, the parameter of the branch for several drivers.
        """
        along = inputs[0, 0] if len(self.drivers) == 1 else times
        return self._at(lambda part: inputs[:, :, part], inputs.shape[-1], along, times, orders)

    def _at(
        self,
        inputs: Callable[[slice], Real],
        count: int,
        along: Real | None,
        times: Real | None,
        orders: int,
    ) -> Motion:
        """The motion at `inputs(part)` for parts of all positions; `along` is their parameter."""
        table = None
        if self.linkage.blocks and count:
            if along is None:
                raise LinkageError('a sweep is over one driver: hold the others')
            self.path(float(along.min()), float(along.max()))
            table = self._table
        shape = orders, len(self.bodies), count
        position, angle = np.empty(shape, complex), np.empty(shape)
        values, regular = np.empty((orders, len(self.start), count)), np.empty(count, bool)
        sound = np.empty(count, np.int8)
        for first in range(0, count, _CHUNK):
            part = slice(first, first + _CHUNK)
            here = inputs(part)
            if table is None or along is None:
                guess = np.zeros((len(self.start), here.shape[-1]))
            else:
                guess = initial_guess(table, along[part])
            solution = solve(self.linkage, here, guess, orders)
            if not solution.closed.all():
                when = None if times is None else times[part]
                raise LinkageError(self._out_of_reach(here, when, solution.closed))
            values[:, :, part], regular[part] = solution.values, solution.regular
            sound[part] = sound_orders(self.linkage, here, solution)
            position[:, :, part], angle[:, :, part] = body_motion(self.assembly, solution.values)
        return Motion(position, angle, values, regular, sound)

    def path(self, low: float, high: float) -> Path:
        """The branch over the inputs from `low` to `high`, or as far as it goes."""
        path = self._path
        if path is None or not path.covers(low, high):
            one_driver = len(self.drivers) == 1
            start = float(self._inputs(np.zeros(1))[0, 0, 0]) if one_driver else 0.0
            before = (low, high) if path is None else path.requested
            low, high = min(low, start, before[0]), max(high, start, before[1])
            inputs = unit_input if one_driver else self._inputs
            path = trace(self.linkage, start, self.start, low, high, inputs)
            self._path, self._table = path, tabulate(self.linkage, path, inputs)
        return path

    def _inputs(self, times: Real) -> Real:
        """Values and derivatives (5, d, T) of the drivers."""
        return np.stack([driver.motion(times) for driver in self.drivers], axis=1)

    def _out_of_reach(self, inputs: Real, times: Real | None, closed: np.ndarray) -> str:
        first = int(np.argmin(closed))
        when = '' if times is None else f' at {times[first]:.6g} s'
        at = ', '.join(
            f'{driver.name} = {self._with_unit(k, value)}'
            for k, (driver, value) in enumerate(zip(self.drivers, inputs[0, :, first], strict=True))
        )
        limits = ''
        if self._path is not None and len(self.drivers) == 1:
            # The ends of the path are no limits: it may go on beyond the requested range.
            ends = sorted({dead.at for dead in self._path.dead_points if dead.turns_back})
            limits = ' and '.join(self._with_unit(0, end) for end in ends)
            limits = limits and f', it turns back at {limits}'
        return f'the linkage cannot follow its drivers{when}, to {at}{limits}: drive it less far'

    def _with_unit(self, k: int, value: float) -> str:
        """A value of a driver, with its unit."""
        return f'{np.degrees(value):.9g} deg' if self.kind(k) == 'angle' else f'{value:.9g} m'

    def kind(self, k: int) -> str:
        """Whether driver `k` drives an 'angle' (rad) or a 'length' (m)."""
        kinds = list(self.assembly.kinds.values())
        return kinds[int(np.flatnonzero(self.drivers[k].row)[0])]
