"""The plane of a body at one instant: the linkage, both centrodes, poles with their ellipses."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.tools.plot import _style
from kinpole_ros.tools.plot._drawn_body import Body, DrawnCentrodes, centrodes
from kinpole_ros.tools.record.lost import breaks_of
from kinpole_ros.tools.record.record import Pin, Series, ellipse

# An ICR with a standard deviation above this fraction of the view is left out of the centrodes.
_BLURRED = 0.05
# Width over height of the axes.
_ASPECT = 1.12
# The gid of lines that belong to the linkage, not to poles and centrodes.
_LINKAGE = 'linkage'


class View(NamedTuple):
    """A box of the plane; poles farther than `radius` (m) from their body do not enlarge it."""

    low: complex
    high: complex
    radius: float

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which complex points are in the box."""
        in_x = (points.real >= self.low.real) & (points.real <= self.high.real)
        return in_x & (points.imag >= self.low.imag) & (points.imag <= self.high.imag)

    def with_points(self, points: np.ndarray) -> 'View':
        """Return the view with a box that contains the points too."""
        points = np.append(points, [self.low, self.high])
        low, high = (complex(f(points.real), f(points.imag)) for f in (np.min, np.max))
        return View(low, high, self.radius)

    @property
    def size(self) -> float:
        """The longer side of the box."""
        return max((self.high - self.low).real, (self.high - self.low).imag)


class DrawnRig(NamedTuple):
    """The bodies by name, their pins, and their relative centers by pair (j, i)."""

    bodies: dict[str, Body]
    joints: list[Pin]
    centers: dict[tuple[str, str], Series]


class Scope(NamedTuple):
    """A body to draw, its centrodes without blurred parts, and the view of them."""

    body: Body
    centrodes: DrawnCentrodes
    view: View


def scope_of(body: Body) -> Scope:
    """Return what is to be drawn of a body."""
    loci = centrodes(body)
    radius = view_radius(body, loci)
    loci = without_blurred(loci, radius)
    return Scope(body, loci, view_of(body, loci, radius))


def _size(body: Body) -> float:
    return body.size if np.isfinite(body.size) else 0.0


def view_radius(body: Body, loci: DrawnCentrodes) -> float:
    """Return how far from the body's origin poles are shown, m; many go to infinity."""
    extent = float(np.hypot(np.ptp(body.position.real), np.ptp(body.position.imag)))
    usual = float(np.median(np.abs(loci.moving))) if len(loci.moving) else 0.0
    farthest = max(8 * _size(body), 2 * extent) or np.inf
    return min(max(1.5 * usual, _size(body)), farthest)


def without_blurred(loci: DrawnCentrodes, radius: float) -> DrawnCentrodes:
    """Return the centrodes without instants at which noise would draw a star over the picture."""
    with np.errstate(invalid='ignore'):
        sharp = ~(loci.sigma > _BLURRED * radius)
    return DrawnCentrodes(*(values[sharp] for values in loci))


def view_of(body: Body, loci: DrawnCentrodes, radius: float) -> View:
    """Return the view of the path of a body and of the ICRs within a radius of it."""
    start = complex(body.position[0])
    view = View(start, start, radius).with_points(body.position)
    view = view.with_points(loci.fixed[np.abs(loci.moving) <= radius])
    middle = (view.low + view.high) / 2
    margin = 0.6 * max(_size(body), 1e-6) * (1 + 1j)
    return view.with_points(np.array([middle - margin, middle + margin]))


def instant_of(scopes: Sequence[Scope], middle: int) -> int:
    """Return the stamp with the most sharp poles in view; of several, the one nearest `middle`."""
    stamps = []
    for body, _, view in scopes:
        for series in (body.series[pole] for pole in _style.POLES if pole in body.series):
            in_view = view.contains(series.value) & ~_is_blurred(series, view.radius)
            stamps.append(series.stamp[in_view])
    if not any(map(len, stamps)):
        stamps = [scope.body.stamp for scope in scopes]
    values, counts = np.unique(np.concatenate(stamps), return_counts=True)
    best = values[counts == counts.max()]
    return int(best[np.abs(best - middle).argmin()])


def _is_blurred(series: Series, radius: float) -> np.ndarray:
    """Return where a center has a standard deviation too large for a picture."""
    with np.errstate(invalid='ignore'):
        sigma = np.sqrt(np.trace(series.spread, axis1=1, axis2=2))
        return np.asarray(sigma > _BLURRED * radius)


def draw_plane(axis: Any, scope: Scope, instant: int, linkage: DrawnRig) -> None:
    """Draw the linkage with this body in color, its centrodes, poles and relative centers."""
    body, loci, view = scope
    view = _draw_linkage(axis, body, view, instant, linkage)
    breaks = np.union1d(breaks_of(body.frames, loci.stamp), _style.reversals(loci.rate))
    _style.line(axis, body.position, breaks_of(body.frames, body.stamp), _style.PATH)
    _style.line(axis, loci.fixed, breaks, _style.FIXED)
    at = np.flatnonzero(body.stamp == instant)
    if len(at):
        position, angle = body.position[at[0]], body.angle[at[0]]
        moving = position + loci.moving * np.exp(1j * angle)
        _style.line(axis, moving, breaks, _style.MOVING)
        view = view.with_points(moving[np.abs(loci.moving) <= view.radius])
        axis.plot(position.real, position.imag, '+', color=_style.BLACK, markersize=9)
        for (j, i), series in linkage.centers.items():
            if j == body.name:
                centers = series.value[series.stamp == instant]
                view = view.with_points(centers[np.abs(centers - position) <= view.radius])
                _draw_relative_center(axis, body, linkage.bodies[i], series, view.radius, instant)
    for pole in reversed(_style.POLES):
        _draw_pole(axis, body, pole, instant)
    _draw_icr_velocity(axis, body, view, instant)
    middle, half = (view.low + view.high) / 2, 0.55 * view.size
    axis.set_xlim(middle.real - _ASPECT * half, middle.real + _ASPECT * half)
    axis.set_ylim(middle.imag - half, middle.imag + half)
    axis.set_aspect('equal')
    axis.locator_params(nbins=6)
    axis.grid(True, linewidth=0.3)
    axis.set_axisbelow(True)
    axis.set_title(body.name, fontweight='bold', parse_math=False)


