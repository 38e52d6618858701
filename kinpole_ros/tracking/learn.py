"""Learn shapes, noise and weights of the bodies from the history."""

from collections import Counter

import numpy as np

from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.planar._procrustes import procrustes_factors
from kinpole_ros.tracking.bodies import SETTLED_FRAMES, Bodies
from kinpole_ros.tracking.consensus import consensus_shape
from kinpole_ros.tracking.deformation import deformed_freedom
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.noise import (
    MAX_MARKERS,
    MIN_FRAMES,
    correlated_noise,
    marker_variances,
    white_noise,
)
from kinpole_ros.tracking.rejection import MOVED_FRAMES, OUTLIER_SIGMAS, is_unsteady
from kinpole_ros.tracking.statistics import (
    bulk_maximum,
    divided_differences,
    mean_square,
    median,
    medians,
)
from kinpole_ros.tracking.thresholds import MEMORY_FRAMES, MIN_DOF, MIN_SAMPLES, ROUNDED

# Frames for the misfit, which has to follow changes faster than the noise.
MISFIT_FRAMES = 200
# `bulk_maximum` is a 70% quantile, which is 1.08 to 1.22 times the mean of a chi-square.
MISFIT_RATIO = 1.15
# A settled place moves if the mean residual exceeds this share of the root of the misfit.
MAX_MEAN_RESIDUAL = 0.25
# Variances of single markers are estimated if the largest mean square exceeds the median so often.
MIN_SUSPICIOUS_RATIO = 1.4
# Poses for the scale of the residuals about the path of a body.
PATH_FRAMES = 256


def refit(bodies: Bodies, history: History) -> None:
    """Fit all frames of the history again, after shapes or weights have changed."""
    before = history['angle'].copy()
    left_out = (history['information'] == 0).all(axis=1) & np.isfinite(before)
    fit = bodies.fit(np.where(history['used'], history['markers'], np.nan))
    unsteady = is_unsteady(bodies.placement.spread, fit.spread, bodies.fitting.loosest)
    has_pose = np.isfinite(fit.angle) & ~unsteady
    with np.errstate(invalid='ignore'):
        turns = np.nan_to_num(np.rint((before - fit.angle) / (2 * np.pi)))
    # Near half a turn the new angle may have the other sign; the whole turns stay the same.
    history['angle'][...] = np.where(has_pose, fit.angle + 2 * np.pi * turns, np.nan)
    history['position'][...] = np.where(has_pose, fit.position, np.nan)
    history['residual'][...] = fit.residual
    is_used = has_pose & ~left_out
    history['information'][...] = np.where(is_used, (fit.spread, fit.weight), 0.0).swapaxes(0, 1)


def _count_turns(history: History, restarted: np.ndarray) -> None:
    """Count the whole turns of restarted bodies (B,) again, back from their newest poses."""
    for b in np.flatnonzero(restarted):
        rows = np.flatnonzero(np.isfinite(history['angle'][:, b]))
        angle, turns = history['angle'][rows, b], history['turns'][:, b]
        more = np.rint((np.unwrap(angle) - angle) / (2 * np.pi))
        turns[rows] = turns[rows[-1]] + more - more[-1]


def learn(
    bodies: Bodies, history: History, window: int, given: float
) -> tuple[Bodies, np.ndarray, np.ndarray, Counter[str]]:
    """
    Learn shapes, misfit, noise and weights, and fit the history again where these change.

    Parameters
    ----------
    bodies, history : Bodies, History
        What is known so far, and the frames to learn from.
    window : int
        Length of the window of the derivatives, ns.
    given : float
        The noise that the parameters give, m; 0 for none.

    Returns
    -------
    bodies : Bodies
        What is known now.
    restarted : (B,) bool
        Which bodies started again.
    moved : (B, n) bool
        Which markers are surely at other places than before.
    counts : Counter
        Numbers of corrected markers by kind.

    """
    bodies, restarted, counts = _restart_with_outliers(bodies, history)
    before = bodies.shape
    bodies, moved = _relearn_moved_markers(bodies, history)
    if restarted.any() or moved.any():
        refit(bodies, history)
        _count_turns(history, restarted)
    moved &= bodies.shape != before
    bodies, has_changed, contradicted = _update_shapes(bodies, history)
    if has_changed:
        refit(bodies, history)
    bodies = _update_noise(bodies, history, window, given)
    bodies, has_changed = _update_weights(bodies, history)
    if has_changed:
        refit(bodies, history)
        bodies = _update_noise(bodies, history, window, given)
    return bodies, restarted, moved | contradicted, counts


