"""
Noise of all markers of a body, and of single markers that are noisier, from rigid fits.

Residuals are noise, plus whatever makes a body look not rigid: a lens, soft tissue, a shape that is
not well known yet. That part changes slowly. So each residual is compared with the mean of its two
neighbors. Noise that is correlated in time is seen in the means of blocks of frames (the Hadamard
variance, Baugh 1971).
"""

import numpy as np

from kinpole_ros.planar._plane import ROUNDING, Complex, Real
from kinpole_ros.tracking.rejection import (
    MAX_REPEAT_CHANCE,
    MAY_REPEAT,
    NO_MARKER_REPEATS,
    NO_POSE_REPEATS,
)
from kinpole_ros.tracking.statistics import (
    OUTLIER_RATIO,
    OUTLIER_SHARE,
    bulk_maximum,
    mean_square,
    share_of_lowest,
)
from kinpole_ros.tracking.thresholds import N_SIGMA

# Blocks per window for correlated noise, and the most frames of half a block.
BLOCKS, LONGEST_HALF = 12, 8
# Deviations that grow by this factor from half a block to a block are those of slow motion of the
# markers, and grow further; those of a random walk grow by 2.
GROWTH = 3.0
# A marker is down-weighted if its variance exceeds that of the others by this factor from frame to
# frame, or by the second over blocks of so many frames, until the ratio is below the third.
RATIO_ON, BLOCK_RATIO_ON, RATIO_OFF = 2.0, 4.0, 1.5
BLOCK = 8
# One in so many markers may be down-weighted at most: if more disagree, they are on several links.
MARKERS_PER_NOISY = 4
# Bodies with more markers are not weighted: one of them hardly matters.
MAX_MARKERS = 32
# Weights are kept while the variance changes by less than this factor.
MAX_WEIGHT_CHANGE = 1.5
# Exchanging a noisy marker for a good one must leave so many times the residual variance.
MIN_CONTRAST = 2.0
# Variances below this share of the squared size are rounding.
ROUNDED_SQUARE = 1e-12
# Fewest frames for the noise of a single marker.
MIN_FRAMES = 64


def white_noise(residual: Complex, freedom: Real, goes_on: np.ndarray) -> tuple[Real, Real]:
    """
    Estimate the noise that is independent from frame to frame.

    Parameters
    ----------
    residual, freedom : array, shape (N, B, n)
        Residuals, complex, m, NaN for none, and the expected square of each over the variance of
        one coordinate, as of `planar.Fit`.
    goes_on : array, shape (N,), bool
        False for a frame that follows a gap.

    Returns
    -------
    array, shape (B,), m
        Standard deviation of a coordinate of a marker; NaN if not known.
    array, shape (B,)
        Its degrees of freedom.

    """
    bodies = residual.shape[1]
    middle = np.flatnonzero(goes_on[1:-1] & goes_on[2:]) + 1
    if not len(middle):
        return np.full(bodies, np.nan), np.zeros(bodies)
    before, after = middle - 1, middle + 1
    own_squares = mean_square(residual, freedom)[0]
    difference = residual[middle] - (residual[before] + residual[after]) / 2
    expected = freedom[middle] + (freedom[before] + freedom[after]) / 4
    squares, degrees = mean_square(difference, expected)
    usable = ~np.isnan(squares)
    count = usable.sum(axis=0)
    degrees = np.where(usable, degrees, 0).sum(axis=0) / np.maximum(count, 1) / 1.5
    # An outlier spoils the three differences it is in, so it is found by its own residuals.
    largest = np.maximum(own_squares[middle], np.maximum(own_squares[before], own_squares[after]))
    limit = OUTLIER_RATIO * bulk_maximum(own_squares[middle].T)
    ranked = np.sort(np.where(largest > limit, np.nan, squares), axis=0)
    counts = (~np.isnan(ranked)).sum(axis=0)
    lowest = np.ceil(counts * (1 - OUTLIER_SHARE))
    total = np.where(np.arange(len(ranked))[:, None] < lowest, ranked, 0.0).sum(axis=0)
    share = np.array([share_of_lowest(float(f)) for f in np.round(np.maximum(degrees, 0.1), 1)])
    with np.errstate(divide='ignore', invalid='ignore'):
        level = np.sqrt(np.where(counts > 0, total / lowest / share, np.nan))
    return level, counts * degrees / 2


def noise_over_blocks(
    residual: Complex, freedom: Real, goes_on: np.ndarray, half: int
) -> tuple[Real, Real, Real]:
    """
    Estimate the noise of means over half blocks of `half` frames, and over blocks.

    Arguments are as for `white_noise`. Returns the deviations of both, scaled so that white noise
    has that of single frames, and the degrees of freedom of the second.
    """
    rows = slice(len(residual) % (2 * half), None)
    values, freedoms, block_goes_on = residual[rows], freedom[rows], goes_on[rows]
    noises = []
    for size in (half, 2):
        values, freedoms = (
            part.reshape(-1, size, *part.shape[1:]).mean(axis=1) for part in (values, freedoms)
        )
        values = np.sqrt(size) * values
        block_goes_on = block_goes_on.reshape(-1, size)
        values[~block_goes_on[:, 1:].all(axis=1)] = np.nan
        block_goes_on = block_goes_on[:, 0]
        noises.append(white_noise(values, freedoms, block_goes_on))
    return noises[0][0], noises[1][0], noises[1][1]


