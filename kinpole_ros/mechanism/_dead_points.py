"""
Dead points of a linkage: limits, where the input turns back, and change points.

If the matrix of the loops is singular, the driver cannot turn on (a limit), or could go on in two
ways (a change point). Both are located by driving another variable, for which the same position is
regular.
"""

from collections.abc import Callable
from math import factorial
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._loop_closure import SINGULAR, Solution, solve
from kinpole_ros.mechanism._loops import ReducedLoops, reduce
from kinpole_ros.planar._plane import Real

# Values and derivatives (5, d, T) of the drivers over a parameter (T,).
Inputs = Callable[[Real], Real]


class DeadPoint(NamedTuple):
    """
    A position in which the loops do not determine the motion: at the input `at`.

    `values` (n,) are all variables. `turns_back` tells whether the input ends here (a limit) or
    goes on (a change point). `moving` names the variables that move while the input stands still,
    `loop` the joints, or vectors, of the loops that let them.
    """

    at: float
    values: Real
    turns_back: bool
    moving: tuple[str, ...]
    loop: tuple[str, ...]


def unit_input(at: Real, orders: int = 5) -> Real:
    """An input (orders, 1, T) that is its own parameter: the values `at` (T,), at rate 1."""
    inputs = np.zeros((max(2, orders), 1, len(at)))
    inputs[0, 0], inputs[1] = at, 1.0
    return inputs


class Branch(NamedTuple):
    """A linkage, and its inputs over the parameter of the branch."""

    linkage: ReducedLoops
    inputs: Inputs

    def at(self, at: float, guess: Real) -> Solution:
        """The solution at one parameter next to a guess (n,)."""
        return solve(self.linkage, self.inputs(np.array([at])), np.asarray(guess)[:, None])


def locate_limit(branch: Branch, at: float, here: Solution) -> DeadPoint:
    """
    The limit just ahead of `here`: where the input, driven by the fastest variable, turns back.

    There the derivative of the input by that variable vanishes, and Newton's method finds it.
    """
    linkage = branch.linkage
    loops, loop = linkage.loops, loop_names(linkage, most_singular(here))
    fastest = int(np.abs(here.values[1, :, 0]).argmax())
    near = DeadPoint(at, here.values[0, :, 0], True, (loops.variables[fastest],), loop)
    if branch.inputs is not unit_input or loops.laws:
        return near
    row = np.zeros((1, len(loops.variables)))
    row[0, fastest] = 1.0
    driven_by_fastest, input_row = reduce(loops._replace(drives=row)), loops.drives[0]
    x, values = here.values[0, fastest, 0], here.values[0, :, 0]
    for _ in range(51):
        solution = solve(driven_by_fastest, unit_input(np.array([x])), values[:, None])
        if not solution.regular[0]:
            return near
        values = solution.values[0, :, 0]
        slope, curvature = (input_row @ solution.values[k, :, 0] for k in (1, 2))
        step = -slope / curvature if curvature else 0.0
        if abs(step) < 1e-14 * max(1.0, abs(x)):
            break
        x += np.clip(step, -0.1, 0.1)
    moves = np.abs(solution.values[1, :, 0]) > 1e-9
    moving = tuple(name for name, m in zip(loops.variables, moves, strict=True) if m)
    return DeadPoint(float(input_row @ values), values, True, moving, loop)


def locate_change_point(branch: Branch, low: float, here: Solution, high: float) -> DeadPoint:
    """
    The change point between two nodes, where a determinant passes zero.

    Positions right there are ill-determined, but all is smooth along the branch, so it is the zero
    of a polynomial through positions around it.
    """
    linkage = branch.linkage
    after = branch.at(high, taylor(here, high - low))
    block = int(np.argmax(here.determinant[:, 0] * after.determinant[:, 0] < 0))
    moving, loop = _block_variables(linkage, block), loop_names(linkage, block)
    before, behind = here.determinant[block, 0], after.determinant[block, 0]
    middle = low + before / (before - behind) * (high - low)
    # An even number of nodes: none is at the middle.
    x = np.polynomial.chebyshev.chebpts1(14)
    for width in (0.15, 0.1):
        at = middle + width * x
        is_low = np.abs(at - low) < np.abs(at - high)
        guess = [
            taylor(here, s - low) if near_low else taylor(after, s - high)
            for s, near_low in zip(at.tolist(), is_low.tolist(), strict=True)
        ]
        solution = solve(linkage, branch.inputs(at), np.stack(guess, axis=-1), 2)
        if not solution.closed.all():
            break
        series = np.polynomial.chebyshev.chebfit(x, solution.determinant[block], 13)
        roots = np.polynomial.chebyshev.chebroots(series)
        inner = roots[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) < 1)].real
        if not len(inner):
            break
        root = inner[np.abs(inner).argmin()]
        series = np.polynomial.chebyshev.chebfit(x, solution.values[0].T, 13)
        middle += width * root
        values = np.polynomial.chebyshev.chebval(root, series)
    else:
        return DeadPoint(float(middle), values, False, moving, loop)
    return DeadPoint(float(middle), taylor(here, middle - low), False, moving, loop)


def _block_variables(linkage: ReducedLoops, block: int) -> tuple[str, ...]:
    """The variables that depend on the unknowns of a block."""
    rows = linkage.free[:, list(linkage.blocks[block].unknown)]
    names = zip(linkage.loops.variables, rows, strict=True)
    return tuple(name for name, row in names if row.any())


def loose_variables(linkage: ReducedLoops, here: Solution) -> tuple[str, ...]:
    """The variables, at the one position of a solution, that can move with all drivers held."""
    blocks = np.flatnonzero(np.abs(here.determinant[:, 0]) <= SINGULAR).tolist()
    names = {name for block in blocks for name in _block_variables(linkage, block)}
    return tuple(name for name in linkage.loops.variables if name in names)


def loop_names(linkage: ReducedLoops, block: int) -> tuple[str, ...]:
    """The joints, or vectors, of a block's loops, each once."""
    around = linkage.blocks[block].loops.around
    return tuple(dict.fromkeys(name for names in around for name in names))


def most_singular(here: Solution) -> int:
    """The block that is nearest to a dead point."""
    return int(np.abs(here.determinant[:, 0]).argmin())


def taylor(here: Solution, step: float) -> Real:
    """The variables (n,) a step of the parameter ahead of a solution, by Taylor's series."""
    orders = range(len(here.values))
    return np.asarray(sum(here.values[k, :, 0] * step**k / factorial(k) for k in orders))
