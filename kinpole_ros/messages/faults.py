"""
Faults of the input in words with the fix, for diagnostics and the warnings of replay.

Each function returns the text of one fault, or an empty one where there is none.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.messages._types import DiagnosticStatus
from kinpole_ros.tracking.clock import StampState
from kinpole_ros.tracking.names import BY_SHAPE, UNCERTAIN
from kinpole_ros.tracking.placed_frames import OTHERS, RENAMED
from kinpole_ros.tracking.plane import FIT, Plane, PlaneSetting, as_parameter
from kinpole_ros.tracking.rejection import HELD
from kinpole_ros.tracking.space import SpaceReport
from kinpole_ros.tracking.tracker import Tracker

Fault: TypeAlias = tuple[int, str]
"""Level of diagnostic_msgs and text."""

_LISTED_NOTES, _NOTE_CHARACTERS = 3, 120  # notes on identities may be of any number and length
_MAX_PACE = 100.0  # of stamps against arrivals: a bag played at ten times its speed is no fault
_BUNCHED_STEP = 0.25  # of the mean step: the median step of frames that come in bunches is less
_MIN_STAMPS = 5  # to judge their pace

PLANE_UNKNOWN = (
    'the plane is not known yet: it is found when bodies have moved in two directions of it, by '
    'more than their noise; wait, or set plane: [x, y, z], its normal'
)
_SHAPE_FAULTS = {
    'mirrored': (
        'the markers of {0} are the mirror image of {0}.shape; fix: change the sign of each y in '
        'it, or look at the plane from the other side'
    ),
    'other': (
        'the markers of {0} do not have the shape {0}.shape; fix: correct it, as kinpole discover '
        'finds it'
    ),
    'nowhere': (
        'no points have the shape {0}.shape; fix: correct it, as kinpole discover finds it, or see '
        'that its markers are seen'
    ),
}
# With which results still come.
_MILD_TROUBLES = ('behind', 'clock', 'other types', 'sources', 'duplicates', 'drawings')
_STAMP_FIX = 'see that the driver sets header.stamp to the time of capture, in s and ns'


def identity_lines(tracker: Tracker, counts: Mapping[str, int]) -> Iterator[str]:
    """
    Yield the faults of the identities of markers: the present ones, then those counted.

    `counts` are what the tracker counted in the time that is described.
    """
    matcher, bodies = tracker.matcher, np.array(tracker.bodies)
    if matcher.disordered:
        names = ', '.join(bodies[matcher.withheld])
        yield (
            f'the points come in random order from the first frame, and {names} have no shape, so '
            'nothing is published of them; fix: give <body>.shape for each; kinpole discover '
            'finds it'
        )
    elif matcher.withheld.any():
        names = ', '.join(bodies[matcher.withheld])
        yield (
            f'nothing is published of {names}, since markers named for one are on another of them, '
            f'and it is not clear which; fix: correct <body>.markers of {names}'
        )
    for marker, named, own in matcher.regrouped:
        yield (
            f'{_short(repr(marker))} is listed for {named} but moves with {own}, and is taken for '
            f'one of its markers; fix: correct {named}.markers and {own}.markers'
        )
    for body, how in matcher.wrong_shapes(tracker.state.placed).items():
        yield _SHAPE_FAULTS[how].format(body)
    yield from _counted_lines(tracker, counts)


def _counted_lines(tracker: Tracker, counts: Mapping[str, int]) -> Iterator[str]:
    """Yield what was corrected or left out, and how often."""
    matcher = tracker.matcher
    examples = '; '.join(_short(text) for text in list(matcher.notes)[-_LISTED_NOTES:])
    examples = f' ({examples})' if examples else ''
    if misnamed := counts.get(OTHERS):
        yield (
            f'{misnamed} markers had the names of markers of other bodies{examples}, and are '
            'matched by shape; fix: see to the labels of the tracker'
        )
    if renamed := counts.get(RENAMED):
        yield (
            f'{renamed} markers had names that no body has{examples}, and are matched by shape; '
            'fix: see to the labels of the tracker'
        )
    if held := counts.get(HELD):
        yield (
            f'{held} poses repeated the one before to the last bit, which measured ones never do, '
            'and are taken as not seen; fix: let the tracker send nothing of a body that it lost'
        )
    by_shape = tracker.settings.marker_identity == 'shape'
    if (frames := counts.get(BY_SHAPE)) and not by_shape:
        yield (
            f'{frames} frames did not have {matcher.full_count} points, and their points, which '
            'have no names, are matched by shape; fix: see that none are missing or added, or set '
            'marker_identity to shape'
        )
    if ambiguous := counts.get(UNCERTAIN):
        yield (
            f'{ambiguous} times a body was left out of a frame, since points fit its shape in '
            'several ways; fix: place its markers so that no other body, and no turn of it, looks '
            'the same'
        )


def _short(text: str) -> str:
    return text if len(text) <= _NOTE_CHARACTERS else f'{text[:_NOTE_CHARACTERS]}...'


def plane_words(plane: Plane) -> str:
    """Return the name of a plane, or its axes in the frame of the markers."""
    if plane.axes is not None:
        return plane.name
    first, second, normal = map(as_parameter, plane.basis)
    return f'normal {normal}, x along {first}, y along {second}'


def tilt_fault(report: SpaceReport, setting: PlaneSetting) -> str:
    """
    Return the fault of a motion that is tilted against the plane; '' where there is none.

    `setting` is the parameter `plane`.
    """
    if report.plane is None or report.normal is None or not report.is_tilted:
        return ''
    degrees = round(np.degrees(report.tilt))
    about = 'at least ' if report.line and degrees < 90 else ''
    if setting == FIT:
        return (
            f'the motion is tilted by {about}{degrees} degrees against the plane that was fitted: '
            'the markers or the cameras were moved; fix: start anew, or set plane: '
            f'{as_parameter(report.normal)}'
        )
    # No plane can be fitted to a line.
    fix = ('' if report.line else 'plane: fit, or ') + f'plane: {as_parameter(report.normal)}'
    return (
        f'the motion is tilted by {about}{degrees} degrees against the plane {report.plane.name}; '
        f'fix: set {fix}'
    )


def _pace_faults(stamps: Sequence[int], seconds: float, window: float) -> list[Fault]:
    """
    Return levels and texts of the faults of header stamps (ns) that came within `seconds`.

    They are stamps that stand still, that advance in another unit than s and ns, and that come in
    bunches; the tracker counts single jumps and repetitions. Steps longer than `window`, s, are
    jumps.
    """
    steps = np.diff(np.array(stamps, dtype=np.int64)) * 1e-9
    if len(stamps) < _MIN_STAMPS or seconds <= 0:
        return []
    if not steps.any():
        text = f'the stamps stand still at {stamps[-1] * 1e-9:.9g} s: {_STAMP_FIX}'
        return [(DiagnosticStatus.ERROR, text)]
    ahead = steps[steps > 0]
    if len(ahead) < _MIN_STAMPS - 1:
        return []
    arrivals = seconds / len(stamps)
    fast, slow = np.median(ahead) / arrivals, ahead.mean() / arrivals
    if fast > _MAX_PACE or slow < 1 / _MAX_PACE:
        pace = fast if fast > _MAX_PACE else slow
        text = f'the stamps advance {pace:.2g} times as fast as the messages come: {_STAMP_FIX}'
        return [(DiagnosticStatus.ERROR, text)]
    regular = ahead[ahead <= window]
    if len(regular) and np.median(regular) < _BUNCHED_STEP * regular.mean():
        text = (
            f'the stamps come in bunches, mostly in steps of {np.median(regular):.2g} s where the '
            f'mean is {regular.mean():.2g} s: {_STAMP_FIX}'
        )
        return [(DiagnosticStatus.WARN, text)]
    return []


def jitter_fault(state: StampState, mode: str) -> str:
    """
    Return the fault of stamps that are late by random times; '' where there is none.

    `mode` is the parameter `stamps`.
    """
    if state.regularized and state.jitter > state.interval:
        return (
            f'the stamps are late by {state.jitter:.2g} s rms, up to {state.largest:.2g} s, more '
            f'than the {state.interval:.2g} s between frames: nobody can tell by them which frames '
            'were lost, and figures may be off by more than their deviations; fix: let the driver '
            'stamp the time of capture'
        )
    if not state.costs:
        return ''
    if mode == 'capture':
        fix = 'set stamps: arrival, or auto, if the camera has an even clock'
    else:
        fix = 'set stamps: arrival if the camera has an even clock'
    return (
        f'the stamps jitter by {state.jitter:.2g} s rms, up to {state.largest:.2g} s, which moves '
        f'the markers by more than their noise; fix: {fix}, or let the driver stamp the time of '
        'capture'
    )


def stamp_faults(
    tracker: Tracker, since: Mapping[str, int], stamps: Sequence[int], seconds: float
) -> list[Fault]:
    """Return the faults of stamps, and of the plane."""
    state = tracker.stamp_state()
    is_regularized = state is not None and state.regularized
    faults = [
        (level, text)
        for level, text in _pace_faults(stamps, seconds, tracker.settings.window)
        # Frames in bunches do no harm where they are placed at the ticks of a clock.
        if level == DiagnosticStatus.ERROR or not is_regularized
    ]
    if since.get('frames'):
        jitter = '' if state is None else jitter_fault(state, tracker.settings.stamps)
        unknown = PLANE_UNKNOWN if tracker.plane is None else ''
        tilt = unknown or tilt_fault(tracker.space(), tracker.settings.plane)
        faults += [(DiagnosticStatus.WARN, text) for text in (jitter, tilt) if text]
    return faults


def input_faults(
    tracker: Tracker, since: Mapping[str, int], trouble: Mapping[str, str], nothing: str
) -> list[Fault]:
    """
    Return levels and texts of the faults of the input, by the counts `since` the last ones.

    As in REP-107, with WARN results still come and may suffer, with ERROR they cannot be relied
    upon. STALE, with the text `nothing`, is when nothing came.
    """
    frames = since.get('frames', 0)
    mild = {*_MILD_TROUBLES}
    if frames:
        mild.add('qos')
    if frames > since.get('unreadable', 0):
        mild.add('message')
    faults = [
        (DiagnosticStatus.WARN if topic in mild else DiagnosticStatus.ERROR, text)
        for topic, text in trouble.items()
    ]
    if not frames and mild.issuperset(trouble):
        return [(DiagnosticStatus.STALE, nothing), *faults]
    texts = []
    if dropped := since.get('dropped'):
        texts.append(
            f'{dropped} messages dropped: the node or the network cannot keep up; send fewer '
            'frames, or read fewer results'
        )
    texts += identity_lines(tracker, since)
    if since.get('restarts'):
        texts.append('another publisher sends the markers: the window starts anew')
    if since.get('frame_changes'):
        texts.append('the markers have another frame_id: the window starts anew')
    if late := since.get('late'):
        texts.append(f'{late} frames came late, after newer ones, and are left out')
    if resets := since.get('resets'):
        text = 'stamps jumped: the window starts anew'
        if resets >= frames:
            text += (
                '; they do at every frame: if frames come so seldom, raise the parameter window, '
                f'{tracker.settings.window:g} s, to hold {FEWEST_SAMPLES} of them or more'
            )
        texts.append(text)
    elif since.get('repeated'):
        texts.append('stamps repeat: see that the driver sets header.stamp to the time of capture')
    elif frames and tracker.samples < FEWEST_SAMPLES:
        texts.append(
            f'the window holds {tracker.samples} frames and needs {FEWEST_SAMPLES}; wait, or '
            'raise the parameter window'
        )
    return faults + [(DiagnosticStatus.WARN, text) for text in texts]
