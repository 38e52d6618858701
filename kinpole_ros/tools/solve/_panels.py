"""
Drawings to scale, as SVG or by matplotlib: panels of lines, arrows and labels that do not overlap.

Coordinates of a drawing are pixels, complex, with y downward. A panel maps its own unit to them.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

# Pixels: margins of a panel, heights of its title and footer, font sizes, and the arrowhead.
_MARGIN, _TITLE, _FOOTER = 26.0, 34.0, 40.0
_FONT, _SMALL_FONT = 13.0, 9.5
_ARROWHEAD = 9.0
# By style: color, width, dashes, and whether it is an arrow.
STYLES: dict[str, tuple[str, float, str, bool]] = {
    'link': ('#7a838c', 3.0, '', False),
    'former': ('#7a838c', 1.6, '7 4', False),
    'shape': ('#9aa3ab', 1.0, '', False),
    'construction': ('#9aa3ab', 0.8, '9 3 2 3', False),
    'absolute': ('#1c2127', 1.8, '', True),
    'relative': ('#0060a8', 1.8, '', True),
    'normal': ('#a83200', 1.4, '6 3', True),
    'tangential': ('#00785a', 1.4, '6 3', True),
    'Coriolis': ('#7a4fa0', 1.4, '6 3', True),
    'slide': ('#8a6100', 1.4, '6 3', True),
    'winding': ('#0060a8', 1.4, '6 3', True),
    'fixed': ('#c08a2b', 3.0, '', False),
    'moving': ('#0060a8', 1.5, '6 3', False),
    'inflection': ('#00785a', 1.6, '', False),
    'ray': ('#0060a8', 1.3, '', False),
    'axis': ('#a83200', 1.8, '8 4', False),
    'angle': ('#7a4fa0', 1.3, '', False),
    'bar': ('#1c2127', 1.4, '', False),
    'point': ('#1c2127', 1.0, '', False),
}
# Candidate positions of a label around its anchor: directions, and distances of its edge, px.
_DIRECTIONS = np.exp(1j * np.arange(16) * np.pi / 8)
_DISTANCES = np.array([5.0, 11.0, 19.0, 30.0, 44.0, 62.0, 84.0])
# Fractions of an arrow at which its label may be.
_ARROW_ANCHORS = np.array([0.5, 0.35, 0.65])
# Costs of a label that overlaps another one, leaves its panel, or lies on a line, per 4 px.
_OVERLAP_COST, _OUTSIDE_COST, _LINE_COST = 1e5, 1e4, 3.0


class Line(NamedTuple):
    """A line, arrow or single point, px."""

    points: np.ndarray
    style: str
    name: str = ''


class Label(NamedTuple):
    """Text centered `at` a point, px; 'v_{BA}^{n}' has a subscript and a superscript."""

    text: str
    at: complex
    style: str
    anchor: complex


@dataclass
class Panel:
    """
    A box of a drawing, from `low` to `high`, in which one `unit` is `scale` px long.

    `order` is the order of the derivative that its vectors are. `rate` is the length, in this unit,
    of one unit of vectors drawn into a picture of another unit.
    """

    title: str
    unit: str
    low: complex
    high: complex
    order: int = 0
    scale: float = 1.0
    rate: float = 1.0
    shift: complex = 0j
    lines: list[Line] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)
    _unplaced: list[tuple[str, np.ndarray, str]] = field(default_factory=list)

    def fit(self, points: Sequence[complex] | np.ndarray) -> None:
        """Choose the largest scale at which all points are in the box."""
        points = np.asarray(points, complex)
        points = points[np.isfinite(points)]
        x, y = (np.array([z.min(), z.max()]) for z in (points.real, points.imag))
        free = self.high - self.low - complex(2 * _MARGIN, _TITLE + _FOOTER + 2 * _MARGIN)
        with np.errstate(divide='ignore'):
            self.scale = float(min(free.real / np.ptp(x), free.imag / np.ptp(y)))
        if not np.isfinite(self.scale):
            self.scale = 1.0
        middle = (self.low + self.high + 1j * (_TITLE - _FOOTER)) / 2
        self.shift = middle - self.scale * complex(x.sum(), y.sum()).conjugate() / 2

    def pixels(self, points: complex | Sequence[complex] | np.ndarray) -> np.ndarray:
        """Return points of the panel's unit in px."""
        return self.shift + self.scale * np.conj(np.atleast_1d(np.asarray(points, complex)))

    def line(self, points: Sequence[complex] | np.ndarray, style: str, name: str = '') -> None:
        """Draw a line or an arrow with its label; skip an arrow without length."""
        ends = self.pixels(points)
        if STYLES[style][3] and abs(ends[-1] - ends[0]) < 1e-6:
            return
        self.lines.append(Line(ends, style, name))
        if name:
            self._unplaced.append((name, ends[0] + (ends[-1] - ends[0]) * _ARROW_ANCHORS, style))

    def point(self, z: complex, name: str) -> None:
        """Draw a point with its label."""
        self.lines.append(Line(self.pixels(z), 'point'))
        self._unplaced.append((name, self.pixels(z), 'point'))

    def scale_bar(self, note: str = '') -> None:
        """Draw a bar of a round number of units, with a note."""
        size = round_down((self.high - self.low).real / 4 / self.scale)
        start = complex(self.low.real + _MARGIN, self.high.imag - 14)
        end = start + size * self.scale
        self.lines.append(Line(np.array([start, end]), 'bar', 'scale'))
        self.lines += [Line(z + np.array([-4j, 4j]), 'bar') for z in (start, end)]
        for text in (f'{size:.12g} {self.unit}', note):
            at = end + 8 + width_of(text) / 2
            self.labels.append(Label(text, at, 'point', at))
            end += 16 + width_of(text)

    def place_labels(self) -> None:
        """Put each label near its anchor, off other labels and, where possible, off lines."""
        dots = np.concatenate([_every_4_px(line.points) for line in self.lines] or [np.zeros(0)])
        # Points first: arrows have more anchors.
        for text, anchors, style in sorted(self._unplaced, key=lambda one: len(one[1])):
            half = _half_size(text)
            edge = np.maximum(
                np.abs(_DIRECTIONS.real) / half.real, np.abs(_DIRECTIONS.imag) / half.imag
            )
            offsets = ((_DISTANCES[:, None] + 1 / edge) * _DIRECTIONS).ravel()
            at = (anchors[:, None] + offsets).ravel()
            cost = np.tile(np.repeat(_DISTANCES, len(_DIRECTIONS)), len(anchors))
            cost += np.repeat([0.0, 4.0, 4.0][: len(anchors)], offsets.size)
            distance = dots - at[:, None]
            on_line = (np.abs(distance.real) < half.real) & (np.abs(distance.imag) < half.imag)
            cost += _LINE_COST * on_line.sum(axis=1)
            for label in self.labels:
                sizes = half + _half_size(label.text)
                distance = at - label.at
                overlaps = np.abs(distance.real) < sizes.real
                cost += _OVERLAP_COST * (overlaps & (np.abs(distance.imag) < sizes.imag))
            low, high = at - half, at + half
            outside = (low.real < self.low.real + 2) | (high.real > self.high.real - 2)
            outside |= (low.imag < self.low.imag + _TITLE) | (high.imag > self.high.imag - 24)
            best = int(np.argmin(cost + _OUTSIDE_COST * outside))
            anchor = complex(anchors[best // offsets.size])
            self.labels.append(Label(text, complex(at[best]), style, anchor))
        self._unplaced.clear()


def round_down(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(k for k in (1, 2, 5) if k * power <= value))


def width_of(text: str) -> float:
    """Return about how wide a text is, px."""
    plain = re.sub(r'[_^]\{[^}]*\}', '', text)
    small = ''.join(re.findall(r'[_^]\{([^}]*)\}', text))
    return 0.62 * (_FONT * len(plain) + _SMALL_FONT * len(small)) + 2


def _half_size(text: str) -> complex:
    return complex(width_of(text), _FONT + 3) / 2


def _every_4_px(points: np.ndarray) -> np.ndarray:
    """Return points along a line, every 4 px."""
    if len(points) < 2:
        return points
    length = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(points)))))
    at = np.linspace(0, length[-1], int(min(length[-1], 4000) / 4) + 2)
    return np.interp(at, length, points.real) + 1j * np.interp(at, length, points.imag)


