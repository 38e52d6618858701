"""Parameters checked against each other, and made into settings."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from kinpole_ros.files import cut, did_you_mean
from kinpole_ros.settings.kinds import FIT, ParameterError
from kinpole_ros.settings.message_types import POSE_TYPES
from kinpole_ros.settings.settings import (
    GROUND,
    NODE_PARAMETERS,
    PARAMETERS,
    POSE_POINTS,
    Parameter,
    Settings,
    check_value,
    own_name,
    own_parameters,
)

# Parameters of ROS in the same file.
_OF_ROS = ('use_sim_time', 'start_type_description_service')
# Parameters of old files, without effect since long.
_GONE = ('effort', 'method')


def settings_from(values: Mapping[str, Any]) -> Settings:
    """
    Check parameters given by their ROS names, 'lag' or 'coupler.markers', and fill in the rest.

    Raises ParameterError for a name that is not known, for a value out of its range, and for values
    that contradict each other.
    """
    rows = known_rows(values)
    for name, row in NODE_PARAMETERS.items():
        check_value(name, row, values)
    checked = {name: check_value(name, row, values) for name, row in rows.items()}
    bodies, joints = checked['bodies'], checked['joints']
    settings = Settings(
        **{name: checked[name] for name in PARAMETERS}
        | {
            'bodies': {name: checked[f'{name}.markers'] for name in bodies},
            'shapes': {name: shape for name in bodies if (shape := checked[f'{name}.shape'])},
            'pins': {name: pin for name in bodies if (pin := checked[f'{name}.pin'])},
            'joints': {name: checked[f'{name}.bodies'] for name in joints},
        }
    )
    if without := next((name for name in settings.pins if name not in settings.shapes), None):
        raise ParameterError(
            f'parameter {without}.pin is in the frame of {without}.shape, which is missing: give '
            'both, as kinpole discover finds them'
        )
    for name, pair in settings.joints.items():
        if unknown := set(pair) - {*bodies, GROUND}:
            raise ParameterError(
                f'parameter {name}.bodies names {cut(", ".join(sorted(unknown)))}; a joint is '
                f'between two of {", ".join(bodies)} and {GROUND}'
            )
    if settings.marker_type in POSE_TYPES:
        check_poses(settings, settings.marker_type)
    else:
        _check_markers(settings)
    if settings.lag >= settings.window:
        raise ParameterError(
            f'parameter lag is {settings.lag:g} s; it must be less than window, '
            f'{settings.window:g} s'
        )
    return settings


def _check_markers(settings: Settings) -> None:
    """Check that the markers and shapes of bodies agree, and suffice to identify them."""
    bodies, shapes = settings.bodies, settings.shapes
    by_shape = settings.marker_identity == 'shape'
    if by_shape and settings.plane == FIT:
        raise ParameterError(
            'parameter plane is fit; with marker_identity shape give its normal, as kinpole '
            'discover finds it'
        )
    for name, markers in bodies.items():
        if markers and len(markers) != len(shapes.get(name, markers)):
            raise ParameterError(
                f'parameter {name}.shape has x and y of {len(shapes[name])} markers, and '
                f'{name}.markers names {len(markers)}; give both of each marker, in the same order'
            )
        if by_shape and not markers and name not in shapes:
            raise ParameterError(
                f'parameter {name}.shape is missing: with marker_identity shape give the shape of '
                'each body, as kinpole discover finds it'
            )
        if not by_shape and not markers and (len(bodies) > 1 or shapes):
            raise ParameterError(
                f'parameter {name}.markers is missing: with several bodies, or shapes, list the '
                'markers of each, or set marker_identity to shape and give all shapes'
            )
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
    return replace(settings, shapes=shapes, marker_identity='auto')


def check_poses(settings: Settings, kind: str) -> None:
    """Raise ParameterError for what does not go with poses of this kind as input."""
    bodies = settings.bodies
    if settings.marker_identity == 'shape':
        raise ParameterError(
            f'parameter marker_identity is shape, which takes markers, and marker_type {kind} '
            'brings poses; set marker_identity to auto'
        )
    if settings.shapes:
        raise ParameterError(
            f'parameter {min(settings.shapes)}.shape is of markers, and marker_type {kind} brings '
            'poses; leave it out'
        )
    single, example = kind == 'pose_stamped', '0' if kind == 'body_poses' else 'crank'
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


def known_rows(values: Mapping[str, Any]) -> dict[str, Parameter]:
    """
    The rows of all parameters there are with these bodies and joints.

    Raises ParameterError for a name among `values` that is not one of them.
    """
    bodies, joints = (check_value(name, PARAMETERS[name], values) for name in ('bodies', 'joints'))
    known = {**PARAMETERS, **own_parameters(bodies, joints)}
    taken = {*known, *NODE_PARAMETERS, *_OF_ROS}
    for name in values:
        if name in taken or name.startswith('qos_overrides.'):
            continue
        hint = '; leave it out, as it has no effect' if name in _GONE else ''
        owner = cut(name.rpartition('.')[0])
        if own_name(name).startswith('<body>'):
            hint = f'; {owner} is not among the bodies {", ".join(bodies)}'
        elif own_name(name):
            hint = f'; {owner} is not among the joints {", ".join(joints) or "(none)"}'
        raise ParameterError(
            f'unknown parameter {cut(name)}{hint}; {did_you_mean(name[:100], known)}known are '
            f'{", ".join(sorted(known))}'
        )
    return known
