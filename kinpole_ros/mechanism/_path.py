"""
The way of a linkage through its range of motion: branch by continuation, limits and dead points.

From one position the next is predicted by the Taylor series that `solve` gives, in steps as long as
the prediction is good, so a branch is followed and never jumped.
"""

from collections.abc import Sequence
from math import pi
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._dead_points import (
    DeadPoint,
    Inputs,
    Way,
    crossing,
    flattest,
    locate,
    loop_of,
    taylor,
    unit_input,
)
from kinpole_ros.mechanism._loops import Linkage, LinkageError
from kinpole_ros.mechanism._solution import Solution
from kinpole_ros.mechanism._start import closing_starts
from kinpole_ros.planar._plane import Real

# The largest error of a predicted variable, rad or lengths over the largest, and the longest step.
_GUESS_ERROR, LONGEST, _SHORTEST = 1e-3, 0.25, 1e-7
MOST_NODES = 20_000
# Right in a dead point, where a step is a rounding error's root, or next to it.
_AT_REST = 1e-5


class Path(NamedTuple):
    """
    Nodes of a branch over one input: `inputs` (K,), rising, `values` (5, n, K) by that input.

    `period` is 2 pi where the input turns all the way round and everything returns, with the
    whole turns that the variables make meanwhile in `winding` (n,); else 0. `dead_points` are those
    met, from low to high inputs; the first and last node lie just inside limits, if there are any.
    `start` is the node from which the others were found.
    """

    inputs: Real
    values: Real
    period: float
    winding: Real
    dead_points: tuple[DeadPoint, ...]
    asked: tuple[float, float]
    start: int

    def covers(self, low: float, high: float) -> bool:
        """Whether inputs from `low` to `high` have been asked for before, or are all the same."""
        return bool(self.period) or (self.asked[0] <= low and high <= self.asked[1])


def trace(
    linkage: Linkage,
    start: float,
    guess: Real,
    low: float,
    high: float,
    inputs: Inputs = unit_input,
) -> Path:
    """
    Follow the branch next to `guess` (n,) from the input `start` down to `low` and up to `high`.

    Stops at limits. `inputs` gives the drivers (5, d, T) over whatever parametrizes the way, their
    one input itself unless said otherwise. Raises LinkageError where the linkage cannot be
    assembled at `start`.
    """
    way = Way(linkage, inputs)
    first = way.at(start, guess)
    if not first.closed[0]:
        drives = linkage.loops.drives
        lacks = inputs(np.array([start]))[0, :, 0] - drives @ guess
        raise LinkageError(_why_open(linkage, guess + np.linalg.pinv(drives) @ lacks))
    if not (np.abs(first.determinant[:, 0]) > _AT_REST).all():
        loop = ', '.join(loop_of(linkage, flattest(first)))
        raise LinkageError(
            f'the start is a dead point of the loop {loop}, from which it is not known where to '
            'go: start next to it'
        )
    scale = _scales(linkage, first.values[0, :, 0])
    period, winding = 0.0, np.zeros(len(guess))
    turn = start + 2 * pi
    whole_turn = inputs is unit_input and _is_angle(linkage) and high - low >= 2 * pi - 1e-9
    # Once round, everything may be as before: then that is the way for any number of turns.
    up, dead_up = _follow(way, start, first, turn if whole_turn else high, scale)
    if whole_turn and up and up[-1][0] >= turn - 1e-9:
        after = way.at(turn, _guess_from(up, turn))
        turns = (after.values[0, :, 0] - first.values[0, :, 0]) / (2 * pi)
        whole = np.where(_angles(linkage), np.round(turns), 0.0)
        if after.closed[0] and np.abs(turns - whole).max() < 1e-9 * max(1.0, scale.max()):
            period, winding = 2 * pi, whole
            dead_up = [dead for dead in dead_up if dead.at < turn - 1e-9]
        elif high > turn:
            more, dead_more = _follow(way, *up[-1], high, scale)
            up, dead_up = up + more, dead_up + dead_more
    if not period and whole_turn:
        up = [node for node in up if node[0] <= high + 1e-9]
        dead_up = [dead for dead in dead_up if dead.at <= high + 1e-9]
    down, dead_down = ([], []) if period else _follow(way, start, first, low, scale)
    nodes = [*reversed(down), (start, first), *up]
    return Path(
        np.array([s for s, _ in nodes]),
        np.stack([solution.values[:, :, 0] for _, solution in nodes], axis=-1),
        period,
        winding,
        tuple(sorted(dead_down + dead_up, key=lambda dead: dead.at)),
        (low, high),
        len(down),
    )


