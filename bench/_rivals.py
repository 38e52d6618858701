"""
Other methods that set themselves by the samples alone, each on the windows of the estimator.

A rival gets windows (M, n) of a signal, the sample `at` of the instant, the rate in Hz and the
noise of a sample, and returns derivatives (4, M) of order 0 to 3 at the instants.
"""

from collections.abc import Callable
from functools import cache
from math import factorial, pi, tan

import numpy as np

from bench._polynomial import derivative_weights

Rival = Callable[[np.ndarray, int, float, float], np.ndarray]

# Lengths of the Gaussian process, windows, and variances of processes over that of the noise.
_LENGTHS = 2.0 ** np.arange(-5.0, 3.1, 0.5)
_VARIANCES = 10.0 ** np.arange(-3.0, 13.1, 0.5)
# Passes of the alternating directions, and strengths of the total variation, from strong to weak.
_PASSES, _STRENGTHS = 40, 10.0 ** np.arange(6.0, -1.1, -1.0)
# Fewest samples of a segment, and parameters that one costs: a cubic and its place.
_SHORTEST, _PARAMETERS = 5, 5
# Share of the cutoffs, the highest, whose residuals are taken for noise (Winter, 2009).
_TAIL = 0.5


def gaussian_process(windows: np.ndarray, at: int, rate: float, noise: float) -> np.ndarray:
    """A line and a Matérn 9/2 process of the likeliest length, amplitude and noise."""
    return _likeliest(windows, at, rate, _LENGTHS, 1)


def kalman_smoother(windows: np.ndarray, at: int, rate: float, noise: float) -> np.ndarray:
    """
    The Kalman smoother of white snap of the likeliest density, started from nothing known.

    That is the process of the snap integrated four times, over a cubic.
    """
    return _likeliest(windows, at, rate, (np.inf,), 3)


def _likeliest(
    windows: np.ndarray, at: int, rate: float, lengths: np.ndarray | tuple[float, ...], degree: int
) -> np.ndarray:
    """Derivatives (4, M) by the process and variance of the largest restricted likelihood."""
    count, samples = windows.shape
    here = windows[:, at : at + 1]
    centered = windows - here
    best = np.full(count, np.inf)
    chosen = np.zeros((count, 2), int)
    for k, length in enumerate(lengths):
        values, vectors = _spectrum(samples, length, degree)
        squares = (centered @ vectors) ** 2
        for j, variance in enumerate(_VARIANCES):
            spread = variance * values + 1.0
            cost = len(values) * np.log((squares / spread).mean(axis=1)) + np.log(spread).sum()
            better = cost < best
            best[better], chosen[better] = cost[better], (k, j)
    found = np.empty((4, count))
    for k, j in np.unique(chosen, axis=0):
        same = (chosen == (k, j)).all(axis=1)
        weights = _process_weights(samples, at, lengths[k], degree, float(_VARIANCES[j]))
        found[:, same] = weights @ centered[same].T
    found *= (rate / (samples - 1)) ** np.arange(4)[:, None]
    found[0] += here[:, 0]
    return found


_MATERN = [np.polynomial.Polynomial([1, 1, 3 / 7, 2 / 21, 1 / 105])]
for _ in range(3):
    # Of the derivatives of a polynomial times exp(-x).
    _MATERN.append(_MATERN[-1].deriv() - _MATERN[-1])


def _covariances(samples: int, at: np.ndarray, length: float) -> np.ndarray:
    """Covariances (4, k, n) of derivatives at `at` (k,) with samples; a window is one unit long."""
    times, s = np.arange(samples) / (samples - 1), at[:, None] / (samples - 1)
    if length < np.inf:
        # Matérn 9/2: a polynomial of x = 3 r / length, times exp(-x).
        x, sign = 3 * np.abs(s - times) / length, np.where(s < times, -1, 1)
        return np.array(
            [(3 / length * sign) ** k * each(x) * np.exp(-x) for k, each in enumerate(_MATERN)]
        )
    # White snap integrated four times: the integral of (s - u)^3 (t - u)^3 / 36 up to the earlier m
    # of both, by powers of m - u, s - m and t - m.
    m = np.minimum(s, times)
    rows = np.zeros((4, *m.shape))
    for order in range(4):
        for k in range(4 - order):
            power = 3 - order - k
            ahead = (s - m) ** k / factorial(k) / factorial(power)
            for i in range(4):
                behind = (times - m) ** i / factorial(i) / factorial(3 - i)
                rows[order] += ahead * behind * m ** (power + 4 - i) / (power + 4 - i)
    return rows


