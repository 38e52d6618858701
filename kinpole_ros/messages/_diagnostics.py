"""How the tracking is going, as diagnostic_msgs, for people who watch a rig."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.messages import body_faults
from kinpole_ros.messages._types import DiagnosticArray, DiagnosticStatus, KeyValue, ns_to_stamp
from kinpole_ros.messages.faults import Fault, input_faults, stamp_faults
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.kennedy import distances_from_pins_line
from kinpole_ros.tracking.outages import Outage
from kinpole_ros.tracking.plane import as_parameter
from kinpole_ros.tracking.tracker import Tracker

# Compares an estimate with a scene: whether it is off, in words, and its figures by name.
Comparison: TypeAlias = Callable[[Estimate], tuple[bool, str, dict[str, float]]]

# Keys of the diagnostics of the input, by the names of the tracker's counts. Where RECEIVED begins
# again from 0, or RESTARTS goes up, a node was started again.
RECEIVED, RESTARTS = 'frames received', 'starts anew'
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
        self._nothing = f'no markers received on {topic}' if topic else 'no markers received'
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
        trouble: Mapping[str, str],
        stamps: Sequence[int] = (),
    ) -> DiagnosticArray:
        """
        Make diagnostics of the `seconds` since the last ones, with a stamp in ns.

        `latest` are the newest estimates of this time, of which the last is described. `trouble`
        are other faults by topic, and `stamps` those of the frames, ns.
        """
        now = None if latest is None else latest[-1]
        return self.begin(stamp, tracker, seconds, trouble, stamps)(now)

    def begin(
        self,
        stamp: int,
        tracker: Tracker,
        seconds: float,
        trouble: Mapping[str, str],
        stamps: Sequence[int] = (),
    ) -> Callable[[Estimate | None], DiagnosticArray]:
        """Return a function that completes `make` with an estimate, by the tracker as it is now."""
        counts = tracker.update_counts()
        since = {key: count - self._counts[key] for key, count in counts.items()}
        self._counts = counts.copy()
        outages = self._new_outages(tracker)
        faults = input_faults(tracker, since, trouble, self._nothing)
        faults += stamp_faults(tracker, since, stamps, seconds)
        if '' in outages:
            faults.append((DiagnosticStatus.WARN, body_faults.outage_fault('', outages[''].latest)))
        input_status = _input_status(f'{self._name}: markers', tracker, since, seconds, faults)
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
        found = zip(*now.pairs, *distances_from_pins_line(now), strict=True)
        for j, i, distance, deviations in found:
            if np.isfinite(distance):
                pair = f'{now.bodies[j]} wrt {now.bodies[i]}'
                values[f'{pair}: center off the line of the pins (m)'] = float(distance)
                values[f'{pair}: the same in deviations'] = float(deviations)
        if self._compare is None:
            return _status(name, DiagnosticStatus.OK, 'no scene given', values)
        is_off, message, figures = self._compare(now)
        level = DiagnosticStatus.WARN if is_off else DiagnosticStatus.OK
        return _status(name, level, message, values | figures)


def _bodies(
    name: str,
    tracker: Tracker,
    wrong_before: np.ndarray | None,
    outages: Mapping[str, Outage],
) -> list['_Body']:
    """Describe the bodies as the tracker has them, `wrong_before` at the last diagnostics."""
    space, absent = tracker.space(), tracker.absent_markers()
    noise, angle_noise = tracker.noise().tolist(), tracker.angle_noise()
    residuals, causes = tracker.rigidity_residual().tolist(), tracker.causes()
    erring, wrong, smoothed = tracker.erring(), tracker.wrong(), tracker.noise_underestimated()
    new_wrong = wrong if wrong_before is None else wrong - wrong_before
    bodies = []
    for b, body in enumerate(tracker.bodies):
        noises = {'noise of a marker per axis (m)': noise[b]}
        if angle_noise is not None:
            noises = {
                'noise of its position per axis (m)': noise[b],
                'noise of its angle (rad)': float(angle_noise[b]),
            }
        absence = ''
        if body in absent:
            absence = body_faults.absent_markers_fault(body, absent[body], tracker.identities)
        unit = body_faults.unit_fault(float(space.size[b]), tracker.settings.scale)
        shape = body_faults.shape_fault(b, residuals[b], causes[b], space)
        warnings = body_faults.marker_faults(erring[body], noise[b])
        if new_wrong[b] > 0:
            warnings.append(body_faults.wrong_pose_fault(int(new_wrong[b])))
        if body in outages:
            warnings.append(body_faults.outage_fault(body, outages[body].latest))
        bodies.append(
            _Body(
                number=b,
                name=f'{name}: {body}',
                absent=absence,
                noises={key: value for key, value in noises.items() if np.isfinite(value)},
                fault='; '.join(filter(None, (unit, shape))),
                is_smoothed=bool(smoothed[b]),
                erring=erring[body],
                wrong=int(wrong[b]),
                warnings=warnings,
            )
        )
    return bodies


class _Body(NamedTuple):
    """A body at the time of diagnostics: its noise in words, and its faults."""

    number: int
    name: str
    absent: str
    noises: dict[str, float]
    fault: str
    is_smoothed: bool
    erring: Mapping[str, float]
    wrong: int
    warnings: list[str]

    def status(self, now: Estimate | None, is_receiving: bool, is_idle: bool) -> DiagnosticStatus:
        """Return the status of the body, with its estimate `now`, if any."""
        if is_receiving and self.absent:
            return _status(self.name, DiagnosticStatus.WARN, self.absent, {})
        values: dict[str, object] = {**self.noises}
        if not is_receiving:
            level, message = DiagnosticStatus.STALE, 'no markers received'
        elif now is not None:
            level, message = self._describe(now, values)
        elif is_idle:
            level = DiagnosticStatus.OK
            message = 'ready: nobody subscribes to a result, so none is computed'
        else:
            level, message = DiagnosticStatus.STALE, 'nothing known: too few frames yet'
        for marker, deviation in self.erring.items():
            name = repr(marker[: body_faults.SHOWN_CHARACTERS])
            values[f'noise of marker {name}, which counts for less (m)'] = deviation
        if self.wrong:
            values['frames in which its pose was wrong, left out'] = self.wrong
        if self.warnings and level != DiagnosticStatus.STALE:
            level, message = DiagnosticStatus.WARN, '; '.join((message, *self.warnings))
        return _status(self.name, level, message, values)

    def _describe(self, now: Estimate, values: dict[str, object]) -> Fault:
        """Add the values of an estimate; return level and message."""
        b = self.number
        values['size (m)'] = float(now.size[b])
        if np.isfinite(now.degree[b]):
            values['time used for the angular velocity (s)'] = float(now.span[b])
            values['degree used for the angular velocity'] = float(now.degree[b])
        reasons = now.reasons(b)
        if 'all' in reasons:
            message = '; '.join(filter(None, (reasons['all'], self.fault)))
            return DiagnosticStatus.WARN, message
        motion = now.motion(b)
        values['motion'] = motion
        if motion == 'pinned':
            values['pin (m)'] = f'{now.pin[b].real:.6g}, {now.pin[b].imag:.6g}'
        for quantity, reason in reasons.items():
            values[f'{quantity} undetermined'] = reason
        level, message = DiagnosticStatus.OK, 'tracking'
        if self.fault or self.is_smoothed:
            level, message = DiagnosticStatus.WARN, self.fault or body_faults.SMOOTHED
        if reasons:
            message += '; undetermined: ' + ', '.join(reasons)
        return level, message


def _input_status(
    name: str,
    tracker: Tracker,
    since: Mapping[str, int],
    seconds: float,
    faults: list[Fault],
) -> DiagnosticStatus:
    """Return the status of the markers, the worst fault first."""
    faults = sorted(faults, key=lambda fault: fault[0], reverse=True)
    level = faults[0][0] if faults else DiagnosticStatus.OK
    message = '; '.join(text for _, text in faults) or 'receiving markers'
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
    return _status(name, level, message, values)


def _status(name: str, level: int, message: str, values: Mapping[str, object]) -> DiagnosticStatus:
    pairs = [
        KeyValue(key=key, value=f'{value:.6g}' if isinstance(value, float) else str(value))
        for key, value in values.items()
    ]
    return DiagnosticStatus(name=name, level=level, message=message, hardware_id='', values=pairs)
