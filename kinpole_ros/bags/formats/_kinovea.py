"""
Kinovea, a program that tracks points in videos by hand.

Trajectories and angles as CSV, and trajectories as text (gnuplot) or for Excel (.xml). CSV has
columns Time, then OBJECT/POINT/X and OBJECT/POINT/Y, or an angle each; cells are in quotes, and
decimals and separators are those of the computer. Text and XML have the rows of one trajectory
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
from kinpole_ros.bags.formats import _cells, _sheet
from kinpole_ros.bags.formats._file import File, Format, Options, Points

# Headings are in the language of Kinovea, but a time has a unit.
_TIME = re.compile(r'(?:Time|[^\W\d_]+(?=\s*\())(?:\s*\((?P<unit>m?s)\))?', re.IGNORECASE)
_X = re.compile(r'(.+)/X', re.IGNORECASE)
_ANGLE = re.compile(
    r'.*(?:\b(?:angle|[áâa]ngulo|angolo|unghi|winkel|hoek|vinkel|kulma|kąt|úhel|uhol|szög|kut|kampas|'
    r'nurk|açı|угол|кут|ъгъл|γωνία|sudut|góc)\b|角|각도|มุม|زاوية).*',
    re.IGNORECASE,
)
_TEXT = b'#Kinovea Trajectory'
_EXCEL = b'urn:schemas-microsoft-com:office:spreadsheet'
_COORDINATES = re.compile(r'Coords \(x,\s*y:\s*(?P<unit>[^;]*);.*')
_EXPORT_AGAIN = 'export it again'


class _Trajectory(NamedTuple):
    """A trajectory of P points: the rows of text or XML."""

    name: str
    times: list[str]
    positions: list[list[float]]  # 2 P numbers each


def _is_kinovea(file: File) -> bool:
    if _TEXT in file.head or _EXCEL in file.head:
        return True
    if not file.is_sheet:
        return False
    time, *titles = file.sheet.row(0) or ['']
    titles = [title for title in titles if title]
    are_angles = bool(titles) and all(map(_ANGLE.fullmatch, titles))
    return bool(_TIME.fullmatch(time)) and (are_angles or any(map(_X.fullmatch, titles)))


def _read_kinovea(file: File, options: Options) -> Points:
    if _EXCEL in file.head:
        return _points_of_trajectories(file, *_excel_trajectories(file), options)
    if _TEXT in file.head:
        return _points_of_trajectories(file, list(_text_trajectories(file)), '', options)
    sheet = file.sheet
    header = sheet.row(0)
    angles = {name: column for column, name in enumerate(header) if _ANGLE.fullmatch(name)}
    columns = _kinovea_columns(sheet, header)
    if not columns and angles and _TIME.fullmatch(header[0]):
        return _read_angles(sheet, angles)
    # An object with one point is a trajectory, and the name of its point says nothing.
    objects = [name.rpartition('/')[0] or name for name in columns]
    columns = {
        thing if objects.count(thing) == 1 else name.replace('/', '.'): axes
        for thing, (name, axes) in zip(objects, columns.items(), strict=True)
    }
    _cells.check_names(sheet.path, list(columns))
    points, numbers = sheet.points(columns, 1, number=(0, 'Time'))
    frames, times, fault = _clock(sheet, numbers)
    lines = sheet.lines[1:]
    return Points(list(columns), points, frames, times, '', lines=lines, no_times=fault)


def _kinovea_columns(sheet: _sheet.Sheet, header: Sequence[str]) -> dict[str, list[int]]:
    """Find columns X and Y by OBJECT/POINT."""
    columns: dict[str, list[int]] = {}
    for column, title in enumerate(header[:-1]):
        if match := _X.fullmatch(title):
            if header[column + 1].lower() != f'{match[1]}/y'.lower():
                raise BagError(
                    f'{sheet.path}: {_cells.shown(title)} has no Y behind it; fix: {_EXPORT_AGAIN}'
                )
            if match[1] in columns:
                raise BagError(
                    f"{sheet.path}: '{_cells.shown(match[1])}' is there twice; "
                    'fix: rename one in Kinovea'
                )
            columns[match[1]] = [column, column + 1]
    return columns


def _read_angles(sheet: _sheet.Sheet, angles: dict[str, int]) -> Points:
    """Make a body at the origin of each angle, which is in degrees unless its name says rad."""
    frames, times, fault = _clock(sheet, sheet.column(0, 1, 'Time'))
    poses = np.zeros((len(frames), len(angles), 7))
    for k, (name, column) in enumerate(angles.items()):
        half = sheet.column(column, 1, name) / 2
        if '(rad' not in name.lower():
            half = np.radians(half)
        poses[:, k, 5], poses[:, k, 6] = np.sin(half), np.cos(half)
    poses[np.isnan(poses).any(axis=-1)] = np.nan
    return Points(
        list(angles),
        poses[..., :3].copy(),
        frames,
        times,
        'm',
        lines=sheet.lines[1:],
        no_times=fault,
        bodies=list(angles),
        poses=poses,
    )


def _clock(sheet: _sheet.Sheet, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray | None, str]:
    """Return numbers of frames and their times, s, or why there are none, from the column Time."""
    steps = np.diff(numbers)
    step = float(steps.min(initial=np.inf))
    if not step > 0:
        row = int(np.argmin(steps > 0)) + 1
        raise BagError(
            f'{sheet.path}, line {sheet.lines[1:][row]}: Time does not go on from the line before; '
            f'fix: {_EXPORT_AGAIN}'
        )
    # Frames in which nothing was tracked have no line.
    frames = np.concatenate(([0], np.rint(steps / step).cumsum())).astype(np.int64)
    frames = frames[: len(numbers)]
    unit = (_TIME.fullmatch(sheet.cell(0, 0)) or {'unit': None})['unit']
    if unit:
        return frames, numbers * (1e-3 if unit.lower() == 'ms' else 1.0), ''
    fault = _unit_fault(step, numbers)
    return frames, None if fault else numbers, fault


def _unit_fault(step: float, times: np.ndarray) -> str:
    """Say why times with this step are not in seconds, rounded to milliseconds; '' if they are."""
    if step < 1 and np.abs(times * 1e3 - np.rint(times * 1e3)).max(initial=0.0) < 1e-2:
        return ''
    return (
        f'has times that go on by {step:.6g} from line to line, frames or milliseconds, as Kinovea '
        'writes what its screen shows'
    )


def _text_trajectories(file: File) -> Iterator[_Trajectory]:
    """Yield the trajectories of a text: empty lines between them, and maybe # NAME above them."""
    trajectory = _Trajectory('', [], [])
    lines = file.data.decode('utf-8-sig', 'replace').splitlines()
    for number, line in enumerate([*lines, ''], start=1):
        if line.strip() and not line.startswith('#'):
            _append_row(file, trajectory, line.split(), f'line {number}')
            continue
        if trajectory.times:
            yield trajectory
            trajectory = _Trajectory('', [], [])
        if line.startswith('#') and number > 2:
            trajectory = _Trajectory(line.strip('# '), [], [])


