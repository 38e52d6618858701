"""
The first page of the benchmarks: four sentences, three charts, and where the rest is.

Every figure in it is from the rows that were measured.
"""

import statistics
from collections.abc import Iterable

import numpy as np

from bench._markdown import wrapped
from bench._overview import BOUND, over_hindsight, pareto_points, troubles
from bench._peers import OURS, TUNED_ON
from bench._record import LAG, NOISES, WINDOW
from bench._rigs import NOISE
from bench._rows import Rows

Tables = dict[str, Rows]
MISSING = 'Not measured.'
# Load of a machine, over its cores, above which others have their part in the times.
_BUSY = 0.25
# Tables that are no part of this page: the runs themselves, and those of the constants' own page.
_ELSEWHERE = {'run', 'constants'}


def make_page(tables: Tables) -> str:
    """The page as Markdown, from rows by the name of their table."""
    parts = [
        '# Benchmarks',
        '\n'.join(_sentences(tables)),
        _pareto_part(tables),
        _strip_part(tables),
        _model_part(tables),
        _rest_part(tables),
        *warnings(tables),
    ]
    return wrapped('\n\n'.join(parts))


def warnings(tables: Tables) -> list[str]:
    """What keeps figures from being judged: age, too little data, a busy machine."""
    runs = tables.get('run', [])
    found = []
    noted = {name for row in runs for name in row['tables'].split()}
    earlier = [name for name in tables if name not in noted and name not in _ELSEWHERE]
    newest = max((row['day'] for row in runs), default='')
    earlier += [f'{row["part"]} ({row["day"]})' for row in runs if row['day'] != newest]
    if earlier:
        found.append(f'**Measured earlier than the other parts: {", ".join(earlier)}.**')
    quick = [row['part'] for row in runs if row['quick']]
    if quick:
        found.append(
            f'**Measured with --quick, with too little data for conclusions: {", ".join(quick)}.**'
        )
    busy = [row for row in runs if row['load'] > _BUSY * row['cores']]
    if busy:
        worst = max(busy, key=lambda row: row['load'])
        usual = statistics.median(row['load'] for row in runs)
        found.append(
            f'**Other programs ran at the same time (load {worst["load"]:.1f} before '
            f'{worst["part"]}, median {usual:.1f}, on {worst["cores"]:.0f} cores): times are '
            'too long, in particular latencies.**'
        )
    return found


def _sentences(tables: Tables) -> Iterable[str]:
    """How accurate, how dear, when it fails, what to set."""
    makers = {
        'How accurate?': _accurate,
        'How fast?': _dear,
        'When does it fail?': _fails,
        'What should I set?': _settings,
    }
    for question, make in makers.items():
        answer = make(tables) or MISSING
        yield f'- **{question}** {answer}'


def _accurate(tables: Tables) -> str:
    ratios = over_hindsight(tables.get('peers', [])).get(OURS)
    if ratios is None:
        return ''
    text = (
        f'{_absolute(tables.get("hindsight", []))}The error is {np.median(ratios):.2f} times that '
        'of the best fixed window found in hindsight.'
    )
    covered = [
        row['covered']
        for name in ('coverage', 'coverage_others')
        for row in tables.get(name, [])
        if np.isfinite(row['covered'])
    ]
    if covered:
        share = 100 * np.median(covered)
        text += (
            f' The 95% intervals contain the true value {share:.0f}% of the time. All are medians.'
        )
    return text


def _absolute(rows: Rows) -> str:
    """Errors at the middle noise over what scales them, medians over the motions."""
    found = []
    for name in ('ω', 'ICR'):
        some = [row for row in rows if (row['quantity'], row['noise']) == (name, NOISES[1])]
        found.append([row['ours'] / row['scale'] for row in some if 'scale' in row])
    if not all(found):
        return ''
    rate, pole = (float(np.nanmedian(each)) for each in found)
    return (
        f'At a noise of {NOISES[1]:g} body sizes, the error of ω is {rate:.2%} and that of the ICR '
        f'{pole:.3f} body sizes. '
    )


def _dear(tables: Tables) -> str:
    costs = {row['method']: row for row in tables.get('costs', [])}
    if not costs:
        return ''
    live, replay = (1e6 * costs[OURS][what] for what in ('live', 'replay'))
    text = f'A frame of one body takes {live:.0f} µs of CPU time live and {replay:.0f} µs in replay'
    node = tables.get('live', [])
    if node:
        text += f'. The whole node takes {node[0]["core"]:.0%} of a core at 200 Hz'
    return f'{text}.'


