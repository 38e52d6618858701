"""The analysis of a scene as a CSV table: a row for each position."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kinpole_ros.mechanism import (
    SceneError,
    efforts,
    holding,
    poles,
    reactions,
    transmission_angles,
    why_no_reactions,
)
from kinpole_ros.tools.solve._solved import (
    Solved,
    acting,
    advantages,
    centers_of,
    lengths,
    point_motions,
)


class _Columns(dict[str, np.ndarray]):
    """Columns by name, of which no other takes the place: body a_b, and the point b of body a."""

    def __setitem__(self, name: str, values: np.ndarray) -> None:
        if name in self and not np.allclose(self[name], values, rtol=1e-9, equal_nan=True):
            raise SceneError(
                f"two columns would be called '{name}': give a body, point or joint another name"
            )
        super().__setitem__(name, values)


def write_table(path: Path, solved: Solved, centers: bool, statics: bool) -> None:
    """
    One row per position, SI units; empty cells for what is not determined.

    Raises SceneError where names would give two columns one name.
    """
    columns = _Columns()
    if solved.times is not None:
        columns['t'] = solved.times
    orders = ('', '_velocity', '_acceleration', '_jerk', '_snap')
    for k, driver in enumerate(solved.scene.mechanism.drivers):
        columns[driver.name] = solved.inputs[k]
    for b, body in enumerate(solved.scene.mechanism.bodies):
        for k, name in enumerate(orders):
            columns[f'{body}_x{name}'] = solved.motion.position[k, b].real
            columns[f'{body}_y{name}'] = solved.motion.position[k, b].imag
            columns[f'{body}_angle{name}'] = solved.motion.angle[k, b]
    for name, n in lengths(solved.scene).items():
        for k, what in enumerate(orders):
            columns[f'{name}{what}'] = solved.motion.values[k, n]
    for point, places in point_motions(solved).items():
        name = point.replace('.', '_')
        for k, what in enumerate(orders[:4]):
            columns[f'{name}_x{what}'] = places[k].real
            columns[f'{name}_y{what}'] = places[k].imag
    found_poles = poles(solved.scene.mechanism, solved.motion)
    for b, body in enumerate(solved.scene.mechanism.bodies):
        for what in ('icr', 'iap', 'ijp', 'isp'):
            points = getattr(found_poles, what)[b]
            columns[f'{body}_{what}_x'], columns[f'{body}_{what}_y'] = points.real, points.imag
        columns[f'{body}_icr_velocity_x'] = found_poles.velocity[b].real
        columns[f'{body}_icr_velocity_y'] = found_poles.velocity[b].imag
        columns[f'{body}_centrode_curvature'] = found_poles.curvature[b]
    for (name, _), values in advantages(solved).items():
        columns[f'advantage_{name.replace("the force at ", "force_").replace(".", "_")}'] = values
    for names, angles in transmission_angles(solved.scene.mechanism, solved.values).items():
        columns[f'transmission_angle_{"_".join(names)}'] = angles
    if centers:
        found = centers_of(solved)
        for c, (i, j) in enumerate(found.pairs):
            name = f'center_{found.bodies[i]}_{found.bodies[j]}'
            columns[f'{name}_x'] = found.points[c].real
            columns[f'{name}_y'] = found.points[c].imag
    if statics:
        loads = acting(solved).all
        if solved.scene.held_by:
            size, load = holding(solved.scene.mechanism, solved.values, loads, solved.scene.held_by)
            columns['held_by'] = size
            loads = [*loads, load]
        borne = efforts(solved.scene.mechanism, solved.values, loads)
        for k, driver in enumerate(solved.scene.mechanism.drivers):
            columns[f'{driver.name}_effort'] = borne.effort[k]
        if not why_no_reactions(solved.scene.mechanism):
            forces = reactions(solved.scene.mechanism, solved.values, loads)
            for j, joint in enumerate(forces.joints):
                columns[f'{joint}_force_x'] = forces.force[j].real
                columns[f'{joint}_force_y'] = forces.force[j].imag
                columns[f'{joint}_moment'] = forces.moment[j]
    write_columns(path, columns)


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Columns (T,) by name; empty cells for what is not finite."""
    with path.open('w', newline='', encoding='utf-8') as file:
        rows = csv.writer(file)
        rows.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            rows.writerow([repr(float(cell)) if np.isfinite(cell) else '' for cell in row])
