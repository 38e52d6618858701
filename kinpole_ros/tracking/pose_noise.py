"""
Poses of bodies as input, instead of markers.

Each pose is represented by three points of its body, which fit exactly. So noise is measured of the
poses: of the angle, and of the point whose error is independent of that of the angle.
"""

import math
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.statistics import divided_differences, trimmed_mean
from kinpole_ros.tracking.thresholds import MEMORY_FRAMES, MIN_SAMPLES, N_SIGMA

# Order of the differences that measure the noise, and a lower one, which motion would enlarge.
_ORDER = 6
_LOWER_ORDER = _ORDER - 2
# Standard deviations, and intervals, are equal within this factor.
_MAX_RATIO = 1.25
# Frames in a block.
_BLOCKS = 2, 4, 8


def learn_poses(bodies: Bodies, history: History, given: float) -> Bodies:
    """Update the noise of the poses; the parameters may give that of a position, m."""
    rows = slice(-MEMORY_FRAMES, None)
    has_pose = history['information'][rows, 0] > 0
    measured = pose_noise(
        history['time'][rows],
        np.where(has_pose, history['position'][rows], np.nan),
        np.where(has_pose, history['angle'][rows], np.nan),
    )
    is_unknown = np.isnan(measured.angle)
    noise = np.where(is_unknown, np.nan, given) if given > 0 else measured.position
    return bodies.change(
        angle_noise=np.where(is_unknown, np.inf, measured.angle),
        pose_middle=measured.middle,
        lasting=measured.underestimated,
        noise=noise,
        # Not what the parameters say: exact poses of a body at rest do repeat.
        white=np.full(bodies.count, np.nan) if given > 0 else noise,
        misfit=np.nan_to_num(noise**2),
    )


class PoseNoise(NamedTuple):
    """
    Noise of the poses of B bodies, NaN while not known.

    `middle` (B,), complex, m, is the point in the frame of the body whose error is independent of
    that of the angle. `position` (B,), m, is its standard deviation per axis, `angle` (B,), rad,
    that of the angle. `underestimated` (B,) marks noise that is correlated for too long.
    """

    middle: Complex
    position: Real
    angle: Real
    underestimated: np.ndarray


def pose_noise(time: np.ndarray, position: Complex, angle: Real) -> PoseNoise:
    """
    Measure the noise of poses (N, B) at `time` (N,), ns, NaN for none.

    Differences from polynomials through a few frames are noise, since no mechanism moves so fast:
    divided differences of high order (von Neumann 1941; Gasser, Sroka and Jennen-Steinmetz 1986).
    A driver that smooths poses hides noise from frame to frame. So means over blocks of frames are
    measured too: of white noise their deviation falls with the root of their length.
    """
    bodies = angle.shape[1]
    unknown = np.full((2, bodies), np.nan)
    noise = PoseNoise(np.zeros(bodies, complex), unknown[0], unknown[1], np.zeros(bodies, bool))
    for b in range(bodies):
        seen = np.isfinite(angle[:, b])
        moves = np.ones(len(seen), bool)
        moves[1:] = (np.diff(angle[:, b]) != 0) | (np.diff(position[:, b]) != 0)
        # A body at rest shows no noise of a tracker that rounds.
        if (seen & moves).sum() >= MIN_SAMPLES + _ORDER:
            seen &= moves
        if seen.sum() >= MIN_SAMPLES + _ORDER:
            _measure_noise(noise, b, time[seen], np.unwrap(angle[seen, b]), position[seen, b])
    return noise


def _measure_noise(
    noise: PoseNoise, b: int, stamps: np.ndarray, angle: Real, position: Complex
) -> None:
    """Measure the noise of the poses (N,) of one body."""
    time = (stamps - stamps[0]) * 1e-9
    turn = np.exp(1j * angle)
    turned, about = (divided_differences(time, part, _ORDER) for part in (turn, position))
    if len(turned) < MIN_SAMPLES:
        return
    squares = float((turned.real**2 + turned.imag**2).sum())
    if squares > 0:
        noise.middle[b] = -(turned.conj() * about).sum() / squares
    middle = position + noise.middle[b] * turn
    floor = ROUNDING * np.pi, ROUNDING * float(np.abs(position).max())
    levels = []
    for values, least in zip((angle, middle), floor, strict=True):
        level = _deviation(time, values, _ORDER)
        lasts = False
        for block in _BLOCKS:
            times, means = _means(block, time, values)
            count = len(times) - _ORDER
            if count < MIN_SAMPLES:
                break
            new, lower = (_deviation(times, means, order) for order in (_ORDER, _LOWER_ORDER))
            # Motion enlarges the lower order, also in all longer blocks.
            if lower > _MAX_RATIO * new:
                break
            # n differences have n / 2 degrees of freedom.
            lasts = math.sqrt(block) * new > (1 + N_SIGMA / math.sqrt(count)) * level
            if lasts:
                level = math.sqrt(block) * new
        levels.append((max(level, least), lasts))
    (noise.angle[b], of_angle), (noise.position[b], of_position) = levels
    noise.underestimated[b] = of_angle or of_position


def _means(block: int, time: Real, values: np.ndarray) -> tuple[Real, np.ndarray]:
    """Means over blocks of the latest frames with even intervals; others depend on the motion."""
    count = len(time) // block
    shape = count, block
    times, values = (part[len(part) - count * block :].reshape(shape) for part in (time, values))
    length = times[:, -1] - times[:, 0]
    even = length < _MAX_RATIO * (block - 1) * np.median(np.diff(time))
    return times[even].mean(axis=1), values[even].mean(axis=1)


def _deviation(time: Real, values: np.ndarray, order: int) -> float:
    """Standard deviation of white noise of one coordinate, by differences of an order."""
    differences = divided_differences(time, values, order)
    squares = differences.real**2 + differences.imag**2
    coordinates = 2 if np.iscomplexobj(differences) else 1
    if not len(squares):
        return math.nan
    return math.sqrt(trimmed_mean(squares, coordinates) / coordinates)
