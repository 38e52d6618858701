"""Points tracked in videos come as spreadsheets; a bag of them is input like any other."""

import csv
import math
import os
from collections.abc import Callable, Sequence
from io import StringIO
from pathlib import Path

import numpy as np

from kinpole_ros.bags._reader import BagError
from kinpole_ros.bags._writer import BagWriter
from kinpole_ros.messages import to_message

_SECOND = 1_000_000_000  # ns
_LONGEST = 2.0**31  # s; the seconds of a ROS stamp are an int32
# Bytes of a table, which is held as text and cell by cell; hours of tracked points are less.
_MOST = 256 << 20


def import_csv(
    csv_path: str | Path,
    output: str | Path,
    rate: float | None = None,
    scale: float = 1.0,
    y_down: bool = False,
    topic: str = '/markers',
    frame_id: str = 'world',
    progress: Callable[[float], None] | None = None,
) -> int:
    """Write the markers of a CSV file to a bag, as visualization_msgs/MarkerArray.

    The first line names the columns: NAME_x and NAME_y for each marker, NAME_z where there is
    one (else z is 0), and t, in s. Other columns are ignored. A cell that is empty or 'nan' means
    that its marker was not seen in that frame; a frame without markers becomes an empty array.
    `scale` is the length of the table's unit in m; `y_down` turns the sign of y.

    With `rate`, in Hz, frame k is stamped 1 s + k/rate, whatever t says. Else the stamps are t;
    where t starts at 0 or before, all are moved so that the first is 1 s, for a stamp of 0 means
    none in ROS. Log times are the stamps. `progress` is called with the fraction of frames
    written, at most some 200 times.

    Returns the number of frames. Raises BagError, naming file, line and column, when the table
    is not as above; `output`, which is replaced, is not touched before all of it has been read.
    """
    csv_path, output = Path(csv_path), Path(output)
    for name, value in (('rate', rate), ('scale', scale)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise BagError(f'{name} is {value}; fix: give a number greater than 0')
    if os.path.exists(output) and os.path.exists(csv_path) and output.samefile(csv_path):
        raise BagError(f'{output} is the table itself; fix: give another file for the bag')

    columns, lines = _read_columns(csv_path)
    names, points = _markers(csv_path, columns, lines)
    with np.errstate(over='ignore'):
        points *= [scale, -scale if y_down else scale, scale]
    if np.isinf(points).any():
        raise BagError(f'scale is {scale}; fix: give the length of the unit of {csv_path} in m')
    stamps = _stamps(csv_path, columns, lines, rate)
    step = math.ceil(len(stamps) / 200)
    with BagWriter(output) as bag:
        for count, (stamp, row) in enumerate(zip(stamps.tolist(), points, strict=True), start=1):
            bag.write(topic, to_message('marker_array', stamp, frame_id, names, row), stamp)
            if progress is not None and (count % step == 0 or count == len(stamps)):
                progress(count / len(stamps))
    return len(stamps)


def _read_columns(path: Path) -> tuple[dict[str, Sequence[str]], list[int]]:
    """Cells by the name of their column, and the number of each row's line."""
    try:
        with path.open('rb') as table:
            content = table.read(_MOST + 1)
        if len(content) > _MOST:
            raise BagError(f'{path} is larger than {_MOST >> 20} MiB; fix: cut it into parts')
        text = content.decode('utf-8-sig')
    except OSError as error:
        raise BagError(
            f'{path} cannot be read: {error.strerror}; fix: check the path and its rights'
        ) from error
    except UnicodeDecodeError as error:
        line = content.count(b'\n', 0, error.start) + 1
        raise BagError(f'{path}, line {line}: not UTF-8; fix: save it as CSV UTF-8') from error

    reader = csv.reader(StringIO(text, newline=''), strict=True)
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        for row in reader:
            if row:  # the last line may be empty
                rows.append(row)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise BagError(
            f'{path}, line {reader.line_num}: {error}; fix: save it as plain CSV, with commas'
        ) from error
    if len(rows) < 2:
        has = 'has no frames, only a line of names' if rows else 'is empty'
        raise BagError(f'{path} {has}; fix: give a line of names and a line for each frame')
    header = [name.strip() for name in rows.pop(0)]
    head_line = lines.pop(0)
    if len(header) == 1 and any(mark in header[0] for mark in ';\t'):
        raise BagError(
            f'{path}, line {head_line}: cells are not separated by commas; fix: save it as CSV '
            'with commas, and numbers with decimal points'
        )
    for name in header:
        if name and header.count(name) > 1:
            raise BagError(
                f"{path}, line {head_line}: column '{name}' is there twice; fix: rename one"
            )
    for row, line in zip(rows, lines, strict=True):
        if len(row) != len(header):
            raise BagError(
                f'{path}, line {line}: {len(row)} cells under {len(header)} names; '
                'fix: as many commas in each line'
            )
    return dict(zip(header, zip(*rows, strict=True), strict=True)), lines


def _markers(
    path: Path, columns: dict[str, Sequence[str]], lines: list[int]
) -> tuple[list[str], np.ndarray]:
    """Names of the n markers, and their points, float64 of shape (frames, n, 3)."""
    # A dict, not a set: markers keep the order of the columns.
    names = list(dict.fromkeys(c[:-2] for c in columns if c[:-2] and c[-2:] in ('_x', '_y', '_z')))
    if not names:
        raise BagError(
            f'{path}, line 1: no column is named NAME_x; fix: name the columns of each marker '
            'NAME_x and NAME_y, with commas between them'
        )
    points = np.zeros((len(lines), len(names), 3))
    for index, name in enumerate(names):
        for axis, letter in enumerate('xyz'):
            column = f'{name}_{letter}'
            if column in columns:
                points[:, index, axis] = _numbers(path, column, columns[column], lines)
            elif letter != 'z':
                raise BagError(
                    f"{path}, line 1: marker '{name}' has no column {column}; fix: add it"
                )
    return names, points


def _numbers(path: Path, column: str, cells: Sequence[str], lines: Sequence[int]) -> np.ndarray:
    """A column as float64, NaN where a cell is empty."""
    filled = [cell.strip() or 'nan' for cell in cells]
    try:
        numbers = np.array(filled, dtype=np.float64)
    except ValueError:
        numbers = np.array([_number_or_inf(cell) for cell in filled])
    if (bad := np.isinf(numbers)).any():
        row = int(bad.argmax())
        raise BagError(
            f"{path}, line {lines[row]}, column {column}: '{cells[row][:40]}' is not a number; "
            'fix: write it with a decimal point, and nothing where a marker was not seen'
        )
    return numbers


def _number_or_inf(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.inf


def _stamps(
    path: Path, columns: dict[str, Sequence[str]], lines: list[int], rate: float | None
) -> np.ndarray:
    """A stamp for each frame, int64, in ns; from 1 s on where the table starts at 0 or before."""
    if rate is not None:
        if not 1.001 * len(lines) / _LONGEST < rate <= 1e9:
            raise BagError(f'rate is {rate:g} for {len(lines)} frames; fix: give it in Hz')
        return _SECOND + np.rint(np.arange(len(lines)) * 1e9 / rate).astype(np.int64)
    if 't' not in columns:
        raise BagError(f'{path} has no column t; fix: add one, in seconds, or give --rate')
    seconds = _numbers(path, 't', columns['t'], lines)
    if seconds[0] <= 0:
        seconds = seconds - seconds[0] + 1
    if (bad := ~(np.abs(seconds) < _LONGEST)).any():
        row = int(bad.argmax())
        raise BagError(
            f"{path}, line {lines[row]}, column t: '{columns['t'][row]}' is not a time in "
            'seconds; fix: give each frame its time, or the table a --rate'
        )
    stamps = np.rint(seconds * 1e9).astype(np.int64)
    if (bad := np.diff(stamps) <= 0).any():
        row = int(bad.argmax()) + 1
        raise BagError(
            f"{path}, line {lines[row]}, column t: '{columns['t'][row]}' is not later than the "
            'line before; fix: sort the lines by t, or give --rate'
        )
    return stamps
