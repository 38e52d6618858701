"""
Findings: what is wrong with an input, as values; and the sentence and fix of each for people.

Programs compare codes and read values. Only `words` makes a sentence, and nothing is looked up by
it.
"""

import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

# Levels of diagnostic_msgs: with WARN results still come and may suffer, with ERROR they cannot be
# relied upon; STALE is when nothing comes.
OK, WARN, ERROR, STALE = range(4)
_CAPTURE = 'see that the driver sets header.stamp to the time of capture'
_LABELS = 'see to the labels of the tracker'
_ONE_LINK = 'name those of one link only'


class Row(NamedTuple):
    """What is said of a code: formats of its values, and what to do, where anything helps."""

    sentence: str
    fix: str = ''


TABLE = {
    # What is said where it was found, of a message, a topic, a file or a program.
    'source': Row('{text}'),
    # The input.
    'nothing': Row('no markers received'),
    'nothing_on_topic': Row('no markers received on {topic}'),
    'no_frames': Row(
        'no frames came for {seconds:.3g} s from {since:.3f} s on, a window or more',
        'see to the tracker and the network',
    ),
    'often_no_frames': Row(
        'no frames came {times} times for a window or more, at the longest for {seconds:.3g} s '
        'from {since:.3f} s on',
        'see to the tracker and the network',
    ),
    'dropped': Row(
        '{count} messages dropped, since the node or the network cannot keep up',
        'send fewer frames, or read fewer results',
    ),
    'publisher_changed': Row('another publisher sends the markers: the window starts anew'),
    'frame_changed': Row('the markers have another frame_id: the window starts anew'),
    'late': Row('{count} frames came late, after newer ones, and are left out'),
    'window_not_full': Row(
        'the window holds {samples} frames and needs {needed}',
        'wait, or raise the parameter window',
    ),
    # Stamps.
    'stamps_jumped': Row('stamps jumped: the window starts anew'),
    'stamps_jump_always': Row(
        'stamps jumped at every frame: the window starts anew each time',
        'if frames come so seldom, raise the parameter window, {window:g} s, to hold {needed} of '
        'them or more',
    ),
    'stamps_repeat': Row('stamps repeat', _CAPTURE),
    'stamps_stand_still': Row(
        'the stamps stand still at {stamp:.9g} s', f'{_CAPTURE}, in s and ns'
    ),
    'stamps_pace': Row(
        'the stamps advance {pace:.2g} times as fast as the messages come',
        f'{_CAPTURE}, in s and ns',
    ),
    'stamps_bunched': Row(
        'the stamps come in bunches, mostly in steps of {median:.2g} s where the mean is '
        '{mean:.2g} s',
        f'{_CAPTURE}, in s and ns',
    ),
    'stamps_late': Row(
        'the stamps are late by {jitter:.2g} s rms, up to {largest:.2g} s, more than the '
        '{interval:.2g} s between frames: nobody can tell by them which frames were lost, and '
        'figures may be off by more than their deviations',
        'let the driver stamp the time of capture',
    ),
    'stamps_jitter': Row(
        'the stamps jitter by {jitter:.2g} s rms, up to {largest:.2g} s, which moves the markers '
        'by more than their noise',
        'set stamps: arrival if the camera has an even clock, or let the driver stamp the time of '
        'capture',
    ),
    'stamps_jitter_at_capture': Row(
        'the stamps jitter by {jitter:.2g} s rms, up to {largest:.2g} s, which moves the markers '
        'by more than their noise',
        'set stamps: arrival, or auto, if the camera has an even clock, or let the driver stamp '
        'the time of capture',
    ),
    # The plane.
    'plane_unknown': Row(
        'the plane is not known yet: it is found when bodies have moved in two directions of it, '
        'by more than their noise',
        'wait, or set plane: [x, y, z], its normal',
    ),
    'tilted_from_fit': Row(
        'the motion is tilted by {about}{degrees} degrees against the plane that was fitted: the '
        'markers or the cameras were moved',
        'start anew, or set plane: {normal}',
    ),
    'tilted': Row(
        'the motion is tilted by {about}{degrees} degrees against the plane {plane}',
        'set plane: fit, or plane: {normal}',
    ),
    'line_tilted': Row(
        'the motion is tilted by {about}{degrees} degrees against the plane {plane}',
        'set plane: {normal}',
    ),
    # Names of markers.
    'unordered': Row(
        'the points come in random order from the first frame, and {names} have no shape, so '
        'nothing is published of them',
        'give <body>.shape for each; kinpole discover finds it',
    ),
    'unclear_names': Row(
        'nothing is published of {names}, since markers named for one are on another of them, and '
        'it is not clear which',
        'correct <body>.markers of {names}',
    ),
    'regrouped': Row(
        '{marker} is listed for {named} but moves with {own}, and is taken for one of its markers',
        'correct {named}.markers and {own}.markers',
    ),
    'mirrored': Row(
        'the markers of {body} are the mirror image of {body}.shape',
        'change the sign of each y in it, or look at the plane from the other side',
    ),
    'other_shape': Row(
        'the markers of {body} do not have the shape {body}.shape',
        'correct it, as kinpole discover finds it',
    ),
    'shape_nowhere': Row(
        'no points have the shape {body}.shape',
        'correct it, as kinpole discover finds it, or see that its markers are seen',
    ),
    'misnamed': Row(
        '{count} markers had the names of markers of other bodies{examples}, and are matched by '
        'shape',
        _LABELS,
    ),
    'renamed': Row(
        '{count} markers had names that no body has{examples}, and are matched by shape', _LABELS
    ),
    'poses_held': Row(
        '{count} poses repeated the one before to the last bit, which measured ones never do, and '
        'are taken as not seen',
        'let the tracker send nothing of a body that it lost',
    ),
    'matched_by_shape': Row(
        '{count} frames did not have {points} points, and their points, which have no names, are '
        'matched by shape',
        'see that none are missing or added, or set marker_identity to shape',
    ),
    'ambiguous': Row(
        '{count} times a body was left out of a frame, since points fit its shape in several ways',
        'place its markers so that no other body, and no turn of it, looks the same',
    ),
    'absent_markers': Row(
        'messages lack {absent} of {body}; the last one has {present}',
        'correct the parameter {body}.markers, or marker_identity',
    ),
    'all_one_body': Row(
        'all {count} markers are taken as one rigid body, "{body}", since no parameters name '
        'bodies',
        'to track several: kinpole discover {bag} --output rig.yaml, then the same command with '
        '--config rig.yaml',
    ),
    # Bodies.
    'missing': Row('{reason}'),
    'never_estimated': Row('{body} was never estimated: {reason}'),
    'size': Row(
        'it is {size:.3g} m across', 'see what unit its markers are in; set scale, m per unit'
    ),
    'unit': Row(
        'it is {size:.3g} m across: its markers are likely in {unit}', 'set scale: {scales}'
    ),
    'tilted_body': Row(
        'its markers are {off:.2g} m off one rigid body as the plane shows them, since the motion '
        'is tilted against it by {degrees} degrees',
        'set plane',
    ),
    'leaves_plane': Row(
        'it leaves the plane by {off:.2g} m rms, while its markers keep their distances: figures '
        'are of its motion as the plane shows it',
        'guide it in the plane, or leave it out',
    ),
    'off_plane': Row(
        'its markers are {off:.2g} m off one rigid body as the plane shows them, while they keep '
        'their distances in space',
        'set plane',
    ),
    'not_rigid': Row(
        'its markers are {off:.2g} m off one rigid body, far more than their noise', _ONE_LINK
    ),
    'tissue': Row(
        'its markers are {off:.2g} m off one rigid body, slowly and far more than their noise, as '
        'on soft tissue, through a lens, or where one is loose or of another link; deviations '
        'include it',
        f'fasten them, and {_ONE_LINK}',
    ),
    'smoothed': Row(
        'its tracker has time-correlated noise, as after smoothing, that is more than is measured, '
        'so figures are overconfident',
        'have it send them unsmoothed, or set noise or a longer window',
    ),
    'noisy_marker': Row(
        'marker {marker} errs by {deviation:.2g} m, {times:.2g} times as much as the others, and '
        'counts for less',
        'see to its fixing and to what reflects near it, or leave it out',
    ),
    'often_not_seen': Row(
        'it was not seen {times} times for a window or more, at the longest for {seconds:.3g} s '
        'from {since:.3f} s on',
        'see to the view of its markers',
    ),
    'wrong_poses': Row(
        'left out of {count} frames in which its pose was far off and then back',
        'see that the tracker takes no other markers for it',
    ),
    'not_seen': Row(
        'it was not seen for {seconds:.3g} s from {since:.3f} s on, a window or more',
        'see to the view of its markers',
    ),
    # Recordings.
    'unreadable': Row('{count} messages left out, the first: {problem}'),
    'repeated': Row(
        '{count} of {frames} messages have the stamp of the one before, and are left out', _CAPTURE
    ),
    'concatenated': Row(
        '{first} to {last}, {count} files, were read as one recording, since the folder has no '
        'metadata.yaml to tell, but the stamps do not run on',
        'if they are several, give each file by itself',
    ),
    'unpaired': Row(
        'relative rates and centers of pairs are left out: there are {count} bodies, and pairs are '
        'measured of up to {most}',
        'for these, name fewer bodies',
    ),
    'scene': Row('scene {scene}: {text}'),
    'scene_not_compared': Row(
        'the scene {scene} was compared at no instant: bodies that its joints connect were never '
        'all seen',
        'mark more of them, or see to the view of the markers',
    ),
    # Why there are no results.
    'no_messages': Row(
        'no results, since the topic has no messages', 'record again, or name another --topic'
    ),
    'no_time': Row('no results, since all stamps are the same', _CAPTURE),
    'backward': Row('no results, since the stamps run backward', _CAPTURE),
    'all_jumps': Row(
        'no results, since the stamps jump by more than the parameter window, {window:g} s',
        'raise it, or see to the stamps',
    ),
    'within_lag': Row(
        'no results, since a frame has one when it is {lag:g} s old (the parameter lag), and there '
        'are {seconds:.3g} s',
        'record longer, or see to the stamps',
    ),
    'few_frames': Row(
        'no results, since they take {needed} frames, and there are {count}',
        'record longer, or see to the stamps',
    ),
    'short_window': Row(
        'no results, since the parameter window, {window:g} s, must hold {needed} frames, and they '
        'come every {interval:.3g} s',
        'raise it, or see to the stamps',
    ),
}
"""What is said of each code."""


