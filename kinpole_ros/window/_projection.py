"""
All windows about an instant, projected on polynomials.

Windows of a geometric ladder of lengths, each reaching as far ahead as it does back where it can.
Their polynomials are orthonormal on the samples, so that every coefficient has the noise of one
sample and knows nothing of the others. Which of them are to be believed is not asked here.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real
from kinpole_ros.window._models import Models, models_of, shared_models

# ns. Steps of even sampling differ by no more, for stamps are whole ns.
_UNEVEN = 1
# Instants with stamps of their own that are projected at once: what a cache holds.
_MOST_AT_ONCE = 32


_Found = tuple[Real, Real, Real]  # coefficients, squares and products as of a `Projection`


class Projection(NamedTuple):
    """
    G signals at M instants on L windows: see `project`.

    `coefficients` (L, D, 2, M, G) and the sums of squares (L, 2, M, G) of what the fits leave;
    where the signals are poses of B bodies, `products` (L, 3, M, B) are sums of those of angle and
    x, angle and y, x and y. `base` (M, G, 2) is the sample at time 0, which the others are counted
    from; `missing` (M, G) says where there is none.
    """

    models: Models
    coefficients: Real
    squares: Real
    products: Real
    base: Real
    missing: np.ndarray


def project(
    times: np.ndarray, signals: Real, weights: Real | None, order: int, bodies: int = 0
) -> Projection:
    """
    G signals at M instants, on all windows about each.

    `times` (N, M) are whole ns from each instant, rising, with 0 among them; `signals` (N, M, G, 2)
    are vectors of the plane, or numbers in their first component, as the samples about each instant
    have them. `weights` (N, G), for one instant at a time, are the inverse variances of the samples
    relative to the noise; 0 is a sample that is missing, None means all are 1, or that a signal is
    NaN throughout. Derivatives are wanted up to `order`. If `bodies` are given, the signals are
    their angles, then their positions.
    """
    places = (times >= 0).argmax(axis=0)
    base = signals[places, np.arange(len(places))]
    missing = np.isnan(base[..., 0])  # (M, G)
    if weights is not None:
        missing |= ~(weights[places] > 0)
    some_missing = np.count_nonzero(missing) > 0
    if some_missing:
        base[missing] = 0.0
    centered = signals - base
    if weights is not None:
        models = models_of(times.T, int(places[0]), weights.T, order + 1)
        # What is missing may hold anything.
        some = np.where(weights[:, None, :, None] > 0, centered, 0.0).transpose(2, 3, 1, 0)
        found = _by_own(models, some, weights, bodies, (3, 0))
        return Projection(models, *found, base, missing)
    if some_missing:
        centered = np.where(missing[..., None], 0.0, centered)
    parts = []
    for instants, even in _parts(times, places):
        stamps, part = times[:, instants], centered[:, instants]
        now = int(places[instants][0])
        if even:
            models = shared_models(stamps[:, 0].tobytes(), now, order + 1)
            found = _by_shared(models, part, bodies)
        else:
            models = models_of(stamps.T, now, None, order + 1)
            found = _by_own(models, part.transpose(1, 3, 2, 0), None, bodies, (0, 3))
        parts.append((instants, models, found))
    models, found = _joined(parts, len(places))
    return Projection(models, *found, base, missing)


def _parts(times: np.ndarray, places: np.ndarray) -> list[tuple[np.ndarray | slice, bool]]:
    """
    Which instants are projected at once, and whether their samples are even, with one pattern.

    0 is at `places` (M,) of their times (N, M), in the same place for those together.
    """
    steps = times[1:] - times[:-1] if len(times) > 1 else times
    # By the stamps alone: no figure may hang on what was asked before.
    even = np.maximum.reduce(steps) - np.minimum.reduce(steps) <= _UNEVEN
    if len(places) == 1 or (even.all() and (times == times[:, :1]).all()):
        return [(slice(None), bool(even[0]))]
    parts: list[tuple[np.ndarray | slice, bool]] = []
    for place in np.unique(places):
        those = np.flatnonzero(~even & (places == place))
        for first in range(0, len(those), _MOST_AT_ONCE):
            parts.append((those[first : first + _MOST_AT_ONCE], False))
        those = np.flatnonzero(even & (places == place))
        # Where the interval is no whole number of ns, a few patterns take turns.
        while len(those):
            alike = (times[:, those] == times[:, those[:1]]).all(axis=0)
            parts.append((those[alike], True))
            those = those[~alike]
    return parts


def _joined(
    parts: list[tuple[np.ndarray | slice, Models, _Found]], instants: int
) -> tuple[Models, _Found]:
    """Models and findings of all instants, out of those of some at a time."""
    _, models, found = parts[0]
    if len(parts) == 1:
        return models, found
    coefficients, squares, products = (
        np.empty((*array.shape[:-2], instants, array.shape[-1])) for array in found
    )
    rows = np.empty((instants, *models.rows.shape[1:]))
    rim, own = (np.empty((*models.rim.shape[:2], instants, 1)) for _ in range(2))
    spans = np.empty((len(models.spans), instants, 1))
    for those, part, found in parts:
        coefficients[..., those, :], squares[..., those, :], products[..., those, :] = found
        rows[those], rim[:, :, those], own[:, :, those] = part.rows, part.rim, part.own
        spans[:, those] = part.spans
    models = models._replace(rows=rows, rim=rim, own=own, spans=spans)
    return models, (coefficients, squares, products)


def _by_shared(models: Models, signals: Real, bodies: int) -> _Found:
    """Coefficients and what the fits leave of signals (N, M, G, 2), all by the same models."""
    count, instants, groups = signals.shape[:3]
    shape = 2, instants, groups
    # All signals at all instants are columns of one product.
    columns = signals.transpose(0, 3, 1, 2).reshape(count, -1)
    found, squares, products = [], [], []
    for scale, (matrix, members, starts) in zip(models.scales, models.shortcuts, strict=True):
        each, start = scale.each, scale.start
        sums = columns[start : start + matrix.shape[1] * each]
        if each > 1:
            sums = np.add.reduce(sums.reshape(-1, each, sums.shape[1]), 1)
        both = matrix @ sums
        found.append(both[:members])
        rest = both[members:].reshape(-1, *shape)
        if bodies:
            products.append(np.add.reduceat(_products(rest, bodies), starts, axis=0))
        squares.append(np.add.reduceat(np.square(rest, out=rest), starts, axis=0))
    coefficients = np.concatenate(found).reshape(-1, models.rows.shape[-1], *shape)
    squares = np.concatenate(squares)
    return coefficients, squares, np.concatenate(products) if bodies else squares[:, :0]


def _products(rest: Real, bodies: int) -> Real:
    """Products (..., 3, M, B) of angle and x, angle and y, x and y of poses (..., 2, M, 2 B)."""
    angle, position = rest[..., :1, :, :bodies], rest[..., bodies:]
    result = np.empty((*rest.shape[:-3], 3, rest.shape[-2], bodies))
    np.multiply(angle, position, out=result[..., :2, :, :])
    np.multiply(position[..., 0, :, :], position[..., 1, :, :], out=result[..., 2, :, :])
    return result


def _by_own(
    models: Models, signals: Real, weights: Real | None, bodies: int, sets: tuple[int, int]
) -> _Found:
    """
    The same of S sets of C signals, (S, 2, C, N), each set by models of its own.

    `sets` are the axes of the instants and of the signals in (S, l, 2, C, ...).
    """
    count = signals.shape[-1]
    rows = signals.reshape(len(signals), 1, -1, count)
    found, squares, products = [], [], []
    for each, start, root, basis, inside in models.scales:
        taken = slice(start, start + root.shape[1] * each)
        means = rows[..., taken]
        if each > 1:
            given = np.ones((1, means.shape[-1])) if weights is None else weights.T[:, taken]
            by_mean = given.reshape(len(given), 1, 1, -1, each)
            total = by_mean.sum(axis=-1)
            means = (by_mean * means.reshape(*means.shape[:3], -1, each)).sum(axis=-1)
            means /= np.where(total > 0, total, 1.0)
        means = means * root[:, None, None]
        of_window = means @ np.swapaxes(basis, -1, -2)  # (S, l, 2 C, D)
        rest = means * inside[:, None] - of_window @ basis
        split = len(signals), len(inside), 2, signals.shape[2], -1
        found.append(of_window.reshape(split).transpose(1, 4, 2, *sets))
        rest = rest.reshape(split).transpose(1, 2, *sets, 4)  # (l, 2, M, G, B)
        squares.append(np.einsum('...n,...n', rest, rest))
        if bodies:
            angle, x, y = rest[:, 0, :, :bodies], rest[:, 0, :, bodies:], rest[:, 1, :, bodies:]
            pairs = (angle, x), (angle, y), (x, y)
            products.append(np.stack([np.einsum('...n,...n', *pair) for pair in pairs], axis=1))
    coefficients, squares = np.concatenate(found), np.concatenate(squares)
    return coefficients, squares, np.concatenate(products) if bodies else squares[:, :0]


def evaluate(matrix: Real, members: Real) -> Real:
    """Rows (m, g, L, r, D) applied to what members have, (L, D, ..., M, G): (L, r, ..., M, G)."""
    if matrix.shape[:2] == (1, 1):
        flat = matrix[0, 0] @ members.reshape(*members.shape[:2], -1)
        return flat.reshape(*flat.shape[:2], *members.shape[2:])
    if matrix.shape[1] == 1:
        # As one product for each instant and window.
        apart = np.moveaxis(members, -2, 0)
        flat = matrix[:, 0] @ apart.reshape(*apart.shape[:3], -1)
        return np.moveaxis(flat.reshape(*flat.shape[:3], *apart.shape[3:]), 0, -2)
    return np.einsum('glrd,ld...g->lr...g', matrix[0], members)
