"""The plane of a body at one instant: the linkage, both centrodes, poles with their ellipses."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.tools.plot._linkage import hatch, hull
from kinpole_ros.tools.plot._pins import pins
from kinpole_ros.tools.plot._read import Body, Centrodes, Results, Series, centrodes
from kinpole_ros.tools.plot._style import (
    BLACK,
    FIXED,
    GREEN,
    HALO,
    LINK,
    MOVING,
    OTHER,
    PATH,
    POLES,
    RELATIVE,
    breaks_of,
    line,
    reversals,
)

# An ICR known no better than this part of the picture is left out of the centrodes.
_BLURRED = 0.05
# Width over height of the frame, about as the figure has room.
_WIDER = 1.12
# What belongs to it, apart from poles and centrodes.
_LINKAGE = 'linkage'


class Shown(NamedTuple):
    """A body, the part of its centrodes that is known well, and the view of them."""

    body: Body
    locus: Centrodes
    view: 'View'


class View(NamedTuple):
    """What is worth seeing of the plane: a box, and how far from its body a pole is in it (m)."""

    low: complex
    high: complex
    reach: float

    def holds(self, points: np.ndarray) -> np.ndarray:
        across = (points.real >= self.low.real) & (points.real <= self.high.real)
        return across & (points.imag >= self.low.imag) & (points.imag <= self.high.imag)

    def with_points(self, points: np.ndarray) -> 'View':
        points = np.append(points, [self.low, self.high])
        return View(
            complex(points.real.min(), points.imag.min()),
            complex(points.real.max(), points.imag.max()),
            self.reach,
        )


def shown(body: Body) -> Shown:
    """What is to be drawn of a body."""
    locus = centrodes(body)
    reach = reach_of(body, locus)
    locus = sharp(locus, reach)
    return Shown(body, locus, view_of(body, locus, reach))


def _size(body: Body) -> float:
    return body.size if np.isfinite(body.size) else 0.0


def reach_of(body: Body, locus: Centrodes) -> float:
    """How far from the body's origin a pole is worth seeing, m; many go out to infinity."""
    extent = float(np.hypot(np.ptp(body.position.real), np.ptp(body.position.imag)))
    usual = float(np.median(np.abs(locus.moving))) if len(locus.moving) else 0.0
    farthest = max(8 * _size(body), 2 * extent) or np.inf
    return min(max(1.5 * usual, _size(body)), farthest)


def sharp(locus: Centrodes, reach: float) -> Centrodes:
    """The loci without the instants at which noise alone would draw a star across the picture."""
    with np.errstate(invalid='ignore'):
        kept = ~(locus.sigma > _BLURRED * reach)
    return Centrodes(*(part[kept] for part in locus))


def view_of(body: Body, locus: Centrodes, reach: float) -> View:
    """The path and the ICRs within reach of it."""
    start = complex(body.position[0])
    view = View(start, start, reach).with_points(body.position)
    view = view.with_points(locus.fixed[np.abs(locus.moving) <= reach])
    middle = (view.low + view.high) / 2
    least = 0.6 * max(_size(body), 1e-6) * (1 + 1j)
    return view.with_points(np.array([middle - least, middle + least]))


def instant_of(all_shown: Sequence[Shown], middle: int) -> int:
    """The stamp nearest to the middle of those with the most poles in view, and known well."""
    marks = []
    for body, _, view in all_shown:
        for series in (body.series[pole] for pole in POLES if pole in body.series):
            kept = view.holds(series.value) & ~_blurred(series, view.reach)
            marks.append(series.stamp[kept])
    stamps = np.concatenate(marks) if marks else np.empty(0, np.int64)
    if not len(stamps):
        stamps = np.concatenate([one.body.stamp for one in all_shown])
    stamps, counts = np.unique(stamps, return_counts=True)
    best = stamps[counts == counts.max()]
    return int(best[np.abs(best - middle).argmin()])


def _blurred(series: Series, reach: float) -> np.ndarray:
    """Where a center is known no better than a part of the picture."""
    with np.errstate(invalid='ignore'):
        spread = np.sqrt(np.trace(series.covariance, axis1=1, axis2=2))
        return np.asarray(spread > _BLURRED * reach)


def draw_plane(axis: Any, one: Shown, instant: int, results: Results) -> None:
    """The linkage with this body in color, its centrodes, poles and relative centers."""
    body, locus, view = one
    view = _draw_linkage(axis, body, view, instant, results)
    breaks = np.union1d(breaks_of(body, locus.stamp), reversals(locus.rate))
    line(axis, body.position, breaks_of(body, body.stamp), PATH)
    line(axis, locus.fixed, breaks, FIXED)
    here = np.flatnonzero(body.stamp == instant)
    if len(here):
        position, angle = body.position[here[0]], body.angle[here[0]]
        rolled = position + locus.moving * np.exp(1j * angle)
        line(axis, rolled, breaks, MOVING)
        view = view.with_points(rolled[np.abs(locus.moving) <= view.reach])
        axis.plot(position.real, position.imag, '+', color=BLACK, markersize=9)
        others = {other.name: other for other in results.bodies}
        for (j, i), series in results.relative.items():
            if j == body.name:
                centers = series.value[series.stamp == instant]
                view = view.with_points(centers[np.abs(centers - position) <= view.reach])
                _draw_relative(axis, body, others[i], series, view.reach, instant)
    for pole in reversed(POLES):
        _draw_pole(axis, body, pole, instant)
    _draw_velocity(axis, body, view, instant)
    middle, size = (view.low + view.high) / 2, view.high - view.low
    half = 0.55 * max(size.real, size.imag)
    wide = _WIDER * half
    axis.set_xlim(middle.real - wide, middle.real + wide)
    axis.set_ylim(middle.imag - half, middle.imag + half)
    axis.set_aspect('equal')
    axis.locator_params(nbins=6)
    axis.grid(True, linewidth=0.3)
    axis.set_axisbelow(True)
    axis.set_title(body.name, fontweight='bold', parse_math=False)


