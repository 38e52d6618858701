"""Statistics of residuals: robust levels, and what random ones exceed."""

import math
from functools import cache, lru_cache
from statistics import NormalDist

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from kinpole_ros.planar._plane import Complex, Real

# Share of the largest squares that may be outliers.
OUTLIER_SHARE = 0.1
# A square is an outlier if it is this many times the maximum of the bulk, the lowest 70%.
OUTLIER_RATIO, BULK_SHARE = 9.0, 0.7
# Samples in a row that take so many times the median time have a gap between them.
_MAX_GAP = 3.0


def bulk_maximum(values: Real) -> Real:
    """Return the largest (B,) of the lowest 70% of values (B, m), NaN left out."""
    ranked = np.sort(values)  # NaN come last
    last = np.ceil(BULK_SHARE * np.maximum((~np.isnan(ranked)).sum(axis=-1) - 1, 0)).astype(int)
    return np.asarray(ranked[np.arange(len(ranked)), last])


def medians(values: Real) -> Real:
    """Return medians (B,) of values (B, m), NaN left out; nanmedian takes ten times as long."""
    ranked, number = np.sort(values, axis=1), (~np.isnan(values)).sum(axis=1)
    rows, last = np.arange(len(values)), np.maximum(number - 1, 0)
    return np.asarray((ranked[rows, last // 2] + ranked[rows, (last + 1) // 2]) / 2)


def median(values: Real) -> float:
    """Return the median of values (m,); np.median takes 10 ms once, to import numpy.ma."""
    return float(medians(values[None])[0])


def mean_square(residual: Complex, expected: Real) -> tuple[Real, Real]:
    """Return mean squares (...) of residuals (..., n) per degree of freedom, and the degrees."""
    seen = ~np.isnan(residual)
    squares = np.where(seen, residual.real**2 + residual.imag**2, 0).sum(axis=-1)
    freedom = np.where(seen, expected, 0).sum(axis=-1)
    enough = freedom > 0.5
    return np.where(enough, squares / np.where(enough, freedom, 1.0), np.nan), freedom


def trimmed_mean(squares: Real, freedom: int) -> float:
    """Return the mean of squares (m,) of `freedom` degrees each, robust against outliers."""
    limit = OUTLIER_RATIO * bulk_maximum(squares[None])[0]
    ranked = np.sort(squares[squares <= limit])
    lowest = ranked[: max(1, math.ceil(len(ranked) * (1 - OUTLIER_SHARE)))]
    return float(lowest.mean()) / share_of_lowest(float(freedom))


@lru_cache(maxsize=1024)
def share_of_lowest(freedom: float) -> float:
    """Return the mean of the lowest 90% of a chi-square over its mean (Wilson, Hilferty 1931)."""
    cube = np.maximum(1 - 2 / (9 * freedom) + _lowest_normal() * np.sqrt(2 / (9 * freedom)), 0)
    return float((cube**3).mean())


@cache
def _lowest_normal() -> Real:
    """Return the lowest 90% of a normal distribution, at 200 even levels."""
    levels = (np.arange(200) + 0.5) / 200 * (1 - OUTLIER_SHARE)
    return np.array([NormalDist().inv_cdf(level) for level in levels])


def student(freedom: Real) -> Real:
    """
    Return the square of the 95% limit of Student's t (...) over that of a normal distribution.

    A measured variance of `freedom` (...) degrees is multiplied by it, so that 95% intervals cover.
    By the expansion of Cornish and Fisher (Hill 1970, ACM algorithm 396), second order.
    """
    z = NormalDist().inv_cdf(0.975)
    first, second = (z**2 + 1) / 4, (5 * z**4 + 16 * z**2 + 3) / 96
    return np.asarray((1 + (first + second / freedom) / freedom) ** 2)


def chi_square(freedom: Real, deviations: float) -> Real:
    """
    Return a chi-square over its `freedom` (...) at so many standard deviations.

    By the cube root of Wilson and Hilferty (1931); less than 1 degree counts as 1.
    """
    part = 2 / (9 * np.maximum(freedom, 1.0))
    return np.asarray(np.maximum(1 - part + deviations * np.sqrt(part), 0.0) ** 3)


def divided_differences(time: Real, values: Real | Complex, order: int) -> Real | Complex:
    """
    Return divided differences (M, ...) of values (N, ...) at `time` (N,), of samples without gaps.

    They are scaled so that those of white noise have its standard deviation.
    """
    rows = sliding_window_view(time, order + 1)
    length = rows[:, -1] - rows[:, 0]
    usable = length < _MAX_GAP * median(length)
    rows = rows[usable]
    between = (rows[:, :, None] - rows[:, None]) / length[usable, None, None]
    between += np.eye(order + 1)
    with np.errstate(divide='ignore', invalid='ignore'):
        weights = 1 / between.prod(axis=2)
        weights /= np.sqrt((weights**2).sum(axis=1, keepdims=True))
    good = np.isfinite(weights).all(axis=1)
    usable[usable] = good
    weights = weights[good].reshape(-1, *(1,) * (values.ndim - 1), order + 1)
    windows = sliding_window_view(values, order + 1, axis=0)[usable]
    return np.asarray((weights * windows).sum(axis=-1))
