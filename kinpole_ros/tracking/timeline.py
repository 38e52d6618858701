"""
When frames were captured: at their stamps, or at the ticks of the clock behind these.

Header stamps and the motion alone decide; nobody asks for the time.
"""

from collections import Counter

import numpy as np

from kinpole_ros.tracking.arrivals import Arrivals
from kinpole_ros.tracking.clock import MAX_PENDING, Clock, ambiguous_frames, count_arrivals
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.stamps import StampHistory, StampState

# ns. Frames are no nearer to each other than this.
_LEAST_STEP = 1000
# Before the clock is known a frame may be late by this share of the window.
_PLAUSIBLE = 1 / 4


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
        self._clock: Clock | None = None
        # Of the newest frame that is counted, and by how much counts are ahead of the clock.
        self._count = self._shift = 0
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
        parts = [*self._uncounted, frames]
        stamps = np.concatenate([part.stamps for part in parts])
        if self._clock is None:
            counts, sure_with = np.zeros(0, np.int64), np.arange(len(stamps))
        else:
            counts, sure_with, self._shift = count_arrivals(
                stamps, self._clock, self._count, self._shift
            )
        self._counted = np.concatenate((self._counted, counts))
        if len(counts):
            self._count = int(counts[-1])
        numbers = numbers[np.maximum(sure_with - (len(stamps) - len(frames.stamps)), 0)]
        self._uncounted, sure = [], []
        for part in parts:
            number = min(len(part.stamps), len(numbers))
            if number:
                sure.append((part_of(part, slice(number)), numbers[:number]))
            if number < len(part.stamps):
                self._uncounted.append(part_of(part, slice(number, None)))
            numbers = numbers[number:]
        return sure

    def enter(self, stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Times, ns, and counts (T,) of frames that are to be appended to the history next.

        Also which may be from before or after a loss, so that their times are not sure.
        """
        times, counts = self.history['time'], self.history['count']
        before = int(times[-1]) if len(times) else int(stamps[0]) - _LEAST_STEP
        ambiguous = np.zeros(len(stamps), bool)
        if self._clock is not None:
            fresh, self._counted = np.split(self._counted, [len(stamps)])
            every = np.concatenate((counts[-MAX_PENDING:], fresh))
            ambiguous = ambiguous_frames(every, self._clock)[len(every) - len(stamps) :]
            return self._times(fresh), fresh, ambiguous
        rising = stamps
        if self._regular or stamps[0] <= before or (stamps[1:] <= stamps[:-1]).any():
            rising = _rising(np.concatenate(((before,), stamps)))[1:]
        return rising, np.zeros(len(stamps), np.int64), ambiguous

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
        counts = self._stamps.update(self.history, samples, uncounted, noise)
        self._counts['lost'] += self._stamps.lost - lost
        if self._stamps.regular:
            self._to_ticks(counts)
        elif self._regular:
            self._to_stamps()

    def _to_ticks(self, counts: np.ndarray) -> None:
        """Take frames to be at ticks, of which the newest have these `counts` (n,)."""
        clock, history = self._stamps.clock, self.history
        assert clock is not None
        self._regular = True
        self._clock, self._shift = clock, 0
        self._step = max(round(clock.interval), 1)
        first = max(len(history) - len(counts), 0)
        self._count = int(counts[-1]) if len(history) > first else -1
        self._anchor = clock.origin + round(clock.phase + self._count * clock.interval), self._count
        counted = counts[len(counts) - (len(history) - first) :]
        history['count'][first:] = counted
        history['time'][first:] = self._times(counted)
        ambiguous = ambiguous_frames(counted, clock)
        history['ambiguous'][first:][ambiguous] = True
        history['information'][first:][ambiguous] = 0.0
        # Frames of another rate.
        before = history['stamp'][:first] - round(clock.lateness)
        history['time'][:first] = _rising(before)

    def _to_stamps(self) -> None:
        """Take frames to be at their stamps from now on."""
        self._regular, self._clock = False, None
        self.history['time'][...] = _rising(self.history['stamp'])


def _rising(stamps: np.ndarray) -> np.ndarray:
    """Times (T,) that rise, from stamps that need not."""
    least = _LEAST_STEP * np.arange(len(stamps))
    return np.asarray(np.maximum.accumulate(stamps - least) + least)
