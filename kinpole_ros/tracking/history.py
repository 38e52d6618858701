"""The frames of late, as arrays with one row per frame."""

import numpy as np


class History:
    """
    Frames of `bodies` bodies of up to `markers` markers, oldest first.

    `history['angle']` is the column of that name, a view of all rows, valid until the next
    `reserve`. Rows are dropped from the start; `dropped` counts them. Rows `first` to `end` of
    `columns` are in use.

    stamp, time : int64, ns. As the message has it, and as the clock has it.
    count : int64. The tick of the clock, where frames are counted.
    goes_on : bool. False for a frame that follows a gap.
    markers : complex (B, n), m. As they came, in the plane; NaN for those not seen.
    used : bool (B, n). Those that the pose is fitted to.
    residual : complex (B, n), m. Marker minus fitted marker, in the axes of the body.
    angle, turns : (B,). The angle, rad, near (-pi, pi], and the whole turns beyond it.
    position : complex (B,), m. The origin of the frame of the body.
    information : (2, B). Inverse variances of angle and position, over that of one coordinate of a
        marker; 0 where the pose is not known.
    height : (B,), m. Mean height of the markers that were seen.
    extra_turn : (B,), rad. Of poses of tilted bodies: see `Step.total_turn`.
    heights : (B, n), m. Heights of the markers over the plane.
    """

    def __init__(self, bodies: int, markers: int) -> None:
        self.dropped = self.first = self.end = 0
        self.capacity = capacity = 256
        each, both = (capacity, bodies), (capacity, bodies, markers)
        self.columns: dict[str, np.ndarray] = {
            'stamp': np.zeros(capacity, np.int64),
            'time': np.zeros(capacity, np.int64),
            'count': np.zeros(capacity, np.int64),
            'goes_on': np.zeros(capacity, bool),
            'markers': np.zeros(both, complex),
            'used': np.zeros(both, bool),
            'residual': np.zeros(both, complex),
            'angle': np.zeros(each),
            'turns': np.zeros(each),
            'position': np.zeros(each, complex),
            'height': np.zeros(each),
            'extra_turn': np.zeros(each),
            'information': np.zeros((capacity, 2, bodies)),
            'heights': np.zeros(both),
        }

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

    def drop(self, count: int) -> None:
        """Drop the `count` oldest rows."""
        self.first += count
        self.dropped += count
