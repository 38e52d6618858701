"""
The first page of the benchmarks: four sentences, three charts, and where the rest is.

Every figure in it is from the rows that were measured.
"""

import statistics
from collections.abc import Iterable

import numpy as np

from bench._markdown import number, table, wrapped
from bench._overview import BOUND, over_hindsight, pareto_points, troubles
from bench._peers import EFFORTS, OURS, TUNED_ON
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
        _efforts_part(tables),
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
        found.append(f'**Measured before the rest: {", ".join(earlier)}.**')
    quick = [row['part'] for row in runs if row['quick']]
    if quick:
        found.append(f'**Made with --quick, too little data to judge by: {", ".join(quick)}.**')
    busy = [row for row in runs if row['load'] > _BUSY * row['cores']]
    if busy:
        worst = max(busy, key=lambda row: row['load'])
        usual = statistics.median(row['load'] for row in runs)
        found.append(
            f'**Other programs ran on the machine meanwhile (load {worst["load"]:.1f} before '
            f'{worst["part"]}, {usual:.1f} as a rule, on {worst["cores"]:.0f} cores): times are '
            'too long, latencies most of all.**'
        )
    return found


def _sentences(tables: Tables) -> Iterable[str]:
    """How accurate, how dear, when it fails, what to set."""
    makers = {
        'How accurate?': _accurate,
        'How dear?': _dear,
        'When does it fail?': _fails,
        'What to set?': _settings,
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
        'of the best fixed window that hindsight finds.'
    )
    covered = [
        row['covered']
        for name in ('coverage', 'coverage_others')
        for row in tables.get(name, [])
        if np.isfinite(row['covered'])
    ]
    if covered:
        share = 100 * np.median(covered)
        text += f' The 95% intervals hold the truth {share:.0f}% of the time (all medians).'
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
        f'With noise of {NOISES[1]:g} body sizes, ω errs by {rate:.2%} and the ICR by {pole:.3f} '
        'sizes. '
    )


def _dear(tables: Tables) -> str:
    costs = {row['method']: row for row in tables.get('costs', [])}
    if not costs:
        return ''
    live, replay = (1e6 * costs[OURS][what] for what in ('live', 'replay'))
    text = f'A frame of one body takes {live:.0f} µs of CPU live and {replay:.0f} µs in replay'
    node = tables.get('live', [])
    if node:
        text += f', and the whole node {node[0]["core"]:.0%} of a core at 200 Hz'
    return f'{text}.'


def _fails(tables: Tables) -> str:
    rows = troubles(tables.get('rigs', []))
    if not rows:
        return ''
    names = [each.name for each in rows if each.first_broken]
    levels = [level for each in rows for level in each.levels if level.broken]
    text = (
        f'Of {len(rows)} troubles of the input, {len(names)} raise the error beyond {BOUND:g} '
        'times that of ideal input'
    )
    if not names:
        return f'{text}.'
    reported = sum(level.reported for level in levels)
    return (
        f'{text}, at some strength: {", ".join(names)}. Diagnostics report {reported} of these '
        f'{len(levels)} cases.'
    )


def _settings(tables: Tables) -> str:
    lagged = {row['lag']: row for row in tables.get('error_over_lag', []) if row['method'] == OURS}
    if 0.0 not in lagged or LAG not in lagged:
        return ''
    rate, jerk = (lagged[0.0][name] / lagged[LAG][name] for name in ('ω', 'jerk'))
    text = (
        f'First `lag`: {LAG:g} s instead of none makes the error of ω {rate:.1f} times and that of '
        f'the jerk {jerk:.1f} times smaller.'
    )
    costs = {row['method']: row['live'] for row in tables.get('costs', [])}
    ratios = over_hindsight(tables.get('peers', []))
    low = EFFORTS['low']
    if low in costs and low in ratios:
        time, error = costs[low] / costs[OURS], np.median(ratios[low]) / np.median(ratios[OURS])
        text += f' `effort: low` takes {time:.2f} times the CPU and errs {error:.2f} times as much.'
    return text


