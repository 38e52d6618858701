"""
Derivatives of poses: weights judged now and then, and used at every instant.

To judge takes ten times what the derivatives themselves take, and from one frame to the next the
judgment hardly changes: it holds for a small part of the window.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import rotation_coefficient
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.window._choice import (
    Spectrum,
    Together,
    Weights,
    apply,
    members_of,
    weigh_apart,
    weigh_together,
)
from kinpole_ros.window._projection import project

# Weights hold for so small a part of the samples of a window: up to 4 of 61 samples the errors are
# the same, with 8 some are half as large again.
_PART = 15


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


class _Judgment(NamedTuple):
    """
    How J instants are to be derived from samples at the `times` about them.

    The fields are those of `Weights` and `Together`, and the covariance of the angle together.
    """

    times: bytes
    apart: Weights
    together: Together
    angle_covariance: Real


class PoseFilter:
    """Finds the derivatives of the poses of bodies, instant after instant."""

    def __init__(self) -> None:
        self._spectrum = Spectrum()
        self._spectrum_together = Spectrum()
        self._held: _Judgment | None = None
        self._cell = -1

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
        Derivatives up to `order` at M instants, the samples of numbers (M,), rising, of all so far.

        `times`, `samples` (N, M, 2 B, 2), angles first, and `weights` as in `project`; `noise`
        (M, 2 B) as in `weigh_apart`; poles farther away than `reach` (B,), m, are not aimed at.
        An order that was not asked for before is NaN until the next judgment.
        """
        count = len(reach)
        every = 1 if weights is not None else max(1, len(times) // _PART)
        cells = numbers // every
        fresh = np.diff(cells, prepend=self._cell) != 0
        held, now = self._held, times.tobytes()
        if held is None or weights is not None or held.times != now:
            fresh[0] = True
        self._cell = -1 if weights is not None else int(cells[-1])
        judged = fresh.nonzero()[0]
        fits = project(times, samples, weights, order, count, judged)
        members = members_of(fits.coefficients)
        if len(judged):
            noise = noise[judged]
            dimensions = np.repeat((1, 2), count)
            apart = weigh_apart(fits, noise, dimensions, order, self._spectrum, every)
            position, angle = _split(apply(apart.taps, members[judged]), count)
            with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
                orders = range(1, order + 1)
                arms = -position[1:] / [rotation_coefficient(k, angle) for k in orders]
                arms = np.where(np.abs(arms) < reach, arms, 0.0)
            spectrum = self._spectrum_together
            both = weigh_together(fits, arms, noise, order, spectrum, every)
            of_angle = both.covariance * (noise[:, :count] / noise[:, count:]) ** 2
            new = _Judgment(now, apart, both, of_angle)
            self._held = _chosen(new, np.array([-1]))
            held = new if fresh[0] or held is None else _followed(_of_order(held, order), new)
        else:
            assert held is not None
            held = _of_order(held, order)
        which = np.cumsum(fresh) - fresh[0]
        if len(which) > 1:
            held = _chosen(held, which)
        apart, both = held.apart, held.together

        position, angle = _split(apply(apart.taps, members), count)
        members = members[:, None]
        together = apply(both.position, members[:, :, count:])
        turned = apply(both.angle, members[:, :, :count])[..., 0]
        position[0] += fits.base[:, count:, 0] + 1j * fits.base[:, count:, 1]
        angle[0] += fits.base[:, :count, 0]
        return PoseDerivatives(
            position,
            angle,
            apart.covariance[..., count:],
            apart.covariance[..., :count],
            apart.span[:, :count],
            apart.degree[:, :count],
            _complex(together).transpose(3, 1, 0, 2),
            turned.transpose(3, 1, 0, 2),
            both.covariance,
            held.angle_covariance,
            both.turning,
        )


def _split(derivatives: Real, count: int) -> tuple[Complex, Real]:
    """Of derivatives (M, 2 B, K, 2) those of the positions (K, M, B) and of the angles."""
    both = derivatives.transpose(2, 0, 1, 3)
    return _complex(both[:, :, count:]), both[:, :, :count, 0].copy()


def _complex(vectors: Real) -> Complex:
    return np.asarray(vectors[..., 0] + 1j * vectors[..., 1])


def _mapped(function: Callable[..., Real], *judgments: _Judgment) -> _Judgment:
    """What the function makes of the fields; it is told their axis of instants as well."""

    def fields(parts: Iterable[tuple[Real, ...]], taps: int) -> list[Real]:
        return [function(*one, axis=0 if k < taps else -2) for k, one in enumerate(parts)]

    times, apart, together, angle_covariance = zip(*judgments, strict=True)
    return _Judgment(
        times[-1],
        Weights(*fields(zip(*apart, strict=True), 1)),
        Together(*fields(zip(*together, strict=True), 2)),
        function(*angle_covariance, axis=-2),
    )


def _chosen(judgment: _Judgment, which: np.ndarray) -> _Judgment:
    """Those instants of a judgment."""
    return _mapped(lambda array, axis: np.take(array, which, axis), judgment)


def _followed(judgment: _Judgment, later: _Judgment) -> _Judgment:
    """One judgment after the other."""
    return _mapped(lambda *arrays, axis: np.concatenate(arrays, axis), judgment, later)


def _of_order(judgment: _Judgment, order: int) -> _Judgment:
    """The judgment up to that order, NaN beyond what it is of."""
    apart, together = judgment.apart, judgment.together
    orders, arms = order + 1, order
    if apart.taps.shape[2] == orders:
        return judgment
    covariance = judgment.angle_covariance
    return _Judgment(
        judgment.times,
        apart._replace(
            taps=_resized(apart.taps, {2: orders}),
            covariance=_resized(apart.covariance, {0: orders, 1: orders}),
        ),
        Together(
            _resized(together.angle, {1: arms, 3: orders}),
            _resized(together.position, {1: arms, 3: orders}),
            _resized(together.covariance, {0: orders, 1: orders, 2: arms}),
            _resized(together.turning, {0: orders, 1: arms}),
        ),
        _resized(covariance, {0: orders, 1: orders, 2: arms}),
    )


def _resized(array: Real, sizes: Mapping[int, int]) -> Real:
    """The array with these sizes of some axes, cut or with NaN."""
    shape = [sizes.get(k, size) for k, size in enumerate(array.shape)]
    result = np.full(shape, np.nan)
    common = tuple(slice(min(pair)) for pair in zip(shape, array.shape, strict=True))
    result[common] = array[common]
    return result
