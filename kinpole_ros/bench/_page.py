"""
The page of the benchmarks: every table, and what to see in each picture.

Only words and tables are made here, of figures that others have measured.
"""

import os
import platform
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.bench._atlas import SHOWN
from kinpole_ros.bench._hindsight import LEVELS
from kinpole_ros.bench._peers import FIXED, OURS, REAL_TIME, UNTUNED, Table, median_over_ours
from kinpole_ros.bench._record import NOISES, POLES, QUANTITIES

Rows = list[dict[str, Any]]
# Ratio that the project promises, and the one it aims at.
_BAR, _AIM = 1.5, 1.2
# The same against the peers at equal lag, and against fixed windows on the pendulum.
_PEER_BAR = 1.1
# Where more of the frames than this have no error at all, coverage cannot be 93 to 97%.
_ALL_EXACT = 0.97


class Results(NamedTuple):
    """All that a page is made of: rows as in the CSV files, tables of RMS errors, times."""

    seconds: float
    quick: bool
    ratios: Rows
    bounds: Rows
    coverage: Rows
    tables: dict[str, Table]
    offline: dict[str, Table]
    version: str
    pendulum: Rows
    spent: dict[str, float]
    atlas: Rows
    speed: Rows
    long: list[dict[str, float]]
    soak: list[dict[str, float]]


def make_page(results: Results) -> str:
    """The page as Markdown."""
    parts = [
        _head(results.seconds, results.quick),
        _hindsight_part(results.ratios),
        _bounds_part(results.bounds, results.ratios),
        _coverage_part(results.coverage, results.bounds),
        _chi_part(results.coverage),
        _peers_part(results.tables, results.offline, results.version),
        _pendulum_part(results.pendulum, results.quick),
        _time_part(results.spent),
        _speed_part(results.speed),
        _lag_part(),
        _atlas_part(results.atlas),
        _long_part(results.long),
        _soak_part(results.soak),
    ]
    return '\n\n'.join(parts) + '\n'


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


def _bounds_part(rows: Rows, ratios: Rows) -> str:
    def median(what: str, quantity: str, noise: float) -> float:
        found = [r[what] for r in rows if (r['quantity'], r['noise']) == (quantity, noise)]
        found = [value for value in found if np.isfinite(value)]
        return float(np.median(found)) if found else np.nan

    noises = sorted({row['noise'] for row in rows})
    lines = [
        (told, f'{n:g}', *(_number(median(what, q, n)) for q in QUANTITIES))
        for told, what in (
            ('ours over the bound', 'ours_over_bound'),
            ('the best in hindsight over the bound', 'best_over_bound'),
        )
        for n in noises
    ]
    lines += [
        (
            'the best in hindsight, single records over all',
            f'{n:g}',
            *(
                f'{_number(median("seeds_10", q, n))} to {_number(median("seeds_90", q, n))}'
                for q in QUANTITIES
            ),
        )
        for n in noises
    ]
    cells = {(row['motion'], row['noise'], row['quantity']): row for row in rows}
    over = [row for row in ratios if row['ratio'] > _BAR]
    chance = near = 0
    for row in over:
        cell = cells[row['motion'], row['noise'], row['quantity']]
        chance += row['ratio'] <= cell['seeds_90']
        near += cell['best_over_bound'] <= _AIM
    return f"""## What could be reached

{_table(('medians over the motions', 'noise', *QUANTITIES), lines)}

The bound is that of Cramér and Rao: what any unbiased estimate must err, at the true state, from
the same window with a polynomial of the same degree, both being those that proved best in hindsight
for the cell; of each cell the median over its records. To see: hindsight is above 1 where its best
setting trades noise for bias. Ours is below 1 where it takes longer windows or lower degrees in
some frames. Both are far below it near rest (stop and go), where poles are known too badly for a
bound of first order, and where ours is exact. The last rows tell how far the RMS of the best fixed
setting on one record is from that on all of them: the 10th and 90th percentile of the records.

Of the {len(over)} cells over the bar of {_BAR}, in {chance} the ratio is within what the best fixed
setting itself makes of one record in ten, and in {near} hindsight is within {_AIM} of the bound, so
that the bar asks for nearly all that any polynomial of that window can give. Every cell:
[bounds.csv](charts/bounds.csv)."""


