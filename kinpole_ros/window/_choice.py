"""
How long a window and how high a degree: chosen at every instant, from the data.

A short window of high degree follows any motion and carries much noise; a long one of low degree
the reverse, and which is best differs between motions by orders of magnitude. So all windows of a
geometric ladder and all degrees are fitted at once (one projection on an orthonormal basis holds
every degree) and their answers are averaged, each with the weight exp(-criterion / 2),

    criterion = RSS / noise^2 + 6 per coefficient - 3 per sample of the window.

The last term is what a sample left outside the window costs. It bounds the harm a bad day does: a
fit has to leave three times the noise before a shorter window is preferred. Averaging keeps the
answer from flapping between models, and the spread of the models is part of its variance (Hoeting
et al., Bayesian model averaging, 1999). Each order of derivative averages the models whose degree
can hold it, so what is found for one order never depends on which others are asked for.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real
from kinpole_ros.window._polynomial import orthonormal_basis

HIGHEST_ORDER = 4
FEWEST_SAMPLES = 7
_HIGHEST_DEGREE = 12
_PER_COEFFICIENT = 6.0
_PER_SAMPLE = 2.5
_LADDER = 1.33
_ENOUGH_FREEDOM = 8


class Derivatives(NamedTuple):
    """
    Derivatives of signals at one instant, of order 0 to K - 1.

    `values` (K, G, 2); `covariance` (K, K, G) between orders, of one component; both NaN where the
    samples are too few. `span` (G,) is the time in s that the models of order 1 used, `degree` (G,)
    their degree, both as weighted means over the models.
    """

    values: Real
    covariance: Real
    span: Real
    degree: Real


class _Models(NamedTuple):
    """All fits of one set of instants: `groups` is 1 where every signal shares them, else G."""

    basis: Real  # (groups, L, N, degrees), members orthonormal on the weighted samples
    rows: Real  # (groups, L, HIGHEST_ORDER + 1, degrees), their derivatives at time 0
    counts: Real  # (groups, L) samples with weight in each window
    spans: Real  # (L,) s


def differentiate(
    times: np.ndarray,
    signals: Real,
    weights: Real | None,
    noise: Real,
    dimensions: np.ndarray,
    order: int,
) -> Derivatives:
    """
    Derivatives of order 0 to `order` of G signals at time 0.

    `times` (N,) are whole ns from that instant, rising, with 0 among them; `signals` (N, G, 2) are
    vectors of the plane, or numbers in their first component; `dimensions` (G,) says which, 2 or 1.
    `weights` (N, G) are the inverse variances of the samples relative to `noise` (G,), the
    standard deviation of one component of a sample of weight 1; 0 is a sample that is missing,
    None means all are 1.
    """
    now = int(np.searchsorted(times, 0))
    count, groups = signals.shape[:2]
    base = signals[now]
    if weights is None:
        models = _shared_models(times.tobytes(), now)
        # All signals are columns of one product.
        scaled = (signals - base).reshape(1, 1, count, groups * 2)
    else:
        root = np.sqrt(weights)
        models = _models(times, now, np.ascontiguousarray(root.T))
        centered = np.where(root[..., None] > 0, signals - base, 0.0) * root[..., None]
        scaled = np.moveaxis(centered, 1, 0)[:, None]
    transposed = np.swapaxes(models.basis, -1, -2)
    coefficients = transposed @ scaled
    inside = (models.basis[..., 0] != 0)[..., None]
    left = np.where(inside, scaled - models.basis @ coefficients, 0.0)
    squares = _by_group(np.einsum('gln...,gln...->gl...', left, left)[:, :, None], groups)
    coefficients = _by_group(coefficients, groups)
    # RSS of degree d is that of the richest fit plus the coefficients above d: no cancellation.
    tails = np.cumsum((coefficients**2)[:, ::-1], axis=1)[:, ::-1]
    rss = np.concatenate((tails[:, 1:], np.zeros_like(tails[:, :1])), axis=1) + squares

    degrees = np.arange(models.rows.shape[-1])[:, None]
    counts = models.counts.T[:, None]
    allowed = degrees <= np.maximum(counts - 3, np.minimum(counts - 1, HIGHEST_ORDER))
    # A fit through all of a few samples leaves nothing over and would always be believed, so
    # windows thinned by missing samples serve only where there are no fuller ones.
    allowed = allowed & (counts >= np.minimum(counts.max(axis=0), FEWEST_SAMPLES))
    level = _level(rss.sum(axis=-1), counts[:, 0], allowed, dimensions, noise)
    criterion = rss.sum(axis=-1) / level**2 + dimensions * (
        _PER_COEFFICIENT * (degrees + 1) - _PER_SAMPLE * counts
    )
    orders = np.arange(order + 1)
    usable = (allowed & (degrees >= orders[:, None, None, None])) & np.isfinite(criterion)
    criterion = np.where(usable, criterion, np.inf)
    best = criterion.min(axis=(1, 2), keepdims=True)
    known = np.isfinite(best)
    share = np.exp(-0.5 * (criterion - np.where(known, best, 0.0)))
    share /= np.where(known, share.sum(axis=(1, 2), keepdims=True), 1.0)  # (K, L, degrees, G)

    rows = np.moveaxis(models.rows[:, :, : order + 1], (2, 0), (0, 3))  # (K, L, degrees, groups)
    terms = rows[..., None] * coefficients
    each = np.cumsum(terms, axis=2)  # what every model says, (K, L, degrees, G, 2)
    values = np.einsum('kldg,kldgc->kgc', share, each)
    between = np.einsum('kldg,kldgc->kg', share, (each - values[:, None, None]) ** 2) / dimensions
    # The average is linear in the samples: member j counts with the share of all degrees >= j.
    reach = np.cumsum(share[:, :, ::-1], axis=2)[:, :, ::-1] * rows  # (K, L, degrees, G)
    flat = np.moveaxis(models.basis, 2, 1).reshape(models.basis.shape[0], count, -1)
    by_member = np.moveaxis(reach, (1, 2, 3), (0, 1, 2)).reshape(-1, groups, order + 1)
    if weights is None:
        per_sample = np.tensordot(flat[0], by_member, axes=1)  # (N, G, K)
    else:
        per_sample = np.moveaxis(flat @ np.moveaxis(by_member, 1, 0), 0, 1)
    covariance = np.einsum('ngk,ngm->kmg', per_sample, per_sample) * noise**2
    covariance[orders, orders] += between
    values[0] += base
    unknown = ~known[:, 0, 0]
    values[unknown] = np.nan
    covariance[unknown[:, None] | unknown[None]] = np.nan
    first = share[min(1, order)]
    span = (first.sum(axis=1) * models.spans[:, None]).sum(axis=0)
    return Derivatives(values, covariance, span, (first * degrees).sum(axis=(0, 1)))


def _level(
    rss: Real, counts: np.ndarray, allowed: np.ndarray, dimensions: np.ndarray, noise: Real
) -> Real:
    """The noise (G,) to judge by: not less than what the best of the richest fits leaves."""
    richest = allowed.sum(axis=1)  # coefficients of the richest fit, (L, G)
    left = np.take_along_axis(rss, (richest - 1)[:, None], axis=1)[:, 0]
    freedom = counts - richest
    variance = np.where(
        freedom >= _ENOUGH_FREEDOM, left / (dimensions * np.maximum(freedom, 1)), np.inf
    ).min(axis=0)
    return np.where(np.isfinite(variance), np.maximum(noise, np.sqrt(variance)), noise)


def _by_group(array: Real, groups: int) -> Real:
    """(1, L, d, 2 G) or (G, L, d, 2) to (L, d, G, 2)."""
    if array.shape[0] == 1 and array.shape[-1] == 2 * groups:
        return array[0].reshape(*array.shape[1:3], groups, 2)
    return np.moveaxis(array, 0, 2)


@lru_cache(maxsize=16)
def _shared_models(times: bytes, now: int) -> _Models:
    """The models of equally weighted samples: even sampling asks for the same ones every frame."""
    instants = np.frombuffer(times, np.int64)
    return _models(instants, now, np.ones((1, len(instants))))


def _models(times: np.ndarray, now: int, root: Real) -> _Models:
    """Fit bases for every window of the ladder: each reaches as far ahead as it does back."""
    count = len(times)
    lengths = [min(FEWEST_SAMPLES, count)]
    while lengths[-1] * _LADDER < count:
        # Odd lengths are symmetric about the instant.
        lengths.append(int(lengths[-1] * _LADDER) // 2 * 2 + 1)
    if lengths[-1] < count:
        lengths.append(count)
    sizes = np.array(lengths)
    ahead = np.maximum(np.minimum(count - 1 - now, (sizes - 1) // 2), sizes - 1 - now)
    first, last = now + ahead - sizes + 1, now + ahead
    index = np.arange(count)
    inside = (index >= first[:, None]) & (index <= last[:, None])
    weights = root[:, None] * inside
    seconds = np.broadcast_to(times * 1e-9, weights.shape)
    degree = min(_HIGHEST_DEGREE, count - 1)
    basis, rows = orthonormal_basis(seconds, weights, degree, HIGHEST_ORDER)
    counts = (weights > 0).sum(axis=-1)
    # Members beyond the samples of a window mean nothing.
    member = np.arange(degree + 1) < counts[..., None]
    basis = basis * member[..., None, :]
    rows = rows * member[..., None, :]
    return _Models(basis, rows, counts, (times[last] - times[first]) * 1e-9)
