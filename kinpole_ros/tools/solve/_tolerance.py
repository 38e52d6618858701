"""`kinpole tolerance`: how errors of a scene's dimensions spread over its motion."""

import re
from argparse import Namespace
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.mechanism import Scene, SceneError, load_scene, quantity
from kinpole_ros.mechanism._dimension_errors import (
    Tolerance,
    ToleranceSpread,
    propagate_tolerances,
    tolerances_of,
)
from kinpole_ros.tools.solve import _solution
from kinpole_ros.tools.solve._solution import SolvedScene
from kinpole_ros.tools.solve._spreadsheet import write_columns
from kinpole_ros.tools.solve._text import Row, head_lines, table_lines

_POSITIONS = 121
# Standard deviations of lengths, m, and angles, rad, if none are given.
_DEFAULT = {'length': 1e-4, 'angle': np.radians(0.1)}
# A line that `kinpole fit` prints.
_FIT_LINE = re.compile(r'^(\S+(?: [xy])?) +\S+ (m|deg), deviation ([\d.e+-]+);', re.M)
# The widest band in the picture is below this fraction of the largest path.
_BAND_WIDTH = 0.3
# Errors that are listed as the largest contributions to a quantity.
_CONTRIBUTIONS = 3
# Quantities with a standard deviation below this, in their unit, are constant.
_CONSTANT = 1e-9


def tolerances(options: Namespace) -> list[str]:
    """
    Return the errors of a scene's points, angles and centers as lines to print.

    `options` are those of `kinpole tolerance`, which name the files to write. Raises SceneError,
    LinkageError, and BagError for a picture that cannot be written.
    """
    if options.plot:
        from kinpole_ros.tools.plot._style import picture_format, saved_figure  # which needs mcap

        picture_format(options.plot)
    loaded = load_scene(options.scene)
    errors, notes = _errors(loaded, options.tolerances)
    if not errors:
        raise SceneError('no dimension has an error: give --tolerances 0.1mm')
    solution = _solution.over_full_motion(loaded, _POSITIONS)
    spread = propagate_tolerances(loaded, errors, solution.values, solution.rates, options.samples)
    lines = [*head_lines(loaded), *notes, '', *_error_lines(errors)]
    lines += ['', *_spread_lines(solution, spread, errors)]
    if options.csv:
        with _solution.open_output(options.csv) as part:
            _write_table(part, solution, spread)
        lines.append(f'written to {options.csv}')
    if options.plot:
        with saved_figure(options.plot, (13, 8), 150) as figure:
            _draw(figure, solution, spread)
        lines.append(f'written to {options.plot}')
    if options.html:
        from kinpole_ros.tools.solve._scene_page import write_page

        with _solution.open_output(options.html) as part:
            write_page(part, solution, solution.at(0), _record_columns(spread))
        lines.append(f'written to {options.html}')
    return lines


def _errors(scene: Scene, texts: Sequence[str]) -> tuple[list[Tolerance], list[str]]:
    """Return the errors that are given, or the default ones with a note."""
    if not texts:
        note = 'no --tolerances: each length is taken to be off by 0.1 mm, each angle by 0.1 deg'
        return tolerances_of(scene, _DEFAULT, {}), [note]
    deviations: dict[str, float] = {}
    play: dict[str, float] = {}
    angles = {'angle', *(row.name for row in scene.equations.dimensions if row.kind == 'angle')}
    for text in texts:
        name, equals, value = text.partition('=')
        if not equals and (kind := _kind_of(text)):
            deviations[kind] = quantity(f'--tolerances {text!r}', text, kind)
        elif not equals:
            deviations |= _fit_deviations(text)
        elif name.startswith('play:'):
            play[name.removeprefix('play:')] = quantity(f'--tolerances {text!r}', value, 'length')
        else:
            kind = 'angle' if name in angles else 'length'
            deviations[name] = quantity(f'--tolerances {text!r}', value, kind)
    return tolerances_of(scene, deviations, play), []


def _kind_of(text: str) -> str:
    """Return whether a value with its unit is a length or an angle; '' for other words."""
    for kind in ('length', 'angle'):
        with suppress(SceneError):
            quantity('', text, kind)
            return kind if not text.strip()[-1].isdigit() else ''
    return ''


