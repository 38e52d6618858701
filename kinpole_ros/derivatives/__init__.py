"""
Poses on a clock to their derivatives with covariances, by Gaussian processes and their evidence.

Knows neither markers nor rigid bodies nor ROS: a pose is an angle and a point of the plane.
"""

from kinpole_ros.derivatives._events import Event, Samples, find_events
from kinpole_ros.derivatives._models import FEWEST_SAMPLES
from kinpole_ros.derivatives._poses import (
    Call,
    Derivatives,
    Poses,
    Windows,
    derive_poses,
    go_on,
    new_call,
    pass_tables,
)

__all__ = [
    'FEWEST_SAMPLES',
    'Call',
    'Derivatives',
    'Event',
    'Poses',
    'Samples',
    'Windows',
    'derive_poses',
    'find_events',
    'go_on',
    'new_call',
    'pass_tables',
]