def correlated_noise(
    residual: Complex, freedom: Real, goes_on: np.ndarray, frames: float, white: Real
) -> tuple[Real, np.ndarray]:
    """
    Estimate the noise that matters in a window of so many frames.

    Parameters
    ----------
    residual, freedom, goes_on
        As for `white_noise`.
    frames : float
        Number of frames of a window.
    white : (B,) float
        The noise that is independent from frame to frame, m.

    Returns
    -------
    (B,) float
        Standard deviation of a coordinate of a marker, m.
    (B,) bool
        Whether the noise still grows with the length of the blocks, and may be larger.

    """
    half = min(round(frames / BLOCKS / 2), LONGEST_HALF)
    if half < 1:
        return white, np.zeros(len(white), bool)
    of_halves, of_blocks, degrees = noise_over_blocks(residual, freedom, goes_on, half)
    # Negative with few degrees: then nothing is found to be correlated.
    lower_bound = 1 - N_SIGMA / np.sqrt(2 * np.maximum(degrees, 1.0))
    with np.errstate(invalid='ignore'):
        is_correlated = of_blocks * lower_bound > white
        grows = is_correlated & (of_blocks > GROWTH * of_halves)
    return np.where(is_correlated, of_blocks, white), grows


def marker_variances(
    residual: Complex, goes_on: np.ndarray, shape: Complex, relative: Real, deviation: Real
) -> tuple[Real, Real]:
    """
    Estimate the variance of each marker of one body over that of the others.

    Variance components by the estimator of Foerstner (1979), one body at a time, of residuals from
    frame to frame and over blocks.

    Parameters
    ----------
    residual : array, shape (N, n), complex, m
        Residuals of fits, NaN for none.
    goes_on : array, shape (N,), bool
        False for a frame that follows a gap.
    shape : array, shape (n,), complex, m
        Places of the markers.
    relative, deviation : array, shape (n,)
        The ratios and the deviations, m, so far. They stay where too few markers are seen.

    Returns
    -------
    array, shape (n,)
        The ratios, 1 for markers that are not noisier than the others.
    array, shape (n,), m
        Standard deviations of the noisier markers, 0 for the others.

    """
    seen = (~np.isnan(residual)).sum(axis=0) >= MIN_FRAMES // 2
    if seen.sum() < 3 or len(residual) < MIN_FRAMES:
        return relative, deviation
    ratios, deviation = np.ones(len(seen)), np.zeros(len(seen))
    difference = residual[1:-1] - (residual[:-2] + residual[2:]) / 2
    difference[~(goes_on[1:-1] & goes_on[2:])] = complex(np.nan, np.nan)
    for values, limit in ((difference, RATIO_ON), (_block_means(residual), BLOCK_RATIO_ON)):
        components = variance_components(values[:, seen], shape[seen])
        new = np.array([v / np.median(np.delete(components, k)) for k, v in enumerate(components)])
        is_noisy = new > np.where(relative[seen] > 1, RATIO_OFF, limit)
        noisy = np.flatnonzero(seen)[is_noisy].tolist()
        if noisy and not _is_unambiguous(values, shape, seen, noisy):
            # Another marker may be the noisy one.
            continue
        ratios[seen] = np.maximum(ratios[seen], np.where(is_noisy, new, 1.0))
    is_noisy = ratios > 1
    if is_noisy.sum() > max(1, seen.sum() // MARKERS_PER_NOISY):
        # The markers are on several links.
        return np.ones(len(seen)), deviation
    change = np.abs(np.log(ratios / relative))
    keeps = (relative > 1) & is_noisy & (change < np.log(MAX_WEIGHT_CHANGE))
    ratios = np.where(keeps, relative, ratios)
    if is_noisy.any():
        components = variance_components(residual[:, seen], shape[seen])
        deviation[seen] = np.sqrt(np.where(is_noisy[seen], components, 0.0))
    return ratios, deviation


def variance_components(values: Complex, shape: Complex, rounds: int = 8) -> Real:
    """
    Estimate variances (n,) of markers, m^2 per axis, from small displacements `values` (N, n), m.

    Each round fits a shift and a turn with the weights of the round before, and divides the squared
    residuals by the redundancy of each marker (Foerstner 1979).
    """
    seen = ~np.isnan(values)
    values = np.where(seen, values, 0)
    variance = np.ones(values.shape[1])
    for _ in range(rounds):
        weight = seen / variance
        total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
        arm = np.where(seen, shape - (weight * shape).sum(axis=1, keepdims=True) / total, 0)
        off = values - (weight * values).sum(axis=1, keepdims=True) / total
        spread = np.maximum((weight * np.abs(arm) ** 2).sum(axis=1, keepdims=True), 1e-300)
        turn = (weight * (arm.conj() * off).imag).sum(axis=1, keepdims=True) / spread
        residual = np.where(seen, off - 1j * turn * arm, 0)
        redundancy = np.where(seen, 2 - weight * (2 / total + np.abs(arm) ** 2 / spread), 0)
        new = (np.abs(residual) ** 2).sum(axis=0) / np.maximum(redundancy.sum(axis=0), 1e-9)
        new += ROUNDED_SQUARE * np.abs(shape - shape.mean()).max() ** 2
        variance = np.clip(new, 1e-3 * np.median(new), 1e8 * np.median(new))
    return variance


def _block_means(residual: Complex) -> Complex:
    """Means (N / BLOCK, n) over blocks, scaled so that white noise has that of single frames."""
    count = len(residual) // BLOCK
    blocks = residual[len(residual) - count * BLOCK :].reshape(count, BLOCK, -1)
    seen = (~np.isnan(blocks)).sum(axis=1)
    total = np.where(np.isnan(blocks), 0, blocks).sum(axis=1)
    enough = seen > BLOCK // 2
    return np.where(enough, total / np.sqrt(np.maximum(seen, 1)), complex(np.nan, np.nan))


def _is_unambiguous(values: Complex, shape: Complex, seen: np.ndarray, noisy: list[int]) -> bool:
    """Whether exchanging a noisy marker for a good one always fits much worse."""
    good = seen.copy()
    good[noisy] = False
    limit = MIN_CONTRAST * _pooled_variance(values, shape, good)
    for k in noisy:
        for exchanged in np.flatnonzero(good):
            choice = good.copy()
            choice[k], choice[exchanged] = True, False
            if _pooled_variance(values, shape, choice) < limit:
                return False
    return True


def _pooled_variance(values: Complex, shape: Complex, which: np.ndarray) -> float:
    """Variance, m^2 per axis, of some markers (n,) about small shifts and turns of their own."""
    seen = ~np.isnan(values) & which
    count = seen.sum(axis=1)
    divisor = np.maximum(count, 1)
    mean = np.where(seen, values, 0).sum(axis=1) / divisor
    middle = np.where(seen, shape, 0).sum(axis=1) / divisor
    arms = np.where(seen, shape - middle[:, None], 0)
    shifted = np.where(seen, values - mean[:, None], 0)
    spread = (arms.real**2 + arms.imag**2).sum(axis=1)
    spread = np.where(spread > 0, spread, np.inf)
    turn = (arms.conj() * shifted).imag.sum(axis=1) / spread
    residual = np.where(seen, shifted - 1j * turn[:, None] * arms, 0)
    enough = count >= 2
    degrees = float((2 * count[enough] - 3).sum())
    squares = float((residual.real**2 + residual.imag**2)[enough].sum())
    variance = squares / degrees if degrees > 0 else np.inf
    return variance + ROUNDED_SQUARE * float(spread[np.isfinite(spread)].max(initial=0.0))


def find_repetition(markers: Complex, white: Real, degrees: int | None) -> np.ndarray:
    """
    Return how markers of bodies (B,) may repeat, as their noise says: REPETITIONS of codes.h.

    Two normal deviates are rounded to one number with the probability q / (2 sqrt(pi) sigma), where
    q is the resolution. That is the smallest distance between two different coordinates.

    Parameters
    ----------
    markers : (N, B, n) complex
        Markers in the plane, m, NaN for those not seen.
    white : (B,) float
        Noise of a coordinate that is independent from frame to frame, m, NaN if unknown.
    degrees : int or None
        Degrees of freedom of the markers of a body; None for two of each marker.

    """
    markers = markers[..., :MAX_MARKERS]
    chance, of_marker = np.ones(len(white)), np.ones(len(white))
    for b in np.flatnonzero(white > 0).tolist():
        own = markers[:, b]
        seen = np.count_nonzero(~np.isnan(own), axis=0)
        if not (seen > 1).any():
            continue
        farthest = float(np.nanmax(np.abs(own)))
        steps = np.concatenate([np.diff(np.sort(part.ravel())) for part in (own.real, own.imag)])
        steps = steps[steps > ROUNDING * farthest]
        if len(steps):
            once = min(float(steps.min()) / (2 * np.sqrt(np.pi) * white[b]), 1.0)
            chance[b] = once ** (degrees or 2 * np.count_nonzero(seen))
            of_marker[b] = once**4
    repetition = np.where(chance < MAX_REPEAT_CHANCE, NO_POSE_REPEATS, MAY_REPEAT)
    if degrees is None:
        repetition[of_marker < MAX_REPEAT_CHANCE] = NO_MARKER_REPEATS
    return repetition.astype(np.uint8)
