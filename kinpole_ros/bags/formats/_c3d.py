"""
C3D (c3d.org): the binary format of motion capture, read by the package c3d.

Units, rate and names are parameters of the group POINT. A point with a negative residual was not
seen. Models keep angles, forces and the like among the points, and list their names.
"""

import io
import warnings
from typing import Any

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted, check_names, frame_times
from kinpole_ros.packages import install_command

# Parameters that name points which are none.
_NO_POINTS = ('ANGLES', 'FORCES', 'MOMENTS', 'POWERS', 'SCALARS')


def _recognizes(file: File) -> bool:
    # The number of the block of parameters, then the key of the format.
    return not file.is_text and len(file.data) >= 512 and file.data[1] == 0x50


def _read(file: File, wanted: Wanted) -> Points:
    try:
        import c3d
    except ImportError:
        raise BagError(
            f'{file.path} is C3D, which needs c3d; fix: {install_command("formats")}'
        ) from None
    try:
        with warnings.catch_warnings():
            # Of files without analog channels, among others.
            warnings.simplefilter('ignore')
            reader = c3d.Reader(io.BytesIO(file.data))
            rate = float(reader.point_rate)
            unit = reader.get('POINT:UNITS')
            unit_name = unit.string_value.strip('\0 ') if unit is not None else ''
            labels = _labels(reader, 'POINT:LABELS')
            left_out = {
                name for what in _NO_POINTS for name in _labels(reader, f'POINT:{what}') if name
            }
            claimed = int(reader.last_frame) - int(reader.first_frame) + 1
            numbers, rows = [], []
            for number, points, _ in reader.read_frames():
                numbers.append(number)
                rows.append(points[:, :4])
    except Exception as error:
        # c3d has no error of its own: what comes depends on the byte that is wrong.
        raise BagError(
            f'{file.path} is not a C3D file that can be read ({type(error).__name__}); '
            'fix: export it again'
        ) from error
    if not rows:
        raise BagError(f'{file.path} has no frames; fix: export it again')
    if len(rows) < claimed:
        # The end of the last block is padding, which looks like frames.
        raise BagError(
            f'{file.path} says that it has {claimed} frames, and has {len(rows)} at most: it is '
            'cut off; fix: export it again'
        )
    seen = np.array(rows, dtype=np.float64)
    whole, is_amid = _frames_before_zeros(seen)
    notes = []
    if whole < len(seen):
        amid = 'amid ' if is_amid else ''
        notes = [
            f'{file.path} is zeros from {amid}frame {numbers[whole]} on, as padding of a file is: '
            f'{len(seen) - whole} of its {len(seen)} frames are left out; fix: export it again if '
            'it should have them'
        ]
        seen, numbers = seen[:whole], numbers[:whole]
    seen[seen[..., 3] < 0] = np.nan
    names = [label or f'point {index + 1}' for index, label in enumerate(labels)]
    names += [f'point {index + 1}' for index in range(len(names), seen.shape[1])]
    kept = [index for index in range(seen.shape[1]) if names[index] not in left_out]
    names = [names[index] for index in kept]
    check_names(file.path, names)
    frames = np.array(numbers, dtype=np.int64)
    times = None if wanted.rate is not None else frame_times(frames, rate)
    return Points(names, seen[:, kept, :3], frames, times, unit_name, notes=notes)


def _frames_before_zeros(values: np.ndarray) -> tuple[int, bool]:
    """
    Count the frames (T, n, 4) before the zeros that a file is filled up with at its end.

    The zeros may begin amid the frame behind these, which the second result says. A marker that
    rests at the origin is zeros in the frame before that, too.
    """
    frames, points = values.any(axis=(1, 2)), values.any(axis=2)
    if not frames.any():
        return len(values), False
    whole = len(values) - int(frames[::-1].argmax())
    behind = points.shape[1] - int(points[whole - 1, ::-1].argmax())
    if whole > 1 and points[whole - 2, behind:].any():
        return whole - 1, True
    return whole, False


def _labels(reader: Any, parameter: str) -> list[str]:
    """A list of names, which goes on in NAME2, NAME3 where it has more than 255."""
    names: list[str] = []
    for number in ('', *map(str, range(2, 300))):
        values = reader.get(f'{parameter}{number}')
        if values is None or not values.dimensions:
            break
        names += [str(name).strip('\0 ') for name in np.atleast_1d(values.string_array)]
    return names


FORMAT = Format(
    'c3d',
    f'C3D ({install_command("formats")})',
    '(binary)',
    _recognizes,
    _read,
)
