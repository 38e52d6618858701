"""
Motive, of OptiTrack: takes exported as CSV.

The first line has pairs of keys and values, rates and unit among them. Then rows that name each
column by type, name and more, Position or Rotation, and the axis, below which frames begin. Only
columns of type Marker are measured: those of rigid bodies and their markers are where Motive's
model has them. Poses of rigid bodies are read where there are no markers.
"""

from collections.abc import Sequence

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
from kinpole_ros.bags.formats._sheet import Sheet, number_in, shown

_KINDS = ('Rigid Body', 'Rigid Body Marker', 'Marker', 'Bone', 'Bone Marker')


def _recognizes(file: File) -> bool:
    return file.is_sheet and file.sheet.cell(0, 0) == 'Format Version'


def _row_with(sheet: Sheet, titles: Sequence[str], columns: range) -> int | None:
    """Find the first row of the head that has one of these titles in one of these columns."""
    for row in range(1, min(12, len(sheet))):
        if any(sheet.cell(row, column) in titles for column in columns):
            return row
    return None


def _read(file: File, wanted: Wanted) -> Points:
    sheet, path = file.sheet, file.path
    fix = 'export the take again, with its header'
    first = sheet.head(0)
    about = dict(zip(first[::2], first[1::2], strict=False))
    axes = _row_with(sheet, ['Frame'], range(1))
    # Up to 1.21 rows have no titles: kinds of columns, their names, and more.
    types = _row_with(sheet, ['Type', *_KINDS], range(5))
    if axes is None or types is None:
        lacking = 'Frame' if axes is None else 'Type'
        raise BagError(f'{path} has no row with {lacking} in its head; fix: {fix}')
    titles = _row_with(sheet, ['Name'], range(2)) or types + 1
    places = [
        column
        for column in range(2, len(sheet.head(axes)))
        if sheet.cell(types, column) == 'Marker' and sheet.cell(axes - 1, column) == 'Position'
    ]
    bodies = {} if places else _body_columns(sheet, types, titles, axes)
    if not (places or bodies):
        kinds = shown(', '.join(filter(None, dict.fromkeys(sheet.head(types)[2:]))) or 'none')
        raise BagError(
            f'{path} has no columns of type Marker, only {kinds}, which are not measured; '
            'fix: export the take again, with markers'
        )
    # What a body's rotation is in stands before its position.
    columns = (
        sheet.markers(titles, axes, places) if places else {k: c[4:] for k, c in bodies.items()}
    )
    names, points, frames, lines = sheet.frames(columns, axes + 1)
    claim = about.get('Total Exported Frames') or about.get('Total Frames in Take', '')
    file.notes += claimed(path, claim, len(frames))
    return Points(
        names,
        points,
        frames,
        None if wanted.rate is not None else _times(sheet, axes, frames, about),
        about.get('Length Units', ''),
        lines=lines,
        time_column='Time (Seconds)',
        bodies=list(bodies),
        poses=_read_poses(sheet, bodies, axes + 1) if bodies else None,
    )


def _body_columns(sheet: Sheet, types: int, titles: int, axes: int) -> dict[str, list[int]]:
    """Find columns X, Y, Z, W of the rotation and X, Y, Z of the position of each rigid body."""
    found: dict[str, dict[str, list[int]]] = {}
    for column in range(2, len(sheet.head(axes))):
        if sheet.cell(types, column) == 'Rigid Body':
            of_body = found.setdefault(sheet.cell(titles, column), {})
            of_body.setdefault(sheet.cell(axes - 1, column), []).append(column)
    rows = {
        name: [*of_body.get('Rotation', []), *of_body.get('Position', [])]
        for name, of_body in found.items()
    }
    return {name: row for name, row in rows.items() if len(row) == 7}


def _read_poses(sheet: Sheet, bodies: dict[str, list[int]], first: int) -> np.ndarray:
    """Read poses (T, B, 7); a body that was not seen has no numbers, or only zeros."""
    columns = [column for row in bodies.values() for column in (*row[4:], *row[:4])]
    titles = [f'{name} {number}' for name in bodies for number in range(1, 8)]
    poses = sheet.numbers(columns, titles, first).reshape(-1, len(bodies), 7)
    poses[~poses[..., 3:].any(axis=-1) | np.isnan(poses).any(axis=-1)] = np.nan
    return poses


def _times(sheet: Sheet, axes: int, frames: np.ndarray, about: dict[str, str]) -> np.ndarray | None:
    rate = number_in(about.get('Export Frame Rate') or about.get('Capture Frame Rate', ''))
    if not sheet.cell(axes, 1).startswith('Time'):
        return frame_times(frames, rate)
    times = sheet.column(1, axes + 1, sheet.cell(axes, 1))
    return frame_times(frames, rate, times, decimals_of(times))


FORMAT = Format(
    'motive',
    'OptiTrack Motive .csv',
    'Format Version,1.23,Capture Frame Rate,120,Length Units,Meters\n,Type,Marker,Marker,Marker\n'
    ',Name,tip,tip,tip\n,,Position,Position,Position\nFrame,Time (Seconds),X,Y,Z\n'
    '0,0.0,0.1,0.2,0.3',
    _recognizes,
    _read,
    is_always_ended=True,
)
