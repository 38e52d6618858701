"""
All windows about an instant, projected on polynomials.

Windows of a geometric ladder of lengths, each reaching as far ahead as it does back where it can.
Their polynomials are orthonormal on the samples, so that every coefficient has the noise of one
sample and knows nothing of the others. Which of them are to be believed is not asked here.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real
from kinpole_ros.window._polynomial import orthonormal_basis

HIGHEST_ORDER = 4
FEWEST_SAMPLES = 7
_HIGHEST_DEGREE = 12
_LADDER = 1.33
# Windows of more samples are made of means: a polynomial of this degree is as well known by them.
_FINEST = 128
# ns. Steps of even sampling differ by no more, for stamps are whole ns.
_UNEVEN = 1


class _Scale(NamedTuple):
    """
    Windows of one scale, made of means of `each` samples together, for long ones need no more.

    The B means start at the sample `start`; `root` (groups, B) are the square roots of their
    weights; `basis` (groups, l, B, D) are the members of the l windows, orthonormal on the weighted
    means, and zero for means that are not `inside` (l, B).
    """

    each: int
    start: int
    root: Real
    basis: Real
    inside: np.ndarray


class _Shortcut(NamedTuple):
    """
    A scale whose models are shared and used again and again, as one matrix.

    `matrix` (l D + R, B) gives the coefficients of the l windows, and below what the fits leave of
    each mean inside, window after window from the rows `starts` (l,) on.
    """

    matrix: Real
    starts: np.ndarray


class Models(NamedTuple):
    """All fits of one set of instants: `groups` is 1 where every signal shares them, else G."""

    scales: tuple[_Scale, ...]
    shortcuts: tuple[_Shortcut, ...]  # of the scales, where they pay
    rows: Real  # (groups, L, K, D), derivatives of order 0 to K - 1 of the members at time 0
    products: Real  # (groups, L, K * K, D), of the rows of any two orders
    rim: Real  # (L, K, 1, groups), the larger square of the last two members in each row
    own: Real  # (L, K, 1, groups), the square of the first member that each row knows
    lengths: np.ndarray  # (L, 1, groups) samples with weight in each window
    freedom: np.ndarray  # (L, 1, groups) means beyond the members of the richest fit
    highest: np.ndarray  # (L, 1, groups) degree of the richest fit
    spans: Real  # (L, 1, 1) s

    def of(self, place: np.ndarray) -> 'Models':
        """The models of the signals at `place`, to evaluate and to judge by, not to project on."""
        return Models(
            (),
            (),
            self.rows[place],
            self.products[place],
            self.rim[..., place],
            self.own[..., place],
            self.lengths[..., place],
            self.freedom[..., place],
            self.highest[..., place],
            self.spans,
        )


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

    `times` (N,) are whole ns from the instant, rising, with 0 among them, alike for all instants;
    `signals` (N, M, G, 2) are vectors of the plane, or numbers in their first component, as the
    samples about each instant have them. `weights` (N, G), for one instant at a time, are the
    inverse variances of the samples relative to the noise; 0 is a sample that is missing, None
    means all are 1, or that a signal is NaN throughout. Derivatives are wanted up to `order`. If
    `bodies` are given, the signals are their angles, then their positions.
    """
    now = int(np.searchsorted(times, 0))
    count, instants, groups = signals.shape[:3]
    missing = np.isnan(signals[now, ..., 0])  # (M, G)
    if weights is not None:
        missing |= ~(weights[now] > 0)
    base = np.where(missing[..., None], 0.0, signals[now])
    if weights is None:
        models = _shared_models(times.tobytes(), now, order + 1)
        centered = (
            np.where(missing[..., None], 0.0, signals - base) if missing.any() else signals - base
        )
        # All signals at all instants are columns of one product.
        columns = centered.transpose(0, 3, 1, 2).reshape(count, 2 * instants * groups)
        found = _by_shared(models, columns, (2, instants, groups), bodies)
    else:
        models = _models(times, now, weights.T, order + 1)
        # What is missing may hold anything.
        centered = np.where(weights[:, None, :, None] > 0, signals - base, 0.0)
        columns = centered.transpose(2, 0, 3, 1).reshape(groups, count, 2)
        found = _by_own(models, columns, weights, bodies)
    return Projection(models, *found, base, missing)


