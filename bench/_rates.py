"""
Errors and uncertainties by rate and lag, of motions with and without events.

Poses with white noise go straight to the estimator, without a tracker. Other methods get the
windows that the estimator gets.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from bench._events import Record, event_motions, smooth_motions
from bench._hindsight import covered, fixed_weights, settings
from bench._record import NEAR, NOISES, START, WINDOW
from bench._rivals import RIVALS
from bench._rows import Rows
from kinpole_ros import planar
from kinpole_ros.derivatives import Derivatives, Poses, Windows, derive_poses

RATES_HZ = (30, 60, 200, 1000)
LAGS = (0.0, 0.1)
# Hz, of the comparison with other methods.
RIVALED = (60, 200)
SIZE = 0.2  # m, of every body: its noise in body sizes is that of a marker
QUANTITIES = ('ω', 'α', 'jerk', 'ICR', 'IAP', 'IJP')
ORDER = dict(zip(QUANTITIES, (1, 2, 3, 1, 2, 3), strict=True))
# s, bounds of the distance of an instant from the nearest event.
DISTANCES = (0.0, 0.01, 0.03, 0.1, np.inf)
# s of a record; instants of each, in full and quick.
_SECONDS, _INSTANTS = 8.0, (120, 30)
# Poles with a larger standard deviation, body sizes, are withheld.
_WITHHELD = 0.5
# An error below this share of the best polynomial's counts as that, among methods: it may be 0.
_LEAST_ERROR = 0.01
_MIN_INSTANTS = 15


class Place(NamedTuple):
    """Where derivatives are compared: the rate, Hz, the lag, s, and window ends (M,), frames."""

    rate: int
    lag: float
    newest: np.ndarray

    @property
    def samples(self) -> int:
        """Samples of a window."""
        return round(WINDOW * self.rate) + 1

    @property
    def ahead(self) -> int:
        """Samples after the instant."""
        return round(self.lag * self.rate)

    @property
    def now(self) -> np.ndarray:
        """The frames (M,) of the instants."""
        return self.newest - self.ahead

    def windows(self, signal: np.ndarray) -> np.ndarray:
        """Windows (M, samples) of a signal (N,)."""
        return signal[self.newest[:, None] + np.arange(1 - self.samples, 1)]


class Noisy(NamedTuple):
    """A record with noise, body sizes: angles and positions (N,) as they are measured."""

    record: Record
    noise: float
    time: np.ndarray
    angle: np.ndarray
    position: np.ndarray


class Cell(NamedTuple):
    """
    Errors of one quantity of one motion at one noise.

    `ours` and `best` are RMS errors of kinpole and of the best fixed polynomial in hindsight, and
    `others` those of the rivals. `by_distance` (4, 3) is the number of instants in their 95%
    interval, of those beyond 10 standard deviations, and of all, by distance from an event.
    """

    quantity: str
    ours: float
    best: float
    others: dict[str, float]
    by_distance: np.ndarray


def rate_rows(quick: bool, progress: Callable[[float], None]) -> tuple[Rows, Rows]:
    """Return rows by kind of motion, rate, lag and quantity, and by distance from an event."""
    kinds = {'smooth': smooth_motions(), 'events': event_motions()}
    cases = [(kind, rate, lag) for kind in kinds for rate in RATES_HZ for lag in LAGS]
    rows: Rows = []
    near: Rows = []
    for number, (kind, rate, lag) in enumerate(cases):
        known = list(kinds[kind].values())[: 1 if quick else None]
        cells = [
            cell
            for k, motion in enumerate(known)
            for noise in (NOISES[1:2] if quick else NOISES)
            for cell in _cells(motion, k, noise, rate, lag, _INSTANTS[quick])
        ]
        at = {'kind': kind, 'rate': rate, 'lag': lag}
        for quantity in QUANTITIES:
            some = [cell for cell in cells if cell.quantity == quantity]
            if some:
                rows.append(at | {'quantity': quantity} | _summary(some))
                near += [at | {'quantity': quantity} | row for row in _by_distance(some)]
        progress((number + 1) / len(cases))
    return rows, [row for row in near if row['kind'] == 'events']


def _summary(cells: list[Cell]) -> dict[str, float | int]:
    """Figures of the cells of one quantity."""
    ratios = np.array([cell.ours / cell.best for cell in cells])
    counts = np.array([cell.by_distance.sum(axis=0) for cell in cells])
    shares = counts[:, 0] / counts[:, 2]
    inside, beyond, number = counts.sum(axis=0)
    found: dict[str, float | int] = {
        'cells': len(cells),
        'median': float(np.median(ratios)),
        'ninetieth': float(np.quantile(ratios, 0.9)),
        'covered': inside / number,
        'under_85': float(np.mean(shares < 0.85)),
        'beyond': beyond / number,
    }
    for name in RIVALS:
        ratios = [_ratio(cell, name) for cell in cells if name in cell.others]
        found[name] = float(np.exp(np.mean(np.log(ratios)))) if ratios else float('nan')
    return found


def _ratio(cell: Cell, name: str) -> float:
    """The error of a rival over ours, each no less than a share of the best polynomial's."""
    least = _LEAST_ERROR * cell.best
    return max(cell.others[name], least) / max(cell.ours, least)


