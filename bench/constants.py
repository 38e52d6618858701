"""
Constants set by hand, and what comes of half and of double of each: `python -m bench.constants`.

A constant is a number that a module of the estimate's rooms gives a name in capitals, be it written
as an expression; what is made of other constants is none. Each is changed in a copy of the package,
and a process of its own measures a panel of figures with it, so what is made of it goes with it.
"""

import ast
import json
import math
import os
import pickle
import re
import shutil
import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from ctypes import c_double, c_int
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench._markdown import wrapped
from bench._panel import inputs, panel
from bench._rows import Rows, read_rows, write_rows
from kinpole_ros.core.bindings import library

ROOMS = ('core', 'derivatives', 'tracking')
PAGE, TABLE = 'constants.md', 'charts/constants.csv'
_ROOT = Path(__file__).resolve().parent.parent
# A smaller change of an error, and of the CPU time, is no effect; points of a share.
_LITTLE, _LITTLE_TIME, _POINTS = 0.1, 1.0, 3.0
# Points of a share of reports: an event is several.
_REPORT_POINTS = 15.0
# What does not end in so many s hangs.
_PATIENCE = 120.0
# Bounds of memory and of text, marks, and definitions: they change no result but by their refusal.
_BOUNDS = {
    *('_MAX_TABLE_BYTES', 'MAX_HISTORY_BYTES', '_ALWAYS', 'NOT_ORDERED', '_IS_VALUE', '_IS_ARRAY'),
    *('MAX_CELLS', 'MAX_LENGTH', 'MAX_SPECTRA', 'TURN', 'MAX_SIGNALS', 'WIDTH', 'PAIR', 'SETS'),
    *('EVENTS', 'MOST_EVENT'),
    *('MOST_ORDER', 'MAX_WINDOWS', '_MOST_LAYOUTS', '_MOST_NOTES', 'FARTHEST_MARKER', 'TINY'),
    *('MOST_MARKERS', 'MOST_PAIRED_BODIES', 'EVENT_COLUMNS', '_MAX_POINTS'),
    *('MAX_SETS', '_MAX_FILE_BYTES', 'MAX_BODY_GROUPS', 'MAX_BODIES_WITH_SPECTRUM'),
}

# Why constants of a file stay that have no effect on the panel.
_REASONS = {
    'change_points.c': 'reports over many events and hours',
    'derive.c': 'bounds of time; noise prior, few samples, and gradual starts over many cases',
    'events.c': 'bounds of time; coverage over many events',
    'evidence.c': 'save time: what is left out weighs less than rounding, or than 1e-5',
    'fit.c': 'markers all but in one place',
    'follow.c': 'lag of live results',
    'hub.c': 'noise of the angle is no turning',
    'polynomials.h': 'coverage over many cases; hubs',
    'poles.c': 'which poles are told',
    'samples.c': 'a first guess only',
    'screens.c': 'no event at the ends of a window, or of rounding',
    '_spectra.py': 'many records',
    'segments.c': 'save time; coverage over many events',
    'window.c': 'exact samples, long windows, and stamps that the clock has not made even',
    'window.h': 'the same',
    '_event_search.py': 'short records',
    '_models.py': 'exact samples, parabolas, rounding',
    'bodies.py': 'long records',
    'candidates.py': 'bounds of time in clouds without names',
    'center.py': 'pins that move, or are seen for a moment',
    'clock.py': 'other stamps: ticks, grids, other rates, stalls',
    'deformation.py': 'soft tissue',
    'events.py': 'the time of a search',
    'frame_intervals.py': 'other stamps: ticks, grids, other rates, stalls',
    'frame_counter.py': 'stamps with many losses, or in bursts',
    'grouping.py': 'bodies that are not named',
    'identity.py': 'points without names that fit in two ways',
    'learn.py': 'shapes that change, and long records',
    'names.py': 'drivers that name points anew',
    'noise.py': 'noise that is correlated, or of a single marker',
    'other_noise.py': 'noise that is correlated, or of a single marker',
    'plane.py': 'planes that are fitted',
    'pose_points.py': 'poses instead of markers',
    'pose_noise.py': 'poses instead of markers',
    'rejection.py': 'markers that are exchanged, held, or far off',
    'scatter.py': 'soft tissue',
    'space.py': 'planes that are fitted',
    'stamp_grid.py': 'stamps on a grid',
    'state.py': 'long windows',
    'statistics.py': 'outliers among residuals',
    'summary.py': 'words of the summary',
    'thresholds.py': 'few frames, and changes of a body',
    'tick_evidence.py': 'stamps that are ticks',
    'timeline.py': 'stamps before the clock is known',
    'update.py': 'the time of updates',
}