@cache
def _matrix(samples: int, length: float) -> np.ndarray:
    """Covariances (n, n) of samples."""
    return _covariances(samples, np.arange(samples), length)[0]


@cache
def _spectrum(samples: int, length: float, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Variances (m,) and modes (n, m) of a process in the samples, apart from polynomials."""
    matrix = _matrix(samples, length)
    basis = np.vander(np.linspace(-1, 1, samples), degree + 1)
    rest = np.linalg.qr(basis, mode='complete')[0][:, degree + 1 :]
    values, vectors = np.linalg.eigh(rest.T @ matrix @ rest)
    return np.maximum(values, 0.0), rest @ vectors


@cache
def _process_weights(
    samples: int, at: int, length: float, degree: int, variance: float
) -> np.ndarray:
    """Weights (4, n) of samples in the derivatives, per window, by a process over a polynomial."""
    values, vectors = _spectrum(samples, length, degree)
    polynomial = derivative_weights((np.arange(samples) - at) / (samples - 1), degree, 3)
    # Mode by mode, which keeps the digits: the process at the instant, and not in the polynomial.
    process = variance * (_covariances(samples, np.array([at]), length)[:, 0] @ vectors)
    process -= polynomial @ (variance * (_matrix(samples, length) @ vectors) + vectors)
    return (process / (variance * values + 1.0)) @ vectors.T + polynomial


def butterworth(windows: np.ndarray, at: int, rate: float, noise: float) -> np.ndarray:
    """A Butterworth filter, forward and back, of the cutoff by residual analysis (Winter, 2009)."""
    samples = windows.shape[1]
    shares, filters = _butterworth_filters(samples)
    filtered = windows @ filters.swapaxes(1, 2)  # (cutoffs, M, n)
    residual = np.sqrt(((windows - filtered) ** 2).mean(axis=2))
    tail = slice(round((1 - _TAIL) * len(shares)), None)
    slope, level = np.polynomial.polynomial.polyfit(shares[tail], residual[tail], 1)[::-1]
    cutoff = (residual <= np.where(slope < 0, level, residual[-1])).argmax(axis=0)
    signal = filtered[cutoff, np.arange(len(windows))]
    rows = [signal]
    for _ in range(3):
        rows.append(np.gradient(rows[-1], 1 / rate, axis=1, edge_order=2))
    return np.array([row[:, at] for row in rows])


@cache
def _butterworth_filters(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Cutoffs (k,), shares of the rate, and what the filters make of samples (k, n, n)."""
    shares = np.linspace(0.01, 0.45, 45)
    padding = min(3 * 3, samples - 1)
    unit = np.eye(samples)
    before = 2 * unit[:1] - unit[padding:0:-1]
    after = 2 * unit[-1:] - unit[-2 : -padding - 2 : -1]
    extended = np.concatenate((before, unit, after))
    filters = []
    for share in shares:
        # The second pass moves the cutoff: 0.802 makes up for that.
        w = tan(pi * min(share / 0.802, 0.49))
        scale = 1 + 2**0.5 * w + w**2
        b, a = w**2 / scale, (2 * (w**2 - 1) / scale, (1 - 2**0.5 * w + w**2) / scale)
        found = extended
        for _ in range(2):
            found = _filtered(found, b, a)[::-1]
        filters.append(found[padding : padding + samples])
    return shares, np.array(filters)


def _filtered(signal: np.ndarray, b: float, a: tuple[float, float]) -> np.ndarray:
    """A low-pass of second order of signals (n, m), as if they had been constant before."""
    found = np.empty_like(signal)
    x1 = x2 = y1 = y2 = signal[0]
    for k, x in enumerate(signal):
        y = b * (x + 2 * x1 + x2) - a[0] * y1 - a[1] * y2
        found[k] = y
        x1, x2, y1, y2 = x, x1, y, y1
    return found


def cubic_segments(windows: np.ndarray, at: int, rate: float, noise: float) -> np.ndarray:
    """Cubics between breaks, as many and where Schwarz's criterion says, by the known noise."""
    count, samples = windows.shape
    here = windows[:, at : at + 1]
    centered = windows - here
    price = _PARAMETERS * np.log(samples)
    # Least cost of the first k samples, and where the last segment of that begins.
    least = np.full((samples + 1, count), np.inf)
    least[0] = -price
    begins = np.zeros((samples + 1, count), int)
    squares = np.pad((centered**2).cumsum(axis=1), ((0, 0), (1, 0)))
    for end in range(_SHORTEST, samples + 1):
        for begin in range(end - _SHORTEST + 1):
            basis = _cubic_basis(end - begin)
            fitted = ((centered[:, begin:end] @ basis) ** 2).sum(axis=1)
            misfit = (squares[:, end] - squares[:, begin] - fitted) / noise**2
            cost = least[begin] + price + misfit
            better = cost < least[end]
            least[end, better], begins[end, better] = cost[better], begin
    last = np.full(count, samples)
    first = begins[last, np.arange(count)]
    while (first > at).any():
        last = np.where(first > at, first, last)
        first = begins[last, np.arange(count)]
    found = np.empty((4, count))
    for begin, end in np.unique(np.column_stack((first, last)), axis=0):
        same = (first == begin) & (last == end)
        weights = derivative_weights((np.arange(begin, end) - at) / rate, 3, 3)
        found[:, same] = weights @ centered[same, begin:end].T
    found[0] += here[:, 0]
    return found


@cache
def _cubic_basis(samples: int) -> np.ndarray:
    """An orthonormal basis (n, 4) of cubics."""
    return np.linalg.qr(np.vander(np.linspace(-1, 1, samples), 4))[0]


def total_variation(windows: np.ndarray, at: int, rate: float, noise: float) -> np.ndarray:
    """
    The least total variation of the acceleration at which the residual is that of the noise.

    By alternating directions (Boyd et al., 2011), from strong to weak.
    """
    samples = windows.shape[1]
    centered = (windows - windows.mean(axis=1, keepdims=True)) / noise
    jumps = np.diff(np.eye(samples), 3, axis=0)
    found = centered.copy()
    done = np.zeros(len(windows), bool)
    split = centered @ jumps.T
    dual = np.zeros_like(split)
    for strength in _STRENGTHS:
        # The weight of the constraint is in proportion, which needs few passes.
        inverse = np.linalg.inv(np.eye(samples) + strength * jumps.T @ jumps)
        fixed, driven = centered @ inverse, strength * jumps @ inverse
        for _ in range(_PASSES):
            smooth = fixed + (split - dual) @ driven
            stepped = smooth @ jumps.T + dual
            dual = np.clip(stepped, -1.0, 1.0)
            split = stepped - dual
        fits = ~done & (((centered - smooth) ** 2).mean(axis=1) <= 1.0)
        found[fits] = smooth[fits]
        done |= fits
    rows = [found * noise + windows.mean(axis=1, keepdims=True)]
    for _ in range(3):
        rows.append(np.gradient(rows[-1], 1 / rate, axis=1, edge_order=2))
    return np.array([row[:, at] for row in rows])


RIVALS: dict[str, Rival] = {
    'Gaussian process, likeliest': gaussian_process,
    'Kalman smoother, likeliest': kalman_smoother,
    'Butterworth, residual analysis': butterworth,
    'cubic segments, BIC': cubic_segments,
    'total variation of α': total_variation,
}
