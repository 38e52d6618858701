"""Whether a scene's mechanism moves as it is driven, and from where it is said to start."""

from collections.abc import Mapping
from contextlib import suppress
from math import pi

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly
from kinpole_ros.mechanism._drivers import Driven
from kinpole_ros.mechanism._joints import Rolling
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.mechanism._reactions import loose_teeth
from kinpole_ros.mechanism._start import close_near, mobility
from kinpole_ros.mechanism._units import SceneError
from kinpole_ros.planar._plane import Real

# rad. A start says roughly which way loops close; what gears alone determine is to be right.
_ROUGHLY, _GEARED = pi / 2, 0.02


def check_mobility(assembly: Assembly, start: Real, drivers: int) -> None:
    """Raise SceneError unless there are as many drivers as degrees of freedom."""
    near, _ = close_near(assembly.loops, start)
    count, by_rank = mobility(assembly, near)
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
    """Raise SceneError where the drivers ask for more than the linkage gives."""
    if not mechanism.linkage.blocks:
        return
    driver = driven[0].driver
    if len(driven) == 1:
        low, high, what = driver.low, driver.high, f'{driver.name} ='
    else:
        low = min(0.0, *(one.begin for one in driven))
        high, what = max(one.end for one in driven), 'the time'
    path = mechanism.path(low, high)
    reach = path.inputs[0], path.inputs[-1]
    slack = 1e-9 * max(1.0, abs(low), abs(high))
    if path.period or (reach[0] <= low + slack and reach[1] >= high - slack):
        return
    dead = next((dead for dead in path.dead_points if dead.turns_back), None)
    why = '' if dead is None else f', a dead point of the loop {", ".join(dead.loop)}'

    size, unit = 1.0, 's'
    if len(driven) == 1:
        size, unit = (180 / pi, 'deg') if mechanism.kind(0) == 'angle' else (1.0, 'm')
    least, most = _limits(mechanism, low, high)
    # With more digits where these are what the asked and the given differ by.
    for digits in (6, 9, 12):
        asked, given = (
            [None if end is None else f'{end * size:.{digits}g}' for end in ends]
            for ends in ((low, high), (least, most))
        )
        if not set(asked) & set(given):
            break
    if None not in given:
        goes = f'goes from {given[0]} to {given[1]} {unit}'
    elif given[0] is not None:
        goes = f'goes no lower than {given[0]} {unit}'
    else:
        goes = f'goes no higher than {given[1]} {unit}'
    raise SceneError(
        f"'drivers' ask for {what} {asked[0]} to {asked[1]} {unit}, but the linkage {goes}{why}: "
        'drive it less far, or change lengths'
    )


def _limits(mechanism: Mechanism, low: float, high: float) -> tuple[float | None, float | None]:
    """
    Where the linkage turns back below and above its start, None where it was not found to.

    One driver is followed beyond the range asked for, `low` to `high`: an angle by a whole turn, a
    length by twice all lengths. Several drivers are followed over the time asked for.
    """
    path = mechanism.path(low, high)
    start = float(path.inputs[path.start])
    if len(mechanism.drivers) == 1:
        lengths = 2 * float(np.abs(mechanism.assembly.loops.length0).sum())
        reach = 2 * pi if mechanism.kind(0) == 'angle' else lengths
        # Where it cannot be followed so far, the limits within the requested range are reported.
        with suppress(LinkageError):
            path = mechanism.path(start - reach, start + reach)
    limits = [dead.at for dead in path.dead_points if dead.turns_back]
    least = max((at for at in limits if at <= start), default=None)
    most = min((at for at in limits if at > start), default=None)
    if least is None and most is None:
        # It ends where no dead point was located.
        ends = float(path.inputs[0]), float(path.inputs[-1])
        return (ends[0] if ends[0] > low else None, ends[1] if ends[1] < high else None)
    return least, most


def check_teeth(mechanism: Mechanism) -> None:
    """Raise SceneError where a pressure angle leaves a wheel's hub to nothing that holds it."""
    if not any(isinstance(joint, Rolling) for joint in mechanism.assembly.joints):
        return
    names = loose_teeth(mechanism, mechanism.motion(np.zeros(1), 3).values[0, :, 0])
    if names:
        raise SceneError(
            f"'joints: {', '.join(names)}': teeth with a pressure angle push apart, and nothing "
            'holds the hub at its distance: hold it by an arm with pins, or by a pin or slide on '
            'the ground'
        )


def check_start(mechanism: Mechanism, said: Mapping[str, float]) -> None:
    """Raise SceneError where a body is not at time 0 about where the scene says that it is."""
    loops, kinds = mechanism.assembly.loops, mechanism.assembly.kinds
    values = mechanism.motion(np.zeros(1), 3).values[0, :, 0]
    # What loops do not hold follows from gears and drivers alone, and is said exactly.
    in_loops = (loops.loops[:, :] != 0).any(axis=0)
    loose = (loops.angles[in_loops] != 0).any(axis=0)
    for k, name in enumerate(loops.variables):
        if name not in said or kinds[name] != 'angle':
            continue
        off = abs((values[k] - said[name] + pi) % (2 * pi) - pi)
        if off > (_ROUGHLY if loose[k] else _GEARED):
            now, meant = (np.degrees(x) % 360 for x in (values[k], said[name]))
            fix = (
                'another branch: start it there'
                if loose[k]
                else ('drivers and gears have it there: correct it, or give the joint its start')
            )
            raise SceneError(
                f"'start: {name}' is {meant:.6g} deg, but at time 0 it is at {now:.6g} deg; {fix}"
            )
