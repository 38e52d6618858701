"""Learn from the history when an update is due: the last stage of a frame."""

import numpy as np

from kinpole_ros.tracking.center import find_hubs
from kinpole_ros.tracking.deformation import deformed_freedom
from kinpole_ros.tracking.learn import freedom_of, learn, path_scale
from kinpole_ros.tracking.posed import learn_poses
from kinpole_ros.tracking.state import MIN_HISTORY_FRAMES, State, restart_bodies
from kinpole_ros.tracking.thresholds import MEMORY_FRAMES

# The history has at least this many windows.
MIN_HISTORY_WINDOWS = 4
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
    samples = int(state.step.fields.samples)
    state.timeline.update_clock(state.history, samples, state.bodies.noise)


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
    if state.posed:
        learn_poses(bodies, history, state.settings.noise)
        bodies.extra_turn = state.step.total_turn.copy()
    else:
        restarts = learn(bodies, history, window, state.settings.noise, state.totals.counts)
        state.pins.forget(restarts)
    state.pins.update(bodies, history, min(state.new_frames, len(history)), state.posed)
    state.new_frames = state.counted_frames = 0
    drop_old_frames(state)
    bodies.hub = find_hubs(bodies, history, window, bodies.hub)
    bodies.jump_scale = path_scale(history)
    if not state.posed:
        _find_deformed(state)
    changed = False
    if state.matcher.regrouping_is_due():
        regrouped = state.matcher.regroup(bodies.rigidity_residual() > 0)
        changed = bool(regrouped.any() or state.matcher.withheld.any())
        if regrouped.any():
            restart_bodies(state, regrouped)
    state.step.bind(bodies, history)
    return changed


def _find_deformed(state: State) -> None:
    """Find the bodies whose markers move against each other by more than their noise."""
    bodies, history = state.bodies, state.history
    rows = slice(-MEMORY_FRAMES - 2, None)
    time, residual = history['time'][rows], history['residual'][rows]
    interval = float(np.median(np.diff(time))) if len(time) > 1 else state.settings.window_ns / 2
    free = freedom_of(bodies, residual).sum(axis=-1)
    noise = np.fmax(bodies.noise, bodies.white)
    half = round(state.settings.window_ns / 2 / max(interval, 1.0))
    bodies.freedom, bodies.hidden_factor = deformed_freedom(
        residual, free, noise, bodies.degrees, half
    )


def count_new_frames(state: State) -> None:
    """Count hidden markers since the last update, and measure how the motion lies in space."""
    new = min(state.new_frames - state.counted_frames, len(state.history))
    state.counted_frames = state.new_frames
    if not new or state.assignment.plane is None:
        return
    markers, heights = (state.history[name][-new:] for name in ('markers', 'heights'))
    seen = np.count_nonzero(~np.isnan(markers[..., 0] if state.posed else markers))
    lacking = state.assignment.count * new - seen
    state.totals.counts['markers_not_seen'] += int(lacking)
    if not state.posed:
        state.space.add(state.assignment.plane.in_space(markers, heights))


def drop_old_frames(state: State) -> None:
    """Drop frames that neither the window nor the next update needs."""
    history, fields = state.history, state.step.fields
    samples = int(fields.samples)
    kept = max(MIN_HISTORY_FRAMES, MIN_HISTORY_WINDOWS * samples, samples)
    drop = len(history) - kept
    if drop > 0:
        history.drop(drop)
        fields.due = max(0, fields.due - drop)
