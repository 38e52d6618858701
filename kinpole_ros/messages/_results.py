"""
The table of all topics of results: name, type, the derivative it needs, and how it is made.

Node, replay and simulate publish the rows of this table. A topic that nobody reads is not made.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kinpole_ros.messages._drawing import Trail, centrode, drawing
from kinpole_ros.messages._joints import frames, joint_states
from kinpole_ros.messages._quantities import (
    Build,
    balance_wrench,
    builds_of,
    numbers,
    odometry,
    points_with_covariance,
    vectors,
    with_deviation,
)
from kinpole_ros.messages._state import STATE, state
from kinpole_ros.messages._types import (
    JointState,
    MarkerArray,
    Odometry,
    Path,
    PointCloud2,
    PointStamped,
    PoseWithCovarianceStamped,
    String,
    TFMessage,
    Vector3Stamped,
    WrenchStamped,
)
from kinpole_ros.messages._view import VIEW, VIEW_INTERVAL, view
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

DRAWING = 'visualization'
"""The topic of the drawing for RViz and Foxglove."""
TF = '/tf'
"""The topic of frames, the same for all nodes."""


class Output(NamedTuple):
    """
    One topic, under the node's name unless it begins with a slash.

    `order` is the highest derivative it needs. `build` makes the messages of an estimate: indices
    of instants, in order, and a serialized message for each. An instant at which nothing is
    determined, or no drawing is due, has none. `interval`, s of wall time, is the least time
    between messages for a display; 0: every frame.
    """

    topic: str
    message_type: type
    order: int
    build: Build
    interval: float = 0.0

    def under(self, node: str) -> str:
        """Return the full name of the topic of a node of this name."""
        return self.topic if self.topic.startswith('/') else f'{node}/{self.topic}'


class _Table:
    """The rows of the table so far."""

    def __init__(self) -> None:
        self.rows: list[Output] = []

    def add(self, topic: str, kind: type, order: int, build: Build) -> None:
        self.rows.append(Output(topic, kind, order, build))

    def add_with_deviation(
        self, topic: str, kind: type, order: int, builds: tuple[list[Build], list[Build]], k: int
    ) -> None:
        """Add a topic and the topic of its standard deviation."""
        for suffix, build in zip(('', '/deviation'), builds, strict=True):
            self.add(f'{topic}{suffix}', kind, order, build[k])


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
    Return all topics of results for these bodies.

    Parameters
    ----------
    bodies : sequence of str
        Names of the bodies.
    plane : str or tuple
        The parameter `plane`, for estimates without a plane.
    theory : Theory, optional
        The theory of a scene. With its loads there is the topic `balance`, with its points those of
        points.
    joints : mapping, optional
        By name of a joint its two bodies, or `ground` and a body.
    frame_prefix : str
        Precedes the name of a body in the name of its frame.
    highest : int
        Highest derivative: topics that need more are left out.
    joint_state_rate : float
        Hz by the stamps; 0: joint states at each instant.

    Returns
    -------
    list of Output
        The topics.
    """
    given = plane_of(plane) or XY
    frame_names = [frame_prefix + body for body in bodies]
    table = _Table()
    trails = [Trail() for _ in bodies]
    _add_bodies(table, bodies, frame_names, given, trails)
    _add_pairs(table, bodies, given)
    if theory is not None:
        _add_points(table, bodies, theory, given)
    table.add(STATE, PointCloud2, highest, state(given, highest))
    table.add(DRAWING, MarkerArray, highest, drawing(tuple(bodies), given, trails, highest))
    if joints:
        order = min(2, highest) if joint_state_rate else 1
        states = [[joint_states(joints, bodies, joint_state_rate, of)] for of in (False, True)]
        table.add_with_deviation('joint_states', JointState, order, (states[0], states[1]), 0)
    if theory is not None and theory.balances:
        builds = with_deviation(1, partial(balance_wrench, theory, given))
        table.add_with_deviation('balance', WrenchStamped, 1, builds, 0)
    table.add(TF, TFMessage, 1, frames(frame_names, given))
    return [output for output in table.rows if output.order <= highest]


