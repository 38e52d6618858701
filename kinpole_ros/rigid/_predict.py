"""
Predictions of samples from those before, by polynomials through the last few.

As good as the best degree of late, and exact for whatever moves so.
"""

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.rigid.levels import RECENT

# Weights of the samples before, oldest first, by degree, where they are even.
WEIGHTS = np.array([(0, 0, 0, 1), (0, 0, -1, 2), (0, 1, -3, 3), (-1, 4, -6, 4)], float)
POINTS = len(WEIGHTS)
_OWN = np.arange(POINTS)
# How many frames ago they came if none is left out.
AGO = POINTS - _OWN[:, None]
# Which of them each degree takes.
_TAKEN = _OWN[:, None] + _OWN >= POINTS - 1
# Steps that differ by less than this share are even.
_EVEN = 0.01
# Variances of their innovations, by degree, where there is nothing but noise.
GAINS = 1 + (WEIGHTS**2).sum(axis=1)
REACHES = np.abs(WEIGHTS).sum(axis=1)


def innovations(stamps: Real, signals: Complex) -> Real:
    """Squares (T, degrees, S) of what frames are off their predictions, NaN for none."""
    found = np.full((len(stamps), POINTS, signals.shape[1]), np.nan)
    if len(stamps) <= POINTS:
        return found
    if _even(np.diff(stamps)) and not np.isnan(signals).any():
        off = signals
        for degree in range(POINTS):
            off = off[1:] - off[:-1]
            found[degree + 1 :, degree] = off.real**2 + off.imag**2
        return found
    for b in range(signals.shape[1] // 2):
        both = [b, signals.shape[1] // 2 + b]
        kept = np.isfinite(signals[:, b]).nonzero()[0]
        if len(kept) <= POINTS:
            continue
        weights = lagrange(stamps[kept], kept)
        past = kept[np.arange(len(weights))[:, None] + np.arange(POINTS)]
        for signal in both:
            values = signals[:, signal]
            ahead = (weights * values[past][:, None]).sum(axis=-1)
            off = values[kept[POINTS:], None] - ahead
            found[kept[POINTS:], :, signal] = off.real**2 + off.imag**2
    return found


def lagrange(times: Real, numbers: np.ndarray) -> Real:
    """
    Weights (T, degree, 4) by which samples predict those after them, at `times` (4 + T,).

    By polynomials through the last of each four, as many as the degree and one more. NaN where they
    are of frames, by their numbers (4 + T,), too long ago.
    """
    count = len(times) - POINTS
    rows = np.arange(count)[:, None] + np.arange(POINTS)
    past, now = times[rows], times[POINTS:]
    # What each of the others adds to the weight of one, from the last back.
    factors = (now[:, None] - past)[:, None] / (past[..., None] - past[:, None])
    factors[:, _OWN, _OWN] = 1.0
    products = np.multiply.accumulate(factors[..., ::-1], axis=-1)
    weights = np.where(_TAKEN, products.swapaxes(1, 2), 0.0)
    weights[numbers[POINTS:] - numbers[:count] > RECENT] = np.nan
    return weights


def _even(steps: Real) -> bool:
    return bool(np.maximum.reduce(steps) - np.minimum.reduce(steps) <= _EVEN * steps[0])
