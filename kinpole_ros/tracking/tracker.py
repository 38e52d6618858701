"""
The tracker: from frames of markers to the motion of bodies, one frame at a time.

Node and replay use it in the same way, so live results equal replayed ones. It depends on the
stamps of the frames only, never on the clock of the machine.
"""

import itertools
from collections import Counter, deque
from collections.abc import Iterable, Sequence

import numpy as np

from kinpole_ros.tracking.assignment import MarkerAssignment, PlacedFrames
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.center import Pins, find_hubs
from kinpole_ros.tracking.corrections import EXCHANGED, correct_frame
from kinpole_ros.tracking.deformation import TISSUE, deformed_freedom
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.events import BodyEvent, EventSearch
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.learn import freedom_of, learn, path_scale
from kinpole_ros.tracking.matcher import Matcher
from kinpole_ros.tracking.outages import Outage, named_outages, no_outages, note_gap
from kinpole_ros.tracking.parameters import Settings, of_poses
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.posed import learn_poses
from kinpole_ros.tracking.rejection import MOVED_FRAMES, NAME_DOUBTFUL, ODD
from kinpole_ros.tracking.results import Results, add_deformation, estimate_of
from kinpole_ros.tracking.space import Space, SpaceReport
from kinpole_ros.tracking.step import Step
from kinpole_ros.tracking.thresholds import MEMORY_FRAMES, N_SIGMA, NEGLIGIBLE, ROUNDED
from kinpole_ros.tracking.timeline import StampState, TimedFrames, Timeline

# The history has at least this many frames, and this many windows.
MIN_HISTORY_FRAMES, MIN_HISTORY_WINDOWS = 1024, 4
# Frames between two updates: this share of all frames so far, and at most so many.
UPDATE_SHARE, MAX_UPDATE_INTERVAL = 1 / 8, 128
# Most frames between two searches for the names of markers after searches without a result.
MAX_SEARCH_INTERVAL = 16
# Residuals beyond this share of the body size are of markers on other bodies: tissue moves less.
OTHER_BODY_SHARE = 0.05
_run_numbers = itertools.count(1)


