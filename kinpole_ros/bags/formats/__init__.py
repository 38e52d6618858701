"""
Files of trackers, as their programs write them, to one plain record.

A module a format: it says how the format is recognized and read, in a `FORMAT` of `_file.py`. A new
one is a module like the others and its line below.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats import (
    _bag,
    _c3d,
    _deeplabcut,
    _keypoints,
    _kinovea,
    _motive,
    _plain,
    _qualisys,
    _sleap,
    _tracker,
    _trc,
    _vicon,
)
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted, not_utf8
from kinpole_ros.bags.formats._sheet import shown

__all__ = ['FORMATS', 'Points', 'Wanted', 'read_points', 'shown']

# Looked at in this order: the plain table is the least particular.
FORMATS: dict[str, Format] = {
    found.name: found
    for found in (
        _bag.FORMAT,
        _sleap.FORMAT,
        _deeplabcut.FORMAT,
        _kinovea.FORMAT,
        _tracker.FORMAT,
        _motive.FORMAT,
        _vicon.FORMAT,
        _qualisys.FORMAT,
        _trc.FORMAT,
        _c3d.FORMAT,
        _keypoints.FORMAT,
        _plain.ANIPOSE,
        _plain.FORMAT,
    )
}


def read_points(
    path: str | Path, name: str = 'auto', wanted: Wanted | None = None
) -> tuple[str, Points]:
    """
    Read the points of a file, and the name of its format: `name`, or the one that is recognized.

    Raises BagError when the format is unknown, or the file is not as its program writes it.
    """
    if name != 'auto' and name not in FORMATS:
        raise BagError(f"format '{shown(name)}' is unknown; fix: auto, {', '.join(FORMATS)}")
    file = File(Path(path))
    if not (file.is_folder or file.head.strip() or file.data.strip()):
        raise BagError(f'{path} is empty; fix: give a line of names and a line for each frame')
    for found in FORMATS.values() if name == 'auto' else [FORMATS[name]]:
        if found.recognizes(file):
            if file.is_sheet:
                file.sheet.judge_last_row(found.is_always_ended)
            # Damaged numbers may be any, and what is not finite was not seen.
            with np.errstate(invalid='ignore', over='ignore'):
                points = found.read(file, wanted or Wanted())
            if not len(points.frames):
                raise BagError(f'{path} has no frames; fix: give a line for each frame')
            return found.name, replace(points, notes=tuple(file.notes))
    raise _unknown(file, name)


def _unknown(file: File, name: str) -> BagError:
    """What was seen, and what would be read."""
    if file.head[:2] in (b'\xff\xfe', b'\xfe\xff'):
        return not_utf8(file.path, 1)
    if file.is_folder:
        seen = 'is a folder'
    elif file.is_sheet:
        lines = [' '.join(file.sheet.head(row)) for row in range(min(2, len(file.sheet)))]
        seen = f'begins with {" / ".join(repr(shown(line)) for line in lines)}'
    elif file.is_text:
        seen = f'begins with {shown(" ".join(file.head[:80].decode(errors="replace").split()))!r}'
    else:
        seen = f'is binary and begins with {file.head[:8].hex(" ")}'
    if name == 'auto':
        name = 'table'
        known = ', '.join(other for other in FORMATS if other != name)
        seen += f': of no format known here ({known}), and no column is named NAME_x'
    else:
        seen += f': not what {FORMATS[name].what} begins with'
    example = ' / '.join(FORMATS[name].example.replace('\t', ' ').split('\n'))
    return BagError(f'{file.path} {seen}; fix: give a file such as: {example}')