def _bold(ratio: float) -> str:
    return f'**{_number(ratio)}**' if ratio > _BAR else _number(ratio)


def _coverage_part(rows: Rows, bounds: Rows) -> str:
    cells = {(row['motion'], row['noise'], row['quantity']): row for row in rows}
    conditions = list(dict.fromkeys((row['motion'], row['noise']) for row in rows))

    def share(row: dict[str, Any]) -> str:
        value = row['covered']
        if not np.isfinite(value):
            return '–'
        if row['exact'] > _ALL_EXACT:
            return f'{100 * value:.1f} ='
        return f'{100 * value:.1f}' if 0.93 <= value <= 0.97 else f'**{100 * value:.1f}**'

    table = _table(
        ('motion', 'noise', *QUANTITIES),
        ((m, f'{n:g}', *(share(cells[m, n, q]) for q in QUANTITIES)) for m, n in conditions),
    )

    def tally(values: Iterable[float]) -> tuple[int, int, int]:
        """How many shares are inside 93 to 97%, too low and too high."""
        shares = np.array(list(values))
        low, high = int((shares < 0.93).sum()), int((shares > 0.97).sum())
        return len(shares) - low - high, low, high

    known = [row for row in rows if np.isfinite(row['covered'])]
    judged = [row for row in known if not row['exact'] > _ALL_EXACT]
    inside, low, high = tally(row['covered'] for row in judged)
    scaled = tally(row['scaled'] for row in judged)
    best = tally(row['best_covered'] for row in bounds)
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

In {len(known) - len(judged)} cells, marked =, over {100 * _ALL_EXACT:.0f}% of the frames have no
error but rounding, as truth and estimate are one constant: nothing but 100% is possible there. Of
the other {len(judged)}, bold is outside 93 to 97%: {inside} are inside, {low} too low (stated too
sure), {high} too high (stated too unsure). Neighboring frames share their windows: reckoned as one
independent frame per 0.25 s, each cell is known to some 1.5 points only.

What could be reached: the best fixed setting in hindsight, told the true noise, is inside in
{best[0]} of {len(bounds)} cells, too sure in {best[1]} and too unsure in {best[2]}, for what its
polynomial cannot follow it knows nothing of. Were all stated variances of a cell of ours scaled by
the one factor that makes its mean squared error right, which takes the truth to know, {scaled[0]}
would be inside, {scaled[1]} too low and {scaled[2]} too high: what is left to do is to tell how
large the errors of a motion are, not how they are distributed.

{determined}

A frame is bad where the true error exceeds 10 stated deviations or the true pole (for κ: the ICR)
is beyond 1000 body sizes or does not exist; good where it is not bad and the stated deviation is
below 0.3 of a body size (of rates: 0.3 of the figure, or of the rms of ω to that power; of κ: 0.3
of the figure or of one per size). What is known worse than that is not counted as lost. Rates are
determined wherever there are samples, so none is withheld. Every number by row:
[coverage.csv](charts/coverage.csv)."""


def _chi_part(rows: Rows) -> str:
    lines = []
    for name in POLES:
        cells = [f'{name}']
        for level in LEVELS:
            shares = np.array([r[f'below_{100 * level:g}'] for r in rows if r['quantity'] == name])
            low, middle, high = 100 * np.nanpercentile(shares, (0, 50, 100))
            cells.append(f'{middle:.1f} ({low:.0f} to {high:.0f})')
        lines.append(cells)
    return f"""### Errors of poles against chi-square

Percentage of determined frames whose squared error over the covariance is below that percentile of
chi-square of 2 degrees of freedom: median (lowest to highest) of the motions and noise levels.

{_table(('', *(f'{100 * level:g}%' for level in LEVELS)), lines)}

