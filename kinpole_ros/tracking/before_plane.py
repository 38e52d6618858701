"""Frames that come before the plane is known: they are kept, and taken again in the plane."""

from collections.abc import Callable, Sequence

import numpy as np

from kinpole_ros.tracking.correction import correct_next
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.placing import PlacedFrames
from kinpole_ros.tracking.state import State, count_taken, start_bodies
from kinpole_ros.tracking.update import update_if_due


def keep_frame(state: State, placed: PlacedFrames, times: Sequence[np.ndarray]) -> None:
    """Keep the next frame until the plane is known, and measure how it lies in space."""
    in_space, k = placed.in_space, state.step.fields.frame
    part = slice(k, k + 1)
    frame = part_of(placed.frames, part), [array[part] for array in times]
    state.before_plane.append(frame)
    assert in_space is not None
    unusable = state.matcher.is_incomplete_cloud(placed)
    state.space.add(np.full_like(in_space[part], np.nan) if unusable else in_space[part])
    state.step.correct_next(placed.points[k])


def take_again(
    state: State, place: Callable[[MarkerFrames, Sequence[np.ndarray]], PlacedFrames]
) -> None:
    """
    Take the earlier frames again, now that the plane is known.

    `place` puts the markers of frames in the slots of the bodies, and passes them to the step.
    """
    early = list(state.before_plane)
    state.before_plane.clear()
    due = state.step.fields.due - (len(state.history) - len(early))
    seen_last = state.step.seen_last
    state.assignment.set_plane(state.space.plane)
    assert state.assignment.plane is not None
    start_bodies(state)
    for frame, times in early:
        update_if_due(state)
        placed = place(frame, times)
        state.step.correct_next(correct_next(state, placed, 0))
        state.step.follow(1, state.step.reserve_results(0, None))
        count_taken(state, 1)
    state.step.fields.due = max(due, 0)
    state.step.seen_last[:] = seen_last
