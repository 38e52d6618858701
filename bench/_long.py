"""
A run of ten million frames: whether anything drifts, grows or slows down as a tracker goes on.

Fourteen hours of markers at 200 Hz, most of them only taken in: figures are asked for in short
stretches, all at the same phase of the motion, so that early and late ones are alike but for noise.
"""

import resource
import time
from collections.abc import Callable

import numpy as np

from bench._motions import motions
from bench._record import NEAR, RATE, START, STEP, frames_of, observe, quantities, rms
from kinpole_ros.planar import fit_pose, to_complex
from kinpole_ros.tracking.frame import part_of
from kinpole_ros.tracking.tracker import Tracker

FRAMES = 10_000_000
STRETCHES, ASKED = 200, 50
_MOTION, _NOISE = 'four-bar coupler', 1e-3


def long_run(
    frames: int = FRAMES, progress: Callable[[float], None] | None = None
) -> list[dict[str, float]]:
    """
    One row by stretch, the last `ASKED` frames of each of `STRETCHES` equal parts of `frames`.

    `omega_error` is the RMS error over the true rms of ω, `icr_error` that of the ICR over the
    body's size, of the share `icr_determined`. The learned shape laid on the true one tells how far
    the body's frame has `turned` (rad) and `shifted` (sizes) since the first stretch, and what is
    left between them, `shape_error` (rms, sizes). `memory` is the peak of the process so far (MB),
    `cpu` the time per frame of the part (µs).
    """
    motion = motions()[_MOTION]
    shape = to_complex(motion.markers)[None]
    shape = shape - shape.mean()
    rng = np.random.default_rng(11)
    piece = frames // STRETCHES
    tracker: Tracker | None = None
    rows: list[dict[str, float]] = []
    place, angle = 0j, 0.0
    for stretch in range(STRETCHES):
        index = np.arange(stretch * piece, (stretch + 1) * piece)
        _, exact = observe(motion, index / RATE)
        noise = _NOISE * motion.size * (rng.normal(size=(*exact.shape, 2)) @ (1, 1j))
        given, settings = frames_of((exact + noise)[:, None], START + STEP * index)
        tracker = tracker or Tracker(settings)
        begun = time.process_time()
        tracker.add(part_of(given, slice(-ASKED)), None)
        blocks = tracker.add(part_of(given, slice(-ASKED, None)), 3)
        found = [instant for block in blocks for instant in block]
        spent = time.process_time() - begun

        true = motion.motion(np.array([estimate.stamp - START for estimate in found]) * 1e-9)
        truth = quantities(true.position, true.angle)
        poles = [estimate.pole(1) for estimate in found]
        told = np.array([pole.determined[0] for pole in poles])
        near = told & (np.abs(truth['ICR'] - true.position[0]) < NEAR * motion.size)
        rate_error = np.array([estimate.rate(1).value[0] for estimate in found]) - truth['ω']
        pole_error = np.array([pole.value[0] for pole in poles]) - truth['ICR']
        learned = fit_pose(found[-1].shape, shape, np.ones(shape.shape))
        if not rows:
            place, angle = learned.position[0], learned.angle[0]
        rows.append(
            {
                'frame': float(index[-1] + 1),
                'omega_error': _pooled(rate_error) / _pooled(truth['ω']),
                'icr_error': _pooled(pole_error[near]) / motion.size,
                'icr_determined': float(told.mean()),
                'turned': float(np.angle(np.exp(1j * (learned.angle[0] - angle)))),
                'shifted': float(np.abs(learned.position[0] - place) / motion.size),
                'shape_error': _pooled(learned.residual[0]) / motion.size,
                'memory': resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                'cpu': 1e6 * spent / piece,
            }
        )
        if progress is not None:
            progress((stretch + 1) / STRETCHES)
    return rows


def _pooled(error: np.ndarray) -> float:
    return float(rms(error[:, None], np.isfinite(error)[:, None])[0])
