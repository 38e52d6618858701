"""Mechanisms whose motion is known exactly: the truth that measured kinematics is held against."""

from kinpole_ros.mechanism._motions import BodyMotion, marker_positions, rotation_derivatives
from kinpole_ros.mechanism._scene import (
    Scene,
    SceneError,
    load_scene,
    scene_names,
    scenes_folder,
)
from kinpole_ros.mechanism._share import share_folder

__all__ = [
    'BodyMotion',
    'Scene',
    'SceneError',
    'load_scene',
    'marker_positions',
    'rotation_derivatives',
    'scene_names',
    'scenes_folder',
    'share_folder',
]