To see: each column should repeat its head; where it is below, more errors are large than stated."""


def _peers_part(tables: dict[str, Table], offline: dict[str, Table], version: str) -> str:
    parts = []
    for noise in NOISES:
        rows = []
        for method in [*tables, *offline]:
            group = tables if method in tables else offline
            medians = [median_over_ours(group, method, q, noise) for q in QUANTITIES]
            if method != OURS and np.isfinite(medians).any():
                rows.append((method, *(_number(m) for m in medians)))
        parts.append(f'Noise {noise:g}:\n\n' + _table(('', *QUANTITIES), rows))
    tuned, plain = (_beyond(tables, peers) for peers in (REAL_TIME, UNTUNED))
    worse = sorted((cell for cell in tuned if cell[0] > _PEER_BAR), reverse=True)
    blind = sum(ratio > _PEER_BAR for ratio, *_ in plain)
    counted = _table(
        ('quantity', 'cells', 'against all, tuned in hindsight', 'against those not tuned'),
        (
            (
                name,
                f'{sum(key[2] == name for _, key, _ in tuned)}',
                *(
                    f'{sum(key[2] == name and r > _PEER_BAR for r, key, _ in cells)}'
                    for cells in (tuned, plain)
                ),
            )
            for name in QUANTITIES
        ),
    )
    methods = (OURS, FIXED, *REAL_TIME)
    everyone = _table(
        ('method', f'cells more than {_PEER_BAR} times the smallest of the others'),
        (
            (method, f'{sum(ratio > _PEER_BAR for ratio, *_ in cells)} of {len(cells)}')
            for method in methods
            for cells in [_beyond(tables, tuple(m for m in methods[1:] if m != method), method)]
        ),
    )
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
{_PEER_BAR} times worse in **{len(worse)} of {len(tuned)}** cells (the bar is none); against the
smallest of those that nobody tunes by the truth ({' and '.join(UNTUNED)}), in {blind} of
{len(plain)}. How many by quantity:

{counted}

Whether any method could: how often each is that far behind the smallest of the others but ours. All
but two were tuned by the truth for each single cell; ours has one setting for all.

{everyone}

The worst against those tuned in hindsight:

{listed}"""


def _beyond(
    tables: dict[str, Table], peers: tuple[str, ...], method: str = OURS
) -> list[tuple[float, tuple[str, float, str], str]]:
    """Of every cell, a method's error over the smallest of the peers', the cell, and whose."""
    found = []
    for key, error in tables[method].items():
        others = {m: tables[m].get(key, np.nan) for m in peers}
        others = {m: e for m, e in others.items() if np.isfinite(e)}
        if others and np.isfinite(error):
            least = min(others, key=lambda m: others[m])
            found.append((error / others[least], key, least))
    return found


def _pendulum_part(rows: Rows, quick: bool) -> str:
    title = '## A real double pendulum against hindsight'
    if not rows:
        why = (
            'with --quick' if quick else 'here: its data are not at ../shared/data/double_pendulum'
        )
        return f'{title}\n\nNot measured {why}.'
    places = list(dict.fromkeys(row['place'] for row in rows))
    cells = {(row['way'], row['place']): row for row in rows}
    ways = list(dict.fromkeys(row['way'] for row in rows))
    fixed = [way for way in ways if not way.startswith(OURS)]
    lines = []
    for way in ways:
        pairs = (cells[way, place] for place in places)
        lines.append((way, *(f'{c["median"]:.4f} / {c["ninetieth"]:.4f}' for c in pairs)))
    beyond = total = 0
    for way in ways:
        if way in fixed:
            continue
        line = [f'{way}, over the best fixed']
        for place in places:
            ratios = [
                cells[way, place][what] / min(cells[f, place][what] for f in fixed)
                for what in ('median', 'ninetieth')
            ]
            total += len(ratios)
            beyond += sum(ratio > _PEER_BAR for ratio in ratios)
            line.append(' / '.join(f'**{r:.2f}**' if r > _PEER_BAR else f'{r:.2f}' for r in ratios))
        lines.append(tuple(line))
    lines.append(('frames judged', *(f'{cells[ways[0], place]["frames"]}' for place in places)))
    told = min(cells[way, place]['told'] for way in ways if way not in fixed for place in places)
    return f"""{title}

Two links filmed at 500 Hz, each known by two markers, some 0.4 of 589 units of noise (IBM's "Double
Pendulum Chaotic", run 16; the data are not part of the project). Ours has one setting, window 0.2 s
and lag 0.1 s; the rivals are local polynomials on the markers, centered. Distances over the length
of link1, median / 90th percentile:

{_table(('', *places), lines)}

Bold is over the bar of {_PEER_BAR}: **{beyond} of {total}**; the best fixed is another one from
column to column and figure to figure. Ours has a figure in at least {100 * told:.1f}% of
the frames judged. All are judged on the same frames, those in which the links turn:
|ω1| > 0.01 rad per frame for the ICR of link1, |ω2 − ω1| > 0.01 for the relative ICR, |ω2| > 0.01
for the ICR of link2, which should lie on the line through pivot and joint; (α² + ω⁴)^½ > 4e-4 for
the IAP and ((ω̈ − ω³)² + 9ω²α²)^½ > 1.6e-5 for the IJP. The joint is where 21 frames and degree 3
have it; the pivot is the median of its marker, up to 0.0044 from the center of the joint's path."""


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


