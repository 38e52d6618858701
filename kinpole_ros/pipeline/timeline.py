"""
The frames that are held: when they were, what their windows hold, what falls due.

Header stamps alone decide; nobody asks for the time. Frames are at their stamps, or at the ticks of
the clock behind these: see `ticks`.
"""

from collections import Counter
from collections.abc import Callable

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES, Windows
from kinpole_ros.pipeline.arrivals import Arrivals
from kinpole_ros.pipeline.bodies import pose_columns
from kinpole_ros.pipeline.clock import MAX_PENDING, Clock, ambiguous_frames, count_arrivals
from kinpole_ros.pipeline.frame import MarkerFrames, part_of
from kinpole_ros.pipeline.parameters import Settings
from kinpole_ros.pipeline.stamps import StampHistory, StampState
from kinpole_ros.rigid import Samples

# Frames later than this many intervals of late come after a gap.
_LATE = 2.5
# ns. Frames are no nearer to each other than this.
_LEAST_STEP = 1000
# Before the clock is known a frame may be late by this share of the window.
_PLAUSIBLE = 1 / 4


def _frame_type(bodies: int) -> np.dtype:
    """What is held of a frame, in one row."""
    columns: list[tuple] = [
        ('stamp', np.int64),
        # When it was captured, ns: its stamp, or its tick of the clock.
        ('time', np.int64),
        # Its tick, if it is counted.
        ('count', np.int64),
        # While it waits: its number among the frames that were given together, the oldest frame in
        # the window, and the mean interval, ns.
        ('number', np.int64),
        ('oldest', np.int64),
        ('interval', float),
        *pose_columns(bodies),
    ]
    return np.dtype(columns, align=True)


