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

# A pose is wrong beyond this many standard deviations of what poses are off the cubic; the newest,
# which no pose follows yet, beyond three times as many off every polynomial through those before.
FAR, NEWEST_FAR = 7.0, 3.0
# A pose is not wrong within this share of the diameter, or this angle, rad.
NEAR = 0.01
# Most wrong poses in a row.
LONGEST = 3
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
            found[part, enough] = 1.4826 * np.nanmedian(off[:, enough], axis=0)
    return found


def signals(history: History, rows: slice) -> tuple[Real, Complex]:
    """Angles with whole turns and positions (N, B) of some rows, NaN where not known."""
    known = history['information'][rows, 0] > 0
    angle = history['angle'][rows] + 2 * np.pi * history['turns'][rows]
    return np.where(known, angle, np.nan), np.where(known, history['position'][rows], np.nan)


def leave_out_wrong_poses(history: History, bodies: Bodies) -> np.ndarray:
    """
    Leave out poses that the newest frame shows to be wrong; how many (B,) of each body were.

    Those are one to three poses before the two newest of the body.
    """
    count = np.zeros(bodies.count, int)
    rows = slice(-4 * LONGEST, None)
    time = (history['time'][rows] - history['time'][-1]) * 1e-9
    angles, positions = signals(history, rows)
    for b in np.flatnonzero(np.isfinite(bodies.jump_scale).all(axis=0)).tolist():
        frames = np.flatnonzero(np.isfinite(angles[:, b]))[-LONGEST - 4 :]
        if len(frames) < 5 or frames[-1] != len(time) - 1:
            continue
        values = np.stack((angles[frames, b] + 0j, positions[frames, b]))
        least = np.array((NEAR, NEAR * bodies.size[b]))
        length = _wrong_before_last(time[frames], values, FAR * bodies.jump_scale[:, b], least)
        if length:
            wrong = frames[-2 - length : -2] - len(time)
            history['information'][wrong, :, b] = 0.0
            count[b] = length
    return count


def _wrong_before_last(time: Real, values: Complex, most: Real, least: Real) -> int:
    """How many poses before the last two, at `time` (n,), with `values` (2, n), are wrong."""
    for length in range(1, min(LONGEST, len(time) - 4) + 1):
        gap = np.arange(len(time) - 2 - length, len(time) - 2)
        nodes = np.array((gap[0] - 2, gap[0] - 1, len(time) - 2, len(time) - 1))
        weights = lagrange_weights(np.broadcast_to(time[nodes], (length, 4)), time[gap])
        gain = np.sqrt(1 + (weights**2).sum(axis=1))
        off = np.abs(values[:, gap] - values[:, nodes] @ weights.T)
        limit = np.maximum(most[:, None] * gain, least[:, None])
        far = off > limit
        if not far.any(axis=0).all():
            continue
        # After a jump that lasts, the poses after the gap do not go on from those before it.
        first, second, *after = nodes
        slope = (values[:, second] - values[:, first]) / (time[second] - time[first])
        ahead = values[:, second, None] + slope[:, None] * (time[after] - time[second])
        back = np.abs(values[:, after] - ahead).max(axis=1) < off.min(axis=1)
        if (back | ~far.all(axis=1)).all():
            return length
    return 0


def doubtful_newest(history: History, bodies: Bodies) -> np.ndarray:
    """How many (B,) of the newest frames have poses that cannot be told from wrong ones yet."""
    count = np.zeros(bodies.count, int)
    rows = slice(-4 * LONGEST, None)
    time = (history['time'][rows] - history['time'][-1]) * 1e-9
    angles, positions = signals(history, rows)
    for b in np.flatnonzero(np.isfinite(bodies.jump_scale).all(axis=0)).tolist():
        frames = np.flatnonzero(np.isfinite(angles[:, b]))[-LONGEST - 4 :]
        if len(frames) < 5 or frames[-1] != len(time) - 1:
            continue
        values = np.stack((angles[frames, b] + 0j, positions[frames, b]))
        most = np.maximum(
            NEWEST_FAR * FAR * bodies.jump_scale[:, b], (NEAR, NEAR * bodies.size[b])
        )
        for last in range(max(len(frames) - LONGEST, 4), len(frames)):
            off = []
            for used in range(1, 5):
                nodes = time[last - used : last]
                weights = lagrange_weights(nodes[None], time[last : last + 1])[0]
                gain = np.sqrt(1 + (weights**2).sum())
                off.append(np.abs(values[:, last] - values[:, last - used : last] @ weights) / gain)
            if (np.min(off, axis=0) > most).any():
                count[b] = len(time) - frames[last]
                break
    return count


def lagrange_weights(nodes: Real, at: Real) -> Real:
    """Weights (m, k) of values at `nodes` (m, k) in the polynomial through them, `at` (m,)."""
    number = nodes.shape[1]
    weights = np.ones((len(at), number))
    for i in range(number):
        for j in range(number):
            if i != j:
                weights[:, i] *= (at - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
    return weights
