"""
Relative motion in a four-bar: the relative instant center of two links is their common pin.

Prints:
coupler relative to crank: -9.0 to -4.2 rad/s, standard deviation of the center 0.4 mm
rocker relative to coupler: -3.1 to 3.1 rad/s, standard deviation of the center 2 mm
"""

from pathlib import Path

import numpy as np

from kinpole_ros import replay

ROOT = Path(__file__).parents[1]
motion = replay(ROOT / 'bags' / 'four_bar.mcap', ROOT / 'config' / 'four_bar.yaml')
for pair in (('coupler', 'crank'), ('rocker', 'coupler')):
    relative = motion.pairs[pair]
    sigma = np.sqrt(np.trace(relative.icr_covariance, axis1=1, axis2=2))
    lowest, highest = np.nanmin(relative.angular_velocity), np.nanmax(relative.angular_velocity)
    print(
        f'{" relative to ".join(pair)}: {lowest:.1f} to {highest:.1f} rad/s, '
        f'standard deviation of the center {1e3 * np.nanmedian(sigma):.1g} mm'
    )