def _speed_part(rows: Rows) -> str:
    def figure(row: dict[str, Any], name: str) -> str:
        return (
            f'{row[name]:,.3g} {row["unit"]}'
            if row[name] < 1e3
            else f'{row[name]:,.0f} {row["unit"]}'
        )

    told = (
        (
            row['what'],
            figure(row, 'ours'),
            figure(row, 'other'),
            f'**{row["ratio"]:.3g}**' if _beyond_bar(row) else f'{row["ratio"]:.3g}',
            f'{"at least" if row["least"] else "at most"} {row["bar"]:g}',
        )
        for row in rows
    )
    return f"""## What it costs

{_table(('what', 'ours', 'the other', 'ratio', 'bar'), told)}

Bold does not reach its bar. CPU times, but for the latencies and what is live; each pair in one
run. The relay is a node that reads the same message as rclpy makes it and publishes one vector;
the node follows one body of 4 markers in a cloud of 20 and is asked for its angular velocity, ICR
and centrode curvature. A rate is held when it is in one of three tries of 2 s, by either."""


def _beyond_bar(row: dict[str, Any]) -> bool:
    return bool((row['ratio'] < row['bar']) if row['least'] else (row['ratio'] > row['bar']))


def _lag_part() -> str:
    return f"""## Error against lag

![Error against lag](charts/error_over_lag.png)

To see: every method but the plain finite differences gains a factor from the first 0.05 s of lag;
the lower the line, the better at that lag. Median over six motions at a noise of {NOISES[1]:g}, on
the frames that ours calls determined at every lag, over ours at 0.1 s."""


def _atlas_part(rows: Rows) -> str:
    raised = [row for row in rows if row['raised']]
    finite = [row for row in rows if row['not_finite']]
    both = {
        (row['limit'], row['value']): (row, other)
        for row in rows
        for other in rows
        if row['method'] == OURS
        and other['method'] != OURS
        and (other['limit'], other['value']) == (row['limit'], row['value'])
    }

    def cell(row: dict[str, Any], name: str) -> str:
        error, told = row.get(f'{name}_error', np.nan), row.get(f'{name}_determined', 0.0)
        return f'{error:.2g}, {told:.2f}' if np.isfinite(error) else f'–, {told:.2f}'

    def lost(pair: tuple[dict[str, Any], dict[str, Any]], name: str) -> float:
        """By how much the fixed window is worse: its error over ours, and frames it has not."""
        ours, fixed = (row.get(f'{name}_error', np.nan) for row in pair)
        mine, its = (row.get(f'{name}_determined', 0.0) for row in pair)
        if not np.isfinite(ours) or mine < 0.1:
            return 0.0
        return fixed / max(ours, 1e-15) if np.isfinite(fixed) and its > 0.1 * mine else np.inf

    poles = ('ICR', 'IAP')
    failing = []
    for limit in dict.fromkeys(limit for limit, _ in both):
        here = [pair for key, pair in both.items() if key[0] == limit]
        ours, fixed = max(here, key=lambda pair: max(lost(pair, name) for name in poles))
        failing.append(
            (
                limit,
                f'{ours["value"]:g} {ours["unit"]}',
                *(cell(row, name) for name in poles for row in (ours, fixed)),
            )
        )
    better = [
        (1 / lost(pair, name), f'{name} at {key[0]} {key[1]:g}: {1 / lost(pair, name):.1f}')
        for key, pair in both.items()
        for name in poles
        if 0 < lost(pair, name) < 1 / _PEER_BAR
    ]
    better.sort(reverse=True)
    contrary = '; '.join(text for _, text in better[:4])
    told = _table(
        ('as', 'is', *(f'{q}: error, determined' for q in SHOWN)),
        (
            (row['limit'], f'{row["value"]:g} {row["unit"]}', *(cell(row, q) for q in SHOWN))
            for row, _ in both.values()
        ),
    )
    return f"""## Stability atlas

Cells in which something raised: **{len(raised)}**; in which something not finite was called
determined: **{len(finite)}**, of {len(rows)} (both methods).

![Stability atlas: ω and ICR](charts/atlas.png)

To see: where the error (above) grows without bound, the share determined (below) must fall with it.
Dotted is the fixed window of 41 samples and degree 4 in the same pipeline, which has no use for a
window with a sample missing.

![Stability atlas: IAP and κ](charts/atlas_higher.png)

To see: the same of what needs more derivatives; the fixed window loses them sooner. At a cusp of
the centrode (judged 0.05 s to either side of it) the poles stay, and κ, infinite there, is withheld
in the frames that cannot tell and poor beside them.

Where the fixed window does worst on poles, limit by limit (error over the body's size, share
determined):

{_table(('as', 'is', *(f'{q}, {m}' for q in poles for m in ('ours', 'fixed 41/4'))), failing)}

Ours is worse by more than {_PEER_BAR} in {len(better)} of {len(poles) * len(both)} figures
{f'({contrary})' if better else ''}.

Ours in all cells:

{told}

Errors are medians over determined frames: of rates over the figure (at least the rms of ω to that
power), of poles over the body's size, of κ over the figure (at least one per size)."""


