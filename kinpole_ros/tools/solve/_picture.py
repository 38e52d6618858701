"""
The picture of `kinpole solve`: the linkage, its velocities and centers, and rates over the range.

Readable in black and white: lines differ by dashes and markers too.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from kinpole_ros.mechanism import Belt, Rolling, center_name, poles, polygon
from kinpole_ros.tools.solve._solved import (
    Solved,
    centers_of,
    driver_unit,
    point_motions,
    rates_of,
)

_SIZE, _DPI = (12.5, 6.2), 150  # inches
_DASHES: tuple[Any, ...] = ('-', '--', '-.', ':', (0, (5, 1, 1, 1, 1, 1)))
_GRAYS = ('#000000', '#0060a8', '#a83200', '#00785a', '#7a4fa0', '#777777')
# The longest arrow of a velocity, and how far out a center is still drawn, of the linkage's size.
_ARROW, _FAR = 0.35, 1.2
# Letters of a title in a line.
_TITLE = 60
# Rates that differ by less than this part of them are one, but for rounding.
_FLAT = 1e-6


def draw(
    path: Path, kind: str, solved: Solved, here: Solved, centers: bool, curves: Sequence[str]
) -> None:
    """
    Draw the range of `solved` with the linkage at the one position `here` to a file of that kind,
    the centrodes of the bodies `curves` and, with `centers`, the instant centers.

    Raises OSError where it cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE, layout='constrained')
    grid = figure.add_gridspec(2, 2, width_ratios=(1.35, 1))
    _draw_linkage(figure.add_subplot(grid[:, 0]), solved, here, centers, curves)
    at, mark, label, title = _way(solved, here)
    rates = rates_of(solved.motion)
    for row, (order, name) in enumerate(
        ((1, 'angular velocity (rad/s)'), (2, 'angular acceleration (rad/s²)'))
    ):
        axis = figure.add_subplot(grid[row, 1])
        for b, body in enumerate(solved.scene.mechanism.bodies):
            values = rates[order, b]
            style = {'linestyle': _DASHES[b % len(_DASHES)], 'color': _GRAYS[b % len(_GRAYS)]}
            axis.plot(at, values, label=body, linewidth=1.4, **style)
        axis.axvline(mark, color='#999999', linewidth=0.8)
        _tame(axis, rates[order])
        axis.set_ylabel(name)
        axis.grid(alpha=0.3)
        axis.set_xlabel(label if row else '')
        if not row:
            axis.legend(fontsize=8, ncols=2)
    # A scene is called after its file, whose name may hold what text or formulas must not.
    scene = os.fsencode(solved.scene.name).decode(errors='replace')
    figure.suptitle(f'{scene} {title}', parse_math=False)
    figure.savefig(path, format=kind, dpi=_DPI)


def _way(solved: Solved, here: Solved) -> tuple[np.ndarray, float, str, str]:
    """What rates are drawn over (T,), where on it `here` is, its name, and the title's end."""
    if solved.times is not None:
        return solved.times, 0.0, 'time (s)', 'at 0 s'
    unit, size = driver_unit(solved.scene, 0)
    at = solved.inputs[0] / size
    value = float(here.inputs[0, 0]) / size
    # In the range, if need be by whole turns.
    mark = at[0] + (value - at[0]) % 360 if unit == 'deg' and at[-1] - at[0] > 359 else value
    label = f'{solved.scene.mechanism.drivers[0].name} ({unit})'
    rate = f'{solved.rates[0, 0] / size:.4g} {unit}/s'
    return at, mark, label, f'at {label} = {value:.6g}, driven at {rate}'


def _tame(axis: Any, values: np.ndarray) -> None:
    """
    Leave out the poles of rates at limits, where nothing else would be seen; what hardly changes is
    drawn over an axis of its own size.
    """
    known = values[np.isfinite(values)]
    finite = np.abs(known)
    if len(finite) and np.ptp(known) <= _FLAT * finite.max():
        middle = known.mean()
        axis.set_ylim(middle - 0.2 * (abs(middle) or 1.0), middle + 0.2 * (abs(middle) or 1.0))
        return
    if len(finite) and finite.max() > 20 * np.percentile(finite, 90) > 0:
        reach = 4 * np.percentile(finite, 90)
        axis.set_ylim(-reach, reach)


def _places(solved: Solved) -> dict[str, list[np.ndarray]]:
    """The points of each body as in `point_motions`, or its origin."""
    scene, bodies = solved.scene, solved.scene.mechanism.bodies
    places: dict[str, list[np.ndarray]] = {body: [] for body in bodies}
    for name, found in point_motions(solved).items():
        places[scene.points[name][0]].append(found)
    for b, body in enumerate(bodies):
        if not places[body]:
            places[body].append(solved.motion.position[:3, b])
    return places


