"""
From energies to weights: of each coefficient of each window, and of the windows.

Energies are mean squares less those of the noise. A coefficient is weighted as Wiener has it, and
what follows for the errors of derivatives weighs the windows. Squares come in, and nothing here
asks whether they are of angles, of positions or of both together.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real
from kinpole_ros.window._models import Models
from kinpole_ros.window._projection import evaluate
from kinpole_ros.window._spectrum import Past

# The averages of a window go back this many times its own length: a short one learns quickly.
_MEMORY = 3.0
# A mean energy counts from so many of its standard deviations, a single one from so many s^2.
_LASTING = 3.0
_SUDDEN = 11.0
# Coefficients whose mean energy is so many s^2 tell how much moves now: this many times what their
# squares, and half an s^2 more that noise may hide, are of it.
_BOLD, _CALM = 30.0, 1.25
# What lies beyond them is as calm as so many of them, the last.
_LAST = 3
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


class Shares(NamedTuple):
    """
    Weights of coefficients `share` (L, D, M, G) and of windows `mix` (L, K, M, G).

    `risk` (L, K, M, G) is the mean square error of derivatives by each window, infinite where it
    will not do; `covariance` (K, K, M, G) is without what the windows disagree about; `last`
    (L, M, G) is the degree of the last coefficient in use; `unknown` (K, M, G) says where no window
    will do; the rest is as in `Weights`.
    """

    share: Real
    mix: Real
    risk: Real
    covariance: Real
    last: np.ndarray
    unknown: np.ndarray
    limits: Real
    means: Real
    among: Real


class _Believed(NamedTuple):
    """
    What is believed of coefficients: see `_believed`.

    `share`, `error` and `signal` (L, D, M, G) are weights, mean square errors and the energies in
    use; `scatter` (L, 1, M, G) is the deviation of a mean energy without signal; `last` (L, 1, M,
    G) the degree of the last coefficient in use, -1 for none; squares beyond `limits` (L, D, M, G)
    are news.
    """

    share: Real
    error: Real
    signal: Real
    scatter: Real
    last: np.ndarray
    limits: Real


def weigh(
    models: Models,
    squares: Real,
    missing: np.ndarray,
    noise: Real,
    dimensions: np.ndarray | int,
    order: int,
    past: Past,
    every: int,
    back: float = _MEMORY,
    free: np.ndarray | None = None,
) -> Shares:
    """
    Judge squares (L, D + 1, M, G) of coefficients and of what the fits leave, up to `order`.

    `missing` (M, G), `noise`, `dimensions` and `every` are as in `weigh_apart`; averages go `back`
    so many windows. Coefficients of degree up to `free` (G,) are taken as they are.
    """
    freedom = models.freedom
    known = (models.lengths > 0) & ~missing
    lengths = np.maximum(models.lengths, 1)
    # Neighboring windows share samples: this part of a square is new to the one before.
    new = np.minimum(every / lengths, 1.0)
    means, among = past(squares, known, 1 / new[:, 0], back)
    apart = np.maximum(new * among, 1.0) * dimensions
    variance = _variance(means[:, -1], freedom * apart, noise)
    energies = squares[:, :-1], means[:, :-1]
    believed = _believed(models, *energies, variance, apart, dimensions, free)
    lost, most_left = _lost(squares[:, -1], means[:, -1], variance, freedom, apart, dimensions)
    errors = _errors(models.rows, believed.error, order + 1)
    risk = _risk(models, errors, believed, lost, missing)
    mix, covariance, unknown = _mixed(errors, risk)
    limits = np.empty_like(squares)
    limits[:, :-1] = believed.limits
    # What is charged for is no news.
    no_news = (squares[:, -1] > most_left) | (freedom == 0)
    limits[:, -1] = np.where(no_news, np.inf, most_left)
    last = believed.last[:, 0]
    return Shares(believed.share, mix, risk, covariance, last, unknown, limits, means, among)


def _believed(
    models: Models,
    energy: Real,
    mean: Real,
    variance: Real,
    apart: Real,
    dimensions: np.ndarray | int,
    free: np.ndarray | None,
) -> _Believed:
    """What to believe of coefficients by their squares now and of late, (L, D, M, G)."""
    scatter = variance * np.sqrt(2 / apart)[:, None]
    stands_out = 1 + _SUDDEN / np.sqrt(dimensions)
    sudden = energy > variance * stands_out
    signal = np.maximum(mean - variance, 0.0)
    lasting = signal > _LASTING * scatter
    calm: Real = np.ones(())
    if free is None:
        calm = _calm(energy + variance / 2, signal, lasting & (signal > _BOLD * variance))
        signal *= calm
    signal = np.maximum(signal, np.where(sudden, energy - variance, 0.0))
    degrees = np.arange(energy.shape[1])[:, None, None]
    last = np.where(sudden | lasting, degrees, -1).max(axis=1)[:, None]
    if free is not None:
        last = np.maximum(last, free)
    used = degrees <= last
    signal *= used
    total = signal + variance
    within = degrees <= models.highest[:, None]
    share = signal / total
    if free is not None:
        share = np.where((degrees <= free) & within, 1.0, share)
    hidden = ~used & (degrees <= last + 2) & within
    error = share * variance + np.where(hidden, _HIDDEN * scatter, 0.0)
    # What is in use is no news.
    limits = stands_out * np.where(used & (calm == 1), np.inf, total)
    return _Believed(share, error, signal, scatter, last, limits)


def _calm(energy: Real, signal: Real, known: np.ndarray) -> Real:
    """
    How much less (L, D, M, G), at most 1, moves now than of late.

    By the coefficients whose `signal` is `known` well; beyond them, where no more than noise can be
    seen now, by the last of these alone.
    """
    now = np.divide(energy, signal, out=np.zeros_like(energy), where=known)
    # How many are known from a degree on.
    left = known[:, ::-1].cumsum(axis=1)[:, ::-1]
    count = left[:, :1]
    calm = np.minimum(_CALM / np.maximum(count, 1) * now.sum(axis=1, keepdims=True), 1.0)
    calm[count == 0] = 1.0
    now *= left <= _LAST
    rest = np.where(count < _LAST, calm, _CALM / _LAST * now.sum(axis=1, keepdims=True))
    return np.where(left > 0, calm, np.minimum(calm, rest))


def _lost(
    left: Real,
    mean_left: Real,
    variance: Real,
    freedom: np.ndarray,
    apart: Real,
    dimensions: np.ndarray | int,
) -> tuple[Real, Real]:
    """
    How much more than noise (L, M, G) the richest fits leave by degree of freedom, now or of late.

    Also how much they may leave now without.
    """
    odds = np.sqrt(2 / np.maximum(freedom * apart, 1))
    lost = np.maximum(mean_left - variance * (_LEFT + _LEFT_LASTING * odds), 0.0)
    odds = np.sqrt(2 / np.maximum(freedom * dimensions, 1))
    most_left = variance * (_LEFT + _LEFT_SUDDEN * odds)
    return np.maximum(lost, left - most_left), most_left


def _errors(rows: Real, error: Real, orders: int) -> Real:
    """Covariances (L, K, K, M, G) of derivatives by `rows`, from those of the coefficients."""
    products = rows[..., None, :] * rows[..., None, :, :]
    products = products.reshape(*rows.shape[:3], -1, rows.shape[-1])
    return evaluate(products, error).reshape(-1, orders, orders, *error.shape[2:])


def _risk(
    models: Models, errors: Real, believed: _Believed, lost: Real, missing: np.ndarray
) -> Real:
    """The `risk` of `Shares`: the diagonal of `errors`, to which it adds what windows miss."""
    # What a window cannot follow adds to its error: what it leaves, and the rest of its series.
    degrees = np.arange(believed.signal.shape[1])[:, None, None]
    rim = degrees >= models.highest[:, None] - 1
    top = np.where(rim, believed.signal, 0.0).max(axis=1)
    charge = _LEFT_WEIGHT * lost * models.freedom + _BEYOND * top
    # An order above all coefficients in use still has its own first one to fear.
    above = np.arange(errors.shape[1])[:, None, None] > believed.last + 2
    feared = np.where(above, _HIDDEN * believed.scatter, 0.0)
    risk = np.einsum('lkk...->lk...', errors)  # a view
    risk += models.rim * charge[:, None] + models.own * feared
    usable = models.highest[:, None] >= np.arange(errors.shape[1])[:, None, None]
    usable = usable & np.isfinite(risk) & ~missing
    return np.where(usable, np.maximum(risk, np.finfo(float).tiny), np.inf)


def _mixed(errors: Real, risk: Real) -> tuple[Real, Real, np.ndarray]:
    """The `mix` of windows, the covariance of what is mixed, and `unknown`, as in `Shares`."""
    least = risk.min(axis=0)
    unknown = ~np.isfinite(least)
    mix = np.maximum(np.where(unknown, 1.0, least) / risk - _OUT, 0.0) ** _SHARPNESS
    mix /= np.where(unknown, 1.0, mix.sum(axis=0))
    part = mix**_KINSHIP
    covariance = (part[:, :, None] * part[:, None] * errors).sum(axis=0)
    if unknown.any():
        covariance[unknown[:, None] | unknown] = np.nan
    return mix, covariance, unknown


def _variance(mean_left: Real, freedom: Real, noise: Real) -> Real:
    """Variance (M, G) of the noise to judge by: not less than what the best rich fit leaves."""
    measured = np.where(freedom >= _ENOUGH_FREEDOM, mean_left, np.inf).min(axis=0)
    return np.maximum(noise**2, np.where(np.isfinite(measured), measured, 0.0))
