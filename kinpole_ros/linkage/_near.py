"""Pairs of points that may be near each other, without all distances of one to the other."""

import numpy as np


def near_pairs(
    points: np.ndarray, others: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    List the pairs of points whose first coordinates differ by no more than the `reach` (n,).

    `points` (n, d) and `others` (m, d) may be NaN, and are in no pair then. Returns the numbers of
    the points and of the others, those of one point one after the other.
    """
    order = np.argsort(others[:, 0], kind='stable')
    order = order[: np.count_nonzero(~np.isnan(others[:, 0]))]
    ordered = others[order, 0]
    # Rounding must not leave out one that is exactly so far away.
    reach = reach * (1 + 1e-9)
    known = np.isfinite(points[:, 0]) & np.isfinite(reach)
    at, reach = np.where(known, points[:, 0], 0.0), np.where(known, reach, 0.0)
    first = np.searchsorted(ordered, at - reach, side='left')
    counts = np.where(known, np.searchsorted(ordered, at + reach, side='right') - first, 0)
    rows = np.repeat(np.arange(len(points)), counts)
    within = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    return rows, order[first[rows] + within]
