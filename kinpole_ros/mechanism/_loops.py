"""
Linkages as vector loops: sums of terms r e^{iθ} that close, solved exactly up to snap.

Every planar joint can be written so (seed 003): lengths r and angles θ are affine in a few
variables, of which linear ties and drivers leave the unknowns. The loops are taken apart into the
smallest sets that can be solved one after the other (a four-bar's is one loop with two unknowns),
each by Newton's method for all positions at once. Differentiated k times, the loops are linear in
the unknown k-th derivatives, always with the same matrix: no difference quotient comes in.
"""

from collections.abc import Sequence
from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real

# A step below this, of lengths over the largest and of angles in rad, is rounding.
_ROUNDING = 64 * np.finfo(float).eps
# A step whose square is below this leaves less than rounding.
_LEFT = 1e-17
_MOST_STEPS = 60
# With two columns this nearly parallel, positions are right to a rounding error over it and rates
# to one over its square: to no digit.
SINGULAR = 1e-7


class LinkageError(ValueError):
    """A linkage that cannot be solved: one line that says which loop or variable, and the mend."""


class Loops(NamedTuple):
    """
    Terms r e^{iθ}: r = lengths u + length0 (m), θ = angles u + angle0 (rad).

    `variables` names the n variables u; `lengths` and `angles` (terms, n), `length0` and `angle0`
    (terms,). `loops` (m, terms) holds the sign of each term in each closed sum. Each row of `ties`
    (k, n) is a linear equation ties u = tie0; each of `drives` (d, n) one whose right side is an
    input.
    """

    variables: tuple[str, ...]
    lengths: Real
    length0: Real
    angles: Real
    angle0: Real
    loops: Real
    ties: Real
    tie0: Real
    drives: Real


class Linkage(NamedTuple):
    """
    Loops reduced to their unknowns: u = free @ w + driven @ inputs + fixed, where w = u[unknown].

    The terms are as in Loops, over w and the inputs together (terms, unknowns + inputs). `blocks`
    are to be solved in order. `turns` (A, unknowns + inputs) are the different angles α of the
    terms, in the order they become known (those that need no unknown first), `slides` (V, ...)
    their different lengths: every sum of terms is one of e^{iα}, see `sums`.
    """

    loops: Loops
    unknown: tuple[int, ...]
    free: Real
    driven: Real
    fixed: Real
    lengths: Real
    length0: Real
    angles: Real
    angle0: Real
    turns: Real
    slides: Real
    blocks: tuple['Block', ...]


class Block(NamedTuple):
    """
    Loops (m) that are solved together for their `unknown` (j), and the sums they are made of.

    With E = e^{iα}: the loops and below them their columns, their derivatives by the unknowns (m
    and m j rows), are constant @ E plus each slide times sliding @ E. `turns` and `slides` are the
    ranges of angles and lengths that become known with the block.
    """

    loops: tuple[int, ...]
    unknown: tuple[int, ...]
    constant: Complex
    sliding: Complex
    turns: slice
    slides: slice


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


def reduce(loops: Loops) -> Linkage:
    """
    Use ties and drivers to leave the unknowns, and find the order to solve them in.

    Raises LinkageError where ties contradict each other, or drivers are too few or too many.
    """
    count = len(loops.variables)
    inputs = len(loops.drives)
    rows = np.concatenate((loops.ties, loops.drives))
    right = np.zeros((len(rows), inputs + 1))
    right[: len(loops.ties), -1] = loops.tie0
    right[len(loops.ties) :, :inputs] = np.eye(inputs)
    pivots = _eliminate(loops, rows, right)
    unknown = [k for k in range(count) if k not in pivots]
    free = np.zeros((count, len(unknown)))
    driven, fixed = np.zeros((count, inputs)), np.zeros(count)
    free[unknown, np.arange(len(unknown))] = 1.0
    for row, pivot in enumerate(pivots):
        free[pivot] = -rows[row, unknown]
        driven[pivot] = right[row, :inputs]
        fixed[pivot] = right[row, -1]
    both = np.concatenate((free, driven), axis=1)
    lengths, angles = loops.lengths @ both, loops.angles @ both
    names = [loops.variables[k] for k in unknown]
    order = _blocks(loops.loops, lengths, angles, names, inputs)
    stage = np.zeros(len(unknown) + inputs, int)
    for k, (_, some) in enumerate(order):
        stage[list(some)] = k + 1
    turns, slides = _by_stage(angles, stage), _by_stage(lengths, stage)
    linkage = Linkage(
        loops,
        tuple(unknown),
        free,
        driven,
        fixed,
        lengths,
        loops.length0 + loops.lengths @ fixed,
        angles,
        loops.angle0 + loops.angles @ fixed,
        turns,
        # What does not slide is no length of its own.
        slides[(slides != 0).any(axis=1)],
        (),
    )
    return linkage._replace(
        blocks=tuple(_block(linkage, *some, stage, k + 1) for k, some in enumerate(order))
    )


