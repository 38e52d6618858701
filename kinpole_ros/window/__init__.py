"""
From samples of markers to derivatives at one instant.

Knows rigid bodies only as shapes to fit, and neither ROS nor the names of quantities: poses and
their noise go in at true time stamps, derivatives with covariances come out.
"""

from kinpole_ros.window._choice import (
    Derivatives,
    differentiate,
    weigh_together,
)
from kinpole_ros.window._continuity import MOST_SUSPECT, Verdict
from kinpole_ros.window._judgment import PoseDerivatives
from kinpole_ros.window._ladder import FEWEST_SAMPLES
from kinpole_ros.window._landmarks import LandmarkFilter
from kinpole_ros.window._lasting import LastingNoise
from kinpole_ros.window._lens import LENS, SLANT, TISSUE, Fields
from kinpole_ros.window._noise import Noise
from kinpole_ros.window._pin import STRIKES, Pins
from kinpole_ros.window._polynomial import derivative_weights, stencil
from kinpole_ros.window._poses import PoseFilter, Room, Unforeseen
from kinpole_ros.window._projection import project
from kinpole_ros.window._reference import References, alike, seen_at
from kinpole_ros.window._runs import Windows, joined, runs
from kinpole_ros.window._samples import Samples
from kinpole_ros.window._shape import PlainShape, Shapes
from kinpole_ros.window._soft import Deformation
from kinpole_ros.window._spectrum import Spectrum
from kinpole_ros.window._turn import NOT_FAR

__all__ = [
    'FEWEST_SAMPLES',
    'LENS',
    'MOST_SUSPECT',
    'NOT_FAR',
    'SLANT',
    'STRIKES',
    'TISSUE',
    'Deformation',
    'Derivatives',
    'Fields',
    'LandmarkFilter',
    'LastingNoise',
    'Noise',
    'Pins',
    'PlainShape',
    'PoseDerivatives',
    'PoseFilter',
    'References',
    'Room',
    'Samples',
    'Shapes',
    'Spectrum',
    'Unforeseen',
    'Verdict',
    'Windows',
    'alike',
    'derivative_weights',
    'differentiate',
    'joined',
    'project',
    'runs',
    'seen_at',
    'stencil',
    'weigh_together',
]
