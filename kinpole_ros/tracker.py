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
from kinpole_ros.frame import MarkerFrames
from kinpole_ros.parameters import Settings
from kinpole_ros.roster import Roster
from kinpole_ros.window import (
    FEWEST_SAMPLES,
    STRIKES,
    LandmarkFilter,
    Noise,
    Pins,
    PoseFilter,
    References,
    Samples,
    Shapes,
    Windows,
    alike,
    joined,
    runs,
    seen_at,
)

# Coordinates are known no better than a few units of their last place.
_ROUNDING = 4 * np.finfo(float).eps
# rad. An angle noisier than this wanders round, and its errors are no longer small.
_UNSTEADY = 0.15
# Markers are not of one rigid body that are off it by so many times their noise and by this share
# of its size.
_LOOSE, _LOOSE_SHARE = 5.0, 0.01
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
    gaps: np.ndarray


def _frame_type(bodies: int) -> np.dtype:
    """What is held of a frame, in one row; what is of angles comes before what is of positions."""
    columns: list[tuple] = [
        ('stamp', np.int64),
        # While it waits: its number among the frames that were given together, and which of what
        # was known is as of then; the oldest frame in the window, and the mean interval, ns.
        ('number', np.int64),
        ('beat', np.int64),
        ('oldest', np.int64),
        ('interval', float),
        # Angles with whole turns, as what comes between -pi and pi goes on, and positions.
        ('poses', float, (2 * bodies, 2)),
        # Inverse variances over that of a coordinate of a marker, 0 for a body not seen.
        ('information', float, (2 * bodies,)),
        ('height', float, (bodies,)),
        ('strayed', bool, (bodies,)),
    ]
    return np.dtype(columns, align=True)


def _known_type(bodies: int, width: int) -> np.dtype:
    """What is known of the bodies from one beat to the next, in one row."""
    columns: list[tuple] = [
        ('noise', float, (bodies,)),
        ('measured', bool, (bodies,)),
        ('firm', bool, (bodies,)),
        ('size', float, (bodies,)),
        ('pin', complex, (bodies,)),
        ('pin_variance', float, (bodies,)),
        ('pin_since', np.int64, (bodies,)),
        ('reference', complex, (bodies,)),
        ('middle', complex, (bodies,)),
        ('shape', complex, (bodies, width)),
    ]
    return np.dtype(columns, align=True)


