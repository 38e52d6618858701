"""
Linkages solved exactly: positions, and derivatives up to snap, for many inputs at once.

Dyads close directly (`_dyads`), all other loops by Newton's method, for all positions jointly.
Differentiated k times, the loops are linear in the unknown k-th derivatives, always with the same
matrix, so no difference quotients are needed.
"""

from collections.abc import Sequence
from math import comb
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._dyads import close_dyad
from kinpole_ros.mechanism._loops import Block, Linkage, weigh, with_laws
from kinpole_ros.planar._plane import ROUNDING, Complex, Real

# A step whose square is below this leaves an error below rounding.
_CONVERGED = 1e-17
_MOST_STEPS = 60
# With two columns this nearly parallel, positions are right to a rounding error over it and rates
# to one over its square: to three digits. In a change point positions are off by up to 1e-7.
SINGULAR = 1e-6
# Farther from a dead point all derivatives have digits.
_NEAR = 0.02
_NONE = 0j


class Solution(NamedTuple):
    """
    Variables `values` (orders, n, T) with their derivatives, and where they are valid.

    `closed` (T,) is where the loops close; `regular` (T,) where they also determine the
    derivatives. `determinant` (blocks, T) is that of each block's matrix over the product of its
    columns' lengths: zero at a dead point. `turns` (orders, A, T) are e^{iα} of the linkage's
    distinct angles, `slides` (orders, V, T) its distinct lengths.
    """

    values: Real
    closed: np.ndarray
    regular: np.ndarray
    determinant: Real
    turns: Complex
    slides: Real


def solve(
    linkage: Linkage,
    inputs: Real,
    guess: Real,
    orders: int = 5,
    close: bool = True,
    out: Real | None = None,
) -> Solution:
    """
    Positions near `guess` (n, T), and their derivatives, for `inputs` (orders or more, d, T).

    `inputs` holds each driver's value and its derivatives; `guess` all variables u, or just the
    unknowns of the linkage. Without `close` the positions are the guess, and only the derivatives
    are solved. `out` is an array for the values. Values are NaN where the loops do not close.
    """
    unknowns = linkage.free.shape[1]
    count = inputs.shape[-1]
    inputs = with_laws(linkage, inputs[:orders])
    # The rows of `state` are unknowns, then inputs, order by order.
    state = np.empty((orders, unknowns + inputs.shape[1], count))
    state[:, unknowns:] = inputs
    if unknowns:
        state[0, :unknowns] = guess if len(guess) == unknowns else guess[list(linkage.unknown)]
    closed, regular = np.ones(count, bool), np.ones(count, bool)
    determinants = np.ones((len(linkage.blocks), count))
    turns = np.empty((orders, len(linkage.turns), count), complex)
    slides = np.empty((orders, len(linkage.slides), count))
    with np.errstate(all='ignore'):
        first = linkage.blocks[0] if linkage.blocks else None
        for row in range(first.turns.start if first else len(linkage.turns)):
            _turn(linkage.turns[row], state, turns[:, row])
        rows = slice(0, first.slides.start if first else None)
        slides[:, rows] = weigh(linkage.slides[rows], state)
        for b, block in enumerate(linkage.blocks):
            if close:
                closed &= _close(linkage, block, state[0], turns[0], slides[0])
            else:
                _move(linkage, block, state[0], turns[0], slides[0])
            determinants[b] = _differentiate(linkage, block, state, turns, slides)
            regular &= np.abs(determinants[b]) > SINGULAR
    coefficients = np.concatenate((linkage.free, linkage.driven), axis=1)
    values = weigh(coefficients, state, out)
    values[:, ~coefficients.any(axis=1)] = 0.0
    if linkage.fixed.any():
        values[0] += linkage.fixed[:, None]
    if not closed.all():
        values[:, :, ~closed] = np.nan
    if not regular.all():
        values[1:, :, ~regular] = turns[1:, :, ~regular] = np.nan
    return Solution(values, closed, regular & closed, determinants, turns, slides)


def sound_orders(linkage: Linkage, inputs: Real, solution: Solution) -> np.ndarray:
    """
    How many orders (T,) of `solution.values` have digits: next to a change point, not all.

    With columns that meet at an angle whose sine is s, the k-th derivatives are off by rounding
    over s^(k+1). Next to a limit, as near to a dead point, they themselves grow faster than that.
    """
    orders = np.full(solution.closed.shape, len(solution.values))
    least = np.abs(solution.determinant).min(axis=0, initial=1.0)
    near = np.flatnonzero(least < _NEAR)
    if not len(near):
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


