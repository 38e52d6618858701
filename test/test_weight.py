"""
How heavy each package is: what `weight.csv` allows, which only falls unless a row says why.

`python test/test_weight.py` writes today's figures into the table, and keeps the reasons.
"""

import ast
import csv
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parents[1] / 'kinpole_ros'
TABLE = Path(__file__).with_name('weight.csv')
FIGURES = ('statements', 'constants', 'state_fields', 'files')
# A table further above the code than this share no longer holds it.
SLACK = 0.02


def room_of(path: Path) -> str:
    """The package of a file; `top` for those beside the packages."""
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else 'top'


def lines_of_code(text: str) -> int:
    """Lines of C that are neither blank nor comment alone."""
    without = re.sub(r'/\*.*?\*/|//[^\n]*', '', text, flags=re.DOTALL)
    return sum(bool(line.strip()) for line in without.splitlines())


def statements(tree: ast.Module) -> int:
    """Statements of Python, less docstrings."""
    return sum(
        isinstance(node, ast.stmt)
        and not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
        for node in ast.walk(tree)
    )


def constants(tree: ast.Module) -> int:
    """Names in capitals that a module assigns."""
    return sum(
        isinstance(name, ast.Name) and name.id.isupper()
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        for name in ast.walk(target)
    )


def constants_of_c(line: str) -> list[str]:
    """Names in capitals that a line of C gives a value."""
    if line.startswith('#define'):
        return re.findall(r'^#define [A-Z][A-Z0-9_]* +[^\s(]', line)
    return re.findall(r'\b[A-Z][A-Z0-9_]+ =', line) if line.startswith('static const') else []


def attributes(cls: ast.ClassDef) -> Iterator[str]:
    """Attributes that methods set, and fields where the class is a dataclass that may change."""
    for node in ast.walk(cls):
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Store)
            and isinstance(node.value, ast.Name)
            and node.value.id == 'self'
        ):
            yield node.attr
    marks = [ast.unparse(mark) for mark in cls.decorator_list]
    if any('dataclass' in mark and 'frozen=True' not in mark for mark in marks):
        fields = [node.target for node in cls.body if isinstance(node, ast.AnnAssign)]
        yield from (field.id for field in fields if isinstance(field, ast.Name))


def state_fields(tree: ast.Module) -> int:
    classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    return sum(len(set(attributes(cls))) for cls in classes)


def weigh() -> dict[str, dict[str, int]]:
    """Figures of each package."""
    found: dict[str, dict[str, int]] = {}
    for path in sorted(PACKAGE.rglob('*')):
        if path.suffix not in ('.py', '.c', '.h'):
            continue
        weight = found.setdefault(room_of(path), dict.fromkeys(FIGURES, 0))
        text = path.read_text(encoding='utf-8')
        weight['files'] += 1
        if path.suffix == '.py':
            tree = ast.parse(text)
            weight['statements'] += statements(tree)
            weight['constants'] += constants(tree)
            weight['state_fields'] += state_fields(tree)
        else:
            weight['statements'] += lines_of_code(text)
            weight['constants'] += sum(map(len, map(constants_of_c, text.splitlines())))
    return found


def read_table() -> dict[str, dict[str, Any]]:
    with TABLE.open(newline='') as file:
        return {row['package']: row for row in csv.DictReader(file)}


def test_no_package_is_heavier_than_its_row_allows():
    table, found = read_table(), weigh()
    assert table.keys() == found.keys()
    for room, weight in found.items():
        for figure, value in weight.items():
            allowed = int(table[room][figure])
            assert value <= allowed, (
                f'{room} has {value} {figure}, {allowed} are allowed: take something away, or run '
                f'python {Path(__file__).name} and say in the row why it grew'
            )
            assert value >= allowed * (1 - SLACK) - 1, (
                f'{room} has {value} {figure} of {allowed}: run python {Path(__file__).name}, so '
                'that it stays as light'
            )


if __name__ == '__main__':
    reasons = {room: row['why'] for room, row in read_table().items()} if TABLE.exists() else {}
    with TABLE.open('w', newline='') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(['package', *FIGURES, 'why'])
        for room, weight in weigh().items():
            writer.writerow([room, *weight.values(), reasons.get(room, '')])
