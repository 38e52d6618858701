"""What drives a linkage, as a scene says it: a steady turn, a sine, or values over time."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real

# rms off a steady turn, rad, that is still called one; share of its amplitude off a sine.
_STEADY = 0.05
_SINE = 0.005
# Values of a table, and as many of them for each swing.
_VALUES = 61
_EACH = 16
_SHORTEST = 0.5  # s
_TURN = 2 * np.pi


class Drive(NamedTuple):
    """
    How a variable goes over time.

    `kind` is rate (`values`: rate, start), sine (mean, amplitude, frequency, phase, with
    mean + amplitude sin(2π frequency t + phase)) or table (times, values one after the other);
    `off` is the rms of what it leaves over, as a share of the amplitude.
    """

    kind: str
    values: tuple[float, ...]
    off: float


def fit_drive(seconds: Real, values: Real, turns: bool) -> Drive:
    """A drive of values (T,) at `seconds` (T,), NaN for none; `turns`: it may turn steadily."""
    seen = np.isfinite(values)
    t, y = seconds[seen], values[seen]
    rate, start = np.polyfit(t, y, 1)
    off = float(np.std(y - rate * t - start))
    if turns and off < _STEADY and np.ptp(y) > _TURN:
        return Drive('rate', (float(rate), float(start)), off)
    sine = _sine(t, y)
    if sine is not None:
        return sine
    last = min(float(t[-1]), 2 * _VALUES / _EACH / _usual_frequency(t, y))
    while True:
        times = np.linspace(0.0, last, _VALUES)
        table = np.interp(times, t, y)
        part = (t >= 0) & (t <= last)
        off = float(np.sqrt(np.mean((np.interp(t[part], times, table) - y[part]) ** 2)))
        # A spline through the values is better by far than the straight lines that are tried.
        if off < 0.01 * np.ptp(y[part]) or last < _SHORTEST:
            return Drive('table', (*times.tolist(), *table.tolist()), 1.0)
        last *= 0.7


def _sine(t: Real, y: Real) -> Drive | None:
    """The sine that fits best, if one fits at all; frequencies by scanning, then by halving."""
    length = float(t[-1] - t[0])
    usual = length / max(len(t) - 1, 1)
    guess = _usual_frequency(t, y)
    highest = min(3 * guess + 2 / length, 0.5 / usual)
    frequencies = np.arange(0.25 / length, max(highest, 0.5 / length), 0.2 / length)
    if len(frequencies) > 3000:
        return None
    some = slice(None, None, max(1, min(len(t) // 500, int(0.2 / highest / usual) or 1)))
    left = [_left_over(t[some], y[some], f)[0] for f in frequencies]
    some = slice(None, None, max(1, len(t) // 2000))
    t, y = t[some], y[some]
    best = float(frequencies[int(np.argmin(left))])
    step = 0.1 / length
    while step > 1e-9 * best:
        around = [best - step, best, best + step]
        best = around[int(np.argmin([_left_over(t, y, f)[0] for f in around]))]
        step /= 1.7
    off, (mean, a, b) = _left_over(t, y, best)
    amplitude = float(np.hypot(a, b))
    # Less than half a swing may be anything.
    if off > _SINE * amplitude or best * length < 0.5:
        return None
    phase = float(np.arctan2(b, a))
    return Drive('sine', (float(mean), amplitude, best, phase), off / amplitude)


def _usual_frequency(t: Real, y: Real) -> float:
    """How often it crosses its median, of two crossings a period."""
    length = float(t[-1] - t[0])
    # What is nearer than a twentieth of its range to the median is not a crossing yet.
    clear = np.sign(y - np.median(y))[np.abs(y - np.median(y)) > 0.05 * np.ptp(y)]
    return max(int((np.diff(clear) != 0).sum()) / (2 * length), 0.25 / length)


def _left_over(t: Real, y: Real, frequency: float) -> tuple[float, Real]:
    angle = _TURN * frequency * t
    rows = np.stack((np.ones(len(t)), np.sin(angle), np.cos(angle)), axis=1)
    found, *_ = np.linalg.lstsq(rows, y, rcond=None)
    return float(np.std(y - rows @ found)), found