def _excel_trajectories(file: File) -> tuple[list[_Trajectory], str]:
    """Read the trajectories of an .xml, and their unit."""
    space = f'{{{_EXCEL.decode()}}}'
    name, units = '', {''}
    trajectory = None
    trajectories: list[_Trajectory] = []
    for number, row in enumerate(file.xml(f'fix: {_EXPORT_AGAIN}').iter(f'{space}Row'), start=1):
        cells = [(cell.text or '').strip() for cell in row.iter(f'{space}Data')]
        if cells == ['x', 'y', 't']:
            trajectory = _Trajectory(name, [], [])
            trajectories.append(trajectory)
        elif trajectory is not None and len(cells) == 3:
            _append_row(file, trajectory, [cells[2], *cells[:2]], f'row {number}')
        else:
            trajectory = None
            if len(cells) == 2 and cells[0].startswith('Label'):
                name = cells[1]
            elif match := _COORDINATES.fullmatch(' '.join(cells)):
                units.add(match['unit'].strip())
    return [one for one in trajectories if one.times], max(units) if len(units) < 3 else ''


def _append_row(file: File, trajectory: _Trajectory, cells: list[str], where: str) -> None:
    """Append a row, of a time and positions, to a trajectory."""
    numbers = [_cells.number_or_inf(cell.replace(',', '.')) for cell in cells[1:]]
    if (
        not numbers
        or len(numbers) % 2
        or not np.isfinite(numbers).all()
        or (trajectory.positions and len(numbers) != len(trajectory.positions[0]))
    ):
        raise BagError(
            f"{file.path}, {where}: '{_cells.shown(' '.join(cells))}' is not t, x and y; "
            f'fix: {_EXPORT_AGAIN}'
        )
    trajectory.times.append(cells[0])
    trajectory.positions.append(numbers)


