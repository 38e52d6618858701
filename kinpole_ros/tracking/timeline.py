"""
When frames were captured: at their stamps, or at the ticks of the clock behind these.

Header stamps and the motion alone decide; nobody asks for the time.
"""

from collections import Counter

import numpy as np

from kinpole_ros.tracking.arrivals import Arrivals
from kinpole_ros.tracking.counter import Counter as FrameCounter
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.stamps import StampHistory, StampState

# ns. Frames are no nearer to each other than this.
_LEAST_STEP = 1000
# Before the clock is known a frame may be late by this share of the window.
_PLAUSIBLE = 1 / 4
# The rate is the same if this share of the frames is counted alike as before.
_SAME_RATE = 0.5


class Timeline:
    """
    The times of the frames of a `history`, from one that starts anew on.

    It goes on as the one `before` a jump of the stamps did: at stamps, or at ticks. Frames that are
    repeated, late or lost are added to `counts`.
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
        known = None if before is None else before._stamps
        self._stamps: StampHistory = StampHistory(settings.stamps, self._window, known)
        self._regular = self._stamps.regular
        # What frames are counted by; None where they are at stamps, or it is not known yet.
        self._counter: FrameCounter | None = None
        self._scale = settings.scale
        # Frames that wait for their count, and counts of those to be entered.
        self._uncounted: list[MarkerFrames] = []
        self._counted = np.zeros(0, np.int64)
        # The time of a count, and from one to the next.
        self._anchor = 0, 0
        self._step = 0

    @property
    def regular(self) -> bool:
        """Whether frames are taken to be at ticks of the clock."""
        return self._regular

    def stamp_state(self) -> StampState | None:
        """How the stamps are; None while too few have come."""
        return self._stamps.state()

    def accept(self, stamps: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """
        Up to where frames of `stamps` (T,) go on, and whether the next starts anew.

        Also how far each is ahead of all before it, ns: it is one to take where that is positive.
        Where nothing starts anew and not all go on, the clock is to be updated first. `points`
        (T, ...) tell a frame that is repeated from one with the stamp of another.
        """
        stamps = stamps[: self._stamps.until_update]
        stamps = stamps[: self._stamps.until_slip(stamps)]
        if not len(stamps):
            return stamps, 0, False
        ahead, end, came = self._arrivals.accept(stamps, points, self._regular, self._plausible())
        if end:
            self._stamps.append(stamps[:end][came], (ahead > 0)[came])
        return ahead, end, end < len(stamps)

    def _plausible(self) -> int:
        """By how much a frame may be late, ns."""
        clock = self._stamps.clock
        if not self._regular and self._stamps.mode == 'capture':
            return 0
        if clock is None:
            return round(_PLAUSIBLE * self._window) if self._regular else 0
        return round(clock.largest + clock.interval)

    def count(
        self, frames: MarkerFrames, numbers: np.ndarray
    ) -> list[tuple[MarkerFrames, np.ndarray]]:
        """
        Frames whose times are sure now, to be entered: some from before, and some of `frames` (T,).

        Also the `numbers` (T,) of the frames with which they became so. The others wait.
        """
        if self._counter is None and not self._uncounted:
            return [(frames, numbers)]
        parts = [*self._uncounted, frames]
        if self._counter is None:
            waiting = sum(len(part.stamps) for part in self._uncounted)
            numbers = np.concatenate((np.repeat(numbers[:1], waiting), numbers))
        else:
            counts, sure_with = count_frames(self._counter, frames.stamps, frames.points)
            self._counted = np.concatenate((self._counted, counts))
            numbers = numbers[sure_with]
        self._uncounted, sure = [], []
        for part in parts:
            number = min(len(part.stamps), len(numbers))
            if number:
                sure.append((part_of(part, slice(number)), numbers[:number]))
            if number < len(part.stamps):
                self._uncounted.append(part_of(part, slice(number, None)))
            numbers = numbers[number:]
        return sure

    def enter(self, stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Times, ns, and counts (T,) of frames that are to be appended to the history next."""
        times = self.history['time']
        before = int(times[-1]) if len(times) else int(stamps[0]) - _LEAST_STEP
        if self._counter is not None:
            fresh, self._counted = np.split(self._counted, [len(stamps)])
            return self._times(fresh), fresh
        rising = stamps
        several = len(stamps) > 1
        if self._regular or stamps[0] <= before or (several and (stamps[1:] <= stamps[:-1]).any()):
            rising = _rising(np.concatenate(((before,), stamps)))[1:]
        return rising, np.zeros(len(stamps), np.int64)

    def _times(self, counts: np.ndarray) -> np.ndarray:
        """When frames with `counts` (T,) were, ns: in even steps."""
        time, count = self._anchor
        return np.asarray(time + (counts - count) * self._step)

    @property
    def clock_update_is_due(self) -> bool:
        """Whether `update_clock` is to be called before more frames come."""
        return self._stamps.until_update <= 0

    def update_clock(self, samples: int, noise: np.ndarray) -> None:
        """
        Estimate the clock, and give the frames of the history their times by it.

        `samples` is the number of frames in the window, `noise` (B,), m, that of a marker of each
        body.
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
        """Take frames to be at ticks, of which the newest have these `counts` (n,)."""
        clock, history = self._stamps.clock, self.history
        assert clock is not None
        self._regular = True
        self._step = max(round(clock.interval), 1)
        first = max(len(history) - len(counts), 0)
        counts = counts[len(counts) - (len(history) - first) :]
        if self._counter is not None:
            # By the motion they are counted better than by the stamps alone.
            own = history['count'][first:]
            offsets, times = np.unique(counts - own, return_counts=True)
            usual = int(offsets[times.argmax()]) if len(own) else 0
            if np.mean(np.abs(counts - own - usual) <= 1) > _SAME_RATE:
                counts = own + usual
                self._counter.move(usual)
                self._counter.follow(clock)
            else:
                self._counter = None
        if self._counter is None:
            self._counter = FrameCounter(clock, int(counts[0]) if len(counts) else -1)
            # Those that wait are counted by the clock up to now.
            if len(counts) and not self._uncounted:
                markers = history['markers'][first + 1 :].view(float)
                stamps = history['stamp'][first + 1 :]
                counted, _ = count_frames(self._counter, stamps, markers)
                counts = np.concatenate((counts[:1], counted, self._counter.take_pending()))
        count = self._counter.count
        self._anchor = clock.origin + round(clock.phase + count * clock.interval), count
        self._counter.learn_losses(counts)
        history['count'][first:] = counts
        history['time'][first:] = self._times(counts)
        # Frames of another rate.
        before = history['stamp'][:first] - round(clock.lateness)
        history['time'][:first] = _rising(before)

    def _to_stamps(self) -> None:
        """Take frames to be at their stamps from now on."""
        self._regular, self._counter = False, None
        self.history['time'][...] = _rising(self.history['stamp'])


def _rising(stamps: np.ndarray) -> np.ndarray:
    """Times (T,) that rise, from stamps that need not."""
    least = _LEAST_STEP * np.arange(len(stamps))
    return np.asarray(np.maximum.accumulate(stamps - least) + least)


def count_frames(
    counter: FrameCounter, stamps: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Count frames (T,): the sure counts (R,), and the frames with which each became sure."""
    counts, sure_with = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    first = 0
    while first < len(stamps):
        plain = counter.plain(stamps[first:])
        if plain:
            counts.append(counter.take_plain(points[first : first + plain]))
            sure_with.append(np.arange(first, first + plain))
            first += plain
        if first < len(stamps):
            counts.append(counter.take(int(stamps[first]), points[first]))
            sure_with.append(np.full(len(counts[-1]), first))
            first += 1
    return np.concatenate(counts), np.concatenate(sure_with)
