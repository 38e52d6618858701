"""
Derivatives of poses: how is judged now and then, and holds until the data refute it.

To judge windows and degrees takes ten times what the derivatives themselves take, and as a rule the
judgment is the same from one frame to the next. It is made anew at each twelfth part of a window,
and at once for a body in whose coefficients or residuals something stands out that was not there.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar import rotation_coefficient
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.window._choice import (
    Past,
    Spectrum,
    apply,
    members_of,
    squares_of,
    weigh_apart,
    weigh_together,
)
from kinpole_ros.window._projection import Projection, project

# A judgment holds for so small a part of the samples of a window, for as many samples at least.
_PART = 12


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
    How bodies at instants are derived: one row each, of the fields of `Weights` and `Together`.

    Of two signals, angle and position, and A arms; also the covariance of the angle together.
    """

    taps: Real  # (rows, 2, K, L D)
    covariance: Real  # (rows, 2, K, K)
    span: Real  # (rows,)
    degree: Real
    limits: Real  # (rows, 2, L, D + 1)
    means: Real
    among: Real  # (rows, 2, L)
    taps_together: Real  # (rows, 1 or 2, A, K, L D)
    covariance_together: Real  # (rows, A, K, K)
    angle_covariance: Real
    turning: Real  # (rows, A, K)
    means_together: Real  # (rows, A, L, D + 1)
    among_together: Real  # (rows, A, L)


