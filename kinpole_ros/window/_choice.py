"""
How long a window and how high a degree: chosen at every instant, from the data of late.

A short window of high degree follows any motion and carries much noise; a long one of low degree
the reverse, and which is best differs between motions and orders of derivative by orders of
magnitude. All windows of a geometric ladder are projected on polynomials that are orthonormal on
their samples, so that each coefficient c_j is signal plus noise of one known variance s^2. What
the squares of a coefficient average to over the last instants, less s^2, is the energy E_j of the
signal in it. From there on everything is Wiener's: the coefficient is weighted E / (E + s^2), its
mean square error is E s^2 / (E + s^2), and that of a derivative follows from the rows that evaluate
it. Each order of derivative is a mean over the windows, weighted by their inverse errors, so what
is found for one order never depends on which others are asked for. What the windows disagree about
is error too: energies are of late, but where a motion sets in only now the windows part at once.

Averages look back, so what happens only now has its own say: a coefficient that stands out of the
noise by itself counts, and a window whose richest fit leaves more than noise is charged for it.
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
# The averages of a window go back this many times its own length: a short one learns quickly.
_MEMORY = 3.0
# A mean energy counts from so many of its standard deviations, a single one from so many s^2.
_LASTING = 3.0
_SUDDEN = 11.0
# Energy that may hide in each of the next two coefficients, in standard deviations of its mean.
_HIDDEN = 0.5
# A fit leaves more than noise when it leaves this many times s^2, and so many standard deviations
# more (lasting, sudden); the last is how much worse that is than as much energy in the last
# coefficient. The first allows for noise that is not quite what its measure says.
_LEFT, _LEFT_LASTING, _LEFT_SUDDEN, _LEFT_WEIGHT = 2.0, 2.0, 4.0, 30.0
# The series goes on beyond its last coefficients with this share of their energy.
_BEYOND = 0.03
# Windows are mixed by this power of their inverse errors, which are taken over the greatest and
# less this much, so that a window of far larger error brings in nothing.
_SHARPNESS, _OUT = 2, 0.15
# The errors of a mean of windows add up by this power of their shares: 1/2 were they all the same,
# 1 were they independent.
_KINSHIP = 0.75
# Degrees of freedom from which what a fit leaves is a measure of the noise.
_ENOUGH_FREEDOM = 16


class Derivatives(NamedTuple):
    """
    Derivatives of signals at M instants, of order 0 to K - 1.

    `values` (K, M, G, 2); `covariance` (K, K, M, G) between orders, of one component; both NaN
    where the samples are too few. `span` (M, G) is the time in s that the windows for order 1
    cover and `degree` (M, G) that of the last coefficient in use, both as weighted means over the
    windows.
    """

    values: Real
    covariance: Real
    span: Real
    degree: Real


class Spectrum:
    """What the signals of late were made of: mean energies by window, coefficient and signal."""

    def __init__(self) -> None:
        self._mean = np.zeros((0, 0, 0))
        self._count = np.zeros((0, 0))

    def follow(self, squares: Real, known: np.ndarray, memory: Real) -> tuple[Real, Real]:
        """
        Take the squares of some instants one after the other; return their means as of each.

        `squares` (L, D, M, G), `known` (L, M, G) where they mean anything; `memory` (L, G) or
        (L, 1) is the number of instants that an average goes back. Also returned (L, M, G): how
        many instants are in the means.
        """
        levels, degrees, instants, groups = squares.shape
        if self._mean.shape[1:] != (degrees, groups):
            self._mean = np.zeros((0, degrees, groups))
            self._count = np.zeros((0, groups))
        new = levels - len(self._count)
        if new > 0:
            self._mean = np.concatenate((self._mean, np.zeros((new, degrees, groups))))
            self._count = np.concatenate((self._count, np.zeros((new, groups))))
        count = self._count[:levels, None] + np.cumsum(known, axis=1)
        self._count[:levels] = count[:, -1]
        among = np.clip(count, 1.0, memory[:, None])
        gain = (known / among)[:, None]
        means = np.empty_like(squares)
        mean = self._mean[:levels]
        # Each mean goes on from the one before: the one thing here that is not done all at once.
        for m in range(instants):
            mean += gain[:, :, m] * (squares[:, :, m] - mean)
            means[:, :, m] = mean
        return means, among


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


class _Models(NamedTuple):
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


def differentiate(
    times: np.ndarray,
    signals: Real,
    weights: Real | None,
    noise: Real,
    dimensions: np.ndarray,
    order: int,
    spectrum: Spectrum | None = None,
) -> Derivatives:
    """
    Derivatives of order 0 to `order` of G signals at M instants.

    `times` (N,) are whole ns from the instant, rising, with 0 among them, alike for all instants;
    `signals` (N, M, G, 2) are vectors of the plane, or numbers in their first component, as the
    samples about each instant have them; `dimensions` (G,) says which, 2 or 1. `weights` (N, G),
    for one instant at a time, are the inverse variances of the samples relative to `noise` (G,) or
    (M, G), the standard deviation of one component of a sample of weight 1; 0 is a sample that is
    missing, None means all are 1, or that a signal is NaN throughout. A signal that is missing or
    NaN at time 0 comes out NaN. `spectrum` remembers the instants before; without it only these
    judge, one after the other.
    """
    now = int(np.searchsorted(times, 0))
    count, instants, groups = signals.shape[:3]
    missing = np.isnan(signals[now, ..., 0])  # (M, G)
    if weights is not None:
        missing |= ~(weights[now] > 0)
    base = np.where(missing[..., None], 0.0, signals[now])
    orders = order + 1
    if weights is None:
        models = _shared_models(times.tobytes(), now, orders)
        centered = (
            np.where(missing[..., None], 0.0, signals - base) if missing.any() else signals - base
        )
        # All signals at all instants are columns of one product.
        centered = centered.transpose(0, 3, 1, 2).reshape(1, count, 2 * instants * groups)
    else:
        models = _models(times, now, weights.T, orders)
        # What is missing may hold anything.
        centered = np.where(weights[:, None, :, None] > 0, signals - base, 0.0)
        centered = centered.transpose(2, 0, 3, 1).reshape(groups, count, 2 * instants)
    coefficients, squares = _project(models, centered, weights, instants, groups)

    energy = (coefficients**2).sum(axis=2) / dimensions  # (L, D, M, G)
    freedom = models.freedom
    left = squares.sum(axis=1) / (dimensions * np.maximum(freedom, 1))  # (L, M, G)
    known = np.broadcast_to((models.lengths > 0) & ~missing, left.shape)
    memory = Spectrum() if spectrum is None else spectrum
    lengths = np.maximum(models.lengths, 1)
    mean, among = memory.follow(
        np.concatenate((energy, left[:, None]), axis=1), known, _MEMORY * lengths[:, 0]
    )
    mean, mean_left = mean[:, :-1], mean[:, -1]
    # Neighboring windows share samples; the number of squares that are new to each other:
    apart = np.maximum(among / lengths, 1.0) * dimensions
    variance = _variance(mean_left, freedom * apart, noise)

    scatter = variance * np.sqrt(2 / apart)[:, None]
    sudden = energy > variance * (1 + _SUDDEN / np.sqrt(dimensions))
    lasting = mean - variance > _LASTING * scatter
    signal = np.maximum(mean - variance, np.where(sudden, energy - variance, 0.0))
    signal = np.maximum(signal, 0.0)
    degrees = np.arange(energy.shape[1])[:, None, None]
    last = np.where(sudden | lasting, degrees, -1).max(axis=1)[:, None]
    used = degrees <= last
    share = np.where(used, signal / (signal + variance), 0.0)
    hidden = (degrees > last) & (degrees <= last + 2) & (degrees <= models.highest[:, None])
    error = share * variance + np.where(hidden, _HIDDEN * scatter, 0.0)

    values = _evaluate(models.rows, share[:, :, None] * coefficients)  # (L, K, 2, M, G)
    errors = _evaluate(models.products, error).reshape(-1, orders, orders, instants, groups)
    # What a window cannot follow adds to its error: what it leaves, and the rest of its series.
    odds = np.sqrt(2 / np.maximum(freedom * apart, 1))
    lost = np.maximum(mean_left - variance * (_LEFT + _LEFT_LASTING * odds), 0.0)
    odds = np.sqrt(2 / np.maximum(freedom * dimensions, 1))
    lost = np.maximum(lost, left - variance * (_LEFT + _LEFT_SUDDEN * odds)) * (freedom > 0)
    top = np.where(used & (degrees >= models.highest[:, None] - 1), signal, 0.0).max(axis=1)
    charge = _LEFT_WEIGHT * lost * freedom + _BEYOND * top
    # An order above all coefficients in use still has its own first one to fear.
    index = np.arange(orders)
    above = index[:, None, None] > last + 2
    extra = models.rim * charge[:, None] + models.own * np.where(above, _HIDDEN * scatter, 0.0)
    errors[:, index, index] += extra

    risk = errors[:, index, index]  # (L, K, M, G)
    usable = models.highest[:, None] >= index[:, None, None]
    usable = usable & np.isfinite(risk) & ~missing
    risk = np.where(usable, np.maximum(risk, np.finfo(float).tiny), np.inf)
    least = risk.min(axis=0)
    unknown = ~np.isfinite(least)
    mix = np.maximum(np.where(unknown, 1.0, least) / risk - _OUT, 0.0) ** _SHARPNESS
    mix /= np.where(unknown, 1.0, mix.sum(axis=0))  # (L, K, M, G)
    result = (mix[:, :, None] * values).sum(axis=0)
    part = mix**_KINSHIP
    covariance = (part[:, :, None] * part[:, None] * errors).sum(axis=0)
    disagreement = np.sqrt(mix / dimensions)[:, :, None] * (values - result)
    covariance += np.einsum('lkcmg,ljcmg->kjmg', disagreement, disagreement)
    result = result.transpose(0, 2, 3, 1)
    result[0] += base
    result[unknown] = np.nan
    covariance[unknown[:, None] | unknown[None]] = np.nan
    first = mix[:, min(1, order)]
    span = (first * models.spans).sum(axis=0)
    return Derivatives(result, covariance, span, (first * last[:, 0]).sum(axis=0))


def _variance(mean_left: Real, freedom: Real, noise: Real) -> Real:
    """Variance (M, G) of the noise to judge by: not less than what the best rich fit leaves."""
    measured = np.where(freedom >= _ENOUGH_FREEDOM, mean_left, np.inf).min(axis=0)
    return np.where(np.isfinite(measured), np.maximum(noise**2, measured), noise**2)


def _project(
    models: _Models, centered: Real, weights: Real | None, instants: int, groups: int
) -> tuple[Real, Real]:
    """Coefficients (L, D, 2, M, G) of all windows, and the squares (L, 2, M, G) they leave."""
    found, left = [], []
    for k, scale in enumerate(models.scales):
        means = _means(centered, scale, weights) * scale.root[..., None]
        if models.shortcuts:
            shortcut = models.shortcuts[k]
            both = shortcut.matrix @ means
            coefficients = len(scale.inside) * scale.basis.shape[-1]
            found.append(both[:, :coefficients])
            rest = both[:, coefficients:]
            left.append(np.add.reduceat(np.square(rest, out=rest), shortcut.starts, axis=1))
        else:
            of_window = np.swapaxes(scale.basis, -1, -2) @ means[:, None]
            rest = (means[:, None] - scale.basis @ of_window) * scale.inside[..., None]
            found.append(of_window.reshape(len(means), -1, means.shape[-1]))
            left.append(np.einsum('glbc,glbc->glc', rest, rest))
    members = models.rows.shape[-1]
    columns = 2, instants, groups // len(centered)
    coefficients = np.concatenate(found, axis=1).reshape(len(centered), -1, members, *columns)
    squares = np.concatenate(left, axis=1).reshape(len(centered), -1, *columns)
    if len(centered) == 1:
        return coefficients[0], squares[0]
    return np.moveaxis(coefficients[..., 0], 0, -1), np.moveaxis(squares[..., 0], 0, -1)


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


def _evaluate(matrix: Real, members: Real) -> Real:
    """Rows (groups, L, r, D) applied to what each member has, (L, D, ..., G): (L, r, ..., G)."""
    if len(matrix) == 1:
        flat = matrix[0] @ members.reshape(*members.shape[:2], -1)
        return flat.reshape(*flat.shape[:2], *members.shape[2:])
    return np.einsum('glrd,ld...g->lr...g', matrix, members)


def _shared_models(times: bytes, now: int, orders: int) -> _Models:
    """The models of equally weighted samples: even sampling asks for the same ones every frame."""
    kept = _kept_models(times, now, orders)
    if len(kept) == 1:
        # Uneven stamps never come again.
        kept.append(kept[0])
    elif not kept[1].shortcuts:
        kept[1] = kept[0]._replace(shortcuts=tuple(map(_shortcut, kept[0].scales)))
    return kept[1]


@lru_cache(maxsize=16)
def _kept_models(times: bytes, now: int, orders: int) -> list[_Models]:
    instants = np.frombuffer(times, np.int64)
    return [_models(instants, now, np.ones((1, len(instants))), orders)]


def _shortcut(scale: _Scale) -> _Shortcut:
    """One product instead of two for each window (of 61 samples, 10 us instead of 17)."""
    basis = scale.basis[0]
    left = np.eye(basis.shape[1]) - basis @ np.swapaxes(basis, -1, -2)
    project = np.swapaxes(basis, -1, -2).reshape(-1, basis.shape[1])
    rows = scale.inside.sum(axis=-1)
    # What lies outside of a window is none of what its fit leaves.
    rest = np.where(scale.inside[:, None], left, 0.0)[scale.inside]
    return _Shortcut(np.concatenate((project, rest)), np.cumsum(rows) - rows)


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


def _models(times: np.ndarray, now: int, weights: Real, orders: int) -> _Models:
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

    return _Models(
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