def sums(linkage: Linkage, weights: Real) -> tuple[Complex, Complex]:
    """
    Sums (s) of the terms with `weights` (s, terms), by angles: constant (s, A), sliding (V, s, A).

    With E = `Solution.turns` and l = `Solution.slides` the sums are constant @ E plus each
    l times sliding @ E.
    """
    at = np.exp(1j * linkage.angle0)
    with_turn = _same(linkage.angles, linkage.turns)
    constant = (weights * (linkage.length0 * at)) @ with_turn
    with_slide = _same(linkage.lengths, linkage.slides)
    sliding = [(weights * (at * slide)) @ with_turn for slide in with_slide.T]
    return constant, np.array(sliding, complex).reshape(len(sliding), *constant.shape)


def _by_stage(rows: Real, stage: np.ndarray) -> Real:
    """The different rows, in the order of the last stage that they need."""
    different = np.unique(rows, axis=0)
    last = (stage * (different != 0)).max(axis=1, initial=0)
    return different[np.argsort(last, kind='stable')]


def _same(rows: Real, different: Real) -> Real:
    """Which of the `different` each row is, as zeros and ones."""
    return (rows[:, None] == different).all(axis=2).astype(float)


def _block(
    linkage: Linkage,
    loops: tuple[int, ...],
    unknown: tuple[int, ...],
    stage: np.ndarray,
    number: int,
) -> Block:
    """Write the loops and their derivatives by the unknowns as sums over the angles."""
    constant, sliding = sums(linkage, linkage.loops.loops[list(loops)])
    # ∂(l K E) / ∂w = (∂l/∂w) K E + l K (i ∂α/∂w) E.
    by_turn = 1j * linkage.turns[:, list(unknown)].T
    by_slide = linkage.slides[:, list(unknown)]
    columns = constant[:, None] * by_turn + np.einsum('vj,vma->mja', by_slide, sliding)
    sliding_columns = sliding[:, :, None] * by_turn
    angles, rows = len(linkage.turns), len(loops) * len(unknown)

    def known_with(rows: Real) -> slice:
        last = (stage * (rows != 0)).max(axis=1, initial=0)
        return slice(int((last < number).sum()), int((last <= number).sum()))

    return Block(
        loops,
        unknown,
        np.concatenate((constant, columns.reshape(rows, angles))),
        np.concatenate((sliding, sliding_columns.reshape(len(sliding), rows, angles)), axis=1),
        known_with(linkage.turns),
        known_with(linkage.slides),
    )


def _eliminate(loops: Loops, rows: Real, right: Real) -> list[int]:
    """Bring the equations to reduced row echelon form in place; return the pivots' columns."""
    pivots: list[int] = []
    row = 0
    for column in range(rows.shape[1]):
        if row == len(rows):
            break
        best = row + int(np.abs(rows[row:, column]).argmax())
        if abs(rows[best, column]) < 1e-12:
            continue
        rows[[row, best]], right[[row, best]] = rows[[best, row]], right[[best, row]]
        scale = rows[row, column]
        rows[row], right[row] = rows[row] / scale, right[row] / scale
        for other in range(len(rows)):
            if other != row:
                factor = rows[other, column]
                rows[other] -= factor * rows[row]
                right[other] -= factor * right[row]
        pivots.append(column)
        row += 1
    if np.abs(right[row:]).max(initial=0.0) > 1e-9:
        raise LinkageError(
            'drivers and joints contradict each other: two of them fix the same angle or slide; '
            'leave one out'
        )
    return pivots


def _blocks(
    loops: Real, lengths: Real, angles: Real, names: Sequence[str], inputs: int
) -> tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]:
    """Smallest sets of loops that have as many unknowns left as equations, in order."""
    touches = (lengths[:, : len(names)] != 0) | (angles[:, : len(names)] != 0)
    uses = (loops != 0).astype(float) @ touches > 0
    left, solved = list(range(len(loops))), np.zeros(len(names), bool)
    blocks = []
    while left:
        chosen = None
        for size in range(1, len(left) + 1):
            for some in combinations(left, size):
                unknown = np.flatnonzero(uses[list(some)].any(axis=0) & ~solved)
                if len(unknown) == 2 * size or (size == len(left) and len(unknown) < 2 * size):
                    chosen = some, tuple(int(k) for k in unknown)
                    break
            if chosen:
                break
        if chosen is None:
            more = len(names) - int(solved.sum()) - 2 * len(left)
            raise LinkageError(
                f'{inputs} drivers for {inputs + more} degrees of freedom: {more} more of '
                f'{", ".join(names)} must be driven or held'
            )
        blocks.append(chosen)
        solved[list(chosen[1])] = True
        left = [k for k in left if k not in chosen[0]]
    if not solved.all():
        loose = [name for name, done in zip(names, solved, strict=True) if not done]
        raise LinkageError(f'no loop holds {", ".join(loose)}: drive it, or join it to the rest')
    return tuple(blocks)


