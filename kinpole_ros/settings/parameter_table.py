"""
The parameters, once: names, defaults, ranges and what they mean.

The node declares them and replay reads the same ROS 2 parameter file, so both accept and refuse
the same things in the same words.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from kinpole_ros.files import cut
from kinpole_ros.settings.settings import (
    AXES,
    FIT,
    POSE_TYPES,
    ParameterError,
    PlaneSetting,
    canonical_name,
)


@dataclass(frozen=True)
class Parameter:
    """One row of the table: default, what it means, how a value is checked, and its range."""

    default: Any
    description: str
    check: Callable[[Any], Any]
    allowed: str
    lowest: float | None = None
    highest: float | None = None
    fixed: bool = False


# As ROS 2 has it: names of letters, digits and _ between slashes.
_TOPIC = re.compile(r'(~/|/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*', re.ASCII)


def _topic(value: Any) -> str:
    if not isinstance(value, str) or not _TOPIC.fullmatch(value):
        raise ValueError
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError
    return value


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError
    return value


def _one_of(*names: str) -> Callable[[Any], str]:
    def check(value: Any) -> str:
        if value not in names:
            raise ValueError
        return str(value)

    return check


def _number(lowest: float, highest: float) -> Callable[[Any], float]:
    def check(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError
        if not (math.isfinite(value) and lowest <= value <= highest):
            raise ValueError
        return float(value)

    return check


def _plane(value: Any) -> PlaneSetting:
    if isinstance(value, str):
        return _one_of(*AXES, FIT)(canonical_name(value))
    number = _number(-1e300, 1e300)
    x, y, z = (number(component) for component in value)
    if not (x or y or z):
        raise ValueError
    return x, y, z


def _order(value: Any) -> int | None:
    if value == 'auto':
        return None
    if isinstance(value, str) and value.isdigit():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 4:
        raise ValueError
    return value


def _names(value: Any) -> tuple[str, ...]:
    if isinstance(value, str) or any(not isinstance(name, str) or not name for name in value):
        raise ValueError
    if len(set(value)) != len(value):
        raise ValueError
    return tuple(value)


def _identifiers(value: Any) -> tuple[str, ...]:
    names = _names(value)
    if not all(
        name.isascii() and name.replace('_', 'a').isalnum() and not name[0].isdigit()
        for name in names
    ):
        raise ValueError
    return names


def _body_names(value: Any) -> tuple[str, ...]:
    names = _identifiers(value)
    if not names:
        raise ValueError
    return names


def _pair(value: Any) -> tuple[str, str]:
    first, second = _names(value)
    return first, second


def _prefix(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(r'[\w/.-]*', value):
        raise ValueError
    return value


def _shape(value: Any) -> tuple[complex, ...]:
    if isinstance(value, str) or len(value) % 2:
        raise ValueError
    numbers = [_number(-1e6, 1e6)(number) for number in value]
    shape = tuple(map(complex, numbers[::2], numbers[1::2]))
    if shape and len(set(shape)) < max(2, len(shape)):
        raise ValueError
    return shape


def _pin(value: Any) -> tuple[complex, ...]:
    if isinstance(value, str) or len(value) not in (0, 4):
        raise ValueError
    numbers = [_number(-1e6, 1e6)(number) for number in value]
    return tuple(map(complex, numbers[::2], numbers[1::2]))


def _choices(default: str, description: str, *names: str, fixed: bool = False) -> Parameter:
    return Parameter(
        default, description, _one_of(*names), 'one of ' + ', '.join(names), fixed=fixed
    )


def _range(default: float, description: str, lowest: float, highest: float, unit: str) -> Parameter:
    check = _number(lowest, highest)
    allowed = f'a number from {lowest:g} to {highest:g} {unit}'
    return Parameter(default, description, check, allowed, lowest, highest)


PARAMETERS: Mapping[str, Parameter] = {
    'marker_topic': Parameter(
        'markers',
        'Topic of the markers.',
        _topic,
        'the name of a topic, such as markers or /rig/markers',
        fixed=True,
    ),
    'marker_type': _choices(
        'auto',
        'Type of the marker messages; auto takes the type that is published. pose_stamped, '
        'body_poses (a PoseArray with one pose per body) and tf carry poses of bodies instead of '
        'markers: <body>.markers then names one pose, by its index or its child_frame_id.',
        'auto',
        'marker_array',
        'marker',
        'pose_array',
        'point_cloud2',
        *POSE_TYPES,
        fixed=True,
    ),
    'marker_identity': _choices(
        'auto',
        'How markers are identified: by their index in the message, id, namespace, or both; auto '
        'takes namespace and id if there are any, and the index otherwise. shape: by their places '
        'on the bodies, for points in random order.',
        'auto',
        'index',
        'id',
        'ns',
        'ns_id',
        'shape',
    ),
    'plane': Parameter(
        'xy',
        'Plane of the motion in the frame of the markers: its name (xz is zx), its normal '
        '[x, y, z] of any length, or fit to find it from the motion.',
        _plane,
        'one of xy, yz, zx, fit, or a normal [x, y, z] of three numbers, not all 0',
    ),
    'scale': _range(
        1.0,
        'Length of one unit of the markers: 0.001 for markers in mm.',
        1e-9,
        1e9,
        'm',
    ),
    'bodies': Parameter(
        ['body'],
        'Names of the bodies. Each has a parameter <body>.markers.',
        _body_names,
        'a list of different names of letters, digits and _',
    ),
    'window': _range(0.3, 'Length of past data that results are computed from.', 1e-6, 60.0, 's'),
    'lag': _range(
        0.1,
        'Delay of the output behind the newest sample. Half a window gives the most accurate '
        'derivatives.',
        0.0,
        3600.0,
        's',
    ),
    'derivative_order': Parameter(
        'auto',
        'Highest derivative computed; auto: as the subscribed topics need.',
        _order,
        'auto, 1, 2, 3 or 4',
    ),
    'noise': _range(0.0, 'Standard deviation of the markers per axis; 0: measured.', 0.0, 1e6, 'm'),
    'stamps': _choices(
        'auto',
        'Meaning of header stamps: the time of capture, or of arrival. Arrival is late by a random '
        'time, and the even clock of the camera is estimated. auto: decided by stamps and motion.',
        'auto',
        'capture',
        'arrival',
    ),
    'effort': _choices(
        'normal',
        'Makes no difference any more: events are searched for wherever the evidence asks for it.',
        'low',
        'normal',
        'high',
    ),
    'method': _choices(
        'pose',
        'Makes no difference any more: what is differentiated is the pose fitted to each frame.',
        'pose',
        'landmarks',
    ),
    'scene': Parameter(
        '',
        'Scene of the mechanism, by name or path. Diagnostics then report the deviation of the '
        'bodies from it, and ~/balance the effort that balances its loads. Empty: none.',
        _text,
        'the name of a scene, such as four_bar, or the path of one',
        # Other machines on the network must not choose files of this one.
        fixed=True,
    ),
    'joints': Parameter(
        [],
        'Names of the joints on ~/joint_states. Each has a parameter <joint>.bodies.',
        _identifiers,
        'a list of different names of letters, digits and _',
    ),
    'joint_state_rate': _range(
        0.0,
        'Rate of ~/joint_states: at multiples of its period, extrapolated from the nearest '
        'instant; 0: at each instant.',
        0.0,
        1000.0,
        'Hz',
    ),
    'publish_tf': Parameter(
        False,
        'Whether the frames of the bodies are published on /tf; needs tf2_msgs.',
        _flag,
        'true or false',
    ),
    'frame_prefix': Parameter(
        '',
        'Prefix of the frame names of the bodies, such as rig1/.',
        _prefix,
        'letters, digits and any of _ / . -',
    ),
}
JOINT_BODIES = Parameter(
    [],
    'The two bodies of this joint, or ground and a body: the motion is that of the second relative '
    'to the first.',
    _pair,
    "two different names of bodies, or 'ground' and one, such as ['crank', 'coupler']",
)
MARKERS = Parameter(
    [],
    'Identities of the markers on this body; empty, if it is the only one: all markers.',
    _names,
    "a list of different marker identities, as text, such as ['0', '1', '2']",
)
SHAPE = Parameter(
    [],
    'Places of the markers on this body: x and y of each in a frame of the body, in the order of '
    '<body>.markers if that is given. Empty: learned.',
    _shape,
    'a flat list of x, y of two or more markers at different places, m, such as '
    '[0.0, 0.0, 0.1, 0.0, 0.05, 0.08]',
)
PIN = Parameter(
    [],
    'Pin between this body and the ground: its x and y in the frame of <body>.shape, then in '
    'the plane. It distinguishes bodies of the same shape. Empty: not known.',
    _pin,
    'a flat list of four numbers, m, such as [0.0, 0.0, 0.3, 0.1]',
)
# Parameters of the node only, which are not in `Settings`.
NODE_PARAMETERS = {
    'autostart': Parameter(
        True,
        'Whether the node configures and activates itself.',
        _flag,
        'true or false',
        fixed=True,
    ),
    'executor': _choices(
        'lean',
        'What waits for messages and runs callbacks: lean, which takes less CPU time, or the '
        'executor of rclpy.',
        'lean',
        'rclpy',
        fixed=True,
    ),
}
# Parameters that no user needs: accepted with a warning, and the reason.
DEPRECATED = {
    'effort': 'it makes no difference',
    'method': 'it makes no difference',
}
# The name of the ground in a joint.


def own_parameters(bodies: Iterable[str], joints: Iterable[str]) -> dict[str, Parameter]:
    """The rows of the parameters that each body and each joint has."""
    rows = {'markers': MARKERS, 'shape': SHAPE, 'pin': PIN}
    own = {f'{body}.{name}': row for body in bodies for name, row in rows.items()}
    return own | {f'{joint}.bodies': JOINT_BODIES for joint in joints}


def check_value(name: str, row: Parameter, values: Mapping[str, Any]) -> Any:
    """The value of one parameter, or its default, as Settings have it; raises ParameterError."""
    value = values.get(name, row.default)
    try:
        return row.check(value)
    except (TypeError, ValueError, OverflowError):
        shown = cut(repr(value))
        raise ParameterError(f'parameter {name} is {shown}; it must be {row.allowed}') from None


def is_of_bodies(name: str) -> bool:
    """Whether a parameter says which bodies and joints there are, or of which markers."""
    return name in ('bodies', 'joints') or name.endswith(('.markers', '.shape', '.pin', '.bodies'))
