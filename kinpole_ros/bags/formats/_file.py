"""What every format is read from, a file as bytes or as a sheet of cells, and what it becomes."""

import csv
import errno
import math
import re
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.files import printable, read_limited

# Bytes of a file, which is held as text and cell by cell; hours of tracked points are less.
MOST = 256 << 20
# m in the units that programs write, by their names in small letters.
UNITS = {
    **dict.fromkeys(('m', 'meter', 'meters', 'metre', 'metres'), 1.0),
    **dict.fromkeys(('dm', 'decimeters', 'decimetres'), 0.1),
    **dict.fromkeys(('cm', 'centimeter', 'centimeters', 'centimetres'), 0.01),
    **dict.fromkeys(('mm', 'millimeter', 'millimeters', 'millimetres'), 0.001),
    **dict.fromkeys(('um', 'µm', 'micrometers'), 1e-6),
    **dict.fromkeys(('in', 'inch', 'inches'), 0.0254),
    **dict.fromkeys(('ft', 'foot', 'feet'), 0.3048),
}
_MOST_COLUMNS = 10_000
# Cells of a file: 1e6 frames of 10 markers in space, and times; a text cell takes some 60 bytes.
MOST_CELLS = 45_000_000
_NUMBER = re.compile(r'[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|nan)', re.I | re.A)
_SNIFFED = 50  # lines that show what separates cells
_SHOWN = 40  # characters of a cell


class Wanted(NamedTuple):
    """What the user said of the file; None where nothing."""

    rate: float | None = None  # Hz; times in the file do not count then
    likelihood: float | None = None  # the least at which a point counts as seen


@dataclass(frozen=True)
class Points:
    """Tracked points of any format: n markers in T frames."""

    names: Sequence[str]  # n
    points: np.ndarray  # (T, n, 3), in the unit of the file; NaN where a marker was not seen
    frames: np.ndarray  # (T,), int64: number of each frame
    times: np.ndarray | None  # (T,), s; None where the file has none or a rate is given
    unit: str  # as the file calls it; '' where it does not say
    y_down: bool = False
    lines: Sequence[int] = ()  # of each frame, in a text file
    time_column: str = 'Time'
    notes: Sequence[str] = field(default=())  # what the user should know, a line each

    @property
    def scale(self) -> float | None:
        """Metres a unit; None where only the user can say."""
        return UNITS.get(self.unit.lower())


class Format(NamedTuple):
    """One format: how it is recognized and read."""

    name: str  # for --format
    what: str
    example: str  # its first lines, shortened
    recognizes: Callable[['File'], bool]
    read: Callable[['File', Wanted], Points]


