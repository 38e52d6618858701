"""
Counts of frames as they come: how many were lost before each, by the clock and by the motion.

A stamp that is late by more than a tick may mean that frames were lost or that this one was late.
So all ways in which the last frames may be counted are kept until one is sure.
"""

import math
from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np

from kinpole_ros.pipeline.clock import LOSS, SURE_NATS, Clock
from kinpole_ros.planar._plane import Real
from kinpole_ros.rigid.levels import TINY

# What paths (H, n) of the pending frames cost by the motion, nats (H,).
Motion: TypeAlias = Callable[[np.ndarray], Real]
# Of a sure count one in a hundred is wrong.
_DOUBT = 1 / 100
# So many paths are looked at, and so many frames at most wait for their count.
_MOST_PATHS, _MOST_PENDING = 32, 20
# A frame that comes more than this share of the interval before its tick has another.
_EARLY = 0.2


class FrameCounter:
    """
    Counts frames as they come, by a clock and by the motion.

    `count` is that of the newest frame whose count is sure; those after it are pending. What they
    may have is a handful of paths: how many frames were lost before each of them. A path costs
    what its losses, the lateness of its frames and the motion say, nats.
    """

    def __init__(self, clock: Clock, count: int) -> None:
        self.count = count
        self._forget()
        self.follow(clock)

    def _forget(self) -> None:
        """None is pending."""
        # Frames lost (H, n) before each of the pending, by path, and what that costs by stamps.
        self._paths = np.zeros((1, 0), np.int64)
        self._costs = np.zeros(1)

    def follow(self, clock: Clock) -> None:
        """Go by a clock that is known better, by these counts."""
        self.clock, self._shift = clock, 0
        self._weight_of_tick = clock.interval / max(clock.lateness, 1.0)

    @property
    def pending(self) -> int:
        """How many of the newest frames wait for their count."""
        return self._paths.shape[1]

    @property
    def likely(self) -> np.ndarray:
        """The likeliest counts of the pending."""
        return self.count + np.arange(1, self.pending + 1) + self._paths[0]

    @property
    def newest(self) -> int:
        """The likeliest count of the newest frame."""
        return int(self.likely[-1]) if self.pending else self.count

    def expected(self, stamps: np.ndarray) -> np.ndarray:
        """Counts (T,) of the next frames until they are counted: none is later than the latest."""
        ticks = self.clock.ticks(stamps) + self._shift
        # Of even stamps these are whole numbers but for rounding, which must not count a frame.
        least = np.minimum(np.ceil(ticks - self.clock.reach - TINY), np.floor(ticks))
        number = np.arange(1, len(stamps) + 1)
        ahead = np.maximum(least.astype(np.int64) - number, self.newest)
        return np.asarray(np.maximum.accumulate(ahead) + number)

    def until_doubt(self, stamps: np.ndarray) -> int:
        """How many of the next frames (T,) come up to the first with more than one count to it."""
        if self.pending:
            return 1
        ticks = self.clock.ticks(stamps) + self._shift
        next_ones = self.count + np.arange(1, len(stamps) + 1)
        doubtful = (np.floor(ticks) > next_ones) | (np.floor(ticks + _EARLY) < next_ones)
        return int(doubtful.argmax()) + 1 if np.count_nonzero(doubtful) else len(stamps)

    def take(self, stamps: np.ndarray, motion: Motion) -> Iterator[np.ndarray]:
        """
        Count frames with `stamps` (T,), ns: after each, the counts (n,) that are sure now.

        They are of the frames from the oldest that was pending on.
        """
        for tick in self.clock.ticks(stamps).tolist():
            yield self._next(tick, motion)

    def _next(self, tick: float, motion: Motion) -> np.ndarray:
        number = self.pending + 1
        tick += self._shift
        most = math.floor(tick) - self.count - number
        if most < 0:
            # Unless the edge was not known well.
            early = self.count + number - math.floor(tick + _EARLY)
            if early > 0:
                self._shift += early
            most = 0
        if not most:
            # Nor were any lost before those that are pending.
            self.count += number
            self._forget()
            return np.arange(self.count - number + 1, self.count + 1)
        self._extend(most)
        costs = self._costs + motion(self._paths)
        order = costs.argsort(kind='stable')[:_MOST_PATHS]
        order = order[costs[order] < costs[order[0]] + SURE_NATS]
        self._paths, self._costs = self._paths[order], self._costs[order]
        weights = np.exp(costs[order[0]] - costs[order])
        doubt = weights @ (self._paths != self._paths[0]) / weights.sum()
        sure = (doubt < _DOUBT).nonzero()[0]
        known = max(int(sure[-1]) + 1 if len(sure) else 0, number - _MOST_PENDING)
        return self._settle(known)

    def _extend(self, most: int) -> None:
        """Go on with the next frame, before which at most so many were lost in all."""
        number = self.pending
        before = self._paths[:, -1] if number else np.zeros(1, np.int64)
        if before.min() > most:
            self._paths = np.minimum(self._paths, most)
            before = self._paths[:, -1]
        # Either nothing was lost now, or the frame is no later than the latest, nor than it may
        # wait for its count.
        least = max(most - min(math.ceil(self.clock.reach), _MOST_PENDING), 0)
        lost = np.unique(np.concatenate((before, np.arange(least, most + 1))))
        path, which = ((lost >= before[:, None]) & (lost <= most)).nonzero()
        more = lost[which] - before[path]
        self._costs = self._costs[path] + LOSS * np.minimum(more, 2)
        # No frame tells more: a driver hangs for once about as often as frames are lost.
        self._costs += np.minimum((most - lost[which]) * self._weight_of_tick, LOSS)
        self._paths = np.column_stack((self._paths[path], lost[which]))

    def _settle(self, known: int) -> np.ndarray:
        """Take so many of the pending as the likeliest path has them."""
        if not known:
            return np.zeros(0, np.int64)
        counts = self.likely[:known]
        if known == self.pending:
            self._forget()
            self.count = int(counts[-1])
            return counts
        lost = self._paths[0, known - 1]
        same = self._paths[:, known - 1] == lost
        paths, first = np.unique(self._paths[same, known:] - lost, axis=0, return_index=True)
        order = first.argsort()
        self._paths, self._costs = paths[order], self._costs[same][first[order]]
        self.count = int(counts[-1])
        return counts
