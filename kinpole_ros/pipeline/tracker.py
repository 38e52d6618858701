"""
The one pipeline: frames of markers in, motion of bodies out.

Node and replay both call it and nothing else does the job, so what is seen live is what a bag
gives: the one hands it frame by frame, the other many at once, and what they get is the same.
Header stamps drive it; it never asks for the time.
"""

import itertools
from collections import Counter
from collections.abc import Iterable
from functools import partial
from threading import Lock
from typing import Any

import numpy as np

from kinpole_ros.derivatives import Derivatives, Poses, Windows, derive_poses
from kinpole_ros.pipeline.bodies import Outage, RigidBodies, one_more, pose_columns
from kinpole_ros.pipeline.estimate import Estimate, FramePoses
from kinpole_ros.pipeline.frame import MarkerFrames, concatenated, part_of
from kinpole_ros.pipeline.landmarks import derive_landmarks
from kinpole_ros.pipeline.matcher import Matcher
from kinpole_ros.pipeline.parameters import Settings, of_poses
from kinpole_ros.pipeline.posed import PosedBodies
from kinpole_ros.pipeline.roster import Roster
from kinpole_ros.pipeline.ticks import StampState
from kinpole_ros.pipeline.timeline import Timeline
from kinpole_ros.rigid import (
    Samples,
    constant_segments,
    seen_at,
)
from kinpole_ros.rigid.levels import RUNNING
from kinpole_ros.rigid.plane import Plane
from kinpole_ros.rigid.scatter import HISTORY
from kinpole_ros.rigid.space import Space, SpaceReport

# Why nothing is estimated, where there is something to be done.
TOO_FEW, NO_POSE = 'too few markers seen, or all at one place', 'no pose of it came'
TOO_CLOSE = 'markers too close together for their noise'
NOISY_POSES = 'the noise of its angle is too large'
# Not by its first stamp, which a bag that loops has again and again.
_run_numbers = itertools.count(1)


class _OneThread:
    """Refuses a second thread; raises RuntimeError."""

    def __init__(self) -> None:
        self._in_use = Lock()

    def __enter__(self) -> None:
        if not self._in_use.acquire(blocking=False):
            raise RuntimeError(
                'this Tracker is at work in another thread; give each thread a Tracker of its own, '
                'or have them take turns'
            )

    def __exit__(self, *_: object) -> None:
        self._in_use.release()


