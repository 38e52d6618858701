"""The analysis of a scene as lines to print: tables with units."""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.mechanism import (
    Load,
    Scene,
    Torque,
    center_name,
    efforts,
    explain,
    holding,
    poles,
    reactions,
    transmission_angles,
    undetermined,
    why_no_reactions,
)
from kinpole_ros.tools.solve._solved import (
    Acting,
    Solved,
    advantages,
    centers_of,
    driver_unit,
    lengths,
    loaded_by,
    point_motions,
    shown,
)

# Positions in the table of a range.
_ROWS = 13


def head_lines(scene: Scene) -> list[str]:
    """What the scene is made of, and what drives it."""
    mechanism = scene.mechanism
    counts = {
        'moving bodies': len(mechanism.bodies),
        'joints': len(mechanism.assembly.joints),
        'loops': len(mechanism.linkage.loops.loops),
    }
    driven = ', '.join(driver.name for driver in scene.mechanism.drivers)
    parts = [f'{what}: {count}' for what, count in counts.items() if count]
    return [f'{scene.name}: {", ".join(parts)}, driven: {driven}']


def motion_lines(solved: Solved) -> list[str]:
    """Bodies and points at one position."""
    scene, motion = solved.scene, solved.motion
    at = ', '.join(
        f'{driver.name} = {shown(scene, k, value)} at {shown(scene, k, rate)}/s'
        for (k, driver), value, rate in zip(
            enumerate(scene.mechanism.drivers), solved.inputs[:, 0], solved.rates[:, 0], strict=True
        )
    )
    lines = [f'at {at}']
    if not motion.regular[0]:
        loop = ', '.join(scene.mechanism.dead_loop(motion.values[0, :, 0]))
        lines.append(f'a dead point of the loop {loop}: the drivers do not tell how it moves on')
    elif motion.sound[0] < len(motion.values):
        lines.append('next to a change point, where rounding leaves no digits of what is missing')
    rows = [
        [body, np.rad2deg(motion.angle[0, b, 0]), *motion.angle[1:, b, 0]]
        for b, body in enumerate(scene.mechanism.bodies)
    ]
    lines += table_lines(
        ['body', 'angle deg', 'ω rad/s', 'α rad/s²', 'jerk rad/s³', 'snap rad/s⁴'], rows
    )
    slides = [[name, *motion.values[:, k, 0]] for name, k in lengths(scene).items()]
    if slides:
        lines += ['', *table_lines(['length', 'm', 'm/s', 'm/s²', 'm/s³', 'm/s⁴'], slides)]
    rows = [
        [name, *(part for z in place[:, 0] for part in (z.real, z.imag))]
        for name, place in point_motions(solved).items()
    ]
    if rows:
        units = ('m', 'm/s', 'm/s²', 'm/s³')
        head = [
            f'{d}{c} {unit}'
            for d, unit in zip(('', 'v', 'a', 'j'), units, strict=True)
            for c in 'xy'
        ]
        lines += ['', *table_lines(['point', *head], rows)]
    return [*lines, *_pole_lines(solved), *_transmission_lines(solved)]


def _pole_lines(solved: Solved) -> list[str]:
    """Poles of the bodies at the first position, and how the ICR moves on."""
    mechanism = solved.scene.mechanism
    found = poles(mechanism, solved.motion)
    rows: list[list[str | float]] = []
    for b, body in enumerate(mechanism.bodies):
        places = [points[b, 0] for points in (found.icr, found.iap, found.ijp, found.velocity)]
        parts = [part for z in places for part in (z.real, z.imag)]
        rows.append([body, *parts, found.curvature[b, 0]])
    head = [f'{name} {c} m' for name in ('ICR', 'IAP', 'IJP') for c in 'xy']
    return ['', *table_lines(['body', *head, 'u x m/s', 'u y m/s', 'κ 1/m'], rows)]


def _transmission_lines(solved: Solved) -> list[str]:
    """What a unit of effort at the one driver becomes, and how well it is passed on."""
    lines: list[str] = []
    gains = advantages(solved)
    if gains:
        rows: list[list[str | float]] = [
            [name, _ratio(values[0]), unit] for (name, unit), values in gains.items()
        ]
        driver = solved.scene.mechanism.drivers[0].name
        lines += ['', *table_lines(['at', f'advantage over {driver}', ''], rows)]
    angles = transmission_angles(solved.scene.mechanism, solved.values)
    if angles:
        listed = [[', '.join(names), np.rad2deg(angle[0])] for names, angle in angles.items()]
        lines += ['', *table_lines(['between', 'transmission angle deg'], listed)]
    return lines


