"""
The noise of the markers, measured without any model of the motion.

What a rigid fit leaves over is noise, but also whatever makes a body look not quite rigid: a lens,
a marker that sits off the plane, a shape not yet known well. That part changes slowly, so each
residual is compared with the mean of the ones before and after it, which white noise survives.

A frame gone wild spoils three such comparisons, so that a quarter of them would spoil more than
half. Frames are told apart by what their own fits leave, which is wild in no more than they are.
"""

from functools import lru_cache
from statistics import NormalDist

import numpy as np

from kinpole_ros.planar import Fit
from kinpole_ros.planar._plane import Complex, Real

# How many frames the level is taken from, and which share of what is left may be wild.
_KEPT = 512
_WILD = 0.1
# A frame is wild whose fit leaves so many times what it leaves in all but the worst three tenths:
# however wild they are, more than these tenths are never called so.
_FAR, _TAME = 9.0, 0.7


class Noise:
    """Running noise level (m, per axis) of B bodies, from the residuals of their rigid fits."""

    def __init__(self, bodies: int) -> None:
        self._squares = np.full((bodies, _KEPT), np.nan)
        # What the fit itself leaves in the frame, and at most in it and its two neighbors.
        self._own = np.full((bodies, _KEPT), np.nan)
        self._most = np.full((bodies, _KEPT), np.nan)
        self._freedom = np.ones(bodies)
        self._count = 0
        self._before: list[tuple[Fit, Real]] = []

    def add(self, fit: Fit) -> None:
        """Take the fits of one frame: residuals (B, n), NaN for a marker that was not seen."""
        self._before.append((fit, mean_square(fit.residual, fit.freedom)[0]))
        if len(self._before) < 3:
            return
        (first, left), (middle, own), (last, right) = self._before
        self._before = self._before[1:]
        bend = middle.residual - (first.residual + last.residual) / 2
        # White residuals add up to 1 + 1/4 + 1/4 of what each frame has to expect.
        expected = middle.freedom + (first.freedom + last.freedom) / 4
        row, freedom = mean_square(bend, expected)
        self._freedom = np.where(np.isnan(row), self._freedom, freedom / 1.5)
        place = self._count % _KEPT
        self._squares[:, place] = row
        self._own[:, place] = own
        self._most[:, place] = np.maximum(own, np.maximum(left, right))
        self._count += 1

    def forget_neighbors(self) -> None:
        """Do not compare the next residual with those before a gap."""
        self._before = []

    def level(self) -> Real:
        """
        Standard deviation (B,) of one coordinate of one marker; NaN while not known.

        From the mean of the squares without those of wild frames, less the largest tenth: a median
        would call a tracker that rounds its coordinates free of noise, and a plain mean believes
        every jump.
        """
        filled = slice(max(1, min(self._count, _KEPT)))
        usual = tame_part(self._own[:, filled])
        tame = ~(self._most[:, filled] > _FAR * usual[:, None])
        known = np.sort(np.where(tame, self._squares[:, filled], np.nan))
        counts = (~np.isnan(known)).sum(axis=-1)
        kept = np.ceil(counts * (1 - _WILD))
        lowest = np.where(np.arange(known.shape[1]) < kept[:, None], known, 0.0).sum(axis=-1)
        share = [_share_of_lowest(round(float(f), 1)) for f in self._freedom]
        with np.errstate(divide='ignore', invalid='ignore'):
            return np.sqrt(np.where(counts > 0, lowest / kept / share, np.nan))


def tame_part(values: Real) -> Real:
    """What (B,) all but the worst three tenths of the values (B, m) stay below, NaN left out."""
    ranked = np.sort(values)  # NaN come last
    place = np.ceil(_TAME * np.maximum((~np.isnan(ranked)).sum(axis=-1) - 1, 0)).astype(int)
    return np.asarray(ranked[np.arange(len(ranked)), place])


def mean_square(residual: Complex, expected: Real) -> tuple[Real, Real]:
    """Squares (B,) of residuals (B, n) per degree of freedom, NaN for none, and the degrees."""
    seen = ~np.isnan(residual)
    squares = np.where(seen, residual.real**2 + residual.imag**2, 0).sum(axis=-1)
    freedom = np.where(seen, expected, 0).sum(axis=-1)
    enough = freedom > 0.5
    return np.where(enough, squares / np.where(enough, freedom, 1.0), np.nan), freedom


@lru_cache(maxsize=1024)
def _share_of_lowest(freedom: float) -> float:
    """Mean of the tame part of a chi-square over its mean (Wilson and Hilferty 1931)."""
    levels = (np.arange(200) + 0.5) / 200 * (1 - _WILD)
    normal = np.array([NormalDist().inv_cdf(level) for level in levels])
    cube = np.maximum(1 - 2 / (9 * freedom) + normal * np.sqrt(2 / (9 * freedom)), 0)
    return float((cube**3).mean())
