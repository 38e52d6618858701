"""
Low polynomials between events: a window is divided into segments with a polynomial each.

Dynamic programming finds the best division that has any given segment around the instant. The
result is the mean over these segments, and is mixed with that of the models by the evidence.
"""

from math import factorial
from typing import NamedTuple

import numpy as np

from derivatives_reference._evidence import Found
from derivatives_reference._samples import Window
from kinpole_ros.planar._plane import Real

# Degree of a segment, and the degrees more that its covariance has.
_DEGREE, _MORE = 2, 2
# Evidence that a coefficient and an event cost.
_COEFFICIENT, EVENT_COST = 5.0, 12.0
_SHORTEST = 2
# How many segments count, and how far they are behind the best, and all behind the models.
_KEPT, _BEHIND = 8, 20.0
# The power of the evidence in the covariance.
PLACE_POWER = 0.25
_SIGNALS = (slice(0, 1), slice(1, 3))


class Division(NamedTuple):
    """
    The best divisions by angle and position, each with a segment around the instant.

    `values` (2, n + 1, n + 1) is their evidence by the first and last + 1 of this segment, less
    that of the best. `evidence` (2,) is that of the best, over that of noise alone. `excess` (2,)
    is what a coefficient costs more where there are as many as samples.
    """

    values: Real
    evidence: Real
    excess: Real


def add_segments(window: Window, samples: Real, weight: Real, found: Found) -> None:
    """Mix segments of `samples` (n, 3) with a `weight` (n,) into what is `found`."""
    division = _divide_window(window, samples, weight)
    orders = window.orders
    present = np.concatenate(([0], np.cumsum(weight > 0)))
    for c, part in enumerate(_SIGNALS):
        whole, ahead = division.values[c], division.evidence[c] - found.evidence[c]
        if ahead <= -_BEHIND:
            continue
        found.evidence[c] = max(found.evidence[c], division.evidence[c])
        order = np.argsort(-whole, axis=None, kind='stable')[:_KEPT]
        kept = [one for one in order if whole.flat[one] > -_BEHIND]
        if not kept:
            continue
        value = whole.flat[kept]
        likely, share = np.exp(value - value[0]), np.exp(PLACE_POWER * (value - value[0]))
        likely, share = likely / likely.sum(), share / share.sum()
        means, spreads, freedom = [], [], []
        for one in kept:
            rows = slice(*np.unravel_index(one, whole.shape))
            own = samples[rows, part]
            mean, spread, degree = _derive(
                window, own, weight[rows], rows.start, division.excess[c]
            )
            length = present[rows.stop] - present[rows.start]
            unknown = np.maximum(degree + _MORE, np.arange(orders)) >= length
            other = ((found.mean[:, part] - mean) ** 2).mean(axis=1)
            spread = spread + np.diag(unknown * (np.diag(found.covariance[..., c]) + other))
            means.append(mean)
            spreads.append(spread)
            freedom.append(degree + 1)
        mean = np.tensordot(likely, means, 1)
        off = np.array(means) - mean
        covariance = np.tensordot(share, spreads, 1)
        covariance += np.einsum('n,nkc,njc->kj', share, off, off) / (c + 1)
        probability, by = 1 / (1 + np.exp(-ahead)), 1 / (1 + np.exp(-ahead / 2))
        both = (1 - probability) * found.mean[:, part] + probability * mean
        total = np.zeros((orders, orders))
        pairs = ((1 - by, found.mean[:, part], found.covariance[..., c]), (by, mean, covariance))
        for some, other, spread in pairs:
            total += some * (spread + (other - both) @ (other - both).T / (c + 1))
        found.mean[:, part], found.covariance[..., c] = both, total
        found.freedom[c] += probability * (likely @ freedom - found.freedom[c])


def _divide_window(window: Window, samples: Real, weight: Real) -> Division:
    """Divide `samples` (n, 3) with a `weight` (n,) into segments."""
    count = len(samples)
    at = window.at + (count - 1) / 2
    square = weight[:, None] * samples**2
    largest = np.array((square[:, 0].mean(), square[:, 1:].mean()))
    with np.errstate(divide='ignore'):
        excess = np.maximum(np.log(largest) / 2 - _COEFFICIENT, 0.0) * (1, 2)
    values, evidence = _values(samples, weight, excess), np.empty(2)
    # There is an event: without one the models have more to say.
    values[:, 0, count] = -np.inf
    first, end = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing='ij')
    # A sample that is missing is in the segment before.
    begins = np.concatenate(([True], weight[1:] > 0, [True]))
    around = (first - 0.5 <= at) & (end - 0.5 > at) & begins[first] & begins[end]
    for c in range(2):
        before, after = _divide(values[c], c + 1)
        evidence[c] = before[count] + np.count_nonzero(weight) * (c + 1) / 2
        values[c] = np.where(around, before[:, None] + values[c] + after - before[count], -np.inf)
    return Division(values, evidence, excess)


