"""
Linkages solved exactly: positions, and derivatives up to snap, for many inputs at once.

Dyads close directly (`_dyads`), all other loops by Newton's method, for all positions jointly.
Differentiated k times, the loops are linear in the unknown k-th derivatives, always with the same
matrix: no difference quotient comes in.
"""

from collections.abc import Sequence
from math import comb
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._dyads import close_dyad
from kinpole_ros.mechanism._loops import Block, Linkage, weigh, with_laws
from kinpole_ros.planar._plane import Complex, Real

# A step below this, of lengths over the largest and of angles in rad, is rounding.
_ROUNDING = 64 * np.finfo(float).eps
# A step whose square is below this leaves less than rounding.
_LEFT = 1e-17
_MOST_STEPS = 60
# With two columns this nearly parallel, positions are right to a rounding error over it and rates
# to one over its square: to three digits. In a change point positions are off by up to 1e-7.
SINGULAR = 1e-6
# Farther from a dead point all derivatives have digits.
_NEAR = 0.02
_NONE = 0j


class Solution(NamedTuple):
    """
    Variables `values` (orders, n, ...) with their derivatives, and where they hold.

    `closed` (...) is where the loops close; `regular` (...) where they also determine the
    derivatives. `determinant` (blocks, ...) is that of each block's matrix over the product of its
    columns' lengths: zero at a dead point. `turns` (orders, A, ...) are e^{iα} of the linkage's
    different angles, `slides` (orders, V, ...) its different lengths.
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

    `inputs` holds each driver's value and its time derivatives; `guess` all variables u, or just
    the unknowns of the linkage. Without `close` the positions are the guess, and only the
    derivatives are found. `out` is where the values go. Raises nothing: where the loops do not
    close, values are NaN.
    """
    unknowns = linkage.free.shape[1]
    count = inputs.shape[-1]
    inputs = with_laws(linkage, inputs[:orders])
    # The rows of `known` are unknowns, then inputs, order by order.
    known = np.empty((orders, unknowns + inputs.shape[1], count))
    known[:, unknowns:] = inputs
    if unknowns:
        known[0, :unknowns] = guess if len(guess) == unknowns else guess[list(linkage.unknown)]
    closed, regular = np.ones(count, bool), np.ones(count, bool)
    determinants = np.ones((len(linkage.blocks), count))
    turns = np.empty((orders, len(linkage.turns), count), complex)
    slides = np.empty((orders, len(linkage.slides), count))
    with np.errstate(all='ignore'):
        first = linkage.blocks[0] if linkage.blocks else None
        for row in range(first.turns.start if first else len(linkage.turns)):
            _turn(linkage.turns[row], known, turns[:, row])
        rows = slice(0, first.slides.start if first else None)
        slides[:, rows] = weigh(linkage.slides[rows], known)
        for b, block in enumerate(linkage.blocks):
            if close:
                closed &= _close(linkage, block, known[0], turns[0], slides[0])
            else:
                _move(linkage, block, known[0], turns[0], slides[0])
            determinants[b] = _differentiate(linkage, block, known, turns, slides)
            regular &= np.abs(determinants[b]) > SINGULAR
    both = np.concatenate((linkage.free, linkage.driven), axis=1)
    values = weigh(both, known, out)
    values[:, ~both.any(axis=1)] = 0.0
    if linkage.fixed.any():
        values[0] += linkage.fixed[:, None]
    if not closed.all():
        values[:, :, ~closed] = np.nan
    if not regular.all():
        values[1:, :, ~regular] = turns[1:, :, ~regular] = np.nan
    return Solution(values, closed, regular & closed, determinants, turns, slides)


def sound_orders(linkage: Linkage, inputs: Real, found: Solution) -> np.ndarray:
    """
    How many orders (T,) of `found.values` have digits left: next to a change point, not all.

    With columns that meet at an angle whose sine is s, the k-th derivatives are off by rounding
    over s^(k+1). Next to a limit, as near to a dead point, they themselves grow faster than that.
    """
    orders = np.full(found.closed.shape, len(found.values))
    least = np.abs(found.determinant).min(axis=0, initial=1.0)
    some = np.flatnonzero(least < _NEAR)
    if not len(some):
        return orders
    loops = linkage.loops
    size = float(np.abs(loops.length0).max(initial=0.0)) or 1.0
    unit = np.where((loops.lengths != 0).any(axis=0), size, 1.0)
    by = np.array([unit[row != 0].max(initial=1e-300) for row in loops.drives])
    # How fast things go, from all derivatives of the inputs.
    fast = np.stack(
        [
            (np.abs(inputs[k][:, some]) / by[:, None]).max(axis=0) ** (1 / k)
            for k in range(1, len(found.values))
        ]
    ).max(axis=0, initial=0.0)
    for k in reversed(range(1, len(found.values))):
        noise = _ROUNDING / 8 * fast**k / least[some] ** (k + 1)
        most = (np.abs(found.values[k][:, some]) / unit[:, None]).max(axis=0)
        # Not a number in what is irregular anyway.
        drowned = ~(noise <= 1e-3 * np.maximum(most, fast**k)) & (fast > 0)
        orders[some[drowned]] = k
    return orders