def _by_shared(
    models: Models, columns: Real, shape: tuple[int, int, int], bodies: int
) -> tuple[Real, Real, Real]:
    """Coefficients and what the fits leave of signals (N, C), columns of `shape` (2, M, G)."""
    found, squares, products = [], [], []
    for k, scale in enumerate(models.scales):
        means = _means(columns[None], scale, None)[0] * scale.root[0, :, None]
        if models.shortcuts:
            matrix, starts = models.shortcuts[k]
            both = matrix @ means
            members = len(scale.inside) * scale.basis.shape[-1]
            of_window, rest = both[:members], both[members:]
        else:
            basis = scale.basis[0]
            of_window = np.swapaxes(basis, -1, -2) @ means
            rest = (means - basis @ of_window)[scale.inside]
            starts = _starts(scale)
        found.append(of_window.reshape(-1, means.shape[-1]))
        rest = rest.reshape(-1, *shape)
        if bodies:
            products.append(np.add.reduceat(_products(rest, bodies), starts, axis=0))
        squares.append(np.add.reduceat(np.square(rest, out=rest), starts, axis=0))
    coefficients = np.concatenate(found).reshape(-1, models.rows.shape[-1], *shape)
    squares = np.concatenate(squares)
    return coefficients, squares, np.concatenate(products) if bodies else squares[:, :0]


def _by_own(models: Models, columns: Real, weights: Real, bodies: int) -> tuple[Real, Real, Real]:
    """The same for G signals (G, N, 2) at one instant, each with models of its own."""
    found, squares, products = [], [], []
    for scale in models.scales:
        means = (_means(columns, scale, weights) * scale.root[..., None])[:, None]
        of_window = np.swapaxes(scale.basis, -1, -2) @ means
        rest = (means - scale.basis @ of_window) * scale.inside[..., None]
        found.append(np.moveaxis(of_window, 0, -1))  # (l, D, 2, G)
        rest = np.moveaxis(rest, 0, -1)[..., None, :]  # (l, B, 2, 1, G)
        squares.append(np.square(rest).sum(axis=1))
        if bodies:
            products.append(_products(rest, bodies).sum(axis=1))
    coefficients, squares = np.concatenate(found)[..., None, :], np.concatenate(squares)
    return coefficients, squares, np.concatenate(products) if bodies else squares[:, :0]


def _products(rest: Real, bodies: int) -> Real:
    """Products (..., 3, M, B) of angle and x, angle and y, x and y of poses (..., 2, M, 2 B)."""
    angle, position = rest[..., :1, :, :bodies], rest[..., bodies:]
    result = np.empty((*rest.shape[:-3], 3, rest.shape[-2], bodies))
    np.multiply(angle, position, out=result[..., :2, :, :])
    np.multiply(position[..., 0, :, :], position[..., 1, :, :], out=result[..., 2, :, :])
    return result


def _means(rows: Real, scale: _Scale, weights: Real | None) -> Real:
    """The means (groups, B, ...) of rows (groups, N, ...) that a scale is made of."""
    blocks = scale.root.shape[1]
    taken = rows[:, scale.start : scale.start + blocks * scale.each]
    if scale.each == 1:
        return taken
    taken = taken.reshape(len(rows), blocks, scale.each, -1)
    if weights is None:
        return np.asarray(taken.mean(axis=2))
    given = weights.T[:, scale.start : scale.start + blocks * scale.each]
    given = given.reshape(len(rows), blocks, scale.each, 1)
    total = given.sum(axis=2)
    return np.asarray((given * taken).sum(axis=2) / np.where(total > 0, total, 1.0))


def evaluate(matrix: Real, members: Real) -> Real:
    """Rows (groups, L, r, D) applied to what each member has, (L, D, ..., G): (L, r, ..., G)."""
    if len(matrix) == 1:
        flat = matrix[0] @ members.reshape(*members.shape[:2], -1)
        return flat.reshape(*flat.shape[:2], *members.shape[2:])
    return np.einsum('glrd,ld...g->lr...g', matrix, members)


@lru_cache(maxsize=16)
def _shared_models(times: bytes, now: int, orders: int) -> Models:
    """The models of equally weighted samples: even sampling asks for the same ones every frame."""
    instants = np.frombuffer(times, np.int64)
    models = _models(instants, now, np.ones((1, len(instants))), orders)
    steps = np.diff(instants)
    if len(steps) and np.ptp(steps) > _UNEVEN:
        # They never come again. By the stamps alone: no figure may hang on what was asked before.
        return models
    return models._replace(shortcuts=tuple(map(_shortcut, models.scales)))


def _shortcut(scale: _Scale) -> _Shortcut:
    """One product instead of two for each window (of 61 samples, 10 us instead of 17)."""
    basis = scale.basis[0]
    left = np.eye(basis.shape[1]) - basis @ np.swapaxes(basis, -1, -2)
    project = np.swapaxes(basis, -1, -2).reshape(-1, basis.shape[1])
    # What lies outside of a window is none of what its fit leaves.
    rest = np.where(scale.inside[:, None], left, 0.0)[scale.inside]
    return _Shortcut(np.concatenate((project, rest)), _starts(scale))


