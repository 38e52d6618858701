"""
`kinpole solve`: the classical analysis of a scene, as tables, a spreadsheet or a picture.

Everything is computed by `mechanism`; here it is only asked for and laid out.
"""

import csv
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import (
    Centers,
    Load,
    Motion,
    Scene,
    SceneError,
    Torque,
    centrodes,
    efforts,
    explain,
    holding,
    instant_centers,
    load_scene,
    quantity,
    reactions,
    undetermined,
    write_pitch_curves,
)
from kinpole_ros.planar import body_point_derivative

# Positions over a range: of the table, and of the spreadsheet and the picture.
_ROWS, _SAMPLES = 13, 361
# From a limit, where no rate is finite, the first position keeps this share of the range.
_ASIDE = 1e-3
_TURN = 2 * np.pi


class Solved(NamedTuple):
    """
    A scene at T positions: `inputs` (d, T) of its drivers, `motion` by time, at the rates `rates`.

    `limits` are the lowest and highest input if a limit ends the range there, else None.
    """

    scene: Scene
    inputs: np.ndarray
    rates: np.ndarray
    motion: Motion
    limits: tuple[float | None, float | None]

    @property
    def values(self) -> np.ndarray:
        """Variables (n, T)."""
        return np.asarray(self.motion.values[0])


def solve_scene(
    scene: str | Path,
    at: str | None = None,
    sweep: bool = False,
    centers: bool = False,
    statics: bool = False,
    table: str | Path | None = None,
    picture: str | Path | None = None,
    pitch: Sequence[str] | None = None,
) -> list[str]:
    """
    The analysis as lines to print; also writes the CSV `table`, the `picture`, the `pitch` curves.

    `at` is a value of the one driver, with a unit or in SI; `sweep` takes its whole range; neither,
    the position at time 0. `pitch` is two bodies and a file (.csv or .svg). Raises SceneError and
    LinkageError for what the scene cannot do, SceneError for files too.
    """
    loaded = load_scene(scene)
    here = _solve(loaded, at, None)
    whole = here
    if sweep or picture or pitch:
        whole = _solve(loaded, None, _SAMPLES)
    lines = _head(loaded)
    if sweep:
        lines += _range_lines(whole) + _sweep_lines(whole)
    else:
        lines += _motion_lines(here)
    if centers:
        lines += _center_lines(whole if sweep else here)
    if statics:
        lines += _static_lines(whole if sweep else here)
    if table:
        with _writing(table):
            _write_table(Path(table), whole if sweep else here, centers, statics)
        lines.append(f'written to {table}')
    if pitch:
        one, other, file = pitch
        low, high = float(whole.inputs[0, 0]), float(whole.inputs[0, -1])
        curves = centrodes(loaded.mechanism, one, other, low, high)
        write_pitch_curves(file, curves)
        lines.append(
            f'the curves of {one} and {other} roll on each other, arc lengths alike to '
            f'{curves.slip:.1e}; written to {file}'
        )
    if picture:
        from kinpole_ros.solve_plot import draw

        _check_picture(Path(picture))
        with _writing(picture):
            draw(Path(picture), whole, _nearest(whole, here), centers)
        lines.append(f'written to {picture}')
    return lines


def _solve(scene: Scene, at: str | None, count: int | None) -> Solved:
    """
    The scene at one position, or at `count` over the range of its one driver.

    Derivatives that rounding has drowned, next to change points, are NaN.
    """
    mechanism = scene.mechanism
    now = np.stack([driver.motion(np.zeros(1)) for driver in scene.mechanism.drivers], axis=1)
    if at is None and count is None:
        motion = _sound(mechanism.motion(np.zeros(1)))
        return Solved(scene, now[0], now[1, :, 0], motion, (None, None))
    if len(mechanism.drivers) != 1:
        raise SceneError(
            f'{scene.name} has {len(mechanism.drivers)} drivers: --at, --sweep, --plot and --pitch '
            'are for one; leave them out, or hold the others'
        )
    # As fast as it is driven at time 0, or one unit per second if that is at rest.
    rate = float(now[1, 0, 0]) or 1.0
    limits: tuple[float | None, float | None] = (None, None)
    if count is None:
        values = np.array([quantity('--at', at, scene.mechanism.kind(0))])
    else:
        low, high, limits = _range(scene, float(now[0, 0, 0]))
        values = np.linspace(low, high, count)
    inputs = np.zeros((5, 1, len(values)))
    inputs[0, 0], inputs[1] = values, rate
    motion = _sound(mechanism.at_inputs(inputs, None))
    return Solved(scene, inputs[0], np.array([rate]), motion, limits)


