"""Drawings for CAD as DXF, in mm: polylines and letters on layers, and a linkage with its paths."""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from kinpole_ros.planar._plane import Complex
from kinpole_ros.tools.solve._shapes import SceneLines
from kinpole_ros.tools.solve._solution import SolvedScene, point_motions

# The layer, points (n,), mm, and whether the last is joined to the first; the layer, a point, text.
LayerLine = tuple[str, Complex, bool]
LayerText = tuple[str, complex, str]
# The height of letters, and of the cross of a point, as shares of the drawing's size.
_LETTER, _CROSS = 0.02, 0.01


def write_dxf(
    path: Path, comment: str, lines: Iterable[LayerLine], texts: Iterable[LayerText], letter: float
) -> None:
    """
    Write R12, which every program reads; it has no units, so that a comment and a text say mm.

    `letter` is the height of the letters, mm.
    """
    rows: list[tuple[int, str]] = [(999, comment), (0, 'SECTION'), (2, 'ENTITIES')]
    for name, points, closed in lines:
        on = (8, _layer(name))
        rows += [(0, 'POLYLINE'), on, (66, '1'), *_coordinates(0j), (70, str(int(closed)))]
        for point in points:
            rows += [(0, 'VERTEX'), on, *_coordinates(point)]
        rows += [(0, 'SEQEND'), on]
    for name, at, text in texts:
        rows += [(0, 'TEXT'), (8, _layer(name)), *_coordinates(at), (40, f'{letter:g}'), (1, text)]
    rows += [(0, 'ENDSEC'), (0, 'EOF')]
    data = ''.join(f'{code}\n{value}\n' for code, value in rows)
    path.write_text(data, encoding='ascii', errors='replace')


def _layer(name: str) -> str:
    return re.sub('[^A-Z0-9_-]', '_', name.upper())[:31]


def _coordinates(z: complex) -> list[tuple[int, str]]:
    return [(10, f'{z.real:.6f}'), (20, f'{z.imag:.6f}'), (30, '0.0')]


def write_linkage(path: Path, motion: SolvedScene, here: SolvedScene) -> None:
    """
    Write a scene at the first position of `here`, and the paths of its points over the motion.

    Each body has a layer, and so have what is between bodies, 'spans', and the path of each point,
    'path_BODY_POINT'. Lengths are in mm.
    """
    lines: list[LayerLine] = []
    for line in SceneLines(motion).at(here):
        is_closed = bool(len(line.points) > 3 and abs(line.points[-1] - line.points[0]) < 1e-12)
        points = line.points[: len(line.points) - is_closed]
        lines.append((line.body or 'spans', 1e3 * points, is_closed))
    paths = {name: 1e3 * z[0] for name, z in point_motions(motion).items()}
    ends = np.concatenate([*(points for _, points, _ in lines), *paths.values()])
    size = float(np.hypot(np.ptp(ends.real), np.ptp(ends.imag)))
    for name, points in paths.items():
        closes = bool(abs(points[0] - points[-1]) < 1e-9 * size)
        lines.append((f'path_{name}', points[: len(points) - closes], closes))
    at = {name: 1e3 * complex(z[0, 0]) for name, z in point_motions(here).items()}
    on_ground = {n: 1e3 * z for n, (_, z) in here.scene.points.items() if n not in at}
    cross = _CROSS * size * np.array([-1, 1])
    for z in on_ground.values():
        lines += [('ground', z + cross, False), ('ground', z + 1j * cross, False)]
    letter = _LETTER * size
    texts = [
        (here.scene.points[name][0], z + letter * (0.4 + 0.4j), name.rpartition('.')[2])
        for name, z in (at | on_ground).items()
    ]
    low = complex(ends.real.min(), ends.imag.min() - 2 * letter)
    title = f'{here.scene.name}, in mm'
    write_dxf(path, title, lines, [*texts, ('units', low, 'in mm')], letter)
