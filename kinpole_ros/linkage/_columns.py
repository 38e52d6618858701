"""Quantiles of many columns at once, each without the values that it lacks."""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.planar._plane import Real


def quantiles(rows: Real, shares: Sequence[float]) -> tuple[Real, np.ndarray]:
    """
    Compute quantiles of each of the `rows` (n, T), without NaN, as `numpy.quantile` does.

    Returns them (len(shares), n), NaN for a row without values, and how many values (n,) there are.
    """
    ordered = np.sort(rows, axis=1)
    counts = np.isfinite(ordered).sum(axis=1)
    every = np.arange(len(rows))
    found = np.full((len(shares), len(rows)), np.nan)
    last = np.maximum(counts - 1, 0)
    for row, share in zip(found, shares, strict=True):
        place = last * share
        before = np.floor(place).astype(np.int64)
        part = place - before
        low, high = ordered[every, before], ordered[every, np.minimum(before + 1, last)]
        step = high - low
        row[:] = np.where(part < 0.5, low + step * part, high - step * (1 - part))
    return found, counts


def medians(rows: Real) -> tuple[Real, np.ndarray]:
    """Compute the medians (n,) of `rows` (n, T) without NaN, and how many values (n,) there are."""
    ordered = np.sort(rows, axis=1)
    counts = np.isfinite(ordered).sum(axis=1)
    every = np.arange(len(rows))
    low, high = (ordered[every, np.maximum(k, 0) // 2] for k in (counts - 1, counts))
    return np.where(counts % 2, low, (low + high) / 2), counts
