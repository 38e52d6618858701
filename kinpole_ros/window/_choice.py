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
noise by itself counts, a window whose richest fit leaves more than noise is charged for it, and
where all that is known well of a window is far below its average, there is less of all of it.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.window._projection import Projection, evaluate, project
from kinpole_ros.window._spectrum import Past, Spectrum
from kinpole_ros.window._weighted import apart, evaluate_poses, squares_of
from kinpole_ros.window._wiener import weigh

# The point at a pole is another one every instant: what it did before a window is of no use.
_MEMORY_TOGETHER = 1.0
# A window contradicts the mean of all beyond so many deviations of their difference.
_CONTRADICTS = 3.0


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


class Weights(NamedTuple):
    """
    What makes derivatives of G signals out of their coefficients, as judged at M instants.

    `share` (L, D, M, G) are the weights of coefficients, `mix` (L, K, M, G) those of windows, NaN
    where the samples are too few; `covariance`, `span` and `degree` are as in `Derivatives`;
    `parted` (K, M, G) is the variance by which the windows contradict each other.
    Squares (L, D + 1, M, G) beyond `limits` refute the judgment; `means` and `among` are what
    `Past` gave.
    """

    share: Real
    mix: Real
    covariance: Real
    parted: Real
    span: Real
    degree: Real
    limits: Real
    means: Real
    among: Real


class Together(NamedTuple):
    """
    What makes derivatives of B bodies' poses, the same for angle and position, for each of A arms.

    `share` (L, D, A, M, B) and `mix` (L, K, A, M, B) are as in `Weights`; `covariance`
    (K, K, A, M, B) is that of one component of the position, in whose ratio to the noise of
    positions that of angles goes too; `turning` (K, A, M, B) is the variance by which the windows
    differ in the angle; `means` and `among`, of A B signals, are as in `Weights`.
    """

    share: Real
    mix: Real
    covariance: Real
    turning: Real
    means: Real
    among: Real


def differentiate(
    times: np.ndarray,
    signals: Real,
    weights: Real | None,
    noise: Real,
    dimensions: np.ndarray,
    order: int,
    spectrum: Spectrum | None = None,
) -> Derivatives:
    """Derivatives of order 0 to `order` of G signals: see `project` and `weigh_apart`."""
    fits = project(times, signals, weights, order)
    squares = squares_of(fits, dimensions)
    past = (spectrum or Spectrum()).follow
    found = weigh_apart(fits, squares, noise, dimensions, order, past)
    values = apart(fits, found.share, found.mix).transpose(0, 2, 3, 1)
    values[0] += fits.base
    return Derivatives(values, found.covariance, found.span, found.degree)


def weigh_apart(
    fits: Projection,
    squares: Real,
    noise: Real,
    dimensions: np.ndarray,
    order: int,
    past: Past,
    every: int = 1,
) -> Weights:
    """
    Weights for derivatives of order 0 to `order` of G signals at M instants, each by itself.

    `squares` are those of the `fits`; `noise` (G,) or (M, G) is the standard deviation of one
    component of a sample of weight 1; `dimensions` (G,) says how many components a signal has, 1 or
    2. A signal that is missing or NaN at time 0 comes out NaN. The `past` knows one in `every`
    instants.
    """
    shares = weigh(fits.models, squares, fits.missing, noise, dimensions, order, past, every)
    # (L, K, 2, M, G)
    values = evaluate(fits.models.rows, shares.share[:, :, None] * fits.coefficients)
    mix = shares.mix
    values -= (mix[:, :, None] * values).sum(axis=0)
    covariance = shares.covariance + _disagreement(mix / dimensions, values)
    squares = np.einsum('lkc...,lkc...->lk...', values, values) / dimensions
    parted = _contradiction(squares, shares.risk, np.einsum('kk...->k...', covariance))
    first = mix[:, min(1, order)]
    span = (first * fits.models.spans).sum(axis=0)
    degree = (first * shares.last).sum(axis=0)
    mix[:, shares.unknown] = np.nan
    return Weights(shares.share, mix, covariance, parted, span, degree, *shares[-3:])


