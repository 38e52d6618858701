"""Correct the markers of a frame that is not usual: names first, then markers that do not fit."""

import numpy as np

from kinpole_ros.tracking.assignment import PlacedFrames
from kinpole_ros.tracking.corrections import EXCHANGED, correct_frame
from kinpole_ros.tracking.rejection import MOVED_FRAMES, NAME_DOUBTFUL, ODD
from kinpole_ros.tracking.state import State, restart_bodies

# Most frames between two searches for the names of markers after searches without a result.
MAX_SEARCH_INTERVAL = 16


def correct_next(state: State, placed: PlacedFrames, k: int) -> np.ndarray:
    """Return the markers (B, n) that frame `k` is fitted to, NaN for those left out."""
    bodies, matcher = state.bodies, state.matcher
    if matcher.arrange(placed, k):
        restart_bodies(state, np.ones(bodies.count, bool))
    markers, heights = placed.points[k], placed.heights[k]
    if len(bodies.fitting.unseen):
        bodies.begin(markers)
        state.step.bind(bodies, state.history)
    if bodies.fitting.incomplete and (bodies.fitting.unknown_slots & ~np.isnan(markers)).any():
        # New markers are learned as soon as they are seen.
        state.next_update = min(state.next_update, state.frame_count + 1)
    if bodies.exchanged:
        markers[...] = np.take_along_axis(markers, bodies.order, axis=1)
        heights[...] = np.take_along_axis(heights, bodies.order, axis=1)
    unusual = state.step.try_next(markers)
    is_name_doubtful = unusual & NAME_DOUBTFUL or matcher.has_unassigned(placed)
    if is_name_doubtful and _correct_names(state, placed, k, unusual):
        unusual = state.step.try_next(markers)
    fitted = markers
    if unusual & ODD:
        odd = (state.step.unusual & ODD) > 0
        before = np.argsort(bodies.order, axis=1)
        fitted = correct_frame(bodies, state.history, markers, odd, state.totals.counts)
        new_order = np.take_along_axis(before, bodies.order, axis=1)
        heights[...] = np.take_along_axis(heights, new_order, axis=1)
    if bodies.exchanged:
        # Names that stay exchanged were wrong before.
        recent = bodies.exchanged_for < MOVED_FRAMES
        moved = bodies.order[recent] != np.arange(bodies.width)
        state.totals.counts[EXCHANGED] += int(np.count_nonzero(moved))
        bodies.exchanged_for += 1
    return fitted


def _correct_names(state: State, placed: PlacedFrames, k: int, unusual: int) -> bool:
    """Correct wrong names of markers in the frame; return whether there were any."""
    if not unusual & NAME_DOUBTFUL:
        markers = placed.points[k]
        unseen = np.isnan(markers)
        if not unseen.any():
            return False
        if not state.matcher.is_doubtful(placed, k, state.bodies.fit(markers), unseen):
            return False
    # Bodies that are not rigid are doubtful in every frame, and a search takes long.
    if state.frame_count < state.next_search:
        return False
    corrected = state.matcher.correct_names(placed, k)
    state.futile_searches = 0 if corrected else state.futile_searches + 1
    state.next_search = state.frame_count + min(
        2 ** max(state.futile_searches - 1, 0), MAX_SEARCH_INTERVAL
    )
    return corrected
