"""
The branch of a linkage over its range of motion, by continuation, and guesses for positions on it.

From one position the next is predicted by the Taylor series that `solve` gives, in steps as long as
the prediction is good, so a branch is followed and never changed.
"""

from collections.abc import Sequence
from math import factorial, pi
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._dead_points import (
    Branch,
    DeadPoint,
    Inputs,
    locate_change_point,
    locate_limit,
    loop_names,
    most_singular,
    taylor,
    unit_input,
)
from kinpole_ros.mechanism._loop_closure import Solution, solve
from kinpole_ros.mechanism._loops import LinkageError, Loops, ReducedLoops
from kinpole_ros.mechanism._start import closing_starts, open_gaps
from kinpole_ros.planar._plane import Real

# The largest error of a predicted variable, rad or lengths over the largest, and limits of steps.
_GUESS_ERROR, _LONGEST, _SHORTEST = 1e-3, 0.25, 1e-7
_MOST_NODES = 20_000
# Determinants below this are those of a dead point.
_DEAD = 1e-5


class Path(NamedTuple):
    """
    Nodes of a branch over one input: `inputs` (K,), rising, `values` (5, n, K) by that input.

    `period` is 2 pi where the input turns all the way round and everything returns, with the whole
    turns that the variables make meanwhile in `winding` (n,); else 0. `dead_points` are those met,
    from low to high inputs; the first and last node lie just inside limits, if there are any.
    `requested` is the range that was asked for, `start` the first node that was solved.
    """

    inputs: Real
    values: Real
    period: float
    winding: Real
    dead_points: tuple[DeadPoint, ...]
    requested: tuple[float, float]
    start: int

    def covers(self, low: float, high: float) -> bool:
        """Whether inputs from `low` to `high` were requested before, or are all the same."""
        return bool(self.period) or (self.requested[0] <= low and high <= self.requested[1])


def trace(
    linkage: ReducedLoops,
    start: float,
    guess: Real,
    low: float,
    high: float,
    inputs: Inputs = unit_input,
) -> Path:
    """
    Follow the branch next to `guess` (n,) from the input `start` down to `low` and up to `high`.

    It stops at limits. `inputs` gives the drivers (5, d, T) over the parameter of the branch, by
    default their one input itself. Raises LinkageError where the linkage cannot be assembled at
    `start`.
    """
    branch = Branch(linkage, inputs)
    first = _first(branch, linkage, start, guess)
    is_angle = linkage.loops.is_angle
    length = np.abs(linkage.loops.lengths @ first.values[0, :, 0] + linkage.loops.length0).max()
    scale = np.where(is_angle, 1.0, length)
    period, winding = 0.0, np.zeros(len(guess))
    turn = start + 2 * pi
    row = linkage.loops.drives[0]
    turns_round = inputs is unit_input and high - low >= 2 * pi - 1e-9
    turns_round = turns_round and is_angle[row != 0].all() and np.isclose(np.abs(row).sum(), 1)
    # If all is as before after one turn, that is the path for any number of turns.
    up, dead_up = _follow(branch, start, first, turn if turns_round else high, scale)
    if turns_round and up and up[-1][0] >= turn - 1e-9:
        near = min(up, key=lambda node: abs(node[0] - turn))
        after = branch.at(turn, taylor(near[1], turn - near[0]))
        turns = (after.values[0, :, 0] - first.values[0, :, 0]) / (2 * pi)
        whole_turns = np.where(is_angle, np.round(turns), 0.0)
        if after.closed[0] and np.abs(turns - whole_turns).max() < 1e-9 * max(1.0, scale.max()):
            period, winding = 2 * pi, whole_turns
            dead_up = [dead for dead in dead_up if dead.at < turn - 1e-9]
        elif high > turn:
            farther, dead_farther = _follow(branch, *up[-1], high, scale)
            up, dead_up = up + farther, dead_up + dead_farther
    if not period and turns_round:
        up = [node for node in up if node[0] <= high + 1e-9]
        dead_up = [dead for dead in dead_up if dead.at <= high + 1e-9]
    down, dead_down = ([], []) if period else _follow(branch, start, first, low, scale)
    nodes = [*reversed(down), (start, first), *up]
    return Path(
        np.array([at for at, _ in nodes]),
        np.stack([solution.values[:, :, 0] for _, solution in nodes], axis=-1),
        period,
        winding,
        tuple(sorted(dead_down + dead_up, key=lambda dead: dead.at)),
        (low, high),
        len(down),
    )


