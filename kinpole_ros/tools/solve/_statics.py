"""
The statics of a scene as lines to print: efforts and reactions, and their derivation step by step.

The derivation uses virtual work, superposition, and bearings released one at a time.
"""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.mechanism import (
    Force,
    Load,
    Scene,
    Statics,
    Torque,
    holding,
    undetermined,
)
from kinpole_ros.mechanism._equilibrium import why_no_reactions
from kinpole_ros.mechanism._vector_joints import reactions
from kinpole_ros.tools.solve import _solution
from kinpole_ros.tools.solve._solution import ActingLoads, SolvedScene
from kinpole_ros.tools.solve._text import Row, table_lines

# Units of an effort and a rate, by whether they are those of a torque.
_UNITS = {True: ('N m', 'rad/s'), False: ('N', 'm/s')}


def static_lines(solution: SolvedScene) -> list[str]:
    """Return the efforts of the drivers and the forces in the joints, at the first position."""
    scene, acting = solution.scene, _solution.require_loads(solution)
    values = solution.values[:, :1]
    several = solution.inputs.shape[1] > 1
    lines = ['', 'forces at the start of the range' if several else 'forces']
    loads = acting.loads
    if np.isnan(solution.motion.values[1:, :, 0]).all() and solution.motion.regular.size == 1:
        # This near to a dead point, the efforts depend on the last digit of the input.
        return [*lines, 'not determined: in a dead point the drivers do not move the loads']
    if scene.held_by:
        size, load = holding(scene.mechanism, values, loads, scene.held_by)
        lines.append(_holder_line(scene, float(size[0]), load))
        loads = [*loads, load]
    else:
        lines += _effort_lines(scene, values, acting)
    forces = reactions(scene, values, loads)
    if reason := why_no_reactions(forces.mechanism):
        return [*lines, reason]
    return [*lines, *_reaction_lines(forces)]


def _reaction_lines(forces: Statics) -> list[str]:
    """Return the forces in the joints, and those that are not unique."""
    lines = []
    rows: list[Row] = [
        [name, force.real, force.imag, abs(force), moment]
        for name, force, moment in zip(
            forces.joints, forces.force[:, 0], forces.moment[:, 0], strict=True
        )
    ]
    if rows:
        lines += ['', *table_lines(['joint', 'Fx N', 'Fy N', 'F N', 'moment N m'], rows)]
    for j, name in enumerate(forces.joints):
        # A force that is not unique may have a unique part, such as the force along a wheel's rim.
        for part, turn in ((forces.along[j, 0], 1), (forces.across[j, 0], 1j)):
            if np.isfinite(part) and not np.isfinite(forces.force[j, 0]):
                angle = _degrees(part * turn * forces.axis[j, 0])
                size = f'{abs(part):.6g} N'
                lines.append(f'{name}: of its force the part along {angle:g} deg is unique: {size}')
    return [*lines, *undetermined(forces.mechanism, forces.values[:, 0])]


def _effort_lines(scene: Scene, values: np.ndarray, acting: ActingLoads) -> list[str]:
    """Return the effort of each driver that balances the loads, and the share of each load."""
    lines = []
    balance = Statics(scene.mechanism, values, acting.loads)
    for k, driver in enumerate(scene.mechanism.drivers):
        unit, _ = _UNITS[scene.mechanism.kind(k) == 'angle']
        if np.isnan(balance.effort[k, 0]):
            lines.append(f'{driver.name}: a dead point, where no finite effort balances the loads')
            continue
        lines.append(f'{driver.name} balances the loads with {balance.effort[k, 0]:.9g} {unit}')
        ends = np.cumsum([len(acting.external), len(acting.springs)])
        external, springs, inertia = np.split(balance.share[:, k, 0], ends)
        texts = []
        if len(external):
            texts.append(f'load by load: {", ".join(f"{share:.6g}" for share in external)}')
        if len(springs):
            texts.append(f'springs: {springs.sum():.6g}')
        if len(inertia):
            texts.append(f'inertia: {inertia.sum():.6g}')
        if len(external) > 1 or len(texts) > 1:
            lines.append(f'  of this, {"; ".join(texts)} {unit}')
    return lines


def _holder_line(scene: Scene, size: float, load: Load) -> str:
    """Return the force or torque that holds the loads in place of the driver."""
    driver = scene.mechanism.drivers[0].name
    if not np.isfinite(size):
        return f'nothing on {load.body} balances the loads: it does not move, or is in a dead point'
    if isinstance(load, Torque):
        return f'{size:.9g} N m on {load.body} balance the loads, with {driver} free'
    angle = f'{np.rad2deg(np.angle(_effort(load) / size)):.6g} deg'
    name = _solution.point_name(scene, load)
    return f'{size:.9g} N at {name}, along {angle}, balance the loads, with {driver} free'


def work_lines(solution: SolvedScene) -> list[str]:
    """Return virtual work, the share of each load and each bearing force, at the first position."""
    here = solution.at(0)
    scene, acting = here.scene, _solution.require_loads(here)
    kinds = ['load'] * len(acting.external) + ['spring'] * len(acting.springs)
    kinds += ['inertia'] * len(acting.inertia)
    named = {
        f'{k} {kind}, {_load_text(scene, load)}': load
        for k, (kind, load) in enumerate(zip(kinds, acting.loads, strict=True), start=1)
    }
    if np.isnan(here.motion.values[1:, :, 0]).all():
        return ['', 'virtual work: in a dead point the drivers do not move the loads']
    lines: list[str] = []
    if scene.held_by:
        size, holder = holding(scene.mechanism, here.values, acting.loads, scene.held_by)
        lines += _balance_lines(here, named, 0, holder, float(size[0]))
        named[f'{len(named) + 1} holder, {_load_text(scene, holder)}'] = holder
    else:
        balance = Statics(scene.mechanism, here.values, acting.loads)
        for k in range(len(scene.mechanism.drivers)):
            lines += _balance_lines(here, named, k, None, float(balance.effort[k, 0]))
    return [*lines, *_bearing_lines(here, named)]


