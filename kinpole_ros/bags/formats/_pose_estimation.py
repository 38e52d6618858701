"""
DeepLabCut and SLEAP, programs that find points of bodies in videos: tables as CSV or HDF5.

DeepLabCut: columns are named by three rows, scorer, bodyparts and coords (x, y, likelihood), and by
one more, individuals, where there are several animals. The .h5 is of pandas, with the same columns.
Rows are frames by number; there are no times, and the unit is the pixel, with y down. Triangulated
points have z, and the unit of the calibration.

SLEAP: the analysis CSV has a line for each instance in each frame, with columns track, frame_idx,
instance.score, then NODE.x, NODE.y and NODE.score. Pixels, y down; no times. Cells of nodes that
were not found are empty. The .h5 has positions by track, axis, node and frame, or by these in
reverse, and names of nodes and tracks.
"""

import io
import json
import pickle
import pickletools
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice, product, repeat
from typing import Any, NamedTuple, NoReturn

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Options, Points
from kinpole_ros.bags.formats._sheet import (
    MOST_COLUMNS,
    check_cells,
    check_names,
    number_names,
    shown,
    whole_numbers,
)
from kinpole_ros.packages import install_command

_HDF = b'\x89HDF\r\n\x1a\n'
_CHUNK_BYTES = 32 << 20  # that one chunk may unpack to; those of PyTables have some 100 kB
_MOST_NAME_BYTES = 1 << 20
_SLICE_BYTES = 8 << 20  # of rows read at a time
_LIKELIHOOD = 0.6  # DeepLabCut's own limit, "pcutoff"
_AXES = ('x', 'y', 'z')
_DLC_FIX = 'give the .csv or .h5 that analyze_videos wrote'
# Axes of arrays in an .h5, by the names that a file may give.
_SLEAP_AXES = {'frame': 'f', 'track': 't', 'node': 'n', 'xy': 'x'}
_SLEAP_FIX = 'export the analysis .h5 or .csv from SLEAP again'


# HDF5 files of strangers: all that is read lies in the file and fits in memory.


@contextmanager
def _opened_hdf(file: File, program: str, fix: str) -> Iterator[Any]:
    """Open the file by h5py; what h5py and pickle raise for wrong bytes becomes a BagError."""
    try:
        import h5py
    except ImportError:
        raise BagError(
            f'{file.path} is HDF5, which needs h5py; fix: {install_command("formats")}, or give '
            'the .csv'
        ) from None
    try:
        yield h5py.File(io.BytesIO(file.data), 'r')
    except BagError:
        raise
    except Exception as error:
        raise BagError(f'{file.path} is not an .h5 of {program}; fix: {fix}') from error


def _item(file: File, group: Any, name: str, fix: str) -> Any:
    """
    Return a group or dataset of a group, whose bytes are in that file.

    Raises BagError for links and storage that lead to other files, and where a row or a chunk alone
    unpacks to more than `_CHUNK_BYTES`.
    """
    import h5py

    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise BagError(f"{file.path}: '{shown(name)}' is a link; fix: {fix}")
    item = group[name]
    if not isinstance(item, h5py.Dataset):
        return item
    if item.external or item.is_virtual:
        raise BagError(f"{file.path}: the rows of '{shown(name)}' are elsewhere; fix: {fix}")
    # HDF5 unpacks one chunk at a time. Python integers, since the product may be large.
    size = item.dtype.itemsize
    for length in item.chunks or ():
        size *= length
    if size > _CHUNK_BYTES:
        raise BagError(
            f'{file.path}: a chunk of {(item.chunks or [1])[0]} rows is more than '
            f'{_CHUNK_BYTES >> 20} MiB; fix: {fix}'
        )
    return item


def _no_scores(file: File, name: str = 'scores') -> BagError:
    return BagError(f'{file.path} has no {name} of points; fix: leave that option out')


# DeepLabCut


class _LabeledColumns(NamedTuple):
    """Columns of a .csv or an .h5, which are read a block of rows at a time."""

    labels: list[tuple[str, str]]  # marker and coordinate of each column
    lines: Sequence[int]  # of each row
    index_name: str  # of the column of frame numbers
    blocks: Iterator[tuple[np.ndarray, np.ndarray]]  # frame numbers (rows,), (rows, columns)


