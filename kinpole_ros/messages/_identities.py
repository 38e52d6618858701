"""What is to be said of markers that are not what their names say, by both node and replay."""

from collections.abc import Iterator, Mapping

import numpy as np

from kinpole_ros.tracking.matcher import BY_SHAPE, OTHERS, RENAMED, UNCERTAIN
from kinpole_ros.tracking.tracker import Tracker

# Of corrections and characters of each.
_MOST_NOTES, _MOST_SHOWN = 3, 120
_DIFFER = {
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


def identity_lines(tracker: Tracker, counts: Mapping[str, int]) -> Iterator[str]:
    """Lines on what was wrong with identities: what is still so, and what was in these `counts`."""
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
    for body, how in matcher.wrong_shapes().items():
        yield _DIFFER[how].format(body)
    examples = '; '.join(_short(text) for text in list(matcher.notes)[-_MOST_NOTES:])
    examples = f' ({examples})' if examples else ''
    if others := counts.get(OTHERS):
        yield (
            f'{others} markers had the names of markers of other bodies{examples}, and are matched '
            'by shape; fix: see to the labels of the tracker'
        )
    if renamed := counts.get(RENAMED):
        yield (
            f'{renamed} markers had names that no body has{examples}, and are matched by shape; '
            'fix: see to the labels of the tracker'
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
    return text if len(text) <= _MOST_SHOWN else f'{text[:_MOST_SHOWN]}...'
