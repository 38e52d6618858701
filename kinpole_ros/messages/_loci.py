"""What is drawn now and then, and the centrodes of late, as paths."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from kinpole_ros.messages._cdr import path
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.plane import Plane

# Instants as indices, in order, and the messages of these.
Built: TypeAlias = tuple[list[int], list[bytes]]
Build: TypeAlias = Callable[[Estimate], Built]
# Loci are drawn, not computed with: this much of them, this finely, this often (ns of stamps).
_TRAIL_POINTS = 200
_TRAIL_STEP = 10_000_000
_DRAWN_EVERY = 100_000_000


class Trail:
    """The ICR of late, as seen from the ground and from the body."""

    def __init__(self) -> None:
        self._taken: Estimate | None = None
        self._run = 0
        self._clear()

    def _clear(self) -> None:
        self.stamps = np.empty(0, np.int64)
        self.fixed = self.moving = np.empty(0, complex)
        self.heights = np.empty(0)

    def follow(self, estimate: Estimate, b: int) -> None:
        """Take the poles of these instants, unless it has them or ones hardly older."""
        if estimate is self._taken:
            return
        self._taken = estimate
        if estimate.run != self._run:
            self._run = estimate.run
            self._clear()
        pole = estimate.pole(1)
        known = pole.determined[:, b].nonzero()[0]
        if len(self.stamps):
            known = known[estimate.stamp[known] >= self.stamps[-1] + _TRAIL_STEP]
        if not len(known):
            return
        new = known[_spaced(estimate.stamp[known], _TRAIL_STEP)]
        fixed = pole.value[new, b]
        moving = (fixed - estimate.origin(0)[new, b]) * np.exp(-1j * estimate.angle[0, new, b])
        # What was drawn before is still needed by the drawings of these instants.
        old = slice(-_TRAIL_POINTS, None)
        self.stamps = np.concatenate((self.stamps[old], estimate.stamp[new]))
        self.fixed = np.concatenate((self.fixed[old], fixed))
        self.moving = np.concatenate((self.moving[old], moving))
        self.heights = np.concatenate((self.heights[old], estimate.height[new, b]))

    def until(self, stamps: np.ndarray) -> list[slice]:
        """The part of it that is of late at each of the stamps."""
        ends = self.stamps.searchsorted(stamps, side='right').tolist()
        return [slice(max(0, end - _TRAIL_POINTS), end) for end in ends]


def _spaced(stamps: np.ndarray, step: int) -> list[int]:
    """Places of the first of the stamps, in order, and of each that is `step` after the last."""
    if len(stamps) == 1:
        return [0]
    following = stamps.searchsorted(stamps + step).tolist()
    found, k = [], 0
    while k < len(following):
        found.append(k)
        k = following[k]
    return found


class DrawingSchedule:
    """Which instants of a run are due to be drawn, at most every tenth of a second of stamps."""

    def __init__(self) -> None:
        self._run = 0
        self._last: int | None = None

    def rests(self, estimate: Estimate) -> bool:
        """Whether none of the instants can be due."""
        if estimate.run != self._run:
            self._run, self._last = estimate.run, None
        return self._last is not None and int(estimate.stamp[-1]) < self._last + _DRAWN_EVERY

    def due(self, stamps: np.ndarray, instants: np.ndarray) -> list[int]:
        """Those of the `instants`, indices of `stamps` in order, that are due."""
        if self._last is not None:
            instants = instants[stamps[instants] >= self._last + _DRAWN_EVERY]
        if not len(instants):
            return []
        due: list[int] = instants[_spaced(stamps[instants], _DRAWN_EVERY)].tolist()
        self._last = int(stamps[due[-1]])
        return due


def centrode(b: int, given: Plane, trail: Trail, frame: str | None) -> Build:
    """Paths of the centrode of body `b`, on the ground, or on the body in the `frame` it has."""
    schedule = DrawingSchedule()

    def build(estimate: Estimate) -> Built:
        trail.follow(estimate, b)
        if schedule.rests(estimate) or not len(trail.stamps):
            return [], []
        drawn = (estimate.missing[:, b] == '') & (estimate.stamp >= trail.stamps[0])
        due = schedule.due(estimate.stamp, drawn.nonzero()[0])
        if not due:
            return [], []
        frame_id = estimate.frame_id if frame is None else frame
        values, heights = (trail.moving, 0.0) if frame else (trail.fixed, trail.heights)
        places = (estimate.plane or given).in_space(values, heights)
        parts = zip(due, trail.until(estimate.stamp[due]), strict=True)
        return due, [
            path(int(estimate.stamp[t]), frame_id, trail.stamps[part], places[part])
            for t, part in parts
        ]

    return build
