"""
The shapes of the bodies, learned from the frames as they come.

Each frame is fitted to the shape known so far and then moves it a little: a running generalized
Procrustes mean (Gower 1975). A fitted frame's residuals neither turn nor shift the shape, so poses
found early and late stay comparable and nothing has to be fitted twice. Once known well below the
noise it is held, unless the residuals refute it: so a bad frame leaves no trace in later poses.
"""

from collections import Counter

import numpy as np

from kinpole_ros.planar import Fit, fit_pose
from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.window._noise import mean_square, tame_part
from kinpole_ros.window._untangle import EXCHANGED, half_turn, untangle

# A marker's place is held from so many frames on, when it is known to a twentieth of the noise. It
# is learned on (a marker that creeps) while its residuals, averaged over as many frames, are off by
# more than this share of what residuals come to as a rule.
_MEMORY, _REFUTED = 1000, 0.25
# A marker is suspect beyond this many times what residuals come to as a rule, which is known from
# so many frames on and taken from so many, each counted for no more than so many times the rule.
_SUSPECT = 6.0
_MATURE, _RULE_MEMORY, _RULE_CLIP = 20, 200, 9.0
# What all but the worst three tenths of chi-squares stay below, over their mean, within a tenth.
_RULE_SHARE = 1.15
# What is less than this share of the body's size is rounding.
_TINY = 1e-6
# A marker that does not fit in so many frames running sits elsewhere now.
_MOVED = 100
# rad. A body has jumped by half a turn, its markers exchanged, if it is turned this far from where
# it was to be; known while it turns by less than the other and was seen so many frames ago at most.
_HALF_TURN, _SLOW, _RECENT = 0.75 * np.pi, 0.25 * np.pi, 3


