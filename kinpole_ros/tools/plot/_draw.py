"""
A picture of a result bag, for who wants to see at once what the mechanism did.

One row per body: the plane with both centrodes and the poles of one instant, the rates of turning,
and how the ICR runs along the fixed centrode.
"""

import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.bags import BagError, in_place_of
from kinpole_ros.tools.plot._read import Body, Centrodes, Results, Series, centrodes, read_results

_MOST_BODIES = 4
_READING = 0.9  # of the time, the rest is drawing
_WIDTH, _ROW_HEIGHT, _DPI = 12.0, 4.1, 150  # inches; 1800 px across
# Longer than this many periods without a sample is a gap, not a lost frame.
_GAP = 2.5
# An ICR known no better than this part of the picture is left out of the centrodes.
_BLURRED = 0.05
# What is positive and spreads over more than this factor goes on a logarithmic axis.
_LOG_FACTOR = 30
# Each fits around the one before: where poles meet, all are still seen.
_POLES = {'icr': ('o', 6.0), 'iap': ('^', 9.0), 'ijp': ('s', 11.0)}
_POLE_TEXT = {
    'icr': 'ICR (velocity pole)',
    'iap': 'IAP (acceleration pole)',
    'ijp': 'IJP (jerk pole)',
}
_BLACK, _BLUE, _GREEN, _GRAY = '#000000', '#0060a8', '#00785a', '#777777'
# Widths and shades differ too: dashes of the second turn fill the gaps of the first.
_PATH: dict[str, Any] = {'color': '#a0a0a0', 'linestyle': ':', 'linewidth': 1.2}
_FIXED: dict[str, Any] = {'color': '#7db4e6', 'linestyle': '-', 'linewidth': 3.5}
_MOVING: dict[str, Any] = {'color': '#a83200', 'linestyle': '--', 'linewidth': 1.3}
_RELATIVE: dict[str, Any] = {'color': '#00785a', 'linestyle': '-.', 'linewidth': 0.7}
_BAND: dict[str, Any] = {'color': _BLUE, 'alpha': 0.3, 'linewidth': 0.8}
_HALO: dict[str, Any] = {'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.75, 'pad': 1.0}


def plot(
    bag: str | Path, output: str | Path, progress: Callable[[float], None] | None = None
) -> str:
    """
    Draw the results in `bag` (an .mcap file or a rosbag2 folder) to `output`.

    The format goes by the suffix of `output`: png, pdf, svg or whatever else matplotlib writes;
    folders above it are made. `progress` is called with the share done, by time. Returns what a bag
    that is not whole lacks, '' for one that is. Raises BagError when the bag holds no results,
    `output` cannot be written or matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise BagError(
            "drawing needs matplotlib; install it with pip install 'kinpole_ros[plot]'"
        ) from error
    # A Figure of its own, without pyplot: whoever draws in the same process keeps his state.
    figure = Figure(figsize=(_WIDTH, 1), layout='constrained')
    formats = sorted(figure.canvas.get_supported_filetypes())
    kind = Path(output).suffix[1:].lower()
    if kind not in formats:
        raise BagError(f'{output} is no picture; end its name in one of {", ".join(formats)}')
    reading = None if progress is None else lambda share: progress(_READING * share)
    results = read_results(bag, reading)
    # A file name need not be text.
    _draw(figure, os.fsencode(Path(bag).name).decode(errors='replace'), results)
    with in_place_of(output) as part, warnings.catch_warnings():
        # A letter that the font lacks is drawn as a box.
        warnings.filterwarnings('ignore', 'Glyph .* missing from', UserWarning)
        figure.savefig(part, format=kind, dpi=_DPI)
    if progress is not None:
        progress(1.0)
    return results.cut


def _draw(figure: Any, bag: str, results: Results) -> None:
    bodies = results.bodies[:_MOST_BODIES]
    figure.set_size_inches(_WIDTH, 1.3 + _ROW_HEIGHT * len(bodies))
    start = min(int(body.stamp[0]) for body in bodies)
    end = max(int(body.stamp[-1]) for body in bodies)
    loci = [centrodes(body) for body in bodies]
    reaches = [_reach(body, locus) for body, locus in zip(bodies, loci, strict=True)]
    loci = [_sharp(locus, reach) for locus, reach in zip(loci, reaches, strict=True)]
    views = [_view(*found) for found in zip(bodies, loci, reaches, strict=True)]
    instant = _instant(bodies, views, (start + end) // 2)
    names = ', '.join(body.name for body in bodies)
    left_out = [body.name for body in results.bodies[_MOST_BODIES:]]
    figure.suptitle(
        f'{bag}: {names}'
        + (f' (not drawn: {", ".join(left_out)})' if left_out else '')
        + f'\n{(end - start) * 1e-9:.3g} s from stamp {start * 1e-9:.3f} s'
        + (', bag cut off' if results.cut else '')
        + f'; poles and moving centrode at t = {(instant - start) * 1e-9:.3f} s',
        parse_math=False,
    )
    columns: dict[int, list[Any]] = {0: [], 1: [], 2: []}
    grid = figure.add_gridspec(len(bodies), 3, width_ratios=[1.2, 1, 1])
    figure.get_layout_engine().set(w_pad=0.12)
    for row, (body, locus, view) in enumerate(zip(bodies, loci, views, strict=True)):
        axis = figure.add_subplot(grid[row, 0])
        others = {other.name: other for other in results.bodies}
        related = [(others[i], s) for (j, i), s in results.relative.items() if j == body.name]
        _draw_plane(axis, body, locus, view, instant, related)
        axis.set_xlabel(f'{results.along[0]} (m)')
        axis.set_ylabel(f'{results.along[1]} (m)')
        columns[0].append(axis)
        for column, panels in ((1, _rates(body)), (2, _run(body))):
            inner = grid[row, column].subgridspec(len(panels), 1)
            shared = None
            for k, panel in enumerate(panels):
                axis = shared = figure.add_subplot(inner[k], sharex=shared)
                _draw_time(axis, body, panel, start, instant)
                columns[column].append(axis)
                axis.tick_params(labelbottom=k == len(panels) - 1)
                if end > start:
                    axis.set_xlim(0, (end - start) * 1e-9)
            axis.set_xlabel('t (s)')
    for axes in columns.values():
        figure.align_ylabels(axes)
    _legend(figure, bool(results.relative))


class _View(NamedTuple):
    """What is worth seeing of the plane: a box, and how far from its body a pole is in it (m)."""

    low: complex
    high: complex
    reach: float

    def holds(self, points: np.ndarray) -> np.ndarray:
        across = (points.real >= self.low.real) & (points.real <= self.high.real)
        return across & (points.imag >= self.low.imag) & (points.imag <= self.high.imag)

    def with_points(self, points: np.ndarray) -> '_View':
        points = np.append(points, [self.low, self.high])
        return _View(
            complex(points.real.min(), points.imag.min()),
            complex(points.real.max(), points.imag.max()),
            self.reach,
        )


def _size(body: Body) -> float:
    return body.size if np.isfinite(body.size) else 0.0


def _reach(body: Body, locus: Centrodes) -> float:
    """How far from the body's origin a pole is worth seeing, m; many go out to infinity."""
    extent = float(np.hypot(np.ptp(body.position.real), np.ptp(body.position.imag)))
    usual = float(np.median(np.abs(locus.moving))) if len(locus.moving) else 0.0
    farthest = max(8 * _size(body), 2 * extent) or np.inf
    return min(max(1.5 * usual, _size(body)), farthest)


def _sharp(locus: Centrodes, reach: float) -> Centrodes:
    """The loci without the instants at which noise alone would draw a star across the picture."""
    with np.errstate(invalid='ignore'):
        kept = ~(locus.sigma > _BLURRED * reach)
    return Centrodes(*(part[kept] for part in locus))


def _view(body: Body, locus: Centrodes, reach: float) -> _View:
    """The path and the ICRs within reach of it."""
    start = complex(body.position[0])
    view = _View(start, start, reach).with_points(body.position)
    view = view.with_points(locus.fixed[np.abs(locus.moving) <= reach])
    middle = (view.low + view.high) / 2
    least = 0.6 * max(_size(body), 1e-6) * (1 + 1j)
    return view.with_points(np.array([middle - least, middle + least]))


def _instant(bodies: Sequence[Body], views: Sequence[_View], middle: int) -> int:
    """The stamp nearest to the middle of those with the most poles in view."""
    marks = [
        body.series[pole].stamp[view.holds(body.series[pole].value)]
        for body, view in zip(bodies, views, strict=True)
        for pole in _POLES
        if pole in body.series
    ]
    stamps = np.concatenate(marks) if marks else np.empty(0, np.int64)
    if not len(stamps):
        stamps = np.concatenate([body.stamp for body in bodies])
    stamps, counts = np.unique(stamps, return_counts=True)
    best = stamps[counts == counts.max()]
    return int(best[np.abs(best - middle).argmin()])


def _breaks(body: Body, stamp: np.ndarray) -> np.ndarray:
    """Indices after which a line through `stamp` has to stop: nothing is known in between."""
    period = np.median(np.diff(body.stamp)) if len(body.stamp) > 1 else np.inf
    return np.flatnonzero(np.diff(stamp) > _GAP * period)


def _reversals(rate: np.ndarray) -> np.ndarray:
    """Indices after which the rate changes sign: there the ICR passes through infinity."""
    return np.flatnonzero(np.diff(np.sign(rate)) != 0)


def _broken(values: np.ndarray, breaks: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """The values with NaN at each break, and where in them values stand alone."""
    values = np.insert(values, np.unique(breaks) + 1, np.nan)
    gap = np.concatenate([[True], np.isnan(values), [True]])
    alone = ~gap[1:-1] & gap[:-2] & gap[2:]
    return values, np.flatnonzero(alone).tolist()


def _line(axis: Any, points: np.ndarray, breaks: np.ndarray, style: dict[str, Any]) -> None:
    points, alone = _broken(points, breaks)
    axis.plot(points.real, points.imag, marker='.', markersize=3, markevery=alone, **style)


def _draw_plane(
    axis: Any,
    body: Body,
    locus: Centrodes,
    view: _View,
    instant: int,
    related: Sequence[tuple[Body, Series]],
) -> None:
    breaks = np.union1d(_breaks(body, locus.stamp), _reversals(locus.rate))
    _line(axis, body.position, _breaks(body, body.stamp), _PATH)
    _line(axis, locus.fixed, breaks, _FIXED)
    here = np.flatnonzero(body.stamp == instant)
    if len(here):
        position, angle = body.position[here[0]], body.angle[here[0]]
        rolled = position + locus.moving * np.exp(1j * angle)
        _line(axis, rolled, breaks, _MOVING)
        view = view.with_points(rolled[np.abs(locus.moving) <= view.reach])
        axis.plot(position.real, position.imag, '+', color=_BLACK, markersize=9)
        for other, series in related:
            centers = series.value[series.stamp == instant]
            view = view.with_points(centers[np.abs(centers - position) <= view.reach])
            _draw_relative(axis, body, other, series, instant)
    for pole in reversed(_POLES):
        _draw_pole(axis, body, pole, instant)
    _draw_velocity(axis, body, view, instant)
    middle, size = (view.low + view.high) / 2, view.high - view.low
    half = 0.55 * max(size.real, size.imag)
    axis.set_xlim(middle.real - half, middle.real + half)
    axis.set_ylim(middle.imag - half, middle.imag + half)
    axis.set_box_aspect(1)
    axis.locator_params(nbins=6)
    axis.grid(True, linewidth=0.3)
    axis.set_title(body.name, fontweight='bold', parse_math=False)


def _draw_relative(axis: Any, body: Body, other: Body, series: Series, instant: int) -> None:
    stamp, own, its = np.intersect1d(body.stamp, other.stamp, return_indices=True)
    rate = np.interp(series.stamp, stamp, body.rate[own] - other.rate[its]) if len(stamp) else None
    breaks = _breaks(body, series.stamp)
    if rate is not None:
        breaks = np.union1d(breaks, _reversals(rate))
    _line(axis, series.value, breaks, _RELATIVE)
    for value in series.value[series.stamp == instant]:
        axis.plot(value.real, value.imag, 'D', color=_GREEN, markersize=6, fillstyle='none')
        axis.annotate(
            f'to {other.name}',
            (value.real, value.imag),
            (6, -11),
            textcoords='offset points',
            color=_GREEN,
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
        marker, size = _POLES[pole]
        fill = _BLACK if pole == 'icr' else 'none'
        axis.plot(
            value.real, value.imag, marker, color=_BLACK, markerfacecolor=fill, markersize=size
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
                    edgecolor=_BLACK,
                    linewidth=0.7,
                )
            )


def _draw_velocity(axis: Any, body: Body, view: _View, instant: int) -> None:
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
            arrowprops={'arrowstyle': '-|>', 'color': _BLACK, 'linewidth': 1.5},
            annotation_clip=False,
            clip_on=True,
        )
    axis.text(0.02, 0.98, text, transform=axis.transAxes, va='top', fontsize='small', bbox=_HALO)


class _Panel(NamedTuple):
    """
    A quantity over time: its label, and the series if there is one.

    `least` is how much of it is worth seeing at all; `cut` the percentage of values at each end
    that may fall outside; `sigma` the standard deviation of the values, if known.
    """

    label: str
    series: Series | None
    least: float
    cut: float
    sigma: np.ndarray | None = None


def _rates(body: Body) -> list[_Panel]:
    covariance = np.full((len(body.stamp), 2, 2), np.nan)
    rate = Series(body.stamp, body.rate, covariance)
    # Measured by the turning itself: a steady wheel's acceleration is nothing, however jagged.
    least = [0.05 * float(np.median(np.abs(body.rate))) ** order for order in (1, 2, 3)]
    alpha, jerk = body.series.get('angular_acceleration'), body.series.get('angular_jerk')
    return [
        _Panel('ω (rad/s)', rate, least[0], 0, body.rate_sigma),
        _Panel('α (rad/s²)', alpha, least[1], 2),
        _Panel('jerk (rad/s³)', jerk, least[2], 2),
    ]


def _run(body: Body) -> list[_Panel]:
    curvature, speed = body.series.get('centrode_curvature'), body.series.get('icr_velocity')
    if speed is not None:
        speed = speed._replace(value=np.abs(speed.value))
    least = 0.05 * float(np.median(speed.value)) if speed is not None else 0.0
    # A centrode of a radius of many body sizes is straight.
    straight = 0.5 / _size(body) if _size(body) else 0.0
    return [
        _Panel('curvature of the\nfixed centrode (1/m)', curvature, straight, 4),
        _Panel('speed of the\nICR (m/s)', speed, least, 4),
    ]


def _draw_time(axis: Any, body: Body, panel: _Panel, start: int, instant: int) -> None:
    axis.grid(True, linewidth=0.3)
    axis.axvline((instant - start) * 1e-9, color=_GRAY, linestyle='--', linewidth=0.8)
    axis.ticklabel_format(useOffset=False)
    axis.set_ylabel(panel.label)
    share = len(panel.series.stamp) / len(body.stamp) if panel.series is not None else 0.0
    if share < 0.9:
        percent = f'{share:.0%}' if share >= 0.01 else 'less than 1%'
        text = f'determined at {percent} of the instants' if share else 'undetermined'
        axis.text(0.02, 0.96, text, transform=axis.transAxes, va='top', fontsize='small', zorder=5)
    if panel.series is None or not share:
        axis.set_yticks([])
        return
    breaks = _breaks(body, panel.series.stamp)
    time, _ = _broken((panel.series.stamp - start) * 1e-9, breaks)
    value, alone = _broken(panel.series.value, breaks)
    axis.plot(time, value, '-', color=_BLUE, linewidth=1, marker='.', markevery=alone, markersize=4)
    if panel.sigma is not None:
        band, _ = _broken(2 * panel.sigma, breaks)
        axis.fill_between(time, value - band, value + band, **_BAND)
    low, high = np.percentile(panel.series.value, [panel.cut, 100 - panel.cut])
    if low > 0 and high > _LOG_FACTOR * low:
        axis.set_yscale('log')
        axis.set_ylim(low / 1.5, high * 1.5)
    elif (spare := max(0.12 * (high - low), (panel.least - (high - low)) / 2)) > 0:
        axis.set_ylim(low - spare, high + spare)


def _legend(figure: Any, relative: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def symbol(
        marker: str, text: str, fill: str = _BLACK, color: str = _BLACK, size: float = 7
    ) -> Any:
        shape: dict[str, Any] = {
            'marker': marker,
            'markersize': size,
            'color': color,
            'markerfacecolor': fill,
        }
        return Line2D([], [], linestyle='', label=text, **shape)

    handles = [
        Line2D([], [], label='path of the origin', **_PATH),
        Line2D([], [], label='fixed centrode', **_FIXED),
        Line2D([], [], label='moving centrode', **_MOVING),
        symbol('+', "origin of the body's frame"),
        *(
            symbol(marker, _POLE_TEXT[pole], _BLACK if pole == 'icr' else 'white')
            for pole, (marker, _) in _POLES.items()
        ),
        symbol('$\u2192$', 'direction of the ICR velocity u', size=13),
        Patch(facecolor='#dddddd', edgecolor=_BLACK, label='2σ of a pole'),
        Patch(label='2σ of ω', **_BAND),
    ]
    if relative:
        handles += [
            symbol('D', 'relative instant center', 'white', _GREEN),
            Line2D([], [], label='its locus', **_RELATIVE),
        ]
    figure.legend(handles=handles, loc='outside lower center', ncol=4, frameon=False)
