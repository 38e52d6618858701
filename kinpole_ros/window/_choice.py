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
    Derivatives of signals at one instant, of order 0 to K - 1.

    `values` (K, G, 2); `covariance` (K, K, G) between orders, of one component; both NaN where the
    samples are too few. `span` (G,) is the time in s that the windows for order 1 cover and
    `degree` (G,) that of the last coefficient in use, both as weighted means over the windows.
    """

    values: Real
    covariance: Real
    span: Real
    degree: Real


class Spectrum:
    """What the signals of late were made of: mean energies by window, coefficient and signal."""

    def __init__(self) -> None:
        self._energy = np.zeros((0, 0, 0))
        self._left = np.zeros((0, 0))
        self._count = np.zeros((0, 0))

    def follow(
        self, energy: Real, left: Real, known: np.ndarray, memory: Real
    ) -> tuple[Real, Real, Real]:
        """
        Take the squares of one instant, return their means and how many are in them.

        `energy` (L, D, G), `left` (L, G) per degree of freedom, `known` (L, G) where they mean
        anything; `memory` (L, G) or (L, 1) is the number of instants that an average goes back.
        """
        levels, degrees, groups = energy.shape
        if self._energy.shape[1:] != (degrees, groups):
            self._energy = np.zeros((0, degrees, groups))
            self._left = np.zeros((0, groups))
            self._count = np.zeros((0, groups))
        new = levels - len(self._count)
        if new > 0:
            self._energy = np.concatenate((self._energy, np.zeros((new, degrees, groups))))
            self._left = np.concatenate((self._left, np.zeros((new, groups))))
            self._count = np.concatenate((self._count, np.zeros((new, groups))))
        count = self._count[:levels]
        count += known
        gain = known / np.clip(count, 1.0, memory)
        energy, left = np.where(known[:, None], energy, 0.0), np.where(known, left, 0.0)
        self._energy[:levels] += gain[:, None] * (energy - self._energy[:levels])
        self._left[:levels] += gain * (left - self._left[:levels])
        return self._energy[:levels], self._left[:levels], np.clip(count, 1.0, memory)


class _Models(NamedTuple):
    """All fits of one set of instants: `groups` is 1 where every signal shares them, else G."""

    basis: Real  # (groups, L, N, D), members orthonormal on the weighted samples
    rows: Real  # (groups, L, K, D), their derivatives of order 0 to HIGHEST_ORDER at time 0
    products: Real  # (groups, L, K * K, D), of the rows of any two orders
    rim: Real  # (groups, L, K), the larger square of the last two members in each row
    counts: np.ndarray  # (L, groups) samples with weight in each window
    highest: np.ndarray  # (L, groups) degree of the richest fit
    spans: Real  # (L,) s


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
    Derivatives of order 0 to `order` of G signals at time 0.

    `times` (N,) are whole ns from that instant, rising, with 0 among them; `signals` (N, G, 2) are
    vectors of the plane, or numbers in their first component; `dimensions` (G,) says which, 2 or 1.
    `weights` (N, G) are the inverse variances of the samples relative to `noise` (G,), the
    standard deviation of one component of a sample of weight 1; 0 is a sample that is missing,
    None means all are 1. A signal that is missing at time 0 comes out NaN. `spectrum` remembers the
    instants before; without it only this one judges.
    """
    now = int(np.searchsorted(times, 0))
    count, groups = signals.shape[:2]
    missing = np.zeros(groups, bool) if weights is None else ~(weights[now] > 0)
    base = np.where(missing[:, None], 0.0, signals[now])
    if weights is None:
        models = _shared_models(times.tobytes(), now)
        # All signals are columns of one product.
        scaled = (signals - base).reshape(1, 1, count, groups * 2)
    else:
        root = np.sqrt(weights)
        models = _models(times, now, np.ascontiguousarray(root.T))
        centered = np.where(root[..., None] > 0, signals - base, 0.0) * root[..., None]
        scaled = np.moveaxis(centered, 1, 0)[:, None]
    found = np.swapaxes(models.basis, -1, -2) @ scaled
    inside = (models.basis[..., 0] != 0)[..., None]
    left = np.where(inside, scaled - models.basis @ found, 0.0)
    squares = _by_group(np.einsum('gln...,gln...->gl...', left, left)[:, :, None], groups)[:, 0]
    coefficients = _by_group(found, groups)  # (L, D, G, 2)

    energy = (coefficients**2).sum(axis=-1) / dimensions
    freedom = models.counts - models.highest - 1
    left = squares.sum(axis=-1) / (dimensions * np.maximum(freedom, 1))
    known = (models.counts > 0) & ~missing
    memory = Spectrum() if spectrum is None else spectrum
    reach = _MEMORY * np.maximum(models.counts, 1)
    mean, mean_left, instants = memory.follow(energy, left, known, reach)
    # Neighboring windows share samples; the number of squares that are new to each other:
    apart = np.maximum(instants / np.maximum(models.counts, 1), 1.0) * dimensions
    variance = _variance(mean_left, freedom * apart, noise)

    scatter = variance * np.sqrt(2 / apart)[:, None]
    sudden = energy > variance * (1 + _SUDDEN / np.sqrt(dimensions))
    lasting = mean - variance > _LASTING * scatter
    signal = np.maximum(mean - variance, np.where(sudden, energy - variance, 0.0))
    signal = np.maximum(signal, 0.0)
    degrees = np.arange(energy.shape[1])[:, None]
    last = np.where(sudden | lasting, degrees, -1).max(axis=1)[:, None]
    used = degrees <= last
    share = np.where(used, signal / (signal + variance), 0.0)
    hidden = (degrees > last) & (degrees <= last + 2) & (degrees <= models.highest[:, None])
    error = share * variance + np.where(hidden, _HIDDEN * scatter, 0.0)

    orders = order + 1
    values = _evaluate(models.rows[:, :, :orders], share[..., None] * coefficients)
    errors = _evaluate(models.products, error).reshape(-1, 5, 5, groups)[:, :orders, :orders]
    # What a window cannot follow adds to its error: what it leaves, and the rest of its series.
    odds = np.sqrt(2 / np.maximum(freedom * apart, 1))
    lost = np.maximum(mean_left - variance * (_LEFT + _LEFT_LASTING * odds), 0.0)
    odds = np.sqrt(2 / np.maximum(freedom * dimensions, 1))
    lost = np.maximum(lost, left - variance * (_LEFT + _LEFT_SUDDEN * odds)) * (freedom > 0)
    top = np.where(used & (degrees >= models.highest[:, None] - 1), signal, 0.0).max(axis=1)
    charge = _LEFT_WEIGHT * lost * freedom + _BEYOND * top
    rim = np.moveaxis(models.rim[:, :, :orders], 0, -1)  # (L, K, groups)
    extra = rim * charge[:, None]
    # An order above all coefficients in use still has its own first one to fear.
    index = np.arange(orders)
    own = np.moveaxis(models.rows[:, :, index, index], 0, -1) ** 2  # (L, K, groups)
    extra = extra + own * np.where(index[:, None] > last + 2, _HIDDEN * scatter, 0.0)
    errors[:, index, index] += extra

    risk = errors[:, index, index]  # (L, K, G)
    usable = models.highest[:, None] >= index[:, None]
    usable = usable & np.isfinite(risk) & ~missing
    risk = np.where(usable, np.maximum(risk, np.finfo(float).tiny), np.inf)
    least = risk.min(axis=0)
    unknown = ~np.isfinite(least)
    mix = np.maximum(np.where(unknown, 1.0, least) / risk - _OUT, 0.0) ** _SHARPNESS
    mix /= np.where(unknown, 1.0, mix.sum(axis=0))  # (L, K, G)
    result = (mix[..., None] * values).sum(axis=0)
    part = mix**_KINSHIP
    covariance = (part[:, :, None] * part[:, None] * errors).sum(axis=0)
    disagreement = np.sqrt(mix / dimensions)[..., None] * (values - result)
    covariance += np.einsum('lkgc,lmgc->kmg', disagreement, disagreement)
    result[0] += base
    result[unknown] = np.nan
    covariance[unknown[:, None] | unknown[None]] = np.nan
    first = mix[:, min(1, order)]
    span = (first * models.spans[:, None]).sum(axis=0)
    return Derivatives(result, covariance, span, (first * last[:, 0]).sum(axis=0))


