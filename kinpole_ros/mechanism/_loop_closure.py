"""
Linkages solved exactly: positions, and derivatives up to snap, for many inputs at once.

Loops close by Newton's method, for all positions jointly. Differentiated k times, the loops are
linear in the unknown k-th derivatives, always with the same matrix, so no difference quotients are
needed.
"""

from math import comb
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._loops import (
    Block,
    ReducedLoops,
    loop_jacobian,
    term_directions,
    term_lengths,
    weigh,
    with_laws,
)
from kinpole_ros.planar._plane import ROUNDING, Complex, Real

# A step whose square is below this leaves an error below rounding.
_CONVERGED = 1e-17
_MOST_STEPS = 60
# The longest step, rad or largest lengths: a longer one may lead to another branch.
_FARTHEST = 0.5
# With two columns this nearly parallel, positions are right to a rounding error over it and rates
# to one over its square: to three digits. In a change point positions are off by up to 1e-7.
SINGULAR = 1e-6
# Farther from a dead point all derivatives have digits.
_NEAR = 0.02


class Solution(NamedTuple):
    """
    Variables `values` (orders, n, T) with their derivatives, and where they are valid.

    `closed` (T,) is where the loops close; `regular` (T,) where they also determine the
    derivatives. `determinant` (blocks, T) is that of each block's matrix over the product of its
    columns' lengths: zero at a dead point.
    """

    values: Real
    closed: np.ndarray
    regular: np.ndarray
    determinant: Real


def solve(
    linkage: ReducedLoops, inputs: Real, guess: Real, orders: int = 5, close: bool = True
) -> Solution:
    """
    Positions near `guess` (n, T), and their derivatives, for `inputs` (orders or more, d, T).

    `inputs` holds each driver's value and its derivatives; `guess` all variables u, or just the
    unknowns of the linkage. Without `close` the positions are the guess, and only the derivatives
    are solved. Values are NaN where the loops do not close.
    """
    unknowns, count = linkage.free.shape[1], inputs.shape[-1]
    inputs = with_laws(linkage, inputs[:orders])
    # The rows of `state` are unknowns, then inputs, order by order.
    state = np.zeros((orders, unknowns + inputs.shape[1], count))
    state[:, unknowns:] = inputs
    if unknowns:
        state[0, :unknowns] = guess if len(guess) == unknowns else guess[list(linkage.unknown)]
    closed, determinants = np.ones(count, bool), np.ones((len(linkage.blocks), count))
    with np.errstate(all='ignore'):
        for b, block in enumerate(linkage.blocks):
            if close:
                closed &= _close(block, state[0])
            determinants[b] = _differentiate(block, state)
    regular = closed & (np.abs(determinants) > SINGULAR).all(axis=0)
    values = weigh(linkage.coefficients, state)
    values[0] += linkage.fixed[:, None]
    values[:, :, ~closed] = np.nan
    values[1:, :, ~regular] = np.nan
    return Solution(values, closed, regular, determinants)


def sound_orders(linkage: ReducedLoops, inputs: Real, solution: Solution) -> np.ndarray:
    """
    How many orders (T,) of `solution.values` have digits: next to a change point, not all.

    With columns that meet at an angle whose sine is s, the k-th derivatives are off by rounding
    over s^(k+1). Next to a limit, as near to a dead point, they themselves grow faster than that.
    """
    orders = np.full(solution.closed.shape, len(solution.values))
    least = np.abs(solution.determinant).min(axis=0, initial=1.0)
    near = np.flatnonzero(least < _NEAR)
    if not len(near) or len(solution.values) == 1:
        return orders
    loops = linkage.loops
    size = float(np.abs(loops.length0).max(initial=0.0)) or 1.0
    unit = np.where(loops.is_angle, 1.0, size)
    by = np.array([unit[row != 0].max(initial=1e-300) for row in loops.drives])
    # How fast the inputs move, from all of their derivatives.
    fast = np.stack(
        [
            (np.abs(inputs[k][:, near]) / by[:, None]).max(axis=0) ** (1 / k)
            for k in range(1, len(solution.values))
        ]
    ).max(axis=0, initial=0.0)
    for k in reversed(range(1, len(solution.values))):
        noise = ROUNDING / 8 * fast**k / least[near] ** (k + 1)
        most = (np.abs(solution.values[k][:, near]) / unit[:, None]).max(axis=0)
        # Values that are not regular are NaN.
        is_noise = ~(noise <= 1e-3 * np.maximum(most, fast**k)) & (fast > 0)
        orders[near[is_noise]] = k
    return orders


