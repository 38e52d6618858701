"""Whether the markers of bodies stray by more, or by less, than in the frames before."""

import numpy as np

from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.learn import freedom_of
from kinpole_ros.tracking.noise import white_noise
from kinpole_ros.tracking.thresholds import MEMORY_FRAMES, MIN_SAMPLES, N_SIGMA, ROUNDED

# Noise is another if its deviation grows or falls by this factor: a smaller change costs less
# accuracy than what is learned from fewer frames.
_NOISE_RATIO = 1.5


def has_other_noise(bodies: Bodies, history: History, count: int, new: int) -> np.ndarray:
    """
    Return which bodies have markers that surely stray more, or less, than before.

    A lens and a shape that is not well known yet do not: they show in all frames alike.

    Parameters
    ----------
    bodies, history : Bodies, History
        What is known of B bodies, and their frames.
    count, new : int
        The newest `new` frames are compared with the others of the newest `count`.

    Returns
    -------
    (B,) bool

    """
    new = max(new, MIN_SAMPLES)
    rows = slice(-min(count, MEMORY_FRAMES, len(history)), None)
    residual, goes_on = history['residual'][rows], history['goes_on'][rows]
    if len(residual) < new + MIN_SAMPLES:
        return np.zeros(bodies.count, bool)
    freedom = freedom_of(bodies, residual)
    parts = slice(-new), slice(-new, None)
    least = ROUNDED * bodies.fitting.size
    (before, of_before), (now, of_now) = (
        white_noise(residual[part], freedom[part], goes_on[part]) for part in parts
    )
    seen = ~np.isnan(residual)
    squares = np.where(seen, residual.real**2 + residual.imag**2, 0.0)
    counts = [seen[part].sum(axis=0) for part in parts]
    with np.errstate(divide='ignore', invalid='ignore'):
        ratio = np.abs(np.log((now + least) / (before + least)))
        error = np.sqrt((1 / of_before + 1 / of_now) / 2)
        is_other = ratio > np.log(_NOISE_RATIO) + N_SIGMA * error
        means = [squares[part].sum(axis=0) for part in parts]
        strays = [m / c + least[:, None] ** 2 for m, c in zip(means, counts, strict=True)]
        ratios = np.abs(np.log(strays[1] / strays[0]))
    enough = np.minimum(*counts) >= MIN_SAMPLES
    return np.asarray(is_other | ((ratios > 2 * np.log(N_SIGMA)) & enough).any(axis=1))
