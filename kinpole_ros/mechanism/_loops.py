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


class ReducedLoops(NamedTuple):
    """
    Loops reduced to their unknowns: u = free @ w + driven @ inputs + fixed, where w = u[unknown].

    The inputs are those of the drivers, then those that laws make of them (`with_laws`). `blocks`
    are to be solved in order.
    """

    loops: Loops
    unknown: tuple[int, ...]
    free: Real
    driven: Real
    fixed: Real
    blocks: tuple['Block', ...]

    @property
    def coefficients(self) -> Real:
        """Derivatives (n, unknowns + inputs) of the variables by the unknowns and inputs."""
        return np.concatenate((self.free, self.driven), axis=1)


class Block(NamedTuple):
    """
    Loops (m) that are solved jointly for their `unknown` (j).

    The variables of these loops are the unknowns of the linkage, then its inputs, and `unknown` are
    numbers of them.
    """

    loops: Loops
    unknown: tuple[int, ...]


def reduce(loops: Loops) -> ReducedLoops:
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
    linkage = ReducedLoops(loops, tuple(unknown), free, driven, fixed, ())
    coefficients = linkage.coefficients
    names = [loops.variables[k] for k in unknown]
    anywhere = np.random.default_rng(0).normal(size=(count, 1))
    slopes = loop_jacobian(loops, anywhere)[1][:, :, 0] @ free
    order = _solving_order(
        loops.loops,
        loops.lengths @ coefficients,
        loops.angles @ coefficients,
        names,
        len(loops.drives),
        slopes,
    )
    return linkage._replace(blocks=tuple(_block(linkage, *block) for block in order))


def with_laws(linkage: ReducedLoops, inputs: Real) -> Real:
    """Values and derivatives (orders, d, T) of the drivers, followed by those that laws give."""
    for law in linkage.loops.laws:
        argument = law.of @ linkage.driven[:, : inputs.shape[1]] @ inputs
        argument[0] += law.of @ linkage.fixed
        value = compose(law.function(argument[0]), argument)
        inputs = np.concatenate((inputs, value[:, None]), axis=1)
    return inputs


def term_lengths(loops: Loops, values: Real) -> Real:
    """Lengths (terms, T), m, of the terms at variables (n, T)."""
    return np.asarray(weigh(loops.lengths, values) + loops.length0[:, None])


def term_directions(loops: Loops, values: Real) -> Complex:
    """
    Directions e^{iθ} (terms, T) of the terms at variables (n, T), from the tangent of half θ.

    That is one function instead of two, and numpy's is vectorized (3 ns an angle against 15).
    """
    half = np.tan(0.5 * (weigh(loops.angles, values) + loops.angle0[:, None]))
    scale = 2.0 / (1.0 + half * half)
    turn = np.empty(half.shape, complex)
    turn.real, turn.imag = scale - 1.0, scale * half
    return turn


def loop_jacobian(
    loops: Loops, values: Real, by: Sequence[int] | None = None
) -> tuple[Complex, Complex]:
    """
    Gaps (m, T) of the loops at variables (n, T), and their derivatives (m, j, T) by some of these.

    `by` (j) are the numbers of those variables, all by default.
    """
    by = range(len(values)) if by is None else by
    length, turn = term_lengths(loops, values), term_directions(loops, values)
    slope = np.empty((len(loops.loops), len(by), values.shape[1]), complex)
    for column, k in enumerate(by):
        by_length, by_angle = loops.lengths[:, [k]], loops.angles[:, [k]]
        slope[:, column] = weigh(loops.loops, turn * (by_length + 1j * length * by_angle))
    return weigh(loops.loops, length * turn), slope


def _block(linkage: ReducedLoops, numbers: tuple[int, ...], unknown: tuple[int, ...]) -> Block:
    """The loops of these numbers, over the unknowns and inputs of the linkage."""
    loops, coefficients = linkage.loops, linkage.coefficients
    rows = loops.loops[list(numbers)]
    terms = rows.any(axis=0)
    lengths, angles = loops.lengths[terms], loops.angles[terms]
    block = loops._replace(
        lengths=lengths @ coefficients,
        length0=loops.length0[terms] + lengths @ linkage.fixed,
        angles=angles @ coefficients,
        angle0=loops.angle0[terms] + angles @ linkage.fixed,
        loops=rows[:, terms],
        around=tuple(loops.around[k] for k in numbers),
    )
    return Block(block, unknown)


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


def weigh(coefficients: Real, vectors: np.ndarray) -> np.ndarray:
    """
    Coefficients (s, A) @ vectors (..., A, T), most coefficients being zero.

    For a single row the BLAS would call its threads, which on busy processors wait for each other
    much longer than this takes (3900 ns a position against 8).
    """
    shape = (*vectors.shape[:-2], len(coefficients), vectors.shape[-1])
    out = np.zeros(shape, vectors.dtype)
    terms = vectors.swapaxes(0, -2)
    for row, total in zip(coefficients.tolist(), out.swapaxes(0, -2), strict=True):
        for weight, term in zip(row, terms, strict=True):
            if weight:
                total += term if weight == 1 else weight * term
    return out
