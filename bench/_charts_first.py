"""
The three charts of the first screen: where we stand, where it breaks, which model it chose.

Legible on white in light and dark pages, and without color: marks, fills and words differ too.
"""

from pathlib import Path
from typing import Any

import numpy as np

from bench._overview import BOUND, Point, Trouble
from bench._rows import Rows

# Okabe and Ito's palette, which the color-blind can tell apart.
_OURS, _PEER, _TUNED = '#0072B2', '#D55E00', '0.45'
_WIDTH = 9.2
# Of errors in the Pareto chart; what is above it is drawn there.
_HIGHEST = 12.0
# Fills of the strip, from good to bad, and of what is withheld.
_LEVELS = ((BOUND, '#DCEBF5', '0.1'), (3.0, '#F5C98A', '0.1'), (np.inf, '#B23A0E', 'white'))
_WITHHELD = '0.88'
_NOISE_FILLS = ('#0072B2', '#8CC4E4', 'white')


def pareto(points: list[Point], path: Path) -> None:
    """Error over that of the best fixed window in hindsight, over CPU time a frame."""
    figure = _figure(5.2)
    left, right = figure.subplots(1, 2, sharey=True)
    ours = [point for point in points if point.group == 'ours']
    reach = [1e6 * t for p in points for t in (p.live, p.replay) if np.isfinite(t)]
    least, most = min(reach), max(reach)
    names = 'As anyone can run it', 'Given the truth, or offline'
    for panel, name, group in zip((left, right), names, ('peer', 'tuned'), strict=True):
        shown = [point for point in points if point.group == group]
        for point in shown:
            _dumbbell(panel, point, _PEER if group == 'peer' else _TUNED, 's')
        for point in ours:
            _dumbbell(panel, point, _OURS, 'o')
        panel.axhline(1.0, color='0.6', linewidth=1, linestyle=(0, (4, 3)), zorder=0)
        panel.set_xscale('log')
        panel.set_yscale('log')
        # Room for the names.
        panel.set_xlim(least / 2, most * (most / least) ** 0.95)
        panel.set_xticks([t for t in (1, 10, 100, 1000, 10_000) if least / 2 < t < 2 * most])
        panel.set_ylim(0.62 * min(point.median for point in points), 1.25 * _HIGHEST)
        ticks = (0.5, 0.7, 1, 1.5, 2, 3, 5, 10)
        panel.set_yticks(ticks, [f'{tick:g}' for tick in ticks])
        panel.xaxis.set_major_formatter(lambda value, _: f'{value:g}')
        panel.minorticks_off()
        panel.set_xlabel('CPU time a frame of one body, µs', loc='left')
        panel.grid(color='0.93', zorder=0)
        panel.spines[['top', 'right']].set_visible(False)
        panel.set_title(name, loc='left', fontweight='bold', fontsize=11)
        _label(panel, [*ours, *shown], 2.0 * most)
    left.set_ylabel('error over the best fixed window in hindsight\n(median of all cells)')
    for fill, text in (('0.3', 'live: frame by frame'), ('white', 'replay: many frames at once')):
        left.plot([], [], 'o', color='0.3', markerfacecolor=fill, label=text, markersize=7)
    figure.legend(loc='outside lower center', ncols=3, frameon=False, fontsize=9)
    _save(figure, path)


def _height(point: Point) -> float:
    return min(point.median, _HIGHEST)


def _dumbbell(panel: Any, point: Point, color: str, mark: str) -> None:
    """Replay, hollow, and live, filled, at one height; what is too high points up."""
    ends = [1e6 * point.replay, 1e6 * point.live]
    y = _height(point)
    mark = '^' if y < point.median else mark
    panel.plot(ends, [y, y], color=color, linewidth=1, alpha=0.6, zorder=1)
    for x, fill in zip(ends, ('white', color), strict=True):
        panel.plot(x, y, mark, color=color, markerfacecolor=fill, markersize=8, zorder=3)


def _label(panel: Any, points: list[Point], x: float) -> None:
    """Names in a column at `x`, each as near to the height of its point as there is room."""
    low, high = np.log(panel.get_ylim())
    # Of the height of the panel, what a line of text takes.
    step = 0.056 * (high - low)
    order = sorted(points, key=_height)
    wanted = np.log([_height(point) for point in order])
    places = spread(wanted, step, low, high)
    for point, wish, place in zip(order, wanted, places, strict=True):
        end = 1e6 * np.nanmax([point.live, point.replay])
        color = {'ours': _OURS, 'peer': _PEER}.get(point.group, '0.25')
        panel.plot([1.3 * end, 0.93 * x], np.exp([wish, place]), color='0.8', linewidth=0.7)
        figure = f'{point.median:.2g}' if point.median < 99.5 else f'{point.median:.0f}'
        panel.text(
            x,
            np.exp(place),
            f'{point.label}: {figure}',
            color=color,
            fontsize=8.5,
            fontweight='bold' if point.group == 'ours' else 'normal',
            va='center',
        )


def spread(wanted: np.ndarray, step: float, low: float, high: float) -> np.ndarray:
    """Places near those `wanted`, in rising order, a `step` from each other and inside."""
    places = np.array(wanted, float)
    for _ in range(1000):
        for k in range(len(places) - 1):
            close = step - (places[k + 1] - places[k])
            if close > 0:
                places[k] -= close / 2
                places[k + 1] += close / 2
        places = np.clip(places, low + step / 2, high - step / 2)
    return places


