"""
Instants at which a derivative of a pose steps, as an impact or a drive makes them.

On either side of an event the motion goes on smoothly. Within a window a signal is a polynomial and
white noise, and a step of the k-th derivative at t0 adds a multiple of (t - t0)^k / k! from t0 on.
The evidence of polynomials with steps is held against that of polynomials without, of all degrees:
each coefficient costs about the logarithm of how far it exceeds its noise (the evidence of a
Gaussian prior as wide as the estimate). Windows of several lengths are looked at, since a short one
sees little but is simple. Angle and position have evidence of their own.

Times are in samples from the middle of the places that are looked at, and signals in deviations of
the noise.
"""

from collections.abc import Sequence
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real

# Orders that step at an event, by sets: the first is the event, the others may step with it.
_SETS = ((1,), (1, 2), (2,), (2, 3), (3,))
# What may look like an event and is none: poses that jump, and motion that sets in gradually.
_RIVALS = ((0,), (4,), (4, 5), (5,), (5, 6))
# Numbers of samples that may be off.
_PULSES = (1, 2, 3)
# Columns of the angle, and of the two coordinates of the point.
_SIGNALS = (slice(0, 1), slice(1, 3))
# Degrees of polynomials with a step. Without one they are at least so many higher, and one for so
# many samples: what those do not explain shall not be explained by a step.
_SIMPLEST, _FEWER, _SAMPLES = 8, 4, 7
# Samples after the event in the shortest window, and blocks in the longest.
_SHORTEST, _MOST_BLOCKS = 8, 64
# A window has so many times as many samples before the middle as after it.
_BEFORE = 2
# Samples that the noise is known from beforehand.
_PRIOR_SAMPLES = 30.0
# What a size costs besides the logarithm of how far it exceeds its noise: of a step, of a degree.
_STEP_COST, _DEGREE_COST = 2.4, 1.0
# Logarithm of the evidence that an event must have, and have more than its rivals.
_ENOUGH, _AHEAD = 18.0, 3.0
# Of an acceleration and of a jerk: smooth motion looks more like steps of these.
_ENOUGH_OF = {1: _ENOUGH, 2: 20.0, 3: 24.0}
# Residuals around the step must not exceed the noise by more than this many standard deviations of
# their mean square.
_MISFIT = 4.0
# An event of order 2 or 3 is less distinct from smooth motion: its rivals must have less than this
# share of its evidence, and signals whose polynomials have at most this degree must show it.
_RIVAL_SHARE, _SIMPLE = 0.65, 4
# Evidence that simple signals must have by themselves.
_ENOUGH_SIMPLE = 11.0
# The lowest order must exceed its noise by this, as a sum of squares of all signals.
_STANDS_OUT = 25.0
# In a window half as long there must be this share of the evidence expected there, less an offset.
_CONFIRMED, _CONFIRMED_LESS = 0.6, 3.0
# Samples at either end of a window where no event is found.
_EDGE = 2
# Squares below this share of a step's own are rounding.
_ROUNDING = 1e-9
# Degrees added where sizes are estimated, for the bias of the likeliest one.
_MORE_DEGREES = 2
# A sample with more than this times the usual variance does not count.
_NOISY = 4.0
# A sample this far off its place, in samples, is not evenly spaced.
_UNEVEN = 0.05


class Event(NamedTuple):
    """
    A step of the derivative of this `order` at `time`, s, with its standard deviation.

    `step` (3,) is by how much the derivatives of the angle and of both coordinates of the point
    step, rad/s^order and m/s^order, with standard deviations `step_sigma` (3,). `gain` is the
    logarithm of the evidence for it.
    """

    time: float
    time_sigma: float
    order: int
    step: Real
    step_sigma: Real
    gain: float


class _Steps(NamedTuple):
    """
    Steps of some orders at P places, as rows of a window and polynomials see them.

    `columns` (n, K, P), their coefficients `along` (D + 1, K, P) in the polynomials, and the
    products `remaining` (D + 1, K, K, P) of what polynomials up to each degree leave of them.
    """

    columns: Real
    along: Real
    remaining: Real


