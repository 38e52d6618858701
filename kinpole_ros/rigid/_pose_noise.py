"""
The noise of poses that come as such: no fit to markers leaves anything that would tell of it.

What differs from polynomials through a few frames running is noise, since no mechanism moves so
fast: differences of high order (von Neumann 1941; Gasser, Sroka and Jennen-Steinmetz 1986), divided
where frames come unevenly. Noise of angle and position have no ratio that is known: it is measured.

A driver that fits its poses to markers has both errors in common: a turn moves the origin if that
lies off the middle of the markers. So the point of the body is found whose errors have nothing to
do with those of the angle, by least squares.

Poses that a driver smooths differ little from frame to frame. So means over blocks of frames are
looked at too: of noise their deviation falls with the square root of their length. Smoothing that
leaves nothing above its cutoff cannot be told from motion.
"""

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid._noise import trimmed_mean
from kinpole_ros.rigid.levels import FEW, KEPT, ROUNDING, SURE

# Differences are of this order; of another one for comparison, which motion would make larger.
_ORDER = 6
_LOWER = _ORDER - 2
# Deviations, and intervals of a block, are the same within this factor.
_SAME = 1.25
# Frames in a block.
_BLOCKS = 2, 4, 8
# Frames farther between than so many times what is usual do not count as running.
_APART = 3.0


class PoseNoise:
    """
    What poses of B bodies err by.

    `middle` (B,), complex, m, is the point, in the body's frame, whose error and that of the angle
    are independent; `position` (B,), m, is its deviation per axis and `angle` (B,), rad, that of
    the angle, NaN while not known. `underestimated` (B,) says where they last longer than can be
    measured.
    """

    def __init__(self, bodies: int) -> None:
        self.middle = np.zeros(bodies, complex)
        self.position, self.angle = np.full((2, bodies), np.nan)
        self.underestimated = np.zeros(bodies, bool)
        self._stamps = np.zeros(0, np.int64)
        self._poses = np.zeros((0, bodies)), np.zeros((0, bodies), complex)

    def forget(self, which: np.ndarray) -> None:
        """Forget the bodies `which` (B,)."""
        self.middle[which] = 0.0
        self.position[which] = self.angle[which] = np.nan
        self.underestimated[which] = False
        self._poses[0][:, which] = np.nan

    def add(self, stamps: np.ndarray, position: Complex, angle: Real) -> None:
        """Take the poses (T, B) of frames at `stamps` (T,), ns, NaN for none; measure anew."""
        some = slice(-KEPT, None)
        self._stamps = np.concatenate((self._stamps, stamps))[some]
        both = zip(self._poses, (angle, position), strict=True)
        angles, places = (np.concatenate(pair)[some] for pair in both)
        self._poses = angles, places
        for b in range(len(self.middle)):
            seen = np.isfinite(angles[:, b])
            seen[1:] &= ~((np.diff(angles[:, b]) == 0) & (np.diff(places[:, b]) == 0))
            if seen.sum() < FEW + _ORDER:
                # A tracker that rounds says nothing of its noise while its body rests.
                seen = np.isfinite(angles[:, b])
            if seen.sum() >= FEW + _ORDER:
                rows = self._stamps[seen], np.unwrap(angles[seen, b]), places[seen, b]
                self._measure(b, *rows)

    def _measure(self, b: int, stamps: np.ndarray, angle: Real, position: Complex) -> None:
        """Measure what the poses (N,) of one body err by."""
        time = (stamps - stamps[0]) * 1e-9
        turn = np.exp(1j * angle)
        off, turned, about = _differences(time, _ORDER, angle, turn, position)
        if len(off) < FEW:
            return
        squares = float((turned.real**2 + turned.imag**2).sum())
        if squares > 0:
            self.middle[b] = -(turned.conj() * about).sum() / squares
        place = position + self.middle[b] * turn
        floor = ROUNDING * np.pi, ROUNDING * float(np.abs(position).max())
        found = []
        for values, least in zip((angle, place), floor, strict=True):
            level = _deviation(time, values, _ORDER)
            lasts = False
            for block in _BLOCKS:
                times, means = _means(block, time, values)
                count = len(times) - _ORDER
                if count < FEW:
                    break
                new, lower = (_deviation(times, means, order) for order in (_ORDER, _LOWER))
                # Motion makes the lower one larger, and is seen in all blocks that are longer.
                if lower > _SAME * new:
                    break
                # Of n differences half as many are degrees of freedom.
                lasts = math.sqrt(block) * new > (1 + SURE / math.sqrt(count)) * level
                if lasts:
                    level = math.sqrt(block) * new
            found.append((max(level, least), lasts))
        (self.angle[b], of_angle), (self.position[b], of_place) = found
        self.underestimated[b] = of_angle or of_place


def _means(block: int, time: Real, values: np.ndarray) -> tuple[Real, np.ndarray]:
    """Means over blocks of the latest frames, those that are even: others move with the motion."""
    count = len(time) // block
    shape = count, block
    times, values = (one[len(one) - count * block :].reshape(shape) for one in (time, values))
    length = times[:, -1] - times[:, 0]
    even = length < _SAME * (block - 1) * np.median(np.diff(time))
    return times[even].mean(axis=1), values[even].mean(axis=1)


def _deviation(time: Real, values: np.ndarray, order: int) -> float:
    """Deviation of white noise of one coordinate, by differences of that order."""
    (left,) = _differences(time, order, values)
    squares = left.real**2 + left.imag**2
    coordinates = 2 if np.iscomplexobj(left) else 1
    return math.sqrt(trimmed_mean(squares, coordinates) / coordinates) if len(left) else math.nan


def _differences(time: Real, order: int, *series: np.ndarray) -> list[np.ndarray]:
    """
    Divided differences of series (N,) at `time` (N,), s, of frames running.

    Scaled so that of white noise they have its deviation.
    """
    rows = sliding_window_view(time, order + 1)
    length = rows[:, -1] - rows[:, 0]
    kept = length < _APART * np.median(length)
    rows = rows[kept]
    between = (rows[:, :, None] - rows[:, None]) / length[kept, None, None]
    between += np.eye(order + 1)
    with np.errstate(divide='ignore', invalid='ignore'):
        weights = 1 / between.prod(axis=2)
        weights /= np.sqrt((weights**2).sum(axis=1, keepdims=True))
    good = np.isfinite(weights).all(axis=1)
    return [
        (weights * sliding_window_view(one, order + 1)[kept]).sum(axis=1)[good] for one in series
    ]
