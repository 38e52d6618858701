"""What the tracker knows between two frames, and which stage writes it."""

import itertools
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from kinpole_ros.settings import Settings, of_poses
from kinpole_ros.tracking.bodies import Bodies, new_bodies
from kinpole_ros.tracking.center import PinSearch, new_pin_search
from kinpole_ros.tracking.events import EventSearch
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.history import History
from kinpole_ros.tracking.names import Matcher
from kinpole_ros.tracking.outages import no_outages
from kinpole_ros.tracking.placed_frames import PlacedFrames
from kinpole_ros.tracking.placing import MarkerAssignment
from kinpole_ros.tracking.recording import Recording
from kinpole_ros.tracking.space import Space
from kinpole_ros.tracking.step import Step, new_tracks
from kinpole_ros.tracking.timeline import Timeline

# The history has at least this many frames.
MIN_HISTORY_FRAMES = 2048
_run_numbers = itertools.count(1)


class Totals(NamedTuple):
    """
    What is counted from the first frame on, also over restarts.

    `counts` are frames and markers that were dropped, corrected or not seen, by cause; each stage
    adds to its own. `outages` (B + 1, 5) are gaps, see frames.h, and `wrong` (B,) poses off their
    paths; C writes both.
    """

    counts: Counter[str]
    outages: np.ndarray
    wrong: np.ndarray


def new_totals(bodies: int) -> Totals:
    """Return the totals before the first frame."""
    return Totals(Counter(), no_outages(bodies), np.zeros(bodies, np.int64))


class NameSearch(NamedTuple):
    """Searches for names in a row without a result, and the frame from which to search again."""

    futile: int
    due: int


_NOT_SEARCHED = NameSearch(0, 0)


@dataclass
class State:
    """
    What is known since the last start.

    Attributes
    ----------
    settings : Settings
        The parameters.
    recording : Recording or None
        What the first pass over a recording learns, and the second one knows; None for neither.
    totals : Totals
        What is counted over restarts.
    run : int
        Another number for each start.
    timeline : Timeline
        The clock, written by `Timeline` alone.
    assignment, matcher : MarkerAssignment, Matcher
        The names of markers, written by `correct_frame` of correction.py.
    placed : PlacedFrames or None
        The frames in hand.
    space : Space
        The plane, and how the motion lies in space.
    before_plane : deque
        Frames before the plane was known, with their times and counts.
    bodies : Bodies
        What is learned, put in by `put_bodies` alone.
    pins : PinSearch
        Poses that are kept for pins, written by update.py.
    history, step : History, Step
        The frames of late, written by C.
    event_search : EventSearch
        Where the search for events goes on.
    frame_count, learned_count, counted_count : int
        Frames since the start, those up to the last update, and those whose hidden markers were
        counted; the first is written by tracker.py, the others by update.py.
    next_update : int
        The frame at which to learn next.
    next_spectrum : (B,) int64
        The frames at which to find the spectrum of each body next.
    names_changed : bool
        Whether names stand for other markers since the frames in hand were placed.
    name_search : NameSearch
        When to search for names again.

    """

    settings: Settings
    recording: Recording | None
    totals: Totals
    run: int
    timeline: Timeline
    assignment: MarkerAssignment
    space: Space
    event_search: EventSearch
    bodies: Bodies
    history: History
    pins: PinSearch
    matcher: Matcher
    step: Step
    next_spectrum: np.ndarray
    placed: PlacedFrames | None = None
    before_plane: deque[tuple[MarkerFrames, list[np.ndarray]]] = field(
        default_factory=lambda: deque(maxlen=MIN_HISTORY_FRAMES)
    )
    frame_count: int = 0
    learned_count: int = 0
    counted_count: int = 0
    next_update: int = 1
    names_changed: bool = False
    name_search: NameSearch = _NOT_SEARCHED


def start(
    settings: Settings,
    are_measured: bool,
    totals: Totals,
    before: Timeline | None,
    recording: Recording | None,
) -> State:
    """
    Return the state before the first frame, of bodies whose poses are measured or not.

    The clock goes on from the timeline `before`.
    """
    count = len(settings.bodies)
    assignment = MarkerAssignment(of_poses(settings) if are_measured else settings, are_measured)
    space = Space(settings.plane, count, assignment.width)
    assignment.set_plane(space.plane)
    bodies, history, pins, matcher, step = _new_bodies(settings, totals, assignment, are_measured)
    return State(
        settings=settings,
        recording=recording,
        totals=totals,
        run=next(_run_numbers),
        timeline=Timeline(settings, totals.counts, before),
        assignment=assignment,
        space=space,
        event_search=EventSearch(settings.window_ns, count),
        bodies=bodies,
        history=history,
        pins=pins,
        matcher=matcher,
        step=step,
        next_spectrum=np.zeros(count, np.int64),
    )


def start_bodies(state: State) -> None:
    """Start with bodies of which nothing is known, on the same clock, names and plane."""
    state.assignment.restart()
    about = state.settings, state.totals, state.assignment, state.bodies.are_measured
    state.bodies, state.history, state.pins, state.matcher, state.step = _new_bodies(*about)
    state.frame_count = state.learned_count = state.counted_count = 0
    state.next_spectrum[:] = 0
    state.next_update, state.names_changed, state.name_search = 1, False, _NOT_SEARCHED


def _new_bodies(
    settings: Settings, totals: Totals, assignment: MarkerAssignment, are_measured: bool
) -> tuple[Bodies, History, PinSearch, Matcher, Step]:
    """Return bodies, history, pins, matcher and step before the first frame."""
    settings = of_poses(settings) if are_measured else settings
    slots = len(settings.bodies), assignment.width
    history = History(*slots)
    matcher = Matcher(settings, assignment, new_bodies(*slots, are_measured), history)
    step = Step(settings, new_tracks(len(settings.bodies), totals.outages, totals.wrong))
    step.bind(matcher.bodies, history)
    return matcher.bodies, history, new_pin_search(*slots), matcher, step


def put_bodies(state: State, bodies: Bodies) -> None:
    """Let all stages of the next frames use what is known of the bodies now."""
    state.bodies = state.matcher.bodies = bodies
    state.step.bind(bodies, state.history)


def forget_earlier(state: State, which: np.ndarray) -> None:
    """Forget what earlier stretches of a recording say of bodies (B,) that were never so."""
    if state.recording is not None and which.any():
        state.recording.forget(which)


def widen(state: State) -> None:
    """Make room for more markers, of a body that takes all markers."""
    width = state.assignment.width
    state.history.widen(width)
    state.space.widen(width)
    state.pins = state.pins.widen(width)
    put_bodies(state, state.bodies.widen(width))
    state.before_plane.clear()


def restart_bodies(state: State, bodies: Bodies, which: np.ndarray) -> Bodies:
    """Return `bodies` with everything learned of some (B,) forgotten, as in history and pins."""
    bodies = bodies.restart(which)
    forget_earlier(state, which)
    state.assignment.restore_order(which)
    given = state.matcher.given
    if given.has_shape.any():
        bodies = bodies.give(np.where(which[:, None], given.shapes, np.nan))
    history = state.history
    history['information'][:, :, which] = 0.0
    history['used'][:, which] = False
    history['markers'][:, which] = np.nan
    history['angle'][:, which] = np.nan
    state.step.tracks['last_angle'][which] = np.nan
    state.pins = state.pins.forget(which)
    return bodies
