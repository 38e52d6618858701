"""
`kinpole bench`: measure, keep the figures as CSV files, and make the pages and charts of these.

What is not measured this time is quoted as it was measured before.
"""

import os
import platform
import time
from collections.abc import Callable, Collection, Iterable
from pathlib import Path

import numpy as np

from bench._draw import draw_charts
from bench._long import long_run
from bench._page import make_page
from bench._page_tables import make_tables
from bench._parts import PARTS
from bench._rows import Rows, read_rows, write_rows, writing
from bench._soak import soak, soak_rows
from kinpole_ros.bags import BagError

_RUN, _LONG, _SOAK = 'run', 'long', 'soak'


def bench(
    output: str | Path,
    quick: bool = False,
    progress: Callable[[float], None] | None = None,
    only: Collection[str] = tuple(PARTS),
) -> list[Path]:
    """
    Measure `only` some of `PARTS` and write both pages and `charts/` in the folder `output`.

    `quick` takes few seeds and short records: it shows that all works, not how well. Returns the
    files written. Raises OSError where they cannot be, ImportError where matplotlib is missing, and
    BagError for a part that there is not.
    """
    import matplotlib  # noqa: F401 - before minutes of work are lost for want of it

    unknown = [name for name in only if name not in PARTS]
    if unknown:
        raise BagError(f'--only: there is no part {unknown[0]!r}; parts: {", ".join(PARTS)}')
    charts = _charts(output)
    # Before it is our own.
    load = os.getloadavg()[0]
    chosen = [name for name in PARTS if name in only]
    tell = progress_of_parts(progress or (lambda share: None), quick, chosen)
    written: list[Path] = []
    for name in chosen:
        begun = time.monotonic()
        tell(name)(0.0)
        tables = PARTS[name].rows(quick, tell(name))
        tell(name)(1.0)
        for table, rows in tables.items():
            written.append(charts / f'{table}.csv')
            write_rows(written[-1], rows)
        if tables:
            _note_run(charts, name, tables, quick, time.monotonic() - begun, load)
    return written + make_pages(output)


def make_pages(output: str | Path) -> list[Path]:
    """Both pages and the charts, of all that is in `charts/` of the folder `output`."""
    folder, charts = Path(output), _charts(output)
    tables = {path.stem: read_rows(path) for path in sorted(charts.glob('*.csv'))}
    written = draw_charts(tables, charts)
    for name, make in (('benchmarks.md', make_page), ('benchmarks-tables.md', make_tables)):
        with writing(folder / name):
            (folder / name).write_text(make(tables), encoding='utf-8')
        written.append(folder / name)
    return written


def progress_of_parts(
    progress: Callable[[float], None], quick: bool, chosen: Collection[str] = tuple(PARTS)
) -> Callable[[str], Callable[[float], None]]:
    """Progress of a part by its name: its share done, as a share of all that are chosen."""
    names = list(chosen)
    seconds = [PARTS[name].seconds[quick] for name in names]

    def part(name: str) -> Callable[[float], None]:
        number = names.index(name)
        before, own = sum(seconds[:number]), seconds[number]
        # Parts that take no time are done at once.
        return lambda share: progress((before + share * own) / max(sum(seconds), 1e-9))

    return part


def bench_long(output: str | Path, progress: Callable[[float], None] | None = None) -> list[Path]:
    """
    Run ten million frames through one tracker and write `charts/long.csv` in the folder `output`.

    Some minutes. The page quotes it from the next `bench` on. Raises OSError where it cannot be
    written.
    """
    return _alone(output, _LONG, lambda: long_run(progress=progress))


def bench_soak(
    output: str | Path, minutes: float, progress: Callable[[float], None] | None = None
) -> list[Path]:
    """
    Run the live node for so long and write `charts/soak.csv` in the folder `output`.

    The page quotes it from the next `bench` on. Raises OSError where it cannot be written, if the
    node ends or does not answer, and BagError for minutes that are none.
    """
    if not 0 < minutes < np.inf:
        raise BagError(f'--soak is {minutes}; it must be more than 0 minutes')
    return _alone(output, _SOAK, lambda: soak_rows(soak(minutes, progress)))


def _alone(output: str | Path, name: str, measured: Callable[[], Rows]) -> list[Path]:
    charts, load, begun = _charts(output), os.getloadavg()[0], time.monotonic()
    path = charts / f'{name}.csv'
    write_rows(path, measured())
    _note_run(charts, name, (name,), False, time.monotonic() - begun, load)
    return [path]


def _charts(output: str | Path) -> Path:
    folder = Path(output) / 'charts'
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _note_run(
    charts: Path, part: str, tables: Iterable[str], quick: bool, seconds: float, load: float
) -> None:
    """When and where a part was measured: a row of `run.csv`, in place of its last one."""
    path = charts / f'{_RUN}.csv'
    row = {
        'part': part,
        'tables': ' '.join(tables),
        'seconds': seconds,
        'quick': quick,
        'load': load,
        'cores': os.cpu_count(),
        'day': time.strftime('%Y-%m-%d'),
        'python': f'Python {platform.python_version()}',
        'numpy': f'numpy {np.__version__}',
    }
    rows: Rows = [each for each in read_rows(path) if each['part'] != part] + [row]
    order = [*PARTS, _LONG, _SOAK]
    write_rows(path, sorted(rows, key=lambda each: order.index(each['part'])))
