"""Pitch curves: a pair of centrodes as a table, or drawn true to scale for a saw or a mill."""

import csv
import re
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.files import whole_file
from kinpole_ros.mechanism._centrodes import Centrodes
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.planar._plane import Complex

# In sizes of the linkage: a drawing ends here; ends of a curve nearer than this meet.
_SHOWN, _MEET = 3.0, 1e-6
# Of the drawing, mm: its margin, the arms of an axis and of a pin's cross, a line, a letter.
_MARGIN, _AXIS, _PIN, _LINE, _LETTER = 10.0, 8.0, 2.0, 0.25, 4.0


class _Sheet(NamedTuple):
    """
    One body's curve in mm, y upward: `lines` (each (n,) complex, and whether it is closed) and
    `pins` (complex) from an origin that is at `left` on the paper.
    """

    body: str
    lines: list[tuple[Complex, bool]]
    pins: Complex
    left: float


def write_pitch_curves(path: str | Path, curves: Centrodes) -> None:
    """
    Write both centrodes to a file, by its suffix a table or a drawing.

    Parameters
    ----------
    path
        CSV, in SI units: input, fixed_x, fixed_y, moving_x, moving_y, arc_length, piece; a row per
        sample that has a center. SVG and DXF (R12, in mm), true to scale: the curve in the frame of
        `one` and to its right that of `other`, with the axes x and y of the frames and the pins of
        the bodies; it ends where the center is more than 3 sizes of the linkage away, and is closed
        where its ends meet.
    curves
        What `centrodes` gives.

    Raises
    ------
    LinkageError
        For another suffix and for a file that cannot be written.

    """
    path = Path(path)
    writers = {'.csv': _table, '.dxf': _dxf, '.svg': _svg}
    write = writers.get(path.suffix.lower())
    if write is None:
        raise LinkageError(f'{path} is no pitch curves; end its name in one of csv, dxf, svg')
    try:
        with whole_file(path) as part:
            write(part, curves)
    except OSError as error:
        raise LinkageError(
            f'{path} cannot be written: {error.strerror}; '
            'fix: check the path, its rights and the space on the disk'
        ) from error


def _table(path: Path, curves: Centrodes) -> None:
    with open(path, 'w', newline='', encoding='utf-8') as file:
        rows = csv.writer(file)
        names = 'input fixed_x fixed_y moving_x moving_y arc_length piece'
        rows.writerow(names.split())
        columns = (
            curves.at,
            curves.fixed.real,
            curves.fixed.imag,
            curves.moving.real,
            curves.moving.imag,
            curves.fixed_length,
            curves.piece,
        )
        there = curves.piece >= 0
        rows.writerows(zip(*(column[there].tolist() for column in columns), strict=True))


def _sheets(curves: Centrodes) -> tuple[list[_Sheet], complex, complex]:
    """Both curves side by side, and the lower left and upper right corner of the paper."""
    near = np.minimum(np.abs(curves.fixed), np.abs(curves.moving)) < _SHOWN * curves.size
    number = np.where(near, curves.piece, -1)
    # Where a drawn piece leaves the paper and comes back it is two lines.
    breaks = np.flatnonzero(np.diff(number)) + 1
    runs = [run for run in np.split(np.arange(len(number)), breaks) if number[run[0]] >= 0]
    sheets, left, low, high = [], _MARGIN, -_AXIS - _LETTER, _AXIS + _LETTER
    for name, points, pins in (
        (curves.one, curves.fixed, curves.pins[0]),
        (curves.other, curves.moving, curves.pins[1]),
    ):
        lines = _chained([1e3 * points[run] for run in runs], 1e3 * _MEET * curves.size)
        drawn = np.concatenate([line for line, _ in lines] + [1e3 * pins])
        shift = left - min(drawn.real.min(), -_AXIS)
        sheets.append(_Sheet(name, lines, 1e3 * pins, shift))
        left = shift + max(drawn.real.max(), 2 * _AXIS) + _MARGIN
        low, high = min(low, drawn.imag.min()), max(high, drawn.imag.max())
    return sheets, complex(0.0, low - _MARGIN), complex(left, high + _MARGIN)


