"""
Drawings to scale: panels of lines, arrows and names that do not cover each other, as SVG or PNG.

Coordinates of a sheet are pixels, complex, with y downward. A panel maps its own unit to them.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

_MARGIN, _TITLE, _FOOT = 26.0, 34.0, 40.0
_LETTER, _SMALL = 13.0, 9.5
_HEAD = 9.0  # length of an arrow's head
# Of each style: color, width, dashes, and whether it is an arrow.
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
    'fixed': ('#c08a2b', 3.0, '', False),
    'moving': ('#0060a8', 1.5, '6 3', False),
    'bar': ('#1c2127', 1.4, '', False),
    'point': ('#1c2127', 1.0, '', False),
}
# Where a name may stand: directions, and distances of its nearest edge, px.
_AROUND = np.exp(1j * np.arange(16) * np.pi / 8)
_FAR = np.array([5.0, 11.0, 19.0, 30.0, 44.0, 62.0, 84.0])
# Where along an arrow its name may be.
_ALONG = np.array([0.5, 0.35, 0.65])
# Costs of a name that covers another, leaves its panel, lies on a line or away from its place.
_COVERS, _OUTSIDE, _ON_LINE = 1e5, 1e4, 3.0


class _Line(NamedTuple):
    points: np.ndarray
    style: str
    name: str = ''


class _Name(NamedTuple):
    """Text at its middle; 'v_{BA}^{n}' has an index and an exponent. It belongs to `of`."""

    text: str
    at: complex
    style: str
    of: complex


@dataclass
class Panel:
    """
    A box of a sheet, `low` to `high`, in which one unit is `scale` px long.

    `order` and `unit` tell what its vectors are; one unit of those drawn into a picture of another
    unit is `rate` of this. `lines` are in px, `names` where they were put.
    """

    title: str
    unit: str
    low: complex
    high: complex
    order: int = 0
    scale: float = 1.0
    rate: float = 1.0
    shift: complex = 0j
    lines: list[_Line] = field(default_factory=list)
    names: list[_Name] = field(default_factory=list)
    _wanted: list[tuple[str, np.ndarray, str]] = field(default_factory=list)

    def fit(self, points: Sequence[complex] | np.ndarray) -> None:
        """Choose the largest scale at which all points are in the box."""
        every = np.asarray(points, complex)
        every = every[np.isfinite(every)]
        ends = [every.real.min(), every.real.max(), every.imag.min(), every.imag.max()]
        room = self.high - self.low - complex(2 * _MARGIN, _TITLE + _FOOT + 2 * _MARGIN)
        with np.errstate(divide='ignore'):
            self.scale = float(min(room.real / np.ptp(ends[:2]), room.imag / np.ptp(ends[2:])))
        if not np.isfinite(self.scale):
            self.scale = 1.0
        middle = (self.low + self.high + 1j * (_TITLE - _FOOT)) / 2
        center = complex(ends[0] + ends[1], ends[2] + ends[3]) / 2
        self.shift = middle - self.scale * center.conjugate()

    def px(self, points: complex | Sequence[complex] | np.ndarray) -> np.ndarray:
        """Points of the panel's unit in px."""
        return self.shift + self.scale * np.conj(np.atleast_1d(np.asarray(points, complex)))

    def line(self, points: Sequence[complex] | np.ndarray, style: str, name: str = '') -> None:
        """Draw a line or arrow, and ask for a name at it; an arrow of no length is none."""
        ends = self.px(points)
        if STYLES[style][3] and abs(ends[-1] - ends[0]) < 1e-6:
            return
        self.lines.append(_Line(ends, style, name))
        if name:
            self._wanted.append((name, ends[0] + (ends[-1] - ends[0]) * _ALONG, style))

    def point(self, z: complex, name: str) -> None:
        """Draw a point with its name."""
        self.lines.append(_Line(self.px(z), 'point'))
        self.name(z, name)

    def name(self, z: complex, text: str, style: str = 'point') -> None:
        """Ask for a name at a point."""
        self._wanted.append((text, self.px(z), style))

    def bar(self, more: str = '') -> None:
        """Draw the bar of the scale, a round number of units; `more` is written beside it."""
        size = (self.high - self.low).real / 4 / self.scale
        ten = 10 ** np.floor(np.log10(size))
        size = ten * max(k for k in (1, 2, 5) if k * ten <= size)
        start = complex(self.low.real + _MARGIN, self.high.imag - 14)
        self.lines.append(_Line(start + np.array([0, size * self.scale]), 'bar', 'scale'))
        for end in (start, start + size * self.scale):
            self.lines.append(_Line(end + np.array([-4j, 4j]), 'bar'))
        for text in (f'{size:.12g} {self.unit}', more):
            at = start + size * self.scale + 8 + width_of(text) / 2
            self.names.append(_Name(text, at, 'point', at))
            start += 16 + width_of(text)

    def place_names(self) -> None:
        """Put each name near its place, where it covers neither names nor, if it can be, lines."""
        steps = [_dense(line.points) for line in self.lines]
        dots = np.concatenate(steps) if steps else np.zeros(0, complex)
        taken = [_box(name.at, name.text) for name in self.names]
        # Points first: arrows have more places for theirs.
        for text, anchors, style in sorted(self._wanted, key=lambda one: len(one[1])):
            half = complex(width_of(text), _LETTER + 3) / 2
            reach = 1 / np.maximum(
                np.abs(_AROUND.real) / half.real, np.abs(_AROUND.imag) / half.imag
            )
            away = (_FAR[:, None] + reach) * _AROUND
            at = (anchors[:, None] + away.ravel()).ravel()
            cost = np.tile(np.repeat(_FAR, len(_AROUND)), len(anchors))
            cost = cost + np.repeat([0.0, 4.0, 4.0][: len(anchors)], away.size)
            low, high = at - half, at + half
            inside = (np.abs((dots - at[:, None]).real) < half.real) & (
                np.abs((dots - at[:, None]).imag) < half.imag
            )
            cost = cost + _ON_LINE * inside.sum(axis=1)
            for one, other in taken:
                over = (low.real < other.real) & (high.real > one.real)
                over &= (low.imag < other.imag) & (high.imag > one.imag)
                cost = cost + _COVERS * over
            out = (low.real < self.low.real + 2) | (high.real > self.high.real - 2)
            out |= (low.imag < self.low.imag + _TITLE) | (high.imag > self.high.imag - 24)
            best = int(np.argmin(cost + _OUTSIDE * out))
            self.names.append(
                _Name(text, complex(at[best]), style, complex(anchors[best // away.size]))
            )
            taken.append(_box(at[best], text))
        self._wanted.clear()


def width_of(text: str) -> float:
    """About how wide a text is, px."""
    plain = re.sub(r'[_^]\{[^}]*\}', '', text)
    small = ''.join(re.findall(r'[_^]\{([^}]*)\}', text))
    return 0.62 * (_LETTER * len(plain) + _SMALL * len(small)) + 2


def _box(at: complex, text: str) -> tuple[complex, complex]:
    half = complex(width_of(text), _LETTER + 3) / 2
    return at - half, at + half


def _dense(points: np.ndarray) -> np.ndarray:
    """Points of a line, every 4 px."""
    if len(points) < 2:
        return points
    length = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(points)))))
    at = np.linspace(0, length[-1], int(min(length[-1], 4000) / 4) + 2)
    return np.interp(at, length, points.real) + 1j * np.interp(at, length, points.imag)


