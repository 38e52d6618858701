"""
What is learned of a whole recording, so that a second pass knows it from the first frame on.

The first pass keeps what is known at the end of each stretch of frames. A stretch ends where a body
changes, or the noise of its markers, and after as many frames as noise is measured from. The second
pass has what holds for the stretch of each frame, and learns nothing.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.clock import Clock
from kinpole_ros.tracking.names import KnownNames
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.thresholds import MEMORY_FRAMES, MIN_SAMPLES
from kinpole_ros.tracking.timeline import Timeline

# What every frame makes better while a body stays the same. The rest changes with the motion and
# the light, and is that of its stretch.
_LASTING = 'shape', 'frames', 'begun', 'given', 'pin', 'pin_arm', 'pin_variance'
_PASSING = tuple(name for name in Bodies.__dataclass_fields__ if name not in _LASTING)


class Stretch(NamedTuple):
    """
    What is known of the frames up to `end`, counted through the recording.

    `changed` (B,) says which bodies are others than in the stretch before, and `moved` (B, n) which
    markers are elsewhere. Frames are `at_ticks` of the clock or not. Plane and names are those of
    all frames since the same start.
    """

    end: int
    bodies: Bodies
    changed: np.ndarray
    moved: np.ndarray
    clock: Clock | None
    at_ticks: bool
    plane: Plane | None = None
    names: KnownNames | None = None


class Recording:
    """
    The stretches of a recording, written by a first pass over its frames.

    Attributes
    ----------
    number : int
        The next frame, counted through the recording; written by tracker.py.
    is_learned : bool
        Whether the first pass is over, so that the tracker learns nothing.
    recalled : Stretch or None
        The stretch whose bodies the tracker has now; written by `recall` of update.py.
    stretches : list of Stretch
        The stretches, in order; complete once all is learned.

    """

    def __init__(self) -> None:
        self.number = 0
        self.is_learned = False
        self.recalled: Stretch | None = None
        self.stretches: list[Stretch] = []
        # Of the start in hand.
        self._since_start: list[Stretch] = []
        # Of the stretch in hand: its first frame, what changed there, and what is known of it.
        self._begin = 0
        self._changed: tuple[np.ndarray, np.ndarray] | None = None
        self._latest: Bodies | None = None

    def stretch(self) -> Stretch:
        """Return the stretch of the next frame, or the last one."""
        ends = [one.end for one in self.stretches[:-1]]
        return self.stretches[int(np.searchsorted(ends, self.number, side='right'))]

    @property
    def count(self) -> int:
        """Number of the frames of the stretch in hand."""
        return self.number - self._begin

    def note(
        self,
        bodies: Bodies,
        moved: np.ndarray,
        is_other: np.ndarray,
        new: int,
        timeline: Timeline,
    ) -> None:
        """
        Take what is known of the bodies with the next frame.

        In the `new` newest frames markers `moved` (B, n), and the noise of bodies `is_other` (B,).
        """
        bodies = _kept(bodies, self._latest)
        before, begins = self._latest, self._begin >= self.number - new
        if before is not None:
            lost_pin = np.isfinite(before.pin) & ~np.isfinite(bodies.pin)
            changed = moved.any(axis=1) | is_other | lost_pin
            if changed.any():
                if not begins:
                    self._end_stretch(before, timeline, self.number - new)
                self._changed = changed, moved
            elif not begins:
                bodies = _with_largest_steps(before, bodies)
        self._latest = bodies
        if self.count >= MEMORY_FRAMES:
            self._end_stretch(bodies, timeline, self.number)

    def _end_stretch(self, bodies: Bodies, timeline: Timeline, end: int) -> None:
        """End the stretch before the frame `end`, up to which this is known."""
        none = np.zeros(bodies.shape.shape, bool)
        changed, moved = self._changed or (none.any(axis=1), none)
        clock = timeline.clock, timeline.at_ticks
        self._since_start.append(Stretch(end, bodies, changed, moved, *clock))
        self._begin, self._changed = end, None

    def forget(self, which: np.ndarray) -> None:
        """Forget some bodies (B,), which were never what they were taken for."""
        self._since_start = [
            one._replace(bodies=one.bodies.restart(which), changed=one.changed & ~which)
            for one in self._since_start
        ]
        if self._changed is not None:
            self._changed = self._changed[0] & ~which, self._changed[1]
        if self._latest is not None:
            self._latest = self._latest.restart(which)

    def end_run(
        self, bodies: Bodies, timeline: Timeline, plane: Plane | None, names: KnownNames
    ) -> None:
        """Take what is known at the end of the frames since a start, and complete the earlier."""
        self._end_stretch(self._latest or replace(bodies), timeline, self.number)
        later: Stretch | None = None
        completed = []
        for one in reversed(self._since_start):
            # Each window shows whether its poses are on the pin.
            always = np.full(bodies.count, np.iinfo(np.int64).min)
            one = one._replace(bodies=one.bodies.change(pin_since=always))
            later = one if later is None else _completed(one, later)
            completed.append(later._replace(plane=plane, names=names))
        self.stretches += reversed(completed)
        self._since_start, self._latest = [], None


def _kept(bodies: Bodies, before: Bodies | None) -> Bodies:
    """Return bodies without what follows from them, which share equal arrays with those before."""
    same: dict[str, np.ndarray] = {}
    for name in Bodies.__dataclass_fields__ if before is not None else ():
        old = getattr(before, name)
        if np.array_equal(getattr(bodies, name), old, equal_nan=old.dtype.kind in 'fc'):
            same[name] = old
    return replace(bodies, **same)


def _with_largest_steps(before: Bodies, now: Bodies) -> Bodies:
    """Return what is known now, with steps about the path as large as any before, fast or slow."""
    scale = np.where(np.isfinite(before.jump_scale), before.jump_scale, 0.0)
    return now.change(jump_scale=np.maximum(scale, now.jump_scale))


def _completed(stretch: Stretch, later: Stretch) -> Stretch:
    """Return a stretch with what is known better in the one after it."""
    own = stretch.bodies
    if own.width < later.bodies.width:
        own = own.widen(later.bodies.width)
    lacks = np.isnan(own.noise) | (own.fits < np.minimum(later.bodies.fits, MIN_SAMPLES))
    bodies = own.take(later.bodies, ~later.changed, _LASTING)
    bodies = bodies.take(later.bodies, ~later.changed & lacks, _PASSING)
    unseen = np.equal(own.spectra, None)
    bodies = bodies.take(later.bodies, ~later.changed & unseen, ('spectra',))
    return stretch._replace(bodies=bodies)
