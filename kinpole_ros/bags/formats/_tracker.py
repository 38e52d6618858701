"""
Tracker, of Open Source Physics: data files, of one track or of several, and project files (.trk).

One track: a line with its name, a line of columns, t, x, y among them. Several: the line #multi:,
a line with each name above its first column, then the columns. Lengths are in what the user
calibrated, with y up; columns may say the unit, as in "x (cm)".

A project is XML: the places of each track in the picture, in pixels with y down, by number of the
frame, with the origin, angle and scale of the user's axes, and the time between frames.
"""

import math
import re
from collections.abc import Sequence
from xml.etree.ElementTree import Element

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted
from kinpole_ros.bags.formats._sheet import (
    Sheet,
    check_cells,
    check_names,
    number_names,
    number_or_inf,
    shown,
)

_TITLE = re.compile(r'(?P<name>t|x|y|frame|step)(?:_\{.*\})?\s*(?:[(\[](?P<unit>[^)\]]*)[)\]])?')
_MULTI = '#multi:'
_PROJECT = b'org.opensourcephysics.cabrillo.tracker.TrackerPanel'
_FIX = 'export t, x and y of each track'


def _recognizes(file: File) -> bool:
    return _PROJECT in file.head or (file.is_sheet and _titles_row(file.sheet) is not None)


def _titles_row(sheet: Sheet) -> int | None:
    """The row with the titles of columns, if this is such a file."""
    row = 2 if sheet.cell(0, 0) == _MULTI else 1
    titles = {match['name'] for cell in sheet.head(row) if (match := _TITLE.fullmatch(cell))}
    one_name = sum(bool(cell) for cell in sheet.head(0)) == 1
    return row if one_name and {'t', 'x', 'y'} <= titles else None


def _read(file: File, wanted: Wanted) -> Points:
    if _PROJECT in file.head:
        return _of_project(file, wanted)
    sheet, path = file.sheet, file.path
    row = _titles_row(sheet)
    if row is None:
        raise BagError(f'{path} is no data file of Tracker; fix: {_FIX}')
    titles = [_TITLE.fullmatch(cell) for cell in sheet.head(row)]
    columns: dict[str, dict[str, int]] = {}
    units = set()
    name = sheet.cell(0, 0) if row == 1 else ''
    for column, match in enumerate(titles):
        if row == 2:
            name = sheet.cell(1, column) or name
        if match is None or match['name'] not in ('x', 'y'):
            continue
        of_track = columns.setdefault(name, {})
        if match['name'] in of_track:
            raise BagError(
                f"{path}, line {sheet.lines[row]}: '{shown(name)}' has {match['name']} twice; "
                f'fix: {_FIX}'
            )
        of_track[match['name']] = column
        units.add(match['unit'] or '')
    for name, of_track in columns.items():
        if len(of_track) < 2 or not name:
            raise BagError(
                f"{path}, line {sheet.lines[row]}: '{shown(name)}' lacks x or y; fix: {_FIX}"
            )
    if len(units) > 1:
        raise BagError(
            f'{path}, line {sheet.lines[row]}: columns are in {shown(" and ".join(sorted(units)))};'
            ' fix: export all in one unit'
        )
    check_names(path, list(columns))
    first = row + 1
    kinds = [match['name'] if match else '' for match in titles]
    also = None if wanted.rate is not None else (kinds.index('t'), 't')
    places = [[c['x'], c['y']] for c in columns.values()]
    points, times = sheet.points(places, list(columns), first, also=also)
    return Points(
        list(columns),
        points,
        np.arange(len(points)),
        times if also else None,
        units.pop(),
        lines=sheet.lines[first:],
        time_column='t',
    )


def _of_project(file: File, wanted: Wanted) -> Points:
    """Read the tracks of a .trk in the user's axes."""
    root = file.xml('fix: save it again')
    tracks: list[tuple[str, dict[int, list[float]]]] = []
    for item in _objects(root, '.PointMass'):
        name = next((e.text for e in item if e.get('name') == 'name'), None)
        marks = _by_frame(file, item, ('x', 'y'), (math.nan, math.nan))
        if marks:
            tracks.append((name or f'track {len(tracks) + 1}', marks))
    names = number_names(file.path, [name for name, _ in tracks], file.notes)
    frames = np.array(sorted({number for _, marks in tracks for number in marks}), np.int64)
    check_cells(file.path, 3 * len(frames) * len(names))
    points = np.full((len(frames), len(names), 3), np.nan)
    for k, (_, marks) in enumerate(tracks):
        rows = np.searchsorted(frames, list(marks))
        points[rows, k, :2] = list(marks.values())
        points[rows, k, 2] = 0.0
    system = next(iter(_objects(root, '.ImageCoordSystem')), None)
    keys = ('xorigin', 'yorigin', 'angle', 'xscale', 'yscale')
    axes = {} if system is None else _by_frame(file, system, keys, (0.0, 0.0, 0.0, 1.0, 1.0))
    # The axes of a frame hold up to the next for which there are some, the first ones before, too.
    starts = [0, *np.searchsorted(frames, sorted(axes)[1:]).tolist(), len(frames)]
    for first, end, number in zip(starts, starts[1:], sorted(axes), strict=False):
        x0, y0, angle, x_scale, y_scale = axes[number]
        x, y = points[first:end, :, 0] - x0, y0 - points[first:end, :, 1]
        cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        points[first:end, :, 0] = (cosine * x + sine * y) / x_scale
        points[first:end, :, 1] = (cosine * y - sine * x) / y_scale
    step = _first_number(root, 'delta_t')
    start = _first_number(root, 'starttime') - _first_number(root, 'startframe') * step
    has_times = wanted.rate is None and 0 < step < math.inf and math.isfinite(start)
    times = (start + frames * step) / 1e3 if has_times else None
    is_scaled = any(row[3:] != [1.0, 1.0] for row in axes.values())
    unit = next((e.text for e in root if e.get('name') == 'length_unit'), None) or 'm'
    return Points(names, points, frames, times, unit if is_scaled else 'px', y_down=not axes)


def _objects(root: Element, ending: str) -> list[Element]:
    return [item for item in root.iter('object') if item.get('class', '').endswith(ending)]


def _by_frame(
    file: File, item: Element, keys: Sequence[str], default: Sequence[float]
) -> dict[int, list[float]]:
    """Read numbers by frame, from the framedata of an object."""
    found = {}
    for row in (row for data in item if data.get('name') == 'framedata' for row in data):
        index = row.get('name', '')[1:-1]
        values = {e.get('name'): number_or_inf(e.text or '') for e in row.iter('property')}
        numbers = [values.get(key, value) for key, value in zip(keys, default, strict=True)]
        if not (index.isdecimal() and len(index) < 10 and np.isfinite(numbers).all()):
            raise BagError(
                f"{file.path}: frame '{shown(index)}' has no {keys[0]}; fix: save it again"
            )
        if 0.0 in numbers[3:]:
            raise BagError(f'{file.path}: the scale is 0; fix: calibrate it in Tracker')
        found[int(index)] = numbers
    return found


def _first_number(root: Element, name: str) -> float:
    found = (number_or_inf(e.text or '') for e in root.iter('property') if e.get('name') == name)
    return next(found, 0.0)


FORMAT = Format(
    'tracker',
    'Tracker (Open Source Physics) data file, one track or several, or .trk',
    'mass_A\nt\tx\ty\n0.04\t1.25E-1\t2.5E-1',
    _recognizes,
    _read,
)
