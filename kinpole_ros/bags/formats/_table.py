"""
The plain table, which anyone can write: a line of names, then a line for each frame.

Columns are NAME_x and NAME_y for each marker, maybe NAME_z (else z is 0), and t, in s, or another
column named as one of times. One marker may have columns x and y alone. A quaternion beside them
makes them the pose of a body, as in the tables of ROS tools. Others are named in a line. A cell
that is empty or 'nan' means that its marker was not seen in that frame. The unit is m, if no column
says another. A row may also be that of one point of a frame (`_long_tables`).

Anipose writes such a table, too: fnum, and x, y, z, error, ncams and score of each point, in the
unit of its calibration.
"""

import re
from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from itertools import product
from typing import NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._cells import listed, shown, whole_numbers
from kinpole_ros.bags.formats._file import File, Format, Options, Points, frame_times, not_utf8
from kinpole_ros.bags.formats._long_tables import (
    CHILD,
    LongRows,
    find_long_rows,
    identity_columns,
    in_frames,
)
from kinpole_ros.bags.formats._preamble import (
    PIXELS,
    Preamble,
    data_sets,
    plain_sheet,
    read_preamble,
    titles_of,
)
from kinpole_ros.bags.formats._row_times import TimeColumns, find_times, read_times
from kinpole_ros.bags.formats._shares import SHARES, unit_of_picture
from kinpole_ros.bags.formats._sheet import Sheet
from kinpole_ros.bags.formats._titles import BODY, Layout, find_columns

# "frame", "Frame#", "fnum", "frame_number", "Slice".
_FRAME = re.compile(
    r'(?:video[ _]?)?f(?:rame|num)s?(?:[ _]?(?:number|num|no|nr|index|idx|id|#)\.?)?|slice(?: n°)?',
    re.IGNORECASE,
)
_IN_FRAMES = re.compile(r't(?:ime)? ?[(\[]frames?[)\]]', re.IGNORECASE)  # of MTrackJ
# Points that only pictures have: the corners of tags.
_CORNER = re.compile(r'(?:top|bottom)[ _]?(?:left|right)|corner[ _]?[0-9]', re.IGNORECASE)
# By scripts that find tags in pictures: center_x, center_y, or x1, y1, ... x4, y4.
_OF_TAGS = {'center'}, {'centre'}, {f'point{k}' for k in range(1, 5)}
_FAR = 50.0  # m: beyond, points of a tracker of particles or tags are in another unit
_LIKELIHOODS = ('likelihood', 'score', 'confidence', 'visibility', 'presence')


class _Rows(NamedTuple):
    """What the R rows of a table have, each of them a frame or a point of one."""

    points: np.ndarray  # (R, n, 3)
    poses: np.ndarray  # (R, B, 7)
    frames: np.ndarray  # (R,), int64
    seconds: np.ndarray | None  # (R,)
    stamps: np.ndarray | None  # (R,), ns
    lines: Sequence[int]
    names: list[str]  # n
    bodies: list[str]  # B


def _is_table(file: File) -> bool:
    if not file.is_sheet:
        return False
    about = read_preamble(file.sheet)
    return about.is_found and about.is_known


def _is_anipose(file: File) -> bool:
    header = titles_of(file.sheet.row(0)) if file.is_sheet else []
    return 'fnum' in header and any(name.endswith('_ncams') for name in header)


