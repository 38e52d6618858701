"""
The noise of the markers, measured without any model of the motion.

What a rigid fit leaves over is noise, but also whatever makes a body look not quite rigid: a lens,
a marker that sits off the plane, a shape not yet known well. That part changes slowly, so each
residual is compared with the mean of the ones before and after it, which white noise survives.
"""

import numpy as np

from kinpole_ros.planar import Fit
from kinpole_ros.planar._plane import Real

_KEPT = 129


class Noise:
    """Running noise level (m, per axis) of B bodies, from the residuals of their rigid fits."""

    def __init__(self, bodies: int) -> None:
        self._squares = np.full((_KEPT, bodies), np.nan)
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
        freedom = np.where(enough, freedom, 1.0)
        # The median of a chi-square of f degrees of freedom (Wilson and Hilferty 1931).
        median = 1.5 * freedom * (1 - 2 / (9 * freedom)) ** 3
        self._squares[self._count % _KEPT] = np.where(enough, squares / median, np.nan)
        self._count += 1

    def forget_neighbors(self) -> None:
        """Do not compare the next residual with those before a gap."""
        self._before = []

    def level(self) -> Real:
        """Standard deviation (B,) of one coordinate of one marker; NaN while not known."""
        known = self._squares[: self._count]
        if not len(known):
            return np.full(known.shape[1], np.nan)
        if np.isnan(known).any():
            counts = (~np.isnan(known)).sum(axis=0)
            filled = np.sort(np.where(np.isnan(known), np.inf, known), axis=0)
            middle = filled[np.maximum(counts - 1, 0) // 2, np.arange(known.shape[1])]
            return np.sqrt(np.where(counts > 0, middle, np.nan))
        return np.sqrt(np.median(known, axis=0))
