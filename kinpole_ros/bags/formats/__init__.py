"""
Files of trackers, as their programs write them, read into `Points`.

A `Format` in the module of its kind of program says how it is recognized and read. A new one needs
a line in the table below.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._bag import BAG
from kinpole_ros.bags.formats._c3d import C3D
from kinpole_ros.bags.formats._cells import listed, shown
from kinpole_ros.bags.formats._deeplabcut import DEEPLABCUT
from kinpole_ros.bags.formats._file import (
    UNITS,
    File,
    Format,
    Options,
    Points,
    not_utf8,
    without_stand_ins,
)
from kinpole_ros.bags.formats._keypoints import KEYPOINTS
from kinpole_ros.bags.formats._kinovea import KINOVEA
from kinpole_ros.bags.formats._motion_capture import MOTIVE, TRC, VICON
from kinpole_ros.bags.formats._named_arrays import MOVEMENT, NWB
from kinpole_ros.bags.formats._open_source_physics import TRACKER
from kinpole_ros.bags.formats._preamble import PIXELS, read_preamble
from kinpole_ros.bags.formats._qualisys import QUALISYS
from kinpole_ros.bags.formats._shares import SHARES, in_unit_square
from kinpole_ros.bags.formats._sleap import SLEAP
from kinpole_ros.bags.formats._table import ANIPOSE, TABLE

__all__ = [
    'FORMATS',
    'SHARES',
    'UNITS',
    'Options',
    'Points',
    'listed',
    'read_points',
    'shown',
]

# Tried in this order: the plain table is the least particular.
FORMATS: dict[str, Format] = {
    format.name: format
    for format in (
        BAG,
        SLEAP,
        MOVEMENT,
        NWB,
        DEEPLABCUT,
        KINOVEA,
        TRACKER,
        MOTIVE,
        VICON,
        QUALISYS,
        TRC,
        C3D,
        KEYPOINTS,
        ANIPOSE,
        TABLE,
    )
}


def read_points(
    path: str | Path, name: str = 'auto', options: Options | None = None
) -> tuple[str, Points]:
    """
    Read the points of a file, or of a folder of OpenPose or rosbag2.

    Returns the key of its format in `FORMATS`, which is found where `name` is 'auto', and the
    points. Raises BagError if the format is unknown, or the file is not as its program writes it.
    """
    if name != 'auto' and name not in FORMATS:
        raise BagError(f"format '{shown(name)}' is unknown; fix: auto, {', '.join(FORMATS)}")
    file, given = File(Path(path)), options or Options()
    if not (file.is_folder or file.head.strip() or file.data.strip()):
        raise BagError(f'{path} is empty; fix: give a line of names and a line for each frame')
    for candidate in FORMATS.values() if name == 'auto' else [FORMATS[name]]:
        if candidate.recognizes(file):
            if given.likelihood is not None and not candidate.has_likelihood:
                raise BagError(f'{path} ({candidate.name}) has no likelihoods; fix: leave that out')
            if file.is_sheet:
                file.sheet.check_last_number(candidate.is_always_ended)
            # Damaged numbers may be any; those that are not finite count as not seen.
            with np.errstate(invalid='ignore', over='ignore'):
                points = candidate.read(file, given)
                if file.counts_left_out_row(len(points.frames)):
                    file.sheet.restore_last_row()
                    points = candidate.read(file, given)
            if not len(points.frames):
                raise BagError(f'{path} has no frames; fix: give a line for each frame')
            file.notes += _blank_stand_ins(path, points)
            if points.unit.lower() in PIXELS and in_unit_square(points.points):
                points = replace(points, unit=SHARES)
            return candidate.name, replace(points, notes=tuple(file.notes))
    raise _unrecognized(file, name)


def _blank_stand_ins(path: str | Path, read: Points) -> list[str]:
    """Blank points that stand for none, in place; return a note on them."""
    unseen = without_stand_ins(read.points)
    read.points[unseen] = np.nan
    if not unseen.any():
        return []
    counts = zip(read.names, unseen.sum(axis=0).tolist(), strict=True)
    places = [f'{shown(name)} in {count} frames' for name, count in counts if count]
    return [
        f'{path}: points of one number, such as (0, 0, 0), and far from all others of their marker '
        f'count as not seen: {listed(places)}'
    ]


def _unrecognized(file: File, name: str) -> BagError:
    """Return an error that says how the file begins, and how it should."""
    if file.head[:2] in (b'\xff\xfe', b'\xfe\xff'):
        return not_utf8(file.path, 1)
    if file.is_folder:
        text = 'is a folder'
    elif file.is_sheet and name in ('auto', 'table') and (row := read_preamble(file.sheet).row):
        return BagError(
            f'{file.path} names its columns in line {file.sheet.lines[row]}; fix: delete the lines '
            'before it, and give the unit and the rate that they say, if any, by --scale and --rate'
        )
    elif file.is_sheet:
        lines = [' '.join(file.sheet.row(row)) for row in range(min(2, len(file.sheet)))]
        text = f'begins with {" / ".join(repr(shown(line)) for line in lines)}'
    elif file.is_text:
        text = f'begins with {shown(" ".join(file.head[:80].decode(errors="replace").split()))!r}'
    else:
        text = f'is binary and begins with {file.head[:8].hex(" ")}'
    if name == 'auto':
        name = 'table'
        names = ', '.join(key for key in FORMATS if key != name)
        text += f': of no format known here ({names}), and no column is named NAME_x'
    else:
        text += f': not what {FORMATS[name].what} begins with'
    example = ' / '.join(FORMATS[name].example.replace('\t', ' ').split('\n'))
    return BagError(f'{file.path} {text}; fix: give a file such as: {example}')
