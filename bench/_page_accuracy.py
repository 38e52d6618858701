"""
The page of the benchmarks, as to accuracy: errors, bounds, stated uncertainty, peers.

Each part is made of figures that others have measured, and says what to see in its picture.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from bench._hindsight import LEVELS
from bench._markdown import PEER_BAR, number, table
from bench._peers import FIXED, OURS, REAL_TIME, UNTUNED, Table, median_over_ours
from bench._record import NOISES, POLES, QUANTITIES

Rows = list[dict[str, Any]]
# Ratio that the project promises, and the one it aims at.
_BAR, _AIM = 1.5, 1.2
# Where more of the frames than this have no error at all, coverage cannot be 93 to 97%.
_ALL_EXACT = 0.97


def hindsight_part(rows: Rows) -> str:
    cell_table, told, ratios = _cells(rows)
    over = int((ratios > _BAR).sum())
    return f"""## Error over the best fixed window and degree in hindsight

{cell_table}

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


def others_part(rows: Rows) -> str:
    cell_table, told, ratios = _cells(rows)
    return f"""## The same on other motions

Nothing was tuned on these: the rod of a slider-crank at several speeds (its harmonics come near the
noise one by one), the foot of a Jansen leg, a cam with dwells, a pendulum that dies away, random
motion up to 3 Hz, and steady turning with a ripple. As above stamps are even, markers have their
names and noise is white; what rigs send is [below](#on-real-rigs).

{cell_table}

Bold is over {_BAR}: **{int((ratios > _BAR).sum())} of {len(ratios)}** cells. Median
{np.median(ratios):.2f}, 90th percentile {np.percentile(ratios, 90):.2f}, worst {ratios.max():.2f}.
The worst: {told}.

To see: where the error is over the best fixed one, harmonics near the noise are taken for noise."""


def _cells(rows: Rows) -> tuple[str, str, np.ndarray]:
    """The table of ratios by cell, the eight worst, and all of them."""
    cells = {(row['motion'], row['noise'], row['quantity']): row['ratio'] for row in rows}
    conditions = list(dict.fromkeys((row['motion'], row['noise']) for row in rows))
    cell_table = table(
        ('motion', 'noise', *QUANTITIES),
        (
            (motion, f'{noise:g}', *(_bold(cells[motion, noise, q]) for q in QUANTITIES))
            for motion, noise in conditions
        ),
    )
    known = {key: ratio for key, ratio in cells.items() if np.isfinite(ratio)}
    worst = sorted(known, key=lambda key: -known[key])[:8]
    told = '; '.join(f'{q} of {m} at {n:g}: {known[m, n, q]:.2f}' for m, n, q in worst)
    return cell_table, told, np.array(list(known.values()))


