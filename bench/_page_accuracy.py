"""
The tables of the benchmarks, as to accuracy: errors, bounds, stated uncertainty.

Each part is made of rows that others have measured, and is empty where there are none.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from bench._hindsight import LEVELS
from bench._markdown import number, table
from bench._record import POLES, QUANTITIES
from bench._rows import Rows

# Ratio that the project promises of each cell, and of their median and 90th percentile.
_BAR, _MEDIAN_BAR, _NINETIETH_BAR = 1.5, 0.92, 1.15
# Where more of the frames than this have no error at all, coverage cannot be 93 to 97%.
_ALL_EXACT = 0.97


def hindsight_part(rows: Rows) -> str:
    if not rows:
        return ''
    return f"""## Error relative to the best fixed window and degree in hindsight

{_ratios(rows)} Bars: {_MEDIAN_BAR} and {_NINETIETH_BAR}.

A dash: fewer than 50 frames are determined. A ratio near 0: the true value is zero, and so is ours.

The reference is a local polynomial on the fitted poses, with 5 to 101 samples and a degree of up to
12. It may use 20 later samples. For each cell the best one is chosen with the true values. Its
poses are fitted to the true shape of the body, which ours has to learn.

![Error over the best in hindsight](charts/hindsight.png)"""


def others_part(rows: Rows) -> str:
    if not rows:
        return ''
    return f"""## The same on other motions

{_ratios(rows)}"""


def _ratios(rows: Rows) -> str:
    cell_table, worst, ratios = _cells(rows)
    middle, high, most = np.percentile(ratios, (50, 90, 100))
    return f"""{cell_table}

Bold is above the bar of {_BAR}: **{(ratios > _BAR).sum()} of {len(ratios)}** cells. Median
{middle:.2f}, 90th percentile {high:.2f}, worst {most:.2f}. The worst: {worst}."""


def _cells(rows: Rows) -> tuple[str, str, np.ndarray]:
    """The table of ratios by cell, the four worst, and all of them."""
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
    worst = sorted(known, key=lambda key: -known[key])[:4]
    listed = '; '.join(f'{q} of {m} at {n:g}: {known[m, n, q]:.2f}' for m, n, q in worst)
    return cell_table, listed, np.array(list(known.values()))


def bounds_part(rows: Rows, ratios: Rows) -> str:
    if not rows:
        return ''

    def median(what: str, quantity: str, noise: float) -> float:
        found = [r[what] for r in rows if (r['quantity'], r['noise']) == (quantity, noise)]
        found = [value for value in found if np.isfinite(value)]
        return float(np.median(found)) if found else np.nan

    noises = sorted({row['noise'] for row in rows})
    lines = [
        (told, f'{n:g}', *(number(median(what, q, n)) for q in QUANTITIES))
        for told, what in (
            ('ours relative to the bound', 'ours_over_bound'),
            ('the best in hindsight relative to the bound', 'best_over_bound'),
        )
        for n in noises
    ]
    lines += [
        (
            'the best in hindsight, single records relative to all',
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
    chance = sum(
        row['ratio'] <= cells[row['motion'], row['noise'], row['quantity']]['seeds_90']
        for row in over
    )
    return f"""## What is the theoretical limit?

{table(('medians over the motions', 'noise', *QUANTITIES), lines)}

The bound is that of Cramér and Rao, for a polynomial with the best window and degree. No unbiased
estimate with that model has a smaller error. The best in hindsight is above 1 where it exchanges
noise for bias. Ours is below 1 where some frames have a better model.

The last rows compare single records with all records: 10th and 90th percentile. {len(over)} cells
are above the bar. For {chance} of them the best fixed setting varies as much in one record of ten.
All cells: [bounds.csv](charts/bounds.csv)."""


def _bold(ratio: float) -> str:
    return f'**{number(ratio)}**' if ratio > _BAR else number(ratio)


def coverage_part(rows: Rows, bounds: Rows, others: Rows) -> str:
    if not rows:
        return ''
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

    judged = _judged(rows)
    exact = sum(np.isfinite(row['covered']) for row in rows) - len(judged)
    inside, low, high = tally(row['covered'] for row in judged)
    more = tally(row['covered'] for row in _judged(others))
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
                f'{total["bad"]:.0f}',
                '–' if not total['bad'] else f'{100 * caught:.1f}%',
                f'{100 * total["bad_visible"] / total["bad"]:.0f}%'
                if total['bad_visible'] > 0
                else '–',
                f'{total["good"]:.0f}',
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
    counts = table(
        ('cells by coverage of their 95% intervals', '93 to 97%', 'below', 'above'),
        (
            (what, *map(str, each))
            for what, each in (
                ('ours', (inside, low, high)),
                ('ours, the other motions', more),
                ('ours, each cell scaled by the best factor for it', scaled),
                ('the best fixed setting in hindsight, given the true noise', best),
            )
        ),
    )
    return f"""## Is the uncertainty correct?

Percentage of determined frames whose 95% interval contains the true value. For poles: whose squared
error over the covariance is below 5.991, chi-square with 2 degrees of freedom.

{cell_table}

Bold is outside 93 to 97%. In {exact} cells, marked =, more than {100 * _ALL_EXACT:.0f}% of the
frames have rounding errors only; they are left out below. Neighboring frames share their windows,
so the accuracy of a cell is about 1.5 percentage points.

{counts}

{determined}

- Bad: the error exceeds 10 standard deviations, or the true pole (for κ: the ICR) is beyond 1000
  body sizes.
- Good: not bad, and the standard deviation is below 0.3 body sizes (for rates and κ: below 0.3 of
  the value).
- Could be marked at most: no test with less than 2% false alarms marks more bad rates, because the
  true motion differs too little from one with the published rate.

All values: [coverage.csv](charts/coverage.csv)."""


def _judged(rows: Rows) -> Rows:
    """Those for which coverage can be other than 100%."""
    return [r for r in rows if np.isfinite(r['covered']) and not r['exact'] > _ALL_EXACT]


def chi_part(rows: Rows) -> str:
    if not rows:
        return ''
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
chi-square: median (lowest to highest) of the cells. The ideal is the head of each column.

{table(('', *(f'{100 * level:g}%' for level in LEVELS)), lines)}"""