def _variance(mean_left: Real, freedom: Real, noise: Real) -> Real:
    """Variance (G,) of the noise to judge by: not less than what the best rich fit leaves."""
    measured = np.where(freedom >= _ENOUGH_FREEDOM, mean_left, np.inf).min(axis=0)
    return np.where(np.isfinite(measured), np.maximum(noise**2, measured), noise**2)


def _by_group(array: Real, groups: int) -> Real:
    """(1, L, d, 2 G) or (G, L, d, 2) to (L, d, G, 2)."""
    if array.shape[0] == 1 and array.shape[-1] == 2 * groups:
        return array[0].reshape(*array.shape[1:3], groups, 2)
    return np.moveaxis(array, 0, 2)


def _evaluate(matrix: Real, members: Real) -> Real:
    """Rows (groups, L, r, D) applied to what each member has, (L, D, G, ...): (L, r, G, ...)."""
    if len(matrix) == 1:
        flat = matrix[0] @ members.reshape(*members.shape[:2], -1)
        return flat.reshape(*flat.shape[:2], *members.shape[2:])
    return np.einsum('glrd,ldg...->lrg...', matrix, members)


@lru_cache(maxsize=16)
def _shared_models(times: bytes, now: int) -> _Models:
    """The models of equally weighted samples: even sampling asks for the same ones every frame."""
    instants = np.frombuffer(times, np.int64)
    return _models(instants, now, np.ones((1, len(instants))))


