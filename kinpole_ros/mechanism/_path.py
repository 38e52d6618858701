"""
The way of a linkage through its range of motion: branch by continuation, limits and dead points.

From one position the next is predicted by the Taylor series that `solve` gives, in steps as long as
the foretelling is good, so a branch is followed and never jumped. The few nodes so found start
Newton's method for any number of positions at once. Where the matrix of the loops loses rank the
driver cannot turn on (a dead point), or could go on in two ways (a change point): both are located
by driving another variable, in which the same place is ordinary.
"""

from collections.abc import Callable, Sequence
from math import factorial, pi
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._loops import Linkage, LinkageError, reduce
from kinpole_ros.mechanism._solution import Solution, solve
from kinpole_ros.mechanism._start import closing_starts
from kinpole_ros.planar._plane import Real

# The largest error of a predicted variable, rad or lengths over the largest, and the longest step.
_GUESS_ERROR, _LONGEST, _SHORTEST = 1e-3, 0.25, 1e-7
_MOST_NODES = 20_000
# Right in a dead point, where a step is a rounding error's root, or next to it.
_AT_REST = 1e-5
# Determinants above this are far from dead points.
_EASY = 0.05


class DeadPoint(NamedTuple):
    """
    Where the loops do not determine the motion: at the input `at`, with all variables `values`.

    `values` is (n,). `turns_back` tells whether the input ends here (a limit, a dead point) or goes
    on (a change point); `moving` names the variables that move while the input stands still, and
    `loop` the joints, or vectors, of the loops that let them.
    """

    at: float
    values: Real
    turns_back: bool
    moving: tuple[str, ...]
    loop: tuple[str, ...]


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


Inputs = Callable[[Real], Real]


def unit_input(at: Real, orders: int = 5) -> Real:
    """An input (orders, 1, T) that is its own parameter: the values `at` (T,), rate 1, no more."""
    inputs = np.zeros((max(2, orders), 1, len(at)))
    inputs[0, 0], inputs[1] = at, 1.0
    return inputs


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
    way = _Way(linkage, inputs)
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


class Table(NamedTuple):
    """
    Guesses for `solve`: nodes of a path so dense that one step of Newton's method is left.

    `inputs` (K,), `between` the nodes, and in `values` (orders, unknowns, K) the unknowns and their
    derivatives: three, or one where all loops are dyads, which need but a rough guess, and far from
    dead points. `period` and `winding` as in Path.
    """

    between: Real
    inputs: Real
    values: Real
    period: float
    winding: Real


