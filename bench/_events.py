"""
Errors and uncertainties of derivatives near events: instants at which a derivative steps.

Poses with white noise go straight to the estimator, without a tracker. Run as a script for tables:

    python -m bench._events [--stride 4] [--csv cells.csv]
"""

import argparse
import csv
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from bench._hindsight import apply_weights, fixed_weights, settings
from bench._motions import motions, other_motions
from bench._record import NEAR, RATE, WINDOW, stamps_of
from kinpole_ros import planar
from kinpole_ros.derivatives import Derivatives, Poses, Windows, derive_poses
from kinpole_ros.mechanism import BodyMotion
from kinpole_ros.mechanism._motions import ORDERS, rotation_derivatives

LAGS = (0.0, 0.1, 0.25)
NOISES = (1e-5, 1e-3, 1e-2)
SECONDS = 8.0
SIZE = 0.2  # m, of every body: its noise in body sizes is that of a marker
QUANTITIES = ('ω', 'α', 'jerk', 'ICR', 'IAP', 'IJP')
ORDER = dict(zip(QUANTITIES, (1, 2, 3, 1, 2, 3), strict=True))
# s, bounds of the distance of an instant from the nearest event.
DISTANCES = (0.0, 0.01, 0.03, 0.1, np.inf)
# Poles with a larger standard deviation, body sizes, are withheld.
_WITHHELD = 0.5
_MIN_INSTANTS = 30

Derive = Callable[[Poses, np.ndarray, np.ndarray], list[Derivatives]]


class Record(NamedTuple):
    """A motion of one body in N frames, (5, N), and the instants of its events, s."""

    position: np.ndarray
    angle: np.ndarray
    events: np.ndarray


class Cell(NamedTuple):
    """
    Figures of one quantity of one motion at one noise and lag.

    `ratio` is the RMS error over that of the best fixed polynomial, `covered` the share of instants
    in their 95% interval, `beyond` that beyond 10 standard deviations, and `score` the mean
    interval score (Gneiting and Raftery, 2007), in which the error of a pole is its length. By
    distance from the nearest event: how many instants are covered, beyond, and all.
    """

    motion: str
    noise: float
    lag: float
    quantity: str
    error: float
    ratio: float
    covered: float
    beyond: float
    score: float
    number: int
    by_distance: tuple[tuple[float, float, int], ...]


def event_motions() -> dict[str, Callable[[np.ndarray], Record]]:
    """Return the motions with events by name."""
    return {
        'bounce': _bounce,
        'stick-slip': _stick_slip,
        'Geneva drive': _geneva,
        'backlash': _backlash,
        'Coulomb friction': _coulomb,
        'trapezoid drive': _trapezoid,
        'S-curve drive': _s_curve,
        'impact on a slider': _impact,
        'ratchet': _ratchet,
        'reversing drive': _reversing,
    }


def smooth_motions() -> dict[str, Callable[[np.ndarray], Record]]:
    """Return the other motions of the benchmarks by name."""

    def observed(motion: Callable[[np.ndarray], BodyMotion], markers: np.ndarray) -> Callable:
        mean = planar.to_complex(markers).mean()

        def record(t: np.ndarray) -> Record:
            moved = motion(t)
            position = moved.position + mean * rotation_derivatives(moved.angle)
            return Record(position, moved.angle, np.empty(0))

        return record

    return {name: observed(*one) for name, one in (motions() | other_motions()).items()}


Segment = tuple[float, float, float | None, float | None]


