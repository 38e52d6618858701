"""
Rigid-body kinematics in the plane, as pure functions of arrays.

Knows no time series, files or ROS: derivatives come in, rates, poles and centrodes go out. Inside,
a vector (x, y) is the complex number x + iy, so that the seeds' matrix R (a turn by +90 degrees) is
a product with i and each of their 2 x 2 matrices B, H and G is one complex number.
"""

from kinpole_ros.planar._balance import Port, measured_balance
from kinpole_ros.planar._centrode import (
    acceleration_terms,
    centrode_curvature,
    curvature_terms,
    icr_acceleration,
    icr_velocity,
    moving_centrode,
    moving_centrode_curvature,
    velocity_terms,
)
from kinpole_ros.planar._landmarks import (
    LandmarkKinematics,
    im2kin2d,
    landmark_kinematics,
    point_derivatives,
)
from kinpole_ros.planar._linear import Linear, covariance, mean_square, variance
from kinpole_ros.planar._plane import to_complex, to_plane
from kinpole_ros.planar._poisson import (
    centrode_velocities,
    fixed_centrode_from_reference,
    moving_centrode_from_reference,
    pole_from_reference,
    relative_acceleration,
    relative_velocity,
    transport,
)
from kinpole_ros.planar._poles import (
    body_point_derivative,
    point_motion,
    pole,
    rotation,
    rotation_coefficient,
)
from kinpole_ros.planar._procrustes import (
    Fit,
    Grip,
    fit_by_grip,
    fit_pose,
    grip_of,
)
from kinpole_ros.planar._relative import (
    center_offset,
    kennedy_residual,
    relative_center,
    relative_pole,
)

__all__ = [
    'Fit',
    'Grip',
    'LandmarkKinematics',
    'Linear',
    'Port',
    'acceleration_terms',
    'body_point_derivative',
    'center_offset',
    'centrode_curvature',
    'centrode_velocities',
    'covariance',
    'curvature_terms',
    'fit_by_grip',
    'fit_pose',
    'fixed_centrode_from_reference',
    'grip_of',
    'icr_acceleration',
    'icr_velocity',
    'im2kin2d',
    'kennedy_residual',
    'landmark_kinematics',
    'mean_square',
    'measured_balance',
    'moving_centrode',
    'moving_centrode_curvature',
    'moving_centrode_from_reference',
    'point_derivatives',
    'point_motion',
    'pole',
    'pole_from_reference',
    'relative_acceleration',
    'relative_center',
    'relative_pole',
    'relative_velocity',
    'rotation',
    'rotation_coefficient',
    'to_complex',
    'to_plane',
    'transport',
    'variance',
    'velocity_terms',
]