def _draw_linkage(
    axis: Any, solved: Solved, at: Solved, centers: bool, curves: Sequence[str] = ()
) -> None:
    scene, bodies = solved.scene, solved.scene.mechanism.bodies
    fixed = np.array([p for body, p in scene.points.values() if body not in bodies])
    ways, places = _places(solved), _places(at)
    wheels = _wheels(at)
    everything = np.concatenate(
        [found[0] for listed in (*ways.values(), *places.values()) for found in listed]
        + [rim for _, rim in wheels]
        + [fixed.ravel() + 0j]
    )
    everything = everything[np.isfinite(everything)]
    low = complex(everything.real.min(), everything.imag.min())
    high = complex(everything.real.max(), everything.imag.max())
    reach = max(abs(high - low), 1e-9)
    fastest = max(
        (np.abs(found[1, 0]) for listed in places.values() for found in listed), default=0.0
    )
    moving = [found[:2, 0] for listed in places.values() for found in listed]
    arrows = [
        (z, z + v / fastest * _ARROW * reach) for z, v in moving if np.abs(v) > 1e-3 * fastest
    ]
    for _, tip in arrows:
        low = complex(min(low.real, tip.real), min(low.imag, tip.imag))
        high = complex(max(high.real, tip.real), max(high.imag, tip.imag))
    for listed in ways.values():
        for found in listed:
            axis.plot(found[0].real, found[0].imag, color='#bbbbbb', linewidth=0.8, zorder=1)
    vectors = _draw_vectors(axis, at)
    for b, body in enumerate(bodies):
        here = np.array([found[0, 0] for found in places[body]])
        color = _GRAYS[b % len(_GRAYS)]
        closed = np.append(here, here[:1]) if len(here) > 2 else here
        axis.plot(
            closed.real,
            closed.imag,
            color=color,
            linewidth=2.4,
            marker='o',
            markersize=4,
            linestyle=_DASHES[b % len(_DASHES)],
            zorder=3,
        )
        middle = vectors.get(b, here.mean())
        axis.annotate(
            body,
            (middle.real, middle.imag),
            fontsize=9,
            color=color,
            xytext=(4, 4),
            textcoords='offset points',
            zorder=5,
            path_effects=_halo(),
        )
    for tail, tip in arrows:
        axis.annotate(
            '',
            (tip.real, tip.imag),
            (tail.real, tail.imag),
            zorder=4,
            arrowprops={'arrowstyle': '->', 'color': '#444444', 'linewidth': 1.1},
        )
    axis.plot(fixed.real, fixed.imag, 'k^', markersize=8, zorder=4, label='ground')
    for b, rim in wheels:
        color = _GRAYS[b % len(_GRAYS)] if b >= 0 else '#000000'
        axis.plot(rim.real, rim.imag, color=color, linewidth=1.5 if b >= 0 else 1.0, zorder=3)
    if centers:
        low, high = _draw_centers(axis, at, low, high, reach)
    far = (0.5 + _FAR) * abs(high - low)
    _draw_centrodes(axis, solved, at, curves, (low + high) / 2, far)
    margin = 0.08 * max(abs(high - low), reach)
    axis.set_xlim(low.real - margin, high.real + margin)
    axis.set_ylim(low.imag - margin, high.imag + margin)
    axis.set_aspect('equal')
    axis.set_xlabel('x (m)')
    axis.set_ylabel('y (m)')
    title = f'arrows: velocities, the longest {fastest:.3g} m/s'
    title += '; wide: fixed centrodes, dashed: moving' if curves else ''
    title += '; crosses: instant centers' if centers else ''
    axis.set_title(fill(title, _TITLE), fontsize=10)


