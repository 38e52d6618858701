"""
A linkage that is driven: where all its bodies are and how they move, at any time or input.

Combines what bodies and joints say (`_assembly`), the algebra of their loops (`_loops`), the
branch they are on (`_path`) and what drives them (`_drive`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from math import comb
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinpole_ros.mechanism._assembly import Assembly, body_motion
from kinpole_ros.mechanism._dead_points import flattest, loop_of, unit_input
from kinpole_ros.mechanism._guesses import Table, initial_guess, tabulate
from kinpole_ros.mechanism._loops import Linkage, LinkageError, reduce, sums, weigh
from kinpole_ros.mechanism._path import Path, trace
from kinpole_ros.mechanism._solution import Solution, solve, sound_orders
from kinpole_ros.planar._plane import Complex, Real

ORDERS = 5  # position to snap
# Positions at a time: fewer cost more calls, more leave the cache (1e5 of a four-bar to its
# accelerations: 9.2 ms with 6144, 8.6 with 8192, 14.7 with 12500).
_CHUNK = 8192


class Driver(NamedTuple):
    """
    What prescribes a variable, or the difference of two: variables @ row = value.

    `name` is for people; `row` (n,); `motion(t)` gives the value and its derivatives (5, ...) at
    times (...) in s; `low` and `high` bound its range, infinite where only the linkage does.
    """

    name: str
    row: Real
    motion: Callable[[Real], Real]
    low: float = -np.inf
    high: float = np.inf


class Motion(NamedTuple):
    """
    All bodies (B) of a linkage: `position` (5, B, ...) complex, m, of their origins, and `angle`
    (5, B, ...), rad, with the derivatives by time, or by the input; `values` (5, n, ...) the
    variables; `regular` (...) where the derivatives are determined, and `sound` (...) how many
    orders have digits left, which next to change points are not all.
    """

    position: Complex
    angle: Real
    values: Real
    regular: np.ndarray
    sound: np.ndarray


@dataclass(eq=False)
class Mechanism:
    """
    Bodies on joints, with drivers.

    `start` (n,) is the position it is drawn in, roughly: the branch is the one next to it, at the
    inputs it has at time 0.
    """

    assembly: Assembly
    drivers: tuple[Driver, ...]
    start: Real
    _path: Path | None = field(default=None, init=False)
    _table: Table | None = field(default=None, init=False)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names (B,) of the moving bodies."""
        return self.assembly.bodies

    @cached_property
    def linkage(self) -> Linkage:
        """The loops with the drivers, reduced to their unknowns; raises LinkageError."""
        rows = np.array([driver.row for driver in self.drivers])
        return reduce(self.assembly.loops._replace(drives=rows.reshape(-1, len(self.start))))

    def motion(self, t: npt.ArrayLike, orders: int = ORDERS) -> Motion:
        """
        How all bodies move at times of any shape (...), in s; `orders` are 3 up to accelerations.

        Raises LinkageError where the linkage cannot follow its drivers so far, with the time.
        """
        times = np.asarray(t, dtype=float)
        flat = times.ravel()
        found = self.at_inputs(self._inputs(flat), flat, orders)
        position, angle, values = (
            part.reshape(*part.shape[:2], *times.shape)
            for part in (found.position, found.angle, found.values)
        )
        regular, sound = (part.reshape(times.shape) for part in (found.regular, found.sound))
        return Motion(position, angle, values, regular, sound)

    def sweep(self, at: Real, orders: int = ORDERS) -> Motion:
        """How all bodies move at the inputs `at` (T,) of the one driver, by that input."""
        at = np.asarray(at, dtype=float)
        if len(self.drivers) != 1:
            raise LinkageError('a sweep is over one driver: hold the others')
        return self._at(lambda part: unit_input(at[part], orders), len(at), at, None, orders)

    def unit_rates(self, values: Real) -> tuple[Complex, Real]:
        """
        Velocities of all bodies per unit rate of each driver at variables (n, T) as given.

        Returns those of the origins (d, B, T), complex, and the angular ones (d, B, T).
        """
        rates = []
        for k in range(len(self.drivers)):
            inputs = np.zeros((2, len(self.drivers), values.shape[1]))
            inputs[0] = np.stack([driver.row for driver in self.drivers]) @ values
            inputs[1, k] = 1.0
            rates.append(solve(self.linkage, inputs, values, 2, close=False).values)
        moved = [body_motion(self.assembly, found) for found in rates]
        return np.stack([z[1] for z, _ in moved]), np.stack([angle[1] for _, angle in moved])

    def dead_loop(self, values: Real) -> tuple[str, ...]:
        """The joints, or vectors, of the loops that are in a dead point at variables (n,)."""
        here = values[:, None]
        inputs = np.zeros((2, len(self.drivers), 1))
        inputs[0] = np.stack([driver.row for driver in self.drivers]) @ here
        return loop_of(self.linkage, flattest(solve(self.linkage, inputs, here, 2, close=False)))

    def at_inputs(self, inputs: Real, times: Real | None, orders: int = ORDERS) -> Motion:
        """
        How all bodies move at `inputs` (orders or more, d, T), derivatives by whatever theirs are.

        `times` (T,) are those of the inputs, which tell the way of several drivers.
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
        """The same at `inputs(part)` for parts of all positions; `along` tells their way."""
        table = None
        if self.linkage.blocks and count:
            if along is None:
                raise LinkageError('a sweep is over one driver: hold the others')
            self.path(float(along.min()), float(along.max()))
            table = self._table
        # Much of it stays zero: memory that nobody writes to costs nothing.
        position = np.zeros((orders, len(self.bodies), count), complex)
        values, regular = np.empty((orders, len(self.start), count)), np.empty(count, bool)
        sound = np.empty(count, np.int8)
        for first in range(0, count, _CHUNK):
            part = slice(first, first + _CHUNK)
            here = inputs(part)
            if table is None or along is None:
                guess = np.zeros((len(self.start), here.shape[-1]))
            else:
                guess = initial_guess(table, along[part])
            found = solve(self.linkage, here, guess, orders, out=values[:, :, part])
            if not found.closed.all():
                when = None if times is None else times[part]
                raise LinkageError(self._out_of_reach(here, when, found.closed))
            regular[part] = found.regular
            sound[part] = sound_orders(self.linkage, here, found)
            self._place(found, position[:, :, part])
        return Motion(position, self._angles(values), values, regular, sound)

    def _angles(self, values: Real) -> Real:
        """The angles (orders, B, T) of all bodies, without a copy where they are variables."""
        turns = self.assembly.turns
        if np.array_equal(turns, np.eye(*turns.shape)):
            return values[:, : len(turns)]
        return weigh(turns, values)

    @cached_property
    def _places(self) -> tuple[Complex, Complex]:
        return sums(self.linkage, self.assembly.places)

    def _place(self, found: Solution, position: Complex) -> None:
        """Fill in origins of all bodies (orders, B, T), from the angles and lengths of `solve`."""
        constant, sliding = self._places
        weigh(constant, found.turns[0], out=position[0])
        moving = constant * self.linkage.turns.any(axis=1)
        weigh(moving, found.turns[1:], out=position[1:])
        for v, coefficients in enumerate(sliding):
            if coefficients.any():
                turned = weigh(coefficients, found.turns)
                for k in range(len(position)):
                    for j in range(k + 1):
                        position[k] += comb(k, j) * found.slides[j, v] * turned[k - j]

    def path(self, low: float, high: float) -> Path:
        """The branch over the inputs from `low` to `high`, or as far as it goes."""
        known = self._path
        if known is None or not known.covers(low, high):
            one = len(self.drivers) == 1
            start = float(self._inputs(np.zeros(1))[0, 0, 0]) if one else 0.0
            low = min(low, start, low if known is None else known.asked[0])
            high = max(high, start, high if known is None else known.asked[1])
            inputs = unit_input if one else self._inputs
            self._path = trace(self.linkage, start, self.start, low, high, inputs)
            self._table = tabulate(self.linkage, self._path, inputs)
        assert self._path is not None
        return self._path

    def _inputs(self, times: Real) -> Real:
        """Values and derivatives (5, d, T) of the drivers."""
        return np.stack([driver.motion(times) for driver in self.drivers], axis=1)

    def _out_of_reach(self, inputs: Real, times: Real | None, closed: np.ndarray) -> str:
        first = int(np.argmin(closed))
        when = '' if times is None else f' at {times[first]:.6g} s'
        at = ', '.join(
            f'{driver.name} = {self._shown(k, value)}'
            for k, (driver, value) in enumerate(zip(self.drivers, inputs[0, :, first], strict=True))
        )
        limits = ''
        if self._path is not None and len(self.drivers) == 1:
            # The ends of the path are none: it may go on where nobody asked for it.
            ends = sorted({dead.at for dead in self._path.dead_points if dead.turns_back})
            limits = ' and '.join(self._shown(0, end) for end in ends)
            limits = limits and f', it turns back at {limits}'
        return f'the linkage cannot follow its drivers{when}, to {at}{limits}: drive it less far'

    def _shown(self, k: int, value: float) -> str:
        """A value of a driver, with its unit."""
        return f'{np.degrees(value):.9g} deg' if self.kind(k) == 'angle' else f'{value:.9g} m'

    def kind(self, k: int) -> str:
        """Whether driver `k` drives an 'angle' (rad) or a 'length' (m)."""
        kinds = list(self.assembly.kinds.values())
        return kinds[int(np.flatnonzero(self.drivers[k].row)[0])]
