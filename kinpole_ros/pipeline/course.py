"""
What the motion says of when frames were: at their stamps or at ticks, and at which of these.

Each pose is held against what polynomials through its neighbors have there. What is likelier is
said in nats.
"""

import math
from collections.abc import Iterable

import numpy as np

from kinpole_ros.pipeline.clock import SURE_NATS
from kinpole_ros.planar._plane import Real
from kinpole_ros.rigid.levels import SURE

# Neighbors on each side that predict a pose.
SIDE = 3
# Of the polynomial that places a lost frame, and the highest of those that tell frames' counts.
_DEGREE = 3
_HIGHEST = 2 * _DEGREE
# Frames on each side that tell how long a gap is, and mean squares up to which a polynomial follows
# the motion.
_OFF_CLOCK, _FOLLOWED = _DEGREE + 1, 4.0
# So many gaps are corrected in one go.
_MOST_CORRECTED = 20
# What neighbors predict is correlated: there is half as much evidence as predictions.
_INDEPENDENT = 0.5


def signals_of(poses: Real, information: Real, noise: Real) -> tuple[Real, Real]:
    """Angles without turns, and coordinates (T, 3 B), with their variances."""
    count = len(noise)
    angle = poses[:, :count, 0] + 2 * np.pi * (poses[:, :count, 1] - poses[0, :count, 1])
    signals = np.concatenate((angle, poses[:, count:, 0], poses[:, count:, 1]), axis=1)
    level = np.where(np.isfinite(noise), noise, 0.0)
    with np.errstate(divide='ignore'):
        inverse = np.where(information > 0, 1 / information, np.nan)
    # Where noise is not known yet it is what predictions leave.
    square = np.maximum(level, 1e-9) ** 2
    of_angle, even = inverse[:, :count] * square, inverse[:, count:] * square
    return signals, np.concatenate((of_angle, even, even), axis=1)


@np.errstate(divide='ignore', invalid='ignore')
def evidence(times: Real, signals: Real, variance: Real) -> tuple[float, float]:
    """
    By how many nats signals make the second of two sequences of times likelier than the first.

    `times` (2, N) are in intervals, `signals` (N, S) have the `variance` (N, S), NaN where not
    known: `times` are stamps and ticks. Each signal is predicted by the polynomial through its
    neighbors on both sides. Also the largest rms rate of a signal by interval, in its deviations.
    """
    count = len(signals)
    offsets = np.array([k for k in range(-SIDE, SIDE + 1) if k])
    here = np.arange(SIDE, count - SIDE)
    there = here[:, None] + offsets
    stamps, ticks = times
    steps = ticks[there] - ticks[here, None]  # (M, 2 side)
    weights = np.ones_like(steps)
    for k, m in _pairs(len(offsets)):
        weights[:, k] *= steps[:, m] / (steps[:, m] - steps[:, k])
    # What a stamp that is right moves a signal by, off where it is at its tick. By slopes, which
    # hardly have noise: what does not move says nothing.
    nearby = here[:, None] + np.arange(-SIDE, SIDE + 1)
    around = ticks[nearby] - ticks[nearby].mean(axis=1, keepdims=True)
    slopes = np.einsum('mk,mks->ms', around, signals[nearby])
    slopes /= (around**2).sum(axis=1, keepdims=True)
    early = ticks - stamps
    early = early - np.median(early)
    moved = -slopes * (early[here] - (weights * early[there]).sum(axis=1))[:, None]
    off = signals[here] - np.einsum('mk,mks->ms', weights, signals[there])
    off = np.stack((off - moved, off))
    spread = variance[here] + np.einsum('mk,mks->ms', weights**2, variance[there])
    squares = off**2 / spread
    known = np.isfinite(squares).all(axis=0)
    number = np.maximum(known.sum(axis=0), 1)
    squares = np.where(known, squares, 0.0)
    # By the better of the two, for no polynomial follows every motion.
    scale = np.maximum((squares.sum(axis=1) / number).min(axis=0), 1.0)
    # None counts for more than an outlier would.
    cost = np.minimum(squares / scale, SURE**2)
    nats = float((cost[0] - cost[1]).sum() / 2) * _INDEPENDENT
    rate = np.diff(signals, axis=0) ** 2 / np.where(variance[1:] > 0, variance[1:], np.nan)
    rate = rate[np.isfinite(rate).all(axis=1)]
    speed = float(np.sqrt(rate.mean(axis=0).max())) if rate.size else 0.0
    return nats, speed


def _pairs(count: int) -> Iterable[tuple[int, int]]:
    return ((k, m) for k in range(count) for m in range(count) if k != m)


