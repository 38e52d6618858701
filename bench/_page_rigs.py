"""The tables of the benchmarks, as to real rigs: what comes of input that is not ideal."""

from typing import Any

import numpy as np

from bench._markdown import number, table
from bench._rigs import NOISE, rigs
from bench._rows import Rows

TITLE = '## On real rigs'
# Parts of the table: name, and the bars of it in words.
_PARTS = {
    'stamps': 'Stamps, with 2% of the frames lost if the stamps are wrong. Bar: 1.1 (1.3 for '
    'exp(3 ms), 1.05 for correct ones), coverage within 3 points of the ideal.',
    'plane': 'Plane and units, tilted about any axis. Bar with `plane: fit`: 1.1 for the ICR, '
    'covered by 90%; with `plane: xy` the tilt must be reported.',
    'names': 'Names. Bar: 1.2 for ω or withheld, under 1% beyond 5 standard deviations, reported.',
    'markers': 'Bad markers. Bar: 1.25 for ω and ICR, covered by 90%, reported.',
    'frames': 'Bad frames: one every 0.6 s. Bar: nothing beyond 10 standard deviations.',
    'bodies': 'Bodies that are not rigid. Bar: ω and ICR covered by 85%, or reported.',
}


def rigs_part(rows: Rows) -> str:
    """The section, from the rows of `rig_rows` or as their CSV file has them, as text."""
    if not rows:
        return ''
    parts = '\n\n'.join(
        f'{words}\n\n{_table([row for row in rows if row["part"] == part])}'
        for part, words in _PARTS.items()
    )
    return f"""{TITLE}

`kinpole bench --rigs` measures this alone. {len(rigs())} rigs: the six motions in pairs, with four
markers on each body, and the links of a four-bar. 100 and 200 Hz, or 200 Hz if there is no bar.
Noise is {1e3 * NOISE:g} mm on all three axes. The interval of the camera has an error of 100 ppm,
the window is 0.3 s, the lag 0.1 s. The first 2 s are left out.

- Errors: RMS relative to that with ideal input, on the frames at which both are determined. Median
  and worst of all bodies and rates. A worst one above its bar is bold.
- A dash: not determined, or no error with ideal input.
- Covered: share in the 95% region, %. Median and lowest; in parentheses the median with ideal
  input.
- Beyond 5σ and 10σ, and withheld of those determined with ideal input: mean of ω and ICR, %.
- Reported: additional diagnostics compared with ideal input, and in how many runs.

{parts}

All values: [rigs.csv](charts/rigs.csv)."""


def _table(rows: Rows) -> str:
    head = ('input', 'ω', 'α', 'jerk', 'ICR', 'ω covered', 'ICR covered')
    lines = []
    for what in dict.fromkeys(row['what'] for row in rows):
        case = {row['quantity']: row for row in rows if row['what'] == what}
        rare = ('beyond_5', 'beyond_10', 'withheld')
        lines.append(
            (
                what,
                *(_ratio(case[name]) for name in ('ω', 'α', 'jerk', 'ICR')),
                *(_covered(case[name]) for name in ('ω', 'ICR')),
                *(_percent(*(case[q][name] for q in ('ω', 'ICR'))) for name in rare),
                case['ω']['said'] or 'nothing',
            )
        )
    return table((*head, 'beyond 5σ', 'beyond 10σ', 'withheld', 'reported'), lines)


def _ratio(row: dict[str, Any]) -> str:
    middle, worst = (_number(row[name]) for name in ('ratio', 'worst'))
    return f'{middle}, {f"**{worst}**" if row["worst"] > row["bar"] else worst}'


def _number(value: float) -> str:
    return f'{value:,.0f}' if 99.5 <= value < 1e5 else number(value)


def _covered(row: dict[str, Any]) -> str:
    shares = (f'{100 * row[name]:.0f}' for name in ('covered', 'least_covered', 'ideal_covered'))
    middle, least, ideal = ('–' if text == 'nan' else text for text in shares)
    return f'{middle}, {least} ({ideal})'


def _percent(*shares: float) -> str:
    known = [100 * share for share in shares if np.isfinite(share)]
    if not known:
        return '–'
    mean = float(np.mean(known))
    return '<0.1' if 0 < mean < 0.05 else f'{mean:.1f}'