def _by_distance(cells: list[Cell]) -> Rows:
    """Shares of the cells of one quantity by distance from an event."""
    totals = np.sum([cell.by_distance for cell in cells], axis=0)
    return [
        {'from': low, 'to': high, 'covered': inside / number, 'beyond': beyond / number}
        for (low, high), (inside, beyond, number) in zip(pairwise(DISTANCES), totals, strict=True)
        if number
    ]


def _cells(
    motion: Callable[[np.ndarray], Record],
    number: int,
    noise: float,
    rate: int,
    lag: float,
    instants: int,
) -> list[Cell]:
    """Cells of one motion, the `number`th, at one noise, rate and lag, of so many instants."""
    noisy = _record(motion, number, noise, rate)
    record, longest = noisy.record, round(WINDOW * rate)
    stride = max((len(noisy.time) - longest) // instants, 1)
    place = Place(rate, lag, np.arange(longest, len(noisy.time), stride))
    truth = _quantities(record.position[:4, place.now], record.angle[:4, place.now])
    errors, squares = _own(noisy, place, truth)
    best = _best_polynomials(noisy, place, truth)
    others = _rivals(noisy, place, truth) if rate in RIVALED else {}
    distance = np.full(len(place.now), np.inf)
    if len(record.events):
        distance = np.abs(noisy.time[place.now, None] - record.events).min(axis=1)
    cells = []
    for name in QUANTITIES:
        used = np.isfinite(squares[name])
        if name in QUANTITIES[3:]:
            used &= np.abs(truth[name] - record.position[0, place.now]) <= NEAR * SIZE
        if used.sum() >= _MIN_INSTANTS:
            ours, *fixed = (_rms(each[name][used]) for each in (errors, *best) if name in each)
            rivals = {rival: _rms(each[name][used]) for rival, each in others.items()}
            counts = _counts(name, squares[name][used], distance[used])
            cells.append(Cell(name, ours, min(fixed), rivals, counts))
    return cells


def _record(motion: Callable[[np.ndarray], Record], number: int, noise: float, rate: int) -> Noisy:
    """Return what is measured of the `number`th motion."""
    count = round(_SECONDS * rate)
    # No event is at a frame, but by chance.
    time = (np.arange(count) + 0.382 * number % 1.0) / rate
    record = motion(time)
    rng = np.random.default_rng((number, round(1e9 * noise)))
    # Of four markers: the angle has the noise of one over the body's rms radius.
    angle = record.angle[0] + noise * rng.normal(size=count)
    position = record.position[0] + noise * SIZE / 2 * (rng.normal(size=(count, 2)) @ (1, 1j))
    return Noisy(record, noise, time, angle, position)


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt((error**2).mean()))