def _chained(pieces: list[Complex], near: float) -> list[tuple[Complex, bool]]:
    """Pieces as lines, and whether they are closed; over a turn the last may go on as the first."""
    if len(pieces) > 1 and abs(pieces[-1][-1] - pieces[0][0]) < near:
        pieces = [np.concatenate((pieces[-1], pieces[0][1:])), *pieces[1:-1]]
    closed = [len(piece) > 3 and bool(abs(piece[-1] - piece[0]) < near) for piece in pieces]
    return [
        (piece[:-1] if meets else piece, meets) for piece, meets in zip(pieces, closed, strict=True)
    ]


def _marks(sheet: _Sheet) -> Iterator[Complex]:
    """A cross for each pin and the axes of the frame, as lines."""
    for pin in sheet.pins:
        yield np.array([pin - _PIN, pin + _PIN])
        yield np.array([pin - 1j * _PIN, pin + 1j * _PIN])
    yield np.array([0, _AXIS], complex)
    yield np.array([0, 1j * _AXIS])


def _labels(sheet: _Sheet) -> tuple[tuple[complex, str], ...]:
    """Letters and where they begin."""
    return (
        (complex(_AXIS + 1, -_LETTER / 2), 'x'),
        (complex(-_LETTER / 2, _AXIS + 1), 'y'),
        (complex(0, -_AXIS - _LETTER), sheet.body),
    )


def _svg(path: Path, curves: Centrodes) -> None:
    sheets, low, high = _sheets(curves)
    parts = []
    for sheet in sheets:
        parts.append(f'<g id="{escape(sheet.body)}" transform="translate({sheet.left:.4f} 0)">')
        parts += [_path(line, closed) for line, closed in sheet.lines]
        parts += [_path(line, False) for line in _marks(sheet)]
        parts += [
            f'<text x="{at.real}" y="{-at.imag}" font-size="{_LETTER}">{escape(text)}</text>'
            for at, text in _labels(sheet)
        ]
        parts.append('</g>')
    width, height = high.real, high.imag - low.imag
    text = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{height:.4f}mm" '
        f'viewBox="0 {-high.imag:.4f} {width:.4f} {height:.4f}">',
        f'<title>Centrodes of {escape(curves.one)} and {escape(curves.other)}, in mm</title>',
        *parts,
        '</svg>',
    ]
    path.write_text('\n'.join(text) + '\n', encoding='utf-8')


def _path(points: Complex, closed: bool) -> str:
    # y points downward in a picture.
    places = ' L '.join(f'{p.real:.4f} {0.0 - p.imag:.4f}' for p in points)
    end = ' Z' if closed else ''
    return f'<path d="M {places}{end}" fill="none" stroke="black" stroke-width="{_LINE}"/>'


def _dxf(path: Path, curves: Centrodes) -> None:
    """R12, which every program reads; it knows no units, so a comment and a text say mm."""
    sheets, low, _ = _sheets(curves)
    rows: list[tuple[int, str]] = [(999, f'Centrodes of {curves.one} and {curves.other}, in mm')]
    rows += [(0, 'SECTION'), (2, 'ENTITIES')]
    for sheet in sheets:
        layer = re.sub('[^A-Z0-9_-]', '_', sheet.body.upper())[:26]
        lines = [(line, closed, layer) for line, closed in sheet.lines]
        lines += [(line, False, f'{layer}_AXES') for line in _marks(sheet)]
        for line, closed, on in lines:
            rows += [(0, 'POLYLINE'), (8, on), (66, '1'), *_place(0j), (70, str(int(closed)))]
            for point in line + sheet.left:
                rows += [(0, 'VERTEX'), (8, on), *_place(point)]
            rows += [(0, 'SEQEND'), (8, on)]
        for at, text in _labels(sheet):
            rows += [(0, 'TEXT'), (8, f'{layer}_AXES'), *_place(at + sheet.left)]
            rows += [(40, f'{_LETTER}'), (1, text)]
    rows += [(0, 'TEXT'), (8, 'UNITS'), *_place(low + _MARGIN), (40, f'{_LETTER}')]
    rows += [(1, 'in mm'), (0, 'ENDSEC'), (0, 'EOF')]
    text = ''.join(f'{code}\n{value}\n' for code, value in rows)
    path.write_text(text, encoding='ascii', errors='replace')


def _place(z: complex) -> list[tuple[int, str]]:
    return [(10, f'{z.real:.6f}'), (20, f'{z.imag:.6f}'), (30, '0.0')]
