"""
The plain table, which anyone can write: a line of names, then a line for each frame.

Columns are NAME_x and NAME_y for each marker, maybe NAME_z (else z is 0), and t, in s, or another
column named as one of times. One marker may have columns x and y alone. Others are named in a line.
A cell that is empty or 'nan' means that its marker was not seen in that frame. The unit is m, if no
column says another.

Anipose writes such a table, too: fnum, and x, y, z, error, ncams and score of each point, in the
unit of its calibration.
"""

import re
from collections import Counter
from collections.abc import Sequence
from itertools import product

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._cells import listed, shown, whole_numbers
from kinpole_ros.bags.formats._file import File, Format, Options, Points, not_utf8
from kinpole_ros.bags.formats._sheet import Sheet

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
# "frame", "Frame#", "fnum", "frame_number".
_FRAME = re.compile(
    r'f(?:rame|num)s?(?:[ _]?(?:number|num|no|nr|index|idx|id|#)\.?)?', re.IGNORECASE
)
_AXES = ('_x', '_y', '_z')
_MOST_TITLE_ROWS = 10  # titles and comments above the names of columns
# Where no column is named NAME_x: "x", "X (mm)", "x1", "tip x", "tip.x [cm]".
_COORDINATE = re.compile(
    r'(?:(?P<name>.+)[ _.:/-])?(?P<axis>[xyz])(?P<number>[0-9]*)\s*(?:[(\[](?P<unit>.*)[)\]])?',
    re.IGNORECASE,
)


def header_row(sheet: Sheet) -> int:
    """Return the first of some rows that names the columns of a table, as row 0 should; or 0."""
    titles = ([cell.strip() for cell in sheet.row(row)] for row in range(_MOST_TITLE_ROWS))
    return next((row for row, header in enumerate(titles) if _axes_by_marker(header)[0]), 0)


def _is_table(file: File) -> bool:
    return file.is_sheet and bool(_axes_by_marker(_header(file.sheet))[0])


def _is_anipose(file: File) -> bool:
    header = _header(file.sheet) if file.is_sheet else []
    return 'fnum' in header and any(name.endswith('_ncams') for name in header)


def _header(sheet: Sheet) -> list[str]:
    """Return the names of columns; numpy puts a # before the first."""
    return [name.removeprefix('#').strip() for name in sheet.row(0)]


def _axes_by_marker(header: Sequence[str]) -> tuple[dict[str, dict[str, int]], str]:
    """
    Find columns by marker and axis, in the order of the header, and the unit in them, else ''.

    Where no column is named NAME_x, those with x and y in another notation count.
    """
    axes: dict[str, dict[str, int]] = {}
    for column, title in enumerate(header):
        if title[:-2] and title[-2:] in _AXES:
            axes.setdefault(title[:-2], {})[title[-1]] = column
    if axes:
        return axes, ''
    units = set()
    for column, title in enumerate(header):
        if match := _COORDINATE.fullmatch(title):
            name = match['name'] or f'point{match["number"]}'
            axes.setdefault(name, {}).setdefault(match['axis'].lower(), column)
            units.add((match['unit'] or '').strip())
    axes = {name: columns for name, columns in axes.items() if {'x', 'y'} <= columns.keys()}
    return axes, ' and '.join(sorted(units))