class Tracker:
    """
    Follows the bodies of `settings` from frame to frame.

    `samples` is how many frames the window holds. `counts` says what became of the frames, for
    diagnostics: frames, repeated, late, lost, resets, frame_changes, markers_not_seen,
    markers_unknown, and the markers_... that were corrected, see `correct_markers`.

    Trackers in threads of their own do not meet. One tracker is for one thread at a time: `add`,
    `add_parts`, `settle` and `reset` raise RuntimeError while another thread is in one of them, and
    what they changed may be asked for when they are done.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.bodies = tuple(settings.bodies)
        self._alone = _OneThread()
        self.counts: Counter[str] = Counter()
        # By body, '' for all frames.
        self._outages: dict[str, Outage] = {}
        self._wrong = np.zeros(len(self.bodies), int)
        self._frame_id = ''
        # Whether poses come, and not markers.
        self._posed = False
        self._start(None)

    def reset(self) -> None:
        """Forget all samples, and the shapes and noise learned from them."""
        with self._alone:
            self._start(None)

    def _start(self, before: Timeline | None) -> None:
        """Start anew; `before` a jump of the stamps frames were as in that timeline."""
        count = len(self.bodies)
        if hasattr(self, '_rigid'):
            self._outages, self._wrong = self.outages(), self.wrong()
        settings = self._settings_of_input()
        self._roster = Roster(settings, self._posed)
        width = self._roster.width
        self._space = Space(self.settings.plane, count, width)
        self._roster.plane = self._space.plane
        # The frames before the plane is known: rows, markers, and which come after a gap.
        self._early: list[tuple[np.ndarray, MarkerFrames, np.ndarray]] = []
        self._timeline = Timeline(settings, self.counts, before)
        self._rigid = self._make_bodies()
        self._points: Samples | None = None
        if settings.method == 'landmarks':
            self._points = Samples((count, self._roster.width), complex)
        self._run_number = next(_run_numbers)

    def _settings_of_input(self) -> Settings:
        return of_poses(self.settings) if self._posed else self.settings

    def _make_bodies(self) -> RigidBodies:
        kind = PosedBodies if self._posed else RigidBodies
        window = self._timeline.window
        return kind(self._settings_of_input(), window, self._roster, self.counts)

    @property
    def samples(self) -> int:
        """How many frames the window holds."""
        return self._timeline.samples

    @property
    def interval(self) -> float:
        """Mean time between the frames of the window in s; NaN for fewer than two."""
        return self._timeline.interval * 1e-9 if self.samples > 1 else float('nan')

    def noise(self) -> np.ndarray:
        """Noise (B,) of one coordinate of a marker, m, given or measured; NaN while not known."""
        return self._rigid.noise()

    def angle_noise(self) -> np.ndarray | None:
        """Noise (B,) of the angles of poses that come as such, rad; None where markers come."""
        return self._rigid.angle_noise()

    def rigidity_residual(self) -> np.ndarray:
        """How far (B,) markers are off one rigid body: see `RigidBodies.rigidity_residual`."""
        return self._rigid.rigidity_residual()

    def stamp_state(self) -> StampState | None:
        """How the stamps lie on the clock found behind them; None while too few have come."""
        return self._timeline.stamp_state()

    def causes(self) -> list[str]:
        """What moves the markers of each body against each other: see `RigidBodies.causes`."""
        return self._rigid.causes()

    def noise_underestimated(self) -> np.ndarray:
        """Which bodies (B,) have more noise than can be measured, since it lasts long."""
        return self._rigid.noise_underestimated()

    @property
    def plane(self) -> Plane | None:
        """The plane that figures are in; None while it is to be fitted and not known yet."""
        return self._roster.plane

    def space(self) -> SpaceReport:
        """How the motion lies in space: its tilt against the plane, and what leaves the plane."""
        return self._space.report()

    def erring(self) -> dict[str, dict[str, float]]:
        """
        Deviations, m, per axis, of markers, by name, that count for less than the others of their
        body, since they err more.
        """
        found = {}
        for b, row in enumerate(self._rigid.erring()):
            names = self._roster.markers[b]
            found[self.bodies[b]] = {names[k]: float(row[k]) for k in np.flatnonzero(row)}
        return found

    def wrong(self) -> np.ndarray:
        """In how many frames each body (B,) as a whole was wrong, and left out."""
        return self._wrong + self._rigid.wrong

    def outages(self) -> dict[str, Outage]:
        """For how long bodies, by name, were not seen, a window or more; all frames by ''."""
        found = dict(self._outages)
        for b, new in self._rigid.outages.items():
            old = found.get(self.bodies[b])
            if old is not None:
                longest = max(old.longest, new.longest, key=lambda each: each[1])
                new = Outage(old.times + new.times, new.latest, longest)
            found[self.bodies[b]] = new
        return found

    def lacking(self) -> dict[str, list[str]]:
        """Markers by body that the last message has not, where less than two of the body are."""
        lacks = zip(self.bodies, self._roster.lacking(), strict=False)
        return {body: names for body, names in lacks if names}

    @property
    def matcher(self) -> Matcher:
        """What holds names of markers against shapes, and knows what it corrected."""
        return self._rigid.matcher

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
        with self._alone:
            return self._add_parts(parts, order)

    def _add_parts(self, parts: Iterable[MarkerFrames], order: int | None) -> list[Estimate]:
        found: list[Estimate] = []
        before = 0
        for frames in parts:
            stamps = np.asarray(frames.stamps)
            if not len(stamps):
                continue
            self.counts['frames'] += len(stamps)
            posed = frames.axes is not None
            if frames.frame_id != self._frame_id or posed != self._posed:
                anew = posed != self._posed
                if len(self._timeline):
                    found += self._estimates(order)
                    self.counts['frame_changes'] += 1
                    anew = True
                self._frame_id, self._posed = frames.frame_id, posed
                if anew:
                    self._start(None)
            first = 0
            while first < len(stamps):
                if self._timeline.look_due:
                    found += self._look(order)
                # A plane that is being fitted is known at the next update at the earliest.
                last = first + self._space.capacity(len(stamps) - first)
                some = slice(first, last)
                steps, end, anew = self._timeline.accept(stamps[some], frames.points[some])
                new = (steps > 0).nonzero()[0]
                if len(new):
                    taken, place = frames, first + new
                    if len(new) < len(stamps):
                        taken = part_of(frames, place)
                    if self._roster.plane is not self._space.plane:
                        found += self._estimates(order)
                        self._catch_up()
                    solid = self._roster.sort(taken)
                    if self._roster.width > self._rigid.width:
                        found += self._estimates(order)
                        self._widen()
                    self._run(taken, steps[new], solid, before + place)
                first += end
                if anew:
                    found += self._estimates(order)
                    self.counts['resets'] += 1
                    newest, next_one = self._timeline.newest, int(stamps[first])
                    if next_one > newest:
                        before_it = self._outages.get('')
                        self._outages[''] = one_more(before_it, newest, next_one - newest)
                    self._start(self._timeline)
            before += len(stamps)
        return found + self._estimates(order)

    def settle(self) -> None:
        """Learn from what is due, while nobody waits for it; else the next `add` does."""
        with self._alone:
            self._rigid.settle()
            self._space.settle()
            if self._timeline.look_due:
                self._look(None)

    def _look(self, order: int | None) -> list[Estimate]:
        """Look at the clock of the stamps; what waits is estimated before it changes anything."""
        # By the noise as it is known to whoever takes frames one by one.
        self._rigid.settle()
        change = self._timeline.look(self._rigid.noise())
        if change is None:
            return []
        found = self._estimates(order)
        anew = change()
        self._rigid.were_at(self._timeline.view()['time'])
        if anew:
            self._rigid.retime()
        return found

    def _run(
        self, frames: MarkerFrames, steps: np.ndarray, solid: np.ndarray, numbers: np.ndarray
    ) -> None:
        """
        Take frames that go on by `steps` from those before; `numbers` (T,) are theirs.

        `solid` (T, B, n, 3), m, are their markers as sorted.
        """
        self.counts['markers_unknown'] = self._roster.unknown
        first = 0
        while first < len(steps):
            room = self._timeline.until_doubt(frames.stamps[first:])
            if room == len(steps):
                self._take(frames, steps, solid, numbers)
                return
            part = slice(first, first + room)
            some = part_of(frames, part)
            # By their names as they are known after the part before.
            self._take(some, steps[part], self._roster.sort(some), numbers[part])
            first += room

    def _take(
        self, frames: MarkerFrames, steps: np.ndarray, solid: np.ndarray, numbers: np.ndarray
    ) -> None:
        """The same of frames that may be taken at once."""
        rows, gaps = self._timeline.enter(frames.stamps, steps, numbers)
        landmarks = None if self._points is None else self._points.room(len(rows))
        points, heights = self._roster.flat(solid)
        plane = self._roster.plane
        if plane is None:
            self._rigid.take_unseen(rows)
            if landmarks is not None:
                landmarks[...] = complex(np.nan, np.nan)
            self._early.append((rows.copy(), frames, gaps))
            if len(self._early) > 2 * HISTORY:
                self._early = self._latest_early()
            seen = solid[..., 0, 0] if self._posed else solid[..., 0]
            if self._rigid.matcher.lacks_order(len(rows)):
                solid = np.full_like(solid, np.nan)
        else:
            self._rigid.are_timed(self._timeline.counts_are_sure)
            every = self._timeline.view()[-len(rows) - RUNNING :]
            if self._posed:
                rows['tilt'] = self._roster.tilts(solid)
            self._rigid.take(every, points, heights, gaps, landmarks)
            seen = points[..., 0] if self._posed else points
            if not self._posed:
                # As they were corrected.
                solid = plane.in_space(points, heights)
        self._rigid.were_at(self._timeline.pose(rows, self._rigid.known['noise']))
        self._space.add(solid)
        missing = np.count_nonzero(np.isnan(seen)) - seen.size
        self.counts['markers_not_seen'] += int(self._roster.wanted * len(rows) + missing)

    def _catch_up(self) -> None:
        """The plane has become known: learn from the frames before, and see them in it."""
        self._roster.plane = self._space.plane
        early, self._early = self._latest_early(), []
        self._rigid = self._make_bodies()
        end = len(self._timeline) - sum(len(rows) for rows, *_ in early)
        for rows, frames, gaps in early:
            solid = self._roster.sort(frames)
            if self._roster.width > self._rigid.width:
                self._widen()
            landmarks = None if self._points is None else np.empty(solid.shape[:-1], complex)
            points, heights = self._roster.flat(solid)
            if self._posed:
                rows['tilt'] = self._roster.tilts(solid)
            self._rigid.take(rows, points, heights, gaps, landmarks)
            first, end = end, end + len(rows)
            if end <= 0:
                continue
            held = self._timeline.view()[max(first, 0) : end]
            for name, *_ in pose_columns(len(self.bodies)):
                held[name] = rows[name][len(rows) - len(held) :]
            if self._points is not None and landmarks is not None:
                self._points.view()[max(first, 0) : end] = landmarks[len(rows) - len(held) :]
        self._rigid.forget()

    def _latest_early(self) -> list[tuple[np.ndarray, MarkerFrames, np.ndarray]]:
        """The frames of before the plane is known, as many as it is found from, in few parts."""
        parts = []
        for _, group in itertools.groupby(self._early, key=lambda part: part[1].identities):
            rows, frames, gaps = zip(*group, strict=True)
            parts.append((np.concatenate(rows), concatenated(frames), np.concatenate(gaps)))
        left = sum(len(rows) for rows, *_ in parts) - HISTORY
        while left > 0:
            rows, frames, gaps = parts.pop(0)
            if len(rows) > left:
                parts.insert(0, (rows[left:], part_of(frames, slice(left, None)), gaps[left:]))
            left -= len(rows)
        return parts

    def _widen(self) -> None:
        """A body of all markers has more of them."""
        self._rigid.widen(self._roster.width)
        self._early = []
        self._space.widen(self._roster.width)
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
        new, known = self._timeline.waiting(), self._rigid.known
        if not len(new):
            return []
        self._rigid.forget()
        end, windows, frame = self._timeline.falling_due(new)
        found = []
        if order is not None and len(frame):
            then = known[new['beat'][frame]]
            found.append(self._estimate(windows, order, new['number'][frame], then))
        outlived = int(new['oldest'][-1])
        self._timeline.pass_by(int(end[-1]), outlived)
        # Its stencils may begin a little before the window.
        self._rigid.deformation.drop(self._timeline.dropped - self._timeline.samples)
        if self._points is not None:
            self._points.drop(outlived)
        return found

    def _estimate(
        self, windows: Windows, order: int, due: np.ndarray, known: np.ndarray
    ) -> Estimate:
        """The frames `windows[0]` (T,), as those from `windows[1]` to `windows[2]` tell of them."""
        frames = self._timeline.view()[windows[0]]
        seen = frames['information'][:, : len(self.bodies)] > 0
        suspect = self._suspect(windows)
        if suspect is not None:
            seen &= windows[0][:, None] <= windows[2][:, None] - suspect
        measured, orientation_observable = known['measured'], known['orientation_observable']
        usable = seen & measured & orientation_observable
        if self._points is None:
            found, reference = self._from_poses(windows, known, order, suspect)
        else:
            found, reference = self._from_landmarks(windows, known, order), None
        if np.count_nonzero(known['deformed']):
            self._add_deformation(windows, known, found)
        position, angle, position_covariance, angle_covariance, span, degree = found
        if np.count_nonzero(usable) < usable.size:
            for array in found:
                array[..., ~usable] = np.nan
        enough = np.isfinite(angle[1]) & np.isfinite(position[1])
        missing = np.empty(seen.shape, object)
        missing.fill('')
        if np.count_nonzero(enough) < enough.size:
            missing[~enough] = 'window not full'
            missing[~orientation_observable] = NOISY_POSES if self._posed else TOO_CLOSE
            missing[~measured] = 'noise not known yet'
            missing[~seen] = NO_POSE if self._posed else TOO_FEW
            if self.plane is None:
                missing[...] = 'plane not known yet'
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
            self._run_number,
            *self._pinned(windows, known),
            known['shape'],
            due,
            reference,
            self.plane,
            partial(_frame_poses, frames, seen, known),
        )

    def _add_deformation(
        self,
        windows: Windows,
        known: np.ndarray,
        found: tuple[np.ndarray, ...],
    ) -> None:
        """Add to the covariances `found` what deformed bodies err by."""
        frames, count = self._timeline.view(), len(self.bodies)
        information = frames['information'][windows[0]]
        if self._points is None:
            # Of the points that are differentiated.
            for part in constant_segments(known['reference'], known['middle']):
                at, rows = known[part.start], frames[windows[0][part]]
                points = at['reference'], at['middle'], rows['poses'], rows['information']
                information[part] = seen_at(*points)[1]
        *_, span, degree = found
        numbers = tuple(rows + self._timeline.dropped for rows in windows)
        interval = frames['interval'][windows[2]] * 1e-9
        order = len(found[0]) - 1
        noise = known['noise'] * np.sqrt(known['held'])
        deformed = known['deformed'], known['deformed_since']
        slow = self._rigid.deformation.covariance(
            numbers, interval, span, degree, noise, *deformed, order
        )
        with np.errstate(divide='ignore', invalid='ignore'):
            of_angle, of_position = slow / information[:, :count], slow / information[:, count:]
        found[2][...] += of_position
        found[3][...] += of_angle

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
        frames = self._timeline.view()
        held &= known['pin_since'] <= frames['time'][oldest, None]
        off_pin = frames['off_pin']
        if np.count_nonzero(off_pin):
            times = off_pin.cumsum(axis=0)
            until = times[newest]
            suspect = self._suspect(windows)
            if suspect is not None:
                last = np.maximum(newest[:, None] - suspect, oldest[:, None])
                until = np.take_along_axis(times, last, axis=0)
            held &= until - times[oldest] + off_pin[oldest] < RUNNING
        return (
            np.where(held, pin, complex(np.nan, np.nan)),
            np.where(held, variance, np.nan),
        )

    def _suspect(self, windows: Windows) -> np.ndarray | None:
        """How many of the newest frames of each window (T, B) were suspect, None for none."""
        suspect = self._timeline.view()['suspect'][windows[2]]
        return suspect if np.count_nonzero(suspect) else None

    def _from_poses(
        self, windows: Windows, known: np.ndarray, order: int, suspect: np.ndarray | None
    ) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """
        Derivatives of the fitted poses, and of which points (T, B) of the bodies they are.

        Frames that are `suspect`, so many (T, B) of the newest, do not count.
        """
        count = len(self.bodies)
        frames = self._timeline.view()
        poses, information, time = frames['poses'], frames['information'], frames['time']
        turns = poses[:, :count, 1]
        if suspect is None:
            suspect = np.zeros((len(known), count), int)
        parts, references = [], []
        learned = (known[name] for name in ('reference', 'since', 'scale', 'extra_turn'))
        for part in constant_segments(*learned):
            row = known[part.start]
            signals, good = poses, information
            extra = np.zeros_like(turns)
            if self._posed:
                good = good * row['scale']
                # Rates are those of the rotation in space, and so is the motion of `reference`.
                extra = frames['extra_turn'] - row['extra_turn']
                signals = poses.copy()
                signals[:, :count, 0] += extra
            if np.count_nonzero(row['since']):
                # A body that began anew is another one since then.
                before = np.tile(time[:, None] < row['since'], 2)
                good = np.where(before, 0.0, information)
            if np.count_nonzero(row['reference']):
                signals, good = seen_at(row['reference'], row['middle'], signals, good)
            position = signals[:, count:].view(complex)[..., 0]
            angle = signals[:, :count, 0]
            seen = Poses(time, angle, turns, position, good[:, :count], good[:, count:])
            how = known['noise'][part], self._timeline.window * 1e-9, order, self.settings.effort
            arguments = windows.part(part), suspect[part], *how
            reference = known['reference'][part]
            if np.count_nonzero(extra):
                found, ahead = _derive_tilted(poses[:, :count, 0], seen, *arguments)
                reference = reference * np.exp(1j * np.nan_to_num(ahead))
            else:
                found = derive_poses(seen, *arguments)
            parts.append(found)
            references.append(reference)
        if len(parts) > 1:
            found = Derivatives(*(np.concatenate(e, axis=-2) for e in zip(*parts, strict=True)))
        return (*found[:-1], found.freedom - 1), np.concatenate(references)

    def _from_landmarks(
        self, windows: Windows, known: np.ndarray, order: int
    ) -> tuple[np.ndarray, ...]:
        """The same from the derivatives of each landmark."""
        assert self._points is not None
        frames = self._timeline.view()
        window = self._timeline.window * 1e-9
        how = known['noise'], window, order, self.settings.effort
        found = derive_landmarks(frames['time'], self._points.view(), windows, *how)
        found.angle[0] = frames['poses'][windows[0], : len(self.bodies), 0]
        return *found[:-1], found.freedom - 1


def _derive_tilted(
    headings: np.ndarray, poses: Poses, windows: Windows, left_out: np.ndarray, *how: Any
) -> tuple[Derivatives, np.ndarray]:
    """
    Differentiate poses of bodies that are tilted, whose angles are not their `headings` (N, B).

    The other arguments are those of `derive_poses`. Returns the derivatives of the poses, with the
    heading in place of the angle itself, and by how much (T, B), rad, the angle is ahead of it.
    """
    both = Poses(poses.time, *(np.concatenate((each, each), axis=1) for each in poses[1:]))
    count = headings.shape[1]
    both.angle[:, count:] = headings
    noise, *rest = how
    found = derive_poses(both, windows, np.tile(left_out, 2), np.tile(noise, 2), *rest)
    heading = found.angle[0, :, count:]
    found = Derivatives(*(each[..., :count] for each in found))
    ahead = found.angle[0] - heading
    found.angle[0] = heading
    return found, ahead


def _frame_poses(frames: np.ndarray, seen: np.ndarray, known: np.ndarray) -> FramePoses:
    """The poses of `frames` (T,) as they were fitted, of bodies where they are `seen` (T, B)."""
    count, poses = seen.shape[1], frames['poses']
    information = np.where(np.tile(seen, 2), frames['information'] * known['scale'], 0.0)
    return FramePoses(
        poses[:, :count, 0] + 2 * np.pi * poses[:, :count, 1],
        poses[:, count:].view(complex)[..., 0],
        information[:, :count],
        information[:, count:],
        frames['middle'],
        known['noise'],
    )
