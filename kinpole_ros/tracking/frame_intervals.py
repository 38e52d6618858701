"""
Intervals between the frames of a camera, and which frames were lost, as their stamps say.

Each hypothesis is an interval, and counts of the frames by it. Counts are the larger the more
frames were lost.
"""

import math

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.planar._plane import Real
from kinpole_ros.tracking.stamp_grid import rounding_nats

# Number of intervals of the search that are refined.
MAX_REFINED = 16
# The fit leaves out so many of the newest frames and after each loss: their counts may change.
UNSETTLED = 4
# Cost of a lost frame before any was lost, nats: one in fifty.
LOSS_NATS = math.log(50)
# The rate has changed if another one is likelier by so many nats.
CHANGE_NATS = 20.0
# An exactly even clock with losses is a clock of its own, on a grid, if that is likelier by so many
# nats. With 12, one of 300 recordings of even stamps with random losses of 1 to 20% is taken for
# another clock for a while, with 10 nine; 60 Hz on steps of 15.6 ms is recognized in 64 frames.
GRID_NATS = 12.0
# Share of an interval, or of a step of rounding, by which an estimated edge may be off.
TOLERANCE = 0.1
# ns. Stamps with a coarser resolution were rounded by the driver.
COARSE = 10_000


def likeliest_intervals(
    since: Real, intervals: Real, resolution: float, rounds: int
) -> tuple[np.ndarray, Real]:
    """
    The likeliest intervals, best first, and the counts of frames `since` the first, ns, by them.

    Each interval is refined by some rounds of counting frames and fitting the edge to them. One is
    returned of the intervals with equally many losses.
    """
    settled = max(FEWEST_SAMPLES, len(since) - UNSETTLED)
    counts = _counts_by(since, intervals, resolution)
    candidates = [(counts, intervals, costs_of_counts(since, counts, intervals, resolution))]
    for _ in range(rounds):
        intervals = _edge_intervals(since[:settled], counts[:, :settled])
        counts = _counts_by(since, intervals, resolution)
        candidates.append(
            (counts, intervals, costs_of_counts(since, counts, intervals, resolution))
        )
    counts, intervals, costs = (np.concatenate(part) for part in zip(*candidates, strict=True))
    order = costs.argsort(kind='stable')
    _, first = np.unique(counts[order, settled - 1] - counts[order, 0], return_index=True)
    order = order[np.sort(first)[:MAX_REFINED]]
    if rounds:
        order = order[costs[order] <= costs[order[0]] + 2 * CHANGE_NATS]
    return counts[order], intervals[order]


def costs_of_counts(since: Real, counts: np.ndarray, intervals: Real, resolution: float) -> Real:
    """Negative log likelihoods (I,) of counts (I, N) and intervals (I,), up to a constant."""
    settled = max(FEWEST_SAMPLES, len(since) - UNSETTLED)
    late = (since - counts * intervals[:, None])[:, :settled]
    late = late - late.min(axis=1, keepdims=True)
    lost = counts[:, settled - 1] - counts[:, 0] - (settled - 1)
    if is_grid_coarse(since, resolution):
        # A clock that is exactly even on the grid has no phase and no interval of its own.
        cost = rounding_nats(late / resolution) + np.where(late.max(axis=1) > 1.0, GRID_NATS, 0.0)
    else:
        cost = settled * np.log(late.mean(axis=1) + resolution / 4 + 1.0)
    cost = cost + _loss_nats(lost, settled)
    # The rate within bunches, as above.
    return np.asarray(np.where(lost > settled, np.inf, cost))


def is_grid_coarse(since: Real, resolution: float) -> bool:
    """Whether steps of the grid are longer than half of the mean time between frames."""
    return resolution >= COARSE and 2 * resolution > (since[-1] - since[0]) / (len(since) - 1)


def _counts_by(since: Real, intervals: Real, resolution: float) -> np.ndarray:
    """Largest counts (I, N) of frames `since` the first, ns, by intervals (I,), from 0 on."""
    number, steps = np.arange(len(since)), intervals[:, None]
    offset = since - steps * number
    # The phase with the least mean lateness.
    late = np.sort(offset % steps, axis=1)
    edge = (steps * number / len(since) - late).argmin(axis=1)
    phase = late[np.arange(len(late)), edge][:, None]
    least = np.minimum.accumulate(offset[:, ::-1], axis=1)[:, ::-1]
    early = np.minimum(TOLERANCE * steps + resolution, steps / 2)
    lost = np.floor((least - phase + early) / steps)
    lost = np.maximum.accumulate(lost, axis=1).astype(np.int64)
    return np.asarray(number + lost - lost[:, :1])


def _edge_intervals(since: Real, counts: np.ndarray) -> Real:
    """
    Slopes (I,) of the lower edge of stamps `since` the first (N,), ns, over their counts (I, N).

    The edge of the lower hull at the middle frame is the likeliest line for stamps that are late by
    an exponential time (Smith 1985).
    """
    middle, rows = len(since) // 2, np.arange(len(counts))
    spoiled = after_losses(counts)
    spoiled &= np.count_nonzero(~spoiled, axis=1)[:, None] > len(since) // 4
    slopes = (since[-1] - since[0]) / (counts[:, -1] - counts[:, 0])
    for _ in range(10):
        late = np.where(spoiled, np.inf, since - slopes[:, None] * counts)
        i = late[:, :middle].argmin(axis=1)
        j = middle + late[:, middle:].argmin(axis=1)
        before = slopes
        slopes = (since[j] - since[i]) / (counts[rows, j] - counts[rows, i])
        if (slopes == before).all():
            break
    # The slope may be negative if frames are very late.
    mean = max(float(np.ptp(since)) / (len(since) - 1), 1.0)
    return np.where(slopes >= 1.0, slopes, mean)


def fit_interval(since: Real, counts: np.ndarray, resolution: float) -> float:
    """The interval, ns, by the lower and the upper edge of the stamps, weighted by sharpness."""
    lower = float(_edge_intervals(since, counts[None])[0])
    upper = float(_edge_intervals(-since[::-1], -counts[None, ::-1])[0])
    late = np.sort(since - lower * counts)
    few = min(UNSETTLED, len(late) - 1)
    # An edge is sharp if several frames are close to it.
    below, above = late[few] - late[0] + resolution, late[-1] - late[-1 - few] + resolution
    both = float((lower / below**2 + upper / above**2) / (below**-2 + above**-2))
    if not is_grid_coarse(since, resolution):
        return both
    intervals = np.array([lower, upper, both])
    return float(intervals[costs_of_counts(since, counts[None], intervals, resolution).argmin()])


def after_losses(counts: np.ndarray) -> np.ndarray:
    """Which frames (I, N) come soon after a loss, by their counts (I, N)."""
    after = np.zeros(counts.shape, bool)
    gaps = np.diff(counts) > 1
    for k in range(min(UNSETTLED, gaps.shape[1])):
        after[:, 1 + k :] |= gaps[:, : gaps.shape[1] - k]
    return after


def _loss_nats(lost: np.ndarray, frames: int) -> Real:
    """Negative log likelihoods (I,) of `lost` frames (I,) among those that came."""
    share = (lost.clip(0) + 1) / (frames + lost.clip(0) + math.exp(LOSS_NATS))
    return np.asarray(-lost * np.log(share) - frames * np.log1p(-share))


def lost_between(counts: np.ndarray) -> int:
    """Return how many frames were lost between those with counts (n,)."""
    return int(counts[-1] - counts[0]) + 1 - len(counts)
