"""
Whether the tests would notice: one fault at a time in a copy of the project, and what fails.

`python test/seed_faults.py` chooses 60 places by a seed, 20 of them in C, spread over the packages:
a sign, a bound, a number off by one, two arguments exchanged, a unit dropped. A fault that leaves
the code as it was cannot be caught, so what counts is the number before and after a change of the
tests: `--output` keeps a row for each fault, `--faults` repeats those of such a file.
"""

import argparse
import ast
import csv
import os
import random
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
IN_C = 20
# A test run that a fault has made endless, s.
PATIENCE = 1800
SWAPS = {'+': '-', '-': '+', '<': '<=', '<=': '<', '>': '>=', '>=': '>'}
OPERATORS = {
    ast.Add: '+',
    ast.Sub: '-',
    ast.Lt: '<',
    ast.LtE: '<=',
    ast.Gt: '>',
    ast.GtE: '>=',
}


class Fault(NamedTuple):
    """In the file at `path`, `old` on a line (from 1) at a column becomes `new`."""

    path: str
    line: int
    column: int
    old: str
    new: str
    kind: str


def faults_of(path: Path) -> Iterator[Fault]:
    """The faults that could be seeded in a file."""
    name, text = str(path.relative_to(ROOT)), path.read_text(encoding='utf-8')
    if path.suffix == '.py':
        lines = text.splitlines()
        for node in ast.walk(ast.parse(text)):
            for line, column, old, new, kind in _python_faults(node, lines):
                yield Fault(name, line, column, old, new, kind)
        return
    is_comment = False
    for at, line in enumerate(text.splitlines(), 1):
        is_comment |= line.lstrip().startswith('/*')
        if not is_comment and not line.lstrip().startswith(('#', '//')):
            code = line.partition('/*')[0]
            for found in re.finditer(r' (\+|-|<|<=|>|>=) (?=\w)', code):
                kind = 'sign' if found[1] in '+-' else 'bound'
                yield Fault(name, at, found.start(1), found[1], SWAPS[found[1]], kind)
            for found in re.finditer(r'(?<=[+\-\[] )?\b([1-9])\b(?=[\];)])', code):
                yield Fault(name, at, found.start(1), found[1], str(int(found[1]) + 1), 'number')
            for found in re.finditer(r'(?<=\()(\w+), (\w+)(?=[,)])', code):
                new = f'{found[2]}, {found[1]}'
                yield Fault(name, at, found.start(), found[0], new, 'arguments')
        if '*/' in line:
            is_comment = False


def _python_faults(node: ast.AST, lines: list[str]) -> Iterator[tuple[int, int, str, str, str]]:
    """Line, column, old and new text, and kind of each fault of a node on one line."""
    if isinstance(node, ast.BinOp | ast.Compare):
        right = node.right if isinstance(node, ast.BinOp) else node.comparators[0]
        left = node.left
        operator = node.op if isinstance(node, ast.BinOp) else node.ops[0]
        sign = OPERATORS.get(type(operator))
        if sign and left.end_lineno == right.lineno:
            between = lines[right.lineno - 1].encode()[left.end_col_offset : right.col_offset]
            if between.decode().strip() == sign:
                column = (left.end_col_offset or 0) + between.index(sign.encode())
                kind = 'sign' if sign in '+-' else 'bound'
                yield right.lineno, column, sign, SWAPS[sign], kind
        if (
            isinstance(operator, ast.Mult | ast.Div)
            and isinstance(right, ast.Constant)
            and isinstance(right.value, int | float)
            and right.value in (1e-9, 1e9, 1e-3, 1e3, 1e6)
            and left.end_lineno == right.lineno == right.end_lineno
        ):
            line = lines[right.lineno - 1]
            old = line[left.end_col_offset : right.end_col_offset]
            yield right.lineno, left.end_col_offset or 0, old, '', 'unit'
    elif isinstance(node, ast.Constant) and type(node.value) is int and 0 < node.value < 10:
        yield node.lineno, node.col_offset, str(node.value), str(node.value + 1), 'number'
    elif isinstance(node, ast.Call) and len(node.args) > 1:
        first, second = node.args[:2]
        names = isinstance(first, ast.Name) and isinstance(second, ast.Name)
        if names and first.lineno == second.lineno:
            old = lines[first.lineno - 1][first.col_offset : second.end_col_offset]
            yield first.lineno, first.col_offset, old, f'{second.id}, {first.id}', 'arguments'


