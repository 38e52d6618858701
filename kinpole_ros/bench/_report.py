"""
`kinpole bench`: all measurements, as tables beside charts, and the page that tells what to see.

Seeds are fixed: except for the times everything comes out the same again.
"""

import csv
import os
import platform
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.bench import _charts as charts
from kinpole_ros.bench._atlas import SHOWN, survey
from kinpole_ros.bench._hindsight import (
    best_fixed,
    counted,
    coverage,
    own_errors,
    pooled_rms,
)
from kinpole_ros.bench._motions import motions
from kinpole_ros.bench._peers import (
    FIXED,
    KALMAN,
    OURS,
    Table,
    costs,
    equal_lag,
    over_lag,
    pynumdiff_errors,
)
from kinpole_ros.bench._record import NOISES, QUANTITIES, RATE, UNITS, make_recording, measure

Rows = list[dict[str, Any]]
# Ratio that the project promises, and the one it aims at.
_BAR, _AIM = 1.5, 1.2


def hindsight_table(
    names: tuple[str, ...], noises: tuple[float, ...], seeds: int, seconds: float
) -> tuple[Rows, Rows]:
    """
    Rows of our errors over the best fixed (window, degree) in hindsight, and of coverage.

    By motion, noise and quantity; ratio NaN where too few frames are determined.
    """
    recording = make_recording(names, noises, seeds, seconds)
    ours = measure(recording)
    where = counted(recording, ours)
    errors = pooled_rms(recording, own_errors(recording, ours), where)
    best = best_fixed(recording, ours.frames, where)
    rows = []
    for (motion, noise, quantity), error in errors.items():
        least, samples, degree = best.get((motion, noise, quantity), (np.nan, 0, 0))
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
    return rows, coverage(recording, ours)


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
    tell = progress or (lambda share: None)
    written: list[Path] = []

    def write(name: str, rows: Rows, draw: Callable[[Rows, Path], None] | None) -> None:
        path = folder / 'charts' / f'{name}.csv'
        _write_csv(path, rows)
        written.append(path)
        if draw is not None:
            draw(rows, path.with_suffix('.png'))
            written.append(path.with_suffix('.png'))

    spent = costs(1 if quick else 5)
    tell(0.05)
    ratios, covered = hindsight_table(names, NOISES, *((1, 3.0) if quick else (12, 6.0)))
    write('hindsight', ratios, charts.hindsight)
    write('coverage', covered, None)
    tell(0.3)
    tables = equal_lag(make_recording(names, NOISES, *((1, 3.0) if quick else (2, 6.0))))
    tell(0.4)
    lags = (0, 20) if quick else (0, 2, 5, 10, 20, 40)
    lagged = over_lag(names, lags, *((1, 3.0) if quick else (2, 6.0)))
    tell(0.6)
    few = names[:1] if quick else names
    offline, offline_costs, version = pynumdiff_errors(make_recording(few, NOISES[1:2], 1, 4.5))
    tell(0.8)
    spent |= offline_costs
    write('peers', _peer_rows(tables) + _peer_rows(offline)[len(offline.get(OURS, ())) :], None)
    timed = _time_rows(tables, spent) + _time_rows(offline, spent)[1:]
    write('error_over_time', timed, charts.error_over_time)
    write('error_over_lag', _lag_rows(lagged), charts.error_over_lag)
    cells = survey(quick)
    write('atlas', cells, charts.atlas)
    tell(1.0)

    page = folder / 'benchmarks.md'
    parts = [
        _head(time.monotonic() - begun, quick),
        _hindsight_part(ratios),
        _coverage_part(covered),
        _peers_part(tables, offline, version),
        _time_part(spent),
        _lag_part(),
        _atlas_part(cells),
    ]
    page.write_text('\n\n'.join(parts) + '\n', encoding='utf-8')
    return [page, *written]


def _write_csv(path: Path, rows: Rows) -> None:
    fields = list(dict.fromkeys(field for row in rows for field in row))
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.DictWriter(file, fields, restval='', lineterminator='\n')
        writer.writeheader()
        for row in rows:
            writer.writerow({f: f'{v:.5g}' if isinstance(v, float) else v for f, v in row.items()})


