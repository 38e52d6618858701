"""
The decision whether frames are at their stamps or at the ticks of the clock behind the stamps.

Stamps alone cannot distinguish an even camera with late stamps from frames that come unevenly, but
the motion can. Each pose is predicted from its neighbors on both sides, once at the stamps and once
at the ticks.
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

# Number of neighbors on each side from which a pose is predicted.
_SIDE = 3


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


class StampHistory:
    """
    The recent stamps, their clock, and whether frames are at its ticks (`regular`).

    `window`, ns, is that of the derivatives, and `mode` the parameter `stamps`. `lost` counts all
    lost frames. The clock is estimated again after `until_update` more frames.
    """

    def __init__(self, mode: str, window: int, before: 'StampHistory | None') -> None:
        self.mode, self._window = mode, window
        # Whether the motion has decided for ticks.
        self._motion_says_ticks: bool = before is not None and before._motion_says_ticks
        self.regular: bool = mode == 'arrival' if before is None else before.regular
        self.clock: Clock | None = None
        self.lost = 0
        self.until_update = FEWEST_SAMPLES
        self._seen = 0
        self._nats = self._speed = 0.0
        # Stamps of the frames, in parts, and which of the frames are used.
        self._appended = [(np.zeros(0, np.int64), np.zeros(0, bool))]
        self._last = 0
        # Whether the next frame shows that the stamps are rounded, and the last stamp of such one.
        self._has_slipped = False
        self._slipped_at: int | None = None
        # Frames since the last update, and used frames that were not compared with neighbors yet.
        self._new = self._unweighed = 0

    def until_slip(self, stamps: np.ndarray) -> int:
        """
        Return how many of the next stamps (T,), ns, come before one that slips by a rounding step.

        If even stamps slip, they were rounded all the time. The clock has to be updated before that
        frame.
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
        # Two frames within a tick have another rate.
        before = np.rint((self._last - clock.origin - clock.phase) / clock.interval)
        slips &= np.diff(ticks, prepend=before) > 0
        # The clock was updated for this frame already.
        slips &= stamps != self._slipped_at
        first = int(slips.argmax()) if slips.any() else len(stamps)
        if not first:
            self._has_slipped, self._slipped_at, self.until_update = True, int(stamps[0]), 0
        return first

    def append(self, stamps: np.ndarray, is_used: np.ndarray) -> None:
        """Append the stamps (T,), ns, of new frames, some of which are used."""
        self._appended.append((stamps, is_used))
        self._last = int(stamps[-1]) if len(stamps) else self._last
        self.until_update -= len(stamps)
        self._seen += len(stamps)
        self._new += len(stamps)
        self._unweighed += int(np.count_nonzero(is_used))

    def update(
        self, history: History, samples: int, uncounted: int, noise: Real, counted: bool
    ) -> np.ndarray:
        """
        Estimate the clock, and decide by the motion whether frames are at its ticks.

        Parameters
        ----------
        history : History
            The frames.
        samples : int
            Number of the newest frames whose motion is used.
        uncounted : int
            Number of used frames that are not in the history yet.
        noise : (B,) float
            Noise of a marker of each body, m, NaN while not known.
        counted : bool
            Whether the frames of the history were counted by the motion. Then the clock is that of
            these counts.

        Returns
        -------
        (n,) int64
            Counts of the newest frames of the history.

        """
        stamps, is_used = (np.concatenate(arrays) for arrays in zip(*self._appended, strict=True))
        stamps, is_used = stamps[-MEMORY:], is_used[-MEMORY:]
        clock, counts = estimate_clock(stamps, self.clock)
        if counted:
            which = np.flatnonzero(is_used)
            which = which[: len(which) - uncounted][-len(history) :]
            own = history['count'][len(history) - len(which) :]
            clock, counts = clock_of(clock, counts, stamps, which, own)
        is_used = is_used[len(is_used) - len(counts) :]
        self._appended = [(stamps[len(stamps) - len(counts) :], is_used)]
        self._count_lost(clock, counts)
        self.clock = clock
        counts = counts[is_used]
        counts = counts[: len(counts) - uncounted]
        self._weigh(history, samples, counts, noise)
        self.regular = self._decide()
        # After a quarter more frames, and at the latest after a twentieth of those remembered.
        self.until_update = min(max(1, self._seen // 4), MEMORY // 20)
        return counts

    def _count_lost(self, clock: Clock, counts: np.ndarray) -> None:
        """Count the frames that were lost between the new ones."""
        steps = np.diff(counts)[max(len(counts) - self._new - UNSETTLED - 1, 0) : -UNSETTLED]
        self._new = 0
        # Stamps far from all ticks do not show any loss.
        if self.regular or clock.largest < clock.interval / 2:
            self.lost += int((steps - 1).clip(0).sum())

    def _weigh(self, history: History, samples: int, counts: np.ndarray, noise: Real) -> None:
        """Add the evidence of the motion in the frames that were not compared yet."""
        assert self.clock is not None
        used = min(samples, len(counts), self._unweighed + _SIDE)
        centers = used - UNSETTLED - 2 * _SIDE
        if self._seen < MIN_SAMPLES or centers < 1:
            return
        self._unweighed = UNSETTLED + _SIDE
        rows = slice(len(history) - used, len(history) - UNSETTLED)
        counts = counts[len(counts) - used : len(counts) - UNSETTLED]
        interval, stamps = self.clock.interval, history['stamp'][rows]
        times = np.stack(((stamps - stamps[0]) / interval, (counts - counts[0]) * 1.0))
        signals, variance = _signals(history, rows, noise)
        nats, speed = _evidence(times, signals, variance)
        fading = 0.5 ** (centers * interval / (HALF_LIFE * self._window))
        # Bounded, since the driver may change.
        self._nats = float(np.clip(fading * self._nats + nats, -CHANGE_NATS, CHANGE_NATS))
        self._speed = max(speed, fading * self._speed)

    def _decide(self) -> bool:
        """Whether frames are taken to be at ticks from now on."""
        clock = self.clock
        if self.mode != 'auto' or clock is None:
            return self.regular
        if abs(self._nats) > DECISIVE_NATS:
            self._motion_says_ticks = self._nats > 0
        rounded = clock.is_rounded or self._has_slipped
        rounded = rounded and self._seen >= MIN_SAMPLES and self._nats > -DECISIVE_NATS
        self._has_slipped = False
        # No clock explains lateness of a window or more.
        return (self._motion_says_ticks or rounded) and clock.largest < self._window

    def state(self) -> StampState | None:
        """Return how the stamps lie on the clock; None while too few have come."""
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
    """Angles and coordinates (T, 3 B) of some frames, with their variances."""
    turns, position = history['turns'][rows], history['position'][rows]
    angle = history['angle'][rows] + 2 * np.pi * (turns - turns[0])
    signals = np.concatenate((angle, position.real, position.imag), axis=1)
    information = history['information'][rows]
    level = np.where(np.isfinite(noise), noise, 0.0)
    with np.errstate(divide='ignore'):
        inverse = np.where(information > 0, 1 / information, np.nan)
    # While the noise is not known, `_evidence` scales by the residuals.
    square = np.maximum(level, 1e-9) ** 2
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
    centers = np.arange(_SIDE, len(signals) - _SIDE)
    neighbors = centers[:, None] + np.array([k for k in range(-_SIDE, _SIDE + 1) if k])
    stamps, ticks = times
    steps = ticks[neighbors] - ticks[centers, None]  # (M, 2 side)
    differences = steps[:, None, :] - steps[:, :, None]
    ratios = np.where(differences == 0, 1.0, steps[:, None, :] / differences)
    weights = ratios.prod(axis=2)
    # Shift of a signal from its tick to its stamp, by slopes, which have little noise. Signals that
    # do not change give no evidence.
    nearby = centers[:, None] + np.arange(-_SIDE, _SIDE + 1)
    around = ticks[nearby] - ticks[nearby].mean(axis=1, keepdims=True)
    slopes = np.einsum('mk,mks->ms', around, signals[nearby])
    slopes /= (around**2).sum(axis=1, keepdims=True)
    early = ticks - stamps
    early = early - np.median(early)
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
