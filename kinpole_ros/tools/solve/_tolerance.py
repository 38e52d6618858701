"""`kinpole tolerance`: how errors of a scene's dimensions spread over its motion."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.mechanism import (
    Scene,
    SceneError,
    Tolerance,
    ToleranceSpread,
    load_scene,
    propagate_tolerances,
    quantity,
    scene_text,
    tolerances_of,
)
from kinpole_ros.tools.solve._lines import head_lines, table_lines
from kinpole_ros.tools.solve._solved import Solved, driver_unit, everywhere, shown, writing
from kinpole_ros.tools.solve._spreadsheet import write_columns

# Positions over the range.
_POSITIONS = 121
# Where nothing is said: of lengths, m, and of angles, rad.
_USUAL = {'length': 1e-4, 'angle': np.radians(0.1)}
# A line of `kinpole fit`.
_FITTED = re.compile(r'^(\S+(?: [xy])?) +\S+ (m|deg), deviation ([\d.e+-]+);', re.M)
# The widest band that is drawn is less than this share of the largest path.
_BAND = 0.3
# Errors that are named as the largest of a quantity.
_NAMED = 3
_UNITS = {'angle': ('deg', 180 / np.pi), 'angular velocity': ('rad/s', 1.0)}


def tolerances(
    scene: str,
    said: Sequence[str] = (),
    samples: int = 1000,
    table: str | None = None,
    picture: str | None = None,
    page: str | None = None,
) -> list[str]:
    """
    The errors of a scene's points, angles and centers as lines to print.

    `said` are NAME=DEVIATION, play:PIN=RADIUS and files with what `kinpole fit` printed; also
    writes a CSV `table`, a `picture` and an HTML `page`. Raises SceneError and LinkageError.
    """
    loaded = load_scene(scene)
    errors, notes = _errors(loaded, said)
    if not errors:
        raise SceneError('no dimension has an error: give --tolerances length=0.1mm')
    solved = everywhere(loaded, _POSITIONS)
    found = propagate_tolerances(
        scene_text(scene), loaded, errors, solved.values, solved.rates, samples
    )
    lines = [*head_lines(loaded), *notes, '', *_error_lines(errors)]
    lines += ['', *_spread_lines(solved, found, errors)]
    if table:
        with writing(table) as part:
            _write_table(part, solved, found)
        lines.append(f'written to {table}')
    if picture:
        with writing(picture) as part:
            _draw(part, Path(picture).suffix.lstrip('.'), solved, found)
        lines.append(f'written to {picture}')
    if page:
        from kinpole_ros.tools.solve._page import write_page

        with writing(page) as part:
            write_page(part, solved, solved.at(0), _columns(found))
        lines.append(f'written to {page}')
    return lines


def _errors(scene: Scene, said: Sequence[str]) -> tuple[list[Tolerance], list[str]]:
    """The errors that are said, or the usual ones, with a line that says so."""
    deviations: dict[str, float] = {}
    play: dict[str, float] = {}
    for words in said:
        name, equals, value = words.partition('=')
        if not equals:
            deviations |= _fitted(words)
        elif name.startswith('play:'):
            play[name.removeprefix('play:')] = quantity(f'--tolerances {words!r}', value, 'length')
        else:
            kind = 'angle' if name == 'angle' or _is_angle(scene, name) else 'length'
            deviations[name] = quantity(f'--tolerances {words!r}', value, kind)
    if said:
        return tolerances_of(scene, deviations, play), []
    note = 'no --tolerances: each length is taken to be off by 0.1 mm, each angle by 0.1 deg'
    return tolerances_of(scene, _USUAL, {}), [note]


def _is_angle(scene: Scene, name: str) -> bool:
    return any(row.name == name and row.kind == 'angle' for row in scene.equations.dimensions)


def _fitted(path: str) -> dict[str, float]:
    """Deviations that `kinpole fit` printed into a file, by name."""
    try:
        text = Path(path).read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError):
        raise SceneError(
            f'--tolerances {path!r}: give NAME=0.1mm, play:PIN=0.05mm, or a file with what '
            '`kinpole fit` printed'
        ) from None
    found = {
        name: float(deviation) * (1.0 if unit == 'm' else np.pi / 180)
        for name, unit, deviation in _FITTED.findall(text)
    }
    if not found:
        raise SceneError(f'{path} has no line of `kinpole fit` with a deviation')
    return found


def _error_lines(errors: Sequence[Tolerance]) -> list[str]:
    rows: list[list[str | float]] = []
    for error in errors:
        angle = not error.is_play and error.path[-1] in ('angle', 'along', 'turned')
        size, unit = (180 / np.pi, 'deg') if angle else (1e3, 'mm')
        rows.append([error.name, error.deviation * size, unit])
    return table_lines(['dimension', 'standard deviation', ''], rows)


def _spread_lines(solved: Solved, found: ToleranceSpread, errors: Sequence[Tolerance]) -> list[str]:
    """A row for each quantity: deviations over the range, and where they come from."""
    rows: list[list[str | float]] = []
    sampled = _sampled(found)
    for q, (name, what) in enumerate(found.names):
        unit, size = _UNITS.get(what, ('mm', 1e3))
        deviation = found.deviation[q] * size
        if not np.isfinite(deviation).any() or np.nanmax(deviation) < 1e-9:
            continue
        worst = int(np.nanargmax(deviation))
        shares = (found.parts[:, q] ** 2).mean(axis=1, where=np.isfinite(found.parts[:, q]))
        order = np.argsort(-shares)[:_NAMED]
        shares /= shares.sum()
        main = ', '.join(f'{errors[k].name} {shares[k]:.0%}' for k in order if shares[k] > 0.005)
        at = float(solved.times[worst]) if solved.times is not None else 0.0
        where = shown(solved.scene, 0, solved.inputs[0, worst], 4) if at == 0.0 else f'{at:.4g} s'
        row: list[str | float] = [f'{name} {what}', unit, float(np.nanmedian(deviation))]
        row += [float(deviation[worst]), where]
        if sampled is not None:
            row += [float(sampled[0][q, worst] * size), *(sampled[1][:, q, worst] * size)]
        rows.append([*row, main])
    head = ['quantity', 'unit', 'median', 'largest', 'at']
    head += ['sampled', '2.5%', '97.5%'] if sampled is not None else []
    return table_lines([*head, 'mostly from'], rows)


def _sampled(found: ToleranceSpread) -> tuple[np.ndarray, np.ndarray] | None:
    """Standard deviations (Q, T) and 95% bands (2, Q, T) less the value, of the samples."""
    if len(found.samples) < 2:
        return None
    off = found.samples - found.value
    return off.std(axis=0, ddof=1), np.percentile(off, [2.5, 97.5], axis=0)


def _write_table(path: Path, solved: Solved, found: ToleranceSpread) -> None:
    columns: dict[str, np.ndarray] = {}
    if solved.times is not None:
        columns['t'] = solved.times
    for k, driver in enumerate(solved.scene.mechanism.drivers):
        columns[driver.name] = solved.inputs[k]
    sampled = _sampled(found)
    for q, words in enumerate(found.names):
        name = '_'.join(words).replace('.', '_').replace(' ', '_')
        columns[f'value_{name}'] = found.value[q]
        columns[f'sigma_{name}'] = found.deviation[q]
        if sampled is not None:
            columns[f'sampled_sigma_{name}'] = sampled[0][q]
            columns[f'sampled_low_{name}'] = found.value[q] + sampled[1][0, q]
            columns[f'sampled_high_{name}'] = found.value[q] + sampled[1][1, q]
    write_columns(path, columns)


def _draw(path: Path, kind: str, solved: Solved, found: ToleranceSpread) -> None:
    """Paths of points with their bands, and deviations over the range; dots are of the samples."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 8), layout='constrained')
    grid = figure.add_gridspec(3, 2, width_ratios=(1.1, 1))
    _draw_paths(figure.add_subplot(grid[:, 0]), found)
    at, label = solved.times, 'time (s)'
    if at is None:
        unit, size = driver_unit(solved.scene, 0)
        at, label = solved.inputs[0] / size, f'{solved.scene.mechanism.drivers[0].name} ({unit})'
    sampled = _sampled(found)
    for k, kinds in enumerate((('x', 'y'), ('angle',), ('ICR x', 'ICR y'))):
        axis = figure.add_subplot(grid[k, 1])
        unit, size = _UNITS.get(kinds[0], ('mm', 1e3))
        for q, (name, what) in enumerate(found.names):
            deviation = found.deviation[q] * size
            if what not in kinds or not np.nanmax(deviation, initial=0.0) > 1e-9:
                continue
            dashes = '--' if what[-1] == 'y' else '-'
            (line,) = axis.plot(at, deviation, dashes, label=f'{name} {what}', linewidth=1.2)
            if sampled is not None:
                axis.plot(at[::8], sampled[0][q][::8] * size, '.', color=line.get_color())
        axis.set(ylabel=f'deviation ({unit})', xlabel=label, yscale='log' if k == 2 else 'linear')
        axis.grid(alpha=0.3)
        if axis.lines:
            axis.legend(fontsize=6, ncols=3)
    name = solved.scene.name
    title = f'{name}: standard deviations, to first order' + (', dots: samples' if sampled else '')
    figure.suptitle(title, parse_math=False)
    figure.savefig(path, format=kind, dpi=150)