def choose(count: int, seed: int) -> list[Fault]:
    """Some faults of each package and kind, by turns; a third of them in C."""
    chance = random.Random(seed)
    groups: dict[bool, dict[tuple[str, str], list[Fault]]] = {
        True: defaultdict(list),
        False: defaultdict(list),
    }
    for path in sorted((ROOT / 'kinpole_ros').rglob('*')):
        if path.suffix in ('.py', '.c'):
            is_c = path.suffix == '.c'
            room = path.name if is_c else path.parent.name
            for fault in faults_of(path):
                groups[is_c][room, fault.kind].append(fault)
    chosen: list[Fault] = []
    for is_c, by_kind in groups.items():
        keys = sorted(by_kind)
        chance.shuffle(keys)
        wanted = IN_C if is_c else count - IN_C
        chosen += [chance.choice(by_kind[key]) for key in keys[:wanted]]
    return chosen


def copy_project(folder: Path) -> None:
    listing = subprocess.run(['git', 'ls-files', '-z'], cwd=ROOT, capture_output=True, check=True)
    for name in listing.stdout.decode().split('\0'):
        if name and (ROOT / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def run_tests(folder: Path, arguments: list[str]) -> str:
    """The first test that fails in a copy of the project; '' if none does."""
    variables = {'PYTEST_DISABLE_PLUGIN_AUTOLOAD': '1', 'OPENBLAS_NUM_THREADS': '1'}
    environment = os.environ | variables | {'PYTHONPATH': str(folder)}
    command = [sys.executable, '-m', 'pytest', '-q', '-x', *arguments]
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE
        )
    except subprocess.TimeoutExpired:
        return 'hangs'
    failed = re.findall(r'^(?:FAILED|ERROR) (\S+)', done.stdout, re.MULTILINE)
    return (
        failed[0] if failed else '' if done.returncode in (0, 5) else f'ends with {done.returncode}'
    )


def try_fault(fault: Fault, folder: Path, arguments: list[str]) -> str:
    """What fails with a fault in a copy of the project, whose file is as before afterwards."""
    file = folder / fault.path
    text = file.read_text(encoding='utf-8')
    lines = text.splitlines(keepends=True)
    line = lines[fault.line - 1].encode()
    if not line[fault.column :].startswith(fault.old.encode()):
        return 'is gone'
    end = fault.column + len(fault.old.encode())
    lines[fault.line - 1] = (line[: fault.column] + fault.new.encode() + line[end:]).decode()
    file.write_text(''.join(lines), encoding='utf-8')
    try:
        if file.suffix == '.c' and not build(folder):
            return 'does not compile'
        return run_tests(folder, arguments)
    finally:
        file.write_text(text, encoding='utf-8')
        if file.suffix == '.c':
            build(folder)


def build(folder: Path) -> bool:
    command = [sys.executable, 'setup.py', '-q', 'build_ext', '--inplace', '--force']
    return subprocess.run(command, cwd=folder, capture_output=True).returncode == 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=60)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--faults', type=Path, help='repeat what a file says was not caught')
    parser.add_argument('--copy', type=Path, required=True, help='folder for the copy')
    parser.add_argument('--output', type=Path, required=True)
    parser.add_argument('tests', nargs='*', help='arguments of pytest')
    options = parser.parse_args()
    copy_project(options.copy)
    build(options.copy)
    if options.faults:
        with options.faults.open(newline='') as file:
            rows = [row for row in csv.reader(file) if not row[-1]]
        faults = [Fault(p, int(line), int(column), *rest) for p, line, column, *rest, _ in rows]
    else:
        faults = choose(options.count, options.seed)
    with options.output.open('w', newline='') as file:
        for fault in faults:
            caught = try_fault(fault, options.copy, options.tests)
            csv.writer(file, lineterminator='\n').writerow([*fault, caught])
            file.flush()
            print(f'{fault.path}:{fault.line} {fault.old} -> {fault.new}: {caught or "not caught"}')


if __name__ == '__main__':
    main()