def _is_deeplabcut(file: File) -> bool:
    if file.head.startswith(_HDF):
        return True
    if not file.is_sheet:
        return False
    first = [file.sheet.cell(row, 0) for row in range(4)]
    return 'bodyparts' in first and 'coords' in first


def _read_deeplabcut(file: File, options: Options) -> Points:
    if file.head.startswith(_HDF):
        with _opened_hdf(file, 'DeepLabCut', _DLC_FIX) as content:
            return _points_of_table(file, _hdf_table(file, content), options)
    return _points_of_table(file, _csv_table(file), options)


def _points_of_table(file: File, table: _LabeledColumns, options: Options) -> Points:
    labels, lines, index_name, blocks = table
    likelihood = _LIKELIHOOD if options.likelihood is None else options.likelihood
    columns = {label: column for column, label in enumerate(labels)}
    names = list(dict.fromkeys(name for name, _ in labels))
    check_names(file.path, names)
    if options.likelihood is not None and not any(what == 'likelihood' for _, what in labels):
        raise _no_scores(file, 'likelihoods')
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
        group = _item(file, content, name, _DLC_FIX)
        if not isinstance(group, h5py.Group) or 'table' not in group:
            continue
        table = _item(file, group, 'table', _DLC_FIX)
        if not isinstance(table, h5py.Dataset) or table.ndim != 1 or table.dtype.names is None:
            raise BagError(f"{file.path}: '{shown(name)}' is not a table; fix: {_DLC_FIX}")
        for field in table.dtype.names:
            if table.dtype[field].base.kind not in 'iuf':
                raise BagError(
                    f"{file.path}: column '{shown(field)}' is not of numbers; fix: {_DLC_FIX}"
                )
        return table
    raise BagError(f'{file.path} has no table of DeepLabCut; fix: {_DLC_FIX}')


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


# SLEAP


def _is_sleap(file: File) -> bool:
    if file.head.startswith(_HDF):
        return b'node_names' in file.data
    if not file.is_sheet:
        return False
    header = file.sheet.row(0)
    return 'frame_idx' in header and any(cell.endswith('.x') for cell in header)


def _read_sleap(file: File, options: Options) -> Points:
    if file.head.startswith(_HDF):
        with _opened_hdf(file, 'SLEAP', _SLEAP_FIX) as content:
            return _read_sleap_hdf(file, content, options)
    sheet, path = file.sheet, file.path
    header = sheet.row(0)
    columns = {name: column for column, name in reversed(list(enumerate(header)))}
    nodes = [name[:-2] for name in header if name.endswith('.x') and f'{name[:-2]}.y' in columns]
    check_names(path, nodes)
    numbers = sheet.column(columns['frame_idx'], 1, 'frame_idx')
    if len(numbers) == 0 or not (np.abs(numbers) < 2**53).all():
        raise BagError(f'{path}: frame_idx is missing or empty; fix: export the analysis CSV again')
    frames, rows = np.unique(numbers.astype(np.int64), return_inverse=True)
    animals: dict[str, int] = {}
    instances = np.zeros(len(numbers), np.int64)
    tracks = sheet.texts(columns['track'], 1) if 'track' in columns else repeat('', len(numbers))
    for row, name in enumerate(tracks):
        instances[row] = animals.setdefault(name, len(animals))
        if len(animals) * len(nodes) > MOST_COLUMNS:
            raise BagError(
                f'{path}: more than {MOST_COLUMNS} nodes in all tracks; fix: export fewer tracks'
            )
    check_cells(path, 3 * len(frames) * len(animals) * len(nodes))
    pairs, counts = np.unique(
        np.stack((frames[rows], instances), axis=1), axis=0, return_counts=True
    )
    if counts.max() > 1:
        frame, animal = pairs[int(counts.argmax())]
        raise BagError(
            f'{path}: frame {frame} has {counts.max()} instances of track '
            f"'{shown(list(animals)[animal])}', which nothing distinguishes; fix: track them in "
            'SLEAP first, or export one instance a frame'
        )
    points = np.full((len(frames), len(animals), len(nodes), 3), np.nan)
    axes = {node: [columns[f'{node}.x'], columns[f'{node}.y']] for node in nodes}
    points[rows, instances], _ = sheet.points(axes, 1, separator='.')
    if options.likelihood is not None:
        titles = {k: f'{n}.score' for k, n in enumerate(nodes) if f'{n}.score' in columns}
        if not titles:
            raise _no_scores(file)
        for k, title in titles.items():
            doubtful = ~(sheet.column(columns[title], 1, title) >= options.likelihood)
            points[rows[doubtful], instances[doubtful], k] = np.nan
    names = _point_names(list(animals), nodes)
    return Points(names, points.reshape(len(frames), -1, 3), frames, None, 'px', y_down=True)