def _halo() -> list[Any]:
    """White around letters, which else cannot be read where they lie on a line."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=2.5, foreground='white')]


def _draw_vectors(axis: Any, at: Solved) -> dict[int, complex]:
    """The vectors of a scene that has no bodies with joints; returns the middles of bodies."""
    mechanism, middles = at.scene.mechanism, dict[int, complex]()
    for side in () if mechanism.assembly.joints else polygon(at.scene, at.motion, 0).sides:
        # A slide in a fixed direction is no body.
        b = mechanism.bodies.index(side.body) if side.body else 0
        ends = np.array([side.tail, side.head])
        color = _GRAYS[b % len(_GRAYS)] if side.body else '#999999'
        style = _DASHES[b % len(_DASHES)] if side.body else ':'
        axis.plot(ends.real, ends.imag, linewidth=2.4, zorder=3, linestyle=style, color=color)
        if side.body:
            middles[b] = complex(ends.mean())
    return middles


def _wheels(at: Solved) -> list[tuple[int, np.ndarray]]:
    """
    Circles that roll or carry belts, complex, by the numbers of their bodies, -1 for the ground's.

    A wheel with a spoke, the circle that it rolls on, and the strand of a belt.
    """
    mechanism, wheels = at.scene.mechanism, []
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 73))
    for joint in mechanism.assembly.joints:
        if isinstance(joint, Rolling):
            radii = abs(joint.circle), joint.radius
        elif isinstance(joint, Belt):
            radii = abs(joint.radii[0]), abs(joint.radii[1])
        else:
            continue
        spoke = np.append(0, circle)
        for body, hub, rim in (
            (joint.other, joint.b, radii[1] * spoke),
            (joint.one, joint.a, radii[0] * (spoke if isinstance(joint, Belt) else circle)),
        ):
            b = mechanism.bodies.index(body) if body in mechanism.bodies else -1
            place, turn = (at.motion.position[0, b, 0], at.motion.angle[0, b, 0])
            place, turn = (place, np.exp(1j * turn)) if b >= 0 else (0j, 1.0)
            if rim.any():
                wheels.append((b, place + (hub + rim) * turn))
        if isinstance(joint, Belt):
            values = dict(zip(mechanism.assembly.loops.variables, at.values[:, 0], strict=True))
            along = np.exp(1j * values[f'{joint.name}.angle'])
            # From the wheel on the body `one`, the last of the two above.
            ends = np.array([0.0, values[joint.name]]) + 1j * joint.radii[0]
            wheels.append((-1, place + joint.a * turn + ends * along))
    return wheels


def _draw_centrodes(
    axis: Any, solved: Solved, at: Solved, names: Sequence[str], middle: complex, far: float
) -> None:
    """Centrodes of some bodies over the range, where they are near: fixed, and rolling on it."""
    motion, bodies = solved.motion, solved.scene.mechanism.bodies
    found = poles(solved.scene.mechanism, motion)
    for b, body in enumerate(bodies):
        if body not in names:
            continue
        seen = (found.icr[b] - motion.position[0, b]) * np.exp(-1j * motion.angle[0, b])
        moving = at.motion.position[0, b, 0] + seen * np.exp(1j * at.motion.angle[0, b, 0])
        color = _GRAYS[b % len(_GRAYS)]
        for curve, style in ((found.icr[b], '-'), (moving, '--')):
            near = np.where(np.abs(curve - middle) < far, curve, complex(np.nan, np.nan))
            width = 4 if style == '-' else 1.2
            axis.plot(
                near.real, near.imag, style, color=color, alpha=0.35, linewidth=width, zorder=0
            )


def _draw_centers(
    axis: Any, at: Solved, low: complex, high: complex, reach: float
) -> tuple[complex, complex]:
    """Crosses and numbers of the centers near the linkage, and the lines that lead to them."""
    found = centers_of(at)
    middle = (low + high) / 2
    shown: dict[complex, list[str]] = {}
    placed: dict[tuple[int, int], complex] = {}
    for pair, point in zip(found.pairs, found.points[:, 0], strict=True):
        if np.isfinite(point) and abs(point - middle) < (0.5 + _FAR) * reach:
            key = next((z for z in shown if abs(z - point) < 1e-3 * reach), complex(point))
            shown.setdefault(key, []).append(center_name(len(found.bodies), *pair))
            placed[pair] = complex(point)
    for step in found.steps:
        if step.rule != 'lines' or step.pair not in placed:
            continue
        for code in step.by:
            through = [tuple(sorted((one, code))) for one in step.pair] if code >= 0 else []
            known = [placed[pair] for pair in through if pair in placed]
            if known:
                here = placed[step.pair]
                ends = np.array([known[int(np.abs(np.array(known) - here).argmax())], here])
                axis.plot(ends.real, ends.imag, color='#999999', linewidth=0.8, linestyle=':')
    for z, names in shown.items():
        axis.plot(z.real, z.imag, 'kx', markersize=7, zorder=6)
        axis.annotate(
            ', '.join(names),
            (z.real, z.imag),
            fontsize=8,
            zorder=6,
            xytext=(5, -10),
            textcoords='offset points',
            path_effects=_halo(),
        )
        low = complex(min(low.real, z.real), min(low.imag, z.imag))
        high = complex(max(high.real, z.real), max(high.imag, z.imag))
    return low, high
