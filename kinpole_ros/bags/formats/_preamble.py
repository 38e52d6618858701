"""
What stands around the names of columns in a table: unit and rate above, units below.

Lines above the names are read where they say the unit or the rate, or their program is known:
NDI First Principles ("Frequency: 100", "Units: mm"), Logger Pro ("Vernier Format 2"), Visual3D. A
cell may have both coordinates of a point, as Python writes a tuple: "(292.0, 849.0)".
"""

import csv
import io
import re
from collections.abc import Callable, Sequence
from itertools import chain, islice
from typing import NamedTuple

from kinpole_ros.bags.formats._cells import is_decimal, number_in
from kinpole_ros.bags.formats._file import UNITS, File
from kinpole_ros.bags.formats._sheet import Sheet
from kinpole_ros.bags.formats._titles import find_columns

PIXELS = ('px', 'pixel', 'pixels')
_MOST_TITLE_ROWS = 10  # titles and comments above the names of columns
_MOST_UNIT_ROWS = 3  # short names and units below them
_LENGTHS = '|'.join(sorted({*UNITS, *PIXELS, 'mm', 'millimeters'}, key=len, reverse=True))
_UNIT = re.compile(
    r'\bunits?\b[^:=,;\t]*[:=,;\t ]+\(?(?P<any>[A-Za-zµ]+)'
    rf'|\b(?:in|all)\s+(?P<known>{_LENGTHS})\b'
    rf'|[(\[](?P<alone>{_LENGTHS})[)\]]',
    re.IGNORECASE,
)
_RATE = re.compile(
    r'\b(?:rate|frequency|freq|fps|frames per second|hz)\b[^0-9\n]{0,20}'
    r'(?P<after>[0-9]+(?:[.,][0-9]+)?)'
    r'|(?P<before>[0-9]+(?:[.,][0-9]+)?)\s*(?:hz|fps)\b',
    re.IGNORECASE,
)
_TUPLE = re.compile(r'[(\[]\s*([-+.\deE]+)[,\s]+([-+.\deE]+)(?:[,\s]+([-+.\deE]+))?\s*[)\]]', re.A)
_DATA_SET = re.compile(r'(?P<set>[^:]+):\s*(?P<title>\S.*)')  # "Latest: Time (s)", "Run 1: X (m)"
_VERNIER, _VISUAL3D = 'Vernier Format', 'ITEM'
_V3D_PLACES = ('TARGET', 'LANDMARK')  # other types are angles, forces and the like


class Preamble(NamedTuple):
    """What lines above the names of columns say."""

    row: int  # of the names
    unit: str | None = None  # None where they say none
    rate: float = 0.0  # Hz; 0 where they say none
    is_known: bool = True  # whether these lines were understood
    is_found: bool = True  # whether any row names columns of points


def read_preamble(sheet: Sheet) -> Preamble:
    """Find the row of names, and read the lines above it; row 0 where none names a column."""
    rows = [sheet.row(row) for row in range(min(_MOST_TITLE_ROWS, len(sheet)))]
    for row, header in enumerate(rows):
        is_visual3d = row >= 3 and header[:1] == [_VISUAL3D]
        if is_visual3d or find_columns(titles_of(header)).points or _tuple_columns(sheet, row):
            break
    else:
        return Preamble(0, is_found=False)
    # Those of Visual3D: file, name, type and folder; its lengths are in m.
    own = 4 if is_visual3d else 0
    text = '\n'.join(sheet.delimiter.join(cells) for cells in rows[: row - own])
    unit, rate = _UNIT.search(text), _RATE.search(text)
    is_vernier = row > 0 and rows[0][0].startswith(_VERNIER)
    return Preamble(
        row,
        next(filter(None, unit.groups()), None) if unit else 'm' if is_visual3d else None,
        number_in(next(filter(None, rate.groups()), '')) if rate else 0.0,
        row == 0 or bool(unit or rate) or is_vernier or is_visual3d,
    )


def titles_of(header: Sequence[str]) -> list[str]:
    """Return titles without the # of numpy and the name of a data set before each."""
    titles = [name.removeprefix('#').strip() for name in header]
    matches = [_DATA_SET.fullmatch(title) for title in titles if title]
    if not all(matches) or data_sets(titles):
        return titles
    plain = [_DATA_SET.sub(r'\g<title>', title) for title in titles]
    # Data sets beside that of the times keep their names.
    return [
        short if plain.index(short) == k else title.replace(':', '')
        for k, (short, title) in enumerate(zip(plain, titles, strict=True))
    ]


