"""
CPU time by method, all figures up to the jerk: frame by frame, as live, and of many at once.

The peers are bare loops without covariances, dropouts, uneven stamps or any checks; the pose fit is
part of their time where they use one.
"""

import time
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bench._hindsight import fixed_weights
from bench._peers import (
    DIFFERENCES,
    EFFORTS,
    FIXED,
    KALMAN,
    LIKELY,
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
from bench._polynomial import derivative_weights, stencil
from bench._record import (
    LAG,
    RATE,
    fit_poses,
    frames_of,
    make_recording,
    quantities,
    stamps_of,
)
from kinpole_ros.derivatives import Derivatives, Poses, Windows
from kinpole_ros.planar import fit_pose
from kinpole_ros.tracking.frame import part_of
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.tracker import Tracker

PIPELINE = 'the same pipeline, fixed 41/4'
# Hindsight makes no method faster.
_AS_LONG = {FIXED: POLYNOMIAL, SPACED: DIFFERENCES, SAVGOL_BEST: SAVGOL, LIKELY: SMOOTHER}
# Frames that fill the windows before any counts, and those that do, live and at once.
_FILL, _LIVE, _AT_ONCE = 200, 400, 1000


def derive_fixed(
    poses: Poses,
    windows: Windows,
    left_out: np.ndarray,
    noise: np.ndarray,
    window: float,
    order: int,
    effort: str = 'normal',
) -> Derivatives:
    """Differentiate by a local polynomial (41 samples, degree 4); arguments as `derive_poses`."""
    (now,), (oldest,), (newest,) = windows
    samples, degree = USUAL
    last = min(now + (samples + 1) // 2, newest + 1)
    rows = slice(max(last - samples, oldest), last)
    times = poses.time[rows] - poses.time[now]
    shape = order + 1, 1, noise.shape[1]
    if len(times) <= degree:
        bad, wide = np.full(shape, np.nan), np.full((order + 1, *shape), np.nan)
        return Derivatives(bad + 0j, bad, wide, wide, bad[0], bad[0])
    weights = _fixed_rows(times.tobytes(), degree)[: order + 1]
    position = weights @ (poses.position[rows] - poses.position[now])
    position[0] += poses.position[now]
    spread = (weights @ weights.T)[..., None] * noise[0] ** 2
    return Derivatives(
        position[:, None],
        (weights @ np.unwrap(poses.angle[rows], axis=0))[:, None],
        (spread / poses.position_information[now])[:, :, None],
        (spread / poses.angle_information[now])[:, :, None],
        np.full(shape[1:], (times[-1] - times[0]) * 1e-9),
        np.full(shape[1:], float(degree + 1)),
    )


class FixedTracker(Tracker):
    """The same tracker with a fixed local polynomial for the choice."""

    derive = staticmethod(derive_fixed)


@lru_cache(maxsize=16)
def _fixed_rows(times: bytes, degree: int) -> np.ndarray:
    """Weights for order 0 to 3: even sampling asks for the same ones every frame."""
    return derivative_weights(np.frombuffer(times, np.int64) * 1e-9, degree, 3)


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

    def tracked(kind: type[Tracker], effort: str, step: int) -> float:
        tracker = kind(Settings(**{**vars(settings), 'effort': effort}))
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
        name: (partial(tracked, Tracker, effort, 1), partial(tracked, Tracker, effort, _AT_ONCE))
        for effort, name in EFFORTS.items()
    }
    tasks |= {
        PIPELINE: (
            partial(tracked, FixedTracker, 'normal', 1),
            partial(tracked, FixedTracker, 'normal', _AT_ONCE),
        ),
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
