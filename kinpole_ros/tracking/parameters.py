"""
The parameters, once: names, defaults, ranges and what they mean.

The node declares them and replay reads the same ROS 2 parameter file, so both accept and refuse
the same things in the same words.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from kinpole_ros.files import cut, cut_line, read_limited
from kinpole_ros.files.bounded_yaml import MOST_YAML, load_yaml
from kinpole_ros.tracking._ros_yaml import RosLoader
from kinpole_ros.tracking.plane import AXES, FIT, PlaneSetting, canonical_name

# Of the types of messages, those that carry poses of bodies and not markers.
POSE_TYPES = ('pose_stamped', 'body_poses', 'tf')
# m, complex, of the points that stand for such a pose, in its frame. Figures do not depend on them;
# drawings show them. Their mean is the origin, so that it is not rounded by how the body is turned.
POSE_POINTS = (0.1 + 0j, 0.1j, -0.1 - 0.1j)


class ParameterError(ValueError):
    """A parameter that is unknown, or whose value cannot be used; the message has the fix."""


@dataclass(frozen=True)
class Settings:
    """Parameters as the pipeline uses them. `bodies` maps a name to its markers, () for all."""

    marker_topic: str = 'markers'
    marker_type: str = 'auto'
    marker_identity: str = 'auto'
    plane: PlaneSetting = 'xy'
    scale: float = 1.0
    bodies: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {'body': ()})
    window: float = 0.3
    lag: float = 0.1
    derivative_order: int | None = None
    noise: float = 0.0
    stamps: str = 'auto'
    effort: str = 'normal'
    method: str = 'pose'
    scene: str = ''
    # By name, of the second body, or the ground, against the first.
    joints: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    joint_state_rate: float = 0.0
    publish_tf: bool = False
    frame_prefix: str = ''
    # Of the bodies that have one given: places of their markers, complex, m.
    shapes: Mapping[str, tuple[complex, ...]] = field(default_factory=dict)
    # Of the bodies that have one given: the pin on the ground, in the frame of the shape and in the
    # plane, complex, m.
    pins: Mapping[str, tuple[complex, ...]] = field(default_factory=dict)

    @property
    def highest_order(self) -> int:
        """The highest derivative of all results, also of those that no live topic asks for."""
        return self.derivative_order or 4

    @cached_property
    def window_ns(self) -> int:
        """The window in ns."""
        return round(self.window * 1e9)


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
GROUND = 'ground'
# Raised for malformed YAML; PyYAML lets some errors of Python through.
_MALFORMED = (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError)
# Parameters of ROS and of the node in the same file.
_NODE_ONLY = ('use_sim_time', 'start_type_description_service', *NODE_PARAMETERS)


def settings_from(values: Mapping[str, Any]) -> Settings:
    """
    Check parameters given by their ROS names, 'lag' or 'coupler.markers', and fill in the rest.

    Raises ParameterError for a name that is not known, for a value out of its range, and for values
    that contradict each other.
    """
    known = known_rows(values)
    names, joints = (tuple(values.get(name, known[name].default)) for name in ('bodies', 'joints'))
    for name, row in NODE_PARAMETERS.items():
        check_value(name, row, values)
    checked = {name: check_value(name, row, values) for name, row in known.items()}
    bodies = {name: checked.pop(f'{name}.markers') for name in names}
    checked['bodies'] = bodies
    shapes = {name: checked.pop(f'{name}.shape') for name in names}
    checked['shapes'] = shapes = {name: shape for name, shape in shapes.items() if shape}
    pins = {name: checked.pop(f'{name}.pin') for name in names}
    checked['pins'] = pins = {name: pin for name, pin in pins.items() if pin}
    if without := next((name for name in pins if name not in shapes), None):
        raise ParameterError(
            f'parameter {without}.pin is in the frame of {without}.shape, which is missing: give '
            'both, as kinpole discover finds them'
        )
    checked['joints'] = {name: checked.pop(f'{name}.bodies') for name in joints}
    for name, pair in checked['joints'].items():
        if unknown := set(pair) - {*names, GROUND}:
            raise ParameterError(
                f'parameter {name}.bodies names {cut(", ".join(sorted(unknown)))}; a joint is '
                f'between two of {", ".join(names)} and {GROUND}'
            )
    if checked['marker_type'] in POSE_TYPES:
        settings = Settings(**checked)
        check_poses(settings, settings.marker_type)
        return _consistent(settings)
    _check_markers(Settings(**checked))
    return _consistent(Settings(**checked))


def _check_markers(settings: Settings) -> None:
    """Check that the markers and shapes of bodies agree, and suffice to identify them."""
    bodies, shapes = settings.bodies, settings.shapes
    for name, shape in shapes.items():
        if bodies[name] and len(bodies[name]) != len(shape):
            raise ParameterError(
                f'parameter {name}.shape has x and y of {len(shape)} markers, and {name}.markers '
                f'names {len(bodies[name])}; give both of each marker, in the same order'
            )
    if settings.marker_identity == 'shape':
        if settings.plane == FIT:
            raise ParameterError(
                'parameter plane is fit; with marker_identity shape give its normal, as kinpole '
                'discover finds it'
            )
        for name, markers in bodies.items():
            if not markers and name not in shapes:
                raise ParameterError(
                    f'parameter {name}.shape is missing: with marker_identity shape give the shape '
                    'of each body, as kinpole discover finds it'
                )
    elif len(bodies) > 1 or shapes:
        for name, markers in bodies.items():
            if not markers:
                raise ParameterError(
                    f'parameter {name}.markers is missing: with several bodies, or shapes, list '
                    'the markers of each, or set marker_identity to shape and give all shapes'
                )
    for name, markers in bodies.items():
        if len(markers) == 1:
            raise ParameterError(
                f'parameter {name}.markers names one marker; a body needs at least two, or a '
                f'marker_type of poses ({", ".join(POSE_TYPES)})'
            )


def of_poses(settings: Settings) -> Settings:
    """
    The settings where poses of bodies come: each stands for three points fixed to its body.

    The frame of the pose is that of the body.
    """
    shapes = dict.fromkeys(settings.bodies, POSE_POINTS)
    return replace(settings, shapes=shapes, marker_identity='auto', method='pose')


def check_poses(settings: Settings, kind: str) -> None:
    """Raise ParameterError for what does not go with poses of this kind as input."""
    bodies = settings.bodies
    for name, value, fix in (('marker_identity', 'shape', 'auto'), ('method', 'landmarks', 'pose')):
        if getattr(settings, name) == value:
            raise ParameterError(
                f'parameter {name} is {value}, which takes markers, and marker_type {kind} brings '
                f'poses; set {name} to {fix}'
            )
    if settings.shapes:
        raise ParameterError(
            f'parameter {min(settings.shapes)}.shape is of markers, and marker_type {kind} brings '
            'poses; leave it out'
        )
    single, example = kind == 'pose_stamped', 'crank' if kind == 'tf' else '0'
    if single and len(bodies) > 1:
        raise ParameterError(
            f'parameter bodies names {len(bodies)}, and a PoseStamped is of one; take their poses '
            'from a PoseArray (body_poses) or from /tf (tf), or run a node for each'
        )
    for body, names in bodies.items():
        if single and names:
            raise ParameterError(
                f'parameter {body}.markers is given, and a PoseStamped has no names; leave it out'
            )
        # The only body may be the only pose.
        if len(names) != 1 and (names or kind == 'tf' or len(bodies) > 1):
            raise ParameterError(
                f'parameter {body}.markers names {len(names)} poses; with marker_type {kind} name '
                f"the one of this body, such as ['{example}']"
            )
    own = {settings.frame_prefix + body for body in bodies}
    taken = own & {name for names in bodies.values() for name in names}
    if kind == 'tf' and settings.publish_tf and taken:
        raise ParameterError(
            f'parameter publish_tf is true, and {cut(min(taken))} is a frame that comes on /tf; '
            'set frame_prefix, such as kinpole/'
        )


def _consistent(settings: Settings) -> Settings:
    """The settings as they are; raises ParameterError where they contradict each other."""
    if settings.lag >= settings.window:
        raise ParameterError(
            f'parameter lag is {settings.lag:g} s; it must be less than window, '
            f'{settings.window:g} s'
        )
    return settings


def known_rows(values: Mapping[str, Any]) -> dict[str, Parameter]:
    """
    The rows of all parameters there are with these bodies and joints.

    Raises ParameterError for a name among `values` that is not one of them.
    """
    names = check_value('bodies', PARAMETERS['bodies'], values)
    joints = check_value('joints', PARAMETERS['joints'], values)
    known = {**PARAMETERS, **own_parameters(names, joints)}
    for name in values:
        if name not in known and name not in _NODE_ONLY and not name.startswith('qos_overrides.'):
            hint = ''
            body, _, last = name.rpartition('.')
            if last in ('markers', 'shape', 'pin'):
                hint = f'; {cut(body)} is not among the bodies {", ".join(names)}'
            elif last == 'bodies':
                hint = f'; {cut(body)} is not among the joints {", ".join(joints) or "(none)"}'
            raise ParameterError(
                f'unknown parameter {cut(name)}{hint}; known are {", ".join(sorted(known))}'
            )
    return known


def deprecation_warnings(names: Iterable[str]) -> list[str]:
    """Return a warning for each deprecated parameter among the names."""
    return [
        f'parameter {name} is deprecated, since {DEPRECATED[name]}; fix: leave it out'
        for name in sorted(DEPRECATED.keys() & set(names))
    ]


def is_of_bodies(name: str) -> bool:
    """Whether a parameter says which bodies and joints there are, or of which markers."""
    return name in ('bodies', 'joints') or name.endswith(('.markers', '.shape', '.pin', '.bodies'))


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


def load_settings(
    path: str | Path, node_name: str = 'kinpole', changes: Mapping[str, Any] | None = None
) -> Settings:
    """
    Read a ROS 2 parameter file: the sections '/**' and that of the node.

    `changes`, by ROS names, override what it says. Raises ParameterError naming the file for
    anything that cannot be used.
    """
    try:
        document = load_yaml(read_limited(path, MOST_YAML), RosLoader)
    except OSError as error:
        raise ParameterError(f'{path}: {error.strerror}; name a readable parameter file') from None
    except _MALFORMED as error:
        reason = cut_line(' '.join(str(error).split()))
        raise ParameterError(f'{path}: not YAML ({reason})') from None
    wanted = {'/**', node_name, f'/{node_name}'}
    sections = document if isinstance(document, dict) else {}
    values: dict[str, Any] = {}
    found = False
    for key, section in sections.items():
        if key not in wanted:
            continue
        if not isinstance(section, dict) or not isinstance(section.get('ros__parameters'), dict):
            raise ParameterError(
                f'{path}: {key} must hold the key ros__parameters, and that the parameters'
            )
        found = True
        try:
            values.update(_flat(section['ros__parameters']))
        except ParameterError as error:
            raise ParameterError(f'{path}: {error}') from None
    if not found:
        raise ParameterError(
            f'{path}: no section for this node; write {node_name}: or /**: and under it '
            'ros__parameters:'
        )
    try:
        return settings_from(values | dict(changes or {}))
    except ParameterError as error:
        source = f'{path} and --set' if changes else path
        raise ParameterError(f'{source}: {error}') from None


def assignments(words: Iterable[str]) -> dict[str, Any]:
    """
    Parameters by their ROS names from words as of `ros2 run ... -p`: NAME:=VALUE, VALUE in YAML.

    The last of several of one name holds. Raises ParameterError for a word that is none.
    """
    values: dict[str, Any] = {}
    for word in words:
        name, sign, text = word.partition(':=')
        if not sign or not name:
            raise ParameterError(f'{cut(word)} is not NAME:=VALUE, such as lag:=0.05')
        try:
            value = load_yaml(text, RosLoader)
        except _MALFORMED as error:
            reason = cut_line(' '.join(str(error).split()))
            raise ParameterError(f'{cut(word)}: the value is not YAML ({reason})') from None
        values.update(_flat({name: value}))
    return values


def _flat(section: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """
    Names as ROS has them: nested keys with dots between them.

    Raises ParameterError for what the node does not take either: no value, and lists of values of
    several types, of which there are none in ROS.
    """
    values: dict[str, Any] = {}
    for key, value in section.items():
        name = f'{prefix}{key}'
        if value is None or value in ({}, []):
            raise ParameterError(f'parameter {cut(name)} has no value; leave it out or give it one')
        if isinstance(value, list) and len({type(each) for each in value}) > 1:
            raise ParameterError(
                f'parameter {cut(name)} is {cut(repr(value))}, a list of several types; give all '
                'numbers of a list a point, as in [0.0, 1.0], or all texts quotes'
            )
        new = _flat(value, f'{name}.') if isinstance(value, dict) else {name: value}
        if twice := values.keys() & new.keys():
            raise ParameterError(f'parameter {cut(min(twice))} is given twice; keep one')
        values.update(new)
    return values
