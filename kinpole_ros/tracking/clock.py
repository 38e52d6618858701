"""
The even clock of a camera, estimated from the stamps of its frames.

A camera captures frames at the ticks of an even clock. Its driver may stamp them when they arrive,
round the stamps and lose frames. A stamp is never before its tick, so the ticks are the lower edge
of the stamps, and a frame was lost where all later frames come at least one tick later than without
the loss.
"""

import math
from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.planar._plane import Real

# All constants of the clock and of its use.
# Frames that the clock is estimated from: 10 s at 200 Hz.
MEMORY = 2000
# Newest frames that the interval is searched for in: fewer do not tell 2% of losses from none.
SEARCHED = 128
# Intervals that are refined: the likeliest of the search.
KEPT = 16
# Newest frames, and frames after a loss, that the fit leaves out: their counts may be wrong.
UNSETTLED = 4
# Frames that wait for a sure count at most: the usual lag at 200 Hz.
MAX_PENDING = 20
# Nats of a lost frame before any was seen to be lost: one in fifty.
LOSS_NATS = math.log(50)
# Nats by which another rate must be likelier for the rate to have changed.
CHANGE_NATS = 20.0
# Nats from which on the motion decides between stamps and ticks.
DECISIVE_NATS = 6.0
# Windows in which half of the evidence of the motion is forgotten: 1 s of 0.3 s each.
HALF_LIFE = 3.3
# Share of an interval, or of a step of rounding, by which an estimated edge may be off.
TOLERANCE = 0.1
# ns. Stamps in such steps or longer ones were rounded by the driver.
COARSE = 10_000


class Clock(NamedTuple):
    """
    A clock whose tick n is at `origin` + `phase` + n `interval`, ns.

    Stamps are later than their ticks by `lateness` in the mean, with the standard deviation
    `jitter`, by `largest` at most, and earlier by `margin` at most. They are multiples of
    `resolution`. All in ns.
    """

    origin: int
    phase: float
    interval: float
    lateness: float
    jitter: float
    largest: float
    margin: float
    resolution: float

    @property
    def reach(self) -> float:
        """By how many ticks a frame may be later than another with the same count."""
        return (self.largest + self.margin) / self.interval

    @property
    def is_rounded(self) -> bool:
        """Whether the rounding of the stamps explains how far they are off their ticks."""
        explained = self.resolution / 2 < self.largest <= (1 + TOLERANCE) * self.resolution
        return explained and COARSE <= self.resolution <= self.interval

    @property
    def is_even(self) -> bool:
        """Whether the stamps are exactly at the ticks of a clock, in coarse steps."""
        return self.largest <= 1.0 and self.resolution >= COARSE

    def ticks(self, stamps: np.ndarray) -> Real:
        """Ticks (T,) up to the `stamps` (T,), ns; their whole part is the latest possible count."""
        since = np.asarray(stamps) - self.origin
        return np.asarray((since - self.phase + self.margin) / self.interval)


def estimate_clock(stamps: np.ndarray, before: Clock | None) -> tuple[Clock, np.ndarray]:
    """
    Estimate the clock of `stamps` (N,), ns, of frames in order of capture, and count the frames.

    Intervals that are likely by the newest frames are refined with twice as many, and so on, as
    long as one of them holds: frames before a change of the rate are left out. The counts (n,) are
    of the newest frames that the clock holds for. N is at least `FEWEST_SAMPLES`.

    The clock `before`, by an earlier estimate, is kept if all stamps are near its ticks as they
    were, within a quarter of the interval: another rate would show. Else its interval is tried too.
    """
    resolution = float(max(np.gcd.reduce(np.diff(stamps)), 1))
    if before is not None and len(stamps) > SEARCHED and before.resolution == resolution:
        near = _counts_if_near(stamps, before)
        if near is not None:
            return before, near
    origin = int(stamps[0])
    since = (stamps - origin).astype(float)
    number = min(SEARCHED, len(since))
    newest = since[-number:]
    # Any share of the frames up to one half may have been lost, and the first may have come late.
    lost = np.arange(-1, number, 0.5) / (number - 1)
    mean = (newest[-1] - newest[0]) / (number - 1)
    intervals = _likeliest(newest, np.maximum(mean / (1 + lost), 1.0), resolution, 0)[1]
    known = [] if before is None else [before.interval]
    counts, intervals = _likeliest(newest, np.append(intervals, known), resolution, 2)
    while number < len(since):
        longer = min(2 * number, len(since))
        more, refined = _likeliest(since[-longer:], np.append(intervals, known), resolution, 2)
        # The rate has changed where the newest frames are likelier without the older ones, ...
        cost = _costs(newest, counts[:1], intervals[:1], resolution)[0]
        costs = _costs(newest, more[:, -number:], refined, resolution)
        best = int(costs.argmin())
        off = abs(refined[best] - intervals[0]) * number
        if costs[best] > cost + CHANGE_NATS and off > 2 * resolution:
            break
        # ... or where the older ones are much later.
        late = since[-longer:] - more[0] * refined[0]
        late -= late.min()
        if late[:-number].mean() > 2 * (late[-number:].mean() + resolution):
            break
        number, counts, intervals = longer, more, refined
        newest = since[-number:]
    clock = _fit_clock(origin, newest, counts[0], resolution)
    return clock, count_frames(stamps[-number:], clock)


