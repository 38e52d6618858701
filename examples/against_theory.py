"""
A measured mechanism against its theory: how many deviations are the rates off?

Prints:
crank: 0.5 deviations rms
coupler: 0.8 deviations rms
rocker: 1.5 deviations rms
"""

from pathlib import Path

import numpy as np

from kinpole_ros import replay
from kinpole_ros.mechanism import load_scene

ROOT = Path(__file__).parents[1]
motion = replay(ROOT / 'bags' / 'four_bar.mcap', ROOT / 'config' / 'four_bar.yaml')
# The bag is a simulation of this scene, which begins at 1 s.
exact = load_scene('four_bar').motion(motion.t - 1.0)
for name, body in motion.bodies.items():
    off = (body.angular_velocity - exact[name].angle[1]) / body.angular_velocity_sigma
    print(f'{name}: {np.sqrt(np.nanmean(off**2)):.1f} deviations rms')
