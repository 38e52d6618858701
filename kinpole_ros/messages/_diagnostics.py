"""How the tracking is going, in the words of diagnostic_msgs, for people who watch a rig."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from kinpole_ros.derivatives import FEWEST_SAMPLES
from kinpole_ros.messages._identities import identity_lines
from kinpole_ros.messages._markers import ns_to_stamp
from kinpole_ros.messages._space import (
    PLANE_UNKNOWN,
    shape_fault,
    space_values,
    tilt_fault,
    unit_fault,
)
from kinpole_ros.messages._stamps import jitter_fault, stamp_faults, stamp_values
from kinpole_ros.messages._types import DiagnosticArray, DiagnosticStatus, KeyValue
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.outages import Outage
from kinpole_ros.tracking.tracker import Tracker

if TYPE_CHECKING:
    from kinpole_ros.linkage.positions import LivePositions
    from kinpole_ros.linkage.theory import Theory

# Of the names of markers in a message, which may be anything.
_MOST_NAMES, _MOST_SHOWN = 12, 80
# What tells whether a node started anew: these go up, or frames begin again from none.
RECEIVED, RESTARTS = 'frames received', 'starts anew'
_WORDS = {
    'frames': RECEIVED,
    'repeated': 'frames with the stamp of the one before, left out',
    'late': 'frames that came late, after newer ones, left out',
    'lost': 'frames lost on the way, by the clock of the stamps',
    'resets': f'{RESTARTS} after a jump of the stamps',
    'frame_changes': f'{RESTARTS} with another frame_id',
    'restarts': f'{RESTARTS} with another publisher of the markers',
    'markers_not_seen': 'markers not seen, summed over frames',
    'markers_unknown': 'markers in the last new layout that no body names',
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
    'untold': 'results left out, since the node could not keep up',
    'failures': 'failures of the node itself',
}


# Markers are warned of that err so many times as much as the others of their body.
_ERRS = 3.0
# Troubles despite which figures still come.
_MILD = ('clock', 'other types', 'sources', 'rivals')


class DiagnosticsMaker:
    """
    Makes the diagnostics of a tracker; remembers the last ones to tell rates by.

    With a `theory` they also tell how far the bodies are from it. `topic` is where markers are
    awaited, and is named when none come.
    """

    def __init__(self, name: str, theory: 'Theory | None' = None, topic: str = '') -> None:
        self._name = name
        self._nothing = f'no markers received on {topic}' if topic else 'no markers received'
        self._topic = topic
        self._theory = theory
        self._positions: LivePositions | None = None
        if theory is not None:
            from kinpole_ros.linkage import positions

            self._positions = positions.LivePositions(theory.scene, theory.lies)
        self._before: Counter[str] = Counter()
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
        Diagnostics stamped `stamp` (ns), of the `seconds` since the last ones.

        `latest` holds the newest estimates since, if any, of which the last counts; `trouble` names
        what else is wrong, by topic; `stamps` are those of the frames since.
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
        """The same of the tracker as it is, to be finished with the one estimate of this time."""
        counts = tracker.counts
        since = {key: counts[key] - self._before[key] for key in counts}
        self._before = counts.copy()
        array = DiagnosticArray()
        array.header.stamp = ns_to_stamp(stamp)
        faults = _faults(tracker, since, trouble, self._nothing)
        state = tracker.stamp_state()
        regularized = state is not None and state.regularized
        faults += [
            (level, text)
            for level, text in stamp_faults(stamps, seconds, tracker.settings.window)
            # Bunches are no fault of figures that are at the ticks of a clock.
            if level == DiagnosticStatus.ERROR or not regularized
        ]
        late = '' if state is None else jitter_fault(state, tracker.settings.stamps)
        if late and since.get('frames'):
            faults.append((DiagnosticStatus.WARN, late))
        space = tracker.space()
        if since.get('frames'):
            unknown = PLANE_UNKNOWN if tracker.plane is None else ''
            if plane := unknown or tilt_fault(space, tracker.settings.plane):
                faults.append((DiagnosticStatus.WARN, plane))
        outages = self._new_outages(tracker)
        if '' in outages:
            faults.append((DiagnosticStatus.WARN, unseen('', outages[''].latest)))
        array.status = [self._input(tracker, since, seconds, faults, space_values(space))]
        noise, underestimated = tracker.noise(), tracker.noise_underestimated()
        noises = _noises(tracker)
        loose = [
            shape_fault(b, off, cause, space)
            for b, (off, cause) in enumerate(
                zip(tracker.rigidity_residual().tolist(), tracker.causes(), strict=True)
            )
        ]
        units = [unit_fault(size, tracker.settings.scale) for size in space.size.tolist()]
        erring, wrong = tracker.erring(), tracker.wrong()
        before = np.zeros_like(wrong) if self._wrong is None else self._wrong
        self._wrong = wrong
        receiving = bool(since.get('frames'))
        # With so many frames there are figures, if anybody wants them.
        idle = tracker.samples >= FEWEST_SAMPLES
        lacking = {
            body: not_there(body, names, tracker.identities)
            for body, names in tracker.absent_markers().items()
        }

        def finish(now: Estimate | None) -> DiagnosticArray:
            for b, body in enumerate(tracker.bodies):
                if receiving and body in lacking:
                    name = f'{self._name}: {body}'
                    array.status.append(_status(name, DiagnosticStatus.WARN, lacking[body], {}))
                    continue
                warnings = marker_faults(erring[body], float(noise[b]))
                if wrong[b] > before[b]:
                    warnings.append(left_out(int(wrong[b] - before[b])))
                if body in outages:
                    warnings.append(unseen(body, outages[body].latest))
                fault = '; '.join(filter(None, (units[b], loose[b])))
                known = noises[b], fault, bool(underestimated[b])
                status = self._body(b, body, now, *known, receiving, idle)
                for marker, deviation in erring[body].items():
                    key = f'noise of marker {marker[:_MOST_SHOWN]!r}, which counts for less (m)'
                    status.values.append(_pair(key, deviation))
                if wrong[b]:
                    key = 'frames in which its pose was wrong, left out'
                    status.values.append(_pair(key, int(wrong[b])))
                if warnings and status.level != DiagnosticStatus.STALE:
                    status.level = DiagnosticStatus.WARN
                    status.message = '; '.join((status.message, *warnings))
                array.status.append(status)
            if now is not None and (len(tracker.bodies) > 1 or self._theory is not None):
                array.status.append(self._linkage(now))
            for status in array.status:
                status.hardware_id = self._topic
            return array

        return finish

    def _new_outages(self, tracker: Tracker) -> dict[str, Outage]:
        """Those that ended since the last diagnostics."""
        every = tracker.outages()
        new = {name: o for name, o in every.items() if o.times > self._outages.get(name, 0)}
        self._outages = {name: outage.times for name, outage in every.items()}
        return new

    def _linkage(self, now: Estimate) -> DiagnosticStatus:
        """What the bodies say of each other: Kennedy's theorem, and the scene if one is given."""
        values: dict[str, object] = {}
        for k, (j, i) in enumerate(zip(*now.pairs, strict=True)):
            distance, deviations = (part[k] for part in now.kennedy)
            if np.isfinite(distance):
                pair = f'{now.bodies[j]} wrt {now.bodies[i]}'
                values[f'{pair}: center off the line of the pins (m)'] = float(distance)
                values[f'{pair}: the same in deviations'] = float(deviations)
        if self._theory is None:
            return _status(f'{self._name}: linkage', DiagnosticStatus.OK, 'no scene given', values)
        from kinpole_ros.linkage.theory import joint_offsets, rate_differences

        message = f'compared with the scene {self._theory.scene.name}'
        level = DiagnosticStatus.OK
        for off in (*rate_differences(self._theory, now), *joint_offsets(self._theory, now)):
            values[f'{off.subject}: {off.what} ({off.unit})'] = off.value
            values[f'{off.subject}: deviation of that ({off.unit})'] = off.deviation
        found = self._positions.add(now) if self._positions else None
        if found is None and not values:
            message = f'too little is known yet to compare the scene {self._theory.scene.name}'
        if found is not None:
            for joint in found.joints:
                values[f'joint {joint.joint}: off (m)'] = joint.rms
                values[f'joint {joint.joint}: the same in deviations'] = joint.deviations
            values['residuals of the joints over their noise, rms'] = float(np.sqrt(found.ratio))
            if found.words:
                level = DiagnosticStatus.WARN
                message = f'off the scene {self._theory.scene.name}: ' + '; '.join(found.words)
        return _status(f'{self._name}: linkage', level, message, values)

    def _input(
        self,
        tracker: Tracker,
        since: Mapping[str, int],
        seconds: float,
        faults: list[tuple[bytes, str]],
        more: Mapping[str, object],
    ) -> DiagnosticStatus:
        # The worst first, and each with its words.
        faults = sorted(faults, key=lambda fault: fault[0], reverse=True)
        level = faults[0][0] if faults else DiagnosticStatus.OK
        message = '; '.join(text for _, text in faults) or 'receiving markers'
        values: dict[str, object] = {
            'rate (Hz)': since.get('frames', 0) / seconds if seconds > 0 else 0.0,
            'frames in the window': tracker.samples,
        }
        if np.isfinite(tracker.interval):
            values['mean interval (s)'] = tracker.interval
        values.update(more)
        state = tracker.stamp_state()
        if state is not None:
            values.update(stamp_values(state))
        values.update({_WORDS[key]: tracker.counts[key] for key in _WORDS})
        return _status(f'{self._name}: markers', level, message, values)

    def _body(
        self,
        b: int,
        body: str,
        now: Estimate | None,
        noise: Mapping[str, float],
        wrong: str,
        underestimated: bool,
        receiving: bool,
        idle: bool,
    ) -> DiagnosticStatus:
        name = f'{self._name}: {body}'
        values: dict[str, object] = {k: v for k, v in noise.items() if np.isfinite(v)}
        if not receiving:
            return _status(name, DiagnosticStatus.STALE, 'no markers received', values)
        if now is None and idle:
            reason = 'ready: nobody subscribes to a result, so none is computed'
            return _status(name, DiagnosticStatus.OK, reason, values)
        if now is None:
            reason = 'nothing known: too few frames yet'
            return _status(name, DiagnosticStatus.STALE, reason, values)
        values['size (m)'] = float(now.size[b])
        if np.isfinite(now.degree[b]):
            values['time used for the angular velocity (s)'] = float(now.span[b])
            values['degree used for the angular velocity'] = float(now.degree[b])
        reasons = now.reasons(b)
        if 'all' in reasons:
            message = '; '.join(filter(None, (reasons['all'], wrong)))
            return _status(name, DiagnosticStatus.WARN, message, values)
        motion = now.motion(b)
        values['motion'] = motion
        if motion == 'pinned':
            values['pin (m)'] = f'{now.pin[b].real:.6g}, {now.pin[b].imag:.6g}'
        for quantity, reason in reasons.items():
            values[f'{quantity} undetermined'] = reason
        level, message = DiagnosticStatus.OK, 'tracking'
        if wrong:
            level, message = DiagnosticStatus.WARN, wrong
        elif underestimated:
            level, message = DiagnosticStatus.WARN, SMOOTHED
        if reasons:
            message += '; undetermined: ' + ', '.join(reasons)
        return _status(name, level, message, values)


