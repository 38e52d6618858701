"""
From markers to poses: shapes, noise, pins, hubs, and what is wrong with all of these.

Knows rigid bodies only as shapes to fit, and neither ROS nor derivatives.
"""

from kinpole_ros.rigid._continuity import Verdict
from kinpole_ros.rigid._lasting import LastingNoise
from kinpole_ros.rigid._lens import LENS, SLANT, TISSUE, Fields
from kinpole_ros.rigid._noise import Noise
from kinpole_ros.rigid._pin import Pins
from kinpole_ros.rigid._pose_noise import PoseNoise
from kinpole_ros.rigid._reference import References, constant_segments, seen_at
from kinpole_ros.rigid._samples import Samples
from kinpole_ros.rigid._shape import Shapes
from kinpole_ros.rigid._soft import Deformation

__all__ = [
    'LENS',
    'SLANT',
    'TISSUE',
    'Deformation',
    'Fields',
    'LastingNoise',
    'Noise',
    'Pins',
    'PoseNoise',
    'References',
    'Samples',
    'Shapes',
    'Verdict',
    'constant_segments',
    'seen_at',
]
