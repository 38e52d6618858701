"""
SLEAP: the analysis CSV, a line for each instance in each frame, and the analysis .h5.

Columns track, frame_idx, instance.score, then NODE.x, NODE.y and NODE.score. Pixels, y down; no
times. Cells of nodes that were not found are empty. The .h5 has places by track, axis, node and
frame, or by these in reverse, and names of nodes and tracks.
"""

from collections.abc import Sequence
from itertools import repeat
from typing import Any

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted
from kinpole_ros.bags.formats._hdf import HDF, errors_of_hdf, open_hdf, own_item
from kinpole_ros.bags.formats._sheet import (
    MOST_COLUMNS,
    check_cells,
    check_names,
    number_names,
    shown,
)

_FIX = 'export the analysis .h5 or .csv from SLEAP again'
_MOST_NAMES = 1 << 20  # bytes of names


def _recognizes(file: File) -> bool:
    if file.head.startswith(HDF):
        return b'node_names' in file.data
    if not file.is_sheet:
        return False
    header = file.sheet.head(0)
    return 'frame_idx' in header and any(cell.endswith('.x') for cell in header)


def _read(file: File, wanted: Wanted) -> Points:
    if file.head.startswith(HDF):
        with errors_of_hdf(file, 'SLEAP', _FIX):
            return _of_hdf(file, wanted)
    sheet, path = file.sheet, file.path
    header = sheet.head(0)
    places = {name: column for column, name in reversed(list(enumerate(header)))}
    nodes = [name[:-2] for name in header if name.endswith('.x') and f'{name[:-2]}.y' in places]
    check_names(path, nodes)
    numbers = sheet.column(places['frame_idx'], 1, 'frame_idx')
    if len(numbers) == 0 or not (np.abs(numbers) < 2**53).all():
        raise BagError(f'{path}: frame_idx is missing or empty; fix: export the analysis CSV again')
    frames, rows = np.unique(numbers.astype(np.int64), return_inverse=True)
    animals: dict[str, int] = {}
    instances = np.zeros(len(numbers), np.int64)
    tracks = sheet.texts(places['track'], 1) if 'track' in places else repeat('', len(numbers))
    for row, name in enumerate(tracks):
        instances[row] = animals.setdefault(name, len(animals))
        if len(animals) * len(nodes) > MOST_COLUMNS:
            raise BagError(
                f'{path}: more than {MOST_COLUMNS} nodes in all tracks; fix: export fewer tracks'
            )
    check_cells(path, 3 * len(frames) * len(animals) * len(nodes))
    places_taken, counts = np.unique(
        np.stack((frames[rows], instances), axis=1), axis=0, return_counts=True
    )
    if counts.max() > 1:
        frame, animal = places_taken[int(counts.argmax())]
        track = shown(list(animals)[animal])
        raise BagError(
            f"{path}: frame {frame} has {counts.max()} instances of track '{track}', and nothing "
            'tells them apart; fix: track them in SLEAP first, or export one instance a frame'
        )
    points = np.full((len(frames), len(animals), len(nodes), 3), np.nan)
    titles = [f'{node}.{letter}' for node in nodes for letter in 'xy']
    scored = [node for node in nodes if wanted.likelihood is not None and f'{node}.score' in places]
    titles += [f'{node}.score' for node in scored]
    done = 0
    for block in sheet.blocks([places[title] for title in titles], titles, 1):
        seen = np.zeros((len(block), len(nodes), 3))
        seen[..., :2] = block[:, : 2 * len(nodes)].reshape(len(block), len(nodes), 2)
        for index, node in enumerate(scored, start=2 * len(nodes)):
            seen[~(block[:, index] >= wanted.likelihood), nodes.index(node)] = np.nan
        here = slice(done, done + len(block))
        points[rows[here], instances[here]] = seen
        done += len(block)
    names = _names(list(animals), nodes)
    return Points(names, points.reshape(len(frames), -1, 3), frames, None, 'px', y_down=True)


def _names(animals: Sequence[str], nodes: Sequence[str]) -> list[str]:
    one = len(animals) == 1
    return [
        node if one else f'{animal or "untracked"}.{node}' for animal in animals for node in nodes
    ]


def _of_hdf(file: File, wanted: Wanted) -> Points:
    """Read an analysis .h5; scores (tracks, nodes, frames) count where a likelihood is given."""
    content = open_hdf(file)
    nodes, animals = (_read_texts(file, content, name) for name in ('node_names', 'track_names'))
    places = own_item(file, content, 'tracks', _FIX)
    check_cells(file.path, 2 * places.size)
    # Whether MATLAB's order is meant, which is the reverse.
    is_reversed = places.shape[1:3] != (2, len(nodes)) or (
        len(nodes) == 2 and len(animals) not in (0, places.shape[0])
    )
    values = np.asarray(places[:], np.float64)
    values = values if is_reversed else values.T  # by frame, node, axis and track
    if values.ndim != 4 or values.shape[1:3] != (len(nodes), 2):
        raise BagError(f'{file.path} has places by {places.shape}; fix: {_FIX}')
    points = np.zeros((len(values), values.shape[3], len(nodes), 3))
    points[..., :2] = values.transpose(0, 3, 1, 2)
    if wanted.likelihood is not None and 'point_scores' in content:
        scores = np.asarray(own_item(file, content, 'point_scores', _FIX)[:], np.float64)
        scores = scores if is_reversed else scores.T
        points[~(scores.swapaxes(1, 2) >= wanted.likelihood)] = np.nan
    animals = animals or [f'track_{k}' for k in range(values.shape[3])]
    names = number_names(file.path, _names(animals, nodes), file.notes)
    points[np.isnan(points).any(axis=-1)] = np.nan
    frames = np.arange(len(points))
    return Points(names, points.reshape(len(frames), -1, 3), frames, None, 'px', y_down=True)


def _read_texts(file: File, content: Any, name: str) -> list[str]:
    item = own_item(file, content, name, _FIX)
    if item.size > MOST_COLUMNS or item.dtype.itemsize * item.size > _MOST_NAMES:
        raise ValueError('names that are not')
    texts, size = [], 0
    for number in range(item.size):
        text = item[number]
        texts.append(text.decode() if isinstance(text, bytes) else str(text))
        # Texts of any length may all be one in the file.
        size += len(texts[-1])
        if size > _MOST_NAMES:
            raise ValueError('names that are not')
    return texts


FORMAT = Format(
    'sleap',
    'SLEAP analysis .csv or .h5',
    'track,frame_idx,instance.score,tip.x,tip.y,tip.score\ncrank,0,0.95,101.5,55.2,0.98',
    _recognizes,
    _read,
)