def _seconds(time: str) -> float:
    """Convert h:mm:ss:cc or [h:][mm:]ss.xx to seconds; infinity for what is neither."""
    fields = time.replace(',', '.').split(':')
    if len(fields) == 4:
        fields[2:] = [f'{fields[2]}.{fields[3]}']
    if len(fields) > 3:
        return math.inf
    total = 0.0
    for text in fields:
        total = 60 * total + _cells.number_or_inf(text)
    return total


def _points_of_trajectories(
    file: File, trajectories: Sequence[_Trajectory], unit: str, options: Options
) -> Points:
    """
    Put trajectories into frames; each row is at least one frame after the row before.

    Times are often rounded to hundredths of a second, so that frames may seem to share one.
    """
    path = file.path
    _cells.check_names(path, trajectories)
    names = []
    for k, one in enumerate(trajectories, start=1):
        name, count = one.name or f'track {k}', len(one.positions[0]) // 2
        names += [name] if count == 1 else [f'{name}.{point}' for point in range(1, 1 + count)]
    names = _cells.number_names(path, names, file.notes)
    times = [np.array([_seconds(time) for time in one.times]) for one in trajectories]
    steps = np.concatenate([np.diff(row) for row in times])
    if not (np.isfinite(np.concatenate(times)).all() and steps.min(initial=0.0) >= 0):
        raise BagError(f'{path}: its times are none, or not in order; fix: {_EXPORT_AGAIN}')
    start = min(row[0] for row in times)
    step = float(np.median(steps[steps > 0])) if steps.any() else 1.0
    interval = float(steps.sum() / max(1.0, np.rint(steps / step).sum())) or step
    if max(row[-1] for row in times) - start > interval * _cells.MOST_CELLS:
        raise BagError(f'{path}: its times are too far from each other; fix: {_EXPORT_AGAIN}')
    numbers = [
        np.rint((row[0] - start) / interval)
        + np.concatenate(([0], np.maximum(1, np.rint(np.diff(row) / step)).cumsum()))
        for row in times
    ]
    frames = np.unique(np.concatenate(numbers)).astype(np.int64)
    _cells.check_cells(path, 3 * len(frames) * len(names))
    points = np.full((len(frames), len(names), 3), np.nan)
    instants = start + frames * interval
    is_rounded = any(':' in time for one in trajectories for time in one.times)
    first = 0
    for one, row, row_times in zip(trajectories, numbers, times, strict=True):
        rows = np.searchsorted(frames, row)
        positions = np.array(one.positions).reshape(len(rows), -1, 2)
        columns = range(first, first := first + positions.shape[1])
        points[rows[:, None], columns, :2] = positions
        points[rows[:, None], columns, 2] = 0.0
        if not is_rounded:
            instants[rows] = row_times
    fault = '' if is_rounded else _unit_fault(step, instants)
    if options.rate is None and is_rounded:
        file.notes.append(
            f'{path} has times in hundredths of a second: frames are taken to come every '
            f'{interval:.4g} s, {1 / interval:.4g} Hz; fix: give --rate HZ if the video has another'
        )
    return Points(names, points, frames, None if fault else instants, unit, no_times=fault)


KINOVEA = Format(
    'kinovea',
    'Kinovea: trajectories as .csv, .txt or .xml, and angles as .csv',
    '"Time","Tip/0/X","Tip/0/Y"\n"0.04","12.5","3.1"',
    _is_kinovea,
    _read_kinovea,
)