def solve(
    linkage: Linkage, inputs: Real, guess: Real, orders: int = 5, close: bool = True
) -> Solution:
    """
    Positions near `guess` (n, T), and their derivatives, for `inputs` (orders or more, d, T).

    `inputs` holds each driver's value and its time derivatives; `guess` all variables u, or just
    the unknowns of the linkage. Without `close` the positions are the guess, and only the
    derivatives are found. Raises nothing: where the loops do not close, values are NaN.
    """
    unknowns = linkage.free.shape[1]
    count = inputs.shape[-1]
    # The rows of `known` are unknowns, then inputs, order by order.
    known = np.zeros((orders, unknowns + inputs.shape[1], count))
    known[:, unknowns:] = inputs[:orders]
    if unknowns:
        known[0, :unknowns] = guess if len(guess) == unknowns else guess[list(linkage.unknown)]
    closed, regular = np.ones(count, bool), np.ones(count, bool)
    determinants = np.ones((len(linkage.blocks), count))
    turns = np.zeros((orders, len(linkage.turns), count), complex)
    slides = np.zeros((orders, len(linkage.slides), count))
    with np.errstate(all='ignore'):
        first = linkage.blocks[0] if linkage.blocks else None
        _turn(linkage, slice(0, first.turns.start if first else None), known, turns)
        rows = slice(0, first.slides.start if first else None)
        slides[:, rows] = _slide(linkage, rows, known)
        for b, block in enumerate(linkage.blocks):
            if close:
                closed &= _close(linkage, block, known[0], turns[0], slides[0])
            else:
                _move(linkage, block, known[0], turns[0], slides[0])
            determinants[b] = _differentiate(linkage, block, known, turns, slides)
            regular &= np.abs(determinants[b]) > SINGULAR
    values = weigh(np.concatenate((linkage.free, linkage.driven), axis=1), known)
    values[0] += linkage.fixed[:, None]
    if not closed.all():
        values[:, :, ~closed] = np.nan
    if not regular.all():
        values[1:, :, ~regular] = turns[1:, :, ~regular] = np.nan
    return Solution(values, closed, regular & closed, determinants, turns, slides)


def _turn(linkage: Linkage, rows: slice, known: Real, turns: Complex) -> None:
    """Fill in e^{iα} of some angles that are all known, and their derivatives."""
    for row in range(*rows.indices(len(linkage.turns))):
        if not linkage.turns[row].any():
            turns[0, row] = 1.0
            continue
        angle = weigh(linkage.turns[row : row + 1], known)[:, 0]
        turns[0, row].real, turns[0, row].imag = np.cos(angle[0]), np.sin(angle[0])
        for k in range(1, len(known)):
            turns[k, row] = 1j * angle[k] * turns[0, row] + _leibniz(k, angle, turns[:, row])


def _leibniz(k: int, angle: Real, turn: Complex) -> Complex | float:
    """The k-th derivative of e^{iα}, i Σ (k-1 over j) α^(j+1) (e^{iα})^(k-1-j), less that of α."""
    terms = [
        (1j * comb(k - 1, j)) * angle[j + 1] * turn[k - 1 - j]
        for j in range(k - 1)
        if angle[j + 1].any()
    ]
    return np.asarray(sum(terms)) if terms else 0.0


def _slide(linkage: Linkage, rows: slice, known: Real) -> Real:
    """Some different lengths, of which `length0` is kept apart."""
    return np.asarray(weigh(linkage.slides[rows], known))


def _move(linkage: Linkage, block: Block, known: Real, turn: Complex, slide: Real) -> None:
    """Bring the block's angles and lengths to where its unknowns are."""
    angle = weigh(linkage.turns[block.turns], known)
    turn[block.turns].real, turn[block.turns].imag = np.cos(angle), np.sin(angle)
    slide[block.slides] = _slide(linkage, block.slides, known)


def _sum(block: Block, rows: slice, turn: Complex, slide: Real) -> Complex:
    """Some of the block's sums (rows, T)."""
    upto = block.turns.stop
    found = weigh(block.constant[rows, :upto], turn[:upto])
    for v in range(block.slides.stop):
        if block.sliding[v, rows].any():
            found += slide[v] * weigh(block.sliding[v, rows, :upto], turn[:upto])
    return found


