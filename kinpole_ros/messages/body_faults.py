"""Faults of bodies and their markers in words with the fix; an empty text is no fault."""

from collections.abc import Mapping, Sequence

import numpy as np

from kinpole_ros.tracking.deformation import TISSUE
from kinpole_ros.tracking.space import MAX_STRETCH_SHARE, SpaceReport

# Limits of what is listed: names of markers may be of any number and length.
_LISTED_NAMES, SHOWN_CHARACTERS = 12, 80
_ERRING_RATIO = 3.0  # of the noise of a marker over that of its body: more is a fault
_PLAUSIBLE_SIZES = (1e-3, 20.0)  # m, of bodies; others are likely in another unit
_LIKELY_SIZES = (0.02, 20.0)  # m, by which the unit is guessed
_UNITS = {'m': 1.0, 'mm': 1e-3, 'km': 1e3, 'µm': 1e-6}  # in the order in which they are likely
_MAX_CENTIMETERS = 100.0  # a body of fewer units may be in cm as well as in mm

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


def shape_fault(b: int, off: float, cause: str, report: SpaceReport) -> str:
    """
    Return the fault of a body that is not rigid, or leaves the plane; '' where there is none.

    `b` is its number, `off` how far its markers are off one rigid body in the plane, m, 0 if they
    are not, and `cause` that of the deformation, where it is known.
    """
    leaves = float(np.nan_to_num(report.off_plane[b]))
    if np.isnan(report.stretch[b]):
        # Too early to tell the body from the plane.
        return ''
    holds = report.stretch[b] < MAX_STRETCH_SHARE * off
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
    """Return the fault of a body of an implausible `size`, m, or ''; `scale` is in m per unit."""
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
    """
    Return the faults of noisy markers of a body.

    `erring` is the noise by marker, m, `noise` that of the other markers.
    """
    return [
        f'marker {marker[:SHOWN_CHARACTERS]!r} errs by {deviation:.2g} m, {deviation / noise:.2g} '
        'times as much as the others, and counts for less: see to its fixing and to what reflects '
        'near it, or leave it out'
        for marker, deviation in erring.items()
        if deviation > _ERRING_RATIO * noise
    ]


def wrong_pose_fault(frames: int) -> str:
    """Return the fault of a body whose pose was wrong in so many frames."""
    return (
        f'left out of {frames} frames in which its pose was far off and then back: see that the '
        'tracker takes no other markers for it'
    )


def outage_fault(body: str, outage: tuple[int, int]) -> str:
    """Return the fault of an outage of a body, or of all frames: its start and duration, ns."""
    since, duration = outage
    what = 'it was not seen' if body else 'no frames came'
    return (
        f'{what} for {duration / 1e9:.3g} s from {since / 1e9:.3f} s on, a window or more: see '
        + ('to the view of its markers' if body else 'to the tracker and the network')
    )


def absent_markers_fault(body: str, names: Sequence[str], identities: Sequence[str]) -> str:
    """
    Return the fault of markers of a body that messages do not have.

    `identities` are the markers of the last message.
    """
    return (
        f'messages lack {_listed(names)} of {body}; the last one has {_listed(identities)}; '
        f'correct the parameter {body}.markers, or marker_identity'
    )


def _listed(names: Sequence[str]) -> str:
    shown = [repr(name)[:SHOWN_CHARACTERS] for name in names[:_LISTED_NAMES]]
    return ', '.join(shown + ['...'] * (len(names) > _LISTED_NAMES)) or 'none'
