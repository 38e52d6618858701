"""
Derivatives of poses: how is judged now and then, and holds until the data refute it.

To judge windows and degrees takes ten times what the derivatives themselves take, and as a rule the
judgment is the same from one frame to the next. It is made anew at each eighth part of a window,
and at once for a body in whose coefficients or residuals something stands out that was not there,
or of which angle and position tell another story together than they do apart.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import rotation_coefficient
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.window._choice import (
    Past,
    Spectrum,
    apart,
    both_ways,
    squares_of,
    weigh_apart,
    weigh_together,
)
from kinpole_ros.window._projection import Projection, longest, project

# A judgment holds for this part of the samples of the longest window: 12 of 99 leave the errors as
# they are when each instant is judged.
_PART = 8
# Derivatives found together and apart are not the same where they differ by so many deviations.
_OFF = 3.0


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


# The first axes of these fields: orders K, arms A.
_AXES = ('K', 'K', 'KK', 'KK', '', '', 'KA', 'KA', 'KKA', 'KKA', 'KA')


class _Judged(NamedTuple):
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
    means_together: Real  # (L, D + 1, A, R)
    among_together: Real  # (L, A, R)


class PoseFilter:
    """Finds the derivatives of the poses of B bodies, instant after instant."""

    def __init__(self) -> None:
        self._spectrum = Spectrum()
        self._spectrum_together = Spectrum()
        # What holds up to an order, for windows up to so many samples, in this stretch.
        self._held: _Judged | None = None
        self._order = 0
        self._longest = 0
        self._stretch = -1

    def derivatives(
        self,
        numbers: np.ndarray,
        times: np.ndarray,
        samples: Real,
        weights: Real | None,
        noise: Real,
        reach: Real,
        order: int,
    ) -> PoseDerivatives:
        """
        Derivatives up to `order` at M instants, the samples of `numbers` (M,), rising, of all.

        `times`, `samples` (N, M, 2 B, 2), angles first, and `weights` as in `project`; `noise`
        (M, 2 B) as in `weigh_apart`; poles farther away than `reach` (M, B), m, are not aimed at.
        Orders that were not asked for when the instants before were judged are NaN until the next.
        """
        # Not by the times: stamps that are a little uneven are no reason to judge anew.
        most = longest(len(times))
        every = max(1, most // _PART) if weights is None else 1
        stretches = numbers // every
        due = np.ones(len(stretches), bool)
        due[1:] = stretches[1:] != stretches[:-1]
        if self._held is not None and weights is None and self._longest == most:
            due[0] = stretches[0] != self._stretch
        self._longest, self._stretch = most, int(stretches[-1])

        def part(chosen: slice, order: int) -> PoseDerivatives:
            parts = times[:, chosen], samples[:, chosen]
            fits = project(*parts, weights, order, reach.shape[1])
            return self._derived(fits, noise[chosen], reach[chosen], due[chosen], order, every)

        if due[0] or order == self._order:
            return part(slice(None), order)
        end = int(due.argmax()) or len(due)
        parts = [_of_order(part(slice(end), self._order), order)]
        if end < len(due):
            parts.append(part(slice(end, None), order))
        return PoseDerivatives(*(np.concatenate(each, -2) for each in zip(*parts, strict=True)))

    def _derived(
        self, fits: Projection, noise: Real, reach: Real, due: np.ndarray, order: int, every: int
    ) -> PoseDerivatives:
        """Derivatives of poses at instants that are judged where `due` (M,), or refute the last."""
        bodies = reach.shape[1]
        squares = squares_of(fits, _dimensions(bodies))

        def judge(
            instants: np.ndarray, those: np.ndarray, pasts: tuple[Past, Past]
        ) -> tuple[_Judged, Projection]:
            """Judge these bodies (m, b) at instants (m, b), by what is known of the past."""
            if those.shape == reach.shape:  # all there are, as a rule where frames come singly
                return _judge(fits, squares, noise, reach, *pasts, order, every), fits
            signals = np.concatenate((those, bodies + those), axis=1)
            at = (..., np.concatenate((instants, instants), axis=1), signals)
            some = Projection(
                fits.models.at(instants[:, 0]),
                fits.coefficients[at],
                fits.squares[at],
                fits.products[..., instants, those],
                fits.base[at[1:]],
                fits.missing[at],
            )
            given = some, squares[at], noise[at], reach[instants, those]
            return _judge(*given, *pasts, order, every), some

        stretch = due.cumsum()
        which = (stretch - stretch[0])[:, None] * bodies + np.arange(bodies)
        judged = self._held
        begun = due.nonzero()[0]
        if len(begun):
            instants, those = np.broadcast_arrays(begun[:, None], np.arange(bodies))
            pasts = self._spectrum.follow, self._spectrum_together.follow
            new, _ = judge(instants, those, pasts)
            judged = new
            if not due[0] and self._held is not None:
                pairs = zip(self._held, new, strict=True)
                judged = _Judged(*(np.concatenate(pair, axis=-1) for pair in pairs))
            self._held = _Judged(*(field[..., -bodies:] for field in new))
            self._order = order
        assert judged is not None
        found = _applied(judged, which, fits)
        news = _by_signal(squares, bodies) > judged.limits.take(which, -1)
        wrong = news.any(axis=(0, 1, 2))
        off = _off(found)
        refuted = (wrong | off[-1].any(axis=0)) & ~due[:, None]
        if np.count_nonzero(refuted):
            rows = which[refuted]
            pasts = (
                _known(judged.means[..., rows], judged.among[..., rows]),
                _known(judged.means_together[..., rows], judged.among_together[..., rows]),
            )
            instants, those = (places[:, None] for places in refuted.nonzero())
            new, some = judge(instants, those, pasts)
            anew = _applied(new, np.arange(len(rows))[:, None], some)
            # No order hangs on what those above it tell, lest it did on which are asked for.
            orders = np.arange(order + 1)
            both = off[..., refuted] | wrong[refuted]
            own = both[:, 0].copy()
            own[1:] = np.logical_or.accumulate(both[orders[1:], orders[:-1]], axis=0)
            replaced = {
                'K': own,
                'KK': own[:, None] | own,
                '': own[min(1, order)],
                'KA': both,
                'KKA': both[:, None] | both,
            }
            for array, part, axes in zip(found, anew, _AXES, strict=True):
                where = replaced[axes]
                array[..., refuted] = np.where(where, part[..., 0], array[..., refuted])
        return found


def _off(found: PoseDerivatives) -> np.ndarray:
    """Which derivatives (K, A, M, B) together, or some of lower order, are off those apart."""

    def off(apart: Complex, both: Complex, covariance: Real, covariance_both: Real) -> np.ndarray:
        of_itself = np.einsum('kk...->k...', covariance), np.einsum('kk...->k...', covariance_both)
        variance = of_itself[0][:, None] + of_itself[1]
        away = both - apart[:, None]
        return np.asarray(away.real**2 + away.imag**2 > _OFF**2 * variance)

    f = found
    either = off(
        f.position, f.position_together, f.position_covariance, f.position_covariance_together
    ) | off(f.angle, f.angle_together, f.angle_covariance, f.angle_covariance_together)
    # The instant itself is the same for both, but for rounding.
    either[0] = False
    return np.asarray(np.logical_or.accumulate(either, axis=0))


def _judge(
    fits: Projection,
    squares: Real,
    noise: Real,
    reach: Real,
    past: Past,
    past_together: Past,
    order: int,
    every: int,
) -> _Judged:
    """Judge bodies at instants (M, B), by what was known of them apart and together."""
    bodies = reach.shape[1]
    own = weigh_apart(fits, squares, noise, _dimensions(bodies), order, past, every)
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
        two = _by_signal(of_signals, bodies)
        return flat(np.concatenate((two[:, :, :1], of_arms, two[:, :, 1:]), axis=2))

    fields = own.covariance, own.limits, own.means, own.among
    covariance, limits, means, among = (flat(_by_signal(field, bodies)) for field in fields)
    return _Judged(
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
        flat(_by_signal(both.means, bodies)),
        flat(_by_signal(both.among, bodies)),
    )


def _known(means: Real, among: Real) -> Past:
    """What was known when bodies at instants were judged, as in `_Judged`; nothing is added."""
    return lambda squares, known, memory: (np.swapaxes(means, -1, -2), np.swapaxes(among, -1, -2))


@cache
def _dimensions(bodies: int) -> np.ndarray:
    """How many components the signals (2 B,) of B bodies have: angles 1, positions 2."""
    return np.repeat((1, 2), bodies)


def _by_signal(array: Real, bodies: int) -> Real:
    """Some signals S of B bodies, (..., M, S B), as (..., S, M, B)."""
    return array.reshape(*array.shape[:-1], -1, bodies).swapaxes(-3, -2)


def _applied(judged: _Judged, which: np.ndarray, fits: Projection) -> PoseDerivatives:
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
    )


def _complex(vectors: Real) -> Complex:
    """Vectors (K, 2, ...) as complex numbers (K, ...)."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1])


def _of_order(found: PoseDerivatives, order: int) -> PoseDerivatives:
    """The same up to another order, NaN where that is higher."""
    sizes = {'K': order + 1, 'A': order}
    return PoseDerivatives(
        *(
            _resized(array, [sizes[axis] for axis in axes])
            for array, axes in zip(found, _AXES, strict=True)
        )
    )


def _resized(array: np.ndarray, sizes: list[int]) -> np.ndarray:
    """The array with these sizes of its first axes, cut or with NaN."""
    result = np.full((*sizes, *array.shape[len(sizes) :]), np.nan, array.dtype)
    common = tuple(slice(min(pair)) for pair in zip(sizes, array.shape, strict=False))
    result[common] = array[common]
    return result
