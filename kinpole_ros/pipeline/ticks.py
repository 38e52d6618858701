"""
Whether frames are at their stamps or at the ticks of a clock, and when they are taken to be.

Stamps alone cannot tell a camera with an even clock from frames that really come unevenly: motion
can. Each pose is predicted from its neighbors on both sides, once by the stamps and once by the
ticks, and what is the better prediction by a clear margin is what frames are taken to be at.
"""

import math
from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.pipeline.clock import (
    SEARCHED,
    SURE_NATS,
    UNSETTLED,
    Clock,
    find_clock,
    follow_clock,
)
from kinpole_ros.pipeline.course import SIDE, correct_counts, evidence, signals_of
from kinpole_ros.planar._plane import Real
from kinpole_ros.rigid.levels import FEW
from kinpole_ros.rigid.scatter import HISTORY

# Windows that the clock is found from: 10 s of 0.3 s each.
_MEMORY = 33
# Looks at the clock come after a quarter more frames each time, and at least so often, windows.
_GROWTH, _SELDOM = 4, _MEMORY / 20
# Evidence in nats decides from so many on; half of it is forgotten in so many windows.
_DECIDES, _HALF_LIFE = 6.0, _MEMORY / 10
# Stamps in such steps, ns, or longer ones are rounded if no tick is off by more than one of them.
_COARSE, _ROUNDED = 10_000, 1.05


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


