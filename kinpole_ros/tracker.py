"""
The one pipeline: frames of markers in, motion of bodies out.

Node and replay both call it and nothing else does the job, so what is seen live is what a bag
gives: the one hands it frame by frame, the other many at once, and what they get is the same.
Header stamps drive it; it never asks for the time.
"""

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from kinpole_ros.estimate import FARTHEST, Estimate, Poses
from kinpole_ros.frame import MarkerFrames, part_of
from kinpole_ros.parameters import Settings
from kinpole_ros.roster import Roster
from kinpole_ros.window import (
    FEWEST_SAMPLES,
    STRIKES,
    LandmarkFilter,
    Noise,
    Pins,
    PoseFilter,
    Samples,
    Shapes,
    Windows,
    joined,
    runs,
)

# Coordinates are known no better than a few units of their last place.
_ROUNDING = 4 * np.finfo(float).eps
# rad. An angle noisier than this wanders round, and its errors are no longer small.
_UNSTEADY = 0.15
# Frames later than this many intervals of late come after a gap.
_LATE = 2.5


class _News(NamedTuple):
    """Frames that were taken since the last beat: fits, and what is left of them, (T, ...)."""

    stamps: np.ndarray
    position: np.ndarray
    angle: np.ndarray
    information: np.ndarray  # (T, 2 B)
    residual: np.ndarray
    freedom: np.ndarray
    goes_on: np.ndarray


class _Known(NamedTuple):
    """What is known of the bodies from one beat to the next, (B,), or (T, B) for some frames."""

    noise: np.ndarray
    size: np.ndarray
    spread: np.ndarray
    pin: np.ndarray
    pin_variance: np.ndarray
    pin_since: np.ndarray
    shape: np.ndarray  # (B, n)


