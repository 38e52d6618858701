"""The motion of a scene as lines to print: tables with units."""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.mechanism import GROUND, Centers, Scene, explain, poles, transmission_angles
from kinpole_ros.mechanism._followers import cam_lines
from kinpole_ros.mechanism._kennedy import center_name
from kinpole_ros.tools.solve import _solution
from kinpole_ros.tools.solve._solution import SolvedScene

# Positions in the table of a range.
_ROWS = 13
# Two centers nearer than this share of the distance to a third one are one.
_ONE_CENTER = 1e-9

Row = list[str | float]


def table_lines(head: Sequence[str], rows: Sequence[Sequence[str | float]]) -> list[str]:
    """Return the lines of a table, with numbers aligned right and text aligned left."""
    columns = []
    for column in zip(*rows, strict=True):
        numbers = [abs(cell) for cell in column if not isinstance(cell, str) and np.isfinite(cell)]
        rounding = 1e-12 * max([1.0, *numbers])
        columns.append(
            [
                cell if isinstance(cell, str) else _number(0.0 if abs(cell) <= rounding else cell)
                for cell in column
            ]
        )
    all_rows = [list(head), *(list(row) for row in zip(*columns, strict=True))]
    lines = [''] * len(all_rows)
    for k in range(len(head)):
        cells = [row[k] for row in all_rows]
        width = max(map(len, cells))
        is_text = k == 0 or not all(map(_is_number, cells[1:]))
        separator = '  ' if k else ''
        for r, cell in enumerate(cells):
            lines[r] += separator + (cell.ljust(width) if is_text else cell.rjust(width))
    return [line.rstrip() for line in lines]


def _number(value: float) -> str:
    return f'{value:.6g}' if np.isfinite(value) else '-'


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return cell == '-'
    return True


def head_lines(scene: Scene) -> list[str]:
    """Return the numbers of bodies, joints and loops, the drivers, and a check of each cam."""
    mechanism = scene.mechanism
    counts = {
        'moving bodies': len(mechanism.bodies),
        'joints': len(mechanism.assembly.joints),
        'loops': len(mechanism.linkage.loops.loops),
    }
    listed = ', '.join(f'{title}: {count}' for title, count in counts.items() if count)
    drivers = ', '.join(driver.name for driver in mechanism.drivers)
    return [f'{scene.name}: {listed}, driven: {drivers}', *cam_lines(mechanism.assembly.followers)]


def motion_lines(solution: SolvedScene) -> list[str]:
    """Return bodies, lengths, points, poles and transmission at one position."""
    scene, motion = solution.scene, solution.motion
    values = ', '.join(
        f'{driver.name} = {_solution.driver_text(scene, k, solution.inputs[k, 0])} at '
        f'{_solution.driver_text(scene, k, solution.rates[k, 0])}/s'
        for k, driver in enumerate(scene.mechanism.drivers)
    )
    lines = [f'at {values}']
    if not motion.regular[0]:
        loop = ', '.join(scene.mechanism.dead_loop(motion.values[0, :, 0]))
        lines.append(f'a dead point of the loop {loop}: the drivers do not determine the motion')
    elif motion.sound[0] < len(motion.values):
        lines.append('next to a change point: the missing rates would have no correct digits')
    rows: list[Row] = [
        [body, np.rad2deg(motion.angle[0, b, 0]), *motion.angle[1:, b, 0]]
        for b, body in enumerate(scene.mechanism.bodies)
    ]
    head = ['body', 'angle deg', 'ω rad/s', 'α rad/s²', 'jerk rad/s³', 'snap rad/s⁴']
    lines += table_lines(head, rows)
    rows = [
        [name, *motion.values[:, n, 0]] for name, n in _solution.variable_lengths(scene).items()
    ]
    if rows:
        lines += ['', *table_lines(['length', 'm', 'm/s', 'm/s²', 'm/s³', 'm/s⁴'], rows)]
    rows = [[name, *_coordinates(z[:, 0])] for name, z in _solution.point_motions(solution).items()]
    if rows:
        units = {'': 'm', 'v': 'm/s', 'a': 'm/s²', 'j': 'm/s³'}
        head = [f'{letter}{axis} {unit}' for letter, unit in units.items() for axis in 'xy']
        lines += ['', *table_lines(['point', *head], rows)]
    return [*lines, *_pole_lines(solution), *_transmission_lines(solution)]


