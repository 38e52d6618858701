"""
Linkages as vector loops: sums of terms r e^{iθ} that close, split into blocks that can be solved.

Every planar joint can be written so (seed 003): lengths r and angles θ are affine in a few
variables, of which linear ties and drivers leave the unknowns. The loops are split into the
smallest sets that can be solved one after the other: a four-bar is one loop with two unknowns.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._laws import Law, compose
from kinpole_ros.planar._plane import Complex, Real


class LinkageError(ValueError):
    """A linkage that cannot be solved: one line that says which loop or variable, and the fix."""


class Loops(NamedTuple):
    """
    Terms r e^{iθ}: r = lengths u + length0 (m), θ = angles u + angle0 (rad).

    `variables` names the n variables u; `lengths` and `angles` (terms, n), `length0` and `angle0`
    (terms,). `loops` (m, terms) holds the sign of each term in each closed sum. Each row of `ties`
    (k, n) is a linear equation ties u = tie0; each of `drives` (d, n) one whose right side is an
    input. `around` names the joints or vectors of each loop, for messages. `laws` are equations
    that are not linear, whose arguments the inputs alone determine.
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
    around: tuple[tuple[str, ...], ...]
    laws: tuple[Law, ...] = ()

    @property
    def is_angle(self) -> np.ndarray:
        """Which variables (n,) are angles: also those of no term, as of a wheel that rolls."""
        return ~np.asarray((self.lengths != 0).any(axis=0))


class Linkage(NamedTuple):
    """
    Loops reduced to their unknowns: u = free @ w + driven @ inputs + fixed, where w = u[unknown].

    The inputs are those of the drivers, then those that laws make of them (`with_laws`). The terms
    are as in Loops, over both w and the inputs (terms, unknowns + inputs). `blocks` are to be
    solved in order. `turns` (A, unknowns + inputs) are the distinct angles α of the terms, in the
    order in which they become known (those that need no unknown first), `slides` (V, ...) the
    distinct lengths: every sum of terms is a sum of e^{iα}, see `sums`.
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
    Loops (m) that are solved jointly for their `unknown` (j), and the sums they are made of.

    With E = e^{iα}: the loops, and below them their derivatives by the unknowns (m and m j rows),
    are constant @ E plus each slide times sliding @ E. `turns` and `slides` are the ranges of
    angles and lengths that become known with the block. `dyad` names by its joints the loop with a
    closed form that it is (`_dyads`): RRR of two angles, RRP of an angle and a slide in a known
    direction, RPR of a slide that turns; else empty. `mixed` tells whether its angles and lengths
    also depend on unknowns of earlier blocks or on inputs.
    """

    loops: tuple[int, ...]
    unknown: tuple[int, ...]
    constant: Complex
    sliding: Complex
    turns: slice
    slides: slice
    dyad: str
    mixed: bool


def reduce(loops: Loops) -> Linkage:
    """
    Use ties and drivers to leave the unknowns, and find the order to solve them in.

    Raises LinkageError where ties contradict each other, drivers are too few or too many, or the
    argument of a law depends on the loops.
    """
    count = len(loops.variables)
    laws = np.array([law.row for law in loops.laws]).reshape(-1, count)
    inputs = len(loops.drives) + len(laws)
    rows = np.concatenate((loops.ties, loops.drives, laws))
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
    for k, law in enumerate(loops.laws):
        later = driven[:, len(loops.drives) + k :]
        if np.abs(law.of @ np.concatenate((free, later), axis=1)).max(initial=0.0) > 1e-9:
            raise LinkageError(
                f'{law.name}: what turns it is not known before loops are closed: drive the body '
                'that it is on, by itself, by gears or by belts on one body'
            )
    coefficients = np.concatenate((free, driven), axis=1)
    lengths, angles = loops.lengths @ coefficients, loops.angles @ coefficients
    names = [loops.variables[k] for k in unknown]
    anywhere = np.random.default_rng(0).normal(size=(count, 1))
    slopes = loop_jacobian(loops, anywhere)[1][:, :, 0] @ free
    order = _solving_order(loops.loops, lengths, angles, names, len(loops.drives), slopes)
    stage = np.zeros(len(unknown) + inputs, int)
    for k, (_, block_unknowns) in enumerate(order):
        stage[list(block_unknowns)] = k + 1
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
        # A constant length is part of the coefficients.
        slides[(slides != 0).any(axis=1)],
        (),
    )
    blocks = [_block(linkage, *block, stage, k + 1) for k, block in enumerate(order)]
    return linkage._replace(blocks=tuple(blocks))