class PoseFilter:
    """Finds the derivatives of the poses of B bodies, instant after instant."""

    def __init__(self) -> None:
        self._spectra = Spectrum(), Spectrum()
        # What holds up to an order, for samples at these times about an instant, in this stretch.
        self._held: _Judged | None = None
        self._order = 0
        self._times = b''
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
        every = max(1, len(times) // _PART) if weights is None else 1
        stretches = numbers // every
        due = np.diff(stretches, prepend=self._stretch) != 0
        if self._held is None or weights is not None or self._times != times.tobytes():
            due[0] = True
        self._times, self._stretch = times.tobytes(), int(stretches[-1])

        def part(chosen: slice, order: int) -> PoseDerivatives:
            fits = project(times, samples[:, chosen], weights, order, reach.shape[1])
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
        squares = squares_of(fits, np.repeat((1, 2), bodies))

        def judge(instants: np.ndarray, those: np.ndarray, pasts: tuple[Past, Past]) -> _Judged:
            """Judge these bodies (m, b) at instants (m, b), by what is known of the past."""
            signals = np.concatenate((those, bodies + those), axis=1)
            at = (..., np.tile(instants, 2), signals)
            some = Projection(
                fits.models,
                fits.coefficients[at],
                fits.squares[at],
                fits.products[..., instants, those],
                fits.base[at[1:]],
                fits.missing[at],
            )
            given = some, squares[at], noise[at], reach[instants, those]
            return _judge(*given, *pasts, order, every)

        stretch = np.cumsum(due)
        which = (stretch - stretch[0])[:, None] * bodies + np.arange(bodies)
        judged = self._held
        begun = due.nonzero()[0]
        if len(begun):
            instants, those = np.broadcast_arrays(begun[:, None], np.arange(bodies))
            apart, together = self._spectra
            new = judge(instants, those, (apart.follow, together.follow))
            judged = new if due[0] or judged is None else _followed(judged, new)
            self._held = _Judged(*(field[-bodies:] for field in new))
            self._order = order
        assert judged is not None
        off = _by_body(squares, bodies) > judged.limits[which]
        refuted = off.any(axis=(2, 3, 4)) & ~due[:, None]
        if refuted.any():
            rows = which[refuted]
            pasts = (
                _known(judged.means[rows], judged.among[rows]),
                _known(judged.means_together[rows], judged.among_together[rows]),
            )
            which[refuted] = len(judged.taps) + np.arange(len(rows))
            instants, those = refuted.nonzero()
            new = judge(instants[:, None], those[:, None], pasts)
            judged = _followed(judged, new)
        return _applied(judged, which, fits)


def _followed(judged: _Judged, new: _Judged) -> _Judged:
    return _Judged(*map(np.concatenate, zip(judged, new, strict=True)))


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
    instants, bodies = reach.shape
    dimensions = np.repeat((1, 2), bodies)
    apart = weigh_apart(fits, squares, noise, dimensions, order, past, every)
    derivatives = apply(apart.taps, members_of(fits.coefficients)).transpose(2, 0, 1, 3)
    angle = derivatives[:, :, :bodies, 0]
    orders = range(1, order + 1)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        arms = derivatives[1:, :, bodies:] @ (-1, -1j)
        arms /= [rotation_coefficient(k, angle) for k in orders]
        arms = np.where(np.abs(arms) < reach, arms, 0.0)
        together = weigh_together(fits, arms, noise, order, past_together, every)
        of_angle = (noise[:, :bodies] / noise[:, bodies:]) ** 2

    def rows(array: Real, *axes: int) -> Real:
        """One row for each body at each instant, from its axes in the order given."""
        array = array.transpose(axes)
        return array.reshape(-1, *array.shape[2:])

    def signals(array: Real) -> Real:
        """The same of some signals of each body (..., M, signals B)."""
        array = array.reshape(*array.shape[:-1], -1, bodies)
        last = array.ndim - 1
        return rows(array, last - 2, last, last - 1, *range(last - 2))

    taps = apart.taps.reshape(instants, 2, bodies, *apart.taps.shape[2:])
    return _Judged(
        rows(taps, 0, 2, 1, 3, 4),
        signals(apart.covariance),
        apart.span[:, :bodies].reshape(-1),
        apart.degree[:, :bodies].reshape(-1),
        signals(apart.limits),
        signals(apart.means),
        signals(apart.among),
        rows(together.taps, 0, 2, 3, 1, 4, 5),
        rows(together.covariance, 3, 4, 2, 0, 1),
        rows(together.covariance * of_angle, 3, 4, 2, 0, 1),
        rows(together.turning, 2, 3, 1, 0),
        signals(together.means),
        signals(together.among),
    )


def _known(means: Real, among: Real) -> Past:
    """What was known when rows were judged, (rows, signals, L, D + 1), which is not added to."""
    return lambda squares, known, memory: (means.transpose(2, 3, 0, 1), among.transpose(2, 0, 1))


def _by_body(squares: Real, bodies: int) -> Real:
    """Squares (L, D + 1, M, 2 B) as (M, B, 2, L, D + 1)."""
    return squares.reshape(*squares.shape[:-1], 2, bodies).transpose(2, 4, 3, 0, 1)


def _applied(judged: _Judged, which: np.ndarray, fits: Projection) -> PoseDerivatives:
    """Derivatives of bodies at instants by the rows `which` (M, B) of the judged."""
    bodies = which.shape[1]
    members = members_of(fits.coefficients)
    members = np.swapaxes(members.reshape(len(members), 2, bodies, *members.shape[2:]), 1, 2)
    apart = apply(judged.taps[which], members)  # (M, B, 2, K, 2)
    together = apply(judged.taps_together[which], members[:, :, :, None])  # (M, B, 2, A, K, 2)
    position = _complex(apart[:, :, 1]).transpose(2, 0, 1)
    angle = apart[:, :, 0, :, 0].transpose(2, 0, 1)
    position[0] += _complex(fits.base[:, bodies:])
    angle[0] += fits.base[:, :bodies, 0]
    covariance = judged.covariance[which].transpose(2, 3, 4, 0, 1)
    return PoseDerivatives(
        position,
        angle,
        covariance[1],
        covariance[0],
        judged.span[which],
        judged.degree[which],
        _complex(together[:, :, 1]).transpose(3, 2, 0, 1),
        together[:, :, 0, :, :, 0].transpose(3, 2, 0, 1),
        judged.covariance_together[which].transpose(3, 4, 2, 0, 1),
        judged.angle_covariance[which].transpose(3, 4, 2, 0, 1),
        judged.turning[which].transpose(3, 2, 0, 1),
    )


def _complex(vectors: Real) -> Complex:
    """Vectors (..., 2) as complex numbers, in place."""
    return vectors.view(complex)[..., 0]


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
