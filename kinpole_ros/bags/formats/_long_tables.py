"""
Long tables: a row for each point of a frame, with a column that names the point.

Trackers of particles and scripts that find tags write them: the row of a point has the number or
the time of its frame, the number of the point, x and y. Rows may be in any order.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats import _cells
from kinpole_ros.bags.formats._sheet import Sheet

# "id", "TRACK_ID", "particle", "marker id", "keypoint", "child_frame_id".
_IDENTITY = re.compile(
    r'(?:.*[./])?(?:id|identity|track|trajectory|particle|marker|aruco|tag|point|object|body|bodypart|link'
    r'|body[ _]?part|keypoint|landmark|node|joint|individual|animal|subject|agent|target|instance'
    r'|label|name|corner|spot|feature|tid|pid|child_frame)s?'
    r'(?:[ _.-]?(?:id|ids|no|nr|number|num|name|label|index|idx|n°|#)\.?)?',
    re.IGNORECASE,
)
# Of trackers, for what belongs to no track.
_UNNAMED = ('', 'nan', 'none', 'null', '-1')
CHILD = 'child_frame_id'
# Rows for one that has the time of another: in a table of points, and in one with a few faults.
_MOST_SHARED, _FEW_SHARED = 4, 20
_FEWEST_ROWS = 8  # from which equal times are more than a fault of a row


class LongRows(NamedTuple):
    """Where each of R rows of a long table belongs."""

    kept: np.ndarray  # (R,), whether it names a point
    frames: np.ndarray  # (kept,), index of its frame
    points: np.ndarray  # (kept,), index of its point
    first: np.ndarray  # (T,), a row of each frame
    names: list[str]
    columns: list[int]  # that name the points


def identity_columns(header: Sequence[str]) -> list[int]:
    """Return the columns that may name the point of a row."""
    return [k for k, title in enumerate(header) if _IDENTITY.fullmatch(title)]


def find_long_rows(
    sheet: Sheet, header: Sequence[str], keys: np.ndarray, candidates: Sequence[int]
) -> LongRows | None:
    """
    Find frame and point of each row; None where each row is a frame.

    `keys` (R,) are times or numbers of frames, `candidates` columns that may name the point. Raises
    BagError for several rows of one frame that no column distinguishes.
    """
    known = keys[np.isfinite(keys)]
    # A time that stays for a single row is a fault of that row.
    repeats = len(known) - len(np.unique(known))
    texts = {k: [_plain_number(cell) for cell in sheet.texts(k, 1)] for k in candidates}
    # Numbers of rows, and what all rows share, name no point.
    counts = {k: len(set(cells)) for k, cells in texts.items()}
    useful = {k: texts[k] for k, count in counts.items() if 1 < count <= max(1, len(keys) // 2)}
    if not repeats and not any(title.endswith(CHILD) for title in header):
        return None
    is_usual = repeats >= len(known) / _MOST_SHARED and (
        len(known) >= _FEWEST_ROWS or bool(candidates)
    )
    if not is_usual:
        # A row for each body in turn, as messages on /tf; other columns may name anything.
        of_tf = {k for k in useful if header[k].endswith(CHILD)}
        useful = {k: useful[k] for k in useful if k in of_tf or repeats >= len(known) / _FEW_SHARED}
        if not useful:
            return None
    single = sorted(useful, key=lambda k: counts[k], reverse=True)
    for columns in [*([k] for k in single), *([single] if len(single) > 1 else [])]:
        names = [tuple(row) for row in zip(*(useful[k] for k in sorted(columns)), strict=True)]
        kept = np.array([not any(c.lower() in _UNNAMED for c in name) for name in names], bool)
        kept &= np.isfinite(keys)
        if (found := _group(keys, names, kept, sorted(columns))) is not None:
            return found
    # Without names, only rows in order are known to be points, and not frames out of order.
    if not is_usual or not (useful or (known[0] < known[-1] and (np.diff(known) >= 0).all())):
        return None
    row = int(np.argmax(np.isin(keys, _repeated(known))))
    named = ', '.join(f"'{_cells.shown(header[k])}'" for k in useful)
    raise BagError(
        f'{sheet.path}, line {sheet.lines[1 + row]}: several rows have the time or the number of '
        f'one frame, as in a table with a row for each point, and '
        f'{f"{named} name some twice" if named else "no column names the point"}; fix: name the '
        'point of each row in a column id'
    )


def _plain_number(cell: str) -> str:
    """Return 3 for 3.0, as pandas writes whole numbers in columns with gaps."""
    return cell[:-2] if cell.endswith('.0') and cell[:-2].lstrip('-').isdecimal() else cell


def _repeated(keys: np.ndarray) -> np.ndarray:
    values, counts = np.unique(keys, return_counts=True)
    return np.asarray(values[counts > 1])


def _group(
    keys: np.ndarray, names: list[tuple[str, ...]], kept: np.ndarray, columns: list[int]
) -> LongRows | None:
    """Return frames and points of the kept rows; None where a point comes twice in a frame."""
    rows = np.flatnonzero(kept)
    if not len(rows):
        return None
    numbers: dict[tuple[str, ...], int] = {}
    points = np.array([numbers.setdefault(names[row], len(numbers)) for row in rows], np.intp)
    _, first, frames = np.unique(keys[rows], return_index=True, return_inverse=True)
    if len(np.unique(frames * len(numbers) + points)) < len(rows):
        return None
    order = sorted(numbers, key=_by_number)
    ranks = np.empty(len(order), np.intp)
    ranks[[numbers[name] for name in order]] = np.arange(len(order))
    texts = ['.'.join(name) for name in order]
    return LongRows(kept, frames.reshape(-1), ranks[points], rows[first], texts, columns)


def _by_number(name: tuple[str, ...]) -> list[tuple[bool, int, str]]:
    """Sort numbers as numbers, and other names as they are."""
    return [(not c.isdecimal(), int(c) if c.isdecimal() else 0, c) for c in name]


def in_frames(values: np.ndarray, rows: LongRows, path: Path) -> np.ndarray:
    """Put values (R, n, k) of rows into frames: (T, points * n, k), NaN where a point is absent."""
    count, (_, width, size) = len(rows.names), values.shape
    if count * width > _cells.MOST_COLUMNS:
        raise BagError(
            f'{path} names {count * width} points, more than {_cells.MOST_COLUMNS}; '
            'fix: leave out those of short tracks'
        )
    _cells.check_cells(path, len(rows.first) * count * width * size)
    result = np.full((len(rows.first), count, width, size), np.nan)
    result[rows.frames, rows.points] = values[rows.kept]
    return result.reshape(len(rows.first), count * width, size)
