"""
Relative motion in a four-bar: the relative instant center of two links is the pin between them.

Prints:
coupler with respect to crank: -9.0 to -4.2 rad/s, center known to 0.4 mm
rocker with respect to coupler: -3.1 to 3.1 rad/s, center known to 1 mm
"""

from pathlib import Path

import numpy as np

from kinpole_ros import replay

ROOT = Path(__file__).parents[1]
motion = replay(ROOT / 'bags' / 'four_bar.mcap', ROOT / 'config' / 'four_bar.yaml')
for pair in (('coupler', 'crank'), ('rocker', 'coupler')):
    between = motion.pairs[pair]
    spread = np.sqrt(np.trace(between.icr_covariance, axis1=1, axis2=2))
    least, most = np.nanmin(between.angular_velocity), np.nanmax(between.angular_velocity)
    print(
        f'{" with respect to ".join(pair)}: {least:.1f} to {most:.1f} rad/s, center known to '
        f'{1e3 * np.nanmedian(spread):.1g} mm'
    )