class Tracker:
    """
    Follows the bodies of `settings` from frame to frame.

    `samples` is how many frames the window holds. `counts` says what became of the frames, for
    diagnostics: frames, repeated, late, resets, frame_changes, markers_not_seen, markers_unknown,
    and the markers_... that were mended, see `window.untangle`.
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
        self._shapes = Shapes(count, self._roster.width)
        self._noise = Noise(count)
        self._pins = Pins(count)
        self._references = References(count, self._window)
        self._filter = PoseFilter()
        self._landmark_filter = LandmarkFilter()
        self._frames = Samples((), _frame_type(count))
        self._last_angle = np.zeros(count)
        self._last_turn = np.zeros(count)
        self._points: Samples | None = None
        if self.settings.method == 'landmarks':
            self._points = Samples((count, self._roster.width), complex)
        self.samples = 0
        # Mean time between the frames of the window, ns, 0 for fewer than two.
        self._interval = 0.0
        self._since = 0
        self._due = 0
        self._dropped = 0
        # Frames since the last beat, at which the bodies' shapes, noise and pins are learned.
        self._news: list[_News] = []
        self._new = 0
        # How many frames wait to be estimated, and what was known with them, now in the last row
        # unless something was learned since.
        self._waiting = 0
        self._known = Samples((), _known_type(count, self._roster.width))
        self._learned = True

    @property
    def interval(self) -> float:
        """Mean time between the frames of the window in s; NaN for fewer than two."""
        return self._interval * 1e-9 if self.samples > 1 else float('nan')

    def noise(self) -> np.ndarray:
        """Noise (B,) of one coordinate of a marker, m, given or measured; NaN while not known."""
        if self.settings.noise > 0:
            return np.full(len(self.bodies), self.settings.noise)
        return np.maximum(self._noise.level(), _ROUNDING * self._shapes.farthest)

    def looseness(self) -> np.ndarray:
        """
        How far (B,) markers are off one rigid body, m, per axis; 0 where they may well be of one.

        No noise accounts for it: the markers are of several links, or their body bends.
        """
        off, noise = np.sqrt(self._shapes.misfit()), self._noise.level()
        loose = (off > _LOOSE * noise) & (off > _LOOSE_SHARE * self._size())
        return np.where(loose, off, 0.0)

    def lacking(self) -> dict[str, list[str]]:
        """Markers by body that the last message has not, where less than two of the body are."""
        named = self.settings.bodies
        lacks = dict(zip(self.bodies, self._roster.absent, strict=False))
        return {b: names for b, names in lacks.items() if len(named[b]) - len(names) < 2 and names}

    @property
    def identities(self) -> tuple[str, ...]:
        """The markers that the last message has."""
        return self._roster.identities

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
            if not len(stamps):
                continue
            self.counts['frames'] += len(stamps)
            if frames.frame_id != self._frame_id:
                if len(self._frames):
                    found += self._estimates(order)
                    self.counts['frame_changes'] += 1
                    self.reset()
                self._frame_id = frames.frame_id
            first = 0
            while first < len(stamps):
                steps, end = self._sift(stamps[first:])
                new = (steps > 0).nonzero()[0]
                if len(new):
                    taken, place = frames, first + new
                    if len(new) < len(stamps):
                        taken = frames._replace(stamps=stamps[place], points=frames.points[place])
                    points, heights = self._roster.sort(taken)
                    if self._roster.width > self._shapes.points.shape[1]:
                        found += self._estimates(order)
                        self._widen()
                    self._run(taken.stamps, steps[new], points, heights, before + place)
                first += end
                if first < len(stamps):
                    found += self._estimates(order)
                    self.counts['resets'] += 1
                    self.reset()
            self._last = int(stamps[-1])
            before += len(stamps)
        return found + self._estimates(order)

    def settle(self) -> None:
        """Learn and judge what is due, while nobody waits for it; else the next `add` does."""
        self._filter.settle()
        if self._new >= self._shapes.beat:
            self._learn()

    def _sift(self, stamps: np.ndarray) -> tuple[np.ndarray, int]:
        """
        Up to where frames of `stamps` (T,) go on, T if nothing starts anew, and how far each is
        ahead of all before it, ns: it is one to take where that is positive.
        """
        last, newest = self._last, int(stamps[0]) - 1
        if len(self._frames):
            newest = int(self._frames.view()['stamp'][-1])
        else:
            last = newest
        ahead = stamps - np.concatenate(((newest,), stamps[:-1]))
        if np.minimum.reduce(ahead) > 0 and np.maximum.reduce(ahead) <= self._window:
            return ahead, len(stamps)
        # As it is when each frame comes.
        reached = np.maximum.accumulate(np.concatenate(((newest,), stamps[:-1])))
        before = np.concatenate(((last,), stamps[:-1]))
        ahead = stamps - reached
        back = (before < reached) & (before < stamps) & (ahead <= 0)
        anew = back | (np.abs(ahead) > self._window)
        end = int(anew.argmax()) if anew.any() else len(stamps)
        ahead = ahead[:end]
        self.counts['late'] += int((ahead < 0).sum())
        self.counts['repeated'] += int((ahead == 0).sum())
        return ahead, end

    def _run(
        self,
        stamps: np.ndarray,
        steps: np.ndarray,
        points: np.ndarray,
        heights: np.ndarray,
        numbers: np.ndarray,
    ) -> None:
        """Take frames that go on by `steps` from those before; `numbers` (T,) are theirs."""
        self.counts['markers_unknown'] = self._roster.unknown
        seen = points.size - np.count_nonzero(np.isnan(points))
        self.counts['markers_not_seen'] += self._roster.wanted * len(points) - seen
        if not len(self._frames):
            self._since = int(stamps[0])
        rows = self._frames.room(len(stamps))
        gaps = self._enter(rows, stamps, steps)
        rows['number'] = numbers
        first = 0
        while first < len(stamps):
            if self._new >= self._shapes.beat:
                self._learn()
            room = self._shapes.beat - self._new
            unseen = self._shapes.unseen(points[first : first + room])
            if not unseen:
                self._learn()
                self._shapes.begin(points[first])
                self._learned = True
                unseen = 1
            end = first + unseen
            later = gaps[first + 1 : end].nonzero()[0]
            if len(later):
                end = first + 1 + int(later[0])
            part = slice(first, end)
            self._take(rows[part], points[part], heights[part], gaps[part])
            rows['beat'][part] = self._known_now()
            first = end
        self._waiting += len(rows)

    def _enter(self, rows: np.ndarray, stamps: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Note the windows of frames; returns which (T,) come much later than those before did."""
        rows['stamp'] = stamps
        every = self._frames.view()['stamp']
        oldest = every.searchsorted(stamps - self._window)
        held = np.arange(len(every) - len(rows), len(every)) - oldest
        interval = (stamps - every[oldest]) / np.maximum(held, 1)
        rows['oldest'], rows['interval'] = oldest, interval
        # As the window was before the frame came.
        before = np.concatenate(((self._interval,), interval[:-1]))
        self.samples, self._interval = int(held[-1]) + 1, float(interval[-1])
        return (steps > _LATE * before) & (before > 0)

    def _known_now(self) -> int:
        """The row of what is known now."""
        if self._learned:
            self._learned = False
            known, pins, noise = self._known.room(1), self._pins, self.noise()
            known['noise'] = np.where(noise > 0, noise, 1.0)
            known['measured'] = np.isfinite(noise)
            known['firm'] = noise**2 < _UNSTEADY**2 * self._shapes.spread
            known['size'] = self._size()
            known['pin'], known['pin_variance'] = pins.center, pins.variance
            known['pin_since'] = pins.since
            # On a pin the poles are the pin, and relative centers are best where a lens bends two
            # bodies alike: from velocities at the origins of both.
            references = self._references
            known['reference'] = np.where(np.isfinite(pins.center), 0.0, references.point)
            known['middle'] = references.middle
            known['shape'] = self._shapes.markers()
        return len(self._known) - 1

    def _take(
        self, rows: np.ndarray, points: np.ndarray, heights: np.ndarray, gaps: np.ndarray
    ) -> None:
        """Fit the poses of frames between which nothing is learned and no gap is."""
        if gaps[0]:
            self._shapes.forget_motion()
        fit, points = self._shapes.fit(points)
        if self._shapes.mended:
            self.counts.update(self._shapes.mended)
            self._shapes.mended.clear()
            self._learned = True
        known = np.isfinite(fit.angle)
        information = np.concatenate((fit.spread, fit.weight), axis=-1)
        if np.count_nonzero(known) < known.size:
            information[np.concatenate((~known, ~known), axis=-1)] = 0.0
        count = len(self.bodies)
        poses = rows['poses']
        poses[:, :count, 0], poses[:, :count, 1] = fit.angle, self._turned(fit.angle, known)
        poses[:, count:, 0], poses[:, count:, 1] = fit.position.real, fit.position.imag
        rows['information'] = information
        seen = ~np.isnan(points)
        with np.errstate(invalid='ignore'):
            total = np.add.reduce(heights, -1, where=seen)
            rows['height'] = total / np.add.reduce(seen, -1)
        rows['strayed'] = False
        if np.count_nonzero(np.isfinite(self._pins.center)):
            variance = self._variance(information)
            rows['strayed'] = self._pins.strayed(fit.position, fit.angle, variance)
        if self._points is not None:
            # One line goes on, whatever the marker is called.
            stand_in = np.broadcast_to(self._shapes.stand_in, points.shape)
            self._points.room(len(points))[...] = np.take_along_axis(points, stand_in, axis=-1)
        self._news.append(
            _News(
                rows['stamp'].copy(),
                fit.position,
                fit.angle,
                information,
                fit.residual,
                fit.freedom,
                gaps,
            )
        )
        self._new += len(rows)

    def _turned(self, angle: np.ndarray, known: np.ndarray) -> np.ndarray:
        """How often (T, B) the bodies have turned round when they are at `angle`, where `known`."""
        if np.count_nonzero(known) < known.size:
            # Where nothing is known it is as it was.
            rows = np.where(known, np.arange(1, len(angle) + 1)[:, None], 0)
            before = np.concatenate((self._last_angle[None], np.where(known, angle, 0.0)))
            angle = np.take_along_axis(before, np.maximum.accumulate(rows, axis=0), axis=0)
        steps = angle - np.concatenate((self._last_angle[None], angle[:-1]))
        turns = self._last_turn - np.add.accumulate(np.rint(steps / (2 * np.pi)))
        self._last_angle, self._last_turn = angle[-1], turns[-1]
        return np.asarray(turns)

    def _learn(self) -> None:
        """A beat: learn the bodies' shapes, noise and pins from the frames since the last one."""
        if not self._new:
            return
        size = self._size()
        news = _News(*map(np.concatenate, zip(*self._news, strict=True)))
        self._news, self._new = [], 0
        self._learned = True
        if self._points is None:
            variance = self._variance(news.information)
            poses = news.stamps, news.position, news.angle, variance, size
            self._pins.add(*poses)
            self._references.add(*poses, self._shapes.middle)
        self._noise.add(news.residual, news.freedom, ~news.gaps)
        self._shapes.learn()

    def _variance(self, information: np.ndarray) -> np.ndarray:
        """Variances (T, 2, B) of one coordinate of the positions, and of the angles."""
        of_angle_first = information.reshape(len(information), 2, -1)
        with np.errstate(divide='ignore', invalid='ignore'):
            return np.asarray(self._misfit() / of_angle_first[:, ::-1])

    def _misfit(self) -> np.ndarray:
        """Variance (B,) of one coordinate of a marker, of all that keeps it off its place."""
        rounding = _ROUNDING * self._shapes.farthest
        return np.maximum(self._shapes.misfit(), max(self.settings.noise, rounding) ** 2)

    def _size(self) -> np.ndarray:
        """Diameters (B,) of the bodies: twice the rms distance of their markers from the mean."""
        return np.asarray(2 * np.sqrt(self._shapes.spread / np.maximum(self._shapes.known, 1)))

    def _trim(self, count: int) -> None:
        """Drop so many frames that no window to come holds."""
        self._frames.drop(count)
        if self._points is not None:
            self._points.drop(count)
        self._due = max(0, self._due - count)
        self._dropped += count

    def _widen(self) -> None:
        """A body of all markers has more of them."""
        self._learn()
        self._shapes.widen(self._roster.width)
        self._known = Samples((), _known_type(len(self.bodies), self._roster.width))
        self._learned = True
        if self._points is not None:
            # The landmarks of the new ones are not known in the frames before.
            old = self._points.view()
            wide = np.full((len(old), 1, self._roster.width), complex(np.nan, np.nan))
            wide[..., : old.shape[-1]] = old
            self._points = Samples(wide.shape[1:], complex)
            self._points.room(len(wide))[...] = wide

    def _estimates(self, order: int | None) -> list[Estimate]:
        """
        What falls due with the frames that wait: to wait for one more would trail beyond lag.

        Each instant is seen as of the frame it falls due with, whatever has come since: by what was
        known then.
        """
        if not self._waiting:
            return []
        frames = self._frames.view()
        new, known = frames[-self._waiting :], self._known.view()
        self._waiting = 0
        self._known.drop(len(known) - 1)
        ahead = np.rint(self.settings.lag * 1e9 - 0.75 * new['interval'])
        last = new['stamp'] - ahead.astype(np.int64)
        oldest, newest = new['oldest'], np.arange(len(frames) - len(new), len(frames))
        end = np.minimum(frames['stamp'].searchsorted(last, side='right'), newest + 1)
        end = np.maximum.accumulate(np.maximum(end, self._due))
        due = np.arange(self._due, end[-1])
        self._due = int(end[-1])
        found = []
        if order is not None and len(due):
            frame = end.searchsorted(due, side='right')
            full = (newest - oldest)[frame] >= FEWEST_SAMPLES - 1
            seen = (full & (due >= oldest[frame])).nonzero()[0]
            if len(seen):
                frame = frame[seen]
                windows = due[seen], oldest[frame], newest[frame]
                then = known[new['beat'][frame]]
                found.append(self._estimate(windows, order, new['number'][frame], then))
        self._trim(int(oldest[-1]))
        return found

    def _estimate(
        self, windows: Windows, order: int, due: np.ndarray, known: np.ndarray
    ) -> Estimate:
        """The frames `windows[0]` (T,), as those from `windows[1]` to `windows[2]` tell of them."""
        frames = self._frames.view()[windows[0]]
        seen = frames['information'][:, : len(self.bodies)] > 0
        measured, firm = known['measured'], known['firm']
        usable = seen & measured & firm
        differentiated = self._from_poses if self._points is None else self._from_landmarks
        found, together, reference = differentiated(windows, known, order)
        position, angle, position_covariance, angle_covariance, span, degree = found
        if np.count_nonzero(usable) < usable.size:
            for array in (*found, *(together or ())):
                array[..., ~usable] = np.nan
        enough = np.isfinite(angle[1]) & np.isfinite(position[1])
        missing = np.empty(seen.shape, object)
        missing.fill('')
        if np.count_nonzero(enough) < enough.size:
            missing[~enough] = 'window not full'
            missing[~firm] = 'markers too close together for their noise'
            missing[~measured] = 'noise not known yet'
            missing[~seen] = 'too few markers seen, or all at one place'
        return Estimate(
            frames['stamp'],
            self._frame_id,
            self.bodies,
            position,
            angle,
            position_covariance,
            angle_covariance,
            known['size'],
            frames['height'],
            span,
            degree,
            missing,
            self._since,
            *self._pinned(windows, known),
            known['shape'],
            due,
            together,
            reference,
        )

    def _pinned(self, windows: Windows, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Fixed pins (T, B) of the bodies, complex, NaN for none, and their variance.

        A pin holds for the whole window or not at all.
        """
        pin, variance = known['pin'], known['pin_variance']
        held = np.isfinite(pin)
        if not np.count_nonzero(held):
            return pin, variance
        _, oldest, newest = windows
        frames = self._frames.view()
        held &= known['pin_since'] <= frames['stamp'][oldest, None]
        strayed = frames['strayed']
        if np.count_nonzero(strayed):
            times = strayed.cumsum(axis=0)
            held &= times[newest] - times[oldest] + strayed[oldest] < STRIKES
        return (
            np.where(held, pin, complex(np.nan, np.nan)),
            np.where(held, variance, np.nan),
        )

    def _from_poses(
        self, windows: Windows, known: np.ndarray, order: int
    ) -> tuple[tuple[np.ndarray, ...], Poses | None, np.ndarray | None]:
        """
        Derivatives of the fitted poses, angle and position each by itself and together.

        Also of which points (T, B) of the bodies the positions are, None for the origins.
        """
        now = windows[0]
        count = len(self.bodies)
        frames = self._frames.view()
        signals = frames['poses'].copy()
        angles, turns = signals[:, :count, 0], signals[:, :count, 1]
        turned = 2 * np.pi * (turns - turns[0])
        angles += turned
        turns[...] = 0.0
        reach = FARTHEST * known['size']
        found = []
        numbers = now + self._dropped
        noise = np.concatenate((known['noise'], known['noise']), axis=1)
        first = 0
        for part in alike(known['reference']):
            row = known[part.start]
            poses = signals, frames['information']
            if np.count_nonzero(row['reference']):
                poses = seen_at(row['reference'], row['middle'], *poses)
            some = tuple(frame[part] for frame in windows)
            for run in runs(frames['stamp'], some, *poses, noise[part]):
                end = first + run[1].shape[1]
                found.append(
                    self._filter.derivatives(numbers[first:end], *run, reach[first:end], order)
                )
                first = end
        parts = joined(found)
        apart, together = parts[:6], Poses(*parts[6:])
        # Of all turns that are one, as it was measured.
        for angle in (apart[1], together.angle):
            angle[0] -= turned[now]
        return apart, together, known['reference']

    def _from_landmarks(
        self, windows: Windows, known: np.ndarray, order: int
    ) -> tuple[tuple[np.ndarray, ...], Poses | None, np.ndarray | None]:
        """The same from the derivatives of each landmark."""
        assert self._points is not None
        frames = self._frames.view()
        found = self._landmark_filter.derivatives(
            frames['stamp'], windows, self._points.view(), known['noise'], order
        )
        found[1][0] = frames['poses'][windows[0], : len(self.bodies), 0]
        return found, None, None