class Constant(NamedTuple):
    """A number `value` of the name in a `path` under the package, there on `line` at `column`."""

    path: str
    name: str
    value: float
    line: int
    column: int
    end: int


def constants() -> list[Constant]:
    """All constants of the rooms that are no bounds, in their order."""
    return [
        constant
        for room in ROOMS
        for file in sorted((_ROOT / 'kinpole_ros' / room).glob('**/*.*'))
        for constant in _constants_of(file)
        if constant.name not in _BOUNDS
    ]


def _constants_of(file: Path) -> Iterator[Constant]:
    if file.suffix not in ('.c', '.h', '.py'):
        return
    text = file.read_text(encoding='utf-8')
    lines = text.splitlines()
    path = str(file.relative_to(_ROOT))
    if file.suffix != '.py':
        for at, line in enumerate(lines, 1):
            if not line.startswith(('#define', 'static const double')):
                continue
            for found in re.finditer(
                r'\b([A-Z_]{3,})(?: =)? ([\d.]+(?:e[+-]?\d+)?)(?=$|[,;])', line
            ):
                name, written = found.groups()
                yield Constant(path, name, ast.literal_eval(written), at, *found.span(2))
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
                yield Constant(path, name.id, number, *place)


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


def effect(before: dict[str, float], after: dict[str, float]) -> str:
    """
    Say what a change does to the figures of a panel.

    That is the figure that gets worst and the one that gets best, a dash if none does, and nothing
    if all are the same.
    """
    if not after:
        return 'fails'
    worst, better, is_same = ('–', 1.0), ('–', -1.0), True
    for what, was in before.items():
        now = after.get(what, math.nan)
        is_same &= now == was or what == 'CPU time'
        if what.startswith(('error', 'CPU')):
            least = _LITTLE_TIME if what.startswith('CPU') else _LITTLE
            # More of it is worse.
            change = math.log(now / was) / math.log1p(least) if now > 0 and was > 0 else 0.0
            words = f'×{now / was:.2f} {what}' if was > 0 else what
        else:
            points = _REPORT_POINTS if 'report' in what else _POINTS
            change, words = (was - now) / points, f'{now - was:+.0f} points {what}'
        if math.isnan(change):
            change, words = math.inf, f'no {what}'
        worst = max(worst, (words, change), key=lambda one: one[1])
        better = min(better, (words, change), key=lambda one: one[1])
    effects = [words for words, _ in (worst, better) if words != '–']
    return '; '.join(effects) or ('' if is_same else '–')


def halved(value: float) -> float:
    """Half of it; of a count, a count."""
    return max(round(value / 2), 1) if isinstance(value, int) else value / 2


def doubled(value: float) -> float:
    return 2 * value


