"""
The shapes of the bodies: learned from the frames, and what tells which markers cannot be right.

Frames are fitted to the shape known so far and then move it a little: a running generalized
Procrustes mean (Gower 1975). A fitted frame's residuals neither turn nor shift the shape, so poses
found early and late stay comparable and nothing has to be fitted twice. Once known well below the
noise it is held, unless the residuals refute it: so a bad frame leaves no trace in later poses.

The shape moves only at a beat, for all frames since the last one, so that a stretch of frames can
be fitted at once, and a frame comes out the same whether it is in a stretch or alone.
"""

from collections import Counter
from typing import NamedTuple, Protocol

import numpy as np

from kinpole_ros.planar import Fit, fit_by_grip, fit_pose, grip_of
from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.rigid._continuity import Continuity, Verdict
from kinpole_ros.rigid._marker_noise import MarkerNoise
from kinpole_ros.rigid._noise import mean_square, tame_part
from kinpole_ros.rigid._turn import Turns
from kinpole_ros.rigid._untangle import EXCHANGED, agreed, correct_markers, half_turn
from kinpole_ros.rigid.levels import FEW, SURE, TINY

# A marker's place is held from so many frames on, when it is known to a twentieth of the noise. It
# is learned on (a marker that creeps) while its residuals, averaged over as many frames, are off by
# more than this share of what residuals come to as a rule.
_MEMORY, _CONTRADICTED = 1000, 0.25
# Frames between two beats: this share of those that the least known marker was seen in.
_BEAT = 1 / 8
# A marker is suspect beyond this many times what residuals come to as a rule, to which no frame
# counts for more than so many times the rule. Until that is known a marker is suspect beyond this
# share of the body's size, more than its noise may be, and only names are doubted by it.
_SUSPECT, _YOUNG_SUSPECT = 6.0, 0.03
_RULE_CLIP = SURE**2
# What all but the worst three tenths of chi-squares stay below, over their mean, within a tenth.
_RULE_SHARE = 1.15
# A marker that does not fit in so many frames running sits elsewhere from the next beat on, and
# markers that are exchanged in so many have changed their names.
_MOVED = 100
# They are no rule by then.
_RULE_MEMORY = 2 * _MOVED


class _News(NamedTuple):
    """What frames tell of the shapes, kept until a beat: (T, B, n), or (T, B) for the poses."""

    points: Complex
    position: Complex
    angle: Real
    residual: Complex
    freedom: Real


class Names(Protocol):
    """Corrects which point of a frame is which marker, where that is not as the names have it."""

    def doubtful(self, fit: Fit, unseen: np.ndarray) -> np.ndarray | None:
        """Which frames (T,) may have markers that are `unseen` (T, B, n) under other names."""

    def correct(self, row: int, before: list[Fit]) -> bool:
        """Whether points of the frame were exchanged in place; `before` are the fits up to it."""


