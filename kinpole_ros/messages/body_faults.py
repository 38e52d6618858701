"""Findings about bodies and their markers."""

from collections.abc import Mapping, Sequence

import numpy as np

from kinpole_ros.findings import Finding
from kinpole_ros.tracking.deformation import TISSUE
from kinpole_ros.tracking.space import MAX_STRETCH_SHARE, SpaceReport
from kinpole_ros.tracking.tracker import Tracker

# Limits of what is listed: names of markers may be of any number and length.
_LISTED_NAMES, SHOWN_CHARACTERS = 12, 80
_ERRING_RATIO = 3.0  # of the noise of a marker over that of its body: more is a fault
_PLAUSIBLE_SIZES = (1e-3, 20.0)  # m, of bodies; others are likely in another unit
_LIKELY_SIZES = (0.02, 20.0)  # m, by which the unit is guessed
_UNITS = {'m': 1.0, 'mm': 1e-3, 'km': 1e3, 'µm': 1e-6}  # in the order in which they are likely
_MAX_CENTIMETERS = 100.0  # a body of fewer units may be in cm as well as in mm


def body_findings(
    tracker: Tracker, space: SpaceReport
) -> list[tuple[list[Finding], list[Finding]]]:
    """
    Return of each body what is wrong with its shape or its noise, and its noisy markers.

    `space` is how the motion lies in space.
    """
    noise, erring = tracker.noise().tolist(), tracker.erring()
    residuals, causes = tracker.rigidity_residual().tolist(), tracker.causes()
    found = []
    for b, body in enumerate(tracker.bodies):
        own = unit_findings(body, float(space.size[b]), tracker.settings.scale)
        own += shape_findings(body, b, residuals[b], causes[b], space)
        if tracker.noise_underestimated()[b] and not own:
            own.append(Finding('smoothed', body))
        found.append((own, marker_findings(body, erring[body], noise[b])))
    return found


def shape_findings(body: str, b: int, off: float, cause: str, report: SpaceReport) -> list[Finding]:
    """
    Return whether a body is not rigid, or leaves the plane.

    `b` is its number, `off` how far its markers are off one rigid body in the plane, m, 0 if they
    are not, and `cause` that of the deformation, where it is known.
    """
    leaves = float(np.nan_to_num(report.off_plane[b]))
    if np.isnan(report.stretch[b]):
        # Too early to tell the body from the plane.
        return []
    holds = report.stretch[b] < MAX_STRETCH_SHARE * off
    if off and report.is_tilted and holds:
        about = {'off': off, 'degrees': round(np.degrees(report.tilt))}
        return [Finding('tilted_body', body, about)]
    if leaves and (holds or not off):
        return [Finding('leaves_plane', body, {'off': leaves})]
    if not off:
        return []
    code = 'off_plane' if holds else 'tissue' if cause == TISSUE else 'not_rigid'
    return [Finding(code, body, {'off': off})]


def unit_findings(body: str, size: float, scale: float) -> list[Finding]:
    """Return whether the `size` of a body, m, is implausible; `scale` is in m per unit."""
    smallest, largest = _PLAUSIBLE_SIZES
    if not size or not np.isfinite(size) or smallest <= size <= largest:
        return []
    given = size / scale
    low, high = _LIKELY_SIZES
    unit = next((unit for unit, m in _UNITS.items() if low <= given * m <= high), '')
    if not unit:
        return [Finding('size', body, {'size': size})]
    scales = str(_UNITS[unit])
    if unit == 'mm' and given < _MAX_CENTIMETERS:
        unit, scales = 'mm or cm', f'{scales}, or 0.01 for cm'
    return [Finding('unit', body, {'size': size, 'unit': unit, 'scales': scales})]


def marker_findings(body: str, erring: Mapping[str, float], noise: float) -> list[Finding]:
    """
    Return the noisy markers of a body.

    `erring` is the noise by marker, m, `noise` that of the other markers.
    """
    return [
        Finding(
            'noisy_marker',
            body,
            {
                'marker': repr(marker[:SHOWN_CHARACTERS]),
                'deviation': deviation,
                'times': deviation / noise,
            },
        )
        for marker, deviation in erring.items()
        if deviation > _ERRING_RATIO * noise
    ]


def outage_finding(body: str, outage: tuple[int, int], times: int = 1) -> Finding:
    """
    Return an outage of a body, or of all frames: its start and duration, ns.

    It is the longest of so many `times`.
    """
    since, duration = outage
    about = {'since': since / 1e9, 'seconds': duration / 1e9, 'times': times}
    code = 'not_seen' if body else 'no_frames'
    return Finding(f'often_{code}' if times > 1 else code, body, about)


def absence_finding(body: str, names: Sequence[str], identities: Sequence[str]) -> Finding:
    """
    Return that messages do not have markers of a body.

    `identities` are the markers of the last message.
    """
    about = {'body': body, 'absent': _listed(names), 'present': _listed(identities)}
    return Finding('absent_markers', values=about)


def _listed(names: Sequence[str]) -> str:
    shown = [repr(name)[:SHOWN_CHARACTERS] for name in names[:_LISTED_NAMES]]
    return ', '.join(shown + ['...'] * (len(names) > _LISTED_NAMES)) or 'none'
