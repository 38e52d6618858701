"""
The even clock of a camera behind the stamps of its frames.

Cameras run on an even clock, but drivers stamp frames when they arrive, round the stamps or lose
frames. A frame arrives after it was captured, never before: its stamp is that of its tick and a
lateness of 0 or more. Ticks are found by the lower edge of the stamps, and frames that are lost by
all later ones being at least a tick later than without the loss.
"""

import math
from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.planar._plane import Real

# Below these the interval is searched for, which takes as long as n^2; above it is known well
# enough to go on from what it was. Fewer say nothing of a rate that has changed.
SEARCHED = 64
# Nats of a lost frame: one in fifty.
LOSS = math.log(50)
# Deviation of the slope of a line along the edge of n points, by the inverse of their density there
# over n^2 (simulated); so many points nearest to the edge tell the density.
_EDGE, _NEAREST = 8.0, 6
# The edge is known from n frames and is gone by for a quarter of n more: it may be off by so many
# deviations of its slope, by n, two on the far side of the middle (simulated: 0.96 are within).
_AHEAD = 1.5
# Nats by which the newest frames must be likelier at a rate of their own for it to have changed, or
# another count for that of a frame to be wrong.
SURE_NATS = 20.0
# Stamps that are late by no more than this share of the interval leave no doubt of any count.
_PLAIN = 1 / 4
# One frame in so many may be as late as no other.
_RARE = 512
# Newest frames whose counts are not sure enough to find the clock by.
UNSETTLED = 8
# So many frames after a loss may have been captured before it.
_AFTER = 4


class Clock(NamedTuple):
    """
    A clock with ticks of number n at `origin` + `phase` + n `interval`, ns.

    `deviation` is that of the interval; `lateness` the mean by which stamps are later than their
    ticks, `jitter` its standard deviation, `largest` the most of it and `margin` how much earlier
    than its tick a stamp may be; stamps are multiples of `resolution`; all in ns.
    """

    origin: int
    phase: float
    interval: float
    deviation: float
    lateness: float
    jitter: float
    largest: float
    margin: float
    resolution: float

    @property
    def reach(self) -> float:
        """By how many ticks a frame may be later than another with the same count."""
        return (self.largest + self.margin) / self.interval

    def ticks(self, stamps: np.ndarray) -> Real:
        """At how many ticks (T,) the `stamps` (T,), ns, come: their whole part is the latest."""
        since = np.asarray(stamps) - self.origin
        return np.asarray((since - self.phase + self.margin) / self.interval)


def find_clock(stamps: np.ndarray, before: Clock | None) -> tuple[Clock, np.ndarray]:
    """
    The clock behind `stamps` (N,), ns, of frames in order of capture, and the counts of the latest.

    `before` is the clock as it was known from most of these. The counts (n,) are of the newest
    frames, from which the clock is found; those before had another rate. There are at least
    `FEWEST_SAMPLES`.
    """
    origin = int(stamps[0])
    since = (stamps - origin).astype(float)
    resolution = float(max(np.gcd.reduce(np.diff(stamps)), 1))
    if before is not None and before.largest <= _PLAIN * before.interval:
        counts = counts_by(stamps, before)
        clock, used = _fit(origin, since, counts, resolution)
        # Where more are lost than come it is the pace within bunches, not that of the camera.
        lost_most = counts[-1] - counts[0] > 2 * len(counts)
        if clock.largest <= _PLAIN * clock.interval and not lost_most:
            return clock, counts[-used:]
    trials = [_afresh(since, resolution)]
    if before is not None:
        rates = np.array((before.interval, _edge_of(since, trials[0])))
        trials += [counts_by(stamps, before), *_counts_of(since, rates)]
    counts = _likeliest(since, trials, resolution)
    clock, used = _fit(origin, since, counts, resolution)
    # The rate found with some counts may show that others were meant.
    for _ in range(3):
        since, counts = since[-used:], counts[-used:]
        again = counts_by(stamps[-used:], clock)
        if (np.diff(again) == np.diff(counts)).all():
            break
        if _likeliest(since, [counts, again], resolution) is counts:
            break
        counts = again
        clock, used = _fit(origin, since, counts, resolution)
    return clock, counts[-used:]


