"""Learn from the history when an update is due: the last stage of a frame."""

from dataclasses import replace

import numpy as np

from kinpole_ros.derivatives import SPECTRUM_WINDOWS
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.center import find_hubs, update_pins
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.learn import (
    MISFIT_FRAMES,
    find_deformed,
    forget_held_markers,
    learn,
    path_scale,
    refit,
)
from kinpole_ros.tracking.noise import find_repetition
from kinpole_ros.tracking.other_noise import has_other_noise
from kinpole_ros.tracking.pose_noise import learn_poses
from kinpole_ros.tracking.recording import Recording, Stretch
from kinpole_ros.tracking.rejection import HELD, HELD_MARKERS, NO_MARKER_REPEATS
from kinpole_ros.tracking.spectra import spectrum_of_body
from kinpole_ros.tracking.state import (
    MIN_HISTORY_FRAMES,
    State,
    forget_earlier,
    put_bodies,
    restart_bodies,
    widen,
)

# The history has at least this many windows, and at most so many bytes, whatever the window: 30 s
# of 20 bodies with four markers at 200 Hz. Results of a longer window are from what is kept of it.
MIN_HISTORY_WINDOWS, MAX_HISTORY_BYTES = SPECTRUM_WINDOWS + 2, 2**25
# Bodies whose spectra are known, at most: a bound of the memory of their tables.
MAX_BODIES_WITH_SPECTRUM = 16
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
    if state.recording is not None and state.recording.is_learned:
        recall(state, state.recording)
        return False
    state.next_update = state.frame_count + max(
        1, min(int(state.frame_count * UPDATE_SHARE), MAX_UPDATE_INTERVAL)
    )
    if state.assignment.plane is None:
        drop_old_frames(state)
        return False
    count_new_frames(state)
    bodies, restarted, moved = _learn_shapes_and_noise(state, state.bodies)
    forget_earlier(state, restarted)
    new = min(state.frame_count - state.learned_count, len(state.history))
    pins = state.pins.forget(restarted)
    bodies, state.pins = update_pins(bodies, pins, state.history, new)
    state.learned_count = state.frame_count
    drop_old_frames(state)
    bodies = _learn_without_held_markers(state, bodies)
    bodies = bodies.change(
        hub=find_hubs(bodies, state.history, state.settings.window_ns, bodies.hub),
        jump_scale=path_scale(state.history),
    )
    if not bodies.are_measured:
        bodies = find_deformed(bodies, state.history, state.settings.window_ns)
    bodies = _find_spectrum_if_due(state, bodies)
    regrouped = np.zeros(bodies.count, bool)
    changed = state.matcher.regrouping_is_due()
    if changed:
        regrouped = state.matcher.regroup(bodies.rigidity_residual() > 0, state.totals.counts)
        changed = bool(regrouped.any() or state.matcher.withheld.any())
    if regrouped.any():
        bodies = restart_bodies(state, bodies, regrouped)
    put_bodies(state, bodies)
    if state.recording is not None:
        is_other = has_other_noise(bodies, state.history, state.recording.count, new)
        state.recording.note(bodies, moved, is_other, new, state.timeline)
    return changed


def _find_spectrum_if_due(state: State, bodies: Bodies) -> Bodies:
    """
    Find the spectrum of a body, if the history is long enough, and again once all of it is new.

    That of one body, because its tables take several ms.
    """
    history, window = state.history, state.settings.window_ns
    due = state.next_spectrum[:MAX_BODIES_WITH_SPECTRUM]
    b = int(due.argmin())
    span = history['time'][-1] - history['time'][0]
    if state.frame_count < due[b] or span < SPECTRUM_WINDOWS * window:
        return bodies
    due[b] = state.frame_count + len(history)
    spectra = bodies.spectra.copy()
    spectra[b] = spectrum_of_body(bodies, history, window, b)
    return bodies.change(spectra=spectra)


def end_learned(state: State) -> None:
    """Keep what a first pass learned of the frames since the start."""
    recording = state.recording
    if recording is not None and not recording.is_learned:
        names = state.matcher.known_names()
        recording.end_run(state.bodies, state.timeline, state.assignment.plane, names)


def begin_known(state: State) -> None:
    """Begin with what a first pass learned of the frames after the start."""
    recording = state.recording
    if recording is None or not recording.is_learned:
        return
    stretch = recording.stretch()
    if stretch.names is None or stretch.bodies.are_measured != state.bodies.are_measured:
        return
    state.matcher.take_names(stretch.names)
    if state.assignment.width > state.step.known.width:
        widen(state)
    state.space.plane = state.space.plane or stretch.plane
    state.assignment.set_plane(state.space.plane)
    state.step.complete_results(True)
    recall(state, recording)


