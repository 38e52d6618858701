"""Mechanisms whose motion is known exactly: the truth that measured kinematics is held against."""

from kinpole_ros.mechanism._centers import Centers, instant_centers
from kinpole_ros.mechanism._centrodes import Centrodes, Poles, centrodes, poles
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
    Anchor,
    Belt,
    Pose,
    Revolute,
    Rolling,
    Slot,
    Strut,
    constraint_rows,
    loop_form,
    wheel_state,
)
from kinpole_ros.mechanism._kennedy import center_name, explain
from kinpole_ros.mechanism._loops import LinkageError, with_laws
from kinpole_ros.mechanism._mechanism import Mechanism, Motion
from kinpole_ros.mechanism._motions import BodyMotion, marker_positions, rotation_derivatives
from kinpole_ros.mechanism._pitch import write_pitch_curves
from kinpole_ros.mechanism._polygon import Polygon, polygon
from kinpole_ros.mechanism._reactions import (
    Release,
    reactions,
    releases,
    undetermined,
    why_no_reactions,
)
from kinpole_ros.mechanism._rewrite import rewritten, value_spans
from kinpole_ros.mechanism._scene import Scene, load_scene
from kinpole_ros.mechanism._scene_file import scene_names, scene_text, scenes_folder
from kinpole_ros.mechanism._share import share_folder
from kinpole_ros.mechanism._start import mobility
from kinpole_ros.mechanism._statics import (
    Force,
    Holder,
    Load,
    Mass,
    Spring,
    Torque,
    Torsion,
    efforts,
    holding,
    inertial_loads,
    load_rates,
    spring_loads,
)
from kinpole_ros.mechanism._tolerance import (
    Tolerance,
    ToleranceSpread,
    propagate_tolerances,
    tolerances_of,
)
from kinpole_ros.mechanism._transmission import Port, advantage, transmission_angles
from kinpole_ros.mechanism._units import SceneError, quantity

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
    'Strut',
    'Tolerance',
    'ToleranceSpread',
    'Torque',
    'Torsion',
    'advantage',
    'center_name',
    'centrodes',
    'constraint_rows',
    'efforts',
    'explain',
    'holding',
    'inertial_loads',
    'instant_centers',
    'joint_at',
    'load_rates',
    'load_scene',
    'loop_form',
    'marker_positions',
    'mobility',
    'part_sum',
    'poles',
    'polygon',
    'propagate_tolerances',
    'quantity',
    'reactions',
    'releases',
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
