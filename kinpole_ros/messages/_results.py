"""
Everything that is published, as one table: topic, type, what it needs and how it is made.

Node, replay and simulate all walk this table, so a topic added here is there in all of them. A row
is only built for a topic somebody reads.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import (
    Point,
    PointStamped,
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    Vector3,
    Vector3Stamped,
    WrenchStamped,
)
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from kinpole_ros.estimate import POLE_NAMES, RATE_NAMES, Estimate, Numbers, Vectors
from kinpole_ros.messages._markers import ns_to_stamp
from kinpole_ros.theory import Theory, balance
from kinpole_ros.tracker import AXES

# Loci are drawn, not computed with: this much of them, this finely, this often (s of stamps).
_TRAIL_POINTS = 200
_TRAIL_STEP = 0.01
_DRAWN_EVERY = 0.1
# A variance for what a planar measurement says nothing about (m^2, rad^2, ...).
_UNMEASURED = 1e6


class Output(NamedTuple):
    """
    One topic under the node's name.

    `order` is the highest derivative it needs; `build` makes the message, None when there is
    nothing determined to say.
    """

    topic: str
    message_type: type
    order: int
    build: Callable[[Estimate], Any]


def result_outputs(bodies: Sequence[str], plane: str, theory: Theory | None = None) -> list[Output]:
    """
    All topics for these bodies, as DESIGN's table has them; `plane` is xy, yz or zx.

    With the loads of a `theory` also what balances them: `balance`, and its standard deviation.
    """
    axes = AXES[plane]
    outputs: list[Output] = []
    trails = [_Trail() for _ in bodies]
    for b, body in enumerate(bodies):
        outputs.append(Output(f'{body}/odom', Odometry, 1, _odometry(b, axes)))
        for order in range(1, 5):
            rate = _Numbers(_rate(order), b, axes)
            outputs.append(Output(f'{body}/{RATE_NAMES[order - 1]}', Vector3Stamped, order, rate))
        for order in range(1, 5):
            name = f'{body}/{POLE_NAMES[order - 1]}'
            pole = _Vectors(_pole(order), b, axes)
            outputs.append(Output(name, PointStamped, order, pole.point))
            outputs.append(
                Output(f'{name}/with_covariance', PoseWithCovarianceStamped, order, pole.pose)
            )
        velocity = _Vectors(lambda e: e.icr_velocity, b, axes)
        outputs.append(Output(f'{body}/icr_velocity', Vector3Stamped, 2, velocity.vector))
        curvature = _Numbers(lambda e: e.centrode_curvature, b, axes)
        outputs.append(Output(f'{body}/centrode_curvature', Vector3Stamped, 3, curvature))
        outputs.append(Output(f'{body}/centrode/fixed', Path, 1, _path(b, axes, trails[b], True)))
        outputs.append(Output(f'{body}/centrode/moving', Path, 1, _path(b, axes, trails[b], False)))
    for k, (i, j) in enumerate(combinations(range(len(bodies)), 2)):
        name = f'{bodies[j]}/wrt/{bodies[i]}'
        center = _Vectors(lambda e: e.relative_icr, k, axes, height=i)
        rate = _Numbers(lambda e: e.relative_rate, k, axes)
        outputs.append(Output(f'{name}/icr', PointStamped, 1, center.point))
        outputs.append(Output(f'{name}/angular_velocity', Vector3Stamped, 1, rate))
    scene = _scene(tuple(bodies), axes, trails)
    outputs.append(Output('visualization', MarkerArray, 2, scene))
    if theory is not None and theory.balances:
        outputs.append(Output('balance', WrenchStamped, 1, _balance(theory, axes, False)))
        outputs.append(Output('balance/deviation', WrenchStamped, 1, _balance(theory, axes, True)))
    return outputs


def _balance(
    theory: Theory, axes: tuple[int, int, int], deviation: bool
) -> Callable[[Estimate], WrenchStamped | None]:
    """The torque on the driven body that balances the loads, or its standard deviation."""

    def build(estimate: Estimate) -> WrenchStamped | None:
        found = balance(theory, estimate)
        if not found.determined:
            return None
        torque = math.sqrt(found.variance) if deviation else float(found.value)
        message = WrenchStamped(header=_header(estimate))
        x, y, z = _place(0j, torque, axes)
        message.wrench.torque = Vector3(x=x, y=y, z=z)
        return message

    return build


def _rate(order: int) -> Callable[[Estimate], Numbers]:
    return lambda estimate: estimate.rate(order)


def _pole(order: int) -> Callable[[Estimate], Vectors]:
    return lambda estimate: estimate.pole(order)


def _header(estimate: Estimate, frame_id: str | None = None) -> Header:
    return _shared_header(estimate.stamp, estimate.frame_id if frame_id is None else frame_id)


@lru_cache(maxsize=16)
def _shared_header(stamp: int, frame_id: str) -> Header:
    """One header for all messages of an instant; they are sent, never changed."""
    return Header(stamp=ns_to_stamp(stamp), frame_id=frame_id)


def _place(value: complex, height: float, axes: tuple[int, int, int]) -> list[float]:
    """x, y and z of a point of the plane."""
    xyz = [0.0, 0.0, 0.0]
    xyz[axes[0]], xyz[axes[1]], xyz[axes[2]] = float(value.real), float(value.imag), float(height)
    return xyz


def _turn(angle: float, axes: tuple[int, int, int]) -> Quaternion:
    xyz = _place(0j, math.sin(angle / 2), axes)
    return Quaternion(x=xyz[0], y=xyz[1], z=xyz[2], w=math.cos(angle / 2))


def _matrix(
    linear: np.ndarray, angular: float, unmeasured: float, axes: tuple[int, int, int]
) -> list[float]:
    """A 6 x 6 covariance from that in the plane (2, 2) and that of the turn about the normal."""
    matrix = np.diag(np.full(6, unmeasured))
    for row in range(2):
        for column in range(2):
            matrix[axes[row], axes[column]] = linear[row, column]
    matrix[3 + axes[2], 3 + axes[2]] = angular
    return matrix.ravel().tolist()


class _Vectors:
    """Messages of one vector quantity of body or pair `k`."""

    def __init__(
        self,
        quantity: Callable[[Estimate], Vectors],
        k: int,
        axes: tuple[int, int, int],
        height: int | None = None,
    ) -> None:
        self._quantity = quantity
        self._k = k
        self._axes = axes
        self._height = k if height is None else height

    def point(self, estimate: Estimate) -> PointStamped | None:
        found = self._quantity(estimate)
        if not found.determined[self._k]:
            return None
        x, y, z = self._xyz(estimate, found)
        return PointStamped(header=_header(estimate), point=Point(x=x, y=y, z=z))

    def pose(self, estimate: Estimate) -> PoseWithCovarianceStamped | None:
        found = self._quantity(estimate)
        if not found.determined[self._k]:
            return None
        message = PoseWithCovarianceStamped(header=_header(estimate))
        x, y, z = self._xyz(estimate, found)
        message.pose.pose.position = Point(x=x, y=y, z=z)
        message.pose.covariance = _matrix(found.covariance[self._k], 0.0, 0.0, self._axes)
        return message

    def vector(self, estimate: Estimate) -> Vector3Stamped | None:
        found = self._quantity(estimate)
        if not found.determined[self._k]:
            return None
        x, y, z = _place(found.value[self._k], 0.0, self._axes)
        return Vector3Stamped(header=_header(estimate), vector=Vector3(x=x, y=y, z=z))

    def _xyz(self, estimate: Estimate, found: Vectors) -> list[float]:
        return _place(found.value[self._k], estimate.height[self._height], self._axes)


class _Numbers:
    """Messages of one quantity along the normal, of body or pair `k`."""

    def __init__(
        self, quantity: Callable[[Estimate], Numbers], k: int, axes: tuple[int, int, int]
    ) -> None:
        self._quantity = quantity
        self._k = k
        self._axes = axes

    def __call__(self, estimate: Estimate) -> Vector3Stamped | None:
        found = self._quantity(estimate)
        if not found.determined[self._k]:
            return None
        x, y, z = _place(0j, found.value[self._k], self._axes)
        return Vector3Stamped(header=_header(estimate), vector=Vector3(x=x, y=y, z=z))


def _odometry(b: int, axes: tuple[int, int, int]) -> Callable[[Estimate], Odometry | None]:
    """Pose of the body in the frame of the markers, twist in the body's own frame (REP-105)."""

    def build(estimate: Estimate) -> Odometry | None:
        if estimate.missing[b]:
            return None
        body = estimate.bodies[b]
        message = Odometry(header=_header(estimate), child_frame_id=body)
        angle = estimate.angle[0, b]
        x, y, z = _place(estimate.position[0, b], estimate.height[b], axes)
        message.pose.pose.position = Point(x=x, y=y, z=z)
        message.pose.pose.orientation = _turn(angle, axes)
        velocity = estimate.position[1, b] * np.exp(-1j * angle)
        x, y, z = _place(velocity, 0.0, axes)
        message.twist.twist.linear = Vector3(x=x, y=y, z=z)
        x, y, z = _place(0j, estimate.angle[1, b], axes)
        message.twist.twist.angular = Vector3(x=x, y=y, z=z)
        for part, order in ((message.pose, 0), (message.twist, 1)):
            linear = np.eye(2) * estimate.position_covariance[order, order, b]
            angular = float(estimate.angle_covariance[order, order, b])
            part.covariance = _matrix(linear, angular, _UNMEASURED, axes)
        return message

    return build


