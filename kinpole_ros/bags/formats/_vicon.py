"""
Vicon Nexus: trajectories exported as ASCII (.csv).

A file has sections, one after the other: Devices, Joints, Model Outputs, Trajectories. Each begins
with its name and its rate; Trajectories goes on with the names of markers, each above its X, then
Frame, Sub Frame, X, Y, Z and so on, then units, then a line a frame.
"""

from collections import deque

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import (
    File,
    Format,
    Points,
    Wanted,
    frame_times,
)
from kinpole_ros.bags.formats._sheet import Sheet, number_in, shown

_SECTION = 'Trajectories'
_FIX = 'export trajectories as ASCII from Nexus again'


def _recognizes(file: File) -> bool:
    title = _SECTION.encode()
    return file.is_sheet and title in file.data and _section(file.sheet) is not None


def _section(sheet: Sheet) -> int | None:
    """The row in which trajectories begin."""
    titles: deque[str] = deque(maxlen=3)  # the first cells of the rows before
    for index, row in enumerate(sheet.rows()):
        is_axes = [cell.strip() for cell in row[:2]] == ['Frame', 'Sub Frame']
        if is_axes and len(titles) == 3 and titles[0] == _SECTION:
            return index - 3
        titles.append(row[0].strip())
    return None


def _read(file: File, wanted: Wanted) -> Points:
    sheet, path = file.sheet, file.path
    row = _section(sheet)
    if row is None:
        raise BagError(f'{path} has no section {_SECTION}; fix: {_FIX}')
    names_row, axes, units, first = row + 2, row + 3, row + 4, row + 5
    # With velocities there are X', too.
    places = [c for c, axis in enumerate(sheet.head(axes)) if c > 1 and axis in ('X', 'Y', 'Z')]
    columns = sheet.markers(names_row, axes, places)
    named = {sheet.cell(units, column) for places in columns.values() for column in places}
    if len(named) > 1:
        raise BagError(
            f'{path}, line {sheet.lines[units]}: several units, '
            f'{shown(" ".join(sorted(named)))}; fix: {_FIX}'
        )
    end = next(
        (r for r, cell in enumerate(sheet.texts(0, first), first) if not _is_frame(cell)),
        len(sheet),
    )
    names, points, frames, lines = sheet.frames(columns, first, end=end)
    rate = number_in(sheet.cell(row + 1, 0))
    times = None if wanted.rate is not None else frame_times(frames, rate)
    return Points(names, points, frames, times, named.pop(), lines=lines)


def _is_frame(cell: str) -> bool:
    # Empty: a line of commas, as spreadsheets leave between sections.
    return cell.isdecimal()


FORMAT = Format(
    'vicon',
    'Vicon Nexus .csv',
    'Trajectories\n100\n,,Rig:tip,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,125.1,250.2,3.3',
    _recognizes,
    _read,
    is_always_ended=True,
)
