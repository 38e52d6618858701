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
from collections.abc import Iterator, Sequence
from itertools import islice, product
from typing import Any, NamedTuple, NoReturn

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted
from kinpole_ros.bags.formats._hdf import HDF, errors_of_hdf, open_hdf, own_item
from kinpole_ros.bags.formats._sheet import check_cells, check_names, shown, whole_numbers

# What DeepLabCut itself takes as seen ("pcutoff").
_LIKELIHOOD = 0.6
_SLICE = 8 << 20  # bytes of rows read at a time
_AXES = ('x', 'y', 'z')
_FIX = 'give the .csv or .h5 that analyze_videos wrote'


class _Table(NamedTuple):
    """Columns of a .csv or an .h5, which are read a block of rows at a time."""

    labels: list[tuple[str, str]]  # marker and coordinate of each column
    lines: Sequence[int]  # of each row
    index_name: str  # of the column of numbers of frames
    blocks: Iterator[tuple[np.ndarray, np.ndarray]]  # numbers of frames (rows,), (rows, columns)


def _recognizes(file: File) -> bool:
    if file.head.startswith(HDF):
        return True
    if not file.is_sheet:
        return False
    first = [file.sheet.cell(row, 0) for row in range(4)]
    return 'bodyparts' in first and 'coords' in first


def _read(file: File, wanted: Wanted) -> Points:
    read = _of_hdf if file.head.startswith(HDF) else _of_csv
    labels, lines, index_name, blocks = read(file)
    least = _LIKELIHOOD if wanted.likelihood is None else wanted.likelihood
    columns = {label: column for column, label in enumerate(labels)}
    names = list(dict.fromkeys(name for name, _ in labels))
    check_names(file.path, names)
    if len(columns) < len(labels):
        raise BagError(f'{file.path}: a point has one coordinate twice; fix: {_FIX}')
    for name, letter in product(names, 'xy'):
        if (name, letter) not in columns:
            raise BagError(f"{file.path}: '{shown(name)}' has no {letter}; fix: {_FIX}")
    # The number and the stamp of each frame are held, too.
    check_cells(file.path, (3 * len(names) + 2) * len(lines))
    points, numbers = np.zeros((len(lines), len(names), 3)), np.empty(len(lines))
    places = {name: index for index, name in enumerate(names)}
    done = 0
    for indices, values in blocks:
        here = points[done : done + len(values)]
        numbers[done : done + len(values)] = indices
        for (name, letter), column in columns.items():
            if letter in _AXES:
                here[:, places[name], _AXES.index(letter)] = values[:, column]
        for (name, letter), column in columns.items():
            # Positions that people labeled have no likelihood.
            if letter == 'likelihood':
                here[values[:, column] < least, places[name]] = np.nan
        done += len(values)
    frames = whole_numbers(file.path, numbers, lines, index_name)
    in_space = any(letter == 'z' for _, letter in labels)
    return Points(names, points, frames, None, '' if in_space else 'px', y_down=not in_space)


def _of_csv(file: File) -> _Table:
    """Find the columns of a .csv, and read the numbers of its frames."""
    sheet = file.sheet
    titles = {sheet.cell(row, 0): row for row in reversed(range(min(5, len(sheet))))}
    if 'coords' not in titles:
        raise BagError(f'{file.path} has no frames; fix: {_FIX}')
    first = titles['coords'] + 1
    levels = [titles[title] for title in ('individuals', 'bodyparts', 'coords') if title in titles]
    labels, columns = [], []
    for column in range(1, len(sheet.head(titles['coords']))):
        label = [sheet.cell(row, column) for row in levels]
        if label[-1]:
            labels.append(_label(label))
            columns.append(column)
    if not columns:
        raise BagError(f'{file.path} names no coordinates; fix: {_FIX}')
    blocks = sheet.blocks(columns, ['.'.join(label) for label in labels], first)
    # Names of labeled images follow those of their folders.
    indices = map(_number_of, sheet.texts(columns[0] - 1, first))
    numbered = ((np.array(list(islice(indices, len(block)))), block) for block in blocks)
    return _Table(labels, sheet.lines[first:], '1', numbered)


def _number_of(cell: str) -> float:
    """Number of a frame, or of an image such as img0012.png; NaN where there is none."""
    match = re.search(r'([0-9]{1,15})(\.0*|\.[A-Za-z]+)?$', cell)
    return int(match[1]) if match else np.nan


def _label(levels: 'list[str] | tuple[str, ...]') -> tuple[str, str]:
    """Marker and coordinate: individuals are put before the parts of their bodies."""
    return '.'.join(level for level in levels[:-1] if level), levels[-1]


def _of_hdf(file: File) -> _Table:
    """Read a table that pandas wrote; PyTables keeps the names of columns as pickles."""
    with errors_of_hdf(file, 'DeepLabCut', _FIX):
        table = _hdf_table(file, open_hdf(file))
        labels: list[tuple[str, str]] = []
        fields = [name for name in table.dtype.names if name.startswith('values_block_')]
        for name in fields:
            if table.attrs.get_id(f'{name}_kind').shape != ():
                raise ValueError('names of columns in an array, which may repeat any of its bytes')
            # The scorer is the first level.
            labels += [
                _label(levels[1:]) for levels in _names_in(bytes(table.attrs[f'{name}_kind']))
            ]
        width = sum(int(np.prod(table.dtype[name].shape)) for name in fields)
        check_cells(file.path, len(table) * width)
    if width != len(labels):
        raise BagError(f'{file.path} has {width} columns, {len(labels)} names; fix: {_FIX}')
    lines = range(1, len(table) + 1)
    return _Table(labels, lines, 'index', _hdf_blocks(file, table, fields, width))


def _hdf_blocks(
    file: File, table: Any, fields: Sequence[str], width: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    step = max(1, _SLICE // max(table.dtype.itemsize, 8 * width))
    for first in range(0, len(table), step):
        with errors_of_hdf(file, 'DeepLabCut', _FIX):
            rows = table[first : first + step]
            values = [rows[name].reshape(len(rows), -1) for name in fields]
            block = rows['index'], np.concatenate(values, axis=1, dtype=np.float64)
        yield block


def _hdf_table(file: File, content: Any) -> Any:
    """
    The table of positions in an open .h5 file.

    Raises BagError where it is elsewhere, and for fields that are not numbers.
    """
    import h5py

    for name in content:
        group = own_item(file, content, name, _FIX)
        if not isinstance(group, h5py.Group) or 'table' not in group:
            continue
        table = own_item(file, group, 'table', _FIX)
        if not isinstance(table, h5py.Dataset) or table.ndim != 1 or table.dtype.names is None:
            raise BagError(f"{file.path}: '{shown(name)}' is not a table; fix: {_FIX}")
        for field in table.dtype.names:
            if table.dtype[field].base.kind not in 'iuf':
                raise BagError(
                    f"{file.path}: column '{shown(field)}' is not of numbers; fix: {_FIX}"
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
    is_always_ended=True,
)