def _add_bodies(
    table: _Table,
    bodies: Sequence[str],
    frame_names: Sequence[str],
    given: Plane,
    trails: list[Trail],
) -> None:
    count = len(bodies)
    odometries = builds_of(count, odometry(given), frame_names)
    rates = [with_deviation(count, partial(numbers, _rate(n), given)) for n in range(1, 5)]
    points = [builds_of(count, vectors(_pole(n), given, np.arange(count))) for n in range(1, 5)]
    poses = [builds_of(count, points_with_covariance(_pole(n), given)) for n in range(1, 5)]
    velocity = with_deviation(count, partial(vectors, lambda e: e.icr_velocity, given, None))
    curvature = with_deviation(count, partial(numbers, lambda e: e.centrode_curvature, given))
    for b, body in enumerate(bodies):
        table.add(f'{body}/odom', Odometry, 1, odometries[b])
        for order, name in enumerate(RATE_NAMES, 1):
            topic = f'{body}/{name}'
            table.add_with_deviation(topic, Vector3Stamped, order, rates[order - 1], b)
        for order, name in enumerate(POLE_NAMES, 1):
            topic = f'{body}/{name}'
            table.add(topic, PointStamped, order, points[order - 1][b])
            pose = poses[order - 1][b]
            table.add(f'{topic}/with_covariance', PoseWithCovarianceStamped, order, pose)
        table.add_with_deviation(f'{body}/icr_velocity', Vector3Stamped, 2, velocity, b)
        table.add_with_deviation(f'{body}/centrode_curvature', Vector3Stamped, 3, curvature, b)
        for name, frame in (('fixed', None), ('moving', frame_names[b])):
            locus = centrode(b, given, trails[b], frame)
            table.add(f'{body}/centrode/{name}', Path, 1, locus)


def _add_pairs(table: _Table, bodies: Sequence[str], given: Plane) -> None:
    pairs = measured_pairs(len(bodies))
    firsts = np.array([i for i, _ in pairs], int)
    center = partial(vectors, lambda e: e.relative_icr, given, firsts)
    centers = with_deviation(len(pairs), center)
    rates = with_deviation(len(pairs), partial(numbers, lambda e: e.relative_rate, given))
    for k, (i, j) in enumerate(pairs):
        name = f'{bodies[j]}/wrt/{bodies[i]}'
        table.add_with_deviation(f'{name}/icr', PointStamped, 1, centers, k)
        table.add_with_deviation(f'{name}/angular_velocity', Vector3Stamped, 1, rates, k)


def _add_points(table: _Table, bodies: Sequence[str], theory: 'Theory', given: Plane) -> None:
    """Add the points of interest of the scene and their motion."""
    from kinpole_ros.linkage.theory import measured_point, points_of_interest

    for point in points_of_interest(theory):
        body = np.array([bodies.index(point.body)])
        for order, name in enumerate(('', '/velocity', '/acceleration', '/jerk')):
            kind, heights = (Vector3Stamped, None) if order else (PointStamped, body)
            motion = partial(_as_column, partial(measured_point, theory, point, order))
            builds = with_deviation(1, partial(vectors, motion, given, heights))
            topic = f'{point.body}/points/{point.name}{name}'
            table.add_with_deviation(topic, kind, max(order, 1), builds, 0)


def _as_column(motion: Callable[[Estimate], Vectors], estimate: Estimate) -> Vectors:
    """The motion (T,) of one point as an array (T, 1) of points."""
    return Vectors(*(part[:, None] for part in motion(estimate)))


def _rate(order: int) -> Callable[[Estimate], Numbers]:
    return lambda estimate: estimate.rate(order)


def _pole(order: int) -> Callable[[Estimate], Vectors]:
    return lambda estimate: estimate.pole(order)


def theory_of(settings: Settings) -> 'Theory | None':
    """
    Load the theory of the scene that the parameters name.

    `linkage` and `mechanism` are imported only here, with a scene: they take as long as the rest of
    the start of a node.

    Parameters
    ----------
    settings : Settings
        The parameters.

    Returns
    -------
    Theory or None
        The theory; None without a scene.

    Raises
    ------
    ParameterError
        Where the scene cannot be used, or does not go with the bodies.
    """
    if not settings.scene:
        return None
    from kinpole_ros.linkage.theory import load_theory

    return load_theory(settings)


def outputs_of(settings: Settings, theory: 'Theory | None') -> list[Output]:
    """
    Return all topics of results with these parameters.

    Parameters
    ----------
    settings : Settings
        The parameters.
    theory : Theory or None
        The theory of their scene.

    Returns
    -------
    list of Output
        The topics.
    """
    return result_outputs(
        tuple(settings.bodies),
        settings.plane,
        theory,
        settings.joints,
        settings.frame_prefix,
        settings.derivative_order or 4,
        settings.joint_state_rate,
    )


def live_outputs(settings: Settings, theory: 'Theory | None') -> list[Output]:
    """
    Return all topics of a live node: those of results, and that of live pages.

    Parameters
    ----------
    settings : Settings
        The parameters.
    theory : Theory or None
        The theory of their scene.

    Returns
    -------
    list of Output
        The topics.
    """
    build = view(plane_of(settings.plane) or XY)
    page = Output(VIEW, String, settings.derivative_order or 4, build, VIEW_INTERVAL)
    return [*outputs_of(settings, theory), page]
