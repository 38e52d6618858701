"""
The evidence of the motion for ticks over stamps.

Stamps alone cannot distinguish an even camera with late stamps from frames that come unevenly, but
the motion can. Each pose is predicted from its neighbors on both sides, once at the stamps and once
at the ticks.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import ROUNDING, Real
from kinpole_ros.tracking.clock import DECISIVE_NATS
from kinpole_ros.tracking.frame_intervals import CHANGE_NATS, UNSETTLED
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.statistics import median
from kinpole_ros.tracking.thresholds import N_SIGMA

# Number of neighbors on each side from which a pose is predicted.
SIDE = 3
# Fewer frames have no pose with all neighbors.
FEWEST_WEIGHED = UNSETTLED + 2 * SIDE + 1


class TickEvidence(NamedTuple):
    """
    What the motion has said so far.

    `nats` is the log likelihood of ticks over stamps, `speed` the largest rms change of a signal
    per interval in standard deviations of its noise, and `says_ticks` the last decision.
    """

    nats: float = 0.0
    speed: float = 0.0
    says_ticks: bool = False

    def denies_grid(self, stamps: str) -> bool:
        """
        Return whether the motion denies that the stamps are on the grid of a timer.

        Else they are even, and frames were lost, which regularly happens to a body that is hidden
        once a turn. Both explain the stamps. Those of a file, or of a driver, are true unless the
        parameter `stamps` says, or the motion says, that they are not.
        """
        if stamps == 'arrival':
            return self.nats < -DECISIVE_NATS
        return not self.says_ticks


def add_evidence(
    before: TickEvidence,
    history: History,
    counts: np.ndarray,
    number: int,
    interval: float,
    half_life: float,
    noise: Real,
) -> TickEvidence:
    """
    Add the evidence of the newest frames of the history.

    Parameters
    ----------
    before : TickEvidence
        That of earlier frames, which fades.
    history : History
        The frames.
    counts : (n,) int64
        Counts of the newest frames of the history.
    number : int
        How many of the newest frames are weighed, at least `FEWEST_WEIGHED`.
    interval, half_life : float
        Interval of the clock, and half-life of the evidence, ns.
    noise : (B,) float
        Noise of a marker of each body, m, NaN while not known.

    """
    rows = slice(len(history) - number, len(history) - UNSETTLED)
    counts = counts[len(counts) - number : len(counts) - UNSETTLED]
    stamps = history['stamp'][rows]
    times = np.stack(((stamps - stamps[0]) / interval, (counts - counts[0]) * 1.0))
    signals, variance = _signals(history, rows, noise)
    nats, speed = _evidence(times, signals, variance)
    fading = 0.5 ** ((number - UNSETTLED - 2 * SIDE) * interval / half_life)
    # Bounded, since the driver may change.
    nats = float(np.clip(fading * before.nats + nats, -CHANGE_NATS, CHANGE_NATS))
    says_ticks = nats > 0 if abs(nats) > DECISIVE_NATS else before.says_ticks
    return TickEvidence(nats, max(speed, fading * before.speed), says_ticks)


def _signals(history: History, rows: slice, noise: Real) -> tuple[Real, Real]:
    """Angles and coordinates (T, 3 B) of some frames, with their variances."""
    turns, position = history['turns'][rows], history['position'][rows]
    angle = history['angle'][rows] + 2 * np.pi * (turns - turns[0])
    signals = np.concatenate((angle, position.real, position.imag), axis=1)
    information = history['information'][rows]
    level = np.where(np.isfinite(noise), noise, 0.0)
    with np.errstate(divide='ignore'):
        inverse = np.where(information > 0, 1 / information, np.nan)
    # While the noise is not known, `_evidence` scales by the residuals. It is no less than rounding
    # of the places and arms of markers.
    arms = np.sqrt(information[:, 0] * inverse[:, 1])
    sizes = np.concatenate((np.abs(position), arms))
    size = np.max(sizes, initial=0.0, where=np.isfinite(sizes))
    square = np.maximum(level, ROUNDING * size) ** 2
    of_angle, even = inverse[:, 0] * square, inverse[:, 1] * square
    return signals, np.concatenate((of_angle, even, even), axis=1)


@np.errstate(divide='ignore', invalid='ignore')
def _evidence(times: Real, signals: Real, variance: Real) -> tuple[float, float]:
    """
    Compute the evidence of signals for ticks over stamps.

    Each signal is predicted by the polynomial through its neighbors on both sides.

    Parameters
    ----------
    times : (2, N) float
        Stamps and ticks, in intervals.
    signals, variance : (N, S) float
        Signals and their variances, NaN where not known.

    Returns
    -------
    nats : float
        Log likelihood of the ticks over that of the stamps.
    speed : float
        Largest rms change of a signal per interval, in its standard deviations.

    """
    centers = np.arange(SIDE, len(signals) - SIDE)
    neighbors = centers[:, None] + np.array([k for k in range(-SIDE, SIDE + 1) if k])
    stamps, ticks = times
    steps = ticks[neighbors] - ticks[centers, None]  # (M, 2 side)
    differences = steps[:, None, :] - steps[:, :, None]
    ratios = np.where(differences == 0, 1.0, steps[:, None, :] / differences)
    weights = ratios.prod(axis=2)
    # Shift of a signal from its tick to its stamp, by slopes, which have little noise. Signals that
    # do not change give no evidence.
    nearby = centers[:, None] + np.arange(-SIDE, SIDE + 1)
    around = ticks[nearby] - ticks[nearby].mean(axis=1, keepdims=True)
    slopes = np.einsum('mk,mks->ms', around, signals[nearby])
    slopes /= (around**2).sum(axis=1, keepdims=True)
    early = ticks - stamps
    early = early - median(early)
    shift = -slopes * (early[centers] - (weights * early[neighbors]).sum(axis=1))[:, None]
    residual = signals[centers] - np.einsum('mk,mks->ms', weights, signals[neighbors])
    residual = np.stack((residual - shift, residual))
    spread = variance[centers] + np.einsum('mk,mks->ms', weights**2, variance[neighbors])
    squares = residual**2 / spread
    usable = np.isfinite(squares).all(axis=0)
    count = np.maximum(usable.sum(axis=0), 1)
    squares = np.where(usable, squares, 0.0)
    # Scale by the smaller residuals: no polynomial follows every motion.
    scale = np.maximum((squares.sum(axis=1) / count).min(axis=0), 1.0)
    # Bound the effect of outliers.
    cost = np.minimum(squares / scale, N_SIGMA**2)
    # Neighboring predictions are correlated, so there are half as many independent ones.
    nats = float((cost[0] - cost[1]).sum() / 2) / 2
    rate = np.diff(signals, axis=0) ** 2 / np.where(variance[1:] > 0, variance[1:], np.nan)
    rate = rate[np.isfinite(rate).all(axis=1)]
    speed = float(np.sqrt(rate.mean(axis=0).max())) if rate.size else 0.0
    return nats, speed
