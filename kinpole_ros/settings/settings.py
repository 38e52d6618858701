"""
The parameters, each a field declared once: default, range, unit, meaning and when it can be set.

The node declares them and replay reads the same ROS 2 parameter file, so both accept and refuse
the same things in the same words.
"""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

from kinpole_ros.files import cut
from kinpole_ros.settings import kinds
from kinpole_ros.settings.kinds import Kind, ParameterError, PlaneSetting
from kinpole_ros.settings.message_types import MESSAGE_TYPES

# m, complex, of the points that stand for such a pose, in its frame. Figures do not depend on them;
# drawings show them. Their mean is the origin, so that it is not rounded by how the body is turned.
POSE_POINTS = (0.1 + 0j, 0.1j, -0.1 - 0.1j)
# The name of the ground in a joint.
GROUND = 'ground'
# When a parameter can be set.
START = 'at the start only'
INACTIVE = 'at the start and while the node is inactive'
RUNNING = 'while the node runs'


@dataclass(frozen=True)
class Parameter:
    """One parameter: default as in ROS, kind of values, what it means, and when it can be set."""

    default: Any
    kind: Kind
    description: str
    settable: str = RUNNING


def parameter(default: Any, kind: Kind, description: str, settable: str = RUNNING) -> Any:
    """Return a field of Settings that is a parameter; one of names maps each to nothing."""
    metadata = {'row': Parameter(default, kind, description, settable)}
    value = kind.convert(default)
    if isinstance(value, tuple):
        return field(default_factory=lambda: dict.fromkeys(value, ()), metadata=metadata)
    return field(default=value, metadata=metadata)


@dataclass(frozen=True)
class Settings:
    """Parameters as the pipeline uses them. `bodies` maps a name to its markers, () for all."""

    marker_topic: str = parameter(
        'markers',
        kinds.TOPIC,
        'Topic of the markers.',
        START,
    )
    marker_type: str = parameter(
        'auto',
        kinds.one_of('auto', *MESSAGE_TYPES),
        'Type of the marker messages; auto takes the type that is published. pose_stamped, '
        'body_poses (a PoseArray with one pose per body), tf, rigid_bodies, named_poses and those '
        'of aruco carry poses of bodies instead of markers: <body>.markers then names one pose, by '
        'its index, child_frame_id, name or number.',
        START,
    )
    marker_identity: str = parameter(
        'auto',
        kinds.one_of('auto', 'index', 'id', 'ns', 'ns_id', 'shape'),
        'How markers are identified: by their index in the message, id, namespace, or both; auto '
        'takes namespace and id if there are any, and the index otherwise. shape: by their places '
        'on the bodies, for points in random order.',
    )
    plane: PlaneSetting = parameter(  # noqa: RUF009
        'xy',
        kinds.PLANE,
        'Plane of the motion in the frame of the markers: its name (xz is zx), its normal '
        '[x, y, z] of any length, or fit to find it from the motion.',
    )
    scale: float = parameter(
        1.0,
        kinds.number(1e-9, 1e9, 'm'),
        'Length of one unit of the markers: 0.001 for markers in mm.',
    )
    bodies: Mapping[str, tuple[str, ...]] = parameter(
        ['body'],
        kinds.identifiers(fewest=1),
        'Names of the bodies. Each has a parameter <body>.markers.',
        INACTIVE,
    )
    window: float = parameter(
        0.3, kinds.number(1e-6, 3600.0, 's'), 'Length of past data that results are computed from.'
    )
    lag: float = parameter(
        0.1,
        kinds.number(0.0, 3600.0, 's'),
        'Delay of the output behind the newest sample. Half a window gives the most accurate '
        'derivatives.',
    )
    derivative_order: int | None = parameter(
        'auto', kinds.ORDER, 'Highest derivative computed; auto: as the subscribed topics need.'
    )
    noise: float = parameter(
        0.0, kinds.number(0.0, 1e6, 'm'), 'Standard deviation of the markers per axis; 0: measured.'
    )
    stamps: str = parameter(
        'auto',
        kinds.one_of('auto', 'capture', 'arrival'),
        'Meaning of header stamps: the time of capture, or of arrival. Arrival is late by a random '
        'time, and the even clock of the camera is estimated. auto: decided by stamps and motion.',
    )
    scene: str = parameter(
        '',
        kinds.text('(?s).*', 'the name of a scene, such as four_bar, or the path of one'),
        'Scene of the mechanism, by name or path. Diagnostics then report the deviation of the '
        'bodies from it, and ~/balance the effort that balances its loads. Empty: none.',
        # Other machines on the network must not choose files of this one.
        START,
    )
    # By name, of the second body, or the ground, against the first.
    joints: Mapping[str, tuple[str, str]] = parameter(
        [],
        kinds.identifiers(),
        'Names of the joints on ~/joint_states. Each has a parameter <joint>.bodies.',
        INACTIVE,
    )
    joint_state_rate: float = parameter(
        0.0,
        kinds.number(0.0, 1000.0, 'Hz'),
        'Rate of ~/joint_states: at multiples of its period, extrapolated from the nearest '
        'instant; 0: at each instant.',
    )
    topics: str = parameter(
        'standard',
        kinds.one_of('standard', 'all'),
        'Topics of results: standard are those that people read, and state with all numbers; all '
        'adds a topic for each other number, each standard deviation, path and pair of bodies.',
    )
    publish_tf: bool = parameter(
        False, kinds.FLAG, 'Whether the frames of the bodies are published on /tf; needs tf2_msgs.'
    )
    frame_prefix: str = parameter(
        '',
        kinds.text(r'[\w/.-]*', 'letters, digits and any of _ / . -'),
        'Prefix of the frame names of the bodies, such as rig1/.',
    )
    # Of the bodies that have one given: places of their markers, complex, m.
    shapes: Mapping[str, tuple[complex, ...]] = field(default_factory=dict)
    # Of the bodies that have one given: the pin on the ground, in the frame of the shape and in the
    # plane, complex, m.
    pins: Mapping[str, tuple[complex, ...]] = field(default_factory=dict)

    @property
    def highest_order(self) -> int:
        """The highest derivative of all results, also of those that no live topic asks for."""
        return self.derivative_order or 4

    def of_recording(self) -> 'Settings':
        """Return these for a recording known as a whole: a default lag becomes half a window."""
        is_default = self.lag == PARAMETERS['lag'].default
        return replace(self, lag=self.window / 2) if is_default else self

    @cached_property
    def window_ns(self) -> int:
        """The window in ns."""
        return round(self.window * 1e9)