def _ratio(value: float) -> str:
    """A ratio, which at a toggle is infinite."""
    return '∞' if np.isinf(value) else _number(value)


def range_lines(solved: Solved) -> list[str]:
    """How far it goes, the dead points on the way, and the motion over it."""
    scene = solved.scene
    name = scene.mechanism.drivers[0].name
    low, high = solved.inputs[0, [0, -1]]
    ends = []
    for value, limit in zip((low, high), solved.limits, strict=True):
        end = value if limit is None else limit
        ends.append(shown(scene, 0, end) + ('' if limit is None else ' (limit)'))
    lines = [f'{name} from {ends[0]} to {ends[1]}']
    if scene.mechanism.linkage.blocks:
        for dead in scene.mechanism.path(float(low), float(high)).dead_points:
            what = 'limit: it turns back' if dead.turns_back else 'change point: two ways on'
            moving, loop = ', '.join(dead.moving), ', '.join(dead.loop)
            lines.append(
                f'dead point at {name} = {shown(scene, 0, dead.at, 12)} ({what}; {moving} can '
                f'move, in the loop {loop})'
            )
    return [*lines, *_motiontable_lines(solved)]


def course_lines(solved: Solved) -> list[str]:
    """The motion over time."""
    assert solved.times is not None
    return [f'from 0 to {solved.times[-1]:.9g} s', *_motiontable_lines(solved)]


def _motiontable_lines(solved: Solved) -> list[str]:
    """Bodies and lengths at some of the positions."""
    scene, motion = solved.scene, solved.motion
    kept = np.linspace(0, solved.inputs.shape[1] - 1, _ROWS).astype(int)
    drivers = scene.mechanism.drivers
    units = [driver_unit(scene, k) for k in range(len(drivers))]
    head = [] if solved.times is None else ['t (s)']
    head += [f'{driver.name} ({unit})' for driver, (unit, _) in zip(drivers, units, strict=True)]
    head += [f'{b} {q}' for b in scene.mechanism.bodies for q in ('deg', 'rad/s')]
    driven = {driver.name for driver in drivers}
    slides = {name: n for name, n in lengths(scene).items() if name not in driven}
    head += [f'{name} {q}' for name in slides for q in ('m', 'm/s')]
    rows = []
    for k in kept:
        row = [] if solved.times is None else [float(solved.times[k])]
        row += [float(solved.inputs[d, k]) / size for d, (_, size) in enumerate(units)]
        for b in range(len(scene.mechanism.bodies)):
            row += [np.rad2deg(motion.angle[0, b, k]), motion.angle[1, b, k]]
        for n in slides.values():
            row += [motion.values[0, n, k], motion.values[1, n, k]]
        rows.append(row)
    return table_lines(head, rows)


def center_lines(solved: Solved) -> list[str]:
    """Instant centers at the first position, and how they are deduced."""
    mechanism = solved.scene.mechanism
    found = centers_of(solved)
    several = solved.inputs.shape[1] > 1
    lines = ['', 'instant centers' + (' at the start of the range' if several else '')]
    rows: list[list[str | float]] = []
    for c, (i, j) in enumerate(found.pairs):
        point, direction = found.points[c, 0], found.directions[c, 0]
        where: list[str | float]
        if np.isfinite(direction):
            where = ['at infinity', f'{np.rad2deg(direction):.6g} deg']
        elif np.isfinite(point):
            where = [point.real, point.imag]
        else:
            where = ['none', '']
        rows.append(
            [center_name(len(found.bodies), i, j), f'{found.bodies[i]}, {found.bodies[j]}', *where]
        )
    lines += table_lines(['center', 'of', 'x m', 'y m'], rows)
    return [*lines, '', *explain(mechanism, found.steps)]