def _read(file: File, options: Options) -> Points:
    """Read the columns of markers, and those of times or of frame numbers."""
    sheet, path = file.sheet, file.path
    if sheet.not_utf8_line:
        raise not_utf8(path, sheet.not_utf8_line)
    if len(sheet) < 2:
        fault = 'has no frames, only a line of names' if len(sheet) else 'is empty'
        raise BagError(f'{path} {fault}; fix: give a line of names and a line for each frame')
    header, head_line = _header(sheet), sheet.lines[0]
    for name, count in Counter(header).items():
        if name and count > 1:
            raise BagError(
                f"{path}, line {head_line}: column '{shown(name)}' is there twice; fix: rename one"
            )
    if (uneven := sheet.uneven_row()) is not None:
        raise BagError(
            f'{path}, line {sheet.lines[uneven]}: {len(sheet.row(uneven))} cells under '
            f'{len(header)} names; fix: as many separators in each line'
        )
    axes, unit = _axes_by_marker(header)
    if not axes:
        raise BagError(
            f'{path}, line {head_line}: no column is named NAME_x; fix: name the columns of each '
            'marker NAME_x and NAME_y, with commas between them'
        )
    for name, axis in product(axes, 'xy'):
        if axis not in axes[name]:
            raise BagError(
                f"{path}, line {head_line}: marker '{shown(name)}' has no column "
                f'{shown(f"{name}_{axis}")}; fix: add it'
            )
    columns = {name: [of[axis] for axis in 'xyz' if axis in of] for name, of in axes.items()}
    time_column = None if options.rate is not None else _time_column(sheet, header)
    number = next((k for k, name in enumerate(header) if _FRAME.fullmatch(name)), None)
    index, seconds = time_column or (number, 1.0)
    title = 't' if index is None else header[index]
    points, numbers = sheet.points(
        columns, 1, number=None if index is None else (index, title), separator='_'
    )
    lines, frames = sheet.lines[1:], np.arange(len(points))
    if time_column is None and number is not None:
        frames = whole_numbers(path, numbers, lines, title)
    used = {number, index, *(column for of in columns.values() for column in of)}
    used |= _leave_out_unlikely(sheet, header, points, list(columns), options)
    unread = [shown(name) for k, name in enumerate(header) if name and k not in used]
    if unread and not _is_anipose(file):
        sheet.notes.append(f'{path}: columns that are not read: {listed(unread)}')
    in_pixels = unit.lower() in ('px', 'pixel', 'pixels')
    if in_pixels:
        sheet.notes.append(f'{path} is in pixels, so y points down, if not by --no-y-down')
    return Points(
        list(columns),
        points,
        frames,
        None if time_column is None else numbers * seconds,
        '' if _is_anipose(file) else unit or 'm',
        y_down=in_pixels,
        lines=lines,
        time_column=shown(title),
    )


def _leave_out_unlikely(
    sheet: Sheet, header: Sequence[str], points: np.ndarray, names: list[str], options: Options
) -> set[int]:
    """Blank points (T, n, 3) below the likelihood; return the columns of likelihoods."""
    columns = {
        k: header.index(title)
        for k, name in enumerate(names)
        for title in (f'{name}_likelihood', f'{name}_score')
        if title in header
    }
    if options.likelihood is not None:
        if not columns:
            raise BagError(
                f'{sheet.path} has no likelihoods; fix: name their columns NAME_likelihood, or '
                'leave that out'
            )
        for k, column in columns.items():
            likelihood = sheet.column(column, 1, header[column])
            points[~(likelihood >= options.likelihood), k] = np.nan
    return set(columns.values())


def _time_column(sheet: Sheet, header: list[str]) -> tuple[int, float] | None:
    """
    Return the index of the column of times and the seconds of its unit; None where there is none.

    A column t is that of times, whatever others there are. Raises BagError where several others
    could be, or one is in a unit that is not known.
    """
    if 't' in header:
        return header.index('t'), 1.0
    units = {}
    for column, name in enumerate(header):
        if match := _TIME.fullmatch(name):
            units[column] = (match['bracketed'] or match['unit'] or 's').strip().lower()
    if len(units) > 1:
        names = ', '.join(f"'{shown(header[column])}'" for column in units)
        raise BagError(
            f'{sheet.path}, line {sheet.lines[0]}: the times could be in any of {names}; '
            'fix: name the one to use t, in seconds, or give --rate HZ'
        )
    for column, unit in units.items():
        if unit not in _SECONDS:
            raise BagError(
                f"{sheet.path}, line {sheet.lines[0]}: column '{shown(header[column])}' is in a "
                f'unit that is not known; fix: name it t, in seconds, or give --rate HZ'
            )
        return column, _SECONDS[unit]
    return None


ANIPOSE = Format(
    'anipose',
    'Anipose .csv of points in space',
    'tip_x,tip_y,tip_z,tip_error,tip_ncams,tip_score,fnum\n1.25,2.5,3.3,0.4,3,0.98,0',
    _is_anipose,
    _read,
    is_always_ended=True,
    has_likelihood=True,
)
TABLE = Format(
    'table',
    'columns NAME_x, NAME_y, maybe NAME_z, and t in seconds',
    't,tip_x,tip_y\n0.00,0.125,0.250',
    _is_table,
    _read,
    has_likelihood=True,
)
