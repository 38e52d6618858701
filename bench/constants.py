"""
Constants set by hand, and what comes of half and of double of each: `python -m bench.constants`.

A constant is a number that a module of the estimate's rooms gives a name in capitals, be it written
as an expression; what is made of other constants is none. Of C it is a number that is defined below
a comment of one line. The comment above it is its reason. Each is changed in a copy of the package,
and a process of its own measures a panel of figures with it. So what is made of it goes with it.
"""

import ast
import json
import math
import os
import re
import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench._cases import CASES
from bench._hindsight import own_errors, pooled_rms
from bench._markdown import wrapped
from bench._motions import motions
from bench._outcome import FIGURES, Outcome, run
from bench._record import QUANTITIES, make_recording, measure, rms
from bench._rigs import record, rigs
from bench._rows import Rows, read_rows, write_rows

ROOMS = ('tracking', 'derivatives', 'core')
PAGE, TABLE = 'constants.md', 'charts/constants.csv'
_ROOT = Path(__file__).resolve().parent.parent
# What is measured of the estimator: noises, over the body's size, and s.
_NOISES, _SECONDS = (1e-5, 1e-3), 1.0
# Of real rigs: frames per s, and s, of which the first two do not count.
_RATE, _LONG = 200.0, 3.0
_WHAT = (
    'late by exp(1 ms)',
    '30% of the frames lost',
    'tilt 10°, plane: fit',
    'none, 5% of the points absent',
    'one of each body slips by 2 mm',
    '10% hidden',
    'one with a body 20 mm off',
    'soft tissue, 1 mm over 0.2 s',
)
# Less than this share of a figure is no effect.
_LITTLE = 0.05
# What does not end in so many s hangs.
_PATIENCE = 300.0


class Constant(NamedTuple):
    """A number `value` of the name in a `path` under the package, there on `line` at `column`."""

    path: str
    name: str
    value: float
    reason: str
    line: int
    column: int
    end: int


def constants() -> list[Constant]:
    """All constants of the rooms, in their order."""
    return [
        constant
        for room in ROOMS
        for file in sorted((_ROOT / 'kinpole_ros' / room).glob('**/*.*'))
        for constant in _constants_of(file)
    ]


def _constants_of(file: Path) -> Iterator[Constant]:
    if file.suffix not in ('.c', '.h', '.py'):
        return
    text = file.read_text(encoding='utf-8')
    lines = text.splitlines()
    path = str(file.relative_to(_ROOT))
    if file.suffix != '.py':
        for found in re.finditer(r'(?m)^/\* (.*) \*/\n(#define ([A-Z_]+) )([\d.e+-]+)$', text):
            reason, begin, name, written = found.groups()
            place = text.count('\n', 0, found.start(2)) + 1, len(begin), len(begin + written)
            yield Constant(path, name, ast.literal_eval(written), reason, *place)
        return
    for node in ast.parse(text).body:
        if not isinstance(node, ast.Assign) or len(node.targets) > 1:
            continue
        target, values = node.targets[0], [node.value]
        names = [target]
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            names, values = list(target.elts), list(node.value.elts)
        for name, value in zip(names, values, strict=False):
            if not (isinstance(name, ast.Name) and name.id.isupper()):
                continue
            number = _number(value)
            if number is not None:
                place = value.lineno, value.col_offset, value.end_col_offset or 0
                yield Constant(path, name.id, number, _reason(lines, node.lineno), *place)


def _number(value: ast.expr) -> float | None:
    """The number that is written there, or is made of such, as `np.radians(0.1)`; else None."""
    parts = list(ast.walk(value))
    written = any(isinstance(part, ast.Constant) for part in parts)
    named = {part.id for part in parts if isinstance(part, ast.Name)}
    if not written or not named <= {'np', 'math'}:
        return None
    number = eval(ast.unparse(value), {'np': np, 'math': math})
    if isinstance(number, bool) or not isinstance(number, int | float):
        return None
    return number if isinstance(number, int) else float(number)


def _reason(lines: list[str], line: int) -> str:
    """The comment above a line, or above those before it."""
    first = line - 1
    while first and lines[first - 1] and not lines[first - 1].startswith('#'):
        first -= 1
    words: list[str] = []
    while first and lines[first - 1].startswith('#'):
        first -= 1
        words.insert(0, lines[first].lstrip('# '))
    return ' '.join(words)


