"""
When frames were captured: at their stamps, or at the ticks of the clock behind the stamps.

The count of a frame is the number of its tick. Only the stamps and the motion decide, never the
clock of the machine.
"""

from collections import Counter

import numpy as np

from kinpole_ros.tracking.counter import Counter as FrameCounter
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.stamps import StampHistory, StampState

# ns. The least time between two frames.
_MIN_STEP = 1000
# A frame may be late by this share of the window before the clock is known.
_MAX_INITIAL_LATENESS = 1 / 4
# The rate is the same if the counts of this share of the frames agree with those before.
_SAME_RATE_SHARE = 0.5


class Timeline:
    """
    The times of the frames of a history, since its start.

    After a jump of the stamps frames are at stamps or at ticks as in the timeline `before` it.
    Repeated, late and lost frames are added to `counts`.
    """

    def __init__(
        self,
        settings: Settings,
        counts: Counter[str],
        history: History,
        before: 'Timeline | None' = None,
    ) -> None:
        self.history = history
        self._window = round(settings.window * 1e9)
        self._counts = counts
        self._arrivals = Arrivals(self._window, counts)
        earlier = None if before is None else before._stamps
        self._stamps: StampHistory = StampHistory(settings.stamps, self._window, earlier)
        self._regular = self._stamps.regular
        # None while frames are at their stamps.
        self._counter: FrameCounter | None = None
        self._scale = settings.scale
        # Frames that wait for their count, and counts of the next frames to be entered.
        self._uncounted: list[MarkerFrames] = []
        self._next_counts = np.zeros(0, np.int64)
        # The time of some count, and the time between two counts, ns.
        self._anchor = 0, 0
        self._step = 0

    @property
    def regular(self) -> bool:
        """Whether frames are taken to be at the ticks of the clock."""
        return self._regular

    def stamp_state(self) -> StampState | None:
        """Return how the stamps lie on the clock; None while too few have come."""
        return self._stamps.state()

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
        # Stop where the clock is to be estimated again, or where the stamps slip against it.
        count = min(len(stamps), self._stamps.until_update)
        count = self._stamps.until_slip(stamps[:count])
        if not count:
            return np.zeros(0, int), 0, False
        stamps = stamps[:count]
        if self._arrivals.append_steady(stamps, points):
            self._stamps.append(stamps, np.ones(count, bool))
            return np.arange(count), count, False
        is_used, end, is_new = self._arrivals.accept(
            stamps, points, self._regular, self._max_lateness()
        )
        if end:
            self._stamps.append(stamps[:end][is_new], is_used[is_new])
        return is_used.nonzero()[0], end, end < count

    def _max_lateness(self) -> int:
        """The most that a frame may be late, ns."""
        clock = self._stamps.clock
        if not self._regular and self._stamps.mode == 'capture':
            return 0
        if clock is None:
            return round(_MAX_INITIAL_LATENESS * self._window) if self._regular else 0
        return round(clock.largest + clock.interval)

    def count(
        self, frames: MarkerFrames, numbers: np.ndarray
    ) -> list[tuple[MarkerFrames, np.ndarray]]:
        """
        Count the next frames; return those whose count is certain, also of the ones that waited.

        Parameters
        ----------
        frames : MarkerFrames
            The next T frames.
        numbers : (T,) int
            Their indices among all frames of this call of the tracker.

        Returns
        -------
        list of (MarkerFrames, (n,) int)
            Frames to be entered next, and the number of the frame with which each became certain.

        """
        if self._counter is None and not self._uncounted:
            return [(frames, numbers)]
        parts = [*self._uncounted, frames]
        if self._counter is None:
            waiting = sum(len(part.stamps) for part in self._uncounted)
            numbers = np.concatenate((np.repeat(numbers[:1], waiting), numbers))
        else:
            # A new counter may have counted frames that wait.
            counted = np.repeat(numbers[:1], len(self._next_counts))
            counts, certain_with = count_frames(self._counter, frames.stamps, frames.points)
            self._next_counts = np.concatenate((self._next_counts, counts))
            numbers = np.concatenate((counted, numbers[certain_with]))
        self._uncounted, certain = [], []
        for part in parts:
            number = min(len(part.stamps), len(numbers))
            if number:
                certain.append((part_of(part, slice(number)), numbers[:number]))
            if number < len(part.stamps):
                self._uncounted.append(part_of(part, slice(number, None)))
            numbers = numbers[number:]
        return certain

    def enter(self, stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the times, ns, and counts (T,) of frames that are appended to the history next."""
        times = self.history['time']
        before = int(times[-1]) if len(times) else int(stamps[0]) - _MIN_STEP
        if self._counter is not None:
            counts, self._next_counts = np.split(self._next_counts, [len(stamps)])
            return self._times_of(counts), counts
        times_now = stamps
        several = len(stamps) > 1
        if self._regular or stamps[0] <= before or (several and (stamps[1:] <= stamps[:-1]).any()):
            times_now = _increasing(np.concatenate(((before,), stamps)))[1:]
        return times_now, np.zeros(len(stamps), np.int64)

    def _times_of(self, counts: np.ndarray) -> np.ndarray:
        """Times (T,) of the ticks with these counts (T,), ns."""
        time, count = self._anchor
        return np.asarray(time + (counts - count) * self._step)

    @property
    def clock_update_is_due(self) -> bool:
        """Whether `update_clock` is to be called before more frames come."""
        return self._stamps.until_update <= 0

    def update_clock(self, samples: int, noise: np.ndarray) -> None:
        """
        Estimate the clock, and the times of the frames of the history.

        Parameters
        ----------
        samples : int
            Number of frames in the window.
        noise : (B,) float
            Noise of a marker of each body, m.

        """
        lost = self._stamps.lost
        uncounted = sum(len(part.stamps) for part in self._uncounted)
        counted = self._counter is not None and self._counter.keeps_pace
        counts = self._stamps.update(self.history, samples, uncounted, noise, counted)
        self._counts['lost'] += self._stamps.lost - lost
        if self._stamps.regular:
            self._to_ticks(counts)
            if self._counter is not None:
                self._counter.noise = float(np.fmax.reduce(noise)) / self._scale
        elif self._regular:
            self._to_stamps()

    def _to_ticks(self, counts: np.ndarray) -> None:
        """Put frames at ticks; the newest have these counts (n,)."""
        clock, history = self._stamps.clock, self.history
        assert clock is not None
        self._regular = True
        self._step = max(round(clock.interval), 1)
        first = max(len(history) - len(counts), 0)
        counts = counts[len(counts) - (len(history) - first) :]
        if self._counter is not None:
            # Counts by the motion are better than those by the stamps alone.
            own = history['count'][first:]
            offsets, frequencies = np.unique(counts - own, return_counts=True)
            offset = int(offsets[frequencies.argmax()]) if len(own) else 0
            if np.mean(np.abs(counts - own - offset) <= 1) > _SAME_RATE_SHARE:
                counts = own + offset
                self._counter.move(offset)
                self._counter.follow(clock)
            else:
                self._counter = None
        if self._counter is None:
            self._counter = FrameCounter(clock, int(counts[0]) if len(counts) else -1)
            if len(counts):
                markers = history['markers'][first + 1 :].view(float)
                stamps = history['stamp'][first + 1 :]
                counted, _ = count_frames(self._counter, stamps, markers)
                counts = np.concatenate((counts[:1], counted, self._counter.take_pending()))
            waiting = [count_frames(self._counter, p.stamps, p.points)[0] for p in self._uncounted]
            self._next_counts = np.concatenate([self._next_counts[:0], *waiting])
        count = self._counter.count
        self._anchor = clock.origin + round(clock.phase + count * clock.interval), count
        self._counter.learn_losses(counts)
        history['count'][first:] = counts
        history['time'][first:] = self._times_of(counts)
        # Earlier frames had another rate: they are at their stamps, less the mean lateness.
        before = _increasing(history['stamp'][:first] - round(clock.lateness))
        if first < len(history):
            latest = history['time'][first] - _MIN_STEP * np.arange(first, 0, -1)
            before = np.minimum(before, latest)
        history['time'][:first] = before

    def _to_stamps(self) -> None:
        """Put frames at their stamps."""
        self._regular, self._counter = False, None
        self.history['time'][...] = _increasing(self.history['stamp'])


def _increasing(stamps: np.ndarray) -> np.ndarray:
    """Times (T,) that increase, from stamps that may not."""
    least = _MIN_STEP * np.arange(len(stamps))
    return np.asarray(np.maximum.accumulate(stamps - least) + least)


def count_frames(
    counter: FrameCounter, stamps: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    Count frames.

    Parameters
    ----------
    counter : FrameCounter
        Counts frames one after the other.
    stamps : (T,) int64
        Stamps, ns.
    points : (T, ...) float
        Markers, NaN for those not seen.

    Returns
    -------
    (R,) int64, (R,) int
        Counts that are certain, and the index of the frame with which each became certain.

    """
    counts, certain_with = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    first = 0
    while first < len(stamps):
        number = counter.count_unambiguous(stamps[first:])
        if number:
            counts.append(counter.append_unambiguous(points[first : first + number]))
            certain_with.append(np.arange(first, first + number))
            first += number
        if first < len(stamps):
            counts.append(counter.append(int(stamps[first]), points[first]))
            certain_with.append(np.full(len(counts[-1]), first))
            first += 1
    return np.concatenate(counts), np.concatenate(certain_with)


class Arrivals:
    """
    Decides by the stamps which frames follow those before.

    A frame that comes late is left out, and so is one that comes twice. A clock that steps back, or
    a gap longer than the window, restarts everything. Frames that are left out are added to
    `counts`.
    """

    def __init__(self, window: int, counts: Counter[str]) -> None:
        self._window = window
        self._counts = counts
        # Stamp and points of the last frame, used or not, and the latest stamp.
        self._last = self._newest = 0
        self._last_points: np.ndarray | None = None

    def append_steady(self, stamps: np.ndarray, points: np.ndarray) -> bool:
        """Use the next frames if each is later than those before, by a window at most."""
        count = len(stamps)
        if self._last_points is None:
            self._last = self._newest = int(stamps[0]) - 1
        if not 0 < int(stamps[0]) - self._newest <= self._window:
            return False
        if count > 1:
            steps = stamps[1:] - stamps[:-1]
            if np.minimum.reduce(steps) <= 0 or np.maximum.reduce(steps) > self._window:
                return False
        self._last = self._newest = int(stamps[-1])
        self._last_points = points[count - 1].copy()
        return True

    def accept(
        self, stamps: np.ndarray, points: np.ndarray, may_be_late: bool, max_lateness: int
    ) -> tuple[np.ndarray, int, np.ndarray]:
        """
        Decide which of the next frames are used, where these are not steady.

        Parameters
        ----------
        stamps, points
            As for `Timeline.accept`.
        may_be_late : bool
            Whether frames may come late. Otherwise each has to be later than all before.
        max_lateness : int
            The most that they may be late, ns.

        Returns
        -------
        is_used : (n,) bool
            Which of the first n frames are used.
        n : int
            The frame that restarts everything, or their number.
        is_new : (n,) bool
            Which of the n frames are not repeated.

        """
        end = len(stamps)
        # The latest stamp before each frame.
        latest = np.maximum.accumulate(np.concatenate(((self._newest,), stamps[:-1])))
        before = np.concatenate(((self._last,), stamps[:-1]))
        ahead = stamps - latest
        too_late = ahead <= -max_lateness
        # A frame that is too late is just late. Two in a row, the second newer than the first,
        # come from a clock that was set back.
        restarts = too_late & (before < latest) & (before < stamps)
        restarts |= np.abs(ahead) > self._window
        end = int(restarts.argmax()) if restarts.any() else end
        ahead, too_late = ahead[:end], too_late[:end]
        repeated = self._repeated((stamps == before)[:end], points)
        if may_be_late:
            late, twice, is_used = too_late, repeated, ~(too_late | repeated)
        else:
            late, twice, is_used = ahead < 0, ahead == 0, ahead > 0
        self._counts['late'] += int(late.sum())
        self._counts['repeated'] += int(twice.sum())
        is_new = ~repeated
        if end:
            self._newest = max(self._newest, int(np.maximum.reduce(stamps[:end])))
            self._last, self._last_points = int(stamps[end - 1]), points[end - 1].copy()
        return is_used, end, is_new

    def _repeated(self, same_stamp: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Which frames (T,) are equal to the one before, of those with the same stamp."""
        repeated = np.zeros(len(same_stamp), bool)
        for k in same_stamp.nonzero()[0].tolist():
            before = points[k - 1] if k else self._last_points
            repeated[k] = before is not None and np.array_equal(points[k], before, equal_nan=True)
        return repeated