def _starts(scale: _Scale) -> np.ndarray:
    """Where (l,) each window begins if the means inside of all follow each other."""
    rows = scale.inside.sum(axis=-1)
    return np.asarray(np.cumsum(rows) - rows)


def _ladder(count: int) -> list[tuple[int, int]]:
    """Windows up to `count` samples: of how many means of how many samples each they are made."""
    windows = [(min(FEWEST_SAMPLES, count), 1)]
    while True:
        means, each = windows[-1]
        longer = max(int(means * each * _LADDER), means * each + 2)
        while longer > _FINEST * each:
            each *= 3
        # Odd numbers are symmetric about the instant.
        means = longer // 2 * 2 + 1 if each == 1 else (longer // each - 1) // 2 * 2 + 1
        if means * each > count:
            return windows
        windows.append((means, each))


def _models(times: np.ndarray, now: int, weights: Real, orders: int) -> Models:
    """Fit bases for every window of the ladder: each reaches as far ahead as it does back."""
    windows = _ladder(len(times))
    parts = []
    for each in sorted({each for _, each in windows}):
        means = np.array([means for means, each_ in windows if each_ == each])
        parts.append(_scale(times, now, weights, orders, means, each))
    scales, rows, highest, lengths, counts, spans = zip(*parts, strict=True)
    rows, highest = np.concatenate(rows, axis=1), np.concatenate(highest, axis=1)
    lengths, counts = np.concatenate(lengths, axis=1), np.concatenate(counts, axis=1)
    member = np.arange(rows.shape[-1])
    near_rim = (member <= highest[..., None]) & (member >= highest[..., None] - 1)
    squares = rows**2
    rim = np.where(near_rim[:, :, None], squares, 0.0).max(axis=-1)
    index = np.arange(orders)
    products = rows[:, :, :, None] * rows[:, :, None]

    def last(array: np.ndarray) -> np.ndarray:
        """The groups (groups, L, ...) as the last axis, instants before them."""
        return np.moveaxis(array, 0, -1)[..., None, :]

    return Models(
        tuple(scales),
        (),
        rows,
        products.reshape(*rows.shape[:2], -1, rows.shape[-1]),
        last(rim),
        last(squares[:, :, index, index]),
        last(lengths),
        last(counts - highest - 1),
        last(highest),
        np.concatenate(spans)[:, None, None],
    )


def _scale(
    times: np.ndarray, now: int, weights: Real, orders: int, sizes: np.ndarray, each: int
) -> tuple[_Scale, Real, np.ndarray, np.ndarray, np.ndarray, Real]:
    """
    The windows of one scale, of `sizes` (l,) means.

    Also their rows (groups, l, K, D), and by (groups, l) the degrees of their richest fits and how
    many samples and means have weight in them, and their spans (l,).
    """
    blocks = len(times) // each
    # The newest samples count most.
    start = len(times) - blocks * each
    here = (now - start) // each
    ahead = np.maximum(np.minimum(blocks - 1 - here, (sizes - 1) // 2), sizes - 1 - here)
    first, last = here + ahead - sizes + 1, here + ahead
    lowest, blocks = first.min(), last.max() - first.min() + 1
    start, first, last = start + lowest * each, first - lowest, last - lowest
    index = np.arange(blocks)
    inside = (index >= first[:, None]) & (index <= last[:, None])
    taken = slice(start, start + blocks * each)
    times = times[taken]
    given = weights[:, None, taken] * np.repeat(inside, each, axis=-1)
    seconds = np.broadcast_to(times * 1e-9, given.shape)
    degree = min(_HIGHEST_DEGREE, blocks - 1)
    basis, rows = orthonormal_basis(seconds, np.sqrt(given), degree, orders - 1, each)
    # A basis has the same members whatever the window holds; those it cannot carry are zero.
    more = [(0, 0), (0, 0), (0, 0), (0, _HIGHEST_DEGREE - degree)]
    basis, rows = np.pad(basis, more), np.pad(rows, more)
    by_mean = given.reshape(*given.shape[:2], blocks, each)
    counts = (by_mean > 0).any(axis=-1).sum(axis=-1)
    highest = np.maximum(counts - 3, np.minimum(counts - 1, HIGHEST_ORDER))
    highest = np.minimum(highest, degree)
    member = np.arange(basis.shape[-1]) <= highest[..., None]
    scale = _Scale(
        each,
        start,
        np.sqrt(weights[:, taken].reshape(len(weights), blocks, each).sum(axis=-1)),
        basis * member[..., None, :],
        inside,
    )
    spans = (times[(last + 1) * each - 1] - times[first * each]) * 1e-9
    lengths = (given > 0).sum(axis=-1)
    return scale, rows * member[..., None, :], highest, lengths, counts, spans
