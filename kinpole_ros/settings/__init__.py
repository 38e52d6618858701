"""Parameters: each declared once, with its default, range and meaning, and checked."""

from kinpole_ros.settings.consistency import (
    check_poses,
    deprecation_warnings,
    known_rows,
    of_poses,
    settings_from,
)
from kinpole_ros.settings.parameter_file import assignments, load_settings
from kinpole_ros.settings.parameter_table import (
    DEPRECATED,
    JOINT_BODIES,
    MARKERS,
    NODE_PARAMETERS,
    PARAMETERS,
    PIN,
    SHAPE,
    Parameter,
    check_value,
    is_of_bodies,
    own_parameters,
)
from kinpole_ros.settings.settings import (
    AXES,
    FIT,
    GROUND,
    POSE_POINTS,
    POSE_TYPES,
    ParameterError,
    PlaneSetting,
    Settings,
    canonical_name,
)

__all__ = [
    'AXES',
    'DEPRECATED',
    'FIT',
    'GROUND',
    'JOINT_BODIES',
    'MARKERS',
    'NODE_PARAMETERS',
    'PARAMETERS',
    'PIN',
    'POSE_POINTS',
    'POSE_TYPES',
    'SHAPE',
    'Parameter',
    'ParameterError',
    'PlaneSetting',
    'Settings',
    'assignments',
    'canonical_name',
    'check_poses',
    'check_value',
    'deprecation_warnings',
    'is_of_bodies',
    'known_rows',
    'load_settings',
    'of_poses',
    'own_parameters',
    'settings_from',
]