def _fit_deviations(path: str) -> dict[str, float]:
    """Return the standard deviations in a file with the output of `kinpole fit`, by name."""
    try:
        text = Path(path).read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError):
        raise SceneError(
            f'--tolerances {path!r}: give 0.1mm, NAME=0.1mm, play:PIN=0.05mm, or a file with what '
            '`kinpole fit` printed'
        ) from None
    deviations = {
        name: float(deviation) * (1.0 if unit == 'm' else np.pi / 180)
        for name, unit, deviation in _FIT_LINE.findall(text)
    }
    if not deviations:
        raise SceneError(f'{path} has no line of `kinpole fit` with a deviation')
    return deviations


def _error_lines(errors: Sequence[Tolerance]) -> list[str]:
    rows: list[Row] = []
    for error in errors:
        is_angle = not error.is_play and error.path[-1] in ('angle', 'along', 'turned')
        scale, unit = (180 / np.pi, 'deg') if is_angle else (1e3, 'mm')
        rows.append([error.name, error.deviation * scale, unit])
    return table_lines(['dimension', 'standard deviation', ''], rows)


def _unit_of(kind: str) -> tuple[str, float]:
    """Return the unit in which a kind of quantity is shown, and how many of them are 1 in SI."""
    return {'angle': ('deg', 180 / np.pi), 'angular velocity': ('rad/s', 1.0)}.get(
        kind, ('mm', 1e3)
    )


def _spread_lines(
    solution: SolvedScene, spread: ToleranceSpread, errors: Sequence[Tolerance]
) -> list[str]:
    """Return a row for each quantity: standard deviations over the range, and contributions."""
    rows: list[Row] = []
    sampled = _sampled(spread)
    for q, (name, kind) in enumerate(spread.names):
        unit, scale = _unit_of(kind)
        deviation = spread.deviation[q] * scale
        if not np.nanmax(deviation, initial=0.0) >= _CONSTANT:
            continue
        worst = int(np.nanargmax(deviation))
        shares = (spread.parts[:, q] ** 2).mean(axis=1, where=np.isfinite(spread.parts[:, q]))
        order = np.argsort(-shares)[:_CONTRIBUTIONS]
        shares /= shares.sum()
        main = ', '.join(f'{errors[k].name} {shares[k]:.0%}' for k in order if shares[k] > 0.005)
        time = float(solution.times[worst]) if solution.times is not None else 0.0
        at = _solution.driver_text(solution.scene, 0, solution.inputs[0, worst], 4)
        row: Row = [f'{name} {kind}', unit, float(np.nanmedian(deviation))]
        row += [float(deviation[worst]), f'{time:.4g} s' if time else at]
        if sampled is not None:
            row += [float(sampled[0][q, worst] * scale), *(sampled[1][:, q, worst] * scale)]
        rows.append([*row, main])
    head = ['quantity', 'unit', 'median', 'largest', 'at']
    head += ['sampled', '2.5%', '97.5%'] if sampled is not None else []
    return table_lines([*head, 'mostly from'], rows)


def _sampled(spread: ToleranceSpread) -> tuple[np.ndarray, np.ndarray] | None:
    """Return standard deviations (Q, T) and 95% bands (2, Q, T) about the value, of the samples."""
    if len(spread.samples) < 2:
        return None
    errors = spread.samples - spread.value
    return errors.std(axis=0, ddof=1), np.percentile(errors, [2.5, 97.5], axis=0)


def _write_table(path: Path, solution: SolvedScene, spread: ToleranceSpread) -> None:
    columns: dict[str, np.ndarray] = {}
    if solution.times is not None:
        columns['t'] = solution.times
    for k, driver in enumerate(solution.scene.mechanism.drivers):
        columns[driver.name] = solution.inputs[k]
    sampled = _sampled(spread)
    for q, words in enumerate(spread.names):
        name = '_'.join(words).replace('.', '_').replace(' ', '_')
        columns[f'value_{name}'] = spread.value[q]
        columns[f'sigma_{name}'] = spread.deviation[q]
        if sampled is not None:
            columns[f'sampled_sigma_{name}'] = sampled[0][q]
            columns[f'sampled_low_{name}'] = spread.value[q] + sampled[1][0, q]
            columns[f'sampled_high_{name}'] = spread.value[q] + sampled[1][1, q]
    write_columns(path, columns)


