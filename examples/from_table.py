"""
A table to a bag: points of a video tracker, in pixels with y down, to rates.

Prints:
1.500 rad/s
about the axle at (0.640, -0.480) m
"""

import csv
import tempfile
from pathlib import Path

import numpy as np

from kinpole_ros import replay
from kinpole_ros.bags import import_points

with tempfile.TemporaryDirectory() as folder:
    table, bag = Path(folder) / 'tracked.csv', Path(folder) / 'tracked.mcap'
    # Two points of a lever that turns at 1.5 rad/s; 500 pixels per meter, 120 frames/s.
    with open(table, 'w', newline='') as file:
        rows = csv.writer(file)
        rows.writerow(['axle_x', 'axle_y', 'tip_x', 'tip_y'])
        for t in np.arange(240) / 120:
            tip = 200 * np.exp(1.5j * t)
            rows.writerow([320, 240, 320 + tip.real, 240 - tip.imag])
    import_points(table, bag, rate=120.0, scale=1 / 500, y_down=True)
    lever = replay(bag)['body']
print(f'{np.nanmedian(lever.angular_velocity):.3f} rad/s')
x, y = np.nanmedian(lever.icr, axis=0)
print(f'about the axle at ({x:.3f}, {y:.3f}) m')
