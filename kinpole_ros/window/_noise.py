"""
The noise of the markers, measured without any model of the motion.

What a rigid fit leaves over is noise, but also whatever makes a body look not quite rigid: a lens,
a marker that sits off the plane, a shape not yet known well. That part changes slowly, so each
residual is compared with the mean of the ones before and after it, which white noise survives.
"""

from functools import lru_cache
from statistics import NormalDist

import numpy as np

from kinpole_ros.planar import Fit
from kinpole_ros.planar._plane import Real

# How many frames the level is taken from, and which share of them may be wild.
_KEPT = 512
_WILD = 0.1


class Noise:
    """Running noise level (m, per axis) of B bodies, from the residuals of their rigid fits."""

    def __init__(self, bodies: int) -> None:
        self._squares = np.full((_KEPT, bodies), np.nan)
        self._freedom = np.ones(bodies)
        self._count = 0
        self._before: list[Fit] = []

    def add(self, fit: Fit) -> None:
        """Take the fits of one frame: residuals (B, n), NaN for a marker that was not seen."""
        self._before.append(fit)
        if len(self._before) < 3:
            return
        first, middle, last = self._before
        self._before = self._before[1:]
        bend = middle.residual - (first.residual + last.residual) / 2
        seen = ~np.isnan(bend)
        squares = np.where(seen, bend.real**2 + bend.imag**2, 0).sum(axis=-1)
        # White residuals add up to 1 + 1/4 + 1/4 of what each frame has to expect.
        expected = middle.freedom + (first.freedom + last.freedom) / 4
        freedom = np.where(seen, expected, 0).sum(axis=-1) / 1.5
        enough = freedom > 0.5
        self._freedom = np.where(enough, freedom, self._freedom)
        row = np.where(enough, squares / (1.5 * self._freedom), np.nan)
        self._squares[self._count % _KEPT] = row
        self._count += 1

    def forget_neighbors(self) -> None:
        """Do not compare the next residual with those before a gap."""
        self._before = []

    def level(self) -> Real:
        """
        Standard deviation (B,) of one coordinate of one marker; NaN while not known.

        From the mean of the squares less the largest tenth: a median would call a tracker that
        rounds its coordinates free of noise, and a plain mean believes every jump.
        """
        known = np.sort(self._squares[: self._count], axis=0)  # NaN come last
        counts = (~np.isnan(known)).sum(axis=0)
        kept = np.ceil(counts * (1 - _WILD))
        lowest = np.where(np.arange(len(known))[:, None] < kept, known, 0.0).sum(axis=0)
        share = [_share_of_lowest(round(float(f), 1)) for f in self._freedom]
        with np.errstate(divide='ignore', invalid='ignore'):
            return np.sqrt(np.where(counts > 0, lowest / kept / share, np.nan))


@lru_cache(maxsize=1024)
def _share_of_lowest(freedom: float) -> float:
    """Mean of the tame part of a chi-square over its mean (Wilson and Hilferty 1931)."""
    levels = (np.arange(200) + 0.5) / 200 * (1 - _WILD)
    normal = np.array([NormalDist().inv_cdf(level) for level in levels])
    cube = np.maximum(1 - 2 / (9 * freedom) + normal * np.sqrt(2 / (9 * freedom)), 0)
    return float((cube**3).mean())
