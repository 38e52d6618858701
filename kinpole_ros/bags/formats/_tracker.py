"""
Tracker, of Open Source Physics: data files, of one track or of several.

One track: a line with its name, a line of columns, t, x, y among them. Several: the line #multi:,
a line with each name above its first column, then the columns. Lengths are in what the user
calibrated, with y up; columns may say the unit, as in "x (cm)".
"""

import re

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted
from kinpole_ros.bags.formats._sheet import Sheet, check_names, shown

_TITLE = re.compile(r'(?P<name>t|x|y|frame|step)(?:_\{.*\})?\s*(?:[(\[](?P<unit>[^)\]]*)[)\]])?')
_MULTI = '#multi:'
_FIX = 'export t, x and y of each track'


def _recognizes(file: File) -> bool:
    return file.is_text and _titles_row(file.sheet) is not None


def _titles_row(sheet: Sheet) -> int | None:
    """The row with the titles of columns, if this is such a file."""
    row = 2 if sheet.cell(0, 0) == _MULTI else 1
    titles = {match['name'] for cell in sheet.head(row) if (match := _TITLE.fullmatch(cell))}
    one_name = sum(bool(cell) for cell in sheet.head(0)) == 1
    return row if one_name and {'t', 'x', 'y'} <= titles else None


def _read(file: File, wanted: Wanted) -> Points:
    sheet, path = file.sheet, file.path
    row = _titles_row(sheet)
    if row is None:
        raise BagError(f'{path} is no data file of Tracker; fix: {_FIX}')
    titles = [_TITLE.fullmatch(cell) for cell in sheet.head(row)]
    columns: dict[str, dict[str, int]] = {}
    units = set()
    name = sheet.cell(0, 0) if row == 1 else ''
    for column, match in enumerate(titles):
        if row == 2:
            name = sheet.cell(1, column) or name
        if match is None or match['name'] not in ('x', 'y'):
            continue
        of_track = columns.setdefault(name, {})
        if match['name'] in of_track:
            raise BagError(
                f"{path}, line {sheet.lines[row]}: '{shown(name)}' has {match['name']} twice; "
                f'fix: {_FIX}'
            )
        of_track[match['name']] = column
        units.add(match['unit'] or '')
    for name, of_track in columns.items():
        if len(of_track) < 2 or not name:
            raise BagError(
                f"{path}, line {sheet.lines[row]}: '{shown(name)}' lacks x or y; fix: {_FIX}"
            )
    if len(units) > 1:
        raise BagError(
            f'{path}, line {sheet.lines[row]}: columns are in {shown(" and ".join(sorted(units)))};'
            ' fix: export all in one unit'
        )
    check_names(path, list(columns))
    first = row + 1
    kinds = [match['name'] if match else '' for match in titles]
    also = None if wanted.rate is not None else (kinds.index('t'), 't')
    places = [[c['x'], c['y']] for c in columns.values()]
    points, times = sheet.points(places, list(columns), first, also=also)
    return Points(
        list(columns),
        points,
        np.arange(len(points)),
        times if also else None,
        units.pop(),
        lines=sheet.lines[first:],
        time_column='t',
    )


FORMAT = Format(
    'tracker',
    'Tracker (Open Source Physics) data file, one track or several',
    'mass_A\nt\tx\ty\n0.04\t1.25E-1\t2.5E-1',
    _recognizes,
    _read,
)
