"""
Frames that were stamped by a timer that ticks hardly faster than they come.

A camera of 60 Hz whose stamps are multiples of 15.6 ms has gaps of one and of two multiples. By the
stamps alone that is an even clock of 64 Hz with losses, but these come regularly.
"""

import math

import numpy as np

from kinpole_ros.planar._plane import Real

# Newest frames in which the interval is searched, and fewest steps of the grid without a frame.
_SEARCHED, _FEWEST_EMPTY = 256, 3
# Candidates are so dense that this share of the time before a tick, in which no frame comes, is
# seen at one of them.
_SEEN_SHARE = 0.6
# Halvings of the slope of the narrowest strip.
_HALVINGS = 40
# Steps of the grid by which the earliest stamp may be late, and the least mean lateness of a driver
# that is tried.
_EDGES, _LEAST_LATENESS = (0.02, 0.1, 0.5, 0.9), 0.01


def rounding_nats(late: Real) -> Real:
    """
    Return the least negative log likelihoods (I,) of stamps that are rounded down to a grid.

    A driver that is late by an exponential time stamps a frame in a step of the grid with the
    probability of that step. It is 1 for the step of the tick, if the driver is not late.

    Parameters
    ----------
    late : (I, N) float
        Lateness of the stamps, steps of the grid, relative to the earliest.

    """
    least = np.full(len(late), np.inf)
    for edge in _EDGES:
        # The time from a tick to the end of the step of its stamp.
        until = late + edge
        beyond = np.maximum(until - 1.0, 0.0)
        # The mean lateness, if ticks are anywhere in their steps, or at the start of them.
        for mean in (until.mean(axis=1) - 0.5, beyond.mean(axis=1)):
            mean = np.maximum(mean, _LEAST_LATENESS)[:, None]
            nats = beyond / mean - np.log1p(-np.exp(-np.minimum(until, 1.0) / mean))
            least = np.minimum(least, nats.sum(axis=1))
    return np.asarray(least)


def count_on_grid(multiples: np.ndarray) -> np.ndarray | None:
    """
    Count the frames of an even clock that is slower than its grid, but less than twice.

    Parameters
    ----------
    multiples : (N,) int64
        Stamps, steps of the grid.

    Returns
    -------
    (N,) int64 or None
        Counts with few losses at which all frames are late by less than a step; None if no interval
        explains an eighth of the empty steps.

    """
    since = (multiples - multiples[0]).astype(float)
    newest = since[-_SEARCHED:] - since[-_SEARCHED:][0]
    mean = newest[-1] / (len(newest) - 1)
    if newest[-1] + 1 - len(newest) < _FEWEST_EMPTY or mean >= 2.0:
        return None
    # Most of the empty steps may be losses.
    most, least = mean + 1.0 / len(newest) - 1.0, (mean - 1.0) / 8
    # From one candidate to the next, frames drift by half of the time in which none comes.
    count = math.ceil(2 * len(newest) * math.log(most / least))
    intervals = 1.0 + np.geomspace(most, least, count)
    late = np.sort(newest % intervals[:, None], axis=1)
    free = np.diff(late, axis=1, append=late[:, :1] + intervals[:, None]).max(axis=1)
    for interval in intervals[free > _SEEN_SHARE * (intervals - 1.0)]:
        counts, slope = _counts_near(newest, float(interval))
        number = len(newest)
        while counts is not None and number < len(since):
            number = min(number + number // 4, len(since))
            counts, slope = _counts_near(since[-number:] - since[-number], slope)
        if counts is not None:
            return counts
    return None


def _counts_near(since: Real, interval: float) -> tuple[np.ndarray | None, float]:
    """Counts (N,) of frames `since` the first, steps, near an interval, and a better interval."""
    late = np.sort(since % interval)
    free = np.diff(late, append=late[0] + interval)
    widest = int(free.argmax())
    counts = np.rint((since - late[widest] - free[widest] / 2) / interval - 0.5)
    if np.diff(counts).min() < 1:
        return None, interval
    slope, width = _narrowest_strip(counts, since, interval)
    # A strip of one step has frames on one edge of it only.
    return (counts - counts[0]).astype(np.int64) if width < 1.0 else None, slope


def _narrowest_strip(counts: Real, since: Real, slope: float) -> tuple[float, float]:
    """Slope and width of the narrowest strip about times `since` (N,) over their counts (N,)."""
    low, high = slope - 1.0 / len(counts), slope + 1.0 / len(counts)
    width = np.inf
    for _ in range(_HALVINGS):
        slope = (low + high) / 2
        off = since - slope * counts
        top, bottom = int(off.argmax()), int(off.argmin())
        width = float(off[top] - off[bottom])
        if counts[top] > counts[bottom]:
            low = slope
        else:
            high = slope
    return slope, width