def _peer_rows(tables: dict[str, Table]) -> Rows:
    return [
        {
            'method': method,
            'motion': motion,
            'noise': noise,
            'quantity': quantity,
            'unit': UNITS[quantity],
            'error': error,
            'over_ours': error / tables[OURS][motion, noise, quantity],
        }
        for method, table in tables.items()
        for (motion, noise, quantity), error in table.items()
    ]


def _median_over_ours(tables: dict[str, Table], method: str, quantity: str, noise: float) -> float:
    ours = tables[OURS]
    ratios = [
        table / ours[key]
        for key, table in tables[method].items()
        if key[1:] == (noise, quantity) and ours[key] > 0 and np.isfinite(table / ours[key])
    ]
    return float(np.median(ratios)) if ratios else float('nan')


def _time_rows(tables: dict[str, Table], spent: dict[str, float]) -> Rows:
    middle = NOISES[1]
    return [
        {'method': method, 'cpu': spent[method]}
        | {name: _median_over_ours(tables, method, name, middle) for name in QUANTITIES}
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


# --- the page -----------------------------------------------------------------------------------


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    lines = [list(head)]
    lines.append(['---'] * len(lines[0]))
    lines += [list(row) for row in rows]
    return '\n'.join('| ' + ' | '.join(line) + ' |' for line in lines)


def _number(value: float) -> str:
    if not np.isfinite(value):
        return '–'
    return f'{value:.2f}' if 0.005 <= value < 99.5 else f'{value:.2g}'


def _head(seconds: float, quick: bool) -> str:
    warning = '\n**Made with --quick: too little data for a judgment.**\n' if quick else ''
    return f"""# Benchmarks

Made by `kinpole bench`: figures as CSV beside each picture in [charts](charts), the same again from
the same code but for the times. This run took {seconds / 60:.1f} minutes on {os.cpu_count()} cores
(Python {platform.python_version()}, numpy {np.__version__}).
{warning}
Unless said otherwise: one body of 4 markers at 200 Hz, window 0.5 s, lag 0.1 s; noise is white,
its standard deviation per axis given in body sizes (twice the rms radius of the markers), and not
told to the tracker. Six motions: a four-bar's coupler at 1 rev/s; turning at a constant 5 rev/s
with the reference point on an orbit; two sines in angle, x and y; half a second of rest and half a
second of motion, over and over; a wheel that rolls at 1 rev/s; and a coupler that whips round at a
dead point, where its acceleration peaks for 0.06 s. The first 1.5 s of each record do not count.
Errors are RMS over the frames that ours calls determined, and of these over frames whose true pole
(for κ: the ICR) lies within 10 body sizes and whose true κ is below 10 per size."""


def _hindsight_part(rows: Rows) -> str:
    cells = {(row['motion'], row['noise'], row['quantity']): row['ratio'] for row in rows}
    conditions = list(dict.fromkeys((row['motion'], row['noise']) for row in rows))
    table = _table(
        ('motion', 'noise', *QUANTITIES),
        (
            (motion, f'{noise:g}', *(_bold(cells[motion, noise, q]) for q in QUANTITIES))
            for motion, noise in conditions
        ),
    )
    known = {key: ratio for key, ratio in cells.items() if np.isfinite(ratio)}
    ratios = np.array(list(known.values()))
    worst = sorted(known, key=lambda key: -known[key])[:8]
    over = int((ratios > _BAR).sum())
    told = '; '.join(f'{q} of {m} at {n:g}: {known[m, n, q]:.2f}' for m, n, q in worst)
    return f"""## Error over the best fixed window and degree in hindsight

{table}

Bold is over the bar of {_BAR}. Beyond it are **{over} of {len(ratios)}** cells; over the aim of
{_AIM} are {int((ratios > _AIM).sum())}. Median {np.median(ratios):.2f} (bar 1.2), 90th percentile
{np.percentile(ratios, 90):.2f}, worst {ratios.max():.2f}. The worst: {told}. A dash: fewer than 50
frames are determined. Below 1 ours is better than any one setting, since it changes its own from
frame to frame; far below 1 (drawn at 0.3) where the true figure is zero and ours comes out zero.

The rival is a local polynomial on the fitted poses, windows of 5 to 101 samples in steps of a fifth
and degrees from the order of derivative to 12, at most 20 samples ahead, on the same frames, the
one that proved best for this quantity in this row. Its poses are fitted to the true shape of the
body, which ours has to learn.

![Error over the best in hindsight](charts/hindsight.png)

To see: marks under the dashed line meet the bar; what lies above it is what is left to do."""


def _bold(ratio: float) -> str:
    return f'**{_number(ratio)}**' if ratio > _BAR else _number(ratio)


def _coverage_part(rows: Rows) -> str:
    cells = {(row['motion'], row['noise'], row['quantity']): row for row in rows}
    conditions = list(dict.fromkeys((row['motion'], row['noise']) for row in rows))

    def share(value: float) -> str:
        text = '–' if not np.isfinite(value) else f'{100 * value:.1f}'
        return text if not np.isfinite(value) or 0.93 <= value <= 0.97 else f'**{text}**'

    table = _table(
        ('motion', 'noise', *QUANTITIES),
        (
            (m, f'{n:g}', *(share(cells[m, n, q]['covered']) for q in QUANTITIES))
            for m, n in conditions
        ),
    )
    shares = np.array([row['covered'] for row in rows])
    shares = shares[np.isfinite(shares)]
    inside = int(((shares >= 0.93) & (shares <= 0.97)).sum())
    low = int((shares < 0.93).sum())
    summary = []
    for name in QUANTITIES:
        mine = [row for row in rows if row['quantity'] == name]
        total = {f: sum(row[f] for row in mine) for f in ('bad', 'bad_let_through', 'good')}
        withheld = sum(row['good_withheld'] for row in mine)
        squares = [r['mean_square'] for r in mine if np.isfinite(r['mean_square'])]
        caught = 1 - total['bad_let_through'] / total['bad'] if total['bad'] else np.nan
        summary.append(
            (
                name,
                f'{np.median(squares):.2f} ({min(squares):.2g} to {max(squares):.2g})',
                f'{total["bad"]}',
                '–' if not total['bad'] else f'{100 * caught:.1f}%',
                f'{total["good"]}',
                f'{100 * withheld / max(total["good"], 1):.2f}%',
            )
        )
    determined = _table(
        (
            '',
            'squared error over variance, median and range of the rows (1 is right)',
            'bad frames',
            'of these marked undetermined (bar: over 99%)',
            'good frames',
            'of these withheld (bar: under 2%)',
        ),
        summary,
    )
    return f"""## What the stated uncertainty is worth

Percentage of determined frames whose 95% interval holds the truth (of poles: whose squared error
over the covariance is below 5.991, chi-square of 2 degrees of freedom):

{table}

Bold is outside 93 to 97%: {inside} of {len(shares)} cells are inside, {low} too low (stated too
sure), {len(shares) - inside - low} too high (stated too unsure). Neighboring frames share their
windows: reckoned as one independent frame per 0.25 s, each cell is known to some 1.5 points only.

{determined}

A frame is bad where the true error exceeds 10 stated deviations or the true pole (for κ: the ICR)
is beyond 1000 body sizes or does not exist; good where it is not bad and the stated deviation is
below 0.3 of a body size (of rates: 0.3 of the figure, or of the rms of ω to that power; of κ: 0.3
of the figure or of one per size). What is known worse than that is not counted as lost. Rates are
determined wherever there are samples, so none is withheld. Every number by row:
[coverage.csv](charts/coverage.csv)."""


def _peers_part(tables: dict[str, Table], offline: dict[str, Table], version: str) -> str:
    parts = []
    for noise in NOISES:
        rows = []
        for method in [*tables, *offline]:
            group = tables if method in tables else offline
            medians = [_median_over_ours(group, method, q, noise) for q in QUANTITIES]
            if method != OURS and np.isfinite(medians).any():
                rows.append((method, *(_number(m) for m in medians)))
        parts.append(f'Noise {noise:g}:\n\n' + _table(('', *QUANTITIES), rows))
    peers = [m for m in tables if m not in (OURS, FIXED, KALMAN)]
    worse = []
    total = 0
    for key, error in tables[OURS].items():
        others = {m: tables[m].get(key, np.nan) for m in peers}
        others = {m: e for m, e in others.items() if np.isfinite(e)}
        if not others or not np.isfinite(error):
            continue
        total += 1
        least = min(others, key=lambda m: others[m])
        if error > 1.1 * others[least]:
            worse.append((error / others[least], key, least))
    worse.sort(reverse=True)
    listed = _table(
        ('quantity', 'motion', 'noise', 'ours over the smallest', 'which'),
        ((k[2], k[0], f'{k[1]:g}', f'{r:.2f}', m) for r, k, m in worse[:12]),
    )
    told = (
        f'PyNumDiff {version} is offline and sees the whole record, so lag does not bind it; its '
        'own optimizer was told the true derivative, order after order. It differentiates one '
        'signal: here the angle, so it has no poles. At one noise level, as its tuning takes long.'
        if version
        else 'PyNumDiff is not installed here: `pip install kinpole_ros[bench]` brings it.'
    )
    return f"""## Peers at the same lag, on the same recordings

Median over the six motions of each method's error over ours (above 1: ours is better). All may look
0.1 s ahead but the Kalman filter, which has no lag, and the plain finite differences, which need
0.01 s. "Hindsight" means that the setting (window and degree, spacing, or density of the snap) was
picked by the truth for each motion, noise and quantity; ours has one setting for all.

{chr(10).join(part + chr(10) for part in parts)}
{told}

Against the smallest of the real-time peers at equal lag, each tuned in hindsight, ours is more than
1.1 times worse in **{len(worse)} of {total}** cells (the bar is none). The worst of these:

{listed}"""


def _time_part(spent: dict[str, float]) -> str:
    rows = ((method, f'{1e6 * seconds:.0f}') for method, seconds in spent.items())
    fixed = spent['the same pipeline, fixed 41/4']
    ratio = spent[OURS] / fixed
    return f"""## Error against CPU time

{_table(('method', 'CPU time per frame of one body, µs'), rows)}

Ours takes {ratio:.2f} times as long as a fixed local polynomial through the same pipeline (bar: 3).
Least of several runs; the peers are bare loops without covariances, dropouts, uneven stamps or
any checks, the pose fit included where they use one.

![Error against CPU time](charts/error_over_time.png)

To see: what is left of ours is cheaper, what is above it is worse; at a noise of {NOISES[1]:g}."""


def _lag_part() -> str:
    return f"""## Error against lag

![Error against lag](charts/error_over_lag.png)

To see: every method but the plain finite differences gains a factor from the first 0.05 s of lag;
the lower the line, the better at that lag. Median over six motions at a noise of {NOISES[1]:g}, on
the frames that ours calls determined at every lag, over ours at 0.1 s."""


def _atlas_part(rows: Rows) -> str:
    raised = [row for row in rows if row['raised']]
    finite = [row for row in rows if row['not_finite']]
    mine = [row for row in rows if row['method'] == 'ours']
    told = _table(
        ('as', 'is', *(f'{q}: error, determined' for q in SHOWN)),
        (
            (
                f'{row["limit"]}',
                f'{row["value"]:g} {row["unit"]}',
                *(
                    f'{row.get(f"{q}_error", np.nan):.2g}, {row.get(f"{q}_determined", 0):.2f}'
                    for q in SHOWN
                ),
            )
            for row in mine
        ),
    )
    return f"""## Stability atlas

Cells in which something raised: **{len(raised)}**; in which something not finite was called
determined: **{len(finite)}**, of {len(rows)} (both methods).

![Stability atlas](charts/atlas.png)

To see: where the error (above) grows without bound, the share determined (below) must fall with it.
Dotted is the fixed window of 41 samples and degree 4 in the same pipeline. A run of 1e7 frames is
not part of this page.

{told}

Errors are medians over determined frames: of rates over the figure (at least the rms of ω to that
power), of poles over the body's size, of κ over the figure (at least one per size)."""
