"""
Kinovea: trajectories and angles as CSV, and trajectories as text (gnuplot) or for Excel (.xml).

CSV has columns Time, then OBJECT/POINT/X and OBJECT/POINT/Y, or an angle each; cells are in quotes,
and decimals and separators are those of the computer. Text and XML have the rows of one trajectory
after those of another. Lengths are in what the user calibrated, with y up; only XML says in what.
Times are what the user chose for the screen: seconds, rounded to milliseconds, by default, and in
older versions h:mm:ss:cc.
"""

import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted
from kinpole_ros.bags.formats._sheet import (
    MOST_CELLS,
    Sheet,
    check_cells,
    check_names,
    number_names,
    number_or_inf,
    shown,
)

_TIME = re.compile(r'Time(?:\s*\((?P<unit>m?s)\))?', re.IGNORECASE)
_X = re.compile(r'(.+)/X', re.IGNORECASE)
_ANGLE = re.compile(r'.*\bangle\b.*', re.IGNORECASE)
_TEXT = b'#Kinovea Trajectory'
_EXCEL = b'urn:schemas-microsoft-com:office:spreadsheet'
_COORDINATES = re.compile(r'Coords \(x,\s*y:\s*(?P<unit>[^;]*);.*')
_FIX = 'export it again'


class _Track(NamedTuple):
    """A trajectory of P points: the rows of text or XML."""

    name: str
    times: list[str]
    places: list[list[float]]  # 2 P numbers each


def _recognizes(file: File) -> bool:
    if _TEXT in file.head or _EXCEL in file.head:
        return True
    if not file.is_sheet:
        return False
    time, *others = file.sheet.head(0) or ['']
    others = [title for title in others if title]
    is_angles = bool(others) and all(map(_ANGLE.fullmatch, others))
    return bool(_TIME.fullmatch(time)) and (is_angles or any(map(_X.fullmatch, others)))


def _read(file: File, wanted: Wanted) -> Points:
    if _EXCEL in file.head:
        tracks, unit = _excel_tracks(file)
        return _of_tracks(file, tracks, unit, wanted)
    if _TEXT in file.head:
        return _of_tracks(file, list(_text_tracks(file)), '', wanted)
    sheet, path = file.sheet, file.path
    header = sheet.head(0)
    time = _TIME.fullmatch(header[0]) if header else None
    angles = {name: column for column, name in enumerate(header) if _ANGLE.fullmatch(name)}
    columns = _columns(sheet, header)
    if not columns and time and angles:
        return _of_angles(file, angles, wanted)
    # A trajectory has one point, and its key says nothing.
    objects = [name.rpartition('/')[0] or name for name in columns]
    names = [
        thing if objects.count(thing) == 1 else name.replace('/', '.')
        for name, thing in zip(columns, objects, strict=True)
    ]
    check_names(path, names)
    points, numbers = sheet.points(list(columns.values()), names, 1, also=(0, 'Time'))
    frames, times, why = _clock(sheet, numbers)
    times = None if wanted.rate is not None else times
    return Points(names, points, frames, times, '', lines=sheet.lines[1:], no_times=why)


def _columns(sheet: Sheet, header: Sequence[str]) -> dict[str, list[int]]:
    """Find columns X and Y by OBJECT/POINT."""
    columns: dict[str, list[int]] = {}
    for column, title in enumerate(header[:-1]):
        if match := _X.fullmatch(title):
            if header[column + 1].lower() != f'{match[1]}/y'.lower():
                raise BagError(f'{sheet.path}: {shown(title)} has no Y behind it; fix: {_FIX}')
            if match[1] in columns:
                raise BagError(
                    f"{sheet.path}: '{shown(match[1])}' is there twice; fix: rename one in Kinovea"
                )
            columns[match[1]] = [column, column + 1]
    return columns


