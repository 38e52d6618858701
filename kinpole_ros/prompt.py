"""
The answer to a frame that comes as expected, in plain numbers, found at once.

Until the next frame comes a live node has nothing to do. So all that can be found of it before is
found then, and when it comes only its own share is left (as the real-time iteration has it: Diehl,
Bock and Schloeder 2005): the derivatives are affine in the newest poses. Numbers take a twentieth
of the time of arrays with one element, so the figures that are read most are written here once
more for one body. `Estimate` has the same for all figures, bodies and instants, and says why;
whatever is not as expected is left to it.
"""

import math
from cmath import isfinite
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np

from kinpole_ros import planar

from kinpole_ros.estimate import (
    AGREE,
    APART,
    CURVED,
    DIFFERENT,
    FARTHEST,
    MOVING,
    NOISE,
    SIGNIFICANT,
    STILL,
    TURNING,
    Estimate,
)
from kinpole_ros.frame import MarkerFrames
from kinpole_ros.roster import FARTHEST_MARKER, Roster
from kinpole_ros.window import NOT_FAR, PlainShape, Room, Unforeseen

Matrix = list[list[float]]
T = TypeVar('T', float, complex)


class _Body(NamedTuple):
    """
    What is known of a body before its newest pose: lists by set, apart and together, then by order.

    Derivatives as by the pose that was guessed, and by how much they change with it.
    """

    angle: Matrix
    angle_by: Matrix
    position: list[list[complex]]
    position_by: Matrix
    of_angle: list[Matrix]
    of_position: list[Matrix]
    turning: float
    size: float
    height: float
    pin: complex | None


class Prompt(NamedTuple):
    """What bodies do at the instant `stamp`, ns, in the frame `frame_id`."""

    stamp: int
    frame_id: str
    bodies: list['Moving']


class Foreseen:
    """
    The next frame as it is expected.

    Raises
    ------
    Unforeseen
        If it is not as expected.

    """

    def __init__(
        self,
        stamp: int,
        frame_id: str,
        roster: Roster,
        shapes: Sequence[PlainShape],
        poses: np.ndarray,
        reference: np.ndarray,
        room: Room,
        estimate: Estimate,
    ) -> None:
        count = len(shapes)
        self._layout = stamp, frame_id, roster.identities
        self._stamp = int(estimate.stamp[0])
        self._axes = roster.axes
        self._places = roster.places()
        if len(self._places) != count:
            raise Unforeseen
        self._shapes = shapes
        before, here = poses
        self._before = before[:count, 0].tolist()
        self._angle = here[:count, 0].tolist()
        self._reference = reference.tolist()
        turn = np.exp(1j * here[:count, 0])
        self._position = (here[count:] @ (1, 1j) + reference * turn).tolist()
        self._room = room
        self._bodies = [_body(estimate, b) for b in range(count)]

    def told(self, frames: MarkerFrames) -> 'Prompt':
        """What the one frame that has come says."""
        stamps, *layout, points = frames
        if len(stamps) != 1 or (stamps[0], *layout) != self._layout:
            raise Unforeseen
        bodies = [self._moving(b, points[0, place]) for b, place in enumerate(self._places)]
        return Prompt(self._stamp, self._layout[1], bodies)

    def _moving(self, b: int, markers: np.ndarray) -> 'Moving':
        grip, most = self._shapes[b]
        rows = markers.tolist()
        for row in rows:
            for coordinate in row:
                if not abs(coordinate) < FARTHEST_MARKER:
                    raise Unforeseen
        x, y, _ = self._axes
        position, angle, left = grip.fit([complex(row[x], row[y]) for row in rows])
        step = angle - self._before[b]
        if not (left <= most and math.cos(step) >= NOT_FAR):
            raise Unforeseen
        arm = self._reference[b]
        if arm:
            position += arm * complex(math.cos(angle), math.sin(angle))
        angle_off = angle - 2 * math.pi * round(step / (2 * math.pi)) - self._angle[b]
        position_off = position - self._position[b]
        signals = (b, angle_off), (len(self._shapes) + b, position_off)
        if not all(self._room.holds(*signal) for signal in signals):
            raise Unforeseen
        return Moving(self._bodies[b], angle_off, position_off)


def _body(estimate: Estimate, b: int) -> _Body:
    """Of the estimates of two instants that are the same but for the newest pose."""
    position, angle, of_position, of_angle = (part[..., b] for part in estimate.poses(1))
    assert estimate.together is not None
    # The orders last.
    return _Body(
        angle[..., 0].T.tolist(),
        (angle[..., 1] - angle[..., 0]).T.tolist(),
        position[..., 0].T.tolist(),
        (position[..., 1] - position[..., 0]).real.T.tolist(),
        of_angle[..., 0].transpose(2, 0, 1).tolist(),
        of_position[..., 0].transpose(2, 0, 1).tolist(),
        float(estimate.together.turning[1, 0, 0, b]),
        float(estimate.size[0, b]),
        float(estimate.height[0, b]),
        complex(estimate.pin[0, b]) if estimate.pinned[0, b] else None,
    )


