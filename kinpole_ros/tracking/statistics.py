"""Statistics of residuals: robust levels, and what random ones exceed."""

import math
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from kinpole_ros.planar._plane import Complex, Real

# Share of the largest squares that may be outliers.
OUTLIER_SHARE = 0.1
# A square is an outlier if it exceeds those of all but the worst 30% this many times. However far
# off they are, no more than 30% are called so.
OUTLIER_RATIO, TAME_SHARE = 9.0, 0.7


def tame_part(values: Real) -> Real:
    """What (B,) all but the worst three tenths of the values (B, m) stay below, NaN left out."""
    ranked = np.sort(values)  # NaN come last
    place = np.ceil(TAME_SHARE * np.maximum((~np.isnan(ranked)).sum(axis=-1) - 1, 0)).astype(int)
    return np.asarray(ranked[np.arange(len(ranked)), place])


def medians(values: Real) -> Real:
    """Medians (B,) of values (B, m), NaN left out; nanmedian takes ten times as long."""
    ranked, number = np.sort(values, axis=1), (~np.isnan(values)).sum(axis=1)
    each, last = np.arange(len(values)), np.maximum(number - 1, 0)
    return np.asarray((ranked[each, last // 2] + ranked[each, (last + 1) // 2]) / 2)


def mean_square(residual: Complex, expected: Real) -> tuple[Real, Real]:
    """Squares (...) of residuals (..., n) per degree of freedom, NaN for none, and the degrees."""
    seen = ~np.isnan(residual)
    squares = np.where(seen, residual.real**2 + residual.imag**2, 0).sum(axis=-1)
    freedom = np.where(seen, expected, 0).sum(axis=-1)
    enough = freedom > 0.5
    return np.where(enough, squares / np.where(enough, freedom, 1.0), np.nan), freedom


def trimmed_mean(squares: Real, freedom: int) -> float:
    """Mean of squares (m,) of `freedom` degrees each, of which some may be of outliers."""
    tame = np.sort(squares[squares <= OUTLIER_RATIO * tame_part(squares[None])[0]])
    lowest = tame[: max(1, math.ceil(len(tame) * (1 - OUTLIER_SHARE)))]
    return float(lowest.mean()) / share_of_lowest(float(freedom))


@lru_cache(maxsize=1024)
def share_of_lowest(freedom: float) -> float:
    """Mean of the tame part of a chi-square over its mean (Wilson and Hilferty 1931)."""
    levels = (np.arange(200) + 0.5) / 200 * (1 - OUTLIER_SHARE)
    normal = np.array([NormalDist().inv_cdf(level) for level in levels])
    cube = np.maximum(1 - 2 / (9 * freedom) + normal * np.sqrt(2 / (9 * freedom)), 0)
    return float((cube**3).mean())


def student(freedom: Real) -> Real:
    """
    Square of the 95% limit of Student's t of `freedom` (...) over that of a normal distribution.

    A variance that is measured has errors of its own: figures are to be within 1.96 deviations as
    often. By the expansion of Cornish and Fisher (Hill 1970, ACM algorithm 396), second order.
    """
    z = NormalDist().inv_cdf(0.975)
    first, second = (z**2 + 1) / 4, (5 * z**4 + 16 * z**2 + 3) / 96
    return np.asarray((1 + (first + second / freedom) / freedom) ** 2)


def chi_square(freedom: Real, deviations: float) -> Real:
    """
    What a chi-square of `freedom` (...) over that is at so many deviations (Wilson and Hilferty).

    For less than 1 degree as for 1.
    """
    part = 2 / (9 * np.maximum(freedom, 1.0))
    return np.asarray(np.maximum(1 - part + deviations * np.sqrt(part), 0.0) ** 3)