def _noises(tracker: Tracker) -> list[dict[str, float]]:
    """What the noise of each body is, in words."""
    noise, of_angle = tracker.noise().tolist(), tracker.angle_noise()
    if of_angle is None:
        return [{'noise of a marker per axis (m)': each} for each in noise]
    return [
        {'noise of its position per axis (m)': each, 'noise of its angle (rad)': angle}
        for each, angle in zip(noise, of_angle.tolist(), strict=True)
    ]


# What is to be said of a body whose markers have more noise than can be measured.
SMOOTHED = (
    'its tracker has time-correlated noise, as after smoothing, that is more than is measured, so '
    'figures are overconfident; fix: have it send them unsmoothed, or set noise or a longer window'
)


def marker_faults(erring: Mapping[str, float], noise: float) -> list[str]:
    """What is to be said of markers that err, by name, so much (m) where others have this noise."""
    return [
        f'marker {marker[:_MOST_SHOWN]!r} errs by {deviation:.2g} m, {deviation / noise:.2g} times '
        'as much as the others, and counts for less: see to its fixing and to what reflects near '
        'it, or leave it out'
        for marker, deviation in erring.items()
        if deviation > _ERRS * noise
    ]


def left_out(frames: int) -> str:
    """What is to be said of a body that was wrong as a whole in so many frames."""
    return (
        f'left out of {frames} frames in which its pose was far off and then back: see that the '
        'tracker takes no other markers for it'
    )


