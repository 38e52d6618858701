"""The frames of late, as arrays with one row per frame."""

import numpy as np

from kinpole_ros.core.bindings import HistoryColumns


class History:
    """
    Frames of `bodies` bodies of up to `markers` markers, oldest first.

    `history['angle']` is the column of that name, a view of all rows, valid until the next
    `reserve`. Rows are dropped from the start; `dropped` counts them. Rows `first` to `end` of
    `columns` are in use.

    Columns are the arrays of `HistoryColumns` of frames.h, which says what they are.
    """

    def __init__(self, bodies: int, markers: int) -> None:
        self.dropped = self.first = self.end = 0
        self.capacity = 256
        self.columns = HistoryColumns.new_arrays(rows=self.capacity, B=bodies, n=markers)

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return sum(column[0].nbytes for column in self.columns.values())

    def __len__(self) -> int:
        return self.end - self.first

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name][self.first : self.end]

    def reserve(self, number: int) -> bool:
        """Make room for so many rows more; whether the columns had to be made anew."""
        count = len(self)
        if self.end + number <= self.capacity:
            return False
        grown = max(self.capacity, 2 * (count + number))
        for name, column in self.columns.items():
            moved = np.empty((grown, *column.shape[1:]), column.dtype)
            moved[:count] = column[self.first : self.end]
            self.columns[name] = moved
        self.first, self.end, self.capacity = 0, count, grown
        return True

    def widen(self, markers: int) -> None:
        """Make room for up to `markers` markers per body, not seen up to now."""
        for name, missing in (
            ('markers', np.nan),
            ('heights', np.nan),
            ('used', False),
            ('residual', np.nan),
        ):
            column = self.columns[name]
            more = (0, 0), (0, 0), (0, markers - column.shape[2])
            self.columns[name] = np.pad(column, more, constant_values=missing)

    def poses_before(self, stamp: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return the last `count` poses of each body that are used, NaN for the others.

        Their stamps (N + 1,), ns, the last of which is `stamp`; angles and positions (N, B).
        """
        rows = slice(max(self.first, self.end - count), self.end)
        stamps, information, angle, position = (
            self.columns[name][rows] for name in ('stamp', 'information', 'angle', 'position')
        )
        angle = np.where(information[:, 0] > 0, angle, np.nan)
        return np.append(stamps, stamp), angle, position

    def drop(self, count: int) -> None:
        """Drop the `count` oldest rows."""
        self.first += count
        self.dropped += count
