"""The drivers of a discovered linkage: a steady turn, a sine, or a table over time."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real

# A turn of more than a revolution is steady if its rms residual is below this, rad.
_MAX_STEADY = 0.05
# A swing is a sine if its rms residual is below this share of the amplitude, and if it lasts this
# many periods.
_MAX_SINE, _MIN_PERIODS = 0.005, 0.5
# Most frequencies that are scanned. Each step of the refinement is shorter by a factor.
_MAX_FREQUENCIES, _REFINEMENT = 3000, 1.7
# Points at which a sine is compared while frequencies are scanned, and refined.
_SCANNED_POINTS, _REFINED_POINTS = 500, 2000
# Values of a table, and those that each swing needs. The table is shortened by a factor until its
# rms error is below a share of the range, or until it is shorter than this many seconds.
_VALUES, _VALUES_PER_SWING = 61, 16
_MAX_TABLE, _SHORTER, _MIN_SECONDS = 0.01, 0.7, 0.5


class Drive(NamedTuple):
    """
    How a variable is driven over time.

    `kind` is rate (`values`: rate, start), sine (mean, amplitude, frequency, phase: mean +
    amplitude sin(2π frequency t + phase)) or table (times, then values). `residual` is the rms
    residual; that of a sine as a share of the amplitude.
    """

    kind: str
    values: tuple[float, ...]
    residual: float

    def text(self, name: str, offset: float, unit: str) -> str:
        """The driver of a variable in a scene, in deg or m, with `offset` added to its values."""
        factor = 180 / np.pi if unit == 'deg' else 1.0

        def quantity(value: float) -> str:
            return f'{value * factor:.6f} {unit}'

        if self.kind == 'rate':
            rate, start = self.values
            return f'{{drive: {name}, rate: {rate:.9g} rad/s, start: {quantity(start + offset)}}}'
        if self.kind == 'sine':
            mean, amplitude, frequency, phase = self.values
            return (
                f'{{drive: {name}, mean: {quantity(mean + offset)}, '
                f'amplitude: {quantity(amplitude)}, frequency: {frequency:.9g}, '
                f'phase: {np.degrees(phase):.6f} deg}}'
            )
        half = len(self.values) // 2
        times = ', '.join(f'{t:.4g}' for t in self.values[:half])
        table = ', '.join(f'{(value + offset):.6f}' for value in self.values[half:])
        return f'{{drive: {name}, times: [{times}], values: [{table}]}}'


def fit_drive(seconds: Real, values: Real, may_turn: bool) -> Drive:
    """Fit a drive to `values` (T,) at `seconds` (T,), NaN for none; `may_turn` allows a rate."""
    seen = np.isfinite(values)
    t, y = seconds[seen], values[seen]
    rate, start = np.polyfit(t, y, 1)
    residual = float(np.std(y - rate * t - start))
    if may_turn and residual < _MAX_STEADY and np.ptp(y) > 2 * np.pi:
        return Drive('rate', (float(rate), float(start)), residual)
    return _fit_sine(t, y) or _fit_table(t, y)


def _fit_table(t: Real, y: Real) -> Drive:
    last = min(float(t[-1]), 2 * _VALUES / _VALUES_PER_SWING / _usual_frequency(t, y))
    while True:
        times = np.linspace(0.0, last, _VALUES)
        table = np.interp(times, t, y)
        covered = (t >= 0) & (t <= last)
        off = np.interp(t[covered], times, table) - y[covered]
        # The scene's spline is more accurate than the straight lines that are tried here.
        if float(np.sqrt(np.mean(off**2))) < _MAX_TABLE * np.ptp(y[covered]) or (
            last < _MIN_SECONDS
        ):
            return Drive('table', (*times.tolist(), *table.tolist()), 1.0)
        last *= _SHORTER


def _fit_sine(t: Real, y: Real) -> Drive | None:
    """The best sine, None if none fits. Frequencies are scanned, then refined by steps."""
    length = float(t[-1] - t[0])
    interval = length / max(len(t) - 1, 1)
    highest = min(3 * _usual_frequency(t, y) + 2 / length, 0.5 / interval)
    frequencies = np.arange(0.25 / length, max(highest, 0.5 / length), 0.2 / length)
    if len(frequencies) > _MAX_FREQUENCIES:
        return None
    step = max(1, min(len(t) // _SCANNED_POINTS, int(0.2 / highest / interval) or 1))
    residuals = [_sine_fit(t[::step], y[::step], f)[0] for f in frequencies]
    step = max(1, len(t) // _REFINED_POINTS)
    t, y = t[::step], y[::step]
    best = float(frequencies[int(np.argmin(residuals))])
    change = 0.1 / length
    while change > 1e-9 * best:
        near = [best - change, best, best + change]
        best = near[int(np.argmin([_sine_fit(t, y, f)[0] for f in near]))]
        change /= _REFINEMENT
    residual, (mean, a, b) = _sine_fit(t, y, best)
    amplitude = float(np.hypot(a, b))
    if residual > _MAX_SINE * amplitude or best * length < _MIN_PERIODS:
        return None
    phase = float(np.arctan2(b, a))
    return Drive('sine', (float(mean), amplitude, best, phase), residual / amplitude)


def _usual_frequency(t: Real, y: Real) -> float:
    """Frequency by the crossings of the median, two a period."""
    length = float(t[-1] - t[0])
    # Values within a twentieth of the range of the median are noise, not a crossing.
    clear = np.sign(y - np.median(y))[np.abs(y - np.median(y)) > 0.05 * np.ptp(y)]
    return max(int((np.diff(clear) != 0).sum()) / (2 * length), 0.25 / length)


def _sine_fit(t: Real, y: Real, frequency: float) -> tuple[float, Real]:
    """Rms residual, and mean and factors of sine and cosine (3,), by least squares."""
    angle = 2 * np.pi * frequency * t
    rows = np.stack((np.ones(len(t)), np.sin(angle), np.cos(angle)), axis=1)
    solution, *_ = np.linalg.lstsq(rows, y, rcond=None)
    return float(np.std(y - rows @ solution)), solution