def unseen(body: str, outage: tuple[int, int]) -> str:
    """What is to be said where a body, or '' for all markers, was not seen since then, so long."""
    since, lasted = outage
    what = 'it was not seen' if body else 'no frames came'
    return (
        f'{what} for {lasted / 1e9:.3g} s from {since / 1e9:.3f} s on, a window or more: see '
        + ('to the view of its markers' if body else 'to the tracker and the network')
    )


def not_there(body: str, names: Sequence[str], identities: Sequence[str]) -> str:
    """What is to be said of markers of a body that messages with these identities lack."""
    return (
        f'messages lack {_listed(names)} of {body}; the last one has {_listed(identities)}; '
        f'correct the parameter {body}.markers, or marker_identity'
    )


def _listed(names: Sequence[str]) -> str:
    shown = [repr(name)[:_MOST_SHOWN] for name in names[:_MOST_NAMES]]
    return ', '.join(shown + ['...'] * (len(names) > _MOST_NAMES)) or 'none'


def _faults(
    tracker: Tracker, since: Mapping[str, int], trouble: Mapping[str, str], nothing: str
) -> list[tuple[bytes, str]]:
    """
    Levels and words of what is wrong with the input.

    As REP-107 has them: with WARN figures still come and may suffer, with ERROR they cannot be
    relied upon. STALE is when nothing came, and `nothing` says so.
    """
    mild = {*_MILD}
    if since.get('frames'):
        mild.add('qos')
    if since.get('frames', 0) > since.get('unreadable', 0):
        mild.add('message')
    faults = [
        (DiagnosticStatus.WARN if topic in mild else DiagnosticStatus.ERROR, text)
        for topic, text in trouble.items()
    ]
    if not since.get('frames') and mild.issuperset(trouble):
        return [(DiagnosticStatus.STALE, nothing), *faults]
    if dropped := since.get('dropped'):
        text = (
            f'{dropped} messages dropped: the node or the network cannot keep up; send fewer '
            'frames, or read fewer results'
        )
        faults.append((DiagnosticStatus.WARN, text))
    if untold := since.get('untold'):
        text = f'{untold} results left out: the node cannot keep up; read fewer results'
        faults.append((DiagnosticStatus.WARN, text))
    faults += [(DiagnosticStatus.WARN, text) for text in identity_lines(tracker, since)]
    if since.get('restarts'):
        text = 'another publisher sends the markers: the window starts anew'
        faults.append((DiagnosticStatus.WARN, text))
    if since.get('frame_changes'):
        text = 'the markers have another frame_id: the window starts anew'
        faults.append((DiagnosticStatus.WARN, text))
    if late := since.get('late'):
        text = f'{late} frames came late, after newer ones, and are left out'
        faults.append((DiagnosticStatus.WARN, text))
    if resets := since.get('resets'):
        text = 'stamps jumped: the window starts anew'
        if resets >= since.get('frames', 0):
            text += (
                '; they do at every frame: if frames come so seldom, raise the parameter window, '
                f'{tracker.settings.window:g} s, to hold {FEWEST_SAMPLES} of them or more'
            )
        faults.append((DiagnosticStatus.WARN, text))
    elif since.get('repeated'):
        text = 'stamps repeat: see that the driver sets header.stamp to the time of capture'
        faults.append((DiagnosticStatus.WARN, text))
    elif since.get('frames') and tracker.samples < FEWEST_SAMPLES:
        text = (
            f'the window holds {tracker.samples} frames and needs {FEWEST_SAMPLES}; wait, or '
            'raise the parameter window'
        )
        faults.append((DiagnosticStatus.WARN, text))
    return faults


def _pair(key: str, value: object) -> KeyValue:
    return KeyValue(key=key, value=f'{value:.6g}' if isinstance(value, float) else str(value))


def _status(
    name: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticStatus:
    pairs = [_pair(key, value) for key, value in values.items()]
    return DiagnosticStatus(name=name, level=level, message=message, hardware_id='', values=pairs)
