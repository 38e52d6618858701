"""
The even clock of a camera, estimated from the stamps of its frames.

A camera captures frames at the ticks of an even clock. Its driver may stamp them when they arrive,
round the stamps and lose frames. A stamp is never before its tick, so the ticks are the lower edge
of the stamps, and a frame was lost where all later frames come at least one tick later than without
the loss.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.planar._plane import Real
from kinpole_ros.tracking.frame_intervals import (
    CHANGE_NATS,
    COARSE,
    TOLERANCE,
    UNSETTLED,
    after_losses,
    costs_of_counts,
    fit_interval,
    is_grid_coarse,
    likeliest_intervals,
)
from kinpole_ros.tracking.stamp_grid import count_on_grid

# Frames that the clock is estimated from: 10 s at 200 Hz.
MEMORY = 2000
# The interval is searched in so many of the newest frames; fewer do not show losses of 2%.
SEARCHED = 128
# Few frames that come faster than by this factor waited for a machine that stalled.
MAX_SPEEDUP = 4.0
# Frames that are ahead of the clock by more ticks have another rate.
MAX_AHEAD_TICKS = 1
# Most frames that wait until their count is certain: the usual lag at 200 Hz.
MAX_PENDING = 20
# The motion decides between stamps and ticks by so many nats.
DECISIVE_NATS = 6.0
# Half-life of the evidence of the motion, windows: 1 s for windows of 0.3 s.
HALF_LIFE = 3.3


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
    def max_lateness_ticks(self) -> float:
        """The most that a frame may be later than another with the same count, ticks."""
        return (self.largest + self.margin) / self.interval

    @property
    def is_rounded(self) -> bool:
        """Whether the lateness of the stamps is explained by their rounding."""
        explained = self.resolution / 2 < self.largest <= (1 + TOLERANCE) * self.resolution
        return explained and COARSE <= self.resolution <= self.interval

    @property
    def is_on_grid(self) -> bool:
        """Whether the stamps are on a grid whose steps are longer than half of the interval."""
        return self.is_rounded and self.interval < 2 * self.resolution

    @property
    def is_even(self) -> bool:
        """Whether the stamps are exactly at the ticks of a clock with a coarse resolution."""
        return self.largest <= 1.0 and self.resolution >= COARSE

    def ticks(self, stamps: np.ndarray) -> Real:
        """Return the ticks (T,) up to stamps (T,), ns: rounded down, the largest counts."""
        since = np.asarray(stamps) - self.origin
        return np.asarray((since - self.phase + self.margin) / self.interval)


class StampState(NamedTuple):
    """
    How stamps lie on the estimated clock.

    `interval`, `jitter` (rms) and `largest` lateness are in s. `regularized` is whether frames are
    taken to be at the ticks of the clock. `nats` is the evidence of the motion for that, negative
    if it is for the stamps. `costs` is whether the jitter moves markers by more than their noise.
    """

    interval: float
    jitter: float
    largest: float
    regularized: bool
    nats: float
    costs: bool


def estimate_clock(stamps: np.ndarray, before: Clock | None) -> tuple[Clock, np.ndarray]:
    """
    Estimate the clock of the stamps of frames, and count the frames.

    The likeliest intervals of the newest frames are refined with twice as many frames, and so on,
    until the rate is seen to change: frames before that are left out.

    Parameters
    ----------
    stamps : (N,) int64
        Stamps in the order of capture, ns; N is at least `FEWEST_SAMPLES`.
    before : Clock or None
        An earlier estimate. It is kept if all stamps are within a quarter of the interval of its
        ticks; otherwise its interval is tried too.

    Returns
    -------
    Clock
        The clock of the newest n frames.
    (n,) int64
        Their counts.

    """
    resolution = float(max(np.gcd.reduce(np.diff(stamps)), 1))
    if before is not None and len(stamps) > SEARCHED and before.resolution == resolution:
        near = counts_if_near(stamps, before)
        if near is not None:
            return before, near
    origin = int(stamps[0])
    since = (stamps - origin).astype(float)
    if np.ptp(np.diff(stamps)) <= 1:
        # No clock is likelier than the one whose frames all came, at its ticks.
        counts = np.arange(len(stamps))
        return _fit_clock(origin, since, counts, resolution), counts
    number = min(SEARCHED, len(since))
    newest = since[-number:]
    # Any share of the frames up to one half may have been lost, and the first may have come late.
    lost = np.arange(-1, number, 0.5) / (number - 1)
    mean = (newest[-1] - newest[0]) / (number - 1)
    intervals = likeliest_intervals(newest, np.maximum(mean / (1 + lost), 1.0), resolution, 0)[1]
    earlier = [] if before is None else [before.interval]
    counts, intervals = likeliest_intervals(newest, np.append(intervals, earlier), resolution, 2)
    while number < len(since):
        longer = min(2 * number, len(since))
        longer_counts, refined = likeliest_intervals(
            since[-longer:], np.append(intervals, earlier), resolution, 2
        )
        cost = costs_of_counts(newest, counts[:1], intervals[:1], resolution)[0]
        newer = number, float(intervals[0]), float(cost)
        if _rate_has_changed(since[-longer:], longer_counts, refined, newer, resolution):
            break
        number, counts, intervals = longer, longer_counts, refined
        newest = since[-number:]
    if is_grid_coarse(newest, resolution):
        likeliest = _counts_on_grid(newest, counts[0], resolution)
        return _fit_clock(origin, newest, likeliest, resolution), likeliest
    clock = _fit_clock(origin, newest, counts[0], resolution)
    return clock, count_frames(stamps[-number:], clock)


def even_clock(stamps: np.ndarray, on_grid: Clock) -> tuple[Clock, np.ndarray] | None:
    """
    Return the clock that ticks at each step of a grid, and counts (N,), instead of a slower one.

    None where frames have the same stamp (N,), ns, or step back.
    """
    counts = np.asarray((stamps - stamps[0]) // round(on_grid.resolution))
    if np.diff(counts).min() < 1:
        return None
    since = (stamps - stamps[0]).astype(float)
    return _fit_clock(int(stamps[0]), since, counts, on_grid.resolution), counts


def _rate_has_changed(
    since: Real,
    counts: np.ndarray,
    intervals: Real,
    newer: tuple[int, float, float],
    resolution: float,
) -> bool:
    """
    Whether the older of the frames `since` the first, ns, came at another rate than the newer ones.

    `counts` (I, N) and `intervals` (I,) are likely for all of them, best first. `newer` is the
    number of the newer frames, their interval, and its cost.
    """
    number, interval, cost = newer
    # The newer frames are likelier without the older ones, ...
    costs = costs_of_counts(since[-number:], counts[:, -number:], intervals, resolution)
    best = int(costs.argmin())
    off = abs(intervals[best] - interval) * number
    if costs[best] > cost + CHANGE_NATS and off > 2 * resolution:
        return True
    # ... or the older ones are much later.
    late = since - counts[0] * intervals[0]
    late -= late.min()
    return bool(late[:-number].mean() > 2 * (late[-number:].mean() + resolution))


def _counts_on_grid(since: Real, counts: np.ndarray, resolution: float) -> np.ndarray:
    """Counts (N,) of frames `since` the first, ns, or those of a driver that only rounds."""
    on_grid = count_on_grid(np.rint(since / resolution).astype(np.int64))
    if on_grid is None:
        return counts
    both = np.array([counts, on_grid])
    intervals = np.array([fit_interval(since, each, resolution) for each in both])
    return np.asarray(both[costs_of_counts(since, both, intervals, resolution).argmin()])


def clock_of(
    clock: Clock, counts: np.ndarray, stamps: np.ndarray, which: np.ndarray, own: np.ndarray
) -> tuple[Clock, np.ndarray]:
    """
    Estimate the clock of given counts of frames, and count the other frames by it.

    Parameters
    ----------
    clock, counts : Clock, (n,) int64
        An estimate by the stamps alone. It is returned if it is far likelier with fewer lost
        frames: then the rate has changed.
    stamps : (N,) int64
        All stamps, ns.
    which, own : (m,) int64
        Indices of the frames with given counts, and these counts.

    Returns
    -------
    Clock, (n,) int64
        The clock, and the counts of the newest frames.

    """
    is_counted = which >= len(stamps) - len(counts)
    which, own = which[is_counted], own[is_counted]
    if len(own) < FEWEST_SAMPLES:
        return clock, counts
    first, own = int(which[0]), own - own[0]
    since = (stamps[which] - stamps[first]).astype(float)
    by_stamps = counts[which - (len(stamps) - len(counts))]
    by_stamps = by_stamps - by_stamps[0]
    fitted = _fit_clock(int(stamps[first]), since, own, clock.resolution)
    intervals = np.array([clock.interval, fitted.interval])
    costs = costs_of_counts(since, np.array([by_stamps, own]), intervals, clock.resolution)
    if costs[1] > costs[0] + CHANGE_NATS and by_stamps[-1] < own[-1]:
        return clock, counts
    counts = count_frames(stamps[first:], fitted)
    counts[which - first] = own
    return fitted, counts


def count_until_slip(stamps: np.ndarray, clock: Clock, before: int, slipped_at: int | None) -> int:
    """
    Return how many of the next stamps come before it is clear that they slip by a rounding step.

    If even stamps slip, they were rounded all the time. The clock has to be updated before the
    second of two frames that are equally far off its ticks: another rate has no such frames.

    Parameters
    ----------
    stamps : (T,) int64
        Stamps, ns.
    clock : Clock
        Their clock, at whose ticks they were up to now.
    before : int
        The stamp before them, ns.
    slipped_at : int or None
        A stamp for which the clock was updated already, ns.

    """
    since = np.concatenate(((before,), stamps)) - clock.origin
    off = (since - clock.phase + clock.interval / 2) % clock.interval - clock.interval / 2
    if np.maximum.reduce(np.abs(off[1:])) <= COARSE / 2:
        return len(stamps)
    step = np.gcd(round(clock.resolution), since[1:])
    slips = (np.abs(off[1:]) > COARSE / 2) & (np.abs(off[1:]) <= (1 + TOLERANCE) * step)
    slips &= (np.abs(np.diff(off)) <= COARSE / 2) & (step >= COARSE) & (stamps != slipped_at)
    return int(slips.argmax()) if slips.any() else len(stamps)


def count_until_other_rate(
    recent: np.ndarray, stamps: np.ndarray, clock: Clock, count: int
) -> int | None:
    """
    Return how many of the next frames come until they show that the rate has changed.

    None if they do not. The newest frames, one more than `recent`, then come evenly, but in steps
    that are no multiple of the interval, or so fast that they are ahead of the clock.

    Parameters
    ----------
    recent : (R,) int64
        The stamps before them, ns.
    stamps : (T,) int64
        Their stamps, ns.
    clock : Clock
        Their clock up to now.
    count : int
        The count of the last frame before them.

    """
    number = len(recent) + 1
    newest = np.lib.stride_tricks.sliding_window_view(np.concatenate((recent, stamps)), number)
    since = newest - newest[:, :1]
    centered = np.arange(number) - (number - 1) / 2
    step = since @ (centered / (centered @ centered))
    span = np.ptp(since - step[:, None] * np.arange(number), axis=1)
    resolution = np.minimum(np.gcd.reduce(np.diff(since, axis=1), axis=1), clock.resolution)
    late = (1 + TOLERANCE) * np.maximum(3 * clock.jitter, resolution)
    # Where frames are later than that, those that come while others are lost may look even.
    is_even = (span <= late) & (late < clock.interval / 3)
    missed = np.abs(step - np.rint(step / clock.interval) * clock.interval) * (number - 1)
    is_slower = (step > clock.interval) & (missed > 2 * late)
    ahead = count + np.arange(1, len(stamps) + 1) - clock.ticks(stamps)
    is_faster = (clock.interval - step) * (number - 1) > 2 * late
    is_faster &= (MAX_SPEEDUP * step > clock.interval) & (ahead > MAX_AHEAD_TICKS)
    is_other = is_even & (is_slower | is_faster)
    return int(is_other.argmax()) + 1 if is_other.any() else None


def counts_if_near(stamps: np.ndarray, clock: Clock) -> np.ndarray | None:
    """Counts (N,) of frames by their clock, if all stamps (N,) are near its ticks."""
    counts = count_frames(stamps, clock)
    late = stamps - clock.origin - clock.phase - counts * clock.interval
    most = min(clock.largest + 1.0, clock.interval / 4)
    if clock.is_on_grid:
        most = clock.largest + clock.margin
    near = late.min() >= clock.largest - most - 1.0 and late.max() <= most
    lost = counts[-1] - counts[0] + 1 - len(counts)
    # Losses of an even clock may be those of a grid, which more frames show. With more lost frames
    # than others it is the rate within bunches, not that of the camera.
    return counts if near and lost <= (0 if clock.is_even else len(counts)) else None


def count_frames(stamps: np.ndarray, clock: Clock) -> np.ndarray:
    """
    Return the largest possible counts (N,) of frames.

    No frame is stamped before its tick, and no two frames have the same count.
    """
    number = np.arange(len(stamps))
    ahead = np.floor(clock.ticks(stamps)).astype(np.int64) - number
    return np.asarray(number + np.minimum.accumulate(ahead[::-1])[::-1])


def _fit_clock(origin: int, since: Real, counts: np.ndarray, resolution: float) -> Clock:
    """The clock of frames `since` the `origin`, ns, with `counts` (N,)."""
    settled = max(FEWEST_SAMPLES, len(since) - UNSETTLED)
    since, counts = since[:settled], counts[:settled]
    interval = fit_interval(since, counts, resolution)
    late = since - interval * counts
    spoiled = after_losses(counts[None])[0]
    if np.count_nonzero(~spoiled) > settled // 4:
        late = late[~spoiled]
    phase = float(late.min())
    late -= phase
    # Half of the time before the next tick in which no frame comes.
    ranked = np.sort(late % interval)
    last = len(ranked) - 1
    free = interval - float(np.interp((1 - 1 / 512) * last, np.arange(last + 1), ranked))
    margin = min(max(free / 2, TOLERANCE * interval), interval / 2)
    largest = float(late.max())
    clock = Clock(
        origin=origin,
        phase=phase,
        interval=interval,
        lateness=float(late.mean()),
        jitter=float(late.std()),
        largest=largest,
        margin=margin,
        resolution=resolution,
    )
    # Frames come at all times but for those just before a tick.
    return clock._replace(margin=(interval - largest) / 2) if clock.is_on_grid else clock