def strip(troubles: list[Trouble], path: Path) -> None:
    """A row by trouble, from a little of it to much: error over that with ideal input."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch, Rectangle

    figure = _figure(1.0 + 0.33 * len(troubles))
    panel = figure.subplots()
    for row, trouble in enumerate(troubles):
        for column, level in enumerate(trouble.levels):
            fill, ink = next((f, i) for top, f, i in _LEVELS if not level.ratio > top)
            text = f'{level.ratio:.2g}×' if level.ratio < 99.5 else f'{level.ratio:.0f}×'
            text = text if level.ratio < 1e3 else '>1000×'
            if level.withheld:
                fill, ink, text = _WITHHELD, '0.1', 'withheld'
            elif level.broken and not level.reported:
                text += ' !'
            corner = (column, row - 0.42)
            panel.add_patch(Rectangle(corner, 0.96, 0.84, facecolor=fill, edgecolor='0.75'))
            panel.text(column + 0.03, row, level.name, color=ink, va='center', fontsize=8.5)
            style = {'fontsize': 8.5, 'fontweight': 'bold' if level.broken else 'normal'}
            panel.text(column + 0.93, row, text, color=ink, va='center', ha='right', **style)
    panel.set_yticks(range(len(troubles)), [trouble.name for trouble in troubles], fontsize=9.5)
    panel.set_ylim(len(troubles) - 0.5, -0.5)
    panel.set_xlim(-0.02, max(len(trouble.levels) for trouble in troubles))
    panel.set_xticks([])
    panel.spines[:].set_visible(False)
    panel.tick_params(length=0)
    words = (f'error up to {BOUND:g}× the ideal', 'up to 3×', 'more', 'withheld')
    fills = (*(fill for _, fill, _ in _LEVELS), _WITHHELD)
    handles: list[Any] = [
        Patch(facecolor=fill, edgecolor='0.75', label=word)
        for word, fill in zip(words, fills, strict=True)
    ]
    bang = f'over {BOUND:g}× and not reported'
    handles.append(Line2D([], [], linestyle='none', marker='$!$', color='0.1', label=bang))
    figure.legend(handles=handles, loc='outside upper center', ncols=5, frameon=False, fontsize=9)
    _save(figure, path)


def model(rows: Rows, over_time: Rows, path: Path) -> None:
    """Parameters of the model that was chosen: by motion and noise, and over time."""
    figure = _figure(5.4)
    left, right = figure.subfigures(1, 2, width_ratios=(1.35, 1))
    panel = left.subplots()
    noises = sorted({row['noise'] for row in rows})
    middle = {row['motion']: row['parameters'] for row in rows if row['noise'] == noises[0]}
    motions = sorted(middle, key=lambda motion: middle[motion])
    for noise, fill in zip(noises, _NOISE_FILLS, strict=True):
        found = {row['motion']: row for row in rows if row['noise'] == noise}
        place = np.arange(len(motions)) + 0.24 * (noises.index(noise) - 1)
        low, mid, high = (
            [found[motion][what] for motion in motions] for what in ('low', 'parameters', 'high')
        )
        panel.hlines(place, low, high, color=_OURS, linewidth=1)
        panel.plot(
            mid,
            place,
            'o^s'[noises.index(noise)],
            color=_OURS,
            markerfacecolor=fill,
            markersize=6,
            label=f'noise {noise:g} of the body',
        )
    panel.axvline(2, color='0.6', linewidth=1, linestyle=(0, (4, 3)), zorder=0)
    panel.text(2.05, len(motions) - 0.45, 'a steady turn', fontsize=8.5, color='0.3')
    panel.set_yticks(range(len(motions)), motions)
    panel.set_ylim(-0.6, len(motions) - 0.1)
    panel.set_xscale('log')
    ticks = (1, 2, 3, 5, 10, 20, 50, 100)
    panel.set_xticks(ticks, [f'{tick}' for tick in ticks])
    panel.minorticks_off()
    panel.set_xlabel('parameters of the model in a window of 0.5 s\n(median; 10 to 90% of frames)')
    panel.grid(axis='x', color='0.92', zorder=0)
    panel.spines[['top', 'right']].set_visible(False)
    panel.legend(loc='lower right', fontsize=8.5, frameon=True, framealpha=1, edgecolor='0.9')
    names = list(dict.fromkeys(row['motion'] for row in over_time))
    for each, motion in zip(np.atleast_1d(right.subplots(len(names), 1)), names, strict=True):
        mine = [row for row in over_time if row['motion'] == motion]
        t = [row['t'] for row in mine]
        each.plot(t, [row['parameters'] for row in mine], color=_OURS, linewidth=1.8)
        each.set_ylabel('parameters', color=_OURS, fontsize=9)
        each.set_ylim(0, None)
        other = each.twinx()
        other.plot(t, [row['omega'] for row in mine], color='0.5', linewidth=1, linestyle='--')
        other.set_ylabel('true ω, rad/s (dashed)', color='0.4', fontsize=9)
        each.set_title(f'{motion}, noise {noises[1]:g}', fontsize=9.5, loc='left')
        for part in (each, other):
            part.spines['top'].set_visible(False)
            part.tick_params(labelsize=8.5)
    each.set_xlabel('t, s', fontsize=9)
    _save(figure, path)


def _figure(height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(_WIDTH, height), layout='constrained', facecolor='white')


def _save(figure: Any, path: Path) -> None:
    # Without the version of the program the same figures give the same file.
    figure.savefig(path, dpi=130, metadata={'Software': None})
