"""
Formulas only: rates and poles of a body from the derivatives of points on it.

Prints:
rod: 2 rad/s about (0, 0) m
wheel: 10 rad/s about (0, 0) m, acceleration pole (0, 0.3) m
"""

import numpy as np

from kinpole_ros.planar import landmark_kinematics

# A rod that turns about its first end: points and velocities, (n, 2).
rod = landmark_kinematics([[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [0.0, 2.0]])
print(f'rod: {rod.angular_velocity:.3g} rad/s about ({rod.icr[0]:.3g}, {rod.icr[1]:.3g}) m')

# A wheel of 0.3 m that rolls on the x axis at a constant 10 rad/s. Its hub does not accelerate.
rate, hub = 10.0, np.array([0.0, 0.3])
arms = 0.3 * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
normals = np.stack((-arms[:, 1], arms[:, 0]), axis=1)
velocities = [-rate * hub[1], 0.0] + rate * normals
wheel = landmark_kinematics(hub + arms, velocities, -(rate**2) * arms)
(icr_x, icr_y), (iap_x, iap_y) = wheel.icr, wheel.iap
print(
    f'wheel: {wheel.angular_velocity:.3g} rad/s about ({icr_x:.3g}, {abs(icr_y.round(9)):.3g}) m, '
    f'acceleration pole ({iap_x:.3g}, {iap_y:.3g}) m'
)
