"""
Which dimension of a scene is wrong, by how much: the one whose correction explains the residuals.

All are tried by one linearized least squares: what a correction would take off the sum of squares
(the score test, as data snooping in geodesy: Baarda 1968), the best first, then what is left.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._residuals import point_dimensions
from kinpole_ros.linkage._unknowns import Normal, always_free, independent
from kinpole_ros.mechanism import Equations
from kinpole_ros.planar._plane import Real

# What is taken off, of 1, 2, 3 unknowns at once, by chance as seldom as 5 deviations of one.
_BY_CHANCE = (25.0, 28.7, 31.8)
# Off for each unknown, where several explain the same; those as good but for this much are named.
_PRICE, _AS_GOOD = 10.0, 15.0
_MOST_FAULTS = 6
# What others leave so little of, of its square, cannot be told from them.
_DEPENDENT = 1e-7


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


def faults(
    equations: Equations,
    normal: Normal,
    measured: Sequence[str],
    excess: Callable[[list[int], Real], float],
) -> list[Fault]:
    """
    What is wrong with the scene that left so much; `measured` are the bodies with markers.

    A point is wrong in both coordinates; the markers of a body may sit elsewhere, all together.
    `excess` tells by how much variances are to be larger, once unknowns are corrected by so much.
    """
    count = len(equations.dimensions)
    tried = point_dimensions(equations.dimensions)
    for b, body in enumerate(measured):
        first = count + 3 + 3 * b
        tried[f'the markers of {body}'] = [first, first + 1, first + 2]
    known = always_free(equations)
    found: list[Fault] = []
    while len(found) < _MOST_FAULTS and tried:
        base, _, _ = independent(normal.square, known)
        reduced, gradient = _reduced(normal, base)
        best = []
        for name, rows in tried.items():
            gain, step = _gain(reduced, gradient, np.diag(normal.square), rows)
            best.append((gain - _PRICE * len(step), gain, name, step))
        # Of two that are the same, as the ends of one link, the one that is not an origin.
        best.sort(key=lambda row: (-round(row[0], 3), -_value(equations, tried[row[2]])))
        price, gain, name, step = best[0]
        if not step or gain < _BY_CHANCE[len(step) - 1]:
            break
        # What is left with it, and all before, corrected.
        columns, _, inverse = independent(normal.square, [*base, *step])
        change = -inverse @ normal.gradient[columns]
        more = excess(columns, change)
        if gain < _BY_CHANCE[len(step) - 1] * more:
            break
        own = [columns.index(k) for k in step]
        lengths = [k for k in own if _kind(equations, columns[k]) == 'length'] or own
        off = change[lengths]
        size = float(np.linalg.norm(off)) or 1e-300
        spread = inverse[np.ix_(lengths, lengths)] * more
        others = tuple(row[2] for row in best[1:] if row[0] > price - _AS_GOOD * more)
        fault = Fault(
            name,
            {'length': 'm', 'angle': 'rad'}[_kind(equations, columns[lengths[0]])],
            size,
            float(np.sqrt(off @ spread @ off)) / size,
            float(np.sqrt(gain / more)),
            {columns[k]: float(change[k]) for k in own},
            others,
        )
        found.append(fault)
        known += step
        del tried[name]
    return found


def _value(equations: Equations, rows: Sequence[int]) -> float:
    known = [k for k in rows if k < len(equations.dimensions)]
    return float(np.linalg.norm([equations.dimensions[k].value for k in known]))


def _kind(equations: Equations, unknown: int) -> str:
    """Whether an unknown, numbered as in `Left`, is a 'length' or an 'angle'."""
    count = len(equations.dimensions)
    if unknown < count:
        return equations.dimensions[unknown].kind
    return 'angle' if (unknown - count) % 3 == 2 else 'length'


def _reduced(normal: Normal, base: list[int]) -> tuple[Real, Real]:
    """Normal matrix (U, U) and gradient (U,) of all unknowns with those of `base` eliminated."""
    square, gradient = normal.square, normal.gradient
    if not base:
        return square, gradient
    size = np.sqrt(np.diag(square))[base]
    inner = square[np.ix_(base, base)] / np.outer(size, size)
    across = np.linalg.solve(inner, square[base] / size[:, None])
    return (
        square - (square[:, base] / size) @ across,
        gradient - across.T @ (gradient[base] / size),
    )


def _gain(
    square: Real, gradient: Real, before: Real, rows: Sequence[int]
) -> tuple[float, list[int]]:
    """
    What correcting `rows` takes off the sum of squares, and which of them can be told.

    `before` (U,) is the diagonal before anything was eliminated.
    """
    used: list[int] = []
    for k in rows:
        trial = [*used, k]
        rest = square[k, k]
        if used:
            rest -= square[k, used] @ np.linalg.solve(square[np.ix_(used, used)], square[used, k])
        if rest > _DEPENDENT * before[k]:
            used = trial
    if not used:
        return 0.0, []
    part = np.linalg.solve(square[np.ix_(used, used)], gradient[used])
    return float(gradient[used] @ part), used
