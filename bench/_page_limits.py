"""
The page of the benchmarks, as to costs and limits: times, lag, the stability atlas, long runs.

Each part is made of figures that others have measured, and says what to see in its picture.
"""

from typing import Any

import numpy as np

from bench._atlas import SHOWN
from bench._markdown import PEER_BAR, number, table
from bench._peers import OURS
from bench._record import NOISES

Rows = list[dict[str, Any]]
# Most that latencies may be over those of the relay.
_P50_BAR, _P99_BAR = 1.5, 2.0


def time_part(spent: dict[str, float]) -> str:
    rows = ((method, f'{1e6 * seconds:.0f}') for method, seconds in spent.items())
    fixed = spent['the same pipeline, fixed 41/4']
    ratio = spent[OURS] / fixed
    return f"""## Error against CPU time

{table(('method', 'CPU time per frame of one body, µs'), rows)}

Ours takes {ratio:.2f} times as long as a fixed local polynomial through the same pipeline (bar: 3).
Least of several runs; the peers are bare loops without covariances, dropouts, uneven stamps or
any checks, the pose fit included where they use one.

![Error against CPU time](charts/error_over_time.png)

To see: what is left of ours is cheaper, what is above it is worse; at a noise of {NOISES[1]:g}."""


def speed_part(rows: Rows) -> str:
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

{table(('what', 'ours', 'the other', 'ratio', 'bar'), told)}

Bold does not reach its bar. CPU times, but for rates, start and help; each pair in one run. The
rates are those of one body, as below; one is held when it is in one of two tries of 2.5 s."""


def live_part(rows: Rows) -> str:
    def against(row: dict[str, Any], name: str, bar: float) -> str:
        ratio = row[name] / row[f'{name}_relay']
        text = number(ratio) if ratio <= bar else f'**{number(ratio)}**'
        return f'{text} ({number(row[name])})'

    lines = (
        (
            row['what'],
            against(row, 'p50', _P50_BAR),
            against(row, 'p99', _P99_BAR),
            *(f'{row[f"core{each}"]:.0%}' for each in ('', '_relay')),
            *(f'{row[f"answered{each}"]:.1%}' for each in ('', '_relay')),
        )
        for row in rows
    )
    head = (
        'case',
        "p50 over the relay's (ms)",
        "p99 over the relay's (ms)",
        'share of a core',
        "relay's",
        'answered within two periods',
        "relay's",
    )
    return f"""## The live node against a relay

{table(head, lines)}

Bold is above its bar: {_P50_BAR:g} for p50, {_P99_BAR:g} for p99. Latency is from sending a frame
to the arrival of its last result; a frame without one counts as infinitely late. The relay is a
node that reads the same message as rclpy makes it and publishes one vector. Both get every frame,
half a period after each other, from a process that sleeps between frames; the rate is 200 Hz unless
said. Bodies have 4 markers each, of 20 or more in a cloud. Angular velocity, ICR and centrode
curvature of each body are subscribed to unless said. Paths and drawings count for the core only.
Each figure is the median of three runs of 5 s: [live.csv](charts/live.csv)."""


def _beyond_bar(row: dict[str, Any]) -> bool:
    return bool((row['ratio'] < row['bar']) if row['least'] else (row['ratio'] > row['bar']))


def lag_part() -> str:
    return f"""## Error against lag

![Error against lag](charts/error_over_lag.png)

To see: every method but the plain finite differences gains a factor from the first 0.05 s of lag;
the lower the line, the better at that lag. Median over six motions at a noise of {NOISES[1]:g}, on
the frames that ours calls determined at every lag, over ours at 0.1 s."""


def atlas_part(rows: Rows) -> str:
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
        if 0 < lost(pair, name) < 1 / PEER_BAR
    ]
    better.sort(reverse=True)
    contrary = '; '.join(text for _, text in better[:4])
    told = table(
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
the centrode (compared 0.05 s to either side of it) the poles stay, and κ, infinite there, is
withheld in the frames that cannot tell and poor next to them.

Where the fixed window does worst on poles, limit by limit (error over the body's size, share
determined):

{table(('as', 'is', *(f'{q}, {m}' for q in poles for m in ('ours', 'fixed 41/4'))), failing)}

Ours is worse by more than {PEER_BAR} in {len(better)} of {len(poles) * len(both)} figures
{f'({contrary})' if better else ''}.

Ours in all cells:

{told}

Errors are medians over determined frames: of rates over the figure (at least the rms of ω to that
power), of poles over the body's size, of κ over the figure (at least one per size)."""


def long_part(rows: list[dict[str, float]]) -> str:
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


def soak_part(rows: list[dict[str, float]]) -> str:
    title = '## The live node for a while'
    if not rows:
        return f"""{title}

Not measured: `kinpole bench --soak 30` runs it for 30 minutes and writes charts/soak.csv, which the
next page quotes."""
    # The first minute is that of the start.
    shown = [rows[k] for k in sorted({0, 1, len(rows) // 2, len(rows) - 1}) if k < len(rows)]
    told = table(
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
