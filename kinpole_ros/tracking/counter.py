"""
Counts of frames that come late: how many frames were lost before each, by stamps and by the motion.

A stamp that is late by more than a tick may mean that frames were lost, or that this one was late.
So all ways in which the last frames may be counted are kept until one is sure.
"""

import math
from collections import deque

import numpy as np

from kinpole_ros.planar._plane import Real
from kinpole_ros.tracking.clock import LOSS_NATS, MAX_PENDING, TOLERANCE, UNSETTLED, Clock

# Paths that are looked at: those that are likeliest, within so many nats.
MOST_PATHS, SURE_NATS = 32, 20.0
# A count is sure if it is wrong with this probability.
WRONG = 1 / 100
# Frames that are ahead of the clock by more than so many ticks are of another rate.
MOST_AHEAD = 1
# The highest degree of the polynomials that the motion is held against.
HIGHEST_DEGREE = 6


class Counter:
    """
    Counts frames as they come, by a `clock` and by the motion.

    `count` is that of the newest frame whose count is sure; those after it are pending. A path says
    how many frames were lost before each of them, and costs what its losses, the lateness of its
    frames and the motion say, nats.
    """

    def __init__(self, clock: Clock, count: int) -> None:
        self.count, self.noise = count, np.nan
        # Of a frame that was lost.
        self._loss_nats = LOSS_NATS
        # Coordinates of the markers of the pending frames, and of some before them.
        self._values: deque[Real] = deque(maxlen=UNSETTLED + MAX_PENDING + 1)
        self._before = np.zeros(0, np.int64)
        self._forget()
        self.follow(clock)

    def _forget(self) -> None:
        """No frame is pending."""
        self._paths, self._costs = np.zeros((1, 0), np.int64), np.zeros(1)

    def follow(self, clock: Clock) -> None:
        """Go by a clock that is known better, by the same counts."""
        self.clock, self._shift = clock, 0
        self._late_nats = clock.interval / max(clock.lateness, 1.0)

    @property
    def pending(self) -> int:
        """How many of the newest frames wait for their count."""
        return self._paths.shape[1]

    @property
    def keeps_pace(self) -> bool:
        """Whether frames come no faster than the clock ticks."""
        return self._shift <= MOST_AHEAD

    def plain(self, stamps: np.ndarray) -> int:
        """How many of the next frames (T,) come before the first with more than one count."""
        if self.pending:
            return 0
        ticks = self.clock.ticks(stamps) + self._shift
        expected = self.count + np.arange(1, len(stamps) + 1)
        doubtful = (np.floor(ticks) > expected) | (np.floor(ticks + TOLERANCE) < expected)
        return int(doubtful.argmax()) if np.count_nonzero(doubtful) else len(stamps)

    def take_plain(self, points: Real) -> np.ndarray:
        """Count frames that are plain, with `points` (T, ...); returns the counts (T,)."""
        counts = self.count + np.arange(1, len(points) + 1)
        for values in points[-UNSETTLED:]:
            self._values.append(values.ravel())
        self._before = np.concatenate((self._before, counts))[-UNSETTLED:]
        self.count = int(counts[-1])
        return counts

    def take(self, stamp: int, points: Real) -> np.ndarray:
        """
        Count the next frame, with `points` of any shape, NaN for those not seen.

        Returns the counts that are sure now, of the frames from the oldest that was pending on.
        """
        self._values.append(points.ravel())
        number = self.pending + 1
        tick = float(self.clock.ticks(np.array(stamp))) + self._shift
        most = math.floor(tick) - self.count - number
        if most < 0:
            # Unless the edge was not known well.
            self._shift += max(self.count + number - math.floor(tick + TOLERANCE), 0)
            most = 0
        if not most:
            # Nor were any lost before those that are pending.
            return self._settle(number, np.zeros((1, number), np.int64), np.zeros(1))
        self._extend(most)
        costs = self._costs + self._motion_costs()
        order = costs.argsort(kind='stable')[:MOST_PATHS]
        order = order[costs[order] < costs[order[0]] + SURE_NATS]
        paths = self._paths[order]
        weights = np.exp(costs[order[0]] - costs[order])
        doubt = weights @ (paths != paths[0]) / weights.sum()
        sure = (doubt < WRONG).nonzero()[0]
        known = max(int(sure[-1]) + 1 if len(sure) else 0, number - MAX_PENDING)
        return self._settle(known, paths, self._costs[order])

    def learn_losses(self, counts: np.ndarray) -> None:
        """Learn from `counts` (T,) how often a frame is lost."""
        if len(counts):
            lost = max(int(counts[-1] - counts[0]) + 1 - len(counts), 0)
            self._loss_nats = math.log((len(counts) + lost + math.exp(LOSS_NATS)) / (lost + 1))

    def take_pending(self) -> np.ndarray:
        """Count all that are pending as is likeliest; returns the counts."""
        return self._settle(self.pending, self._paths, self._costs)

    def move(self, offset: int) -> None:
        """Let all counts be larger by so many."""
        self.count += offset
        self._before = self._before + offset

    def _extend(self, most: int) -> None:
        """Go on with the next frame, before which at most so many were lost in all."""
        before = self._paths[:, -1] if self.pending else np.zeros(1, np.int64)
        if before.min() > most:
            self._paths = np.minimum(self._paths, most)
            before = self._paths[:, -1]
        # Either nothing was lost now, or the frame is no later than the latest.
        least = max(most - min(math.ceil(self.clock.reach), MAX_PENDING), 0)
        lost = np.unique(np.concatenate((before, np.arange(least, most + 1))))
        path, which = ((lost >= before[:, None]) & (lost <= most)).nonzero()
        more = lost[which] - before[path]
        self._costs = self._costs[path] + self._loss_nats * np.minimum(more, 2)
        # No frame tells more: a driver hangs for once about as often as frames are lost.
        self._costs += np.minimum((most - lost[which]) * self._late_nats, LOSS_NATS)
        self._paths = np.column_stack((self._paths[path], lost[which]))

    def _settle(self, known: int, paths: np.ndarray, costs: Real) -> np.ndarray:
        """Take so many of the pending as the first of the `paths` has them."""
        self._paths, self._costs = paths, costs
        if not known:
            return np.zeros(0, np.int64)
        counts = self.count + np.arange(1, known + 1) + paths[0, :known]
        same = paths[:, known - 1] == paths[0, known - 1]
        left, first = np.unique(
            paths[same, known:] - paths[0, known - 1], axis=0, return_index=True
        )
        order = first.argsort()
        self._paths, self._costs = left[order], costs[same][first[order]]
        if known == paths.shape[1]:
            self._forget()
        self.count = int(counts[-1])
        self._before = np.concatenate((self._before, counts))[-UNSETTLED:]
        return counts

    def _motion_costs(self) -> Real:
        """How unlikely (H,), nats, the motion makes each path."""
        newest = self._values[-1]
        pending = self.pending
        values = list(self._values)[-(pending + len(self._before)) :]
        same_layout = [k for k, one in enumerate(values) if one.shape == newest.shape]
        values = np.array([values[k] for k in same_layout])
        before = np.broadcast_to(self._before, (len(self._paths), len(self._before)))
        sure = self.count + np.arange(1, pending + 1) + self._paths
        counts = np.concatenate((before, sure), axis=1)[:, -len(self._values) :]
        counts = counts[:, same_layout] - counts[0, -1]
        seen = ~np.isnan(values)
        deviation = self.noise if self.noise > 0 else np.finfo(float).tiny ** 0.5
        costs = np.zeros(len(counts))
        for rows in np.unique(seen, axis=1).T:
            same = (seen == rows[:, None]).all(axis=0)
            costs += motion_costs(counts[:, rows], values[np.ix_(rows, same)] / deviation)
        return costs


