"""
The picture of `kinpole solve --plot`: the linkage with velocities and centers, and rates over time.

It is readable in black and white: lines differ by dashes and markers too.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from kinpole_ros import planar
from kinpole_ros.mechanism import poles
from kinpole_ros.mechanism._kennedy import center_name
from kinpole_ros.tools.plot._style import Box, box_of, saved_figure
from kinpole_ros.tools.solve import _solution
from kinpole_ros.tools.solve._shapes import BODY_COLORS, DrawnLine, SceneLines
from kinpole_ros.tools.solve._solution import SolvedScene

_SIZE, _DPI = (12.5, 6.2), 150  # inches
_DASHES: tuple[Any, ...] = ('-', '--', '-.', ':', (0, (5, 1, 1, 1, 1, 1)))
# In sizes of the linkage: the longest velocity arrow, and how far off a center is drawn.
_ARROW, _CENTER_DISTANCE = 0.35, 1.2
_TITLE_WIDTH = 60  # characters
# Widths, in points, and the order from back to front of lines by their kind.
_WIDTHS = {
    'guide': (2.4, 2),
    'span': (1.3, 2),
    'contour': (1.5, 3),
    'wheel': (1.5, 3),
    'link': (2.4, 3),
}
# A path with a larger radius of curvature, in sizes of the linkage, is straight.
_STRAIGHT = 100
# Rates that differ by less than this fraction are constant.
_CONSTANT = 1e-6


def draw_solution(
    output: str | Path,
    solution: SolvedScene,
    here: SolvedScene,
    centers: bool,
    centrodes: Sequence[str],
    inflection: Sequence[str],
) -> None:
    """
    Draw to `output` the linkage at the one position `here`, and the rates over the motion.

    With `centers`, also its instant centers; of the bodies in `centrodes`, also their centrodes; of
    those in `inflection`, how the paths of their points are curved.
    """
    with saved_figure(output, _SIZE, _DPI) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.35, 1))
        axis = figure.add_subplot(grid[:, 0])
        draw_linkage(axis, solution, here, centers, centrodes, inflection)
        _draw_rates(figure, grid, solution, here)


def _draw_rates(figure: Any, grid: Any, solution: SolvedScene, here: SolvedScene) -> None:
    at, mark, label, title = _abscissa(solution, here)
    rates = _solution.angle_rates(solution.motion)
    names = 'angular velocity (rad/s)', 'angular acceleration (rad/s²)'
    for row, name in enumerate(names):
        axis = figure.add_subplot(grid[row, 1])
        for b, body in enumerate(solution.scene.mechanism.bodies):
            axis.plot(at, rates[row + 1, b], label=body, linewidth=1.4, **_style(b))
        axis.axvline(mark, color='#999999', linewidth=0.8)
        _set_limits(axis, rates[row + 1])
        axis.set(ylabel=name, xlabel=label if row else '')
        axis.grid(alpha=0.3)
        if not row:
            axis.legend(fontsize=8, ncols=2)
    # A scene has the name of its file, which need not be text.
    scene = os.fsencode(solution.scene.name).decode(errors='replace')
    figure.suptitle(f'{scene} {title}', parse_math=False)


def _style(b: int) -> dict[str, Any]:
    """Return the style of the lines of body number `b`."""
    return {'linestyle': _DASHES[b % len(_DASHES)], 'color': BODY_COLORS[b % len(BODY_COLORS)]}


def _abscissa(solution: SolvedScene, here: SolvedScene) -> tuple[np.ndarray, float, str, str]:
    """Return the abscissa of the rates (T,), where `here` is on it, its name, and a title."""
    if solution.times is not None:
        return solution.times, 0.0, 'time (s)', 'at 0 s'
    unit, size = _solution.driver_unit(solution.scene, 0)
    at = solution.inputs[0] / size
    value = float(here.inputs[0, 0]) / size
    is_full_turn = unit == 'deg' and at[-1] - at[0] > 359
    mark = at[0] + (value - at[0]) % 360 if is_full_turn else value
    label = f'{solution.scene.mechanism.drivers[0].name} ({unit})'
    rate = f'{solution.rates[0, 0] / size:.4g} {unit}/s'
    return at, mark, label, f'at {label} = {value:.6g}, driven at {rate}'


def _set_limits(axis: Any, values: np.ndarray) -> None:
    """Cut off rates that go to infinity at limits, and do not magnify rounding."""
    values = values[np.isfinite(values)]
    if not len(values):
        return
    largest, usual = np.abs(values).max(), np.percentile(np.abs(values), 90)
    if np.ptp(values) <= _CONSTANT * largest:
        middle = values.mean()
        margin = 0.2 * (abs(middle) or 1.0)
        axis.set_ylim(middle - margin, middle + margin)
    elif largest > 20 * usual > 0:
        axis.set_ylim(-4 * usual, 4 * usual)


def _body_points(solution: SolvedScene) -> dict[str, list[np.ndarray]]:
    """Return the points of each body as `point_motions` does, or its origin."""
    scene, bodies = solution.scene, solution.scene.mechanism.bodies
    points: dict[str, list[np.ndarray]] = {body: [] for body in bodies}
    for name, motion in _solution.point_motions(solution).items():
        points[scene.points[name][0]].append(motion)
    for b, body in enumerate(bodies):
        if not points[body]:
            points[body].append(solution.motion.position[:3, b])
    return points


def draw_linkage(
    axis: Any,
    solution: SolvedScene,
    here: SolvedScene,
    centers: bool,
    centrodes: Sequence[str] = (),
    inflection: Sequence[str] = (),
) -> None:
    """Draw the linkage at the one position `here`, and the paths of its points."""
    scene, bodies = solution.scene, solution.scene.mechanism.bodies
    ground = np.array([z for body, z in scene.points.values() if body not in bodies])
    body_points, lines = _body_points(here), SceneLines(solution).at(here)
    paths = [motion[0] for motions in _body_points(solution).values() for motion in motions]
    motions = [motion for motions in body_points.values() for motion in motions]
    drawn = [*paths, *(motion[0] for motion in motions), *(line.points for line in lines)]
    box = box_of(np.concatenate([*drawn, ground + 0j]))
    size = max(abs(box.high - box.low), 1e-9)
    fastest = max((abs(motion[1, 0]) for motion in motions), default=0.0)
    arrows = [
        (z, z + velocity / fastest * _ARROW * size)
        for z, velocity in (motion[:2, 0] for motion in motions)
        if abs(velocity) > 1e-3 * fastest
    ]
    box = box.with_points([tip for _, tip in arrows])
    for path in paths:
        axis.plot(path.real, path.imag, color='#bbbbbb', linewidth=0.8, zorder=1)
    for line in lines:
        _draw_line(axis, line, bodies)
    for b, body in enumerate(bodies):
        z, color = np.array([motion[0, 0] for motion in body_points[body]]), _style(b)['color']
        axis.plot(z.real, z.imag, 'o', color=color, markersize=4, zorder=3)
        link = [line.points for line in lines if (line.kind, line.body) == ('link', body)]
        _annotate(axis, body, (link or [z])[0].mean(), (4, 4), color=color, fontsize=9, zorder=5)
    for tail, tip in arrows:
        axis.annotate(
            '',
            (tip.real, tip.imag),
            (tail.real, tail.imag),
            zorder=4,
            arrowprops={'arrowstyle': '->', 'color': '#444444', 'linewidth': 1.1},
        )
    axis.plot(ground.real, ground.imag, 'k^', markersize=8, zorder=4, label='ground')
    if centers:
        box = box.with_points(_draw_centers(axis, here, box.middle, size))
    _draw_centrodes(axis, solution, here, centrodes, box)
    for body in inflection:
        _draw_curvature(axis, here, body, box)
    margin = 0.08 * max(abs(box.high - box.low), size)
    axis.set_xlim(box.low.real - margin, box.high.real + margin)
    axis.set_ylim(box.low.imag - margin, box.high.imag + margin)
    axis.set(aspect='equal', xlabel='x (m)', ylabel='y (m)')
    title = f'arrows: velocities, the longest {fastest:.3g} m/s'
    title += '; wide: fixed centrodes, dashed: moving' if centrodes else ''
    title += '; crosses: instant centers' if centers else ''
    if inflection:
        title += "; dashed circle: inflection; star: Ball's point; dotted: cubic of stationary "
        title += 'curvature; thin circles: paths'
    axis.set_title(fill(title, _TITLE_WIDTH), fontsize=10)


def _draw_line(axis: Any, line: DrawnLine, bodies: Sequence[str]) -> None:
    """Draw a line in the style of its body."""
    width, zorder = _WIDTHS[line.kind]
    style = {'color': '#000000', 'linestyle': '-'}
    if line.kind == 'guide':
        style = {'color': '#999999', 'linestyle': ':'}
    elif line.body in bodies:
        style = _style(bodies.index(line.body))
        if line.kind != 'link':
            style['linestyle'] = '-'
    axis.plot(line.points.real, line.points.imag, linewidth=width, zorder=zorder, **style)


def _annotate(axis: Any, text: str, z: complex, offset: tuple[int, int], **style: Any) -> None:
    """Write text next to a point, with a white outline that keeps it legible on lines."""
    from matplotlib.patheffects import withStroke

    outline = [withStroke(linewidth=2.5, foreground='white')]
    style |= {'xytext': offset, 'textcoords': 'offset points', 'path_effects': outline}
    axis.annotate(text, (z.real, z.imag), **style)


def _draw_centrodes(
    axis: Any, solution: SolvedScene, here: SolvedScene, names: Sequence[str], box: Box
) -> None:
    """Draw the fixed and the moving centrodes of some bodies, near the linkage."""
    motion = solution.motion
    body_poles = poles(solution.scene.mechanism, motion)
    for b, body in enumerate(solution.scene.mechanism.bodies):
        if body not in names:
            continue
        in_body = (body_poles.icr[b] - motion.position[0, b]) * np.exp(-1j * motion.angle[0, b])
        turn = np.exp(1j * here.motion.angle[0, b, 0])
        moving = here.motion.position[0, b, 0] + in_body * turn
        for curve, dashes, width in ((body_poles.icr[b], '-', 4), (moving, '--', 1.2)):
            reach = (0.5 + _CENTER_DISTANCE) * abs(box.high - box.low)
            is_near = np.abs(curve - box.middle) < reach
            z = np.where(is_near, curve, complex(np.nan, np.nan))
            style = {'color': _style(b)['color'], 'alpha': 0.35, 'linewidth': width, 'zorder': 0}
            axis.plot(z.real, z.imag, dashes, **style)


def _draw_curvature(axis: Any, here: SolvedScene, body: str, box: Box) -> None:
    """Draw the inflection circle of a body, the cubic, Ball's point, and circles of its points."""
    from matplotlib.patches import Circle

    mechanism, motion = here.scene.mechanism, here.motion
    b, of_bodies = mechanism.bodies.index(body), poles(mechanism, motion)
    color = _style(b)['color']
    position, angle = motion.position[:, b, 0], motion.angle[:, b, 0]
    icr, u = planar.to_plane(of_bodies.icr[b, 0]), planar.to_plane(of_bodies.velocity[b, 0])
    center, ball = of_bodies.inflection_circle[b, 0], of_bodies.ball_point[b, 0]
    radius, size = of_bodies.inflection_diameter[b, 0] / 2, abs(box.high - box.low)
    if radius < _STRAIGHT * size:
        style = {'fill': False, 'zorder': 2}
        axis.add_patch(Circle((center.real, center.imag), radius, ec=color, ls='--', **style))
        du = planar.to_plane(planar.icr_acceleration(position, angle).value)
        cubic = planar.stationary_curvature(angle[1], angle[2], icr, u, du)
        curve = planar.to_complex(cubic.points(np.linspace(0, np.pi, 2001)))
        near = np.abs(curve - box.middle) < (0.5 + _CENTER_DISTANCE) * size
        curve = np.where(near, curve, complex(np.nan, np.nan))
        axis.plot(curve.real, curve.imag, ':', color=color, linewidth=1.2, zorder=2)
        axis.plot(ball.real, ball.imag, '*', color=color, markersize=9, zorder=5)
    for name, motions in _solution.point_motions(here).items():
        if here.scene.points[name][0] == body:
            z = motions[0, 0]
            x, y = planar.path_curvature(planar.to_plane(z), angle[1], icr, u).center
            radius = abs(z - complex(x, y))
            if radius < _STRAIGHT * size:
                axis.add_patch(Circle((x, y), radius, ec=color, lw=0.5, fill=False))
                axis.plot(x, y, '+', color=color, markersize=5)


