"""
The table of all topics of results: name, type, the derivative it needs, and how it is made.

Node, replay and simulate publish the rows of this table. A topic that nobody reads is not made.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from kinpole_ros.messages._drawing import Trail, centrode, drawing
from kinpole_ros.messages._events import events
from kinpole_ros.messages._joints import joint_states
from kinpole_ros.messages._rows import (
    FRAME,
    NORMAL,
    ODOMETRY,
    POINT,
    POSE,
    RATE,
    RELATIVE_CENTER,
    RELATIVE_RATE,
    VECTOR,
    Build,
    Row,
    Rows,
    balance_rows,
    stamped,
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
from kinpole_ros.messages._view import VIEW, VIEW_INTERVAL, view_builder
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.plane import XY, Plane, PlaneSetting, plane_of
from kinpole_ros.tracking.quantities import CURVATURE, VELOCITY
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES, measured_pairs

if TYPE_CHECKING:
    from kinpole_ros.linkage.theory import Theory

DRAWING = 'visualization'
"""The topic of the drawing for RViz and Foxglove."""
TF = '/tf'
"""The topic of frames, the same for all nodes."""
# Of the names of topics, and whether such a topic has standard deviations.
_SUFFIXES = ('', False), ('/deviation', True)


class Output(NamedTuple):
    """
    One topic, under the node's name unless it begins with a slash.

    `order` is the highest derivative it needs. `build` makes the messages of an estimate: indices
    of instants, in order, and a serialized message for each. An instant at which nothing is
    determined, or no drawing is due, has none. `interval`, s of wall time, is the least time
    between messages for a display; 0: every frame. Events are searched for only if a topic needs
    them: `of_events`.
    """

    topic: str
    message_type: type
    order: int
    build: Build
    interval: float = 0.0
    of_events: bool = False

    def under(self, node: str) -> str:
        """Return the full name of the topic of a node of this name."""
        return self.topic if self.topic.startswith('/') else f'{node}/{self.topic}'


def joint_build(
    outputs: Sequence[Output],
) -> Callable[[Estimate], list[tuple[int, bytes]]]:
    """
    Return a function that makes the messages of several topics.

    Parameters
    ----------
    outputs : sequence of Output
        The topics. One call of compiled code makes the messages of all those that it can.

    Returns
    -------
    callable
        Of an estimate; returns messages, each with the index of its topic.
    """
    builds = [(k, output.build) for k, output in enumerate(outputs)]
    compiled = [(k, build) for k, build in builds if isinstance(build, Rows)]
    others = [(k, build) for k, build in builds if not isinstance(build, Rows)]
    topics = [k for k, rows in compiled for _ in rows.rows]
    given = compiled[0][1].given if compiled else XY
    all_rows = Rows([row for _, rows in compiled for row in rows.rows], given)

    def build_all(estimate: Estimate) -> list[tuple[int, bytes]]:
        messages = [(topics[row], data) for row, data in all_rows.messages(estimate)]
        messages += [(k, data) for k, build in others for data in build(estimate)[1]]
        return messages

    return build_all


class _Table:
    """The rows of the table so far."""

    def __init__(self, given: Plane) -> None:
        self.given = given
        self.rows: list[Output] = []

    def add(self, topic: str, kind: type, order: int, build: Build) -> None:
        self.rows.append(Output(topic, kind, order, build))

    def add_row(self, topic: str, kind: type, row: Row) -> None:
        self.add(topic, kind, row.order, Rows([row], self.given))

    def add_with_deviation(self, topic: str, kind: type, row: Row) -> None:
        """Add a topic and the topic of its standard deviation."""
        self.add_row(topic, kind, row)
        self.add_row(f'{topic}/deviation', kind, row._replace(is_deviation=True))


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
    table = _Table(given)
    trails = [Trail() for _ in bodies]
    for b in range(len(bodies)):
        _add_body(table, bodies[b], b, frame_names[b], trails[b])
    _add_pairs(table, bodies)
    if theory is not None:
        _add_points(table, bodies, theory)
    table.add(STATE, PointCloud2, highest, state(given, highest))
    table.add(DRAWING, MarkerArray, highest, drawing(tuple(bodies), given, trails, highest))
    if joints:
        order = min(2, highest) if joint_state_rate else 1
        for suffix, is_deviation in _SUFFIXES:
            build = joint_states(joints, bodies, joint_state_rate, is_deviation)
            table.add(f'joint_states{suffix}', JointState, order, build)
    if theory is not None and theory.balances:
        for (suffix, _), rows in zip(_SUFFIXES, balance_rows(theory, given), strict=True):
            table.add(f'balance{suffix}', WrenchStamped, 1, rows)
    frames = [Row(FRAME, 0, stamped(FRAME, name), 1, b) for b, name in enumerate(frame_names)]
    table.add(TF, TFMessage, 1, Rows(frames, given))
    return [output for output in table.rows if output.order <= highest]


def _add_body(table: _Table, body: str, b: int, frame_name: str, trail: Trail) -> None:
    point, vector = stamped(POINT), stamped(VECTOR)
    table.add_row(f'{body}/odom', Odometry, Row(ODOMETRY, 0, stamped(ODOMETRY, frame_name), 1, b))
    for order, name in enumerate(RATE_NAMES, 1):
        rate = Row(NORMAL, RATE + order, vector, order, b)
        table.add_with_deviation(f'{body}/{name}', Vector3Stamped, rate)
    for order, name in enumerate(POLE_NAMES, 1):
        topic = f'{body}/{name}'
        table.add_row(topic, PointStamped, Row(POINT, order, point, order, b))
        pose = Row(POSE, order, stamped(POSE), order, b)
        table.add_row(f'{topic}/with_covariance', PoseWithCovarianceStamped, pose)
    velocity = Row(VECTOR, VELOCITY, vector, 2, b)
    table.add_with_deviation(f'{body}/icr_velocity', Vector3Stamped, velocity)
    curvature = Row(NORMAL, CURVATURE, vector, 3, b)
    table.add_with_deviation(f'{body}/centrode_curvature', Vector3Stamped, curvature)
    for name, frame in (('fixed', None), ('moving', frame_name)):
        locus = centrode(b, table.given, trail, frame)
        table.add(f'{body}/centrode/{name}', Path, 1, locus)
    event = Output(f'{body}/event', PointCloud2, 1, events(b, table.given), of_events=True)
    table.rows.append(event)


def _add_pairs(table: _Table, bodies: Sequence[str]) -> None:
    for i, j in measured_pairs(len(bodies)):
        name = f'{bodies[j]}/wrt/{bodies[i]}'
        center = Row(POINT, RELATIVE_CENTER, stamped(POINT), 1, i, j)
        table.add_with_deviation(f'{name}/icr', PointStamped, center)
        rate = Row(NORMAL, RELATIVE_RATE, stamped(NORMAL), 1, i, j)
        table.add_with_deviation(f'{name}/angular_velocity', Vector3Stamped, rate)


def _add_points(table: _Table, bodies: Sequence[str], theory: 'Theory') -> None:
    """Add the points of interest of the scene and their motion."""
    from kinpole_ros.linkage.theory import measured_point, points_of_interest

    for point in points_of_interest(theory):
        body = bodies.index(point.body)
        for order, name in enumerate(('', '/velocity', '/acceleration', '/jerk')):
            kind, message_type = (VECTOR, Vector3Stamped) if order else (POINT, PointStamped)
            motion = partial(measured_point, theory, point, order)
            row = Row(kind, 0, stamped(kind), max(order, 1), body, values=motion)
            table.add_with_deviation(f'{point.body}/points/{point.name}{name}', message_type, row)


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
        settings.highest_order,
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
    build = view_builder(plane_of(settings.plane) or XY)
    page = Output(VIEW, String, settings.highest_order, build, VIEW_INTERVAL)
    return [*outputs_of(settings, theory), page]
