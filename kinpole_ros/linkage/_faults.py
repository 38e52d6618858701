"""
Which dimension of a scene is wrong, by how much: the one whose correction explains the residuals.

All are tried by one linearized least squares: what a correction would take off the sum of squares
(the score test, as data snooping in geodesy: Baarda 1968), the best first, then what is left.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._residuals import point_dimensions
from kinpole_ros.linkage._unknowns import Solved, excess_of, independent
from kinpole_ros.mechanism import Equations
from kinpole_ros.planar._plane import Real

# What is taken off, of 1, 2, 3 unknowns at once, by chance as seldom as 5 deviations of one.
_BY_CHANCE = (25.0, 28.7, 31.8)
# Off for each unknown, where several explain the same; those as good but for this much are named.
_PRICE, _AS_GOOD = 10.0, 15.0
_MOST_FAULTS = 6


class Fault(NamedTuple):
    """
    What is wrong with a scene, in words or by the name of a point, length or angle: `subject`.

    It is `off` by so much, m or rad as `unit` says, `deviation` being that of it, all of it
    `deviations` off; `step` are its corrections by unknown. `others` would explain as much.
    """

    subject: str
    unit: str
    off: float
    deviation: float
    deviations: float
    step: dict[int, float]
    others: tuple[str, ...]


def faults(equations: Equations, solved: Solved, measured: Sequence[str]) -> list[Fault]:
    """
    What is wrong with the scene that left so much; `measured` are the bodies with markers.

    A point is wrong in both coordinates; the markers of a body may sit elsewhere, all together.
    """
    count = len(equations.dimensions)
    tried = {name: rows for name, rows in point_dimensions(equations.dimensions).items()}
    for b, body in enumerate(measured):
        first = count + 3 + 3 * b
        tried[f'the markers of {body}'] = [first, first + 1, first + 2]
    value, by = solved.left.value, solved.left.by
    known = list(solved.free)
    found: list[Fault] = []
    while len(found) < _MOST_FAULTS:
        base, _, _ = independent(by, known)
        reduced, gradient = _reduced(by, value, base)
        best = []
        for name, rows in tried.items():
            gain, step = _gain(reduced, gradient, rows)
            best.append((gain - _PRICE * len(step), gain, name, step))
        if not best:
            break
        best.sort(key=lambda row: -row[0])
        price, gain, name, step = best[0]
        if not step or gain < _BY_CHANCE[min(len(step), 3) - 1]:
            break
        # What is left with it, and all before, corrected.
        columns, _, inverse = independent(by, [*base, *step])
        change = -inverse @ np.einsum('tku,tk->u', by[..., columns], value)
        left = value + np.einsum('tku,u->tk', by[..., columns], change)
        excess = excess_of(left)
        if gain < _BY_CHANCE[min(len(step), 3) - 1] * excess:
            break
        own = [columns.index(k) for k in step if k in columns]
        lengths = [k for k in own if _kind(equations, columns[k]) == 'length'] or own
        off = change[lengths]
        size = float(np.linalg.norm(off))
        spread = inverse[np.ix_(lengths, lengths)] * excess
        deviation = float(np.sqrt(off @ spread @ off)) / size if size else 0.0
        others = tuple(row[2] for row in best[1:] if row[0] > price - _AS_GOOD * excess)
        found.append(
            Fault(
                name,
                {'length': 'm', 'angle': 'rad'}[_kind(equations, columns[lengths[0]])],
                size,
                deviation,
                float(np.sqrt(gain / excess)),
                {columns[k]: float(change[k]) for k in own},
                others,
            )
        )
        known += [k for k in step if k not in known]
        for taken in (name,):
            del tried[taken]
    return found


def _kind(equations: Equations, unknown: int) -> str:
    """Whether an unknown, numbered as in `Left`, is a 'length' or an 'angle'."""
    count = len(equations.dimensions)
    if unknown < count:
        return equations.dimensions[unknown].kind
    return 'angle' if (unknown - count) % 3 == 2 else 'length'


def _reduced(by: Real, value: Real, base: list[int]) -> tuple[Real, Real]:
    """Normal matrix (U, U) and gradient (U,) of all unknowns with those of `base` eliminated."""
    columns = by.reshape(-1, by.shape[-1])
    square, gradient = columns.T @ columns, columns.T @ value.ravel()
    if base:
        size = np.sqrt(np.diag(square))[base]
        inner = square[np.ix_(base, base)] / np.outer(size, size)
        across = np.linalg.solve(inner, square[base] / size[:, None])
        square = square - (square[:, base] / size) @ across
        gradient = gradient - across.T @ (gradient[base] / size)
    return square, gradient


def _gain(square: Real, gradient: Real, rows: list[int]) -> tuple[float, list[int]]:
    """What correcting `rows` takes off the sum of squares, and which of them can be told."""
    part = square[np.ix_(rows, rows)]
    used: list[int] = []
    for k in range(len(rows)):
        trial = [*used, k]
        block = part[np.ix_(trial, trial)]
        # Nothing is left of it beside what is known already.
        if part[k, k] > 0 and np.linalg.cond(block) < 1e12:
            used.append(k)
    if not used:
        return 0.0, []
    some = [rows[k] for k in used]
    block = square[np.ix_(some, some)]
    return float(gradient[some] @ np.linalg.solve(block, gradient[some])), some
