"""
The tables of the benchmarks, as to other methods: on the same recordings, and on a real pendulum.

Each part is made of rows that others have measured.
"""

import numpy as np

from bench._markdown import PEER_BAR, number, table
from bench._peers import FIXED, OURS, REAL_TIME, UNTUNED, Table, median_over_ours
from bench._record import NOISES, QUANTITIES
from bench._rows import Rows


def peers_part(rows: Rows, offline: Rows) -> str:
    if not rows:
        return ''
    tables, others = tables_of(rows), tables_of(offline)
    parts = []
    for noise in NOISES:
        lines = []
        for method in dict.fromkeys((*tables, *others)):
            group = tables if method in tables else others
            medians = [median_over_ours(group, method, q, noise) for q in QUANTITIES]
            if method != OURS and np.isfinite(medians).any():
                lines.append((method, *(number(m) for m in medians)))
        parts.append(f'Noise {noise:g}:\n\n' + table(('', *QUANTITIES), lines))
    real_time, untuned = (tuple(m for m in each if m in tables) for each in (REAL_TIME, UNTUNED))
    tuned, plain = (_beyond(tables, peers) for peers in (real_time, untuned))
    worse = sorted((cell for cell in tuned if cell[0] > PEER_BAR), reverse=True)
    methods = (OURS, FIXED, *real_time)
    everyone = table(
        ('method', f'cells above {PEER_BAR} times the smallest of the other methods'),
        (
            (method, f'{sum(ratio > PEER_BAR for ratio, *_ in cells)} of {len(cells)}')
            for method in methods
            for cells in [_beyond(tables, tuple(m for m in methods[1:] if m != method), method)]
        ),
    )
    listed = table(
        ('quantity', 'motion', 'noise', 'ours relative to the smallest', 'smallest'),
        ((k[2], k[0], f'{k[1]:g}', f'{r:.2f}', m) for r, k, m in worse[:5]),
    )
    version = offline[0]['version'] if offline else ''
    about = (
        f'PyNumDiff {version} is offline and uses the whole record. Its own optimizer was given '
        'the true derivative. It differentiates one signal, the angle, so it has no poles.'
        if version
        else 'PyNumDiff was not measured.'
    )
    return f"""## Other methods at the same lag, on the same recordings

Median over the motions of each method's error divided by ours; above 1 ours is better. All methods
may use 0.1 s of later data, except the Kalman filter and the plain finite differences.

- "Hindsight": the setting was chosen with the true values for each motion, noise and quantity.
- "Self-tuned": the process noise has the highest likelihood at 0.75 to 2.5 s of each record.
- Ours has one setting for all. Errors are those of the frames that it determines.

{chr(10).join(part + chr(10) for part in parts)}
{about}

The error of ours exceeds {PEER_BAR} times the smallest of the other real-time methods in:

- **{len(worse)} of {len(tuned)}** cells, if they are tuned in hindsight (bar: none)
- **{sum(r > PEER_BAR for r, *_ in plain)} of {len(plain)}** cells, if they are not

{everyone}

The worst cells, compared with those tuned in hindsight:

{listed}"""


def tables_of(rows: Rows) -> dict[str, Table]:
    """Errors by method and cell, of rows that have one of each."""
    found: dict[str, Table] = {}
    for row in rows:
        key = row['motion'], row['noise'], row['quantity']
        found.setdefault(row['method'], {})[key] = row['error']
    return found


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


def pendulum_part(rows: Rows) -> str:
    title = '## A real double pendulum'
    if not rows:
        return f'{title}\n\nNot measured: its data are not at ../shared/data/double_pendulum.'
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
        line = [f'{way}, relative to the best fixed']
        for place in places:
            ratios = [
                cells[way, place][what] / min(cells[f, place][what] for f in fixed)
                for what in ('median', 'ninetieth')
            ]
            total += len(ratios)
            beyond += sum(ratio > PEER_BAR for ratio in ratios)
            line.append(' / '.join(f'**{r:.2f}**' if r > PEER_BAR else f'{r:.2f}' for r in ratios))
        lines.append(tuple(line))
    lines.append(
        ('frames compared', *(f'{cells[ways[0], place]["frames"]:.0f}' for place in places))
    )
    told = min(cells[way, place]['told'] for way in ways if way not in fixed for place in places)
    return f"""{title}

Two links filmed at 500 Hz, with two markers each (IBM's "Double Pendulum Chaotic", run 16). The
complete data are not part of the project. Ours has one setting, window 0.2 s and lag 0.1 s. The
other methods are centered local polynomials on the markers. Distances divided by the length of
link1, median / 90th percentile:

{table(('', *places), lines)}

Bold is above the bar of {PEER_BAR}: **{beyond} of {total}**. The best fixed setting differs between
columns. Ours has a result in at least {100 * told:.1f}% of the frames compared.

| quantity | frames compared: those in which, per frame |
| --- | --- |
| ICR of link1; relative ICR; ICR of link2 | \\|ω1\\|; \\|ω2 − ω1\\|; \\|ω2\\| > 0.01 rad |
| IAP | (α² + ω⁴)^½ > 4e-4 |
| IJP | ((ω̈ − ω³)² + 9ω²α²)^½ > 1.6e-5 |

The ICR of link2 should be on the line through pivot and joint. The joint is its smoothed marker, 21
frames and degree 3. The pivot is the median of its marker, up to 0.0044 from the center of the
joint's path."""
