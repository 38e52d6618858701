"""The plain table, which anyone can write: a line of names, then a line a frame."""

from collections import Counter

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted, not_utf8, shown

_AXES = ('_x', '_y', '_z')


def _recognizes(file: File) -> bool:
    return file.is_text and any(cell.endswith(_AXES) for cell in file.sheet.head(0))


def _read(file: File, wanted: Wanted) -> Points:
    """
    NAME_x and NAME_y for each marker, NAME_z where there is one (else z is 0), and t, in s.

    Other columns are ignored. A cell that is empty or 'nan' means that its marker was not seen in
    that frame. The unit is m. Raises BagError naming line and column when it is not so.
    """
    sheet, path = file.sheet, file.path
    if sheet.not_utf8_line:
        raise not_utf8(path, sheet.not_utf8_line)
    if len(sheet.rows) < 2:
        has = 'has no frames, only a line of names' if sheet.rows else 'is empty'
        raise BagError(f'{path} {has}; fix: give a line of names and a line for each frame')
    header, head_line = sheet.head(0), sheet.lines[0]
    for name, count in Counter(header).items():
        if name and count > 1:
            raise BagError(
                f"{path}, line {head_line}: column '{shown(name)}' is there twice; fix: rename one"
            )
    for row, line in zip(sheet.rows, sheet.lines, strict=True):
        if len(row) != len(header):
            raise BagError(
                f'{path}, line {line}: {len(row)} cells under {len(header)} names; '
                'fix: as many separators in each line'
            )
    places = {name: index for index, name in enumerate(header)}
    # A dict, not a set: markers keep the order of the columns.
    names = list(dict.fromkeys(c[:-2] for c in header if c[:-2] and c[-2:] in _AXES))
    if not names:
        raise BagError(
            f'{path}, line {head_line}: no column is named NAME_x; fix: name the columns of each '
            'marker NAME_x and NAME_y, with commas between them'
        )
    points = np.zeros((len(sheet.rows) - 1, len(names), 3))
    for index, name in enumerate(names):
        for axis, end in enumerate(_AXES):
            column = f'{name}{end}'
            if column in places:
                points[:, index, axis] = sheet.column(places[column], 1, column)
            elif end != '_z':
                raise BagError(
                    f"{path}, line {head_line}: marker '{shown(name)}' has no column "
                    f'{shown(column)}; fix: add it'
                )
    times = sheet.column(places['t'], 1, 't') if wanted.rate is None and 't' in places else None
    frames = np.arange(len(points))
    return Points(names, points, frames, times, 'm', lines=sheet.lines[1:], time_column='t')


FORMAT = Format(
    'table',
    'columns NAME_x, NAME_y, maybe NAME_z, and t in seconds',
    't,tip_x,tip_y\n0.00,0.125,0.250',
    _recognizes,
    _read,
)
