"""A text file as a sheet of cells, and the numbers, points and names that are read from it."""

import csv
import math
import re
from array import array
from collections.abc import Iterator, Sequence
from io import BytesIO, TextIOWrapper
from itertools import islice
from pathlib import Path

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.files import printable

MOST_COLUMNS = 10_000
# Cells of a file, two more a row: 1e6 frames of 10 markers in space, and times.
MOST_CELLS = 33_000_000
_NUMBER = re.compile(r'[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|nan)', re.I | re.A)
_HEAD_ROWS = 50  # rows held as text; they show what separates cells
ROW_CHARACTERS = 1 << 20  # of a row with all its cells
_BLOCK_CELLS = 1 << 16  # held as text at a time, at some 60 bytes each
_SHOWN = 40  # characters of a cell


class Sheet:
    """
    Rows of cells of a text file, without its empty lines and the rows of empty cells at its end.

    Cells are separated by what most lines have of tab, semicolon, comma and space; where it is not
    commas, numbers may have decimal commas. Only the bytes of the file and the number of each line
    are held: cells are split again whenever numbers are asked for. Raises BagError when quotes do
    not match.
    """

    def __init__(self, path: Path, data: bytes, notes: list[str], not_utf8_line: int = 0) -> None:
        self.path = path
        self.notes = notes  # what the user should know, a line each
        self.not_utf8_line = not_utf8_line  # 0: it is
        self._data = data
        self._encoding = 'cp1252' if not_utf8_line else 'utf-8-sig'
        text = data[:ROW_CHARACTERS].decode(self._encoding, 'replace')
        first = [line for line in text.splitlines() if line.strip()][:_HEAD_ROWS]
        self.delimiter = next(
            (mark for mark in '\t;, ' if sum(mark in line for line in first) * 2 > len(first)), ','
        )
        self.lines = array('I')  # number of the line that each row ends in
        self._uneven_row: int | None = None  # the first of another width than the first row
        self._most_columns = 1
        self._top: list[list[str]] = []
        self._near: tuple[int, list[list[str]]] = 0, []
        self._row_separators = self._row_characters = self._row_lines = 0
        self._last_row_is_open = False
        self._count_rows()

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.lines)

    def _stream(self) -> TextIOWrapper:
        return TextIOWrapper(BytesIO(self._data), self._encoding, 'replace', newline='')

    def _lines(self) -> Iterator[str]:
        """Yield the lines; where cells are separated by spaces, by one each."""
        with self._stream() as stream:
            yield from stream if self.delimiter != ' ' else map(_single_spaced, stream)

    def _bounded_lines(self) -> Iterator[str]:
        """Yield lines; raise BagError where a row has more cells or letters than are held."""
        with self._stream() as stream:
            number = 0
            while line := stream.readline(ROW_CHARACTERS):
                number += 1
                self._row_lines += 1
                self._row_separators += line.count(self.delimiter)
                self._row_characters += len(line)
                if (columns := self._row_separators + 1) > MOST_COLUMNS:
                    raise BagError(
                        f'{self.path}, line {number}: {columns} columns; '
                        f'fix: give {MOST_COLUMNS} at most'
                    )
                if self._row_characters >= ROW_CHARACTERS:
                    raise BagError(
                        f'{self.path}, line {number}: a row has more than {ROW_CHARACTERS} '
                        'characters; fix: check its quotes and ends of lines'
                    )
                yield line if self.delimiter != ' ' else _single_spaced(line)

    def _count_rows(self) -> None:
        """Find the number, lines and widths of rows, keep the first ones, leave out a cut one."""
        reader = csv.reader(self._bounded_lines(), delimiter=self.delimiter, strict=True)
        is_ended = self._data.endswith((b'\n', b'\r'))
        cell_count = row_count = 0
        before: list[str] = []
        row: list[str] = []
        try:
            for cells in reader:
                self._row_separators = self._row_characters = self._row_lines = 0
                # A row takes as much memory as some cells.
                cell_count += len(cells) + 2
                if cell_count > MOST_CELLS:
                    check_cells(self.path, cell_count)
                if not cells:
                    continue
                before, row = row, cells
                self.lines.append(reader.line_num)
                if any(map(str.strip, row)):
                    row_count = len(self.lines)
                if len(self._top) < _HEAD_ROWS:
                    self._top.append(row)
                self._most_columns = max(self._most_columns, len(row))
                if self._uneven_row is None and len(row) != len(self._top[0]):
                    self._uneven_row = len(self.lines) - 1
        except csv.Error as error:
            # Quotes that are open for more than the last line were left open before the cut.
            if is_ended or 'end of data' not in str(error) or self._row_lines != 1:
                raise BagError(
                    f'{self.path}, line {reader.line_num}: {shown(str(error))}; '
                    'fix: save it as plain CSV, with commas'
                ) from error
            self._keep_rows(row_count)
            self.notes.append(
                f'{self.path}, line {reader.line_num}: the file is cut off amid a cell in quotes; '
                'the row is left out'
            )
            return
        is_last_row_full = row_count == len(self.lines)
        self._keep_rows(row_count)
        if is_ended or not is_last_row_full or row_count < 3:
            return
        if len(row) < len(before):
            self.notes.append(
                f'{self.path}, line {self.lines[-1]}: the file is cut off after {len(row)} of '
                f'{len(before)} cells; the row is left out'
            )
            self._keep_rows(row_count - 1)
            return
        # A last cell that is closed by a quote, or empty in the row before, too, lacks nothing.
        self._last_row_is_open = not self._data.endswith(b'"') and bool(row[-1] or before[-1])

    def _keep_rows(self, count: int) -> None:
        del self.lines[count:], self._top[count:]

    def judge_last_row(self, is_always_ended: bool) -> None:
        """
        Note that the last number of the file may be cut off, where no end of line follows it.

        The row is left out where the program that writes such files always ends the last line.
        """
        if not self._last_row_is_open:
            return
        end = (
            'the row is left out'
            if is_always_ended
            else 'end the line if it is not, or delete the line'
        )
        self.notes.append(
            f'{self.path}, line {self.lines[-1]}: the file ends without the end of a line, so the '
            f'last number may be cut off; {end}'
        )
        if is_always_ended:
            self._keep_rows(len(self) - 1)

    def rows(self) -> Iterator[list[str]]:
        """Split the file into rows of cells, from its beginning."""
        reader = csv.reader(self._lines(), delimiter=self.delimiter, strict=True)
        return islice(filter(None, reader), len(self))

    def _row(self, index: int) -> list[str]:
        if index >= len(self):
            return []
        if index < len(self._top):
            return self._top[index]
        first, rows = self._near
        if not first <= index < first + len(rows):
            first, rows = index, list(islice(self.rows(), index, index + _HEAD_ROWS))
            self._near = first, rows
        return rows[index - first]

    def cell(self, row: int, column: int) -> str:
        """A cell without the spaces around it; '' where there is none."""
        cells = self._row(row)
        return cells[column].strip() if column < len(cells) else ''

    def head(self, row: int) -> list[str]:
        """The cells of a row, without spaces around them."""
        return [cell.strip() for cell in self._row(row)]

    def uneven_row(self) -> int | None:
        """Index of the first row with another number of cells than the first; None without."""
        row = self._uneven_row
        return row if row is not None and row < len(self) else None

    def texts(self, column: int, first: int) -> Iterator[str]:
        """Yield the cells of a column from row `first` on, without the spaces around them."""
        for row in islice(self.rows(), first, None):
            yield row[column].strip() if column < len(row) else ''

    def blocks(
        self, columns: Sequence[int], names: Sequence[str], first: int, end: int | None = None
    ) -> Iterator[np.ndarray]:
        """
        Yield numbers (rows, columns) of the rows from `first` to `end`, some thousand at a time.

        They are float64, NaN where a cell is empty. Raises BagError for a cell that is no number,
        with the name of its column.
        """
        rows = islice(self.rows(), first, end)
        step = max(1, _BLOCK_CELLS // self._most_columns)
        done = first
        while block := list(islice(rows, step)):
            cells = [row[c] if c < len(row) else '' for row in block for c in columns]
            numbers = np.array(_numbers_or_inf(cells, self.delimiter != ','))
            if (bad := np.isinf(numbers)).any():
                place = int(bad.argmax())
                row, column = divmod(place, len(columns))
                raise BagError(
                    f'{self.path}, line {self.lines[done + row]}, column {shown(names[column])}: '
                    f"'{shown(cells[place])}' is not a number; fix: write it with a decimal "
                    'point, and nothing where a marker was not seen'
                )
            yield numbers.reshape(len(block), len(columns))
            done += len(block)

    def numbers(self, columns: Sequence[int], names: Sequence[str], first: int) -> np.ndarray:
        """Read numbers (T, columns) from row `first` on, as `blocks` has them."""
        count = max(0, len(self) - first)
        check_cells(self.path, count * len(columns))
        numbers = np.empty((count, len(columns)))
        done = 0
        for block in self.blocks(columns, names, first):
            numbers[done : done + len(block)] = block
            done += len(block)
        return numbers

    def column(self, index: int, first: int, name: str) -> np.ndarray:
        """Numbers of a column from row `first` on, float64, NaN where a cell is empty."""
        return self.numbers([index], [name], first)[:, 0]

    def points(
        self,
        columns: Sequence[Sequence[int]],
        names: Sequence[str],
        first: int,
        end: int | None = None,
        also: tuple[int, str] | None = None,
        *,
        separator: str = ' ',
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Points (T, n, 3) of rows first to end, from two or three columns each; z is else 0.

        With them come numbers (T,) of a column `also`, an index and a name. The `separator` is
        between the name of a marker and the axis where a message names a column.
        """
        count = max(0, len(self.lines[first:end]))
        points, numbers = np.zeros((count, len(columns), 3)), np.empty(count)
        sources = [column for axes in columns for column in axes]
        targets = [3 * k + axis for k, axes in enumerate(columns) for axis in range(len(axes))]
        titles = [
            f'{name}{separator}{axis}'
            for name, axes in zip(names, columns, strict=True)
            for axis, _ in zip('xyz', axes, strict=False)
        ]
        if also is not None:
            sources.append(also[0])
            titles.append(also[1])
        flat = points.reshape(count, 3 * len(columns))
        done = 0
        for block in self.blocks(sources, titles, first, end):
            flat[done : done + len(block), targets] = block[:, : len(targets)]
            if also is not None:
                numbers[done : done + len(block)] = block[:, -1]
            done += len(block)
        return points, numbers

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
        points, numbers = self.points(list(columns.values()), names, first, end, (0, title))
        return names, points, whole_numbers(self.path, numbers, lines, title), lines

    def markers(
        self, names_row: int, axes_row: int, columns: Sequence[int]
    ) -> dict[str, list[int]]:
        """
        Find columns X, Y, Z of each marker, by its name, which stands above X at least.

        Names that are there several times are numbered. Raises BagError for other axes.
        """
        names: list[str] = []
        found = [[0, 0, 0]]
        for column in columns:
            axis = self.cell(axes_row, column)
            if axis == 'X' and len(found[-1]) == 3:
                names.append(self.cell(names_row, column) or f'marker {len(names) + 1}')
                found.append([column])
            elif len(found[-1]) < 3 and axis == 'XYZ'[len(found[-1])]:
                found[-1].append(column)
            else:
                break
        if len(found[-1]) < 3 or len(columns) > 3 * len(names):
            name = names[-1] if names else self.cell(names_row, columns[0]) if columns else ''
            raise BagError(
                f"{self.path}, line {self.lines[axes_row]}: marker '{shown(name)}' has other "
                'columns than X, Y, Z; fix: export it again'
            )
        names = number_names(self.path, names, self.notes)
        return dict(zip(names, found[1:], strict=True))


def number_in(cell: str) -> float:
    """A number of a file's head, maybe with a decimal comma; 0 where there is none."""
    number = number_or_inf(cell.strip().replace(',', '.'))
    return number if math.isfinite(number) else 0.0


def shown(text: str) -> str:
    """Text of a file for a message: cut, and harmless to a terminal."""
    return printable(text if len(text) <= _SHOWN else f'{text[:_SHOWN]}...')


def check_cells(path: Path, count: int) -> None:
    """Raise BagError when a file has more cells than are held in memory."""
    if count > MOST_CELLS:
        raise BagError(
            f'{path} has more than {MOST_CELLS} cells; fix: cut it into parts, or leave out '
            'columns that are not positions'
        )


def check_names(path: Path, names: Sequence[object]) -> None:
    """Raise BagError where there are no markers."""
    if not names:
        raise BagError(f'{path} has no markers; fix: export positions of markers, too')


def number_names(path: Path, names: Sequence[str], notes: list[str]) -> list[str]:
    """
    Make names differ: NAME, NAME_2, NAME_3, and note where that was needed.

    Raises BagError where there are none.
    """
    check_names(path, names)
    taken, counts = set(names), dict.fromkeys(names, 0)
    unique, numbered = [], []
    for name in names:
        counts[name] += 1
        called = name
        if counts[name] > 1:
            while (called := f'{name}_{counts[name]}') in taken:
                counts[name] += 1
            taken.add(called)
            numbered.append(f"'{shown(called)}'")
        unique.append(called)
    if numbered:
        more = f' and {len(numbered) - 5} more' if len(numbered) > 5 else ''
        notes.append(
            f'{path} has several markers of one name; they are numbered: '
            f'{", ".join(numbered[:5])}{more}'
        )
    return unique


def whole_numbers(path: Path, numbers: np.ndarray, lines: Sequence[int], name: str) -> np.ndarray:
    """Numbers of frames as int64; raises BagError when they are not, or do not rise."""
    whole = np.empty(len(numbers), np.int64)
    # Some at a time, since there can be millions.
    for first in range(0, len(numbers), _BLOCK_CELLS):
        part = slice(first, first + _BLOCK_CELLS)
        whole[part] = np.rint(np.nan_to_num(numbers[part], nan=-1.0))
        bad = ~(np.abs(whole[part] - numbers[part]) < 1e-6)
        before = whole[max(0, first - 1) : part.stop]
        bad[len(bad) - len(before) + 1 :] |= np.diff(before) <= 0
        if bad.any():
            row = first + int(bad.argmax())
            raise BagError(
                f'{path}, line {lines[row]}, column {name}: {numbers[row]:.10g} is not the number '
                'of a frame after the one before; fix: a number for each frame, in order'
            )
    return whole


def _numbers_or_inf(cells: Sequence[str], have_decimal_commas: bool) -> list[float]:
    """Numbers of cells, NaN where they are empty, infinity where they are no numbers."""
    text = ''.join(cells)
    if have_decimal_commas and ',' in text:
        cells = [cell.replace(',', '.') for cell in cells]
    if text.isascii() and '_' not in text:
        # All else that float takes and _NUMBER does not is infinite.
        try:
            return [float(cell) if cell else math.nan for cell in cells]
        except ValueError:
            pass
    return [number_or_inf(cell.strip() or 'nan') for cell in cells]


def number_or_inf(cell: str) -> float:
    """A number in ASCII digits, or NaN; infinity for all else, such as 1_000 or Arabic digits."""
    return float(cell) if _NUMBER.fullmatch(cell) else math.inf


def _single_spaced(line: str) -> str:
    """Put one space between cells; numpy puts a # before the names of columns."""
    return ' '.join(line.removeprefix('#').split()) + '\n'
