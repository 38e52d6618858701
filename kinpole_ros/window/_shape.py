"""
The shapes of the bodies, learned from the frames as they come.

Each frame is fitted to the shape known so far and then moves it a little: a running generalized
Procrustes mean (Gower 1975). A fitted frame's residuals neither turn nor shift the shape, so poses
found early and late stay comparable and nothing has to be fitted twice.
"""

from collections import Counter

import numpy as np

from kinpole_ros.planar import Fit, fit_pose
from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.window._untangle import untangle

# Beyond this many frames a shape follows slow changes (a marker that creeps) instead of averaging.
_MEMORY = 10_000
# A marker is suspect beyond this many times what residuals come to as a rule, which is known from
# so many frames on and averaged over so many, each counted for no more than so many times the rule.
_SUSPECT = 6.0
_MATURE, _RULE_MEMORY, _RULE_CLIP = 20, 200, 9.0
# What is less than this share of the body's size is rounding.
_TINY = 1e-6
# A marker that does not fit in so many frames running sits elsewhere now.
_MOVED = 100


class Shapes:
    """Shapes of B bodies of up to n markers, in each body's own frame."""

    def __init__(self, bodies: int, markers: int) -> None:
        self.points = np.zeros((bodies, markers), complex)
        self._frames = np.zeros((bodies, markers))
        self._astray = np.zeros((bodies, markers), int)
        self._rule = np.zeros(bodies)
        self._fits = np.zeros(bodies, int)
        self.mended: Counter[str] = Counter()

    def fit(self, points: Complex) -> tuple[Fit, Complex]:
        """
        Fit the poses of one frame, `points` (B, n), NaN for a marker that was not seen, and learn.

        A body's frame starts where it is first seen: its origin at the mean of the markers seen
        then, its axes along the ground's. Bodies of which fewer than two known markers are seen,
        or of which all coincide, get NaN. Markers that do not fit their body are left out or put
        back, see `untangle`, and counted in `mended`. Returns the fit and the markers it is of.
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
        points, weights, fit = self._mend(points, weights, fit)
        seen = ~np.isnan(points)
        turned = np.exp(-1j * fit.angle)[:, None]
        found = (points - fit.position[:, None]) * turned
        learned = seen & ~np.isnan(found) & ~new[:, None]
        self._frames[learned] += 1.0
        # Twice the gain of a plain mean, so that a poor start is forgotten.
        gain = 2.0 / (1.0 + np.minimum(self._frames[learned], _MEMORY))
        self.points[learned] += gain * (found - self.points)[learned]
        return fit, points

    def _mend(self, points: Complex, weights: Real, fit: Fit) -> tuple[Complex, Real, Fit]:
        """Untangle the bodies that fit far worse than they do as a rule, and learn that rule."""
        square = np.abs(fit.residual) ** 2
        square = np.where(np.isnan(square), 0.0, square)
        with np.errstate(divide='ignore', invalid='ignore'):
            left = square.sum(axis=-1) / fit.freedom.sum(axis=-1)
        left = np.where(np.isfinite(left), left, 0.0)
        rule = np.maximum(self._rule, _TINY**2 * self.spread())
        limit = _SUSPECT * np.sqrt(rule)
        suspect = (self._fits >= _MATURE) & (np.sqrt(square.max(axis=-1)) > limit)
        fitted = np.isfinite(fit.angle)
        self._fits[fitted] += 1
        gain = 1.0 / np.minimum(np.maximum(self._fits, 1), _RULE_MEMORY)
        clipped = np.where(self._fits > _MATURE, np.minimum(left, _RULE_CLIP * rule), left)
        self._rule += np.where(fitted, gain * (clipped - self._rule), 0.0)
        if not suspect.any():
            self._astray[weights > 0] = 0
            return points, weights, fit
        points, weights = points.copy(), weights.copy()
        for b in np.flatnonzero(suspect):
            given = weights[b] > 0
            points[b], what, count = untangle(points[b], self.points[b], weights[b], limit[b])
            self.mended[what] += count
            out = given & np.isnan(points[b])
            weights[b, out] = 0.0
            self._astray[b] = np.where(out, self._astray[b] + 1, 0)
            moved = self._astray[b] >= _MOVED
            if moved.any():
                # Learned anew where it is from the next frame on; a body none of which fits, too.
                self._frames[b, moved] = 0.0
                self._astray[b, moved] = 0
                self._fits[b] = 0
        return points, weights, fit_pose(points, self.points, weights)

    def widen(self, markers: int) -> None:
        """Make room for up to `markers` markers."""
        more = ((0, 0), (0, markers - self.points.shape[1]))
        self.points = np.pad(self.points, more)
        self._frames = np.pad(self._frames, more)
        self._astray = np.pad(self._astray, more)

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