class Moving:
    """
    One body at one instant: figures as of `Estimate`, None where they are not determined.

    Raises
    ------
    ArithmeticError
        Where a figure does not come out, for the arrays to tell.

    """

    def __init__(self, body: _Body, angle_off: float, position_off: complex) -> None:
        self._body = body
        self._angle = _moved(body.angle, body.angle_by, angle_off)
        self._position = _moved(body.position, body.position_by, position_off)
        self.height = body.height

    def rate(self, order: int) -> float:
        """As `Estimate.rate`, rad/s^order."""
        return self._angle[0][order]

    @cached_property
    def _pole(self) -> tuple[complex, bool]:
        """The ICR as it follows from the motion, and whether the two that there are agree."""
        values, variances = [], []
        for angle, position, of_angle, of_position in self._sets():
            q = 1j / angle[1]
            arm = position[1] * q
            even = mean_square((1.0, q), of_position, 0)
            values.append(position[0] + arm)
            variances.append(2 * even + abs(arm * q) ** 2 * of_angle[1][1])
        value, _, agreed = _mean(values, variances)
        return value, agreed

    @cached_property
    def icr(self) -> complex | None:
        """As `Estimate.pole` of order 1, m."""
        pin, (apart, both) = self._body.pin, self._angle
        noise, noise_both = self._body.of_angle
        if pin is not None and abs(apart[1]) > SIGNIFICANT * math.sqrt(noise[1][1]):
            return pin
        value, agreed = self._pole
        different = self._body.turning
        times = NOISE if different > 0 else SIGNIFICANT
        turning = (
            abs(both[1]) > math.sqrt(times**2 * noise_both[1][1] + DIFFERENT[0] ** 2 * different)
            and abs(apart[1]) > APART[0] * math.sqrt(noise[1][1])
            and agreed
            and self._near(value)
        )
        return (value if pin is None else pin) if turning else None

    @property
    def centrode_curvature(self) -> float | None:
        """As `Estimate.centrode_curvature`, 1/m."""
        if self._body.pin is not None:
            return None
        velocities, curvatures, of_velocity, of_curvature = [], [], [], []
        for angle, position, of_angle, of_position in self._sets():
            turn = [complex(0.0, rate) for rate in angle[1:4]]
            u = planar.velocity_terms(position[1:3], turn[:2])
            du = planar.acceleration_terms(position[1:4], turn[1:], *u[1:])
            curvature = planar.curvature_terms(u, du)
            by_angle = [by.real for by in curvature[2]]
            velocities.append(u[0])
            curvatures.append(curvature[0])
            even = mean_square(u[1], of_position, 1)
            of_velocity.append(2 * even + mean_square(u[2], of_angle, 1))
            even = mean_square(curvature[1], of_position, 1)
            of_curvature.append(even + mean_square(by_angle, of_angle, 1))
        u, spread, _ = _mean(velocities, of_velocity)
        value, noise, agreed = _mean(curvatures, of_curvature)
        noise += 18 * (value * spread / 2 / abs(u) ** 2) ** 2
        size, rate = self._body.size, self._angle[0][1]
        moves = self._near(self._pole[0]) and (
            abs(u) > max(MOVING * math.sqrt(spread), STILL * abs(rate) * size)
        )
        turns = rate**2 > TURNING**2 * self._body.of_angle[0][1][1]
        sure = noise < max(CURVED * abs(value), 1 / size) ** 2
        return value if moves and turns and sure and agreed else None

    def _sets(self) -> Iterator[tuple[list[float], list[complex], Matrix, Matrix]]:
        """Angle and position with their covariances, apart and together."""
        body = self._body
        return zip(self._angle, self._position, body.of_angle, body.of_position, strict=True)

    def _near(self, pole: complex) -> bool:
        return abs(pole - self._position[0][0]) < FARTHEST * self._body.size


def _moved(values: list[list[T]], changes: Matrix, off: T) -> list[list[T]]:
    return [
        [value + change * off for value, change in zip(*both, strict=True)]
        for both in zip(values, changes, strict=True)
    ]


def mean_square(factors: Sequence[complex], matrix: Matrix, first: int) -> float:
    """As `planar.mean_square`, by the orders of the matrix from `first` on."""
    total = 0.0
    for k, one in enumerate(factors):
        row = matrix[first + k]
        total += row[first + k] * (one.real**2 + one.imag**2)
        for m in range(k):
            other = factors[m]
            total += 2 * row[first + m] * (one.real * other.real + one.imag * other.imag)
    return total


def _mean(values: list[T], variances: list[float]) -> tuple[T, float, bool]:
    """The mean of two, its variance, and whether they agree: see `estimate`, which has it of arrays."""
    (one, other), (v, w) = values, variances
    if not (isfinite(v) and isfinite(w) and isfinite(one) and isfinite(other)):
        raise ArithmeticError
    ratio, inverse = v / w, w / v
    share, rest = 1 / (1 + ratio * ratio), 1 / (1 + inverse * inverse)
    off = abs(other - one) ** 2
    variance = share * v + rest * w + share * rest * off
    return share * one + rest * other, variance, off <= AGREE**2 * (v + w)
