"""
The page of `kinpole solve --html`: a report of a motion that is solved instead of measured.

Quantities have no uncertainty there, or that of the tolerances of the dimensions.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kinpole_ros import __version__
from kinpole_ros.files import printable
from kinpole_ros.mechanism import poles
from kinpole_ros.tools.report import Record, pack, page
from kinpole_ros.tools.solve._editor import editor_data
from kinpole_ros.tools.solve._shapes import belts_of, outline_of, rims_of
from kinpole_ros.tools.solve._solution import Solution, acting_loads, angle_rates, centers_of
from kinpole_ros.tools.solve._statics import work_lines
from kinpole_ros.tracking.estimate import POLE_NAMES, RATE_NAMES

# Coordinates below this fraction of the largest body are rounding.
_ROUNDING = 1e-9


def write_page(
    path: Path,
    solution: Solution,
    here: Solution,
    deviations: Mapping[tuple[str, str], np.ndarray] | None = None,
    text: str = '',
) -> None:
    """
    Write the motion over time, or over a range at the rate of the driver, as one HTML file.

    The statics step by step, where there are loads, are those of the position `here`. `deviations`
    are columns (T, ...) of bodies as a `Record` has them. With the `text` of the scene's file, the
    points of the scene can be dragged.
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
        'scene': printable(scene.name),
        'deviations': [],
        'belts': belts_of(scene),
        'work': work_lines(here) if acting_loads(here).all else [],
        'solved': True,
        'exact': deviations is None,
        'made': f'kinpole {__version__}',
    }
    if text and (editor := editor_data(solution, text, np.argsort(_times(solution)))):
        data['edit'] = editor
    path.write_text(page(data), encoding='utf-8')


def _times(solution: Solution) -> np.ndarray:
    """Return the times (T,), s; over a range, those at the rate of the driver."""
    return solution.inputs[0] / solution.rates[0] if solution.times is None else solution.times


def _record(solution: Solution, deviations: Mapping[tuple[str, str], np.ndarray]) -> Record:
    """Return the motion as a report has it, in the order of time."""
    mechanism, motion = solution.scene.mechanism, solution.motion
    times = _times(solution)
    order = np.argsort(times)
    stamp = np.round((times - times.min())[order] * 1e9).astype(np.int64)
    count = len(stamp)
    no_sigma, no_covariance = np.full(count, np.nan), np.full((count, 2, 2), np.nan)
    columns: dict[tuple[str | tuple[str, str], str], np.ndarray] = {}
    body_poles, angles = poles(mechanism, motion), angle_rates(motion)
    dead = ~motion.regular[order]
    outlines, sizes = {}, {}
    for b, body in enumerate(mechanism.bodies):
        angle = angles[:, b, order]
        columns[body, 'position'] = motion.position[0, b, order]
        columns[body, 'velocity'] = motion.position[1, b, order]
        columns[body, 'position_sigma'] = columns[body, 'angle_sigma'] = no_sigma
        columns[body, 'angle'] = angle[0]
        columns[body, 'missing'] = np.full(count, '', object)
        numbers = dict(zip(RATE_NAMES, angle[1:], strict=True))
        numbers['centrode_curvature'] = body_poles.curvature[b, order]
        for name, values in numbers.items():
            columns[body, name], columns[body, f'{name}_sigma'] = values, no_sigma
        velocity = body_poles.velocity[b, order]
        points = {name: getattr(body_poles, name)[b, order] for name in POLE_NAMES}
        for name, values in (points | {'icr_velocity': velocity}).items():
            columns[body, name], columns[body, f'{name}_covariance'] = values, no_covariance
        for name in (*POLE_NAMES, 'centrode_curvature'):
            reason = np.where(np.isnan(columns[body, name]), 'at infinity', '').astype(object)
            if name == 'centrode_curvature':
                reason[(reason != '') & (velocity == 0)] = 'the ICR stands still'
            reason[dead & (reason != '')] = 'dead point'
            columns[body, f'{name}_withheld'] = reason
        outline = outline_of(solution.scene, body)
        outlines[body] = [(0, outline)]
        diameters = [2 * rim.radius for rim in rims_of(solution.scene, body)]
        size = max([float(np.abs(outline[:, None] - outline).max()), *diameters])
        sizes[body] = size or float('nan')
    centers = centers_of(solution)
    for (i, j), values in zip(centers.pairs, centers.points, strict=True):
        if i:  # not of the ground
            pair = centers.bodies[j], centers.bodies[i]
            columns[pair, 'icr'], columns[pair, 'icr_covariance'] = values[order], no_covariance
    columns |= {key: values[order] for key, values in deviations.items()}
    rounding = _ROUNDING * np.nanmax([*sizes.values(), 0.0])
    for (_, name), values in columns.items():
        if name in (*POLE_NAMES, 'position'):
            for part in (values.real, values.imag):
                part[np.abs(part) < rounding] = 0.0
    return Record(stamp, count, mechanism.bodies, columns, sizes, outlines, ('x', 'y'))
