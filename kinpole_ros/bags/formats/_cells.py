"""Cells of text files as numbers and names, and the limits of how many are held."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.files import printable

MOST_COLUMNS = 10_000
# Cells of a file, and two more for each row: 1e6 frames of 10 markers in space, and times.
MOST_CELLS = 33_000_000
NUMBER = re.compile(r'[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[+-]?[0-9]+)?|nan)', re.I | re.A)
_SHOWN = 40  # characters of a cell in a message
_SLICE_ROWS = 1 << 16  # that are looked at together


def number_in(cell: str) -> float:
    """Return a number of a file's head, maybe with a decimal comma; 0 where there is none."""
    number = number_or_inf(cell.strip().replace(',', '.'))
    return number if math.isfinite(number) else 0.0


def shown(text: str) -> str:
    """Return text of a file for a message: cut, and harmless to a terminal."""
    return printable(text if len(text) <= _SHOWN else f'{text[:_SHOWN]}...')


def listed(texts: Sequence[str]) -> str:
    """Return the first five texts for a message, and how many more there are."""
    ending = f' and {len(texts) - 5} more' if len(texts) > 5 else ''
    return f'{", ".join(texts[:5])}{ending}'


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
    Make names differ, NAME, NAME_2, NAME_3, and note where that was needed.

    Raises BagError where there are none.
    """
    check_names(path, names)
    taken, counts = set(names), dict.fromkeys(names, 0)
    unique, numbered = [], []
    for name in names:
        counts[name] += 1
        new_name = name
        if counts[name] > 1:
            while (new_name := f'{name}_{counts[name]}') in taken:
                counts[name] += 1
            taken.add(new_name)
            numbered.append(f"'{shown(new_name)}'")
        unique.append(new_name)
    if numbered:
        notes.append(
            f'{path} has several markers of one name; they are numbered: {listed(numbered)}'
        )
    return unique


def whole_numbers(path: Path, numbers: np.ndarray, lines: Sequence[int], name: str) -> np.ndarray:
    """Return frame numbers (T,) as int64; raises BagError when they are not, or do not rise."""
    frames = np.empty(len(numbers), np.int64)
    # In slices, since there can be millions.
    for first in range(0, len(numbers), _SLICE_ROWS):
        part = slice(first, first + _SLICE_ROWS)
        frames[part] = np.rint(np.nan_to_num(numbers[part], nan=-1.0))
        bad = ~(np.abs(frames[part] - numbers[part]) < 1e-6)
        with_previous = frames[max(0, first - 1) : part.stop]
        bad[len(bad) - len(with_previous) + 1 :] |= np.diff(with_previous) <= 0
        if bad.any():
            row = first + int(bad.argmax())
            raise BagError(
                f'{path}, line {lines[row]}, column {name}: {numbers[row]:.10g} is not the number '
                'of a frame after the one before; fix: a number for each frame, in order'
            )
    return frames


def numbers_or_inf(cells: Sequence[str], have_decimal_commas: bool) -> list[float]:
    """Return the numbers of cells, NaN where they are empty, infinity where they are no numbers."""
    text = ''.join(cells)
    if have_decimal_commas and ',' in text:
        cells = [cell.replace(',', '.') for cell in cells]
    if text.isascii() and '_' not in text:
        # All else that float takes and NUMBER does not is infinite.
        try:
            return [float(cell) if cell else math.nan for cell in cells]
        except ValueError:
            pass
    return [number_or_inf(cell.strip() or 'nan') for cell in cells]


def is_decimal(cell: str) -> bool:
    return bool(NUMBER.fullmatch(cell.strip().replace(',', '.')))


def number_or_inf(cell: str) -> float:
    """Return a number in ASCII digits, or NaN; infinity for text such as 1_000 or Arabic digits."""
    return float(cell) if NUMBER.fullmatch(cell) else math.inf
