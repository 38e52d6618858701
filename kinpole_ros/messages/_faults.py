"""
Faults of the input in words with the fix, for diagnostics and the warnings of replay.

Each function returns the text of one fault, or an empty one where there is none.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from kinpole_ros.messages._types import DiagnosticStatus
from kinpole_ros.tracking.deformation import TISSUE
from kinpole_ros.tracking.matcher import BY_SHAPE, OTHERS, RENAMED, UNCERTAIN
from kinpole_ros.tracking.plane import FIT, Plane, PlaneSetting, as_parameter
from kinpole_ros.tracking.space import KEEPS, SpaceReport
from kinpole_ros.tracking.stamps import StampState
from kinpole_ros.tracking.tracker import Tracker

# Limits of what is listed: names of markers may be of any number and length.
_LISTED_NAMES, _LISTED_NOTES = 12, 3
SHOWN_CHARACTERS, _NOTE_CHARACTERS = 80, 120
_ERRING_RATIO = 3.0  # of the noise of a marker over that of its body: more is a fault
_PLAUSIBLE_SIZES = (1e-3, 20.0)  # m, of bodies; others are likely in another unit
_LIKELY_SIZES = (0.02, 20.0)  # m, by which the unit is guessed
_UNITS = {'m': 1.0, 'mm': 1e-3, 'km': 1e3, 'µm': 1e-6}  # in the order in which they are likely
_MAX_CENTIMETERS = 100.0  # a body of fewer units may be in cm as well as in mm
_MAX_PACE = 100.0  # of stamps against arrivals: a bag played at ten times its speed is no fault
_BUNCHED_STEP = 0.25  # of the mean step: the median step of frames that come in bunches is less
_MIN_STAMPS = 5  # to judge their pace

PLANE_UNKNOWN = (
    'the plane is not known yet: it is found when bodies have moved in two directions of it, by '
    'more than their noise; wait, or set plane: [x, y, z], its normal'
)
SMOOTHED = (
    'its tracker has time-correlated noise, as after smoothing, that is more than is measured, so '
    'figures are overconfident; fix: have it send them unsmoothed, or set noise or a longer window'
)
_DEFORMATION_CAUSES = {
    '': 'far more than their noise: name those of one link only',
    TISSUE: (
        'slowly and far more than their noise, as on soft tissue, through a lens, or where one is '
        'loose or of another link; deviations include it; fix: fasten them, and name those of one '
        'link only'
    ),
}
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
_STAMP_FIX = 'see that the driver sets header.stamp to the time of capture, in s and ns'


def identity_lines(tracker: Tracker, counts: Mapping[str, int]) -> Iterator[str]:
    """Yield the faults of identities: the present ones, and those counted in `counts`."""
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
        yield _SHAPE_FAULTS[how].format(body)
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
    """Describe a plane by its name, or by its axes in the frame of the markers."""
    if plane.axes is not None:
        return plane.name
    first, second, normal = map(as_parameter, plane.basis)
    return f'normal {normal}, x along {first}, y along {second}'


def tilt_fault(report: SpaceReport, setting: PlaneSetting) -> str:
    """Return the fault of a motion that is tilted against the plane."""
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


def shape_fault(b: int, off: float, cause: str, report: SpaceReport) -> str:
    """
    Return the fault of body `b`, whose markers are `off` one rigid body in the plane, m, or 0.

    Also that of a body that leaves the plane.
    """
    leaves = float(np.nan_to_num(report.off_plane[b]))
    if np.isnan(report.stretch[b]):
        # Too early to tell the body from the plane.
        return ''
    holds = report.stretch[b] < KEEPS * off
    if off and report.is_tilted and holds:
        degrees = round(np.degrees(report.tilt))
        return (
            f'its markers are {off:.2g} m off one rigid body as the plane shows them, since the '
            f'motion is tilted against it by {degrees} degrees: set plane'
        )
    if leaves and (holds or not off):
        return (
            f'it leaves the plane by {leaves:.2g} m rms, while its markers keep their distances: '
            'figures are of its motion as the plane shows it; guide it in the plane, or leave it '
            'out'
        )
    if off and holds:
        return (
            f'its markers are {off:.2g} m off one rigid body as the plane shows them, while they '
            'keep their distances in space: set plane'
        )
    if not off:
        return ''
    return f'its markers are {off:.2g} m off one rigid body, {_DEFORMATION_CAUSES[cause]}'


def unit_fault(size: float, scale: float) -> str:
    """Return the fault of a body of an implausible size, m, with the parameter `scale`."""
    smallest, largest = _PLAUSIBLE_SIZES
    if not size or not np.isfinite(size) or smallest <= size <= largest:
        return ''
    given = size / scale
    low, high = _LIKELY_SIZES
    unit = next((unit for unit, m in _UNITS.items() if low <= given * m <= high), '')
    across = f'it is {size:.3g} m across'
    if not unit:
        return f'{across}: see what unit its markers are in; fix: set scale, m per unit'
    fix = f'set scale: {_UNITS[unit]}'
    if unit == 'mm' and given < _MAX_CENTIMETERS:
        unit, fix = 'mm or cm', f'{fix}, or 0.01 for cm'
    return f'{across}: its markers are likely in {unit}; fix: {fix}'


def marker_faults(erring: Mapping[str, float], noise: float) -> list[str]:
    """Return the faults of markers by their noise `erring`, m, where the others have `noise`."""
    return [
        f'marker {marker[:SHOWN_CHARACTERS]!r} errs by {deviation:.2g} m, {deviation / noise:.2g} '
        'times as much as the others, and counts for less: see to its fixing and to what reflects '
        'near it, or leave it out'
        for marker, deviation in erring.items()
        if deviation > _ERRING_RATIO * noise
    ]


def left_out(frames: int) -> str:
    """Return the fault of a body whose pose was wrong in so many frames."""
    return (
        f'left out of {frames} frames in which its pose was far off and then back: see that the '
        'tracker takes no other markers for it'
    )


def unseen(body: str, outage: tuple[int, int]) -> str:
    """Return the fault of an outage (start and duration, ns) of a body, or of all frames for ''."""
    since, duration = outage
    what = 'it was not seen' if body else 'no frames came'
    return (
        f'{what} for {duration / 1e9:.3g} s from {since / 1e9:.3f} s on, a window or more: see '
        + ('to the view of its markers' if body else 'to the tracker and the network')
    )


def not_there(body: str, names: Sequence[str], identities: Sequence[str]) -> str:
    """Return the fault of markers `names` of a body that are not among the `identities`."""
    return (
        f'messages lack {_listed(names)} of {body}; the last one has {_listed(identities)}; '
        f'correct the parameter {body}.markers, or marker_identity'
    )


def _listed(names: Sequence[str]) -> str:
    shown = [repr(name)[:SHOWN_CHARACTERS] for name in names[:_LISTED_NAMES]]
    return ', '.join(shown + ['...'] * (len(names) > _LISTED_NAMES)) or 'none'


def stamp_faults(stamps: Sequence[int], seconds: float, window: float) -> list[tuple[bytes, str]]:
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
    """Return the fault of stamps that are late, with `mode` the parameter `stamps`."""
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
