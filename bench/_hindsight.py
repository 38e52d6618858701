"""
Our errors beside those of the best fixed window and degree, known only in hindsight.

A fixed local polynomial on the same fitted poses, with the same window and lag at its disposal, is
run in all its settings; for each quantity of each case the one that turns out best is the bound.
"""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from bench._polynomial import derivative_weights
from bench._record import (
    LAG,
    POLES,
    QUANTITIES,
    RATE,
    RATES,
    WINDOW,
    Figures,
    Recording,
    fit_poses,
    quantities,
    rms,
)

# Motion, noise level and quantity.
Key = tuple[str, float, str]
# Highest derivative in each quantity.
ORDER = dict(zip(QUANTITIES, (1, 2, 3, 1, 2, 3, 3), strict=True))
# Fewer determined frames than this are no basis for a figure.
FEWEST = 50
# Chi-square of 2 is exponential: below -2 ln(1 - p) lies the share p.
LEVELS = (0.5, 0.9, 0.95, 0.99)
# Of the bound on marking bad rates: samples and degree of the polynomials by which two motions may
# differ, and the share of false alarms.
_DIFFERENCE, _FALSE = (41, 9), 0.02
# An error below this share of the scale is rounding.
_EXACT = 1e-9


class Best(NamedTuple):
    """The best fixed setting of one cell: pooled RMS, window and degree, RMS by seed (seeds,)."""

    error: float
    samples: int
    degree: int
    seeds: np.ndarray


