"""
Centrodes from a bag: the moving centrode of a rolling wheel is its rim.

Prints:
the fixed centrode is straight to 0.14 mm
the moving centrode is a circle of 0.100 m
"""

from pathlib import Path

import numpy as np

from kinpole_ros import replay

bag = Path(__file__).parents[1] / 'bags' / 'rolling_wheel.mcap'
wheel = replay(bag)['body']
determined = np.isfinite(wheel.icr[:, 0])
fixed = wheel.icr[determined]
print(f'the fixed centrode is straight to {1e3 * fixed[:, 1].std():.2g} mm')

# The moving centrode is the path of the ICR in the frame of the body.
x, y = (wheel.icr - wheel.position)[determined].T
moving = (x + 1j * y) * np.exp(-1j * wheel.angle[determined])
# A circle by least squares: |z|^2 = 2 (a x + b y) + c.
rows = np.stack((2 * moving.real, 2 * moving.imag, np.ones(len(moving))), axis=1)
a, b, c = np.linalg.lstsq(rows, np.abs(moving) ** 2, rcond=None)[0]
print(f'the moving centrode is a circle of {np.sqrt(c + a**2 + b**2):.3f} m')
