"""
The prompt answer to a frame that comes as expected.

While a live node waits for the next frame it has nothing to do. So all that hangs on the frames
before is found then, and only what the new one adds is left for when it comes, as in real-time
iterations (Diehl, Bock and Schloeder 2005): derivatives are affine in the newest poses. Numbers
take a twentieth of the time of arrays with one element, so the figures that are read most are here
once more, for one body. `Estimate` has them all and says why they are as they are; what is not as
expected is left to it.
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
from kinpole_ros.plane import XY, Plane
from kinpole_ros.roster import FARTHEST_MARKER, Roster
from kinpole_ros.window import NOT_FAR, PlainShape, Room, Unforeseen

Matrix = list[list[float]]
T = TypeVar('T', float, complex)


class Body(NamedTuple):
    """
    What is known of a body before its newest pose.

    Derivatives by order, apart and then together: as they are by the pose that is expected, and by
    how much they change with what it is off that; their covariances, and what `Estimate` has.
    """

    angle: Matrix
    angle_change: Matrix
    position: list[list[complex]]
    position_change: Matrix
    of_angle: list[Matrix]
    of_position: list[Matrix]
    turning: float
    size: float
    height: float
    pin: complex | None


class Prompt(NamedTuple):
    """What bodies do at the instant `stamp`, ns, in the frame `frame_id`; `plane` as `Estimate`."""

    stamp: int
    frame_id: str
    bodies: list['Moving']
    plane: Plane | None = None


class Foreseen:
    """
    The next frame as it is expected: at `stamp`, laid out as the last that `roster` has sorted.

    `poses` (2, 2 B, 2) are those before and those expected, angles first; `reference` (B,) are the
    points of the bodies that are differentiated. The `estimate` is of the same instant by what is
    expected and by poses that are off that as in `PoseFilter.ahead`; `room` is how far off they may
    be.
    """

    def __init__(
        self,
        stamp: int,
        roster: Roster,
        shapes: Sequence[PlainShape],
        poses: np.ndarray,
        reference: np.ndarray,
        room: Room,
        estimate: Estimate,
    ) -> None:
        count = len(shapes)
        self._layout = stamp, estimate.frame_id, roster.identities
        self._stamp = int(estimate.stamp[0])
        # Whether it is this frame that is told of.
        self._newest = self._stamp == stamp
        self._plane = plane = estimate.plane or XY
        self._axes = plane.axes or (0, 1, 2)
        # Where markers are turned or scaled first, the matrix that does it.
        self._turn = None
        if plane.axes is None:
            self._turn = roster.scale * plane.basis.T
        elif roster.scale != 1.0:
            self._turn = roster.scale * np.eye(3)
        self._places = roster.places()
        if [len(shape.grip.arms) for shape in shapes] != [len(place) for place in self._places]:
            raise Unforeseen
        self._shapes = shapes
        before, here = poses
        self._before = before[:count, 0].tolist()
        self._angle = here[:count, 0].tolist()
        self._reference = reference.tolist()
        turn = np.exp(1j * here[:count, 0])
        self._position = (here[count:] @ (1, 1j) + reference * turn).tolist()
        self._room = room
        self._bodies = [body_of(estimate, b) for b in range(count)]

    def told(self, frames: MarkerFrames) -> Prompt:
        """What the frame that has come says; raises Unforeseen or ArithmeticError."""
        stamps, *layout, points = frames
        if len(stamps) != 1 or (stamps[0], *layout) != self._layout:
            raise Unforeseen
        bodies = [self._moving(b, points[0, place]) for b, place in enumerate(self._places)]
        return Prompt(self._stamp, self._layout[1], bodies, self._plane)

    def _moving(self, b: int, markers: np.ndarray) -> 'Moving':
        grip, most, angle_ahead, ahead, turn, shift = self._shapes[b]
        if self._turn is not None:
            with np.errstate(invalid='ignore', over='ignore'):
                markers = markers @ self._turn
        rows = markers.tolist()
        for row in rows:
            for coordinate in row:
                if not abs(coordinate) < FARTHEST_MARKER:
                    raise Unforeseen
        x, y, normal = self._axes
        position, angle, left = grip.fit([complex(row[x], row[y]) for row in rows])
        step = angle - self._before[b]
        if not (left <= most and math.cos(step) >= NOT_FAR):
            raise Unforeseen
        # One that is far off what was to be expected may be wrong.
        turned = math.remainder(angle - angle_ahead, 2 * math.pi)
        if not (turned**2 <= turn and abs(position - ahead) ** 2 <= shift):
            raise Unforeseen
        arm = self._reference[b]
        if arm:
            position += arm * complex(math.cos(angle), math.sin(angle))
        angle_off = angle - 2 * math.pi * round(step / (2 * math.pi)) - self._angle[b]
        position_off = position - self._position[b]
        signals = (b, angle_off), (len(self._shapes) + b, position_off)
        if not all(self._room.holds(*signal) for signal in signals):
            raise Unforeseen
        body = self._bodies[b]
        if self._newest:
            body = body._replace(height=sum(row[normal] for row in rows) / len(rows))
        return Moving(body, angle_off, position_off)


def body_of(estimate: Estimate, b: int) -> Body:
    """What the `estimate` of a `Foreseen` says of one body."""
    position, angle, of_position, of_angle = (part[..., b] for part in estimate.poses(1))
    assert estimate.together is not None
    # The orders last.
    return Body(
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

    They raise ArithmeticError where they do not come out.
    """

    def __init__(self, body: Body, angle_off: float, position_off: complex) -> None:
        self._body = body
        self._angle = _moved(body.angle, body.angle_change, angle_off)
        self._position = _moved(body.position, body.position_change, position_off)
        self.height = body.height

    def rate(self, order: int) -> float | None:
        """As `Estimate.rate`, rad/s^order."""
        value = self._angle[0][order]
        return value if isfinite(value) else None

    @cached_property
    def _pole(self) -> tuple[complex, bool]:
        """The ICR as it follows from the motion, and whether the two that there are agree."""
        values, variances = [], []
        for angle, position, of_angle, of_position in self._sets():
            q = 1j / angle[1]
            arm = position[1] * q
            even = _mean_square((1.0, q), of_position, 0)
            values.append(position[0] + arm)
            variances.append(2 * even + abs(arm * q) ** 2 * of_angle[1][1])
        value, _, agreed = _mean(values, variances)
        return value, agreed

    @cached_property
    def icr(self) -> complex | None:
        """As `Estimate.pole` of order 1, m."""
        pin, (apart, both) = self._body.pin, self._angle
        noise, noise_both = self._body.of_angle
        if pin is not None and apart[1] ** 2 > SIGNIFICANT**2 * noise[1][1]:
            return pin
        different = self._body.turning
        times = NOISE if different > 0 else SIGNIFICANT
        least = times**2 * noise_both[1][1] + DIFFERENT[0] ** 2 * different
        if not (both[1] ** 2 > least and apart[1] ** 2 > APART[0] ** 2 * noise[1][1]):
            return None
        value, agreed = self._pole
        if not (agreed and self._near(value)):
            return None
        return value if pin is None else pin

    @property
    def centrode_curvature(self) -> float | None:
        """As `Estimate.centrode_curvature`, 1/m."""
        rate = self._angle[0][1]
        turns = rate**2 > TURNING**2 * self._body.of_angle[0][1][1]
        if not turns or self._body.pin is not None:
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
            even = _mean_square(u[1], of_position, 1)
            of_velocity.append(2 * even + _mean_square(u[2], of_angle, 1))
            even = _mean_square(curvature[1], of_position, 1)
            of_curvature.append(even + _mean_square(by_angle, of_angle, 1))
        u, spread, _ = _mean(velocities, of_velocity)
        value, noise, agreed = _mean(curvatures, of_curvature)
        size, speed = self._body.size, abs(u) ** 2
        noise += 18 * (value * spread / 2 / speed) ** 2
        moves = speed > max(MOVING**2 * spread, (STILL * rate * size) ** 2)
        moves = moves and self._near(self._pole[0])
        sure = noise < max(CURVED * abs(value), 1 / size) ** 2
        return value if moves and sure and agreed else None

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


def _mean_square(factors: Sequence[complex], matrix: Matrix, first: int) -> float:
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
    """The mean of two, its variance, and whether they agree, as `estimate` has it of arrays."""
    (one, other), (v, w) = values, variances
    if not (isfinite(v) and isfinite(w) and isfinite(one) and isfinite(other)):
        raise ArithmeticError
    ratio, inverse = v / w, w / v
    share, rest = 1 / (1 + ratio * ratio), 1 / (1 + inverse * inverse)
    off = abs(other - one) ** 2
    variance = share * v + rest * w + share * rest * off
    return share * one + rest * other, variance, off <= AGREE**2 * (v + w)