def _sound(motion: Motion) -> Motion:
    for k in range(1, len(motion.values)):
        for part in (motion.position, motion.angle, motion.values):
            part[k][:, motion.sound <= k] = np.nan
    return motion


def _range(scene: Scene, start: float) -> tuple[float, float, tuple[float | None, float | None]]:
    """The range of the one driver: a full turn, what the scene drives, or up to the limits."""
    driver = scene.mechanism.drivers[0]
    angle = scene.mechanism.kind(0) == 'angle'
    if angle:
        low, high = start - _TURN, start + _TURN
    else:
        low, high = driver.low, driver.high
    if not scene.mechanism.linkage.blocks:
        return (start, start + _TURN, (None, None)) if angle else (low, high, (None, None))
    path = scene.mechanism.path(low, high)
    if path.period:
        return start, start + path.period, (None, None)
    found = float(path.inputs[0]), float(path.inputs[-1])
    ends = [dead.at for dead in path.dead_points if dead.turns_back]
    limits: list[float | None] = [None, None]
    near = 1e-3 * (found[1] - found[0])
    aside = _ASIDE * (found[1] - found[0])
    low, high = found
    for end in ends:
        if abs(end - found[0]) < near:
            limits[0], low = end, end + aside
        elif abs(end - found[1]) < near:
            limits[1], high = end, end - aside
    if limits == [None, None] and angle:
        low, high = start, start + _TURN
    return low, high, (limits[0], limits[1])


def _head(scene: Scene) -> list[str]:
    mechanism = scene.mechanism
    counts = {
        'moving bodies': len(mechanism.bodies),
        'joints': len(mechanism.assembly.joints),
        'loops': len(mechanism.linkage.loops.loops),
    }
    driven = ', '.join(driver.name for driver in scene.mechanism.drivers)
    parts = [f'{what}: {count}' for what, count in counts.items() if count]
    return [f'{scene.name}: {", ".join(parts)}, driven: {driven}']