def panel() -> dict[str, float]:
    """Figures by what they are of: errors, and shares in % that are determined and covered."""
    found: dict[str, float] = {}
    recording = make_recording(tuple(motions()), _NOISES, 1, _SECONDS)
    ours = measure(recording)
    own = own_errors(recording, ours)
    known = {name: np.isfinite(own[name]) for name in QUANTITIES}
    for (motion, noise, quantity), error in pooled_rms(recording, own, known).items():
        found[f'error of {quantity}: {motion}, noise {noise:g}'] = error
    rig = list(rigs())[-1]
    seen = record(rig, _RATE, _LONG)
    for case in CASES:
        if case.what not in _WHAT:
            continue
        rng = np.random.default_rng((*case.what.encode(), *rig.encode(), round(_RATE)))
        outcome = run(seen, case.spoil(seen, rng))
        found |= {f'{what}: {case.what}': value for what, value in _figures(outcome).items()}
    return {what: value for what, value in found.items() if math.isfinite(value)}


def _figures(outcome: Outcome) -> dict[str, float]:
    found = {}
    for name in FIGURES:
        error, square = outcome.error[name], outcome.square[name]
        known = np.isfinite(error)
        with np.errstate(all='ignore'):
            each = rms(error, known)
            found[f'error of {name}'] = float(np.exp(np.nanmean(np.log(each))))
            found[f'{name} covered'] = 100.0 * float((square <= 9.0)[known].mean())
        found[f'{name} determined'] = 100.0 * float(known.mean())
    return found


def effect(before: dict[str, float], after: dict[str, float] | None) -> tuple[str, float]:
    """What a change does to the figures of a panel, in words, and by which share at most."""
    if after is None:
        return 'fails', math.inf
    worst, better = ('', 0.0), ('', 0.0)
    for what, was in before.items():
        now = after.get(what, math.nan)
        if what.startswith('error'):
            # More of it is worse.
            change = math.log(now / was) if now > 0 and was > 0 else math.nan
        else:
            change = (was - now) / 100
        if math.isnan(change):
            continue
        worst = max(worst, (what, change), key=lambda one: one[1])
        better = min(better, (what, change), key=lambda one: one[1])
    words = [
        f'{_change(what, change)} {what}'
        for what, change in (worst, better)
        if abs(change) > _LITTLE
    ]
    return '; '.join(words) or '–', max(worst[1], -better[1])


def _change(what: str, change: float) -> str:
    if what.startswith('error'):
        return f'×{math.exp(change):.2f}'
    return f'{-100 * change:+.0f} points'


def halved(value: float) -> float:
    """Half of it; of a count, a count."""
    return max(round(value / 2), 1) if isinstance(value, int) else value / 2


def doubled(value: float) -> float:
    return 2 * value


