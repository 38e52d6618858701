"""
Bodies whose poses come as such, in place of markers.

Each pose stands for three points fixed to its body, which fit exactly. The noise is that of the
poses: of the angle, and of the point whose error is independent of that of the angle.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.statistics import trimmed_mean
from kinpole_ros.tracking.thresholds import MIN_SAMPLES, N_SIGMA

# Differences are of this order; of another one for comparison, which motion would make larger.
_ORDER = 6
_LOWER = _ORDER - 2
# Deviations, and intervals of a block, are the same within this factor.
_SAME = 1.25
# Frames in a block.
_BLOCKS = 2, 4, 8
# Frames farther between than so many times what is usual do not count as running.
_APART = 3.0
# Frames that the noise is estimated from.
NOISE_FRAMES = 512


class TiltedTurns:
    """
    Turns of B bodies about the normal beyond those of their headings, as they tilt.

    `total` (B,), rad, is the sum up to the last frame that is sure.
    """

    def __init__(self, bodies: int) -> None:
        self.total = np.zeros(bodies)
        self._heading = np.full(bodies, np.nan)
        self._tilt = np.full(bodies, complex(np.nan, np.nan))

    def follow(self, heading: np.ndarray, tilt: np.ndarray, sure: np.ndarray) -> np.ndarray:
        """The turns (B,), rad, up to a frame; those of bodies that are not `sure` are not kept."""
        turns = self.total + extra_turns(self._tilt, tilt, heading - self._heading)
        self.total = np.where(sure, turns, self.total)
        self._heading = np.where(sure, heading, self._heading)
        self._tilt = np.where(sure, tilt, self._tilt)
        return turns


def learn_poses(bodies: Bodies, history: History, given: float) -> None:
    """Update the noise of the poses, and what follows; `given`, m, is that of a position."""
    rows = slice(-NOISE_FRAMES, None)
    known = history['information'][rows, 0] > 0
    measured = pose_noise(
        history['time'][rows],
        np.where(known, history['position'][rows], np.nan),
        np.where(known, history['angle'][rows], np.nan),
    )
    bodies.angle_noise = measured.angle
    bodies.lasting = measured.underestimated
    bodies.noise = measured.position
    if given > 0:
        bodies.noise = np.where(np.isnan(measured.angle), np.nan, given)
    # How far markers with such noise would be from their mean.
    arm = bodies.noise / bodies.angle_noise
    scale = np.stack((arm**2, arm**2 / (arm**2 + np.abs(measured.middle) ** 2)))
    bodies.scale = np.where(np.isnan(scale), 1.0, scale)
    bodies.misfit = np.nan_to_num(bodies.noise**2)
    bodies.update()
    bodies.middle, bodies.size = measured.middle, 2 * arm


def extra_turns(before: np.ndarray, after: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """
    Compute how far bodies turned about the normal beyond the turn of their headings.

    The heading is the twist about the normal in the swing-twist decomposition. While a body is
    tilted, its rate is not the angular velocity along the normal, and the integral of the
    difference depends on the path: it does not return to zero with the pose.

    Parameters
    ----------
    before, after : array, shape (T, B), complex
        The tilts at the begin and the end of a rotation with constant angular velocity, as
        `Roster.tilts` returns them; NaN where not known.
    heading : array, shape (T, B), rad
        The change of the heading.

    Returns
    -------
    array, shape (T, B), rad
        The rotation vector along the normal less the change of the heading; 0 where not known.
    """
    # The quaternion of the rotation has the parts w + i z, `along`, and |x + i y|, `across`.
    cosines = [np.sqrt(np.maximum(1 - np.abs(tilt) ** 2, 0.0)) for tilt in (before, after)]
    ahead = cosines[0] * cosines[1] + after * before.conj()
    across = np.abs(cosines[0] * after - cosines[1] * before)
    turn = (heading + np.pi) % (2 * np.pi) - np.pi
    along = ahead * np.exp(0.5j * turn)
    sine = np.hypot(along.imag, across)
    with np.errstate(divide='ignore', invalid='ignore'):
        half = np.arctan2(sine, along.real) * (along.imag / sine)
        extra = 2 * np.angle(ahead) + 2 * (half - np.angle(along))
    return np.asarray(np.nan_to_num(extra))


class PoseNoise(NamedTuple):
    """
    Errors of poses of B bodies.

    `middle` (B,), complex, m, is the point, in the frame of the body, whose error and that of the
    angle are independent; `position` (B,), m, is its deviation per axis and `angle` (B,), rad, that
    of the angle, NaN while not known. `underestimated` (B,) says where they last longer than can be
    measured.
    """

    middle: Complex
    position: Real
    angle: Real
    underestimated: np.ndarray


def pose_noise(time: np.ndarray, position: Complex, angle: Real) -> PoseNoise:
    """
    Measure the noise of poses (N, B) at `time` (N,), ns, NaN for none.

    What differs from polynomials through a few frames is noise, since no mechanism moves so fast:
    divided differences of high order (von Neumann 1941; Gasser, Sroka and Jennen-Steinmetz 1986).
    Poses that a driver smooths differ little from frame to frame, so means over blocks of frames
    are looked at too: of white noise their deviation falls with the root of their length.
    """
    bodies = angle.shape[1]
    unknown = np.full((2, bodies), np.nan)
    found = PoseNoise(np.zeros(bodies, complex), unknown[0], unknown[1], np.zeros(bodies, bool))
    for b in range(bodies):
        seen = np.isfinite(angle[:, b])
        moves = np.ones(len(seen), bool)
        moves[1:] = (np.diff(angle[:, b]) != 0) | (np.diff(position[:, b]) != 0)
        # A tracker that rounds says nothing of its noise while its body rests.
        if (seen & moves).sum() >= MIN_SAMPLES + _ORDER:
            seen &= moves
        if seen.sum() >= MIN_SAMPLES + _ORDER:
            _measure(found, b, time[seen], np.unwrap(angle[seen, b]), position[seen, b])
    return found


def _measure(found: PoseNoise, b: int, stamps: np.ndarray, angle: Real, position: Complex) -> None:
    """Measure what the poses (N,) of one body err by."""
    time = (stamps - stamps[0]) * 1e-9
    turn = np.exp(1j * angle)
    off, turned, about = _differences(time, _ORDER, angle, turn, position)
    if len(off) < MIN_SAMPLES:
        return
    squares = float((turned.real**2 + turned.imag**2).sum())
    if squares > 0:
        found.middle[b] = -(turned.conj() * about).sum() / squares
    place = position + found.middle[b] * turn
    floor = ROUNDING * np.pi, ROUNDING * float(np.abs(position).max())
    levels = []
    for values, least in zip((angle, place), floor, strict=True):
        level = _deviation(time, values, _ORDER)
        lasts = False
        for block in _BLOCKS:
            times, means = _means(block, time, values)
            count = len(times) - _ORDER
            if count < MIN_SAMPLES:
                break
            new, lower = (_deviation(times, means, order) for order in (_ORDER, _LOWER))
            # Motion makes the lower one larger, and is seen in all blocks that are longer.
            if lower > _SAME * new:
                break
            # Of n differences half as many are degrees of freedom.
            lasts = math.sqrt(block) * new > (1 + N_SIGMA / math.sqrt(count)) * level
            if lasts:
                level = math.sqrt(block) * new
        levels.append((max(level, least), lasts))
    (found.angle[b], of_angle), (found.position[b], of_place) = levels
    found.underestimated[b] = of_angle or of_place


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