def _coordinates(points: Sequence[complex] | np.ndarray) -> list[float]:
    """Return x and y of all points in one list."""
    return [part for z in points for part in (z.real, z.imag)]


def _pole_lines(solution: SolvedScene) -> list[str]:
    """Return the poles of the bodies at the first position, and the velocity of the ICR."""
    mechanism = solution.scene.mechanism
    body_poles = poles(mechanism, solution.motion)
    rows: list[Row] = []
    for b, body in enumerate(mechanism.bodies):
        points = [getattr(body_poles, name)[b, 0] for name in ('icr', 'iap', 'ijp', 'velocity')]
        rows.append([body, *_coordinates(points), body_poles.curvature[b, 0]])
    head = [f'{name} {axis} m' for name in ('ICR', 'IAP', 'IJP') for axis in 'xy']
    return ['', *table_lines(['body', *head, 'u x m/s', 'u y m/s', 'κ 1/m'], rows)]


def _transmission_lines(solution: SolvedScene) -> list[str]:
    """Return mechanical advantages and transmission angles at the first position."""
    mechanism, lines = solution.scene.mechanism, list[str]()
    rows: list[Row] = [
        [name, '∞' if np.isinf(gain[0]) else _number(gain[0]), unit]
        for (name, unit), gain in _solution.advantages(solution).items()
    ]
    if rows:
        lines += ['', *table_lines(['at', f'advantage over {mechanism.drivers[0].name}', ''], rows)]
    angles = transmission_angles(mechanism, solution.values).items()
    rows = [[', '.join(names), np.rad2deg(angle[0])] for names, angle in angles]
    if rows:
        lines += ['', *table_lines(['between', 'transmission angle deg'], rows)]
    return lines


def range_lines(solution: SolvedScene) -> list[str]:
    """Return the range of the driver, its dead points, and the motion over it."""
    scene = solution.scene
    name = scene.mechanism.drivers[0].name
    low, high = solution.inputs[0, [0, -1]]
    ends = [
        _solution.driver_text(scene, 0, end)
        if limit is None
        else f'{_solution.driver_text(scene, 0, limit)} (limit)'
        for end, limit in zip((low, high), solution.limits, strict=True)
    ]
    lines = [f'{name} from {ends[0]} to {ends[1]}']
    if scene.mechanism.linkage.blocks:
        for dead in scene.mechanism.path(float(low), float(high)).dead_points:
            kind = 'limit: it turns back' if dead.turns_back else 'change point: two branches'
            moving, loop = ', '.join(dead.moving), ', '.join(dead.loop)
            at = _solution.driver_text(scene, 0, dead.at, 12)
            lines.append(
                f'dead point at {name} = {at} ({kind}; {moving} can move, in the loop {loop})'
            )
    return [*lines, *_motion_table(solution)]


def time_lines(solution: SolvedScene) -> list[str]:
    """Return the motion over time."""
    assert solution.times is not None
    return [f'from 0 to {solution.times[-1]:.9g} s', *_motion_table(solution)]


