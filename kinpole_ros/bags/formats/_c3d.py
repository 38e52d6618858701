"""
C3D (c3d.org): the binary format of motion capture.

A header block, a section of parameters, then frames: for each point x, y, z and a residual, and the
analog samples. Integers and floats are in the formats of Intel, DEC or MIPS processors. Units, rate
and names are parameters of the group POINT. A point with a negative residual was not seen. Models
keep angles, forces and the like among the points, and list their names.
"""

import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats import _file
from kinpole_ros.bags.formats._cells import check_cells, number_names

_BLOCK = 512
_INTEL, _DEC, _MIPS = 84, 85, 86  # how a file says which processor its numbers are of
# Parameters with the names of quantities that are stored as points.
_NO_POINTS = ('ANGLES', 'FORCES', 'MOMENTS', 'POWERS', 'SCALARS')
_OTHERS = ('ROTATION', 'ANALOG')  # groups of what a file may hold beside points
_FIX = 'fix: export it again'


class _Header(NamedTuple):
    """The words of the first block, and the order of bytes."""

    points: int
    analog: int  # samples of all channels in a frame
    first: int
    last: int
    scale: float
    start: int  # block at which frames begin
    rate: float


class _Parameter(NamedTuple):
    """A parameter as it lies in the file: type -1 is text, 1 bytes, 2 integers, 4 floats."""

    kind: int
    size: tuple[int, ...]
    data: bytes


def _recognizes(file: _file.File) -> bool:
    # The number of the block of parameters, then the key of the format.
    return not file.is_text and len(file.head) >= _BLOCK and file.head[1] == 0x50


def _read(file: _file.File, options: _file.Options) -> _file.Points:
    try:
        processor = file.data[_BLOCK * (file.data[0] - 1) + 3]
        header = _read_header(file.data, processor)
        parameters = _read_parameters(file.data, processor)
    except (struct.error, IndexError, ValueError) as error:
        raise BagError(f'{file.path} is not a C3D file that can be read; {_FIX}') from error

    def numbers(name: str) -> list[float]:
        parameter = parameters.get(name)
        return [] if parameter is None else _numbers(parameter, processor)

    scale = next(iter(numbers('POINT:SCALE')), header.scale)
    rate = next(iter(numbers('POINT:RATE')), 0.0) or header.rate
    first, count = _frame_range(file, header, numbers)
    used = int(next(iter(numbers('POINT:USED')), header.points))
    header = _with_point_count(file, header, used, scale, count)
    if not header.points:
        others = ' and '.join(name for name in _OTHERS if any(numbers(f'{name}:USED')))
        only = f', only {others.lower()} data, which are not read' if others else ''
        raise BagError(f'{file.path} has no points{only}; fix: export positions of markers, too')
    if header.rate > 0 and abs(rate / header.rate - 1.0) > _file.SAME_RATE:
        file.notes.append(
            f'{file.path} has {rate:.6g} Hz as its parameter and {header.rate:.6g} Hz in its '
            'header: the former is taken; fix: give --rate if it is wrong'
        )
    values = _read_frames(file, header, processor, scale, count)
    frames = first + np.arange(len(values))
    end, is_amid = _frames_before_zeros(values)
    if end < len(values):
        amid = 'amid ' if is_amid else ''
        file.notes.append(
            f'{file.path} is zeros from {amid}frame {frames[end]} on, as padding of a file is: '
            f'{len(values) - end} of its {len(values)} frames are left out; {_FIX} if it should '
            'have them'
        )
        values, frames = values[:end], frames[:end]
    labels = _read_labels(parameters, 'POINT:LABELS')[: header.points]
    labels += [''] * (header.points - len(labels))
    left_out = {
        name for what in _NO_POINTS for name in _read_labels(parameters, f'POINT:{what}') if name
    }
    indices = [index for index, label in enumerate(labels) if label not in left_out]
    names = [labels[index] or f'point {index + 1}' for index in indices]
    names = number_names(file.path, names, file.notes)
    points = values[:, indices, :3].astype(float) * (1.0 if scale < 0 else scale)
    points[values[:, indices, 3] < 0] = np.nan
    unit = next(iter(_read_labels(parameters, 'POINT:UNITS')), '')
    times = _file.frame_times(file, frames, rate)
    return _file.Points(names, points, frames, times, unit)


def _read_header(data: bytes, processor: int) -> _Header:
    """Read the first block."""
    order = '>' if processor == _MIPS else '<'
    points, analog, first, last = struct.unpack_from(f'{order}4H', data, 2)
    (start,) = struct.unpack_from(f'{order}H', data, 16)
    scale = float(_to_floats(data[12:16], processor)[0])
    rate = float(_to_floats(data[20:24], processor)[0])
    return _Header(points, analog, first, last, scale, start, rate)


def _read_parameters(data: bytes, processor: int) -> dict[str, _Parameter]:
    """Read the parameters by GROUP:NAME; raises where they are cut off."""
    order = '>' if processor == _MIPS else '<'
    offset = _BLOCK * (data[0] - 1) + 4
    groups: dict[int, str] = {}
    rows: list[tuple[int, str, _Parameter]] = []
    step = 1
    while step > 0 and data[offset]:
        length, number = struct.unpack_from('<bb', data, offset)
        body = offset + 2 + abs(length)
        name = _text(data[offset + 2 : body]).upper()
        (step,) = struct.unpack_from(f'{order}h', data, body)
        if number < 0:
            groups[-number] = name
        else:
            kind, dimensions = struct.unpack_from('<bB', data, body + 2)
            size = tuple(data[body + 4 : body + 4 + dimensions])
            start = body + 4 + dimensions
            count = abs(kind) * int(np.prod(size, dtype=float))
            rows.append((number, name, _Parameter(kind, size, data[start : start + count])))
        offset = body + step
    return {f'{groups.get(number, "")}:{name}': value for number, name, value in rows}