def _arrowhead(points: np.ndarray) -> np.ndarray:
    """Return a triangle that ends where the arrow does."""
    vector = points[-1] - points[0]
    back = vector / abs(vector) * min(_ARROWHEAD, 0.6 * abs(vector))
    return points[-1] - back * np.array([0, 1 + 0.34j, 1 - 0.34j])


def _leader(label: Label) -> np.ndarray | None:
    """Return a line from the anchor to a label that is far from it."""
    half, vector = _half_size(label.text), label.anchor - label.at
    if not vector:
        return None
    edge = vector / max(abs(vector.real) / half.real, abs(vector.imag) / half.imag, 1e-9)
    is_far = abs(vector) - abs(edge) > _DISTANCES[2] - 1
    return np.array([label.anchor, label.at + edge]) if is_far else None


def write_drawing(path: Path, kind: str, title: str, panels: Sequence[Panel]) -> None:
    """Write panels as one drawing: 'svg' as text, other formats by matplotlib."""
    for panel in panels:
        panel.place_labels()
    size = complex(max(p.high.real for p in panels), max(p.high.imag for p in panels))
    if kind == 'svg':
        path.write_text(svg_of(title, size, panels), encoding='utf-8')
    else:
        _save_figure(path, kind, title, size, panels)


def svg_of(title: str, size: complex, panels: Sequence[Panel]) -> str:
    """Return panels with labels in place as the text of an SVG."""
    rows = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size.real:g} {size.imag:g}" '
        f'width="{size.real:g}" height="{size.imag:g}" font-family="DejaVu Sans, Verdana, '
        f'sans-serif" font-size="{_FONT:g}" text-anchor="middle">',
        f'<title>{escape(title)}</title>',
        '<rect width="100%" height="100%" fill="#ffffff"/>',
    ]
    for panel in panels:
        middle = (panel.low.real + panel.high.real) / 2
        rows += [
            f'<g data-order="{panel.order}" data-unit="{escape(panel.unit)}" '
            f'data-scale="{panel.scale:.15g}" data-rate="{panel.rate:.15g}">',
            f'<text x="{middle:g}" y="{panel.low.imag + 20:g}" font-weight="bold">'
            f'{escape(panel.title)}</text>',
            *(_svg_line(line) for line in panel.lines),
            *(_svg_label(label) for label in panel.labels),
            '</g>',
        ]
    return '\n'.join([*rows, '</svg>', ''])


