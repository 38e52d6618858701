"""
Residuals of poses about the path of their body, which show that a whole body is wrong.

A tracker that confuses two bodies, or sees one mirrored in a window, gives markers that fit the
shape at a wrong place, for one to three frames. Such poses are far from the cubic through the two
poses before and the two after them.
"""

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.statistics import medians

# Most and fewest poses for the scale of the residuals.
SCALE_FRAMES, MIN_SCALE_FRAMES = 256, 20


def path_scale(history: History, bodies: Bodies) -> Real:
    """
    Return the standard deviations (2, B) of angles, rad, and positions, m, about their cubics.

    Divided by the gain of white noise; infinite with fewer than MIN_SCALE_FRAMES poses.
    """
    rows = slice(-SCALE_FRAMES, None)
    time = history['time'][rows]
    scale = np.full((2, bodies.count), np.inf)
    if len(time) < MIN_SCALE_FRAMES + 4:
        return scale
    nodes = np.stack([(time[k : len(time) - 4 + k] - time[2:-2]) * 1e-9 for k in (0, 1, 3, 4)], 1)
    weights = lagrange_weights(nodes, np.zeros(len(nodes)))
    gain = np.sqrt(1 + (weights**2).sum(axis=1))
    for part, values in enumerate(signals(history, rows)):
        around = np.stack([values[k : len(time) - 4 + k] for k in (0, 1, 3, 4)], axis=1)
        residual = np.abs(values[2:-2] - (weights[..., None] * around).sum(axis=1))
        residual = residual / gain[:, None]
        enough = np.isfinite(residual).sum(axis=0) >= MIN_SCALE_FRAMES
        if enough.any():
            scale[part, enough] = 1.4826 * medians(residual[:, enough].T)
    return scale


def signals(history: History, rows: slice) -> tuple[Real, Complex]:
    """Return angles with whole turns and positions (N, B) of some rows, NaN where not known."""
    has_pose = history['information'][rows, 0] > 0
    angle = history['angle'][rows] + 2 * np.pi * history['turns'][rows]
    position = np.where(has_pose, history['position'][rows], np.nan)
    return np.where(has_pose, angle, np.nan), position


def lagrange_weights(nodes: Real, at: Real) -> Real:
    """Return the weights (m, k) of values at `nodes` (m, k) in their polynomial `at` (m,)."""
    number = nodes.shape[1]
    weights = np.ones((len(at), number))
    for i in range(number):
        for j in range(number):
            if i != j:
                weights[:, i] *= (at - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
    return weights