class Ticks:
    """
    The clock behind stamps, and whether motion says that frames are at its ticks.

    `window`, ns, is as long as the estimates'; `mode` is the parameter `stamps`; `regular` is
    whether frames are taken to be at ticks.
    """

    def __init__(self, mode: str, window: int) -> None:
        self.mode = mode
        self._window = window
        self.regular = mode == 'arrival'
        self.clock: Clock | None = None
        self.lost = 0
        # Frames until the next look.
        self.room = FEWEST_SAMPLES
        self.seen = 0
        self.nats = 0.0
        self._stamps = np.zeros(0, np.int64)
        # Where frames are counted as they come, of the newest when they are sure.
        self.counts = np.zeros(0, np.int64)
        # Whether frames are regular only since stamps are rounded.
        self._rounded = False
        self._taken = np.zeros(0, bool)
        self._new: list[tuple[np.ndarray, np.ndarray]] = []
        # Poses of frames taken, with what they are known by, that are still to be looked at.
        self._poses: list[tuple[np.ndarray, np.ndarray]] = []
        self._speed = 0.0
        self._latest = 0

    def add(self, stamps: np.ndarray, taken: np.ndarray) -> None:
        """Frames that have come with `stamps` (T,), ns, of which some are `taken`."""
        if not len(stamps):
            return
        self._new.append((stamps.copy(), taken.copy()))
        self._latest = int(stamps[-1])
        self.room -= len(stamps)
        self.seen += len(stamps)

    def add_poses(self, poses: Real, information: Real) -> None:
        """Poses (T, 2 B, 2) of the frames taken, as in `RigidBodies`."""
        self._poses.append((poses.copy(), information.copy()))

    def count(self, counts: np.ndarray) -> None:
        """The next of the frames have these `counts` (T,)."""
        self.counts = np.concatenate((self.counts, counts))

    def uncount(self, number: int) -> None:
        """The counts of so many of the newest frames are to be found."""
        self.counts = self.counts[: len(self.counts) - number]

    def look(self, noise: Real, newest: np.ndarray | None) -> bool:
        """
        Find the clock, and decide; whether it is still the one that frames are counted by.

        `noise` (B,), m, is that of a marker of each body, NaN while not known; `newest` are the
        counts of the newest frames as far as none is sure, None where frames are not counted.
        """
        news = [np.concatenate(parts) for parts in zip(*self._new, strict=True)]
        self._new = []
        if newest is not None:
            # A frame that came too late to be taken has no count.
            news = [part[news[1]] for part in news]
        before = len(self._stamps)
        self._stamps = np.concatenate((self._stamps, news[0]))
        self._taken = np.concatenate((self._taken, news[1]))
        if newest is not None and len(self._stamps) < FEWEST_SAMPLES:
            self.counts = np.concatenate((self.counts, newest))
            self.room = FEWEST_SAMPLES - len(self._stamps)
            return True
        latest = int(self._stamps[-1])
        old = int((self._stamps > latest - _MEMORY * self._window).argmax())
        # Of a slow camera as many as are looked at same.
        old = max(min(old, len(self._stamps) - 2 * SEARCHED), len(self._stamps) - HISTORY, 0)
        self._forget(old)
        before = max(before - old, 0)
        if newest is None:
            same = False
            clock, counts = find_clock(self._stamps, self.clock)
        else:
            known = np.concatenate((self.counts, newest))
            poses, information = (np.concatenate(parts) for parts in zip(*self._poses, strict=True))
            correct_counts(known, poses, information, noise)
            clock, counts, same = follow_clock(self._stamps, known)
        dropped = len(self._stamps) - len(counts)
        self._forget(dropped)
        before = max(before - dropped, 0)
        steps = np.diff(counts)[max(before - UNSETTLED, 0) : len(counts) - UNSETTLED]
        # Stamps that are out of order, say, are of no clock that could miss any.
        if len(steps) and (self.regular or clock.largest < clock.interval / 2):
            self.lost += int((steps - 1).clip(0).sum())
        self.clock = clock
        seldom = max(FEWEST_SAMPLES, int(_SELDOM * self._window / max(clock.interval, 1.0)))
        self.room = min(max(1, self.seen // _GROWTH), seldom)
        self._weigh(counts[self._taken], noise)
        late = self._stamps - clock.origin - counts * clock.interval
        step = clock.resolution
        rounded = step / 2 < float(np.ptp(late)) <= _ROUNDED * step and self._may_be_rounded(step)
        if rounded and not self.regular:
            self._rounded = self.regular = True
        if self._rounded and self.nats > _DECIDES:
            self._rounded = False
        elif self._rounded and step < _COARSE:
            # Stamps are in finer steps now, and the motion does not tell.
            self._rounded = self.regular = False
        if self.regular:
            # The others are of no use any more, nor do more of them come.
            self._stamps, counts = self._stamps[self._taken], counts[self._taken]
            self._taken = np.ones(len(counts), bool)
        self.counts = counts
        return same

    def _may_be_rounded(self, step: float) -> bool:
        """Whether stamps that are off their ticks may be so since they are in such steps, ns."""
        usual = self.mode == 'auto' and self.seen >= FEW
        assert self.clock is not None
        likely = _COARSE <= step <= self.clock.interval
        return usual and likely and self.nats > -_DECIDES

    def until_slip(self, stamps: np.ndarray) -> int:
        """
        How many frames come before one that slips by a step of rounded stamps (T,) that were even.

        From there on frames are taken to be at ticks.
        """
        clock = self.clock
        if self.regular or clock is None or clock.largest > 1.0 or clock.resolution < _COARSE:
            return len(stamps)
        ticks = (stamps - clock.origin - clock.phase) / clock.interval
        off = np.abs(ticks - np.rint(ticks)) * clock.interval
        slips = (off > _COARSE / 2).nonzero()[0]
        if not len(slips):
            return len(stamps)
        first = int(slips[0])
        step = math.gcd(round(clock.resolution), int(stamps[first]) - clock.origin)
        before = int(stamps[first - 1]) if first else self._latest
        count = round((before - clock.origin - clock.phase) / clock.interval)
        # Frames that come sooner than the clock ticks are of another rate.
        rounded = off[first] <= _ROUNDED * step and round(float(ticks[first])) > count
        rounded = rounded and self._may_be_rounded(step)
        return first if rounded else len(stamps)

    @property
    def is_up_to_date(self) -> bool:
        """Whether no frames have come since the last look."""
        return not self._new

    def round(self) -> None:
        """Take frames to be at ticks, as their stamps are rounded."""
        self.regular = self._rounded = True

    def _forget(self, count: int) -> None:
        if count > 0:
            self._stamps, self._taken = self._stamps[count:], self._taken[count:]
            self.counts = self.counts[count:]

    def _weigh(self, counts: np.ndarray, noise: Real) -> None:
        """Add up what the motion of late says, and decide by it."""
        poses, information = (np.concatenate(parts) for parts in zip(*self._poses, strict=True))
        held = min(len(poses), len(counts))
        # What is not looked at now is looked at next time.
        kept = min(held, 2 * SIDE + UNSETTLED)
        self._poses = [(poses[len(poses) - kept :], information[len(poses) - kept :])]
        usable = held - UNSETTLED
        if self.seen < FEW or usable < 2 * SIDE + 1:
            self._poses = [(poses, information)]
            return
        assert self.clock is not None
        interval = self.clock.interval
        part = slice(len(poses) - held, len(poses) - UNSETTLED)
        at = slice(len(counts) - held, len(counts) - UNSETTLED)
        stamps = self._stamps[self._taken][at]
        times = np.stack(((stamps - stamps[0]) / interval, (counts[at] - counts[at][0]) * 1.0))
        signals, variance = signals_of(poses[part], information[part], noise)
        nats, speed = evidence(times, signals, variance)
        fading = 0.5 ** ((usable - 2 * SIDE) * interval / (_HALF_LIFE * self._window))
        # No more are kept: a driver may be changed.
        self.nats = float(np.clip(fading * self.nats + nats, -SURE_NATS, SURE_NATS))
        self._speed = max(speed, fading * self._speed)
        if self.mode == 'auto' and abs(self.nats) > _DECIDES:
            # Frames are not late by windows: then it is no clock.
            self.regular = self.nats > 0 and self.clock.largest < self._window

    def state(self) -> StampState | None:
        """How the stamps are; None while too few have come."""
        clock = self.clock
        if clock is None:
            return None
        jitter = clock.jitter / clock.interval
        costs = not self.regular and self.nats > -_DECIDES and jitter * self._speed > 1.0
        scale = 1e-9
        return StampState(
            clock.interval * scale,
            clock.jitter * scale,
            clock.largest * scale,
            self.regular,
            self.nats,
            costs,
        )