def _values(samples: Real, weight: Real, excess: Real) -> Real:
    """Evidence (2, n + 1, n + 1) of segments of angle and position, by their first and last + 1."""
    count = len(samples)
    values = np.full((2, count + 1, count + 1), -np.inf)
    for length in range(_SHORTEST, count + 1):
        first = np.arange(count - length + 1)
        rows = first[:, None] + np.arange(length)
        root = np.sqrt(weight[rows])[..., None]
        degrees = range(min(_DEGREE + 1, length))
        basis, _ = np.linalg.qr(root * (np.arange(length) / length)[:, None] ** degrees)
        own = root * samples[rows]
        along = basis.swapaxes(1, 2) @ own
        squares = ((own - basis @ along) ** 2).sum(axis=1)
        for c, part in enumerate(_SIGNALS):
            best, _ = _best(
                (along[..., part] ** 2).sum(axis=-1),
                squares[:, part].sum(axis=-1),
                np.count_nonzero(root, axis=(1, 2)),
                c + 1,
                excess[c],
            )
            values[c, first, first + length] = best
    return values


def _best(
    of_degree: Real, squares: Real, length: np.ndarray, signals: int, excess: float
) -> tuple[Real, Real]:
    """Evidence (B,) of the best degree, and that degree, by the squares (B, K) of coefficients."""
    of_degree = np.pad(of_degree, ((0, 0), (0, _DEGREE + 1 - of_degree.shape[1])))
    after = np.cumsum(of_degree[:, ::-1], axis=1)[:, ::-1]
    left = squares[:, None] + np.pad(after, ((0, 0), (0, 1)))[:, 1:]
    degrees = np.arange(_DEGREE + 1)
    value = -left / 2 - _COEFFICIENT * signals * (degrees + 1) - EVENT_COST
    length = length[:, None]
    value -= np.where(degrees + 1 == length, length * excess, 0.0)
    value[(degrees + 1 > length) | (length < _SHORTEST)] = -np.inf
    return value.max(axis=1), value.argmax(axis=1)


def _divide(value: Real, signals: int) -> tuple[Real, Real]:
    """Best evidence (n + 1,) of the samples before and after each place between them."""
    count = len(value) - 1
    before, after = np.full((2, count + 1), -np.inf)
    before[0], after[count] = EVENT_COST + 2 * _COEFFICIENT * signals, 0.0
    for end in range(1, count + 1):
        before[end] = (before + value[:, end]).max()
    for first in range(count - 1, -1, -1):
        after[first] = (after + value[first]).max()
    return before, after


def _derive(
    window: Window, own: Real, weight: Real, first: int, excess: float
) -> tuple[Real, Real, int]:
    """Derivatives (K, c) of a segment at the instant, their covariance (K, K), and the degree."""
    size, orders = window.size, window.orders
    time = (np.arange(first, first + len(own)) - window.at - (size - 1) / 2) / len(own)
    root = np.sqrt(weight)[:, None]
    present = np.count_nonzero(weight)
    columns = min(5, present)
    basis, factor = np.linalg.qr(root * time[:, None] ** range(columns))
    along = basis.T @ (root * own)
    low = basis[:, : _DEGREE + 1]
    squares = ((root * own - low @ along[: _DEGREE + 1]) ** 2).sum()
    of_degree = (along[None, : _DEGREE + 1] ** 2).sum(axis=2)
    signals = own.shape[1]
    seen = np.array([present])
    degree = int(_best(of_degree, squares[None], seen, signals, excess)[1][0])
    powers = np.zeros((orders, columns))
    for order in range(min(orders, columns)):
        powers[order, order] = factorial(order) / float(len(own)) ** order
    stencil = powers @ np.linalg.inv(factor)
    mean = stencil[:, : degree + 1] @ along[: degree + 1]
    highest = np.maximum(degree + _MORE, np.arange(orders))
    seen = stencil * (np.arange(columns) <= highest[:, None])
    return mean, seen @ seen.T, degree