def _of_angles(file: File, angles: dict[str, int], wanted: Wanted) -> Points:
    """Make a body at the origin of each angle, which is in degrees unless its name says rad."""
    sheet = file.sheet
    numbers = sheet.column(0, 1, 'Time')
    frames, times, why = _clock(sheet, numbers)
    poses = np.zeros((len(numbers), len(angles), 7))
    for k, (name, column) in enumerate(angles.items()):
        half = np.radians(sheet.column(column, 1, name)) / 2
        half /= np.radians(1) if '(rad' in name.lower() else 1
        poses[:, k, 5], poses[:, k, 6] = np.sin(half), np.cos(half)
    poses[np.isnan(poses).any(axis=-1)] = np.nan
    return Points(
        list(angles),
        poses[..., :3].copy(),
        frames,
        None if wanted.rate is not None else times,
        'm',
        lines=sheet.lines[1:],
        no_times=why,
        bodies=list(angles),
        poses=poses,
    )


def _clock(sheet: Sheet, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray | None, str]:
    """Return numbers of frames and their times, s, or why there are none, from the column Time."""
    steps = np.diff(numbers)
    step = float(steps.min(initial=np.inf))
    if not step > 0:
        row = int(np.argmin(steps > 0)) + 1
        raise BagError(
            f'{sheet.path}, line {sheet.lines[1:][row]}: Time does not go on from the line before; '
            f'fix: {_FIX}'
        )
    # Frames in which nothing was tracked have no line.
    frames = np.concatenate(([0], np.rint(steps / step).cumsum())).astype(np.int64)
    frames = frames[: len(numbers)]
    unit = (_TIME.fullmatch(sheet.cell(0, 0)) or {'unit': None})['unit']
    if unit:
        return frames, numbers * (1e-3 if unit.lower() == 'ms' else 1.0), ''
    why = _unknown_unit(step, numbers)
    return frames, None if why else numbers, why


def _unknown_unit(step: float, times: np.ndarray) -> str:
    """Say why times with this step are not in seconds, rounded to milliseconds; '' if they are."""
    if step < 1 and np.abs(times * 1e3 - np.rint(times * 1e3)).max(initial=0.0) < 1e-2:
        return ''
    return (
        f'has times that go on by {step:.6g} from line to line, frames or milliseconds, as Kinovea '
        'writes what its screen shows'
    )


def _text_tracks(file: File) -> Iterator[_Track]:
    """Yield the trajectories of a text: empty lines between them, and maybe # NAME above them."""
    track = _Track('', [], [])
    lines = file.data.decode('utf-8-sig', 'replace').splitlines()
    for number, line in enumerate([*lines, ''], start=1):
        if line.strip() and not line.startswith('#'):
            _append_row(file, track, line.split(), f'line {number}')
            continue
        if track.times:
            yield track
            track = _Track('', [], [])
        if line.startswith('#') and number > 2:
            track = _Track(line.strip('# '), [], [])


def _excel_tracks(file: File) -> tuple[list[_Track], str]:
    """Read the trajectories of an .xml, and their unit."""
    space = f'{{{_EXCEL.decode()}}}'
    name, units = '', {''}
    track = None
    tracks: list[_Track] = []
    for number, row in enumerate(file.xml(f'fix: {_FIX}').iter(f'{space}Row'), start=1):
        cells = [(cell.text or '').strip() for cell in row.iter(f'{space}Data')]
        if cells == ['x', 'y', 't']:
            track = _Track(name, [], [])
            tracks.append(track)
        elif track is not None and len(cells) == 3:
            _append_row(file, track, [cells[2], *cells[:2]], f'row {number}')
        else:
            track = None
            if len(cells) == 2 and cells[0].startswith('Label'):
                name = cells[1]
            elif match := _COORDINATES.fullmatch(' '.join(cells)):
                units.add(match['unit'].strip())
    return [track for track in tracks if track.times], max(units) if len(units) < 3 else ''


