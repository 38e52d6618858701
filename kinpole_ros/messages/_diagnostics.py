"""How the tracking is going, as diagnostic_msgs, for people who watch a rig."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.findings import ERROR, OK, STALE, WARN, Finding, all_words, finding_of
from kinpole_ros.messages import body_faults
from kinpole_ros.messages._types import DiagnosticArray, DiagnosticStatus, KeyValue, ns_to_stamp
from kinpole_ros.messages.faults import input_findings, stamp_findings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.kennedy import distances_from_pins_line
from kinpole_ros.tracking.outages import Outage
from kinpole_ros.tracking.plane import as_parameter
from kinpole_ros.tracking.tracker import Tracker

# Compares an estimate with a scene: what was found, OK where nothing is off, and figures by name.
Comparison: TypeAlias = Callable[[Estimate], tuple[list[Finding], dict[str, float]]]

# Keys of the diagnostics of the input, by the names of the tracker's counts. Where RECEIVED begins
# again from 0, or RESTARTS goes up, a node was started again.
RECEIVED, RESTARTS = 'frames received', 'starts anew'
# Keys of findings: this and the code.
FINDING = 'finding '
COUNT_KEYS = {
    'frames': RECEIVED,
    'repeated': 'frames with the stamp of the one before, left out',
    'late': 'frames that came late, after newer ones, left out',
    'lost': 'frames lost on the way, by the clock of the stamps',
    'resets': f'{RESTARTS} after a jump of the stamps',
    'frame_changes': f'{RESTARTS} with another frame_id',
    'restarts': f'{RESTARTS} with another publisher of the markers',
    'markers_not_seen': 'markers not seen, summed over frames',
    'markers_unknown': 'markers in the last new layout that no body names',
    'markers_too_far': 'markers farther than 1e15 m, taken as not seen',
    'markers_held': 'markers that repeat their last place to the last bit, taken as not seen',
    'poses_held': 'poses that repeat the last one to the last bit, taken as not seen',
    'markers_exchanged': 'markers exchanged with one another, put back',
    'markers_left_out': 'markers left out, since they did not fit their body',
    'markers_mirrored': 'markers left out, since their body was seen mirrored',
    'markers_of_misfits': 'markers left out, since their body did not fit its shape',
    'markers_of_others': 'markers named for another body, put back',
    'markers_renamed': 'markers under names that no body has, found by shape',
    'markers_regrouped': 'markers listed for another body than the one they move with',
    'frames_by_shape': 'frames without names that were matched by shape',
    'bodies_ambiguous': 'bodies left out of a frame, since points fit them in several ways',
    'unreadable': 'messages that could not be read',
    'dropped': 'messages dropped, since the node or the network could not keep up',
    'failures': 'failures of the node itself',
}


class DiagnosticsMaker:
    """
    Makes the diagnostics of a tracker, with rates and counts since the last ones.

    With `compare` they also say how far the bodies are from a scene. `topic` is that of the
    markers.
    """

    def __init__(self, name: str, compare: Comparison | None = None, topic: str = '') -> None:
        self._name = name
        self._topic = topic
        self._compare = compare
        # At the last diagnostics: counts, outages by body, and frames with a wrong pose (B,).
        self._counts: Counter[str] = Counter()
        self._outages: dict[str, int] = {}
        self._wrong: np.ndarray | None = None

    def make(
        self,
        stamp: int,
        tracker: Tracker,
        latest: Estimate | None,
        seconds: float,
        trouble: Iterable[Finding],
        stamps: Sequence[int] = (),
    ) -> DiagnosticArray:
        """
        Make diagnostics of the `seconds` since the last ones, with a stamp in ns.

        `latest` are the newest estimates of this time, of which the last is described. `trouble`
        is what was found before the tracker, and `stamps` are those of the frames, ns.
        """
        now = None if latest is None else latest[-1]
        return self.begin(stamp, tracker, seconds, trouble, stamps)(now)

    def begin(
        self,
        stamp: int,
        tracker: Tracker,
        seconds: float,
        trouble: Iterable[Finding],
        stamps: Sequence[int] = (),
    ) -> Callable[[Estimate | None], DiagnosticArray]:
        """Return a function that completes `make` with an estimate, by the tracker as it is now."""
        counts = tracker.update_counts()
        since = {key: count - self._counts[key] for key, count in counts.items()}
        self._counts = counts.copy()
        outages = self._new_outages(tracker)
        found = input_findings(tracker, since, trouble, self._topic)
        found += stamp_findings(tracker, since, stamps, seconds)
        if '' in outages:
            found.append(body_faults.outage_finding('', outages[''].latest))
        input_status = _input_status(f'{self._name}: markers', tracker, since, seconds, found)
        bodies = _bodies(self._name, tracker, self._wrong, outages)
        self._wrong = tracker.wrong()
        is_receiving = bool(since.get('frames'))
        # With so many frames there are estimates, if a topic has a subscriber.
        is_idle = tracker.samples >= FEWEST_SAMPLES

        def complete(now: Estimate | None) -> DiagnosticArray:
            array = DiagnosticArray()
            array.header.stamp = ns_to_stamp(stamp)
            statuses = [body.status(now, is_receiving, is_idle) for body in bodies]
            array.status = [input_status, *statuses]
            if now is not None and (len(bodies) > 1 or self._compare is not None):
                array.status.append(self._linkage(now))
            for status in array.status:
                status.hardware_id = self._topic
            return array

        return complete

    def _new_outages(self, tracker: Tracker) -> dict[str, Outage]:
        """Return the outages that ended since the last diagnostics."""
        outages = tracker.outages()
        new = {name: o for name, o in outages.items() if o.times > self._outages.get(name, 0)}
        self._outages = {name: outage.times for name, outage in outages.items()}
        return new

    def _linkage(self, now: Estimate) -> DiagnosticStatus:
        """Compare the bodies with Kennedy's theorem, and with the scene."""
        name = f'{self._name}: linkage'
        values: dict[str, object] = {}
        rows = zip(*now.pairs, *distances_from_pins_line(now), strict=True)
        for j, i, distance, deviations in rows:
            if np.isfinite(distance):
                pair = f'{now.bodies[j]} wrt {now.bodies[i]}'
                values[f'{pair}: center off the line of the pins (m)'] = float(distance)
                values[f'{pair}: the same in deviations'] = float(deviations)
        if self._compare is None:
            return _status(name, OK, 'no scene given', values)
        found, figures = self._compare(now)
        level = max(one.level for one in found)
        return _status(name, level, all_words(found), values | figures, found if level else ())


