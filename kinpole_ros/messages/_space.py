"""What is wrong with the plane, the unit or the shape of bodies in space, in words with the fix."""

import numpy as np

from kinpole_ros.tracking.deformation import TISSUE
from kinpole_ros.tracking.plane import FIT, Plane, PlaneSetting, as_parameter
from kinpole_ros.tracking.space import KEEPS, SpaceReport

# m. Bodies that are larger or smaller are likely given in another unit.
_LARGEST, _SMALLEST = 20.0, 1e-3
# m, of a body that is likely after all. Units in the order in which they are likely.
_LIKELY = (0.02, 20.0)
_UNITS = {'m': 1.0, 'mm': 1e-3, 'km': 1e3, 'µm': 1e-6}
# Of this many, in cm, a body is likely too.
_CENTIMETERS = 100.0

PLANE_UNKNOWN = (
    'the plane is not known yet: it is found when bodies have moved in two directions of it, by '
    'more than their noise; wait, or set plane: [x, y, z], its normal'
)


def plane_words(plane: Plane) -> str:
    """The plane and what its x and y are in the frame of the markers."""
    if plane.axes is not None:
        return plane.name
    first, second, normal = map(as_parameter, plane.basis)
    return f'normal {normal}, x along {first}, y along {second}'


def tilt_fault(report: SpaceReport, setting: PlaneSetting) -> str:
    """What is wrong with the plane in use; empty for nothing that shows."""
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
    Why the markers of a body, `off` one rigid body in the plane by so much (m, 0 for none), are so.

    Also where it leaves the plane; empty for nothing.
    """
    leaves = float(np.nan_to_num(report.off_plane[b]))
    if np.isnan(report.stretch[b]):
        # Too early to say whether it is the body or the plane.
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
    return not_rigid(off, cause) if off else ''


# What moves markers against each other, and what can be done about it.
_CAUSES = {
    '': 'far more than their noise: name those of one link only',
    TISSUE: (
        'slowly and far more than their noise, as on soft tissue, through a lens, or where one is '
        'loose or of another link; deviations include it; fix: fasten them, and name those of one '
        'link only'
    ),
}


def not_rigid(off: float, cause: str) -> str:
    """What is to be said of a body whose markers are so far (m) off one rigid body, by a cause."""
    return f'its markers are {off:.2g} m off one rigid body, {_CAUSES[cause]}'


def unit_fault(size: float, scale: float) -> str:
    """What is wrong with a body of this size, m, with the parameter `scale`; empty for nothing."""
    if not size or not np.isfinite(size) or _SMALLEST <= size <= _LARGEST:
        return ''
    given = size / scale
    low, high = _LIKELY
    unit = next((unit for unit, m in _UNITS.items() if low <= given * m <= high), '')
    across = f'it is {size:.3g} m across'
    if not unit:
        return f'{across}: see what unit its markers are in; fix: set scale, m per unit'
    fix = f'set scale: {_UNITS[unit]}'
    if unit == 'mm' and given < _CENTIMETERS:
        unit, fix = 'mm or cm', f'{fix}, or 0.01 for cm'
    return f'{across}: its markers are likely in {unit}; fix: {fix}'


def space_values(report: SpaceReport) -> dict[str, object]:
    """How the motion lies in space, by name."""
    values: dict[str, object] = {}
    if report.plane is not None:
        names = ('plane: x along', 'plane: y along', 'plane: normal')
        values = dict(zip(names, map(as_parameter, report.plane.basis), strict=True))
    if np.isfinite(report.tilt):
        values['tilt of the motion against the plane (deg)'] = float(np.degrees(report.tilt))
    return values