def forget_held_markers(
    bodies: Bodies, history: History, which: np.ndarray
) -> tuple[Bodies, np.ndarray]:
    """
    Learn the shapes of bodies again, without markers that are at one place in three frames or more.

    Such a marker was lost from the first frames on, and learned as one that stands still.

    Parameters
    ----------
    bodies, history : Bodies, History
        What is known so far, and the frames, where such markers are taken out.
    which : (B,) bool
        Bodies whose noise lets no marker repeat.

    Returns
    -------
    bodies : Bodies
        What is known now.
    lacking : (B,) bool
        Which bodies have less than two markers left.

    """
    markers = history['markers']
    held = np.zeros(markers.shape, bool)
    thrice = (markers[2:] == markers[1:-1]) & (markers[1:-1] == markers[:-2]) & which[:, None]
    for k in range(3):
        held[k : len(held) - 2 + k] |= thrice
    is_learned_so = 2 * held.sum(axis=0) > np.count_nonzero(~np.isnan(markers), axis=0)
    wrong = is_learned_so.any(axis=1)
    if not wrong.any():
        return bodies, wrong
    markers[held] = np.nan
    history['used'][held] = False
    # The places of the others were learned with a wrong one: they move again.
    frames = np.where(wrong[:, None], np.minimum(bodies.frames, 1), bodies.frames)
    bodies = bodies.change(frames=np.where(is_learned_so, 0, frames))
    refit(bodies, history)
    return bodies, wrong & (bodies.placement.learned_count < 2)


def _restart_with_outliers(
    bodies: Bodies, history: History
) -> tuple[Bodies, np.ndarray, Counter[str]]:
    """Start bodies again from the first frames that agree, if some of these have outliers."""
    restarted, counts = np.zeros(bodies.count, bool), Counter[str]()
    fits = np.isfinite(history['angle']).sum(axis=0)
    due = ~bodies.begun & (fits >= MIN_SAMPLES)
    shape, frames = bodies.shape.copy(), bodies.frames.copy()
    for b in np.flatnonzero(due).tolist():
        if bodies.given[b]:
            continue
        seen = np.isfinite(history['angle'][:, b])
        markers = np.where(history['used'][seen, b], history['markers'][seen, b], np.nan)
        consensus = consensus_shape(markers, OUTLIER_SIGMAS / np.sqrt(MISFIT_RATIO), ROUNDED)
        if consensus is None:
            continue
        shape[b], markers, corrected = consensus
        counts.update(corrected)
        used, rows = ~np.isnan(markers), np.flatnonzero(seen)
        original = history['markers'][rows, b]
        history['markers'][rows, b] = np.where(used, markers, original)
        history['used'][rows, b] = used
        frames[b] = used.sum(axis=0)
        restarted[b] = True
    if due.any():
        bodies = bodies.change(begun=bodies.begun | due, shape=shape, frames=frames)
    return bodies, restarted, counts


def _relearn_moved_markers(bodies: Bodies, history: History) -> tuple[Bodies, np.ndarray]:
    """Learn the places of markers again that did not fit for long; which (B, n) they are."""
    rows, none = slice(-MOVED_FRAMES, None), np.zeros(bodies.shape.shape, bool)
    if len(history) < MOVED_FRAMES:
        return bodies, none
    used = history['used'][rows]
    seen = ~np.isnan(history['markers'][rows]) & np.isfinite(history['angle'][rows])[..., None]
    moved = (seen.sum(axis=0) >= 0.5 * MOVED_FRAMES) & ~used.any(axis=0) & (bodies.frames > 0)
    if not moved.any():
        return bodies, none
    shape, frames = bodies.shape.copy(), bodies.frames.copy()
    for b, k in zip(*moved.nonzero(), strict=True):
        at = np.flatnonzero(seen[:, b, k])
        turn = np.exp(-1j * history['angle'][rows][at, b])
        local = (history['markers'][rows][at, b, k] - history['position'][rows][at, b]) * turn
        middle = np.median(local.real) + 1j * np.median(local.imag)
        near = np.abs(local - middle) < bodies.fitting.limit[b]
        if near.sum() < MIN_SAMPLES:
            continue
        shape[b, k] = local[near].mean()
        frames[b, k] = near.sum()
        used[at[near], b, k] = True
    return bodies.change(shape=shape, frames=frames), moved


