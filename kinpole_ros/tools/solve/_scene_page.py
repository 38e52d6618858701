"""
The page of `kinpole solve --html`: a report of a motion that is solved instead of measured.

Quantities have no uncertainty there, or that of the tolerances of the dimensions.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kinpole_ros import __version__
from kinpole_ros.files import printable
from kinpole_ros.mechanism import GROUND, Motion, Poles, Scene, poles
from kinpole_ros.tools.record.record import Columns, MotionRecord
from kinpole_ros.tools.report import pack, page
from kinpole_ros.tools.solve._editor import editor_data
from kinpole_ros.tools.solve._shapes import drawn_data, outline_of, rims_of
from kinpole_ros.tools.solve._solution import SolvedScene, acting_loads, angle_rates, centers_of
from kinpole_ros.tools.solve._statics import work_lines
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES

# Coordinates below this fraction of the largest body are rounding, and rates below this fraction of
# the largest one.
_ROUNDING = 1e-9
_ROUNDED = 'next to a dead point'  # where `over_range` drops derivatives that are mostly rounding


def write_page(
    path: Path,
    solution: SolvedScene,
    here: SolvedScene,
    deviations: Mapping[tuple[str, str], np.ndarray] | None = None,
    text: str = '',
) -> None:
    """
    Write a motion as one HTML file, with the virtual work at the position `here`, if it has loads.

    `deviations` are columns (T, ...) of the record with standard deviations and covariances. With
    the `text` of the scene file, the points of the scene can be dragged.
    """
    scene = solution.scene
    record = _record(solution, deviations or {})
    packed = pack(record)
    for body in packed['bodies']:
        body['points'] = [
            [name.rpartition('.')[2], point.real, point.imag]
            for name, (owner, point) in scene.points.items()
            if owner == body['name']
        ]
        # In vector loops without joints, most ends of vectors have no name.
        if not scene.mechanism.assembly.joints:
            body['points'] += [['', z.real, z.imag] for z in outline_of(scene, body['name'])]
        rims = rims_of(scene, body['name'])
        body['rims'] = [[rim.hub.real, rim.hub.imag, rim.radius] for rim in rims]
    seconds = (record.stamp[-1] - record.stamp[0]) * 1e-9
    drivers = ', '.join(driver.name for driver in scene.mechanism.drivers)
    bands = '' if deviations is None else '; bands are of the errors of its dimensions'
    data = {
        **packed,
        'title': printable(scene.name),
        'about': f'solved, not measured: {len(record.stamp)} positions in {seconds:.4g} s, '
        f'driven: {drivers}{bands}',
        'notes': [],
        'scene': printable(scene.name),  # the name of the file that the editor saves
        'deviations': [],
        **drawn_data(solution),
        'work': work_lines(here) if acting_loads(here).loads else [],
        'solved': True,
        'exact': deviations is None,
        'made': f'kinpole {__version__}',
    }
    if text and (editor := editor_data(solution, text, np.argsort(_times(solution)))):
        data['edit'] = editor
    path.write_text(page(data), encoding='utf-8')


def _times(solution: SolvedScene) -> np.ndarray:
    """Return the times (T,), s; over a range, which has one driver, those at its rate, never 0."""
    return solution.inputs[0] / solution.rates[0] if solution.times is None else solution.times


def _record(
    solution: SolvedScene, deviations: Mapping[tuple[str, str], np.ndarray]
) -> MotionRecord:
    """Return the motion as a report has it, in the order of time."""
    scene, bodies = solution.scene, solution.scene.mechanism.bodies
    times = _times(solution)
    order = np.argsort(times)
    stamp = np.round((times - times.min())[order] * 1e9).astype(np.int64)
    outlines = {body: outline_of(scene, body) for body in bodies}
    sizes = {body: _diameter(scene, body, outline) for body, outline in outlines.items()}
    unordered = _body_columns(solution) | _pair_columns(solution) | dict(deviations)
    columns = {key: values[order] for key, values in unordered.items()}
    rounding = _ROUNDING * np.nanmax([*sizes.values(), 0.0])
    for (_, name), values in columns.items():
        if name in (*POLE_NAMES, 'position'):
            for part in (values.real, values.imag):
                part[np.abs(part) < rounding] = 0.0
    from_first_instant = {body: [(0, outline)] for body, outline in outlines.items()}
    return MotionRecord(stamp, len(stamp), bodies, columns, sizes, from_first_instant, ('x', 'y'))


def _diameter(scene: Scene, body: str, outline: np.ndarray) -> float:
    diameters = [2 * rim.radius for rim in rims_of(scene, body)]
    return max([float(np.abs(outline[:, None] - outline).max()), *diameters]) or float('nan')


def _body_columns(solution: SolvedScene) -> Columns:
    """Return the columns of all bodies, at the T positions in the order of the solution."""
    mechanism, motion = solution.scene.mechanism, solution.motion
    body_poles, angles = poles(mechanism, motion), angle_rates(motion)
    reasons = _reasons(motion, angles, body_poles)
    count = angles.shape[-1]
    no_sigma, no_covariance = np.full(count, np.nan), np.full((count, 2, 2), np.nan)
    columns: Columns = {}
    for b, body in enumerate(mechanism.bodies):
        columns[body, 'position'] = motion.position[0, b]
        columns[body, 'velocity'] = motion.position[1, b]
        columns[body, 'angle'] = angles[0, b]
        columns[body, 'position_sigma'] = columns[body, 'angle_sigma'] = no_sigma
        columns[body, 'missing'] = np.full(count, '', object)
        numbers = dict(zip(RATE_NAMES, angles[1:, b], strict=True))
        numbers['centrode_curvature'] = body_poles.curvature[b]
        numbers['inflection_diameter'] = body_poles.inflection_diameter[b]
        for name, values in numbers.items():
            columns[body, name], columns[body, f'{name}_sigma'] = values, no_sigma
        points = {name: getattr(body_poles, name)[b] for name in POLE_NAMES}
        points['icr_velocity'] = body_poles.velocity[b]
        points['ball_point'] = body_poles.ball_point[b]
        for name, values in points.items():
            columns[body, name], columns[body, f'{name}_covariance'] = values, no_covariance
        for name, reason in reasons.items():
            columns[body, f'{name}_withheld'] = reason[b]
    return columns


def _reasons(motion: Motion, angles: np.ndarray, body_poles: Poles) -> dict[str, np.ndarray]:
    """Return why poles and curvatures (B, T) do not exist, '' where they do, by name."""
    reasons = {}
    is_at_rest = np.ones(angles.shape[1:], bool)
    for order, name in enumerate(POLE_NAMES, 1):
        is_at_rest &= _is_zero(motion.position[order]) & _is_zero(angles[order])
        pole = getattr(body_poles, name)
        is_rounding = np.isnan(motion.position[order]) & np.isnan(pole)
        causes = {'dead point': ~motion.regular, _ROUNDED: is_rounding, 'at rest': is_at_rest}
        reasons[name] = _first_cause(pole, causes, 'at infinity')
    # `poles` sets the velocity of an ICR that stands still to 0.
    causes = {'dead point': ~motion.regular, 'the ICR stands still': body_poles.velocity == 0}
    causes |= {reason: reasons['icr'] == reason for reason in (_ROUNDED, 'at rest')}
    of_motion = {
        'centrode_curvature': body_poles.curvature,
        'inflection_circle': body_poles.inflection_diameter,
    }
    for name, values in of_motion.items():
        reasons[name] = _first_cause(values, causes, 'at infinity')
    return reasons


def _first_cause(values: np.ndarray, causes: Mapping[str, np.ndarray], other: str) -> np.ndarray:
    """Return the first cause that holds where values are NaN, `other` if none does."""
    conditions = [np.broadcast_to(is_cause, values.shape) for is_cause in causes.values()]
    cause = np.select(conditions, [*causes], other)
    return np.where(np.isnan(values), cause, '').astype(object)


def _is_zero(rates: np.ndarray) -> np.ndarray:
    """Return where rates of bodies (B, T) are 0 but for rounding."""
    return np.asarray(np.abs(rates) <= _ROUNDING * np.nanmax(np.abs(rates), initial=0.0))


def _pair_columns(solution: SolvedScene) -> Columns:
    """Return the relative centers of pairs of moving bodies."""
    centers = centers_of(solution)
    no_covariance = np.full((solution.inputs.shape[-1], 2, 2), np.nan)
    columns: Columns = {}
    for (i, j), values in zip(centers.pairs, centers.points, strict=True):
        if centers.bodies[i] != GROUND:
            pair = centers.bodies[j], centers.bodies[i]
            columns[pair, 'icr'], columns[pair, 'icr_covariance'] = values, no_covariance
    return columns
