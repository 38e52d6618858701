"""
SLEAP, a program that finds points of bodies in videos: analysis tables as CSV or HDF5.

The CSV has a line for each instance in each frame, with columns track, frame_idx, instance.score,
then NODE.x, NODE.y and NODE.score. Pixels, y down; no times. Cells of nodes that were not found are
empty. The .h5 has positions by track, axis, node and frame, or by these in reverse, and names of
nodes and tracks.
"""

import json
from collections.abc import Sequence
from itertools import repeat
from typing import Any

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats import _cells, _hdf
from kinpole_ros.bags.formats._file import File, Format, Options, Points

# Axes of arrays in an .h5, by the names that a file may give.
_SLEAP_AXES = {'frame': 'f', 'track': 't', 'node': 'n', 'xy': 'x'}
_SLEAP_FIX = 'export the analysis .h5 or .csv from SLEAP again'


def _is_sleap(file: File) -> bool:
    if file.head.startswith(_hdf.HDF_MAGIC):
        return b'node_names' in file.data
    if not file.is_sheet:
        return False
    header = file.sheet.row(0)
    return 'frame_idx' in header and any(cell.endswith('.x') for cell in header)


def _read_sleap(file: File, options: Options) -> Points:
    if file.head.startswith(_hdf.HDF_MAGIC):
        with _hdf.opened_hdf(file, 'SLEAP', _SLEAP_FIX) as content:
            return _read_sleap_hdf(file, content, options)
    sheet, path = file.sheet, file.path
    header = sheet.row(0)
    columns = {name: column for column, name in reversed(list(enumerate(header)))}
    nodes = [name[:-2] for name in header if name.endswith('.x') and f'{name[:-2]}.y' in columns]
    _cells.check_names(path, nodes)
    numbers = sheet.column(columns['frame_idx'], 1, 'frame_idx')
    if len(numbers) == 0 or not (np.abs(numbers) < 2**53).all():
        raise BagError(f'{path}: frame_idx is missing or empty; fix: export the analysis CSV again')
    frames, rows = np.unique(numbers.astype(np.int64), return_inverse=True)
    animals: dict[str, int] = {}
    instances = np.zeros(len(numbers), np.int64)
    tracks = sheet.texts(columns['track'], 1) if 'track' in columns else repeat('', len(numbers))
    for row, name in enumerate(tracks):
        instances[row] = animals.setdefault(name, len(animals))
        if len(animals) * len(nodes) > _cells.MOST_COLUMNS:
            raise BagError(
                f'{path}: more than {_cells.MOST_COLUMNS} nodes in all tracks; '
                'fix: export fewer tracks'
            )
    _cells.check_cells(path, 3 * len(frames) * len(animals) * len(nodes))
    pairs, counts = np.unique(
        np.stack((frames[rows], instances), axis=1), axis=0, return_counts=True
    )
    if counts.max() > 1:
        frame, animal = pairs[int(counts.argmax())]
        raise BagError(
            f'{path}: frame {frame} has {counts.max()} instances of track '
            f"'{_cells.shown(list(animals)[animal])}', which nothing distinguishes; fix: track "
            'them in SLEAP first, or export one instance a frame'
        )
    points = np.full((len(frames), len(animals), len(nodes), 3), np.nan)
    axes = {node: [columns[f'{node}.x'], columns[f'{node}.y']] for node in nodes}
    points[rows, instances], _ = sheet.points(axes, 1, separator='.')
    if options.likelihood is not None:
        titles = {k: f'{n}.score' for k, n in enumerate(nodes) if f'{n}.score' in columns}
        if not titles:
            raise _hdf.no_scores(file)
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
    nodes, animals = (
        _hdf.hdf_texts(file, content, name, _SLEAP_FIX) for name in ('node_names', 'track_names')
    )
    tracks = _hdf.hdf_item(file, content, 'tracks', _SLEAP_FIX)
    _cells.check_cells(file.path, 2 * tracks.size)
    order = _sleap_axes(file, content, tracks, len(nodes), len(animals))
    values = np.asarray(tracks[:], np.float64).transpose([order.index(c) for c in 'ftnx'])
    points = np.zeros((*values.shape[:3], 3))
    points[..., :2] = values
    if options.likelihood is not None:
        if 'point_scores' not in content:
            raise _hdf.no_scores(file)
        scores = np.asarray(_hdf.hdf_item(file, content, 'point_scores', _SLEAP_FIX)[:], np.float64)
        order = _named_axes(content['point_scores']) or order.replace('x', '')
        scores = scores.transpose([order.index(c) for c in 'ftn'])
        points[~(scores >= options.likelihood)] = np.nan
    animals = animals or [f'track_{k}' for k in range(values.shape[1])]
    names = _cells.number_names(file.path, _point_names(animals, nodes), file.notes)
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


SLEAP = Format(
    'sleap',
    'SLEAP analysis .csv or .h5',
    'track,frame_idx,instance.score,tip.x,tip.y,tip.score\ncrank,0,0.95,101.5,55.2,0.98',
    _is_sleap,
    _read_sleap,
    has_likelihood=True,
)
