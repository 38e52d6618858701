"""
The frames that are held: which of those that come go on, what their windows hold, what falls due.

Header stamps alone decide; nobody asks for the time.
"""

from collections import Counter

import numpy as np

from kinpole_ros.bodies import pose_columns
from kinpole_ros.parameters import Settings
from kinpole_ros.window import FEWEST_SAMPLES, Samples, Unforeseen, Windows

# Frames later than this many intervals of late come after a gap.
_LATE = 2.5


def _frame_type(bodies: int) -> np.dtype:
    """What is held of a frame, in one row."""
    columns: list[tuple] = [
        ('stamp', np.int64),
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
    ns, 0 for fewer than two, and `dropped` how many frames were held and are no more. `last` is the
    stamp of the frame that came last, taken or not.
    """

    def __init__(self, settings: Settings, counts: Counter[str]) -> None:
        self.samples = 0
        self.interval = 0.0
        self.dropped = 0
        self.last = 0
        self.window = round(settings.window * 1e9)
        self._lag = settings.lag * 1e9
        self._counts = counts
        self._frames = Samples((), _frame_type(len(settings.bodies)))
        self._due = 0
        # How many of the newest frames are not estimated yet.
        self._waiting = 0

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def newest(self) -> int:
        """The stamp of the newest frame that is held, ns."""
        return int(self._frames.view()['stamp'][-1])

    def view(self) -> np.ndarray:
        """All frames, oldest first; valid until more come."""
        return self._frames.view()

    def sift(self, stamps: np.ndarray) -> tuple[np.ndarray, int]:
        """
        Up to where frames of `stamps` (T,) go on, T if nothing starts anew, and how far each is
        ahead of all before it, ns: it is one to take where that is positive.
        """
        last, newest = self.last, int(stamps[0]) - 1
        if len(self._frames):
            newest = int(self._frames.view()['stamp'][-1])
        else:
            last = newest
        ahead = stamps - np.concatenate(((newest,), stamps[:-1]))
        if np.minimum.reduce(ahead) > 0 and np.maximum.reduce(ahead) <= self.window:
            return ahead, len(stamps)
        # As it is when each frame comes.
        reached = np.maximum.accumulate(np.concatenate(((newest,), stamps[:-1])))
        before = np.concatenate(((last,), stamps[:-1]))
        ahead = stamps - reached
        back = (before < reached) & (before < stamps) & (ahead <= 0)
        anew = back | (np.abs(ahead) > self.window)
        end = int(anew.argmax()) if anew.any() else len(stamps)
        ahead = ahead[:end]
        self._counts['late'] += int((ahead < 0).sum())
        self._counts['repeated'] += int((ahead == 0).sum())
        return ahead, end

    def enter(
        self, stamps: np.ndarray, steps: np.ndarray, numbers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Rows for frames that go on by `steps` ns, which wait from now on, to be filled.

        Also which (T,) come much later than those before did. `numbers` (T,) are theirs.
        """
        rows = self._frames.room(len(stamps))
        held = self._place(rows, stamps)
        rows['number'] = numbers
        interval = rows['interval']
        # As the window was before the frame came.
        before = np.concatenate(((self.interval,), interval[:-1]))
        self.samples, self.interval = int(held[-1]) + 1, float(interval[-1])
        self._waiting += len(stamps)
        return rows, (steps > _LATE * before) & (before > 0)

    def guess(self) -> np.ndarray:
        """
        A row (1,) for the frame that comes if all goes on as it did, until it is `withdrawn`.

        Raises Unforeseen where frames do not come evenly, or are too few.
        """
        if len(self._frames) < FEWEST_SAMPLES:
            raise Unforeseen
        stamps = self._frames.view()['stamp'][-4:]
        steps = stamps[1:] - stamps[:-1]
        if np.ptp(steps) > 1:
            raise Unforeseen
        # The step of three frames ago: at 120 Hz and the like one in three is a ns longer.
        stamp = stamps[-1:] + steps[0]
        row = self._frames.room(1)
        self._place(row, stamp)
        return row

    def withdraw(self) -> None:
        """Take the guess back."""
        self._frames.withdraw(1)

    def waiting(self) -> np.ndarray:
        """Those of the frames that are not estimated yet."""
        every = self._frames.view()
        return every[len(every) - self._waiting :]

    def _place(self, rows: np.ndarray, stamps: np.ndarray) -> np.ndarray:
        """Note when frames are and what their windows hold; how many (T,) frames before them."""
        rows['stamp'] = stamps
        every = self._frames.view()['stamp']
        rows['oldest'] = oldest = every.searchsorted(stamps - self.window)
        held = np.arange(len(every) - len(rows), len(every)) - oldest
        rows['interval'] = (stamps - every[oldest]) / np.maximum(held, 1)
        return held

    def falling_due(self, new: np.ndarray) -> tuple[np.ndarray, Windows, np.ndarray]:
        """
        What falls due with the newest frames (T,): up to where (T,), and which instants can be told
        of; with which of these frames each is due.
        """
        frames = self._frames.view()
        ahead = np.rint(self._lag - 0.75 * new['interval'])
        last = new['stamp'] - ahead.astype(np.int64)
        oldest, newest = new['oldest'], np.arange(len(frames) - len(new), len(frames))
        end = np.minimum(frames['stamp'].searchsorted(last, side='right'), newest + 1)
        end = np.maximum.accumulate(np.maximum(end, self._due))
        due = np.arange(self._due, end[-1])
        frame = end.searchsorted(due, side='right')
        full = (newest - oldest)[frame] >= FEWEST_SAMPLES - 1
        seen = (full & (due >= oldest[frame])).nonzero()[0]
        frame = frame[seen]
        return end, (due[seen], oldest[frame], newest[frame]), frame

    def pass_by(self, due: int, count: int) -> None:
        """All that wait are estimated, up to `due`; the first `count` no window to come holds."""
        self._waiting = 0
        self._frames.drop(count)
        self._due = max(0, due - count)
        self.dropped += count
