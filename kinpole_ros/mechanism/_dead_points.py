"""
Dead points on the way of a linkage: limits, where the input turns back, and change points.

Where the matrix of the loops loses rank the driver cannot turn on (a dead point), or could go on in
two ways (a change point): both are located by driving another variable, in which the same place is
ordinary.
"""

from collections.abc import Callable
from math import factorial
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._loops import Linkage, reduce
from kinpole_ros.mechanism._solution import Solution, solve
from kinpole_ros.planar._plane import Real

Inputs = Callable[[Real], Real]


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


def unit_input(at: Real, orders: int = 5) -> Real:
    """An input (orders, 1, T) that is its own parameter: the values `at` (T,), rate 1, no more."""
    inputs = np.zeros((max(2, orders), 1, len(at)))
    inputs[0, 0], inputs[1] = at, 1.0
    return inputs


class Way(NamedTuple):
    """A linkage, and its inputs over what parametrizes the way."""

    linkage: Linkage
    inputs: Inputs

    def at(self, at: float, guess: Real) -> Solution:
        return solve(self.linkage, self.inputs(np.array([at])), np.asarray(guess)[:, None])


def locate(on: Way, at: float, here: Solution) -> DeadPoint:
    """
    The limit just ahead of `here`: where the input, driven by what moves fastest, turns back.

    There the input's derivative vanishes, by that variable, and Newton's method finds it.
    """
    linkage = on.linkage
    loop = loop_of(linkage, flattest(here))
    fast = int(np.abs(here.values[1, :, 0]).argmax())
    near = DeadPoint(at, here.values[0, :, 0], True, (linkage.loops.variables[fast],), loop)
    if on.inputs is not unit_input or linkage.loops.laws:
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


def crossing(on: Way, low: float, here: Solution, high: float) -> DeadPoint:
    """
    The change point between two nodes, where a determinant passes zero.

    Positions right there are ill-determined, but all is smooth along the branch, so it is read off
    a polynomial through positions around it.
    """
    linkage = on.linkage
    after = on.at(high, taylor(here, high - low))
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
        guess = np.stack([taylor(n, d) for n, d in zip(near, at - base, strict=True)], axis=-1)
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
    return DeadPoint(float(middle), taylor(here, middle - low), False, moving, loop)


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


def taylor(here: Solution, step: float) -> Real:
    return np.asarray(
        sum(here.values[k, :, 0] * step**k / factorial(k) for k in range(len(here.values)))
    )
