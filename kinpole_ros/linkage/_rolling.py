"""Wheels that roll on lines and gears that roll on each other, by their angles."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._joints import Joint
from kinpole_ros.linkage._poses import Pose

_FITS = 3.0  # times the noise that a model may leave over, as in _joints
_FEWEST = 50  # frames
_LARGEST_WHEEL = 10.0  # radius over the size of what is marked on it: else it hardly turns


class Rolling(NamedTuple):
    """
    A wheel, the body `one`, that rolls without slip on a line or circle of `other` (-1: ground).

    `hub` is its center on `one`, `radius` its radius; `line` (its direction on `other`, rad, the
    wheel to the left of it, and a point that it goes through) or `circle` about a point of `other`,
    negative where the wheel is inside. `arm` is the body that holds both centers, or -1.
    `deviation` is that of the radius; `residual` is left over of the way rolled, `expected` what
    noise explains. `steady`: all turn at constant rates, as gears do, and independent motors.
    """

    one: int
    other: int
    hub: complex
    radius: float
    along: float
    at: complex
    circle: float
    arm: int
    deviation: float
    residual: float
    expected: float
    steady: bool


def fit_wheel(one: Pose, other: Pose, slot: Joint) -> Rolling | None:
    """Whether the point that moves along a line is the hub of a wheel rolling on it."""
    both = one.seen & other.seen
    back = np.exp(-1j * other.angle[both])
    w = back * (one.position[both] - other.position[both])
    theta = one.angle[both] - other.angle[both]
    direction = np.exp(1j * slot.along)
    along = (direction.conjugate() * (w + np.exp(1j * theta) * slot.on_one)).real
    rows = np.stack((theta, np.ones(len(theta))), axis=1)
    (rate, start), *_ = np.linalg.lstsq(rows, along, rcond=None)
    residual = float(np.std(along - rows @ (rate, start)))
    noise = one.angle_variance + other.angle_variance
    expected = float(np.sqrt(slot.expected**2 + rate**2 * noise))
    if residual > _FITS * expected + 0.002 * float(np.std(along)):
        return None
    # Rolling to the right means turning clockwise, for a wheel to the left of its line.
    if rate > 0:
        direction = -direction
    radius = abs(float(rate))
    if radius > _LARGEST_WHEEL * one.size:
        return None
    at = slot.on_other - 1j * direction * radius
    deviation = max(residual, expected) / float(np.std(theta) * np.sqrt(len(theta)))
    return Rolling(
        slot.one,
        slot.other,
        slot.on_one,
        radius,
        float(np.angle(direction)),
        complex(at),
        0.0,
        -1,
        deviation,
        residual,
        expected,
        False,
    )


def fit_gear(
    one: Pose,
    other: Pose,
    arm: Pose,
    numbers: tuple[int, int, int],
    pins: tuple[complex, ...],
    of_pins: float,
) -> Rolling | None:
    """
    Whether `one` rolls on `other`, both pinned to `arm`: their turns against it have one ratio.

    `numbers` are those of the three, `pins` the hub on `one`, its place on the arm, the center on
    `other` and its place on the arm, `of_pins` their deviation. Willis:
    R (θ_j - θ_arm) = -r (θ_i - θ_arm), with R < 0 inside.
    """
    both = one.seen & other.seen & arm.seen
    if both.sum() < _FEWEST:
        return None
    a, b, c = (pose.angle[both] for pose in (one, other, arm))
    x, y = b - c, a - c
    spread = np.std(x), np.std(y)
    noise = one.angle_variance + arm.angle_variance, other.angle_variance + arm.angle_variance
    if spread[0] ** 2 < 100 * noise[1] or spread[1] ** 2 < 100 * noise[0]:
        return None
    x, y = x - x.mean(), y - y.mean()
    ratio = float(x @ y / (x @ x))
    residual = float(np.std(y - ratio * x))
    variance = one.angle_variance + ratio**2 * other.angle_variance
    variance += (1 - ratio) ** 2 * arm.angle_variance
    expected = float(np.sqrt(variance))
    if residual > _FITS * expected or abs(ratio) > 50:
        return None
    # R = -ratio r, and the centers are R + r from each other, or inside |R| - r. Of a ring that
    # turns about its wheel the ratio is between 0 and 1: it is found the other way round.
    if -0.02 < ratio < 1.02:
        return None
    distance = abs(pins[1] - pins[3])
    radius = distance / abs(1 - ratio)
    circle = -ratio * radius
    deviation = distance / (1 - ratio) ** 2 * max(residual, expected) / (spread[0] * len(x) ** 0.5)
    deviation = np.hypot(deviation, 2**0.5 * of_pins / abs(1 - ratio))
    rate = np.polyfit(np.arange(len(y)), y, 1)
    steady = float(np.std(y - np.polyval(rate, np.arange(len(y))))) < 3 * expected
    return Rolling(
        numbers[0],
        numbers[1],
        pins[0],
        float(radius),
        0.0,
        pins[2],
        float(circle),
        numbers[2],
        float(deviation),
        residual,
        expected,
        bool(steady),
    )
