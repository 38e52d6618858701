"""
`kinpole bench`: all measurements, as tables beside charts.

Seeds are fixed: except for the times everything comes out the same again.
"""

import csv
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bench import _charts as charts
from bench._atlas import survey
from bench._bounds import bounds
from bench._hindsight import (
    best_fixed,
    counted,
    coverage,
    own_errors,
    pooled_rms,
)
from bench._live import live_rows, measure_live, start_rows
from bench._long import long_run
from bench._motions import motions, other_motions
from bench._outcome import rig_rows
from bench._page import Results, make_page
from bench._page_rigs import TITLE, rigs_part
from bench._peers import (
    OURS,
    Table,
    costs,
    equal_lag,
    median_over_ours,
    over_lag,
    pynumdiff_errors,
)
from bench._pendulum import TABLE, pendulum
from bench._record import NOISES, QUANTITIES, RATE, UNITS, make_recording, measure
from bench._rigs import rigs
from bench._soak import soak, soak_rows
from bench._speed import speed_rows
from kinpole_ros.bags import BagError

Rows = list[dict[str, Any]]
_LONG, _SOAK = 'long.csv', 'soak.csv'
# What each part takes, in full and quick, s, for whoever watches it go on. As measured once on two
# busy cores; PyNumDiff and the pendulum were not at hand and are guessed.
_SECONDS = {
    'costs': (15, 2),
    'speed': (202, 16),
    'live': (342, 86),
    'hindsight': (33, 2),
    'other motions': (20, 2),
    'equal lag': (12, 4),
    'over lag': (14, 2),
    'PyNumDiff': (60, 0),
    'atlas': (98, 11),
    'pendulum': (10, 0),
    'rigs': (110, 9),
}


def hindsight_table(
    names: tuple[str, ...], noises: tuple[float, ...], seeds: int, seconds: float
) -> tuple[Rows, Rows, Rows]:
    """
    Rows of our errors over the best fixed (window, degree) in hindsight, of coverage and of bounds.

    By motion, noise and quantity; ratio NaN where too few frames are determined.
    """
    recording = make_recording(names, noises, seeds, seconds)
    ours = measure(recording)
    where = counted(recording, ours)
    own = own_errors(recording, ours)
    errors = pooled_rms(recording, own, where)
    best = best_fixed(recording, ours.frames, where)
    rows = []
    for (motion, noise, quantity), error in errors.items():
        least, samples, degree, _ = best.get((motion, noise, quantity), (np.nan, 0, 0, None))
        rows.append(
            {
                'motion': motion,
                'noise': noise,
                'quantity': quantity,
                'unit': UNITS[quantity],
                'ours': error,
                'best': least,
                'samples': samples,
                'degree': degree,
                'ratio': error / least,
            }
        )
    return rows, coverage(recording, ours), bounds(recording, ours.frames, own, where, best)