def _segments(t: np.ndarray, segments: list[Segment]) -> tuple[np.ndarray, np.ndarray]:
    """
    A signal (5, N) of cubic pieces, and where they meet.

    A segment is its duration, its jerk, and the acceleration and velocity that it begins with, None
    for those that the segment before ends with. Segments repeat.
    """
    signal, events = np.zeros((ORDERS, len(t))), []
    start, state, k = 0.0, np.zeros(3), 0
    while start <= t[-1]:
        duration, jerk, acceleration, velocity = segments[k % len(segments)]
        state[2] = state[2] if acceleration is None else acceleration
        state[1] = state[1] if velocity is None else velocity
        piece = np.polynomial.Polynomial((*state / (1, 1, 2), jerk / 6))
        inside = (t >= start) & (t < start + duration)
        for order in range(ORDERS):
            signal[order, inside] = (piece.deriv(order) if order else piece)(t[inside] - start)
        state = np.array([piece(duration), piece.deriv()(duration), piece.deriv(2)(duration)])
        start, k = start + duration, k + 1
        events.append(start)
    return signal, np.array(events)


def _sine(t: np.ndarray, size: float, hertz: float, phase: float = 0.0) -> np.ndarray:
    rate = 2 * np.pi * hertz
    return np.stack([size * (rate * 1j) ** k * np.exp(1j * (rate * t + phase)) for k in range(5)])


def _pinned(angle: np.ndarray, events: np.ndarray) -> Record:
    """A body that turns about a point 0.2 m above it."""
    return Record(-0.2j * rotation_derivatives(angle), angle, events)


def _bounce(t: np.ndarray) -> Record:
    """A ball that bounces, with a spin that changes."""
    speeds, spins = (1.5, 1.1, 0.8, 1.7, 1.25), (4.0, -1.0, 2.5, 6.0, -3.0)
    flights = [2 * speed / 9.81 for speed in speeds]
    height, events = _segments(
        t, [(flight, 0.0, -9.81, speed) for flight, speed in zip(flights, speeds, strict=True)]
    )
    angle, _ = _segments(
        t, [(flight, 0.0, 0.0, spin) for flight, spin in zip(flights, spins, strict=True)]
    )
    along = np.zeros_like(height)
    along[0], along[1] = 0.3 * t, 0.3
    return Record(along + 1j * height, angle, events)


def _stick_slip(t: np.ndarray) -> Record:
    """A rocker held by friction to a belt, and pulled back by a spring."""
    half, speed, rate = 0.15, 0.7, 2 * np.pi * 4
    lean = np.arctan2(half * rate, speed)
    slip, stick = (2 * np.pi - 2 * lean) / rate, 2 * half / speed
    phase = np.mod(t, slip + stick)
    angle = np.zeros((ORDERS, len(t)))
    size = np.hypot(half, speed / rate)
    for k in range(ORDERS):
        slipping = size * rate**k * np.sin(rate * phase + lean + k * np.pi / 2)
        sticking = (-half + speed * (phase - slip), speed, 0.0, 0.0, 0.0)[k]
        angle[k] = np.where(phase < slip, slipping, sticking)
    cycles = (slip + stick) * np.arange(int(t[-1] / (slip + stick)) + 2)
    return _pinned(angle, np.sort(np.concatenate((cycles, cycles + slip))))


def _geneva(t: np.ndarray) -> Record:
    """A Geneva wheel of four slots."""
    rate = 2 * np.pi * 1.2
    turns, crank = np.divmod(rate * t + np.pi, 2 * np.pi)
    crank -= np.pi
    s, q = np.sqrt(2), np.exp(-1j * np.clip(crank, -np.pi / 4, np.pi / 4))
    d = s - q
    wave = (
        np.log(d),
        1j * q / d,
        s * q / d**2,
        -1j * s * q * (s + q) / d**3,
        -s * q * (s**2 + 4 * s * q + q**2) / d**4,
    )
    angle = np.stack([rate**k * each.imag for k, each in enumerate(wave)])
    angle[0] += np.pi / 2 * turns
    angle[1:, np.abs(crank) >= np.pi / 4] = 0.0
    cycles = 2 * np.pi * np.arange(turns[-1] + 2)
    return _pinned(angle, np.sort(np.concatenate((cycles - np.pi / 4, cycles + np.pi / 4))) / rate)