def _load_text(scene: Scene, load: Load) -> str:
    if isinstance(load, Torque):
        return f'torque on {load.body}'
    points = scene.points.items()
    at = next((name for name, point in points if point == (load.body, load.point)), load.body)
    return f'force at {at}'


def _balance_lines(
    here: SolvedScene, named: dict[str, Load], k: int, holder: Load | None, size: float
) -> list[str]:
    """
    Return Σ F·v + Σ T ω = 0 for the motion of driver `k` alone, and the share of each load.

    `size` is the effort of the driver, or of the `holder` in its place.
    """
    mechanism = here.scene.mechanism
    driver = mechanism.drivers[k].name
    # The prescribed rate; one unit if the driver is at rest, or is one of several.
    driver_rate = float(here.rates[k, 0]) if len(mechanism.drivers) == 1 else 0.0
    driver_rate = driver_rate or 1.0
    loads = [*named.values()] if holder is None else [*named.values(), holder]
    unit_rates = Statics(mechanism, here.values, loads).load_rates(k)
    rates = [driver_rate * v[0] for v in unit_rates]
    powers = [_power(load, v) for load, v in zip(named.values(), rates, strict=False)]
    title, rate = f'the effort of {driver}', driver_rate
    effort_unit, unit = _UNITS[mechanism.kind(k) == 'angle']
    note = ', the other drivers held' if len(mechanism.drivers) > 1 else ''
    value = _solution.driver_text(here.scene, k, here.inputs[k, 0])
    lines = ['', f'virtual work: {driver} = {value} moves at {driver_rate:.6g} {unit}{note}']
    rows: list[Row] = [
        [name, *_components(load, _effort(load)), *_components(load, v), power]
        for (name, load), v, power in zip(named.items(), rates, powers, strict=False)
    ]
    head = ['load', 'Fx N, T N m', 'Fy N', 'vx m/s, ω rad/s', 'vy m/s', 'power W']
    lines += table_lines(head, rows)
    if holder is not None and size:
        title = _load_text(here.scene, holder)
        effort_unit, unit = _UNITS[isinstance(holder, Torque)]
        rate = _power(holder, rates[-1]) / size
    if not size:
        return [*lines, 'the powers add up to zero: no effort is needed to balance them']
    if not np.isfinite(size):
        return [*lines, f'{title} is not determined: it does not move, or this is a dead point']
    lines += [
        f'{sum(powers):.9g} W + {title} · {rate:.9g} {unit} = 0',
        f'{title} = {size:.9g} {effort_unit}',
        '',
        f'superposition: each load alone needs minus its power over {rate:.6g} {unit}; the '
        'mechanical advantage is the load over that',
    ]
    rows = []
    for (name, load), power in zip(named.items(), powers, strict=True):
        gain = np.nan
        if _effort(load):
            port = driver if holder is None else holder
            gain = float(np.ravel(_solution.advantage_of(mechanism, here.values, port, load))[0])
        rows.append([name, -power / rate, 'infinite' if np.isinf(gain) else gain])
    head = ['load', effort_unit, 'mechanical advantage']
    return [*lines, *table_lines(head, [*rows, ['sum', -sum(powers) / rate, '']])]


def _effort(load: Load) -> complex:
    """Return the force or torque at the first position."""
    return complex(np.ravel(load.force if isinstance(load, Force) else load.torque)[0])


def _power(load: Load, rate: complex) -> float:
    return float((_effort(load).conjugate() * rate).real)


def _components(load: Load, z: complex) -> tuple[float | str, float | str]:
    return (z.real, '') if isinstance(load, Torque) else (z.real, z.imag)


def _bearing_lines(here: SolvedScene, named: dict[str, Load]) -> list[str]:
    """Return each bearing force as the power of the loads when that bearing alone moves."""
    mechanism = here.scene.mechanism
    forces = reactions(here.scene, here.values, list(named.values()))
    if reason := why_no_reactions(forces.mechanism):
        return ['', reason]
    releases = forces.releases
    names: Sequence[str] = [name.partition(' ')[0] for name in named]
    names = [*names, *('teeth' for _ in releases[0].powers[len(named) :])]
    drivers = ', '.join(driver.name for driver in mechanism.drivers)
    lines = ['', f'bearings: each released at 1 m/s or 1 rad/s in one direction, {drivers} held']
    rows: list[Row] = []
    for one in releases:
        direction = 'turning' if one.way is None else f'{_degrees(one.way[0]):g} deg'
        powers = one.powers[:, 0]
        unit = 'N m' if one.way is None else 'N'
        rows.append([one.joint, direction, *powers, -powers.sum(), unit])
    head = ['joint', 'released', *(f'power {name} W' for name in names), 'force', '']
    return [*lines, *table_lines(head, rows)]


def _degrees(z: complex) -> float:
    return float(np.round(np.degrees(np.angle(z)), 4) % 360)