def _turn(row: Real, known: Real, turn: Complex) -> None:
    """Fill in e^{iα} (orders, T) of an angle that is all known, and its derivatives."""
    if not row.any():
        turn[0], turn[1:] = 1.0, 0.0
        return
    angle = weigh(row[None], known)[:, 0]
    _point(angle[0], turn[0])
    # Often all but the first are zero.
    rates = [1j * rate if rate.any() else _NONE for rate in angle]
    for k in range(1, len(known)):
        np.multiply(rates[k], turn[0], out=turn[k])
        if k > 1:
            turn[k] += _lower(k, rates, turn)


def _point(angle: Real, turn: Complex) -> None:
    """
    Fill in e^{iα}, from the tangent of half the angle.

    That is one function instead of two, and numpy's is vectorized (3 ns an angle against 15).
    """
    half = np.tan(0.5 * angle)
    share = 2.0 / (1.0 + half * half)
    np.subtract(share, 1.0, out=turn.real)
    np.multiply(share, half, out=turn.imag)


def _lower(k: int, rates: Sequence[Complex | complex], turn: Complex) -> Complex | float:
    """
    The k-th derivative of e^{iα}, Σ (k-1 over j) i α^(j+1) (e^{iα})^(k-1-j), but for that of α.

    `rates` are i α^(j), `turn` the derivatives (k or more, ...) up to the one before.
    """
    found: Complex | float = 0.0
    for j in range(k - 1):
        rate = rates[j + 1]
        if rate is not _NONE:
            weight = comb(k - 1, j)
            found = found + (rate if weight == 1 else weight * rate) * turn[k - 1 - j]
    return found


def _move(linkage: Linkage, block: Block, known: Real, turn: Complex, slide: Real) -> None:
    """Bring the block's angles and lengths to where its unknowns are."""
    _point(weigh(linkage.turns[block.turns], known), turn[block.turns])
    slide[block.slides] = weigh(linkage.slides[block.slides], known)


def _sum(block: Block, rows: slice, turn: Complex, slide: Real) -> Complex:
    """Some of the block's sums (rows, T)."""
    upto = block.turns.stop
    found = weigh(block.constant[rows, :upto], turn[:upto])
    for v in range(block.slides.stop):
        if block.sliding[v, rows].any():
            found += slide[v] * weigh(block.sliding[v, rows, :upto], turn[:upto])
    return found


def _close(linkage: Linkage, block: Block, known: Real, turn: Complex, slide: Real) -> np.ndarray:
    """Move the block's unknowns in `known` until its loops close; return where they do (T,)."""
    if not block.dyad:
        return _newton(linkage, block, known, turn, slide)
    done = close_dyad(linkage, block, known, turn, slide)
    left = np.flatnonzero(~done)
    if len(left):
        some = known[:, left], turn[:, left], slide[:, left]
        done[left] = _newton(linkage, block, *some)
        known[:, left], turn[:, left], slide[:, left] = some
    return done


def _newton(
    linkage: Linkage, block: Block, known: Real, turn: Complex, slide: Real, steps: int = 0
) -> np.ndarray:
    """The same step by step, jointly for those that are not there yet."""
    m, n = len(block.loops), len(block.unknown)
    lengths = [j for j, k in enumerate(block.unknown) if linkage.slides[:, k].any()]
    _move(linkage, block, known, turn, slide)
    both = _sum(block, slice(None), turn, slide)
    gap = both[:m]
    inverse, determinant = _inverse(both[m:].reshape(m, n, both.shape[-1]))
    step = _apply(inverse, gap)
    most = np.abs(step).max(axis=0, initial=0.0)
    worst = most.max(initial=0.0)
    if n == 2 * m and not lengths and worst * worst <= _LEFT * np.abs(determinant).min(initial=1.0):
        _follow(linkage, block, step, known, turn, slide)
        return np.ones(len(most), bool)
    # What later blocks slide is not known yet: whatever lay in memory.
    scale = _size(linkage, slide[: block.slides.stop])
    # Far from the solution a whole step may throw an angle anywhere.
    moves = np.abs(step)
    moves[lengths] /= scale
    most = moves.max(axis=0, initial=0.0)
    fine = np.isfinite(most)
    step[:, ~fine] = 0.0
    far = most > 0.5
    step[:, far] *= 0.5 / most[far]
    # What a step leaves is its square, over the determinant.
    done = (most * most <= _LEFT * np.abs(determinant)) | (most <= _ROUNDING)
    tight = np.abs(gap).max(axis=0) <= _ROUNDING * scale
    done |= tight
    # In a change point a step is rounding over nothing: what was predicted is better.
    step[:, tight & (np.abs(determinant) < SINGULAR)] = 0.0
    if n < 2 * m:
        # Loops that others repeat: no step is left, but they may still be open.
        done &= np.abs(gap).max(axis=0) <= 1e-7 * scale
    _follow(linkage, block, step, known, turn, slide)
    left = np.flatnonzero(fine & ~done)
    if len(left) and steps < _MOST_STEPS:
        some = known[:, left], turn[:, left], slide[:, left]
        done[left] = _newton(linkage, block, *some, steps + 1)
        known[:, left], turn[:, left], slide[:, left] = some
    return done