def _arrow(points: np.ndarray) -> np.ndarray:
    """Its head: a triangle that ends where the arrow does."""
    way = points[-1] - points[0]
    back = way / abs(way) * min(_HEAD, 0.6 * abs(way))
    return points[-1] - back * np.array([0, 1 + 0.34j, 1 - 0.34j])


def write_sheet(path: Path, kind: str, title: str, panels: Sequence[Panel]) -> None:
    """Write panels as one drawing of that kind; 'svg' is written as text, others by matplotlib."""
    for panel in panels:
        panel.place_names()
    size = complex(max(p.high.real for p in panels), max(p.high.imag for p in panels))
    if kind == 'svg':
        path.write_text(_svg(title, size, panels), encoding='utf-8')
    else:
        _draw(path, kind, title, size, panels)


def _svg(title: str, size: complex, panels: Sequence[Panel]) -> str:
    rows = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size.real:g} {size.imag:g}" '
        f'width="{size.real:g}" height="{size.imag:g}" font-family="DejaVu Sans, Verdana, '
        f'sans-serif" font-size="{_LETTER:g}" text-anchor="middle">',
        f'<title>{escape(title)}</title>',
        '<rect width="100%" height="100%" fill="#ffffff"/>',
    ]
    for panel in panels:
        middle = (panel.low.real + panel.high.real) / 2
        rows.append(
            f'<g data-order="{panel.order}" data-unit="{escape(panel.unit)}" '
            f'data-scale="{panel.scale:.15g}" data-rate="{panel.rate:.15g}">'
        )
        rows.append(
            f'<text x="{middle:g}" y="{panel.low.imag + 20:g}" font-weight="bold">'
            f'{escape(panel.title)}</text>'
        )
        for line in panel.lines:
            rows += _svg_line(line)
        for name in panel.names:
            rows += _svg_name(name)
        rows.append('</g>')
    return '\n'.join([*rows, '</svg>', ''])