def weigh(coefficients: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """
    Coefficients (s, A) @ parts (..., A, T), most coefficients being zero.

    For a single row the BLAS would call its threads, which on busy processors wait for each other
    much longer than this takes (3900 ns a position against 8).
    """
    shape = (*parts.shape[:-2], len(coefficients), parts.shape[-1])
    found = np.zeros(shape, np.result_type(coefficients, parts))
    for s, a in zip(*np.nonzero(coefficients), strict=True):
        weight, part = coefficients[s, a], parts[..., a, :]
        found[..., s, :] += part if weight == 1 else weight * part
    return found


def _close(
    linkage: Linkage, block: Block, known: Real, turn: Complex, slide: Real, steps: int = 0
) -> np.ndarray:
    """Move the block's unknowns in `known` until its loops close; return where they do (T,)."""
    m, n = len(block.loops), len(block.unknown)
    lengths = [j for j, k in enumerate(block.unknown) if linkage.slides[:, k].any()]
    _move(linkage, block, known, turn, slide)
    both = _sum(block, slice(None), turn, slide)
    gap = both[:m]
    inverse, determinant = _inverse(both[m:].reshape(m, n, -1))
    step = _apply(inverse, -gap)
    most = np.abs(step).max(axis=0, initial=0.0)
    worst = most.max(initial=0.0)
    if n == 2 * m and not lengths and worst * worst <= _LEFT * np.abs(determinant).min(initial=1.0):
        _follow(linkage, block, step, known, turn, slide)
        return np.ones(len(most), bool)
    scale = _size(linkage, slide)
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
    # In a change point a step is rounding over nothing: what was foretold is better.
    step[:, tight & (np.abs(determinant) < 10 * SINGULAR)] = 0.0
    if n < 2 * m:
        # Loops that others repeat: no step is left, but they may still be open.
        done &= np.abs(gap).max(axis=0) <= 1e-7 * scale
    _follow(linkage, block, step, known, turn, slide)
    left = np.flatnonzero(fine & ~done)
    if len(left) and steps < _MOST_STEPS:
        some = known[:, left], turn[:, left], slide[:, left]
        done[left] = _close(linkage, block, *some, steps + 1)
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
    inverse, determinant = _inverse(columns.reshape(m, len(unknown), -1))
    by_unknown = linkage.turns[rows][:, unknown]
    angle = np.zeros((len(known), rows.stop - rows.start, known.shape[-1]))
    sliding = [v for v in range(block.slides.stop) if block.sliding[v, :m].any()]
    # Whether the block's angles and lengths also need what was known before.
    mixed = bool(np.delete(linkage.turns[rows], unknown, axis=1).any())
    mixed |= bool(np.delete(linkage.slides[block.slides], unknown, axis=1).any())
    for k in range(1, len(known)):
        # All that does not hold the unknowns' k-th derivatives (Leibniz), which are still zero.
        turns[k, rows] = _leibniz(k, angle, turns[:, rows])
        if mixed:
            angle[k] = weigh(linkage.turns[rows], known[k])
            turns[k, rows] += 1j * angle[k] * turns[0, rows]
            slides[k, block.slides] = _slide(linkage, block.slides, known[k])
        rest = weigh(block.constant[:m, :upto], turns[k, :upto])
        for v in sliding:
            for j in range(k + 1):
                part = weigh(block.sliding[v, :m, :upto], turns[k - j, :upto])
                rest += comb(k, j) * slides[j, v] * part
        found = _apply(inverse, -rest)
        known[k, unknown] = found
        more = weigh(by_unknown, found)
        angle[k] += more
        turns[k, rows] += 1j * more * turns[0, rows]
        slides[k, block.slides] += weigh(linkage.slides[block.slides][:, unknown], found)
    return determinant


def _apply(inverse: Complex, right: Complex) -> Real:
    """Real x (n, T) with columns x = right (m, T)."""
    if inverse.shape[1] == 1:
        return (inverse[:, 0] * right[0]).real
    return np.asarray(np.einsum('nmt,mt->nt', inverse, right).real)


def _inverse(columns: Complex) -> tuple[Complex, Real]:
    """
    The inverse (n, m, T) of complex columns (m, n, T), x = Re(inverse right), and the determinant.

    The determinant (T,) is that of columns scaled to length 1. More equations than unknowns, as
    where loops repeat each other, are met by least squares.
    """
    m, n, count = columns.shape
    if (m, n) == (1, 2):
        a, b = columns[0]
        # Im(a* b) is the cross product of the two columns.
        cross = a.real * b.imag - a.imag * b.real
        inverse = np.empty((2, 1, count), complex)
        np.multiply(b.conj(), 1j / cross, out=inverse[0, 0])
        np.multiply(a.conj(), -1j / cross, out=inverse[1, 0])
        return inverse, cross / np.sqrt((a.real**2 + a.imag**2) * (b.real**2 + b.imag**2))
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
    return found[:, :m] - 1j * found[:, m:], determinant
