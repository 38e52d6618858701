"""
The shapes of the bodies, learned from the frames as they come.

Each frame is fitted to the shape known so far and then moves it a little: a running generalized
Procrustes mean (Gower 1975). A fitted frame's residuals neither turn nor shift the shape, so poses
found early and late stay comparable and nothing has to be fitted twice.
"""

import numpy as np

from kinpole_ros.planar import Fit, fit_pose
from kinpole_ros.planar._plane import ROUNDING, Complex, Real

# Beyond this many frames a shape follows slow changes (a marker that creeps) instead of averaging.
_MEMORY = 10_000


class Shapes:
    """Shapes of B bodies of up to n markers, in each body's own frame."""

    def __init__(self, bodies: int, markers: int) -> None:
        self.points = np.zeros((bodies, markers), complex)
        self._frames = np.zeros((bodies, markers))

    def fit(self, points: Complex) -> Fit:
        """
        Fit the poses of one frame, `points` (B, n), NaN for a marker that was not seen, and learn.

        A body's frame starts where it is first seen: its origin at the mean of the markers seen
        then, its axes along the ground's. Bodies of which fewer than two known markers are seen,
        or of which all coincide, get NaN.
        """
        seen = ~np.isnan(points)
        new = (self._frames.sum(axis=-1) == 0) & (seen.sum(axis=-1) >= 2)
        if new.any():
            count = np.maximum(seen.sum(axis=-1, keepdims=True), 1)
            mean = np.where(seen, points, 0).sum(axis=-1, keepdims=True) / count
            arms = np.where(seen, points - mean, 0)
            # Markers all at one place, as of a tracker that has not found them yet, are no shape.
            new &= np.abs(arms).max(axis=-1) > ROUNDING * np.abs(mean[:, 0])
            first = new[:, None] & seen
            self.points[first] = arms[first]
            self._frames[first] = 1.0
        # A marker known from N frames has 1 + 1/N times the variance of a well-known one.
        weights = np.where(seen, self._frames / (self._frames + 1.0), 0.0)
        fit = fit_pose(points, self.points, weights)
        turned = np.exp(-1j * fit.angle)[:, None]
        found = (points - fit.position[:, None]) * turned
        learned = seen & ~np.isnan(found) & ~new[:, None]
        self._frames[learned] += 1.0
        # Twice the gain of a plain mean, so that a poor start is forgotten.
        gain = 2.0 / (1.0 + np.minimum(self._frames[learned], _MEMORY))
        self.points[learned] += gain * (found - self.points)[learned]
        return fit

    def widen(self, markers: int) -> None:
        """Make room for up to `markers` markers."""
        more = ((0, 0), (0, markers - self.points.shape[1]))
        self.points = np.pad(self.points, more)
        self._frames = np.pad(self._frames, more)

    def spread(self) -> Real:
        """Sum of squares (B,) of the known markers about their mean, in m^2."""
        known = self._frames > 0
        count = np.maximum(known.sum(axis=-1), 1)
        mean = self.points.sum(axis=-1, where=known) / count
        offsets = np.where(known, self.points - mean[:, None], 0)
        return np.asarray((np.abs(offsets) ** 2).sum(axis=-1))

    def known(self) -> np.ndarray:
        """How many markers (B,) of each body have been seen so far."""
        return np.asarray((self._frames > 0).sum(axis=-1))