def _backlash(t: np.ndarray) -> Record:
    """The driven side of a joint with play: it stays where the drive reverses, until it is hit."""
    size, play, hertz = 0.5, 0.06, 0.8
    halves = 2 * hertz * t - 0.5
    half = np.floor(halves)
    sign = np.where(half % 2 == 0, 1.0, -1.0)
    drive = _sine(t, size, hertz).imag
    hit = np.arccos(1 - 2 * play / size) / np.pi
    held = halves - half < hit
    angle = drive.copy()
    angle[0] += sign * play
    angle[:, held] = 0.0
    angle[0, held] = sign[held] * (size - play)
    number = np.arange(half[-1] + 2)
    return _pinned(angle, np.sort(np.concatenate((number, number + hit)) + 0.5) / 2 / hertz)


def _coulomb(t: np.ndarray) -> Record:
    """A swing with dry friction."""
    size, friction, hertz = 1.0, 0.025, 1.1
    half = np.floor(2 * hertz * t)
    angle = np.zeros((ORDERS, len(t)))
    sign = np.where(half % 2 == 0, 1.0, -1.0)
    angle = (size - friction * (2 * half + 1)) * _sine(t, 1.0, hertz).real
    angle[0] += sign * friction
    return _pinned(angle, np.arange(half[-1] + 2) / 2 / hertz)


def _trapezoid(t: np.ndarray) -> Record:
    go: list[Segment] = [(0.15, 0.0, 20.0, None), (0.31, 0.0, 0.0, None), (0.15, 0.0, -20.0, None)]
    back: list[Segment] = [
        (0.15, 0.0, -20.0, None),
        (0.31, 0.0, 0.0, None),
        (0.15, 0.0, 20.0, None),
    ]
    rest: list[Segment] = [(0.29, 0.0, 0.0, 0.0)]
    return _pinned(*_segments(t, go + rest + back + rest))


def _s_curve(t: np.ndarray) -> Record:
    def move(jerk: float) -> list[Segment]:
        each = ((0.09, jerk), (0.09, -jerk), (0.23, 0.0), (0.09, -jerk), (0.09, jerk))
        return [*((length, one, None, None) for length, one in each), (0.27, 0.0, 0.0, 0.0)]

    return _pinned(*_segments(t, move(350.0) + move(-350.0)))


def _impact(t: np.ndarray) -> Record:
    """A slider on a slow wave is hit now and then, and rings."""
    period, decay = 0.83, complex(-12.0, 2 * np.pi * 9)
    x, angle = _sine(t, 0.1, 0.7).imag, _sine(t, 0.3, 0.9, 0.4).imag
    hits = period * np.arange(1, int(t[-1] / period) + 1)
    for k, hit in enumerate(hits):
        since = t - hit
        ring = np.stack([(decay**n * np.exp(decay * np.maximum(since, 0))).imag for n in range(5)])
        ring *= (since >= 0) * (0.3, -0.2, 0.1)[k % 3] / decay.imag
        x, angle = x + ring, angle + 3.0 * ring
    return Record(x + 0.02j * _sine(t, 1.0, 0.7, 0.3).imag, angle, hits)


def _ratchet(t: np.ndarray) -> Record:
    return _pinned(*_segments(t, [(0.2, 0.0, 15.0, 0.0), (0.34, 0.0, 0.0, 0.0)]))


def _reversing(t: np.ndarray) -> Record:
    push = (25.0, -25.0, -10.0, 10.0)
    return _pinned(*_segments(t, [(0.31, 0.0, one, None) for one in push]))


def _derive_compiled(poses: Poses, newest: np.ndarray, noise: np.ndarray) -> list[Derivatives]:
    """Derivatives by lag, of the windows that end at frames `newest` (T,)."""
    found = []
    for lag in LAGS:
        windows = Windows(newest - round(lag * RATE), newest - round(WINDOW * RATE), newest)
        shape = len(newest), poses.angle.shape[1]
        found.append(
            derive_poses(
                poses, windows, np.zeros(shape, int), np.broadcast_to(noise, shape), WINDOW, 3
            )
        )
    return found


