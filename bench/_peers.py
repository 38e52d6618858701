"""
The other ways to get derivatives, on the same recordings: what each gives for what time and lag.

Every peer that has something to set is set in hindsight, by the truth, for each quantity of each
motion and noise level apart: better than anybody could set it in use.
"""

import time
import warnings
from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from bench._hindsight import (
    ORDER,
    Best,
    Key,
    apply_weights,
    best_fixed,
    counted,
    errors_of,
    fixed_weights,
    own_errors,
    pooled_rms,
    settings,
)
from bench._polynomial import derivative_weights, stencil
from bench._record import (
    LAG,
    QUANTITIES,
    RATE,
    RATES,
    Recording,
    fit_poses,
    frames_of,
    make_recording,
    measure,
    quantities,
    stamps_of,
)
from kinpole_ros import planar
from kinpole_ros.derivatives import Windows
from kinpole_ros.pipeline.frame import part_of
from kinpole_ros.pipeline.parameters import Settings
from kinpole_ros.pipeline.tracker import Tracker
from kinpole_ros.planar import fit_pose

Table = dict[Key, float]

OURS = 'ours'
FIXED = 'local polynomial on poses, hindsight'
DIFFERENCES = 'finite differences, 5 samples'
SPACED = 'finite differences, spacing in hindsight'
SAVGOL = 'Savitzky-Golay 41/4 on markers'
SAVGOL_BEST = 'Savitzky-Golay on markers, hindsight'
KALMAN = 'Kalman filter, hindsight, no lag'
SMOOTHER = 'Kalman smoother, hindsight'
# The peers that lag no more than ours, and those of them that the truth has not tuned.
UNTUNED = (DIFFERENCES, SAVGOL)
REAL_TIME = (*UNTUNED, SPACED, SAVGOL_BEST, SMOOTHER)
# The methods and where PyNumDiff's optimizer starts its search (a set: each; a list: near each).
PYNUMDIFF = {
    'savgoldiff': {'degree': {4, 7}, 'window_size': [21, 61, 101], 'smoothing_win': {3}},
    'splinediff': {'degree': {5}, 's': [0.9, 0.1]},
    'rtsdiff': {'order': {3}, 'log_qr_ratio': [4.0, 10.0], 'forwardbackward': {False}},
    'butterdiff': {'filter_order': {3}, 'cutoff_freq': [0.02, 0.1], 'num_iterations': {1}},
}
# A usual window, centered at 0.1 s of lag, and degree.
_USUAL = (41, 4)
# Spectral density of the snap over the variance of a sample, in units of the frame interval.
_SNAP = 10.0 ** np.arange(-13.0, 3.1, 0.5)


class Kalman(NamedTuple):
    """A constant-jerk model in its steady state, one frame being the unit of time."""

    transition: np.ndarray
    gain: np.ndarray
    smoothing: np.ndarray  # (lag + 1, 4): what each later innovation adds to the state


