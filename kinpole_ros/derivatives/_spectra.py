"""
The spectrum of the motion of a body, over many windows.

A window alone says little of harmonics below its noise, and nothing of those that last for its
length. Many windows do: a machine that runs steadily has lines in its spectrum.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np

from kinpole_ros.planar._plane import Complex, Real

# Windows of the shortest record whose spectrum says more than a window does.
SPECTRUM_WINDOWS = 16
# Least power of a line, over that of the noise, in both halves of a record. Noise alone is above in
# both with a probability of exp(-16) at a frequency, and of 6e-5 at one of 500.
_MIN_POWER = 8.0
# A signal has a trend if it rises by more than so many standard deviations of what a line leaves.
_MIN_TREND = 4.0
# Intervals, in the mean, of a frame up to which missing ones are interpolated.
_MAX_MEAN_STEP = 4.0


@dataclass(frozen=True, eq=False)
class Lines:
    """
    Frequencies (J,) of a signal, rad per frame, and the variances (J,) there.

    These are over the variance of the noise of a frame. `has_trend` says whether the signal goes on
    and on, as the angle of a crank.
    """

    frequency: Real
    variance: Real
    has_trend: bool


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The lines of angle and position of a body; equal ones have the same `number`, over 0."""

    lines: tuple[Lines, Lines]
    number: int


def spectrum_numbers(spectra: Sequence[Spectrum | None]) -> np.ndarray:
    """Return the numbers (B,) of spectra, 0 for none."""
    return np.array([0 if one is None else one.number for one in spectra], np.int64)


def find_spectrum(
    time: np.ndarray, angle: Real, position: Complex, noise: tuple[float, float], window: float
) -> Spectrum | None:
    """
    Return the spectrum of poses, or None if they say no more than a window.

    At each frequency it is the lesser one of the periodograms of both halves of the poses, less a
    line, with a window of Hann (Welch 1967): what happens once, as a jump, is no spectrum.

    Parameters
    ----------
    time : (N,) int64
        When the poses were, ns, in order.
    angle, position : (N,) float, (N,) complex
        Angles with all turns, rad, and positions, m; NaN for missing ones.
    noise : (2,) float
        Standard deviations of an angle, rad, and of a coordinate, m.
    window : float
        Length of a window, s.

    """
    seen = np.isfinite(angle) & np.isfinite(position)
    time, angle, position = (one[seen] for one in (time, angle, position))
    steps = np.diff(time)
    if not (len(steps) > 1 and steps.min() > 0 and min(noise) > 0 and np.isfinite(noise).all()):
        return None
    usual = steps[steps < 1.5 * np.median(steps)].mean()
    span = float(time[-1] - time[0])
    count = round(span / usual) + 1
    if span < SPECTRUM_WINDOWS * window * 1e9 or count > _MAX_MEAN_STEP * len(time):
        return None
    even = np.linspace(0.0, span, count)
    signals = (angle,), (position.real, position.imag)
    lines = []
    for parts, sigma in zip(signals, noise, strict=True):
        samples = [
            _interpolate(even, (time - time[0]).astype(float), part / sigma) for part in parts
        ]
        lines.append(_find_lines(np.array(samples)))
    content = b''.join(one.tobytes() for own in lines for one in (own.frequency, own.variance))
    content += bytes(one.has_trend for one in lines) if content else b''
    number = int.from_bytes(blake2b(content, digest_size=8).digest(), 'little') >> 1
    return Spectrum((lines[0], lines[1]), number) if content else None


def _interpolate(even: Real, time: Real, values: Real) -> Real:
    """Return values at even times, by cubics with the slopes of a parabola through neighbors."""
    slope = np.gradient(values, time)
    before = np.clip(time.searchsorted(even, side='right') - 1, 0, len(time) - 2)
    step = time[before + 1] - time[before]
    rise, u = values[before + 1] - values[before], (even - time[before]) / step
    first, last = slope[before] * step - rise, rise - slope[before + 1] * step
    return values[before] + u * (rise + (1 - u) * ((1 - u) * first + u * last))


def _find_lines(signals: Real) -> Lines:
    """Return the lines that signals (S, N), in units of their noise, have in the mean."""
    left, rise = _without_line(signals)
    has_trend = bool((np.abs(rise) > _MIN_TREND * left.std(axis=1)).any())
    half = signals.shape[1] // 2
    first, last = signals[:, :half], signals[:, -half:]
    powers = _periodogram(first, has_trend), _periodogram(last, has_trend)
    # Poses that are off, or interpolated, are more noise than the measured one. Powers of noise are
    # sums of S exponential ones, over S, whose median is 1 - 1 / (3 S).
    noise = max(1.0, float(np.median(powers)) / (1 - 1 / (3 * len(signals))))
    power = np.minimum(*powers)
    which = np.flatnonzero(power > _MIN_POWER * noise)
    return Lines(2 * np.pi / half * which, 2 / half * (power[which] - noise), has_trend)


def _without_line(signals: Real) -> tuple[Real, Real]:
    """Return signals (S, N) less a line of each, and by how much this rises (S,)."""
    time = np.linspace(-0.5, 0.5, signals.shape[1])
    line = np.polynomial.polynomial.polyfit(time, signals.T, 1)
    return signals - np.polynomial.polynomial.polyval(time, line), line[1]


def _periodogram(signals: Real, has_trend: bool) -> Real:
    """
    Return the mean periodogram of signals (S, N) less their means, or lines if they have a trend.

    That of white noise is its variance.
    """
    taper = np.hanning(signals.shape[1] + 2)[1:-1]
    left = signals - signals.mean(axis=1, keepdims=True)
    if has_trend:
        left, _ = _without_line(signals)
    return (np.abs(np.fft.rfft(left * (taper / np.linalg.norm(taper)))) ** 2).mean(axis=0)