def clock_of(
    clock: Clock, counts: np.ndarray, stamps: np.ndarray, which: np.ndarray, own: np.ndarray
) -> tuple[Clock, np.ndarray]:
    """
    The clock of `own` counts of `which` stamps, and the counts of the newest of all by it.

    But the `clock` with `counts` of the newest `stamps`, ns, where that is far likelier with fewer
    lost frames: the rate has changed.
    """
    held = which >= len(stamps) - len(counts)
    which, own = which[held], own[held]
    if len(own) < FEWEST_SAMPLES:
        return clock, counts
    first, own = int(which[0]), own - own[0]
    since = (stamps[which] - stamps[first]).astype(float)
    other = counts[which - (len(stamps) - len(counts))]
    other = other - other[0]
    fitted = _fit_clock(int(stamps[first]), since, own, clock.resolution)
    intervals = np.array([clock.interval, fitted.interval])
    costs = _costs(since, np.array([other, own]), intervals, clock.resolution)
    if costs[1] > costs[0] + CHANGE_NATS and other[-1] < own[-1]:
        return clock, counts
    counts = count_frames(stamps[first:], fitted)
    counts[which - first] = own
    return fitted, counts


def _counts_if_near(stamps: np.ndarray, clock: Clock) -> np.ndarray | None:
    """Counts (N,) of frames by their clock, if all `stamps` (N,) are still near its ticks."""
    counts = count_frames(stamps, clock)
    late = stamps - clock.origin - clock.phase - counts * clock.interval
    near = late.min() >= -1.0 and late.max() <= min(clock.largest + 1.0, clock.interval / 4)
    # Where more are lost than come it is the pace within bunches, not that of the camera.
    return counts if near and counts[-1] - counts[0] <= 2 * len(counts) else None


def count_frames(stamps: np.ndarray, clock: Clock) -> np.ndarray:
    """
    The latest counts (N,) of frames that neither their stamps nor later frames forbid.

    No frame is stamped before its tick, and each has a count of its own.
    """
    number = np.arange(len(stamps))
    ahead = np.floor(clock.ticks(stamps)).astype(np.int64) - number
    return np.asarray(number + np.minimum.accumulate(ahead[::-1])[::-1])


def _likeliest(
    since: Real, intervals: Real, resolution: float, rounds: int
) -> tuple[np.ndarray, Real]:
    """
    The likeliest intervals, best first, and the counts of frames `since` the first, ns, by them.

    Each interval is refined by so many `rounds` of counting frames and fitting the edge to them. Of
    intervals with equally many losses one is kept.
    """
    settled = max(FEWEST_SAMPLES, len(since) - UNSETTLED)
    counts = _counts_by(since, intervals, resolution)
    found = [(counts, intervals, _costs(since, counts, intervals, resolution))]
    for _ in range(rounds):
        intervals = _edge_intervals(since[:settled], counts[:, :settled])
        counts = _counts_by(since, intervals, resolution)
        found.append((counts, intervals, _costs(since, counts, intervals, resolution)))
    counts, intervals, costs = (np.concatenate(part) for part in zip(*found, strict=True))
    order = costs.argsort(kind='stable')
    _, first = np.unique(counts[order, settled - 1] - counts[order, 0], return_index=True)
    order = order[np.sort(first)[:KEPT]]
    if rounds:
        order = order[costs[order] <= costs[order[0]] + 2 * CHANGE_NATS]
    return counts[order], intervals[order]


