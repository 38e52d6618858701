"""
Qualisys Track Manager: markers (3D) and rigid bodies (6D) exported as .tsv.

Lines of a key and its values, tab-separated, then maybe a line of titles, then a line a frame, in
mm, with the number of the frame and its time in front where that was asked for. A marker that was
not seen is three zeros, or nothing. A body has its position, three angles, a residual, and the nine
elements of its rotation matrix, column by column.
"""

from dataclasses import replace

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
from kinpole_ros.bags.formats._sheet import (
    Sheet,
    check_cells,
    number_in,
    number_names,
    whole_numbers,
)

_KEYS = ('NO_OF_FRAMES', 'FILE_VERSION')
# Numbers of a marker, and of a body: with residual and matrix, with matrix, and as angles.
_WIDTHS = {'MARKER_NAMES': (3,), 'BODY_NAMES': (16, 15, 7, 6)}
_NOT_ROTATED = 0.01  # a rotation matrix has the determinant 1 but for its rounding to 5 digits
_FIX = 'export 3D or 6D data as .tsv, with its header'


def _recognizes(file: File) -> bool:
    return file.is_sheet and file.sheet.cell(0, 0) in _KEYS


def _read(file: File, wanted: Wanted) -> Points:
    sheet, path = file.sheet, file.path
    about, first = _read_head(sheet)
    key = next((key for key in _WIDTHS if any(about.get(key, []))), None)
    if key is None:
        kind = ' '.join(about.get('DATA_INCLUDED', []))
        raise BagError(f'{path} names no markers or bodies ({kind or "no data"}); fix: {_FIX}')
    given = about[key]
    while given and not given[-1]:
        given.pop()
    names = number_names(path, [name or f'{k + 1}' for k, name in enumerate(given)], file.notes)
    begin, width = _columns(sheet, first, key, len(names))
    columns = [[begin + width * k + axis for axis in range(3)] for k in range(len(names))]
    points, numbers = sheet.points(columns, names, first, also=(0, 'Frame') if begin else None)
    # A marker that was not seen is three zeros.
    points[~points.any(axis=-1)] = np.nan
    rate = number_in(next(iter(about.get('FREQUENCY', [])), ''))
    if begin:
        frames = whole_numbers(path, numbers, sheet.lines[first:], 'Frame')
        times = sheet.column(1, first, 'Time')
        instants = frame_times(frames, rate, times, decimals_of(times))
    else:
        frames = np.arange(len(points))
        instants = frame_times(frames, rate)
    file.notes += claimed(path, ''.join(about.get('NO_OF_FRAMES', [])), len(points))
    count = about.get('NO_OF_MARKERS' if width == 3 else 'NO_OF_BODIES', [])
    file.notes += claimed(path, ''.join(count), len(names), 'names')
    found = Points(
        names,
        points,
        frames,
        instants if wanted.rate is None else None,
        'mm',
        lines=sheet.lines[first:],
    )
    if width == 3:
        return found
    check_cells(path, 20 * len(points) * len(names))
    places = range(begin, begin + width * len(names))
    titles = [f'{name} {number}' for name in names for number in range(1, width + 1)]
    values = sheet.numbers(places, titles, first).reshape(len(points), len(names), width)
    poses = _to_poses(values)
    points[np.isnan(poses[..., 0])] = np.nan
    return replace(found, bodies=names, poses=poses)


def _read_head(sheet: Sheet) -> tuple[dict[str, list[str]], int]:
    """Read values by key, and the row at which frames begin."""
    about: dict[str, list[str]] = {}
    row = 0
    while (key := sheet.cell(row, 0)) and key.replace('_', '').isalpha() and key.isupper():
        about.setdefault(key, sheet.head(row)[1:])
        row += 1
    # Titles of columns have letters.
    is_titles = any(cell[:1].isalpha() and len(cell) != 3 for cell in sheet.head(row))
    return about, row + is_titles


def _columns(sheet: Sheet, first: int, key: str, count: int) -> tuple[int, int]:
    """Find the column at which `count` markers or bodies begin, and the numbers of each."""
    cells = len(sheet.head(first))
    for width in _WIDTHS[key]:
        for begin in (0, 2):
            # A tab may end the row.
            if 0 <= cells - begin - width * count <= 1:
                return begin, width
    raise BagError(
        f'{sheet.path}, line {sheet.lines[min(first, len(sheet) - 1)]}: {cells} cells, which is no '
        f'number of columns of the {count} named in the head; fix: {_FIX}'
    )


def _to_poses(values: np.ndarray) -> np.ndarray:
    """Convert the numbers (T, B, n) of bodies to poses (T, B, 7), NaN where one was not tracked."""
    if values.shape[-1] > 7:
        # The matrix is written column by column.
        turns = values[..., -9:].reshape(*values.shape[:-1], 3, 3).swapaxes(-1, -2)
    else:
        x, y, z = (_turn_about(axis, values[..., 3 + axis]) for axis in range(3))
        turns = x @ y @ z
    # A body that was not tracked has a residual of -1, and zeros or nothing for a matrix.
    tracked = np.abs(np.linalg.det(turns) - 1) < _NOT_ROTATED
    tracked &= values[..., :3].any(axis=-1) & np.isfinite(values[..., :3]).all(axis=-1)
    if values.shape[-1] in (16, 7):
        tracked &= values[..., 6] >= 0
    poses = np.full((*values.shape[:-1], 7), np.nan)
    poses[tracked, :3] = values[tracked, :3]
    poses[tracked, 3:] = _to_quaternions(turns[tracked])
    return poses


def _turn_about(axis: int, degrees: np.ndarray) -> np.ndarray:
    """Make rotation matrices (..., 3, 3) about a coordinate axis."""
    turn = np.zeros((*degrees.shape, 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[..., axis, axis] = 1
    turn[..., i, i] = turn[..., j, j] = np.cos(np.radians(degrees))
    turn[..., j, i] = np.sin(np.radians(degrees))
    turn[..., i, j] = -turn[..., j, i]
    return turn


def _to_quaternions(turns: np.ndarray) -> np.ndarray:
    """
    Convert rotation matrices (N, 3, 3) to unit quaternions x, y, z, w (N, 4), w not negative.

    A quaternion is the eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric matrix
    (Journal of Guidance, Control, and Dynamics 23(6), 2000).
    """
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(turns, 0, -1)
    lower = [
        [a - e - i],
        [d + b, e - a - i],
        [g + c, h + f, i - a - e],
        [h - f, c - g, d - b, a + e + i],
    ]
    symmetric = np.zeros((len(turns), 4, 4))
    for row, values in enumerate(lower):
        for column, value in enumerate(values):
            symmetric[:, row, column] = value
    # eigh reads the lower half; its eigenvalues rise.
    found = np.linalg.eigh(symmetric)[1][..., -1]
    return found * np.where(found[:, 3:] < 0, -1.0, 1.0)


FORMAT = Format(
    'qualisys',
    'Qualisys .tsv, 3D or 6D',
    'NO_OF_FRAMES\t513\nFREQUENCY\t256\nDATA_INCLUDED\t3D\nMARKER_NAMES\ttip\n125.1\t250.2\t3.3',
    _recognizes,
    _read,
    is_always_ended=True,
)