def bounds_part(rows: Rows, ratios: Rows) -> str:
    def median(what: str, quantity: str, noise: float) -> float:
        found = [r[what] for r in rows if (r['quantity'], r['noise']) == (quantity, noise)]
        found = [value for value in found if np.isfinite(value)]
        return float(np.median(found)) if found else np.nan

    noises = sorted({row['noise'] for row in rows})
    lines = [
        (told, f'{n:g}', *(number(median(what, q, n)) for q in QUANTITIES))
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
                f'{number(median("seeds_10", q, n))} to {number(median("seeds_90", q, n))}'
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

{table(('medians over the motions', 'noise', *QUANTITIES), lines)}

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
    return f'**{number(ratio)}**' if ratio > _BAR else number(ratio)


def coverage_part(rows: Rows, bounds: Rows) -> str:
    cells = {(row['motion'], row['noise'], row['quantity']): row for row in rows}
    conditions = list(dict.fromkeys((row['motion'], row['noise']) for row in rows))

    def share(row: dict[str, Any]) -> str:
        value = row['covered']
        if not np.isfinite(value):
            return '–'
        if row['exact'] > _ALL_EXACT:
            return f'{100 * value:.1f} ='
        return f'{100 * value:.1f}' if 0.93 <= value <= 0.97 else f'**{100 * value:.1f}**'

    cell_table = table(
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
        total = {
            f: sum(row[f] for row in mine)
            for f in ('bad', 'bad_let_through', 'bad_visible', 'good')
        }
        withheld = sum(row['good_withheld'] for row in mine)
        squares = [r['mean_square'] for r in mine if np.isfinite(r['mean_square'])]
        caught = 1 - total['bad_let_through'] / total['bad'] if total['bad'] else np.nan
        summary.append(
            (
                name,
                f'{np.median(squares):.2f} ({min(squares):.2g} to {max(squares):.2g})',
                f'{total["bad"]}',
                '–' if not total['bad'] else f'{100 * caught:.1f}%',
                f'{100 * total["bad_visible"] / total["bad"]:.0f}%'
                if total['bad_visible'] > 0
                else '–',
                f'{total["good"]}',
                f'{100 * withheld / max(total["good"], 1):.2f}%',
            )
        )
    determined = table(
        (
            '',
            'squared error over variance, median and range of the rows (1 is right)',
            'bad frames',
            'of these marked undetermined (bar: over 99%)',
            'could be marked at most',
            'good frames',
            'of these withheld (bar: under 2%)',
        ),
        summary,
    )
    return f"""## What the stated uncertainty is worth

Percentage of determined frames whose 95% interval holds the truth (of poles: whose squared error
over the covariance is below 5.991, chi-square of 2 degrees of freedom):

{cell_table}

In {len(known) - len(judged)} cells, marked =, over {100 * _ALL_EXACT:.0f}% of the frames have no
error but rounding, as truth and estimate are one constant: nothing but 100% is possible there. Of
the other {len(judged)}, bold is outside 93 to 97%: {inside} are inside, {low} too low
(overconfident), {high} too high (conservative). Neighboring frames share their windows: reckoned as
one independent frame per 0.25 s, each cell is known to some 1.5 points only.

What could be reached: the best fixed setting in hindsight, given the true noise, is inside in
{best[0]} of {len(bounds)} cells, overconfident in {best[1]} and conservative in {best[2]}, for what
its polynomial cannot follow it knows nothing of. Were all stated variances of a cell of ours scaled
by the one factor that makes its mean squared error right, which takes the truth to know,
{scaled[0]} would be inside, {scaled[1]} too low and {scaled[2]} too high: what is left to do is to
find how large the errors of a motion are, not how they are distributed.

{determined}

A frame is bad where the true error exceeds 10 stated deviations or the true pole (for κ: the ICR)
is beyond 1000 body sizes or does not exist; good where it is not bad and the stated deviation is
below 0.3 of a body size (of rates: 0.3 of the figure, or of the rms of ω to that power; of κ: 0.3
of the figure or of one per size). What is known worse than that is not counted as lost. Every
number by row: [coverage.csv](charts/coverage.csv).

Rates are determined wherever there are samples, so none is withheld. How many of the bad ones could
be marked at most: for each there is a motion that differs from the true one by a polynomial of
degree 9 in the 41 samples about the instant, as far back as may be looked ahead, and for which the
published rate is right. It is distinguished from the true one by their distance in units of noise,
and no test that takes under 2% of such motions for the true ones marks more than this."""


def chi_part(rows: Rows) -> str:
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

{table(('', *(f'{100 * level:g}%' for level in LEVELS)), lines)}

To see: each column should repeat its head; where it is below, more errors are large than stated."""


def peers_part(tables: dict[str, Table], offline: dict[str, Table], version: str) -> str:
    parts = []
    for noise in NOISES:
        rows = []
        for method in [*tables, *offline]:
            group = tables if method in tables else offline
            medians = [median_over_ours(group, method, q, noise) for q in QUANTITIES]
            if method != OURS and np.isfinite(medians).any():
                rows.append((method, *(number(m) for m in medians)))
        parts.append(f'Noise {noise:g}:\n\n' + table(('', *QUANTITIES), rows))
    tuned, plain = (_beyond(tables, peers) for peers in (REAL_TIME, UNTUNED))
    worse = sorted((cell for cell in tuned if cell[0] > PEER_BAR), reverse=True)
    blind = sum(ratio > PEER_BAR for ratio, *_ in plain)
    counted = table(
        ('quantity', 'cells', 'against all, tuned in hindsight', 'against those not tuned'),
        (
            (
                name,
                f'{sum(key[2] == name for _, key, _ in tuned)}',
                *(
                    f'{sum(key[2] == name and r > PEER_BAR for r, key, _ in cells)}'
                    for cells in (tuned, plain)
                ),
            )
            for name in QUANTITIES
        ),
    )
    methods = (OURS, FIXED, *REAL_TIME)
    everyone = table(
        ('method', f'cells more than {PEER_BAR} times the smallest of the others'),
        (
            (method, f'{sum(ratio > PEER_BAR for ratio, *_ in cells)} of {len(cells)}')
            for method in methods
            for cells in [_beyond(tables, tuple(m for m in methods[1:] if m != method), method)]
        ),
    )
    listed = table(
        ('quantity', 'motion', 'noise', 'ours over the smallest', 'which'),
        ((k[2], k[0], f'{k[1]:g}', f'{r:.2f}', m) for r, k, m in worse[:12]),
    )
    told = (
        f'PyNumDiff {version} is offline and sees the whole record, so lag does not bind it; its '
        'own optimizer was given the true derivative, order after order. It differentiates one '
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
{PEER_BAR} times worse in **{len(worse)} of {len(tuned)}** cells (the bar is none); against the
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


def pendulum_part(rows: Rows, quick: bool) -> str:
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
            beyond += sum(ratio > PEER_BAR for ratio in ratios)
            line.append(' / '.join(f'**{r:.2f}**' if r > PEER_BAR else f'{r:.2f}' for r in ratios))
        lines.append(tuple(line))
    lines.append(('frames compared', *(f'{cells[ways[0], place]["frames"]}' for place in places)))
    told = min(cells[way, place]['told'] for way in ways if way not in fixed for place in places)
    return f"""{title}

Two links filmed at 500 Hz, each known by two markers, some 0.4 of 589 units of noise (IBM's "Double
Pendulum Chaotic", run 16; the data are not part of the project). Ours has one setting, window 0.2 s
and lag 0.1 s; the rivals are local polynomials on the markers, centered. Distances over the length
of link1, median / 90th percentile:

{table(('', *places), lines)}

Bold is over the bar of {PEER_BAR}: **{beyond} of {total}**; the best fixed is another one from
column to column and figure to figure. Ours has a figure in at least {100 * told:.1f}% of
the frames compared. All are compared on the same frames, those in which the links turn:
|ω1| > 0.01 rad per frame for the ICR of link1, |ω2 − ω1| > 0.01 for the relative ICR, |ω2| > 0.01
for the ICR of link2, which should lie on the line through pivot and joint; (α² + ω⁴)^½ > 4e-4 for
the IAP and ((ω̈ − ω³)² + 9ω²α²)^½ > 1.6e-5 for the IJP. The joint is where 21 frames and degree 3
have it; the pivot is the median of its marker, up to 0.0044 from the center of the joint's path."""
