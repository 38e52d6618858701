"""
Counts of frames whose stamps are late: how many frames were lost, by the stamps and the motion.

If a stamp is late by more than a tick, either frames were lost or this frame was late. All possible
counts of the last frames, the hypotheses, are followed until one of them is certain.
"""

import math
from collections import deque

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.planar._plane import ROUNDING, Real
from kinpole_ros.tracking.clock import MAX_AHEAD_TICKS, MAX_PENDING, Clock
from kinpole_ros.tracking.frame_intervals import LOSS_NATS, TOLERANCE, UNSETTLED
from kinpole_ros.tracking.rejection import FARTHEST_MARKER

# Most hypotheses that are followed, and the most that their costs differ, nats.
MAX_HYPOTHESES, MAX_COST_DIFFERENCE = 32, 20.0
# A count is certain if its probability to be wrong is smaller.
MAX_ERROR_PROBABILITY = 1 / 100
# Lost frames in a row that are charged at most: a driver that hangs loses several at once.
MOST_CHARGED_LOSSES = 2
# Highest degree of the polynomials that are fitted to the motion.
MAX_DEGREE = 6


class FrameCounter:
    """
    Counts frames as they come, by a clock and by the motion.

    `count` is that of the newest frame whose count is certain; the frames after it are pending. A
    hypothesis says how many frames were lost before each of them. Its cost, nats, adds up the lost
    frames, the lateness of the others, and how badly polynomials of the counts fit the motion.
    """

    def __init__(self, clock: Clock, count: int) -> None:
        self.clock, self.count, self.noise = clock, count, np.nan
        self._loss_nats = LOSS_NATS
        # The correction of the counts, ticks, while the phase of the clock is wrong.
        self._ticks_ahead = 0
        # Coordinates of the markers in the pending frames and in some before them.
        self._values: deque[Real] = deque(maxlen=UNSETTLED + MAX_PENDING + 1)
        self._earlier_counts = np.zeros(0, np.int64)
        self._clear_pending()

    def _clear_pending(self) -> None:
        """Start with no pending frame."""
        self._losses, self._costs = np.zeros((1, 0), np.int64), np.zeros(1)

    def follow(self, clock: Clock) -> None:
        """Use a new estimate of the clock, with the same counts."""
        self.clock, self._ticks_ahead = clock, 0

    @property
    def pending(self) -> int:
        """Number of newest frames whose count is not certain."""
        return self._losses.shape[1]

    @property
    def keeps_pace(self) -> bool:
        """Whether frames come no faster than the clock ticks."""
        return self._ticks_ahead <= MAX_AHEAD_TICKS

    def count_frames(self, stamps: np.ndarray, points: Real) -> tuple[np.ndarray, np.ndarray]:
        """
        Count the next frames.

        Parameters
        ----------
        stamps : (T,) int64
            Stamps, ns.
        points : (T, ...) float
            Markers, NaN for those not seen.

        Returns
        -------
        (R,) int64, (R,) int
            Counts that are certain, and the index of the frame with which each became certain.

        """
        counts, certain_with = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        first = 0
        while first < len(stamps):
            number = self.count_unambiguous(stamps[first:])
            if number:
                counts.append(self.append_unambiguous(points[first : first + number]))
                certain_with.append(np.arange(first, first + number))
                first += number
            if first < len(stamps):
                counts.append(self.append(int(stamps[first]), points[first]))
                certain_with.append(np.full(len(counts[-1]), first))
                first += 1
        return np.concatenate(counts), np.concatenate(certain_with)

    def count_unambiguous(self, stamps: np.ndarray) -> int:
        """Return how many of the next frames (T,) have only one possible count."""
        if self.pending:
            return 0
        ticks = self.clock.ticks(stamps) + self._ticks_ahead
        expected = self.count + np.arange(1, len(stamps) + 1)
        doubtful = (np.floor(ticks) > expected) | (np.floor(ticks + TOLERANCE) < expected)
        return int(doubtful.argmax()) if np.count_nonzero(doubtful) else len(stamps)

    def append_unambiguous(self, points: Real) -> np.ndarray:
        """Count frames with one possible count and `points` (T, ...); return the counts (T,)."""
        counts = self.count + np.arange(1, len(points) + 1)
        for values in points[-UNSETTLED:]:
            self._values.append(values.ravel())
        self._earlier_counts = np.concatenate((self._earlier_counts, counts))[-UNSETTLED:]
        self.count = int(counts[-1])
        return counts

    def append(self, stamp: int, points: Real) -> np.ndarray:
        """
        Count the next frame.

        Parameters
        ----------
        stamp : int
            Its stamp, ns.
        points : float
            Its markers, of any shape, NaN for those not seen.

        Returns
        -------
        (n,) int64
            Counts that are certain now, of the oldest pending frames.

        """
        self._values.append(points.ravel())
        number = self.pending + 1
        tick = float(self.clock.ticks(np.array(stamp))) + self._ticks_ahead
        most = math.floor(tick) - self.count - number
        ahead = self.count + number - math.floor(tick + TOLERANCE)
        if ahead > 0 and self.clock.is_rounded and number < FEWEST_SAMPLES:
            # Before its tick by more than the rounding: wait whether the rate has changed.
            self._losses, self._costs = np.zeros((1, number), np.int64), np.zeros(1)
            return np.zeros(0, np.int64)
        # For a frame before its tick the phase of the clock was not known well.
        self._ticks_ahead += max(ahead, 0)
        if most <= 0:
            # No frame was lost before the pending ones either.
            return self._accept(number, np.zeros((1, number), np.int64), np.zeros(1))
        self._extend(most)
        costs = self._costs + self._motion_costs()
        costs -= costs.min()
        order = costs.argsort(kind='stable')[:MAX_HYPOTHESES]
        order = order[costs[order] < MAX_COST_DIFFERENCE]
        losses = self._losses[order]
        weights = np.exp(-costs[order])
        error_probability = weights @ (losses != losses[0]) / weights.sum()
        certain = (error_probability < MAX_ERROR_PROBABILITY).nonzero()[0]
        accepted = max(int(certain[-1]) + 1 if len(certain) else 0, number - MAX_PENDING)
        return self._accept(accepted, losses, self._costs[order])

    def learn_losses(self, counts: np.ndarray) -> None:
        """Learn from counts (T,) how often a frame is lost."""
        if len(counts):
            lost = max(int(counts[-1] - counts[0]) + 1 - len(counts), 0)
            self._loss_nats = math.log((len(counts) + lost + math.exp(LOSS_NATS)) / (lost + 1))

    def take_pending(self) -> np.ndarray:
        """Count all pending frames by the likeliest hypothesis; return the counts."""
        return self._accept(self.pending, self._losses, self._costs)

    def move(self, offset: int) -> None:
        """Add an offset to all counts."""
        self.count += offset
        self._earlier_counts = self._earlier_counts + offset

    def _extend(self, most: int) -> None:
        """Extend the hypotheses by a frame, before which at most so many were lost in all."""
        before = self._losses[:, -1] if self.pending else np.zeros(1, np.int64)
        if before.min() > most:
            self._losses = np.minimum(self._losses, most)
            before = self._losses[:, -1]
        if self.clock.is_rounded and not self.clock.is_on_grid:
            # No stamp is later than by its rounding.
            lost = np.array([most])
        else:
            # Either no frame was lost now, or the lateness of the frame is possible.
            least = max(most - min(math.ceil(self.clock.max_lateness_ticks), MAX_PENDING), 0)
            lost = np.unique(np.concatenate((before, np.arange(least, most + 1))))
        parent, which = ((lost >= before[:, None]) & (lost <= most)).nonzero()
        lost_now = lost[which] - before[parent]
        self._costs = self._costs[parent] + self._loss_nats * np.minimum(
            lost_now, MOST_CHARGED_LOSSES
        )
        # Cap lateness at one lost frame: both are equally likely.
        late_nats = self.clock.interval / max(self.clock.lateness, 1.0)
        self._costs += np.minimum((most - lost[which]) * late_nats, LOSS_NATS)
        self._losses = np.column_stack((self._losses[parent], lost[which]))

    def _accept(self, accepted: int, losses: np.ndarray, costs: Real) -> np.ndarray:
        """Count so many pending frames by the first of the hypotheses; return the counts."""
        self._losses, self._costs = losses, costs
        if not accepted:
            return np.zeros(0, np.int64)
        counts = self.count + np.arange(1, accepted + 1) + losses[0, :accepted]
        # Hypotheses with another count of the newest accepted frame are dropped.
        agree = losses[:, accepted - 1] == losses[0, accepted - 1]
        later = losses[agree, accepted:] - losses[0, accepted - 1]
        later, first = np.unique(later, axis=0, return_index=True)
        order = first.argsort()
        self._losses, self._costs = later[order], costs[agree][first[order]]
        if accepted == losses.shape[1]:
            self._clear_pending()
        self.count = int(counts[-1])
        self._earlier_counts = np.concatenate((self._earlier_counts, counts))[-UNSETTLED:]
        return counts

    def _motion_costs(self) -> Real:
        """Costs (H,) of the hypotheses by the motion, nats."""
        newest = self._values[-1]
        pending = self.pending
        values = list(self._values)[-(pending + len(self._earlier_counts)) :]
        same_layout = [k for k, one in enumerate(values) if one.shape == newest.shape]
        values = np.array([values[k] for k in same_layout])
        before = np.broadcast_to(
            self._earlier_counts, (len(self._losses), len(self._earlier_counts))
        )
        new = self.count + np.arange(1, pending + 1) + self._losses
        counts = np.concatenate((before, new), axis=1)[:, -len(self._values) :]
        counts = counts[:, same_layout] - counts[0, -1]
        seen = np.abs(values) < FARTHEST_MARKER
        # No noise is below rounding, so that all costs are finite.
        rounding = ROUNDING * np.max(np.abs(values), initial=0.0, where=seen)
        deviation = np.fmax(np.fmax(self.noise, rounding), np.finfo(float).tiny)
        costs = np.zeros(len(counts))
        for rows in np.unique(seen, axis=1).T:
            same = (seen == rows[:, None]).all(axis=0)
            costs += motion_costs(counts[:, rows], values[np.ix_(rows, same)] / deviation)
        return costs


