"""
A picture of a result bag, for who wants to see at once what the mechanism did.

One row per body: the linkage in the plane with both centrodes and the poles of one instant, the
rates of turning, and how the ICR runs along the fixed centrode.
"""

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from kinpole_ros.bags import in_place_of
from kinpole_ros.tools.plot import _plane, _time
from kinpole_ros.tools.plot._read import Results, Series, read_results, read_truth
from kinpole_ros.tools.plot._style import (
    BAND,
    BLACK,
    ERROR,
    ESTIMATE,
    FIXED,
    GREEN,
    LINK,
    MOVING,
    PATH,
    POLES,
    RELATIVE,
    TRUTH,
    picture_format,
)

_MOST_BODIES = 4  # each has a row of the picture
_READING = 0.9  # of the time, the rest is drawing
_WIDTH, _ROW_HEIGHT, _DPI = 12.0, 4.3, 150  # inches; 1800 px across
_POLE_TEXT = {
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
    Draw the results in `bag` (an .mcap file or a rosbag2 folder) to `output`.

    The format goes by the suffix of `output`: png, pdf, svg or whatever else matplotlib writes;
    folders above it are made. `progress` is called with the share done, by time. `truth` is the bag
    that `kinpole simulate` made, whose exact answers are drawn too. Returns what a bag that is not
    whole lacks, '' for one that is. Raises BagError when the bag holds no results, `output` cannot
    be written or matplotlib is missing.
    """
    kind = picture_format(output)
    from matplotlib.figure import Figure

    # A Figure of its own, without pyplot: whoever draws in the same process keeps his state.
    figure = Figure(figsize=(_WIDTH, 1), layout='constrained')
    reading = None if progress is None else lambda share: progress(_READING * share)
    results = read_results(bag, reading)
    exact = {} if truth is None else read_truth(truth, results)
    # A file name need not be text.
    _draw(figure, os.fsencode(Path(bag).name).decode(errors='replace'), results, exact)
    with in_place_of(output) as part, warnings.catch_warnings():
        # A letter that the font lacks is drawn as a box.
        warnings.filterwarnings('ignore', 'Glyph .* missing from', UserWarning)
        figure.savefig(part, format=kind, dpi=_DPI)
    if progress is not None:
        progress(1.0)
    return results.cut


def _draw(figure: Any, bag: str, results: Results, exact: dict[str, dict[str, Series]]) -> None:
    bodies = results.bodies[:_MOST_BODIES]
    figure.set_size_inches(_WIDTH, 1.5 + _ROW_HEIGHT * len(bodies))
    start = min(int(body.stamp[0]) for body in bodies)
    end = max(int(body.stamp[-1]) for body in bodies)
    all_shown = [_plane.shown(body) for body in bodies]
    instant = _plane.instant_of(all_shown, (start + end) // 2)
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
    for row, (body, one) in enumerate(zip(bodies, all_shown, strict=True)):
        axis = figure.add_subplot(grid[row, 0])
        _plane.draw_plane(axis, one, instant, results)
        axis.set_xlabel(f'{results.along[0]} (m)')
        axis.set_ylabel(f'{results.along[1]} (m)')
        columns[0].append(axis)
        truth = exact.get(body.name, {})
        for column, panels in ((1, _time.rates(body, truth)), (2, _time.run(body, truth))):
            heights = [part for _ in panels for part in (len(columns), 1.0)]
            inner = grid[row, column].subgridspec(2 * len(panels), 1, height_ratios=heights)
            shared = None
            for k, panel in enumerate(panels):
                axis = shared = figure.add_subplot(inner[2 * k], sharex=shared)
                strip = figure.add_subplot(inner[2 * k + 1], sharex=shared)
                _time.draw(axis, strip, body, panel, start, instant)
                columns[column].append(axis)
                axis.tick_params(labelbottom=False)
                strip.tick_params(labelbottom=k == len(panels) - 1)
                if end > start:
                    axis.set_xlim(0, (end - start) * 1e-9)
            strip.set_xlabel('t (s)')
    for axes in columns.values():
        figure.align_ylabels(axes)
    _legend(figure, bool(results.relative), bool(exact))


def _legend(figure: Any, relative: bool, exact: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def symbol(
        marker: str, text: str, fill: str = BLACK, color: str = BLACK, size: float = 7
    ) -> Any:
        shape: dict[str, Any] = {
            'marker': marker,
            'markersize': size,
            'color': color,
            'markerfacecolor': fill,
        }
        return Line2D([], [], linestyle='', label=text, **shape)

    handles = [
        Patch(label='the body, through its markers and pins', **LINK),
        Line2D([], [], label='path of the origin', **PATH),
        Line2D([], [], label='fixed centrode', **FIXED),
        Line2D([], [], label='moving centrode', **MOVING),
        symbol('+', "origin of the body's frame"),
        *(
            symbol(marker, _POLE_TEXT[pole], BLACK if pole == 'icr' else 'white')
            for pole, (marker, _) in POLES.items()
        ),
        symbol('$\u2192$', 'direction of the ICR velocity u', size=13),
        Patch(facecolor='#dddddd', edgecolor=BLACK, label='2σ of a pole'),
        Line2D([], [], label='estimate', **ESTIMATE),
        Patch(label='±2σ; below each curve at its own scale', **BAND),
    ]
    if relative:
        handles += [
            symbol('D', 'relative instant center', 'white', GREEN),
            Line2D([], [], label='its locus', **RELATIVE),
        ]
    if exact:
        handles.append(Line2D([], [], label='exact answer', **TRUTH))
        handles.append(Line2D([], [], label='error, in the band', **ERROR))
    figure.legend(handles=handles, loc='outside lower center', ncol=4, frameon=False)