class Copy:
    """
    A copy of the package in a folder, with what the panel is measured on.

    In its library the constants of C are variables, but for sizes of arrays and those in an
    initializer, for each of which it is compiled.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        for name in ('bench', 'config', 'setup.py', 'README.md'):
            (folder / name).symlink_to(_ROOT / name)
        ignored = shutil.ignore_patterns('__pycache__', '_compiled*')
        shutil.copytree(_ROOT / 'kinpole_ros', folder / 'kinpole_ros', ignore=ignored)
        (folder / 'inputs').write_bytes(pickle.dumps(inputs()))
        files = (folder / 'kinpole_ros' / 'core').rglob('*.[ch]')
        source = ''.join(file.read_text(encoding='utf-8') for file in files)
        self._variables = {
            one: f'constant_{number}'
            for number, one in enumerate(constants())
            if not one.path.endswith('.py')
            and re.search(rf'#define {one.name} [\d.]', (_ROOT / one.path).read_text('utf-8'))
            and not re.search(rf'\[[^]]*\b{one.name}\b|#define [A-Z_]+ .*\b{one.name}\b', source)
        }
        lines = [
            f'__attribute__((weak, visibility("default"))) {_type(one)} {name} = {one.value!r};\n'
            for one, name in self._variables.items()
        ]
        (folder / 'constants.h').write_text(''.join(lines), encoding='utf-8')
        for one, name in self._variables.items():
            self._write(one, name)
        if not self._is_built():
            raise RuntimeError('the library with variables for constants is not built')

    def _write(self, constant: Constant, written: str) -> None:
        """Write another expression in the place of a constant, the one left in its line."""
        file = self._folder / constant.path
        lines = file.read_text(encoding='utf-8').splitlines(keepends=True)
        line = (_ROOT / constant.path).read_text(encoding='utf-8').splitlines(keepends=True)
        before, after = line[constant.line - 1][: constant.column], line[constant.line - 1]
        lines[constant.line - 1] = before + written + after[constant.end :]
        file.write_text(''.join(lines), encoding='utf-8')

    def _is_built(self) -> bool:
        build = [sys.executable, 'setup.py', '-q', 'build_ext', '--inplace', '--force']
        environment = {**os.environ, 'CFLAGS': f'-include {self._folder}/constants.h'}
        return not subprocess.run(
            build, cwd=self._folder, env=environment, capture_output=True, check=False
        ).returncode

    def measure(self, constant: Constant | None = None, value: float = 0.0) -> dict[str, float]:
        """Measure the panel with another value of a constant; empty if that fails."""
        if constant in self._variables:
            return self._panel(self._variables[constant], _type(constant), repr(value))
        if constant is None:
            return self._panel()
        self._write(constant, repr(value))
        is_python = constant.path.endswith('.py')
        found = self._panel() if is_python or self._is_built() else {}
        self._write(constant, repr(constant.value))
        return found

    def _panel(self, *variable: str) -> dict[str, float]:
        try:
            done = subprocess.run(
                [sys.executable, '-B', '-m', 'bench.constants', '--panel', 'inputs', *variable],
                cwd=self._folder,
                env={**os.environ, 'PYTHONPATH': '.', 'OPENBLAS_NUM_THREADS': '1'},
                capture_output=True,
                timeout=_PATIENCE,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return {}
        figures: dict[str, float] = json.loads(done.stdout) if not done.returncode else {}
        return figures


def _type(constant: Constant) -> str:
    return 'int' if isinstance(constant.value, int) else 'double'


def constant_rows(
    progress: Callable[[float], None], known: Rows, keep: Callable[[Rows], None]
) -> None:
    """
    Keep a row by constant: where it is, and what half and double of it do.

    Those that are `known` are not measured again; after each one `keep` is given all there are.
    """
    found = {(one['module'], one['constant'], one['value']): one for one in known}
    every, rows = constants(), []
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        before = copy.measure()
        if not before:
            raise RuntimeError('the panel fails as it is')
        for number, one in enumerate(every, 1):
            row = found.pop(_key(one), None) or {
                'module': one.path.removeprefix('kinpole_ros/'),
                'constant': one.name,
                'value': one.value,
            } | {
                name: effect(before, copy.measure(one, change(one.value)))
                if change(one.value) != one.value
                else ''
                for name, change in (('half', halved), ('double', doubled))
            }
            rows.append(row)
            keep([*rows, *found.values()])
            progress(number / len(every))


def _key(one: Constant) -> tuple[str, str, float]:
    """By what its row is found; floats have five digits there."""
    return one.path.removeprefix('kinpole_ros/'), one.name, float(f'{one.value:.5g}')


def of_now(rows: Rows, now: list[Constant] | None = None) -> Rows:
    """The rows of constants that are there now with these values, in their order."""
    found = {(row['module'], row['constant'], row['value']): row for row in rows}
    now = constants() if now is None else now
    return [found[_key(one)] for one in now if _key(one) in found]


def page(rows: Rows) -> str:
    """The page: constants that affect results, with the size of the effect, then the others."""
    inert = {'', '–'}
    effective = [row for row in rows if not {row['half'], row['double']} <= inert]
    others = [row for row in rows if row not in effective]
    missing = ', '.join(f'`{one.name}`' for one in constants() if not of_now(rows, [one]))
    number = len(constants()) - len(rows)
    lines = [
        '# Constants',
        '',
        f'Which constants change results? These {len(effective)}, of {len(rows)} that are measured',
        'in `core/`, `derivatives/` and `tracking/`. Measure a constant again when you change it:',
        '`python -m bench.constants` measures those that are new or have another value, and makes',
        f'this page. {number} are not measured yet.',
        '',
        'The columns "half" and "double" show what half or double the value changes most, for the',
        f'worse and for the better: an error by {_LITTLE:.0%} or more, the share of frames with',
        f'results, or within three standard deviations, by {_POINTS:g} points, the share of events',
        'reported by several events, CPU time by a factor of 2. An empty cell has no difference.',
        'The measure is the RMS error of bodies with and without events, at 200 Hz, and at 60 Hz',
        'with late stamps, lost frames, hidden, noisy and misplaced markers, and of a four-bar of',
        'markers without names. The records are short: one frame may make a large factor. A row is',
        'of the code of the day it was measured.',
        '',
        '| constant | in | value | half | double |',
        '| --- | --- | --- | --- | --- |',
    ]
    for row in effective:
        effects = ' | '.join(str(row[name]).replace('|', '\\|') for name in ('half', 'double'))
        lines.append(f'| `{row["constant"]}` | `{row["module"]}` | {row["value"]:g} | {effects} |')
    lines += ['', f'Without such an effect are {len(others)}. They stay for:', '']
    lines += ['| in | constants | reason |', '| --- | --- | --- |']
    for module in dict.fromkeys(row['module'] for row in others):
        names = ', '.join(f'`{row["constant"]}`' for row in others if row['module'] == module)
        lines.append(f'| `{module}` | {names} | {_REASONS[Path(module).name]} |')
    lines += [
        '',
        'The reason for a value is the comment next to the constant. Bounds of memory are not',
        'measured, nor are those of other packages.',
        *(['', f'Not measured yet: {missing}.'] if missing else []),
    ]
    return wrapped('\n'.join(lines))


def main() -> None:
    parser = ArgumentParser(description=__doc__.split('\n', 2)[1])
    parser.add_argument('--output', type=Path, default=_ROOT / 'docs', help='folder of the page')
    parser.add_argument('--anew', action='store_true', help='measure what is known already, too')
    parser.add_argument('--page', action='store_true', help='make the page of the table there is')
    parser.add_argument(
        '--panel',
        nargs='+',
        help='print figures of these inputs, JSON, with a variable of this type at this value',
    )
    options = parser.parse_args()
    if options.panel:
        for name, kind, value in [options.panel[1:]] if options.panel[1:] else []:
            found = (c_int if kind == 'int' else c_double).in_dll(library, name)
            found.value = ast.literal_eval(value)
        json.dump(panel(pickle.loads(Path(options.panel[0]).read_bytes())), sys.stdout)
        return
    table = options.output / TABLE
    known = of_now(read_rows(table)) if table.exists() and not options.anew else []
    if options.page:
        write_rows(table, known)
    else:
        constant_rows(
            lambda share: print(f'\r{share:4.0%}', end='', file=sys.stderr, flush=True),
            known,
            lambda rows: write_rows(table, rows),
        )
    (options.output / PAGE).write_text(page(read_rows(table)), encoding='utf-8')


if __name__ == '__main__':
    main()
