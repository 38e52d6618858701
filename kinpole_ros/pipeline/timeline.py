"""
The frames that are held: when they were, what their windows hold, what falls due.

Header stamps alone decide; nobody asks for the time. Frames are at their stamps, or at the ticks of
the clock behind these: see `ticks`.
"""

from collections import Counter
from collections.abc import Callable
from functools import partial

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES, Windows
from kinpole_ros.pipeline.arrivals import Arrivals
from kinpole_ros.pipeline.bodies import pose_columns
from kinpole_ros.pipeline.clock import UNSETTLED, counts_by
from kinpole_ros.pipeline.counter import FrameCounter
from kinpole_ros.pipeline.course import correct_counts, course_costs
from kinpole_ros.pipeline.parameters import Settings
from kinpole_ros.pipeline.ticks import StampState, Ticks
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
        # Its number on the clock, and how many of the newest frames had none yet when it came.
        ('count', np.int64),
        ('behind', np.int64),
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
        self._ticks = Ticks(settings.stamps, self.window)
        if before is not None:
            self._ticks.regular = before._ticks.regular
        # As the frames that are held are taken: what is decided counts when all that wait are
        # estimated.
        self._regular = self._ticks.regular
        self._counter: FrameCounter | None = None
        # The time of a count, and from one to the next.
        self._anchor = 0, 0
        self._step = 0
        self._slips = False

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

    @property
    def counts_are_sure(self) -> bool:
        """Whether a frame's stamp alone tells its tick: none is later than the next."""
        clock = self._ticks.clock
        return not self.regular or (clock is not None and clock.reach < 1)

    def until_doubt(self, stamps: np.ndarray) -> int:
        """
        How many of the next frames may be taken at once, by their `stamps` (T,), ns.

        One whose count is in doubt has it by the poses up to it; those that follow go by that.
        """
        return len(stamps) if self._counter is None else self._counter.until_doubt(stamps)

    def stamp_state(self) -> StampState | None:
        """How the stamps are; None while too few have come."""
        return self._ticks.state()

    def accept(self, stamps: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """
        Up to where frames of `stamps` (T,) go on, and whether the next starts anew.

        Also how far each is ahead of all before it, ns: it is one to take where that is positive.
        Where nothing starts anew and not all go on, there is something to `look` at first. `points`
        (T, ...) tell a frame that is repeated from one with the stamp of another.
        """
        stamps = stamps[: self._ticks.room]
        until = self._ticks.until_slip(stamps)
        if not until:
            self._slips = True
            return stamps[:0], 0, False
        stamps = stamps[:until]
        ahead, end, came = self._arrivals.accept(stamps, points, self._regular, self._plausible())
        if end:
            self._ticks.add(stamps[:end][came], (ahead > 0)[came])
        return ahead, end, end < len(stamps)

    def _plausible(self) -> int:
        """By how much a frame may be late, ns."""
        clock = self._ticks.clock
        if not self._regular and self._ticks.mode == 'capture':
            return 0
        if clock is None:
            return round(_PLAUSIBLE * self.window) if self._regular else 0
        return round(clock.largest + clock.interval)

    def enter(
        self, stamps: np.ndarray, steps: np.ndarray, numbers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Rows for frames that go on by `steps` ns, which wait from now on, to be filled.

        Also which (T,) come much later than those before did. `numbers` (T,) are theirs.
        """
        rows = self._frames.room(len(stamps))
        rows['stamp'], rows['number'] = stamps, numbers
        self._waiting += len(stamps)
        if self._regular:
            return rows, self._enter_arrivals(rows, stamps)
        rows['time'] = stamps
        rows['count'] = rows['behind'] = 0
        held = self._place(rows, stamps)
        interval = rows['interval']
        # As the window was before the frame came.
        before = np.concatenate(((self.interval,), interval[:-1]))
        self.samples, self.interval = int(held[-1]) + 1, float(interval[-1])
        return rows, (steps > _LATE * before) & (before > 0)

    def _enter_arrivals(self, rows: np.ndarray, stamps: np.ndarray) -> np.ndarray:
        """Give frames times to go on with until they are counted; which (T,) come after a gap."""
        every = self._frames.view()
        rows['count'] = rows['behind'] = 0
        if self._counter is None:
            first = len(every) == len(rows)
            last = int(stamps[0]) - _LEAST_STEP if first else int(every['time'][-len(rows) - 1])
            rows['time'] = _rising(np.concatenate(((last,), stamps)))[1:]
            return np.zeros(len(rows), bool)
        counts = self._counter.expected(stamps)
        gaps = np.diff(counts, prepend=self._counter.newest) > _LATE
        rows['time'] = self._times(counts)
        return gaps

    def _times(self, counts: np.ndarray) -> np.ndarray:
        time, count = self._anchor
        return np.asarray(time + (counts - count) * self._step)

    def pose(self, rows: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """
        Frames `rows` have poses now: what that says of when they, and those before, were.

        `noise` (K, B) is that of a marker of each body, m, as it was known by the rows' `beat`. The
        times (T,) are of the newest frames, as far as they are not those that they had.
        """
        self._ticks.add_poses(rows['poses'], rows['information'])
        if not self._regular:
            return rows['time'][:0]
        every = self._frames.view()
        pending = anew = 0
        if self._counter is not None:
            anew = len(rows) + self._counter.pending
            self._count(self._counter, len(every) - len(rows), noise[rows['beat']])
            pending = self._counter.pending
        sure = len(every) - pending
        if sure:
            times = every['time'][:sure]
            oldest = int(times.searchsorted(times[-1] - self.window))
            self.samples = sure - oldest
            self.interval = float(times[-1] - times[oldest]) / max(self.samples - 1, 1)
        return every['time'][len(every) - anew :]

    def _count(self, counter: FrameCounter, first: int, noise: np.ndarray) -> None:
        """
        Count the frames from the `first` on, as if each came alone.

        `noise` (T, B) is that of a marker of each body, m, as it was known when they came.
        """
        every = self._frames.view()
        here = begin = first - counter.pending

        def motion(paths: np.ndarray) -> np.ndarray:
            """Nats by what the poses up to now say."""
            number = paths.shape[1]
            frames = every[max(0, begin - UNSETTLED) : begin + number]
            counts = counter.count + np.arange(1, number + 1) + paths
            return course_costs(
                frames, len(frames) - number, counts, noise[begin + number - 1 - first]
            )

        for k, sure in enumerate(counter.take(every['stamp'][first:], motion)):
            every['count'][begin : begin + len(sure)] = sure
            begin += len(sure)
            every['behind'][first + k] = counter.pending
            self._ticks.count(sure)
        every['count'][begin:] = counter.likely
        every['time'][here:] = self._times(every['count'][here:])

    @property
    def look_due(self) -> bool:
        """Whether `look` is to be called before more frames come."""
        return self._ticks.room <= 0 or self._slips

    def look(self, noise: np.ndarray) -> Callable[[], bool] | None:
        """
        Look at the clock: what is to be done when all that waits is estimated, if anything.

        That says whether frames were not when they seemed to be.
        `noise` (B,), m, is that of a marker of each body.
        """
        if self._slips:
            self._slips = False
            self._ticks.round()
            if self._ticks.is_up_to_date:
                return partial(self._count_anew, noise)
        was = self._regular
        lost = self._ticks.lost
        newest = None if self._counter is None else self._counter.likely
        same = self._ticks.look(noise, newest)
        self._counts['lost'] += self._ticks.lost - lost
        if self._ticks.regular:
            return self._follow if was and same else partial(self._count_anew, noise)
        return self._to_stamps if was else None

    def _follow(self) -> bool:
        """Go on by the clock as it is known now."""
        clock, every, counter = self._ticks.clock, self._frames.view(), self._counter
        assert counter is not None and clock is not None
        counter.follow(clock)
        self._ticks.uncount(counter.pending)
        sure = len(every) - counter.pending
        if sure > 0:
            self._anchor = int(every['time'][sure - 1]), int(every['count'][sure - 1])
        self._step = max(round(clock.interval), 1)
        # Those before had another rate; some may have been taken back.
        first = max(sure - len(self._ticks.counts), 0)
        every['count'][first:sure] = self._ticks.counts[len(self._ticks.counts) - sure + first :]
        every['time'][first:] = self._times(every['count'][first:])
        return False

    def _count_anew(self, noise: np.ndarray) -> bool:
        """Give all frames the counts that the clock has for them."""
        clock, every = self._ticks.clock, self._frames.view()
        assert clock is not None
        other, self._regular = not self._regular, True
        self._step = max(round(clock.interval), 1)
        number = min(len(every), len(self._ticks.counts))
        if not number:
            return other
        here = len(every) - number
        counts = counts_by(every['stamp'][here:], clock)
        count = int(counts[0])
        self._anchor = clock.origin + round(clock.phase + count * clock.interval), count
        every['count'][here] = count
        self._counter = FrameCounter(clock, count)
        self._ticks.uncount(number)
        self._ticks.count(counts[:1])
        self._count(self._counter, here + 1, np.broadcast_to(noise, (number, len(noise))))
        corrected, sure = every[here:], number - self._counter.pending
        correct_counts(corrected['count'], corrected['poses'], corrected['information'], noise)
        self._ticks.uncount(sure)
        self._ticks.count(corrected['count'][:sure])
        every['time'][here:] = self._times(corrected['count'])
        # Frames of another rate.
        every['time'][:here] = _rising(every['stamp'][:here] - round(clock.lateness))
        return other

    def _to_stamps(self) -> bool:
        """Take frames to be at their stamps from now on."""
        self._regular = False
        every = self._frames.view()
        every['time'] = _rising(every['stamp'])
        self._counter = None
        return True

    def waiting(self) -> np.ndarray:
        """Those of the frames that are not estimated yet."""
        every = self._frames.view()
        return every[len(every) - self._waiting :]

    def _place(self, rows: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Note what the windows of frames hold; how many (T,) frames before them."""
        every = self._frames.view()['time']
        newest = np.arange(len(every) - len(rows), len(every))
        rows['oldest'], rows['interval'] = self._windows(every, times, newest)
        return np.asarray(newest - rows['oldest'])

    def _windows(
        self, every: np.ndarray, times: np.ndarray, newest: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The oldest frames (T,) of windows, and their mean interval, ns; `times` of the newest."""
        oldest = every.searchsorted(times - self.window)
        return oldest, (times - every[oldest]) / np.maximum(newest - oldest, 1)

    def falling_due(self, new: np.ndarray) -> tuple[np.ndarray, Windows, np.ndarray]:
        """
        What falls due with the newest frames (T,): up to where (T,), and which instants can be
        estimated of; with which of these frames each is due.
        """
        frames = self._frames.view()
        newest = np.arange(len(frames) - len(new), len(frames))
        times = frames['time']
        if self._regular:
            # Frames without a sure count are as if they had not come.
            newest = np.maximum(newest - new['behind'], 0)
            times = times[: newest[-1] + 1]
            here = times[newest]
            new['oldest'], new['interval'] = self._windows(times, here, newest)
        else:
            here = new['time']
        oldest = new['oldest']
        ahead = np.rint(self._lag - 0.75 * new['interval'])
        last = here - ahead.astype(np.int64)
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