def tabulate(linkage: Linkage, path: Path, inputs: Inputs = unit_input) -> Table:
    """A table for `initial_guess` over the whole path, its steps split into up to 16 parts."""
    parts = min(16, max(1, _MOST_NODES // len(path.inputs)))
    share = np.arange(parts) / parts
    at = (path.inputs[:-1, None] + np.diff(path.inputs)[:, None] * share).ravel()
    # Each step is predicted from the node it was found from: next to a limit only that one reaches.
    near = np.arange(len(path.inputs) - 1)
    near = np.append(np.repeat(near + (near < path.start), parts), len(path.inputs) - 1)
    at = np.append(at, path.inputs[-1])
    step = at - path.inputs[near]
    guess = sum(path.values[k][:, near] * (step**k / factorial(k)) for k in range(5))
    found = solve(linkage, inputs(at), np.asarray(guess), 4)
    good, rows = found.regular, list(linkage.unknown)
    at, rates = at[good], np.abs(found.values[1:3][:, rows][:, :, good]).max(axis=1, initial=0.0)
    easy = all(block.dyad for block in linkage.blocks)
    easy &= bool((np.abs(found.determinant) > _EASY).all())
    # A series reaches as far as its terms fall, which next to a limit is as good as nowhere.
    gap = np.diff(at)
    with np.errstate(divide='ignore', invalid='ignore'):
        reach = np.nan_to_num(rates[0] / rates[1], nan=np.inf, posinf=np.inf)
        one, other = np.minimum(reach[:-1], gap), np.minimum(reach[1:], gap)
        share = np.nan_to_num(one / (one + other), nan=0.5)
    return Table(
        at[:-1] + share * gap,
        at,
        np.ascontiguousarray(found.values[: 2 if easy else 4, rows][:, :, good]),
        path.period,
        path.winding[rows],
    )


def initial_guess(table: Table, at: Real) -> Real:
    """The unknowns (w, T) near the inputs `at` (T,), by Taylor's series at the nearest node."""
    turns = None
    if table.period:
        turns = np.floor((at - table.inputs[0]) / table.period)
        at = at - turns * table.period
    node = np.searchsorted(table.between, at)
    # No farther than the nodes go: a value beyond a limit does not close, and is found out.
    step = np.clip(at - table.inputs[node], -_LONGEST, _LONGEST)
    found = table.values[-1].take(node, axis=1)
    for k in reversed(range(len(table.values) - 1)):
        found *= step * (1 / (k + 1))
        found += table.values[k].take(node, axis=1)
    if turns is not None and table.winding.any():
        found += 2 * pi * table.winding[:, None] * turns
    return found


class _Way(NamedTuple):
    """A linkage, and its inputs over what parametrizes the way."""

    linkage: Linkage
    inputs: Inputs

    def at(self, at: float, guess: Real) -> Solution:
        return solve(self.linkage, self.inputs(np.array([at])), np.asarray(guess)[:, None])


def _follow(
    on: _Way, start: float, first: Solution, end: float, scale: Real
) -> tuple[list[tuple[float, Solution]], list[DeadPoint]]:
    """Nodes after the first on the way to `end`, and the dead points met."""
    way = 1.0 if end > start else -1.0
    nodes: list[tuple[float, Solution]] = []
    dead: list[DeadPoint] = []
    here, at, step = first, start, 0.05
    while (end - at) * way > 1e-12 * max(1.0, abs(end)):
        if len(nodes) > _MOST_NODES:
            raise LinkageError(
                f'more than {_MOST_NODES} steps: is the range {start} to {end} meant?'
            )
        step = min(step, _LONGEST, abs(end - at))
        ahead = _taylor(here, way * step)
        there = on.at(at + way * step, ahead)
        off = np.abs((there.values[0, :, 0] - ahead) / scale).max() if there.closed[0] else np.inf
        good = bool(there.regular[0]) and np.isfinite(off) and off < _GUESS_ERROR
        if not good:
            step /= 2
            if step < _SHORTEST:
                dead.append(_locate(on, at, here))
                break
            continue
        if np.any(there.determinant[:, 0] * here.determinant[:, 0] < 0):
            dead.append(_crossing(on, at, here, at + way * step))
        at, here = at + way * step, there
        nodes.append((at, here))
        step *= min(2.0, 0.9 * (_GUESS_ERROR / max(off, 1e-12)) ** 0.2)
    return nodes, dead


def _locate(on: _Way, at: float, here: Solution) -> DeadPoint:
    """
    The limit just ahead of `here`: where the input, driven by what moves fastest, turns back.

    There the input's derivative vanishes, by that variable, and Newton's method finds it.
    """
    linkage = on.linkage
    loop = loop_of(linkage, flattest(here))
    fast = int(np.abs(here.values[1, :, 0]).argmax())
    near = DeadPoint(at, here.values[0, :, 0], True, (linkage.loops.variables[fast],), loop)
    if on.inputs is not unit_input:
        return near
    other, place = _driven_by(linkage, fast)
    x, values = here.values[0, fast, 0], here.values[0, :, 0]
    for _ in range(50):
        found = solve(other, unit_input(np.array([x])), values[:, None])
        if not found.regular[0]:
            break
        values = found.values[0, :, 0]
        slope, bend = (place @ found.values[k, :, 0] for k in (1, 2))
        step = -slope / bend if bend else 0.0
        x += np.clip(step, -0.1, 0.1)
        if abs(step) < 1e-14 * max(1.0, abs(x)):
            break
    found = solve(other, unit_input(np.array([x])), values[:, None])
    if found.regular[0]:
        values = found.values[0, :, 0]
        return DeadPoint(float(place @ values), values, True, _moving(linkage, found), loop)
    return near


def _crossing(on: _Way, low: float, here: Solution, high: float) -> DeadPoint:
    """
    The change point between two nodes, where a determinant passes zero.

    Positions right there are ill-determined, but all is smooth along the branch, so it is read off
    a polynomial through positions around it.
    """
    linkage = on.linkage
    after = on.at(high, _taylor(here, high - low))
    block = int(np.argmax(here.determinant[:, 0] * after.determinant[:, 0] < 0))
    moving, loop = _names(linkage, block), loop_of(linkage, block)
    share = here.determinant[block, 0] / (here.determinant[block, 0] - after.determinant[block, 0])
    middle = low + share * (high - low)
    # An even number of them: none at the middle.
    x = np.polynomial.chebyshev.chebpts1(14)
    for reach in (0.15, 0.1):
        at = middle + reach * x
        near = [here if abs(s - low) < abs(s - high) else after for s in at]
        base = np.array([low if n is here else high for n in near])
        guess = np.stack([_taylor(n, d) for n, d in zip(near, at - base, strict=True)], axis=-1)
        found = solve(linkage, on.inputs(at), guess, 2)
        if not found.closed.all():
            break
        fits = np.polynomial.chebyshev.chebfit(x, found.determinant[block], 13)
        roots = np.polynomial.chebyshev.chebroots(fits)
        inner = roots[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) < 1)].real
        if not len(inner):
            break
        root = inner[np.abs(inner).argmin()]
        values = np.polynomial.chebyshev.chebfit(x, found.values[0].T, 13)
        middle, place = middle + reach * root, np.polynomial.chebyshev.chebval(root, values)
    else:
        return DeadPoint(float(middle), place, False, moving, loop)
    return DeadPoint(float(middle), _taylor(here, middle - low), False, moving, loop)