def static_lines(solved: Solved) -> list[str]:
    """What the drivers and the joints bear, at the first position."""
    scene, acts = solved.scene, loaded_by(solved)
    first = solved.values[:, :1]
    several = solved.inputs.shape[1] > 1
    lines = ['', 'forces at the start of the range' if several else 'forces']
    loads = acts.all
    if np.isnan(solved.motion.values[1:, :, 0]).all() and solved.motion.regular.size == 1:
        # As good as in a dead point: what is printed there is the last digit of the input.
        return [*lines, 'not determined: the drivers have no hold of the loads in a dead point']
    if scene.held_by:
        size, load = holding(scene.mechanism, first, loads, scene.held_by)
        lines.append(_held_line(scene, float(size[0]), load))
        loads = [*loads, load]
    else:
        lines += _effort_lines(scene, first, acts)
    if reason := why_no_reactions(scene.mechanism):
        return [*lines, reason]
    found = reactions(scene.mechanism, first, loads)
    rows = [
        [
            name,
            found.force[j, 0].real,
            found.force[j, 0].imag,
            abs(found.force[j, 0]),
            found.moment[j, 0],
        ]
        for j, name in enumerate(found.joints)
    ]
    if rows:
        lines += ['', *table_lines(['joint', 'Fx N', 'Fy N', 'F N', 'moment N m'], rows)]
    for j, name in enumerate(found.joints):
        # Of a force that is not unique one part may be, as that of teeth along their wheel.
        for part, turn in ((found.along[j, 0], 1), (found.across[j, 0], 1j)):
            if np.isfinite(part) and not np.isfinite(found.force[j, 0]):
                force = part * turn * found.axis[j, 0]
                way = round(np.degrees(np.angle(force)), 4) % 360
                size = f'{abs(part):.6g} N'
                lines.append(f'{name}: of its force the part along {way:g} deg is unique: {size}')
    return [*lines, *undetermined(scene.mechanism, first[:, 0])]


def _effort_lines(scene: Scene, first: np.ndarray, acts: Acting) -> list[str]:
    """What each driver exerts to balance all that acts."""
    lines = []
    borne = efforts(scene.mechanism, first, acts.all)
    for k, driver in enumerate(scene.mechanism.drivers):
        unit = 'N m' if scene.mechanism.kind(k) == 'angle' else 'N'
        if not borne.determined[k, 0]:
            lines.append(f'{driver.name}: a dead point, where no finite effort balances the loads')
            continue
        lines.append(f'{driver.name} balances the loads with {borne.effort[k, 0]:.9g} {unit}')
        ends = np.cumsum([len(acts.loads), len(acts.springs)])
        loads, springs, inertia = np.split(borne.share[:, k, 0], ends)
        parts = [f'load by load: {", ".join(f"{x:.6g}" for x in loads)}'] if len(loads) else []
        parts += [f'springs: {springs.sum():.6g}'] if len(springs) else []
        parts += [f'inertia: {inertia.sum():.6g}'] if len(inertia) else []
        if len(loads) > 1 or len(parts) > 1:
            lines.append(f'  of this, {"; ".join(parts)} {unit}')
    return lines


def _held_line(scene: Scene, size: float, load: Load) -> str:
    """What holds the loads in place of the driver."""
    driver = scene.mechanism.drivers[0].name
    if not np.isfinite(size):
        return f'on {load.body} nothing balances the loads here: it does not move, or a dead point'
    if isinstance(load, Torque):
        return f'{size:.9g} N m on {load.body} balance the loads, with {driver} free'
    name = next(n for n, place in scene.points.items() if place == (load.body, load.point))
    force = complex(np.ravel(load.force)[0])
    way = f'{np.rad2deg(np.angle(force / size)):.6g} deg'
    return f'{size:.9g} N at {name}, along {way}, balance the loads, with {driver} free'


def _number(value: float) -> str:
    return f'{value:.6g}' if np.isfinite(value) else '-'


def table_lines(head: Sequence[str], rows: Sequence[Sequence[str | float]]) -> list[str]:
    """Lines of a table, numbers to the right."""
    columns = []
    for column in zip(*rows, strict=True):
        numbers = [abs(c) for c in column if not isinstance(c, str) and np.isfinite(c)]
        # Rounding of what is zero by itself, or next to the others.
        least = 1e-12 * max([1.0, *numbers])
        columns.append(
            [
                c if isinstance(c, str) else _number(c if not abs(c) <= least else 0.0)
                for c in column
            ]
        )
    cells = [list(row) for row in zip(*columns, strict=True)]
    widths = [max(len(row[k]) for row in [list(head), *cells]) for k in range(len(head))]
    text = [k == 0 or any(not _is_number(row[k]) for row in cells) for k in range(len(head))]
    lines = []
    for row in [list(head), *cells]:
        placed = zip(row, widths, text, strict=True)
        lines.append('  '.join(c.ljust(w) if left else c.rjust(w) for c, w, left in placed))
    return [line.rstrip() for line in lines]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return cell == '-'
    return True
