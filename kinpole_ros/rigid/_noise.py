"""
The noise of the markers, measured without any model of the motion.

What a rigid fit leaves over is noise, but also whatever makes a body look not quite rigid: a lens,
a marker that sits off the plane, a shape not yet known well. That part changes slowly, so each
residual is compared with the mean of the ones before and after it, which white noise survives.

An outlier spoils three such comparisons, so that a quarter of them would spoil more than
half. Frames are distinguished by what their own fits leave, which is an outlier in no more than
they are.
"""

import math
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid.levels import KEPT

# This share of what is left may be outliers.
_OUTLIER = 0.1
# A frame is an outlier whose fit leaves so many times what it leaves in all but the worst three
# tenths: however far off they are, more than these tenths are never called so.
_FAR, _TAME = 9.0, 0.7


class Noise:
    """Running noise level (m, per axis) of B bodies, from the residuals of their rigid fits."""

    def __init__(self, bodies: int, kept: int = KEPT) -> None:
        self._kept = kept
        self._squares = np.full((bodies, kept), np.nan)
        # What the fit itself leaves in the frame, and at most in it and its two neighbors.
        self._own = np.full((bodies, kept), np.nan)
        self._most = np.full((bodies, kept), np.nan)
        self._freedom = np.ones(bodies)
        self._count = 0
        self._before: tuple[Complex, Real, Real, np.ndarray] | None = None
        self._level = np.full(bodies, np.nan)

    def add(self, residual: Complex, freedom: Real, goes_on: np.ndarray) -> None:
        """
        Take the fits of some frames, and measure anew.

        `residual` and `freedom` (T, B, n) as of `Fit`; `goes_on` (T,) is False for a frame that
        comes after a gap.
        """
        rows = residual, freedom, mean_square(residual, freedom)[0], goes_on
        if self._before is not None and self._before[0].shape[1:] == residual.shape[1:]:
            rows = tuple(np.concatenate(pair) for pair in zip(self._before, rows, strict=True))
        residual, freedom, left, goes_on = rows
        self._before = tuple(part[-2:] for part in rows)
        middle = np.flatnonzero(goes_on[1:-1] & goes_on[2:]) + 1
        if not len(middle):
            return
        before, after = middle - 1, middle + 1
        bend = residual[middle] - (residual[before] + residual[after]) / 2
        # White residuals add up to 1 + 1/4 + 1/4 of what each frame has to expect.
        expected = freedom[middle] + (freedom[before] + freedom[after]) / 4
        squares, degrees = mean_square(bend, expected)
        known = ~np.isnan(squares)
        mean = np.where(known, degrees, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1) / 1.5
        self._freedom = np.where(known.any(axis=0), mean, self._freedom)
        place = (self._count + np.arange(len(middle))) % self._kept
        self._squares[:, place] = squares.T
        self._own[:, place] = left[middle].T
        most = np.maximum(left[middle], np.maximum(left[before], left[after]))
        self._most[:, place] = most.T
        self._count += len(middle)
        self._measure()

    def forget(self, which: np.ndarray) -> None:
        """Forget the bodies `which` (B,): what they left so far was not noise."""
        for kept in (self._squares, self._own, self._most):
            kept[which] = np.nan
        self._level = np.where(which, np.nan, self._level)
        if self._before is not None:
            self._before[0][:, which] = complex(np.nan, np.nan)
            self._before[2][:, which] = np.nan

    def replace(self, b: int, residual: Complex, freedom: Real, goes_on: np.ndarray) -> None:
        """Take these fits (T, 1, n), as of `add`, for those of one body so far."""
        self.forget(np.arange(len(self._squares)) == b)
        fresh = Noise(1, self._kept)
        fresh.add(residual, freedom, goes_on)
        for kept, new in (
            (self._squares, fresh._squares),
            (self._own, fresh._own),
            (self._most, fresh._most),
            (self._freedom, fresh._freedom),
        ):
            kept[b] = new[0]
        self._measure()

    def level(self) -> Real:
        """Standard deviation (B,) of one coordinate of one marker; NaN while not known."""
        return self._level

    def degrees(self) -> Real:
        """Of how many degrees of freedom (B,) the level is, about."""
        # Every frame is in three of the comparisons.
        return np.asarray((~np.isnan(self._squares)).sum(axis=1) * self._freedom / 2)

    def _measure(self) -> None:
        """
        From the mean of the squares without those of outliers, less the largest tenth.

        A median would call a tracker that rounds its coordinates free of noise, and a plain mean
        believes every jump.
        """
        filled = slice(max(1, min(self._count, self._kept)))
        usual = tame_part(self._own[:, filled])
        tame = ~(self._most[:, filled] > _FAR * usual[:, None])
        known = np.sort(np.where(tame, self._squares[:, filled], np.nan))
        counts = (~np.isnan(known)).sum(axis=-1)
        kept = np.ceil(counts * (1 - _OUTLIER))
        lowest = np.where(np.arange(known.shape[1]) < kept[:, None], known, 0.0).sum(axis=-1)
        freedoms, which = np.unique(np.round(self._freedom, 1), return_inverse=True)
        share = np.array([_share_of_lowest(float(f)) for f in freedoms])[which]
        with np.errstate(divide='ignore', invalid='ignore'):
            self._level = np.sqrt(np.where(counts > 0, lowest / kept / share, np.nan))


def tame_part(values: Real) -> Real:
    """What (B,) all but the worst three tenths of the values (B, m) stay below, NaN left out."""
    ranked = np.sort(values)  # NaN come last
    place = np.ceil(_TAME * np.maximum((~np.isnan(ranked)).sum(axis=-1) - 1, 0)).astype(int)
    return np.asarray(ranked[np.arange(len(ranked)), place])


def mean_square(residual: Complex, expected: Real) -> tuple[Real, Real]:
    """Squares (...) of residuals (..., n) per degree of freedom, NaN for none, and the degrees."""
    seen = ~np.isnan(residual)
    squares = np.where(seen, residual.real**2 + residual.imag**2, 0).sum(axis=-1)
    freedom = np.where(seen, expected, 0).sum(axis=-1)
    enough = freedom > 0.5
    return np.where(enough, squares / np.where(enough, freedom, 1.0), np.nan), freedom


def trimmed_mean(squares: Real, freedom: int) -> float:
    """Mean of squares (m,) of `freedom` degrees each, of which some may be of outliers."""
    tame = np.sort(squares[squares <= _FAR * tame_part(squares[None])[0]])
    lowest = tame[: max(1, math.ceil(len(tame) * (1 - _OUTLIER)))]
    return float(lowest.mean()) / _share_of_lowest(float(freedom))


@lru_cache(maxsize=1024)
def _share_of_lowest(freedom: float) -> float:
    """Mean of the tame part of a chi-square over its mean (Wilson and Hilferty 1931)."""
    levels = (np.arange(200) + 0.5) / 200 * (1 - _OUTLIER)
    normal = np.array([NormalDist().inv_cdf(level) for level in levels])
    cube = np.maximum(1 - 2 / (9 * freedom) + normal * np.sqrt(2 / (9 * freedom)), 0)
    return float((cube**3).mean())
