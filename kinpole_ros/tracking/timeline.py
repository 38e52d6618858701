"""
When frames were captured: at their stamps, or at the ticks of the clock behind the stamps.

The count of a frame is the number of its tick. Only the stamps and the motion decide, never the
clock of the machine.
"""

import math
from collections import Counter

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.planar._plane import Real
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.clock import (
    DECISIVE_NATS,
    HALF_LIFE,
    MEMORY,
    Clock,
    StampState,
    clock_of,
    count_frames,
    count_until_other_rate,
    count_until_slip,
    counts_if_near,
    estimate_clock,
    even_clock,
)
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.frame_counter import FrameCounter
from kinpole_ros.tracking.frame_intervals import UNSETTLED, lost_between
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.rejection import LastFrame, judge_arrivals
from kinpole_ros.tracking.thresholds import MIN_SAMPLES
from kinpole_ros.tracking.tick_evidence import FEWEST_WEIGHED, SIDE, TickEvidence, add_evidence
from kinpole_ros.tracking.timed_frames import TimedFrames, split_certain

# ns. The least time between two frames.
_MIN_STEP = 1000
# A frame may be late by this share of the window before the clock is known.
_MAX_INITIAL_LATENESS = 1 / 4
# The rate is the same if the counts of this share of the frames agree with those before.
_SAME_RATE_SHARE = 0.9
_NO_COUNTS = np.zeros(0, np.int64)