def _svg_line(line: _Line) -> list[str]:
    color, width, dashes, arrow = STYLES[line.style]
    if len(line.points) == 1:
        z = line.points[0]
        return [f'<circle cx="{z.real:.6f}" cy="{z.imag:.6f}" r="3" fill="{color}"/>']
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ''
    named = f' data-name="{escape(line.name)}"' if line.name else ''
    ends = ' '.join(f'{z.real:.6f},{z.imag:.6f}' for z in line.points)
    rows = [
        f'<polyline class="{line.style}"{named} points="{ends}" fill="none" stroke="{color}" '
        f'stroke-width="{width}"{dashed}/>'
    ]
    if arrow:
        corners = ' '.join(f'{z.real:.3f},{z.imag:.3f}' for z in _arrow(line.points))
        rows.append(f'<polygon points="{corners}" fill="{color}"/>')
    return rows


def _svg_name(name: _Name) -> list[str]:
    color = STYLES[name.style][0]
    text, lift = '', 0.0
    for plain, mark, small in re.findall(r'([^_^]+)|([_^])\{([^}]*)\}', name.text):
        to = 0.0 if plain else 3.5 if mark == '_' else -5.0
        size = '' if plain else f' font-size="{_SMALL:g}"'
        text += f'<tspan dy="{to - lift:g}"{size}>{escape(plain or small)}</tspan>'
        lift = to
    rows = []
    if (lead := _leader(name)) is not None:
        ends = ' '.join(f'{z.real:.1f},{z.imag:.1f}' for z in lead)
        rows.append(f'<polyline points="{ends}" stroke="{color}" stroke-width="0.6"/>')
    rows.append(
        f'<text x="{name.at.real:.1f}" y="{name.at.imag + 0.36 * _LETTER:.1f}" fill="{color}" '
        f'stroke="#ffffff" stroke-width="3" paint-order="stroke">{text}</text>'
    )
    return rows


def _leader(name: _Name) -> np.ndarray | None:
    """A line from what a name belongs to, where that is not next to it."""
    half = complex(width_of(name.text), _LETTER + 3) / 2
    way = name.of - name.at
    if not way:
        return None
    edge = way / max(abs(way.real) / half.real, abs(way.imag) / half.imag, 1e-9)
    return np.array([name.of, name.at + edge]) if abs(way) - abs(edge) > _FAR[2] - 1 else None


def _draw(path: Path, kind: str, title: str, size: complex, panels: Sequence[Panel]) -> None:
    from matplotlib.figure import Figure
    from matplotlib.patheffects import withStroke

    figure = Figure(figsize=(size.real / 100, size.imag / 100))
    axis = figure.add_axes((0, 0, 1, 1))
    axis.set(xlim=(0, size.real), ylim=(size.imag, 0))
    axis.axis('off')
    point = 0.72  # of a px
    halo = [withStroke(linewidth=2.2, foreground='white')]
    for panel in panels:
        middle = (panel.low.real + panel.high.real) / 2
        style: dict[str, Any] = {'ha': 'center', 'va': 'center', 'fontsize': point * _LETTER}
        axis.text(
            middle, panel.low.imag + 16, panel.title, weight='bold', parse_math=False, **style
        )
        for line in panel.lines:
            color, width, dashes, arrow = STYLES[line.style]
            x, y = line.points.real, line.points.imag
            pattern = (0, [point * float(d) / width / point for d in dashes.split()])
            axis.plot(
                x,
                y,
                color=color,
                linewidth=point * width,
                linestyle=pattern if dashes else '-',
                marker='o' if len(x) == 1 else '',
                markersize=point * 6,
                solid_capstyle='butt',
            )
            if arrow:
                corners = _arrow(line.points)
                axis.fill(corners.real, corners.imag, color=color, linewidth=0)
        for name in panel.names:
            color = STYLES[name.style][0]
            if (lead := _leader(name)) is not None:
                axis.plot(lead.real, lead.imag, color=color, linewidth=0.4)
            axis.text(
                name.at.real,
                name.at.imag,
                _math(name.text),
                color=color,
                path_effects=halo,
                **style,
            )
    figure.savefig(path, format=kind, dpi=200, metadata={'Title': title} if kind == 'png' else None)


def _math(text: str) -> str:
    """The same for matplotlib, in upright letters."""
    words = re.sub(r'([$%#&])', r'\\\1', text)
    if '{' not in text:
        return words
    inner = re.sub(
        r'\{([^}]*)\}', lambda m: '{' + m[1].replace('_', r'\_').replace(' ', r'\ ') + '}', words
    )
    return f'$\\mathdefault{{{inner}}}$'