def _counts(name: str, square: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Numbers (4, 3) of instants covered, beyond 10 deviations, and all, by distance (M,), s."""
    found = np.column_stack((covered(name, square), square > 100, np.ones(len(square), bool)))
    part = np.searchsorted(DISTANCES[1:-1], distance, side='right')
    return np.array([found[part == k].sum(axis=0) for k in range(len(DISTANCES) - 1)])


def _quantities(position: np.ndarray, angle: np.ndarray) -> dict[str, np.ndarray]:
    """Rates and poles (M,) from derivatives (4, M)."""
    with np.errstate(all='ignore'):
        poles = {
            name: planar.pole(k + 1, position, angle).value for k, name in enumerate(QUANTITIES[3:])
        }
    return dict(zip(QUANTITIES, angle[1:4], strict=False)) | poles


def _errors(
    position: np.ndarray, angle: np.ndarray, truth: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Errors (M,) by quantity of derivatives (4, M); infinite where there is no pole."""
    found = _quantities(position, angle)
    return {
        name: np.nan_to_num(np.abs(found[name] - truth[name]), nan=np.inf) for name in QUANTITIES
    }


def _derive(noisy: Noisy, place: Place) -> Derivatives:
    """Return the derivatives by the estimator; positions are in units of half the body's size."""
    one = np.ones((len(noisy.time), 1))
    stamps = START + np.rint(np.arange(len(noisy.time)) * 1e9 / place.rate).astype(np.int64)
    turn, position = noisy.angle[:, None], noisy.position[:, None] / (SIZE / 2)
    poses = Poses(stamps, turn, 0 * one, position, one, one)
    windows = Windows(place.now, place.newest - round(WINDOW * place.rate), place.newest)
    shape = len(place.newest), 1
    return derive_poses(
        poses, windows, np.zeros(shape, int), np.full(shape, noisy.noise), WINDOW, 3
    )


def _own(
    noisy: Noisy, place: Place, truth: dict[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Our errors (M,), and their squares over the covariance, NaN where withheld, by quantity."""
    found, scale = _derive(noisy, place), SIZE / 2
    position, spread = found.position[..., 0] * scale, found.position_covariance[..., 0] * scale**2
    turn, of_angle = found.angle[..., 0], found.angle_covariance[..., 0]
    errors = _errors(position, turn, truth)
    squares = {}
    for name in QUANTITIES[:3]:
        variance = of_angle[ORDER[name], ORDER[name]]
        squares[name] = errors[name] ** 2 / np.maximum(variance, np.finfo(float).tiny)
    for name in QUANTITIES[3:]:
        with np.errstate(all='ignore'):
            linear = planar.pole(ORDER[name], position, turn)
            (a, b), (_, d) = np.moveaxis(planar.covariance(linear, spread, of_angle), 0, -1)
            off = linear.value - truth[name]
            square = d * off.real**2 - 2 * b * off.real * off.imag + a * off.imag**2
            told = np.sqrt(a + d) < _WITHHELD * SIZE
            squares[name] = np.where(told, square / (a * d - b * b), np.nan)
    return errors, squares


def _best_polynomials(
    noisy: Noisy, place: Place, truth: dict[str, np.ndarray]
) -> list[dict[str, np.ndarray]]:
    """Errors (M,) of all fixed windows and degrees by quantity, of those with its order."""
    at = place.samples - 1 - place.ahead
    angle, position = (place.windows(signal) for signal in (noisy.angle, noisy.position))
    # About each instant's own value, which keeps the digits of far-off coordinates.
    here = position[:, at : at + 1]
    errors = []
    for samples, degree in settings(place.lag, place.rate):
        weights, ahead = fixed_weights(samples, degree, place.lag, place.rate)
        rows = slice(at + ahead + 1 - samples, at + ahead + 1)
        z = weights @ (position - here)[:, rows].T
        z[0] += here[:, 0]
        found = _errors(z, weights @ angle[:, rows].T, truth)
        errors.append({name: found[name] for name in QUANTITIES if degree >= ORDER[name]})
    return errors


def _rivals(
    noisy: Noisy, place: Place, truth: dict[str, np.ndarray]
) -> dict[str, dict[str, np.ndarray]]:
    """Errors (M,) by rival and quantity."""
    signals = noisy.angle, noisy.position.real, noisy.position.imag
    levels = noisy.noise, noisy.noise * SIZE / 2, noisy.noise * SIZE / 2
    at = place.samples - 1 - place.ahead
    errors = {}
    for name, rival in RIVALS.items():
        turn, x, y = (
            rival(place.windows(signal), at, place.rate, level)
            for signal, level in zip(signals, levels, strict=True)
        )
        errors[name] = _errors(x + 1j * y, turn, truth)
    return errors
