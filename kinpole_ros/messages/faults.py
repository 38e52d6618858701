"""Findings about the input: stamps, the plane, and the names of markers."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.findings import ERROR, STALE, WARN, Finding
from kinpole_ros.tracking.clock import StampState
from kinpole_ros.tracking.names import BY_SHAPE, UNCERTAIN
from kinpole_ros.tracking.placed_frames import OTHERS, RENAMED
from kinpole_ros.tracking.plane import FIT, Plane, PlaneSetting, as_parameter
from kinpole_ros.tracking.rejection import HELD
from kinpole_ros.tracking.space import SpaceReport
from kinpole_ros.tracking.tracker import Tracker

_LISTED_NOTES, _NOTE_CHARACTERS = 3, 120  # notes on identities may be of any number and length
_MAX_PACE = 100.0  # of stamps against arrivals: a bag played at ten times its speed is no fault
_BUNCHED_STEP = 0.25  # of the mean step: the median step of frames that come in bunches is less
_MIN_STAMPS = 5  # to know their pace
_OF_SHAPES = {'mirrored': 'mirrored', 'other': 'other_shape', 'nowhere': 'shape_nowhere'}


def identity_findings(tracker: Tracker, counts: Mapping[str, int]) -> Iterator[Finding]:
    """
    Yield what is wrong with the identities of markers: at present, then as counted.

    `counts` are what the tracker counted in the time that is described.
    """
    matcher, bodies = tracker.matcher, np.array(tracker.bodies)
    if matcher.withheld.any() or matcher.disordered:
        code = 'unordered' if matcher.disordered else 'unclear_names'
        yield Finding(code, values={'names': ', '.join(bodies[matcher.withheld])})
    for marker, named, own in matcher.regrouped:
        regrouped = {'marker': _short(repr(marker)), 'named': named, 'own': own}
        yield Finding('regrouped', values=regrouped)
    for body, how in matcher.wrong_shapes(tracker.state.placed).items():
        yield Finding(_OF_SHAPES[how], values={'body': body})
    examples = '; '.join(_short(text) for text in list(matcher.notes)[-_LISTED_NOTES:])
    about = {'examples': f' ({examples})' * bool(examples), 'points': str(matcher.full_count)}
    counted = {'misnamed': OTHERS, 'renamed': RENAMED, 'poses_held': HELD}
    if tracker.settings.marker_identity != 'shape':
        counted['matched_by_shape'] = BY_SHAPE
    for code, key in (counted | {'ambiguous': UNCERTAIN}).items():
        if count := counts.get(key):
            yield Finding(code, values={'count': count, **about})


def _short(text: str) -> str:
    return text if len(text) <= _NOTE_CHARACTERS else f'{text[:_NOTE_CHARACTERS]}...'


def plane_words(plane: Plane) -> str:
    """Return the name of a plane, or its axes in the frame of the markers."""
    if plane.axes is not None:
        return plane.name
    first, second, normal = map(as_parameter, plane.basis)
    return f'normal {normal}, x along {first}, y along {second}'


def tilt_findings(report: SpaceReport, setting: PlaneSetting) -> list[Finding]:
    """Return whether the motion is tilted against the plane; `setting` is the parameter."""
    if report.plane is None or report.normal is None or not report.is_tilted:
        return []
    degrees = round(np.degrees(report.tilt))
    about = {
        'about': 'at least ' if report.line and degrees < 90 else '',
        'degrees': degrees,
        'normal': as_parameter(report.normal),
        'plane': report.plane.name,
    }
    # No plane can be fitted to a line.
    code = 'tilted_from_fit' if setting == FIT else 'line_tilted' if report.line else 'tilted'
    return [Finding(code, values=about)]


def _pace_findings(stamps: Sequence[int], seconds: float, window: float) -> list[Finding]:
    """
    Return what is wrong with header stamps (ns) that came within `seconds`.

    They are stamps that stand still, that advance in another unit than s and ns, and that come in
    bunches; the tracker counts single jumps and repetitions. Steps longer than `window`, s, are
    jumps.
    """
    steps = np.diff(np.array(stamps, dtype=np.int64)) * 1e-9
    if len(stamps) < _MIN_STAMPS or seconds <= 0:
        return []
    if not steps.any():
        return [Finding('stamps_stand_still', values={'stamp': stamps[-1] * 1e-9}, level=ERROR)]
    ahead = steps[steps > 0]
    if len(ahead) < _MIN_STAMPS - 1:
        return []
    arrivals = seconds / len(stamps)
    fast, slow = float(np.median(ahead)) / arrivals, float(ahead.mean()) / arrivals
    if fast > _MAX_PACE or slow < 1 / _MAX_PACE:
        pace = fast if fast > _MAX_PACE else slow
        return [Finding('stamps_pace', values={'pace': pace}, level=ERROR)]
    regular = ahead[ahead <= window]
    if len(regular) and np.median(regular) < _BUNCHED_STEP * regular.mean():
        about = {'median': float(np.median(regular)), 'mean': float(regular.mean())}
        return [Finding('stamps_bunched', values=about)]
    return []


def jitter_findings(state: StampState | None, mode: str) -> list[Finding]:
    """Return whether stamps are late by random times; `mode` is the parameter `stamps`."""
    if state is None:
        return []
    about = {'jitter': state.jitter, 'largest': state.largest, 'interval': state.interval}
    if state.regularized and state.jitter > state.interval:
        return [Finding('stamps_late', values=about)]
    code = 'stamps_jitter_at_capture' if mode == 'capture' else 'stamps_jitter'
    return [Finding(code, values=about)] if state.costs else []


def stamp_findings(
    tracker: Tracker, since: Mapping[str, int], stamps: Sequence[int], seconds: float
) -> list[Finding]:
    """Return what is wrong with stamps, and with the plane."""
    state = tracker.stamp_state()
    is_regularized = state is not None and state.regularized
    found = [
        finding
        for finding in _pace_findings(stamps, seconds, tracker.settings.window)
        # Frames in bunches do no harm where they are placed at the ticks of a clock.
        if finding.level == ERROR or not is_regularized
    ]
    if since.get('frames'):
        found += jitter_findings(state, tracker.settings.stamps)
        if tracker.plane is None:
            found.append(Finding('plane_unknown'))
        else:
            found += tilt_findings(tracker.space(), tracker.settings.plane)
    return found


def input_findings(
    tracker: Tracker, since: Mapping[str, int], trouble: Iterable[Finding], topic: str
) -> list[Finding]:
    """
    Return what is wrong with the input, by the counts `since` the last ones.

    `trouble` is what was found before the tracker, and `topic` is that of the markers.
    """
    frames = since.get('frames', 0)
    # Results still come of other publishers, and of other messages.
    mild = {'less_qos'} if frames else set()
    if frames > since.get('unreadable', 0):
        mild.add('unreadable_message')
    found = [one._replace(level=WARN) if one.code in mild else one for one in trouble]
    if not frames and all(one.level == WARN for one in found):
        code = 'nothing_on_topic' if topic else 'nothing'
        return [Finding(code, values={'topic': topic}, level=STALE), *found]
    if dropped := since.get('dropped'):
        found.append(Finding('dropped', values={'count': dropped}))
    found += identity_findings(tracker, since)
    for key, code in (
        ('restarts', 'publisher_changed'),
        ('frame_changes', 'frame_changed'),
        ('late', 'late'),
    ):
        if count := since.get(key):
            found.append(Finding(code, values={'count': count}))
    if resets := since.get('resets'):
        about = {'window': tracker.settings.window, 'needed': FEWEST_SAMPLES}
        code = 'stamps_jump_always' if resets >= frames else 'stamps_jumped'
        found.append(Finding(code, values=about))
    elif since.get('repeated'):
        found.append(Finding('stamps_repeat'))
    elif frames and tracker.samples < FEWEST_SAMPLES:
        about = {'samples': tracker.samples, 'needed': FEWEST_SAMPLES}
        found.append(Finding('window_not_full', values=about))
    return found