class Timeline:
    """
    Frames from one that starts anew on, those that a window to come may hold.

    `samples` is how many the window of the newest holds, `interval` the mean time between them in
    ns, 0 for fewer than two, and `dropped` how many frames were held and are no more. It goes on as
    the one `before` a jump of the stamps did: at stamps, or at ticks.
    """

    def __init__(
        self, settings: Settings, counts: Counter[str], before: 'Timeline | None' = None
    ) -> None:
        self.samples = 0
        self.interval = 0.0
        self.dropped = 0
        self.window = round(settings.window * 1e9)
        self._lag = settings.lag * 1e9
        self._counts = counts
        self._frames = Samples((), _frame_type(len(settings.bodies)))
        self._due = 0
        # How many of the newest frames are not estimated yet.
        self._waiting = 0
        self._arrivals = Arrivals(self.window, counts)
        known = None if before is None else before._history
        self._history: StampHistory = StampHistory(settings.stamps, self.window, known)
        self._regular = self._history.regular
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

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def newest(self) -> int:
        """The stamp of the newest frame that is held, ns."""
        return int(self._frames.view()['stamp'][-1])

    def view(self) -> np.ndarray:
        """All frames, oldest first; valid until more come."""
        return self._frames.view()

    @property
    def regular(self) -> bool:
        """Whether frames are taken to be at ticks of the clock."""
        return self._regular

    def stamp_state(self) -> StampState | None:
        """How the stamps are; None while too few have come."""
        return self._history.state()

    def accept(self, stamps: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """
        Up to where frames of `stamps` (T,) go on, and whether the next starts anew.

        Also how far each is ahead of all before it, ns: it is one to take where that is positive.
        Where nothing starts anew and not all go on, the clock is to be updated first. `points`
        (T, ...) tell a frame that is repeated from one with the stamp of another.
        """
        stamps = stamps[: self._history.until_update]
        stamps = stamps[: self._history.until_slip(stamps)]
        if not len(stamps):
            return stamps, 0, False
        ahead, end, came = self._arrivals.accept(stamps, points, self._regular, self._plausible())
        if end:
            self._history.append(stamps[:end][came], (ahead > 0)[came])
        return ahead, end, end < len(stamps)

    def _plausible(self) -> int:
        """By how much a frame may be late, ns."""
        clock = self._history.clock
        if not self._regular and self._history.mode == 'capture':
            return 0
        if clock is None:
            return round(_PLAUSIBLE * self.window) if self._regular else 0
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

    def enter(self, stamps: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Rows for frames that wait to be estimated from now on, to be filled.

        Also which (T,) come much later than those before did. `numbers` (T,) are theirs.
        """
        rows = self._frames.room(len(stamps))
        rows['stamp'], rows['number'] = stamps, numbers
        self._waiting += len(stamps)
        times = self._frames.view()['time']
        first = len(times) - len(rows)
        before = int(times[first - 1]) if first else int(stamps[0]) - _LEAST_STEP
        if self._clock is not None:
            rows['count'], self._counted = np.split(self._counted, [len(rows)])
            rows['time'] = self._times(rows['count'])
        elif self._regular or np.diff(stamps, prepend=before).min() <= 0:
            rows['time'] = _rising(np.concatenate(((before,), stamps)))[1:]
        else:
            rows['time'] = stamps
        newest = np.arange(first, len(times))
        rows['oldest'] = times.searchsorted(rows['time'] - self.window)
        held = newest - rows['oldest']
        rows['interval'] = (rows['time'] - times[rows['oldest']]) / np.maximum(held, 1)
        # As the window was before the frame came.
        mean = np.concatenate(((self.interval,), rows['interval'][:-1]))
        self.samples, self.interval = int(held[-1]) + 1, float(rows['interval'][-1])
        return rows, (np.diff(rows['time'], prepend=before) > _LATE * mean) & (mean > 0)

    def leave_out_ambiguous(self, number: int) -> None:
        """Give no weight to those of the newest frames that may be from before or after a loss."""
        if self._clock is None:
            return
        every = self._frames.view()[-number - MAX_PENDING :]
        ambiguous = ambiguous_frames(every['count'], self._clock)
        ambiguous[: len(every) - number] = False
        every['information'][ambiguous] = 0.0

    def _times(self, counts: np.ndarray) -> np.ndarray:
        """When frames with `counts` (T,) were, ns: in even steps."""
        time, count = self._anchor
        return np.asarray(time + (counts - count) * self._step)

    @property
    def clock_update_is_due(self) -> bool:
        """Whether `update_clock` is to be called before more frames come."""
        return self._history.until_update <= 0

    def update_clock(self, noise: np.ndarray) -> Callable[[], bool] | None:
        """
        Estimate the clock: what is to be done when all that waits is estimated, if anything.

        That says whether frames were not when they seemed to be.
        `noise` (B,), m, is that of a marker of each body.
        """
        lost = self._history.lost
        uncounted = sum(len(part.stamps) for part in self._uncounted)
        # As many frames as are held where each is estimated when it comes.
        frames = self._frames.view()[max(len(self) - self.samples, 0) :]
        counts = self._history.update(frames, uncounted, noise)
        self._counts['lost'] += self._history.lost - lost
        if self._history.regular:
            return lambda: self._to_ticks(counts)
        return self._to_stamps if self._regular else None

    def _to_ticks(self, counts: np.ndarray) -> bool:
        """Take frames to be at ticks, of which the newest have these `counts` (n,)."""
        clock, every = self._history.clock, self._frames.view()
        assert clock is not None
        other, self._regular = not self._regular, True
        self._clock, self._shift = clock, 0
        self._step = max(round(clock.interval), 1)
        number = min(len(every), len(counts))
        self._count = int(counts[-1]) if number else -1
        self._anchor = clock.origin + round(clock.phase + self._count * clock.interval), self._count
        counted = every[len(every) - number :]
        counted['count'] = counts[len(counts) - number :]
        counted['time'] = self._times(counted['count'])
        self.leave_out_ambiguous(number)
        # Frames of another rate.
        before = every[: len(every) - number]
        before['time'] = _rising(before['stamp'] - round(clock.lateness))
        return other

    def _to_stamps(self) -> bool:
        """Take frames to be at their stamps from now on."""
        self._regular, self._clock = False, None
        every = self._frames.view()
        every['time'] = _rising(every['stamp'])
        return True

    def waiting(self) -> np.ndarray:
        """Those of the frames that are not estimated yet."""
        every = self._frames.view()
        return every[len(every) - self._waiting :]

    def falling_due(self, new: np.ndarray) -> tuple[np.ndarray, Windows, np.ndarray]:
        """
        What falls due with the newest frames (T,): up to where (T,), and which instants can be
        estimated of; with which of these frames each is due.
        """
        times = self._frames.view()['time']
        newest = np.arange(len(times) - len(new), len(times))
        oldest = new['oldest']
        ahead = np.rint(self._lag - 0.75 * new['interval'])
        last = new['time'] - ahead.astype(np.int64)
        end = np.minimum(times.searchsorted(last, side='right'), newest + 1)
        end = np.maximum.accumulate(np.maximum(end, self._due))
        due = np.arange(self._due, end[-1])
        frame = end.searchsorted(due, side='right')
        full = (newest - oldest)[frame] >= FEWEST_SAMPLES - 1
        seen = (full & (due >= oldest[frame])).nonzero()[0]
        frame = frame[seen]
        return end, Windows(due[seen], oldest[frame], newest[frame]), frame

    def pass_by(self, due: int, count: int) -> None:
        """All that wait are estimated, up to `due`; the first `count` no window to come holds."""
        self._waiting = 0
        self._frames.drop(count)
        self._due = max(0, due - count)
        self.dropped += count


def _rising(stamps: np.ndarray) -> np.ndarray:
    """Times (T,) that rise, from stamps that need not."""
    least = _LEAST_STEP * np.arange(len(stamps))
    return np.asarray(np.maximum.accumulate(stamps - least) + least)