def _bodies(
    name: str,
    tracker: Tracker,
    wrong_before: np.ndarray | None,
    outages: Mapping[str, Outage],
) -> list['_Body']:
    """Describe the bodies as the tracker has them, `wrong_before` at the last diagnostics."""
    absent, erring, wrong = tracker.absent_markers(), tracker.erring(), tracker.wrong()
    noise, angle_noise = tracker.noise().tolist(), tracker.angle_noise()
    new_wrong = wrong if wrong_before is None else wrong - wrong_before
    bodies = []
    for b, (found, warnings) in enumerate(body_faults.body_findings(tracker, tracker.space())):
        body = tracker.bodies[b]
        noises = {'noise of a marker per axis (m)': noise[b]}
        if angle_noise is not None:
            noises = {
                'noise of its position per axis (m)': noise[b],
                'noise of its angle (rad)': float(angle_noise[b]),
            }
        values: dict[str, object] = {key: one for key, one in noises.items() if np.isfinite(one)}
        for marker, deviation in erring[body].items():
            shown = repr(marker[: body_faults.SHOWN_CHARACTERS])
            values[f'noise of marker {shown}, which counts for less (m)'] = deviation
        if wrong[b]:
            values['frames in which its pose was wrong, left out'] = int(wrong[b])
        if new_wrong[b] > 0:
            warnings.append(Finding('wrong_poses', body, {'count': int(new_wrong[b])}))
        if body in outages:
            warnings.append(body_faults.outage_finding(body, outages[body].latest))
        absence = None
        if body in absent:
            absence = body_faults.absence_finding(body, absent[body], tracker.identities)
        bodies.append(_Body(b, f'{name}: {body}', absence, values, found, warnings))
    return bodies