class Shapes:
    """
    Shapes of B bodies of up to n markers, in each body's own frame.

    `points` (B, n) are where the markers are, complex, m; `limit` (B,) how far off a marker may be
    by what residuals come to, or by the size while that is not known, m; `known` (B,) how many of
    them have been seen so far, and `spread` (B,) the sum of their squares about their mean, m^2;
    `beat` is in how many frames from the last time on `learn` is to be called; `farthest` (B,) is
    how far, m, from the origin of the ground the markers seen last before that were. `corrected`
    counts, see `correct_markers`; `stand_in` (B, n) says which marker goes on where each one was at
    first, for some are exchanged for good.
    """

    def __init__(self, bodies: int, markers: int) -> None:
        self.points = np.zeros((bodies, markers), complex)
        self.corrected: Counter[str] = Counter()
        self.stand_in = np.tile(np.arange(markers), (bodies, 1))
        self.farthest = np.zeros(bodies)
        self._frames = np.zeros((bodies, markers))
        # One for a marker that the last beat began with: no news of it yet.
        self._first = np.zeros((bodies, markers))
        self._drift = np.zeros((bodies, markers), complex)
        self._astray = np.zeros((bodies, markers), int)
        self._left = np.full((bodies, _RULE_MEMORY), np.nan)
        self._rule = np.zeros(bodies)
        self._fits = np.zeros(bodies, int)
        # The markers of bodies whose first frames are still to be looked at, frame by frame.
        self._early: list[list[Complex] | None] = [[] for _ in range(bodies)]
        self._before = np.full((bodies, markers), complex(np.nan, np.nan))
        self._turns = Turns(bodies)
        self._continuity = Continuity(bodies)
        self._marker_noise = MarkerNoise(bodies, markers)
        # Frames running in which markers of a body were exchanged, and which took whose place.
        self._exchanged = np.zeros(bodies, int)
        self._order = np.tile(np.arange(markers), (bodies, 1))
        # Whether any of these, or of those astray, is not zero.
        self._disturbed = False
        self._news: list[_News] = []
        self._measure()

    def unseen(self, points: Complex) -> int:
        """How many of the frames `points` (T, B, n) go by before a body is seen the first time."""
        if not len(self._unmet):
            return len(points)
        begun = _makes_a_body(points[:, self._unmet]).any(axis=-1)
        return int(begun.argmax()) if begun.any() else len(points)

    def begin(self, points: Complex) -> None:
        """
        Take the bodies not seen before from the frame `points` (B, n), at a beat.

        A body's frame starts where it is first seen: its origin at the mean of the markers seen
        then, its axes along the ground's.
        """
        new = (self.known == 0) & _makes_a_body(points)
        seen = new[:, None] & ~np.isnan(points)
        count = np.maximum(seen.sum(axis=-1, keepdims=True), 1)
        mean = np.where(seen, points, 0).sum(axis=-1, keepdims=True) / count
        self.points = np.where(seen, points - mean, self.points)
        self._frames[seen] = self._first[seen] = 1.0
        self._measure()

    def give(self, points: Complex) -> None:
        """
        Begin with shapes (B, n) that are known, NaN for none; poses are of their frames.

        They are learned on like any other, since what is drawn is rarely what was built.
        """
        given = ~np.isnan(points)
        self.points = np.where(given, points, self.points)
        self._frames[given] = 1.0
        for b in np.flatnonzero(given.any(axis=1)):
            # Its frame is not that of any first frames.
            self._early[b] = None
        self._measure()

    def restart(self, which: np.ndarray) -> None:
        """Forget the bodies `which` (B,), at a beat: they begin anew as they are seen next."""
        for part in (self.points, self._frames, self._first, self._drift):
            part[which] = 0.0
        for counter in (self._astray, self._exchanged, self._fits):
            counter[which] = 0
        self._order[which] = np.arange(self._order.shape[1])
        self._left[which] = np.nan
        self._rule[which] = 0.0
        for b in np.flatnonzero(which):
            self._early[b] = []
        self._turns.forget()
        self._continuity.begin(which)
        self._marker_noise.forget(which[:, None])
        self._measure()

    def fit(
        self, points: Complex, stamps: np.ndarray, least: Real, names: Names | None = None
    ) -> tuple[Fit, Complex, Verdict]:
        """
        Fit the poses of some frames, `points` (T, B, n), NaN for a marker that was not seen.

        With `names`, those of a frame that does not fit are corrected first.

        Bodies of which fewer than two known markers are seen, or of which all coincide, get NaN,
        and so do those of which all there are have no less than the spread `least` (B,), m^2, but
        those seen do. Markers that do not fit their body, or that turn it by half a turn in one
        frame, are left out or put back, see `correct_markers` and `half_turn`, and counted in
        `corrected`. Returns the fits, the markers they are of, and how the poses go on, by `stamps`
        (T,), ns.
        """
        parts: list[tuple[Fit, Complex, Verdict]] = []
        few = self.spread > least
        most = self._most if names is None else self._doubt
        frames, corrected = len(points), False
        while len(points):
            unseen = np.isnan(points)
            grip = self._grip
            hidden = np.count_nonzero(unseen)
            if hidden:
                grip = grip_of(self.points, np.where(unseen, 0.0, self._weights))
            fit = fit_by_grip(points, grip)
            shown = _without(fit, few & (fit.spread < least))
            far = fit.residual.real**2 + fit.residual.imag**2 > most
            odd = np.logical_or.reduce(far, axis=(1, 2)) | self._turns.may_jump(fit.angle)
            odd |= self._continuity.odd(stamps, shown.angle, shown.position)
            if names is not None and hidden:
                doubtful = names.doubtful(fit, unseen)
                odd = odd if doubtful is None else odd | doubtful
            quiet = int(odd.argmax()) if np.count_nonzero(odd) else len(points)
            if quiet:
                before = points
                if quiet < len(points):
                    fitted, shown = (Fit(*(f[:quiet] for f in each)) for each in (fit, shown))
                    before = points[:quiet]
                else:
                    fitted = fit
                turns = self._continuity.follow(quiet)
                self._take(fitted, before, fitted.residual, fitted.freedom)
                if self._disturbed:
                    self._in_place(~np.isnan(fitted.residual).all(axis=0))
                    self._disturbed = bool(self._astray.any() or self._exchanged.any())
                none = np.zeros(turns.shape, int)
                parts.append((shown, before, Verdict(turns, none, none)))
                corrected = False
            if quiet < len(points) and names is not None and not corrected:
                points, stamps = points[quiet:], stamps[quiet:]
                if names.correct(frames - len(points), [part[0] for part in parts]):
                    # Its names are as good as they get.
                    corrected = True
                    continue
                fit, quiet = Fit(*(field[quiet:] for field in fit)), 0
            corrected = False
            if quiet < len(points):
                here = Fit(*(field[quiet] for field in fit))
                fitted, markers, *left = self._correct(points[quiet], here)
                shown = _without(fitted, few & (fitted.spread < least))
                pose = shown.angle, shown.position
                verdict = self._continuity.step(int(stamps[quiet]), *pose)
                held = np.where(verdict.suspect > 0, np.nan, fitted.angle)
                self._take(fitted._replace(angle=held), markers, *left)
                parts.append((shown, markers, verdict))
            points, stamps = points[quiet + 1 :], stamps[quiet + 1 :]
        if len(parts) == 1:
            return parts[0]
        fits, seen, verdicts = zip(*parts, strict=True)
        whole = Fit(*(np.concatenate(field) for field in zip(*fits, strict=True)))
        course = Verdict(*(np.concatenate(field) for field in zip(*verdicts, strict=True)))
        return whole, np.concatenate(seen), course

    def were_at(self, times: np.ndarray) -> None:
        """The newest frames that were fitted turned out to be at `times` (T,), ns."""
        self._continuity.were_at(times)

    def forget_motion(self) -> None:
        """Do not expect the next poses to go on from those before a gap."""
        self._turns.forget()
        self._continuity.forget()

    @property
    def deviation(self) -> Real:
        """Deviations (B, n), m, of markers that err more than others and count for less, else 0."""
        return self._marker_noise.deviation

    def of_the_same(self, residual: Complex) -> Complex:
        """Residuals (T, B, n) of markers that err equally: without those that count for less."""
        less = self._marker_noise.relative > 1
        return np.where(less, complex(np.nan, np.nan), residual) if less.any() else residual

    def weighted(self, residual: Complex) -> Complex:
        """Residuals (T, B, n) of markers as if all erred equally: over what each errs as a rule."""
        relative = self._marker_noise.relative
        return residual / np.sqrt(relative) if (relative > 1).any() else residual

    def weigh(self, residual: Complex, freedom: Real, goes_on: np.ndarray) -> np.ndarray:
        """
        Give markers the weights that they are worth, at a beat after `learn`.

        By fits as `MarkerNoise.learn` takes them. Returns of which bodies (B,) other markers count
        for less from now on: their poses change.
        """
        changed = self._marker_noise.learn(residual, freedom, goes_on, self.points)
        for b in np.flatnonzero(changed).tolist():
            # As it would have been with these weights.
            left = mean_square(*self.refitted(b)[:2])[0]
            left = left[~np.isnan(left)][-_RULE_MEMORY:]
            if len(left) >= FEW:
                self._fits[b] = len(left)
                self._left[b] = np.nan
                self._left[b, : len(left)] = left
                self._rule[b] = tame_part(left[None])[0] / _RULE_SHARE
        if (self._marker_noise.relative != 1).any() or changed.any():
            self._measure()
        if changed.any():
            self._continuity.begin(changed)
        return changed

    def refitted(self, b: int) -> tuple[Complex, Real, np.ndarray]:
        """Late frames of one body as fitted by the weights of now: see `MarkerNoise.refitted`."""
        return self._marker_noise.refitted(b, self.points[b])

    def learn(self) -> np.ndarray:
        """
        Move the shapes towards where the markers were found since the last beat.

        Returns which bodies (B,) begin anew, since markers were outliers in their first frames: the
        poses up to now are not theirs.
        """
        anew = np.zeros(len(self.points), bool)
        self._continuity.learn(2 * np.sqrt(self.spread / np.maximum(self.known, 1)))
        if not self._news:
            return anew
        news = _News(*map(np.concatenate, zip(*self._news, strict=True)))
        self._news = []
        # Now, not ever: a marker gone wild once, before that can be told, is no reason for more.
        far = np.fmax.reduce(np.abs(news.points), (0, 2))
        self.farthest = np.where(np.isnan(far), self.farthest, far)
        turned = np.exp(-1j * news.angle)[..., None]
        off = (news.points - news.position[..., None]) * turned - self.points
        seen = ~np.isnan(off)
        count = np.maximum(seen.sum(axis=0) - self._first, 0)
        known = self._frames
        # What is left of the old place by steps of 2 / (frames + 1): twice the gain of a plain
        # mean, so that a poor start is forgotten.
        kept = known * (known + 1) / np.maximum((known + count) * (known + count + 1), 1)
        mean = np.where(seen, off, 0).sum(axis=0) / np.maximum(count, 1)
        step = np.where(count > 0, (1 - kept) * mean, 0)
        settled = known >= _MEMORY
        self._drift = np.where(count > 0, kept * self._drift, self._drift) + step
        self._frames = np.minimum(known + count, _MEMORY)
        self._first[:] = 0.0
        held = settled & (
            np.abs(self._drift) < _CONTRADICTED * np.sqrt(self._least_rule())[:, None]
        )
        self.points += np.where(held, 0.0, step)
        self._learn_rule(news)
        moved = self._astray >= _MOVED
        self._marker_noise.forget(moved)
        if moved.any():
            # Learned anew where it is from the next frame on; a body none of which fits, too.
            self._frames[moved] = self._drift[moved] = 0.0
            self._astray[moved] = 0
            body = moved.any(axis=-1)
            self._left[body] = np.nan
            self._fits[body] = 0
        for b in np.flatnonzero(self._exchanged >= _MOVED):
            # Exchanged for good: the names stand for each other's places, and no pose jumps.
            for kept in (self.points, self._frames, self._drift, self._before):
                kept[b, self._order[b]] = kept[b].copy()
            self.stand_in[b] = self._order[b, self.stand_in[b]]
            self._exchanged[b] = 0
            # What was left with the names of before is no rule.
            self._left[b] = np.nan
            self._marker_noise.forget(np.arange(len(self.points))[:, None] == [[b]])
        for b, early in enumerate(self._early):
            if early is not None and self._fits[b] >= FEW:
                anew[b] = self._look_back(b, np.array(early))
                self._early[b] = None
        if anew.any():
            self._turns.forget()
            self._continuity.begin(anew)
            self._marker_noise.forget(anew[:, None])
        self._measure()
        return anew

    def _look_back(self, b: int, points: Complex) -> bool:
        """
        Begin a body anew by most of its first frames (T, n), if markers are outliers in the others.

        Until what residuals come to is known nobody can tell, and what is wild would spoil the
        shape for long: see `agreed`.
        """
        found = agreed(points, _SUSPECT / np.sqrt(_RULE_SHARE), TINY)
        if found is None:
            return False
        self.points[b], fits, corrected = found
        self.corrected.update(corrected)
        self._frames[b] = (~np.isnan(fits.residual)).sum(axis=0)
        self._drift[b] = 0.0
        self._astray[b] = self._exchanged[b] = 0
        left = mean_square(fits.residual, fits.freedom)[0]
        left = left[~np.isnan(left)][-_RULE_MEMORY:]
        self._fits[b] = len(left)
        self._left[b] = np.nan
        self._left[b, : len(left)] = left
        self._rule[b] = tame_part(left[None])[0] / _RULE_SHARE
        return True

    def _take(self, fit: Fit, points: Complex, residual: Complex, freedom: Real) -> None:
        """Keep what frames tell until the beat, residuals as before the frames were corrected."""
        self._news.append(_News(points, fit.position, fit.angle, residual, freedom))
        self._turns.follow(fit.angle)

    def _in_place(self, fits: np.ndarray) -> None:
        """Note the markers (B, n) that fit where they are: neither astray nor exchanged now."""
        self._astray[fits] = 0
        fits = fits & (self._order != np.arange(fits.shape[1]))
        self._exchanged[fits.any(axis=-1)] = 0

    def _least_rule(self) -> Real:
        return np.maximum(self._rule, TINY**2 * self.spread)

    def _correct(self, points: Complex, fit: Fit) -> tuple[Fit, Complex, Complex, Real]:
        """
        Put right what can be of one frame (B, n); as `fit` gives it, with an axis of one.

        Also the residuals and freedoms as they were.
        """
        points, weights = points.copy(), np.where(np.isnan(points), 0.0, self._weights)
        order = np.tile(np.arange(points.shape[1]), (len(points), 1))
        fit = self._turn_back(points, weights, order, fit)
        residual, freedom = fit.residual[None], fit.freedom[None]
        with np.errstate(invalid='ignore'):
            most = self._limit[:, None] * np.sqrt(self._marker_noise.relative)
            far = (np.abs(fit.residual) > most).any(axis=-1) & self._mature
        good = ~(far[:, None] | np.isnan(fit.residual))
        ahead = self._turns.ahead()
        for b in np.flatnonzero(far):
            erring = np.sqrt(self._marker_noise.relative[b])
            found = correct_markers(
                points[b],
                self.points[b],
                self._weights[b],
                float(self._limit[b]),
                float(ahead[b]),
                erring,
            )
            out = np.isnan(found.points[found.order.argsort()]) & (weights[b] > 0)
            self._astray[b] = np.where(out, self._astray[b] + 1, 0)
            points[b], order[b] = found.points, order[b, found.order]
            weights[b] = np.where(np.isnan(points[b]), 0.0, self._weights[b])
            self.corrected.update(found.counts)
        changed = (order != np.arange(order.shape[1])).any(axis=-1)
        # The places of hidden markers are not known.
        again = ((order == self._order) | np.isnan(points)).all(axis=-1)
        order = np.where(again[:, None], self._order, order)
        running = np.where(again, self._exchanged + 1, 1)
        self._in_place(good)
        self._exchanged[changed], self._order[changed] = running[changed], order[changed]
        fit = Fit(*(field[None] for field in fit_pose(points, self.points, weights)))
        # An exchange accounts for the residuals of the markers.
        residual[0, changed], freedom[0, changed] = (
            fit.residual[0, changed],
            fit.freedom[0, changed],
        )
        self._disturbed = True
        return fit, points[None], residual, freedom

    def _turn_back(self, points: Complex, weights: Real, order: np.ndarray, fit: Fit) -> Fit:
        """
        Put back markers that were exchanged so that a body seems to jump by half a turn.

        No residual tells of it: two markers, or a rectangle of them, fit as well as before. Which
        marker (B, n) took whose place is written to `order`.
        """
        # A body lost in its noise may seem to be turned anyhow.
        jumped = self._turns.jumped(fit.angle) & (self._limit**2 < self.spread)
        for b in np.flatnonzero(jumped):
            found = half_turn(self.points[b], weights[b], float(self._limit[b]))
            if found is not None:
                points[b], order[b] = points[b, found], found
                self.corrected[EXCHANGED] += int((found != np.arange(len(found))).sum())
        return fit_pose(points, self.points, weights) if jumped.any() else fit

    def _learn_rule(self, news: '_News') -> None:
        """Take the mean squares that the fits of frames leave."""
        left = mean_square(self.of_the_same(news.residual), news.freedom)[0]
        most = np.where(self._fits < FEW, np.inf, _RULE_CLIP * self._least_rule())
        # A body at rest in a tracker that rounds seems to fit to the last digit, until it moves.
        before = np.concatenate((self._before[None], news.points[:-1]))
        idle = np.isnan(news.points) | (self._weights == 0)
        still = ((news.points == before) | idle).all(axis=-1)
        self._before = news.points[-1]
        left = np.where(still, np.nan, np.minimum(left, most))
        fitted = ~np.isnan(left)
        for b, early in enumerate(self._early):
            if early is not None:
                early.extend(news.points[fitted[:, b], b])
        frame, body = np.nonzero(fitted)
        place = self._fits + np.cumsum(fitted, axis=0) - 1
        self._left[body, place[frame, body] % _RULE_MEMORY] = left[frame, body]
        self._fits += fitted.sum(axis=0)
        # A mean would believe what is wild before it is known to be.
        some = fitted.any(axis=0)
        self._rule[some] = tame_part(self._left[some]) / _RULE_SHARE

    def widen(self, markers: int) -> None:
        """Make room for up to `markers` markers, at a beat."""
        more = ((0, 0), (0, markers - self.points.shape[1]))
        self.points = np.pad(self.points, more)
        self._frames = np.pad(self._frames, more)
        self._first = np.pad(self._first, more)
        self._astray = np.pad(self._astray, more)
        self._before = np.pad(self._before, more, constant_values=complex(np.nan, np.nan))
        self._drift = np.pad(self._drift, more)
        self._marker_noise.widen(markers)
        self._early = [
            early and [np.pad(row, more[1], constant_values=np.nan) for row in early]
            for early in self._early
        ]
        new = np.tile(np.arange(self.stand_in.shape[1], markers), (len(self.points), 1))
        self.stand_in = np.hstack((self.stand_in, new))
        self._order = np.hstack((self._order, new))
        self._measure()

    def _measure(self) -> None:
        """Keep what is asked for in every frame and changes only at a beat."""
        known = self._frames > 0
        self.known = known.sum(axis=-1)
        self._unmet = np.flatnonzero(self.known == 0)
        mean = np.where(known, self.points, 0).sum(axis=-1) / np.maximum(self.known, 1)
        offsets = np.where(known, self.points - mean[:, None], 0)
        self.spread = (offsets.real**2 + offsets.imag**2).sum(axis=-1)
        # A marker known from N frames has 1 + 1/N times the variance of a well-known one.
        self._weights = self._frames / (self._frames + 1.0) / self._marker_noise.relative
        self._limit = _SUSPECT * np.sqrt(self._least_rule())
        self._mature = self._fits >= FEW
        # What all frames share in which every marker is seen, as a rule all there are.
        most = np.where(self._mature, self._limit**2, np.inf)[:, None]
        # A marker that is known to err more may do so.
        self._most = most * self._marker_noise.relative
        size = 2 * np.sqrt(self.spread / np.maximum(self.known, 1))
        young = np.maximum(_YOUNG_SUSPECT * size, 2 * self._limit)
        self.limit = np.where(self._mature, self._limit, young)
        self._doubt = (self.limit**2)[:, None] * self._marker_noise.relative
        self._grip = grip_of(self.points, self._weights)
        least = self._frames.min(where=known, initial=_MEMORY)
        self.beat = max(1, int(least * _BEAT))

    @property
    def held(self) -> Real:
        """The `spread` and `weight` (2 B,) of a `Fit` of all known markers."""
        return np.concatenate((self._grip.spread, self._grip.weight))

    @property
    def middle(self) -> Complex:
        """The weighted means (B,) of the markers in their bodies' frames."""
        return self._grip.mean

    def middle_of(self, residual: Complex) -> Complex:
        """The same (T, B) of those alone that a fit with this `residual` (T, B, n) is of."""
        seen = ~np.isnan(residual)
        if np.count_nonzero(seen) == seen.size:
            return np.broadcast_to(self.middle, residual.shape[:-1])
        weights = np.where(seen, self._weights, 0.0)
        with np.errstate(divide='ignore', invalid='ignore'):
            return np.asarray((weights * self.points).sum(axis=-1) / weights.sum(axis=-1))

    def markers(self) -> Complex:
        """Where the markers (B, n) are in their bodies' frames, NaN for those not seen yet."""
        return np.where(self._frames > 0, self.points, complex(np.nan, np.nan))

    def misfit(self) -> Real:
        """
        Variance (B,) of one coordinate of a marker about its place, m^2; NaN while not known.

        As rigid fits leave it: noise, and whatever makes a body look not quite rigid.
        """
        return np.where(self._mature, self._rule, np.nan)


def _without(fit: Fit, lost: np.ndarray) -> Fit:
    """Fits without the poses that are `lost` (T, B)."""
    if not np.count_nonzero(lost):
        return fit
    nowhere = np.where(lost, np.nan, 0.0)
    return fit._replace(angle=fit.angle + nowhere, position=fit.position + nowhere)


def _makes_a_body(points: Complex) -> np.ndarray:
    """Where (...) there are two markers, not at one place, in `points` (..., n)."""
    seen = ~np.isnan(points)
    count = seen.sum(axis=-1)
    mean = np.where(seen, points, 0).sum(axis=-1) / np.maximum(count, 1)
    arms = np.where(seen, points - mean[..., None], 0)
    # Markers all at one place, as of a tracker that has not found them yet, are no shape.
    return np.asarray((count >= 2) & (np.abs(arms).max(axis=-1) > ROUNDING * np.abs(mean)))
