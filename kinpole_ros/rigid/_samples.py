"""The sliding window itself: the latest samples, in order, in one piece of memory."""

import numpy as np


class Samples:
    """
    A queue of rows that can be read as one array.

    Rows are written into a buffer twice as long as the queue ever was; when its end is
    reached the rows still wanted move to its start, so the cost per row does not grow.
    """

    def __init__(self, row: tuple[int, ...], dtype: type) -> None:
        self._buffer: np.ndarray = np.empty((64, *row), dtype)
        self._first = 0
        self._end = 0

    def __len__(self) -> int:
        return self._end - self._first

    def room(self, count: int) -> np.ndarray:
        """`count` rows (count, ...) more at the end, a view to be written to."""
        if self._end + count > len(self._buffer):
            kept = self.view().copy()
            room = len(self._buffer)
            while room < 2 * len(kept) + count:
                room *= 2
            if room > len(self._buffer):
                self._buffer = np.empty((room, *kept.shape[1:]), kept.dtype)
            self._buffer[: len(kept)] = kept
            self._first, self._end = 0, len(kept)
        self._end += count
        return self._buffer[self._end - count : self._end]

    def drop(self, count: int) -> None:
        """Take `count` rows from the start."""
        self._first += count

    def view(self) -> np.ndarray:
        """All rows, oldest first; valid until there is more `room`."""
        return self._buffer[self._first : self._end]