class _Body(NamedTuple):
    """A body at the time of diagnostics: what the tracker knows of it, and what was found."""

    number: int
    name: str
    absent: Finding | None
    values: dict[str, object]
    found: list[Finding]
    warnings: list[Finding]

    def status(self, now: Estimate | None, is_receiving: bool, is_idle: bool) -> DiagnosticStatus:
        """Return the status of the body, with its estimate `now`, if any."""
        if is_receiving and self.absent:
            return _status(self.name, WARN, self.absent.words(), {}, [self.absent])
        values = {**self.values}
        found: list[Finding] = []
        if not is_receiving:
            level, message = STALE, Finding('nothing').words()
        elif now is not None:
            message, found = self._describe(now, values)
            level = WARN if found else OK
        elif is_idle:
            level = OK
            message = 'ready: nobody subscribes to a result, so none is computed'
        else:
            level, message = STALE, 'nothing known: too few frames yet'
        if self.warnings and level != STALE:
            level, message = WARN, f'{message}; {all_words(self.warnings)}'
            found = [*found, *self.warnings]
        return _status(self.name, level, message, values, found)

    def _describe(self, now: Estimate, values: dict[str, object]) -> tuple[str, list[Finding]]:
        """Add the values of an estimate; return its message and what was found."""
        b = self.number
        values['size (m)'] = float(now.size[b])
        if np.isfinite(now.degree[b]):
            values['time used for the angular velocity (s)'] = float(now.span[b])
            values['degree used for the angular velocity'] = float(now.degree[b])
        reasons = now.reasons(b)
        if 'all' in reasons:
            shapes = [one for one in self.found if one.code != 'smoothed']
            missing = Finding('missing', now.bodies[b], {'reason': reasons['all']})
            return all_words([missing, *shapes]), [missing, *shapes]
        motion = now.motion(b)
        values['motion'] = motion
        if motion == 'pinned':
            values['pin (m)'] = f'{now.pin[b].real:.6g}, {now.pin[b].imag:.6g}'
        for quantity, reason in reasons.items():
            values[f'{quantity} undetermined'] = reason
        message = all_words(self.found) or 'tracking'
        if reasons:
            message += '; undetermined: ' + ', '.join(reasons)
        return message, self.found


def _input_status(
    name: str,
    tracker: Tracker,
    since: Mapping[str, int],
    seconds: float,
    found: list[Finding],
) -> DiagnosticStatus:
    """Return the status of the markers, the worst first."""
    found = sorted(found, key=lambda finding: finding.level, reverse=True)
    level = found[0].level if found else OK
    message = all_words(found) or 'receiving markers'
    values: dict[str, object] = {
        'rate (Hz)': since.get('frames', 0) / seconds if seconds > 0 else 0.0,
        'frames in the window': tracker.samples,
    }
    if np.isfinite(tracker.interval):
        values['mean interval (s)'] = tracker.interval
    space = tracker.space()
    if space.plane is not None:
        names = ('plane: x along', 'plane: y along', 'plane: normal')
        values |= zip(names, map(as_parameter, space.plane.basis), strict=True)
    if np.isfinite(space.tilt):
        values['tilt of the motion against the plane (deg)'] = float(np.degrees(space.tilt))
    state = tracker.stamp_state()
    if state is not None:
        values |= {
            'interval of the clock of the stamps (s)': state.interval,
            'jitter of the stamps, rms (s)': state.jitter,
            'jitter of the stamps, largest (s)': state.largest,
            'frames taken to be at': (
                'ticks of that clock' if state.regularized else 'their stamps'
            ),
        }
    counts = tracker.update_counts()
    values |= {key: counts[name] for name, key in COUNT_KEYS.items()}
    return _status(name, level, message, values, found)


def _status(
    name: str,
    level: int,
    message: str,
    values: Mapping[str, object],
    found: Sequence[Finding] = (),
) -> DiagnosticStatus:
    """Return a status; for programs, each finding is a value whose key begins with FINDING."""
    pairs = [
        KeyValue(key=key, value=f'{value:.6g}' if isinstance(value, float) else str(value))
        for key, value in values.items()
    ]
    pairs += [KeyValue(key=f'{FINDING}{one.code}', value=one.as_json()) for one in found]
    return DiagnosticStatus(name=name, level=level, message=message, hardware_id='', values=pairs)


def warnings_in(statuses: Iterable[DiagnosticStatus]) -> Iterator[str]:
    """Yield the warnings among findings of statuses, a line each."""
    for pair in chain.from_iterable(status.values for status in statuses):
        if pair.key.startswith(FINDING):
            finding = finding_of(pair.value)
            if finding.level in (WARN, ERROR):
                yield f'{finding.subject or "markers"}: {finding.words()}'
