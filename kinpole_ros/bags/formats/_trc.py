"""
OpenSim and Cortex: Track Row Column (.trc), tab-separated.

Five lines of head: file, keys, their values (rate and unit among them), names, axes. Motive, Vicon
and Qualisys write it, too. Times are often rounded to ms, where the rate is exact. A name stands
above the first of the three columns of its marker; some programs write two tabs between names, or
one, and then markers are in the order of the names.
"""

import math

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import (
    File,
    Format,
    Points,
    Wanted,
    claimed,
    decimals_of,
    frame_times,
)
from kinpole_ros.bags.formats._sheet import Sheet, number_in, number_names, number_or_inf

_FIX = 'export it again as .trc'


def _recognizes(file: File) -> bool:
    return file.is_sheet and file.sheet.cell(0, 0).startswith('PathFileType')


def _read(file: File, wanted: Wanted) -> Points:
    sheet, path = file.sheet, file.path
    about = dict(zip(sheet.head(1), sheet.head(2), strict=False))
    titles = next((r for r in range(1, 5) if sheet.cell(r, 0).lower() in ('frame#', 'frame')), None)
    if titles is None:
        raise BagError(f'{path} has no line with Frame# and names of markers; fix: {_FIX}')
    first = titles + 1
    while first < len(sheet) and not math.isfinite(number_or_inf(sheet.cell(first, 0))):
        first += 1
        if first > titles + 3:
            raise BagError(f'{path}, line {sheet.lines[first - 1]}: no frames; fix: {_FIX}')
    columns = _columns(sheet, titles, first, file.notes)
    names, points, frames, lines = sheet.frames(columns, first, 'Frame#')
    rate = number_in(about.get('DataRate', ''))
    times = None
    if wanted.rate is None:
        numbers = sheet.column(1, first, 'Time')
        known = not np.isnan(numbers).all()
        times = frame_times(frames, rate, *((numbers, decimals_of(numbers)) if known else ()))
    file.notes += claimed(path, about.get('NumFrames', ''), len(frames), 'frames')
    file.notes += claimed(path, about.get('NumMarkers', ''), len(names), 'markers')
    return Points(names, points, frames, times, about.get('Units', ''), lines=lines)


def _columns(sheet: Sheet, titles: int, first: int, notes: list[str]) -> dict[str, list[int]]:
    """Find the three columns of each marker, from the row of names and the first row of frames."""
    header = sheet.head(titles)
    places = [column for column in range(2, len(header)) if header[column]]
    names = number_names(sheet.path, [header[column] for column in places], notes)
    if any((column - 2) % 3 for column in places):
        places = list(range(2, 2 + 3 * len(places), 3))
        cells = len(sheet.head(first))
        if not 0 <= cells - places[-1] - 3 <= 1:
            raise BagError(
                f'{sheet.path}, line {sheet.lines[titles]}: frames have {cells} cells, and '
                f'{len(names)} markers {places[-1] + 3}; fix: {_FIX}'
            )
    return {
        name: [column, column + 1, column + 2] for name, column in zip(names, places, strict=True)
    }


FORMAT = Format(
    'trc',
    'OpenSim, Cortex .trc',
    'PathFileType\t4\t(X/Y/Z)\trun.trc\nDataRate\t...\tUnits\n100.0\t...\tmm\n'
    'Frame#\tTime\ttip\n\t\tX1\tY1\tZ1\n1\t0.00\t125.1\t250.2\t3.3',
    _recognizes,
    _read,
    is_always_ended=True,
)