def _first(branch: Branch, linkage: ReducedLoops, start: float, guess: Real) -> Solution:
    """Return the position at the start; raise LinkageError if there is none, or a dead point."""
    first = branch.at(start, guess)
    if not first.closed[0]:
        drives = linkage.loops.drives
        error = branch.inputs(np.array([start]))[0, :, 0] - drives @ guess
        raise LinkageError(_why_open(linkage, guess + np.linalg.pinv(drives) @ error))
    if not (np.abs(first.determinant[:, 0]) > _DEAD).all():
        loop = ', '.join(loop_names(linkage, most_singular(first)))
        raise LinkageError(
            f'the start is a dead point of the loop {loop}, from which it is not known where to '
            'go: start next to it'
        )
    return first


def _why_open(linkage: ReducedLoops, guess: Real) -> str:
    """The message about loops that do not close from `guess` (n,), with starts that do."""
    loops, is_angle = linkage.loops, linkage.loops.is_angle
    driven = [int(k) for k in np.flatnonzero(loops.drives.any(axis=0))]
    at = f' with {{{_described(loops, guess, driven)}}}' if driven else ''
    starts = closing_starts(loops, guess)
    if not starts:
        return (
            f'the loops do not close{at}, from wherever they were tried: '
            f'{_widest_gap(loops, guess)}{_reach(linkage, guess, driven)}: check the lengths, and '
            'where the drivers are at time 0'
        )
    # Slides and struts follow from the angles of the bodies.
    free = [k for k in linkage.unknown if is_angle[k]] or list(linkage.unknown)
    near = ', or '.join(f'{{{_described(loops, values, free)}}}' for values in starts)
    return (
        f'the loops do not close{at} from {{{_described(loops, guess, free)}}}, but they do near '
        f'{near}: write the one that is meant as start'
    )


def _described(loops: Loops, values: Real, numbers: Sequence[int]) -> str:
    """Some variables with their values; rounded so that no angle is -0 or a rounding error."""
    return ', '.join(
        f'{loops.variables[k]}: '
        + (f'{round(np.degrees(x), 2) + 0.0:g} deg' if loops.is_angle[k] else f'{x:.4g} m')
        for k, x in ((k, float(values[k])) for k in numbers)
    )


def _widest_gap(loops: Loops, guess: Real) -> str:
    """Words on the loop that stays open most where all loops close as well as they can."""
    gaps = open_gaps(loops, guess)
    widest = int(gaps.argmax())
    around = ', '.join(dict.fromkeys(loops.around[widest]))
    return f'the loop {around} stays open by {gaps[widest]:.4g} m'


def _reach(linkage: ReducedLoops, guess: Real, driven: Sequence[int]) -> str:
    """Words on how far the one driver goes towards its value in `guess` (n,)."""
    loops = linkage.loops
    starts = closing_starts(loops._replace(drives=loops.drives[:0]), guess)
    if len(loops.drives) != 1 or not starts:
        return ''
    row, wanted = loops.drives[0], float(loops.drives[0] @ guess)
    start = min(starts, key=lambda values: abs(row @ values - wanted))
    here = float(row @ start)
    try:
        path = trace(linkage, here, start, min(here, wanted), max(here, wanted))
    except LinkageError:
        return ''
    nearest = path.values[0, :, -1 if wanted > here else 0]
    return f'; it closes with {{{_described(loops, nearest, driven)}}}'


