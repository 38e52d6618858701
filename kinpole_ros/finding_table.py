"""
The table of findings: what is said of each code, and what helps.

A sentence is a format of the values of its finding. Nothing is looked up by one.
"""

from typing import NamedTuple

_CAPTURE = 'see that the driver sets header.stamp to the time of capture'
_LABELS = 'see to the labels of the tracker'
_NO_SQUARE = (
    'tag {tag} is no square of {size:.4g} mm in {share:.0%} of the pictures in which it is found: '
    'it turns out of the picture, or is bent'
)
_ONE_LINK = 'name those of one link only'


class Row(NamedTuple):
    """What is said of a code: formats of its values, and what to do, where anything helps."""

    sentence: str
    fix: str = ''


TABLE = {
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
    # The topic of the markers, and who publishes it.
    'wrong_type': Row('{topic} is published as {published}; it must be one of {readable}'),
    'wrong_type_or_tf': Row(
        '{topic} is published as {published}; it must be one of {readable}, or marker_type must be '
        'tf and <body>.markers name its frame'
    ),
    'unusable_type': Row('{type} on {topic} cannot be read: {problem}'),
    'other_types': Row(
        '{topic} is published as {others} too, and that is not read: {type} is followed',
        'set the parameter marker_type, or publish only one of them',
    ),
    'less_qos': Row(
        'a publisher of {topic} offers less QoS than this node asks for, and nothing is received '
        'from it ({problem})',
        'set the parameters qos_overrides.{topic}.subscription... to what it offers',
    ),
    'several_publishers': Row(
        'several publishers send markers on {topic} in turn ({names}), and results are of all of '
        'them mixed',
        'stop all but one',
    ),
    'unreadable_message': Row('{problem}'),
    'drawings': Row(
        'no markers are {drawings} of a MarkerArray, which are left out',
        'publish markers as spheres, cubes, cylinders, points or lists of these',
    ),
    'unseen_names': Row(
        'no pose came of {names}; {noun} that came, and no body has: {others}',
        'name the one of each body, as <body>.markers',
    ),
    'two_clocks': Row(
        '{name} has stamps at least {seconds:.6g} s behind those of {other}, which came with it: '
        'stamps of two clocks',
        'have both stamped by one clock',
    ),
    'stamped_earlier': Row(
        '{name} has stamps at least {seconds:.6g} s behind those that came before it, as of '
        '{other}: it comes too late for their frames',
        'have the driver send bodies of one frame with one stamp',
    ),
    'stamped_apart': Row(
        '{name} is on {below}, and came {count} times with another stamp: its pose in the fixed '
        'frame is not known then',
        'have both sent with one stamp',
    ),
    # The node.
    'behind': Row(
        'the node is slower than the stream: frames wait {seconds:.1f} s while it has {share:.0%} '
        'of a processor',
        'send fewer frames, read fewer results, or stop what else runs',
    ),
    'negative_time': Row(
        '/clock tells of {seconds} s, and ROS has no time before 0; that is left out',
        'see to what publishes it',
    ),
    'duplicate_results': Row(
        '{topic} and the like are published by {names} too',
        'give each node a name of its own (-r __node:=NAME), and play of a bag the markers alone; '
        'what was killed counts for some seconds more',
    ),
    'node_failed': Row('the node failed ({cause}, {place}) and {outcome}'),
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
    'repeats': Row('{repeats} of {count} {noun} repeat the one before, and are left out'),
    'repeats_converted': Row(
        '{repeats} of {count} {noun} repeat the one before, as a converter makes them from '
        '{before:.4g} to {after:.4g} Hz, and are left out'
    ),
    'repeats_rated': Row(
        '{repeats} of {count} {noun} repeat the one before, and the rate is that of the others, '
        'and are left out'
    ),
    'repeats_uneven': Row(
        '{repeats} of {count} {noun} repeat the one before in no even pattern, as of a film of '
        'uneven stamps that was made even, so it is not known when the others were taken',
        'take the film as the camera wrote it, or write each of the {noun} once, with its own time',
    ),
    'lost_converted': Row(
        'a converter from {before:.4g} to {after:.4g} Hz left out {noun}, and the others have '
        'their own times'
    ),
    'lost_uneven': Row(
        'a program that changed the rate to {after:.4g} Hz left out {noun}, in a pattern that '
        'changes, so it is not known when the others were taken',
        'take the film as the camera wrote it',
    ),
    'tag_twice': Row('{tag} (at two places at once)'),
    'tag_of_no_family': Row('{tag} (not of family {family})'),
    'tag_rare': Row('{tag} (in {count} pictures only)'),
    'tags_of_others': Row('{tags} (of family {family})'),
    'tag_no_square': Row(
        _NO_SQUARE,
        'film squarely at the plane of motion, or give --camera FILE, by which tags are placed in '
        'space',
    ),
    'tag_no_square_by_camera': Row(
        _NO_SQUARE,
        'film squarely at the plane of motion',
    ),
    'late_pictures': Row('{count} pictures left out, whose stamps do not increase'),
    'damaged_film': Row('{path} is damaged after {seconds:.4g} s: what follows is lost'),
    'resized_film': Row('{path}: the size of its pictures changes; what follows is left out'),
    # A scene.
    'scene_dimension': Row(
        'scene {scene}: {name} is {off:.4g} {unit} off (deviation {deviation:.2g} {unit}; '
        '{deviations:.0f} deviations): the scene says {stated}, the bodies move as with '
        '{right}{alternatives}'
    ),
    'scene_places': Row(
        'scene {scene}: {name} are {off:.4g} {unit} off (deviation {deviation:.2g} {unit}; '
        '{deviations:.0f} deviations), all by the same, from where the scene has them'
        '{alternatives}',
        'correct their places in the scene, or the dimensions named',
    ),
    'scene_joints': Row(
        'scene {scene}: the bodies are off the joints by {ratio:.2g} times their noise, which no '
        'dimension of the scene explains',
        'see to play in the joints, to bodies that bend, and that markers sit where the scene has '
        'them',
    ),
    'scene_early': Row('too little is known yet to compare the scene {scene}'),
    'scene_compared': Row('compared with the scene {scene}'),
    'scene_not_compared': Row(
        'the scene {scene} was compared at no instant: bodies that its joints connect were never '
        'all seen',
        'mark more of them, or see to the view of the markers',
    ),
    # Bodies and joints that were discovered.
    'no_relative_turn': Row(
        '{one} and {other} do not turn against each other: whether a pin joins them, and where, '
        'cannot be determined'
    ),
    'no_turn': Row('{body} does not turn: it has no pin to the ground that can be seen'),
    'trammel_or_pin': Row(
        '{body} moves as a trammel, and as a body with a pin whose two markers have one coordinate '
        'exchanged: neither is taken',
        'see to the columns of its markers, or give it a third one',
    ),
    'line_of_either': Row(
        '{one} on {other}: a line on either of them fits, and which it is cannot be seen from so '
        'little motion',
        'move them farther, or correct the draft',
    ),
    'nearest_joints': Row(
        'joints of each of the {count} bodies are sought with the ground and the {most} nearest '
        'bodies only'
    ),
    'not_connected': Row(
        'no joint connects {names} with the ground',
        'mark the bodies between, or move the rig further',
    ),
    'steady_rates': Row(
        'wheels turn at steady rates all the time, as gears do, and as two motors may',
        'vary the speed to tell',
    ),
    'names_exchanged': Row(
        '{one!r} and {other!r} exchange names at {seconds:.2f} s{often}: they are taken as '
        'they move',
        'correct the labels in the tracker',
    ),
    'names_doubtful': Row(
        'names of markers that pass each other seem to be exchanged; the bodies are rigid by them, '
        'so they are taken as they are'
    ),
    'unassigned': Row(
        '{share:.0%} of the points are of no body that was found: markers may be missing from some',
        'give the markers names, or take more frames a second',
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
