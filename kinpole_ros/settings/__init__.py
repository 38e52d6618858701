"""Parameters: each declared once, with its default, range and meaning, and checked."""

from kinpole_ros.settings.consistency import check_poses, known_rows, of_poses, settings_from
from kinpole_ros.settings.kinds import AXES, FIT, ParameterError, PlaneSetting, canonical_name
from kinpole_ros.settings.message_types import MESSAGE_TYPES, POSE_TYPES, MessageType
from kinpole_ros.settings.parameter_file import assignments, load_settings
from kinpole_ros.settings.settings import (
    GROUND,
    INACTIVE,
    NODE_PARAMETERS,
    OWN_PARAMETERS,
    PARAMETERS,
    POSE_POINTS,
    RUNNING,
    START,
    Parameter,
    Settings,
    check_value,
    own_name,
    own_parameters,
)

__all__ = [
    'AXES',
    'FIT',
    'GROUND',
    'INACTIVE',
    'MESSAGE_TYPES',
    'NODE_PARAMETERS',
    'OWN_PARAMETERS',
    'PARAMETERS',
    'POSE_POINTS',
    'POSE_TYPES',
    'RUNNING',
    'START',
    'MessageType',
    'Parameter',
    'ParameterError',
    'PlaneSetting',
    'Settings',
    'assignments',
    'canonical_name',
    'check_poses',
    'check_value',
    'known_rows',
    'load_settings',
    'of_poses',
    'own_name',
    'own_parameters',
    'settings_from',
]
