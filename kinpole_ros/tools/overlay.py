"""What is drawn over a film at an instant: outlines, poles with ellipses, centrodes, arrows."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinpole_ros.bags import BagError
from kinpole_ros.settings import load_settings
from kinpole_ros.tools.record.lost import usual_interval
from kinpole_ros.tools.record.record import MotionRecord
from kinpole_ros.tracking.values import ellipse_axes

if TYPE_CHECKING:
    from kinpole_ros.film import Filmed, Shape

# The colors of Okabe and Ito, as in the page of a report, but lighter, since films are dark.
_COLORS = ((86, 180, 233), (230, 159, 0), (0, 200, 140), (230, 130, 190), (240, 228, 66))
_ARROW = 0.12  # of the extent of the motion, the length of the longest arrow
_UNCERTAIN = 0.02  # of the extent: where an ICR is less certain, the centrode has a gap
_CIRCLE = np.exp(2j * np.pi * np.arange(41) / 40)


def draw_over(
    video: str, filmed: 'Filmed', bag: str, output: str, progress: Callable[[float], None] | None
) -> list[str]:
    """
    Write a video with the bodies that its bag shows drawn over it; return the assumptions.

    `filmed` is what was found in the video. Raises BagError if no body is found.
    """
    from kinpole_ros.film import write_overlay
    from kinpole_ros.tools.report import found_rig, replayed

    with tempfile.TemporaryDirectory(prefix='kinpole_') as folder:
        rig, lines, _ = found_rig(video, bag, None, Path(folder) / 'rig.yaml', None)
        if rig is None:
            raise BagError(f'{video}: {lines[0]}')
        settings = load_settings(rig)
        record, _ = replayed(bag, settings, None, None, None, video)
    # The names of markers begin with those of their tags: tag3_1/8.
    high = {f'tag{tag}': height for tag, height in filmed.heights.items()}
    heights = {
        body: float(np.mean([high.get(name.partition('_')[0], 0.0) for name in markers]))
        for body, markers in settings.bodies.items()
    }
    write_overlay(filmed, shapes_of(record, heights), output, progress)
    return lines


def shapes_of(record: MotionRecord, heights: dict[str, float]) -> 'Callable[[int], list[Shape]]':
    """
    Return a function that returns the shapes at a stamp, ns: none where nothing is known.

    `heights` are those of bodies above the plane, m.
    """
    places = np.concatenate([record.columns[body, 'position'] for body in record.bodies])
    places = places[np.isfinite(places)]
    extent = float(np.hypot(np.ptp(places.real), np.ptp(places.imag))) if len(places) else 1.0
    extent = max([extent, *filter(np.isfinite, record.sizes.values())])
    fastest = max(
        float(np.nanmax(np.abs(record.columns[body, 'velocity']), initial=0.0))
        for body in record.bodies
    )
    fixed = {body: _centrode(record, body, extent) for body in record.bodies}
    reach = usual_interval(record.stamp) / 2

    def shapes_at(stamp: int) -> 'list[Shape]':
        after = int(record.stamp.searchsorted(stamp).clip(1, max(1, len(record.stamp) - 1)))
        k = min((after - 1, after), key=lambda row: abs(int(record.stamp[row]) - stamp))
        if abs(int(record.stamp[k]) - stamp) > reach:
            return []
        shapes = []
        for b, body in enumerate(record.bodies):
            color = _COLORS[b % len(_COLORS)]
            own = _body(record, body, k, color, _ARROW * extent / (fastest or 1.0))
            own += _pole(record, body, k, color, fixed[body])
            shapes += [shape._replace(height=heights[body]) for shape in own]
        return shapes

    return shapes_at


def _centrode(record: MotionRecord, body: str, extent: float) -> np.ndarray:
    """Return the fixed centrode (T,), complex, m; NaN where it is uncertain."""
    center = record.columns[body, 'icr'].copy()
    major, _, _ = ellipse_axes(record.columns[body, 'icr_covariance'])
    center[~(major < _UNCERTAIN * extent)] = np.nan
    # A pole that goes through infinity comes back from the other side.
    center[1:][np.abs(np.diff(center)) > extent / 2] = np.nan
    return center


def _body(
    record: MotionRecord, body: str, k: int, color: tuple[int, int, int], scale: float
) -> 'list[Shape]':
    """Return the outline of a body, and velocities, `scale` m long for each m/s."""
    from kinpole_ros.film import Shape

    outline = [points for start, points in record.outlines[body] if start <= k]
    place, angle = record.columns[body, 'position'][k], record.columns[body, 'angle'][k]
    if not outline or not np.isfinite(place):
        return []
    arm = outline[-1] * np.exp(1j * angle)
    shapes = [Shape(place + arm, color, 3.0, 'hull')]
    velocity = record.columns[body, 'velocity'][k]
    turn = 1j * record.columns[body, 'angular_velocity'][k]
    for one in arm[:: max(1, len(arm) // 2)]:
        tip = scale * (velocity + turn * one)
        start = place + one
        head = start + tip * np.array([0.8 + 0.1j, 1.0, 0.8 - 0.1j])
        shapes.append(Shape(np.array([start, start + tip, *head]), color, 2.0))
    return shapes


def _pole(
    record: MotionRecord, body: str, k: int, color: tuple[int, int, int], fixed: np.ndarray
) -> 'list[Shape]':
    """Return the ICR with the ellipse of two standard deviations, and both centrodes."""
    from kinpole_ros.film import Shape

    place, angle = (record.columns[body, name] for name in ('position', 'angle'))
    with np.errstate(invalid='ignore'):
        moving = (fixed - place) * np.exp(-1j * angle)
        moving = place[k] + moving * np.exp(1j * angle[k])
    shapes = [Shape(fixed, color, 1.5), Shape(moving, color, 1.0)]
    center = record.columns[body, 'icr'][k]
    if np.isfinite(center):
        covariance = record.columns[body, 'icr_covariance'][k : k + 1]
        major, minor, direction = (float(values[0]) for values in ellipse_axes(covariance))
        ellipse = major * _CIRCLE.real + 1j * minor * _CIRCLE.imag
        shapes.append(Shape(center + 2 * ellipse * np.exp(1j * direction), color, 1.0))
        shapes.append(Shape(np.array([center]), color, 6.0, 'dot'))
    return shapes
