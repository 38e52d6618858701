"""
CPU time by method, all figures up to the jerk: frame by frame, as live, and of many at once.

The peers are bare loops without covariances, dropouts, uneven stamps or any checks; the pose fit is
part of their time where they use one.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bench._hindsight import fixed_weights
from bench._peers import (
    DIFFERENCES,
    FIXED,
    KALMAN,
    LIKELY,
    OURS,
    POLYNOMIAL,
    SAVGOL,
    SAVGOL_BEST,
    SMOOTHER,
    SPACED,
    USUAL,
    landmarks,
    make_kalman,
    run_kalman,
)
from bench._polynomial import stencil
from bench._record import (
    LAG,
    RATE,
    fit_poses,
    frames_of,
    make_recording,
    quantities,
    stamps_of,
)
from kinpole_ros.planar import fit_pose
from kinpole_ros.tracking.frame import part_of
from kinpole_ros.tracking.tracker import Tracker

# Hindsight makes no method faster.
_AS_LONG = {FIXED: POLYNOMIAL, SPACED: DIFFERENCES, SAVGOL_BEST: SAVGOL, LIKELY: SMOOTHER}
# Frames that fill the windows before any counts, and those that do, live and at once.
_FILL, _LIVE, _AT_ONCE = 200, 400, 1000


def cost_rows(repeats: int) -> list[dict[str, Any]]:
    """Rows of CPU time in s per frame of one body by `method`: `live` and `replay`."""
    recording = make_recording(('four-bar coupler',), (1e-3,), 1, (_FILL + _AT_ONCE) / RATE)
    points = recording.points
    shape, ones = recording.shape, np.ones((1, points.shape[2]))
    frames, settings = frames_of(points, stamps_of(len(points)))
    ahead = round(LAG * RATE)
    kalman = make_kalman(1e-6, ahead)
    live, every = points[: _FILL + _LIVE], np.arange(ahead, len(points) - ahead)

    def timed(work: Callable[[], object], count: int) -> float:
        start = time.process_time()
        work()
        return (time.process_time() - start) / count

    def tracked(step: int) -> float:
        tracker = Tracker(settings)
        tracker.add(part_of(frames, slice(_FILL)), 3)
        last = _FILL + (_LIVE if step == 1 else _AT_ONCE)
        parts = [part_of(frames, slice(k, k + step)) for k in range(_FILL, last, step)]

        def run() -> None:
            for part in parts:
                for estimate in tracker.add(part, 3):
                    [estimate.pole(k) for k in (1, 2, 3)]
                    estimate.centrode_curvature  # noqa: B018 - computed when asked for

        return timed(run, last - _FILL)

    def markers_live(weights: np.ndarray) -> float:
        samples = weights.shape[1]

        def run() -> None:
            for k in range(samples, len(live)):
                found = (weights @ live[k - samples : k, 0])[:, None]
                quantities(*landmarks(found, points.shape[2]))

        return timed(run, len(live) - samples)

    def markers_at_once(weights: np.ndarray) -> float:
        def run() -> None:
            found = sliding_window_view(points[:, 0], weights.shape[1], axis=0) @ weights.T
            quantities(*landmarks(np.moveaxis(found, -1, 0), points.shape[2]))

        return timed(run, len(points))

    def poses_live(weights: np.ndarray) -> float:
        kept = np.zeros((weights.shape[1], 3))

        def run() -> None:
            nonlocal kept
            for row in live:
                fit = fit_pose(row, shape, ones)
                kept = np.roll(kept, -1, axis=0)
                kept[-1] = fit.position[0].real, fit.position[0].imag, fit.angle[0]
                here = weights @ kept
                quantities(here[:, :1] + 1j * here[:, 1:2], here[:, 2:])

        return timed(run, len(live))

    def poses_at_once(weights: np.ndarray) -> float:
        def run() -> None:
            fitted = (part[:, 0] for part in fit_poses(recording))
            windows = (sliding_window_view(part, weights.shape[1]) for part in fitted)
            quantities(*((weights @ window.T) for window in windows))

        return timed(run, len(points))

    def kalman_live(smooth: bool) -> float:
        def run() -> None:
            state, before = np.zeros((4, 3)), np.zeros((ahead + 1, 3))
            states = [state] * (ahead + 1)
            for row in live:
                fit = fit_pose(row, shape, ones)
                sample = np.array((fit.position[0].real, fit.position[0].imag, fit.angle[0]))
                states = [*states[1:], state]
                before = np.roll(before, -1, axis=0)
                before[-1] = sample - state[0]
                updated = state + kalman.gain[:, None] * before[-1]
                state = kalman.transition @ updated
                here = states[0] + kalman.smoothing.T @ before if smooth else updated
                quantities((here[:, :1] + 1j * here[:, 1:2]), here[:, 2:])

        return timed(run, len(live))

    def kalman_at_once(smooth: bool) -> float:
        chosen = kalman if smooth else make_kalman(1e-6, 0)

        def run() -> None:
            position, angle = fit_poses(recording)
            signals = np.concatenate((position.real, position.imag, angle), axis=1)
            found = run_kalman(chosen, signals, every)
            quantities(found[..., 0] + 1j * found[..., 1], found[..., 2])

        return timed(run, len(points))

    usual, short = fixed_weights(*USUAL)[0], stencil(np.arange(-2, 3) / RATE, 3)
    tasks: dict[str, tuple[Callable[[], float], Callable[[], float]]] = {
        OURS: (partial(tracked, 1), partial(tracked, _AT_ONCE)),
        POLYNOMIAL: (partial(poses_live, usual), partial(poses_at_once, usual)),
        DIFFERENCES: (partial(markers_live, short), partial(markers_at_once, short)),
        SAVGOL: (partial(markers_live, usual), partial(markers_at_once, usual)),
        KALMAN: (partial(kalman_live, False), partial(kalman_at_once, False)),
        SMOOTHER: (partial(kalman_live, True), partial(kalman_at_once, True)),
    }
    # The least of several: what others do on the machine only ever adds.
    with np.errstate(all='ignore'):
        spent = {
            name: [min(task() for _ in range(repeats)) for task in both]
            for name, both in tasks.items()
        }
    spent |= {name: spent[like] for name, like in _AS_LONG.items()}
    return [{'method': name, 'live': a, 'replay': b} for name, (a, b) in spent.items()]
