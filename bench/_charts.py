"""The charts of the tables, readable in black and white: marks and lines differ, not colors."""

from pathlib import Path
from typing import Any

import numpy as np

from bench._record import QUANTITIES
from bench._rows import Rows

_MARKS = 'osD^v<>PXhp*'
_LINES = ('-', '--', ':', '-.')
_TICKS = (0.3, 0.5, 1, 1.5, 2, 3, 5, 10)
_GRAYS = ('0.0', '0.45', '0.65')


def error_over_lag(rows: Rows, path: Path) -> None:
    """Error against lag, one panel by quantity."""
    figure, panels = _panels()
    methods = list(dict.fromkeys(row['method'] for row in rows))
    for name, panel in zip(QUANTITIES, panels, strict=False):
        for k, method in enumerate(methods):
            mine = [row for row in rows if row['method'] == method]
            panel.plot(
                [row['lag'] for row in mine],
                [row[name] for row in mine],
                _LINES[k % len(_LINES)],
                marker=_MARKS[k % len(_MARKS)],
                color=_GRAYS[k % 3],
                label=method,
                linewidth=2.2 if method == 'ours' else 1.0,
                markerfacecolor='black' if method == 'ours' else 'white',
            )
        _scaled(panel, name, 'lag, s', 'error over ours at 0.1 s')
        panel.set_xscale('linear')
    _finish(figure, panels, path)


def hindsight(rows: Rows, path: Path) -> None:
    """Error over the best in hindsight, one panel by quantity, one row of marks by noise level."""
    figure, panels = _panels()
    names = list(dict.fromkeys(row['motion'] for row in rows))
    noises = sorted({row['noise'] for row in rows})
    for name, panel in zip(QUANTITIES, panels, strict=False):
        for k, noise in enumerate(noises):
            found = {
                r['motion']: r['ratio']
                for r in rows
                if (r['quantity'], r['noise']) == (name, noise)
            }
            panel.plot(
                range(len(names)),
                [max(found.get(motion, np.nan), 0.3) for motion in names],
                linestyle='none',
                marker=_MARKS[k],
                color=_GRAYS[k % 3],
                markerfacecolor='white' if k else 'black',
                label=f'noise {noise:g} of the body',
            )
        panel.axhline(1.5, color='0.3', linestyle='--', linewidth=0.8)
        panel.axhline(1.0, color='0.7', linewidth=0.8)
        panel.set_yscale('log')
        panel.set_ylim(0.25, max(15.0, 1.2 * np.nanmax([row['ratio'] for row in rows])))
        panel.set_yticks(_TICKS, [f'{tick:g}' for tick in _TICKS])
        panel.minorticks_off()
        panel.set_title(name)
        panel.set_xticks(range(len(names)), names, rotation=50, ha='right', fontsize=7)
        panel.set_ylabel('error over the best in hindsight', fontsize=8)
    _finish(figure, panels, path)


def atlas(rows: Rows, path: Path, names: tuple[str, ...] = ('ω', 'ICR')) -> None:
    """Error (above) and share determined (below) as each thing goes to its limit."""
    from matplotlib.figure import Figure

    limits = list(dict.fromkeys(row['limit'] for row in rows))
    figure = Figure(figsize=(12, 4.6 * ((len(limits) + 2) // 3)), layout='constrained')
    outer = figure.subfigures((len(limits) + 2) // 3, 3, squeeze=False).ravel()
    for part, limit in zip(outer, limits, strict=False):
        above, below = part.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        above.set_yscale('log')
        mine = [row for row in rows if row['limit'] == limit]
        mine.sort(key=lambda row: float(row['value']))
        x = np.arange(len(mine))
        for name, style in zip(names, ('ok-', 's:k'), strict=True):
            errors = np.array([row.get(f'{name}_error', np.nan) for row in mine])
            errors[errors == 0] = np.nan
            above.plot(x, errors, style, label=name, markerfacecolor='white')
            told = [row.get(f'{name}_determined', 0.0) for row in mine]
            below.plot(x, told, style, markerfacecolor='white')
        below.set_xticks(x, [f'{row["value"]:g}' for row in mine], fontsize=7)
        # What is flat shall look flat.
        low, high = above.get_ylim()
        wider = max(1.0, np.sqrt(100 * low / high))
        above.set_ylim(low / wider, high * wider)
        above.set_ylabel('median error, relative', fontsize=8)
        below.set_ylim(-0.05, 1.05)
        below.set_ylabel('share determined', fontsize=8)
        unit = next(row['unit'] for row in rows if row['limit'] == limit)
        below.set_xlabel(f'{limit} ({unit})', fontsize=9)
    first = outer[0].axes[0]
    figure.legend(*first.get_legend_handles_labels(), loc='outside upper center', ncols=4)
    _save(figure, path)


def _panels() -> tuple[Any, list[Any]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 7.5), layout='constrained')
    panels = list(figure.subplots(2, 4).ravel())
    panels[-1].axis('off')
    return figure, panels


def _scaled(panel: Any, title: str, x: str, y: str) -> None:
    panel.set_xscale('log')
    panel.set_yscale('log')
    panel.set_title(title)
    panel.set_xlabel(x, fontsize=8)
    panel.set_ylabel(y, fontsize=8)


def _finish(figure: Any, panels: list[Any], path: Path) -> None:
    handles, labels = panels[0].get_legend_handles_labels()
    panels[-1].legend(handles, labels, loc='center', fontsize=9, frameon=False)
    _save(figure, path)


def _save(figure: Any, path: Path) -> None:
    # Without the version of the program the same figures give the same file.
    figure.savefig(path, dpi=110, metadata={'Software': None})