def _read(file: File, options: Options) -> Points:
    """Read the columns of markers and bodies, and those of times or of frame numbers."""
    about = read_preamble(file.sheet)
    if file.sheet.not_utf8_line:
        raise not_utf8(file.path, file.sheet.not_utf8_line)
    sheet = plain_sheet(file, about)
    header = _checked_header(sheet)
    layout = find_columns(header)
    _check_layout(sheet, layout)
    number, times = _frame_columns(sheet, header, options.rate is not None)
    key = number if number is not None else times.columns[0] if times else None
    given, times = times, None if options.rate is not None else times
    seconds, stamps = read_times(sheet, times) if times else (None, None)
    long = _long_rows(sheet, header, number, given, seconds)
    rows, used = _read_rows(sheet, header, layout, options, None if long or times else number)
    rows = rows._replace(seconds=seconds, stamps=stamps)
    used |= {number, *(times.columns if times else ())}
    if long is not None:
        rows = _frames_of(sheet, header, rows, long, number)
        used |= {*long.columns, key}
    unread = [shown(name) for k, name in enumerate(header) if name and k not in used]
    if unread and not _is_anipose(file):
        sheet.notes.append(f'{file.path}: columns that are not read: {listed(unread)}')
    unit = layout.unit or about.unit or ''
    if not _is_anipose(file):
        unit = unit_of_picture(header, rows.points, unit)
        unit = unit or _usual_unit(header, layout, about, rows.points, long)
    is_down = unit == SHARES or unit.lower() in PIXELS or _is_trackmate(header)
    if unit == SHARES:
        # A network guesses depth, from the width of the body.
        rows.points[..., 2] *= 0.0
    if is_down:
        place = 'pixels' if unit.lower() in PIXELS else unit if unit == SHARES else 'a picture'
        sheet.notes.append(
            f'{file.path} is in {place}, so y points down unless you give --no-y-down'
        )
    elif not unit and long is not None:
        sheet.notes.append(f'{file.path} may be of a picture; y points up unless you give --y-down')
    if about.rate and options.rate is None:
        rows = rows._replace(seconds=frame_times(file, rows.frames, about.rate, rows.seconds))
    title = times.title if times else 't' if number is None else header[number]
    return Points(
        rows.names,
        rows.points,
        rows.frames,
        rows.seconds,
        unit,
        y_down=is_down,
        lines=rows.lines,
        time_column=shown(title),
        stamps=rows.stamps,
        bodies=rows.bodies,
        poses=rows.poses if rows.bodies else None,
    )


def _checked_header(sheet: Sheet) -> list[str]:
    """Return the titles of columns; raises BagError for some that come twice, or uneven rows."""
    path = sheet.path
    if len(sheet) < 2:
        fault = 'has no frames, only a line of names' if len(sheet) else 'is empty'
        raise BagError(f'{path} {fault}; fix: give a line of names and a line for each frame')
    if sets := data_sets(sheet.row(0)):
        raise BagError(
            f'{path} has several data sets, {listed([shown(name) for name in sets])}, each with '
            'times of its own; fix: export one of them'
        )
    header, head_line = titles_of(sheet.row(0)), sheet.lines[0]
    for name, count in Counter(header).items():
        if name and count > 1:
            raise BagError(
                f"{path}, line {head_line}: column '{shown(name)}' is there twice; fix: rename one"
            )
    if (uneven := sheet.uneven_row()) is not None:
        raise BagError(
            f'{path}, line {sheet.lines[uneven]}: {len(sheet.row(uneven))} cells under '
            f'{len(header)} names; fix: as many separators in each line'
        )
    return header


def _check_layout(sheet: Sheet, layout: Layout) -> None:
    """Raise BagError where there are no points, or one lacks x or y."""
    where = f'{sheet.path}, line {sheet.lines[0]}'
    if not layout.points:
        raise BagError(
            f'{where}: no column is named NAME_x; fix: name the columns of each '
            'marker NAME_x and NAME_y, with commas between them'
        )
    links = [name.split('/')[-2:] for name in layout.turns if name.startswith('tf/')]
    if chained := [child for parent, child in links if parent in [own for _, own in links]]:
        raise BagError(
            f'{sheet.path} has {shown(chained[0])} in a frame that moves; fix: give the bag '
            'itself, in which such chains are multiplied out'
        )
    for name, axis in product(layout.points, 'xy'):
        if axis not in layout.points[name]:
            raise BagError(
                f"{where}: marker '{shown(name)}' has no column "
                f'{shown(f"{name}_{axis}")}; fix: add it'
            )


