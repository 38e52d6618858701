"""Parameters checked against each other, and made into settings."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from kinpole_ros.files import cut, did_you_mean
from kinpole_ros.settings.parameter_table import (
    DEPRECATED,
    NODE_PARAMETERS,
    PARAMETERS,
    Parameter,
    check_value,
    own_parameters,
)
from kinpole_ros.settings.settings import (
    FIT,
    GROUND,
    POSE_POINTS,
    POSE_TYPES,
    ParameterError,
    Settings,
)

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
                f'unknown parameter {cut(name)}{hint}; {did_you_mean(name[:100], known)}known are '
                f'{", ".join(sorted(known))}'
            )
    return known


def deprecation_warnings(names: Iterable[str]) -> list[str]:
    """Return a warning for each deprecated parameter among the names."""
    return [
        f'parameter {name} is deprecated, since {DEPRECATED[name]}; fix: leave it out'
        for name in sorted(DEPRECATED.keys() & set(names))
    ]