class _Trail:
    """The ICR of late, as seen from the ground and from the body."""

    def __init__(self) -> None:
        self.fixed: deque[complex] = deque(maxlen=_TRAIL_POINTS)
        self.moving: deque[complex] = deque(maxlen=_TRAIL_POINTS)
        self.stamps: deque[int] = deque(maxlen=_TRAIL_POINTS)
        self._since = 0

    def follow(self, estimate: Estimate, b: int) -> None:
        """Take the pole of this instant, unless it has it or one hardly older."""
        pole = estimate.pole(1)
        if estimate.since != self._since:
            self._since = estimate.since
            self.fixed.clear()
            self.moving.clear()
            self.stamps.clear()
        if not pole.determined[b]:
            return
        if self.stamps and estimate.stamp - self.stamps[-1] < _TRAIL_STEP * 1e9:
            return
        self.stamps.append(estimate.stamp)
        self.fixed.append(complex(pole.value[b]))
        arm = pole.value[b] - estimate.position[0, b]
        self.moving.append(complex(arm * np.exp(-1j * estimate.angle[0, b])))


class _Beat:
    """True at most every tenth of a second of stamps."""

    def __init__(self) -> None:
        self._last: int | None = None

    def due(self, stamp: int) -> bool:
        if self._last is not None and 0 <= stamp - self._last < _DRAWN_EVERY * 1e9:
            return False
        self._last = stamp
        return True


