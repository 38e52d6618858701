"""
The page of `kinpole solve --html`: that of a report, of a motion that is solved and not measured.

Figures have no deviations there. All else, the linkage in motion and its centrodes rolling, is the
report's.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros import __version__
from kinpole_ros.files import printable
from kinpole_ros.mechanism import Belt, Rolling, Scene, poles
from kinpole_ros.tools.report import Record, pack, page
from kinpole_ros.tools.solve._edit import editable
from kinpole_ros.tools.solve._solved import Solved, acting, centers_of, rates_of
from kinpole_ros.tools.solve._work import work_lines
from kinpole_ros.tracking.estimate import POLE_NAMES, RATE_NAMES

# In sizes of the bodies.
_ZERO = 1e-9


def write_page(
    path: Path,
    solved: Solved,
    here: Solved,
    deviations: Mapping[tuple[str, str], np.ndarray] | None = None,
    text: str = '',
) -> None:
    """
    Write the motion over time, or over a range at the rate it is driven at, as one HTML file.

    The statics step by step, where there are loads, are those of the position `here`. Deviations
    are columns (T, ...) of bodies as a `Record` has them. With the `text` of the scene's file its
    points can be dragged.
    """
    record = _record(solved, deviations or {})
    scene = solved.scene
    seconds = (record.stamp[-1] - record.stamp[0]) * 1e-9
    driven = ', '.join(driver.name for driver in scene.mechanism.drivers)
    packed = pack(record)
    for body in packed['bodies']:
        rims = _rims(scene, body['name'])
        body['points'] = [
            [name.rpartition('.')[2], place.real, place.imag]
            for name, (of, place) in scene.points.items()
            if of == body['name']
        ]
        if not scene.mechanism.assembly.joints:
            body['points'] += [['', z.real, z.imag] for z in _outline(scene, body['name'])]
        body['rims'] = [[hub.real, hub.imag, radius] for hub, radius in rims]
    data = {
        **packed,
        'title': printable(scene.name),
        'about': f'solved, not measured: {len(record.stamp)} positions in {seconds:.4g} s, '
        f'driven: {driven}'
        + ('' if deviations is None else '; bands are of the errors of its dimensions'),
        'notes': [],
        'scene': printable(scene.name),
        'deviations': [],
        'belts': _belts(scene),
        'work': work_lines(here) if acting(here).all else [],
        'solved': True,
        'exact': deviations is None,
        'made': f'kinpole {__version__}',
    }
    if text and (edit := editable(solved, text, _by_time(solved))):
        data['edit'] = edit
    path.write_text(page(data), encoding='utf-8')


def _by_time(solved: Solved) -> np.ndarray:
    """The order (T,) of rising time."""
    return np.argsort(_times(solved))


def _times(solved: Solved) -> np.ndarray:
    return solved.inputs[0] / solved.rates[0] if solved.times is None else solved.times


def _record(solved: Solved, deviations: Mapping[tuple[str, str], np.ndarray]) -> Record:
    """The motion as a report has it, by rising time."""
    mechanism, motion = solved.scene.mechanism, solved.motion
    times, order = _times(solved), _by_time(solved)
    stamp = np.round((times - times.min())[order] * 1e9).astype(np.int64)
    count = len(stamp)
    none, even = np.full(count, np.nan), np.full((count, 2, 2), np.nan)
    columns: dict[tuple[str | tuple[str, str], str], np.ndarray] = {}
    found, angles = poles(mechanism, motion), rates_of(motion)
    dead = ~motion.regular[order]
    outlines, sizes = {}, {}
    for b, body in enumerate(mechanism.bodies):
        angle = angles[:, b, order]
        columns[body, 'position'] = motion.position[0, b, order]
        columns[body, 'velocity'] = motion.position[1, b, order]
        columns[body, 'position_sigma'] = columns[body, 'angle_sigma'] = none
        columns[body, 'angle'] = angle[0]
        columns[body, 'missing'] = np.full(count, '', object)
        rates = dict(zip(RATE_NAMES, angle[1:], strict=True))
        for name, values in (rates | {'centrode_curvature': found.curvature[b, order]}).items():
            columns[body, name], columns[body, f'{name}_sigma'] = values, none
        u = found.velocity[b, order]
        places = {name: getattr(found, name)[b, order] for name in POLE_NAMES}
        for name, points in (places | {'icr_velocity': u}).items():
            columns[body, name], columns[body, f'{name}_covariance'] = points, even
        for name in (*POLE_NAMES, 'centrode_curvature'):
            why = np.where(np.isnan(columns[body, name]), 'at infinity', '').astype(object)
            if name == 'centrode_curvature':
                why[(why != '') & (u == 0)] = 'the ICR stands still'
            why[dead & (why != '')] = 'dead point'
            columns[body, f'{name}_withheld'] = why
        outline = _outline(solved.scene, body)
        outlines[body] = [(0, outline)]
        across = [2 * radius for _, radius in _rims(solved.scene, body)]
        size = max([float(np.abs(outline[:, None] - outline).max()), *across])
        sizes[body] = size or float('nan')
    centers = centers_of(solved)
    for (i, j), points in zip(centers.pairs, centers.points, strict=True):
        if i:
            pair = centers.bodies[j], centers.bodies[i]
            columns[pair, 'icr'], columns[pair, 'icr_covariance'] = points[order], even
    columns |= {key: values[order] for key, values in deviations.items()}
    size = np.nanmax([*sizes.values(), 0.0])
    for (_, name), values in columns.items():
        if name in (*POLE_NAMES, 'position'):
            # A coordinate that is zero but for rounding.
            for part in (values.real, values.imag):
                part[np.abs(part) < _ZERO * size] = 0.0
    return Record(stamp, count, mechanism.bodies, columns, sizes, outlines, ('x', 'y'))


def _belts(scene: Scene) -> list[dict[str, Any]]:
    """The belts, by their wheels: which body, where in its frame, and how large."""
    bodies = scene.mechanism.bodies
    return [
        {
            'ends': [
                {'body': body if body in bodies else '', 'at': [z.real, z.imag], 'radius': radius}
                for body, z, radius in (
                    (belt.one, belt.a, belt.radii[0]),
                    (belt.other, belt.b, belt.radii[1]),
                )
            ],
            'closed': belt.carrier is not None,
        }
        for belt in scene.mechanism.assembly.joints
        if isinstance(belt, Belt)
    ]


def _rims(scene: Scene, body: str) -> list[tuple[complex, float]]:
    """Circles of a body that roll or carry belts: middles in its frame, complex, and radii, m."""
    found = []
    for joint in scene.mechanism.assembly.joints:
        if isinstance(joint, Rolling) and joint.other == body:
            found.append((joint.b, joint.radius))
        if isinstance(joint, Rolling) and joint.one == body and joint.circle:
            found.append((joint.a, abs(joint.circle)))
        if isinstance(joint, Belt):
            ends = ((joint.one, joint.a), (joint.other, joint.b))
            for (of, hub), radius in zip(ends, joint.radii, strict=True):
                if of == body and radius:
                    found.append((hub, abs(radius)))
    return list(dict.fromkeys(found))


def _outline(scene: Scene, body: str) -> np.ndarray:
    """Points of a body (n,), complex, m, in its frame: those named, spokes, and of its vector."""
    assembly = scene.mechanism.assembly
    found = [place for of, place in scene.points.values() if of == body]
    # A circle that turns looks like one that does not.
    for hub, radius in _rims(scene, body):
        found += [hub, hub + radius]
    if not assembly.joints:
        # Each vector that turns is a body, in the same order.
        loops = assembly.loops
        term = np.flatnonzero(loops.angles.any(axis=1))[scene.mechanism.bodies.index(body)]
        found += [0j, complex(loops.length0[term] * np.exp(1j * loops.angle0[term]))]
    return np.array(list(dict.fromkeys(found)) or [0j])