def follow_clock(stamps: np.ndarray, counts: np.ndarray) -> tuple[Clock, np.ndarray, bool]:
    """
    The clock behind `stamps` (N,), ns, of frames with `counts` (N,), and the counts of the latest.

    Also whether those are as they were: where the newest are likelier at a rate of their own the
    clock is found anew from them.
    """
    if len(stamps) <= 2 * UNSETTLED:
        return *find_clock(stamps, None), False
    origin = int(stamps[0])
    since = (stamps - origin).astype(float)
    resolution = float(max(np.gcd.reduce(np.diff(stamps)), 1))
    clock, used = _fit(origin, since, counts, resolution, True)
    newest = since[-SEARCHED:]
    trials = np.stack((counts[-SEARCHED:], _search(newest, resolution)))
    intervals = np.array([_edge_of(newest, c) for c in trials])
    costs = _costs(newest, trials, intervals, resolution, _loss(counts))
    lost = np.ptp(trials[:, : len(newest) - UNSETTLED], axis=1)
    if lost[0] != lost[1] and costs[1] < costs[0] - SURE_NATS:
        used = len(newest)
    if used == len(counts):
        return clock, counts, True
    return *find_clock(stamps[-used:], None), False


def _afresh(since: Real, resolution: float) -> np.ndarray:
    """
    Counts (N,) of frames `since` the first, ns, from the newest few on.

    A rate that is wrong by a frame now and then is confirmed by the counts that it gives.
    """
    count = min(SEARCHED, len(since))
    counts = _search(since[-count:], resolution)
    while count < len(since):
        interval = _edge_of(since[-count:], counts)
        count = min(2 * count, len(since))
        counts = _counts_of(since[-count:], np.array([interval]))[0]
    return counts


def _likeliest(since: Real, trials: list[np.ndarray], resolution: float) -> np.ndarray:
    """The likeliest counts (N,) of some."""
    intervals = np.array([_edge_of(since, counts) for counts in trials])
    return trials[int(_costs(since, np.stack(trials), intervals, resolution).argmin())]


def _loss(counts: np.ndarray) -> float:
    """Nats of a lost frame where as many are lost as of those with `counts` (N,)."""
    lost = max(int(counts[-1] - counts[0]) + 1 - len(counts), 0)
    return math.log((len(counts) + lost + math.exp(LOSS)) / (lost + 1))


def _costs(
    since: Real, counts: np.ndarray, intervals: Real, resolution: float, loss: float = LOSS
) -> Real:
    """
    Minus logs (I,) of how likely `counts` (I, N) and `intervals` (I,) are, up to a constant.

    A lost frame costs so many nats: `loss`.
    """
    settled = max(FEWEST_SAMPLES, counts.shape[1] - UNSETTLED)
    late = (since - counts * intervals[:, None])[:, :settled]
    late = (late - late.min(axis=1, keepdims=True)).mean(axis=1)
    lost = counts[:, settled - 1] - counts[:, 0] - (settled - 1)
    cost = settled * np.log(late + resolution / 4 + 1.0) + loss * lost
    # Bunches, as above.
    return np.asarray(np.where(lost > settled, np.inf, cost))