def _point_names(animals: Sequence[str], nodes: Sequence[str]) -> list[str]:
    if len(animals) == 1:
        return list(nodes)
    return [f'{animal or "untracked"}.{node}' for animal in animals for node in nodes]


def _read_sleap_hdf(file: File, content: Any, options: Options) -> Points:
    """Read an analysis .h5; scores (tracks, nodes, frames) count where a likelihood is given."""
    nodes, animals = (_read_texts(file, content, name) for name in ('node_names', 'track_names'))
    tracks = _item(file, content, 'tracks', _SLEAP_FIX)
    check_cells(file.path, 2 * tracks.size)
    order = _sleap_axes(file, content, tracks, len(nodes), len(animals))
    values = np.asarray(tracks[:], np.float64).transpose([order.index(c) for c in 'ftnx'])
    points = np.zeros((*values.shape[:3], 3))
    points[..., :2] = values
    if options.likelihood is not None:
        if 'point_scores' not in content:
            raise _no_scores(file)
        scores = np.asarray(_item(file, content, 'point_scores', _SLEAP_FIX)[:], np.float64)
        order = _named_axes(content['point_scores']) or order.replace('x', '')
        scores = scores.transpose([order.index(c) for c in 'ftn'])
        points[~(scores >= options.likelihood)] = np.nan
    animals = animals or [f'track_{k}' for k in range(values.shape[1])]
    names = number_names(file.path, _point_names(animals, nodes), file.notes)
    points[np.isnan(points).any(axis=-1)] = np.nan
    frames = np.arange(len(points))
    return Points(names, points.reshape(len(frames), -1, 3), frames, None, 'px', y_down=True)


def _named_axes(item: Any) -> str:
    """Return the axes of a dataset as it names them: f, t, n, x for frame, track, node, xy."""
    try:
        return ''.join(_SLEAP_AXES[name] for name in json.loads(item.attrs.get('dims', '[]')))
    except (TypeError, ValueError, KeyError):
        return ''


def _sleap_axes(file: File, content: Any, tracks: Any, nodes: int, animals: int) -> str:
    """
    Return the axes of places: as the file names them, else those of SLEAP's own orders that fit.

    That is the order of Python, or of MATLAB, its reverse. Raises BagError where none or both fit.
    """
    sizes = {'x': 2, 'n': nodes}
    if animals:
        sizes['t'] = animals
        if 'track_occupancy' in content:
            sizes['f'] = content['track_occupancy'].size // animals
    named = _named_axes(tracks)
    found = [
        order
        for order in ([named] if named else ['txnf', 'fnxt'])
        if sorted(order) == ['f', 'n', 't', 'x']
        and tracks.ndim == 4
        and all(
            sizes.get(axis, size) == size for axis, size in zip(order, tracks.shape, strict=True)
        )
    ]
    if len(found) == 1:
        return found[0]
    fault = 'may be by track, xy, node, frame or the reverse' if found else 'fit no names'
    raise BagError(f'{file.path} has places by {tracks.shape}, which {fault}; fix: {_SLEAP_FIX}')


def _read_texts(file: File, content: Any, name: str) -> list[str]:
    item = _item(file, content, name, _SLEAP_FIX)
    if item.size > MOST_COLUMNS or item.dtype.itemsize * item.size > _MOST_NAME_BYTES:
        raise ValueError('names that are not')
    texts, size = [], 0
    for number in range(item.size):
        text = item[number]
        texts.append(text.decode() if isinstance(text, bytes) else str(text))
        # Texts of any length may all be one in the file.
        size += len(texts[-1])
        if size > _MOST_NAME_BYTES:
            raise ValueError('names that are not')
    return texts


SLEAP = Format(
    'sleap',
    'SLEAP analysis .csv or .h5',
    'track,frame_idx,instance.score,tip.x,tip.y,tip.score\ncrank,0,0.95,101.5,55.2,0.98',
    _is_sleap,
    _read_sleap,
    has_likelihood=True,
)