def _draw_paths(axis: Any, found: ToleranceSpread) -> None:
    """Paths of points, and to both sides two deviations across them, times a round number."""
    rows = {words: q for q, words in enumerate(found.names)}
    paths: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name in (name for name, what in found.names if what == 'x'):
        x, y = rows[name, 'x'], rows[name, 'y']
        z = found.value[x] + 1j * found.value[y]
        way = np.gradient(z)
        if np.nanmax(np.abs(way), initial=0.0) < 1e-9:
            continue
        across = 1j * np.exp(1j * np.angle(way))
        parts = found.parts[:, x] * across.real + found.parts[:, y] * across.imag
        paths[name] = z, 2 * across * np.sqrt((parts**2).sum(axis=0))
    extent = max((np.nanmax(np.abs(z - np.nanmean(z))) for z, _ in paths.values()), default=1.0)
    widest = max((np.nanmax(np.abs(band)) for _, band in paths.values()), default=0.0)
    times = 10.0 ** np.floor(np.log10(_BAND * extent / widest)) if widest else 1.0
    for name, (z, band) in paths.items():
        (line,) = axis.plot(z.real, z.imag, label=name)
        one, other = z + times * band, (z - times * band)[::-1]
        edge = np.concatenate((one, other))
        edge = edge[np.isfinite(edge)]
        axis.fill(edge.real, edge.imag, color=line.get_color(), alpha=0.2, linewidth=0)
    axis.set(xlabel='x (m)', ylabel='y (m)', aspect='equal')
    axis.set_title(f'paths, with bands of two deviations, {times:g} times as wide', fontsize=10)
    if paths:
        axis.legend(fontsize=8)


def _columns(found: ToleranceSpread) -> Mapping[tuple[str, str], Any]:
    """Deviations and covariances of bodies as a report has them."""
    rows = {words: q for q, words in enumerate(found.names)}
    columns: dict[tuple[str, str], np.ndarray] = {}
    for body in dict.fromkeys(name for name, what in found.names if what == 'angle'):
        columns[body, 'angle_sigma'] = found.deviation[rows[body, 'angle']]
        columns[body, 'angular_velocity_sigma'] = found.deviation[rows[body, 'angular velocity']]
        parts = found.parts[:, [rows[body, 'ICR x'], rows[body, 'ICR y']]]
        columns[body, 'icr_covariance'] = np.einsum('eat,ebt->tab', parts, parts)
    return columns