def measured(constant: Constant | None, value: float = 0.0) -> dict[str, float] | None:
    """The panel with another value of a constant, in a process of its own; None if that fails."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _copy(folder, constant, value)
        done = subprocess.run(
            [sys.executable, '-m', 'bench.constants', '--panel'],
            cwd=folder,
            env={**os.environ, 'PYTHONPATH': str(folder), 'OPENBLAS_NUM_THREADS': '1'},
            capture_output=True,
            timeout=_PATIENCE,
            check=False,
        )
    if done.returncode:
        return None
    figures: dict[str, float] = json.loads(done.stdout)
    return figures


def _copy(folder: Path, constant: Constant | None, value: float) -> None:
    """A checkout of links, but for the one file that is different."""
    for name in ('bench', 'config'):
        (folder / name).symlink_to(_ROOT / name)
    changed = _ROOT / constant.path if constant else None
    compiled = changed is not None and changed.suffix != '.py'
    _link(_ROOT / 'kinpole_ros', folder / 'kinpole_ros', changed)
    if constant is not None and changed is not None:
        lines = changed.read_text(encoding='utf-8').splitlines(keepends=True)
        line = lines[constant.line - 1]
        lines[constant.line - 1] = f'{line[: constant.column]}{value!r}{line[constant.end :]}'
        (folder / constant.path).write_text(''.join(lines), encoding='utf-8')
    if compiled:
        for name in ('setup.py', 'README.md'):
            (folder / name).symlink_to(_ROOT / name)
        build = [sys.executable, 'setup.py', '-q', 'build_ext', '--inplace']
        subprocess.run(build, cwd=folder, capture_output=True, check=True)


def _link(source: Path, into: Path, changed: Path | None) -> None:
    """Link to a file or folder; of folders with a `changed` file, to all that is beside it."""
    if changed is None or source not in changed.parents:
        into.symlink_to(source)
        return
    into.mkdir()
    for file in source.iterdir():
        is_old = changed.suffix != '.py' and file.name.startswith('_compiled')
        if file != changed and file.name != '__pycache__' and not is_old:
            _link(file, into / file.name, changed)


def constant_rows(
    progress: Callable[[float], None], workers: int, known: Rows, keep: Callable[[Rows], None]
) -> None:
    """
    A row by constant: where it is, what for, and what half and double of it do.

    Those that are `known` are not measured again; after each one `keep` is given all there are.
    """
    before = measured(None)
    if before is None:
        raise RuntimeError('the panel fails as it is')

    def row(constant: Constant) -> dict[str, object]:
        effects: dict[str, str | float] = {}
        for name, change in (('half', halved), ('double', doubled)):
            value = change(constant.value)
            try:
                after = measured(constant, value) if value != constant.value else before
            except subprocess.TimeoutExpired:
                after = None
            effects[name], effects[f'{name}_most'] = effect(before, after)
        return {
            'module': constant.path.removeprefix('kinpole_ros/'),
            'constant': constant.name,
            'value': constant.value,
            'reason': constant.reason,
            **effects,
        }

    found = {(one['module'], one['constant'], one['value']): one for one in known}
    every = constants()
    rows: Rows = []

    def known_or_new(one: Constant) -> dict[str, object]:
        return found.pop(_key(one), None) or row(one)

    with ThreadPoolExecutor(workers) as pool:
        for one in pool.map(known_or_new, every):
            rows.append(one)
            keep([*rows, *found.values()])
            progress(len(rows) / len(every))


def _key(one: Constant) -> tuple[str, str, float]:
    """By what its row is found; floats have five digits there."""
    return one.path.removeprefix('kinpole_ros/'), one.name, float(f'{one.value:.5g}')


def of_now(rows: Rows) -> Rows:
    """The rows of constants that are there with these values, in their order."""
    found = {(row['module'], row['constant'], row['value']): row for row in rows}
    there = ((found.get(_key(one)), one.reason) for one in constants())
    return [{**row, 'reason': reason} for row, reason in there if row]


def page(rows: Rows) -> str:
    """The page: constants that affect results, with the size of the effect, then the others."""
    effective = [row for row in rows if not row['half'] == row['double'] == '–']
    others = ', '.join(f'`{row["constant"]}`' for row in rows if row not in effective)
    missing = len(constants()) - len(rows)
    lines = [
        '# Constants',
        '',
        f'Which constants change results? These {len(effective)}, of {len(rows)} measured ones in',
        '`tracking/` and `derivatives/`. Measure a constant again when you change it:',
        f'`python -m bench.constants` makes this page. {missing} constants are not measured yet.',
        '',
        'The columns "half" and "double" show what changes by 5% or more with half or double the',
        'value: the quantity that gets worst and the one that gets best. The measure is the RMS',
        f'error of {len(motions())} motions at two noises and of a four-bar on {len(_WHAT)} real',
        'rigs, the share of frames with results, and the share within three standard deviations.',
        'The records are short, so a value may change by 5%.',
        '',
        '| constant | in | value | half | double |',
        '| --- | --- | --- | --- | --- |',
    ]
    for row in effective:
        effects = ' | '.join(str(row[name]).replace('|', '\\|') for name in ('half', 'double'))
        lines.append(f'| `{row["constant"]}` | `{row["module"]}` | {row["value"]:g} | {effects} |')
    lines += [
        '',
        f'Without such an effect: {others}. They limit time or memory, protect against input that',
        'is not in the measurement, or matter only over many cases.',
        '',
        'The reason for a value is the comment next to the constant. Constants of other packages',
        'are not measured: they limit files and memory, or decide what `discover` and `fit` find.',
    ]
    return wrapped('\n'.join(lines))


def main() -> None:
    parser = ArgumentParser(description=__doc__.split('\n', 2)[1])
    parser.add_argument('--output', type=Path, default=_ROOT / 'docs', help='folder of the page')
    parser.add_argument('--workers', type=int, default=1, help='processes at once (default: 1)')
    parser.add_argument('--anew', action='store_true', help='measure what is known already, too')
    parser.add_argument('--page', action='store_true', help='make the page of the table there is')
    parser.add_argument('--panel', action='store_true', help='print the figures as they are, JSON')
    options = parser.parse_args()
    if options.panel:
        json.dump(panel(), sys.stdout)
        return
    table = options.output / TABLE
    known = of_now(read_rows(table)) if table.exists() and not options.anew else []
    if options.page:
        write_rows(table, known)
    else:
        constant_rows(
            lambda share: print(f'\r{share:4.0%}', end='', file=sys.stderr, flush=True),
            options.workers,
            known,
            lambda rows: write_rows(table, rows),
        )
    (options.output / PAGE).write_text(page(read_rows(table)), encoding='utf-8')


if __name__ == '__main__':
    main()