def bench(
    output: str | Path, quick: bool = False, progress: Callable[[float], None] | None = None
) -> list[Path]:
    """
    Measure everything and write `benchmarks.md` and `charts/` in the folder `output`.

    `quick` takes few seeds and short records: it shows that all works, not how well. Returns the
    files written. Raises OSError where they cannot be, ImportError where matplotlib is missing.
    """
    import matplotlib  # noqa: F401 - before minutes of work are lost for want of it

    begun = time.monotonic()
    folder = Path(output)
    (folder / 'charts').mkdir(parents=True, exist_ok=True)
    names = tuple(motions())
    tell = progress_of_parts(progress or (lambda share: None), quick)
    written: list[Path] = []

    def write(name: str, rows: Rows, draw: Callable[[Rows, Path], None] | None) -> None:
        path = folder / 'charts' / f'{name}.csv'
        _write_csv(path, rows)
        written.append(path)
        if draw is not None:
            with _writing(path.with_suffix('.png')):
                draw(rows, path.with_suffix('.png'))
            written.append(path.with_suffix('.png'))

    spent = costs(1 if quick else 5)
    fast = speed_rows(quick, tell('speed'))
    little: dict[str, Any] = {'seconds': 1.0, 'runs': 1, 'step_up': 4.0} if quick else {}
    live = measure_live(**little, progress=tell('live'))
    fast += start_rows(live)
    write('speed', fast, None)
    answered = live_rows(live)
    write('live', answered, None)
    tell('hindsight')(0.0)
    ratios, covered, bounded = hindsight_table(names, NOISES, *((1, 3.0) if quick else (9, 6.0)))
    write('hindsight', ratios, charts.hindsight)
    write('coverage', covered, None)
    write('bounds', bounded, None)
    tell('other motions')(0.0)
    some = tuple(other_motions())
    others, *_ = hindsight_table(some, NOISES, *((1, 3.0) if quick else (3, 6.0)))
    write('hindsight_others', others, None)
    tell('equal lag')(0.0)
    tables = equal_lag(make_recording(names, NOISES, *((1, 3.0) if quick else (2, 6.0))))
    tell('over lag')(0.0)
    lags = (0, 20) if quick else (0, 2, 5, 10, 20, 40)
    lagged = over_lag(names, lags, *((1, 3.0) if quick else (2, 6.0)))
    tell('PyNumDiff')(0.0)
    few = names[:1] if quick else names
    offline, offline_costs, version = pynumdiff_errors(make_recording(few, NOISES[1:2], 1, 4.5))
    spent |= offline_costs
    write('peers', _peer_rows(tables) + _peer_rows(offline)[len(offline.get(OURS, ())) :], None)
    timed = _time_rows(tables, spent) + _time_rows(offline, spent)[1:]
    write('error_over_time', timed, charts.error_over_time)
    write('error_over_lag', _lag_rows(lagged), charts.error_over_lag)
    cells = survey(quick, tell('atlas'))
    write('atlas', cells, charts.atlas)
    written.append(folder / 'charts' / 'atlas_higher.png')
    with _writing(written[-1]):
        charts.atlas(cells, written[-1], ('IAP', 'κ'))
    tell('pendulum')(0.0)
    # Its data do not come with the project, and it takes long.
    swung: Rows = []
    if TABLE.exists() and not quick:
        swung = pendulum()
        write('pendulum', swung, None)
    tell('pendulum')(1.0)
    rigged = _measure_rigs(quick, tell('rigs'))
    write('rigs', rigged, charts.rigs)

    page = folder / 'benchmarks.md'
    results = Results(
        time.monotonic() - begun,
        quick,
        ratios,
        others,
        bounded,
        covered,
        tables,
        offline,
        version,
        swung,
        rigged,
        spent,
        cells,
        fast,
        answered,
        _read_csv(folder / 'charts' / _LONG),
        _read_csv(folder / 'charts' / _SOAK),
    )
    with _writing(page):
        page.write_text(make_page(results), encoding='utf-8')
    return [page, *written]


def progress_of_parts(
    progress: Callable[[float], None], quick: bool
) -> Callable[[str], Callable[[float], None]]:
    """Progress of a part by its name: its share done, as a share of the whole run."""
    seconds = {name: both[quick] for name, both in _SECONDS.items()}
    whole = sum(seconds.values())
    names = list(seconds)

    def part(name: str) -> Callable[[float], None]:
        before = sum(seconds[earlier] for earlier in names[: names.index(name)])
        return lambda share: progress((before + share * seconds[name]) / whole)

    return part


def bench_long(output: str | Path, progress: Callable[[float], None] | None = None) -> list[Path]:
    """
    Run ten million frames through one tracker and write `charts/long.csv` in the folder `output`.

    Some minutes. The page quotes it from the next `bench` on. Raises OSError where it cannot be
    written.
    """
    path = Path(output) / 'charts' / _LONG
    path.parent.mkdir(parents=True, exist_ok=True)
    _write_csv(path, long_run(progress=progress))
    return [path]


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
    path = Path(output) / 'charts' / _SOAK
    path.parent.mkdir(parents=True, exist_ok=True)
    _write_csv(path, soak_rows(soak(minutes, progress)))
    return [path]