def _append_row(file: File, track: _Track, cells: list[str], where: str) -> None:
    """Append a row, of time and places, to a trajectory."""
    places = [number_or_inf(cell.replace(',', '.')) for cell in cells[1:]]
    if (
        not places
        or len(places) % 2
        or not np.isfinite(places).all()
        or (track.places and len(places) != len(track.places[0]))
    ):
        shown_cells = shown(' '.join(cells))
        raise BagError(f"{file.path}, {where}: '{shown_cells}' is not t, x and y; fix: {_FIX}")
    track.times.append(cells[0])
    track.places.append(places)


def _seconds(time: str) -> float:
    """Convert h:mm:ss:cc or [h:][mm:]ss.xx to seconds; infinity for what is neither."""
    parts = time.replace(',', '.').split(':')
    if len(parts) == 4:
        parts[2:] = [f'{parts[2]}.{parts[3]}']
    total = 0.0
    for part in parts[-3:]:
        total = 60 * total + number_or_inf(part)
    return total if len(parts) <= 3 else math.inf


def _of_tracks(file: File, tracks: Sequence[_Track], unit: str, wanted: Wanted) -> Points:
    """
    Put trajectories into frames; each row is at least one frame after the row before.

    Times are often rounded to hundredths of a second, so that frames may seem to share one.
    """
    path = file.path
    check_names(path, tracks)
    names = [track.name or f'track {k}' for k, track in enumerate(tracks, start=1)]
    names = [
        name if len(track.places[0]) == 2 else f'{name}.{point}'
        for name, track in zip(names, tracks, strict=True)
        for point in range(1, 1 + len(track.places[0]) // 2)
    ]
    names = number_names(path, names, file.notes)
    times = [np.array([_seconds(time) for time in track.times]) for track in tracks]
    steps = np.concatenate([np.diff(row) for row in times])
    if not (np.isfinite(np.concatenate(times)).all() and steps.min(initial=0.0) >= 0):
        raise BagError(f'{path}: its times are none, or not in order; fix: {_FIX}')
    start = min(row[0] for row in times)
    step = float(np.median(steps[steps > 0])) if steps.any() else 1.0
    interval = float(steps.sum() / max(1.0, np.rint(steps / step).sum())) or step
    if max(row[-1] for row in times) - start > interval * MOST_CELLS:
        raise BagError(f'{path}: its times are too far apart; fix: {_FIX}')
    numbers = [
        np.rint((row[0] - start) / interval)
        + np.concatenate(([0], np.maximum(1, np.rint(np.diff(row) / step)).cumsum()))
        for row in times
    ]
    frames = np.unique(np.concatenate(numbers)).astype(np.int64)
    check_cells(path, 3 * len(frames) * len(names))
    points = np.full((len(frames), len(names), 3), np.nan)
    instants = start + frames * interval
    is_rounded = any(':' in time for track in tracks for time in track.times)
    done = 0
    for track, row, instant in zip(tracks, numbers, times, strict=True):
        rows = np.searchsorted(frames, row)
        places = np.array(track.places).reshape(len(rows), -1, 2)
        columns = range(done, done := done + places.shape[1])
        points[rows[:, None], columns, :2] = places
        points[rows[:, None], columns, 2] = 0.0
        if not is_rounded:
            instants[rows] = instant
    why = '' if is_rounded else _unknown_unit(step, instants)
    if wanted.rate is None and is_rounded:
        file.notes.append(
            f'{path} has times in hundredths of a second: frames are taken to come every '
            f'{interval:.4g} s, {1 / interval:.4g} Hz; fix: give --rate HZ if the video has another'
        )
    is_known = wanted.rate is None and not why
    return Points(names, points, frames, instants if is_known else None, unit, no_times=why)


FORMAT = Format(
    'kinovea',
    'Kinovea: trajectories as .csv, .txt or .xml, and angles as .csv',
    '"Time","Tip/0/X","Tip/0/Y"\n"0.04","12.5","3.1"',
    _recognizes,
    _read,
)