def _costs(since: Real, counts: np.ndarray, intervals: Real, resolution: float) -> Real:
    """Minus the log likelihoods (I,) of `counts` (I, N) and `intervals` (I,), to a constant."""
    settled = max(FEWEST_SAMPLES, len(since) - UNSETTLED)
    late = (since - counts * intervals[:, None])[:, :settled]
    late = (late - late.min(axis=1, keepdims=True)).mean(axis=1)
    lost = counts[:, settled - 1] - counts[:, 0] - (settled - 1)
    share = (lost.clip(0) + 1) / (settled + lost.clip(0) + math.exp(LOSS_NATS))
    cost = settled * np.log(late + resolution / 4 + 1.0)
    cost -= lost * np.log(share) + settled * np.log1p(-share)
    # Of bunches, as above.
    return np.asarray(np.where(lost > settled, np.inf, cost))


def _counts_by(since: Real, intervals: Real, resolution: float) -> np.ndarray:
    """The latest counts (I, N) of frames `since` the first, ns, by `intervals` (I,), from 0 on."""
    number, steps = np.arange(len(since)), intervals[:, None]
    left = since - steps * number
    # The tick after which frames are late by the least time in the mean.
    late = np.sort(left % steps, axis=1)
    edge = (steps * number / len(since) - late).argmin(axis=1)
    phase = late[np.arange(len(late)), edge][:, None]
    least = np.minimum.accumulate(left[:, ::-1], axis=1)[:, ::-1]
    early = np.minimum(TOLERANCE * steps + resolution, steps / 2)
    lost = np.floor((least - phase + early) / steps)
    lost = np.maximum.accumulate(lost, axis=1).astype(np.int64)
    return np.asarray(number + lost - lost[:, :1])


def _edge_intervals(since: Real, counts: np.ndarray) -> Real:
    """
    Slopes (I,) of the lower edge of stamps `since` the first (N,), ns, over their counts (I, N).

    The edge of the lower hull at the middle frame is the most likely line where stamps are late by
    an exponential time (Smith 1985).
    """
    middle, rows = len(since) // 2, np.arange(len(counts))
    spoiled = _after_losses(counts)
    spoiled &= np.count_nonzero(~spoiled, axis=1)[:, None] > len(since) // 4
    slopes = (since[-1] - since[0]) / (counts[:, -1] - counts[:, 0])
    for _ in range(10):
        left = np.where(spoiled, np.inf, since - slopes[:, None] * counts)
        one = left[:, :middle].argmin(axis=1)
        other = middle + left[:, middle:].argmin(axis=1)
        before = slopes
        slopes = (since[other] - since[one]) / (counts[rows, other] - counts[rows, one])
        if (slopes == before).all():
            break
    # Frames may be so late that by the edge they run backward.
    mean = max(float(np.ptp(since)) / (len(since) - 1), 1.0)
    return np.where(slopes >= 1.0, slopes, mean)


def _interval(since: Real, counts: np.ndarray, resolution: float) -> float:
    """The interval, ns, by the lower and the upper edge of stamps: the sharper one counts more."""
    lower = float(_edge_intervals(since, counts[None])[0])
    upper = float(_edge_intervals(-since[::-1], -counts[None, ::-1])[0])
    late = np.sort(since - lower * counts)
    few = min(UNSETTLED, len(late) - 1)
    # An edge is known as well as the frames next to it are close.
    below, above = late[few] - late[0] + resolution, late[-1] - late[-1 - few] + resolution
    return float((lower / below**2 + upper / above**2) / (below**-2 + above**-2))


def _after_losses(counts: np.ndarray) -> np.ndarray:
    """Which frames (I, N) come soon after a loss by `counts` (I, N)."""
    after = np.zeros(counts.shape, bool)
    gaps = np.diff(counts) > 1
    for k in range(min(UNSETTLED, gaps.shape[1])):
        after[:, 1 + k :] |= gaps[:, : gaps.shape[1] - k]
    return after


def _fit_clock(origin: int, since: Real, counts: np.ndarray, resolution: float) -> Clock:
    """The clock of frames `since` the `origin`, ns, with `counts` (N,)."""
    settled = max(FEWEST_SAMPLES, len(since) - UNSETTLED)
    since, counts = since[:settled], counts[:settled]
    interval = _interval(since, counts, resolution)
    late = since - interval * counts
    spoiled = _after_losses(counts[None])[0]
    if np.count_nonzero(~spoiled) > settled // 4:
        late = late[~spoiled]
    phase = float(late.min())
    late -= phase
    # Half of what the lateness of no frame has left free before the next tick.
    free = interval - float(np.quantile(late % interval, 1 - 1 / 512))
    margin = min(max(free / 2, TOLERANCE * interval), interval / 2)
    return Clock(
        origin,
        phase,
        interval,
        float(late.mean()),
        float(late.std()),
        float(late.max()),
        margin,
        resolution,
    )