def _update_shapes(bodies: Bodies, history: History) -> tuple[Bodies, bool, np.ndarray]:
    """
    Move places of markers by mean residuals.

    Return also whether shapes, or the used markers, changed, and which settled places (B, n) did.
    """
    has_pose = np.isfinite(history['angle']) & (history['information'] > 0).all(axis=1)
    residual = np.where(has_pose[..., None], history['residual'], np.nan)
    used = ~np.isnan(residual)
    count = used.sum(axis=0)
    mean = np.where(used, residual, 0).sum(axis=0) / np.maximum(count, 1)
    # A settled place moves only if recent residuals contradict it.
    is_settled = bodies.frames >= SETTLED_FRAMES
    recent = slice(-MEMORY_FRAMES, None)
    recent_count = used[recent].sum(axis=0)
    recent_mean = np.where(used[recent], residual[recent], 0).sum(axis=0)
    recent_mean = recent_mean / np.maximum(recent_count, 1)
    limit = MAX_MEAN_RESIDUAL * np.sqrt(
        np.maximum(bodies.misfit, ROUNDED**2 * bodies.placement.spread)
    )
    contradicted = np.abs(recent_mean) > limit[:, None]
    contradicted &= is_settled & (recent_count >= MEMORY_FRAMES // 2)
    step = np.where(contradicted, recent_mean, np.where(is_settled, 0, mean))
    # A new marker is at its mean place in the frame of its body.
    is_new = (bodies.frames == 0) & (bodies.placement.learned_count >= 2)[:, None]
    has_new, shape, frames = False, bodies.shape.copy(), bodies.frames.copy()
    for b, k in zip(*is_new.nonzero(), strict=True):
        seen = has_pose[:, b] & ~np.isnan(history['markers'][:, b, k])
        if seen.any():
            turn = np.exp(-1j * history['angle'][seen, b])
            local = (history['markers'][seen, b, k] - history['position'][seen, b]) * turn
            shape[b, k] = local.mean()
            frames[b, k] = seen.sum()
            history['used'][seen, b, k] = True
            step[b, k], has_new = 0.0, True
    # Frames have gained or lost a pose since, so other markers count.
    uses_changed = bool((history['used'].sum(axis=0) != count).any() and not is_settled.all())
    frames = np.minimum(np.maximum(frames, count), SETTLED_FRAMES)
    has_changed = has_new or bool(step.any()) or uses_changed
    bodies = bodies.change(shape=shape + step, frames=frames)
    return bodies, has_changed, contradicted


def _without_noisy(bodies: Bodies, residual: Complex) -> Complex:
    """Residuals, NaN for those of noisy markers (`relative` > 1)."""
    return np.where(bodies.relative > 1, complex(np.nan, np.nan), residual)


def freedom_of(bodies: Bodies, residual: Complex) -> Real:
    """Return the expected square of each residual (N, B, n) for unit variance of a coordinate."""
    seen, weights = ~np.isnan(residual), bodies.placement.weights
    freedom = np.broadcast_to(bodies.placement.factors.freedom, residual.shape)
    frames, lacking = (seen != (weights > 0)).any(axis=-1).nonzero()
    if len(frames):
        own = np.where(seen[frames, lacking], weights[lacking], 0.0)
        freedom = freedom.copy()
        freedom[frames, lacking] = procrustes_factors(bodies.shape[lacking], own).freedom
    return freedom


def find_deformed(bodies: Bodies, history: History, window: int) -> Bodies:
    """Find the bodies whose markers move against each other by more than their noise."""
    rows = slice(-MEMORY_FRAMES - 2, None)
    time, residual = history['time'][rows], history['residual'][rows]
    interval = median(np.diff(time)) if len(time) > 1 else window / 2
    free = freedom_of(bodies, residual).sum(axis=-1)
    noise, half = np.fmax(bodies.noise, bodies.white), round(window / 2 / max(interval, 1.0))
    freedom, factor = deformed_freedom(residual, free, noise, bodies.degrees, half)
    return bodies.change(freedom=freedom, hidden_factor=factor)


def _update_misfit(bodies: Bodies, history: History) -> Bodies:
    """Estimate the misfit: the variance of a marker about its place, per axis."""
    rows = slice(-MISFIT_FRAMES - 1, None)
    residual, markers = history['residual'][rows], history['markers'][rows]
    squares = mean_square(_without_noisy(bodies, residual), freedom_of(bodies, residual))[0]
    # A body at rest has the same rounded coordinates in every frame, which show no misfit.
    at_rest = (np.isnan(markers[1:]) | (markers[1:] == markers[:-1])).all(axis=-1)
    squares[1:][at_rest] = np.nan
    count = np.count_nonzero(~np.isnan(squares), axis=0)
    misfit, is_measured = bodies.misfit.copy(), count > 0
    if is_measured.any():
        misfit[is_measured] = bulk_maximum(squares.T[is_measured]) / MISFIT_RATIO
    return bodies.change(fits=np.maximum(bodies.fits, count), misfit=misfit)


def _update_noise(bodies: Bodies, history: History, window: int, given: float) -> Bodies:
    """Estimate the misfit, and the noise of a coordinate of a marker."""
    # The misfit stands for the noise from the update on after which it is known.
    was_mature, bodies = bodies.fitting.mature, _update_misfit(bodies, history)
    rows = slice(-MEMORY_FRAMES - 2, None)
    residual = _without_noisy(bodies, history['residual'][rows])
    freedom = freedom_of(bodies, history['residual'][rows])
    goes_on, time = history['goes_on'][rows], history['time'][rows]
    white, degrees = white_noise(residual, freedom, goes_on)
    noise, lasting = white, np.zeros(bodies.count, bool)
    if len(time) > 1:
        frames = window / max(median(np.diff(time)), 1.0)
        noise, lasting = correlated_noise(residual, freedom, goes_on, frames, white)
    misfit = np.sqrt(np.where(was_mature, bodies.misfit, np.nan))
    noise = np.where(degrees < MIN_DOF, misfit, noise)
    if given > 0:
        noise = np.full(bodies.count, given)
    farthest = np.nan_to_num(np.abs(history['markers'][rows])).max(axis=(0, 2))
    return bodies.change(
        noise=np.maximum(noise, ROUNDING * farthest),
        white=white,
        degrees=degrees,
        lasting=lasting,
        least_noise=np.maximum(ROUNDING * farthest, given),
    )


def _update_weights(bodies: Bodies, history: History) -> tuple[Bodies, bool]:
    """Weight markers by their noise; whether weights have changed."""
    if bodies.width > MAX_MARKERS or len(history) < MIN_FRAMES:
        return bodies, False
    rows = slice(-MEMORY_FRAMES, None)
    residual, goes_on = history['residual'][rows], history['goes_on'][rows]
    squares = residual.real**2 + residual.imag**2
    seen = ~np.isnan(squares)
    expected = np.where(seen, freedom_of(bodies, residual), 0).sum(axis=0)
    with np.errstate(divide='ignore', invalid='ignore'):
        mean = np.where(seen, squares, 0).sum(axis=0) / np.where(expected > 0, expected, np.nan)
        count = (~np.isnan(mean)).sum(axis=1)
        largest = np.fmax.reduce(mean, axis=1)
        suspicious = (count > 2) & (largest > MIN_SUSPICIOUS_RATIO * medians(mean))
    suspicious |= (bodies.relative > 1).any(axis=1)
    relative, deviation = bodies.relative.copy(), bodies.deviation.copy()
    for b in np.flatnonzero(suspicious).tolist():
        relative[b], deviation[b] = marker_variances(
            residual[:, b], goes_on, bodies.shape[b], bodies.relative[b], bodies.deviation[b]
        )
    bodies = bodies.change(deviation=deviation)
    has_changed = bool((relative != bodies.relative).any())
    return bodies.change(relative=relative) if has_changed else bodies, has_changed


def path_scale(history: History) -> Real:
    """
    Return the standard deviations (2, B) of angles, rad, and positions, m, about their cubics.

    A tracker that confuses two bodies, or sees one mirrored in a window, gives markers that fit the
    shape at a wrong place, for one to three frames. Such poses are far from the cubic through the
    two poses before and the two after them. Infinite with fewer than MIN_SAMPLES poses.
    """
    rows = slice(-PATH_FRAMES, None)
    time = history['time'][rows]
    has_pose = history['information'][rows, 0] > 0
    if len(time) < MIN_SAMPLES + 4:
        return np.full((2, has_pose.shape[1]), np.inf)
    angle = history['angle'][rows] + 2 * np.pi * history['turns'][rows]
    poses = np.stack((angle + 0j, history['position'][rows]), axis=1)
    poses = np.where(has_pose[:, None], poses, np.nan)
    off = np.abs(divided_differences((time - time[0]) * 1e-9, poses, 4)).reshape(
        -1, 2 * len(angle[0])
    )
    scale = np.where(np.isfinite(off).sum(axis=0) >= MIN_SAMPLES, 1.4826 * medians(off.T), np.inf)
    return scale.reshape(2, -1)