def _pareto_part(tables: Tables) -> str:
    title = '## Against other methods'
    points = pareto_points(
        tables.get('peers', []), tables.get('costs', []), tables.get('pynumdiff', [])
    )
    if not points:
        return f'{title}\n\n{MISSING}'
    ours = next(point for point in points if point.short == 'normal')
    motions = len({row['motion'] for row in tables['peers']})
    best = min((p for p in points if p.group == 'peer'), key=lambda p: p.median)
    return f"""{title}

![Error over CPU time: ours at three efforts, and peers](charts/pareto.png)

Down and left is better; a triangle lies higher than drawn. At 1 (dashed) is the best fixed window
that hindsight finds for each cell. A cell is one quantity of one motion at one noise: {ours.cells}
of them, {motions} motions. All but the Kalman filter may look {LAG:g} s ahead.

- Left: of the methods that nobody tuned by the truth, the nearest errs
  {best.median / ours.median:.1f} times as much as ours ({best.label}).
- Right: settings picked by the truth for each cell, and PyNumDiff, which sees the whole record.
  Nobody can set these on a rig.
- The peers are bare loops in numpy: no covariance, no dropouts, no uneven stamps. They are compared
  on the frames that ours determines."""


def _strip_part(tables: Tables) -> str:
    title = '## Where it breaks'
    rows = troubles(tables.get('rigs', []))
    if not rows:
        return f'{title}\n\n{MISSING}'
    return f"""{title}

![Error over that with ideal input, by trouble](charts/strip.png)

Each row is one thing that goes wrong, from little to much. The figure is the error over that with
ideal input and {1e3 * NOISE:g} mm of noise: the larger of ω and ICR, the median of all bodies.

What each message means and its fix: [real_rigs.md](real_rigs.md). Worst bodies, coverage and
messages: [tables](benchmarks-tables.md#on-real-rigs)."""


def _model_part(tables: Tables) -> str:
    title = '## The model it chose'
    rows = tables.get('model', [])
    if not rows:
        return f'{title}\n\n{MISSING}'
    motions = {row['motion'] for row in rows}
    counts = {(row['motion'], row['noise']): row['parameters'] for row in rows}
    fewer = sum(counts[m, NOISES[0]] > counts[m, NOISES[-1]] for m in motions)
    least, most = (pick(rows, key=lambda row: row['parameters']) for pick in (min, max))
    return f"""{title}

![Parameters of the model, by motion and over time](charts/model.png)

Nobody tells it the motion. The models it averages have {least['parameters']:.0f} parameters for
{least['motion']} and {most['parameters']:.0f} for {most['motion']}, in one window of {WINDOW:g} s.
What the noise hides takes none: in {fewer} of {len(motions)} motions the most noise leaves fewer
than the least."""


def _efforts_part(tables: Tables) -> str:
    title = '## What `effort` buys'
    costs = {row['method']: row for row in tables.get('costs', [])}
    ratios = over_hindsight(tables.get('peers', []))
    lines: list[tuple[str, ...]] = []
    for effort, name in EFFORTS.items():
        if name in costs and name in ratios:
            times = (f'{1e6 * costs[name][what]:.0f}' for what in ('live', 'replay'))
            errors = (number(value) for value in np.percentile(ratios[name], (50, 90, 100)))
            lines.append((f'`{effort}`', *times, *errors))
    if not lines:
        return f'{title}\n\n{MISSING}'
    head = ('`effort`', 'live, µs', 'replay, µs', 'error: median', '90th percentile', 'worst')
    return f"""{title}

{table(head, lines)}

CPU time a frame of one body, with all poles and the curvature; errors as in the first chart."""


def _rest_part(tables: Tables) -> str:
    runs = tables.get('run', [])
    made = ''
    if runs:
        last = max(runs, key=lambda row: row['day'])
        made = f"""

Made by `kinpole bench` in {sum(row['seconds'] for row in runs) / 60:.0f} minutes on
{last['cores']:.0f} cores ({last['python']}, {last['numpy']}), {last['day']}."""
    return f"""## How it was measured

One body of four markers at 200 Hz, window {WINDOW:g} s, lag {LAG:g} s, even stamps. The noise is
white, of {', '.join(f'{noise:g}' for noise in NOISES)} body sizes, and the tracker is not given it.
The motions are exact: [what they are](benchmarks-tables.md#motions). The Kalman smoother on the
left takes the process noise that is likeliest at {TUNED_ON[0]:g} to {TUNED_ON[1]:g} s of each
record.

Every table, the stability atlas, the live node, the pendulum and long runs:
[benchmarks-tables.md](benchmarks-tables.md). Figures as CSV: [charts](charts).{made}"""