def _why_open(linkage: Linkage, guess: Real) -> str:
    """What is said of loops that do not close from `guess` (n,): where they do, or that nowhere."""
    loops, angles = linkage.loops, _angles(linkage)

    def shown(k: int, value: float) -> str:
        # Rounded so that nothing is a rounding error, or minus zero, of a degree.
        of = f'{round(np.degrees(value), 2) + 0.0:g} deg' if angles[k] else f'{value:.4g} m'
        return f'{loops.variables[k]}: {of}'

    def described(values: Real, which: Sequence[int]) -> str:
        return ', '.join(shown(k, float(values[k])) for k in which)

    driven = [int(k) for k in np.flatnonzero(loops.drives.any(axis=0))]
    at = f' with {{{described(guess, driven)}}}' if driven else ''
    starts = closing_starts(loops, guess)
    if not starts:
        return (
            f'the loops do not close{at}, from wherever they were tried: check the lengths, and '
            'where the drivers are at time 0'
        )
    # What slides and struts do follows from the angles of the bodies.
    free = [k for k in linkage.unknown if angles[k]] or list(linkage.unknown)
    ways = ', or '.join(f'{{{described(values, free)}}}' for values in starts)
    return (
        f'the loops do not close{at} from {{{described(guess, free)}}}, but they do near {ways}: '
        'write the one that is meant as start'
    )


def _follow(
    on: Way, start: float, first: Solution, end: float, scale: Real
) -> tuple[list[tuple[float, Solution]], list[DeadPoint]]:
    """Nodes after the first on the way to `end`, and the dead points met."""
    way = 1.0 if end > start else -1.0
    nodes: list[tuple[float, Solution]] = []
    dead: list[DeadPoint] = []
    here, at, step = first, start, 0.05
    while (end - at) * way > 1e-12 * max(1.0, abs(end)):
        if len(nodes) > MOST_NODES:
            raise LinkageError(
                f'more than {MOST_NODES} steps: is the range {start} to {end} meant?'
            )
        step = min(step, LONGEST, abs(end - at))
        ahead = taylor(here, way * step)
        there = on.at(at + way * step, ahead)
        off = np.abs((there.values[0, :, 0] - ahead) / scale).max() if there.closed[0] else np.inf
        good = bool(there.regular[0]) and np.isfinite(off) and off < _GUESS_ERROR
        if not good:
            step /= 2
            if step < _SHORTEST:
                dead.append(locate(on, at, here))
                break
            continue
        if np.any(there.determinant[:, 0] * here.determinant[:, 0] < 0):
            dead.append(crossing(on, at, here, at + way * step))
        at, here = at + way * step, there
        nodes.append((at, here))
        step *= min(2.0, 0.9 * (_GUESS_ERROR / max(off, 1e-12)) ** 0.2)
    return nodes, dead


def _guess_from(nodes: list[tuple[float, Solution]], at: float) -> Real:
    near = min(nodes, key=lambda node: abs(node[0] - at))
    return taylor(near[1], at - near[0])


def _angles(linkage: Linkage) -> np.ndarray:
    """Which variables (n,) are angles, those of no term too: a wheel that others roll on."""
    return ~np.asarray((linkage.loops.lengths != 0).any(axis=0))


def _is_angle(linkage: Linkage) -> bool:
    driven = linkage.loops.drives[0] != 0
    return bool(
        _angles(linkage)[driven].all() and np.isclose(np.abs(linkage.loops.drives[0]).sum(), 1)
    )


def _scales(linkage: Linkage, values: Real) -> Real:
    """What an error of each variable is held against: 1 rad, or the largest length."""
    length = np.abs(linkage.loops.lengths @ values + linkage.loops.length0).max()
    return np.where(_angles(linkage), 1.0, length)