def _close(block: Block, state: Real) -> np.ndarray:
    """
    Move the block's unknowns in `state` (n + d, T) until its loops close; return where they do.

    Newton's method, jointly for all positions that are still open.
    """
    loops, unknown = block.loops, list(block.unknown)
    lengths = [j for j, k in enumerate(unknown) if loops.lengths[:, k].any()]
    done, still_open = np.zeros(state.shape[1], bool), np.arange(state.shape[1])
    for _ in range(_MOST_STEPS):
        here = state[:, still_open]
        gap, columns = loop_jacobian(loops, here, unknown)
        inverse, determinant = _inverse(columns)
        step = _apply(inverse, gap)
        scale = np.abs(term_lengths(loops, here)).max(axis=0)
        # Far from the solution a full step may lead an angle anywhere.
        moves = np.abs(step)
        moves[lengths] /= scale
        most = moves.max(axis=0, initial=0.0)
        fine = np.isfinite(most)
        step[:, ~fine] = 0.0
        far = most > _FARTHEST
        step[:, far] *= _FARTHEST / most[far]
        # The error after a step is its square, over the determinant.
        is_closed = (most * most <= _CONVERGED * np.abs(determinant)) | (most <= ROUNDING)
        widest = np.abs(gap).max(axis=0)
        tight = widest <= ROUNDING * scale
        is_closed |= tight
        # In a change point a step is rounding over zero: the prediction is better.
        step[:, tight & (np.abs(determinant) < SINGULAR)] = 0.0
        if len(unknown) < 2 * len(gap):
            # Redundant loops: the step is zero, but they may still be open.
            is_closed &= widest <= 1e-7 * scale
        state[np.ix_(unknown, still_open)] += step
        done[still_open] = is_closed
        still_open = still_open[fine & ~is_closed]
        if not len(still_open):
            break
    return done


def _differentiate(block: Block, state: Real) -> Real:
    """Fill in the derivatives of the block's unknowns, order by order; return the determinant."""
    loops, unknown = block.loops, list(block.unknown)
    inverse, determinant = _inverse(loop_jacobian(loops, state[0], unknown)[1])
    length, angle = weigh(loops.lengths, state), weigh(loops.angles, state)
    length[0] += loops.length0[:, None]
    turn = np.empty(angle.shape, complex)
    turn[0] = term_directions(loops, state[0])
    for k in range(1, len(state)):
        # All without the unknowns' k-th derivatives (Leibniz), which are still zero.
        turn[k] = 1j * sum(comb(k - 1, j) * angle[j + 1] * turn[k - 1 - j] for j in range(k))
        terms = sum(comb(k, j) * length[j] * turn[k - j] for j in range(k + 1))
        state[k, unknown] = derivative = _apply(inverse, weigh(loops.loops, terms))
        length[k] += weigh(loops.lengths[:, unknown], derivative)
        by_angle = weigh(loops.angles[:, unknown], derivative)
        angle[k] += by_angle
        turn[k] += 1j * by_angle * turn[0]
    return determinant


def _apply(inverse: Complex, gap: Complex) -> Real:
    """Real x (n, T) with columns x + gap (m, T) = 0."""
    if inverse.shape[1] == 1:
        return (inverse[:, 0] * gap[0]).real
    return np.asarray(np.einsum('nmt,mt->nt', inverse, gap).real)


def _inverse(columns: Complex) -> tuple[Complex, Real]:
    """
    The inverse (n, m, T) of complex columns (m, n, T), x = Re(inverse gap), and the determinant.

    The determinant (T,) is that of columns scaled to length 1. More equations than unknowns, as of
    redundant loops, are solved by least squares.
    """
    m, n, count = columns.shape
    if (m, n) == (1, 2):
        a, b = columns[0]
        cross = (a.conj() * b).imag
        inverse = np.stack((-1j * b.conj(), 1j * a.conj())) / cross
        return inverse[:, None], cross / (np.abs(a) * np.abs(b))
    if not n:
        return np.zeros((0, m, count), complex), np.ones(count)
    matrix = np.empty((count, 2 * m, n))
    matrix[:, :m], matrix[:, m:] = (
        np.moveaxis(columns.real, -1, 0),
        np.moveaxis(columns.imag, -1, 0),
    )
    size = np.sqrt((matrix**2).sum(axis=1, keepdims=True))
    size = np.where((size > 0) & np.isfinite(size), size, 1.0)
    scaled = np.where(np.isfinite(matrix), matrix / size, 0.0)
    if n == 2 * m:
        determinant = np.linalg.det(scaled)
        is_regular = np.abs(determinant) > 1e-300
        real = np.linalg.inv(np.where(is_regular[:, None, None], scaled, np.eye(n)))
        real[~is_regular] = np.nan
    else:
        determinant = np.linalg.svd(scaled, compute_uv=False).min(axis=1)
        real = np.linalg.pinv(scaled)
    real = np.moveaxis(real / size.swapaxes(1, 2), 0, -1)
    return 1j * real[:, m:] - real[:, :m], determinant
