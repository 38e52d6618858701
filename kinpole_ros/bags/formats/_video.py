"""
Kinovea and Tracker, programs that track points in videos by hand.

Kinovea: trajectories and angles as CSV, and trajectories as text (gnuplot) or for Excel (.xml). CSV
has columns Time, then OBJECT/POINT/X and OBJECT/POINT/Y, or an angle each; cells are in quotes, and
decimals and separators are those of the computer. Text and XML have the rows of one trajectory
after those of another. Lengths are in what the user calibrated, with y up; only XML says in what.
Times are what the user chose for the screen: seconds, rounded to milliseconds, by default, and in
older versions h:mm:ss:cc.

Tracker, of Open Source Physics: data files, of one track or of several, and project files (.trk).
One track: a line with its name, a line of columns, t, x, y among them. Several: the line #multi:, a
line with each name above its first column, then the columns. Lengths are in what the user
calibrated, with y up; columns may say the unit, as in "x (cm)". A project is XML: the positions of
each track in the picture, in pixels with y down, by number of the frame, with the origin, angle and
scale of the user's axes, and the time between frames.
"""

import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats import _sheet
from kinpole_ros.bags.formats._file import File, Format, Options, Points

# Kinovea

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
    _sheet.check_names(sheet.path, list(columns))
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
                    f'{sheet.path}: {_sheet.shown(title)} has no Y behind it; fix: {_EXPORT_AGAIN}'
                )
            if match[1] in columns:
                raise BagError(
                    f"{sheet.path}: '{_sheet.shown(match[1])}' is there twice; "
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
    numbers = [_sheet.number_or_inf(cell.replace(',', '.')) for cell in cells[1:]]
    if (
        not numbers
        or len(numbers) % 2
        or not np.isfinite(numbers).all()
        or (trajectory.positions and len(numbers) != len(trajectory.positions[0]))
    ):
        raise BagError(
            f"{file.path}, {where}: '{_sheet.shown(' '.join(cells))}' is not t, x and y; "
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
        total = 60 * total + _sheet.number_or_inf(text)
    return total


def _points_of_trajectories(
    file: File, trajectories: Sequence[_Trajectory], unit: str, options: Options
) -> Points:
    """
    Put trajectories into frames; each row is at least one frame after the row before.

    Times are often rounded to hundredths of a second, so that frames may seem to share one.
    """
    path = file.path
    _sheet.check_names(path, trajectories)
    names = []
    for k, one in enumerate(trajectories, start=1):
        name, count = one.name or f'track {k}', len(one.positions[0]) // 2
        names += [name] if count == 1 else [f'{name}.{point}' for point in range(1, 1 + count)]
    names = _sheet.number_names(path, names, file.notes)
    times = [np.array([_seconds(time) for time in one.times]) for one in trajectories]
    steps = np.concatenate([np.diff(row) for row in times])
    if not (np.isfinite(np.concatenate(times)).all() and steps.min(initial=0.0) >= 0):
        raise BagError(f'{path}: its times are none, or not in order; fix: {_EXPORT_AGAIN}')
    start = min(row[0] for row in times)
    step = float(np.median(steps[steps > 0])) if steps.any() else 1.0
    interval = float(steps.sum() / max(1.0, np.rint(steps / step).sum())) or step
    if max(row[-1] for row in times) - start > interval * _sheet.MOST_CELLS:
        raise BagError(f'{path}: its times are too far from each other; fix: {_EXPORT_AGAIN}')
    numbers = [
        np.rint((row[0] - start) / interval)
        + np.concatenate(([0], np.maximum(1, np.rint(np.diff(row) / step)).cumsum()))
        for row in times
    ]
    frames = np.unique(np.concatenate(numbers)).astype(np.int64)
    _sheet.check_cells(path, 3 * len(frames) * len(names))
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

# Tracker

_TITLE = re.compile(r'(?P<name>t|x|y|frame|step)(?:_\{.*\})?\s*(?:[(\[](?P<unit>[^)\]]*)[)\]])?')
_MULTI = '#multi:'
_PROJECT = b'org.opensourcephysics.cabrillo.tracker.TrackerPanel'
_EXPORT_TRACKS = 'export t, x and y of each track'


def _is_tracker(file: File) -> bool:
    return _PROJECT in file.head or (file.is_sheet and _titles_row(file.sheet) is not None)


def _titles_row(sheet: _sheet.Sheet) -> int | None:
    """Return the row with the titles of columns, if this is such a file."""
    row = 2 if sheet.cell(0, 0) == _MULTI else 1
    titles = {match['name'] for cell in sheet.row(row) if (match := _TITLE.fullmatch(cell))}
    has_name = sum(bool(cell) for cell in sheet.row(0)) == 1
    return row if has_name and {'t', 'x', 'y'} <= titles else None


def _read_tracker(file: File, options: Options) -> Points:
    if _PROJECT in file.head:
        return _read_project(file)
    sheet, path = file.sheet, file.path
    row = _titles_row(sheet)
    if row is None:
        raise BagError(f'{path} is no data file of Tracker; fix: {_EXPORT_TRACKS}')
    line = f'{path}, line {sheet.lines[row]}'
    titles = [_TITLE.fullmatch(cell) for cell in sheet.row(row)]
    axes: dict[str, dict[str, int]] = {}
    units = set()
    name = sheet.cell(0, 0) if row == 1 else ''
    for column, match in enumerate(titles):
        if row == 2:
            name = sheet.cell(1, column) or name
        if match is None or match['name'] not in ('x', 'y'):
            continue
        if axes.setdefault(name, {}).setdefault(match['name'], column) != column:
            raise BagError(
                f"{line}: '{_sheet.shown(name)}' has {match['name']} twice; fix: {_EXPORT_TRACKS}"
            )
        units.add(match['unit'] or '')
    for name, columns in axes.items():
        if len(columns) < 2 or not name:
            raise BagError(f"{line}: '{_sheet.shown(name)}' lacks x or y; fix: {_EXPORT_TRACKS}")
    if len(units) > 1:
        raise BagError(
            f'{line}: columns are in {_sheet.shown(" and ".join(sorted(units)))}; '
            'fix: export all in one unit'
        )
    _sheet.check_names(path, list(axes))
    number = None
    if options.rate is None:
        number = [match['name'] if match else '' for match in titles].index('t'), 't'
    xy = {name: [columns['x'], columns['y']] for name, columns in axes.items()}
    points, numbers = sheet.points(xy, row + 1, number=number)
    return Points(
        list(axes),
        points,
        np.arange(len(points)),
        None if number is None else numbers,
        units.pop(),
        lines=sheet.lines[row + 1 :],
        time_column='t',
    )


def _read_project(file: File) -> Points:
    """Read the tracks of a .trk in the user's axes."""
    root = file.xml('fix: save it again')
    names: list[str] = []
    tracks: list[dict[int, list[float]]] = []
    for item in _objects(root, '.PointMass'):
        name = next((e.text for e in item if e.get('name') == 'name'), None)
        if track := _numbers_by_frame(file, item, {'x': math.nan, 'y': math.nan}):
            names.append(name or f'track {len(tracks) + 1}')
            tracks.append(track)
    names = _sheet.number_names(file.path, names, file.notes)
    frames = np.array(sorted({number for track in tracks for number in track}), np.int64)
    _sheet.check_cells(file.path, 3 * len(frames) * len(names))
    points = np.full((len(frames), len(names), 3), np.nan)
    for k, track in enumerate(tracks):
        rows = np.searchsorted(frames, list(track))
        points[rows, k, :2] = list(track.values())
        points[rows, k, 2] = 0.0
    system = next(iter(_objects(root, '.ImageCoordSystem')), None)
    defaults = {'xorigin': 0.0, 'yorigin': 0.0, 'angle': 0.0, 'xscale': 1.0, 'yscale': 1.0}
    axes = {} if system is None else _numbers_by_frame(file, system, defaults)
    # The axes of a frame are those of the following frames, the first ones also of earlier frames.
    starts = [0, *np.searchsorted(frames, sorted(axes)[1:]).tolist(), len(frames)]
    for first, end, number in zip(starts, starts[1:], sorted(axes), strict=False):
        x0, y0, angle, x_scale, y_scale = axes[number]
        x, y = points[first:end, :, 0] - x0, y0 - points[first:end, :, 1]
        cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        points[first:end, :, 0] = (cosine * x + sine * y) / x_scale
        points[first:end, :, 1] = (cosine * y - sine * x) / y_scale
    step = _first_number(root, 'delta_t')
    start = _first_number(root, 'starttime') - _first_number(root, 'startframe') * step
    has_times = 0 < step < math.inf and math.isfinite(start)
    times = (start + frames * step) / 1e3 if has_times else None
    is_scaled = any(row[3:] != [1.0, 1.0] for row in axes.values())
    unit = next((e.text for e in root if e.get('name') == 'length_unit'), None) or 'm'
    return Points(names, points, frames, times, unit if is_scaled else 'px', y_down=not axes)


def _objects(root: Element, ending: str) -> list[Element]:
    return [item for item in root.iter('object') if item.get('class', '').endswith(ending)]


def _numbers_by_frame(
    file: File, item: Element, defaults: dict[str, float]
) -> dict[int, list[float]]:
    """Read the named numbers of each frame, from the framedata of an object."""
    numbers_by_frame = {}
    for row in (row for data in item if data.get('name') == 'framedata' for row in data):
        index = row.get('name', '')[1:-1]
        values = {e.get('name'): _sheet.number_or_inf(e.text or '') for e in row.iter('property')}
        numbers = [values.get(key, default) for key, default in defaults.items()]
        if not (index.isdecimal() and len(index) < 10 and np.isfinite(numbers).all()):
            raise BagError(
                f"{file.path}: frame '{_sheet.shown(index)}' has no {next(iter(defaults))}; "
                'fix: save it again'
            )
        if 0.0 in numbers[3:]:
            raise BagError(f'{file.path}: the scale is 0; fix: calibrate it in Tracker')
        numbers_by_frame[int(index)] = numbers
    return numbers_by_frame


def _first_number(root: Element, name: str) -> float:
    texts = (e.text or '' for e in root.iter('property') if e.get('name') == name)
    return next(map(_sheet.number_or_inf, texts), 0.0)


TRACKER = Format(
    'tracker',
    'Tracker (Open Source Physics) data file, one track or several, or .trk',
    'mass_A\nt\tx\ty\n0.04\t1.25E-1\t2.5E-1',
    _is_tracker,
    _read_tracker,
)