def _to_floats(data: bytes, processor: int) -> np.ndarray:
    """Convert bytes to float32."""
    if processor == _DEC:
        # The halves are exchanged, and the exponent is larger by 2.
        halves = np.frombuffer(data, '<u2').reshape(-1, 2)[:, ::-1]
        return np.ascontiguousarray(halves).view('<f4')[:, 0] / np.float32(4)
    return np.frombuffer(data, '>f4' if processor == _MIPS else '<f4')


def _numbers(parameter: _Parameter, processor: int) -> list[float]:
    data = parameter.data
    if parameter.kind == 4:
        values = _to_floats(data[: len(data) // 4 * 4], processor)
    elif parameter.kind == 2:
        values = np.frombuffer(data[: len(data) // 2 * 2], '>u2' if processor == _MIPS else '<u2')
    else:
        values = np.frombuffer(data, np.uint8)
    return [float(value) for value in values]


def _text(data: bytes) -> str:
    try:
        return data.decode().strip('\0 ')
    except UnicodeDecodeError:
        return data.decode('cp1252', 'replace').strip('\0 ')


def _read_labels(parameters: dict[str, _Parameter], parameter: str) -> list[str]:
    """Read a list of names, which goes on in NAME2, NAME3 where it has more than 255."""
    names: list[str] = []
    for number in ('', *map(str, range(2, 300))):
        labels = parameters.get(f'{parameter}{number}')
        if labels is None or labels.kind != -1 or not labels.size:
            break
        data, width = labels.data, max(1, labels.size[0])
        names += [_text(data[start : start + width]) for start in range(0, len(data), width)]
    return names


def _frame_range(
    file: _file.File, header: _Header, numbers: Callable[[str], list[float]]
) -> tuple[int, int]:
    """Return the first frame number and the number of frames; parameters hold large counts."""
    first, count = header.first, (header.last - header.first + 1) % 65536
    counts = [count, *numbers('POINT:FRAMES')[:1], *numbers('POINT:LONG_FRAMES')[:1]]
    start, end = numbers('TRIAL:ACTUAL_START_FIELD'), numbers('TRIAL:ACTUAL_END_FIELD')
    if len(start) == len(end) == 2:
        first = int(start[0] + 65536 * start[1])
        counts.append(end[0] + 65536 * end[1] - first + 1)
    # A count that does not fit in 16 bits is written as the largest that does.
    counts = [count for count in counts if count != 65535] or counts
    largest = int(max(count for count in counts if np.isfinite(count)))
    # A count that does not fit in 16 bits may be cut to them.
    for other in sorted({one for one in counts if one % 65536 != largest % 65536}):
        file.notes += _file.count_notes(file.path, f'{other:.0f}', largest)
    return first, largest


def _with_point_count(
    file: _file.File, header: _Header, used: int, scale: float, frames: int
) -> _Header:
    """Return the header with that count of points by which frames fill most of the file."""
    if used == header.points:
        return header
    length, size = len(file.data) - _BLOCK * (header.start - 1), 4 if scale < 0 else 2
    filled = {
        points: size * (4 * points + header.analog) * frames for points in (header.points, used)
    }
    points = max((n for n in filled if filled[n] <= length), key=filled.__getitem__, default=used)
    file.notes.append(
        f'{file.path} says that it has {used} points as its parameter, and {header.points} in its '
        f'header: {points} are taken, which fill the file'
    )
    return header._replace(points=points)


def _read_frames(
    file: _file.File, header: _Header, processor: int, scale: float, claimed: int
) -> np.ndarray:
    """Read the points (T, n, 4) of all frames as the file has them: x, y, z and a residual."""
    check_cells(file.path, 4 * header.points * claimed)
    data = file.data[_BLOCK * (header.start - 1) :] if header.start else b''
    size = 4 if scale < 0 else 2
    words = 4 * header.points + header.analog
    count = len(data) // (size * words) if words else 0
    if not count or claimed < 1:
        raise BagError(f'{file.path} has no frames; {_FIX}')
    if count < claimed:
        # The end of the last block is padding, which looks like frames.
        raise BagError(
            f'{file.path} says that it has {claimed} frames, and has {count} at most: it is '
            f'cut off; {_FIX}'
        )
    values: np.ndarray
    data = data[: size * words * claimed]
    if scale < 0:
        values = _to_floats(data, processor)
    else:
        values = np.frombuffer(data, '>i2' if processor == _MIPS else '<i2')
    return values.reshape(claimed, words)[:, : 4 * header.points].reshape(claimed, -1, 4)


def _frames_before_zeros(values: np.ndarray) -> tuple[int, bool]:
    """
    Return the number of frames (T, n, 4) before the zeros that pad the end of a file.

    The second result is whether the zeros begin amid the following frame. A marker that rests at
    the origin is zeros in the frame before that, too.
    """
    frames, points = values.any(axis=(1, 2)), values.any(axis=2)
    if not frames.any():
        return len(values), False
    end = len(values) - int(frames[::-1].argmax())
    first_zero = points.shape[1] - int(points[end - 1, ::-1].argmax())
    if end > 1 and points[end - 2, first_zero:].any():
        return end - 1, True
    return end, False


C3D = _file.Format('c3d', 'C3D', '(binary)', _recognizes, _read)