def with_laws(linkage: Linkage, inputs: Real) -> Real:
    """
    Inputs followed by the values of cams and Geneva drives, which their laws give.

    Parameters
    ----------
    linkage
        The linkage.
    inputs
        Values and derivatives of the drivers (orders, d, T).

    Returns
    -------
    ndarray
        The same, and after the d drivers the laws.

    """
    for law in linkage.loops.laws:
        argument = law.of @ linkage.driven[:, : inputs.shape[1]] @ inputs
        argument[0] += law.of @ linkage.fixed
        value = compose(law.function(argument[0]), argument)
        inputs = np.concatenate((inputs, value[:, None]), axis=1)
    return inputs


def sums(linkage: Linkage, weights: Real) -> tuple[Complex, Complex]:
    """
    Sums (s) of the terms with `weights` (s, terms), by angles: constant (s, A), sliding (V, s, A).

    With E = `Solution.turns` and l = `Solution.slides` the sums are constant @ E plus each
    l times sliding @ E.
    """
    at = np.exp(1j * linkage.angle0)
    with_turn = _equal_rows(linkage.angles, linkage.turns)
    constant = (weights * (linkage.length0 * at)) @ with_turn
    with_slide = _equal_rows(linkage.lengths, linkage.slides)
    sliding = [(weights * (at * slide)) @ with_turn for slide in with_slide.T]
    return constant, np.array(sliding, complex).reshape(len(sliding), *constant.shape)


def term_vectors(loops: Loops, values: Real) -> tuple[Real, Complex]:
    """Lengths (terms, T), m, of the terms and their directions e^{iθ}, at variables (n, T)."""
    length = loops.lengths @ values + loops.length0[:, None]
    return length, np.exp(1j * (loops.angles @ values + loops.angle0[:, None]))


def loop_jacobian(loops: Loops, values: Real) -> tuple[Complex, Complex]:
    """Gaps (m, T) of the loops at variables (n, T), and their derivatives (m, n, T) by these."""
    length, turn = term_vectors(loops, values)
    slope = np.empty((len(loops.loops), *values.shape), complex)
    for j, (by_length, by_angle) in enumerate(zip(loops.lengths.T, loops.angles.T, strict=True)):
        slope[:, j] = loops.loops @ (turn * (by_length[:, None] + 1j * length * by_angle[:, None]))
    return loops.loops @ (length * turn), slope


def _by_stage(rows: Real, stage: np.ndarray) -> Real:
    """The distinct rows, in the order of the last stage that they need."""
    distinct = np.unique(rows, axis=0)
    last = (stage * (distinct != 0)).max(axis=1, initial=0)
    return distinct[np.argsort(last, kind='stable')]


def _equal_rows(rows: Real, distinct: Real) -> Real:
    """Which of the `distinct` rows each row equals, as zeros and ones."""
    return (rows[:, None] == distinct).all(axis=2).astype(float)


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
    angles, count = len(linkage.turns), len(loops) * len(unknown)

    def rows_of_stage(rows: Real) -> slice:
        last = (stage * (rows != 0)).max(axis=1, initial=0)
        return slice(int((last < number).sum()), int((last <= number).sum()))

    block = Block(
        loops,
        unknown,
        np.concatenate((constant, columns.reshape(count, angles))),
        np.concatenate((sliding, sliding_columns.reshape(len(sliding), count, angles)), axis=1),
        rows_of_stage(linkage.turns),
        rows_of_stage(linkage.slides),
        '',
        False,
    )
    own = np.concatenate((linkage.turns[block.turns], linkage.slides[block.slides]))
    mixed = bool(np.delete(own, unknown, axis=1).any())
    return block._replace(dyad=_dyad(linkage, block), mixed=mixed)


def _dyad(linkage: Linkage, block: Block) -> str:
    """The kind of dyad that the block is, see Block."""
    turns, slides = linkage.turns[block.turns], linkage.slides[block.slides]
    by = np.concatenate((turns, slides))[:, list(block.unknown)] != 0
    if len(block.loops) != 1 or by.shape != (2, 2) or by.sum() != 2 or not by.any(axis=0).all():
        return ''
    if not len(slides):
        return 'RRR'
    if not len(turns):
        return ''
    sliding = block.sliding[block.slides.start, 0, : block.turns.stop]
    directions = bool(sliding[:-1].any()), bool(sliding[-1] != 0)
    return {(True, False): 'RRP', (False, True): 'RPR'}.get(directions, '')


