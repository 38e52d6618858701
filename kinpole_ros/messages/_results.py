"""
The table of all topics of results: a row has name, type, derivative, unit, and how it is made.

Node, replay and simulate publish the rows of this table. A topic that nobody reads is not made.
Other packages register quantities (`Registered`): this one imports none of them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple, Protocol

from kinpole_ros.messages._drawing import Trails, centrode, drawing
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
from kinpole_ros.tracking.quantities import CIRCLE_CENTER, CURVATURE, VELOCITY
from kinpole_ros.tracking.registered import RegisteredQuantity
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES, measured_pairs

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
    between messages for a display; 0: every frame. Events are searched for only if a topic needs
    them: `of_events`. Others than the standard topics exist with `topics: all` only.
    """

    topic: str
    message_type: type
    order: int
    build: Build
    unit: str = ''
    is_standard: bool = True
    interval: float = 0.0
    of_events: bool = False

    def under(self, node: str) -> str:
        """Return the full name of the topic of a node of this name."""
        return self.topic if self.topic.startswith('/') else f'{node}/{self.topic}'


def joint_build(
    outputs: Sequence[Output],
) -> Callable[[Estimate], list[tuple[int, bytes]]]:
    """
    Return a function that makes the messages of several topics of an estimate.

    Each is with the index of its topic. One call of compiled code makes all those that it can.
    """
    builds = [(k, output.build) for k, output in enumerate(outputs)]
    compiled = [(k, build) for k, build in builds if isinstance(build, Rows)]
    others = [
        (k, output.build, output.of_events)
        for k, output in enumerate(outputs)
        if not isinstance(output.build, Rows)
    ]
    topics = [k for k, rows in compiled for _ in rows.rows]
    given = compiled[0][1].given if compiled else XY
    all_rows = Rows([row for _, rows in compiled for row in rows.rows], given)

    def build_all(estimate: Estimate) -> list[tuple[int, bytes]]:
        messages = [(topics[row], data) for row, data in all_rows.messages(estimate)]
        for k, build, of_events in others:
            if not of_events or estimate.events:
                messages += [(k, data) for data in build(estimate)[1]]
        return messages

    return build_all


class Registered(Protocol):
    """What another package adds to the table, as the theory of a scene does."""

    def quantities(self, bodies: Sequence[str]) -> Sequence[RegisteredQuantity]:
        """Return quantities with topics of their own."""

    def connected_bodies(self) -> Sequence[tuple[str, str]]:
        """Return the pairs of bodies that have a joint."""


class _Rig(NamedTuple):
    """The bodies that a table is made for: names, names of their frames, and their poles so far."""

    bodies: Sequence[str]
    frames: Sequence[str]
    trails: Trails
    plane: Plane


class TopicRow(NamedTuple):
    """
    A row of the table: a topic of each body, or of each pair of bodies.

    `make` gets the rig, the order and one or two bodies. A topic with `has_deviation` has one of
    its standard deviation below it.
    """

    name: str
    message_type: type
    order: int
    unit: str
    make: Callable[..., Row | Build]
    is_standard: bool = True
    has_deviation: bool = False
    of_events: bool = False


def _compiled(kind: int, quantity: int) -> Callable[..., Row]:
    """Return what makes the row of a quantity that compiled code computes."""

    def make(_: _Rig, order: int, body: int, other: int = 0) -> Row:
        return Row(kind, quantity, stamped(kind), order, body, other)

    return make


def _odometry(rig: _Rig, order: int, body: int) -> Row:
    return Row(ODOMETRY, 0, stamped(ODOMETRY, rig.frames[body]), order, body)


def _centrode(is_fixed: bool, rig: _Rig, _: int, body: int) -> Build:
    return centrode(body, rig.plane, rig.trails, None if is_fixed else rig.frames[body])


def _events(rig: _Rig, _: int, body: int) -> Build:
    return events(body, rig.plane)


# Standard topics are those of the first derivatives, which people read; `state` has all.
_STANDARD_RATES, _STANDARD_POLES = 3, 2
_RATE_UNITS = ('rad/s', 'rad/s²', 'rad/s³', 'rad/s⁴')
_RATES = (
    TopicRow(name, Vector3Stamped, k, unit, _compiled(NORMAL, RATE + k), k <= _STANDARD_RATES, True)
    for k, (name, unit) in enumerate(zip(RATE_NAMES, _RATE_UNITS, strict=True), 1)
)
_POLES = (
    TopicRow(f'{name}{end}', message_type, k, 'm', _compiled(kind, k), k <= last_standard)
    for k, name in enumerate(POLE_NAMES, 1)
    for end, message_type, kind, last_standard in (
        ('', PointStamped, POINT, 1),
        ('/with_covariance', PoseWithCovarianceStamped, POSE, _STANDARD_POLES),
    )
)
OF_BODY = (
    TopicRow('odom', Odometry, 1, 'm, rad', _odometry),
    *_RATES,
    *_POLES,
    TopicRow('icr_velocity', Vector3Stamped, 2, 'm/s', _compiled(VECTOR, VELOCITY), True, True),
    TopicRow(
        'centrode_curvature', Vector3Stamped, 3, '1/m', _compiled(NORMAL, CURVATURE), True, True
    ),
    TopicRow(
        'inflection_circle', PointStamped, 2, 'm', _compiled(POINT, CIRCLE_CENTER), True, True
    ),
    TopicRow('centrode/fixed', Path, 1, 'm', partial(_centrode, True), is_standard=False),
    TopicRow('centrode/moving', Path, 1, 'm', partial(_centrode, False), is_standard=False),
    TopicRow('event', PointCloud2, 1, '', _events, of_events=True),
)
_OF_PAIR = (
    TopicRow('icr', PointStamped, 1, 'm', _compiled(POINT, RELATIVE_CENTER), True, True),
    TopicRow(
        'angular_velocity', Vector3Stamped, 1, 'rad/s', _compiled(NORMAL, RELATIVE_RATE), True, True
    ),
)
# By the kind of a registered quantity, type and kind of its messages, and how many doubles are 0
# before and after its own: a wrench is a force and then a torque.
_OF_REGISTERED = {
    'point': (PointStamped, POINT, 0, 0),
    'vector': (Vector3Stamped, VECTOR, 0, 0),
    'number': (Vector3Stamped, NORMAL, 0, 0),
    'force': (WrenchStamped, VECTOR, 0, 3),
    'torque': (WrenchStamped, NORMAL, 3, 0),
}