def _follow(
    linkage: Linkage, block: Block, step: Real, known: Real, turn: Complex, slide: Real
) -> None:
    """Make a step of the unknowns. The last is too small to turn the angles afresh."""
    unknown, rows = list(block.unknown), block.turns
    known[unknown] += step
    turn[rows] += turn[rows] * (1j * weigh(linkage.turns[rows][:, unknown], step))
    slide[block.slides] += weigh(linkage.slides[block.slides][:, unknown], step)


def _size(linkage: Linkage, slide: Real) -> Real:
    """The largest length (T,), or nearly."""
    size = np.abs(linkage.length0).max(initial=0.0)
    return np.maximum(size, np.abs(slide).max(axis=0, initial=0.0))


def _differentiate(
    linkage: Linkage, block: Block, known: Real, turns: Complex, slides: Real
) -> Real:
    """Fill in the derivatives of the block's unknowns, order by order; return the determinant."""
    m, unknown = len(block.loops), list(block.unknown)
    rows, upto = block.turns, block.turns.stop
    columns = _sum(block, slice(m, None), turns[0], slides[0])
    inverse, determinant = _inverse(columns.reshape(m, len(unknown), known.shape[-1]))
    turning, slide_rows = 1j * linkage.turns[rows], linkage.slides[block.slides]
    # i α^(k) of the block's angles.
    rates = np.empty((len(known), rows.stop - rows.start, known.shape[-1]), complex)
    sliding = [v for v in range(block.slides.stop) if block.sliding[v, :m].any()]
    # What does not turn at all has no derivatives.
    moving = block.constant[:m, :upto] * linkage.turns[:upto].any(axis=1)
    for k in range(1, len(known)):
        # All that does not hold the unknowns' k-th derivatives (Leibniz), which are still zero.
        turns[k, rows] = _lower(k, rates, turns[:, rows])
        if block.mixed:
            known[k, unknown] = 0.0
            turns[k, rows] += weigh(turning, known[k]) * turns[0, rows]
            slides[k, block.slides] = weigh(slide_rows, known[k])
        elif len(slide_rows):
            slides[k, block.slides] = 0.0
        rest = weigh(moving, turns[k, :upto])
        for v in sliding:
            for j in range(k + 1):
                part = weigh(block.sliding[v, :m, :upto], turns[k - j, :upto])
                rest += comb(k, j) * slides[j, v] * part
        found = _apply(inverse, rest)
        known[k, unknown] = found
        weigh(turning[:, unknown], found, out=rates[k])
        turns[k, rows] += rates[k] * turns[0, rows]
        if len(slide_rows):
            slides[k, block.slides] += weigh(slide_rows[:, unknown], found)
        if block.mixed:
            weigh(turning, known[k], out=rates[k])
    return determinant


def _apply(inverse: Complex, rest: Complex) -> Real:
    """Real x (n, T) with columns x + rest (m, T) = 0."""
    if inverse.shape[1] == 1:
        return (inverse[:, 0] * rest[0]).real
    return np.asarray(np.einsum('nmt,mt->nt', inverse, rest).real)


def _inverse(columns: Complex) -> tuple[Complex, Real]:
    """
    The inverse (n, m, T) of complex columns (m, n, T), x = Re(inverse rest), and the determinant.

    The determinant (T,) is that of columns scaled to length 1. More equations than unknowns, as
    where loops repeat each other, are met by least squares.
    """
    m, n, count = columns.shape
    if (m, n) == (1, 2):
        a, b = columns[0]
        # Im(a* b) is the cross product of the two columns.
        both = a.conj() * b
        cross = both.imag
        share = 1.0 / cross
        inverse = np.empty((2, 1, count), complex)
        (first,), (second,) = inverse
        # -i b* / cross and i a* / cross.
        np.multiply(a.imag, share, out=second.real)
        np.multiply(a.real, share, out=second.imag)
        np.negative(share, out=share)
        np.multiply(b.imag, share, out=first.real)
        np.multiply(b.real, share, out=first.imag)
        return inverse, cross / np.sqrt(both.real**2 + cross**2)
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
        whole = np.abs(determinant) > 1e-300
        found = np.linalg.inv(np.where(whole[:, None, None], scaled, np.eye(n)))
        found[~whole] = np.nan
    else:
        determinant = np.linalg.svd(scaled, compute_uv=False).min(axis=1)
        found = np.linalg.pinv(scaled)
    found = np.moveaxis(found / size.swapaxes(1, 2), 0, -1)
    return 1j * found[:, m:] - found[:, :m], determinant
