"""Update what is known of the bodies from the frames of late."""

from collections import Counter

import numpy as np

from kinpole_ros.planar import procrustes_factors
from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.tracking.bodies import MIN_FITS, OUTLIER_SIGMAS, SETTLED_FRAMES, Bodies
from kinpole_ros.tracking.corrections import agreed
from kinpole_ros.tracking.fit import fit_markers
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.noise import correlated_noise, marker_variances, white_noise
from kinpole_ros.tracking.statistics import mean_square, medians, tame_part
from kinpole_ros.tracking.thresholds import ROUNDED

# Frames that noise is estimated from, and those for the misfit, which must follow faster.
NOISE_FRAMES, MISFIT_FRAMES = 512, 200
# The share of chi-squares that all but the worst 30% stay below, over their mean, within a tenth.
MISFIT_RATIO = 1.15
# A marker that did not fit in so many frames in a row sits at another place.
MOVED_FRAMES = 100
# A settled place is moved where residuals are off it by this share of the misfit on average.
CONTRADICTED = 0.25


def refit(bodies: Bodies, history: History) -> None:
    """Fit all frames of the history anew, as shapes or weights have changed."""
    before = history['angle'].copy()
    wrong = (history['information'] == 0).all(axis=1) & np.isfinite(before)
    fit = fit_markers(bodies, np.where(history['used'], history['markers'], np.nan))
    loose = (bodies.spread > bodies.loosest) & (fit.spread < bodies.loosest)
    known = np.isfinite(fit.angle) & ~loose
    with np.errstate(invalid='ignore'):
        whole = np.nan_to_num(np.rint((before - fit.angle) / (2 * np.pi)))
    # Next to half a turn it may lie on the other side by now: the whole turns stay what they are.
    history['angle'][...] = np.where(known, fit.angle + 2 * np.pi * whole, np.nan)
    history['position'][...] = np.where(known, fit.position, np.nan)
    history['residual'][...] = fit.residual
    held = known & ~wrong
    history['information'][...] = np.where(held, (fit.spread, fit.weight), 0.0).swapaxes(0, 1)


def learn(
    bodies: Bodies, history: History, window: int, given: float, counts: Counter[str]
) -> np.ndarray:
    """
    Update shapes, misfit, noise and weights; returns which bodies (B,) began anew.

    `window`, ns, is as long as that of the derivatives; `given`, m, is the noise if it was given.
    """
    anew = _begin_robustly(bodies, history, counts)
    moved = _move_markers(bodies, history)
    if anew.any() or moved:
        bodies.update()
        refit(bodies, history)
    if _update_shapes(bodies, history):
        bodies.update()
        refit(bodies, history)
    _update_misfit(bodies, history)
    _update_noise(bodies, history, window, given)
    if _update_weights(bodies, history):
        bodies.update()
        refit(bodies, history)
        _update_misfit(bodies, history)
        _update_noise(bodies, history, window, given)
    bodies.update()
    return anew


def _begin_robustly(bodies: Bodies, history: History, counts: Counter[str]) -> np.ndarray:
    """Begin bodies anew by what most of their first frames agree on, once there are enough."""
    anew = np.zeros(bodies.count, bool)
    fits = np.isfinite(history['angle']).sum(axis=0)
    due = ~bodies.begun & (fits >= MIN_FITS)
    bodies.begun |= due
    for b in np.flatnonzero(due).tolist():
        if bodies.given[b]:
            continue
        seen = np.isfinite(history['angle'][:, b])
        markers = np.where(history['used'][seen, b], history['markers'][seen, b], np.nan)
        found = agreed(markers, OUTLIER_SIGMAS / np.sqrt(MISFIT_RATIO), ROUNDED)
        if found is None:
            continue
        bodies.shape[b], markers, corrected = found
        counts.update(corrected)
        used, rows = ~np.isnan(markers), np.flatnonzero(seen)
        came = history['markers'][rows, b]
        history['markers'][rows, b] = np.where(used, markers, came)
        history['used'][rows, b] = used
        bodies.frames[b] = used.sum(axis=0)
        anew[b] = True
    return anew


def _move_markers(bodies: Bodies, history: History) -> bool:
    """Learn markers anew that did not fit for long; whether there were any."""
    rows = slice(-MOVED_FRAMES, None)
    if len(history) < MOVED_FRAMES:
        return False
    used = history['used'][rows]
    came = ~np.isnan(history['markers'][rows]) & np.isfinite(history['angle'][rows])[..., None]
    number = came.sum(axis=0)
    astray = (number >= 0.5 * MOVED_FRAMES) & ~used.any(axis=0) & (bodies.frames > 0)
    for b, k in zip(*astray.nonzero(), strict=True):
        at = np.flatnonzero(came[:, b, k])
        turn = np.exp(-1j * history['angle'][rows][at, b])
        places = (history['markers'][rows][at, b, k] - history['position'][rows][at, b]) * turn
        middle = np.median(places.real) + 1j * np.median(places.imag)
        near = np.abs(places - middle) < bodies.limit[b]
        if near.sum() < MIN_FITS:
            continue
        bodies.shape[b, k] = places[near].mean()
        bodies.frames[b, k] = near.sum()
        used[at[near], b, k] = True
    return bool(astray.any())


