"""The analysis of a scene as a CSV table with one row per position."""

import csv
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kinpole_ros.files import as_cell
from kinpole_ros.mechanism import SceneError, Statics, holding, poles, transmission_angles
from kinpole_ros.mechanism._equilibrium import why_no_reactions
from kinpole_ros.mechanism._vector_joints import reactions
from kinpole_ros.tools.solve import _solution
from kinpole_ros.tools.solve._solution import SolvedScene

_ORDERS = ('', '_velocity', '_acceleration', '_jerk', '_snap')


class _Columns(dict[str, np.ndarray]):
    """Columns by name; body a_b and the point b of body a must not have the same one."""

    def __setitem__(self, name: str, values: np.ndarray) -> None:
        if name in self and not np.allclose(self[name], values, rtol=1e-9, equal_nan=True):
            raise SceneError(
                f"two columns would be called '{name}': give a body, point or joint another name"
            )
        super().__setitem__(name, values)

    def set_point(self, name: str, points: np.ndarray, suffix: str = '') -> None:
        """Set the columns of both coordinates of complex points."""
        self[f'{name}_x{suffix}'], self[f'{name}_y{suffix}'] = points.real, points.imag


def write_table(path: Path, solution: SolvedScene, centers: bool, statics: bool) -> None:
    """
    Write one row per position, in SI units; cells that are not determined are empty.

    Raises SceneError if names would give two columns one name.
    """
    scene, motion, mechanism = solution.scene, solution.motion, solution.scene.mechanism
    columns = _Columns()
    if solution.times is not None:
        columns['t'] = solution.times
    for k, driver in enumerate(mechanism.drivers):
        columns[driver.name] = solution.inputs[k]
    for b, body in enumerate(mechanism.bodies):
        for k, order in enumerate(_ORDERS):
            columns.set_point(body, motion.position[k, b], order)
            columns[f'{body}_angle{order}'] = motion.angle[k, b]
    for name, n in _solution.variable_lengths(scene).items():
        for k, order in enumerate(_ORDERS):
            columns[f'{name}{order}'] = motion.values[k, n]
    for name, points in _solution.point_motions(solution).items():
        for z, order in zip(points, _ORDERS, strict=False):
            columns.set_point(name.replace('.', '_'), z, order)
    body_poles = poles(mechanism, motion)
    for b, body in enumerate(mechanism.bodies):
        for name in ('icr', 'iap', 'ijp', 'isp'):
            columns.set_point(f'{body}_{name}', getattr(body_poles, name)[b])
        columns.set_point(f'{body}_icr_velocity', body_poles.velocity[b])
        columns[f'{body}_centrode_curvature'] = body_poles.curvature[b]
        columns.set_point(f'{body}_inflection_circle', body_poles.inflection_circle[b])
        columns[f'{body}_inflection_diameter'] = body_poles.inflection_diameter[b]
        columns.set_point(f'{body}_ball_point', body_poles.ball_point[b])
    for (name, _), gains in _solution.advantages(solution).items():
        columns[f'advantage_{name.replace("the force at ", "force_").replace(".", "_")}'] = gains
    for names, angles in transmission_angles(mechanism, solution.values).items():
        columns[f'transmission_angle_{"_".join(names)}'] = angles
    if centers:
        all_centers = _solution.centers_of(solution)
        for (i, j), points in zip(all_centers.pairs, all_centers.points, strict=True):
            columns.set_point(f'center_{all_centers.bodies[i]}_{all_centers.bodies[j]}', points)
    if statics:
        _add_statics(columns, solution)
    write_columns(path, columns)


def _add_statics(columns: _Columns, solution: SolvedScene) -> None:
    scene, mechanism = solution.scene, solution.scene.mechanism
    loads = _solution.acting_loads(solution).loads
    if scene.held_by:
        columns['held_by'], load = holding(mechanism, solution.values, loads, scene.held_by)
        loads = [*loads, load]
    forces = Statics(mechanism, solution.values, loads)
    for driver, effort in zip(mechanism.drivers, forces.effort, strict=True):
        columns[f'{driver.name}_effort'] = effort
    forces = reactions(scene, solution.values, loads)
    if not why_no_reactions(forces.mechanism):
        for joint, force, moment in zip(forces.joints, forces.force, forces.moment, strict=True):
            columns.set_point(f'{joint}_force', force)
            columns[f'{joint}_moment'] = moment


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns (T,) by name; cells that are not finite are empty."""
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(map(as_cell, columns))
        for row in zip(*(column.tolist() for column in columns.values()), strict=True):
            writer.writerow([cell if math.isfinite(cell) else '' for cell in row])
