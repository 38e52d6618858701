"""
The picture of a bag of results.

Each body has a row: the linkage with both centrodes and the poles of one instant, the angular
rates, and the motion of the ICR along the fixed centrode.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.tools.plot import _instant, _style, _time
from kinpole_ros.tools.record.record import MotionRecord, Series, joints_of, pairs_of
from kinpole_ros.tools.record.result_bag import read_record, read_truth

_MOST_BODIES = 4
_READING = 0.9  # fraction of the time that reading takes
_WIDTH, _ROW_HEIGHT, _DPI = 12.0, 4.3, 150  # inches; 1800 px wide
_POLE_LABELS = {
    'icr': 'ICR (velocity pole)',
    'iap': 'IAP (acceleration pole)',
    'ijp': 'IJP (jerk pole)',
}


def plot(
    bag: str | Path,
    output: str | Path,
    progress: Callable[[float], None] | None = None,
    truth: str | Path | None = None,
) -> str:
    """
    Draw the results in a bag to `output`, in the format of its ending: png, pdf, svg or others.

    `progress` is called with the fraction done; `truth` is the bag of `kinpole simulate` whose
    exact motion is drawn too. Returns where a truncated bag ends, '' for a complete bag. Raises
    BagError if there are no results, `output` cannot be written or matplotlib is missing.
    """
    reading = None if progress is None else lambda share: progress(_READING * share)
    with _style.saved_figure(output, (_WIDTH, 1), _DPI) as figure:
        record = read_record(bag, reading)
        exact = {} if truth is None else read_truth(truth, record)
        # A file name need not be text.
        name = os.fsencode(Path(bag).name).decode(errors='replace')
        _draw(figure, name, record, exact)
    if progress is not None:
        progress(1.0)
    return record.cut


def _draw(figure: Any, bag: str, record: MotionRecord, exact: dict[str, dict[str, Series]]) -> None:
    seen = [b for b in record.bodies if np.isfinite(record.columns[b, 'position']).any()]
    bodies, joints = seen[:_MOST_BODIES], joints_of(record)
    figure.set_size_inches(_WIDTH, 1.5 + _ROW_HEIGHT * len(bodies))
    known = [np.isfinite(record.columns[body, 'position']) for body in bodies]
    start, end = record.stamp[np.any(known, axis=0)][[0, -1]].tolist()
    scopes = [_instant.scope_of(record, body) for body in bodies]
    k = _instant.instant_of(scopes, (start + end) // 2)
    instant = int(record.stamp[k])
    lost, omitted = record.lost, ', '.join(seen[_MOST_BODIES:])
    figure.suptitle(
        f'{bag}: {", ".join(bodies)}'
        + (f' (not drawn: {omitted})' if omitted else '')
        + f'\n{(end - start) * 1e-9:.3g} s from stamp {start * 1e-9:.3f} s'
        + (f', {lost} frames lost' if lost else '')
        + (', bag cut off' if record.cut else '')
        + f'; poles and moving centrode at t = {(instant - start) * 1e-9:.3f} s',
        parse_math=False,
    )
    columns: tuple[list[Any], ...] = ([], [], [])
    grid = figure.add_gridspec(len(bodies), 3, width_ratios=[1.2, 1, 1])
    figure.get_layout_engine().set(w_pad=0.12)
    for row, scope in enumerate(scopes):
        axis = figure.add_subplot(grid[row, 0])
        _instant.draw_plane(axis, scope, joints, k)
        # Between rows it would touch the name of the next body.
        axis.set_xlabel(f'{record.along[0]} (m)' if row == len(scopes) - 1 else '')
        axis.set_ylabel(f'{record.along[1]} (m)')
        columns[0].append(axis)
        body, truth = scope.body, exact.get(scope.body, {})
        for column, make in enumerate((_time.rate_panels, _time.centrode_panels), start=1):
            panels = make(record, body, truth)
            inner = grid[row, column].subgridspec(
                2 * len(panels), 1, height_ratios=[3.0, 1.0] * len(panels)
            )
            shared = None
            for n, panel in enumerate(panels):
                axis = shared = figure.add_subplot(inner[2 * n], sharex=shared)
                strip = figure.add_subplot(inner[2 * n + 1], sharex=shared)
                _time.draw_panel((axis, strip), record, body, panel, start, instant)
                columns[column].append(axis)
                axis.tick_params(labelbottom=False)
                strip.tick_params(labelbottom=n == len(panels) - 1)
                if end > start:
                    axis.set_xlim(0, (end - start) * 1e-9)
            strip.set_xlabel('t (s)')
    for axes in columns:
        figure.align_ylabels(axes)
    has_events = any(record.events.get(body) for body in bodies)
    _add_legend(figure, bool(pairs_of(record)), bool(exact), has_events, bool(lost))


def _add_legend(figure: Any, relative: bool, exact: bool, events: bool, lost: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def symbol(
        marker: str,
        label: str,
        fill: str = _style.BLACK,
        color: str = _style.BLACK,
        size: float = 7,
    ) -> Any:
        style: Any = {'marker': marker, 'markersize': size, 'color': color}
        return Line2D([], [], linestyle='', label=label, markerfacecolor=fill, **style)

    handles = [
        Patch(label='the body, through its markers and pins', **_style.LINK),
        Line2D([], [], label='path of the origin', **_style.PATH),
        Line2D([], [], label='fixed centrode', **_style.FIXED),
        Line2D([], [], label='moving centrode', **_style.MOVING),
        symbol('+', "origin of the body's frame"),
        *(
            symbol(marker, _POLE_LABELS[pole], _style.BLACK if pole == 'icr' else 'white')
            for pole, (marker, _) in _style.POLES.items()
        ),
        symbol('$\u2192$', 'direction of the ICR velocity u', size=13),
        Patch(facecolor='#dddddd', edgecolor=_style.BLACK, label='2σ of a pole'),
        Line2D([], [], label='estimate', **_style.ESTIMATE),
        Patch(label='±2σ; below each curve at its own scale', **_style.BAND),
    ]
    if relative:
        handles += [
            symbol('D', 'relative instant center', 'white', _style.GREEN),
            Line2D([], [], label='its locus', **_style.RELATIVE),
        ]
    if events:
        label = 'event: velocity, acceleration or jerk steps'
        handles.append(Line2D([], [], label=label, **_style.EVENT))
    if lost:
        handles.append(Patch(label='lost: frames without any result', **_style.LOST))
    if exact:
        handles.append(Line2D([], [], label='exact answer', **_style.THIN))
        handles.append(Line2D([], [], label='error, in the band', **_style.THIN))
    figure.legend(handles=handles, loc='outside lower center', ncol=4, frameon=False)
