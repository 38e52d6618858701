"""
Tracker of Open Source Physics, a program that tracks points in videos by hand.

Data files, of one track or of several, and project files (.trk). One track: a line with its name, a
line of columns, t, x, y among them. Several: the line #multi:, a line with each name above its
first column, then the columns. Lengths are in what the user calibrated, with y up; columns may say
the unit, as in "x (cm)". A project is XML: the positions of each track in the picture, in pixels
with y down, by number of the frame, with the origin, angle and scale of the user's axes, and the
time between frames.
"""

import math
import re
from xml.etree.ElementTree import Element

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats import _cells, _sheet
from kinpole_ros.bags.formats._file import File, Format, Options, Points

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
                f"{line}: '{_cells.shown(name)}' has {match['name']} twice; fix: {_EXPORT_TRACKS}"
            )
        units.add(match['unit'] or '')
    for name, columns in axes.items():
        if len(columns) < 2 or not name:
            raise BagError(f"{line}: '{_cells.shown(name)}' lacks x or y; fix: {_EXPORT_TRACKS}")
    if len(units) > 1:
        raise BagError(
            f'{line}: columns are in {_cells.shown(" and ".join(sorted(units)))}; '
            'fix: export all in one unit'
        )
    _cells.check_names(path, list(axes))
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
    names = _cells.number_names(file.path, names, file.notes)
    frames = np.array(sorted({number for track in tracks for number in track}), np.int64)
    _cells.check_cells(file.path, 3 * len(frames) * len(names))
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
        values = {e.get('name'): _cells.number_or_inf(e.text or '') for e in row.iter('property')}
        numbers = [values.get(key, default) for key, default in defaults.items()]
        is_finite = np.isfinite(numbers).tolist()
        unread = [key for key, finite in zip(defaults, is_finite, strict=True) if not finite]
        if not (index.isdecimal() and len(index) < 10):
            unread = ['number']
        if unread:
            raise BagError(
                f"{file.path}: frame '{_cells.shown(index)}' has no {' and no '.join(unread)}; "
                'fix: save it again'
            )
        if 0.0 in numbers[3:]:
            raise BagError(f'{file.path}: the scale is 0; fix: calibrate it in Tracker')
        numbers_by_frame[int(index)] = numbers
    return numbers_by_frame


def _first_number(root: Element, name: str) -> float:
    texts = (e.text or '' for e in root.iter('property') if e.get('name') == name)
    return next(map(_cells.number_or_inf, texts), 0.0)


TRACKER = Format(
    'tracker',
    'Tracker (Open Source Physics) data file, one track or several, or .trk',
    'mass_A\nt\tx\ty\n0.04\t1.25E-1\t2.5E-1',
    _is_tracker,
    _read_tracker,
)
