"""
Measurement and theory: how many standard deviations are the measured rates from the exact ones?

Prints:
crank: 0.5 standard deviations rms
coupler: 0.8 standard deviations rms
rocker: 1.2 standard deviations rms
"""

from pathlib import Path

import numpy as np

from kinpole_ros import replay
from kinpole_ros.mechanism import load_scene

ROOT = Path(__file__).parents[1]
motion = replay(ROOT / 'bags' / 'four_bar.mcap', ROOT / 'config' / 'four_bar.yaml')
# The bag is a simulation of this scene, which starts at 1 s.
exact = load_scene('four_bar').motion(motion.t - 1.0)
for name, body in motion.bodies.items():
    error = body.angular_velocity - exact[name].angle[1]
    ratio = error / body.angular_velocity_sigma
    print(f'{name}: {np.sqrt(np.nanmean(ratio**2)):.1f} standard deviations rms')