class Shapes:
    """
    Shapes of B bodies of up to n markers, in each body's own frame.

    `points` (B, n) are where the markers are, complex, m; `known` (B,) how many of them have been
    seen so far, and `spread` (B,) the sum of their squares about their mean, m^2.
    """

    def __init__(self, bodies: int, markers: int) -> None:
        self.points = np.zeros((bodies, markers), complex)
        self._frames = np.zeros((bodies, markers))
        self._drift = np.zeros((bodies, markers), complex)
        self._astray = np.zeros((bodies, markers), int)
        self._left = np.full((bodies, _RULE_MEMORY), np.nan)
        self._rule = np.zeros(bodies)
        self._fits = np.zeros(bodies, int)
        self._before = np.full((bodies, markers), complex(np.nan, np.nan))
        # The last angle found, the turn per frame that led to it, and how many frames ago that was.
        self._angle = np.full(bodies, np.nan)
        self._turning = np.full(bodies, np.nan)
        self._ago = np.ones(bodies, int)
        # Frames running in which it turned slowly, and in which it was turned back.
        self._calm = np.zeros(bodies, int)
        self._turned = np.zeros(bodies, int)
        self.mended: Counter[str] = Counter()
        self._measure()

    def fit(self, points: Complex) -> tuple[Fit, Complex]:
        """
        Fit the poses of one frame, `points` (B, n), NaN for a marker that was not seen, and learn.

        A body's frame starts where it is first seen: its origin at the mean of the markers seen
        then, its axes along the ground's. Bodies of which fewer than two known markers are seen,
        or of which all coincide, get NaN. Markers that do not fit their body, or that turn it by
        half a turn in one frame, are left out or put back, see `untangle` and `half_turn`, and
        counted in `mended`. Returns the fit and the markers it is of.
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
            self._measure()
        # A marker known from N frames has 1 + 1/N times the variance of a well-known one.
        weights = np.where(seen, self._frames / (self._frames + 1.0), 0.0)
        fit = fit_pose(points, self.points, weights)
        points, weights, fit = self._turn_back(points, weights, fit)
        points, weights, fit = self._mend(points, weights, fit)
        self._follow(fit.angle)
        self._learn(points, fit, new)
        return fit, points

    def forget_motion(self) -> None:
        """Do not expect the next poses to go on from those before a gap."""
        self._angle[:] = np.nan

    def _learn(self, points: Complex, fit: Fit, new: np.ndarray) -> None:
        """Move the shapes towards where the markers were found, but those of `new` bodies."""
        turned = np.exp(-1j * fit.angle)[:, None]
        off = (points - fit.position[:, None]) * turned - self.points
        learned = ~np.isnan(off) & ~new[:, None]
        settled = self._frames >= _MEMORY
        self._frames[learned] = np.minimum(self._frames[learned] + 1.0, _MEMORY)
        # Twice the gain of a plain mean, so that a poor start is forgotten.
        step = 2.0 / (1.0 + self._frames) * np.where(learned, off, 0.0)
        self._drift += step - np.where(learned, 2.0 / (1.0 + self._frames) * self._drift, 0.0)
        held = settled & (np.abs(self._drift) < _REFUTED * np.sqrt(self._least_rule())[:, None])
        if not held.all():
            self.points += np.where(held, 0.0, step)
            self._measure()

    def _least_rule(self) -> Real:
        return np.maximum(self._rule, _TINY**2 * self.spread)

    def _follow(self, angle: Real) -> None:
        """Take the angles (B,) of a frame, NaN for a body not seen, to know the next from."""
        fitted = np.isfinite(angle)
        turning = _wrapped(angle - self._angle) / self._ago
        slow = (np.abs(turning) < _SLOW) & (self._ago <= _RECENT)
        # What is not seen in between may have turned by any number of revolutions.
        calm = np.where(slow, self._calm + (self._ago == 1), 0)
        self._calm = np.where(fitted, calm, self._calm)
        self._turning = np.where(fitted, turning, self._turning)
        self._angle = np.where(fitted, angle, self._angle)
        self._ago = np.where(fitted, 1, self._ago + 1)

    def _turn_back(self, points: Complex, weights: Real, fit: Fit) -> tuple[Complex, Real, Fit]:
        """
        Put back markers that were exchanged so that the body seems to jump by half a turn.

        No residual tells of it: two markers, or a rectangle of them, fit as well as before.
        """
        ahead = self._turning * self._ago
        jumped = np.abs(_wrapped(fit.angle - self._angle - ahead)) > _HALF_TURN
        jumped &= (np.abs(ahead) < _SLOW) & (self._ago <= _RECENT) & (self._calm >= _MATURE)
        limit = _SUSPECT * np.sqrt(self._least_rule())
        # A body lost in its noise may seem to be turned anyhow.
        jumped &= limit**2 < self.spread
        if not jumped.any():
            self._turned[np.isfinite(fit.angle)] = 0
            return points, weights, fit
        points = points.copy()
        for b in np.flatnonzero(np.isfinite(fit.angle)):
            order = half_turn(self.points[b], weights[b], limit[b]) if jumped[b] else None
            self._turned[b] = 0 if order is None else self._turned[b] + 1
            if order is None:
                continue
            if self._turned[b] <= _MOVED:
                points[b] = points[b, order]
                self.mended[EXCHANGED] += int((order != np.arange(len(order))).sum())
                continue
            # Exchanged for good: the names stand for each other's places, and no pose jumps.
            for kept in (self.points, self._frames, self._drift, weights):
                kept[b] = kept[b, order]
            self._turned[b] = 0
        return points, weights, fit_pose(points, self.points, weights)

    def _mend(self, points: Complex, weights: Real, fit: Fit) -> tuple[Complex, Real, Fit]:
        """Untangle the bodies that fit far worse than they do as a rule, and learn that rule."""
        farthest = np.where(np.isnan(fit.residual), 0.0, np.abs(fit.residual)).max(axis=-1)
        left = mean_square(fit.residual, fit.freedom)[0]
        rule = self._least_rule()
        limit = _SUSPECT * np.sqrt(rule)
        suspect = (self._fits >= _MATURE) & (farthest > limit)
        clipped = np.where(self._fits < _MATURE, left, np.minimum(left, _RULE_CLIP * rule))
        # A body at rest in a tracker that rounds seems to fit to the last digit, until it moves.
        still = ((points == self._before) | (weights == 0)).all(axis=-1)
        self._learn_rule(np.where(still, np.nan, clipped))
        self._before = points
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
                self._drift[b, moved] = 0.0
                self._astray[b, moved] = 0
                self._left[b] = np.nan
                self._fits[b] = 0
        return points, weights, fit_pose(points, self.points, weights)

    def _learn_rule(self, left: Real) -> None:
        """Take the mean squares (B,) that the fits of a frame leave, NaN for a body not fitted."""
        fitted = np.flatnonzero(~np.isnan(left))
        self._left[fitted, self._fits[fitted] % _RULE_MEMORY] = left[fitted]
        self._fits[fitted] += 1
        # A mean would believe what is wild before it is known to be.
        self._rule[fitted] = tame_part(self._left[fitted]) / _RULE_SHARE

    def widen(self, markers: int) -> None:
        """Make room for up to `markers` markers."""
        more = ((0, 0), (0, markers - self.points.shape[1]))
        self.points = np.pad(self.points, more)
        self._frames = np.pad(self._frames, more)
        self._astray = np.pad(self._astray, more)
        self._before = np.pad(self._before, more, constant_values=complex(np.nan, np.nan))
        self._drift = np.pad(self._drift, more)

    def _measure(self) -> None:
        """Keep how large the bodies are, which is asked for several times a frame."""
        known = self._frames > 0
        self.known = known.sum(axis=-1)
        mean = np.where(known, self.points, 0).sum(axis=-1) / np.maximum(self.known, 1)
        offsets = np.where(known, self.points - mean[:, None], 0)
        self.spread = (offsets.real**2 + offsets.imag**2).sum(axis=-1)

    def markers(self) -> Complex:
        """Where the markers (B, n) are in their bodies' frames, NaN for those not seen yet."""
        return np.where(self._frames > 0, self.points, complex(np.nan, np.nan))

    def misfit(self) -> Real:
        """
        Variance (B,) of one coordinate of a marker about its place, m^2; NaN while not known.

        As rigid fits leave it: noise, and whatever makes a body look not quite rigid.
        """
        return np.where(self._fits >= _MATURE, self._rule, np.nan)


def _wrapped(angle: Real) -> Real:
    """Angles in [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
