"""The plain table, which anyone can write: a line of names, then a line a frame."""

import re
from collections import Counter
from itertools import product

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted, not_utf8
from kinpole_ros.bags.formats._sheet import Sheet, shown

# "time", "Time (s)", "t [s]", "timestamp_ns", "time_ms".
_TIME = re.compile(
    r'(?:t|time|timestamp|time[ _]?stamp)\s*'
    r'(?:[(\[](?P<bracketed>[^)\]]*)[)\]]|[_ ](?P<unit>[a-zµ]+))?',
    re.IGNORECASE,
)
_SECONDS = {
    **dict.fromkeys(('s', 'sec', 'secs', 'second', 'seconds'), 1.0),
    **dict.fromkeys(('ms', 'msec', 'millisecond', 'milliseconds'), 1e-3),
    **dict.fromkeys(('us', 'µs', 'usec', 'microsecond', 'microseconds'), 1e-6),
    **dict.fromkeys(('ns', 'nsec', 'nanosecond', 'nanoseconds'), 1e-9),
    **dict.fromkeys(('min', 'minute', 'minutes'), 60.0),
}
_AXES = ('_x', '_y', '_z')


def _recognizes(file: File) -> bool:
    return file.is_text and any(cell.endswith(_AXES) for cell in file.sheet.head(0))


def _read(file: File, wanted: Wanted) -> Points:
    """
    NAME_x and NAME_y for each marker, NAME_z where there is one (else z is 0), and t, in s,
    or another column named as one of times.

    Other columns are ignored. A cell that is empty or 'nan' means that its marker was not seen in
    that frame. The unit is m. Raises BagError naming line and column when it is not so.
    """
    sheet, path = file.sheet, file.path
    if sheet.not_utf8_line:
        raise not_utf8(path, sheet.not_utf8_line)
    if len(sheet) < 2:
        has = 'has no frames, only a line of names' if len(sheet) else 'is empty'
        raise BagError(f'{path} {has}; fix: give a line of names and a line for each frame')
    header, head_line = sheet.head(0), sheet.lines[0]
    for name, count in Counter(header).items():
        if name and count > 1:
            raise BagError(
                f"{path}, line {head_line}: column '{shown(name)}' is there twice; fix: rename one"
            )
    if (uneven := sheet.uneven_row()) is not None:
        raise BagError(
            f'{path}, line {sheet.lines[uneven]}: {len(sheet.head(uneven))} cells under '
            f'{len(header)} names; fix: as many separators in each line'
        )
    places = {name: index for index, name in enumerate(header)}
    # A dict, not a set: markers keep the order of the columns.
    names = list(dict.fromkeys(c[:-2] for c in header if c[:-2] and c[-2:] in _AXES))
    if not names:
        raise BagError(
            f'{path}, line {head_line}: no column is named NAME_x; fix: name the columns of each '
            'marker NAME_x and NAME_y, with commas between them'
        )
    for name, end in product(names, _AXES[:2]):
        if f'{name}{end}' not in places:
            raise BagError(
                f"{path}, line {head_line}: marker '{shown(name)}' has no column "
                f'{shown(name + end)}; fix: add it'
            )
    columns = [[places[name + end] for end in _AXES if name + end in places] for name in names]
    time_column = None if wanted.rate is not None else _time_column(sheet)
    title = 't' if time_column is None else header[time_column[0]]
    also = None if time_column is None else (time_column[0], title)
    points, numbers = sheet.points(columns, names, 1, also=also, separator='_')
    return Points(
        names,
        points,
        np.arange(len(points)),
        None if time_column is None else numbers * time_column[1],
        'm',
        lines=sheet.lines[1:],
        time_column=shown(title),
    )


def _time_column(sheet: Sheet) -> tuple[int, float] | None:
    """
    Index of the column of times and the seconds of its unit; None where there is none.

    A column t is that of times, whatever others there are. Raises BagError where several others
    could be, or one is in a unit that is not known.
    """
    header = sheet.head(0)
    if 't' in header:
        return header.index('t'), 1.0
    found = {}
    for column, name in enumerate(header):
        if match := _TIME.fullmatch(name):
            found[column] = (match['bracketed'] or match['unit'] or 's').strip().lower()
    if len(found) > 1:
        named = ', '.join(f"'{shown(header[column])}'" for column in found)
        raise BagError(
            f'{sheet.path}, line {sheet.lines[0]}: the times could be in any of {named}; '
            'fix: name the one to use t, in seconds, or give --rate HZ'
        )
    for column, unit in found.items():
        if unit not in _SECONDS:
            raise BagError(
                f"{sheet.path}, line {sheet.lines[0]}: column '{shown(header[column])}' is in a "
                f'unit that is not known; fix: name it t, in seconds, or give --rate HZ'
            )
        return column, _SECONDS[unit]
    return None


FORMAT = Format(
    'table',
    'columns NAME_x, NAME_y, maybe NAME_z, and t in seconds',
    't,tip_x,tip_y\n0.00,0.125,0.250',
    _recognizes,
    _read,
)
