"""
Exports of motion capture systems: Motive, Vicon Nexus, and .trc files.

Motive (.csv): the first line has pairs of keys and values, rates and unit among them. Then rows
that name each column by type, name and more, Position or Rotation, and the axis, below which frames
begin. Only columns of type Marker are measured: those of rigid bodies and their markers are where
Motive's model has them. Poses of rigid bodies are read where there are no markers, with quaternions
or angles.

Vicon Nexus (.csv): sections, each of which begins with its name and its rate. Trajectories goes on
with the names of markers, each above its X, then Frame, Sub Frame, X, Y, Z and so on, then units,
then a line for each frame.

Track Row Column (.trc) of OpenSim, Cortex and others: file, keys, their values (rate and unit among
them), names, axes. Times are often rounded to ms, where the rate is exact. A name stands above the
first of the three columns of its marker; some programs write two tabs between names, or one, and
then markers are in the order of the names.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats import _cells, _file, _sheet
from kinpole_ros.messages import multiply_out


def _read_frames(
    sheet: _sheet.Sheet,
    columns: dict[str, list[int]],
    first: int,
    title: str = 'Frame',
    end: int | None = None,
) -> _file.Points:
    """Read the markers in these columns, without times; frame numbers are in the first column."""
    _cells.check_names(sheet.path, list(columns))
    points, numbers = sheet.points(columns, first, end, (0, title))
    lines = sheet.lines[first:end]
    frames = _cells.whole_numbers(sheet.path, numbers, lines, title)
    return _file.Points(list(columns), points, frames, None, '', lines=lines)


# Motive

_KINDS = ('Rigid Body', 'Rigid Body Marker', 'Marker', 'Bone', 'Bone Marker')


def _is_motive(file: _file.File) -> bool:
    return file.is_sheet and file.sheet.cell(0, 0) == 'Format Version'


def _row_with(sheet: _sheet.Sheet, titles: Sequence[str], columns: range) -> int | None:
    """Return the first row of the head that has one of these titles in one of these columns."""
    for row in range(1, min(12, len(sheet))):
        if any(sheet.cell(row, column) in titles for column in columns):
            return row
    return None


def _read_motive(file: _file.File, options: _file.Options) -> _file.Points:
    sheet, path = file.sheet, file.path
    fix = 'export the take again, with its header'
    first = sheet.row(0)
    about = dict(zip(first[::2], first[1::2], strict=False))
    axes = _row_with(sheet, ['Frame'], range(1))
    # Up to 1.21 rows have no titles: kinds of columns, their names, and more.
    types = _row_with(sheet, ['Type', *_KINDS], range(5))
    if axes is None or types is None:
        title = 'Frame' if axes is None else 'Type'
        raise BagError(f'{path} has no row with {title} in its head; fix: {fix}')
    titles = _row_with(sheet, ['Name'], range(2)) or types + 1
    marker_columns = [
        column
        for column in range(2, len(sheet.row(axes)))
        if sheet.cell(types, column) == 'Marker' and sheet.cell(axes - 1, column) == 'Position'
    ]
    # "XYZ"; quaternions have none.
    order = about.get('Rotation Type', '').upper()
    bodies = {} if marker_columns else _body_columns(sheet, types, titles, axes, order)
    if marker_columns:
        columns = sheet.markers(titles, axes, marker_columns)
    elif bodies:
        # The rotation of a body is in front of its position.
        columns = {name: row[-3:] for name, row in bodies.items()}
    else:
        kinds = _cells.shown(', '.join(filter(None, dict.fromkeys(sheet.row(types)[2:]))) or 'none')
        raise BagError(
            f'{path} has no columns of type Marker, only {kinds}, which are not measured; '
            'fix: export the take again, with markers'
        )
    points = _read_frames(sheet, columns, axes + 1)
    claim = about.get('Total Exported Frames') or about.get('Total Frames in Take', '')
    file.note_count(claim, len(points.frames))
    rate = _cells.number_in(about.get('Export Frame Rate') or about.get('Capture Frame Rate', ''))
    times = None
    time_title = sheet.cell(axes, 1)
    if options.rate is None and time_title.startswith('Time'):
        times = sheet.column(1, axes + 1, time_title)
    return replace(
        points,
        times=_file.frame_times(file, points.frames, rate, times),
        unit=about.get('Length Units', ''),
        time_column='Time (Seconds)',
        bodies=list(bodies),
        poses=_read_motive_poses(sheet, bodies, axes + 1, order) if bodies else None,
    )


def _body_columns(
    sheet: _sheet.Sheet, types: int, titles: int, axes: int, order: str
) -> dict[str, list[int]]:
    """
    Find the columns of the rotation and of the position X, Y, Z of each rigid body.

    The rotation is a quaternion X, Y, Z, W, or angles about the axes in this `order`, as XYZ.
    """
    columns: dict[str, dict[str, int]] = {}
    for column in range(2, len(sheet.row(axes))):
        if sheet.cell(types, column) == 'Rigid Body':
            of_body = columns.setdefault(sheet.cell(titles, column), {})
            of_body[f'{sheet.cell(axes - 1, column)} {sheet.cell(axes, column)}'] = column
    turns = order if sorted(order) == ['X', 'Y', 'Z'] else 'XYZW'
    needed = [*(f'Rotation {axis}' for axis in turns), *(f'Position {axis}' for axis in 'XYZ')]
    return {
        name: [of_body[title] for title in needed]
        for name, of_body in columns.items()
        if of_body.keys() >= set(needed)
    }


def _read_motive_poses(
    sheet: _sheet.Sheet, bodies: dict[str, list[int]], first: int, order: str
) -> np.ndarray:
    """Read poses (T, B, 7); a body that was not seen has no numbers, or only zeros."""
    columns = [column for row in bodies.values() for column in (*row[-3:], *row[:-3])]
    size = len(columns) // len(bodies)
    titles = [f'{name} {number}' for name in bodies for number in range(1, size + 1)]
    numbers = sheet.numbers(columns, titles, first).reshape(-1, len(bodies), size)
    if size == 6:
        numbers[~numbers.any(axis=-1)] = np.nan
        return np.concatenate((numbers[..., :3], _quaternions(numbers[..., 3:], order)), axis=-1)
    poses = numbers
    poses[~poses[..., 3:].any(axis=-1) | np.isnan(poses).any(axis=-1)] = np.nan
    return poses


def _quaternions(degrees: np.ndarray, order: str) -> np.ndarray:
    """
    Return quaternions x, y, z, w of turns about axes in an `order`, as XYZ.

    Motive's angles are about the axes of the body as the turns before have left them. `degrees`
    (..., 3) are in this order, too.
    """
    result = np.zeros((*degrees.shape[:-1], 4))
    result[..., 3] = 1.0
    for k, axis in enumerate(order):
        half = np.radians(degrees[..., k]) / 2
        turn = np.zeros(result.shape)
        turn[..., 'XYZ'.index(axis)], turn[..., 3] = np.sin(half), np.cos(half)
        place = np.zeros((*degrees.shape[:-1], 3))
        frames = [np.concatenate((place, one), axis=-1) for one in (result, turn)]
        result = multiply_out(frames)[..., 3:]
    return result


MOTIVE = _file.Format(
    'motive',
    'OptiTrack Motive .csv',
    'Format Version,1.23,Capture Frame Rate,120,Length Units,Meters\n,Type,Marker,Marker,Marker\n'
    ',Name,tip,tip,tip\n,,Position,Position,Position\nFrame,Time (Seconds),X,Y,Z\n'
    '0,0.0,0.1,0.2,0.3',
    _is_motive,
    _read_motive,
    is_always_ended=True,
)


# Vicon Nexus

_SECTION, _MODELED = 'Trajectories', 'Model Outputs'
_LENGTHS = ('mm', 'cm', 'm')  # units of places; angles, moments and powers have others
_VICON_FIX = 'export trajectories as ASCII from Nexus again'


def _is_vicon(file: _file.File) -> bool:
    titles = [
        title for title in (_SECTION, _MODELED) if file.is_sheet and title.encode() in file.data
    ]
    return any(_section_row(file.sheet, title) is not None for title in titles)


def _section_row(sheet: _sheet.Sheet, title: str) -> int | None:
    """Return the row in which trajectories, or what a model computed of them, begin."""
    titles: deque[str] = deque(maxlen=3)  # the first cells of the rows before
    for index, row in enumerate(sheet.rows()):
        is_axes = [cell.strip() for cell in row[:2]] == ['Frame', 'Sub Frame']
        if is_axes and len(titles) == 3 and titles[0] == title:
            return index - 3
        titles.append(row[0].strip())
    return None


def _read_vicon(file: _file.File, options: _file.Options) -> _file.Points:
    sheet, path = file.sheet, file.path
    row = _section_row(sheet, _SECTION)
    is_modeled = row is None
    row = _section_row(sheet, _MODELED) if row is None else row
    if row is None:
        raise BagError(f'{path} has no section {_SECTION}; fix: {_VICON_FIX}')
    names, axes, units, first = row + 2, row + 3, row + 4, row + 5
    # With velocities there are X', too.
    columns = [c for c, axis in enumerate(sheet.row(axes)) if c > 1 and axis in ('X', 'Y', 'Z')]
    if is_modeled:
        columns = _places_of_model(sheet, names, units, columns)
    markers = sheet.markers(names, axes, columns)
    found_units = {sheet.cell(units, column) for triple in markers.values() for column in triple}
    if len(found_units) > 1:
        raise BagError(
            f'{path}, line {sheet.lines[units]}: several units, '
            f'{_cells.shown(" ".join(sorted(found_units)))}; fix: {_VICON_FIX}'
        )
    # Spreadsheets leave a line of commas between sections.
    numbers = enumerate(sheet.texts(0, first), first)
    end = next((index for index, cell in numbers if not cell.isdecimal()), len(sheet))
    points = _read_frames(sheet, markers, first, end=end)
    times = _file.frame_times(file, points.frames, _cells.number_in(sheet.cell(row + 1, 0)))
    return replace(points, times=times, unit=found_units.pop())


def _places_of_model(sheet: _sheet.Sheet, names: int, units: int, columns: list[int]) -> list[int]:
    """Return the columns of lengths, as centers of joints; notes the others, as angles."""
    places = [column for column in columns if sheet.cell(units, column).lower() in _LENGTHS]
    others = [sheet.cell(names, column) for column in columns if column not in places]
    listed = _cells.listed([_cells.shown(name) for name in dict.fromkeys(others) if name])
    if not places:
        raise BagError(
            f'{sheet.path} has outputs of a model alone, which are no places: {listed}; fix: '
            f'export {_SECTION}, too'
        )
    if listed:
        sheet.notes.append(f'{sheet.path}: outputs of the model that are not read: {listed}')
    return places


VICON = _file.Format(
    'vicon',
    'Vicon Nexus .csv',
    'Trajectories\n100\n,,Rig:tip,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,125.1,250.2,3.3',
    _is_vicon,
    _read_vicon,
    is_always_ended=True,
)


# Track Row Column

_TRC_FIX = 'export it again as .trc'


def _is_trc(file: _file.File) -> bool:
    return file.is_sheet and file.sheet.cell(0, 0).startswith('PathFileType')


def _read_trc(file: _file.File, options: _file.Options) -> _file.Points:
    sheet, path = file.sheet, file.path
    about = _trc_head(sheet)
    titles = next((r for r in range(1, 5) if sheet.cell(r, 0).lower() in ('frame#', 'frame')), None)
    if titles is None:
        raise BagError(f'{path} has no line with Frame# and names of markers; fix: {_TRC_FIX}')
    first = titles + 1
    while first < len(sheet) and not math.isfinite(_cells.number_or_inf(sheet.cell(first, 0))):
        first += 1
        if first > titles + 3:
            raise BagError(f'{path}, line {sheet.lines[first - 1]}: no frames; fix: {_TRC_FIX}')
    points = _read_frames(sheet, _trc_columns(sheet, titles, first), first, 'Frame#')
    times = sheet.column(1, first, 'Time') if options.rate is None else None
    file.note_count(about.get('NumFrames', ''), len(points.frames))
    file.notes += _file.count_notes(path, about.get('NumMarkers', ''), len(points.names), 'markers')
    return replace(
        points,
        times=_file.frame_times(
            file, points.frames, _cells.number_in(about.get('DataRate', '')), times
        ),
        unit=about.get('Units', ''),
    )


def _trc_head(sheet: _sheet.Sheet) -> dict[str, str]:
    """Return values by key. The unit is the one that is no number; others may be tabs apart."""
    keys, values = ([cell for cell in sheet.row(row) if cell] for row in (1, 2))
    is_number = [math.isfinite(_cells.number_or_inf(value.replace(',', '.'))) for value in values]
    numbers = [value for value, is_one in zip(values, is_number, strict=True) if is_one]
    number_keys = [key for key in keys if key != 'Units']
    about = dict(zip(sheet.row(1), sheet.row(2), strict=False))
    if len(numbers) == len(number_keys):
        about = dict(zip(number_keys, numbers, strict=True))
    about['Units'] = '' if all(is_number) else values[is_number.index(False)]
    return about


def _trc_columns(sheet: _sheet.Sheet, titles: int, first: int) -> dict[str, list[int]]:
    """Find the three columns of each marker, from the row of names and the first row of frames."""
    header = sheet.row(titles)
    columns = [column for column in range(2, len(header)) if header[column]]
    names = _cells.number_names(sheet.path, [header[column] for column in columns], sheet.notes)
    if any((column - 2) % 3 for column in columns):
        columns = list(range(2, 2 + 3 * len(columns), 3))
        cells = len(sheet.row(first))
        if not 0 <= cells - columns[-1] - 3 <= 1:
            raise BagError(
                f'{sheet.path}, line {sheet.lines[titles]}: frames have {cells} cells, and '
                f'{len(names)} markers {columns[-1] + 3}; fix: {_TRC_FIX}'
            )
    return {
        name: [column, column + 1, column + 2] for name, column in zip(names, columns, strict=True)
    }


TRC = _file.Format(
    'trc',
    'OpenSim, Cortex .trc',
    'PathFileType\t4\t(X/Y/Z)\trun.trc\nDataRate\t...\tUnits\n100.0\t...\tmm\n'
    'Frame#\tTime\ttip\n\t\tX1\tY1\tZ1\n1\t0.00\t125.1\t250.2\t3.3',
    _is_trc,
    _read_trc,
    is_always_ended=True,
)