def _turn(row: Real, state: Real, turn: Complex) -> None:
    """Fill in e^{iα} (orders, T) of an angle without unknowns, and its derivatives."""
    if not row.any():
        turn[0], turn[1:] = 1.0, 0.0
        return
    angle = weigh(row[None], state)[:, 0]
    _unit_vector(angle[0], turn[0])
    # Often all rates but the first are zero.
    rates = [1j * rate if rate.any() else _NONE for rate in angle]
    for k in range(1, len(state)):
        np.multiply(rates[k], turn[0], out=turn[k])
        if k > 1:
            turn[k] += _lower(k, rates, turn)


def _unit_vector(angle: Real, turn: Complex) -> None:
    """
    Fill in e^{iα}, from the tangent of half the angle.

    That is one function instead of two, and numpy's is vectorized (3 ns an angle against 15).
    """
    half = np.tan(0.5 * angle)
    scale = 2.0 / (1.0 + half * half)
    np.subtract(scale, 1.0, out=turn.real)
    np.multiply(scale, half, out=turn.imag)


def _lower(k: int, rates: Sequence[Complex | complex], turn: Complex) -> Complex | float:
    """
    The k-th derivative of e^{iα}, Σ (k-1 over j) i α^(j+1) (e^{iα})^(k-1-j), without α^(k).

    `rates` are i α^(j), `turn` the derivatives (k or more, ...) up to the one before.
    """
    total: Complex | float = 0.0
    for j in range(k - 1):
        rate = rates[j + 1]
        if rate is not _NONE:
            weight = comb(k - 1, j)
            total = total + (rate if weight == 1 else weight * rate) * turn[k - 1 - j]
    return total


def _move(linkage: Linkage, block: Block, state: Real, turn: Complex, slide: Real) -> None:
    """Compute the block's e^{iα} and lengths from its unknowns."""
    _unit_vector(weigh(linkage.turns[block.turns], state), turn[block.turns])
    slide[block.slides] = weigh(linkage.slides[block.slides], state)


def _sum(block: Block, rows: slice, turn: Complex, slide: Real) -> Complex:
    """Some of the block's sums (rows, T)."""
    count = block.turns.stop
    total = weigh(block.constant[rows, :count], turn[:count])
    for v in range(block.slides.stop):
        if block.sliding[v, rows].any():
            total += slide[v] * weigh(block.sliding[v, rows, :count], turn[:count])
    return total


def _close(linkage: Linkage, block: Block, state: Real, turn: Complex, slide: Real) -> np.ndarray:
    """Move the block's unknowns in `state` until its loops close; return where they do (T,)."""
    if not block.dyad:
        return _newton(linkage, block, state, turn, slide)
    done = close_dyad(linkage, block, state, turn, slide)
    _newton_where(~done, linkage, block, done, state, turn, slide)
    return done


def _newton_where(
    mask: np.ndarray,
    linkage: Linkage,
    block: Block,
    done: np.ndarray,
    *arrays: np.ndarray,
    steps: int = 0,
) -> None:
    """Newton's method at the positions in `mask` (T,), whose results replace those in `arrays`."""
    rows = np.flatnonzero(mask)
    if len(rows):
        state, turn, slide = subset = [array[:, rows] for array in arrays]
        done[rows] = _newton(linkage, block, state, turn, slide, steps)
        for array, part in zip(arrays, subset, strict=True):
            array[:, rows] = part