def bench_rigs(
    output: str | Path, quick: bool = False, progress: Callable[[float], None] | None = None
) -> list[Path]:
    """
    Measure what real rigs send: `charts/rigs.csv`, its chart, and its section of `benchmarks.md`.

    Returns the files written in the folder `output`; a page that is not there is not begun. Raises
    OSError where they cannot be written, ImportError where matplotlib is missing.
    """
    import matplotlib  # noqa: F401 - before minutes of work are lost for want of it

    folder = Path(output)
    (folder / 'charts').mkdir(parents=True, exist_ok=True)
    rows = _measure_rigs(quick, progress or (lambda share: None))
    table, chart = (folder / 'charts' / f'rigs.{kind}' for kind in ('csv', 'png'))
    _write_csv(table, rows)
    with _writing(chart):
        charts.rigs(rows, chart)
    page = folder / 'benchmarks.md'
    if not page.exists():
        return [table, chart]
    with _writing(page):
        sections = re.split(r'^(?=## )', page.read_text(encoding='utf-8'), flags=re.MULTILINE)
        place = [k for k, section in enumerate(sections) if section.startswith(TITLE)]
        sections = [section for section in sections if not section.startswith(TITLE)]
        sections.insert(place[0] if place else len(sections), f'{rigs_part(rows)}\n\n')
        page.write_text(''.join(sections).rstrip() + '\n', encoding='utf-8')
    return [table, chart, page]


def _measure_rigs(quick: bool, progress: Callable[[float], None]) -> Rows:
    """Rows of all cases: with `quick` of one rig at one rate, and shorter."""
    names = tuple(rigs())
    if quick:
        return rig_rows(names[:1], 3.0, rates=1, progress=progress)
    return rig_rows(names, 4.0, progress=progress)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Say which file it was that could not be written, which a full disk does not."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _write_csv(path: Path, rows: Rows) -> None:
    fields = list(dict.fromkeys(field for row in rows for field in row))
    with _writing(path), path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.DictWriter(file, fields, restval='', lineterminator='\n')
        writer.writeheader()
        for row in rows:
            writer.writerow({f: f'{v:.5g}' if isinstance(v, float) else v for f, v in row.items()})


def _read_csv(path: Path) -> list[dict[str, float]]:
    """Rows of numbers; none where the file is not there."""
    if not path.exists():
        return []
    with path.open(newline='', encoding='utf-8') as file:
        # What a row has nothing of is left empty.
        return [
            {name: float(v or 'nan') for name, v in row.items()} for row in csv.DictReader(file)
        ]


def _peer_rows(tables: dict[str, Table]) -> Rows:
    return [
        {
            'method': method,
            'motion': motion,
            'noise': noise,
            'quantity': quantity,
            'unit': UNITS[quantity],
            'error': error,
            # Ours is exactly right where what is always zero comes out zero.
            'over_ours': error / ours
            if (ours := tables[OURS][motion, noise, quantity])
            else np.inf,
        }
        for method, table in tables.items()
        for (motion, noise, quantity), error in table.items()
    ]


def _time_rows(tables: dict[str, Table], spent: dict[str, float]) -> Rows:
    middle = NOISES[1]
    return [
        {'method': method, 'cpu': spent[method]}
        | {name: median_over_ours(tables, method, name, middle) for name in QUANTITIES}
        for method in tables
        if method in spent
    ]


def _lag_rows(lagged: dict[tuple[str, int], Table]) -> Rows:
    ours = lagged[OURS, 20]
    rows = []
    order = sorted(lagged, key=lambda key: (key[0] != OURS, key))
    for method, lag in order:
        table = lagged[method, lag]
        row: dict[str, Any] = {'method': method, 'lag': lag / RATE}
        for name in QUANTITIES:
            ratios = [
                error / ours[key]
                for key, error in table.items()
                if key[2] == name and ours[key] > 0 and np.isfinite(error / ours[key])
            ]
            row[name] = float(np.median(ratios)) if ratios else float('nan')
        rows.append(row)
    return rows