def measure(
    known: dict[str, Callable[[np.ndarray], Record]],
    stride: int,
    derive: Derive = _derive_compiled,
    noises: tuple[float, ...] = NOISES,
) -> list[Cell]:
    """Make the cells of motions, of every `stride`th frame."""
    count = round(SECONDS * RATE)
    longest = round(WINDOW * RATE)
    cells = []
    for number, (name, motion) in enumerate(known.items()):
        # No event is at a frame, but by chance.
        time = (np.arange(count) + 0.382 * number % 1.0) / RATE
        record = motion(time)
        for noise in noises:
            rng = np.random.default_rng((number, round(1e9 * noise)))
            # Of four markers: the angle has the noise of one over the body's rms radius.
            angle = record.angle[0] + noise * rng.normal(size=count)
            position = record.position[0] + noise * SIZE / 2 * (
                rng.normal(size=(count, 2)) @ (1, 1j)
            )
            one = np.ones((count, 1))
            # Angle and position have one noise: positions are in units of half the body's size.
            scale = SIZE / 2
            poses = Poses(
                stamps_of(count), angle[:, None], 0 * one, position[:, None] / scale, one, one
            )
            newest = np.arange(longest, count, stride)
            found = derive(poses, newest, np.full(1, noise))
            for lag, derived in zip(LAGS, found, strict=True):
                now = newest - round(lag * RATE)
                cells += _cells_of(name, noise, lag, record, derived, now, time, (angle, position))
    return cells


def _quantities(position: np.ndarray, angle: np.ndarray) -> dict[str, np.ndarray]:
    with np.errstate(all='ignore'):
        poles = {
            name: planar.pole(k + 1, position, angle).value for k, name in enumerate(QUANTITIES[3:])
        }
    return dict(zip(QUANTITIES, angle[1:4], strict=False)) | poles


def _cells_of(
    name: str,
    noise: float,
    lag: float,
    record: Record,
    found: Derivatives,
    now: np.ndarray,
    time: np.ndarray,
    poses: tuple[np.ndarray, np.ndarray],
) -> list[Cell]:
    truth = _quantities(record.position[:4, now], record.angle[:4, now])
    scale = SIZE / 2
    position, of_position = (
        found.position[..., 0] * scale,
        found.position_covariance[..., 0] * scale**2,
    )
    turn, of_angle = found.angle[..., 0], found.angle_covariance[..., 0]
    ours = _quantities(position, turn)
    distance = np.full(len(now), np.inf)
    if len(record.events):
        distance = np.abs(time[now, None] - record.events).min(axis=1)
    best = _best_polynomials(poses, now, lag, truth, _counted(truth, record, now))
    cells = []
    for quantity in QUANTITIES:
        error = np.abs(ours[quantity] - truth[quantity])
        if quantity in QUANTITIES[:3]:
            deviation = np.sqrt(of_angle[ORDER[quantity], ORDER[quantity]])
            square = (error / deviation) ** 2
            told = np.ones(len(now), bool)
            inside = 1.96**2
        else:
            with np.errstate(all='ignore'):
                linear = planar.pole(ORDER[quantity], position, turn)
                matrix = planar.covariance(linear, of_position, of_angle)
                off = ours[quantity] - truth[quantity]
                vector = np.stack((off.real, off.imag))
                (a, b), (_, d) = np.moveaxis(matrix, 0, -1)
                det = a * d - b * b
                square = (
                    d * vector[0] ** 2 - 2 * b * vector[0] * vector[1] + a * vector[1] ** 2
                ) / det
                deviation = np.sqrt(a + d)
                told = deviation < _WITHHELD * SIZE
            inside = 5.991
        told &= np.isfinite(square) & _counted(truth, record, now)[quantity]
        if told.sum() < _MIN_INSTANTS:
            continue
        rms = float(np.sqrt((error[told] ** 2).mean()))
        least = min(
            float(np.sqrt((one[quantity][told] ** 2).mean())) for one in best if quantity in one
        )
        parts = []
        for low, high in pairwise(DISTANCES):
            some = told & (distance >= low) & (distance < high if high < np.inf else True)
            parts.append(
                (
                    float((square[some] < inside).sum()),
                    float((square[some] > 100).sum()),
                    int(some.sum()),
                )
            )
        cells.append(
            Cell(
                name, noise, lag, quantity, rms, rms / least if least > 0 else np.nan,
                float((square[told] < inside).mean()), float((square[told] > 100).mean()),
                _interval_score(error[told], deviation[told]),
                int(told.sum()), tuple(parts),
            )
        )  # fmt: skip
    return cells


