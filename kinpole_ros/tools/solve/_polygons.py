"""The velocity and acceleration polygons of `kinpole solve --polygon`, and the linkage."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import Polygon, SceneError, polygon
from kinpole_ros.tools.solve._panels import Panel
from kinpole_ros.tools.solve._shapes import DrawnLine, SceneLines
from kinpole_ros.tools.solve._solution import SolvedScene
from kinpole_ros.tools.solve._text import Row, table_lines

_HEIGHT, _WIDTHS = 620.0, (460.0, 560.0, 560.0)  # px
# By the order of the derivative.
_TITLES = ('linkage', 'velocities', 'accelerations')
_UNITS = ('m', 'm/s', 'm/s²')
_LETTERS = ('', 'v', 'a')
_MARKS = {'normal': 'n', 'tangential': 't', 'Coriolis': 'C', 'slide': 's', 'winding': 'w'}
# Vectors shorter than this fraction of the largest one are rounding.
_ROUNDING = 1e-9


class Arrow(NamedTuple):
    """A vector of a polygon; `kind` is absolute, relative, or the component that it is."""

    name: str
    kind: str
    tail: complex
    vector: complex


def arrows_of(figure: Polygon) -> list[Arrow]:
    """Return the absolute and relative vectors of a polygon, and the components of these."""
    letter = _LETTERS[figure.order]
    lengths = [abs(z) for z in figure.points.values()] + [abs(s.vector) for s in figure.sides]
    rounding = _ROUNDING * max(lengths)
    arrows: list[Arrow] = []

    def add(name: str, kind: str, tail: complex, vector: complex) -> None:
        is_known = any(
            abs(arrow.tail - tail) + abs(arrow.vector - vector) < rounding for arrow in arrows
        )
        if abs(vector) > rounding and not is_known:
            arrows.append(Arrow(f'{letter}_{{{name}}}', kind, tail, vector))

    for side in figure.sides:
        kind = 'absolute' if abs(side.tail) <= rounding else 'relative'
        add(side.name, kind, side.tail, side.vector)
    for name, z in figure.points.items():
        add(name.replace(', ', '='), 'absolute', 0j, z)
    for side in figure.sides:
        components = {kind: z for kind, z in side.parts.items() if abs(z) > rounding}
        tail = side.tail
        for kind, vector in components.items() if len(components) > 1 else ():
            name = f'{letter}_{{{side.name}}}^{{{_MARKS[kind]}}}'
            arrows.append(Arrow(name, kind, tail, vector))
            tail += vector
    return arrows


def polygon_lines(solution: SolvedScene) -> list[str]:
    """Return a table of the arrows of both polygons."""
    lines = []
    for figure in _polygons(solution)[1:]:
        rows: list[Row] = [
            [re.sub('[{}]', '', name), kind, abs(z), np.degrees(np.angle(z)), z.real, z.imag]
            for name, kind, _, z in arrows_of(figure)
        ]
        unit = _UNITS[figure.order]
        head = ['vector', 'is', unit, 'deg', f'x {unit}', f'y {unit}']
        lines += ['', *table_lines(head, rows)] if rows else []
    return lines


def polygon_panels(solution: SolvedScene, drawn: SceneLines) -> list[Panel]:
    """Return panels, to scale, of linkage, velocities and accelerations at the first position."""
    edge, panels = 0.0, []
    for figure, width in zip(_polygons(solution), _WIDTHS, strict=True):
        low, high = complex(edge, 0), complex(edge + width, _HEIGHT)
        panel = Panel(_TITLES[figure.order], _UNITS[figure.order], low, high, figure.order)
        if figure.order:
            _draw_polygon(panel, figure)
        else:
            _draw_linkage(
                panel, figure, drawn.at(solution), not solution.scene.mechanism.assembly.joints
            )
        panels.append(panel)
        edge += width
    return panels


def _polygons(solution: SolvedScene) -> list[Polygon]:
    polygons = [polygon(solution.scene, solution.motion, order) for order in range(3)]
    if not all(np.isfinite(side.head) for figure in polygons for side in figure.sides):
        raise SceneError(
            'there is no polygon in a dead point, where the drivers do not determine the motion; '
            'give a value next to it'
        )
    return polygons


def _draw_linkage(
    panel: Panel, figure: Polygon, lines: Sequence[DrawnLine], has_vectors: bool
) -> None:
    """Draw the links and named points; in a scene of vectors, the vectors have the names."""
    ends = [z for side in figure.sides for z in (side.tail, side.head)]
    panel.fit(np.concatenate([[*figure.points.values(), *ends], *(one.points for one in lines)]))
    for line in lines:
        panel.line(line.points, 'former' if line.kind == 'guide' else 'shape')
    for side in figure.sides:
        name = side.name if has_vectors else ''
        panel.line([side.tail, side.head], 'link' if side.body else 'former', name)
    for name, z in figure.points.items():
        panel.point(z, name)
    panel.scale_bar()


def _draw_polygon(panel: Panel, figure: Polygon) -> None:
    arrows, lines = arrows_of(figure), _construction_lines(figure)
    ends = [z for arrow in arrows for z in (arrow.tail, arrow.tail + arrow.vector)]
    panel.fit([0j, *figure.points.values(), *ends, *(z for line in lines for z in line)])
    panel.title += f', 1 {panel.unit} = {panel.scale:.4g} px' if arrows else ': none, it is at rest'
    for shape in figure.shapes:
        panel.line([*shape, shape[0]], 'shape')
    for line in lines:
        panel.line(line, 'construction')
    for name, kind, tail, vector in arrows:
        panel.line([tail, tail + vector], kind, name)
    at_pole = next((f'pole: {name}' for name, z in figure.points.items() if not z), 'pole')
    panel.point(0j, at_pole)
    for name, z in figure.points.items():
        if z:
            panel.point(z, name)
    if arrows:
        kinds = {arrow.kind for arrow in arrows}
        panel.scale_bar(
            '; '.join(f'{mark}: {kind}' for kind, mark in _MARKS.items() if kind in kinds)
        )


def _construction_lines(figure: Polygon) -> list[tuple[complex, complex]]:
    """Return the lines that intersect where several vectors end in one point."""
    overhang = 0.12 * max((abs(z) for z in figure.points.values()), default=0.0)
    rounding = _ROUNDING * overhang
    lines = []
    for side in figure.sides:
        last = [z for z in side.parts.values() if abs(z) > rounding][-1:]
        meeting = sum(abs(one.head - side.head) <= rounding for one in figure.sides)
        if last and meeting > 1:
            along = overhang * last[0] / abs(last[0])
            lines.append((side.head - last[0] - along, side.head + along))
    return lines