def _motion_lines(solved: Solved) -> list[str]:
    """Bodies and points at one position."""
    scene, motion = solved.scene, solved.motion
    at = ', '.join(
        f'{driver.name} = {_shown(scene, k, value)} at {_shown(scene, k, rate)}/s'
        for (k, driver), value, rate in zip(
            enumerate(scene.mechanism.drivers), solved.inputs[:, 0], solved.rates, strict=True
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
    lines += _table(
        ['body', 'angle deg', 'ω rad/s', 'α rad/s²', 'jerk rad/s³', 'snap rad/s⁴'], rows
    )
    slides = [[name, *motion.values[:, k, 0]] for name, k in _lengths(scene).items()]
    if slides:
        lines += ['', *_table(['length', 'm', 'm/s', 'm/s²', 'm/s³', 'm/s⁴'], slides)]
    places = point_motions(solved)
    rows = []
    for name, place in places.items():
        z, v, a = place[:3, 0]
        rows.append([name, z.real, z.imag, v.real, v.imag, a.real, a.imag])
    if rows:
        head = ['point', 'x m', 'y m', 'vx m/s', 'vy m/s', 'ax m/s²', 'ay m/s²']
        lines += ['', *_table(head, rows)]
    return lines


def _range_lines(solved: Solved) -> list[str]:
    """How far it goes, and the dead points on the way."""
    scene = solved.scene
    name = scene.mechanism.drivers[0].name
    low, high = solved.inputs[0, [0, -1]]
    ends = []
    for value, limit in zip((low, high), solved.limits, strict=True):
        end = value if limit is None else limit
        ends.append(_shown(scene, 0, end) + ('' if limit is None else ' (limit)'))
    lines = [f'{name} from {ends[0]} to {ends[1]}']
    if scene.mechanism.linkage.blocks:
        for dead in scene.mechanism.path(float(low), float(high)).dead_points:
            what = 'limit: it turns back' if dead.turns_back else 'change point: two ways on'
            moving, loop = ', '.join(dead.moving), ', '.join(dead.loop)
            lines.append(
                f'dead point at {name} = {_shown(scene, 0, dead.at, 12)} ({what}; {moving} can '
                f'move, in the loop {loop})'
            )
    return lines


def _sweep_lines(solved: Solved) -> list[str]:
    scene, motion = solved.scene, solved.motion
    kept = np.linspace(0, solved.inputs.shape[1] - 1, _ROWS).astype(int)
    unit, size = driver_unit(scene, 0)
    head = [f'{scene.mechanism.drivers[0].name} ({unit})']
    head += [f'{b} {q}' for b in scene.mechanism.bodies for q in ('deg', 'rad/s')]
    driven = scene.mechanism.drivers[0].name
    slides = {name: n for name, n in _lengths(scene).items() if name != driven}
    head += [f'{name} {q}' for name in slides for q in ('m', 'm/s')]
    rows = []
    for k in kept:
        row = [float(solved.inputs[0, k]) / size]
        for b in range(len(scene.mechanism.bodies)):
            row += [np.rad2deg(motion.angle[0, b, k]), motion.angle[1, b, k]]
        for n in slides.values():
            row += [motion.values[0, n, k], motion.values[1, n, k]]
        rows.append(row)
    return _table(head, rows)


def _center_lines(solved: Solved) -> list[str]:
    """Instant centers at the first position, and how they are deduced."""
    mechanism = solved.scene.mechanism
    found = _centers(solved)
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
        rows.append([f'I{i + 1}{j + 1}', f'{found.bodies[i]}, {found.bodies[j]}', *where])
    lines += _table(['center', 'of', 'x m', 'y m'], rows)
    return [*lines, '', *explain(mechanism, found.steps)]


def _centers(solved: Solved) -> Centers:
    rates = solved.rates if len(solved.rates) > 1 else None
    return instant_centers(solved.scene.mechanism, solved.values, rates)


def _static_lines(solved: Solved) -> list[str]:
    """What the drivers and the joints bear, at the first position."""
    scene = solved.scene
    if not scene.loads:
        raise SceneError(
            f'{scene.name} has no loads: add them, as loads: [{{weight: 10 kg, at: BODY.POINT}}]'
        )
    first = solved.values[:, :1]
    several = solved.inputs.shape[1] > 1
    lines = ['', 'forces at the start of the range' if several else 'forces']
    loads = scene.loads
    if scene.held_by:
        size, load = holding(scene.mechanism, first, loads, scene.held_by)
        lines.append(_held_line(scene, float(size[0]), load))
        loads = (*loads, load)
    else:
        lines += _effort_lines(scene, first)
    if not scene.mechanism.assembly.joints:
        return [*lines, 'vectors have no joints: for what these bear write bodies and joints']
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
        lines += ['', *_table(['joint', 'Fx N', 'Fy N', 'F N', 'moment N m'], rows)]
    for j, name in enumerate(found.joints):
        # Of a force that is not unique one part may be, as that of teeth along their wheel.
        for part, turn in ((found.along[j, 0], 1), (found.across[j, 0], 1j)):
            if np.isfinite(part) and not np.isfinite(found.force[j, 0]):
                force = part * turn * found.axis[j, 0]
                way = round(np.degrees(np.angle(force)), 4) % 360
                size = f'{abs(part):.6g} N'
                lines.append(f'{name}: of its force the part along {way:g} deg is unique: {size}')
    return [*lines, *undetermined(scene.mechanism, first[:, 0])]


def _effort_lines(scene: Scene, first: np.ndarray) -> list[str]:
    """What each driver exerts to balance the loads."""
    lines = []
    borne = efforts(scene.mechanism, first, scene.loads)
    for k, driver in enumerate(scene.mechanism.drivers):
        unit = 'N m' if scene.mechanism.kind(k) == 'angle' else 'N'
        if not borne.determined[k, 0]:
            lines.append(f'{driver.name}: a dead point, where no finite effort balances the loads')
            continue
        lines.append(f'{driver.name} balances the loads with {borne.effort[k, 0]:.9g} {unit}')
        if len(scene.loads) > 1:
            parts = ', '.join(f'{share:.6g}' for share in borne.share[:, k, 0])
            lines.append(f'  of this, load by load: {parts} {unit}')
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


def point_motions(solved: Solved) -> dict[str, np.ndarray]:
    """The named points of the moving bodies, each (3, T) complex: place, velocity, acceleration."""
    motion = solved.motion
    bodies = list(solved.scene.mechanism.bodies)
    found = {}
    for name, (body, point) in solved.scene.points.items():
        if body in bodies:
            position, angle = (
                part[:, bodies.index(body)] for part in (motion.position, motion.angle)
            )
            place = position[0] + point * np.exp(1j * angle[0])
            rates = [body_point_derivative(k, place, position, angle) for k in (1, 2)]
            found[name] = np.stack([place, *rates])
    return found


def _write_table(path: Path, solved: Solved, centers: bool, statics: bool) -> None:
    """One row per position, SI units; empty cells for what is not determined."""
    columns: dict[str, np.ndarray] = {}
    orders = ('', '_velocity', '_acceleration', '_jerk', '_snap')
    for k, driver in enumerate(solved.scene.mechanism.drivers):
        columns[driver.name] = solved.inputs[k]
    for b, body in enumerate(solved.scene.mechanism.bodies):
        for k, name in enumerate(orders):
            columns[f'{body}_x{name}'] = solved.motion.position[k, b].real
            columns[f'{body}_y{name}'] = solved.motion.position[k, b].imag
            columns[f'{body}_angle{name}'] = solved.motion.angle[k, b]
    for name, n in _lengths(solved.scene).items():
        for k, what in enumerate(orders):
            columns[f'{name}{what}'] = solved.motion.values[k, n]
    for point, places in point_motions(solved).items():
        name = point.replace('.', '_')
        for k, what in enumerate(('', '_velocity', '_acceleration')):
            columns[f'{name}_x{what}'] = places[k].real
            columns[f'{name}_y{what}'] = places[k].imag
    if centers:
        found = _centers(solved)
        for c, (i, j) in enumerate(found.pairs):
            name = f'center_{found.bodies[i]}_{found.bodies[j]}'
            columns[f'{name}_x'] = found.points[c].real
            columns[f'{name}_y'] = found.points[c].imag
    if statics:
        loads = solved.scene.loads
        if solved.scene.held_by:
            size, load = holding(solved.scene.mechanism, solved.values, loads, solved.scene.held_by)
            columns['held_by'] = size
            loads = (*loads, load)
        borne = efforts(solved.scene.mechanism, solved.values, loads)
        for k, driver in enumerate(solved.scene.mechanism.drivers):
            columns[f'{driver.name}_effort'] = borne.effort[k]
        if solved.scene.mechanism.assembly.joints:
            forces = reactions(solved.scene.mechanism, solved.values, loads)
            for j, joint in enumerate(forces.joints):
                columns[f'{joint}_force_x'] = forces.force[j].real
                columns[f'{joint}_force_y'] = forces.force[j].imag
                columns[f'{joint}_moment'] = forces.moment[j]
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open('w', newline='', encoding='utf-8') as file:
        rows = csv.writer(file)
        rows.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            rows.writerow([repr(float(cell)) if np.isfinite(cell) else '' for cell in row])


@contextmanager
def _writing(path: str | Path) -> Iterator[None]:
    """Say which file it was that could not be written."""
    try:
        yield
    except OSError as error:
        raise SceneError(
            f'{path} cannot be written: {error.strerror}; '
            'mend: check the path, its rights and the space on the disk'
        ) from None


def _check_picture(path: Path) -> None:
    """Raise SceneError for a kind of picture that matplotlib does not draw."""
    from matplotlib.backend_bases import FigureCanvasBase

    known = sorted(FigureCanvasBase.get_supported_filetypes())
    if path.suffix.lower().lstrip('.') not in known:
        raise SceneError(f'{path} is no picture; end its name in one of {", ".join(known)}')


def _nearest(whole: Solved, here: Solved) -> int:
    """Which position of a range is drawn: the one nearest to that asked for."""
    return int(np.abs(whole.inputs[0] - here.inputs[0, 0]).argmin())


def driver_unit(scene: Scene, k: int) -> tuple[str, float]:
    """The unit the values of a driver are shown in, and how large that is in SI."""
    return ('deg', np.pi / 180) if scene.mechanism.kind(k) == 'angle' else ('m', 1.0)


def _lengths(scene: Scene) -> dict[str, int]:
    """The slides and other lengths that change, by name, and which variables they are."""
    kinds = scene.mechanism.assembly.kinds
    return {name: n for n, (name, kind) in enumerate(kinds.items()) if kind == 'length'}


def _shown(scene: Scene, k: int, value: float, digits: int = 9) -> str:
    unit, size = driver_unit(scene, k)
    return f'{value / size if abs(value) > 1e-12 else 0.0:.{digits}g} {unit}'


def _number(value: float) -> str:
    return f'{value:.6g}' if np.isfinite(value) else '-'


def _table(head: Sequence[str], rows: Sequence[Sequence[str | float]]) -> list[str]:
    """Lines of a table, numbers to the right."""
    columns = []
    for column in zip(*rows, strict=True):
        numbers = [abs(c) for c in column if not isinstance(c, str) and np.isfinite(c)]
        # Rounding of what is zero by itself, or beside the others.
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