def _path(
    b: int, axes: tuple[int, int, int], trail: _Trail, fixed: bool
) -> Callable[[Estimate], Path | None]:
    beat = _Beat()

    poses: deque[PoseStamped] = deque(maxlen=_TRAIL_POINTS)
    taken = since = 0

    def build(estimate: Estimate) -> Path | None:
        nonlocal taken, since
        trail.follow(estimate, b)
        if estimate.missing[b] or not trail.stamps:
            return None
        if estimate.since != since:
            since = estimate.since
            poses.clear()
        if trail.stamps[-1] != taken:
            # Made once and kept: most of a path is what it was a moment ago.
            taken = trail.stamps[-1]
            pose = PoseStamped(header=_header(estimate, None if fixed else estimate.bodies[b]))
            place = trail.fixed[-1] if fixed else trail.moving[-1]
            x, y, z = _place(place, estimate.height[b] if fixed else 0.0, axes)
            pose.pose.position = Point(x=x, y=y, z=z)
            poses.append(pose)
        if not beat.due(estimate.stamp):
            return None
        header = _header(estimate, None if fixed else estimate.bodies[b])
        return Path(header=header, poses=list(poses))

    return build


_COLORS = ((0.12, 0.47, 0.71), (1.0, 0.5, 0.05), (0.17, 0.63, 0.17), (0.84, 0.15, 0.16))