def weigh_together(
    fits: Projection, arms: Complex, noise: Real, order: int, past: Past, every: int = 1
) -> Together:
    """
    Weights for derivatives of the angles and positions of B bodies, the same for both.

    `fits` are those of poses. Where a motion sets in, all windows are off, but angle and position
    by one factor, which cancels in a pole if it is the same. The weights are those for the point of
    the body at `arms` (A, M, B), m from the reference point now, which should be near the pole of
    order 1 to A: its error is that of the pole. The rest is as in `weigh_apart`.
    """
    number, instants, count = arms.shape
    reach = np.abs(arms)
    along = np.where(reach > 0, arms, 1.0) / np.where(reach > 0, reach, 1.0)
    cos, sin = along.real, along.imag
    of_angle, even = noise[:, :count], noise[:, count:]
    # Across the arm the angle's noise adds to that of the position: scaled back to the same.
    scale = even / np.sqrt(even**2 + (reach * of_angle) ** 2)

    # Those of the positions, for each arm.
    models = fits.models.of(count + np.arange(number * count) % count)

    # Angle, and position along and across the arms: (L, D, 3, A, M, B).
    x, y = (fits.coefficients[:, :, k, None, :, count:] for k in (0, 1))
    members = np.empty((*x.shape[:2], 3, *arms.shape))
    members[:, :, 0] = fits.coefficients[:, :, 0, None, :, :count]
    members[:, :, 1] = cos * x + sin * y
    members[:, :, 2] = cos * y - sin * x
    energy = members[:, :, 1] ** 2 + (scale * (members[:, :, 2] + reach * members[:, :, 0])) ** 2
    turned, xx = fits.squares[:, 0, None, :, :count], fits.squares[:, 0, None, :, count:]
    yy = fits.squares[:, 1, None, :, count:]
    with_x, with_y, xy = (fits.products[:, k, None] for k in range(3))
    left = cos**2 * xx + 2 * cos * sin * xy + sin**2 * yy
    across = xx + yy - left + reach * (reach * turned + 2 * (cos * with_y - sin * with_x))
    # A difference of what may be large: never below 0 but for rounding.
    left = np.maximum(left + scale**2 * across, 0.0) / 2

    def signals(array: Real) -> Real:
        """Arms and bodies (..., A, M, B) as so many signals (..., M, A B)."""
        return np.swapaxes(array, -3, -2).reshape(*array.shape[:-3], instants, number * count)

    def arms_of(array: Real) -> Real:
        """The reverse, as a view."""
        return np.swapaxes(array.reshape(*array.shape[:-1], number, count), -3, -2)

    squares = signals(np.concatenate((energy / 2, left[:, None]), axis=1))
    squares[:, -1] /= np.maximum(models.freedom, 1)
    shares = weigh(
        models,
        squares,
        np.concatenate([fits.missing[:, :count] | fits.missing[:, count:]] * number, axis=1),
        np.concatenate([even] * number, axis=1),
        2,
        order,
        past,
        every,
        _MEMORY_TOGETHER,
        # A pole's own order is not taken for small: its first coefficients count in full.
        np.repeat(np.arange(1, number + 1), count),
    )
    share, mix = arms_of(shares.share), arms_of(shares.mix)
    members *= share[:, :, None]
    values = evaluate_poses(fits.models, members)  # (L, K, 3, A, M, B)
    values -= (mix[:, :, None] * values).sum(axis=0)
    turning = (mix * values[:, :, 0] ** 2).sum(axis=0)
    values[:, :, 2] = scale * (values[:, :, 2] + reach * values[:, :, 0])
    covariance = arms_of(shares.covariance) + _disagreement(mix / 2, values[:, :, 1:])
    mix[:, arms_of(shares.unknown)] = np.nan
    return Together(share, mix, covariance, turning, shares.means, shares.among)


def _disagreement(mix: Real, apart: Real) -> Real:
    """Covariance (K, K, ...) of windows that are off (L, K, C, ...) their mean."""
    parted = np.sqrt(mix)[:, :, None] * apart
    return np.asarray(np.einsum('lkc...,ljc...->kj...', parted, parted))


def _contradiction(squares: Real, risk: Real, variance: Real) -> Real:
    """
    The square (K, M, G) by which the surest window that contradicts the mean is off it, 0 for none.

    `squares` (L, K, M, G) are those by which each window is off it, `risk` their mean square
    errors; `variance` (K, M, G) is that of the mean.
    """
    against = np.where(squares > _CONTRADICTS**2 * (risk + variance), risk, np.inf)
    surest = np.isfinite(against) & (against == against.min(axis=0))
    return np.asarray(np.where(surest, squares, 0.0).max(axis=0))
