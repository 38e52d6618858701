"""
Exports of motion capture systems: Motive, Vicon Nexus, Qualisys, and .trc files.

Motive (.csv): the first line has pairs of keys and values, rates and unit among them. Then rows
that name each column by type, name and more, Position or Rotation, and the axis, below which frames
begin. Only columns of type Marker are measured: those of rigid bodies and their markers are where
Motive's model has them. Poses of rigid bodies are read where there are no markers.

Vicon Nexus (.csv): sections, each of which begins with its name and its rate. Trajectories goes on
with the names of markers, each above its X, then Frame, Sub Frame, X, Y, Z and so on, then units,
then a line for each frame.

Qualisys (.tsv, 3D and 6D): lines of a key and its values, maybe a line of titles, then a line for
each frame, in mm, with its number and time in front where that was asked for. A marker that was not
seen is three zeros, or nothing. A body has its position, three angles, a residual, and the nine
elements of its rotation matrix, column by column.

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
from kinpole_ros.bags.formats import _file, _sheet


def _read_frames(
    sheet: _sheet.Sheet,
    columns: dict[str, list[int]],
    first: int,
    title: str = 'Frame',
    end: int | None = None,
) -> _file.Points:
    """Read the markers in these columns, without times; frame numbers are in the first column."""
    _sheet.check_names(sheet.path, list(columns))
    points, numbers = sheet.points(columns, first, end, (0, title))
    lines = sheet.lines[first:end]
    frames = _sheet.whole_numbers(sheet.path, numbers, lines, title)
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
    bodies = {} if marker_columns else _body_columns(sheet, types, titles, axes)
    if marker_columns:
        columns = sheet.markers(titles, axes, marker_columns)
    elif bodies:
        # The rotation of a body is in front of its position.
        columns = {name: row[4:] for name, row in bodies.items()}
    else:
        kinds = _sheet.shown(', '.join(filter(None, dict.fromkeys(sheet.row(types)[2:]))) or 'none')
        raise BagError(
            f'{path} has no columns of type Marker, only {kinds}, which are not measured; '
            'fix: export the take again, with markers'
        )
    points = _read_frames(sheet, columns, axes + 1)
    claim = about.get('Total Exported Frames') or about.get('Total Frames in Take', '')
    file.notes += _file.count_notes(path, claim, len(points.frames))
    rate = _sheet.number_in(about.get('Export Frame Rate') or about.get('Capture Frame Rate', ''))
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
        poses=_read_motive_poses(sheet, bodies, axes + 1) if bodies else None,
    )


def _body_columns(sheet: _sheet.Sheet, types: int, titles: int, axes: int) -> dict[str, list[int]]:
    """Find columns X, Y, Z, W of the rotation and X, Y, Z of the position of each rigid body."""
    columns: dict[str, dict[str, list[int]]] = {}
    for column in range(2, len(sheet.row(axes))):
        if sheet.cell(types, column) == 'Rigid Body':
            of_body = columns.setdefault(sheet.cell(titles, column), {})
            of_body.setdefault(sheet.cell(axes - 1, column), []).append(column)
    rows = {
        name: [*of_body.get('Rotation', []), *of_body.get('Position', [])]
        for name, of_body in columns.items()
    }
    return {name: row for name, row in rows.items() if len(row) == 7}


def _read_motive_poses(sheet: _sheet.Sheet, bodies: dict[str, list[int]], first: int) -> np.ndarray:
    """Read poses (T, B, 7); a body that was not seen has no numbers, or only zeros."""
    columns = [column for row in bodies.values() for column in (*row[4:], *row[:4])]
    titles = [f'{name} {number}' for name in bodies for number in range(1, 8)]
    poses = sheet.numbers(columns, titles, first).reshape(-1, len(bodies), 7)
    poses[~poses[..., 3:].any(axis=-1) | np.isnan(poses).any(axis=-1)] = np.nan
    return poses


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

_SECTION = 'Trajectories'
_VICON_FIX = 'export trajectories as ASCII from Nexus again'


def _is_vicon(file: _file.File) -> bool:
    has_title = file.is_sheet and _SECTION.encode() in file.data
    return has_title and _section_row(file.sheet) is not None


def _section_row(sheet: _sheet.Sheet) -> int | None:
    """Return the row in which trajectories begin."""
    titles: deque[str] = deque(maxlen=3)  # the first cells of the rows before
    for index, row in enumerate(sheet.rows()):
        is_axes = [cell.strip() for cell in row[:2]] == ['Frame', 'Sub Frame']
        if is_axes and len(titles) == 3 and titles[0] == _SECTION:
            return index - 3
        titles.append(row[0].strip())
    return None


def _read_vicon(file: _file.File, options: _file.Options) -> _file.Points:
    sheet, path = file.sheet, file.path
    row = _section_row(sheet)
    if row is None:
        raise BagError(f'{path} has no section {_SECTION}; fix: {_VICON_FIX}')
    names, axes, units, first = row + 2, row + 3, row + 4, row + 5
    # With velocities there are X', too.
    columns = [c for c, axis in enumerate(sheet.row(axes)) if c > 1 and axis in ('X', 'Y', 'Z')]
    markers = sheet.markers(names, axes, columns)
    found_units = {sheet.cell(units, column) for triple in markers.values() for column in triple}
    if len(found_units) > 1:
        raise BagError(
            f'{path}, line {sheet.lines[units]}: several units, '
            f'{_sheet.shown(" ".join(sorted(found_units)))}; fix: {_VICON_FIX}'
        )
    # Spreadsheets leave a line of commas between sections.
    numbers = enumerate(sheet.texts(0, first), first)
    end = next((index for index, cell in numbers if not cell.isdecimal()), len(sheet))
    points = _read_frames(sheet, markers, first, end=end)
    times = _file.frame_times(file, points.frames, _sheet.number_in(sheet.cell(row + 1, 0)))
    return replace(points, times=times, unit=found_units.pop())


VICON = _file.Format(
    'vicon',
    'Vicon Nexus .csv',
    'Trajectories\n100\n,,Rig:tip,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,125.1,250.2,3.3',
    _is_vicon,
    _read_vicon,
    is_always_ended=True,
)


# Qualisys Track Manager

_KEYS = ('NO_OF_FRAMES', 'FILE_VERSION')
# Numbers of a marker, and of a body: with residual and matrix, with matrix, and as angles.
_WIDTHS = {'MARKER_NAMES': (3,), 'BODY_NAMES': (16, 15, 7, 6)}
_DETERMINANT_TOLERANCE = 0.01  # of a rotation matrix, whose elements have 5 digits
_QUALISYS_FIX = 'export 3D or 6D data as .tsv, with its header'


def _is_qualisys(file: _file.File) -> bool:
    return file.is_sheet and file.sheet.cell(0, 0) in _KEYS


def _read_qualisys(file: _file.File, options: _file.Options) -> _file.Points:
    sheet, path = file.sheet, file.path
    about, first = _read_qualisys_head(sheet)
    key = next((key for key in _WIDTHS if any(about.get(key, []))), None)
    if key is None:
        kind = ' '.join(about.get('DATA_INCLUDED', []))
        raise BagError(
            f'{path} names no markers or bodies ({kind or "no data"}); fix: {_QUALISYS_FIX}'
        )
    titles = about[key]
    while not titles[-1]:
        titles.pop()
    titles = [title or f'{number}' for number, title in enumerate(titles, start=1)]
    names = _sheet.number_names(path, titles, file.notes)
    begin, width = _data_columns(sheet, first, key, len(names))
    lines = sheet.lines[first:]
    if width > 3:
        _sheet.check_cells(path, 20 * len(lines) * len(names))
    components = [*'xyz', *map(str, range(4, width + 1))]
    titles = ['Frame', *(f'{name} {component}' for name in names for component in components)]
    columns = [0 if begin else None, *range(begin, begin + width * len(names))]
    numbers = sheet.numbers(columns, titles, first)
    values = numbers[:, 1:].reshape(len(lines), len(names), width)
    frames, times = np.arange(len(lines)), None
    if begin:
        frames = _sheet.whole_numbers(path, numbers[:, 0], lines, 'Frame')
        times = sheet.column(1, first, 'Time') if options.rate is None else None
    poses = _to_poses(values) if width > 3 else None
    points = values[..., :3]
    # A marker that was not seen is three zeros.
    points[~points.any(axis=-1) if poses is None else np.isnan(poses[..., 0])] = np.nan
    file.notes += _file.count_notes(path, ''.join(about.get('NO_OF_FRAMES', [])), len(lines))
    count = about.get('NO_OF_MARKERS' if width == 3 else 'NO_OF_BODIES', [])
    file.notes += _file.count_notes(path, ''.join(count), len(names), 'names')
    rate = _sheet.number_in(''.join(about.get('FREQUENCY', [])))
    return _file.Points(
        names,
        points,
        frames,
        _file.frame_times(file, frames, rate, times),
        'mm',
        lines=lines,
        bodies=[] if poses is None else names,
        poses=poses,
    )


def _read_qualisys_head(sheet: _sheet.Sheet) -> tuple[dict[str, list[str]], int]:
    """Read values by key, and the row at which frames begin."""
    about: dict[str, list[str]] = {}
    row = 0
    while (key := sheet.cell(row, 0)) and key.replace('_', '').isalpha() and key.isupper():
        about.setdefault(key, sheet.row(row)[1:])
        row += 1
    # Titles of columns have letters.
    is_titles = any(cell[:1].isalpha() and len(cell) != 3 for cell in sheet.row(row))
    return about, row + is_titles


def _data_columns(sheet: _sheet.Sheet, first: int, key: str, count: int) -> tuple[int, int]:
    """Return the column at which `count` markers or bodies begin, and the numbers of each."""
    cells = len(sheet.row(first))
    for width in _WIDTHS[key]:
        for begin in (0, 2):
            # A tab may end the row.
            if 0 <= cells - begin - width * count <= 1:
                return begin, width
    raise BagError(
        f'{sheet.path}, line {sheet.lines[min(first, len(sheet) - 1)]}: {cells} cells, which is no '
        f'number of columns of the {count} named in the head; fix: {_QUALISYS_FIX}'
    )


def _to_poses(values: np.ndarray) -> np.ndarray:
    """Convert the numbers (T, B, n) of bodies to poses (T, B, 7), NaN where one was not tracked."""
    if values.shape[-1] > 7:
        # The matrix is written column by column.
        rotations = values[..., -9:].reshape(*values.shape[:-1], 3, 3).swapaxes(-1, -2)
    else:
        x, y, z = (_axis_rotation(axis, values[..., 3 + axis]) for axis in range(3))
        rotations = x @ y @ z
    # A body that was not tracked has a residual of -1, and zeros or nothing for a matrix.
    is_tracked = np.abs(np.linalg.det(rotations) - 1) < _DETERMINANT_TOLERANCE
    is_tracked &= values[..., :3].any(axis=-1) & np.isfinite(values[..., :3]).all(axis=-1)
    if values.shape[-1] in (16, 7):
        is_tracked &= values[..., 6] >= 0
    poses = np.full((*values.shape[:-1], 7), np.nan)
    poses[is_tracked, :3] = values[is_tracked, :3]
    poses[is_tracked, 3:] = _to_quaternions(rotations[is_tracked])
    return poses


def _axis_rotation(axis: int, degrees: np.ndarray) -> np.ndarray:
    """Return rotation matrices (..., 3, 3) about a coordinate axis."""
    rotation = np.zeros((*degrees.shape, 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation[..., axis, axis] = 1
    rotation[..., i, i] = rotation[..., j, j] = np.cos(np.radians(degrees))
    rotation[..., j, i] = np.sin(np.radians(degrees))
    rotation[..., i, j] = -rotation[..., j, i]
    return rotation


def _to_quaternions(rotations: np.ndarray) -> np.ndarray:
    """
    Convert rotation matrices (N, 3, 3) to unit quaternions x, y, z, w (N, 4), w not negative.

    A quaternion is the eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric matrix
    (Journal of Guidance, Control, and Dynamics 23(6), 2000).
    """
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(rotations, 0, -1)
    lower = [
        [a - e - i],
        [d + b, e - a - i],
        [g + c, h + f, i - a - e],
        [h - f, c - g, d - b, a + e + i],
    ]
    symmetric = np.zeros((len(rotations), 4, 4))
    for row, values in enumerate(lower):
        for column, value in enumerate(values):
            symmetric[:, row, column] = value
    # eigh reads the lower half; its eigenvalues rise.
    quaternions = np.linalg.eigh(symmetric)[1][..., -1]
    return quaternions * np.where(quaternions[:, 3:] < 0, -1.0, 1.0)


QUALISYS = _file.Format(
    'qualisys',
    'Qualisys .tsv, 3D or 6D',
    'NO_OF_FRAMES\t513\nFREQUENCY\t256\nDATA_INCLUDED\t3D\nMARKER_NAMES\ttip\n125.1\t250.2\t3.3',
    _is_qualisys,
    _read_qualisys,
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
    while first < len(sheet) and not math.isfinite(_sheet.number_or_inf(sheet.cell(first, 0))):
        first += 1
        if first > titles + 3:
            raise BagError(f'{path}, line {sheet.lines[first - 1]}: no frames; fix: {_TRC_FIX}')
    points = _read_frames(sheet, _trc_columns(sheet, titles, first), first, 'Frame#')
    times = sheet.column(1, first, 'Time') if options.rate is None else None
    file.notes += _file.count_notes(path, about.get('NumFrames', ''), len(points.frames))
    file.notes += _file.count_notes(path, about.get('NumMarkers', ''), len(points.names), 'markers')
    return replace(
        points,
        times=_file.frame_times(
            file, points.frames, _sheet.number_in(about.get('DataRate', '')), times
        ),
        unit=about.get('Units', ''),
    )


def _trc_head(sheet: _sheet.Sheet) -> dict[str, str]:
    """Return values by key. The unit is the one that is no number; others may be tabs apart."""
    keys, values = ([cell for cell in sheet.row(row) if cell] for row in (1, 2))
    is_number = [math.isfinite(_sheet.number_or_inf(value.replace(',', '.'))) for value in values]
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
    names = _sheet.number_names(sheet.path, [header[column] for column in columns], sheet.notes)
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