def _draw(figure: Any, solution: SolvedScene, spread: ToleranceSpread) -> None:
    """Draw paths with bands, and standard deviations over the range; dots are of the samples."""
    grid = figure.add_gridspec(3, 2, width_ratios=(1.1, 1))
    _draw_paths(figure.add_subplot(grid[:, 0]), spread)
    at, label = solution.times, 'time (s)'
    if at is None:
        unit, size = _solution.driver_unit(solution.scene, 0)
        at, label = (
            solution.inputs[0] / size,
            f'{solution.scene.mechanism.drivers[0].name} ({unit})',
        )
    sampled = _sampled(spread)
    for k, kinds in enumerate((('x', 'y'), ('angle',), ('ICR x', 'ICR y'))):
        axis = figure.add_subplot(grid[k, 1])
        unit, scale = _unit_of(kinds[0])
        for q, (name, quantity_kind) in enumerate(spread.names):
            deviation = spread.deviation[q] * scale
            if quantity_kind not in kinds or not np.nanmax(deviation, initial=0.0) > _CONSTANT:
                continue
            dashes = '--' if quantity_kind[-1] == 'y' else '-'
            label_text = f'{name} {quantity_kind}'
            (line,) = axis.plot(at, deviation, dashes, label=label_text, linewidth=1.2)
            if sampled is not None:
                axis.plot(at[::8], sampled[0][q][::8] * scale, '.', color=line.get_color())
        axis.set(ylabel=f'deviation ({unit})', xlabel=label, yscale='log' if k == 2 else 'linear')
        axis.grid(alpha=0.3)
        if axis.lines:
            axis.legend(fontsize=6, ncols=3)
    dots = '' if sampled is None else ', dots: samples'
    title = f'{solution.scene.name}: standard deviations, to first order{dots}'
    figure.suptitle(title, parse_math=False)


def _draw_paths(axis: Any, spread: ToleranceSpread) -> None:
    """Draw paths of points with bands of two standard deviations, magnified by a power of ten."""
    index = {words: q for q, words in enumerate(spread.names)}
    paths: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name in (name for name, kind in spread.names if kind == 'x'):
        x, y = index[name, 'x'], index[name, 'y']
        z = spread.value[x] + 1j * spread.value[y]
        direction = np.gradient(z)
        if np.nanmax(np.abs(direction), initial=0.0) < 1e-9:
            continue
        normal = 1j * np.exp(1j * np.angle(direction))
        across = spread.parts[:, x] * normal.real + spread.parts[:, y] * normal.imag
        paths[name] = z, 2 * normal * np.sqrt((across**2).sum(axis=0))
    extent = max((np.nanmax(np.abs(z - np.nanmean(z))) for z, _ in paths.values()), default=1.0)
    widest = max((np.nanmax(np.abs(band)) for _, band in paths.values()), default=0.0)
    times = 10.0 ** np.floor(np.log10(_BAND_WIDTH * extent / widest)) if widest else 1.0
    for name, (z, band) in paths.items():
        (line,) = axis.plot(z.real, z.imag, label=name)
        edge = np.concatenate((z + times * band, (z - times * band)[::-1]))
        edge = edge[np.isfinite(edge)]
        axis.fill(edge.real, edge.imag, color=line.get_color(), alpha=0.2, linewidth=0)
    axis.set(xlabel='x (m)', ylabel='y (m)', aspect='equal')
    axis.set_title(f'paths, with bands of two deviations, {times:g} times as wide', fontsize=10)
    if paths:
        axis.legend(fontsize=8)


def _record_columns(spread: ToleranceSpread) -> Mapping[tuple[str, str], Any]:
    """Return standard deviations and covariances of bodies as a report has them."""
    index = {words: q for q, words in enumerate(spread.names)}
    columns: dict[tuple[str, str], np.ndarray] = {}
    for body in dict.fromkeys(name for name, kind in spread.names if kind == 'angle'):
        for kind in ('angle', 'angular velocity'):
            name = f'{kind.replace(" ", "_")}_sigma'
            columns[body, name] = spread.deviation[index[body, kind]]
        axes = spread.parts[:, [index[body, 'ICR x'], index[body, 'ICR y']]]
        columns[body, 'icr_covariance'] = np.einsum('eat,ebt->tab', axes, axes)
    return columns
