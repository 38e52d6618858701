"""
DeepLabCut, a program that finds points of bodies in videos: tables as CSV or HDF5.

Columns are named by three rows, scorer, bodyparts and coords (x, y, likelihood), and by one more,
individuals, where there are several animals. The .h5 is of pandas, with the same columns. Rows are
frames by number; there are no times, and the unit is the pixel, with y down. Triangulated points
have z, and the unit of the calibration.
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
from kinpole_ros.bags.formats._cells import check_cells, check_names, shown, whole_numbers
from kinpole_ros.bags.formats._file import File, Format, Options, Points
from kinpole_ros.bags.formats._hdf import (
    HDF_MAGIC,
    hdf_item,
    no_scores,
    opened_hdf,
    unknown_hdf,
)

_SLICE_BYTES = 8 << 20  # of rows read at a time
_LIKELIHOOD = 0.6  # DeepLabCut's own limit, "pcutoff"
_AXES = ('x', 'y', 'z')
_DLC_FIX = 'give the .csv or .h5 that analyze_videos wrote'


class _LabeledColumns(NamedTuple):
    """Columns of a .csv or an .h5, which are read a block of rows at a time."""

    labels: list[tuple[str, str]]  # marker and coordinate of each column
    lines: Sequence[int]  # of each row
    index_name: str  # of the column of frame numbers
    blocks: Iterator[tuple[np.ndarray, np.ndarray]]  # frame numbers (rows,), (rows, columns)


def _is_deeplabcut(file: File) -> bool:
    if file.head.startswith(HDF_MAGIC):
        return True
    if not file.is_sheet:
        return False
    first = [file.sheet.cell(row, 0) for row in range(4)]
    return 'bodyparts' in first and 'coords' in first


def _read_deeplabcut(file: File, options: Options) -> Points:
    if file.head.startswith(HDF_MAGIC):
        with opened_hdf(file, 'DeepLabCut', _DLC_FIX) as content:
            return _points_of_table(file, _hdf_table(file, content), options)
    return _points_of_table(file, _csv_table(file), options)


def _points_of_table(file: File, table: _LabeledColumns, options: Options) -> Points:
    labels, lines, index_name, blocks = table
    likelihood = _LIKELIHOOD if options.likelihood is None else options.likelihood
    columns = {label: column for column, label in enumerate(labels)}
    names = list(dict.fromkeys(name for name, _ in labels))
    check_names(file.path, names)
    if options.likelihood is not None and not any(what == 'likelihood' for _, what in labels):
        raise no_scores(file, 'likelihoods')
    if len(columns) < len(labels):
        raise BagError(f'{file.path}: a point has one coordinate twice; fix: {_DLC_FIX}')
    for name, letter in product(names, 'xy'):
        if (name, letter) not in columns:
            raise BagError(f"{file.path}: '{shown(name)}' has no {letter}; fix: {_DLC_FIX}")
    # The number and the stamp of each frame are held, too.
    check_cells(file.path, (3 * len(names) + 2) * len(lines))
    points, numbers = np.zeros((len(lines), len(names), 3)), np.empty(len(lines))
    indices = {name: index for index, name in enumerate(names)}
    first = 0
    for frame_numbers, values in blocks:
        block = points[first : first + len(values)]
        numbers[first : first + len(values)] = frame_numbers
        for (name, letter), column in columns.items():
            if letter in _AXES:
                block[:, indices[name], _AXES.index(letter)] = values[:, column]
        for (name, letter), column in columns.items():
            # Positions that people labeled have no likelihood.
            if letter == 'likelihood':
                block[values[:, column] < likelihood, indices[name]] = np.nan
        first += len(values)
    frames = whole_numbers(file.path, numbers, lines, index_name)
    in_space = any(letter == 'z' for _, letter in labels)
    return Points(names, points, frames, None, '' if in_space else 'px', y_down=not in_space)


def _csv_table(file: File) -> _LabeledColumns:
    sheet = file.sheet
    titles = {sheet.cell(row, 0): row for row in reversed(range(min(5, len(sheet))))}
    if 'coords' not in titles:
        raise BagError(f'{file.path} has no frames; fix: {_DLC_FIX}')
    first = titles['coords'] + 1
    levels = [titles[title] for title in ('individuals', 'bodyparts', 'coords') if title in titles]
    labels, columns = [], []
    for column in range(1, len(sheet.row(titles['coords']))):
        label = [sheet.cell(row, column) for row in levels]
        if label[-1]:
            labels.append(_label(label))
            columns.append(column)
    if not columns:
        raise BagError(f'{file.path} names no coordinates; fix: {_DLC_FIX}')
    blocks = sheet.blocks(columns, ['.'.join(label) for label in labels], first)
    # Names of labeled images follow those of their folders.
    numbers = map(_image_number, sheet.texts(columns[0] - 1, first))
    numbered = ((np.array(list(islice(numbers, len(block)))), block) for block in blocks)
    return _LabeledColumns(labels, sheet.lines[first:], '1', numbered)


def _image_number(cell: str) -> float:
    """Return the number of a frame, or of an image such as img0012.png; NaN without."""
    match = re.search(r'([0-9]{1,15})(\.0*|\.[A-Za-z]+)?$', cell)
    return int(match[1]) if match else np.nan


def _label(levels: Sequence[str]) -> tuple[str, str]:
    """Return marker and coordinate: individuals are put before the parts of their bodies."""
    return '.'.join(level for level in levels[:-1] if level), levels[-1]


def _hdf_table(file: File, content: Any) -> _LabeledColumns:
    """Read a table that pandas wrote; PyTables keeps the names of columns as pickles."""
    table = _find_hdf_table(file, content)
    labels: list[tuple[str, str]] = []
    fields = [name for name in table.dtype.names if name.startswith('values_block_')]
    for name in fields:
        if table.attrs.get_id(f'{name}_kind').shape != ():
            raise ValueError('names of columns in an array, which may repeat any of its bytes')
        # The scorer is the first level.
        labels += [_label(row[1:]) for row in _unpickle_names(bytes(table.attrs[f'{name}_kind']))]
    width = sum(int(np.prod(table.dtype[name].shape)) for name in fields)
    check_cells(file.path, len(table) * width)
    if width != len(labels):
        raise BagError(f'{file.path} has {width} columns, {len(labels)} names; fix: {_DLC_FIX}')
    blocks = _hdf_blocks(table, fields, width)
    return _LabeledColumns(labels, range(1, len(table) + 1), 'index', blocks)


def _hdf_blocks(
    table: Any, fields: Sequence[str], width: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    step = max(1, _SLICE_BYTES // max(table.dtype.itemsize, 8 * width))
    for first in range(0, len(table), step):
        rows = table[first : first + step]
        values = [rows[name].reshape(len(rows), -1) for name in fields]
        yield rows['index'], np.concatenate(values, axis=1, dtype=np.float64)


def _find_hdf_table(file: File, content: Any) -> Any:
    """Return the table of positions; raises BagError for fields that are not numbers."""
    import h5py

    for name in content:
        group = hdf_item(file, content, name, _DLC_FIX)
        if not isinstance(group, h5py.Group) or 'table' not in group:
            continue
        table = hdf_item(file, group, 'table', _DLC_FIX)
        if not isinstance(table, h5py.Dataset) or table.ndim != 1 or table.dtype.names is None:
            raise BagError(f"{file.path}: '{shown(name)}' is not a table; fix: {_DLC_FIX}")
        for field in table.dtype.names:
            if table.dtype[field].base.kind not in 'iuf':
                raise BagError(
                    f"{file.path}: column '{shown(field)}' is not of numbers; fix: {_DLC_FIX}"
                )
        return table
    raise unknown_hdf(file, content)


class _NameUnpickler(pickle.Unpickler):
    """Reads lists, tuples and text, and nothing that would run code."""

    def find_class(self, module: str, name: str) -> NoReturn:
        raise pickle.UnpicklingError(f'{module}.{name} among names of columns')


def _unpickle_names(data: bytes) -> list[tuple[str, ...]]:
    for code, number, _ in pickletools.genops(data):
        # Memory is allocated for as many parts as are numbered.
        if code.name.endswith('PUT') and (number or 0) > len(data):
            raise ValueError('columns with more parts than bytes')
    names: Any = _NameUnpickler(io.BytesIO(data)).load()
    for levels in names:
        if not (isinstance(levels, tuple) and len(levels) in (3, 4)):
            raise ValueError('columns with other than three or four levels')
        if not all(isinstance(level, str) for level in levels):
            raise ValueError('names of columns that are not text')
    return list(names)


DEEPLABCUT = Format(
    'deeplabcut',
    'DeepLabCut .csv or .h5, one animal or several',
    'scorer,DLC_resnet50,DLC_resnet50,DLC_resnet50\nbodyparts,tip,tip,tip\ncoords,x,y,likelihood\n'
    '0,101.5,55.2,0.99',
    _is_deeplabcut,
    _read_deeplabcut,
    is_always_ended=True,
    has_likelihood=True,
)
