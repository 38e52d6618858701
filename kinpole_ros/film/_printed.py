"""A sheet of tags to print: A4, as SVG or PDF, to scale."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.files import whole_file
from kinpole_ros.film._decoder import FilmError
from kinpole_ros.film._families import FAMILIES, codes, family_of, tag_count

_PAGE = (210.0, 297.0)  # mm
_MARGIN = 12.0  # mm, which printers leave white
_HEADER = 12.0  # mm, for the scale
_QUIET = 1.5  # modules of white on each side, and at least
_LABEL = 3.0  # mm; the height of a line of text
_CHECK = 100.0  # mm, the length of the line by which the print is checked
_SEAM = 0.01  # mm that rows of modules overlap
_CUT = 0.75  # gray of the lines along which tags are cut out


class _Mark(NamedTuple):
    """A rectangle in mm from the top left of the page, and its gray; or a text at x, y."""

    x: float
    y: float
    width: float = 0.0
    height: float = 0.0
    gray: float = 0.0
    text: str = ''


def print_sheet(path: str | Path, size: float, family: str = 'auto') -> int:
    """
    Write a sheet of tags of a size, m, as .svg or .pdf: one for the ground and two a link.

    Returns their number. Raises FilmError if not three tags fit, or there is no such family.
    """
    family = family_of(family) or next(iter(FAMILIES))
    most = (tag_count(family) - 1) // 2 * 2 + 1
    marks, places = _header(size, family), sheet_places(size)[:most]
    drawn = codes(family, range(len(places)))
    module = size * 1e3 / len(drawn[0])
    half_cell = _cell(size) / 2
    for number, (x, y) in enumerate(places):
        name = 'ground' if number == 0 else f'link {(number + 1) // 2}'
        for side in (-half_cell, half_cell):  # the lines along which it is cut out
            marks.append(_Mark(x + side, y - half_cell, 0.1, 2 * half_cell, _CUT))
            marks.append(_Mark(x - half_cell, y + side, 2 * half_cell, 0.1, _CUT))
        left, top = x - size * 500, y - size * 500
        marks.append(_Mark(left, top + size * 1e3 + _LABEL, text=f'{number}  {name}'))
        for row, column, length in _runs(drawn[number] == 0):
            mark = left + column * module, top + row * module, length * module, module + _SEAM
            marks.append(_Mark(*mark))
    text = _pdf(marks) if Path(path).suffix.lower() == '.pdf' else _svg(marks).encode()
    with whole_file(path) as part:
        part.write_bytes(text)
    return len(places)


def _cell(size: float) -> float:
    """Return the side, mm, of the paper that a tag is cut out with."""
    return size * 1e3 * (1 + 2 * _QUIET / 8) + 2 * _LABEL


def sheet_places(size: float) -> list[tuple[float, float]]:
    """Return the centers (x, y) of the tags on the sheet, mm from its top left."""
    cell = _cell(size)
    columns = int((_PAGE[0] - 2 * _MARGIN) // cell)
    rows = int((_PAGE[1] - 2 * _MARGIN - _HEADER) // cell)
    count = (columns * rows - 1) // 2 * 2 + 1  # one for the ground, and pairs
    if count < 3:
        raise FilmError(
            f'--size is {size * 1e3:g} mm; three tags must fit on A4; fix: 80 mm or less'
        )
    count = min(count, 51)
    top = _MARGIN + _HEADER + cell / 2
    return [
        (_MARGIN + cell * (k % columns + 0.5), top + cell * (k // columns)) for k in range(count)
    ]


def _header(size: float, family: str) -> list[_Mark]:
    line = _MARGIN, _MARGIN + 2 * _LABEL
    text = (
        f'{family}, {size * 1e3:g} mm: print at 100%. This line is {_CHECK:g} mm long. Film the '
        'uncut sheet to calibrate a camera.'
    )
    return [_Mark(*line, _CHECK, 0.3), _Mark(_MARGIN, _MARGIN + _LABEL, text=text)]


def _runs(black: np.ndarray) -> list[tuple[int, int, int]]:
    """Return row, first column and length of the runs of black modules."""
    edges = np.diff(np.pad(black.astype(int), ((0, 0), (1, 1))), axis=1)
    starts, ends = np.argwhere(edges == 1), np.argwhere(edges == -1)
    return [(int(r), int(c), int(e - c)) for (r, c), (_, e) in zip(starts, ends, strict=True)]


def _svg(marks: list[_Mark]) -> str:
    width, height = _PAGE
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}" shape-rendering="crispEdges">',
        f'<rect width="{width:g}" height="{height:g}" fill="#fff"/>',
    ]
    for x, y, w, h, gray, text in marks:
        at = f'x="{x:.4f}" y="{y:.4f}"'
        if text:
            lines.append(f'<text {at} font-family="sans-serif" font-size="{_LABEL}">{text}</text>')
        else:
            fill = f'#{round(255 * gray):02x}' + f'{round(255 * gray):02x}' * 2
            lines.append(f'<rect {at} width="{w:.4f}" height="{h:.4f}" fill="{fill}"/>')
    return '\n'.join([*lines, '</svg>', ''])


def _pdf(marks: list[_Mark]) -> bytes:
    point = 72 / 25.4  # of a mm
    width, height = (side * point for side in _PAGE)
    content = [f'{point:.6f} 0 0 {point:.6f} 0 0 cm']
    for x, y, w, h, gray, text in marks:
        if text:
            content.append(f'0 g BT /F {_LABEL} Tf {x:.4f} {_PAGE[1] - y:.4f} Td ({text}) Tj ET')
        else:
            content.append(f'{gray:g} g {x:.4f} {_PAGE[1] - y - h:.4f} {w:.4f} {h:.4f} re f')
    stream = '\n'.join(content)
    objects = [
        '<< /Type /Catalog /Pages 2 0 R >>',
        '<< /Type /Pages /Kids [3 0 R] /Count 1 >>',
        f'<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.3f} {height:.3f}] /Contents 4 0 R '
        '/Resources << /Font << /F 5 0 R >> >> >>',
        f'<< /Length {len(stream)} >>\nstream\n{stream}\nendstream',
        '<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>',
    ]
    text, places = '%PDF-1.4\n', []
    for number, body in enumerate(objects, 1):
        places.append(len(text))
        text += f'{number} 0 obj\n{body}\nendobj\n'
    table = ''.join(f'{place:010d} 00000 n \n' for place in places)
    count = len(objects) + 1
    text += (
        f'xref\n0 {count}\n0000000000 65535 f \n{table}trailer\n<< /Size {count} /Root 1 0 R >>\n'
        f'startxref\n{len(text)}\n%%EOF\n'
    )
    return text.encode('ascii')
