"""The plane of a body at one instant: the linkage, both centrodes, poles with their ellipses."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.tools.plot import _style
from kinpole_ros.tools.record.record import MotionRecord, Pin, pairs_of
from kinpole_ros.tracking.values import ellipse_axes

# An ICR with a standard deviation above this fraction of the view is left out of the centrodes.
_BLURRED = 0.05
# Width over height of the axes.
_ASPECT = 1.12
# The gid of lines that belong to the linkage, not to poles and centrodes.
_LINKAGE = 'linkage'


class Scope(NamedTuple):
    """
    A body of a record to draw, and the view of it.

    `fixed` and `moving` (T,) are its centrodes in the plane and in its frame, complex, m, without
    instants at which noise would draw a star over the picture. Poles farther than `radius` (m) from
    the body do not enlarge the view.
    """

    record: MotionRecord
    body: str
    fixed: np.ndarray
    moving: np.ndarray
    view: _style.Box
    radius: float

    def column(self, name: str) -> np.ndarray | None:
        """Return a quantity (T,) of the body; None if there is none."""
        return self.record.columns.get((self.body, name))


def scope_of(record: MotionRecord, body: str) -> Scope:
    """Return what is to be drawn of a body."""
    fixed, moving = centrodes(record, body)
    radius = view_radius(record, body, moving)
    if (body, 'icr') in record.columns:
        is_blurred = _is_blurred(record.columns[body, 'icr_covariance'], radius)
        fixed, moving = (
            np.where(is_blurred, complex(np.nan, np.nan), curve) for curve in (fixed, moving)
        )
    points = [*record.columns[body, 'position'], *fixed[np.abs(moving) <= radius]]
    view = _style.box_of(points)
    margin = 0.6 * max(_size(record, body), 1e-6) * (1 + 1j)
    view = view.with_points([view.middle - margin, view.middle + margin])
    return Scope(record, body, fixed, moving, view, radius)


def centrodes(record: MotionRecord, body: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the ICR (T,), complex, m, in the plane and in the frame of a body."""
    position, angle = (record.columns[body, name] for name in ('position', 'angle'))
    fixed = record.columns.get((body, 'icr'), np.full(len(position), complex(np.nan, np.nan)))
    return fixed, (fixed - position) * np.exp(-1j * angle)


def _size(record: MotionRecord, body: str) -> float:
    return record.sizes[body] if np.isfinite(record.sizes[body]) else 0.0


def view_radius(record: MotionRecord, body: str, moving: np.ndarray) -> float:
    """Return how far from the body's origin poles are shown, m; many go to infinity."""
    position, size = record.columns[body, 'position'], _size(record, body)
    position, moving = position[np.isfinite(position)], moving[np.isfinite(moving)]
    extent = float(np.hypot(np.ptp(position.real), np.ptp(position.imag)))
    usual = float(np.median(np.abs(moving))) if len(moving) else 0.0
    farthest = max(8 * size, 2 * extent) or np.inf
    return min(max(1.5 * usual, size), farthest)


def instant_of(scopes: Sequence[Scope], middle: int) -> int:
    """Return the instant with the most sharp poles in view; of several, the nearest to `middle`."""
    record = scopes[0].record
    counts = np.zeros(len(record.stamp), int)
    for scope in scopes:
        for pole in _style.POLES:
            if (points := scope.column(pole)) is not None:
                covariance = record.columns[scope.body, f'{pole}_covariance']
                is_blurred = _is_blurred(covariance, scope.radius)
                counts += scope.view.contains(points) & ~is_blurred
    if not counts.any():
        counts = sum(np.isfinite(record.columns[scope.body, 'position']) + 0 for scope in scopes)
    best = np.flatnonzero(counts == counts.max())
    return int(best[np.abs(record.stamp[best] - middle).argmin()])


def _is_blurred(covariance: np.ndarray, radius: float) -> np.ndarray:
    """Return where a center has a standard deviation too large for a picture."""
    with np.errstate(invalid='ignore'):
        return np.asarray(np.sqrt(np.trace(covariance, axis1=1, axis2=2)) > _BLURRED * radius)


def draw_plane(axis: Any, scope: Scope, joints: Sequence[Pin], k: int) -> None:
    """Draw the linkage at instant k with this body in color, its centrodes and centers."""
    record, body = scope.record, scope.body
    view = _draw_linkage(axis, scope, joints, k)
    rate, position = (record.columns[body, name] for name in ('angular_velocity', 'position'))
    _style.line(axis, record.stamp, position, _style.PATH)
    _style.line(axis, record.stamp, scope.fixed, _style.FIXED, rate)
    if np.isfinite(position[k]):
        here = position[k]
        moving = here + scope.moving * np.exp(1j * record.columns[body, 'angle'][k])
        _style.line(axis, record.stamp, moving, _style.MOVING, rate)
        view = view.with_points(moving[np.abs(scope.moving) <= scope.radius])
        axis.plot(here.real, here.imag, '+', color=_style.BLACK, markersize=9)
        for pair in pairs_of(record):
            if pair[0] == body:
                center = record.columns[pair, 'icr'][k]
                if np.abs(center - here) <= scope.radius:
                    view = view.with_points([center])
                _draw_relative_center(axis, record, pair, scope.radius, k)
    for pole in reversed(_style.POLES):
        _draw_pole(axis, scope, pole, k)
    _draw_icr_velocity(axis, scope, view, k)
    middle, half = view.middle, 0.55 * view.size
    axis.set_xlim(middle.real - _ASPECT * half, middle.real + _ASPECT * half)
    axis.set_ylim(middle.imag - half, middle.imag + half)
    axis.set_aspect('equal')
    axis.locator_params(nbins=6)
    axis.grid(True, linewidth=0.3)
    axis.set_axisbelow(True)
    axis.set_title(body, fontweight='bold', parse_math=False)