def _scene(
    bodies: tuple[str, ...], axes: tuple[int, int, int], trails: list[_Trail]
) -> Callable[[Estimate], MarkerArray | None]:
    """Poles, both centrodes and the ICR's velocity of every body, for RViz and Foxglove."""
    beat = _Beat()

    def build(estimate: Estimate) -> MarkerArray | None:
        for b in range(len(bodies)):
            trails[b].follow(estimate, b)
        if not beat.due(estimate.stamp):
            return None
        array = MarkerArray()
        for b, body in enumerate(bodies):
            # What is not there is deleted by name: a Marker with a NaN would be dropped whole.
            array.markers += _draw(estimate, b, body, axes, trails[b])
        return array

    return build


def _draw(
    estimate: Estimate, b: int, body: str, axes: tuple[int, int, int], trail: _Trail
) -> list[Marker]:
    color = _COLORS[b % len(_COLORS)]
    size = float(estimate.size[b]) if estimate.size[b] > 0 else 1.0
    height = float(estimate.height[b])
    known = not estimate.missing[b]

    def marker(name: str, kind: int, points: list[complex], width: float, alpha: float) -> Marker:
        drawn = Marker(header=_header(estimate), ns=f'{body}/{name}', id=0, type=kind)
        if not points or not known:
            drawn.action = Marker.DELETE
            return drawn
        drawn.pose.orientation.w = 1.0
        drawn.color = ColorRGBA(r=color[0], g=color[1], b=color[2], a=alpha)
        drawn.scale.x = width
        if kind == Marker.SPHERE:
            drawn.scale.y = drawn.scale.z = width
            x, y, z = _place(points[0], height, axes)
            drawn.pose.position = Point(x=x, y=y, z=z)
            return drawn
        if kind == Marker.ARROW:
            drawn.scale.y = 2 * width
        for value in points:
            x, y, z = _place(value, height, axes)
            drawn.points.append(Point(x=x, y=y, z=z))
        return drawn

    marks = []
    for order, alpha in ((1, 1.0), (2, 0.5)):
        pole = estimate.pole(order)
        points = [complex(pole.value[b])] if pole.determined[b] else []
        marks.append(marker(POLE_NAMES[order - 1], Marker.SPHERE, points, size / 20, alpha))
    arrow = []
    if estimate.icr_moves[b]:
        tail = complex(estimate.pole(1).value[b])
        # Drawn as far as the ICR goes in a tenth of a second.
        arrow = [tail, tail + 0.1 * complex(estimate.icr_velocity.value[b])]
    marks.append(marker('icr_velocity', Marker.ARROW, arrow, size / 50, 1.0))
    line = list(trail.fixed) if len(trail.fixed) > 1 else []
    marks.append(marker('centrode_fixed', Marker.LINE_STRIP, line, size / 100, 1.0))
    if line and known:
        turn = np.exp(1j * estimate.angle[0, b])
        line = [complex(estimate.position[0, b] + turn * value) for value in trail.moving]
    marks.append(marker('centrode_moving', Marker.LINE_STRIP, line, size / 100, 0.5))
    return marks