def _draw_linkage(axis: Any, body: Body, view: View, instant: int, linkage: DrawnRig) -> View:
    """Draw outlines of all bodies through their markers and pins; return the view of them."""
    on_ground, between = {}, {}
    for joint in linkage.joints:
        first, z = linkage.bodies[joint.bodies[0]], joint.at[0]
        at = np.flatnonzero(first.stamp == instant)
        if len(at) and len(joint.bodies) == 1:
            on_ground[joint.bodies] = z
        elif len(at):
            between[joint.bodies] = first.position[at[0]] + z * np.exp(1j * first.angle[at[0]])
    for one in linkage.bodies.values():
        at = np.flatnonzero(one.stamp == instant)
        if not len(at):
            continue
        outline = one.position[at[0]] + one.outline * np.exp(1j * one.angle[at[0]])
        pins = [z for names, z in (on_ground | between).items() if one.name in names]
        corners = _style.hull(np.append(outline, pins))
        if len(outline) and len(corners) > 1:
            style, zorder = (_style.LINK, 0.9) if one is body else (_style.OTHER_LINK, 0.8)
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
    axis: Any, body: Body, reference: Body, series: Series, radius: float, instant: int
) -> None:
    sharp = ~_is_blurred(series, radius)
    locus = Series(*(values[sharp] for values in series))
    rates = [one.series['angular_velocity'] for one in (body, reference)]
    stamp, own, its = np.intersect1d(rates[0].stamp, rates[1].stamp, return_indices=True)
    breaks = breaks_of(body.frames, locus.stamp)
    if len(stamp):
        rate = np.interp(locus.stamp, stamp, rates[0].value[own] - rates[1].value[its])
        breaks = np.union1d(breaks, _style.reversals(rate))
    _style.line(axis, locus.value, breaks, _style.RELATIVE)
    for z in series.value[series.stamp == instant]:
        axis.plot(z.real, z.imag, 'D', color=_style.GREEN, markersize=6, fillstyle='none')
        axis.annotate(
            f'to {reference.name}',
            (z.real, z.imag),
            (6, -11),
            textcoords='offset points',
            color=_style.GREEN,
            fontsize='small',
            annotation_clip=True,
            parse_math=False,
        )


def _draw_pole(axis: Any, body: Body, pole: str, instant: int) -> None:
    """Draw a pole with its ellipse of two standard deviations."""
    from matplotlib.patches import Ellipse

    if pole not in body.series:
        return
    series, (marker, size) = body.series[pole], _style.POLES[pole]
    for k in np.flatnonzero(series.stamp == instant):
        x, y, covariance = series.value[k].real, series.value[k].imag, series.spread[k]
        fill = _style.BLACK if pole == 'icr' else 'none'
        axis.plot(x, y, marker, color=_style.BLACK, markerfacecolor=fill, markersize=size)
        if np.isfinite(covariance).all():
            major, minor, direction = ellipse(covariance)
            style = {'facecolor': (0, 0, 0, 0.12), 'edgecolor': _style.BLACK, 'linewidth': 0.7}
            tilt = float(np.degrees(direction))
            axis.add_patch(Ellipse((x, y), 4 * major, 4 * minor, angle=tilt, **style))


def _draw_icr_velocity(axis: Any, body: Body, view: View, instant: int) -> None:
    """Draw an arrow of constant length along the ICR velocity, with the speed as text."""
    icr, velocity = body.series.get('icr'), body.series.get('icr_velocity')
    if icr is None or velocity is None:
        return
    tails, vectors = icr.value[icr.stamp == instant], velocity.value[velocity.stamp == instant]
    if not (len(tails) and len(vectors) and vectors[0]):
        return
    curvature = body.series.get('centrode_curvature')
    if curvature is not None and instant not in curvature.stamp:
        text = 'ICR not seen to move'
    else:
        speed = np.abs(vectors[0])
        text = f'$|u|$ = {speed:.3g} m/s'
        head = tails[0] + 0.2 * view.size * vectors[0] / speed
        axis.annotate(
            '',
            (head.real, head.imag),
            (tails[0].real, tails[0].imag),
            arrowprops={'arrowstyle': '-|>', 'color': _style.BLACK, 'linewidth': 1.5},
            annotation_clip=False,
            clip_on=True,
        )
    corner: dict[str, Any] = {'transform': axis.transAxes, 'va': 'top', 'fontsize': 'small'}
    axis.text(0.02, 0.98, text, bbox=_style.LABEL_BOX, **corner)
