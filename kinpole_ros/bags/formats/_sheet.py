"""A text file as a sheet of cells, and the numbers and points that are read from it."""

import csv
import re
from array import array
from collections.abc import Iterator, Sequence
from io import BytesIO, TextIOWrapper
from itertools import islice
from pathlib import Path

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats import _cells

# The line by which Excel knows the delimiter.
_EXCEL = re.compile(rb'(?:\xef\xbb\xbf)?"?sep=([\t;, ])"?(\r?\n)', re.I)
_HEAD_ROWS = 50  # rows held as text; the delimiter is found from them
_ROW_CHARACTERS = 1 << 20  # of a row with all its cells
_BLOCK_CELLS = 1 << 16  # held as text at a time, at some 60 bytes each


class Sheet:
    """
    Rows of cells of a text file, without empty lines and the rows of empty cells at its end.

    The delimiter is the one of tab, semicolon, comma and space that most lines have; where it is
    not the comma, numbers may have decimal commas. Only the bytes of the file and the number of
    each line are held: cells are split again whenever numbers are read. Raises BagError when quotes
    do not match.
    """

    def __init__(self, path: Path, data: bytes, notes: list[str], not_utf8_line: int = 0) -> None:
        self.path = path
        self.notes = notes  # what the user should know, a line each
        self.not_utf8_line = not_utf8_line  # 0 if all are
        if (head := _EXCEL.match(data)) is not None:
            data = head[2] + data[head.end() :]  # the other lines keep their numbers
        self._data = data
        self._encoding = 'cp1252' if not_utf8_line else 'utf-8-sig'
        text = data[:_ROW_CHARACTERS].decode(self._encoding, 'replace')
        first = [line for line in text.splitlines() if line.strip()][:_HEAD_ROWS]
        self.delimiter = next(
            (mark for mark in '\t;, ' if sum(mark in line for line in first) * 2 > len(first)), ','
        )
        if head is not None:
            self.delimiter = head[1].decode()
        self.lines = array('I')  # number of the line that each row ends in
        self._uneven_row: int | None = None  # the first of another width than the first row
        self._most_columns = 1
        self._head: list[list[str]] = []
        self._marks: dict[str, str] = {}  # decimal marks, and where each is first
        self._window: tuple[int, list[list[str]]] = 0, []  # rows read last, from an index on
        # Of the row that is being read.
        self._row_separators = self._row_characters = self._row_lines = 0
        self._may_be_cut = self._is_short = False  # the last number
        self.left_out: int | None = None  # line of a last row
        self._count_rows()

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.lines)

    def _stream(self) -> TextIOWrapper:
        return TextIOWrapper(BytesIO(self._data), self._encoding, 'replace', newline='')

    def _bounded_lines(self) -> Iterator[str]:
        """Yield lines; raise BagError where a row has more cells or characters than are held."""
        with self._stream() as stream:
            number = 0
            while line := stream.readline(_ROW_CHARACTERS):
                number += 1
                self._row_lines += 1
                self._row_separators += line.count(self.delimiter)
                self._row_characters += len(line)
                if (columns := self._row_separators + 1) > _cells.MOST_COLUMNS:
                    raise BagError(
                        f'{self.path}, line {number}: {columns} columns; '
                        f'fix: give {_cells.MOST_COLUMNS} at most'
                    )
                if self._row_characters >= _ROW_CHARACTERS:
                    raise BagError(
                        f'{self.path}, line {number}: a row has more than {_ROW_CHARACTERS} '
                        'characters; fix: check its quotes and ends of lines'
                    )
                yield line if self.delimiter != ' ' else _single_spaced(line)

    def _count_rows(self) -> None:
        """Find the number, lines and widths of rows, hold the first ones, drop a cut one."""
        reader = csv.reader(self._bounded_lines(), delimiter=self.delimiter, strict=True)
        is_ended = self._data.endswith((b'\n', b'\r'))
        cell_count = row_count = 0
        previous: list[str] = []
        row: list[str] = []
        try:
            for cells in reader:
                self._row_separators = self._row_characters = self._row_lines = 0
                # A row takes as much memory as two cells.
                cell_count += len(cells) + 2
                if cell_count > _cells.MOST_CELLS:
                    _cells.check_cells(self.path, cell_count)
                if not cells:
                    continue
                previous, row = row, cells
                self.lines.append(reader.line_num)
                if any(map(str.strip, row)):
                    row_count = len(self.lines)
                if len(self._head) < _HEAD_ROWS:
                    self._head.append(row)
                self._most_columns = max(self._most_columns, len(row))
                if self._uneven_row is None and len(row) != len(self._head[0]):
                    self._uneven_row = len(self.lines) - 1
        except csv.Error as error:
            # Quotes that are open for more than the last line were left open before the cut.
            if is_ended or 'end of data' not in str(error) or self._row_lines != 1:
                raise BagError(
                    f'{self.path}, line {reader.line_num}: {_cells.shown(str(error))}; '
                    'fix: save it as plain CSV, with commas'
                ) from error
            self._drop_rows(row_count)
            self.notes.append(
                f'{self.path}, line {reader.line_num}: the file is cut off amid a cell in quotes; '
                'the row is left out'
            )
            return
        is_last_row_empty = row_count < len(self.lines)
        self._drop_rows(row_count)
        if is_ended or is_last_row_empty or row_count < 3:
            return
        rows = [one for one in (*self._head[:-1], previous) if len(one) == len(previous)]
        if any(map(str.strip, (cell for one in rows for cell in one[len(row) :]))):
            self.notes.append(
                f'{self.path}, line {self.lines[-1]}: the file is cut off after {len(row)} of '
                f'{len(previous)} cells; the row is left out'
            )
            self._drop_rows(row_count - 1)
            return
        # A last cell that is closed by a quote, or empty as in the row before it, is complete.
        if not self._data.endswith(b'"') and any(
            map(str.strip, (row[-1], *previous[len(row) - 1 :]))
        ):
            above = [one[len(row) - 1] for one in rows if len(one) >= len(row)]
            self._may_be_cut, self._is_short = _judge_last_number(row[-1], above)

    def _drop_rows(self, first: int) -> None:
        del self.lines[first:], self._head[first:]

    def check_last_number(self, is_always_ended: bool) -> None:
        """
        Note that the last number of the file may be cut off, where no end of line follows it.

        It is not where it has as many decimals as all above it. The row is left out where it has
        fewer, and the program that writes such files always ends the last line.
        """
        if not self._may_be_cut:
            return
        is_left_out = is_always_ended and self._is_short
        fix = (
            'the row is left out'
            if is_left_out
            else 'end the line if it is not, or delete the line'
        )
        self.notes.append(self._cut_note(self.lines[-1], fix))
        if is_left_out:
            self.left_out = self.lines[-1]
            self._drop_rows(len(self) - 1)

    def _cut_note(self, line: int, fix: str) -> str:
        return (
            f'{self.path}, line {line}: the file ends without the end of a line, so the last '
            f'number may be cut off; {fix}'
        )

    def restore_last_row(self) -> None:
        """Have the row again that was left out, since the head of the file counts it."""
        assert self.left_out is not None
        self.lines.append(self.left_out)
        if len(self) <= _HEAD_ROWS:
            self._head = list(islice(self.rows(), len(self)))
        kept = 'the file counts that row, so it is kept: see that its last number is whole'
        self.notes[:] = [self._cut_note(self.left_out, kept)]

    def rows(self) -> Iterator[list[str]]:
        """Split the file into rows of cells, from its beginning."""
        with self._stream() as stream:
            lines = stream if self.delimiter != ' ' else map(_single_spaced, stream)
            reader = csv.reader(lines, delimiter=self.delimiter, strict=True)
            yield from islice(filter(None, reader), len(self))

    def _row(self, index: int) -> list[str]:
        if index >= len(self):
            return []
        first, rows = 0, self._head
        if index >= len(rows):
            first, rows = self._window
            if not first <= index < first + len(rows):
                first, rows = index, list(islice(self.rows(), index, index + _HEAD_ROWS))
                self._window = first, rows
        return rows[index - first]

    def row(self, index: int) -> list[str]:
        """Return the cells of a row, without the spaces around them; none beyond the last."""
        return [cell.strip() for cell in self._row(index)]

    def cell(self, row: int, column: int) -> str:
        """Return a cell without the spaces around it; '' where there is none."""
        cells = self._row(row)
        return cells[column].strip() if column < len(cells) else ''

    def uneven_row(self) -> int | None:
        """Return the first row with another number of cells than the first; None without."""
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
        while block := list(islice(rows, step)):
            cells = [row[c] if c < len(row) else '' for row in block for c in columns]
            if self.delimiter != ',':
                self._check_marks(block, dict(zip(columns, names, strict=True)), first)
            numbers = np.array(_cells.numbers_or_inf(cells, self.delimiter != ','))
            if (bad := np.isinf(numbers)).any():
                index = int(bad.argmax())
                row, column = divmod(index, len(columns))
                raise BagError(
                    f'{self.path}, line {self.lines[first + row]}, column '
                    f"{_cells.shown(names[column])}: '{_cells.shown(cells[index])}' is not a "
                    'number; fix: write it with a decimal point, and nothing where a marker was '
                    'not seen'
                )
            yield numbers.reshape(len(block), len(columns))
            first += len(block)

    def _check_marks(self, rows: list[list[str]], names: dict[int, str], first: int) -> None:
        """
        Note where the first decimal mark of each kind is; raise BagError for two kinds.

        `names` are those of the columns to be read. Numbers of other columns count, too, since the
        marks of a column alone may be between thousands.
        """
        for mark in set('.,') - self._marks.keys():
            for row, cells in enumerate(rows):
                for column, cell in enumerate(cells) if mark in ' '.join(cells) else ():
                    if mark in cell and (column in names or _cells.is_decimal(cell)):
                        name = _cells.shown(names.get(column) or self.cell(0, column))
                        place = f'line {self.lines[first + row]}, column {name}'
                        self._marks.setdefault(mark, f"'{_cells.shown(cell)}' in {place}")
                if mark in self._marks:
                    break
        if len(self._marks) > 1:
            raise BagError(
                f'{self.path} has two decimal marks: {self._marks["."]}, and {self._marks[","]}; '
                'fix: write all numbers with one, and none between thousands'
            )

    def numbers(
        self,
        columns: Sequence[int | None],
        names: Sequence[str],
        first: int,
        end: int | None = None,
    ) -> np.ndarray:
        """Return numbers (T, columns) of these rows as `blocks` has them, 0 in a column None."""
        sources = [column for column in columns if column is not None]
        titles = [name for name, c in zip(names, columns, strict=True) if c is not None]
        targets = [k for k, column in enumerate(columns) if column is not None]
        numbers = np.zeros((max(0, len(self.lines[first:end])), len(columns)))
        done = 0
        for block in self.blocks(sources, titles, first, end):
            numbers[done : done + len(block), targets] = block
            done += len(block)
        return numbers

    def column(self, index: int, first: int, name: str) -> np.ndarray:
        """Return the numbers (T,) of a column from row `first` on, NaN where a cell is empty."""
        return self.numbers([index], [name], first)[:, 0]

    def points(
        self,
        columns: dict[str, list[int]],
        first: int,
        end: int | None = None,
        number: tuple[int, str] | None = None,
        separator: str = ' ',
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return points (T, n, 3) of rows first to end, and numbers (T,) of another column.

        `columns` are those of x, y and maybe z by the name of each marker; a z without column is 0,
        and NaN where x or y is. `number` is the index and name of the other column. The separator
        stands between the name of a marker and the axis, where a message names a column.
        """
        sources: list[int | None] = [None if number is None else number[0]]
        titles = ['' if number is None else number[1]]
        for name, axes in columns.items():
            sources += [*axes, None][:3]
            titles += [f'{name}{separator}{axis}' for axis in 'xyz']
        numbers = self.numbers(sources, titles, first, end)
        points = numbers[:, 1:].reshape(len(numbers), len(columns), 3)
        # A row at a time would be slow, and a copy of all as large as the file.
        for axis in range(2):
            points[np.isnan(points[..., axis]), 2] = np.nan
        return points, numbers[:, 0]

    def markers(
        self, names_row: int, axes_row: int, columns: Sequence[int]
    ) -> dict[str, list[int]]:
        """
        Find columns X, Y, Z of each marker, by its name, which stands above X at least.

        Repeated names are numbered. Raises BagError for other axes.
        """
        names: list[str] = []
        triples = [[0, 0, 0]]
        for column in columns:
            axis = self.cell(axes_row, column)
            if axis == 'X' and len(triples[-1]) == 3:
                names.append(self.cell(names_row, column) or f'marker {len(names) + 1}')
                triples.append([column])
            elif len(triples[-1]) < 3 and axis == 'XYZ'[len(triples[-1])]:
                triples[-1].append(column)
            else:
                break
        if len(triples[-1]) < 3 or len(columns) > 3 * len(names):
            name = names[-1] if names else self.cell(names_row, columns[0]) if columns else ''
            raise BagError(
                f"{self.path}, line {self.lines[axes_row]}: marker '{_cells.shown(name)}' has "
                'other columns than X, Y, Z; fix: export it again'
            )
        names = _cells.number_names(self.path, names, self.notes)
        return dict(zip(names, triples[1:], strict=True))


def _judge_last_number(cell: str, above: Sequence[str]) -> tuple[bool, bool]:
    """Return whether a number may be cut off, and is shorter than those above it in its column."""
    own, *others = (text.strip().lower().replace(',', '.') for text in (cell, *above))
    if own == 'nan':
        return False, False
    decimals = len(own.partition('.')[2])
    number, before = _cells.number_or_inf(own), _cells.number_or_inf(others[-1] if others else '')
    if own.isdecimal() and number == before + 1:
        return False, False  # the number of a frame
    counts = [len(text.partition('.')[2]) for text in others if _cells.NUMBER.fullmatch(text)]
    is_short = not counts or 'e' in own or decimals < max(1, min(counts))
    return is_short or decimals < max(counts), is_short


def _single_spaced(line: str) -> str:
    """Put one space between cells; numpy puts a # before the names of columns."""
    return ' '.join(line.removeprefix('#').split()) + '\n'