def _newton(
    linkage: Linkage, block: Block, state: Real, turn: Complex, slide: Real, steps: int = 0
) -> np.ndarray:
    """Newton's method, jointly for all positions; return where the loops close (T,)."""
    m, n = len(block.loops), len(block.unknown)
    lengths = [j for j, k in enumerate(block.unknown) if linkage.slides[:, k].any()]
    _move(linkage, block, state, turn, slide)
    loops = _sum(block, slice(None), turn, slide)
    gap = loops[:m]
    inverse, determinant = _inverse(loops[m:].reshape(m, n, loops.shape[-1]))
    step = _apply(inverse, gap)
    worst = np.abs(step).max(initial=0.0)
    limit = _CONVERGED * np.abs(determinant).min(initial=1.0)
    if n == 2 * m and not lengths and worst * worst <= limit:
        _step(linkage, block, step, state, turn, slide)
        return np.ones(step.shape[1], bool)
    # The largest length, or nearly. Lengths of later blocks are not initialized yet.
    size = np.abs(linkage.length0).max(initial=0.0)
    scale = np.maximum(size, np.abs(slide[: block.slides.stop]).max(axis=0, initial=0.0))
    # Far from the solution a full step may lead an angle anywhere.
    moves = np.abs(step)
    moves[lengths] /= scale
    most = moves.max(axis=0, initial=0.0)
    fine = np.isfinite(most)
    step[:, ~fine] = 0.0
    far = most > 0.5
    step[:, far] *= 0.5 / most[far]
    # The error after a step is its square, over the determinant.
    done = (most * most <= _CONVERGED * np.abs(determinant)) | (most <= ROUNDING)
    tight = np.abs(gap).max(axis=0) <= ROUNDING * scale
    done |= tight
    # In a change point a step is rounding over zero: the prediction is better.
    step[:, tight & (np.abs(determinant) < SINGULAR)] = 0.0
    if n < 2 * m:
        # Redundant loops: the step is zero, but they may still be open.
        done &= np.abs(gap).max(axis=0) <= 1e-7 * scale
    _step(linkage, block, step, state, turn, slide)
    if steps < _MOST_STEPS:
        _newton_where(fine & ~done, linkage, block, done, state, turn, slide, steps=steps + 1)
    return done


def _step(
    linkage: Linkage, block: Block, step: Real, state: Real, turn: Complex, slide: Real
) -> None:
    """Make a step of the unknowns; the last one is so small that e^{iα} needs no new tangent."""
    unknown, rows = list(block.unknown), block.turns
    state[unknown] += step
    turn[rows] += turn[rows] * (1j * weigh(linkage.turns[rows][:, unknown], step))
    slide[block.slides] += weigh(linkage.slides[block.slides][:, unknown], step)


def _differentiate(
    linkage: Linkage, block: Block, state: Real, turns: Complex, slides: Real
) -> Real:
    """Fill in the derivatives of the block's unknowns, order by order; return the determinant."""
    m, unknown = len(block.loops), list(block.unknown)
    rows, count = block.turns, block.turns.stop
    columns = _sum(block, slice(m, None), turns[0], slides[0])
    inverse, determinant = _inverse(columns.reshape(m, len(unknown), state.shape[-1]))
    turning, slide_rows = 1j * linkage.turns[rows], linkage.slides[block.slides]
    # i α^(k) of the block's angles.
    rates = np.empty((len(state), rows.stop - rows.start, state.shape[-1]), complex)
    sliding = [v for v in range(block.slides.stop) if block.sliding[v, :m].any()]
    # Angles that are constant have no derivatives.
    moving = block.constant[:m, :count] * linkage.turns[:count].any(axis=1)
    for k in range(1, len(state)):
        # All terms without the unknowns' k-th derivatives (Leibniz), which are still zero.
        turns[k, rows] = _lower(k, rates, turns[:, rows])
        if block.mixed:
            state[k, unknown] = 0.0
            turns[k, rows] += weigh(turning, state[k]) * turns[0, rows]
            slides[k, block.slides] = weigh(slide_rows, state[k])
        elif len(slide_rows):
            slides[k, block.slides] = 0.0
        gap = weigh(moving, turns[k, :count])
        for v in sliding:
            for j in range(k + 1):
                part = weigh(block.sliding[v, :m, :count], turns[k - j, :count])
                gap += comb(k, j) * slides[j, v] * part
        derivative = _apply(inverse, gap)
        state[k, unknown] = derivative
        weigh(turning[:, unknown], derivative, out=rates[k])
        turns[k, rows] += rates[k] * turns[0, rows]
        if len(slide_rows):
            slides[k, block.slides] += weigh(slide_rows[:, unknown], derivative)
        if block.mixed:
            weigh(turning, state[k], out=rates[k])
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
        # Im(a* b) is the cross product of the two columns.
        product = a.conj() * b
        cross = product.imag
        scale = 1.0 / cross
        inverse = np.empty((2, 1, count), complex)
        (first,), (second,) = inverse
        # -i b* / cross and i a* / cross.
        np.multiply(a.imag, scale, out=second.real)
        np.multiply(a.real, scale, out=second.imag)
        np.negative(scale, out=scale)
        np.multiply(b.imag, scale, out=first.real)
        np.multiply(b.real, scale, out=first.imag)
        return inverse, cross / np.sqrt(product.real**2 + cross**2)
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