def _motion_table(solution: SolvedScene) -> list[str]:
    """Return drivers, bodies and lengths at positions spread over the motion."""
    scene, motion = solution.scene, solution.motion
    drivers = scene.mechanism.drivers
    columns: dict[str, np.ndarray] = {}
    if solution.times is not None:
        columns['t (s)'] = solution.times
    for d, driver in enumerate(drivers):
        unit, size = _solution.driver_unit(scene, d)
        columns[f'{driver.name} ({unit})'] = solution.inputs[d] / size
    for b, body in enumerate(scene.mechanism.bodies):
        columns[f'{body} deg'] = np.rad2deg(motion.angle[0, b])
        columns[f'{body} rad/s'] = motion.angle[1, b]
    for name, n in _solution.variable_lengths(scene).items():
        if name not in {driver.name for driver in drivers}:
            columns[f'{name} m'], columns[f'{name} m/s'] = motion.values[0, n], motion.values[1, n]
    positions = np.linspace(0, solution.inputs.shape[1] - 1, _ROWS).astype(int)
    rows = np.stack([*columns.values()], axis=1)[positions].tolist()
    return table_lines([*columns], rows)


def center_lines(solution: SolvedScene) -> list[str]:
    """Return the instant centers at the first position, and how they are deduced."""
    centers = _solution.centers_of(solution)
    rows: list[Row] = []
    for (i, j), point, direction in zip(
        centers.pairs, centers.points[:, 0], centers.directions[:, 0], strict=True
    ):
        row: Row = [center_name(len(centers.bodies), i, j)]
        row.append(f'{centers.bodies[i]}, {centers.bodies[j]}')
        if np.isfinite(direction):
            row += ['at infinity', f'{np.rad2deg(direction):.6g} deg']
        else:
            row += [point.real, point.imag] if np.isfinite(point) else ['none', '']
        rows.append(row)
    several = solution.inputs.shape[1] > 1
    title = 'instant centers' + (' at the start of the range' if several else '')
    table = table_lines(['center', 'of', 'x m', 'y m'], rows)
    chain = explain(solution.scene.mechanism, centers.steps)
    return ['', title, *table, '', *chain, *_ratio_lines(solution.scene, centers)]


def _ratio_lines(scene: Scene, centers: Centers) -> list[str]:
    """
    Return the ratios of rates at the first position, each by the distances of three centers.

    They are those of all bodies over the driven one, or over the first that turns. With
    I = I_rj, ω_j (I - I_1j) = ω_r (I - I_1r): both bodies have one velocity there.
    """
    bodies, places = centers.bodies, centers.places[:, :, 0]
    turning = [name for name in bodies[1:] if places[2, centers.row(GROUND, name)] == 1]
    driven = scene.mechanism.drivers[0].name
    if not turning:
        return []
    by = driven if driven in turning else turning[0]
    r, lines = bodies.index(by), []
    for j, name in enumerate(bodies):
        if name in (GROUND, by):
            continue
        rows = [centers.row(*two) for two in ((GROUND, by), (GROUND, name), (by, name))]
        own, other, both = (complex(x, y) for x, y, _ in places[:, rows].T)
        own_far, other_far, both_far = (w == 0 for w in places[2, rows])
        a, b, c = (center_name(len(bodies), *centers.pairs[row]) for row in rows)
        arm, other_arm = both - own, both - other
        ratio, size = f'ω{j + 1}/ω{r + 1}', abs(arm) + abs(other_arm)
        if own_far or not np.isfinite(places[:, rows]).all() or (other_far and both_far):
            continue
        if both_far:
            lines.append(f'{ratio} = 1, since {c} is at infinity')
        elif other_far:
            angle = np.degrees(np.angle(1j * arm))
            lines.append(f'v{j + 1}/ω{r + 1} = {a}{c} = {abs(arm):.6g} m, along {angle:.6g} deg')
        elif abs(other_arm) <= _ONE_CENTER * size:
            lines.append(f'{ratio}: not from centers, since {b} and {c} are one')
        else:
            along = float((other_arm * np.exp(-1j * np.angle(arm or other_arm))).real)
            value = f'{abs(arm):.6g} m / {along:.6g} m = {abs(arm) / along:.6g}'
            lines.append(f'{ratio} = {a}{c} / {b}{c} = {value}')
    return ['', f'ratios from centers, over {by}', *lines] if lines else []