def _eliminate(loops: Loops, rows: Real, right: Real) -> list[int]:
    """Bring the equations to reduced row echelon form in place; return the pivots' columns."""
    pivots: list[int] = []
    for column in range(rows.shape[1]):
        row = len(pivots)
        if row == len(rows):
            break
        best = row + int(np.abs(rows[row:, column]).argmax())
        if abs(rows[best, column]) < 1e-12:
            continue
        for matrix in (rows, right):
            matrix[[row, best]] = matrix[[best, row]]
        scale = rows[row, column]
        rows[row], right[row] = rows[row] / scale, right[row] / scale
        factors = rows[:, column].copy()
        factors[row] = 0.0
        rows -= np.outer(factors, rows[row])
        right -= np.outer(factors, right[row])
        pivots.append(column)
    if np.abs(right[len(pivots) :]).max(initial=0.0) > 1e-9:
        raise LinkageError(
            'drivers and joints contradict each other: two of them fix the same angle or slide; '
            'leave one out' + (', and drive a cam, not what follows it' if loops.laws else '')
        )
    return pivots


def _solving_order(
    loops: Real, lengths: Real, angles: Real, names: Sequence[str], inputs: int, slopes: Complex
) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """
    Smallest sets of loops with as many unsolved unknowns as equations, and these, in order.

    Of redundant loops such a set need not hold its unknowns: that shows in the derivatives `slopes`
    (loops, unknowns) anywhere.
    """
    touches = (lengths[:, : len(names)] != 0) | (angles[:, : len(names)] != 0)
    uses = (loops != 0).astype(float) @ touches > 0
    open_loops, solved = list(range(len(loops))), np.zeros(len(names), bool)
    blocks = []

    redundant = len(names) < 2 * len(loops)

    def holds(chosen: Sequence[int], unknown: np.ndarray) -> bool:
        if len(unknown) < 2 * len(chosen):
            return len(chosen) == len(open_loops)
        if not redundant:
            return len(unknown) == 2 * len(chosen)
        own = slopes[np.ix_(chosen, unknown)]
        rank = int(np.linalg.matrix_rank(np.vstack((own.real, own.imag))))
        return rank == len(unknown) == 2 * len(chosen)

    def next_block() -> tuple[tuple[int, ...], tuple[int, ...]] | None:
        for size in range(1, len(open_loops) + 1):
            for chosen in combinations(open_loops, size):
                unknown = np.flatnonzero(uses[list(chosen)].any(axis=0) & ~solved)
                if holds(chosen, unknown):
                    return chosen, tuple(int(k) for k in unknown)
        return None

    while open_loops:
        block = next_block()
        if block is None:
            missing = len(names) - int(solved.sum()) - 2 * len(open_loops)
            raise LinkageError(
                f'{inputs} drivers for {inputs + missing} degrees of freedom: {missing} more of '
                f'{", ".join(names)} must be driven or held'
            )
        blocks.append(block)
        solved[list(block[1])] = True
        open_loops = [k for k in open_loops if k not in block[0]]
    if not solved.all():
        loose = [name for name, done in zip(names, solved, strict=True) if not done]
        raise LinkageError(f'no loop holds {", ".join(loose)}: drive it, or join it to the rest')
    return blocks


def weigh(
    coefficients: np.ndarray, vectors: np.ndarray, out: np.ndarray | None = None
) -> np.ndarray:
    """
    Coefficients (s, A) @ vectors (..., A, T), most coefficients being zero.

    Rows of `out` (..., s, T) without coefficients are left as they are. For a single row the BLAS
    would call its threads, which on busy processors wait for each other much longer than this takes
    (3900 ns a position against 8).
    """
    is_new = out is None
    if out is None:
        shape = (*vectors.shape[:-2], len(coefficients), vectors.shape[-1])
        out = np.empty(shape, (coefficients if np.iscomplexobj(coefficients) else vectors).dtype)
    terms = vectors.swapaxes(0, -2)
    for row, total in zip(coefficients.tolist(), out.swapaxes(0, -2), strict=True):
        is_first = True
        for weight, term in zip(row, terms, strict=True):
            if weight and not is_first:
                total += term if weight == 1 else weight * term
            elif weight:
                np.multiply(weight, term, out=total)
                is_first = False
        if is_first and is_new:
            total[...] = 0.0
    return out
