"""
Which of the frames that come go on from those before, by their stamps alone.

A frame that comes late is left out, and so is one that comes twice. A clock that steps back, or a
gap longer than the window, starts everything anew.
"""

from collections import Counter

import numpy as np


class Arrivals:
    """The frames that have come since all started anew; those left out are added to `counts`."""

    def __init__(self, window: int, counts: Counter[str]) -> None:
        self._window = window
        self._counts = counts
        # Stamp and points of the frame that came last, taken or not, and the latest stamp.
        self._last = self._newest = 0
        self._last_points: np.ndarray | None = None

    def accept(
        self, stamps: np.ndarray, points: np.ndarray, late: bool, plausible: int
    ) -> tuple[np.ndarray, int, np.ndarray | slice]:
        """
        Up to where frames of `stamps` (T,), ns, go on: how far each is ahead, and which came once.

        One to take is ahead by more than 0. Frames may come `late`, by less than is `plausible`,
        ns; else each is to be later than all before. `points` (T, ...) tell a frame that comes
        twice from another one with the same stamp.
        """
        if self._last_points is None:
            self._last = self._newest = int(stamps[0]) - 1
        ahead = stamps - np.concatenate(((self._newest,), stamps[:-1]))
        end, came = len(stamps), slice(None)
        if np.minimum.reduce(ahead) <= 0 or np.maximum.reduce(ahead) > self._window:
            # The latest stamp before each frame.
            reached = np.maximum.accumulate(np.concatenate(((self._newest,), stamps[:-1])))
            before = np.concatenate(((self._last,), stamps[:-1]))
            ahead = stamps - reached
            far = ahead <= -plausible
            # A clock that steps back is no frame that arrives early after one that was late.
            anew = far & (before < reached) & (before < stamps) | (np.abs(ahead) > self._window)
            end = int(anew.argmax()) if anew.any() else end
            ahead, far = ahead[:end], far[:end]
            repeated = self._repeated((stamps == before)[:end], points)
            out, twice = (far, repeated) if late else (ahead < 0, ahead == 0)
            self._counts['late'] += int(out.sum())
            self._counts['repeated'] += int(twice.sum())
            came = ~repeated
            if late:
                ahead = (~(far | repeated)).astype(np.int64)
        if end:
            self._newest = max(self._newest, int(np.maximum.reduce(stamps[:end])))
            self._last, self._last_points = int(stamps[end - 1]), points[end - 1].copy()
        return ahead, end, came

    def _repeated(self, same: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Which frames (T,), of those with the stamp of the one before, are it once more."""
        repeated = np.zeros(len(same), bool)
        for k in same.nonzero()[0].tolist():
            before = points[k - 1] if k else self._last_points
            repeated[k] = before is not None and np.array_equal(points[k], before, equal_nan=True)
        return repeated
