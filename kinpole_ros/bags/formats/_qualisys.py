"""
Qualisys Track Manager, a motion capture system: exports as .tsv, 3D and 6D.

Lines of a key and its values, maybe a line of titles, then a line for each frame, in mm, with its
number and time in front where that was asked for. A marker that was not seen is three zeros, or
nothing. A body has its position, three angles, a residual, and the nine elements of its rotation
matrix, column by column.
"""

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats import _cells, _file, _sheet

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
    names = _cells.number_names(path, titles, file.notes)
    begin, width = _data_columns(sheet, first, key, len(names))
    lines = sheet.lines[first:]
    if width > 3:
        _cells.check_cells(path, 20 * len(lines) * len(names))
    components = [*'xyz', *map(str, range(4, width + 1))]
    titles = ['Frame', *(f'{name} {component}' for name in names for component in components)]
    columns = [0 if begin else None, *range(begin, begin + width * len(names))]
    numbers = sheet.numbers(columns, titles, first)
    values = numbers[:, 1:].reshape(len(lines), len(names), width)
    frames, times = np.arange(len(lines)), None
    if begin:
        frames = _cells.whole_numbers(path, numbers[:, 0], lines, 'Frame')
        times = sheet.column(1, first, 'Time') if options.rate is None else None
    poses = _to_poses(values) if width > 3 else None
    points = values[..., :3]
    # A marker that was not seen is three zeros.
    points[~points.any(axis=-1) if poses is None else np.isnan(poses[..., 0])] = np.nan
    file.note_count(''.join(about.get('NO_OF_FRAMES', [])), len(lines))
    count = about.get('NO_OF_MARKERS' if width == 3 else 'NO_OF_BODIES', [])
    file.notes += _file.count_notes(path, ''.join(count), len(names), 'names')
    rate = _cells.number_in(''.join(about.get('FREQUENCY', [])))
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