def _search(since: Real, resolution: float) -> np.ndarray:
    """Counts (N,) of a few frames `since` the first, by the likeliest interval of many."""
    number = np.arange(len(since))
    steps = np.diff(since)
    middle = _forward(float(np.median(steps)), since)
    around = number - number.mean()
    slope = _forward(float(around @ since / (around @ around)), since)
    deviation = 2 * float(np.median(np.abs(steps - middle))) + resolution
    most = min(3 * deviation / math.sqrt(len(steps)), 0.5 * middle)
    # Also the mean rate if none, one, ... were lost.
    most_lost = max(FEWEST_SAMPLES - 1, len(since) // 8)
    trials = np.concatenate(
        (
            middle + most * np.linspace(-1, 1, SEARCHED + 1),
            slope / (1 + np.linspace(-1, most_lost, 2 * (SEARCHED + 1)) / len(steps)),
        )
    )
    counts = _counts_of(since, trials)
    return np.asarray(counts[_costs(since, counts, trials, resolution).argmin()])


def _counts_of(since: Real, intervals: Real) -> np.ndarray:
    """Counts (I, N) of frames by each of the `intervals` (I,), the first of them in time."""
    number = np.arange(len(since))
    left = since - intervals[:, None] * number
    least = np.minimum.accumulate(left[:, ::-1], axis=1)[:, ::-1]
    lost = np.rint((least - least[:, :1]) / intervals[:, None])
    return np.asarray(number + np.maximum.accumulate(lost, axis=1).astype(np.int64))


def counts_by(stamps: np.ndarray, clock: Clock) -> np.ndarray:
    """
    Counts (N,) of frames by a clock: the latest that neither a stamp nor a later frame forbids.

    No frame comes before its tick, and none has the count of the one after it.
    """
    number = np.arange(len(stamps))
    ahead = np.floor(clock.ticks(stamps)).astype(np.int64) - number
    return np.asarray(number + np.minimum.accumulate(ahead[::-1])[::-1])


def _fit(
    origin: int, since: Real, counts: np.ndarray, resolution: float, counted: bool = False
) -> tuple[Clock, int]:
    """
    The clock of frames `since` `origin`, ns, with `counts` (N,).

    Of all, or of as many of the newest as are returned too, if the rate has changed. Whether it has
    is only looked at where counts cannot be wrong, or were `counted` one by one.
    """
    used = len(counts)
    # A frame after a loss may have come before it, late, for all one knows, and spoil the edge.
    sure = np.ones(used, bool)
    after = (np.diff(counts) > 1).nonzero()[0][:, None] + np.arange(1, _AFTER + 1)
    sure[np.minimum(after, used - 1)] = False
    sure[-UNSETTLED:] = False
    if 2 * np.count_nonzero(sure) < max(used, 4 * UNSETTLED):
        sure[: max(FEWEST_SAMPLES, used - UNSETTLED)] = True
    since, counts = since[sure], counts[sure]
    interval, deviation = _slope(since, counts, resolution)
    interval = _forward(interval, since)
    part = len(counts) // 2
    while part > SEARCHED and (counted or (since - interval * counts).std() < _PLAIN * interval):
        newest = slice(len(counts) - part, None)
        now, sure_now = _slope(since[newest], counts[newest], resolution)
        left, own = (
            float((since[newest] - one * counts[newest]).var()) + resolution**2 / 12
            for one in (interval, now)
        )
        differs = abs(now - interval) * part > 2 * resolution
        if differs and part / 2 * math.log(left / own) > SURE_NATS:
            since, counts = since[newest], counts[newest]
            interval, deviation = max(now, 1.0), sure_now
            used = len(sure) - int(sure.nonzero()[0][-part])
        part //= 2
    late = since - interval * counts
    ranked = np.sort(late)
    phase = float(ranked[0])
    late -= phase
    # A frame is too early by less than half of what no frame's lateness has left free before the
    # next tick, and else by what the edge may be off.
    edge = float(ranked[min(4, len(ranked) - 1)]) - phase + resolution
    edge += _AHEAD * deviation * len(ranked)
    parts = np.sort(late % interval)
    free = interval - float(parts[-1 - len(parts) // _RARE])
    clock = Clock(
        origin,
        phase,
        interval,
        deviation,
        float(late.mean()),
        float(late.std()),
        float(late.max()),
        min(max(edge, free / 2), interval / 2),
        resolution,
    )
    return clock, used


def _forward(interval: float, since: Real) -> float:
    """An interval, ns; the mean where frames are so late that by their stamps they run backward."""
    return interval if interval >= 1.0 else max(float(np.ptp(since)) / max(len(since) - 1, 1), 1.0)


def _slope(since: Real, counts: np.ndarray, resolution: float) -> tuple[float, float]:
    """
    The interval, ns, and its deviation, by what is known best of frames with `counts` (N,).

    A line by least squares is best for lateness that has no edges; lines along the edges are where
    it has them: exponential, even, rounded.
    """
    count = len(counts)
    around = counts - counts.mean()
    total = max(float(around @ around), 1.0)
    line = float(around @ since) / total
    off = since - line * around
    rounding = resolution / math.sqrt(12)
    spread = math.sqrt(float(off.var()) * count / max(count - 2, 1) + rounding**2)
    found = [(line, spread / math.sqrt(total))]
    for sign in (1.0, -1.0):
        edge = _edge(sign * since, around, sign * line)
        left = np.sort(sign * since - edge * around)
        few = min(_NEAREST, count - 1)
        inverse = (left[few] - left[0] + resolution) * count / few
        reach = max(float(around[-1] - around[0]), 1.0)
        found.append((sign * edge, _EDGE * inverse / (count * reach)))
    values, deviations = np.array(found).T
    if deviations[0] <= deviations[1:].min():
        return line, float(deviations[0])
    weights = deviations[1:] ** -2
    mean = float((weights * values[1:]).sum() / weights.sum())
    return mean, float(weights.sum() ** -0.5)


def _edge_of(since: Real, counts: np.ndarray) -> float:
    """The interval by the lower edge of frames with `counts` (N,)."""
    around = counts - counts.mean()
    total = max(float(around @ around), 1.0)
    return max(_edge(since, around, float(around @ since) / total), 1.0)


def _edge(values: Real, around: Real, slope: float) -> float:
    """
    Slope of the line below all `values` (N,), by `around` (N,), that is nearest to them on the sum.

    That is the edge of their lower hull at the mean: the most likely line where values are late by
    an exponential time (Smith 1985).
    """
    middle = int(np.searchsorted(around, 0.0))
    middle = min(max(middle, 1), len(around) - 1)
    pair = (-1, -1)
    for _ in range(20):
        left = values - slope * around
        here = int(left[:middle].argmin()), middle + int(left[middle:].argmin())
        if here == pair:
            break
        pair = here
        distance = max(float(around[pair[1]] - around[pair[0]]), 1.0)
        slope = float(values[pair[1]] - values[pair[0]]) / distance
    return slope