def _read_rows(
    sheet: Sheet,
    header: Sequence[str],
    layout: Layout,
    options: Options,
    number: int | None,
) -> tuple[_Rows, set[int | None]]:
    """Read all rows, without times, and return the columns that were read, too."""
    columns = {n: [of[axis] for axis in 'xyz' if axis in of] for n, of in layout.points.items()}
    given = None if number is None else (number, header[number])
    points, numbers = sheet.points(columns, 1, number=given, separator='_')
    frames = np.arange(len(points))
    if number is not None:
        frames = whole_numbers(sheet.path, numbers, sheet.lines[1:], header[number])
    used: set[int | None] = {column for of in columns.values() for column in of}
    used |= {column for of in layout.turns.values() for column in of}
    used |= _leave_out_unlikely(sheet, header, points, list(columns), options)
    poses = np.full((len(points), len(layout.turns), 7), np.nan)
    for body, (name, axes) in enumerate(layout.turns.items()):
        poses[:, body, :3] = points[:, list(columns).index(name)]
        poses[:, body, 3:] = sheet.numbers(axes, [f'{name}_q{axis}' for axis in 'xyzw'], 1)
    poses[np.isnan(poses).any(axis=-1) | ~poses[..., 3:].any(axis=-1)] = np.nan
    names, bodies = list(columns), list(layout.turns)
    if bodies == [BODY] and (child := _only_child(sheet, header)):
        names, bodies = [child if name == BODY else name for name in names], [child]
    return _Rows(points, poses, frames, None, None, sheet.lines[1:], names, bodies), used


def _only_child(sheet: Sheet, header: Sequence[str]) -> str:
    """Return the name of the only body in the messages of a table; '' where it has none."""
    columns = [k for k, name in enumerate(header) if name.endswith(CHILD)]
    names = set(sheet.texts(columns[0], 1)) if columns else set()
    return names.pop() if len(names) == 1 else ''


def _frame_columns(
    sheet: Sheet, header: Sequence[str], is_rate_given: bool
) -> tuple[int | None, TimeColumns | None]:
    """
    Find the column of frame numbers, and those of times.

    Where rows are points, times 0, 1, 2, ... of no unit are numbers of frames, as of napari.
    """
    number = next((k for k, name in enumerate(header) if _FRAME.fullmatch(name)), None)
    if number is None and identity_columns(header):
        number = next((k for k, name in enumerate(header) if _IN_FRAMES.fullmatch(name)), None)
        if number is not None:
            return number, None
    times = None
    with suppress(BagError) if is_rate_given else nullcontext():
        times = find_times(sheet, header)
    if number is None and times and not times.is_stated and identity_columns(header):
        with suppress(BagError):
            column = sheet.column(times.columns[0], 1, times.title)
            steps = np.diff(np.unique(column))
            if len(steps) and 2 * len(steps) < len(column) and np.median(steps) == 1:
                return times.columns[0], None
    return number, times


def _long_rows(
    sheet: Sheet,
    header: Sequence[str],
    number: int | None,
    times: TimeColumns | None,
    seconds: np.ndarray | None,
) -> LongRows | None:
    """Find frame and point of each row, where a row is not a frame."""
    candidates = identity_columns(header)
    if number is not None and (candidates or seconds is None):
        return find_long_rows(sheet, header, sheet.column(number, 1, header[number]), candidates)
    if seconds is not None:
        return find_long_rows(sheet, header, seconds, candidates)
    if times is None:
        return None
    # Times that are not used may be anything.
    keys = np.full(len(sheet) - 1, np.nan)
    with suppress(BagError):
        keys, _ = read_times(sheet, times)
    return find_long_rows(sheet, header, keys, candidates)


