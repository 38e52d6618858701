"""
A bag to arrays: the motion of the coupler of a four-bar, with standard deviations.

Prints:
390 instants of crank, coupler, rocker
at 3.000 s the angular velocity of the coupler is -2.687 +- 0.009 rad/s
its ICR is determined at 98% of the instants
"""

from pathlib import Path

import numpy as np

from kinpole_ros import replay

ROOT = Path(__file__).parents[1]
motion = replay(ROOT / 'bags' / 'four_bar.mcap', ROOT / 'config' / 'four_bar.yaml')
print(f'{len(motion.t)} instants of {", ".join(motion.bodies)}')
coupler = motion['coupler']
k = np.searchsorted(motion.t, 3.0)
rate, sigma = coupler.angular_velocity[k], coupler.angular_velocity_sigma[k]
print(
    f'at {motion.t[k]:.3f} s the angular velocity of the coupler is {rate:.3f} +- {sigma:.3f} rad/s'
)
determined = np.isfinite(coupler.icr[:, 0]).mean()
print(f'its ICR is determined at {determined:.0%} of the instants')