def recall(state: State, recording: Recording) -> None:
    """Let the next frames use what is known of them from the first pass over the recording."""
    stretch = recording.stretch()
    state.next_update = state.frame_count + max(
        1, min(stretch.end - recording.number, MAX_UPDATE_INTERVAL)
    )
    count_new_frames(state)
    drop_old_frames(state)
    before, bodies = state.bodies, stretch.bodies
    if bodies.are_measured != before.are_measured or bodies.width != before.width:
        return
    if stretch.clock is not None:
        state.timeline.know(stretch.clock, stretch.at_ticks)
    # Without what follows from it, which is not kept.
    bodies = replace(bodies)
    if stretch is not recording.recalled and len(state.history) and stretch.changed.any():
        _change_history(state.history, before, bodies, stretch)
    recording.recalled = stretch
    put_bodies(state, bodies)


def _change_history(history: History, before: Bodies, bodies: Bodies, stretch: Stretch) -> None:
    """Fit the frames before a stretch to its bodies, without markers that moved since."""
    history['used'][:, stretch.moved] = False
    if not bodies.are_measured:
        refit(bodies, history)
    with np.errstate(invalid='ignore', divide='ignore'):
        ratio = np.where(stretch.changed, bodies.noise / before.noise, 1.0)
        is_known = np.isfinite(ratio) & (ratio > 0)
    # Information is in units of the noise now.
    history['information'][...] *= np.where(is_known, ratio, 1.0) ** 2


def _learn_shapes_and_noise(state: State, bodies: Bodies) -> tuple[Bodies, np.ndarray, np.ndarray]:
    """
    Learn what fits need.

    Return also which bodies (B,) started again from earlier frames, and which markers (B, n) moved.
    """
    settings, history, tracks = state.settings, state.history, state.step.tracks
    if bodies.are_measured:
        bodies = bodies.change(learned_tilt_turn=tracks['sure_tilt_turn'].copy())
        none = np.zeros(bodies.shape.shape, bool)
        return learn_poses(bodies, history, settings.noise), none.any(axis=1), none
    bodies, restarted, moved, counts = learn(bodies, history, settings.window_ns, settings.noise)
    state.totals.counts.update(counts)
    for b in np.flatnonzero(restarted).tolist():
        angle = history['angle'][:, b]
        tracks['last_angle'][b] = angle[np.isfinite(angle)][-1]
    return bodies, restarted, moved


def _learn_without_held_markers(state: State, bodies: Bodies) -> Bodies:
    """Find how markers may repeat; learn again where some stood still that never do."""
    history, before = state.history, bodies.repetition
    degrees = 3 if bodies.are_measured else None
    found = find_repetition(history['markers'][-MISFIT_FRAMES:], bodies.white, degrees)
    # Of a body that starts again, what was known before holds until its noise is.
    repetition = np.where(np.isnan(bodies.white), before, found)
    bodies = bodies.change(repetition=repetition)
    begins = (repetition == NO_MARKER_REPEATS) & (before != NO_MARKER_REPEATS)
    if not begins.any():
        return bodies
    forget_earlier(state, begins)
    last = history['markers'][-2:].copy()
    bodies, lacking = forget_held_markers(bodies, history, begins)
    if not lacking.any():
        return bodies
    bodies = restart_bodies(state, bodies, lacking)
    history['markers'][-2:][:, lacking] = last[:, lacking]
    return bodies.change(repetition=repetition)


def recover(state: State, failures: int) -> str:
    """
    Make up for a frame that failed; return in words what is lost.

    That is the frame alone at first, then what is known of one body after the other. `failures` is
    the number of failures before, with no success between.
    """
    if failures:
        names, number = list(state.settings.bodies), failures - 1
        put_bodies(state, restart_bodies(state, state.bodies, np.arange(len(names)) == number))
        return f'starts anew with {names[number]}'
    drop_old_frames(state)
    put_bodies(state, state.bodies)
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
    seen = np.count_nonzero(~np.isnan(markers)) // state.assignment.points_each
    lacking = state.assignment.count * new - seen
    state.totals.counts['markers_not_seen'] += int(lacking)
    if not state.bodies.are_measured:
        state.space.add(state.assignment.plane.in_space(markers, heights))


def drop_old_frames(state: State) -> None:
    """Drop frames that neither the window nor the next update needs."""
    history, columns = state.history, state.step.columns
    samples = int(columns.window_frames)
    most = max(MIN_HISTORY_FRAMES, MAX_HISTORY_BYTES // history.row_bytes)
    kept = min(max(MIN_HISTORY_FRAMES, MIN_HISTORY_WINDOWS * samples), most)
    drop = len(history) - kept
    if drop > 0:
        history.drop(drop)
        # A history that is full gets no longer, so that the window may never be full.
        if not columns.next_result:
            state.step.complete_results(False)
        columns.next_result = max(0, columns.next_result - drop)
