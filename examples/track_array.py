"""
An array of markers to motion: a pendulum at 200 Hz with 0.2 mm of noise.

Prints:
angular velocity: 90% of the errors are below 1.0 standard deviations
median error of the pivot: 0.2 mm
"""

import numpy as np

from kinpole_ros import track

generator = np.random.default_rng(0)
stamps = np.arange(0, 4_000_000_000, 5_000_000)  # ns
angle = 0.8 * np.sin(3.0 * stamps * 1e-9)
pivot = 0.5 + 0.25j
arms = np.array([0.1, 0.2 + 0.03j, 0.2 - 0.03j])
markers = pivot + np.exp(1j * angle)[:, None] * arms
points = np.stack((markers.real, markers.imag), axis=-1)  # (T, n, 2), m
points += 2e-4 * generator.standard_normal(points.shape)
points[100:140, 1] = np.nan  # this marker is hidden for 0.2 s

motion = track(points, stamps, bodies={'pendulum': [0, 1, 2]}, window=0.3, lag=0.1)
body = motion['pendulum']
exact = 0.8 * 3.0 * np.cos(3.0 * motion.t)
ratio = np.abs(body.angular_velocity - exact) / body.angular_velocity_sigma
quantile = np.quantile(ratio, 0.9)
print(f'angular velocity: 90% of the errors are below {quantile:.1f} standard deviations')
error = np.abs(body.icr - [pivot.real, pivot.imag]).max(axis=1)
print(f'median error of the pivot: {1e3 * np.nanmedian(error):.1g} mm')