def _draw_linkage(axis: Any, body: Body, view: View, instant: int, results: Results) -> View:
    """Outlines of all bodies through their markers and pins, and the pins; the view of it."""
    grounded, between = pins(results, instant)
    for other in results.bodies:
        here = np.flatnonzero(other.stamp == instant)
        if not len(here):
            continue
        outline = other.position[here[0]] + other.outline * np.exp(1j * other.angle[here[0]])
        own = [place for pair, place in between.items() if other.name in pair]
        own += [grounded[other.name]] if other.name in grounded else []
        corners = hull(np.append(outline, own))
        if len(outline) and len(corners) > 1:
            style = LINK if other is body else OTHER
            axis.fill(corners.real, corners.imag, zorder=0.9 if other is body else 0.8, **style)
            color = style['edgecolor']
            axis.plot(outline.real, outline.imag, '.', color=color, markersize=4, gid=_LINKAGE)
            view = view.with_points(corners)
    size = 0.02 * max((view.high - view.low).real, (view.high - view.low).imag)
    for place in grounded.values():
        hatch(axis, place, size)
    for place in (*grounded.values(), *between.values()):
        white = {'color': BLACK, 'markerfacecolor': 'white', 'gid': _LINKAGE}
        axis.plot(place.real, place.imag, 'o', markersize=5, **white)
    return view


def _draw_relative(
    axis: Any, body: Body, other: Body, every: Series, reach: float, instant: int
) -> None:
    kept = ~_blurred(every, reach)
    series = Series(*(part[kept] for part in every))
    stamp, own, its = np.intersect1d(body.stamp, other.stamp, return_indices=True)
    rate = np.interp(series.stamp, stamp, body.rate[own] - other.rate[its]) if len(stamp) else None
    breaks = breaks_of(body, series.stamp)
    if rate is not None:
        breaks = np.union1d(breaks, reversals(rate))
    line(axis, series.value, breaks, RELATIVE)
    for value in every.value[every.stamp == instant]:
        axis.plot(value.real, value.imag, 'D', color=GREEN, markersize=6, fillstyle='none')
        axis.annotate(
            f'to {other.name}',
            (value.real, value.imag),
            (6, -11),
            textcoords='offset points',
            color=GREEN,
            fontsize='small',
            annotation_clip=True,
            parse_math=False,
        )


def _draw_pole(axis: Any, body: Body, pole: str, instant: int) -> None:
    from matplotlib.patches import Ellipse

    if pole not in body.series:
        return
    series = body.series[pole]
    for k in np.flatnonzero(series.stamp == instant):
        value, covariance = series.value[k], series.covariance[k]
        marker, size = POLES[pole]
        fill = BLACK if pole == 'icr' else 'none'
        axis.plot(
            value.real, value.imag, marker, color=BLACK, markerfacecolor=fill, markersize=size
        )
        if np.isfinite(covariance).all():
            variances, directions = np.linalg.eigh(covariance)
            width, height = 4 * np.sqrt(np.maximum(variances, 0))
            tilt = np.degrees(np.arctan2(directions[1, 0], directions[0, 0]))
            axis.add_patch(
                Ellipse(
                    (value.real, value.imag),
                    width,
                    height,
                    angle=tilt,
                    facecolor=(0, 0, 0, 0.12),
                    edgecolor=BLACK,
                    linewidth=0.7,
                )
            )


def _draw_velocity(axis: Any, body: Body, view: View, instant: int) -> None:
    """An arrow along u, not to scale, with the speed in words; none for an ICR at rest."""
    icr, u = body.series.get('icr'), body.series.get('icr_velocity')
    if icr is None or u is None:
        return
    tail, velocity = icr.value[icr.stamp == instant], u.value[u.stamp == instant]
    if not (len(tail) and len(velocity) and velocity[0]):
        return
    curvature = body.series.get('centrode_curvature')
    if curvature is not None and instant not in curvature.stamp:
        text = 'ICR not seen to move'
    else:
        text = f'$|u|$ = {np.abs(velocity[0]):.3g} m/s'
        length = 0.2 * max((view.high - view.low).real, (view.high - view.low).imag)
        head = tail[0] + length * velocity[0] / np.abs(velocity[0])
        axis.annotate(
            '',
            (head.real, head.imag),
            (tail[0].real, tail[0].imag),
            arrowprops={'arrowstyle': '-|>', 'color': BLACK, 'linewidth': 1.5},
            annotation_clip=False,
            clip_on=True,
        )
    axis.text(0.02, 0.98, text, transform=axis.transAxes, va='top', fontsize='small', bbox=HALO)