def _draw_centers(axis: Any, here: SolvedScene, middle: complex, size: float) -> list[complex]:
    """Draw the instant centers near the linkage, and the lines that determine them; return them."""
    centers = _solution.centers_of(here)
    names: dict[complex, list[str]] = {}
    drawn: dict[tuple[int, ...], complex] = {}
    for pair, z in zip(centers.pairs, centers.points[:, 0].tolist(), strict=True):
        if np.isfinite(z) and abs(z - middle) < (0.5 + _CENTER_DISTANCE) * size:
            key = next((point for point in names if abs(point - z) < 1e-3 * size), z)
            names.setdefault(key, []).append(center_name(len(centers.bodies), *pair))
            drawn[pair] = z
    for step in centers.steps:
        if step.rule != 'lines' or step.pair not in drawn:
            continue
        for code in step.by:
            through = [tuple(sorted((one, code))) for one in step.pair] if code >= 0 else []
            ends = [drawn[pair] for pair in through if pair in drawn]
            if ends:
                z = drawn[step.pair]
                line = np.array([max(ends, key=lambda end: abs(end - z)), z])
                axis.plot(line.real, line.imag, color='#999999', linewidth=0.8, linestyle=':')
    for z, listed in names.items():
        axis.plot(z.real, z.imag, 'kx', markersize=7, zorder=6)
        _annotate(axis, ', '.join(listed), z, (5, -10), fontsize=8, zorder=6)
    return [*names]
