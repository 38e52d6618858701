"""All charts of both pages, each made where there are rows for it."""

from collections.abc import Callable
from pathlib import Path

from bench import _charts as charts
from bench import _charts_first as first
from bench._overview import pareto_points, troubles
from bench._rows import Rows, writing


def draw_charts(tables: dict[str, Rows], folder: Path) -> list[Path]:
    """Draw in the `folder`, of rows by name of their table; returns the files written."""
    draws: dict[str, tuple[tuple[str, ...], Callable[[Path], None]]] = {
        'pareto': (
            ('peers', 'costs'),
            lambda path: first.pareto(
                pareto_points(tables['peers'], tables['costs'], tables.get('pynumdiff', [])), path
            ),
        ),
        'strip': (('rigs',), lambda path: first.strip(troubles(tables['rigs']), path)),
        'model': (
            ('model', 'model_over_time'),
            lambda path: first.model(tables['model'], tables['model_over_time'], path),
        ),
        'hindsight': (('hindsight',), lambda path: charts.hindsight(tables['hindsight'], path)),
        'error_over_lag': (
            ('error_over_lag',),
            lambda path: charts.error_over_lag(tables['error_over_lag'], path),
        ),
        'atlas': (('atlas',), lambda path: charts.atlas(tables['atlas'], path)),
        'atlas_higher': (
            ('atlas',),
            lambda path: charts.atlas(tables['atlas'], path, ('IAP', 'κ')),
        ),
    }
    written = []
    for name, (needed, draw) in draws.items():
        if all(tables.get(table) for table in needed):
            path = folder / f'{name}.png'
            with writing(path):
                draw(path)
            written.append(path)
    return written
