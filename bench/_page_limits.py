"""
The tables of the benchmarks, as to costs and limits: times, lag, the stability atlas, long runs.

Each part is made of rows that others have measured, and is empty where there are none.
"""

from typing import Any

import numpy as np

from bench._atlas import SHOWN
from bench._markdown import number, table
from bench._record import NOISES
from bench._rows import Rows

# Most that latencies may be over those of the relay.
_P50_BAR, _P99_BAR = 1.5, 2.0


def time_part(costs: Rows) -> str:
    if not costs:
        return ''
    rows = (
        (row['method'], *(f'{1e6 * row[what]:.1f}' for what in ('live', 'replay'))) for row in costs
    )
    return f"""## CPU time by method

{table(('method', 'live, µs per frame', 'replay, µs per frame'), rows)}

All quantities of one body up to jerk: live frame by frame, in replay many frames at once. Ours
fits the poses, learns and checks names and noise too. Minimum of several runs."""


def speed_part(speed: Rows, start: Rows) -> str:
    rows = speed + start
    if not rows:
        return ''

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
    return f"""## What does it cost?

{table(('what', 'ours', 'compared with', 'ratio', 'bar'), told)}

Bold misses its bar. These are CPU times, except for rates, start and help, with each pair in one
run. A rate is sustained if 99% of the frames are answered within two periods, in one of two
tries."""


def live_part(rows: Rows) -> str:
    if not rows:
        return ''

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
        "p50 relative to the relay's (ms)",
        "p99 relative to the relay's (ms)",
        'share of a core',
        "relay's",
        'answered within two periods',
        "relay's",
    )
    return f"""## The live node compared with a relay

{table(head, lines)}

Bold is above its bar: {_P50_BAR:g} for p50, {_P99_BAR:g} for p99. Latency is the time
from sending a frame to the arrival of its last result; a frame without a result counts as
infinitely late. The relay reads the same message with rclpy and publishes one vector. Both receive
every frame, half a period after each other, from a process that sleeps between frames.

Default: 200 Hz, 4 markers per body, 20 or more in a cloud. Angular velocity, ICR and centrode
curvature of each body have subscribers. Paths and drawings are included in the share of a core
only. Median of three runs: [live.csv](charts/live.csv)."""


def _beyond_bar(row: dict[str, Any]) -> bool:
    return bool((row['ratio'] < row['bar']) if row['least'] else (row['ratio'] > row['bar']))


def lag_part(rows: Rows) -> str:
    if not rows:
        return ''
    return f"""## Error by lag

![Error by lag](charts/error_over_lag.png)

Lower is better. Median over six motions at a noise of {NOISES[1]:g}, relative to ours at 0.1 s, on
the frames that ours determines at every lag."""


def atlas_part(rows: Rows) -> str:
    if not rows:
        return ''
    raised = [row for row in rows if row['raised']]
    finite = [row for row in rows if row['not_finite']]

    def cell(row: dict[str, Any], name: str) -> str:
        error, told = row.get(f'{name}_error', np.nan), row.get(f'{name}_determined', 0.0)
        return f'{error:.2g}, {told:.2f}' if np.isfinite(error) else f'–, {told:.2f}'

    told = table(
        ('limit', 'value', *(f'{q}: error, determined' for q in SHOWN)),
        (
            (row['limit'], f'{row["value"]:g} {row["unit"]}', *(cell(row, q) for q in SHOWN))
            for row in rows
        ),
    )
    return f"""## Stability atlas

Of {len(rows)} cells, **{len(raised)}** raised an exception, and in
**{len(finite)}** a value that is not finite was marked as determined.

![Stability atlas: ω and ICR](charts/atlas.png)

Where the error (upper charts) grows without bound, the share determined (lower charts) must
decrease.

![Stability atlas: IAP and κ](charts/atlas_higher.png)

The same for quantities that need more derivatives. At a cusp of the centrode κ is infinite, and it
is withheld in the frames that do not determine it.

<details><summary>All cells</summary>

{told}

</details>

Errors are medians over determined frames. Rates are divided by the true value, or by the rms of ω
to that power. Poles are divided by the body size. κ is divided by the true value, or by one per
body size."""


def long_part(rows: Rows) -> str:
    title = '## A long run'
    if not rows:
        return f"""{title}

Not measured: `kinpole bench --long` feeds 1e7 frames through one tracker and writes
charts/long.csv, which the next page uses."""
    tenth = max(len(rows) // 10, 1)

    def both(what: str, form: str) -> str:
        early, late = (np.median([r[what] for r in part]) for part in (rows[:tenth], rows[-tenth:]))
        return f'{early:{form}} in the first tenth, {late:{form}} in the last'

    most = {what: max(abs(row[what]) for row in rows) for what in ('turned', 'shifted')}
    return f"""{title}

{rows[-1]['frame']:.0e} frames of the four-bar's coupler at a noise of 0.001 through one tracker
(`kinpole bench --long`), with results requested in {len(rows)} segments of 50 frames:

- error of ω divided by its rms: {both('omega_error', '.2g')}
- error of the ICR divided by the body size: {both('icr_error', '.2g')}
- the learned body frame turned by {most['turned']:.1g} rad and shifted by {most['shifted']:.1g}
  body sizes at most; the error of the learned shape is {rows[-1]['shape_error']:.1g} body sizes at
  the end
- peak memory: {rows[tenth]['memory']:.1f} MB after a tenth, {rows[-1]['memory']:.1f} MB at the end
- CPU time per frame, with few results requested: {both('cpu', '.0f')}, µs

All segments: [long.csv](charts/long.csv)."""


def soak_part(rows: Rows) -> str:
    title = '## A long run of the live node'
    if not rows:
        return f"""{title}

Not measured: `kinpole bench --soak 30` runs it for 30 minutes."""
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

{len(rows)} minutes at 500 Hz (`kinpole bench --soak`). Each marker is hidden in 5% of the frames
and displaced by 0.1 m in 0.2%. 1% of the frames are never sent, and every 20 s the clock jumps.
Latency is the time from sending a frame to the arrival of its angular velocity, minus the lag.

{told}

All minutes: [soak.csv](charts/soak.csv)."""
