"""
The other ways to get derivatives, on the same recordings: what each gives at what lag.

Some have the setting that one would choose without the truth. The others are set in hindsight, by
the truth, for each quantity of each motion and noise level: better than anybody could in use.
"""

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
from bench._polynomial import stencil
from bench._record import (
    LAG,
    QUANTITIES,
    RATE,
    Recording,
    fit_poses,
    make_recording,
    measure,
)
from kinpole_ros import planar

Table = dict[Key, float]

OURS = 'ours'
FIXED = 'local polynomial on poses, hindsight'
POLYNOMIAL = 'local polynomial 41/4 on poses'
DIFFERENCES = 'finite differences, 5 samples'
SPACED = 'finite differences, spacing in hindsight'
SAVGOL = 'Savitzky-Golay 41/4 on markers'
SAVGOL_BEST = 'Savitzky-Golay on markers, hindsight'
LIKELY = 'Kalman smoother, self-tuned'
KALMAN = 'Kalman filter, hindsight, no lag'
SMOOTHER = 'Kalman smoother, hindsight'
# The peers that lag no more than ours, and those of them that the truth has not tuned.
UNTUNED = (DIFFERENCES, SAVGOL, POLYNOMIAL, LIKELY)
REAL_TIME = (*UNTUNED, SPACED, SAVGOL_BEST, SMOOTHER)
# A usual window, centered at 0.1 s of lag, and degree.
USUAL = (41, 4)
# Spectral density of the snap over the variance of a sample, in units of the frame interval.
_SNAP = 10.0 ** np.arange(-13.0, 3.1, 0.5)
# s. What a smoother is tuned on: by then a filter that starts at rest has caught up.
TUNED_ON = 0.75, 2.5


class Kalman(NamedTuple):
    """A constant-jerk model in its steady state, one frame being the unit of time."""

    transition: np.ndarray
    gain: np.ndarray
    smoothing: np.ndarray  # (lag + 1, 4): what each later innovation adds to the state


def equal_lag(recording: Recording) -> dict[str, Table]:
    """RMS errors by method, motion, noise and quantity on the frames that ours determines."""
    ours = measure(recording)
    frames, where = ours.frames, counted(recording, ours)
    poses = fit_poses(recording)
    ahead = round(LAG * RATE)
    tables = {OURS: pooled_rms(recording, own_errors(recording, ours), where)}
    tables[FIXED] = _values(best_fixed(recording, frames, where, poses))
    weights = fixed_weights(*USUAL)
    errors = errors_of(recording, frames, *apply_weights(*weights, frames, *poses))
    tables[POLYNOMIAL] = pooled_rms(recording, errors, where)
    tables[DIFFERENCES] = _differences(recording, frames, where, 1)
    strides = [_differences(recording, frames, where, k) for k in range(1, ahead // 2 + 1)]
    tables[SPACED] = _least(strides)
    tables[SAVGOL] = _on_markers(recording, frames, where, *fixed_weights(*USUAL))
    tables[SAVGOL_BEST] = _savgol_best(recording, frames, where, LAG)
    likely = likely_kalman(poses, frames, ahead)
    tables[LIKELY] = pooled_rms(recording, errors_of(recording, frames, *likely), where)
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
            recording, frames, where, *fixed_weights(*USUAL, lag / RATE)
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
    return pooled_rms(recording, errors_of(recording, frames, *landmarks(found, markers)), where)


def landmarks(found: np.ndarray, markers: int) -> tuple[np.ndarray, np.ndarray]:
    """Pose derivatives (5, ...) from those of the markers (4, ..., bodies * n)."""
    split = planar.to_plane(found.reshape(*found.shape[:-1], -1, markers))
    motion = planar.landmark_kinematics(*split)
    return planar.to_complex(motion.position), motion.angle


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
    return _smoothed(kalman, frames, *_filtered(kalman, signal))


def _filtered(kalman: Kalman, signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States (N, 4, C) before each sample of signals (N, C), and innovations (N, C)."""
    state = np.zeros((4, signal.shape[1]), signal.dtype)
    state[0] = signal[0]
    predicted = np.empty((len(signal), *state.shape), signal.dtype)
    innovations = np.empty_like(signal)
    for k, sample in enumerate(signal):
        predicted[k] = state
        innovations[k] = sample - state[0]
        state = kalman.transition @ (state + kalman.gain[:, None] * innovations[k])
    return predicted, innovations


def _smoothed(
    kalman: Kalman, frames: np.ndarray, predicted: np.ndarray, innovations: np.ndarray
) -> np.ndarray:
    found = np.moveaxis(predicted[frames], 1, 0)
    for k, column in enumerate(kalman.smoothing):
        found = found + column[:, None, None] * innovations[frames + k]
    return np.asarray(found)


def likely_kalman(
    signals: tuple[np.ndarray, ...], frames: np.ndarray, lag: int
) -> list[np.ndarray]:
    """
    Derivatives (4, M, C), per s, of signals (N, C) by the smoother that fits each of them best.

    That is the one of the likeliest density of the snap in the samples of `TUNED_ON`: in a steady
    state of unknown noise it is that of the least mean square of the innovations.
    """
    scale = float(RATE) ** np.arange(4)[:, None, None]
    learned = slice(*(round(t * RATE) for t in TUNED_ON))
    results = []
    for signal in signals:
        least = np.full(signal.shape[1], np.inf)
        result = np.empty((4, len(frames), signal.shape[1]), signal.dtype)
        for snap in _SNAP:
            kalman = make_kalman(float(snap), lag)
            predicted, innovations = _filtered(kalman, signal)
            square = np.mean(np.abs(innovations[learned]) ** 2, axis=0)
            better = square < least
            least[better] = square[better]
            part = predicted[..., better], innovations[:, better]
            result[..., better] = _smoothed(kalman, frames, *part)
        results.append(scale * result)
    return results


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
