"""
OpenSim and Cortex: Track Row Column (.trc), tab-separated.

Five lines of head: file, keys, their values (rate and unit among them), names, axes. Motive, Vicon
and Qualisys write it, too. Times are often rounded to ms, where the rate is exact.
"""

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import (
    File,
    Format,
    Points,
    Wanted,
    check_names,
    claimed_frames,
    decimals_of,
    frame_times,
    number_in,
    shown,
)

_FIX = 'export it again as .trc'


def _recognizes(file: File) -> bool:
    return file.is_text and file.sheet.cell(0, 0).startswith('PathFileType')


def _read(file: File, wanted: Wanted) -> Points:
    sheet, path = file.sheet, file.path
    about = dict(zip(sheet.head(1), sheet.head(2), strict=False))
    titles = next((r for r in range(1, 5) if sheet.cell(r, 0).lower() in ('frame#', 'frame')), None)
    if titles is None:
        raise BagError(f'{path} has no line with Frame# and names of markers; fix: {_FIX}')
    header = sheet.head(titles)
    places = [c for c in range(2, len(header)) if header[c]]
    names = [header[c] for c in places]
    check_names(path, names)
    for name, before, after in zip(names, places, places[1:], strict=False):
        if after - before < 3:
            raise BagError(
                f"{path}, line {sheet.lines[titles]}: '{shown(name)}' has fewer than three columns;"
                f' fix: {_FIX}'
            )
    first = titles + 1
    while first < len(sheet) and not sheet.cell(first, 0).isdecimal():
        first += 1
        if first > titles + 3:
            raise BagError(f'{path}, line {sheet.lines[first - 1]}: no frames; fix: {_FIX}')
    columns = {header[c]: [c, c + 1, c + 2] for c in places}
    names, points, frames, lines = sheet.frames(columns, first, 'Frame#')
    rate = number_in(about.get('DataRate', ''))
    times = None
    if wanted.rate is None:
        numbers = sheet.column(1, first, 'Time')
        known = not np.isnan(numbers).all()
        times = frame_times(frames, rate, *((numbers, decimals_of(numbers)) if known else ()))
    notes = claimed_frames(path, about.get('NumFrames', ''), len(frames))
    return Points(names, points, frames, times, about.get('Units', ''), lines=lines, notes=notes)


FORMAT = Format(
    'trc',
    'OpenSim, Cortex .trc',
    'PathFileType\t4\t(X/Y/Z)\trun.trc\nDataRate\t...\tUnits\n100.0\t...\tmm\n'
    'Frame#\tTime\ttip\n\t\tX1\tY1\tZ1\n1\t0.00\t125.1\t250.2\t3.3',
    _recognizes,
    _read,
    is_always_ended=True,
)