def data_sets(header: Sequence[str]) -> list[str]:
    """Return the names of several data sets in one table, each with times of its own."""
    matches = [match for title in header if (match := _DATA_SET.fullmatch(title.strip()))]
    sets = dict.fromkeys(m['set'] for m in matches if m['title'].lower().startswith('time'))
    return list(sets) if len(sets) > 1 else []


def plain_sheet(file: File, about: Preamble) -> Sheet:
    """
    Return the table with its names in row 0, units in their titles, and frames below.

    Lines keep their numbers. It is the sheet of the file where that is so already.
    """
    sheet = file.sheet
    titles = titles_of(sheet.row(about.row))
    first = about.row + 1
    if titles[:1] == [_VISUAL3D]:
        titles = _visual3d_titles(sheet, about.row)
    else:
        titles, first = _with_units(sheet, titles, first)
    tuples = _tuple_columns(sheet, about.row)
    if first == 1 and not tuples and titles == sheet.row(0):
        return sheet
    text = io.StringIO()
    writer = csv.writer(text, delimiter=sheet.delimiter, lineterminator='\n')
    text.write('\n' * (sheet.lines[first - 1] - 1))
    writer.writerow(_expanded(titles, tuples, _axis_titles))
    line = sheet.lines[first - 1]
    for row, cells in zip(sheet.lines[first:], islice(sheet.rows(), first, None), strict=True):
        text.write('\n' * (row - line - 1))
        writer.writerow(_expanded(cells, tuples, _coordinates))
        line = row
    return Sheet(file.path, text.getvalue().encode(), file.notes, sheet.not_utf8_line)


def _expanded(
    cells: Sequence[str], tuples: dict[int, int], expand: Callable[[str, int], list[str]]
) -> list[str]:
    """Return cells with those of the columns of tuples expanded."""
    parts = (expand(cell, tuples[k]) if k in tuples else [cell] for k, cell in enumerate(cells))
    return list(chain.from_iterable(parts))


def _axis_titles(title: str, count: int) -> list[str]:
    return [f'{title}_{axis}' for axis in 'xyz'[:count]]


def _coordinates(cell: str, count: int) -> list[str]:
    match = _TUPLE.fullmatch(cell.strip())
    numbers = [number for number in match.groups() if number] if match else []
    return numbers if len(numbers) == count else [cell.strip(), *[''] * (count - 1)]


def _tuple_columns(sheet: Sheet, row: int) -> dict[int, int]:
    """Return the columns whose first cell below a row has several coordinates, and how many."""
    cells = sheet.row(row + 1)
    found = {k: match for k, cell in enumerate(cells) if (match := _TUPLE.fullmatch(cell))}
    if any(map(is_decimal, sheet.row(row))):
        return {}
    return {k: sum(number is not None for number in found[k].groups()) for k in found}


def _with_units(sheet: Sheet, titles: list[str], first: int) -> tuple[list[str], int]:
    """Return titles with units that stand in a row below them, and the first row of numbers."""
    points = find_columns(titles).points
    columns = [column for axes in points.values() for column in axes.values()]
    for row in range(first, min(first + _MOST_UNIT_ROWS, len(sheet))):
        cells = sheet.row(row)
        units = {cells[k].strip('()[] ').lower() for k in columns if k < len(cells)}
        if len(units) == 1 and units <= {*UNITS, *PIXELS}:
            units_of = dict(enumerate(cell.strip('()[] ') for cell in cells))
            return [
                f'{title} ({units_of[k]})' if units_of.get(k) and '(' not in title else title
                for k, title in enumerate(titles)
            ], row + 1
        if any(map(is_decimal, cells)):
            break
    return titles, first


def _visual3d_titles(sheet: Sheet, row: int) -> list[str]:
    """Name columns of Visual3D by the rows above the axes: file, name, type, folder."""
    names, types, axes = sheet.row(row - 3), sheet.row(row - 2), sheet.row(row)
    titles = ['frame']
    for k in range(1, len(axes)):
        name = names[k] if k < len(names) else ''
        kind = types[k] if k < len(types) else ''
        is_place = kind.upper() in _V3D_PLACES and axes[k] in ('X', 'Y', 'Z')
        titles.append(f'{name}_{axes[k].lower()}' if is_place else f'{name} {axes[k]} [{kind}]')
    return titles