def _driven_by(linkage: Linkage, variable: int) -> tuple[Linkage, Real]:
    """The same loops with one variable for the input, and the row that gives the old input."""
    loops = linkage.loops
    row = np.zeros((1, len(loops.variables)))
    row[0, variable] = 1.0
    return reduce(loops._replace(drives=row)), loops.drives[0]


def _moving(linkage: Linkage, found: Solution) -> tuple[str, ...]:
    moves = np.abs(found.values[1, :, 0]) > 1e-9
    return tuple(n for n, m in zip(linkage.loops.variables, moves, strict=True) if m)


def _names(linkage: Linkage, block: int) -> tuple[str, ...]:
    unknown = linkage.blocks[block].unknown
    rows = linkage.free[:, list(unknown)]
    return tuple(n for n, row in zip(linkage.loops.variables, rows, strict=True) if row.any())


def loop_of(linkage: Linkage, block: int) -> tuple[str, ...]:
    """The joints, or vectors, of a block's loops, each once."""
    around = [linkage.loops.around[loop] for loop in linkage.blocks[block].loops]
    return tuple(dict.fromkeys(name for names in around for name in names))


def flattest(here: Solution) -> int:
    """The block next to a dead point."""
    return int(np.abs(here.determinant[:, 0]).argmin())


def _taylor(here: Solution, step: float) -> Real:
    return np.asarray(
        sum(here.values[k, :, 0] * step**k / factorial(k) for k in range(len(here.values)))
    )


def _guess_from(nodes: list[tuple[float, Solution]], at: float) -> Real:
    near = min(nodes, key=lambda node: abs(node[0] - at))
    return _taylor(near[1], at - near[0])


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
