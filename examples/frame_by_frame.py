"""
Frame by frame: the tracker without ROS, for a driver of your own.

Prints:
at 0.945 s: 3.890 rad/s
2.00 +- 0.26 rad/s^2
"""

import numpy as np

from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker

settings = settings_from(
    {'bodies': ['disk'], 'disk.markers': ['a', 'b', 'c'], 'window': 0.2, 'lag': 0.05, 'noise': 1e-4}
)
tracker = Tracker(settings)
arms = np.array([0.1, 0.1j, -0.1])
for k in range(200):
    t = k / 200
    markers = np.exp(2j * t + 1j * t**2) * arms
    points = np.stack((markers.real, markers.imag, np.zeros(3)), axis=-1)
    frame = MarkerFrames(np.array([k * 5_000_000]), 'world', ('a', 'b', 'c'), points[None])
    for estimate in tracker.add(frame, order=2):
        latest = estimate
rate, acceleration = latest.rate(1), latest.rate(2)
print(f'at {latest.stamp[-1] * 1e-9:.3f} s: {rate.value[-1, 0]:.3f} rad/s')
print(f'{acceleration.value[-1, 0]:.2f} +- {np.sqrt(acceleration.variance[-1, 0]):.2f} rad/s^2')
