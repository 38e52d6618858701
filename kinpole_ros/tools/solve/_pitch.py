"""Pitch curves: a pair of centrodes as a table, or drawn true to scale for a saw or a mill."""

from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import Centrodes, LinkageError
from kinpole_ros.planar._plane import Complex
from kinpole_ros.tools.solve._dxf import LayerLine, LayerText, write_dxf
from kinpole_ros.tools.solve._solution import open_output
from kinpole_ros.tools.solve._spreadsheet import write_columns

# In sizes of the linkage: a drawing ends here; ends of a curve nearer than this meet.
_MOST_DISTANT, _MEETING = 3.0, 1e-6
# Sizes in the drawing, mm: its margin, the arms of an axis and of a pin's cross, a line, a letter.
_MARGIN, _AXIS, _PIN, _LINE, _LETTER = 10.0, 8.0, 2.0, 0.25, 4.0


class _Sheet(NamedTuple):
    """
    One body's curve in mm, y upward: `lines` (each (n,) complex, and whether it is closed) and
    `pins` (complex), from an origin that is at `x` on the paper.
    """

    body: str
    lines: list[tuple[Complex, bool]]
    pins: Complex
    x: float

    def marks(self) -> Iterator[Complex]:
        """A cross for each pin and the axes of the frame, as lines."""
        for pin in self.pins:
            yield np.array([pin - _PIN, pin + _PIN])
            yield np.array([pin - 1j * _PIN, pin + 1j * _PIN])
        yield np.array([0, _AXIS], complex)
        yield np.array([0, 1j * _AXIS])

    def labels(self) -> tuple[tuple[complex, str], ...]:
        """Letters and their positions."""
        return (
            (complex(_AXIS + 1, -_LETTER / 2), 'x'),
            (complex(-_LETTER / 2, _AXIS + 1), 'y'),
            (complex(0, -_AXIS - _LETTER), self.body),
        )


def write_pitch_curves(path: str | Path, curves: Centrodes) -> None:
    """
    Write both centrodes to a file, by its suffix a table or a drawing.

    A CSV, in SI units, has a row for each sample with a center. SVG and DXF (R12, in mm) are true
    to scale: the curve in the frame of `one` and to its right that of `other`, with the axes of the
    frames and the pins of the bodies. A curve ends where the center is more than 3 sizes of the
    linkage away, and is closed where its ends meet. Raises LinkageError for another suffix, and
    SceneError for a file that cannot be written.
    """
    path = Path(path)
    write = {'.csv': _table, '.dxf': _dxf, '.svg': _svg}.get(path.suffix.lower())
    if write is None:
        raise LinkageError(f'{path} is no pitch curves; end its name in one of csv, dxf, svg')
    with open_output(path) as part:
        write(part, curves)


def _table(path: Path, curves: Centrodes) -> None:
    columns = {
        'input': curves.at,
        'fixed_x': curves.fixed.real,
        'fixed_y': curves.fixed.imag,
        'moving_x': curves.moving.real,
        'moving_y': curves.moving.imag,
        'arc_length': curves.fixed_length,
        'piece': curves.piece,
    }
    exists = curves.piece >= 0
    write_columns(path, {name: column[exists] for name, column in columns.items()})


def _sheets(curves: Centrodes) -> tuple[list[_Sheet], complex, complex]:
    """Both curves side by side, and the lower left and upper right corner of the paper."""
    near = np.minimum(np.abs(curves.fixed), np.abs(curves.moving)) < _MOST_DISTANT * curves.size
    number = np.where(near, curves.piece, -1)
    # A drawn piece that leaves the paper and comes back is two lines.
    breaks = np.flatnonzero(np.diff(number)) + 1
    runs = [run for run in np.split(np.arange(len(number)), breaks) if number[run[0]] >= 0]
    sheets, edge, low, high = [], _MARGIN, -_AXIS - _LETTER, _AXIS + _LETTER
    for name, points, pins in (
        (curves.one, curves.fixed, curves.pins[0]),
        (curves.other, curves.moving, curves.pins[1]),
    ):
        lines = _chained([1e3 * points[run] for run in runs], 1e3 * _MEETING * curves.size)
        drawn = np.concatenate([line for line, _ in lines] + [1e3 * pins])
        x = edge - min(drawn.real.min(), -_AXIS)
        sheets.append(_Sheet(name, lines, 1e3 * pins, x))
        edge = x + max(drawn.real.max(), 2 * _AXIS) + _MARGIN
        low, high = min(low, drawn.imag.min()), max(high, drawn.imag.max())
    return sheets, complex(0.0, low - _MARGIN), complex(edge, high + _MARGIN)


def _chained(pieces: list[Complex], near: float) -> list[tuple[Complex, bool]]:
    """Pieces as lines, and whether they are closed; over a turn the last may continue the first."""
    if len(pieces) > 1 and abs(pieces[-1][-1] - pieces[0][0]) < near:
        pieces = [np.concatenate((pieces[-1], pieces[0][1:])), *pieces[1:-1]]
    closed = [len(piece) > 3 and bool(abs(piece[-1] - piece[0]) < near) for piece in pieces]
    return [
        (piece[:-1] if meets else piece, meets) for piece, meets in zip(pieces, closed, strict=True)
    ]


def _svg(path: Path, curves: Centrodes) -> None:
    sheets, low, high = _sheets(curves)
    width, height = high.real, high.imag - low.imag
    text = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{height:.4f}mm" '
        f'viewBox="0 {-high.imag:.4f} {width:.4f} {height:.4f}">',
        f'<title>Centrodes of {escape(curves.one)} and {escape(curves.other)}, in mm</title>',
    ]
    for sheet in sheets:
        text.append(f'<g id="{escape(sheet.body)}" transform="translate({sheet.x:.4f} 0)">')
        for line, closed in [*sheet.lines, *((line, False) for line in sheet.marks())]:
            # y points downward in a picture.
            points = ' L '.join(f'{p.real:.4f} {0.0 - p.imag:.4f}' for p in line)
            text.append(
                f'<path d="M {points}{" Z" if closed else ""}" fill="none" stroke="black" '
                f'stroke-width="{_LINE}"/>'
            )
        text += [
            f'<text x="{at.real}" y="{-at.imag}" font-size="{_LETTER}">{escape(label)}</text>'
            for at, label in sheet.labels()
        ]
        text.append('</g>')
    path.write_text('\n'.join([*text, '</svg>']) + '\n', encoding='utf-8')


def _dxf(path: Path, curves: Centrodes) -> None:
    sheets, low, _ = _sheets(curves)
    lines: list[LayerLine] = []
    texts: list[LayerText] = [('UNITS', low + _MARGIN, 'in mm')]
    for sheet in sheets:
        axes = f'{sheet.body}_axes'
        lines += [(sheet.body, line + sheet.x, closed) for line, closed in sheet.lines]
        lines += [(axes, line + sheet.x, False) for line in sheet.marks()]
        texts += [(axes, at + sheet.x, label) for at, label in sheet.labels()]
    write_dxf(path, f'Centrodes of {curves.one} and {curves.other}, in mm', lines, texts, _LETTER)