def _long_part(rows: list[dict[str, float]]) -> str:
    title = '## A long run'
    if not rows:
        return f"""{title}

Not measured: `kinpole bench --long` feeds 1e7 frames through one tracker and writes
charts/long.csv, which the next page quotes."""
    tenth = max(len(rows) // 10, 1)

    def both(what: str, form: str) -> str:
        early, late = (np.median([r[what] for r in part]) for part in (rows[:tenth], rows[-tenth:]))
        return f'{early:{form}} in the first tenth, {late:{form}} in the last'

    most = {what: max(abs(row[what]) for row in rows) for what in ('turned', 'shifted')}
    return f"""{title}

{rows[-1]['frame']:.0e} frames of the four-bar's coupler at a noise of 0.001 through one tracker
(`kinpole bench --long`), with figures asked for in {len(rows)} stretches of 50 frames:

- error of ω over its rms: {both('omega_error', '.2g')}
- error of the ICR over the body's size: {both('icr_error', '.2g')}
- the learned body frame turned by {most['turned']:.1g} rad and shifted by {most['shifted']:.1g}
  body sizes at most; the learned shape is off by {rows[-1]['shape_error']:.1g} sizes at the end
- peak memory: {rows[tenth]['memory']:.1f} MB after a tenth, {rows[-1]['memory']:.1f} MB at the end
- CPU time per frame, few of them asked for: {both('cpu', '.0f')}, µs

Every stretch: [long.csv](charts/long.csv)."""


def _soak_part(rows: list[dict[str, float]]) -> str:
    title = '## The live node for a while'
    if not rows:
        return f"""{title}

Not measured: `kinpole bench --soak 30` runs it for 30 minutes and writes charts/soak.csv, which the
next page quotes."""
    # The first minute is that of the start.
    shown = [rows[k] for k in sorted({0, 1, len(rows) // 2, len(rows) - 1}) if k < len(rows)]
    told = _table(
        ('minute', 'memory, MB', 'p50, ms', 'p99, ms', 'worst, ms', 'sent', 'answered'),
        (
            (
                f'{row["minute"]:.0f}',
                f'{row["memory"]:.1f}',
                *(f'{row[name]:.2f}' for name in ('p50', 'p99', 'worst')),
                *(f'{row[name]:.0f}' for name in ('sent', 'answered')),
            )
            for row in shown
        ),
    )
    return f"""{title}

{len(rows)} minutes at 500 Hz (`kinpole bench --soak`): each marker of the body is hidden in 5% of
the frames and 0.1 m off in 0.2%, 1% of the frames are never sent, and every 20 s the clock jumps.
Latency is from sending a frame to the arrival of its angular velocity, less the lag.

{told}

Every minute: [soak.csv](charts/soak.csv)."""
