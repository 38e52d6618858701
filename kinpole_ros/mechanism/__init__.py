"""Mechanisms as scenes: exact motion, instant centers, centrodes, statics and tolerances."""

from kinpole_ros.mechanism._centers import Centers, instant_centers
from kinpole_ros.mechanism._centrodes import Centrodes, Poles, centrodes, poles
from kinpole_ros.mechanism._constraints import (
    Anchor,
    constraint_rows,
    wheel_state,
)
from kinpole_ros.mechanism._equations import (
    Dimension,
    Equation,
    Equations,
    Part,
    joint_at,
    part_sum,
)
from kinpole_ros.mechanism._joints import (
    GROUND,
    Belt,
    Pose,
    Revolute,
    Rolling,
    Slot,
    Strut,
    loop_form,
)
from kinpole_ros.mechanism._kennedy import center_name, explain
from kinpole_ros.mechanism._loads import (
    Force,
    Holder,
    Load,
    Mass,
    Spring,
    Torque,
    Torsion,
    inertial_loads,
    spring_loads,
)
from kinpole_ros.mechanism._loops import LinkageError, with_laws
from kinpole_ros.mechanism._mechanism import Mechanism, Motion
from kinpole_ros.mechanism._motions import BodyMotion, marker_positions, rotation_derivatives
from kinpole_ros.mechanism._pitch import write_pitch_curves
from kinpole_ros.mechanism._polygon import Polygon, polygon
from kinpole_ros.mechanism._scene import Scene, load_scene
from kinpole_ros.mechanism._scene_file import (
    rewritten,
    scene_names,
    scene_text,
    scenes_folder,
    share_folder,
    value_spans,
)
from kinpole_ros.mechanism._scene_values import SceneError, quantity
from kinpole_ros.mechanism._start import mobility
from kinpole_ros.mechanism._statics import Release, Statics, undetermined, why_no_reactions
from kinpole_ros.mechanism._tolerance import (
    Tolerance,
    ToleranceSpread,
    propagate_tolerances,
    tolerances_of,
)
from kinpole_ros.mechanism._transmission import (
    Port,
    advantage,
    holding,
    transmission_angles,
)

__all__ = [
    'GROUND',
    'Anchor',
    'Belt',
    'BodyMotion',
    'Centers',
    'Centrodes',
    'Dimension',
    'Equation',
    'Equations',
    'Force',
    'Holder',
    'LinkageError',
    'Load',
    'Mass',
    'Mechanism',
    'Motion',
    'Part',
    'Poles',
    'Polygon',
    'Port',
    'Pose',
    'Release',
    'Revolute',
    'Rolling',
    'Scene',
    'SceneError',
    'Slot',
    'Spring',
    'Statics',
    'Strut',
    'Tolerance',
    'ToleranceSpread',
    'Torque',
    'Torsion',
    'advantage',
    'center_name',
    'centrodes',
    'constraint_rows',
    'explain',
    'holding',
    'inertial_loads',
    'instant_centers',
    'joint_at',
    'load_scene',
    'loop_form',
    'marker_positions',
    'mobility',
    'part_sum',
    'poles',
    'polygon',
    'propagate_tolerances',
    'quantity',
    'rewritten',
    'rotation_derivatives',
    'scene_names',
    'scene_text',
    'scenes_folder',
    'share_folder',
    'spring_loads',
    'tolerances_of',
    'transmission_angles',
    'undetermined',
    'value_spans',
    'wheel_state',
    'why_no_reactions',
    'with_laws',
    'write_pitch_curves',
]