def _frames_of(
    sheet: Sheet, header: Sequence[str], rows: _Rows, long: LongRows, number: int | None
) -> _Rows:
    """Put the rows of points into frames."""
    path, first = sheet.path, long.first
    if left_out := int((~long.kept).sum()):
        sheet.notes.append(f'{path}: rows that name no point are left out: {left_out}')
    parents = [k for k, name in enumerate(header) if name.endswith('frame_id')
               and not name.endswith(CHILD)]  # fmt: skip
    if rows.bodies and parents and len(frames := set(sheet.texts(parents[0], 1))) > 1:
        raise BagError(
            f'{path} has bodies in several frames, {listed(sorted(map(shown, frames)))}; '
            'fix: give the bag itself, in which such chains are multiplied out'
        )
    lines = [rows.lines[row] for row in first]
    frames = np.arange(len(first))
    if number is not None:
        numbers = sheet.column(number, 1, header[number])[first]
        frames = whole_numbers(path, numbers, lines, header[number])
    return _Rows(
        in_frames(rows.points, long, path),
        in_frames(rows.poses, long, path),
        frames,
        None if rows.seconds is None else rows.seconds[first],
        None if rows.stamps is None else rows.stamps[first],
        lines,
        _joined_names(long.names, rows.names),
        _joined_names(long.names, rows.bodies),
    )


def _joined_names(points: Sequence[str], columns: Sequence[str]) -> list[str]:
    """Name what each point has: by the point alone where its columns are those of one point."""
    if len(columns) == 1:
        return list(points)
    return [f'{point}.{column}' for point in points for column in columns]


def _is_trackmate(header: Sequence[str]) -> bool:
    return any(title.lower().startswith('position_t') for title in header)


def _usual_unit(
    header: Sequence[str],
    layout: Layout,
    about: Preamble,
    points: np.ndarray,
    long: LongRows | None,
) -> str:
    """Return the unit of a table that says none: px of pictures, m, or '' where it may be any."""
    titles = {title.lower() for title in header}
    if _is_trackmate(header):
        return ''
    is_far = long is not None and np.nanmax(np.abs(points[..., :2]), initial=0.0) > _FAR
    is_in_picture = (
        {'particle', 'frame'} <= titles  # trackpy
        or all(of['y'] < of['x'] for of in layout.points.values())  # rows and columns of a picture
        or all(map(_CORNER.fullmatch, layout.points))
        or {'cx', 'cy'} <= titles  # the center of a contour or a tag
        or (titles >= {'seconds', 'x1', 'y1'} and len(titles) % 2 == 1)  # idtracker.ai
        or any(title.startswith('probid') for title in titles)  # idtracker
        or (is_far and layout.points.keys() in _OF_TAGS)
    )
    if is_in_picture:
        return 'px'
    # Lines above the names that say the rate alone may say the unit in other words.
    return '' if about.rate or is_far else 'm'


def _leave_out_unlikely(
    sheet: Sheet, header: Sequence[str], points: np.ndarray, names: list[str], options: Options
) -> set[int | None]:
    """Blank points (T, n, 3) below the likelihood; return the columns of likelihoods."""
    columns = {
        k: header.index(title)
        for k, name in enumerate(names)
        for word in _LIKELIHOODS
        for title in (f'{name}_{word}', *([word] if len(names) == 1 else []))
        if title in header
    }
    if options.likelihood is not None:
        if not columns:
            raise BagError(
                f'{sheet.path} has no likelihoods; fix: name their columns NAME_likelihood, or '
                'leave that out'
            )
        for k, column in columns.items():
            likelihood = sheet.column(column, 1, header[column])
            points[~(likelihood >= options.likelihood), k] = np.nan
    return set(columns.values())


ANIPOSE = Format(
    'anipose',
    'Anipose .csv of points in space',
    'tip_x,tip_y,tip_z,tip_error,tip_ncams,tip_score,fnum\n1.25,2.5,3.3,0.4,3,0.98,0',
    _is_anipose,
    _read,
    is_always_ended=True,
    has_likelihood=True,
)
TABLE = Format(
    'table',
    'columns NAME_x, NAME_y, maybe NAME_z, and t in seconds',
    't,tip_x,tip_y\n0.00,0.125,0.250',
    _is_table,
    _read,
    has_likelihood=True,
)
