"""
Everything that is published, as one table: topic, type, what it needs and how it is made.

Node, replay and simulate all walk this table, so a topic added here is there in all of them. What
nobody reads, of any body, is not built.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kinpole_ros.messages._drawing import scene
from kinpole_ros.messages._events import events
from kinpole_ros.messages._loci import Build, Trail, centrode
from kinpole_ros.messages._rows import At, Figures, Found, both, each
from kinpole_ros.messages._stack import TF, frame_poses, frames, joint_states
from kinpole_ros.messages._state import STATE, state
from kinpole_ros.messages._types import (
    JointState,
    MarkerArray,
    Odometry,
    Path,
    PointCloud2,
    PointStamped,
    PoseWithCovarianceStamped,
    TFMessage,
    Vector3Stamped,
    WrenchStamped,
)
from kinpole_ros.tracking.estimate import (
    POLE_NAMES,
    RATE_NAMES,
    Estimate,
    Numbers,
    Vectors,
    measured_pairs,
)
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.plane import XY, Plane, PlaneSetting, plane_of

if TYPE_CHECKING:
    from kinpole_ros.linkage.theory import Theory

# The topic of what is drawn.
DRAWING = 'visualization'
# A variance for what a planar measurement says nothing about (m^2, rad^2, ...).
_UNMEASURED = 1e6
# The same in a plane that is oblique to the axes of the frame, where it adds to all cells of the
# matrix and must not round away what is measured: deviations down to 1e-7 m are kept.
_UNMEASURED_OBLIQUE = 1e2
# The cells of a 3 x 3 matrix, those below the diagonal from above it: equal to the last bit.
_SYMMETRIC = [0, 1, 2, 1, 4, 5, 2, 5, 8]


class Output(NamedTuple):
    """
    One topic, under the node's name unless it begins with a slash.

    `order` is the highest derivative it needs. `build` makes the messages of an estimate's
    instants: the indices of instants, in order, and a serialized message for each. There is none of
    an instant at which nothing is determined, or nothing due to be drawn. What people look at is
    built every so many seconds at most, `every`, of the clock on the wall; all else of every frame.
    Only for those `of_events` are events searched for.
    """

    topic: str
    message_type: type
    order: int
    build: Build
    every: float = 0.0
    of_events: bool = False

    def under(self, node: str) -> str:
        """The whole name of the topic, of a node of this name; one of all nodes has its own."""
        return self.topic if self.topic.startswith('/') else f'{node}/{self.topic}'


def result_outputs(
    bodies: Sequence[str],
    plane: PlaneSetting,
    theory: 'Theory | None' = None,
    joints: Mapping[str, tuple[str, str]] | None = None,
    frame_prefix: str = '',
    highest: int = 4,
    joint_state_rate: float = 0.0,
) -> list[Output]:
    """
    All topics for these bodies, as DESIGN's table has them.

    `plane`, as the parameter has it, is that of estimates that do not say where they lie. With the
    loads of a `theory` also what balances them: `balance`, and its standard deviation. `joints` are
    pairs of bodies, or of the ground and a body. Frames of bodies have their names after a prefix.
    There are only topics that need derivatives up to the `highest`. States of joints come so many
    times a second of the stamps, or with each instant for 0.
    """
    given = plane_of(plane) or XY
    frame_names = [frame_prefix + body for body in bodies]
    outputs: list[Output] = []
    trails = [Trail() for _ in bodies]

    def add(topic: str, kind: type, order: int, builds: tuple[list[Build], ...], k: int) -> None:
        """One of those that have a topic beside them of their standard deviation."""
        for name, build in zip(('', '/deviation'), builds, strict=True):
            outputs.append(Output(f'{topic}{name}', kind, order, build[k]))

    count, own = len(bodies), np.arange(len(bodies))
    odometry = each(count, _odometry(given), frame_names)
    rates = [both(count, partial(_numbers, _rate(n), given)) for n in range(1, 5)]
    points = [each(count, _points(_pole(n), given, own)) for n in range(1, 5)]
    poses = [each(count, _poses(_pole(n), given)) for n in range(1, 5)]
    velocity = both(count, partial(_points, lambda e: e.icr_velocity, given, None))
    curvature = both(count, partial(_numbers, lambda e: e.centrode_curvature, given))
    for b, body in enumerate(bodies):
        outputs.append(Output(f'{body}/odom', Odometry, 1, odometry[b]))
        for order, name in enumerate(RATE_NAMES, 1):
            add(f'{body}/{name}', Vector3Stamped, order, rates[order - 1], b)
        for order, name in enumerate(POLE_NAMES, 1):
            topic, point, pose = f'{body}/{name}', points[order - 1][b], poses[order - 1][b]
            outputs.append(Output(topic, PointStamped, order, point))
            outputs.append(
                Output(f'{topic}/with_covariance', PoseWithCovarianceStamped, order, pose)
            )
        add(f'{body}/icr_velocity', Vector3Stamped, 2, velocity, b)
        add(f'{body}/centrode_curvature', Vector3Stamped, 3, curvature, b)
        for name, frame in (('fixed', None), ('moving', frame_names[b])):
            locus = centrode(b, given, trails[b], frame)
            outputs.append(Output(f'{body}/centrode/{name}', Path, 1, locus))
        outputs.append(Output(f'{body}/event', PointCloud2, 1, events(b, given), of_events=True))
    pairs = measured_pairs(count)
    firsts = np.array([i for i, _ in pairs], int)
    center = both(len(pairs), partial(_points, lambda e: e.relative_icr, given, firsts))
    rate = both(len(pairs), partial(_numbers, lambda e: e.relative_rate, given))
    for k, (i, j) in enumerate(pairs):
        name = f'{bodies[j]}/wrt/{bodies[i]}'
        add(f'{name}/icr', PointStamped, 1, center, k)
        add(f'{name}/angular_velocity', Vector3Stamped, 1, rate, k)
    if theory is not None:
        from kinpole_ros.linkage.points import measured_point, points_of_interest

        for spot in points_of_interest(theory):
            b = bodies.index(spot.body)
            for order, name in enumerate(('', '/velocity', '/acceleration', '/jerk')):
                kind, heights = (Vector3Stamped, None) if order else (PointStamped, own[[b]])
                motion = partial(_of_one, partial(measured_point, theory, spot, order))
                topic = f'{spot.body}/points/{spot.name}{name}'
                builds = both(1, partial(_points, motion, given, heights))
                add(topic, kind, max(order, 1), builds, 0)
    outputs.append(Output(STATE, PointCloud2, highest, state(given, highest)))
    drawing = scene(tuple(bodies), given, trails, highest)
    outputs.append(Output(DRAWING, MarkerArray, highest, drawing))
    if joints:
        order = min(2, highest) if joint_state_rate else 1
        states = [[joint_states(joints, bodies, joint_state_rate, of)] for of in (False, True)]
        add('joint_states', JointState, order, tuple(states), 0)
    if theory is not None and theory.balances:
        add('balance', WrenchStamped, 1, both(1, partial(_balance, theory, given)), 0)
    outputs.append(Output(TF, TFMessage, 1, frames(frame_names, given)))
    return [output for output in outputs if output.order <= highest]


def theory_of(settings: Settings) -> 'Theory | None':
    """
    Load the theory that the parameter `scene` names; None for no scene.

    `linkage` and `mechanism` are imported here and no earlier. They take as long as the rest of
    the start of a node, and are of use only with a scene.

    Raises ParameterError where the scene cannot be used, or does not go with the bodies.
    """
    if not settings.scene:
        return None
    from kinpole_ros.linkage.theory import load_theory

    return load_theory(settings)


def outputs_of(settings: Settings, theory: 'Theory | None') -> list[Output]:
    """All topics with these settings."""
    return result_outputs(
        tuple(settings.bodies),
        settings.plane,
        theory,
        settings.joints,
        settings.frame_prefix,
        settings.derivative_order or 4,
        settings.joint_state_rate,
    )


def _balance(theory: 'Theory', given: Plane, deviation: bool) -> Figures:
    """What balances the loads, a torque or a force, or its standard deviation."""
    from kinpole_ros.linkage.theory import balance, balance_direction

    def figures(estimate: Estimate, which: int | slice) -> Found:
        value, variance, known = (part[:, None] for part in balance(theory, estimate))
        way = balance_direction(theory, estimate)
        plane = estimate.plane or given

        def rows(at: At) -> np.ndarray:
            values = np.sqrt(variance[at]) if deviation else value[at]
            wrench = np.zeros((len(values), 6))
            if way is None:
                wrench[:, 3:] = plane.along_normal(values)
            else:
                force = plane.in_space(values * way[:, None][at], 0.0)
                wrench[:, :3] = np.abs(force) if deviation else force
            return wrench

        return known[:, which], rows

    return figures


def _of_one(motion: Callable[[Estimate], Vectors], estimate: Estimate) -> Vectors:
    """The motion (T,) of one point as an array (T, 1) of points."""
    return Vectors(*(part[:, None] for part in motion(estimate)))


def _rate(order: int) -> Callable[[Estimate], Numbers]:
    return lambda estimate: estimate.rate(order)


def _pole(order: int) -> Callable[[Estimate], Vectors]:
    return lambda estimate: estimate.pole(order)


def _numbers(quantity: Callable[[Estimate], Numbers], given: Plane, deviation: bool) -> Figures:
    """One quantity along the normal, as a vector; or its deviation."""

    def figures(estimate: Estimate, which: int | slice) -> Found:
        value, variance, known = quantity(estimate)

        def rows(at: At) -> np.ndarray:
            values = np.sqrt(variance[at]) if deviation else value[at]
            return (estimate.plane or given).along_normal(values)

        return known[:, which], rows

    return figures


def _points(
    quantity: Callable[[Estimate], Vectors],
    given: Plane,
    bodies: np.ndarray | None,
    deviation: bool = False,
) -> Figures:
    """
    One vector of bodies or pairs: points at the heights of these `bodies`, or free ones without.

    Or its deviations, along the axes of the frame.
    """

    def figures(estimate: Estimate, which: int | slice) -> Found:
        value, spread, known = quantity(estimate)

        def rows(at: At) -> np.ndarray:
            plane = estimate.plane or given
            if deviation:
                across = plane.basis[:2]
                cells = np.einsum('ia,tij,ja->ta', across, spread[at], across)
                return np.asarray(np.sqrt(np.maximum(cells, 0.0)))
            heights = 0.0 if bodies is None else estimate.height[at[0], bodies[at[1]]]
            return plane.in_space(value[at], heights)

        return known[:, which], rows

    return figures


def _poses(quantity: Callable[[Estimate], Vectors], given: Plane) -> Figures:
    """One point of each body with its covariance."""

    def figures(estimate: Estimate, which: int | slice) -> Found:
        value, spread, known = quantity(estimate)

        def rows(at: At) -> np.ndarray:
            values = value[at]
            poses = np.zeros((len(values), 43))
            plane = estimate.plane or given
            poses[:, :3] = plane.in_space(values, estimate.height[at])
            poses[:, 6] = 1.0
            across = plane.basis[:2]
            # After seven of the pose, in a 6 x 6 matrix.
            cells = poses[:, 7:].reshape(-1, 6, 6)
            cells[:, :3, :3] = across.T @ spread[at] @ across
            return poses

        return known[:, which], rows

    return figures


def _odometry(given: Plane) -> Figures:
    """Pose of each body in the frame of the markers, twist in the body's own frame (REP-105)."""

    def rows_of(estimate: Estimate, at: At) -> np.ndarray:
        velocity = estimate.origin(1)[at]
        angle, rate = estimate.angle[0][at], estimate.angle[1][at]
        rows = np.zeros((len(angle), 85))
        pose, twist = rows[:, :43], rows[:, 43:]
        plane = estimate.plane or given
        pose[:, :7] = frame_poses(estimate, given, at)
        turn = np.exp(0.5j * angle)
        twist[:, :3] = plane.in_space(velocity / turn**2, 0.0)
        twist[:, 3:6] = plane.along_normal(rate)
        of_angle = np.moveaxis(estimate.angle_covariance, (0, 1), (-2, -1))[at][:, :2, :2].copy()
        of_angle[:, 1, 1] = estimate.rate(1).variance[at]
        # By how much they change with the angle and with the rate: the origin lies about the
        # reference point, whose velocity is seen from the body.
        arm = estimate.reference[at]
        by_angle = np.zeros((2, len(angle), 3, 2))
        for part, column, lever in (
            (0, 0, arm * turn**2),
            (1, 0, estimate.position[1][at] / turn**2),
            (1, 1, arm),
        ):
            by_angle[part, :, 0, column] = lever.imag
            by_angle[part, :, 1, column] = -lever.real
        by_angle[0, :, 2, 0] = by_angle[1, :, 2, 1] = 1.0
        spread = np.einsum('ptij,tjk,ptlk->ptil', by_angle, of_angle, by_angle)
        known, unknown = _in_space(plane)
        for order, part in enumerate((pose, twist)):
            variance = estimate.position_covariance[order, order][at]
            even = spread[order].reshape(-1, 9)[:, _SYMMETRIC].reshape(-1, 3, 3)
            even[:, 0, 0] += variance
            even[:, 1, 1] += variance
            cells = known @ even @ known.T
            cells = (cells + cells.swapaxes(1, 2)) / 2 + unknown
            part[:, -36:] = cells.reshape(-1, 36)
        return rows

    return lambda e, which: (e.missing[:, which] == '', partial(rows_of, e))


def _in_space(plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    """
    How x, y and angle in the plane are parts (6, 3) of a pose in space, as ROS orders them.

    Also the covariance (6, 6) of the parts that a planar measurement says nothing about.
    """
    across = plane.basis[:2]
    known, unknown = np.zeros((6, 3)), np.zeros((6, 6))
    known[:3, :2], known[3:, 2] = across.T, plane.normal
    unknown[:3, :3] = np.outer(plane.normal, plane.normal)
    unknown[3:, 3:] = across.T @ across
    return known, unknown * (_UNMEASURED if plane.axes else _UNMEASURED_OBLIQUE)
