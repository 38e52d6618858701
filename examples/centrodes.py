"""
Centrodes from a bag: a wheel that rolls, whose moving centrode is its own rim.

Prints:
the fixed centrode is straight to 0.14 mm
the moving one is a circle of 0.100 m
"""

from pathlib import Path

import numpy as np

from kinpole_ros import replay

bag = Path(__file__).parents[1] / 'bags' / 'rolling_wheel.mcap'
wheel = replay(bag)['body']
known = np.isfinite(wheel.icr[:, 0])
fixed = wheel.icr[known]
print(f'the fixed centrode is straight to {1e3 * fixed[:, 1].std():.2g} mm')

# The moving one is what the ICR draws on the body: turned back into the body's frame.
x, y = (wheel.icr - wheel.position)[known].T
moving = (x + 1j * y) * np.exp(-1j * wheel.angle[known])
# A circle by least squares: |z|^2 = 2 (a x + b y) + c.
rows = np.stack((2 * moving.real, 2 * moving.imag, np.ones(len(moving))), axis=1)
a, b, c = np.linalg.lstsq(rows, np.abs(moving) ** 2, rcond=None)[0]
print(f'the moving one is a circle of {np.sqrt(c + a**2 + b**2):.3f} m')