def equal_lag(recording: Recording) -> dict[str, Table]:
    """RMS errors by method, motion, noise and quantity on the frames that we call determined."""
    ours = measure(recording)
    where, frames = counted(recording, ours), ours.frames
    poses = fit_poses(recording)
    ahead = round(LAG * RATE)
    tables = {OURS: pooled_rms(recording, own_errors(recording, ours), where)}
    tables[FIXED] = _values(best_fixed(recording, frames, where, poses))
    tables[DIFFERENCES] = _differences(recording, frames, where, 1)
    strides = [_differences(recording, frames, where, k) for k in range(1, ahead // 2 + 1)]
    tables[SPACED] = _least(strides)
    tables[SAVGOL] = _on_markers(recording, frames, where, *fixed_weights(*_USUAL))
    tables[SAVGOL_BEST] = _savgol_best(recording, frames, where, LAG)
    tables[KALMAN], tables[SMOOTHER] = (
        _kalman_best(recording, frames, where, poses, lag) for lag in (0, ahead)
    )
    return tables


def over_lag(
    names: tuple[str, ...], lags: tuple[int, ...], seeds: int, seconds: float
) -> dict[tuple[str, int], Table]:
    """RMS errors by method and lag in frames, at the middle noise level."""
    recording = make_recording(names, (1e-3,), seeds, seconds)
    poses = fit_poses(recording)
    figures = {lag: measure(recording, lag=lag / RATE) for lag in lags}
    # One set of frames for all lags: those determined at every one.
    first = max(figure.frames[0] for figure in figures.values())
    last = min(figure.frames[-1] for figure in figures.values())
    frames = np.arange(first, last + 1)
    cut = {lag: slice(first - f.frames[0], last + 1 - f.frames[0]) for lag, f in figures.items()}
    masks = [
        {name: mask[cut[lag]] for name, mask in counted(recording, figure).items()}
        for lag, figure in figures.items()
    ]
    where = {name: np.all([mask[name] for mask in masks], axis=0) for name in QUANTITIES}
    tables: dict[tuple[str, int], Table] = {}
    for lag, figure in figures.items():
        errors = {name: e[cut[lag]] for name, e in own_errors(recording, figure).items()}
        tables[OURS, lag] = pooled_rms(recording, errors, where)
        best = best_fixed(recording, frames, where, poses, lag / RATE)
        tables[FIXED, lag] = _values(best)
        tables[SAVGOL, lag] = _on_markers(
            recording, frames, where, *fixed_weights(*_USUAL, lag / RATE)
        )
        tables[SMOOTHER, lag] = _kalman_best(recording, frames, where, poses, lag)
        if lag >= 2:
            tables[DIFFERENCES, lag] = _differences(recording, frames, where, 1)
            tables[SPACED, lag] = _least(
                [_differences(recording, frames, where, k) for k in range(1, lag // 2 + 1)]
            )
    return tables


def median_over_ours(tables: dict[str, Table], method: str, quantity: str, noise: float) -> float:
    """Median over the motions of a method's error over ours; NaN where there is none."""
    ours = tables[OURS]
    ratios = [
        error / ours[key]
        for key, error in tables[method].items()
        if key[1:] == (noise, quantity) and ours[key] > 0 and np.isfinite(error / ours[key])
    ]
    return float(np.median(ratios)) if ratios else float('nan')


def _values(best: dict[Key, Best]) -> Table:
    return {key: found.error for key, found in best.items()}


def _least(tables: list[Table]) -> Table:
    return {key: float(np.fmin.reduce([table[key] for table in tables])) for key in tables[0]}


def _differences(
    recording: Recording, frames: np.ndarray, where: dict[str, np.ndarray], stride: int
) -> Table:
    weights = stencil(stride * np.arange(-2, 3) / RATE, 3)
    return _on_markers(recording, frames, where, weights, 2, stride)


def _on_markers(
    recording: Recording,
    frames: np.ndarray,
    where: dict[str, np.ndarray],
    weights: np.ndarray,
    ahead: int,
    stride: int = 1,
) -> Table:
    """Every marker differentiated, then the landmark formulas."""
    count, _, markers = recording.points.shape
    flat = recording.points.reshape(count, -1)
    (found,) = apply_weights(weights, ahead, frames, flat, stride=stride)
    return pooled_rms(recording, errors_of(recording, frames, *_landmarks(found, markers)), where)


def _landmarks(found: np.ndarray, markers: int) -> tuple[np.ndarray, np.ndarray]:
    """Pose derivatives (5, ...) from those of the markers (4, ..., bodies * n)."""
    split = planar.to_plane(found.reshape(*found.shape[:-1], -1, markers))
    motion = planar.landmark_kinematics(*split)
    return motion.position, motion.angle


def _savgol_best(
    recording: Recording, frames: np.ndarray, where: dict[str, np.ndarray], lag: float
) -> Table:
    best: Table = {}
    for samples, degree in settings(lag):
        # The optimum is flat, and high degrees take long.
        if degree > 8:
            continue
        table = _on_markers(recording, frames, where, *fixed_weights(samples, degree, lag))
        for key, value in table.items():
            if degree >= ORDER[key[2]] and value < best.get(key, np.inf):
                best[key] = value
    return best


def make_kalman(snap: float, lag: int) -> Kalman:
    """Steady-state filter and fixed-lag smoother for samples of variance 1."""
    transition = np.array([(1, 1, 1 / 2, 1 / 6), (0, 1, 1, 1 / 2), (0, 0, 1, 1), (0, 0, 0, 1.0)])
    # White snap enters a state as the powers of the time left, over their factorials.
    power = np.array((3, 2, 1, 0))
    factorial = np.array((6.0, 2.0, 1.0, 1.0))
    driven = snap / (np.add.outer(power, power) + 1) / np.outer(factorial, factorial)
    covariance = 1e6 * np.eye(4)
    for _ in range(4000):
        gain = covariance[:, 0] / (covariance[0, 0] + 1)
        updated = covariance - np.outer(gain, covariance[0])
        new = transition @ updated @ transition.T + driven
        done = np.allclose(new, covariance, rtol=1e-10, atol=0)
        covariance = (new + new.T) / 2
        if done:
            break
    gain = covariance[:, 0] / (covariance[0, 0] + 1)
    onward = (transition @ (np.eye(4) - np.outer(gain, (1, 0, 0, 0)))).T
    column = np.array((1.0, 0, 0, 0)) / (covariance[0, 0] + 1)
    smoothing = []
    for _ in range(lag + 1):
        smoothing.append(covariance @ column)
        column = onward @ column
    return Kalman(transition, gain, np.array(smoothing))


def run_kalman(kalman: Kalman, signal: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Derivatives (4, M, C), in units of frames, of signals (N, C) by filter and smoother."""
    state = np.zeros((4, signal.shape[1]), signal.dtype)
    state[0] = signal[0]
    predicted = np.empty((len(signal), *state.shape), signal.dtype)
    innovations = np.empty_like(signal)
    for k, sample in enumerate(signal):
        predicted[k] = state
        innovations[k] = sample - state[0]
        state = kalman.transition @ (state + kalman.gain[:, None] * innovations[k])
    found = np.moveaxis(predicted[frames], 1, 0)
    for k, column in enumerate(kalman.smoothing):
        found = found + column[:, None, None] * innovations[frames + k]
    return np.asarray(found)


def _kalman_best(
    recording: Recording,
    frames: np.ndarray,
    where: dict[str, np.ndarray],
    poses: tuple[np.ndarray, np.ndarray],
    lag: int,
) -> Table:
    scale = float(RATE) ** np.arange(4)[:, None, None]
    tables = []
    for snap in _SNAP:
        kalman = make_kalman(float(snap), lag)
        position, angle = (scale * run_kalman(kalman, signal, frames) for signal in poses)
        tables.append(pooled_rms(recording, errors_of(recording, frames, position, angle), where))
    return _least(tables)


# --- PyNumDiff ----------------------------------------------------------------------------------


def pynumdiff_errors(recording: Recording) -> tuple[dict[str, Table], dict[str, float], str]:
    """
    RMS errors of PyNumDiff's methods in ω, α and jerk, their time in s per frame, and its version.

    Offline: they see the whole record, so lag does not bind them. Each order of derivative comes
    from the one before, each with the settings that PyNumDiff's own optimizer finds when it is told
    the true derivative. The time is that of these three. The table 'ours' is of the same frames.
    All are empty where the package is missing.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            pynumdiff = import_module('pynumdiff')
            optimize = import_module('pynumdiff.optimize').optimize
    except ImportError:
        return {}, {}, ''
    ours = measure(recording)
    where, frames = counted(recording, ours), ours.frames
    _, angle = fit_poses(recording)
    tables = {OURS: pooled_rms(recording, own_errors(recording, ours), where)}
    costs = {}
    for name, space in PYNUMDIFF.items():
        method: Callable[..., tuple[np.ndarray, np.ndarray]] = getattr(pynumdiff, name)
        errors = {quantity: np.full(ours.values['ω'].shape, np.nan) for quantity in QUANTITIES}
        spent = 0.0
        for column in range(len(recording.cases)):
            signal = angle[:, column]
            for quantity in RATES:
                exact = recording.truth[quantity]
                with warnings.catch_warnings(), np.errstate(all='ignore'):
                    warnings.simplefilter('ignore')
                    try:
                        chosen, _ = optimize(
                            method,
                            signal,
                            1 / RATE,
                            dxdt_truth=exact[:, column],
                            search_space_updates=space,
                            padding='auto',
                            parallel=False,
                            maxiter=5,
                        )
                        start = time.process_time()
                        _, signal = method(signal, 1 / RATE, **chosen)
                        spent += time.process_time() - start
                    except (ValueError, ArithmeticError, np.linalg.LinAlgError):
                        # It has no answer to a record like this: no figure, here and above.
                        break
                errors[quantity][:, column] = (signal - exact[:, column])[frames]
        tables[f'PyNumDiff {name}'] = pooled_rms(recording, errors, where)
        costs[f'PyNumDiff {name}'] = spent / angle.size
    return tables, costs, version('pynumdiff')


# --- time ---------------------------------------------------------------------------------------


class FixedTracker(Tracker):
    """The same pipeline with a fixed local polynomial (41 samples, degree 4) for the choice."""

    def _from_poses(
        self, windows: Windows, known: np.ndarray, order: int, suspect: np.ndarray | None
    ) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        frames = zip(*windows, known['noise'], strict=True)
        found = [self._at(*frame, order) for frame in frames]
        axes = (1, 1, 2, 2, 0, 0)
        parts = tuple(map(np.stack, zip(*found, strict=True), axes))
        return parts, np.zeros_like(known['reference'])

    def _at(
        self, now: int, oldest: int, newest: int, noise: np.ndarray, order: int
    ) -> tuple[np.ndarray, ...]:
        count = len(self.bodies)
        samples, degree = _USUAL
        last = min(now + (samples + 1) // 2, newest + 1)
        first = max(last - samples, oldest)
        rows = slice(first, last)
        if last - first <= degree:
            bad = np.full((order + 1, count), np.nan)
            wide = np.full((order + 1, order + 1, count), np.nan)
            return bad + 0j, bad, wide, wide, bad[0], bad[0]
        frames = self._timeline.view()
        times = frames['stamp'][rows] - frames['stamp'][now]
        poses = frames['poses']
        position, angle = poses[:, count:] @ (1, 1j), np.unwrap(poses[rows, :count, 0], axis=0)
        weights = _fixed_rows(times.tobytes(), degree)[: order + 1]
        z = weights @ (position[rows] - position[now])
        z[0] += position[now]
        turn = weights @ angle
        information = frames['information'][now]
        spread = (weights @ weights.T)[..., None] * noise**2
        span = np.full(count, (times[-1] - times[0]) * 1e-9)
        return (
            z,
            turn,
            spread / information[count:],
            spread / information[:count],
            span,
            np.full(count, float(degree)),
        )


@lru_cache(maxsize=16)
def _fixed_rows(times: bytes, degree: int) -> np.ndarray:
    """Weights for order 0 to 3: even sampling asks for the same ones every frame."""
    return derivative_weights(np.frombuffer(times, np.int64) * 1e-9, degree, 3)


def costs(repeats: int) -> dict[str, float]:
    """CPU time in s per frame of one body, all figures to the jerk, pose fit included."""
    recording = make_recording(('four-bar coupler',), (1e-3,), 1, 3.0)
    points = recording.points
    shape, ones = recording.shape, np.ones((1, points.shape[2]))
    ahead = round(LAG * RATE)
    kalman = make_kalman(1e-6, ahead)

    def trackers(kind: type[Tracker]) -> float:
        frames, chosen = frames_of(points, stamps_of(len(points)))
        tracker = kind(Settings(**vars(chosen)))
        tracker.add(part_of(frames, slice(200)), 3)
        rest = [part_of(frames, slice(k, k + 1)) for k in range(200, len(frames.stamps))]
        start = time.process_time()
        for frame in rest:
            for estimate in tracker.add(frame, 3):
                [estimate.pole(k) for k in (1, 2, 3)]
                estimate.centrode_curvature  # noqa: B018 - computed when asked for
        return (time.process_time() - start) / len(rest)

    def markers(weights: np.ndarray) -> float:
        samples = weights.shape[1]
        start = time.process_time()
        for k in range(samples, len(points)):
            found = (weights @ points[k - samples : k, 0])[:, None]
            quantities(*_landmarks(found, points.shape[2]))
        return (time.process_time() - start) / (len(points) - samples)

    def kalmans(smooth: bool) -> float:
        state = np.zeros((4, 3))
        before = np.zeros((ahead + 1, 3))
        states = [state] * (ahead + 1)
        start = time.process_time()
        for row in points:
            fit = fit_pose(row, shape, ones)
            sample = np.array((fit.position[0].real, fit.position[0].imag, fit.angle[0]))
            states = [*states[1:], state]
            before = np.roll(before, -1, axis=0)
            before[-1] = sample - state[0]
            updated = state + kalman.gain[:, None] * before[-1]
            state = kalman.transition @ updated
            here = states[0] + kalman.smoothing.T @ before if smooth else updated
            quantities((here[:, :1] + 1j * here[:, 1:2]), here[:, 2:])
        return (time.process_time() - start) / len(points)

    def poses(weights: np.ndarray) -> float:
        samples = weights.shape[1]
        kept = np.zeros((samples, 3))
        start = time.process_time()
        for row in points:
            fit = fit_pose(row, shape, ones)
            kept = np.roll(kept, -1, axis=0)
            kept[-1] = fit.position[0].real, fit.position[0].imag, fit.angle[0]
            here = weights @ kept
            quantities(here[:, :1] + 1j * here[:, 1:2], here[:, 2:])
        return (time.process_time() - start) / len(points)

    usual, short = fixed_weights(*_USUAL)[0], stencil(np.arange(-2, 3) / RATE, 3)
    tasks: dict[str, Callable[[], float]] = {
        OURS: lambda: trackers(Tracker),
        'the same pipeline, fixed 41/4': lambda: trackers(FixedTracker),
        FIXED: lambda: poses(usual),
        DIFFERENCES: lambda: markers(short),
        SPACED: lambda: markers(short),
        SAVGOL: lambda: markers(usual),
        SAVGOL_BEST: lambda: markers(usual),
        KALMAN: lambda: kalmans(False),
        SMOOTHER: lambda: kalmans(True),
    }
    # The least of several: what others do on the machine only ever adds.
    with np.errstate(all='ignore'):
        return {name: min(task() for _ in range(repeats)) for name, task in tasks.items()}
