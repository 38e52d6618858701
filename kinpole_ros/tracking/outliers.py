"""
Poses that leave the path of their body for one to three frames: the whole body is wrong.

A tracker that takes one body for another, or sees it mirrored in a window, gives markers that fit
the shape at a place where the body cannot be. Such poses are far off the cubic through the two
poses before and the two after them.
"""

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.statistics import medians

# Poses that are looked back on for the scale, and the fewest.
SCALE_FRAMES, MIN_SCALE_FRAMES = 256, 20


def path_scale(history: History, bodies: Bodies) -> Real:
    """
    Standard deviations (2, B) of what angles, rad, and positions, m, are off their cubics.

    Per unit of the gain of white noise; infinite while fewer than MIN_SCALE_FRAMES are known.
    """
    rows = slice(-SCALE_FRAMES, None)
    time = history['time'][rows]
    found = np.full((2, bodies.count), np.inf)
    if len(time) < MIN_SCALE_FRAMES + 4:
        return found
    nodes = np.stack([(time[k : len(time) - 4 + k] - time[2:-2]) * 1e-9 for k in (0, 1, 3, 4)], 1)
    weights = lagrange_weights(nodes, np.zeros(len(nodes)))
    gain = np.sqrt(1 + (weights**2).sum(axis=1))
    for part, values in enumerate(signals(history, rows)):
        around = np.stack([values[k : len(time) - 4 + k] for k in (0, 1, 3, 4)], axis=1)
        off = np.abs(values[2:-2] - (weights[..., None] * around).sum(axis=1)) / gain[:, None]
        enough = np.isfinite(off).sum(axis=0) >= MIN_SCALE_FRAMES
        if enough.any():
            found[part, enough] = 1.4826 * medians(off[:, enough].T)
    return found


def signals(history: History, rows: slice) -> tuple[Real, Complex]:
    """Angles with whole turns and positions (N, B) of some rows, NaN where not known."""
    known = history['information'][rows, 0] > 0
    angle = history['angle'][rows] + 2 * np.pi * history['turns'][rows]
    return np.where(known, angle, np.nan), np.where(known, history['position'][rows], np.nan)


def lagrange_weights(nodes: Real, at: Real) -> Real:
    """Weights (m, k) of values at `nodes` (m, k) in the polynomial through them, `at` (m,)."""
    number = nodes.shape[1]
    weights = np.ones((len(at), number))
    for i in range(number):
        for j in range(number):
            if i != j:
                weights[:, i] *= (at - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
    return weights
