"""
Statics in the steps in which seed 003 teaches them: virtual work, superposition, bearings let go.

The numbers are those of `efforts`, `holding` and `reactions`.
"""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.mechanism import (
    Load,
    Torque,
    advantage,
    efforts,
    holding,
    load_rates,
    releases,
    why_no_reactions,
)
from kinpole_ros.tools.solve._lines import table_lines
from kinpole_ros.tools.solve._solved import Solved, loaded_by, shown


def work_lines(solved: Solved) -> list[str]:
    """Virtual work line by line, each load's share, each bearing force, at the first position."""
    here = solved.at(0)
    scene, acts = here.scene, loaded_by(here)
    kinds = ['load'] * len(acts.loads) + ['spring'] * len(acts.springs)
    kinds += ['inertia'] * len(acts.inertia)
    named = {
        f'{k} {kind}, {_words(here, load)}': load
        for k, (kind, load) in enumerate(zip(kinds, acts.all, strict=True), start=1)
    }
    if np.isnan(here.motion.values[1:, :, 0]).all():
        return ['', 'virtual work: the drivers have no hold of the loads in a dead point']
    lines: list[str] = []
    loads = acts.all
    if scene.held_by:
        size, holder = holding(scene.mechanism, here.values, loads, scene.held_by)
        lines += _balance(here, named, 0, holder, float(size[0]))
        named[f'{len(named) + 1} what holds them, {_words(here, holder)}'] = holder
    else:
        borne = efforts(scene.mechanism, here.values, loads)
        for k in range(len(scene.mechanism.drivers)):
            lines += _balance(here, named, k, None, float(borne.effort[k, 0]))
    return [*lines, *_bearings(here, named)]


def _words(here: Solved, load: Load) -> str:
    """A load as people call it."""
    if isinstance(load, Torque):
        return f'torque on {load.body}'
    points = here.scene.points.items()
    name = next((name for name, place in points if place == (load.body, load.point)), load.body)
    return f'force at {name}'


def _balance(
    here: Solved, named: dict[str, Load], k: int, holder: Load | None, size: float
) -> list[str]:
    """Σ F·v + Σ T ω = 0 in the motion of driver k, the others held; and each load's share of it."""
    mechanism = here.scene.mechanism
    driver = mechanism.drivers[k].name
    # As it is driven, or at one unit where it is at rest or one of several.
    rate = float(here.rates[k, 0]) if len(mechanism.drivers) == 1 else 0.0
    rate = rate or 1.0
    moved = [*named.values()] if holder is None else [*named.values(), holder]
    rates = [rate * v[0] for v in load_rates(mechanism, here.values, moved, k)]
    what, own = f'the effort of {driver}', rate
    effort_unit, unit = _UNITS[mechanism.kind(k) == 'angle']
    held = ', the other drivers held' if len(mechanism.drivers) > 1 else ''
    at = shown(here.scene, k, here.inputs[k, 0])
    lines = ['', f'virtual work: {driver} = {at} moves at {rate:.6g} {unit}{held}']
    rows, powers = [], []
    for (name, load), v in zip(named.items(), rates, strict=False):
        powers.append(float((_effort(load).conjugate() * v).real))
        rows.append([name, *_parts(load, _effort(load)), *_parts(load, v), powers[-1]])
    head = ['load', 'Fx N, T N m', 'Fy N', 'vx m/s, ω rad/s', 'vy m/s', 'power W']
    lines += table_lines(head, rows)
    if holder is not None and size:
        what = _words(here, holder)
        effort_unit, unit = _UNITS[isinstance(holder, Torque)]
        own = float((np.conj(_effort(holder) / size) * rates[-1]).real)
    if not size:
        return [*lines, 'the powers add up to zero: no effort is needed to balance them']
    if not np.isfinite(size):
        return [*lines, f'{what} is not determined: a dead point, or it does not move']
    lines += [
        f'{sum(powers):.9g} W + {what} · {own:.9g} {unit} = 0',
        f'{what} = {size:.9g} {effort_unit}',
        '',
        f'superposition: each load alone asks for minus its power over {own:.6g} {unit}; the '
        'mechanical advantage is the load over that',
    ]
    into, rows = driver if holder is None else holder, []
    for (name, load), power in zip(named.items(), powers, strict=True):
        gain = np.nan
        if _effort(load):
            # What the linkage exerts against the load.
            gain = -float(advantage(mechanism, here.values, into, load)[0])
            gain *= np.sign(_effort(load).real) if isinstance(load, Torque) else 1.0
        rows.append([name, -power / own, 'infinite' if np.isinf(gain) else gain])
    head = ['load', effort_unit, 'mechanical advantage']
    return [*lines, *table_lines(head, [*rows, ['sum', -sum(powers) / own, '']])]


# Of an effort and a rate, by whether they are those of a torque.
_UNITS = {True: ('N m', 'rad/s'), False: ('N', 'm/s')}


def _effort(load: Load) -> complex:
    """The force or torque at the one position."""
    return complex(np.ravel(load.torque if isinstance(load, Torque) else load.force)[0])


def _parts(load: Load, z: complex) -> tuple[float | str, float | str]:
    return (z.real, '') if isinstance(load, Torque) else (z.real, z.imag)


def _bearings(here: Solved, named: dict[str, Load]) -> list[str]:
    """Each bearing let go in one direction after the other: the loads' power is what it bears."""
    mechanism = here.scene.mechanism
    if reason := why_no_reactions(mechanism):
        return ['', reason]
    released, loads = releases(mechanism, here.values, list(named.values()))
    names: Sequence[str] = [name.partition(' ')[0] for name in named]
    names = [*names, *('teeth' for _ in loads[len(named) :])]
    driver = ', '.join(one.name for one in mechanism.drivers)
    lines = ['', f'bearings: each let go at 1 m/s or 1 rad/s in one direction, {driver} held']
    rows = []
    for one in released:
        way = 'turning' if one.way is None else f'{_degrees(one.way[0]):g} deg'
        powers = one.powers[:, 0]
        unit = 'N m' if one.way is None else 'N'
        rows.append([one.joint, way, *powers, -powers.sum(), unit])
    head = ['joint', 'let go', *(f'power {name} W' for name in names), 'it bears', '']
    return [*lines, *table_lines(head, rows)]


def _degrees(way: complex) -> float:
    return float(np.round(np.degrees(np.angle(way)), 4) % 360)