class File:
    """A file that is to be recognized. Raises BagError when it cannot be read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data = _read(path)

    @cached_property
    def sheet(self) -> 'Sheet':
        """Its cells, where it is text; what is not UTF-8 is taken as of Windows."""
        try:
            text, fault = self.data.decode('utf-8-sig'), 0
        except UnicodeDecodeError as error:
            text = self.data.decode('cp1252', 'replace')
            fault = self.data.count(b'\n', 0, error.start) + 1
        if '\0' in text:
            # UTF-16, or no text at all.
            raise not_utf8(self.path, fault or 1)
        return Sheet(self.path, text, fault)

    @property
    def is_text(self) -> bool:
        """Whether it can be a sheet."""
        return b'\0' not in self.data[:4096]


class Sheet:
    """
    Cells of a text file, without its empty lines.

    Cells are separated by what most lines have of tab, semicolon and comma; where it is not
    commas, numbers may have decimal commas. Raises BagError when quotes do not match.
    """

    def __init__(self, path: Path, text: str, not_utf8_line: int = 0) -> None:
        self.path = path
        self.not_utf8_line = not_utf8_line  # 0: it is
        first = [line for line in text[: 1 << 20].splitlines() if line.strip()][:_SNIFFED]
        self.delimiter = next(
            (mark for mark in '\t;' if sum(mark in line for line in first) * 2 > len(first)), ','
        )
        # Before they are split: a cell of nothing takes as much as 100 letters then.
        for number, line in enumerate(StringIO(text, newline='\n'), 1):
            if (columns := line.count(self.delimiter) + 1) > _MOST_COLUMNS:
                raise BagError(
                    f'{path}, line {number}: {columns} columns; fix: give {_MOST_COLUMNS} at most'
                )
        reader = csv.reader(StringIO(text, newline=''), delimiter=self.delimiter, strict=True)
        self.rows: list[list[str]] = []
        self.lines = array('q')
        empty: dict[int, list[str]] = {}  # by length, shared by all rows without content
        cell_count = 0
        try:
            for row in reader:
                # A row takes as much memory as some cells.
                cell_count += len(row) + 2
                if cell_count > MOST_CELLS:
                    check_cells(path, cell_count)
                if row:
                    if not any(row):
                        row = empty.setdefault(len(row), row)
                    self.rows.append(row)
                    self.lines.append(reader.line_num)
        except csv.Error as error:
            raise BagError(
                f'{path}, line {reader.line_num}: {shown(str(error))}; '
                'fix: save it as plain CSV, with commas'
            ) from error
        self.notes = self._leave_out_cut_row(text)

    def _leave_out_cut_row(self, text: str) -> list[str]:
        """Remove a last row that ends amid its cells, where the file was cut off; a note of it."""
        if text.endswith(('\n', '\r')) or len(self.rows) < 3:
            return []
        if len(self.rows[-1]) >= len(self.rows[-2]):
            return []
        row, line = self.rows.pop(), self.lines.pop()
        if not any(cell.strip() for cell in row):
            return []
        count, before = len(row), len(self.rows[-1])
        return [
            f'{self.path}, line {line}: the file is cut off after {count} of {before} '
            'cells; the row is left out'
        ]

    def cell(self, row: int, column: int) -> str:
        """A cell without the spaces around it; '' where there is none."""
        if row >= len(self.rows) or column >= len(self.rows[row]):
            return ''
        return self.rows[row][column].strip()

    def head(self, row: int) -> list[str]:
        """The cells of a row, without spaces around them."""
        return [cell.strip() for cell in self.rows[row]] if row < len(self.rows) else []

    def column(self, index: int, first: int, name: str = '', end: int | None = None) -> np.ndarray:
        """Numbers of a column from row `first` on, float64, NaN where a cell is empty."""
        rows = self.rows[first:end]
        cells = [row[index].strip() or 'nan' if index < len(row) else 'nan' for row in rows]
        if self.delimiter != ',':
            cells = [cell.replace(',', '.') for cell in cells]
        numbers = np.array([_number_or_inf(cell) for cell in cells])
        if (bad := np.isinf(numbers)).any():
            row = first + int(bad.argmax())
            raise BagError(
                f'{self.path}, line {self.lines[row]}, column {shown(name or str(index + 1))}: '
                f"'{shown(self.rows[row][index])}' is not a number; fix: write it with a decimal "
                'point, and nothing where a marker was not seen'
            )
        return numbers

    def points(
        self, columns: Sequence[Sequence[int]], names: Sequence[str], first: int, end: int | None
    ) -> np.ndarray:
        """Points (T, n, 3) of rows first to end, from two or three columns each; z is else 0."""
        points = np.zeros((len(self.rows[first:end]), len(columns), 3))
        for index, (name, axes) in enumerate(zip(names, columns, strict=True)):
            for axis, column in enumerate(axes):
                points[:, index, axis] = self.column(column, first, f'{name} {"xyz"[axis]}', end)
        return points

    def frames(
        self,
        columns: dict[str, list[int]],
        first: int,
        title: str = 'Frame',
        end: int | None = None,
    ) -> tuple[list[str], np.ndarray, np.ndarray, Sequence[int]]:
        """
        Names of markers, points (T, n, 3), numbers of the frames, and the lines of these.

        `columns` are those of each marker; numbers of frames are in the first, called `title`.
        """
        names, lines = list(columns), self.lines[first:end]
        check_names(self.path, names)
        points = self.points(list(columns.values()), names, first, end)
        numbers = self.column(0, first, title, end)
        return names, points, whole_numbers(self.path, numbers, lines, title), lines

    def check_axes(self, columns: dict[str, list[int]], axes: int, program: str) -> None:
        """Raise BagError where the `columns` of a marker are not X, Y, Z, as the row says."""
        for name, places in columns.items():
            if [self.cell(axes, column) for column in places] != ['X', 'Y', 'Z']:
                raise BagError(
                    f"{self.path}: marker '{shown(name)}' has other columns than X, Y, Z; fix: "
                    f'give each marker a name of its own in {program}'
                )


def number_in(cell: str) -> float:
    """A number of a file's head, maybe with a decimal comma; 0 where there is none."""
    number = _number_or_inf(cell.strip().replace(',', '.'))
    return number if math.isfinite(number) else 0.0


