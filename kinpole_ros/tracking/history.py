"""The frames of late, as arrays with one row per frame."""

import numpy as np


class History:
    """
    Frames of `bodies` bodies of up to `markers` markers, oldest first.

    `history['angle']` is the column of that name, a view of all rows, valid until the next
    `append`. Rows are dropped from the start; `dropped` counts them.

    stamp, time : int64, ns. As the message has it, and as the clock has it.
    goes_on : bool. False for a frame that follows a gap.
    markers : complex (B, n), m. As they came, in the plane; NaN for those not seen.
    used : bool (B, n). Those that the pose is fitted to.
    residual : complex (B, n), m. Marker minus fitted marker, in the axes of the body.
    angle, turns : (B,). The angle in (-pi, pi], rad, and the whole turns beyond it.
    position : complex (B,), m. The origin of the frame of the body.
    information : (2, B). Inverse variances of angle and position, over that of one coordinate of a
        marker; 0 where the pose is not known.
    height : (B,), m. Mean height of the markers over the plane.
    """

    def __init__(self, bodies: int, markers: int) -> None:
        self.dropped = 0
        self._first = self._end = 0
        shapes: dict[str, tuple[tuple[int, ...], type]] = {
            'stamp': ((), np.int64),
            'time': ((), np.int64),
            'goes_on': ((), bool),
            'markers': ((bodies, markers), complex),
            'used': ((bodies, markers), bool),
            'residual': ((bodies, markers), complex),
            'angle': ((bodies,), float),
            'turns': ((bodies,), float),
            'position': ((bodies,), complex),
            'information': ((2, bodies), float),
            'height': ((bodies,), float),
        }
        self._columns = {
            name: np.zeros((256, *shape), dtype) for name, (shape, dtype) in shapes.items()
        }

    def __len__(self) -> int:
        return self._end - self._first

    def __getitem__(self, name: str) -> np.ndarray:
        return self._columns[name][self._first : self._end]

    def append(self) -> None:
        """Add a row, to be filled through the views of the columns."""
        capacity = len(self._columns['stamp'])
        if self._end == capacity:
            count = len(self)
            if 2 * count > capacity:
                capacity *= 2
            for name, column in self._columns.items():
                moved = column if len(column) == capacity else np.empty_like(
                    column, shape=(capacity, *column.shape[1:])
                )
                moved[:count] = column[self._first : self._end].copy()
                self._columns[name] = moved
            self._first, self._end = 0, count
        self._end += 1

    def widen(self, markers: int) -> None:
        """Make room for up to `markers` markers per body, not seen up to now."""
        for name, missing in (('markers', np.nan), ('used', False), ('residual', np.nan)):
            column = self._columns[name]
            more = (0, 0), (0, 0), (0, markers - column.shape[2])
            self._columns[name] = np.pad(column, more, constant_values=missing)

    def drop(self, count: int) -> None:
        """Drop the `count` oldest rows."""
        self._first += count
        self.dropped += count
