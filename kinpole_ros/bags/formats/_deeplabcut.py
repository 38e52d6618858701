"""
DeepLabCut: predictions as CSV, or as the .h5 of pandas with the same columns.

Columns are named by three rows, scorer, bodyparts and coords (x, y, likelihood), and by one more,
individuals, where there are several animals. Rows are frames by number; there are no times, and
the unit is the pixel, with y down. Triangulated points have z, and the unit of the calibration.
"""

import io
import pickle
import pickletools
import re
from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import (
    MOST,
    File,
    Format,
    Points,
    Wanted,
    check_names,
    shown,
    whole_numbers,
)
from kinpole_ros.packages import install_command

# What DeepLabCut itself takes as seen ("pcutoff").
_LIKELIHOOD = 0.6
_HDF = b'\x89HDF\r\n\x1a\n'
_FIX = 'give the .csv or .h5 that analyze_videos wrote'


def _recognizes(file: File) -> bool:
    if file.data.startswith(_HDF):
        return True
    if not file.is_text:
        return False
    first = [file.sheet.cell(row, 0) for row in range(4)]
    return 'bodyparts' in first and 'coords' in first


def _read(file: File, wanted: Wanted) -> Points:
    labels, values, frames = (_of_hdf if file.data.startswith(_HDF) else _of_csv)(file)
    least = _LIKELIHOOD if wanted.likelihood is None else wanted.likelihood
    columns = {label: column for column, label in enumerate(labels)}
    names = list(dict.fromkeys(name for name, _ in labels))
    check_names(file.path, names)
    if len(columns) < len(labels):
        raise BagError(f'{file.path}: a point has one coordinate twice; fix: {_FIX}')
    points = np.zeros((len(values), len(names), 3))
    for index, name in enumerate(names):
        for axis, letter in enumerate('xyz'):
            if (name, letter) in columns:
                points[:, index, axis] = values[:, columns[name, letter]]
            elif letter != 'z':
                raise BagError(f"{file.path}: '{shown(name)}' has no {letter}; fix: {_FIX}")
        if (name, 'likelihood') in columns:
            # What people labeled has none.
            doubtful = values[:, columns[name, 'likelihood']] < least
            points[doubtful, index] = np.nan
    in_space = any(letter == 'z' for _, letter in labels)
    return Points(names, points, frames, None, '' if in_space else 'px', y_down=not in_space)


def _of_csv(file: File) -> tuple[list[tuple[str, str]], np.ndarray, np.ndarray]:
    """Names of columns as (marker, coordinate), values (T, columns), numbers of frames (T,)."""
    sheet = file.sheet
    titles = {sheet.cell(row, 0): row for row in reversed(range(min(5, len(sheet.rows))))}
    first = titles['coords'] + 1
    levels = [titles[title] for title in ('individuals', 'bodyparts', 'coords') if title in titles]
    labels, columns = [], []
    for column in range(1, len(sheet.rows[titles['coords']])):
        label = [sheet.cell(row, column) for row in levels]
        if label[-1]:
            labels.append(_label(label))
            columns.append(column)
    if not columns:
        raise BagError(f'{file.path} names no coordinates; fix: {_FIX}')
    values = np.stack(
        [sheet.column(c, first, '.'.join(x)) for c, x in zip(columns, labels, strict=True)], axis=1
    )
    # Of labeled images there are folders in front of their names.
    cells = [sheet.cell(row, columns[0] - 1) for row in range(first, len(sheet.rows))]
    return labels, values, _numbers_of(file, cells, sheet.lines[first:])


def _numbers_of(file: File, cells: list[str], lines: Sequence[int]) -> np.ndarray:
    """Numbers of frames, or of images such as img0012.png."""
    numbers = np.full(len(cells), np.nan)
    for row, cell in enumerate(cells):
        if match := re.search(r'(\d{1,15})(\.0*|\.[A-Za-z]+)?$', cell):
            numbers[row] = int(match[1])
    return whole_numbers(file.path, numbers, lines, '1')


def _label(levels: 'list[str] | tuple[str, ...]') -> tuple[str, str]:
    """Marker and coordinate: individuals are put before the parts of their bodies."""
    return '.'.join(level for level in levels[:-1] if level), levels[-1]


def _of_hdf(file: File) -> tuple[list[tuple[str, str]], np.ndarray, np.ndarray]:
    """The same of a table that pandas wrote, of which PyTables has names of columns as pickles."""
    try:
        import h5py
    except ImportError:
        raise BagError(
            f'{file.path} is HDF5, which needs h5py; fix: {install_command("formats")}, or give '
            'the .csv'
        ) from None
    try:
        with h5py.File(io.BytesIO(file.data), 'r') as content:
            table = next(
                group['table']
                for group in content.values()
                if isinstance(group, h5py.Group) and 'table' in group
            )
            if table.size * table.dtype.itemsize > MOST:
                raise BagError(f'{file.path} unpacks to more than {MOST >> 20} MiB; fix: cut it')
            rows = table[:]
            labels: list[tuple[str, str]] = []
            blocks = []
            for name in rows.dtype.names:
                if name.startswith('values_block_'):
                    for levels in _names_in(bytes(table.attrs[f'{name}_kind'])):
                        # The scorer is the first level.
                        labels.append(_label(levels[1:]))
                    blocks.append(rows[name].reshape(len(rows), -1).astype(np.float64))
            values = np.concatenate(blocks, axis=1)
            frames = np.asarray(rows['index']).astype(np.int64)
    except BagError:
        raise
    except Exception as error:
        # h5py and pickle raise whatever the byte that is wrong leads to.
        raise BagError(f'{file.path} is not an .h5 of DeepLabCut; fix: {_FIX}') from error
    if values.shape[1] != len(labels):
        raise BagError(
            f'{file.path} has {values.shape[1]} columns, {len(labels)} names; fix: {_FIX}'
        )
    return labels, values, whole_numbers(file.path, frames, range(1, len(frames) + 1), 'index')


class _Names(pickle.Unpickler):
    """Reads lists, tuples and text, and nothing that would run code."""

    def find_class(self, module: str, name: str) -> NoReturn:
        raise pickle.UnpicklingError(f'{module}.{name} among names of columns')


def _names_in(pickled: bytes) -> list[tuple[str, ...]]:
    for code, number, _ in pickletools.genops(pickled):
        # Memory is set aside for as many parts as are numbered.
        if code.name.endswith('PUT') and (number or 0) > len(pickled):
            raise ValueError('columns with more parts than bytes')
    names: Any = _Names(io.BytesIO(pickled)).load()
    for levels in names:
        if not (isinstance(levels, tuple) and len(levels) in (3, 4)):
            raise ValueError('columns with other than three or four levels')
        if not all(isinstance(level, str) for level in levels):
            raise ValueError('names of columns that are not text')
    return list(names)


FORMAT = Format(
    'deeplabcut',
    'DeepLabCut .csv or .h5, one animal or several',
    'scorer,DLC_resnet50,DLC_resnet50,DLC_resnet50\nbodyparts,tip,tip,tip\ncoords,x,y,likelihood\n'
    '0,101.5,55.2,0.99',
    _recognizes,
    _read,
)
