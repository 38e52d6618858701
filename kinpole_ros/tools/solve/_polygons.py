"""The velocity and acceleration polygons of `kinpole solve --polygon`, beside the linkage."""

import re
from pathlib import Path

import numpy as np

from kinpole_ros.mechanism import Polygon, SceneError, polygon
from kinpole_ros.tools.solve._lines import table_lines
from kinpole_ros.tools.solve._sheet import Panel, write_sheet
from kinpole_ros.tools.solve._solved import Solved

_HEIGHT, _WIDTHS = 620.0, (460.0, 560.0, 560.0)
_TITLES = ('linkage', 'velocities', 'accelerations')
_UNITS = ('m', 'm/s', 'm/s²')
_LETTERS = ('', 'v', 'a')
_MARKS = {'normal': 'n', 'tangential': 't', 'Coriolis': 'C', 'slide': 's'}
# Of the largest vector, shorter ones are rounding.
_ZERO = 1e-9

# Name, what it is a part of or whether it is absolute, where it starts, and the vector.
Arrow = tuple[str, str, complex, complex]


def arrows_of(figure: Polygon) -> list[Arrow]:
    """All arrows of a polygon: absolute and relative vectors, and the parts of these."""
    letter = _LETTERS[figure.order]
    size = max([abs(z) for z in figure.points.values()] + [abs(s.vector) for s in figure.sides])
    found: list[Arrow] = []
    for side in figure.sides:
        of = f'{letter}_{{{side.name}}}'
        if abs(side.vector) > _ZERO * size and not any(
            abs(tail - side.tail) + abs(vector - side.vector) < _ZERO * size
            for _, _, tail, vector in found
        ):
            style = 'absolute' if abs(side.tail) <= _ZERO * size else 'relative'
            found.append((of, style, side.tail, side.vector))
    for name, z in figure.points.items():
        if abs(z) > _ZERO * size and not any(
            abs(tail) + abs(vector - z) < _ZERO * size for _, _, tail, vector in found
        ):
            found.append((f'{letter}_{{{name.replace(", ", "=")}}}', 'absolute', 0j, z))
    for side in figure.sides:
        parts = {what: z for what, z in side.parts.items() if abs(z) > _ZERO * size}
        tail = side.tail
        for what, part in parts.items() if len(parts) > 1 else ():
            found.append((f'{letter}_{{{side.name}}}^{{{_MARKS[what]}}}', what, tail, part))
            tail += part
    return found


def polygon_lines(solved: Solved) -> list[str]:
    """A row for each arrow of both polygons."""
    lines = []
    for figure in _polygons(solved)[1:]:
        rows = [
            [re.sub('[{}]', '', name), what, abs(z), np.degrees(np.angle(z)), z.real, z.imag]
            for name, what, _, z in arrows_of(figure)
        ]
        unit = _UNITS[figure.order]
        head = ['vector', 'is', unit, 'deg', f'x {unit}', f'y {unit}']
        lines += ['', *table_lines(head, rows)] if rows else []
    return lines


def draw_polygons(path: Path, kind: str, solved: Solved) -> None:
    """Draw the linkage and both polygons at the first position, to scale."""
    title = f'{solved.scene.name}: velocity and acceleration polygons'
    write_sheet(path, kind, title, polygon_panels(solved))


def polygon_panels(solved: Solved) -> list[Panel]:
    """The linkage, the velocities and the accelerations."""
    left, panels = 0.0, []
    for figure, width in zip(_polygons(solved), _WIDTHS, strict=True):
        low, high = complex(left, 0), complex(left + width, _HEIGHT)
        panel = Panel(_TITLES[figure.order], _UNITS[figure.order], low, high, figure.order)
        if figure.order:
            _draw_polygon(panel, figure)
        else:
            _draw_linkage(panel, figure, not solved.scene.mechanism.assembly.joints)
        panels.append(panel)
        left += width
    return panels


def _polygons(solved: Solved) -> list[Polygon]:
    found = [polygon(solved.scene, solved.motion, order) for order in range(3)]
    if not all(np.isfinite(side.head) for one in found for side in one.sides):
        raise SceneError(
            'there is no polygon in a dead point, where the drivers do not tell how it moves: give '
            'a value next to it'
        )
    return found


def _draw_linkage(panel: Panel, figure: Polygon, loops: bool) -> None:
    """The links, and the points by name; in loop form the vectors by name."""
    ends = [z for side in figure.sides for z in (side.tail, side.head)]
    panel.fit([*figure.points.values(), *ends])
    for shape in figure.shapes:
        panel.line([*shape, shape[0]], 'shape')
    for side in figure.sides:
        # In loop form vectors have names, and their ends have none.
        name = side.name if loops else ''
        panel.line([side.tail, side.head], 'link' if side.body else 'former', name)
    for name, z in figure.points.items():
        panel.point(z, name)
    panel.bar()


def _draw_polygon(panel: Panel, figure: Polygon) -> None:
    arrows, lines = arrows_of(figure), _construction(figure)
    ends = [z for _, _, tail, vector in arrows for z in (tail, tail + vector)]
    panel.fit([0j, *figure.points.values(), *ends, *(z for line in lines for z in line)])
    panel.title += f', 1 {panel.unit} = {panel.scale:.4g} px' if arrows else ': none, it is at rest'
    for shape in figure.shapes:
        panel.line([*shape, shape[0]], 'shape')
    for line in lines:
        panel.line(line, 'construction')
    for name, style, tail, vector in arrows:
        panel.line([tail, tail + vector], style, name)
    at_pole = next((f'pole: {name}' for name, z in figure.points.items() if not z), 'pole')
    panel.point(0j, at_pole)
    for name, z in figure.points.items():
        if z:
            panel.point(z, name)
    if not arrows:
        return
    used = {style for _, style, *_ in arrows}
    panel.bar('; '.join(f'{mark}: {what}' for what, mark in _MARKS.items() if what in used))


def _construction(figure: Polygon) -> list[tuple[complex, complex]]:
    """Where several vectors end in one point, the lines that meet there."""
    reach = 0.12 * max((abs(z) for z in figure.points.values()), default=0.0)
    near = _ZERO * reach
    found = []
    for side in figure.sides:
        last = [part for part in side.parts.values() if abs(part) > near][-1:]
        if last and sum(abs(other.head - side.head) <= near for other in figure.sides) > 1:
            way = reach * last[0] / abs(last[0])
            found.append((side.head - last[0] - way, side.head + way))
    return found