def settings(lag: float = LAG, rate: float = RATE) -> list[tuple[int, int]]:
    """All pairs (samples, degree): windows to the longest in steps of a fifth, degrees 1 to 12."""
    most = round(WINDOW * rate) + 1
    lengths = [5]
    while lengths[-1] < most:
        lengths.append(min(most, max(lengths[-1] + 2, round(lengths[-1] * 1.2) // 2 * 2 + 1)))
    return [(n, d) for n in lengths for d in range(1, 13) if d < n]


def fixed_weights(
    samples: int, degree: int, lag: float = LAG, rate: float = RATE
) -> tuple[np.ndarray, int]:
    """Weights (4, samples) for order 0 to 3 and how many samples lie ahead of the instant."""
    ahead = min((samples - 1) // 2, round(lag * rate))
    t = (np.arange(samples) - (samples - 1 - ahead)) / rate
    return derivative_weights(t, degree, 3), ahead


def apply_weights(
    weights: np.ndarray, ahead: int, frames: np.ndarray, *signals: np.ndarray, stride: int = 1
) -> list[np.ndarray]:
    """Derivatives (4, M, C) of signals (N, C) at the frames (M,)."""
    samples = weights.shape[1]
    offsets = stride * (np.arange(samples) - (samples - 1 - ahead))
    # About each instant's own value, which keeps the digits of far-off coordinates.
    found = []
    for signal in signals:
        here = signal[frames]
        total = np.zeros((len(weights), *here.shape), here.dtype)
        for k, offset in enumerate(offsets):
            total += weights[:, k, None, None] * (signal[frames + offset] - here)
        total[0] += here
        found.append(total)
    return found


def errors_of(
    recording: Recording, frames: np.ndarray, position: np.ndarray, angle: np.ndarray
) -> dict[str, np.ndarray]:
    """Errors (M, C) of the quantities that follow from derivatives (4, M, C)."""
    with np.errstate(all='ignore'):
        found = quantities(position, angle)
        return {name: np.abs(found[name] - recording.truth[name][frames]) for name in QUANTITIES}


def own_errors(recording: Recording, ours: Figures) -> dict[str, np.ndarray]:
    """Our errors (M, C)."""
    return {
        name: np.abs(ours.values[name] - recording.truth[name][ours.frames]) for name in QUANTITIES
    }


def counted(recording: Recording, ours: Figures) -> dict[str, np.ndarray]:
    """Frames (M, C) that count: determined by us, and the true figure is not next to infinite."""
    near = recording.near()
    return {name: ours.determined[name] & near[name][ours.frames] for name in QUANTITIES}


def by_condition(recording: Recording, values: np.ndarray) -> dict[tuple[str, float], np.ndarray]:
    """Columns (..., C) put together by motion and noise level, all seeds of it: (..., seeds)."""
    groups: dict[tuple[str, float], list[int]] = {}
    for k, case in enumerate(recording.cases):
        groups.setdefault((case.motion, case.noise), []).append(k)
    return {key: values[..., columns] for key, columns in groups.items()}


def rms_by_seed(
    recording: Recording, errors: dict[str, np.ndarray], where: dict[str, np.ndarray]
) -> dict[Key, tuple[float, np.ndarray]]:
    """RMS over what counts, pooled and of each seed (seeds,), by motion, noise and quantity."""
    result: dict[Key, tuple[float, np.ndarray]] = {}
    for name in QUANTITIES:
        with np.errstate(all='ignore'):
            squares = np.where(where[name], np.abs(errors[name]) ** 2, 0.0).sum(axis=0)
        counts = by_condition(recording, where[name].sum(axis=0))
        for (motion, noise), square in by_condition(recording, squares).items():
            count = counts[motion, noise]
            enough = count.sum() >= FEWEST
            with np.errstate(all='ignore'):
                pooled = float(np.sqrt(square.sum() / count.sum())) if enough else np.nan
                result[motion, noise, name] = pooled, np.sqrt(square / count)
    return result


def pooled_rms(
    recording: Recording, errors: dict[str, np.ndarray], where: dict[str, np.ndarray]
) -> dict[Key, float]:
    """RMS over all frames and seeds that count, by motion, noise and quantity."""
    return {key: pooled for key, (pooled, _) in rms_by_seed(recording, errors, where).items()}


def best_fixed(
    recording: Recording,
    frames: np.ndarray,
    where: dict[str, np.ndarray],
    poses: tuple[np.ndarray, np.ndarray] | None = None,
    lag: float = LAG,
) -> dict[Key, Best]:
    """The setting of least RMS by motion, noise and quantity."""
    position, angle = fit_poses(recording) if poses is None else poses
    best: dict[Key, Best] = {}
    for samples, degree in settings(lag):
        weights, ahead = fixed_weights(samples, degree, lag)
        z, turn = apply_weights(weights, ahead, frames, position, angle)
        found = rms_by_seed(recording, errors_of(recording, frames, z, turn), where)
        for key, (value, seeds) in found.items():
            # An order above the degree comes out zero, which is no measurement of what is zero.
            if (
                degree >= ORDER[key[2]]
                and np.isfinite(value)
                and (key not in best or value < best[key].error)
            ):
                best[key] = Best(value, samples, degree, seeds)
    return best


def covered(name: str, squares: np.ndarray) -> np.ndarray:
    """Where errors, squared over their (co)variance, lie in the 95% interval of the quantity."""
    return np.asarray(squares < (5.991 if name in POLES else 1.96**2))


def coverage(recording: Recording, ours: Figures) -> list[dict[str, object]]:
    """
    Rows by motion, noise and quantity: how far the stated uncertainty holds.

    `covered` is the share of determined frames within 95% (|error| < 1.96 deviations; of a pole the
    squared error over the covariance below 5.991, chi-square of 2), `mean_square` the mean of that
    square per degree of freedom, which should be 1. A frame is `bad` where the true error exceeds
    10 stated deviations or the true pole lies beyond 1000 sizes, otherwise good, if the stated
    deviation is below 0.3 of what is measured (of a pole: of the body's size; of a rate at least
    that power of the rms of ω): what is known worse than that is no loss. A frame whose true pole
    does not exist is bad, and not covered where it is marked determined. `exact` is the share of
    determined frames without any error but rounding: where it is above 0.97 `covered` cannot be
    below. `scaled` is what `covered` would be, had the stated variances of the row been all as much
    larger or smaller as makes that mean 1. `bad_visible` is how many bad rates any test could mark,
    see `visible`. `below_50` and so on are, for poles, the shares of squared errors over the
    covariance below that percentile of chi-square.
    """
    errors = own_errors(recording, ours)
    rows: list[dict[str, object]] = []
    for name in QUANTITIES:
        freedom = 2 if name in POLES else 1
        truth = recording.truth[name][ours.frames]
        with np.errstate(all='ignore'):
            bad = ~(errors[name] <= 10 * ours.deviations[name])
            # A rate that is zero for now, or for good, is held against what the body does else.
            turning = rms(recording.truth['ω'], np.isfinite(recording.truth['ω']))
            scale = np.maximum(np.abs(truth), turning ** ORDER[name])
            if name in POLES:
                scale = np.broadcast_to(recording.size, truth.shape)
            pole = recording.truth[name if name in POLES else 'ICR'][ours.frames]
            if name in POLES or name == 'κ':
                bad |= ~(np.abs(pole - recording.middle[ours.frames]) <= 1e3 * recording.size)
            if name == 'κ':
                scale = np.maximum(np.abs(truth), 1 / recording.size)
            useful = ours.deviations[name] < 0.3 * scale
        good = ~bad & useful
        seen = np.full(truth.shape, np.nan)
        if name in RATES:
            seen = np.where(bad, visible(recording, name, errors[name]), 0.0)
        columns = {
            'determined': ours.determined[name],
            'covered': covered(name, ours.squares[name]),
            'square': ours.squares[name] / freedom,
            'exact': errors[name] <= _EXACT * scale,
            'bad': bad,
            'visible': seen,
            'good': good,
        }
        parts = {what: by_condition(recording, column) for what, column in columns.items()}
        for key in parts['bad']:
            here = {what: part[key] for what, part in parts.items()}
            told = here['determined']
            enough = told.sum() >= FEWEST
            square = here['square'][told & np.isfinite(here['square'])]
            mean = square.mean() if enough else np.nan
            with np.errstate(all='ignore'):
                scaled = covered(name, freedom * square / mean).mean() if enough else np.nan
            chi = {f'below_{100 * p:g}': np.nan for p in LEVELS}
            if name in POLES and enough:
                all_told = 2 * here['square'][told]
                chi = {f'below_{100 * p:g}': np.mean(all_told < -2 * np.log1p(-p)) for p in LEVELS}
            rows.append(
                {
                    'motion': key[0],
                    'noise': key[1],
                    'quantity': name,
                    'determined': told.mean(),
                    'covered': here['covered'][told].mean() if enough else np.nan,
                    'exact': here['exact'][told].mean() if enough else np.nan,
                    'mean_square': mean,
                    'scaled': scaled,
                    'median_square': np.median(square) if enough else np.nan,
                    'bad': int(here['bad'].sum()),
                    'bad_let_through': int((here['bad'] & told).sum()),
                    'bad_visible': float(here['visible'].sum()),
                    'good': int(here['good'].sum()),
                    'good_withheld': int((here['good'] & ~told).sum()),
                    **chi,
                }
            )
    return rows


def visible(recording: Recording, name: str, errors: np.ndarray) -> np.ndarray:
    """
    Chance (M, C) at most that a test marks frames with these errors (M, C) of the rate `name`.

    There are motions for which what was told is right: the true one and a polynomial in the samples
    about the instant. The one nearest to the truth is off it, in units of noise, by |error| over
    the least deviation that a rate of such polynomials can be known to. By Neyman and Pearson no
    test tells the two apart more often than that on their difference, for as many false alarms.
    """
    samples, degree = _DIFFERENCE
    order = ORDER[name]
    weights = derivative_weights((np.arange(samples) - samples // 2) / RATE, degree, order)[order]
    spread = (np.abs(recording.shape) ** 2).sum(axis=1)
    least = recording.noise * np.sqrt((weights**2).sum() / spread)
    far = errors / least - NormalDist().inv_cdf(1 - _FALSE)
    return np.vectorize(NormalDist().cdf)(far)
