"""
How windows and degrees are judged for poses, and what a judgment makes of their fits.

Angle and position are weighed apart, and together for the point of the body at each pole. When that
is done, and for how long it holds, is not asked here.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import rotation_coefficient
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.window._choice import (
    weigh_apart,
    weigh_together,
)
from kinpole_ros.window._projection import Projection
from kinpole_ros.window._spectrum import Past
from kinpole_ros.window._weighted import apart, both_ways


class PoseDerivatives(NamedTuple):
    """
    Derivatives of the poses of B bodies at M instants, of order 0 to K - 1.

    As fields of `Derivatives`, angle and position each by itself; then both by the same weights,
    those for the point of the body at the pole of order 1 to K - 1, as in `Together`.
    """

    position: Complex  # (K, M, B)
    angle: Real
    position_covariance: Real  # (K, K, M, B)
    angle_covariance: Real
    span: Real  # (M, B)
    degree: Real
    position_together: Complex  # (K, A, M, B)
    angle_together: Real
    position_covariance_together: Real  # (K, K, A, M, B)
    angle_covariance_together: Real
    turning: Real  # (K, A, M, B)
    parted: Real  # (K, M, B), that of the angle by itself, as in `Weights`


# The first axes of these fields: orders K, arms A.
AXES = ('K', 'K', 'KK', 'KK', '', '', 'KA', 'KA', 'KKA', 'KKA', 'KA', 'K')


class Judged(NamedTuple):
    """
    How bodies at instants are derived, R in all: the fields of `Weights` and `Together`.

    Of two signals, angle and position, and A arms; also the covariance of the angle together. The
    weights are in the order of `both_ways`.
    """

    share: Real  # (L, D, A + 2, R)
    mix: Real  # (L, K, A + 2, R)
    covariance: Real  # (K, K, 2, R)
    span: Real  # (R,)
    degree: Real
    limits: Real  # (L, D + 1, 2, R)
    means: Real
    among: Real  # (L, 2, R)
    covariance_together: Real  # (K, K, A, R)
    angle_covariance: Real
    turning: Real  # (K, A, R)
    parted: Real  # (K, R), that of the angle
    means_together: Real  # (L, D + 1, A, R)
    among_together: Real  # (L, A, R)


class Seen(NamedTuple):
    """Poses of B bodies at M instants as they are judged: see `PoseFilter.derivatives`."""

    fits: Projection
    squares: Real  # those of `squares_of`
    noise: Real
    reach: Real

    def at(self, instants: np.ndarray, bodies: np.ndarray) -> 'Seen':
        """Those of some bodies (m, b) at instants (m, b)."""
        if bodies.shape == self.reach.shape:  # all there are, as a rule where frames come singly
            return self
        at = _signals_at(instants, bodies, self.reach.shape[1])
        return Seen(
            fits_at(self.fits, instants, bodies),
            _picked(self.squares, at),
            self.noise[at],
            self.reach[instants, bodies],
        )


def judge(seen: Seen, past: Past, past_together: Past, order: int, every: int) -> Judged:
    """Judge bodies at instants (M, B), by what was known of them apart and together."""
    fits, noise, reach = seen.fits, seen.noise, seen.reach
    bodies = reach.shape[1]
    own = weigh_apart(fits, seen.squares, noise, dimensions_of(bodies), order, past, every)
    derivatives = apart(fits, own.share, own.mix)
    angle = derivatives[:, 0, :, :bodies]
    orders = range(1, order + 1)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        arms = -_complex(derivatives[1:, :, :, bodies:])
        arms /= [rotation_coefficient(k, angle) for k in orders]
        arms = np.where(np.abs(arms) < reach, arms, 0.0)
        both = weigh_together(fits, arms, noise, order, past_together, every)
        of_angle = both.covariance * (noise[:, :bodies] / noise[:, bodies:]) ** 2
    for spread, signals in ((both.covariance, slice(bodies, None)), (of_angle, slice(bodies))):
        # The instant itself is found apart.
        spread[0] = spread[:, 0] = 0.0
        spread[0, 0] = own.covariance[0, 0, :, signals]

    def flat(array: Real) -> Real:
        """Instants and bodies (..., M, B) as one axis."""
        return array.reshape(*array.shape[:-2], -1)

    def ordered(of_signals: Real, of_arms: Real) -> Real:
        """Weights in the order of `both_ways`."""
        two = by_signal(of_signals, bodies)
        return flat(np.concatenate((two[:, :, :1], of_arms, two[:, :, 1:]), axis=2))

    fields = own.covariance, own.limits, own.means, own.among
    covariance, limits, means, among = (flat(by_signal(field, bodies)) for field in fields)
    return Judged(
        ordered(own.share, both.share),
        ordered(own.mix, both.mix),
        covariance,
        flat(own.span[:, :bodies]),
        flat(own.degree[:, :bodies]),
        limits,
        means,
        among,
        flat(both.covariance),
        flat(of_angle),
        flat(both.turning),
        flat(own.parted[..., :bodies]),
        flat(by_signal(both.means, bodies)),
        flat(by_signal(both.among, bodies)),
    )


def applied(judged: Judged, which: np.ndarray, fits: Projection) -> PoseDerivatives:
    """Derivatives of bodies at instants as the items `which` (M, B) of the judged have it."""
    bodies = which.shape[1]

    def taken(array: Real) -> Real:
        return array.take(which, -1)

    found = both_ways(fits, taken(judged.share), taken(judged.mix))
    angle, position = found[:, 0], _complex(found[:, 1:])
    # The instant itself is the same for both.
    base = fits.base.view(complex)[..., 0]
    angle[0] = angle[0, 0] + base.real[:, :bodies]
    position[0] = position[0, -1] + base[:, bodies:]
    covariance = taken(judged.covariance)
    return PoseDerivatives(
        position[:, -1],
        angle[:, 0],
        covariance[:, :, 1],
        covariance[:, :, 0],
        taken(judged.span),
        taken(judged.degree),
        position[:, :-1],
        angle[:, 1:],
        taken(judged.covariance_together),
        taken(judged.angle_covariance),
        taken(judged.turning),
        taken(judged.parted),
    )


def of_order(found: PoseDerivatives, order: int) -> PoseDerivatives:
    """The same up to another order, NaN where that is higher."""
    sizes = {'K': order + 1, 'A': order}
    return PoseDerivatives(
        *(
            _resized(array, [sizes[axis] for axis in axes])
            for array, axes in zip(found, AXES, strict=True)
        )
    )


def _resized(array: np.ndarray, sizes: list[int]) -> np.ndarray:
    """The array with these sizes of its first axes, cut or with NaN."""
    result = np.full((*sizes, *array.shape[len(sizes) :]), np.nan, array.dtype)
    common = tuple(slice(min(pair)) for pair in zip(sizes, array.shape, strict=False))
    result[common] = array[common]
    return result


def known(means: Real, among: Real) -> Past:
    """What was known when bodies at instants were judged, as in `Judged`; nothing is added."""
    past = tuple(np.swapaxes(each, -1, -2).copy() for each in (means, among))
    return lambda squares, known, length, back: past


def joined(first: Judged | None, then: Judged) -> Judged:
    """Both, one after the other."""
    if first is None:
        return then
    return Judged(*(np.concatenate(pair, axis=-1) for pair in zip(first, then, strict=True)))


def fits_at(fits: Projection, instants: np.ndarray, bodies: np.ndarray) -> Projection:
    """The fits of some bodies (m, b) at instants (m, b), to evaluate and to judge by."""
    all_there, count = fits.products.shape[-2:]
    # All there are, unless one instant is twice among as many: as may be where there is one body.
    if (all_there, count) == bodies.shape and (instants[:, 0] == np.arange(all_there)).all():
        return fits
    at = _signals_at(instants, bodies, count)
    return Projection(
        fits.models.at(instants[:, 0]),
        _picked(fits.coefficients, at),
        _picked(fits.squares, at),
        _picked(fits.products, (instants, bodies)),
        fits.base[at],
        fits.missing[at],
    )


def _signals_at(
    instants: np.ndarray, bodies: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Where the signals of some of `count` bodies (m, b) at instants (m, b) are, (m, 2 b) each."""
    signals = np.concatenate((bodies, count + bodies), axis=1)
    return np.concatenate((instants, instants), axis=1), signals


def _picked(array: Real, at: tuple[np.ndarray, np.ndarray]) -> Real:
    """Items of the last two axes, laid out as they are told: an index leaves its own axes first."""
    instants, items = at
    return np.ascontiguousarray(array[..., instants, items])


@cache
def dimensions_of(bodies: int) -> np.ndarray:
    """How many components the signals (2 B,) of B bodies have: angles 1, positions 2."""
    return np.repeat((1, 2), bodies)


def by_signal(array: Real, bodies: int) -> Real:
    """Some signals S of B bodies, (..., M, S B), as (..., S, M, B)."""
    return array.reshape(*array.shape[:-1], -1, bodies).swapaxes(-3, -2)


def _complex(vectors: Real) -> Complex:
    """Vectors (K, 2, ...) as complex numbers (K, ...)."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1])