def _interval_score(error: np.ndarray, deviation: np.ndarray) -> float:
    half = 1.96 * deviation
    return float((2 * half + 2 / 0.05 * np.maximum(error - half, 0)).mean())


def _counted(
    truth: dict[str, np.ndarray], record: Record, now: np.ndarray
) -> dict[str, np.ndarray]:
    """Instants whose true figure is one to be measured."""
    near = {
        name: np.abs(truth[name] - record.position[0, now]) <= NEAR * SIZE
        for name in QUANTITIES[3:]
    }
    return {name: np.ones(len(now), bool) for name in QUANTITIES[:3]} | near


def _best_polynomials(
    poses: tuple[np.ndarray, np.ndarray],
    now: np.ndarray,
    lag: float,
    truth: dict[str, np.ndarray],
    counted: dict[str, np.ndarray],
) -> list[dict[str, np.ndarray]]:
    """Errors (T,) of all fixed windows and degrees by quantity, of those with its order."""
    angle, position = poses
    errors = []
    for samples, degree in settings(lag):
        weights, ahead = fixed_weights(samples, degree, lag)
        z, turn = apply_weights(weights, ahead, now, position[:, None], angle[:, None])
        found = _quantities(z[..., 0], turn[..., 0])
        errors.append(
            {
                name: np.nan_to_num(np.abs(found[name] - truth[name]), nan=np.inf)
                for name in QUANTITIES
                if degree >= ORDER[name]
            }
        )
    return errors


def summarize(cells: list[Cell]) -> str:
    """Make the tables."""
    lines = [
        f'{len(cells)} cells: covered under 85%, under 93%, over 97%: '
        + ', '.join(
            f'{share:.1%}'
            for share in (
                np.mean([c.covered < 0.85 for c in cells]),
                np.mean([c.covered < 0.93 for c in cells]),
                np.mean([c.covered > 0.97 for c in cells]),
            )
        )
    ]
    for quantity in QUANTITIES:
        some = [c for c in cells if c.quantity == quantity]
        ratio = np.array([c.ratio for c in some])
        number = np.array([c.number for c in some])
        beyond = np.array([c.beyond for c in some])
        lines.append(
            f'{quantity:5s} over best: median {np.nanmedian(ratio):.3f}, 90th '
            f'{np.nanquantile(ratio, 0.9):.2f}; beyond 10: '
            f'{(number * beyond).sum() / number.sum():.2%}; '
            f'under 85%: {np.mean([c.covered < 0.85 for c in some]):.0%}; by distance '
            + ', '.join(
                f'{by[0] / max(by[2], 1):.2f} {by[1] / max(by[2], 1):.1%}'
                for by in np.array([c.by_distance for c in some]).sum(axis=0)
                if by[2]
            )
        )
    return '\n'.join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--stride', type=int, default=4)
    parser.add_argument('--csv')
    options = parser.parse_args()
    rows = []
    for kind, known in (('events', event_motions()), ('smooth', smooth_motions())):
        cells = measure(known, options.stride)
        print(kind, summarize(cells), sep='\n')
        rows += cells
    if options.csv:
        with open(options.csv, 'w', encoding='utf-8', newline='') as file:
            writer = csv.writer(file)
            writer.writerow(Cell._fields[:-1])
            writer.writerows(cell[:-1] for cell in rows)


if __name__ == '__main__':
    main()
