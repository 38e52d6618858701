"""
Whether frames are at their stamps or at the ticks of the clock behind these.

Stamps alone cannot tell a camera with an even clock from frames that come unevenly: the motion can.
Each pose is predicted from its neighbors on both sides, once by the stamps and once by the ticks.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.planar._plane import Real
from kinpole_ros.tracking.clock import (
    CHANGE_NATS,
    COARSE,
    DECISIVE_NATS,
    HALF_LIFE,
    MEMORY,
    TOLERANCE,
    UNSETTLED,
    Clock,
    clock_of,
    estimate_clock,
)
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.thresholds import MIN_SAMPLES, N_SIGMA

# Neighbors on each side that predict a pose.
_SIDE = 3


class StampState(NamedTuple):
    """
    How stamps lie on the clock found behind them.

    `interval`, `jitter` (rms) and `largest` are in s; `regularized` is whether frames are taken to
    be at the ticks of the clock. `nats` is how much likelier motion makes that, negative where the
    stamps are right; `costs` is whether jitter moves the markers by more than their noise.
    """

    interval: float
    jitter: float
    largest: float
    regularized: bool
    nats: float
    costs: bool


class StampHistory:
    """
    The stamps of late, their clock, and whether frames are at its ticks (`regular`).

    `window`, ns, is as long as the estimates'; `mode` is the parameter `stamps`. `lost` frames were
    lost in all. `until_update` is how many frames may come before the clock is estimated anew.
    """

    def __init__(self, mode: str, window: int, before: 'StampHistory | None') -> None:
        self.mode, self._window = mode, window
        # Whether the motion said that frames are at ticks.
        self._by_motion: bool = before is not None and before._by_motion
        self.regular: bool = mode == 'arrival' if before is None else before.regular
        self.clock: Clock | None = None
        self.lost = 0
        self.until_update = FEWEST_SAMPLES
        self._seen = 0
        self._nats = self._speed = 0.0
        # Stamps of the frames, in parts, and which of them were taken and have poses.
        self._appended = [(np.zeros(0, np.int64), np.zeros(0, bool))]
        self._last = 0
        # Whether the next frame shows that stamps are rounded.
        self._slipped = False
        # Frames since the last update, and those taken that were not compared with neighbors yet.
        self._new = self._unweighed = 0

    def until_slip(self, stamps: np.ndarray) -> int:
        """
        How many of the next frames come before one that slips by a step of rounded stamps (T,), ns.

        Stamps that were even until then were rounded all the time. The clock is to be updated
        before such a frame.
        """
        clock = self.clock
        if self.mode != 'auto' or self.regular or clock is None or not clock.is_even:
            return len(stamps)
        since = stamps - clock.origin
        ticks = np.rint((since - clock.phase) / clock.interval)
        off = np.abs(since - clock.phase - ticks * clock.interval)
        if np.maximum.reduce(off) <= COARSE / 2:
            return len(stamps)
        step = np.gcd(round(clock.resolution), since)
        slips = (step >= COARSE) & (off > COARSE / 2) & (off <= (1 + TOLERANCE) * step)
        # Frames that come sooner than the clock ticks are of another rate.
        before = np.rint((self._last - clock.origin - clock.phase) / clock.interval)
        slips &= np.diff(ticks, prepend=before) > 0
        first = int(slips.argmax()) if slips.any() else len(stamps)
        if not first:
            self._slipped, self.until_update = True, 0
        return first

    def append(self, stamps: np.ndarray, taken: np.ndarray) -> None:
        """Append frames that have come with `stamps` (T,), ns, of which some are `taken`."""
        self._appended.append((stamps, taken))
        self._last = int(stamps[-1]) if len(stamps) else self._last
        self.until_update -= len(stamps)
        self._seen += len(stamps)
        self._new += len(stamps)
        self._unweighed += int(np.count_nonzero(taken))

    def update(
        self, history: History, samples: int, uncounted: int, noise: Real, counted: bool
    ) -> np.ndarray:
        """
        Estimate the clock, and decide by the motion of the last `samples` frames of the `history`.

        Returns the counts (n,) of the newest frames of the history: all but so many `uncounted` of
        the newest that were taken. `noise` (B,), m, is that of a marker of each body, NaN while not
        known. Where frames of the history are `counted` by the motion, the clock is that of these
        counts.
        """
        stamps, taken = (np.concatenate(parts) for parts in zip(*self._appended, strict=True))
        stamps, taken = stamps[-MEMORY:], taken[-MEMORY:]
        clock, counts = estimate_clock(stamps, self.clock)
        if counted:
            which = np.flatnonzero(taken)
            which = which[: len(which) - uncounted][-len(history) :]
            own = history['count'][len(history) - len(which) :]
            clock, counts = clock_of(clock, counts, stamps, which, own)
        taken = taken[len(taken) - len(counts) :]
        self._appended = [(stamps[len(stamps) - len(counts) :], taken)]
        self._count_lost(clock, counts)
        self.clock = clock
        counts = counts[taken]
        counts = counts[: len(counts) - uncounted]
        self._weigh(history, samples, counts, noise)
        self.regular = self._decide()
        # After a quarter more frames each time, and in the end after a tenth of all that are kept.
        self.until_update = min(max(1, self._seen // 4), MEMORY // 20)
        return counts

    def _count_lost(self, clock: Clock, counts: np.ndarray) -> None:
        """Add the frames that were lost between the new ones."""
        steps = np.diff(counts)[max(len(counts) - self._new - UNSETTLED - 1, 0) : -UNSETTLED]
        self._new = 0
        # Stamps that are out of order, say, are of no clock that could miss any.
        if self.regular or clock.largest < clock.interval / 2:
            self.lost += int((steps - 1).clip(0).sum())

    def _weigh(self, history: History, samples: int, counts: np.ndarray, noise: Real) -> None:
        """Add what the motion of the frames that were not looked at yet says."""
        assert self.clock is not None
        held = min(samples, len(counts), self._unweighed + _SIDE)
        centers = held - UNSETTLED - 2 * _SIDE
        if self._seen < MIN_SAMPLES or centers < 1:
            return
        self._unweighed = UNSETTLED + _SIDE
        rows = slice(len(history) - held, len(history) - UNSETTLED)
        counts = counts[len(counts) - held : len(counts) - UNSETTLED]
        interval, stamps = self.clock.interval, history['stamp'][rows]
        times = np.stack(((stamps - stamps[0]) / interval, (counts - counts[0]) * 1.0))
        signals, variance = _signals(history, rows, noise)
        nats, speed = _evidence(times, signals, variance)
        fading = 0.5 ** (centers * interval / (HALF_LIFE * self._window))
        # No more are kept: a driver may be changed.
        self._nats = float(np.clip(fading * self._nats + nats, -CHANGE_NATS, CHANGE_NATS))
        self._speed = max(speed, fading * self._speed)

    def _decide(self) -> bool:
        """Whether frames are at ticks from now on."""
        clock = self.clock
        if self.mode != 'auto' or clock is None:
            return self.regular
        if abs(self._nats) > DECISIVE_NATS:
            self._by_motion = self._nats > 0
        rounded = clock.is_rounded or self._slipped
        rounded = rounded and self._seen >= MIN_SAMPLES and self._nats > -DECISIVE_NATS
        self._slipped = False
        # Frames are not late by windows: then it is no clock.
        return (self._by_motion or rounded) and clock.largest < self._window

    def state(self) -> StampState | None:
        """How the stamps are; None while too few have come."""
        clock = self.clock
        if clock is None:
            return None
        jitter = clock.jitter / clock.interval
        costs = not self.regular and self._nats > -DECISIVE_NATS and jitter * self._speed > 1.0
        scale = 1e-9
        return StampState(
            clock.interval * scale,
            clock.jitter * scale,
            clock.largest * scale,
            self.regular,
            self._nats,
            costs,
        )


def _signals(history: History, rows: slice, noise: Real) -> tuple[Real, Real]:
    """Angles, and coordinates (T, 3 B), of some frames, with their variances."""
    turns, position = history['turns'][rows], history['position'][rows]
    angle = history['angle'][rows] + 2 * np.pi * (turns - turns[0])
    signals = np.concatenate((angle, position.real, position.imag), axis=1)
    information = history['information'][rows]
    level = np.where(np.isfinite(noise), noise, 0.0)
    with np.errstate(divide='ignore'):
        inverse = np.where(information > 0, 1 / information, np.nan)
    # Where noise is not known yet it is what predictions leave.
    square = np.maximum(level, 1e-9) ** 2
    of_angle, even = inverse[:, 0] * square, inverse[:, 1] * square
    return signals, np.concatenate((of_angle, even, even), axis=1)


@np.errstate(divide='ignore', invalid='ignore')
def _evidence(times: Real, signals: Real, variance: Real) -> tuple[float, float]:
    """
    By how many nats signals make the second of two sequences of times likelier than the first.

    `times` (2, N) are in intervals, `signals` (N, S) have the `variance` (N, S), NaN where not
    known: `times` are stamps and ticks. Each signal is predicted by the polynomial through its
    neighbors on both sides. Also the largest rms rate of a signal by interval, in its deviations.
    """
    here = np.arange(_SIDE, len(signals) - _SIDE)
    there = here[:, None] + np.array([k for k in range(-_SIDE, _SIDE + 1) if k])
    stamps, ticks = times
    steps = ticks[there] - ticks[here, None]  # (M, 2 side)
    others = steps[:, None, :] - steps[:, :, None]
    ratios = np.where(others == 0, 1.0, steps[:, None, :] / others)
    weights = ratios.prod(axis=2)
    # What a stamp that is right moves a signal by, off where it is at its tick. By slopes, which
    # hardly have noise: what does not move says nothing.
    nearby = here[:, None] + np.arange(-_SIDE, _SIDE + 1)
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
    cost = np.minimum(squares / scale, N_SIGMA**2)
    # What neighbors predict is correlated: there is half as much evidence as predictions.
    nats = float((cost[0] - cost[1]).sum() / 2) / 2
    rate = np.diff(signals, axis=0) ** 2 / np.where(variance[1:] > 0, variance[1:], np.nan)
    rate = rate[np.isfinite(rate).all(axis=1)]
    speed = float(np.sqrt(rate.mean(axis=0).max())) if rate.size else 0.0
    return nats, speed