def correct_counts(counts: np.ndarray, poses: Real, information: Real, noise: Real) -> None:
    """
    Put `counts` (N,) right where the motion contradicts them, whatever they were found by.

    The newest frames have `poses` (T, 2 B, 2), as in `RigidBodies`; the newest count stays.
    """
    held = min(len(poses), len(counts))
    signals, variance = signals_of(poses[len(poses) - held :], information[-held:], noise)
    for _ in range(_MOST_CORRECTED):
        here, more = gap_to_correct(counts[len(counts) - held :], signals, variance)
        if not more:
            break
        counts[: len(counts) - held + here] -= more


def gap_to_correct(counts: np.ndarray, signals: Real, variance: Real) -> tuple[int, int]:
    """
    Before which frame one more or one fewer was lost than `counts` (N,) say, by the motion alone.

    Also which, 1 or -1; 0 if none. It is the gap that contradicts most how poses go before and
    after it; `signals` (N, S) have the `variance` (N, S), NaN where not known.
    """
    number = len(counts) - 2 * _OFF_CLOCK + 1
    if number < 1:
        return 0, 0
    around = np.arange(2 * _OFF_CLOCK)
    there = np.arange(number)[:, None] + around
    more = np.array([0, 1, -1])
    at = counts[there] + more[:, None, None] * (around >= _OFF_CLOCK)
    fewest = np.diff(at, axis=-1).min(axis=-1)
    at = (at - at.mean(axis=-1, keepdims=True)) / np.ptp(at, axis=-1).clip(1)[..., None]
    basis, _ = np.linalg.qr(at[..., None] ** np.arange(_DEGREE + 1))
    values = signals[there] / np.sqrt(variance[there].mean(axis=1, keepdims=True))
    known = np.isfinite(values).all(axis=1)
    values = np.where(known[:, None], values - values[:, :1], 0.0)
    rest = values - basis @ (basis.swapaxes(-1, -2) @ values)
    left = (rest**2).sum(axis=-2)  # (3, M, S)
    least = left.min(axis=0) / (2 * _OFF_CLOCK - _DEGREE - 1)
    cost = (left / np.maximum(least, 1.0)).sum(axis=-1) / 2
    cost[fewest < 1] = np.inf
    # Nothing is said of frames that are not counted up.
    cost[:, fewest[0] < 1] = 0.0
    gain = cost[0] - cost
    gain[:, (np.where(known, least, 0.0) > _FOLLOWED).any(axis=-1)] = 0.0
    which, gap = np.unravel_index(gain.argmax(), gain.shape)
    if gain[which, gap] < SURE_NATS:
        return 0, 0
    return int(gap) + _OFF_CLOCK, int(more[which])


def course_costs(frames: np.ndarray, begin: int, counts: np.ndarray, noise: Real) -> Real:
    """
    How unlikely (H,), nats, the motion makes `counts` (H, n) of `frames` from the `begin`-th on.

    The frames are rows of a `Timeline`; `noise` (B,), m, is that of a marker of each body.
    """
    signals, variance = signals_of(frames['poses'], frames['information'], noise)
    before = np.broadcast_to(frames['count'][:begin], (len(counts), begin))
    at = np.concatenate((before, counts), axis=1) - counts[0, -1]
    cost = np.zeros(len(counts))
    # Signals that are known in the same frames go together.
    known = np.isfinite(variance)
    while known.any():
        first = known.any(axis=0).argmax()
        rows = known[:, first].copy()
        same = (known == rows[:, None]).all(axis=0)
        known[:, same] = False
        deviation = np.sqrt(variance[np.ix_(rows, same)].mean(axis=0))
        cost += _misfit(at[:, rows], signals[np.ix_(rows, same)] / deviation)
    return cost


def _misfit(times: np.ndarray, values: Real) -> Real:
    """
    How unlikely (H,), nats, polynomials in `times` (H, N) make `values` (N, S), in deviations.

    Each signal has the degree that its evidence is best with, by Schwarz's criterion: a fast motion
    that a cubic cannot follow would else say that a frame was lost, or was not.
    """
    count = len(values)
    highest = min(_HIGHEST, count - 3)
    if highest < 1:
        return np.zeros(len(times))
    scaled = (times - times.mean(axis=1, keepdims=True)) / max(np.ptp(times), 1)
    basis, _ = np.linalg.qr(scaled[..., None] ** np.arange(highest + 1))
    values = values - values.mean(axis=0)
    squares = (basis.swapaxes(1, 2) @ values) ** 2
    left = (values**2).sum(axis=0) - squares.cumsum(axis=1)  # (H, degrees, S)
    left = np.maximum(left[:, 1:], 0.0)
    degrees = np.arange(1, highest + 1)[:, None]
    # Where no polynomial follows the motion, or the noise is not known.
    scale = np.maximum((left / (count - degrees - 1)).min(axis=(0, 1)), 1.0)
    costs = (left / scale + degrees * math.log(count)).min(axis=1) / 2
    return np.asarray(costs.sum(axis=1))