class Tracker:
    """
    Follows the bodies of `settings` from frame to frame.

    `counts` says what became of the frames, for diagnostics: frames, repeated, late, resets,
    frame_changes, markers_not_seen, markers_unknown, and the markers_... that were mended, see
    `window.untangle`.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.bodies = tuple(settings.bodies)
        self.counts: Counter[str] = Counter()
        self._window = round(settings.window * 1e9)
        self._frame_id = ''
        # The stamp of the frame that came last, taken or not.
        self._last = 0
        self.reset()

    def reset(self) -> None:
        """Forget all samples, and the shapes and noise learned from them."""
        count = len(self.bodies)
        self._roster = Roster(self.settings)
        self._learned: _Known | None = None
        self._shapes = Shapes(count, self._roster.width)
        self._noise = Noise(count)
        self._pins = Pins(count)
        self._filter = PoseFilter()
        self._landmark_filter = LandmarkFilter()
        self._stamps = Samples((), np.int64)
        self._positions = Samples((count,), complex)
        self._angles = Samples((count,), float)
        # Whole turns, as what comes between -pi and pi goes on.
        self._turns = Samples((count,), float)
        self._last_angle = np.zeros(count)
        self._last_turn = np.zeros(count)
        self._information = Samples((2 * count,), float)
        self._heights = Samples((count,), float)
        self._strayed = Samples((count,), bool)
        self._points: Samples | None = None
        if self.settings.method == 'landmarks':
            self._points = Samples((count, self._roster.width), complex)
        self._largest = 0.0
        self._since = 0
        self._due = 0
        self._dropped = 0
        # Frames since the last beat, at which the bodies' shapes, noise and pins are learned.
        self._news: list[_News] = []
        self._new = 0
        # The frames that wait to be estimated: numbers, and places in what was known with them.
        self._waiting: list[tuple[np.ndarray, np.ndarray]] = []
        self._known_then: list[_Known] = []

    @property
    def samples(self) -> int:
        """How many frames the window holds."""
        return len(self._in_window())

    @property
    def interval(self) -> float:
        """Mean time between the frames of the window in s; NaN for fewer than two."""
        stamps = self._in_window()
        if len(stamps) < 2:
            return float('nan')
        return float(stamps[-1] - stamps[0]) * 1e-9 / (len(stamps) - 1)

    def _in_window(self) -> np.ndarray:
        """Stamps of the frames in the window; others are held for estimates that wait."""
        stamps = self._stamps.view()
        return stamps[stamps.searchsorted(stamps[-1] - self._window) :] if len(stamps) else stamps

    def noise(self) -> np.ndarray:
        """Noise (B,) of one coordinate of a marker, m, given or measured; NaN while not known."""
        if self.settings.noise > 0:
            return np.full(len(self.bodies), self.settings.noise)
        return np.maximum(self._noise.level(), _ROUNDING * self._largest)

    def add(self, frames: MarkerFrames, order: int | None) -> list[Estimate]:
        """
        Take frames; return what is now known, stamped `lag` earlier, an instant for most frames.

        `order` is the highest derivative wanted now (1 to 4), None for no estimates at all. A stamp
        seen already is left out, and so is a frame that comes late: before the newest, within the
        window. Everything starts anew with another frame_id, with a stamp farther from the newest
        than the window, and where stamps go on from a late one: then the clock has stepped back.
        """
        return self.add_parts((frames,), order)

    def add_parts(self, parts: Iterable[MarkerFrames], order: int | None) -> list[Estimate]:
        """
        The same of frames in parts, at less cost than one by one.

        Each is taken before the next is asked for: then the tracker is as it was with the last
        frame of that part. Instants are `due` by the number of the frame in all parts.
        """
        found: list[Estimate] = []
        before = 0
        for frames in parts:
            stamps = np.asarray(frames.stamps)
            self.counts['frames'] += len(stamps)
            if frames.frame_id != self._frame_id:
                if len(self._stamps):
                    found += self._estimates(order)
                    self.counts['frame_changes'] += 1
                    self.reset()
                self._frame_id = frames.frame_id
            first = 0
            while first < len(stamps):
                new, end = self._sift(stamps[first:])
                new += first
                if len(new) == end:
                    taken = part_of(frames, slice(first, first + end))
                else:
                    taken = frames._replace(stamps=stamps[new], points=frames.points[new])
                if len(new):
                    points, heights = self._roster.sort(taken)
                    if self._roster.width > self._shapes.points.shape[1]:
                        found += self._estimates(order)
                        self._widen()
                    self._run(taken.stamps, points, heights, before + new)
                first += end
                if first < len(stamps):
                    found += self._estimates(order)
                    self.counts['resets'] += 1
                    self.reset()
            self._last = int(stamps[-1])
            before += len(stamps)
        return found + self._estimates(order)

    def settle(self) -> None:
        """Learn what is due, while nobody waits for it; else the next `add` does."""
        if self._new >= self._shapes.beat:
            self._learn()

    def _sift(self, stamps: np.ndarray) -> tuple[np.ndarray, int]:
        """Which frames of `stamps` (T,) to take, and which starts everything anew, T for none."""
        last, newest = self._last, int(stamps[0]) - 1
        if len(self._stamps):
            newest = int(self._stamps.view()[-1])
        else:
            last = newest
        # As it is when each frame comes.
        reached = np.maximum.accumulate(np.concatenate(((newest,), stamps[:-1])))
        before = np.concatenate(((last,), stamps[:-1]))
        ahead = stamps - reached
        back = (before < reached) & (before < stamps) & (ahead <= 0)
        anew = back | (np.abs(ahead) > self._window)
        end = int(anew.argmax()) if anew.any() else len(stamps)
        ahead = ahead[:end]
        new = np.flatnonzero(ahead > 0)
        if len(new) < end:
            late = int((ahead < 0).sum())
            self.counts['late'] += late
            self.counts['repeated'] += end - len(new) - late
        return new, end

    def _run(
        self, stamps: np.ndarray, points: np.ndarray, heights: np.ndarray, numbers: np.ndarray
    ) -> None:
        """Take frames whose stamps go on from those before; `numbers` (T,) are theirs."""
        self.counts['markers_unknown'] = self._roster.unknown
        wanted = self._roster.wanted * len(points)
        self.counts['markers_not_seen'] += wanted - int((~np.isnan(points)).sum())
        if not len(self._stamps):
            self._since = int(stamps[0])
        gaps = self._gaps(stamps)
        beat = np.empty(len(stamps), int)
        first = 0
        while first < len(stamps):
            self.settle()
            room = self._shapes.beat - self._new
            unseen = self._shapes.unseen(points[first : first + room])
            if not unseen:
                self._learn()
                self._shapes.begin(points[first])
                self._learned = None
                unseen = room = 1
            end = min(first + min(room, unseen), len(stamps))
            later = np.flatnonzero(gaps[first + 1 : end])
            if len(later):
                end = first + 1 + int(later[0])
            self._take(stamps[first:end], points[first:end], heights[first:end], gaps[first])
            beat[first:end] = len(self._known_then)
            self._known_then.append(self._known())
            first = end
        self._waiting.append((numbers, beat))

    def _known(self) -> _Known:
        if self._learned is None:
            pins = self._pins
            self._learned = _Known(
                self.noise(),
                self._size(),
                self._shapes.spread,
                pins.center.copy(),
                pins.variance.copy(),
                pins.since.copy(),
                self._shapes.markers(),
            )
        return self._learned

    def _gaps(self, stamps: np.ndarray) -> np.ndarray:
        """Which frames (T,) come much later than the frames before them did."""
        known = self._stamps.view()
        every = np.concatenate((known, stamps))
        last = len(known) + np.arange(len(stamps)) - 1
        # As the window is when the frame comes.
        first = np.searchsorted(every, every[last] - self._window)
        with np.errstate(divide='ignore', invalid='ignore'):
            interval = (every[last] - every[first]) / (last - first)
            gaps = stamps - every[last] > _LATE * interval
        if not len(known):
            gaps[0] = False
        return np.asarray(gaps & (last > first))

    def _take(self, stamps: np.ndarray, points: np.ndarray, heights: np.ndarray, gap: bool) -> None:
        """Fit the poses of frames between which nothing is learned and no gap is."""
        if gap:
            self._shapes.forget_motion()
        fit, points = self._shapes.fit(points)
        if self._shapes.mended:
            self.counts.update(self._shapes.mended)
            self._shapes.mended.clear()
            self._learned = None
        seen = ~np.isnan(points)
        largest = np.abs(points).max(where=seen, initial=0.0)
        if largest > self._largest:
            self._largest, self._learned = largest, None
        with np.errstate(divide='ignore', invalid='ignore'):
            height = np.where(seen, heights, 0).sum(axis=-1) / seen.sum(axis=-1)
        known = np.isfinite(fit.angle)
        information = np.concatenate((fit.spread, fit.weight), axis=-1)
        self._stamps.extend(stamps)
        self._positions.extend(fit.position)
        self._angles.extend(fit.angle)
        self._turns.extend(self._turned(fit.angle, known))
        self._information.extend(np.where(np.concatenate((known, known), -1), information, 0.0))
        self._heights.extend(height)
        strayed = np.zeros(known.shape, bool)
        if np.isfinite(self._pins.center).any():
            variance = self._variance(information)
            strayed = self._pins.strayed(fit.position, fit.angle, variance)
        self._strayed.extend(strayed)
        if self._points is not None:
            self._points.extend(points)
        goes_on = np.ones(len(stamps), bool)
        goes_on[0] = not gap
        self._news.append(
            _News(
                stamps,
                fit.position,
                fit.angle,
                information,
                fit.residual,
                fit.freedom,
                goes_on,
            )
        )
        self._new += len(stamps)

    def _turned(self, angle: np.ndarray, known: np.ndarray) -> np.ndarray:
        """How often (T, B) the bodies have turned round when they are at `angle`, where `known`."""
        if not known.all():
            # Where nothing is known it is as it was.
            rows = np.where(known, np.arange(1, len(angle) + 1)[:, None], 0)
            before = np.concatenate((self._last_angle[None], np.where(known, angle, 0.0)))
            angle = np.take_along_axis(before, np.maximum.accumulate(rows, axis=0), axis=0)
        steps = np.diff(angle, axis=0, prepend=self._last_angle[None])
        turns = self._last_turn - np.cumsum(np.rint(steps / (2 * np.pi)), axis=0)
        self._last_angle, self._last_turn = angle[-1], turns[-1]
        return np.asarray(turns)

    def _learn(self) -> None:
        """A beat: learn the bodies' shapes, noise and pins from the frames since the last one."""
        if not self._new:
            return
        size = self._size()
        news = _News(*map(np.concatenate, zip(*self._news, strict=True)))
        self._news, self._new = [], 0
        self._learned = None
        if self._points is None:
            variance = self._variance(news.information)
            self._pins.add(news.stamps, news.position, news.angle, variance, size)
        self._noise.add(news.residual, news.freedom, news.goes_on)
        self._shapes.learn()

    def _variance(self, information: np.ndarray) -> np.ndarray:
        """Variances (T, 2, B) of one coordinate of the positions, and of the angles."""
        of_angle_first = information.reshape(len(information), 2, -1)
        with np.errstate(divide='ignore', invalid='ignore'):
            return np.asarray(self._misfit() / of_angle_first[:, ::-1])

    def _misfit(self) -> np.ndarray:
        """Variance (B,) of one coordinate of a marker, of all that keeps it off its place."""
        rounding = _ROUNDING * self._largest
        return np.maximum(self._shapes.misfit(), max(self.settings.noise, rounding) ** 2)

    def _size(self) -> np.ndarray:
        """Diameters (B,) of the bodies: twice the rms distance of their markers from the mean."""
        return np.asarray(2 * np.sqrt(self._shapes.spread / np.maximum(self._shapes.known, 1)))

    def _trim(self, count: int) -> None:
        """Drop so many frames that no window to come holds."""
        buffers = (
            self._stamps,
            self._positions,
            self._angles,
            self._turns,
            self._information,
            self._heights,
            self._strayed,
            self._points,
        )
        for buffer in buffers:
            if buffer is not None:
                buffer.drop(count)
        self._due = max(0, self._due - count)
        self._dropped += count

    def _widen(self) -> None:
        """A body of all markers has more of them."""
        self._learn()
        self._shapes.widen(self._roster.width)
        self._learned = None
        if self._points is not None:
            # The landmarks of the new ones are not known in the frames before.
            old = self._points.view()
            wide = np.full((len(old), 1, self._roster.width), complex(np.nan, np.nan))
            wide[..., : old.shape[-1]] = old
            self._points = Samples(wide.shape[1:], complex)
            self._points.extend(wide)

    def _estimates(self, order: int | None) -> list[Estimate]:
        """
        What falls due with the frames that wait: to wait for one more would trail beyond lag.

        Each instant is seen as of the frame it falls due with, whatever has come since: by what was
        known then.
        """
        if not self._waiting:
            return []
        if len(self._known_then) == 1:
            # As the live node has it: 10 us less.
            ((numbers, beat),), (then,) = self._waiting, self._known_then
            known = _Known(*(array[None] for array in then))
        else:
            numbers, beat = map(np.concatenate, zip(*self._waiting, strict=True))
            known = _Known(*map(np.array, zip(*self._known_then, strict=True)))
        self._waiting, self._known_then = [], []
        stamps = self._stamps.view()
        frames = np.arange(len(stamps) - len(numbers), len(stamps))
        oldest = np.searchsorted(stamps, stamps[frames] - self._window)
        held = frames - oldest + 1
        slack = 0.75 * (stamps[frames] - stamps[oldest]) / np.maximum(held - 1, 1)
        last = stamps[frames] - np.rint(self.settings.lag * 1e9 - slack).astype(np.int64)
        end = np.minimum(np.searchsorted(stamps, last, side='right'), frames + 1)
        end = np.maximum.accumulate(np.maximum(end, self._due))
        due = np.arange(self._due, end[-1])
        self._due = int(end[-1])
        found = []
        if order is not None and len(due):
            frame = np.searchsorted(end, due, side='right')
            seen = (held[frame] >= FEWEST_SAMPLES) & (due >= oldest[frame])
            if seen.any():
                frame = frame[seen]
                windows = due[seen], oldest[frame], frames[frame]
                then = _Known(*(array[beat[frame]] for array in known))
                found.append(self._estimate(*windows, order, numbers[frame], then))
        self._trim(int(oldest[-1]))
        return found

    def _estimate(
        self,
        now: np.ndarray,
        oldest: np.ndarray,
        newest: np.ndarray,
        order: int,
        due: np.ndarray,
        known: _Known,
    ) -> Estimate:
        """The frames `now` (T,), as the frames from `oldest` to `newest` (T,) tell of them."""
        count = len(self.bodies)
        noise = known.noise
        seen = self._information.view()[now, :count] > 0
        measured = np.isfinite(noise)
        with np.errstate(invalid='ignore'):
            firm = noise**2 < _UNSTEADY**2 * known.spread
        usable = seen & measured & firm
        noise = np.where(noise > 0, noise, 1.0)
        differentiated = self._from_poses if self._points is None else self._from_landmarks
        found, together = differentiated((now, oldest, newest), noise, known.size, order)
        position, angle, position_covariance, angle_covariance, span, degree = found
        if not usable.all():
            for array in (*found, *(together or ())):
                array[..., ~usable] = np.nan
        enough = np.isfinite(angle[1]) & np.isfinite(position[1])
        missing = np.full(seen.shape, '', object)
        if not enough.all():
            missing[~enough] = 'window not full'
            missing[~firm] = 'markers too close together for their noise'
            missing[~measured] = 'noise not known yet'
            missing[~seen] = 'too few markers seen, or all at one place'
        return Estimate(
            self._stamps.view()[now],
            self._frame_id,
            self.bodies,
            position,
            angle,
            position_covariance,
            angle_covariance,
            known.size,
            self._heights.view()[now],
            span,
            degree,
            missing,
            self._since,
            *self._pinned(oldest, newest, known),
            known.shape,
            due,
            together,
        )

    def _pinned(
        self, oldest: np.ndarray, newest: np.ndarray, known: _Known
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Fixed pins (T, B) of the bodies, complex, NaN for none, and their variance.

        A pin holds for the whole window or not at all.
        """
        pinned = np.isfinite(known.pin)
        if not pinned.any():
            return known.pin, known.pin_variance
        held = pinned & (known.pin_since <= self._stamps.view()[oldest][:, None])
        strayed = self._strayed.view()
        if strayed.any():
            before = np.cumsum(np.pad(strayed, ((1, 0), (0, 0))), axis=0)
            held &= before[newest + 1] - before[oldest] < STRIKES
        return (
            np.where(held, known.pin, complex(np.nan, np.nan)),
            np.where(held, known.pin_variance, np.nan),
        )

    def _from_poses(
        self, windows: Windows, noise: np.ndarray, size: np.ndarray, order: int
    ) -> tuple[tuple[np.ndarray, ...], Poses | None]:
        """Derivatives of the fitted poses, angle and position each by itself and together."""
        now = windows[0]
        count = len(self.bodies)
        angles = self._angles.view()
        signals = np.zeros((len(angles), 2 * count, 2))
        turns = self._turns.view()
        signals[:, :count, 0] = angles + 2 * np.pi * (turns - turns[0])
        positions = self._positions.view()
        signals[:, count:, 0], signals[:, count:, 1] = positions.real, positions.imag
        reach = FARTHEST * size
        found = []
        numbers = now + self._dropped
        first = 0
        information, both = self._information.view(), np.concatenate((noise, noise), axis=1)
        for run in runs(self._stamps.view(), windows, signals, information, both):
            end = first + run[1].shape[1]
            found.append(
                self._filter.derivatives(numbers[first:end], *run, reach[first:end], order)
            )
            first = end
        parts = joined(found)
        apart, together = parts[:6], Poses(*parts[6:])
        # Of all turns that are one, as it was measured.
        whole = angles[now] - signals[now, :count, 0]
        for angle in (apart[1], together.angle):
            angle[0] += whole
        return apart, together

    def _from_landmarks(
        self, windows: Windows, noise: np.ndarray, size: np.ndarray, order: int
    ) -> tuple[tuple[np.ndarray, ...], Poses | None]:
        """The same from the derivatives of each landmark."""
        assert self._points is not None
        found = self._landmark_filter.derivatives(
            self._stamps.view(), windows, self._points.view(), noise, order
        )
        found[1][0] = self._angles.view()[windows[0]]
        return found, None