def _read(path: Path) -> bytes:
    try:
        return read_limited(path, MOST)
    except OSError as error:
        if error.errno == errno.EFBIG:
            raise BagError(
                f'{path} is larger than {MOST >> 20} MiB; fix: cut it into parts'
            ) from error
        raise BagError(
            f'{path} cannot be read: {error.strerror}; fix: check the path and its rights'
        ) from error


def not_utf8(path: Path, line: int) -> BagError:
    return BagError(f'{path}, line {line}: not UTF-8; fix: save it as CSV UTF-8')


def shown(text: str) -> str:
    """Text of a file for a message: cut, and harmless to a terminal."""
    return printable(text if len(text) <= _SHOWN else f'{text[:_SHOWN]}...')


def no_points(path: Path, why: str, fix: str) -> BagError:
    return BagError(f'{path} {why}; fix: {fix}')


def check_cells(path: Path, count: int) -> None:
    """Raise BagError when a file has more cells than are held in memory."""
    if count > MOST_CELLS:
        raise BagError(
            f'{path} has more than {MOST_CELLS} cells; fix: cut it into parts, or leave out '
            'columns that are not positions'
        )


def check_names(path: Path, names: Sequence[str]) -> None:
    """Raise BagError when two markers have one name, or there is none."""
    if not names:
        raise no_points(path, 'has no markers', 'export positions of markers, too')
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise BagError(f"{path}: marker '{shown(name)}' is there {count} times; fix: rename one")


def whole_numbers(path: Path, numbers: np.ndarray, lines: Sequence[int], name: str) -> np.ndarray:
    """Numbers of frames as int64; raises BagError when they are not, or do not rise."""
    whole = np.rint(np.nan_to_num(numbers, nan=-1.0)).astype(np.int64)
    bad = ~(np.abs(whole - numbers) < 1e-6)
    if not bad.any() and len(whole) > 1:
        bad[1:] = np.diff(whole) <= 0
    if bad.any():
        row = int(bad.argmax())
        raise BagError(
            f'{path}, line {lines[row]}, column {name}: {numbers[row]:.10g} is not the number of a '
            'frame after the one before; fix: a number for each frame, in order'
        )
    return whole


def frame_times(
    frames: np.ndarray, rate: float | None, times: np.ndarray | None = None, decimals: int = 9
) -> np.ndarray | None:
    """
    Instants of frames, s: exact by the file's own rate, where that gives its times as it rounds
    them to so many decimals; else the times; None where there is neither.
    """
    if rate is None or not (math.isfinite(rate) and rate > 0):
        return times
    even = frames / rate
    if times is None or not len(times):
        return even
    start = times[0] - even[0]
    # Both of the ends of a difference are rounded. A missing frame is off by a whole interval.
    rounded = 10.0**-decimals
    most = rounded * (1.01 if rounded * rate < 0.99 else 0.99)
    if np.nanmax(np.abs(times - even - start), initial=0.0) > most:
        return times
    return even + start


def decimals_of(cells: Sequence[str]) -> int:
    """The most digits behind the point of these numbers, but for zeros that all of them end in."""
    plain = (cell.strip().replace(',', '.') for cell in cells)
    return max(
        (len(cell.partition('.')[2].rstrip('0')) for cell in plain if 'e' not in cell.lower()),
        default=9,
    )


def _number_or_inf(cell: str) -> float:
    """A number in ASCII digits, or NaN; infinity for all else, such as 1_000 or Arabic digits."""
    return float(cell) if _NUMBER.fullmatch(cell) else math.inf