class Tracker:
    """Tracks the bodies of `settings` from frame to frame."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.bodies = tuple(settings.bodies)
        self._counts: Counter[str] = Counter()
        self._window = settings.window_ns
        self._frame_id = ''
        # Whether the input are poses of bodies instead of markers.
        self._posed = False
        self._outages = no_outages(len(self.bodies))
        self._earlier_wrong = np.zeros(len(self.bodies), int)
        self._start()

    def reset(self) -> None:
        """Forget all frames and everything learned from them."""
        self._start()

    def _start(self, before: Timeline | None = None) -> None:
        """Start from nothing, but with the clock of the timeline `before` a jump of the stamps."""
        count = len(self.bodies)
        if hasattr(self, '_step'):
            self._earlier_wrong = self.wrong()
        settings = of_poses(self.settings) if self._posed else self.settings
        self._assignment = MarkerAssignment(settings, self._posed)
        self._space = Space(self.settings.plane, count, self._assignment.width)
        self._assignment.set_plane(self._space.plane)
        self._placed: PlacedFrames | None = None
        # Frames before the plane was known, with their times and counts.
        self._before_plane: deque[tuple[MarkerFrames, list[np.ndarray]]] = deque(
            maxlen=MIN_HISTORY_FRAMES
        )
        self._run_number = next(_run_numbers)
        self._start_bodies()
        self._timeline = Timeline(self.settings, self._counts, before)
        self._event_search = EventSearch(self._window, count)
        self._events: list[BodyEvent] = []

    def _start_bodies(self) -> None:
        """Start with bodies of which nothing is known."""
        self._calibration = Bodies(len(self.bodies), self._assignment.width)
        self._history = History(len(self.bodies), self._assignment.width)
        self._pins = Pins(self._calibration)
        settings = of_poses(self.settings) if self._posed else self.settings
        self.matcher = Matcher(
            settings, self._assignment, self._calibration, self._history, self._counts
        )
        self._step = Step(
            settings, self._calibration, self._pins, self._history, self._posed, self._outages
        )
        self._frame_count = self._new_frames = self._counted_frames = 0
        # Searches for the names of markers in a row that had no result.
        self._futile_searches = self._next_search = 0
        self._next_update = 1
        self._names_changed = False

    # For diagnostics.

    @property
    def counts(self) -> Counter[str]:
        """Numbers of frames and markers that were dropped, corrected or not seen, by cause."""
        self._count_new_frames()
        return self._counts

    @property
    def samples(self) -> int:
        """Number of frames in the window."""
        return int(self._step.fields.samples)

    @property
    def interval(self) -> float:
        """Mean time between the frames of the window in s; NaN for fewer than two."""
        return self._step.fields.interval * 1e-9 if self.samples > 1 else float('nan')

    @property
    def plane(self) -> Plane | None:
        """The plane of the results; None until it is fitted."""
        return self._assignment.plane

    @property
    def identities(self) -> tuple[str, ...]:
        """Identities of the markers in the last message."""
        return () if self._placed is None else self._placed.identities

    def space(self) -> SpaceReport:
        """Return the tilt of the motion against the plane, and how far it leaves the plane."""
        self._count_new_frames()
        return self._space.report()

    def noise(self) -> np.ndarray:
        """Return the noise (B,) of one coordinate of a marker, m; NaN while not measured."""
        return self._calibration.noise

    def angle_noise(self) -> np.ndarray | None:
        """Return the noise (B,) of the angles of input poses, rad; None for markers."""
        return self._calibration.angle_noise if self._posed else None

    def rigidity_residual(self) -> np.ndarray:
        """Return the rms residual (B,) of each body, m, per axis; 0 for one that is rigid."""
        known = self._calibration
        off = np.sqrt(np.where(known.mature, known.misfit, np.nan))
        with np.errstate(invalid='ignore'):
            loose = (off > N_SIGMA * known.white) & (off > NEGLIGIBLE * known.size)
            loose &= off > ROUNDED * known.size
        return np.where(loose, off, 0.0)

    def causes(self) -> list[str]:
        """Return why the markers of each body move against each other, '' if it is not known."""
        known = self._calibration
        off = np.sqrt(known.misfit)
        tissue = (known.freedom > 0) & ~(off > OTHER_BODY_SHARE * known.size)
        return [TISSUE if one else '' for one in tissue]

    def noise_underestimated(self) -> np.ndarray:
        """Return which bodies (B,) have noise that is correlated for too long to be measured."""
        return self._calibration.lasting & (self.settings.noise == 0)

    def erring(self) -> dict[str, dict[str, float]]:
        """Return the standard deviations of noisy markers by body and name, m, per axis."""
        return {
            body: {self._assignment.markers[b][k]: float(row[k]) for k in np.flatnonzero(row)}
            for b, (body, row) in enumerate(
                zip(self.bodies, self._calibration.deviation, strict=True)
            )
        }

    def wrong(self) -> np.ndarray:
        """Return in how many frames each body (B,) was left out since its pose was off its path."""
        return self._earlier_wrong + self._step.wrong

    def outages(self) -> dict[str, Outage]:
        """Return gaps of a window or more, by body; '' for gaps without any frame."""
        return named_outages(self._outages, self.bodies)

    def absent_markers(self) -> dict[str, list[str]]:
        """Return the markers that the last message lacks, of bodies with less than two in it."""
        if self._placed is None:
            return {}
        lacks = zip(self.bodies, self._assignment.absent_of_bodies(self._placed), strict=False)
        return {body: names for body, names in lacks if names}

    def stamp_state(self) -> StampState | None:
        """Return how the stamps lie on the estimated clock; None while too few have come."""
        return self._timeline.stamp_state()

    # Frames.

    def add(self, frames: MarkerFrames, order: int | None, events: bool = False) -> list[Estimate]:
        """
        Take frames, and return the results that are complete, which are stamped `lag` earlier.

        A frame is left out if its stamp was seen before, or if it comes late: before the newest
        frame, within the window. Everything restarts with another frame_id, and with a stamp
        farther from the newest than the window.

        Parameters
        ----------
        frames : MarkerFrames
            Frames of one layout, in the order in which they came.
        order : int or None
            The highest derivative needed, 1 to 4; None for no results.
        events : bool
            Whether the results have the events found since those before.

        Returns
        -------
        list of Estimate
            Empty if no result is complete.

        """
        return self.add_parts((frames,), order, events)

    def add_parts(
        self, parts: Iterable[MarkerFrames], order: int | None, events: bool = False
    ) -> list[Estimate]:
        """Take several parts, as `add` takes one; `due` counts the frames of all of them."""
        estimates: list[Estimate] = []
        self._results: list[Results] = []
        self._events_needed = events
        if not events:
            self._event_search.pause()
        number = 0
        for frames in parts:
            stamps = np.asarray(frames.stamps)
            if not len(stamps):
                continue
            posed = frames.axes is not None
            if frames.frame_id != self._frame_id or posed != self._posed:
                estimates += self._flush_results()
                used = len(self._history) > 0
                self._counts['frame_changes'] += used
                restarts = used or posed != self._posed
                self._frame_id, self._posed = frames.frame_id, posed
                if restarts:
                    self._start()
            self._counts['frames'] += len(stamps)
            first = 0
            while first < len(stamps):
                if self._timeline.until_update <= 0:
                    self._update_clock()
                remaining = slice(first, None)
                used, end, restarts = self._timeline.accept(
                    stamps[remaining], frames.points[remaining]
                )
                if len(used):
                    used += first
                    taken = frames if len(used) == len(stamps) else part_of(frames, used)
                    for part in self._timeline.time_frames(taken, number + used, self._history):
                        estimates += self._take_timed(part, order)
                first += end
                if restarts:
                    estimates += self._flush_results()
                    self._restart(int(stamps[first]))
            number += len(stamps)
            self._counts['markers_unknown'] = self._assignment.unknown
        return estimates + self._flush_results()

    def _take_timed(self, timed: TimedFrames, order: int | None) -> list[Estimate]:
        """Take frames whose times are known; return the results before a restart."""
        frames, *times, numbers = timed
        estimates: list[Estimate] = []
        width = self._calibration.width
        placed = self._assign(frames)
        if self._calibration.width > width:
            estimates += self._flush_results()
        self._pass_frames(placed, times)
        results = self._reserve_results(len(frames.stamps), order)
        first, count = 0, len(frames.stamps)
        while first < count:
            self._search_events(first, numbers)
            if self._update_if_due():
                self.matcher.assign_again(placed, first)
                self._step.fields.hidden_is_unusual = self.matcher.has_unassigned(placed)
            if self._assignment.plane is not self._space.plane:
                self._keep_results(results, numbers)
                estimates += self._flush_results()
                self._replay_in_plane()
                placed = self._assign(frames)
                self._pass_frames(placed, times)
                self._step.fields.frame = first
                results = self._reserve_results(count - first, order)
            is_unusual, is_known = True, self._assignment.plane is not None
            if is_known and self.matcher.is_in_order(placed) and not self._calibration.exchanged:
                is_unusual = self._follow(self._next_update - self._frame_count, results)
            if is_unusual:
                self._take_unusual(placed, times, results)
            first = self._step.fields.frame
        self._search_events(first, numbers)
        self._keep_results(results, numbers)
        if placed.in_space is not None and self._assignment.plane is not None:
            self._space.add(placed.in_space)
        return estimates

    def _search_events(self, first: int, numbers: np.ndarray) -> None:
        """Search for events in the history, to which the frames before `first` were appended."""
        if not self._events_needed or first == 0:
            return
        bodies = self._calibration
        hub = np.where(np.isfinite(self._pins.center), 0.0, bodies.hub)
        for event in self._event_search.search(self._history, bodies, hub, first - 1):
            self._events.append(event._replace(due=int(numbers[max(event.due, 0)])))

    def _pass_frames(self, placed: PlacedFrames, times: Sequence[np.ndarray]) -> None:
        """Pass frames, with their times and counts, to the compiled step."""
        stamps, in_space, tilts = placed.frames.stamps, placed.in_space, None
        if in_space is not None and self._assignment.plane is not None:
            tilts = self._assignment.tilts(in_space)
        new_frames = stamps, *times, placed.points, placed.heights, tilts
        self._step.pass_frames(len(stamps), new_frames, self.matcher.has_unassigned(placed))

    def _follow(self, until_update: int, results: Results) -> bool:
        """Take usual frames, and compute the results that are due; whether the next is unusual."""
        fields, computed = self._step.fields, results.count
        before = fields.frame
        is_unusual = self._step.follow(until_update, results)
        self._frame_count += fields.frame - before
        self._new_frames += fields.frame - before
        add_deformation(results, computed, self._calibration, self._history)
        return is_unusual

    def _reserve_results(self, frames: int, order: int | None) -> Results:
        """Reserve memory for the results that so many frames can complete."""
        if order is None:
            return Results(0, 1, 0, 0)
        waiting = len(self._history) - self._step.fields.due
        known = self._calibration
        return Results(frames + waiting, order + 1, known.count, known.width)

    def _keep_results(self, results: Results, numbers: np.ndarray) -> None:
        """Keep results for the next estimate; `numbers` count the frames passed to the step."""
        if results.count:
            due = results.column('due')
            due[:] = numbers[due]
            self._results.append(results)

    def learn_if_due(self) -> None:
        """Learn from the history now if an update is due; otherwise the next `add` does."""
        self._names_changed = self._update_if_due()
        if self._timeline.until_update <= 0:
            self._update_clock()

    def _update_clock(self) -> None:
        # The clock depends on the noise, which is to be the same live and in replay.
        self._names_changed = self._update_if_due()
        self._timeline.update_clock(self._history, self.samples, self.noise())

    def _update_if_due(self) -> bool:
        """Learn if an update is due; return whether names stand for other markers since."""
        if self._frame_count >= self._next_update:
            self._names_changed |= self._update()
        changed, self._names_changed = self._names_changed, False
        return changed

    def _flush_results(self) -> list[Estimate]:
        """Return the results so far as one estimate, if there are any."""
        results, self._results = self._results, []
        if not results:
            return []
        about = self._frame_id, self.bodies, self._run_number, self.plane, self._posed
        events, self._events = self._events, []
        return [estimate_of(results, *about, tuple(events))]

    def _assign(self, frames: MarkerFrames) -> PlacedFrames:
        """Place the markers of frames in the slots of the bodies."""
        self._placed = placed = self._assignment.assign(frames)
        if self._assignment.width > self._calibration.width:
            self._widen()
        self.matcher.begin(placed)
        return placed

    def _widen(self) -> None:
        """Make room for more markers, of a body that takes all markers."""
        width = self._assignment.width
        self._calibration.widen(width)
        self._history.widen(width)
        self._pins.widen(width)
        self._space.widen(width)
        self._step.bind(self._calibration, self._history)
        self._before_plane.clear()

    def _restart(self, stamp: int) -> None:
        """Restart after a jump of the stamps."""
        newest = int(self._history['stamp'][-1]) if len(self._history) else stamp
        if stamp > newest:
            note_gap(self._outages, newest, stamp - newest)
        self._counts['resets'] += 1
        self._start(self._timeline)

    def _take_unusual(
        self, placed: PlacedFrames, times: Sequence[np.ndarray], results: Results
    ) -> None:
        """Take the next frame, after correcting its markers."""
        k = self._step.fields.frame
        if self._assignment.plane is None:
            part, in_space = slice(k, k + 1), placed.in_space
            frame = part_of(placed.frames, part), [array[part] for array in times]
            self._before_plane.append(frame)
            assert in_space is not None
            unusable = self.matcher.is_incomplete_cloud(placed)
            self._space.add(np.full_like(in_space[part], np.nan) if unusable else in_space[part])
            self._step.correct_next(placed.points[k])
        else:
            self._step.correct_next(self._corrected(placed, k))
        self._follow(1, results)

    def _corrected(self, placed: PlacedFrames, k: int) -> np.ndarray:
        """Return the markers (B, n) that frame `k` is fitted to, NaN for those left out."""
        bodies, matcher = self._calibration, self.matcher
        if matcher.arrange(placed, k):
            self._restart_bodies(np.ones(bodies.count, bool))
        markers, heights = placed.points[k], placed.heights[k]
        if len(bodies.unseen):
            bodies.begin(markers)
            self._step.bind(bodies, self._history)
        if bodies.incomplete and (bodies.unknown_slots & ~np.isnan(markers)).any():
            # New markers are learned as soon as they are seen.
            self._next_update = min(self._next_update, self._frame_count + 1)
        if bodies.exchanged:
            markers[...] = np.take_along_axis(markers, bodies.order, axis=1)
            heights[...] = np.take_along_axis(heights, bodies.order, axis=1)
        unusual = self._step.try_next(markers)
        if unusual & NAME_DOUBTFUL or matcher.has_unassigned(placed):
            if self._correct_names(placed, k, unusual):
                unusual = self._step.try_next(markers)
        fitted = markers
        if unusual & ODD:
            odd = (self._step.unusual & ODD) > 0
            before = np.argsort(bodies.order, axis=1)
            fitted = correct_frame(bodies, self._history, markers, odd, self._counts)
            new_order = np.take_along_axis(before, bodies.order, axis=1)
            heights[...] = np.take_along_axis(heights, new_order, axis=1)
        if bodies.exchanged:
            # Names that stay exchanged were wrong before.
            recent = bodies.exchanged_for < MOVED_FRAMES
            moved = bodies.order[recent] != np.arange(bodies.width)
            self._counts[EXCHANGED] += int(np.count_nonzero(moved))
            bodies.exchanged_for += 1
        return fitted

    def _correct_names(self, placed: PlacedFrames, k: int, unusual: int) -> bool:
        """Correct wrong names of markers in the frame; return whether there were any."""
        if not unusual & NAME_DOUBTFUL:
            markers = placed.points[k]
            unseen = np.isnan(markers)
            if not unseen.any():
                return False
            if not self.matcher.is_doubtful(placed, k, self._calibration.fit(markers), unseen):
                return False
        # Bodies that are not rigid are doubtful in every frame, and a search takes long.
        if self._frame_count < self._next_search:
            return False
        corrected = self.matcher.correct_names(placed, k)
        self._futile_searches = 0 if corrected else self._futile_searches + 1
        self._next_search = self._frame_count + min(
            2 ** max(self._futile_searches - 1, 0), MAX_SEARCH_INTERVAL
        )
        return corrected

    def _restart_bodies(self, which: np.ndarray) -> None:
        """Forget everything learned of some bodies (B,)."""
        self._calibration.restart(which)
        if self.matcher.has_shape.any():
            self._calibration.give(np.where(which[:, None], self.matcher.given, np.nan))
        self._history['information'][:, :, which] = 0.0
        self._history['used'][:, which] = False
        self._history['markers'][:, which] = np.nan
        self._history['angle'][:, which] = np.nan
        self._pins.forget(which)
        self._step.bind(self._calibration, self._history)

    def _replay_in_plane(self) -> None:
        """Take the earlier frames again, now that the plane is known."""
        early = list(self._before_plane)
        self._before_plane.clear()
        due = self._step.fields.due - (len(self._history) - len(early))
        seen_last = self._step.seen_last
        self._assignment.set_plane(self._space.plane)
        assert self._assignment.plane is not None
        self._start_bodies()
        for frame, times in early:
            self._update_if_due()
            placed = self._assign(frame)
            self._pass_frames(placed, times)
            self._take_unusual(placed, times, self._reserve_results(0, None))
        self._step.fields.due = max(due, 0)
        self._step.seen_last[:] = seen_last

    def _update(self) -> bool:
        """Learn from the history; return whether names stand for other markers since."""
        bodies, history = self._calibration, self._history
        self._next_update = self._frame_count + max(
            1, min(int(self._frame_count * UPDATE_SHARE), MAX_UPDATE_INTERVAL)
        )
        if self._assignment.plane is None:
            self._drop_old_frames()
            return False
        self._count_new_frames()
        if self._posed:
            learn_poses(bodies, history, self.settings.noise)
            bodies.extra_turn = self._step.total_turn.copy()
        else:
            restarts = learn(bodies, history, self._window, self.settings.noise, self._counts)
            self._pins.forget(restarts)
        self._pins.update(bodies, history, min(self._new_frames, len(history)), self._posed)
        self._new_frames = self._counted_frames = 0
        self._drop_old_frames()
        bodies.hub = find_hubs(bodies, history, self._window, bodies.hub)
        bodies.jump_scale = path_scale(history)
        if not self._posed:
            self._find_deformed()
        changed = False
        if self.matcher.regrouping_is_due():
            regrouped = self.matcher.regroup(self.rigidity_residual() > 0)
            changed = bool(regrouped.any() or self.matcher.withheld.any())
            if regrouped.any():
                self._restart_bodies(regrouped)
        self._step.bind(bodies, history)
        return changed

    def _find_deformed(self) -> None:
        """Find the bodies whose markers move against each other by more than their noise."""
        bodies, history = self._calibration, self._history
        rows = slice(-MEMORY_FRAMES - 2, None)
        time, residual = history['time'][rows], history['residual'][rows]
        interval = float(np.median(np.diff(time))) if len(time) > 1 else self._window / 2
        free = freedom_of(bodies, residual).sum(axis=-1)
        noise = np.fmax(bodies.noise, bodies.white)
        half = round(self._window / 2 / max(interval, 1.0))
        bodies.freedom, bodies.hidden_factor = deformed_freedom(
            residual, free, noise, bodies.degrees, half
        )

    def _count_new_frames(self) -> None:
        """Count hidden markers since the last update, and measure how the motion lies in space."""
        new = min(self._new_frames - self._counted_frames, len(self._history))
        self._counted_frames = self._new_frames
        if not new or self._assignment.plane is None:
            return
        markers, heights = (self._history[name][-new:] for name in ('markers', 'heights'))
        seen = np.count_nonzero(~np.isnan(markers[..., 0] if self._posed else markers))
        lacking = self._assignment.count * new - seen
        self._counts['markers_not_seen'] += int(lacking)
        if not self._posed:
            self._space.add(self._assignment.plane.in_space(markers, heights))

    def _drop_old_frames(self) -> None:
        """Drop frames that neither the window nor the next update needs."""
        history, fields = self._history, self._step.fields
        oldest = len(history) - self.samples
        drop = min(
            oldest, len(history) - max(MIN_HISTORY_FRAMES, MIN_HISTORY_WINDOWS * self.samples)
        )
        if drop > 0:
            history.drop(drop)
            fields.due = max(0, fields.due - drop)
