"""
Rigid-body kinematics in the plane, as pure functions of arrays.

Derivatives of poses or landmarks come in; rates, poles, centrodes and their first-order covariances
go out. Public functions say whether a vector is an array (..., 2) or a complex number x + iy.
Written as complex numbers, the matrix R of the seeds (rotation by +90 degrees) is the factor i, and
their 2 x 2 matrices B, H and G are single complex numbers. The seeds are the course notes listed in
docs/course_notes.md. Functions raise ValueError for arrays whose shapes do not fit.
"""

from kinpole_ros.planar._balance import Port, measured_balance
from kinpole_ros.planar._centrode import (
    centrode_curvature,
    icr_acceleration,
    icr_velocity,
    moving_centrode,
    moving_centrode_curvature,
)
from kinpole_ros.planar._curvature import (
    ball_point,
    bobillier_axis,
    bresse_circles,
    inflection_circle,
    inverse_motion,
    path_curvature,
    stationary_curvature,
)
from kinpole_ros.planar._landmarks import (
    LandmarkKinematics,
    im2kin2d,
    landmark_kinematics,
    point_derivatives,
)
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
    kennedy_residual,
    pole,
    relative_center,
    relative_pole,
)
from kinpole_ros.planar._procrustes import (
    Fit,
    ProcrustesFactors,
    fit_pose,
)
from kinpole_ros.planar._uncertainty import Linear, covariance, propagate, variance

__all__ = [
    'Fit',
    'LandmarkKinematics',
    'Linear',
    'Port',
    'ProcrustesFactors',
    'ball_point',
    'bobillier_axis',
    'body_point_derivative',
    'bresse_circles',
    'centrode_curvature',
    'centrode_velocities',
    'covariance',
    'fit_pose',
    'fixed_centrode_from_reference',
    'icr_acceleration',
    'icr_velocity',
    'im2kin2d',
    'inflection_circle',
    'inverse_motion',
    'kennedy_residual',
    'landmark_kinematics',
    'measured_balance',
    'moving_centrode',
    'moving_centrode_curvature',
    'moving_centrode_from_reference',
    'path_curvature',
    'point_derivatives',
    'pole',
    'pole_from_reference',
    'propagate',
    'relative_acceleration',
    'relative_center',
    'relative_pole',
    'relative_velocity',
    'stationary_curvature',
    'to_complex',
    'to_plane',
    'transport',
    'variance',
]