PARAMETERS: Mapping[str, Parameter] = {
    one.name: one.metadata['row'] for one in fields(Settings) if one.metadata
}
# Parameters that each body and each joint has, which are in the mappings of `Settings`.
OWN_PARAMETERS = {
    '<body>.markers': Parameter(
        [],
        kinds.MARKERS,
        'Identities of the markers on this body; empty, if it is the only one: all markers.',
        INACTIVE,
    ),
    '<body>.shape': Parameter(
        [],
        kinds.SHAPE,
        'Places of the markers on this body: x and y of each in a frame of the body, in the order '
        'of <body>.markers if that is given. Empty: learned.',
        INACTIVE,
    ),
    '<body>.pin': Parameter(
        [],
        kinds.PIN,
        'Pin between this body and the ground: its x and y in the frame of <body>.shape, then in '
        'the plane. It distinguishes bodies of the same shape. Empty: not known.',
        INACTIVE,
    ),
    '<joint>.bodies': Parameter(
        [],
        kinds.PAIR,
        'The two bodies of this joint, or ground and a body: the motion is that of the second '
        'relative to the first.',
        INACTIVE,
    ),
}
# Parameters of the node only, which are not in `Settings`.
NODE_PARAMETERS = {
    'autostart': Parameter(
        True, kinds.FLAG, 'Whether the node configures and activates itself.', START
    ),
    'executor': Parameter(
        'lean',
        kinds.one_of('lean', 'rclpy'),
        'What waits for messages and runs callbacks: lean, which takes less CPU time, or the '
        'executor of rclpy.',
        START,
    ),
    'diagnostics_interval': Parameter(
        1.0, kinds.number(0.05, 3600.0, 's'), 'Time between messages on /diagnostics.', START
    ),
}


def own_parameters(bodies: Iterable[str], joints: Iterable[str]) -> dict[str, Parameter]:
    """The rows of the parameters that each body and each joint has."""
    return {
        name.replace(placeholder, owner): row
        for placeholder, owners in (('<body>', bodies), ('<joint>', joints))
        for owner in owners
        for name, row in OWN_PARAMETERS.items()
        if name.startswith(placeholder)
    }


def own_name(name: str) -> str:
    """The name in `OWN_PARAMETERS` of a parameter of any body or joint; '' for another."""
    return next((own for own in OWN_PARAMETERS if name.endswith(own.partition('>')[2])), '')


def check_value(name: str, row: Parameter, values: Mapping[str, Any]) -> Any:
    """The value of one parameter, or its default, as Settings have it; raises ParameterError."""
    value = values.get(name, row.default)
    with suppress(TypeError, ValueError, OverflowError):
        if row.kind.is_right(value):
            return row.kind.convert(value)
    raise ParameterError(f'parameter {name} is {cut(repr(value))}; it must be {row.kind.allowed}')