class Timeline:
    """
    The times of the frames of a history, since its start.

    After a jump of the stamps frames are at stamps or at ticks as in the timeline `before` it.
    Repeated, late and lost frames are added to `totals`.

    Attributes
    ----------
    clock : Clock or None
        The clock of the recent stamps; None while too few have come.
    at_ticks : bool
        Whether frames are taken to be at the ticks of the clock.
    until_update : int
        Number of frames after which `update_clock` is to be called.

    """

    def __init__(
        self, settings: Settings, totals: Counter[str], before: 'Timeline | None' = None
    ) -> None:
        self._settings, self._totals = settings, totals
        self.clock: Clock | None = None
        self.at_ticks: bool = settings.stamps == 'arrival' if before is None else before.at_ticks
        self.until_update = FEWEST_SAMPLES
        says_ticks = before is not None and before._evidence.says_ticks
        self._evidence: TickEvidence = TickEvidence(says_ticks=says_ticks)
        self._last: LastFrame | None = None
        # Stamps of the frames, in parts, and which of the frames are used; number of all of them.
        self._appended = [(np.zeros(0, np.int64), np.zeros(0, bool))]
        self._seen = 0
        # Lost frames: in the totals, among frames before those kept here, among these at the last
        # update.
        self._lost = self._lost_before = self._lost_at_update = 0
        # Frames since the last update, and used frames that were not compared with neighbors yet.
        self._new = self._unweighed = 0
        # The least count of the last frame at the last update, and whether the rate changed since.
        self._count_at_update, self._rate_has_changed = 0, False
        # Whether even stamps may slip; the last stamp that did, and whether it is the next one.
        self._may_slip = self._has_slipped = False
        self._slipped_at: int | None = None
        # The clock that is known beforehand, and whether frames are at its ticks.
        self._known: tuple[Clock, bool] | None = None
        # None while frames are at their stamps.
        self._counter: FrameCounter | None = None
        # Frames that wait for their count, and the counts that the first of them got since.
        self._waiting: list[MarkerFrames] = []
        self._waiting_counts = _NO_COUNTS
        # The time, ns, of some count.
        self._anchor = 0, 0

    def know(self, clock: Clock, at_ticks: bool) -> None:
        """Take the clock of the next frames as it is known from all of them."""
        self._known = clock, at_ticks
        if not self._seen:
            self.at_ticks = at_ticks

    def stamp_state(self) -> StampState | None:
        """Return how the stamps lie on the clock; None while too few have come."""
        clock, evidence = self.clock, self._evidence
        if clock is None:
            return None
        moved = clock.jitter / clock.interval * evidence.speed
        costs = not self.at_ticks and evidence.nats > -DECISIVE_NATS and moved > 1.0
        lengths = {name: getattr(clock, name) * 1e-9 for name in ('interval', 'jitter', 'largest')}
        return StampState(**lengths, regularized=self.at_ticks, nats=evidence.nats, costs=costs)

    def accept(self, stamps: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """
        Decide which of the next frames are used.

        Parameters
        ----------
        stamps : (T,) int64
            Their stamps, ns.
        points : (T, ...) float
            Their markers, which distinguish a repeated frame from one with the same stamp.

        Returns
        -------
        used : (U,) int
            Which of the first n frames are used; the others are late or repeated.
        n : int
            Number of frames that are decided on.
        restarts : bool
            Whether frame n starts a new timeline. If not, and n < T, call `update_clock`, then
            `accept` the others.

        """
        # Stop where the clock is to be estimated again, as where stamps slip or show another rate.
        stamps = stamps[: self.until_update]
        if self._may_slip:
            stamps = stamps[: self._count_until_slip(stamps)]
        if len(stamps) and (self._counter is not None or self._may_slip):
            stamps = stamps[: self._count_until_other_rate(stamps)]
        count = len(stamps)
        if not count:
            return np.zeros(0, int), 0, False
        if self._last is None:
            self._last = LastFrame(int(stamps[0]) - 1, int(stamps[0]) - 1, None)
        if _are_steady(self._last, stamps, self._settings.window_ns):
            self._last = LastFrame(int(stamps[-1]), int(stamps[-1]), points[count - 1].copy())
            self._append(stamps, np.ones(count, bool))
            return np.arange(count), count, False
        window, lateness = self._settings.window_ns, self._max_lateness()
        found = judge_arrivals(self._last, stamps, points, window, lateness, self.at_ticks)
        self._last = found.last
        self._totals['late'] += found.late
        self._totals['repeated'] += found.repeated
        end = len(found.is_used)
        if end:
            self._append(stamps[:end][found.is_new], found.is_used[found.is_new])
        return found.is_used.nonzero()[0], end, end < count

    def _append(self, stamps: np.ndarray, is_used: np.ndarray) -> None:
        """Append the stamps (T,), ns, of new frames, some of which are used."""
        count = len(stamps)
        self._appended.append((stamps, is_used))
        self.until_update -= count
        self._seen += count
        self._new += count
        self._unweighed += int(np.count_nonzero(is_used))

    def _count_until_slip(self, stamps: np.ndarray) -> int:
        """Return how many of the next stamps (T,), ns, come before one that slips."""
        assert self.clock is not None and self._last is not None
        first = count_until_slip(stamps, self.clock, self._last.stamp, self._slipped_at)
        if not first:
            self._has_slipped, self._slipped_at, self.until_update = True, int(stamps[0]), 0
        return first

    def _count_until_other_rate(self, stamps: np.ndarray) -> int:
        """Return how many of the next stamps (T,), ns, come until they show another rate."""
        assert self.clock is not None
        number = FEWEST_SAMPLES - 1
        newest = [earlier[-number:] for earlier, _ in self._appended[-number:]]
        recent = np.concatenate(newest)[-number:]
        if len(recent) < number:
            return len(stamps)
        count = self._count_at_update + self._new
        shown = count_until_other_rate(recent, stamps, self.clock, count)
        if shown is None:
            return len(stamps)
        self._rate_has_changed, self.until_update = True, shown
        return shown

    def _max_lateness(self) -> int:
        """The most that a frame may be late, ns."""
        if not self.at_ticks and self._settings.stamps == 'capture':
            return 0
        if self.clock is None:
            return round(_MAX_INITIAL_LATENESS * self._settings.window_ns) if self.at_ticks else 0
        return round(self.clock.largest + self.clock.interval)

    def time_frames(
        self, frames: MarkerFrames, numbers: np.ndarray, history: History
    ) -> list[TimedFrames]:
        """
        Return the times of the next frames, and of those that waited, as far as they are certain.

        Parameters
        ----------
        frames : MarkerFrames
            The next T frames.
        numbers : (T,) int
            Their indices among all frames of this call of the tracker.
        history : History
            The frames before.

        Returns
        -------
        list of TimedFrames
            Frames to be appended to the history, in parts of one layout.

        """
        if self._known is not None and self.at_ticks and self.clock is None:
            self._begin_at_ticks(self._known[0], int(frames.stamps[0]))
        if self._counter is None and not self._waiting:
            counts = np.zeros(len(numbers), np.int64)
            times = _times_at_stamps([frames.stamps], history, self.at_ticks)
            return [TimedFrames(frames, times, counts, numbers)]
        parts = [*self._waiting, frames]
        if self._counter is None:
            times, counts = self._times_without_clock(parts, history)
            numbers = np.concatenate((np.repeat(numbers[:1], len(times) - len(numbers)), numbers))
        else:
            # A new counter may have counted frames that wait.
            counted, certain_with = self._counter.count_frames(frames.stamps, frames.points)
            earlier = np.repeat(numbers[:1], len(self._waiting_counts))
            numbers = np.concatenate((earlier, numbers[certain_with]))
            counts = np.concatenate((self._waiting_counts, counted))
            times = self._times_of(counts)
        self._waiting_counts = _NO_COUNTS
        certain, self._waiting = split_certain(parts, times, counts, numbers)
        return certain

    def _begin_at_ticks(self, clock: Clock, first_stamp: int) -> None:
        """Count the first frame, with this stamp, ns, and those after it, by a known clock."""
        before = int(clock.ticks(np.array(first_stamp))) - 1
        self.clock, self._counter = clock, FrameCounter(clock, before)
        self._anchor = clock.origin + round(clock.phase + before * clock.interval), before

    def time_waiting(self, history: History, number: int) -> list[TimedFrames]:
        """Return the frames that wait with their likeliest times, as of the frame `number`."""
        if not self._waiting:
            return []
        if self._counter is None:
            times, counts = self._times_without_clock(self._waiting, history)
        else:
            counts = np.concatenate((self._waiting_counts, self._counter.take_pending()))
            times = self._times_of(counts)
        self._waiting_counts = _NO_COUNTS
        numbers = np.full(len(times), number)
        certain, self._waiting = split_certain(self._waiting, times, counts, numbers)
        return certain

    def _times_without_clock(
        self, parts: list[MarkerFrames], history: History
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the times (T,) of frames at their stamps, ns, and their counts, which are 0."""
        times = _times_at_stamps([part.stamps for part in parts], history, self.at_ticks)
        return times, np.zeros(len(times), np.int64)

    def _times_of(self, counts: np.ndarray) -> np.ndarray:
        """Times (T,) of the ticks with these counts (T,), ns."""
        assert self.clock is not None
        time, count = self._anchor
        return np.asarray(time + (counts - count) * max(round(self.clock.interval), 1))

    def update_clock(self, history: History, noise: Real) -> None:
        """
        Estimate the clock, decide whether frames are at its ticks, and time the history.

        Parameters
        ----------
        history : History
            The frames so far; its times and counts are updated.
        noise : (B,) float
            Noise of a marker of each body, m, NaN while not known.

        """
        was_at_ticks = self.at_ticks
        if self._rate_has_changed:
            self._forget_earlier_rate()
        counts = self._estimate_clock(history, noise)
        self.at_ticks = self._are_at_ticks()
        # After a quarter more frames, and at the latest after a twentieth of those remembered.
        self.until_update = min(max(1, len(self._appended[0][0]) // 4), MEMORY // 20)
        assert self.clock is not None
        self._may_slip = (
            self._settings.stamps == 'auto' and not self.at_ticks and self.clock.is_even
        )
        if self.at_ticks:
            self._count_history(history, counts)
            if self._counter is not None:
                self._counter.noise = float(np.fmax.reduce(noise)) / self._settings.scale
        elif was_at_ticks:
            self._counter = None
            history['time'][...] = _increasing(history['stamp'])
        if self._counter is None:
            self._count_at_update = math.floor(self.clock.ticks(self._appended[0][0][-1]))
        else:
            # Frames in doubt may be late.
            self._count_at_update = self._counter.count + self._counter.pending

    def _forget_earlier_rate(self) -> None:
        """Keep only the newest stamps, which are all of the new rate."""
        kept, is_used = (np.concatenate(arrays) for arrays in zip(*self._appended, strict=True))
        self._appended = [(kept[-FEWEST_SAMPLES:], is_used[-FEWEST_SAMPLES:])]
        self._lost_before, self._lost_at_update = self._lost_before + self._lost_at_update, 0
        self._rate_has_changed = False
        self.clock = self._counter = None

    def _estimate_clock(self, history: History, noise: Real) -> np.ndarray:
        """Estimate the clock; return the counts (n,) of the newest frames of the history."""
        kept, is_used = (np.concatenate(arrays) for arrays in zip(*self._appended, strict=True))
        stamps, is_used = kept[-MEMORY:], is_used[-MEMORY:]
        uncounted = sum(len(part.stamps) for part in self._waiting)
        near = None if self._known is None else counts_if_near(stamps, self._known[0])
        if self._known is not None and near is not None:
            clock, counts = self._known[0], near
        else:
            clock, counts = estimate_clock(stamps, self.clock)
        if self._counter is not None and self._counter.keeps_pace:
            # The frames of the history were counted by the motion: the clock is that of the counts.
            which = np.flatnonzero(is_used)
            which = which[: len(which) - uncounted][-len(history) :]
            own = history['tick'][len(history) - len(which) :]
            clock, counts = clock_of(clock, counts, stamps, which, own)
        stamps, is_used = (part[len(part) - len(counts) :] for part in (stamps, is_used))
        counted = is_used.nonzero()[0]
        counted = counted[: len(counted) - uncounted]
        self._weigh_motion(history, clock, counts[counted], noise)
        if clock.is_on_grid and self._evidence.denies_grid(self._settings.stamps):
            clock, counts = even_clock(stamps, clock) or (clock, counts)
        self._appended = [(stamps, is_used)]
        self._count_lost_at_update(clock, kept, counts)
        self.clock = clock
        return np.asarray(counts[counted])

    def count_lost(self) -> None:
        """Count the frames that were lost up to now in the totals."""
        lost = self._lost_before + self._lost_at_update
        if self._new and self.clock is not None and self._shows_losses(self.clock):
            stamps = np.concatenate([stamps for stamps, _ in self._appended])
            counts = count_frames(stamps[-self._new - UNSETTLED - 1 :], self.clock)
            lost += lost_between(counts[:-UNSETTLED])
        self._totals['lost'] += lost - self._lost
        self._lost = lost

    def _count_lost_at_update(self, clock: Clock, stamps: np.ndarray, counts: np.ndarray) -> None:
        """Count the frames lost between those with stamps (N,), ns; the newest have counts (n,)."""
        dropped = len(stamps) - len(counts)
        if dropped and self.clock is not None and self._shows_losses(self.clock):
            self._lost_before += lost_between(count_frames(stamps, self.clock)[: dropped + 1])
        shown = self._shows_losses(clock)
        self._lost_at_update = lost_between(counts[:-UNSETTLED]) if shown else 0
        self._new = 0

    def _shows_losses(self, clock: Clock) -> bool:
        """Whether stamps are near ticks: stamps far from all of them do not show any loss."""
        return self.at_ticks or clock.is_on_grid or clock.largest < clock.interval / 2

    def _weigh_motion(
        self, history: History, clock: Clock, counts: np.ndarray, noise: Real
    ) -> None:
        """Add the evidence of the motion for a clock, in the frames that were not compared yet."""
        number = min(len(history), len(counts), self._unweighed + SIDE)
        if self._seen < MIN_SAMPLES or number < FEWEST_WEIGHED:
            return
        self._unweighed = UNSETTLED + SIDE
        interval, half_life = clock.interval, HALF_LIFE * self._settings.window_ns
        self._evidence = add_evidence(
            self._evidence, history, counts, number, interval, half_life, noise
        )

    def _are_at_ticks(self) -> bool:
        """Whether frames are taken to be at ticks from now on."""
        clock = self.clock
        if self._settings.stamps != 'auto' or clock is None:
            return self.at_ticks
        if self._known is not None:
            return self._known[1]
        rounded = clock.is_rounded or self._has_slipped
        rounded = rounded and self._seen >= MIN_SAMPLES and self._evidence.nats > -DECISIVE_NATS
        self._has_slipped = False
        # No clock explains lateness of a window or more.
        in_window = clock.largest < self._settings.window_ns
        return (self._evidence.says_ticks or rounded) and in_window

    def _count_history(self, history: History, counts: np.ndarray) -> None:
        """Put the frames of the history at ticks; the newest have these counts (n,)."""
        clock = self.clock
        assert clock is not None
        first = max(len(history) - len(counts), 0)
        counts = counts[len(counts) - (len(history) - first) :]
        if self._counter is not None:
            counts = self._keep_counts(history['tick'][first:], counts)
        if self._counter is None:
            counts = self._start_counter(history, first, counts)
        assert self._counter is not None
        count = self._counter.count
        self._anchor = clock.origin + round(clock.phase + count * clock.interval), count
        self._counter.learn_losses(counts)
        history['tick'][first:] = counts
        history['time'][first:] = self._times_of(counts)
        # Earlier frames had another rate: they are at their stamps, less the mean lateness.
        before = _increasing(history['stamp'][:first] - round(clock.lateness))
        if first < len(history):
            latest = history['time'][first] - _MIN_STEP * np.arange(first, 0, -1)
            before = np.minimum(before, latest)
        history['time'][:first] = before

    def _keep_counts(self, own: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Return counts (n,) by the motion, `own`, on the new clock, if its rate is the same."""
        assert self._counter is not None and self.clock is not None
        # Counts by the motion are better than those by the stamps alone.
        offsets, frequencies = np.unique(counts - own, return_counts=True)
        offset = int(offsets[frequencies.argmax()]) if len(own) else 0
        if np.mean(np.abs(counts - own - offset) <= 1) > _SAME_RATE_SHARE:
            self._counter.move(offset)
            self._counter.follow(self.clock)
            return own + offset
        self._counter = None
        return counts

    def _start_counter(self, history: History, first: int, counts: np.ndarray) -> np.ndarray:
        """Count the frames of the history from `first` on, and those that wait, by the motion."""
        assert self.clock is not None
        self._counter = FrameCounter(self.clock, int(counts[0]) if len(counts) else -1)
        if len(counts):
            markers = history['markers'][first + 1 :].view(float)
            counted, _ = self._counter.count_frames(history['stamp'][first + 1 :], markers)
            counts = np.concatenate((counts[:1], counted, self._counter.take_pending()))
        waiting = [self._counter.count_frames(p.stamps, p.points)[0] for p in self._waiting]
        self._waiting_counts = np.concatenate([_NO_COUNTS, *waiting])
        return counts


def _are_steady(last: LastFrame, stamps: np.ndarray, window: int) -> bool:
    """Whether each of the next stamps, ns, follows those before by a window at most."""
    if not 0 < int(stamps[0]) - last.newest <= window:
        return False
    if len(stamps) == 1:
        return True
    steps = stamps[1:] - stamps[:-1]
    return bool(np.minimum.reduce(steps) > 0 and np.maximum.reduce(steps) <= window)


def _times_at_stamps(parts: list[np.ndarray], history: History, may_repeat: bool) -> np.ndarray:
    """Times (T,), ns, of the next frames, by parts of their stamps, which may repeat or not."""
    before = int(parts[0][0]) - _MIN_STEP
    if history.end > history.first:
        before = int(history.columns['time'][history.end - 1])
    times = []
    for stamps in parts:
        increase = stamps[0] > before
        if len(stamps) > 1:
            increase = increase and not (stamps[1:] <= stamps[:-1]).any()
        if may_repeat or not increase:
            stamps = _increasing(np.concatenate(((before,), stamps)))[1:]
        times.append(stamps)
        before = int(stamps[-1])
    return np.concatenate(times) if times[1:] else times[0]


def _increasing(stamps: np.ndarray) -> np.ndarray:
    """Return times (T,) that increase, from stamps that may not."""
    least = _MIN_STEP * np.arange(len(stamps))
    return np.asarray(np.maximum.accumulate(stamps - least) + least)
