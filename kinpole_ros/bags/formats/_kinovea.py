"""
Kinovea: trajectories exported to a spreadsheet as CSV.

Columns Time, then OBJECT/POINT/X and OBJECT/POINT/Y; cells are in quotes, and decimals and
separators are those of the computer. Lengths are in what the user calibrated, with y up, which the
file does not say. Nor does it say the unit of Time, which is what the user chose for the screen:
seconds, rounded to milliseconds, by default.
"""

import re

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted
from kinpole_ros.bags.formats._sheet import check_names, shown

_X = re.compile(r'(.+)/X', re.IGNORECASE)


def _recognizes(file: File) -> bool:
    if not file.is_text:
        return False
    header = file.sheet.head(0)
    return header[:1] == ['Time'] and any(_X.fullmatch(cell) for cell in header)


def _read(file: File, wanted: Wanted) -> Points:
    sheet, path = file.sheet, file.path
    header = sheet.head(0)
    columns: dict[str, list[int]] = {}
    for column, title in enumerate(header[:-1]):
        if match := _X.fullmatch(title):
            if header[column + 1].lower() != f'{match[1]}/y'.lower():
                raise BagError(f'{path}: {shown(title)} has no Y behind it; fix: export it again')
            if match[1] in columns:
                raise BagError(
                    f"{path}: '{shown(match[1])}' is there twice; fix: rename one in Kinovea"
                )
            columns[match[1]] = [column, column + 1]
    # A trajectory has one point, and its key says nothing.
    objects = [name.rpartition('/')[0] or name for name in columns]
    names = [
        thing if objects.count(thing) == 1 else name.replace('/', '.')
        for name, thing in zip(columns, objects, strict=True)
    ]
    check_names(path, names)
    points, numbers = sheet.points(list(columns.values()), names, 1, also=(0, 'Time'))
    steps = np.diff(numbers)
    step = float(steps.min(initial=np.inf))
    lines = sheet.lines[1:]
    if not step > 0:
        row = int(np.argmin(steps > 0)) + 1
        raise BagError(
            f'{path}, line {lines[row]}: Time does not go on from the line before; fix: export it '
            'again'
        )
    if wanted.rate is not None:
        # Frames in which nothing was tracked have no line.
        frames = np.concatenate(([0], np.rint(steps / step).cumsum())).astype(np.int64)
        return Points(names, points, frames, None, '', lines=lines)
    in_ms = np.abs(numbers * 1e3 - np.rint(numbers * 1e3)).max(initial=0.0) < 1e-2
    if not (step < 1 and in_ms):
        raise BagError(
            f'{path}: Time goes on by {step:.6g} from line to line, frames or milliseconds: '
            'Kinovea writes what its screen shows; fix: give --rate HZ, or export with times as '
            '[h:][mm:]ss.xx'
        )
    frames = np.arange(len(numbers))
    return Points(names, points, frames, numbers, '', lines=lines)


FORMAT = Format(
    'kinovea',
    'Kinovea trajectories as .csv',
    '"Time","Tip/0/X","Tip/0/Y"\n"0.04","12.5","3.1"',
    _recognizes,
    _read,
)