class Finding(NamedTuple):
    """
    Something that is wrong, or that results suffer from.

    Attributes
    ----------
    code : str
        A key of `TABLE`.
    subject : str
        The body it is about, '' for the input.
    values : mapping
        Numbers and names of its sentence, as JSON holds them.
    level : int
        WARN, ERROR or STALE.
    fix : str
        What helps where the table does not know it, as of a reason.

    """

    code: str
    subject: str = ''
    values: Mapping[str, Any] = {}
    level: int = WARN
    fix: str = ''

    def sentence(self) -> str:
        """Return what is wrong, without the subject."""
        return TABLE[self.code].sentence.format(**{'body': self.subject, **self.values})

    def words(self) -> str:
        """Return its sentence and its fix, without the subject."""
        values = {'body': self.subject, **self.values}
        fix = self.fix or TABLE[self.code].fix.format(**values)
        return self.sentence() + (f'; fix: {fix}' if fix else '')

    def line(self) -> str:
        """Return its words after its subject, for a list of several subjects."""
        return f'{self.subject}: {self.words()}' if self.subject else self.words()

    def as_json(self) -> str:
        """Return its subject, values, level and fix as JSON, for a program."""
        return json.dumps(self._asdict(), allow_nan=False, default=float)


def finding_of(text: str) -> Finding:
    """
    Return the finding of the JSON that `as_json` returned.

    Raises
    ------
    ValueError
        For other text, and for a code that this version does not know.

    """
    try:
        finding = Finding(**json.loads(text))
        finding.words()
    except (KeyError, TypeError, AttributeError, IndexError):
        raise ValueError(f'no finding of this version: {text[:80]}') from None
    return finding


def all_words(findings: Iterable[Finding]) -> str:
    """Return the words of findings of one subject, in one line."""
    return '; '.join(finding.words() for finding in findings)
