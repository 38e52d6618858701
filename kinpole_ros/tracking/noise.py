"""
Noise of the markers, from the residuals of rigid fits, and of single markers over the others.

Residuals are noise and whatever else makes a body look not rigid: a lens, soft tissue, a shape not
yet known well. That part changes slowly. So each residual is compared with the mean of those before
and after it, which white noise survives. Noise that is correlated in time is seen in the means of
blocks of frames (the Hadamard variance, Baugh 1971).
"""

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.statistics import (
    OUTLIER_RATIO,
    OUTLIER_SHARE,
    mean_square,
    share_of_lowest,
    tame_part,
)

# A variance counts as larger beyond this many standard deviations of it.
SIGMAS = 4.0
# Correlated noise is measured over blocks, this many per window, of up to twice so many frames.
BLOCKS, LONGEST_HALF = 12, 8
# Noise that grows by this factor from half a block to a block would grow beyond it.
GROWTH = 3.0
# A marker whose variance exceeds that of the others by these factors counts for less: from frame to
# frame, and over blocks of BLOCK frames. It counts for less until the factor is below the last.
LOUDER, LOUDER_OVER_BLOCKS, NO_LOUDER = 2.0, 4.0, 1.5
BLOCK = 8
# Of this many markers one may count for less: if more disagree, they are of several links.
MARKERS_PER_LOUD = 4
# Larger bodies are not spoiled by one marker.
MOST_MARKERS = 32
# Weights are kept while the variance changes by less than this factor.
SAME = 1.5
# Another choice of loud markers must leave so many times as much, or either may be loud.
CLEAR = 2.0
# Variances below this share of the square of the size are rounding.
TINY = 1e-12
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
    left = mean_square(residual, freedom)[0]
    bend = residual[middle] - (residual[before] + residual[after]) / 2
    expected = freedom[middle] + (freedom[before] + freedom[after]) / 4
    squares, degrees = mean_square(bend, expected)
    known = ~np.isnan(squares)
    number = known.sum(axis=0)
    degrees = np.where(known, degrees, 0).sum(axis=0) / np.maximum(number, 1) / 1.5
    # An outlier spoils three comparisons, so frames are told apart by their own residuals.
    largest = np.maximum(left[middle], np.maximum(left[before], left[after]))
    usual = tame_part(left[middle].T)
    kept = np.sort(np.where(largest > OUTLIER_RATIO * usual, np.nan, squares), axis=0)
    counts = (~np.isnan(kept)).sum(axis=0)
    lowest = np.ceil(counts * (1 - OUTLIER_SHARE))
    total = np.where(np.arange(len(kept))[:, None] < lowest, kept, 0.0).sum(axis=0)
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
    bodies = residual.shape[1]
    length = 2 * half
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    ends = np.append(np.flatnonzero(~goes_on[1:]) + 1, len(residual))
    begin = 0
    for end in ends.tolist():
        count = (end - begin) // length * length
        if count:
            part = slice(begin, begin + count)
            runs = np.ones(count // half, bool)
            runs[0] = False
            parts.append((residual[part], freedom[part], runs))
        begin = end
    if not parts:
        return np.full(bodies, np.nan), np.full(bodies, np.nan), np.zeros(bodies)
    values, freedoms, runs = (np.concatenate(part) for part in zip(*parts, strict=True))
    found = []
    for size in (half, 2):
        values, freedoms = (
            part.reshape(-1, size, *part.shape[1:]).mean(axis=1) for part in (values, freedoms)
        )
        values = np.sqrt(size) * values
        found.append(white_noise(values, freedoms, runs))
        runs = runs[::2]
    return found[0][0], found[1][0], found[1][1]


def correlated_noise(
    residual: Complex, freedom: Real, goes_on: np.ndarray, frames: float, white: Real
) -> tuple[Real, np.ndarray]:
    """
    Estimate the noise as it counts in a window of so many `frames`, given the `white` noise (B,).

    Returns the deviation (B,), m, and where (B,) noise grows with the length of blocks so that it
    may be more.
    """
    half = min(round(frames / BLOCKS / 2), LONGEST_HALF)
    if half < 1:
        return white, np.zeros(len(white), bool)
    of_halves, of_blocks, degrees = noise_over_blocks(residual, freedom, goes_on, half)
    sure = 1 - SIGMAS / np.sqrt(2 * np.maximum(degrees, 1.0))
    with np.errstate(invalid='ignore'):
        lasts = of_blocks * sure > white
        return np.where(lasts, of_blocks, white), lasts & (of_blocks > GROWTH * of_halves)


def marker_variances(
    residual: Complex, goes_on: np.ndarray, shape: Complex, relative: Real
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
    relative : array, shape (n,)
        The ratios up to now.

    Returns
    -------
    array, shape (n,)
        The ratios, 1 for markers that are not louder than the others.
    array, shape (n,), m
        Standard deviations of the louder markers, 0 for the others.

    """
    seen = (~np.isnan(residual)).sum(axis=0) >= MIN_FRAMES // 2
    found, deviation = np.ones(len(seen)), np.zeros(len(seen))
    if seen.sum() < 3 or len(residual) < MIN_FRAMES:
        return relative, deviation
    bend = residual[1:-1] - (residual[:-2] + residual[2:]) / 2
    bend[~(goes_on[1:-1] & goes_on[2:])] = complex(np.nan, np.nan)
    for kind, louder in ((bend, LOUDER), (_block_means(residual), LOUDER_OVER_BLOCKS)):
        components = variance_components(kind[:, seen], shape[seen])
        each = np.array([v / np.median(np.delete(components, k)) for k, v in enumerate(components)])
        least = np.where(relative[seen] > 1, NO_LOUDER, louder)
        bad = np.flatnonzero(seen)[each > least].tolist()
        if bad and not _is_clear(kind, shape, seen, bad):
            continue
        found[seen] = np.maximum(found[seen], np.where(each > least, each, 1.0))
    loud = found > 1
    if loud.sum() > max(1, seen.sum() // MARKERS_PER_LOUD):
        # They are of several links.
        return np.ones(len(seen)), deviation
    same = (relative > 1) & loud & (np.abs(np.log(found / relative)) < np.log(SAME))
    found = np.where(same, relative, found)
    if loud.any():
        components = variance_components(residual[:, seen], shape[seen])
        deviation[seen] = np.sqrt(np.where(loud[seen], components, 0.0))
    return found, deviation


def variance_components(values: Complex, shape: Complex, rounds: int = 8) -> Real:
    """
    Variances (n,) of markers, m^2 per axis, from small displacements `values` (N, n), m.

    Each round fits shift and turn with the weights of the round before and divides the squares of
    what is left by the redundancy of each marker (Foerstner 1979).
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
        left = np.where(seen, off - 1j * turn * arm, 0)
        redundancy = np.where(seen, 2 - weight * (2 / total + np.abs(arm) ** 2 / spread), 0)
        new = (np.abs(left) ** 2).sum(axis=0) / np.maximum(redundancy.sum(axis=0), 1e-9)
        # Differences below rounding tell nothing.
        new += TINY * np.abs(shape - shape.mean()).max() ** 2
        variance = np.clip(new, 1e-3 * np.median(new), 1e8 * np.median(new))
    return variance


def _block_means(residual: Complex) -> Complex:
    """Means (N / BLOCK, n) over blocks, scaled so that white noise has that of single frames."""
    count = len(residual) // BLOCK
    parts = residual[len(residual) - count * BLOCK :].reshape(count, BLOCK, -1)
    seen = (~np.isnan(parts)).sum(axis=1)
    total = np.where(np.isnan(parts), 0, parts).sum(axis=1)
    enough = seen > BLOCK // 2
    return np.where(enough, total / np.sqrt(np.maximum(seen, 1)), complex(np.nan, np.nan))


def _is_clear(kind: Complex, shape: Complex, seen: np.ndarray, bad: list[int]) -> bool:
    """Whether no other marker might be meant in place of one of these."""
    good = seen.copy()
    good[bad] = False
    left = _pooled(kind, shape, good)[0]
    for k in bad:
        for other in np.flatnonzero(good):
            swapped = good.copy()
            swapped[k], swapped[other] = True, False
            if _pooled(kind, shape, swapped)[0] < CLEAR * left:
                return False
    return True


def _pooled(
    kind: Complex, shape: Complex, rest: np.ndarray, k: int = 0
) -> tuple[float, float, Complex, Real]:
    """
    Variance, per axis, of the markers `rest` (n,) about fits to them alone, and its degrees.

    Also what marker `k` is off these fits (T,), and the variance of where they have it over that of
    a coordinate, of both axes.
    """
    seen, mean, middle, arms, spread, turn, about = _fit(kind, shape, rest)
    left = np.where(seen, about - 1j * turn[:, None] * arms, 0)
    total = seen.sum(axis=1)
    enough = total >= 2
    degrees = float((2 * total[enough] - 3).sum())
    squares = float((left.real**2 + left.imag**2)[enough].sum())
    arm = shape[k] - middle
    off = kind[:, k] - mean - 1j * turn * arm
    lever = 2 / np.maximum(total, 1) + np.abs(arm) ** 2 / spread
    variance = squares / degrees if degrees > 0 else np.inf
    # Of several markers, wherever they are seen.
    variance += TINY * float(spread[np.isfinite(spread)].max(initial=0.0))
    return variance, degrees, np.where(enough, off, np.nan), lever


def _fit(
    values: Complex, shape: Complex, rest: np.ndarray
) -> tuple[np.ndarray, Complex, Complex, Complex, Real, Real, Complex]:
    """
    Small shifts and turns (T,) of a body that fit what its markers `rest` are off (T, n) best.

    Returns where they are seen (T, n), the shifts, the means (T,) of their places, their arms from
    these (T, n), the sums of the squares of those, the turns, and what the shifts leave (T, n).
    """
    seen = ~np.isnan(values) & rest
    total = np.maximum(seen.sum(axis=1), 1)
    mean = np.where(seen, values, 0).sum(axis=1) / total
    middle = np.where(seen, shape, 0).sum(axis=1) / total
    arms = np.where(seen, shape - middle[:, None], 0)
    about = np.where(seen, values - mean[:, None], 0)
    spread = (arms.real**2 + arms.imag**2).sum(axis=1)
    spread = np.where(spread > 0, spread, np.inf)
    # They are small: a turn adds what is linear in it.
    turn = (arms.conj() * about).imag.sum(axis=1) / spread
    return seen, mean, middle, arms, spread, turn, about