def motion_costs(counts: np.ndarray, values: Real) -> Real:
    """
    How unlikely (H,), nats, polynomials in `counts` (H, N) make `values` (N, S), in deviations.

    Each has the degree that its evidence is best with, by Schwarz's criterion: a fast motion that a
    cubic cannot follow would else say that a frame was lost, or was not.
    """
    number = len(values)
    highest = min(HIGHEST_DEGREE, number - 3)
    if highest < 1:
        return np.zeros(len(counts))
    scaled = (counts - counts.mean(axis=1, keepdims=True)) / max(np.ptp(counts), 1)
    basis, _ = np.linalg.qr(scaled[..., None] ** np.arange(highest + 1))
    values = values - values.mean(axis=0)
    squares = (basis.swapaxes(1, 2) @ values) ** 2
    left = (values**2).sum(axis=0) - squares.cumsum(axis=1)  # (H, degrees, S)
    left = np.maximum(left[:, 1:], 0.0)
    degrees = np.arange(1, highest + 1)[:, None]
    # Where no polynomial follows the motion, or the noise is not known.
    scale = np.maximum((left / (number - degrees - 1)).min(axis=(0, 1)), 1.0)
    costs = (left / scale + degrees * math.log(number)).min(axis=1) / 2
    return np.asarray(costs.sum(axis=1))
