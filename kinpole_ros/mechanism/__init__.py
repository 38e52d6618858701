"""Mechanisms as scenes: exact motion, instant centers, centrodes, statics and tolerances."""

from kinpole_ros.mechanism._belt import Belt
from kinpole_ros.mechanism._centers import Centers, instant_centers
from kinpole_ros.mechanism._centrodes import Centrodes, Poles, centrodes, poles
from kinpole_ros.mechanism._equations import (
    Dimension,
    Equations,
    Part,
)
from kinpole_ros.mechanism._equilibrium import Release, Statics, undetermined
from kinpole_ros.mechanism._joint_kinds import (
    GROUND,
    Pose,
    Revolute,
    Rolling,
    Slot,
    Strut,
)
from kinpole_ros.mechanism._kennedy import explain
from kinpole_ros.mechanism._loads import (
    Force,
    Holder,
    Load,
    Mass,
    Spring,
    Torque,
    Torsion,
)
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism, Motion
from kinpole_ros.mechanism._motions import BodyMotion, marker_positions, rotation_derivatives
from kinpole_ros.mechanism._polygon import Polygon, polygon
from kinpole_ros.mechanism._scene import Scene, load_scene
from kinpole_ros.mechanism._scene_file import (
    scene_names,
    scene_text,
    scenes_folder,
    share_folder,
)
from kinpole_ros.mechanism._scene_values import SceneError, quantity
from kinpole_ros.mechanism._start import mobility
from kinpole_ros.mechanism._transmission import (
    Port,
    advantage,
    holding,
    transmission_angles,
)

__all__ = [
    'GROUND',
    'Belt',
    'BodyMotion',
    'Centers',
    'Centrodes',
    'Dimension',
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
    'Torque',
    'Torsion',
    'advantage',
    'centrodes',
    'explain',
    'holding',
    'instant_centers',
    'load_scene',
    'marker_positions',
    'mobility',
    'poles',
    'polygon',
    'quantity',
    'rotation_derivatives',
    'scene_names',
    'scene_text',
    'scenes_folder',
    'share_folder',
    'transmission_angles',
    'undetermined',
]
