"""
The tracker: from frames of markers to the motion of bodies, one frame at a time.

Node and replay use it in the same way, so live results equal replayed ones. It depends on the
stamps of the frames only, never on the clock of the machine.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from kinpole_ros.settings import Settings
from kinpole_ros.tracking.before_plane import keep_frame, take_again
from kinpole_ros.tracking.correction import correct_next
from kinpole_ros.tracking.deformed_results import add_deformation
from kinpole_ros.tracking.estimate import Estimate, Results, estimate_of
from kinpole_ros.tracking.events import FRAMES_BEHIND, BodyEvent
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.outages import note_gap
from kinpole_ros.tracking.placed_frames import PlacedFrames
from kinpole_ros.tracking.recording import Recording
from kinpole_ros.tracking.rejection import EXCHANGED
from kinpole_ros.tracking.result_layout import DEFORMED, FILLED
from kinpole_ros.tracking.state import new_totals, start, widen
from kinpole_ros.tracking.summary import TrackerSummary
from kinpole_ros.tracking.timed_frames import TimedFrames
from kinpole_ros.tracking.timeline import Timeline
from kinpole_ros.tracking.update import (
    begin_known,
    end_learned,
    learn_if_due,
    recover,
    update_clock,
    update_if_due,
)


class Tracker(TrackerSummary):
    """
    Tracks the bodies of `settings` from frame to frame.

    A `recording` is learned from its frames, or known already: see recording.py.
    """

    def __init__(self, settings: Settings, recording: Recording | None = None) -> None:
        self.settings = settings
        self.frame_id = ''
        self._results: list[tuple[Results, np.ndarray]] = []
        self._events: list[BodyEvent] = []
        self._events_needed = False
        # Before those of this call.
        self._frames_before = 0
        totals = new_totals(len(self.bodies))
        self.state = start(settings, False, totals, before=None, recording=recording)
        begin_known(self.state)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies."""
        return tuple(self.settings.bodies)

    def reset(self) -> None:
        """Forget all frames and everything learned from them."""
        self._start(self.state.bodies.are_measured)

    def recover(self, failures: int) -> str:
        """
        Make up for an exception of `add`, whose frames are lost; return in words what else is.

        All starts again if that of no body helped: see `recover` of update.py.
        """
        if failures > len(self.bodies):
            self.reset()
            return 'starts anew'
        return recover(self.state, failures)

    def _start(self, are_measured: bool, before: Timeline | None = None) -> None:
        """Start from nothing, but with the clock of the timeline `before` a jump of the stamps."""
        self._events = []
        state = self.state
        state.timeline.count_lost()
        end_learned(state)
        self.state = start(self.settings, are_measured, state.totals, before, state.recording)
        begin_known(self.state)

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
        self._results, self._events_needed = [], events
        if not events:
            self.state.event_search.pause()
        number, self._frames_before = 0, self.state.totals.counts['frames']
        for frames in parts:
            if not len(frames.stamps):
                continue
            is_other = (frames.axes is not None) != self.state.bodies.are_measured
            self._note_number(number)
            if frames.frame_id != self.frame_id or is_other:
                estimates += self._change_frame(frames, number, order)
            estimates += self._accept(frames, number, order)
            number += len(frames.stamps)
        return estimates + self._flush_results()

    def _note_number(self, number: int) -> None:
        """Note the number of the next frame, of those of this call, where a recording counts it."""
        if self.state.recording is not None:
            self.state.recording.number = self._frames_before + number

    def finish(self, order: int | None) -> list[Estimate]:
        """
        Return the results that are left after the last frame of a known recording, see `add`.

        They are of the last `lag`, from the frames that there are. Their `due` is the last frame of
        the last call of `add`.
        """
        return self._finish(self.state.totals.counts['frames'] - self._frames_before - 1, order)

    def _finish(self, number: int, order: int | None) -> list[Estimate]:
        """Return all results up to the frame `number` of this call, after which others start."""
        state, estimates = self.state, []
        if state.recording is not None and state.recording.is_learned and len(state.history):
            for part in state.timeline.time_waiting(state.history, number):
                estimates += self._take(part, order)
            results = state.step.reserve_results(0, order)
            state.step.follow_to_end(results)
            if results.fields[DEFORMED]:
                add_deformation(results, 0, state.bodies, state.history)
            self._keep_results(results, np.full(state.step.incoming.frames, max(number, 0)))
        return estimates + self._flush_results()

    def _change_frame(self, frames: MarkerFrames, number: int, order: int | None) -> list[Estimate]:
        """Start again with another frame_id, or with poses instead of markers."""
        state = self.state
        estimates = self._finish(number - 1, order)
        used = len(state.history) > 0
        state.totals.counts['frame_changes'] += used
        self.frame_id = frames.frame_id
        if used or (frames.axes is not None) != state.bodies.are_measured:
            self._start(frames.axes is not None)
        return estimates

    def _accept(self, frames: MarkerFrames, number: int, order: int | None) -> list[Estimate]:
        """Take those of the frames that follow the ones before; `number` frames came before."""
        estimates: list[Estimate] = []
        stamps, counts = np.asarray(frames.stamps), self.state.totals.counts
        counts['frames'] += len(stamps)
        first = 0
        while first < len(stamps):
            state = self.state
            self._note_number(number + first)
            if state.timeline.until_update <= 0:
                update_clock(state)
            used, end, restarts = state.timeline.accept(stamps[first:], frames.points[first:])
            if len(used):
                used += first
                taken = frames if len(used) == len(stamps) else part_of(frames, used)
                for part in state.timeline.time_frames(taken, number + used, state.history):
                    estimates += self._take(part, order)
            first += end
            if restarts:
                self._note_number(number + first)
                estimates += self._finish(number + first - 1, order)
                self._restart(int(stamps[first]))
        counts['markers_unknown'] = self.state.assignment.unknown
        return estimates

    def _restart(self, stamp: int) -> None:
        """Restart after a jump of the stamps."""
        state = self.state
        newest = int(state.history['stamp'][-1]) if len(state.history) else stamp
        if stamp > newest:
            note_gap(state.totals.outages, newest, stamp - newest)
        state.totals.counts['resets'] += 1
        self._start(state.bodies.are_measured, state.timeline)

    def _take(self, timed: TimedFrames, order: int | None) -> list[Estimate]:
        """Take frames whose times are known; return the results before a restart."""
        frames, *times, numbers = timed
        state, estimates = self.state, []
        width = state.step.known.width
        placed = self._place(frames, times)
        if state.step.known.width > width:
            estimates += self._flush_results()
        results = state.step.reserve_results(len(frames.stamps), order)
        first, count = 0, len(frames.stamps)
        while first < count:
            self._search_events(times[0][:first], numbers)
            learns = state.frame_count >= state.next_update or state.names_changed
            self._note_number(int(numbers[first]))
            if learns and update_if_due(state):
                state.assignment.assign_again(placed, first)
                unassigned = state.assignment.layout_of(placed).unassigned
                state.step.incoming.hidden_is_unusual = len(unassigned) > 0
            if state.assignment.plane is not state.space.plane:
                self._keep_results(results, numbers)
                estimates += self._flush_results()
                take_again(state, self._take_early)
                placed = self._place(frames, times)
                state.step.incoming.frame = first
                results = state.step.reserve_results(count - first, order)
            self._follow(placed, times, results)
            first = state.step.incoming.frame
        self._search_events(times[0][:first], numbers)
        self._keep_results(results, numbers)
        if placed.in_space is not None and state.assignment.plane is not None:
            state.space.add(placed.in_space)
        return estimates

    def _place(self, frames: MarkerFrames, times: Sequence[np.ndarray]) -> PlacedFrames:
        """Place the markers of frames in the slots of the bodies, and pass them to C."""
        state = self.state
        state.placed = placed = state.assignment.assign(frames, state.totals.counts)
        if state.assignment.width > state.step.known.width:
            widen(state)
        new_frames = frames.stamps, *times, placed.points, placed.heights, placed.tilts
        hidden_is_unusual = len(state.assignment.layout_of(placed).unassigned) > 0
        state.step.pass_frames(len(frames.stamps), new_frames, hidden_is_unusual)
        return placed

    def _follow(self, placed: PlacedFrames, times: Sequence[np.ndarray], results: Results) -> None:
        """Take frames up to the next update, or one that is not usual after correcting it."""
        state, computed = self.state, int(results.fields[FILLED])
        before, is_unusual = state.step.incoming.frame, True
        if state.assignment.plane is None:
            keep_frame(state, placed, times)
        elif not placed.is_nameless or placed.size == state.assignment.ordered_size:
            is_unusual = state.step.follow(state.next_update - state.frame_count, results)
            self._count_taken(before)
        if is_unusual:
            before = state.step.incoming.frame
            if state.assignment.plane is not None:
                state.step.correct_next(correct_next(state, placed, before))
            state.step.follow(1, results)
            self._count_taken(before)
        if results.fields[DEFORMED]:
            add_deformation(results, computed, state.bodies, state.history)

    def _take_early(self, frame: MarkerFrames, times: Sequence[np.ndarray]) -> None:
        """Take a frame again that came before the plane was known."""
        state = self.state
        update_if_due(state)
        placed = self._place(frame, times)
        state.step.correct_next(correct_next(state, placed, 0))
        state.step.follow(1, state.step.reserve_results(0, None))
        self._count_taken(0)

    def _count_taken(self, before: int) -> None:
        """Count the frames from `before` on that the step took."""
        state = self.state
        taken = state.step.incoming.frame - before
        state.frame_count += taken
        if state.assignment.uncounted is not None:
            state.totals.counts[EXCHANGED] += state.assignment.count_exchanged(taken)

    def _search_events(self, times: np.ndarray, numbers: np.ndarray) -> None:
        """Search for events in the history, to which frames with these times were appended."""
        if not self._events_needed or not len(times):
            return
        state, history, search = self.state, self.state.history, self.state.event_search
        settled = max(history.first, history.end - 1 - FRAMES_BEHIND)
        if history.columns['time'][settled] >= search.due:
            self._events += search.search(history, state.bodies, numbers[: len(times)])

    def _keep_results(self, results: Results, numbers: np.ndarray) -> None:
        """Keep results for the next estimate; `numbers` count the frames passed to the step."""
        if results.fields[FILLED]:
            self._results.append((results, numbers))

    def _flush_results(self) -> list[Estimate]:
        """Return the results so far as one estimate, if there are any."""
        results, self._results = self._results, []
        if not results:
            return []
        events, self._events = self._events, []
        estimate = estimate_of(
            results,
            self.frame_id,
            self.bodies,
            run=self.state.run,
            plane=self.state.assignment.plane,
            are_measured=self.state.bodies.are_measured,
            events=tuple(events),
        )
        return [estimate]

    def learn_if_due(self) -> None:
        """Learn from the history now if an update is due; otherwise the next `add` does."""
        state = self.state
        if state.frame_count >= state.next_update or state.timeline.until_update <= 0:
            learn_if_due(state)


def learn_recording(settings: Settings, parts: Iterable[MarkerFrames]) -> tuple[Tracker, Recording]:
    """Return a tracker after all frames of a recording, and what it learned for another."""
    recording = Recording()
    tracker = Tracker(settings, recording)
    for frames in parts:
        tracker.add(frames, None)
    recording.number = tracker.state.totals.counts['frames']
    end_learned(tracker.state)
    recording.is_learned, recording.number = True, 0
    return tracker, recording
