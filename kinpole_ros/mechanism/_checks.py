"""Checks of a scene's mechanism: its mobility, the range of its drivers, and its start."""

from collections.abc import Mapping
from contextlib import suppress
from math import pi

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly
from kinpole_ros.mechanism._belt import Belt
from kinpole_ros.mechanism._equilibrium import loose_teeth
from kinpole_ros.mechanism._joint_kinds import GROUND
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._scene_inputs import Driven
from kinpole_ros.mechanism._scene_values import SceneError
from kinpole_ros.mechanism._start import close_near, closing_starts, mobility
from kinpole_ros.planar._plane import Real

# Errors of a stated start, rad: it gives roughly the branch of loops, but exactly the phase of
# gears and belts.
_BRANCH_TOLERANCE, _PHASE_TOLERANCE = pi / 2, 0.02


def check_mobility(assembly: Assembly, start: Real, drivers: int) -> None:
    """Raise SceneError unless there are as many drivers as degrees of freedom."""
    near, is_closed = close_near(assembly.loops, start)
    # Where loops stay open, as with all links on one line, the rank is too low.
    closed = [near] if is_closed else closing_starts(assembly.loops, start)
    count, by_rank = min(mobility(assembly, values) for values in closed or [near])
    counts = (
        f"Gruebler's count gives {count} degrees of freedom, the rank of the loops at the start "
        f'{by_rank}'
    )
    if max(count, by_rank) <= 0:
        raise SceneError(f'the bodies cannot move: {counts}: take a joint away')
    if drivers not in (count, by_rank):
        fix = f'drive {by_rank}' if by_rank > 0 else 'check the joints'
        raise SceneError(f"'drivers' are {drivers}, but {counts}: {fix}")


def check_range(mechanism: Mechanism, driven: list[Driven]) -> None:
    """Raise SceneError where the drivers ask for a position that the linkage does not reach."""
    if not mechanism.linkage.blocks:
        return
    driver, size, unit = driven[0].driver, 1.0, 's'
    if len(driven) == 1:
        low, high, what = driver.low, driver.high, f'{driver.name} ='
        size, unit = (180 / pi, 'deg') if mechanism.kind(0) == 'angle' else (1.0, 'm')
    else:
        low = min(0.0, *(one.begin for one in driven))
        high, what = max(one.end for one in driven), 'the time'
    path = mechanism.path(low, high)
    slack = 1e-9 * max(1.0, abs(low), abs(high))
    if path.period or (path.inputs[0] <= low + slack and path.inputs[-1] >= high - slack):
        return
    dead = next((dead for dead in path.dead_points if dead.turns_back), None)
    why = '' if dead is None else f', a dead point of the loop {", ".join(dead.loop)}'
    least, most = _limits(mechanism, low, high)
    # With enough digits to tell the requested ends from those that are reached.
    for digits in (6, 9, 12):
        requested, reached = (
            [None if end is None else f'{end * size:.{digits}g}' for end in ends]
            for ends in ((low, high), (least, most))
        )
        if not set(requested) & set(reached):
            break
    if None not in reached:
        goes = f'goes from {reached[0]} to {reached[1]} {unit}'
    elif reached[0] is not None:
        goes = f'goes no lower than {reached[0]} {unit}'
    else:
        goes = f'goes no higher than {reached[1]} {unit}'
    raise SceneError(
        f"'drivers' ask for {what} {requested[0]} to {requested[1]} {unit}, but the linkage "
        f'{goes}{why}: drive it less far, or change lengths'
    )


def _limits(mechanism: Mechanism, low: float, high: float) -> tuple[float | None, float | None]:
    """
    The inputs at which the linkage turns back below and above its start, None if it does not.

    One driver is followed beyond the requested range: an angle by a whole turn, a length by twice
    all lengths. Several drivers are followed over the requested time.
    """
    path = mechanism.path(low, high)
    start = float(path.inputs[path.start])
    if len(mechanism.drivers) == 1:
        lengths = 2 * float(np.abs(mechanism.assembly.loops.length0).sum())
        span = 2 * pi if mechanism.kind(0) == 'angle' else lengths
        # If it cannot be followed so far, the limits within the requested range are reported.
        with suppress(LinkageError):
            path = mechanism.path(start - span, start + span)
    limits = [dead.at for dead in path.dead_points if dead.turns_back]
    least = max((at for at in limits if at <= start), default=None)
    most = min((at for at in limits if at > start), default=None)
    if least is None and most is None:
        # It ends where no dead point was located.
        first, last = float(path.inputs[0]), float(path.inputs[-1])
        return first if first > low else None, last if last < high else None
    return least, most


def check_belts(mechanism: Mechanism, stated: Mapping[str, float]) -> None:
    """
    Raise SceneError where a belt's wheels start at angle zero, but its strand not in `direction`.

    Its length is stated for that position. A strand whose angle is in `stated` may start anywhere.
    """
    belts = [joint for joint in mechanism.assembly.joints if isinstance(joint, Belt)]
    free = [belt for belt in belts if not belt.is_carried and f'{belt.name}.angle' not in stated]
    start = mechanism.motion(np.zeros(1), 3).values[0, :, 0] if free else ()
    values = dict(zip(mechanism.assembly.loops.variables, start, strict=False))
    for belt in free:
        wheels = {rim.body for rim in belt.rims()} - {GROUND}
        turned = max((abs(values[wheel]) for wheel in wheels), default=pi)
        angle = values[f'{belt.name}.angle']
        if turned <= _PHASE_TOLERANCE < abs(angle - belt.direction):
            raise SceneError(
                f"'joints: {belt.name}': its wheels start at 0 deg, where its 'direction' is "
                f'{np.degrees(belt.direction):.6g} deg, but it leads to {np.degrees(angle):.6g} '
                'deg: a radius is positive where the strand runs on the left of the hub, or give '
                f"'start: {belt.name}.angle'"
            )


def check_teeth(mechanism: Mechanism) -> None:
    """Raise SceneError for teeth with a pressure angle if nothing else holds the hub of a wheel."""
    if not any(joint.pressure is not None for joint in mechanism.assembly.joints):
        return
    if names := loose_teeth(mechanism, mechanism.motion(np.zeros(1), 3).values[0, :, 0]):
        raise SceneError(
            f"'joints: {', '.join(names)}': teeth with a pressure angle push each other away, and "
            'nothing holds the hub at its distance: hold it by an arm with pins, or by a pin or '
            'slide on the ground'
        )


def check_start(mechanism: Mechanism, stated: Mapping[str, float]) -> None:
    """Raise SceneError where a body at time 0 is far from the start that the scene states."""
    loops, kinds = mechanism.assembly.loops, mechanism.assembly.kinds
    values = mechanism.motion(np.zeros(1), 3).values[0, :, 0]
    # Angles outside of all loops follow from gears and drivers alone.
    in_loops = (loops.loops != 0).any(axis=0)
    has_branches = (loops.angles[in_loops] != 0).any(axis=0)
    for k, name in enumerate(loops.variables):
        if name not in stated or kinds[name] != 'angle':
            continue
        error = abs((values[k] - stated[name] + pi) % (2 * pi) - pi)
        if error <= (_BRANCH_TOLERANCE if has_branches[k] else _PHASE_TOLERANCE):
            continue
        actual, start = (np.degrees(x) % 360 for x in (values[k], stated[name]))
        fix = 'drivers and gears have it there: correct it, or give the joint its start'
        if has_branches[k]:
            fix = 'another branch: start it there'
        raise SceneError(
            f"'start: {name}' is {start:.6g} deg, but at time 0 it is at {actual:.6g} deg; {fix}"
        )
