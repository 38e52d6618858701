"""
SLEAP: the analysis CSV, a line for each instance in each frame.

Columns track, frame_idx, instance.score, then NODE.x, NODE.y and NODE.score. Pixels, y down; no
times. Cells of nodes that were not found are empty.
"""

from itertools import repeat

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted
from kinpole_ros.bags.formats._sheet import MOST_COLUMNS, check_cells, check_names, shown


def _recognizes(file: File) -> bool:
    if not file.is_text:
        return False
    header = file.sheet.head(0)
    return 'frame_idx' in header and any(cell.endswith('.x') for cell in header)


def _read(file: File, wanted: Wanted) -> Points:
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
    one = len(animals) == 1
    names = [
        node if one else f'{animal or "untracked"}.{node}' for animal in animals for node in nodes
    ]
    return Points(names, points.reshape(len(frames), -1, 3), frames, None, 'px', y_down=True)


FORMAT = Format(
    'sleap',
    'SLEAP analysis .csv',
    'track,frame_idx,instance.score,tip.x,tip.y,tip.score\ncrank,0,0.95,101.5,55.2,0.98',
    _recognizes,
    _read,
)