def motion_costs(counts: np.ndarray, values: Real) -> Real:
    """
    Return the negative log likelihood of signals as polynomials of counts.

    The degree of each polynomial is chosen by Schwarz's criterion: a fast motion that a cubic
    cannot follow would otherwise look like a lost frame.

    Parameters
    ----------
    counts : (H, N) int
        Counts of the frames by H hypotheses.
    values : (N, S) float
        Signals in standard deviations of their noise.

    Returns
    -------
    (H,) float
        Costs, nats.

    """
    number = len(values)
    highest = min(MAX_DEGREE, number - 3)
    if highest < 1:
        return np.zeros(len(counts))
    scaled = (counts - counts.mean(axis=1, keepdims=True)) / max(np.ptp(counts), 1)
    basis, _ = np.linalg.qr(scaled[..., None] ** np.arange(highest + 1))
    values = values - values.mean(axis=0)
    squares = (basis.swapaxes(1, 2) @ values) ** 2
    residual = (values**2).sum(axis=0) - squares.cumsum(axis=1)  # (H, degrees, S)
    residual = np.maximum(residual[:, 1:], 0.0)
    degrees = np.arange(1, highest + 1)[:, None]
    # At least 1, and more if no polynomial follows the motion or the noise is not known.
    scale = np.maximum((residual / (number - degrees - 1)).min(axis=(0, 1)), 1.0)
    costs = (residual / scale + degrees * math.log(number)).min(axis=1) / 2
    return np.asarray(costs.sum(axis=1))