def _fails(tables: Tables) -> str:
    rows = troubles(tables.get('rigs', []))
    if not rows:
        return ''
    names = [each.name for each in rows if each.first_broken]
    levels = [level for each in rows for level in each.levels if level.broken]
    text = (
        f'{len(names)} of {len(rows)} kinds of bad input increase the error to more than {BOUND:g} '
        'times that of ideal input'
    )
    if not names:
        return f'{text}.'
    reported = sum(level.reported for level in levels)
    return (
        f'{text}, if they are strong: {", ".join(names)}. Diagnostics report {reported} of these '
        f'{len(levels)} cases.'
    )


def _settings(tables: Tables) -> str:
    lagged = {row['lag']: row for row in tables.get('error_over_lag', []) if row['method'] == OURS}
    if 0.0 not in lagged or LAG not in lagged:
        return ''
    rate, jerk = (lagged[0.0][name] / lagged[LAG][name] for name in ('ω', 'jerk'))
    return (
        f'`lag` first. {LAG:g} s instead of none divides the error of ω by {rate:.1f} and that of '
        f'the jerk by {jerk:.1f}.'
    )


def _pareto_part(tables: Tables) -> str:
    title = '## How does it compare with other methods?'
    points = pareto_points(
        tables.get('peers', []), tables.get('costs', []), tables.get('pynumdiff', [])
    )
    if not points:
        return f'{title}\n\n{MISSING}'
    ours = next(point for point in points if point.group == 'ours')
    motions = len({row['motion'] for row in tables['peers']})
    best = min((p for p in points if p.group == 'peer'), key=lambda p: p.median)
    return f"""{title}

![Error over CPU time: kinpole and other methods](charts/pareto.png)

Lower left is better; a triangle is a point above the chart. The dashed line at 1 is the best fixed
window, chosen in hindsight for each cell. A cell is one quantity of one motion at one noise. There
are {ours.cells} cells of {motions} motions. All methods except the Kalman filter may use {LAG:g} s
of later data.

- Left: methods that were not tuned with the true values. The best of them has
  {best.median / ours.median:.1f} times the error of kinpole ({best.label}).
- Right: methods whose settings were chosen with the true values for each cell, and PyNumDiff, which
  uses the whole record. On a rig nobody can choose such settings.
- The other methods are plain loops in numpy, without covariance, dropouts and uneven stamps. They
  are compared on the frames that kinpole determines."""


def _strip_part(tables: Tables) -> str:
    title = '## When does it fail?'
    rows = troubles(tables.get('rigs', []))
    if not rows:
        return f'{title}\n\n{MISSING}'
    return f"""{title}

![Error relative to that with ideal input, by kind of bad input](charts/strip.png)

Each row is one kind of bad input, with increasing strength. The value is the error relative to that
with ideal input and {1e3 * NOISE:g} mm of noise: the larger of ω and ICR, the median of all bodies.

[Real rigs](real_rigs.md) explains each message and its fix. The
[tables](benchmarks-tables.md#on-real-rigs) list the worst bodies, coverage and messages."""


def _model_part(tables: Tables) -> str:
    title = '## Which models does it choose?'
    rows = tables.get('model', [])
    if not rows:
        return f'{title}\n\n{MISSING}'
    motions = {row['motion'] for row in rows}
    counts = {(row['motion'], row['noise']): row['parameters'] for row in rows}
    fewer = sum(counts[m, NOISES[0]] > counts[m, NOISES[-1]] for m in motions)
    least, most = (pick(rows, key=lambda row: row['parameters']) for pick in (min, max))
    return f"""{title}

![Parameters of the model, by motion and over time](charts/model.png)

The motion is not given. In one window of {WINDOW:g} s the averaged models have
{least['parameters']:.0f} parameters for the {least['motion']} and {most['parameters']:.0f} for the
{most['motion']}. Details below the noise take no parameters: in {fewer} of {len(motions)} motions
the highest noise leaves fewer parameters than the lowest."""


def _rest_part(tables: Tables) -> str:
    runs = tables.get('run', [])
    made = ''
    if runs:
        last = max(runs, key=lambda row: row['day'])
        made = f"""

`kinpole bench` made this page in {sum(row['seconds'] for row in runs) / 60:.0f} minutes on
{last['cores']:.0f} cores ({last['python']}, {last['numpy']}), {last['day']}."""
    return f"""## How was it measured?

One body of four markers at 200 Hz, window {WINDOW:g} s, lag {LAG:g} s, even stamps. The noise is
white, {', '.join(f'{noise:g}' for noise in NOISES)} body sizes, and not given to the tracker. The
[motions](benchmarks-tables.md#motions) are exact. The Kalman smoother on the left uses the process
noise with the highest likelihood at {TUNED_ON[0]:g} to {TUNED_ON[1]:g} s of each record.

[The tables](benchmarks-tables.md) also cover stability, the live node, a real pendulum and long
runs. [The experiments](estimator.md#how-accurate-is-it-near-an-event) have errors and coverage by
the distance from an impact, a stop or a reversal. The values are in CSV files in
[charts](charts).{made}"""