def _draw_linkage(axis: Any, scope: Scope, joints: Sequence[Pin], k: int) -> _style.Box:
    """Draw outlines of all bodies through their markers and pins; return the view of them."""
    record, view = scope.record, scope.view
    columns = record.columns
    poses = {
        body: (columns[body, 'position'][k], np.exp(1j * columns[body, 'angle'][k]))
        for body in record.bodies
        if np.isfinite(columns[body, 'position'][k])
    }
    on_ground, between = {}, {}
    for joint in joints:
        if joint.bodies[0] in poses:
            position, turn = poses[joint.bodies[0]]
            if len(joint.bodies) == 1:
                on_ground[joint.bodies] = joint.at[0]
            else:
                between[joint.bodies] = position + joint.at[0] * turn
    for body, (position, turn) in poses.items():
        drawn = record.outlines[body]
        outline = position + (drawn[-1][1] if drawn else np.empty(0, complex)) * turn
        pins = [z for names, z in (on_ground | between).items() if body in names]
        corners = _style.hull(np.append(outline, pins))
        if len(outline) and len(corners) > 1:
            style, zorder = (_style.LINK, 0.9) if body == scope.body else (_style.OTHER_LINK, 0.8)
            axis.fill(corners.real, corners.imag, zorder=zorder, **style)
            dots = {'color': style['edgecolor'], 'markersize': 4, 'gid': _LINKAGE}
            axis.plot(outline.real, outline.imag, '.', **dots)
            view = view.with_points(corners)
    for z in on_ground.values():
        _style.draw_ground(axis, z, 0.02 * view.size)
    circle = {'color': _style.BLACK, 'markerfacecolor': 'white', 'markersize': 5, 'gid': _LINKAGE}
    for z in (*on_ground.values(), *between.values()):
        axis.plot(z.real, z.imag, 'o', **circle)
    return view


def _draw_relative_center(
    axis: Any, record: MotionRecord, pair: tuple[str, str], radius: float, k: int
) -> None:
    centers = record.columns[pair, 'icr']
    is_blurred = _is_blurred(record.columns[pair, 'icr_covariance'], radius)
    locus = np.where(is_blurred, complex(np.nan, np.nan), centers)
    rates = [record.columns[body, 'angular_velocity'] for body in pair]
    _style.line(axis, record.stamp, locus, _style.RELATIVE, rates[0] - rates[1])
    z = centers[k]
    if np.isfinite(z):
        axis.plot(z.real, z.imag, 'D', color=_style.GREEN, markersize=6, fillstyle='none')
        axis.annotate(
            f'to {pair[1]}',
            (z.real, z.imag),
            (6, -11),
            textcoords='offset points',
            color=_style.GREEN,
            fontsize='small',
            annotation_clip=True,
            parse_math=False,
        )


def _draw_pole(axis: Any, scope: Scope, pole: str, k: int) -> None:
    """Draw a pole with its ellipse of two standard deviations."""
    from matplotlib.patches import Ellipse

    points, (marker, size) = scope.column(pole), _style.POLES[pole]
    if points is None or not np.isfinite(points[k]):
        return
    x, y = points[k].real, points[k].imag
    fill = _style.BLACK if pole == 'icr' else 'none'
    axis.plot(x, y, marker, color=_style.BLACK, markerfacecolor=fill, markersize=size)
    covariance = scope.record.columns[scope.body, f'{pole}_covariance'][k]
    if np.isfinite(covariance).all():
        major, minor, direction = ellipse_axes(covariance)
        style = {'facecolor': (0, 0, 0, 0.12), 'edgecolor': _style.BLACK, 'linewidth': 0.7}
        tilt = float(np.degrees(direction))
        axis.add_patch(Ellipse((x, y), 4 * major, 4 * minor, angle=tilt, **style))


def _draw_icr_velocity(axis: Any, scope: Scope, view: _style.Box, k: int) -> None:
    """Draw an arrow of constant length along the ICR velocity, with the speed as text."""
    icr, velocities = scope.column('icr'), scope.column('icr_velocity')
    if icr is None or velocities is None:
        return
    tail, velocity = icr[k], velocities[k]
    if not np.isfinite(tail + velocity) or not velocity:
        return
    curvature = scope.column('centrode_curvature')
    if curvature is not None and not np.isfinite(curvature[k]):
        text = 'ICR not seen to move'
    else:
        speed = np.abs(velocity)
        text = f'$|u|$ = {speed:.3g} m/s'
        head = tail + 0.2 * view.size * velocity / speed
        axis.annotate(
            '',
            (head.real, head.imag),
            (tail.real, tail.imag),
            arrowprops={'arrowstyle': '-|>', 'color': _style.BLACK, 'linewidth': 1.5},
            annotation_clip=False,
            clip_on=True,
        )
    corner: dict[str, Any] = {'transform': axis.transAxes, 'va': 'top', 'fontsize': 'small'}
    axis.text(0.02, 0.98, text, bbox=_style.LABEL_BOX, **corner)
