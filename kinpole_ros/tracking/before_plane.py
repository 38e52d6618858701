"""Frames that come before the plane is known: they are kept, and taken again in the plane."""

from collections.abc import Callable, Sequence

import numpy as np

from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.placed_frames import PlacedFrames
from kinpole_ros.tracking.state import State, start_bodies


def keep_frame(state: State, placed: PlacedFrames, times: Sequence[np.ndarray]) -> None:
    """Keep the next frame until the plane is known, and measure how it lies in space."""
    in_space, k = placed.in_space, state.step.incoming.frame
    part = slice(k, k + 1)
    frame = part_of(placed.frames, part), [array[part] for array in times]
    state.before_plane.append(frame)
    assert in_space is not None
    unusable = state.matcher.is_incomplete_cloud(placed)
    state.space.add(np.full_like(in_space[part], np.nan) if unusable else in_space[part])
    state.step.correct_next(placed.points[k])


def take_again(state: State, take: Callable[[MarkerFrames, Sequence[np.ndarray]], None]) -> None:
    """Take the earlier frames again, each by `take` with its times, now that the plane is known."""
    early = list(state.before_plane)
    state.before_plane.clear()
    due = state.step.columns.next_result - (len(state.history) - len(early))
    state.assignment.set_plane(state.space.plane)
    assert state.assignment.plane is not None
    start_bodies(state)
    for frame, times in early:
        take(frame, times)
    state.step.columns.next_result = max(due, 0)