def _update_shapes(bodies: Bodies, history: History) -> bool:
    """Move places that are not settled yet, or refuted, by their mean residual."""
    known = np.isfinite(history['angle']) & (history['information'] > 0).all(axis=1)
    residual = np.where(known[..., None], history['residual'], np.nan)
    used = ~np.isnan(residual)
    number = used.sum(axis=0)
    settled = bodies.frames >= SETTLED_FRAMES
    new = history['used'].sum(axis=0)
    late = slice(-NOISE_FRAMES, None)
    seen = used[late].sum(axis=0)
    mean = np.where(used[late], residual[late], 0).sum(axis=0) / np.maximum(seen, 1)
    limit = CONTRADICTED * np.sqrt(np.maximum(bodies.misfit, ROUNDED**2 * bodies.spread))
    creeps = settled & (np.abs(mean) > limit[:, None]) & (seen >= NOISE_FRAMES // 2)
    every = np.where(used, residual, 0).sum(axis=0) / np.maximum(number, 1)
    step = np.where(creeps, mean, np.where(settled, 0, every))
    # A marker not seen before is at its place in the axes of its body.
    unknown = (bodies.frames == 0) & (bodies.known >= 2)[:, None]
    for b, k in zip(*unknown.nonzero(), strict=True):
        came = known[:, b] & ~np.isnan(history['markers'][:, b, k])
        if came.any():
            turn = np.exp(-1j * history['angle'][came, b])
            places = (history['markers'][came, b, k] - history['position'][came, b]) * turn
            bodies.shape[b, k] = places.mean()
            bodies.frames[b, k] = came.sum()
            history['used'][came, b, k] = True
            step[b, k] = 1e-300
    bodies.shape += step
    bodies.frames = np.where(settled, SETTLED_FRAMES, np.maximum(bodies.frames, number))
    bodies.frames = np.minimum(bodies.frames, SETTLED_FRAMES)
    return bool(step.any()) or bool((new != number).any() and not settled.all())


def _louder_left_out(bodies: Bodies, residual: Complex) -> Complex:
    """Residuals of the markers that are as noisy as the others of their body."""
    return np.where(bodies.relative > 1, complex(np.nan, np.nan), residual)


def freedom_of(bodies: Bodies, residual: Complex) -> Real:
    """Expected squares (N, B, n) of residuals, as of `Fit`."""
    seen = ~np.isnan(residual)
    if seen.all():
        return np.broadcast_to(bodies.grip.freedom, residual.shape)
    return procrustes_factors(bodies.shape, np.where(seen, bodies.weights, 0.0)).freedom


def _update_misfit(bodies: Bodies, history: History) -> None:
    """Estimate the variance of a coordinate of a marker about its place."""
    rows = slice(-MISFIT_FRAMES - 1, None)
    residual, markers = history['residual'][rows], history['markers'][rows]
    left = mean_square(_louder_left_out(bodies, residual), freedom_of(bodies, residual))[0]
    # A body at rest in a tracker that rounds seems to fit to the last digit.
    still = (np.isnan(markers[1:]) | (markers[1:] == markers[:-1])).all(axis=-1)
    left[1:][still] = np.nan
    number = np.count_nonzero(~np.isnan(left), axis=0)
    bodies.fits = np.maximum(bodies.fits, number)
    known = number > 0
    if known.any():
        bodies.misfit[known] = tame_part(left.T[known]) / MISFIT_RATIO


def _update_noise(bodies: Bodies, history: History, window: int, given: float) -> None:
    """Estimate the noise of a coordinate of a marker."""
    rows = slice(-NOISE_FRAMES - 2, None)
    residual = _louder_left_out(bodies, history['residual'][rows])
    freedom = freedom_of(bodies, history['residual'][rows])
    goes_on, time = history['goes_on'][rows], history['time'][rows]
    white, degrees = white_noise(residual, freedom, goes_on)
    bodies.white, bodies.degrees = white, degrees
    level = white
    bodies.lasting[:] = False
    if len(time) > 1:
        frames = window / max(float(np.median(np.diff(time))), 1.0)
        level, bodies.lasting = correlated_noise(residual, freedom, goes_on, frames, white)
    few = degrees < MIN_DEGREES
    level = np.where(few, np.sqrt(np.where(bodies.mature, bodies.misfit, np.nan)), level)
    if given > 0:
        level = np.full(bodies.count, given)
    farthest = np.nan_to_num(np.abs(history['markers'][rows])).max(axis=(0, 2))
    bodies.least_noise = np.maximum(ROUNDING * farthest, given)
    bodies.noise = np.maximum(level, ROUNDING * farthest)


# Variances are compared if residuals of one marker exceed the median of its body by this factor.
SUSPICIOUS = 1.4
# Fewer degrees of freedom tell no order of magnitude of the noise.
MIN_DEGREES = 6


def _update_weights(bodies: Bodies, history: History) -> bool:
    """Let markers count by their noise; whether weights have changed."""
    if bodies.width > 32 or len(history) < 64:
        return False
    rows = slice(-NOISE_FRAMES, None)
    residual, goes_on = history['residual'][rows], history['goes_on'][rows]
    changed = False
    squares = residual.real**2 + residual.imag**2
    seen = ~np.isnan(squares)
    total = np.where(seen, freedom_of(bodies, residual), 0).sum(axis=0)
    with np.errstate(divide='ignore', invalid='ignore'):
        left = np.where(seen, squares, 0).sum(axis=0) / np.where(total > 0, total, np.nan)
        number = (~np.isnan(left)).sum(axis=1)
        loud = (number > 2) & (np.fmax.reduce(left, axis=1) > SUSPICIOUS * medians(left))
    loud |= (bodies.relative > 1).any(axis=1)
    for b in np.flatnonzero(loud).tolist():
        relative, bodies.deviation[b] = marker_variances(
            residual[:, b], goes_on, bodies.shape[b], bodies.relative[b]
        )
        if (relative != bodies.relative[b]).any():
            bodies.relative[b] = relative
            changed = True
    return changed
