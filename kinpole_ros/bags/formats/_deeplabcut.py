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
    File,
    Format,
    Points,
    Wanted,
    check_cells,
    check_names,
    shown,
    whole_numbers,
)
from kinpole_ros.packages import install_command

# What DeepLabCut itself takes as seen ("pcutoff").
_LIKELIHOOD = 0.6
_HDF = b'\x89HDF\r\n\x1a\n'
_CHUNK = 32 << 20  # bytes that one chunk may unpack to; those of PyTables have some 100 kB
_SLICE = 8 << 20  # bytes of rows read at a time
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
        if match := re.search(r'([0-9]{1,15})(\.0*|\.[A-Za-z]+)?$', cell):
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
            table = _hdf_table(file, content)
            labels: list[tuple[str, str]] = []
            fields = [name for name in table.dtype.names if name.startswith('values_block_')]
            for name in fields:
                # The scorer is the first level.
                labels += [
                    _label(levels[1:]) for levels in _names_in(bytes(table.attrs[f'{name}_kind']))
                ]
            widths = [int(np.prod(table.dtype[name].shape)) for name in fields]
            check_cells(file.path, len(table) * sum(widths))
            values = np.empty((len(table), sum(widths)))
            frames = np.empty(len(table), np.int64)
            step = max(1, _SLICE // table.dtype.itemsize)
            for first in range(0, len(table), step):
                rows = table[first : first + step]
                frames[first : first + step] = rows['index']
                values[first : first + step] = np.concatenate(
                    [rows[name].reshape(len(rows), -1) for name in fields], axis=1
                )
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


def _hdf_table(file: File, content: Any) -> Any:
    """
    The table of positions in an open .h5 file, all of whose bytes are in that file.

    Raises BagError for links and storage that lead to other files, for fields that are not
    numbers, and where a chunk alone unpacks to more than `MOST`.
    """
    import h5py

    for name in content:
        if not isinstance(content.get(name, getlink=True), h5py.HardLink):
            raise BagError(f"{file.path}: '{shown(name)}' is a link; fix: {_FIX}")
        group = content[name]
        if not isinstance(group, h5py.Group) or 'table' not in group:
            continue
        if not isinstance(group.get('table', getlink=True), h5py.HardLink):
            raise BagError(f"{file.path}: the table in '{shown(name)}' is a link; fix: {_FIX}")
        table = group['table']
        if not isinstance(table, h5py.Dataset) or table.ndim != 1 or table.dtype.names is None:
            raise BagError(f"{file.path}: '{shown(name)}' is not a table; fix: {_FIX}")
        if table.external or table.is_virtual:
            raise BagError(f"{file.path}: the rows of '{shown(name)}' are elsewhere; fix: {_FIX}")
        for field in table.dtype.names:
            if table.dtype[field].base.kind not in 'iuf':
                raise BagError(
                    f"{file.path}: column '{shown(field)}' is not of numbers; fix: {_FIX}"
                )
        # HDF5 unpacks one chunk as a whole.
        if table.chunks and table.chunks[0] * table.dtype.itemsize > _CHUNK:
            raise BagError(
                f'{file.path}: a chunk of {table.chunks[0]} rows is more than {_CHUNK >> 20} MiB; '
                f'fix: {_FIX}'
            )
        return table
    raise BagError(f'{file.path} has no table of DeepLabCut; fix: {_FIX}')


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