class _Window:
    """
    Polynomials on samples at `time` (N,), in samples, with `after` of them after the middle.

    Samples are averaged in blocks of up to so many, which begin at `starts`.
    """

    def __init__(self, time: Real, starts: np.ndarray, after: int, block: int) -> None:
        self.time, self.starts, self.after, self.block = time, starts, after, block
        self.root = np.sqrt(np.diff(np.append(starts, len(time))))[:, None]
        self.count = len(starts)
        self.highest = min(max(_SIMPLEST + _FEWER, self.count // _SAMPLES), self.count // 2)
        self.simplest = min(_SIMPLEST, self.highest - _FEWER)
        self.middle, self.half = float(time.mean()), float(np.ptp(time)) / 2
        self.basis, _ = np.linalg.qr(self.join(self.powers(time)))
        self._steps: dict[tuple, _Steps] = {}
        self._directions: dict[tuple, Real] = {}

    def powers(self, time: Real) -> Real:
        """Polynomials (N, D + 1) at times, not orthogonal."""
        scaled = (time - self.middle) / self.half
        return np.asarray(np.polynomial.legendre.legvander(scaled, self.highest))

    def join(self, rows: Real) -> Real:
        """Means of blocks of rows (N, ...), in deviations of their noise."""
        if len(self.starts) == len(rows):
            return rows
        root = self.root.reshape(-1, *[1] * (rows.ndim - 1))
        return np.asarray(np.add.reduceat(rows, self.starts) / root)

    def steps(self, step_times: Real, orders: Sequence[int]) -> _Steps:
        since = self.time[:, None] - step_times
        columns = self.join(np.stack([_power(since, order) for order in orders], axis=1))
        shape = columns.shape
        along = (self.basis.T @ columns.reshape(len(columns), -1)).reshape(-1, *shape[1:])
        own = np.einsum('nkp,njp->kjp', columns, columns)
        explained = np.cumsum(along[:, :, None] * along[:, None], axis=0)
        return _Steps(columns, along, own - explained)

    def steps_at(self, step_times: tuple[float, ...], orders: Sequence[int]) -> _Steps:
        """Return the same, kept for the next time."""
        key = step_times, tuple(orders)
        if key not in self._steps:
            self._steps[key] = self.steps(np.array(step_times), orders)
        return self._steps[key]

    def near(self, offset: float, radius: float) -> tuple[float, ...]:
        """Places at most `radius` from `offset`, and one more to either side."""
        far = np.ceil(radius / self.block) + 1
        step_times = round(offset) + np.arange(-far, far + 1) * self.block
        inside = (step_times > self.time[0] + _EDGE) & (step_times < self.time[-1] - _EDGE)
        return tuple(step_times[inside].tolist())

    def directions(self, step_times: tuple[float, ...]) -> Real:
        """
        Unit vectors (degrees, P, 5, n) along what polynomials leave of the steps of _DIRECTIONS.

        Each is without what the step before it in the same set has.
        """
        if step_times not in self._directions:
            steps = self.steps_at(step_times, _ORDERS)
            degrees = slice(1, self.simplest + 1)
            columns = np.moveaxis(steps.columns, 0, -1).swapaxes(0, 1)  # (P, K, n)
            explained = np.einsum('dkp,nd->dpkn', steps.along, self.basis, optimize=True)
            remainder = columns - np.cumsum(explained, axis=0)[degrees]
            least = np.sqrt(_ROUNDING * (columns**2).sum(axis=-1, keepdims=True))
            result = np.empty((*remainder.shape[:2], len(_DIRECTIONS), remainder.shape[-1]))
            for k, (row, before) in enumerate(_DIRECTIONS):
                own = remainder[:, :, row]
                if before is not None:
                    second = result[:, :, before]
                    for _ in range(2):
                        own = own - second * (second * own).sum(axis=-1, keepdims=True)
                size = np.sqrt((own**2).sum(axis=-1, keepdims=True))
                seen = size > least[:, row]
                result[:, :, k] = np.where(seen, own / np.where(seen, size, 1.0), 0.0)
            self._directions[step_times] = result
        return self._directions[step_times]


def _power(since: Real, order: int) -> Real:
    return np.where(since > 0, np.maximum(since, 0.0) ** order / factorial(order), 0.0)


def _log_sum(values: Real) -> Real:
    most = values.max(axis=0)
    return np.asarray(most + np.log(np.exp(values - most).sum(axis=0)))


class _Fit:
    """
    Samples (n, 3) of a window, and how well polynomials explain them.

    `white` is the noise to be added to curves that have none.
    """

    def __init__(self, window: _Window, samples: Real, white: bool = False) -> None:
        self.window, self.samples = window, samples
        self.count = window.count
        self.along = along = window.basis.T @ samples
        squares = np.maximum((samples**2).sum(axis=0) - np.cumsum(along**2, axis=0), 0.0)
        if white:
            squares += np.arange(window.count - 1, window.count - len(squares) - 1, -1)[:, None]
        with_step = slice(1, window.simplest + 1)
        self.squares, self.cost, self.number, self.smooth = [], [], [], []
        self.least = float(squares[with_step.stop - 1].sum() / (3 * (self.count - with_step.stop)))
        for part in _SIGNALS:
            signals = part.stop - part.start
            remaining = squares[:, part].sum(axis=1)
            per_signal = (0.5 * np.log1p(along[:, part] ** 2) + _DEGREE_COST).sum(axis=1)
            cost, number = np.cumsum(per_signal), (_PRIOR_SAMPLES + signals * window.count) / 2
            self.smooth.append(_log_sum((-number * np.log(_PRIOR_SAMPLES + remaining) - cost)[1:]))
            self.squares.append(remaining[with_step])
            self.cost.append(cost[with_step])
            self.number.append(number)

    def evidence(
        self, steps: _Steps, rows: Sequence[int], product: Real | None = None
    ) -> list[Real]:
        """Evidence (degrees, P) by signal of the steps in `rows`, over that of smooth motion."""
        return self._gains(self._explained(steps, rows, product))

    def _explained(
        self, steps: _Steps, rows: Sequence[int], product: Real | None = None
    ) -> list[Real]:
        """
        Squares (degrees, P, 3) that steps explain, each without those before (Cholesky).

        `product` is that of `product`, if it is known.
        """
        size = self.product(steps) if product is None else product
        remaining = steps.remaining[1 : self.window.simplest + 1]
        factor: list[list[Real]] = []
        explained: list[Real] = []
        for i, row in enumerate(rows):
            own, value = remaining[:, row, row], size[:, row]
            lower: list[Real] = []
            for j in range(i):
                shared = remaining[:, row, rows[j]].copy()
                for m in range(j):
                    shared -= lower[m] * factor[j][m]
                scaled = shared * factor[j][j]
                lower.append(scaled)
                own = own - scaled**2
                value = value - scaled[..., None] * explained[j]
            total = np.einsum('np,np->p', steps.columns[:, row], steps.columns[:, row])
            seen = own > _ROUNDING * total
            inverse = np.where(seen, 1 / np.sqrt(np.where(seen, own, 1.0)), 0.0)
            factor.append([*lower, inverse])
            explained.append(value * inverse[..., None])
        return [part**2 for part in explained]

    def product(self, steps: _Steps) -> Real:
        """Products (degrees, K, P, 3) of steps with what polynomials leave of the samples."""
        shape = steps.columns.shape
        total = steps.columns.reshape(len(self.samples), -1).T @ self.samples
        by_degree = np.cumsum(steps.along[..., None] * self.along[:, None, None], axis=0)
        by_degree = by_degree[1 : self.window.simplest + 1]
        return np.asarray(total.reshape(*shape[1:], 3) - by_degree)

    def _gains(self, squares: list[Real]) -> list[Real]:
        gains = []
        for k, part in enumerate(_SIGNALS):
            signals = part.stop - part.start
            per_signal = [square[..., part].sum(axis=-1) for square in squares]
            cost = sum(signals * np.log1p(one / signals) / 2 + _STEP_COST for one in per_signal)
            remaining = np.maximum(self.squares[k][:, None] - sum(per_signal), 0.0)
            value = (
                -self.number[k] * np.log(_PRIOR_SAMPLES + remaining) - self.cost[k][:, None] - cost
            )
            gains.append(value - self.smooth[k])
        return gains

    def gain(self, steps: _Steps, sets: Sequence[Sequence[int]]) -> Real:
        """Gains (sets, P) of both signals, each of which may have no step; sets are of rows."""
        product = self.product(steps)
        return np.stack([_of_both(self.evidence(steps, rows, product)) for rows in sets])

    def pulse(self) -> float:
        """Gain of the likeliest run of up to three samples that are off by the same."""
        rows = slice(1, self.window.simplest + 1)
        basis = self.window.basis
        residual = self.samples - np.cumsum(basis.T[:, :, None] * self.along[:, None], axis=0)[rows]
        gains = []
        for length in _PULSES:
            ends = slice(length, None), slice(None, -length)
            sums = np.cumsum(np.pad(basis, ((1, 0), (0, 0))), axis=0)
            sums = sums[ends[0]] - sums[ends[1]]
            remaining = np.maximum(length - np.cumsum(sums.T**2, axis=0)[rows], _ROUNDING)
            off = np.cumsum(np.pad(residual, ((0, 0), (1, 0), (0, 0))), axis=1)
            off = off[:, ends[0]] - off[:, ends[1]]
            gains.append(_of_both(self._gains([off**2 / remaining[..., None]])).max())
        return float(max(gains))


def _of_both(evidence: list[Real]) -> Real:
    """Gain of both signals by that of each at all degrees."""
    return np.asarray(sum(np.logaddexp(_log_sum(one), 0.0) - np.log(2) for one in evidence))


_ORDERS = (1, 2, 3)
_ROWS = tuple(tuple(order - 1 for order in one) for one in _SETS)
# Rows of steps, each without another of the directions, and which of them the sets have.
_DIRECTIONS = ((0, None), (1, 0), (1, None), (2, 2), (2, None))
_DIRECTIONS_OF = ((0,), (0, 1), (2,), (2, 3), (4,))
_RIVAL_ORDERS = tuple(sorted({order for one in _RIVALS for order in one}))
_RIVAL_ROWS = tuple(tuple(_RIVAL_ORDERS.index(order) for order in one) for one in _RIVALS)


@lru_cache(maxsize=32)
def _even_window(after: int, block: int) -> _Window:
    """A window with all of its samples, evenly spaced."""
    time = np.arange(-_BEFORE * after, after) + 0.5
    return _Window(time, np.arange(0, len(time), block), after, block)


class Samples(NamedTuple):
    """
    Samples of a pose, and where an event may be among them.

    `time` (N,), s, rising, `values` (N, 3), the angle, rad, and both coordinates of a point, m, and
    their `variance` (N, 2), of the angle and of a coordinate, not finite where a sample is missing.
    The event is between `begin` and `end`, s.
    """

    time: Real
    values: Real
    variance: Real
    begin: float
    end: float


class _Task(NamedTuple):
    """Samples (N, 3) in deviations of the noise, and how they were scaled."""

    since: Real
    samples: Real
    scale: Real
    interval: float
    middle: float
    offset: float
    radius: float


def find_events(samples: Sequence[Samples], after: float) -> list[Event | None]:
    """
    Find the likeliest event of each of several samples.

    In the longest window motion goes on for `after`, s, after the event, and for twice as long
    before. There is none where smooth motion explains the samples as well.
    """
    tasks = [_task_of(one) for one in samples]
    result: list[Event | None] = [None] * len(tasks)
    for number, lengths in _screened(tasks, after).items():
        task = tasks[number]
        assert task is not None
        fits = [fit for length in lengths[1] if (fit := _fit_of(task, length)) is not None]
        best: _Finding | None = None
        for k, fit in enumerate(fits):
            if fit.window.after in lengths[0]:
                one = _search(fit, fits[k + 1 :], task.offset, task.radius)
                if one is not None and (best is None or one.gain > best.gain):
                    best = one
        if best is not None:
            unit = task.scale / task.interval**best.order
            result[number] = Event(
                task.middle + best.step_time * task.interval,
                best.sigma * task.interval,
                best.order,
                best.size * unit,
                best.size_sigma * unit,
                best.gain,
            )
    return result


def _task_of(samples: Samples) -> _Task | None:
    time, values, variance, begin, end = samples
    seen = np.isfinite(variance).all(axis=1)
    if np.count_nonzero(seen) < 2 * _SHORTEST:
        return None
    steps = np.sort(np.diff(time))
    interval = float(steps[len(steps) // 2])
    if not seen.all():
        values, variance = values[seen], variance[seen]
    quiet = (variance <= _NOISY * np.sort(variance, axis=0)[len(variance) // 2]).all(axis=1)
    own = time[seen]
    if not quiet.all():
        own, values, variance = own[quiet], values[quiet], variance[quiet]
    # Half an interval before a sample.
    number = min(int(np.searchsorted(time, (begin + end) / 2)), len(time) - 1)
    middle = float(time[number]) - interval / 2
    since = (own - middle) / interval
    first = min(int(np.searchsorted(since, 0.0)), len(since) - 1)
    scale = np.sqrt(variance.mean(axis=0))[[0, 1, 1]]
    offset, radius = ((begin + end) / 2 - middle) / interval, (end - begin) / interval / 2
    return _Task(since, (values - values[first]) / scale, scale, interval, middle, offset, radius)


def _lengths(task: _Task, after: float) -> list[int]:
    """Samples after the event in each window, the longest first."""
    lengths = [max(round(after / task.interval), _SHORTEST)]
    while lengths[-1] > _SHORTEST:
        lengths.append(max((lengths[-1] + 1) // 2, _SHORTEST))
    return lengths


def _rows_of(task: _Task, after: int) -> slice:
    first, last = np.searchsorted(task.since, (-_BEFORE * after - 0.1, after + 0.1))
    return slice(int(first), int(last))


def _is_even(task: _Task, rows: slice, after: int) -> bool:
    count = (_BEFORE + 1) * after
    if rows.stop - rows.start != count:
        return False
    off = task.since[rows] - np.arange(0.5 - _BEFORE * after, after)
    return bool(max(off.max(), -off.min()) < _UNEVEN)


def _screened(tasks: Sequence[_Task | None], after: float) -> dict[int, tuple[set[int], list[int]]]:
    """By task the lengths of windows that may show an event, if there are any, and of all."""
    groups: dict[tuple[int, int, int], list[int]] = {}
    lengths = {k: _lengths(task, after) for k, task in enumerate(tasks) if task is not None}
    likely: dict[int, set[int]] = {}
    for k, per_signal in lengths.items():
        task = tasks[k]
        assert task is not None
        for length in per_signal:
            rows = _rows_of(task, length)
            if _is_even(task, rows, length):
                key = length, round(task.offset), int(np.ceil(task.radius))
                groups.setdefault(key, []).append(k)
                continue
            fit = _fit_of(task, length)
            if fit is not None:
                steps = fit.window.steps(
                    np.array(fit.window.near(task.offset, task.radius)), _ORDERS
                )
                if fit.gain(steps, _ROWS).max() > _ENOUGH:
                    likely.setdefault(k, set()).add(length)
    for (length, offset, radius), members in groups.items():
        window = _even_window(length, _block_of(length))
        samples = []
        for k in members:
            task = tasks[k]
            assert task is not None
            samples.append(window.join(task.samples[_rows_of(task, length)]))
        gains = _even_gains(window, window.near(offset, radius), np.stack(samples, axis=1))
        for k, gain in zip(members, gains.tolist(), strict=True):
            if gain > _ENOUGH:
                likely.setdefault(k, set()).add(length)
    return {k: (likely[k], lengths[k]) for k in sorted(likely)}


def _even_gains(window: _Window, near: tuple[float, ...], samples: Real) -> Real:
    """Gains (S,) of the likeliest events near the middle, of samples (n, S, 3), as `_Fit.gain`."""
    count, number, _ = samples.shape
    flat = samples.reshape(count, -1)
    along = (window.basis.T @ flat).reshape(-1, number, 3)
    directions = window.directions(near)
    high, step_times, rows, _ = directions.shape
    explained = (directions.reshape(-1, count) @ flat) ** 2
    explained = explained.reshape(high, step_times, rows, number, 3)
    remaining = np.maximum(
        (flat**2).sum(axis=0).reshape(number, 3) - np.cumsum(along**2, axis=0), 0.0
    )
    per_signal = 0.5 * np.log1p(along**2) + _DEGREE_COST
    total = np.zeros((len(_SETS), step_times, number))
    for part in _SIGNALS:
        signals = part.stop - part.start
        cost, half = np.cumsum(per_signal[..., part].sum(axis=-1), axis=0), signals * count
        half = (_PRIOR_SAMPLES + half) / 2
        remainder = remaining[..., part].sum(axis=-1)
        smooth = _log_sum((-half * np.log(_PRIOR_SAMPLES + remainder) - cost)[1:])
        squares = explained[..., part].sum(axis=-1)
        costs = signals * np.log1p(squares / signals) / 2 + _STEP_COST
        for k, chosen in enumerate(_DIRECTIONS_OF):
            used = list(chosen)
            lower = remainder[1 : high + 1, None] - squares[:, :, used].sum(axis=2)
            value = (
                -half * np.log(_PRIOR_SAMPLES + np.maximum(lower, 0.0)) - cost[1 : high + 1, None]
            )
            value -= costs[:, :, used].sum(axis=2)
            total[k] += np.logaddexp(_log_sum(value) - smooth, 0.0) - np.log(2)
    return np.asarray(total.max(axis=(0, 1)))


def _block_of(after: int) -> int:
    block = 1
    while after / block > _MOST_BLOCKS:
        block *= 2
    return block


def _fit_of(task: _Task, after: int) -> _Fit | None:
    """Fit the window with so many samples after its middle; None where too few are there."""
    rows, block = _rows_of(task, after), _block_of(after)
    since, samples = task.since[rows], task.samples[rows]
    if _is_even(task, rows, after):
        window = _even_window(after, block)
    else:
        before = np.count_nonzero(since < 0)
        if before < _SHORTEST or len(since) - before < _SHORTEST - 2:
            return None
        cells = np.floor((since + _BEFORE * after) / block)
        window = _Window(since, np.flatnonzero(np.diff(cells, prepend=-1.0)), after, block)
        if window.count < 2 * _SHORTEST:
            return None
    return _Fit(window, window.join(samples))


class _Finding(NamedTuple):
    """An event as one window sees it, in samples and deviations of the noise."""

    step_time: float
    sigma: float
    order: int
    size: Real
    size_sigma: Real
    gain: float


def _search(fit: _Fit, shorter: list[_Fit], offset: float, radius: float) -> _Finding | None:
    """Find an event at most `radius` samples from `offset`."""
    window = fit.window
    step = window.block
    first, last = np.ceil(window.time[0]) + _EDGE, np.floor(window.time[-1]) - _EDGE
    all_of = tuple(np.arange(first, last + 1, step).tolist())
    gains = fit.gain(window.steps_at(all_of, _ORDERS), _ROWS)
    best, at = np.unravel_index(gains.argmax(), gains.shape)
    if gains[best, at] < _ENOUGH or abs(all_of[at] - offset) > radius + 0.5 * step:
        return None
    rivals = fit.gain(window.steps_at(all_of, _RIVAL_ORDERS), _RIVAL_ROWS).max()
    rival = max(float(rivals), fit.pulse())
    if gains[best, at] < rival + _AHEAD:
        return None
    # The order that stands out, and what steps with it.
    close = np.abs(np.array(all_of) - all_of[at]) <= 3 * step
    top = np.where(close, gains, -np.inf).max(axis=1)
    result = sorted(
        (_refine(fit, k, all_of[int(np.where(close, gains[k], -np.inf).argmax())], step), k)
        for k in np.flatnonzero(top > 0.7 * top.max() - 15).tolist()
    )[::-1]
    for refined, k in result:
        gain, step_time, sigma = refined
        degrees = [
            1 + int(one[:, 0].argmax())
            for one in fit.evidence(window.steps(np.array([step_time]), _ORDERS), _ROWS[k])
        ]
        size, size_sigma, misfit = _sizes(fit, step_time, _SETS[k], degrees)
        order = _SETS[k][0]
        if len(_SETS[k]) == 1 or ((size / size_sigma) ** 2).sum() > _STANDS_OUT:
            break
    else:
        return None
    if abs(step_time - offset) > radius or gain < _ENOUGH_OF[order]:
        return None
    noise = max(1.0, (shorter or [fit])[-1].least)
    if (misfit > noise * (1 + _MISFIT * np.sqrt(2 / (fit.count * np.array((1, 2)))))).any():
        return None
    # No shorter window says whether more degrees would explain it.
    if (
        not shorter
        and _simple_gain(fit, step_time, k, degrees, window.simplest - 1) < _ENOUGH_SIMPLE
    ):
        return None
    if order > 1 and (
        rival > _RIVAL_SHARE * gain
        or _simple_gain(fit, step_time, k, degrees, _SIMPLE) < _ENOUGH_SIMPLE
    ):
        return None
    if shorter and not _is_confirmed(fit, shorter[0], step_time, k, degrees):
        return None
    return _Finding(step_time, sigma, order, size, size_sigma, gain)


def _refine(fit: _Fit, k: int, step_time: float, step: int) -> tuple[float, float, float]:
    """Find the gain, place and its standard deviation of a set of steps, by moments."""
    half, window = 3.0 * step, fit.window
    gain = sigma = 0.0
    for _ in range(6):
        step_times = step_time + half * np.linspace(-1, 1, 17)
        step_times = step_times[
            (step_times > window.time[0] + 1) & (step_times < window.time[-1] - 1)
        ]
        gains = fit.gain(window.steps(step_times, _ORDERS), _ROWS[k : k + 1])[0]
        weights = np.exp(gains - gains.max())
        weights /= weights.sum()
        gain, step_time = float(gains.max()), float(weights @ step_times)
        sigma = float(np.sqrt(weights @ (step_times - step_time) ** 2))
        if sigma > half / 5 or half < 1e-3:
            break
        half = max(5 * sigma, half / 8)
    return gain, step_time, sigma


def _sizes(
    fit: _Fit, step_time: float, orders: Sequence[int], degrees: list[int]
) -> tuple[Real, Real, Real]:
    """Sizes (3,) of the first step, their standard deviations, and mean squares left (2,)."""
    window = fit.window
    columns = window.steps(np.array([step_time]), orders).columns[:, :, 0]
    size, sigma, misfit = np.empty(3), np.empty(3), []
    for part, degree in zip(_SIGNALS, degrees, strict=True):
        degree = min(degree + _MORE_DEGREES, window.simplest)
        design = np.concatenate((columns, window.basis[:, : degree + 1]), axis=1)
        inverse = np.linalg.pinv(design)
        result = inverse @ fit.samples[:, part]
        size[part], sigma[part] = result[0], np.linalg.norm(inverse[0])
        remaining = fit.samples[:, part] - design @ result
        misfit.append((remaining**2).mean() * fit.count / (fit.count - len(inverse)))
    return size, sigma, np.array(misfit)


def _simple_gain(fit: _Fit, step_time: float, k: int, degrees: list[int], most: int) -> float:
    """Gain of the signals whose likeliest curve next to the event has at `most` this degree."""
    pieces = fit.evidence(fit.window.steps(np.array([step_time]), _ORDERS), _ROWS[k])
    simple = [one for one, degree in zip(pieces, degrees, strict=True) if degree <= most]
    return float(_of_both(simple)[0]) if simple else 0.0


def _is_confirmed(fit: _Fit, shorter: _Fit, step_time: float, k: int, degrees: list[int]) -> bool:
    """Whether a shorter window shows what the curve with the step lets expect of it."""
    window, second = fit.window, shorter.window
    if not second.time[0] + 3 < step_time < second.time[-1] - 3:
        return True
    columns = window.steps(np.array([step_time]), _SETS[k]).columns[:, :, 0]
    since = second.time[:, None, None] - step_time
    present = np.concatenate([_power(since[..., 0], order) for order in _SETS[k]], axis=1)
    curve = np.empty((len(second.time), 3))
    powers = window.powers(second.time), window.join(window.powers(window.time))
    for part, degree in zip(_SIGNALS, degrees, strict=True):
        design = np.concatenate((columns, powers[1][:, : degree + 1]), axis=1)
        is_known = np.concatenate((present, powers[0][:, : degree + 1]), axis=1)
        curve[:, part] = is_known @ np.linalg.lstsq(design, fit.samples[:, part], rcond=None)[0]
    steps = second.steps(np.array([step_time]), _ORDERS)
    expected = _Fit(second, second.join(curve), white=True).gain(steps, _ROWS).max()
    return bool(shorter.gain(steps, _ROWS).max() >= _CONFIRMED * expected - _CONFIRMED_LESS)
