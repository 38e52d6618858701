"""Learn from the history when an update is due: the last stage of a frame."""

import numpy as np

from kinpole_ros.tracking.center import find_hubs
from kinpole_ros.tracking.deformation import deformed_freedom
from kinpole_ros.tracking.learn import (
    MISFIT_FRAMES,
    forget_held_markers,
    freedom_of,
    learn,
    path_scale,
)
from kinpole_ros.tracking.noise import find_repetition
from kinpole_ros.tracking.posed import learn_poses
from kinpole_ros.tracking.rejection import HELD, HELD_MARKERS, NO_MARKER_REPEATS
from kinpole_ros.tracking.state import MIN_HISTORY_FRAMES, State, restart_bodies
from kinpole_ros.tracking.statistics import median
from kinpole_ros.tracking.thresholds import MEMORY_FRAMES

# The history has at least this many windows, and at most so many bytes, whatever the window: 30 s
# of 20 bodies with four markers at 200 Hz. Results of a longer window are from what is kept of it.
MIN_HISTORY_WINDOWS, MAX_HISTORY_BYTES = 4, 2**25
# Frames between two updates: this share of all frames so far, and at most so many.
UPDATE_SHARE, MAX_UPDATE_INTERVAL = 1 / 8, 128


def update_if_due(state: State) -> bool:
    """Learn if an update is due; return whether names stand for other markers since."""
    if state.frame_count >= state.next_update:
        state.names_changed |= _update(state)
    changed, state.names_changed = state.names_changed, False
    return changed


def update_clock(state: State) -> None:
    """Estimate the clock again, after an update of what is due."""
    # The clock depends on the noise, which is to be the same live and in replay.
    state.names_changed = update_if_due(state)
    state.timeline.update_clock(state.history, state.bodies.noise)


def learn_if_due(state: State) -> None:
    """Learn, and estimate the clock, if either is due; the next frame need not then."""
    if state.frame_count >= state.next_update:
        state.names_changed = update_if_due(state)
    if state.timeline.until_update <= 0:
        update_clock(state)


def _update(state: State) -> bool:
    """Learn from the history; return whether names stand for other markers since."""
    bodies, history, window = state.bodies, state.history, state.settings.window_ns
    state.next_update = state.frame_count + max(
        1, min(int(state.frame_count * UPDATE_SHARE), MAX_UPDATE_INTERVAL)
    )
    if state.assignment.plane is None:
        drop_old_frames(state)
        return False
    count_new_frames(state)
    new = state.frame_count - state.learned_count
    if state.assignment.posed:
        learn_poses(bodies, history, state.settings.noise)
        bodies.learned_tilt_turn = state.step.tracks['sure_tilt_turn'].copy()
    else:
        restarts, counts = learn(bodies, history, window, state.settings.noise)
        state.totals.counts.update(counts)
        state.pins.forget(restarts)
    state.pins.update(bodies, history, min(new, len(history)), state.assignment.posed)
    state.learned_count = state.frame_count
    drop_old_frames(state)
    # Measured noise, not what the parameters say: exact poses of a body at rest do repeat.
    is_measured = state.assignment.posed and not state.settings.noise
    noise = bodies.noise if is_measured else bodies.white
    degrees = 3 if state.assignment.posed else None
    before = bodies.repetition
    repetition = find_repetition(history['markers'][-MISFIT_FRAMES:], noise, degrees)
    # Of a body that starts again, what was known before holds until its noise is.
    bodies.repetition = np.where(np.isnan(noise), before, repetition)
    begins = (bodies.repetition == NO_MARKER_REPEATS) & (before != NO_MARKER_REPEATS)
    if begins.any():
        last = history['markers'][-2:].copy()
        lacking = forget_held_markers(bodies, history, begins)
        if lacking.any():
            restart_bodies(state, lacking)
            history['markers'][-2:][:, lacking] = last[:, lacking]
            bodies.repetition[lacking] = NO_MARKER_REPEATS
    bodies.hub = find_hubs(bodies, history, window, bodies.hub)
    bodies.jump_scale = path_scale(history)
    if not state.assignment.posed:
        _find_deformed(state)
    changed = False
    if state.matcher.regrouping_is_due():
        regrouped = state.matcher.regroup(bodies.rigidity_residual() > 0, state.totals.counts)
        changed = bool(regrouped.any() or state.matcher.withheld.any())
        if regrouped.any():
            restart_bodies(state, regrouped)
    state.step.bind(bodies, state.pins, history)
    return changed


def _find_deformed(state: State) -> None:
    """Find the bodies whose markers move against each other by more than their noise."""
    bodies, history = state.bodies, state.history
    rows = slice(-MEMORY_FRAMES - 2, None)
    time, residual = history['time'][rows], history['residual'][rows]
    interval = median(np.diff(time)) if len(time) > 1 else state.settings.window_ns / 2
    free = freedom_of(bodies, residual).sum(axis=-1)
    noise = np.fmax(bodies.noise, bodies.white)
    half = round(state.settings.window_ns / 2 / max(interval, 1.0))
    bodies.freedom, bodies.hidden_factor = deformed_freedom(
        residual, free, noise, bodies.degrees, half
    )


def recover(state: State, failures: int) -> str:
    """
    Make up for a frame that failed; return in words what is lost.

    That is the frame alone at first, then what is known of one body after the other. `failures` is
    the number of failures before, with no success between.
    """
    if failures:
        names, number = list(state.settings.bodies), failures - 1
        restart_bodies(state, np.arange(len(names)) == number)
        return f'starts anew with {names[number]}'
    drop_old_frames(state)
    state.step.bind(state.bodies, state.pins, state.history)
    return 'goes on without that frame'


def count_new_frames(state: State) -> None:
    """Count hidden markers since the last update, and measure how the motion lies in space."""
    new = min(state.frame_count - state.counted_count, len(state.history))
    state.counted_count = state.frame_count
    if not new or state.assignment.plane is None:
        return
    markers, heights = (state.history[name][-new:] for name in ('markers', 'heights'))
    for key in (HELD, HELD_MARKERS):
        held = state.step.tracks[key]
        if held.any():
            state.totals.counts[key] += int(held.sum())
            held[:] = 0
    seen = np.count_nonzero(~np.isnan(markers[..., 0] if state.assignment.posed else markers))
    lacking = state.assignment.count * new - seen
    state.totals.counts['markers_not_seen'] += int(lacking)
    if not state.assignment.posed:
        state.space.add(state.assignment.plane.in_space(markers, heights))


def drop_old_frames(state: State) -> None:
    """Drop frames that neither the window nor the next update needs."""
    history, columns = state.history, state.step.columns
    samples = int(columns.samples)
    most = max(MIN_HISTORY_FRAMES, MAX_HISTORY_BYTES // history.row_bytes)
    kept = min(max(MIN_HISTORY_FRAMES, MIN_HISTORY_WINDOWS * samples), most)
    drop = len(history) - kept
    if drop > 0:
        history.drop(drop)
        columns.next_result = max(0, columns.next_result - drop)