def svg_points(points: np.ndarray, digits: int) -> str:
    """Return points (n,), px, complex, as an attribute of a polyline."""
    return ' '.join(f'{z.real:.{digits}f},{z.imag:.{digits}f}' for z in points)


def _svg_line(line: Line) -> str:
    color, width, dashes, is_arrow = STYLES[line.style]
    if len(line.points) == 1:
        z = line.points[0]
        return f'<circle cx="{z.real:.6f}" cy="{z.imag:.6f}" r="3" fill="{color}"/>'
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ''
    named = f' data-name="{escape(line.name)}"' if line.name else ''
    element = (
        f'<polyline class="{line.style}"{named} points="{svg_points(line.points, 6)}" fill="none" '
        f'stroke="{color}" stroke-width="{width}"{dashed}/>'
    )
    if is_arrow:
        corners = svg_points(_arrowhead(line.points), 3)
        element += f'\n<polygon points="{corners}" fill="{color}"/>'
    return element


def _svg_label(label: Label) -> str:
    color, spans, baseline = STYLES[label.style][0], '', 0.0
    for plain, mark, small in re.findall(r'([^_^]+)|([_^])\{([^}]*)\}', label.text):
        shift = 0.0 if plain else 3.5 if mark == '_' else -5.0
        size = '' if plain else f' font-size="{_SMALL_FONT:g}"'
        spans += f'<tspan dy="{shift - baseline:g}"{size}>{escape(plain or small)}</tspan>'
        baseline = shift
    element = (
        f'<text x="{label.at.real:.1f}" y="{label.at.imag + 0.36 * _FONT:.1f}" fill="{color}" '
        f'stroke="#ffffff" stroke-width="3" paint-order="stroke">{spans}</text>'
    )
    if (leader := _leader(label)) is None:
        return element
    ends = svg_points(leader, 1)
    return f'<polyline points="{ends}" stroke="{color}" stroke-width="0.6"/>\n{element}'


def _save_figure(path: Path, kind: str, title: str, size: complex, panels: Sequence[Panel]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(size.real / 100, size.imag / 100))
    draw_panels(figure, size, panels)
    figure.savefig(path, format=kind, dpi=200, metadata={'Title': title} if kind == 'png' else None)


def draw_panels(figure: Any, size: complex, panels: Sequence[Panel]) -> Any:
    """Draw panels with labels in place over a figure of matplotlib; return its axes, in px."""
    from matplotlib.patheffects import withStroke

    axis = figure.add_axes((0, 0, 1, 1))
    axis.set(xlim=(0, size.real), ylim=(size.imag, 0))
    axis.axis('off')
    point = 0.72  # typographic points per px
    text: dict[str, Any] = {'ha': 'center', 'va': 'center', 'fontsize': point * _FONT}
    halo = [withStroke(linewidth=2.2, foreground='white')]
    for panel in panels:
        middle, top = (panel.low.real + panel.high.real) / 2, panel.low.imag + 16
        axis.text(middle, top, panel.title, weight='bold', parse_math=False, **text)
        for line in panel.lines:
            color, width, dashes, is_arrow = STYLES[line.style]
            axis.plot(
                line.points.real,
                line.points.imag,
                color=color,
                linewidth=point * width,
                linestyle=(0, [float(d) / width for d in dashes.split()]) if dashes else '-',
                marker='o' if len(line.points) == 1 else '',
                markersize=point * 6,
                solid_capstyle='butt',
            )
            if is_arrow:
                corners = _arrowhead(line.points)
                axis.fill(corners.real, corners.imag, color=color, linewidth=0)
        for label in panel.labels:
            color = STYLES[label.style][0]
            if (leader := _leader(label)) is not None:
                axis.plot(leader.real, leader.imag, color=color, linewidth=0.4)
            words = _mathtext(label.text)
            axis.text(label.at.real, label.at.imag, words, color=color, path_effects=halo, **text)
    return axis


def _mathtext(text: str) -> str:
    """Return a label for matplotlib, in upright letters."""
    words = re.sub(r'([$%#&])', r'\\\1', text)
    if '{' not in text:
        return words
    words = re.sub(
        r'\{([^}]*)\}', lambda m: '{' + m[1].replace('_', r'\_').replace(' ', r'\ ') + '}', words
    )
    return f'$\\mathdefault{{{words}}}$'