def _models(times: np.ndarray, now: int, root: Real) -> _Models:
    """Fit bases for every window of the ladder: each reaches as far ahead as it does back."""
    count = len(times)
    lengths = [min(FEWEST_SAMPLES, count)]
    while (longer := int(lengths[-1] * _LADDER) // 2 * 2 + 1) <= count:
        # Odd lengths are symmetric about the instant.
        lengths.append(max(longer, lengths[-1] + 2))
    sizes = np.minimum(lengths, count)
    ahead = np.maximum(np.minimum(count - 1 - now, (sizes - 1) // 2), sizes - 1 - now)
    first, last = now + ahead - sizes + 1, now + ahead
    index = np.arange(count)
    inside = (index >= first[:, None]) & (index <= last[:, None])
    weights = root[:, None] * inside
    seconds = np.broadcast_to(times * 1e-9, weights.shape)
    degree = min(_HIGHEST_DEGREE, count - 1)
    basis, rows = orthonormal_basis(seconds, weights, degree, HIGHEST_ORDER)
    # A basis has the same members whatever the window holds; those it cannot carry are zero.
    more = [(0, 0), (0, 0), (0, 0), (0, _HIGHEST_DEGREE - degree)]
    basis, rows = np.pad(basis, more), np.pad(rows, more)
    counts = (weights > 0).sum(axis=-1)
    highest = np.maximum(counts - 3, np.minimum(counts - 1, HIGHEST_ORDER))
    highest = np.minimum(highest, degree)
    member = np.arange(basis.shape[-1]) <= highest[..., None]
    basis = basis * member[..., None, :]
    rows = rows * member[..., None, :]
    products = rows[:, :, :, None] * rows[:, :, None]
    near_rim = member & (np.arange(basis.shape[-1]) >= highest[..., None] - 1)
    rim = np.where(near_rim[:, :, None], rows**2, 0.0).max(axis=-1)
    return _Models(
        basis,
        rows,
        products.reshape(*rows.shape[:2], -1, rows.shape[-1]),
        rim,
        counts.T,
        highest.T,
        (times[last] - times[first]) * 1e-9,
    )
