"""
Which model ours chose: how many parameters the angle's motion has within a window.

A steady turn has two. More noise hides harmonics, which then take none.
"""

import numpy as np

from bench._record import NOISES, WARM_UP, Recording, frames_of, make_recording, stamps_of
from bench._rows import Rows
from kinpole_ros.tracking.tracker import Tracker

# Motions that are shown over time, at the middle noise, and for how many s.
SHOWN = ('stop and go', 'dead point')
_SECONDS = 4.5


def model_rows(names: tuple[str, ...], seeds: int, seconds: float) -> Rows:
    """Rows by motion and noise: `parameters`, median of all frames, `low` 10% and `high` 90%."""
    recording = make_recording(names, NOISES, seeds, seconds)
    stamps, parameters = _parameters(recording)
    counts = parameters[stamps >= WARM_UP]
    rows: Rows = []
    for motion in names:
        for noise in NOISES:
            mine = [k for k, case in enumerate(recording.cases) if case[:2] == (motion, noise)]
            low, middle, high = np.nanpercentile(counts[:, mine], (10, 50, 90)).tolist()
            rows.append(
                {'motion': motion, 'noise': noise, 'parameters': middle, 'low': low, 'high': high}
            )
    return rows


def model_over_time() -> Rows:
    """Rows by motion of `SHOWN` and instant, s: `parameters` and the true `omega`, rad/s."""
    recording = make_recording(SHOWN, NOISES[1:2], 1, _SECONDS)
    times, parameters = _parameters(recording)
    late = times >= WARM_UP
    truth = recording.truth['ω'][: len(times)]
    return [
        {'motion': motion, 't': float(t), 'parameters': float(p), 'omega': float(w)}
        for k, motion in enumerate(SHOWN)
        for t, p, w in zip(times[late], parameters[late, k], truth[late, k], strict=True)
    ]


def _parameters(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Instants (M,), s, the first frames of the recording, and parameters (M, C) there."""
    stamps = stamps_of(len(recording.points))
    frames, settings = frames_of(recording.points, stamps)
    found = Tracker(settings).add(frames, 1)
    at = np.concatenate([estimate.stamp for estimate in found])
    parameters = np.concatenate([estimate.degree for estimate in found]) + 1
    assert np.array_equal(at, stamps[: len(at)])
    return (at - stamps[0]) * 1e-9, parameters