def _registered(quantity: RegisteredQuantity) -> TopicRow:
    """Return the row of a quantity that another package computes."""
    message_type, kind, before, after = _OF_REGISTERED[quantity.kind]
    template = stamped(kind, before=before, after=after)

    def make(_: _Rig, order: int) -> Row:
        return Row(kind, 0, template, order, quantity.body or 0, values=quantity.values)

    about = message_type, quantity.order, quantity.unit, make
    return TopicRow(quantity.topic, *about, has_deviation=True)


def _outputs(
    row: TopicRow, topic: str, rig: _Rig, bodies: tuple[int, ...], is_standard: bool = True
) -> list[Output]:
    """Return the topic of a row, for one or two bodies or none, and that of its deviation."""
    made = row.make(rig, row.order, *bodies)
    builds: list[Build] = [Rows([made], rig.plane) if isinstance(made, Row) else made]
    if row.has_deviation:
        assert isinstance(made, Row)
        builds.append(Rows([made._replace(is_deviation=True)], rig.plane))
    is_standard = is_standard and row.is_standard
    return [
        Output(
            *(f'{topic}{end}', row.message_type, row.order, build, row.unit),
            *(is_standard and not end, 0.0, row.of_events),
        )
        for end, build in zip(('', '/deviation'), builds, strict=False)
    ]


def result_outputs(
    bodies: Sequence[str],
    plane: PlaneSetting,
    registered: Registered | None = None,
    joints: Mapping[str, tuple[str, str]] | None = None,
    frame_prefix: str = '',
    highest: int = 4,
    joint_state_rate: float = 0.0,
) -> list[Output]:
    """
    Return all topics of results for these bodies, also those that are not standard.

    Parameters
    ----------
    bodies : sequence of str
        Names of the bodies.
    plane : str or tuple
        The parameter `plane`, for estimates without a plane.
    registered : Registered, optional
        Quantities of another package, as of the theory of a scene.
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
    given, numbers = plane_of(plane) or XY, range(len(bodies))
    frames = [frame_prefix + body for body in bodies]
    rig = _Rig(bodies, frames, Trails(len(bodies)), given)
    outputs: list[Output] = []
    for b in numbers:
        for row in OF_BODY:
            outputs += _outputs(row, f'{bodies[b]}/{row.name}', rig, (b,))
    connected = [*(joints or {}).values(), *(registered.connected_bodies() if registered else ())]
    outputs += _pair_outputs(rig, connected)
    quantities = registered.quantities(bodies) if registered is not None else ()
    for quantity in quantities:
        outputs += _outputs(_registered(quantity), quantity.topic, rig, ())
    outputs.append(Output(STATE, PointCloud2, highest, state(given, highest, quantities)))
    draw = drawing(tuple(bodies), given, rig.trails, highest)
    outputs.append(Output(DRAWING, MarkerArray, highest, draw))
    if joints:
        order = min(2, highest) if joint_state_rate else 1
        for end in ('', '/deviation'):
            build = joint_states(joints, bodies, joint_state_rate, bool(end))
            topic = f'joint_states{end}'
            outputs.append(Output(topic, JointState, order, build, 'rad, rad/s', not end))
    moving = [Row(FRAME, 0, stamped(FRAME, frames[b]), 1, b) for b in numbers]
    outputs.append(Output(TF, TFMessage, 1, Rows(moving, given)))
    return [output for output in outputs if output.order <= highest]


def _pair_outputs(rig: _Rig, connected: Sequence[tuple[str, str]]) -> Iterator[Output]:
    """Yield the topics of pairs of bodies; those of `connected` ones are standard."""
    names, pairs = rig.bodies, {*map(frozenset, connected)}
    for i, j in measured_pairs(len(names)):
        is_connected = frozenset((names[i], names[j])) in pairs
        for row in _OF_PAIR:
            topic = f'{names[j]}/wrt/{names[i]}/{row.name}'
            yield from _outputs(row, topic, rig, (i, j), is_connected)


def outputs_of(settings: Settings, registered: Registered | None) -> list[Output]:
    """Return the topics of results; the parameter `topics` chooses the standard ones or all."""
    outputs = result_outputs(
        tuple(settings.bodies),
        settings.plane,
        registered,
        settings.joints,
        settings.frame_prefix,
        settings.highest_order,
        settings.joint_state_rate,
    )
    return [output for output in outputs if output.is_standard or settings.topics == 'all']


def live_outputs(settings: Settings, registered: Registered | None) -> list[Output]:
    """Return the topics of a live node: those of results, and that of live pages."""
    build = view_builder(plane_of(settings.plane) or XY)
    page = Output(VIEW, String, settings.highest_order, build, interval=VIEW_INTERVAL)
    return [*outputs_of(settings, registered), page]
