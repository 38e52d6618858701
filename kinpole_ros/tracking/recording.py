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
from kinpole_ros.tracking.thresholds import MEMORY_FRAMES, MIN_SAMPLES, N_SIGMA
from kinpole_ros.tracking.timeline import Timeline

# The noise of a marker is another if its deviation grows or falls by this factor: a smaller change
# costs less accuracy than what is learned from fewer frames.
_NOISE_RATIO = 1.5
# What every frame makes better while a body stays the same. The rest changes with the motion and
# the light, and is that of its stretch.
_LASTING = 'shape', 'frames', 'begun', 'given', 'pin', 'pin_arm', 'pin_variance', 'pin_since'
_PASSING = tuple(name for name in Bodies.__dataclass_fields__ if name not in _LASTING)


class Stretch(NamedTuple):
    """
    What is known of the frames up to `end`, counted through the recording.

    `changed` (B,) says which bodies are others after it. Frames are `at_ticks` of the clock or not.
    Plane and names are those of all frames since the same start.
    """

    end: int
    bodies: Bodies
    changed: np.ndarray
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

    """

    def __init__(self) -> None:
        self.number = 0
        self.is_learned = False
        self._stretches: list[Stretch] = []
        # Of the start in hand.
        self._since_start: list[Stretch] = []
        # Of the stretch in hand: its first frame, and what was known at first and of late.
        self._begin = 0
        self._first: Bodies | None = None
        self._latest: Bodies | None = None

    def stretch(self) -> Stretch:
        """Return the stretch of the next frame, or the last one."""
        ends = [one.end for one in self._stretches[:-1]]
        return self._stretches[int(np.searchsorted(ends, self.number, side='right'))]

    def note(self, bodies: Bodies, changed: np.ndarray, timeline: Timeline) -> None:
        """Take what is known of the bodies with the next frame; `changed` (B,) are others now."""
        # Without what follows from it.
        bodies = replace(bodies)
        if self._latest is not None and self._first is not None:
            changed = changed | _has_lost_pin(self._latest, bodies)
            changed |= _has_other_noise(self._first, bodies)
            if changed.any():
                self._end_stretch(self._latest, changed, timeline)
            else:
                bodies = _with_largest(self._latest, bodies)
        is_mature = (bodies.fits >= MIN_SAMPLES).any()
        self._latest = bodies
        self._first = self._first or (bodies if is_mature else None)
        if self.number - self._begin >= MEMORY_FRAMES:
            self._end_stretch(bodies, np.zeros(bodies.count, bool), timeline)

    def _end_stretch(self, bodies: Bodies, changed: np.ndarray, timeline: Timeline) -> None:
        """End the stretch with the last frame, up to which this is known."""
        stretch = Stretch(self.number, bodies, changed, timeline.clock, timeline.at_ticks)
        self._since_start.append(stretch)
        self._begin, self._first, self._latest = self.number, None, None

    def forget(self, which: np.ndarray) -> None:
        """Forget some bodies (B,), which were never what they were taken for."""
        self._since_start = [
            one._replace(bodies=one.bodies.restart(which), changed=one.changed & ~which)
            for one in self._since_start
        ]
        if self._latest is not None:
            self._latest = self._latest.restart(which)
        self._first = None

    def end_run(
        self, bodies: Bodies, timeline: Timeline, plane: Plane | None, names: KnownNames
    ) -> None:
        """Take what is known at the end of the frames since a start, and complete the earlier."""
        none = np.zeros(bodies.count, bool)
        self._end_stretch(self._latest or replace(bodies), none, timeline)
        later: Stretch | None = None
        completed = []
        for one in reversed(self._since_start):
            later = one if later is None else _completed(one, later)
            completed.append(later._replace(plane=plane, names=names))
        self._stretches += reversed(completed)
        self._since_start = []


def _has_lost_pin(before: Bodies, now: Bodies) -> np.ndarray:
    """Return which bodies (B,) lost a pin."""
    return np.isfinite(before.pin) & ~np.isfinite(now.pin)


def _has_other_noise(before: Bodies, now: Bodies) -> np.ndarray:
    """Return which bodies (B,) have a marker whose noise is surely another than before."""
    number = np.maximum(now.placement.learned_count, 1)
    with np.errstate(divide='ignore', invalid='ignore'):
        # Of the logarithm of a deviation, with the degrees of freedom of one marker.
        error = np.sqrt(number / 2 * (1 / before.degrees + 1 / now.degrees))
        ratio = np.log(now.noise / before.noise)[:, None]
        ratio = np.abs(ratio + np.log(now.relative / before.relative) / 2)
        is_other = ratio > np.log(_NOISE_RATIO) + N_SIGMA * error[:, None]
    return np.asarray((is_other & (before.frames > 0)).any(axis=1))


def _with_largest(before: Bodies, now: Bodies) -> Bodies:
    """Return what is known now, with residuals as large as any of the stretch, fast or slow."""
    is_known = np.minimum(before.fits, now.fits) >= MIN_SAMPLES
    scale = np.where(np.isfinite(before.jump_scale), before.jump_scale, 0.0)
    return now.change(
        misfit=np.where(is_known, np.maximum(before.misfit, now.misfit), now.misfit),
        jump_scale=np.maximum(scale, now.jump_scale),
    )


def _completed(stretch: Stretch, later: Stretch) -> Stretch:
    """Return a stretch with what is known better in the one after it."""
    own = stretch.bodies.widen(later.bodies.width)
    lacks = np.isnan(own.noise) | (own.fits < np.minimum(later.bodies.fits, MIN_SAMPLES))
    bodies = own.take(later.bodies, ~stretch.changed, _LASTING)
    bodies = bodies.take(later.bodies, ~stretch.changed & lacks, _PASSING)
    return stretch._replace(bodies=bodies)