def _follow(
    branch: Branch, start: float, first: Solution, end: float, scale: Real
) -> tuple[list[tuple[float, Solution]], list[DeadPoint]]:
    """Nodes after the first on the way to `end`, and the dead points met."""
    sign = 1.0 if end > start else -1.0
    nodes: list[tuple[float, Solution]] = []
    dead: list[DeadPoint] = []
    here, at, step = first, start, 0.05
    while (end - at) * sign > 1e-12 * max(1.0, abs(end)):
        if len(nodes) > _MOST_NODES:
            raise LinkageError(
                f'more than {_MOST_NODES} steps: is the range {start} to {end} meant?'
            )
        step = min(step, _LONGEST, abs(end - at))
        guess = taylor(here, sign * step)
        ahead = branch.at(at + sign * step, guess)
        error = np.inf
        if ahead.closed[0] and ahead.regular[0]:
            error = np.abs((ahead.values[0, :, 0] - guess) / scale).max()
        if not error < _GUESS_ERROR:
            step /= 2
            if step < _SHORTEST:
                dead.append(locate_limit(branch, at, here))
                break
            continue
        if np.any(ahead.determinant[:, 0] * here.determinant[:, 0] < 0):
            dead.append(locate_change_point(branch, at, here, at + sign * step))
        at, here = at + sign * step, ahead
        nodes.append((at, here))
        step *= min(2.0, 0.9 * (_GUESS_ERROR / max(error, 1e-12)) ** 0.2)
    return nodes, dead


class PathTable(NamedTuple):
    """
    Guesses for `solve`: nodes of a path so dense that one step of Newton's method is left.

    `inputs` (K,), `between` the nodes, and in `values` (orders, unknowns, K) the unknowns and their
    three derivatives. `period` and `winding` as in Path.
    """

    between: Real
    inputs: Real
    values: Real
    period: float
    winding: Real


def tabulate(linkage: ReducedLoops, path: Path, inputs: Inputs = unit_input) -> PathTable:
    """A table for `initial_guess` over the whole path, its steps split into up to 16 parts."""
    count = min(16, max(1, _MOST_NODES // len(path.inputs)))
    share = np.arange(count) / count
    at = (path.inputs[:-1, None] + np.diff(path.inputs)[:, None] * share).ravel()
    # Each step is predicted from the node it was solved from: near a limit only that is close.
    near = np.arange(len(path.inputs) - 1)
    near = np.append(np.repeat(near + (near < path.start), count), len(path.inputs) - 1)
    at = np.append(at, path.inputs[-1])
    step = at - path.inputs[near]
    guess = sum(path.values[k][:, near] * (step**k / factorial(k)) for k in range(5))
    solution = solve(linkage, inputs(at), np.asarray(guess), 4)
    good, rows = solution.regular, list(linkage.unknown)
    values = solution.values[:, rows][:, :, good]
    at, rates = at[good], np.abs(values[1:3]).max(axis=1, initial=0.0)
    # A series is good for as far as its terms fall, which next to a limit is hardly at all.
    gap = np.diff(at)
    with np.errstate(divide='ignore', invalid='ignore'):
        radius = np.nan_to_num(rates[0] / rates[1], nan=np.inf, posinf=np.inf)
        before, after = np.minimum(radius[:-1], gap), np.minimum(radius[1:], gap)
        share = np.nan_to_num(before / (before + after), nan=0.5)
    return PathTable(
        at[:-1] + share * gap,
        at,
        np.ascontiguousarray(values),
        path.period,
        path.winding[rows],
    )


def initial_guess(table: PathTable, at: Real) -> Real:
    """The unknowns (w, T) near the inputs `at` (T,), by Taylor's series at the nearest node."""
    turns = None
    if table.period:
        turns = np.floor((at - table.inputs[0]) / table.period)
        at = at - turns * table.period
    node = np.searchsorted(table.between, at)
    # No farther than the nodes go: a value beyond a limit does not close, and is detected.
    step = np.clip(at - table.inputs[node], -_LONGEST, _LONGEST)
    guess = table.values[-1].take(node, axis=1)
    for k in reversed(range(len(table.values) - 1)):
        guess *= step * (1 / (k + 1))
        guess += table.values[k].take(node, axis=1)
    if turns is not None and table.winding.any():
        guess += 2 * pi * table.winding[:, None] * turns
    return guess
