"""
Which dimension of a scene is wrong, and by how much, from the residuals of its joints.

Each correction is tried in one linearized least squares, by what it takes off the sum of squares
(the score test, as data snooping in geodesy: Baarda 1968): the best one first, then again.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.findings import Finding
from kinpole_ros.linkage._least_squares import Normal, always_free, independent
from kinpole_ros.linkage.limits import DEPENDENT
from kinpole_ros.mechanism import Dimension, Equations
from kinpole_ros.planar._plane import Real

# Least reduction of the sum of squares by 1, 2 and 3 unknowns at once. By chance it is exceeded as
# rarely as 5 standard deviations.
_MIN_REDUCTION = (25.0, 28.7, 31.8)
# Reduction that each further unknown must bring, and the difference of two explanations up to which
# both are named.
_PRICE, _AS_GOOD = 10.0, 15.0
_MAX_FAULTS = 6


class Fault(NamedTuple):
    """
    What is wrong with a scene: `subject`, a point, length or angle by name, or words.

    It is `off` by this much, m or rad as `unit` says, with the standard deviation `deviation`;
    `deviations` is its significance. `step` are its corrections by unknown. `alternatives` explain
    about as much.
    """

    subject: str
    unit: str
    off: float
    deviation: float
    deviations: float
    step: dict[int, float]
    alternatives: tuple[str, ...]

    def finding(self, scene: str, dimensions: Sequence[Dimension]) -> Finding:
        """Return what is wrong with a scene of this name, by how much, and what would be right."""
        factor, unit = (1e3, 'mm') if self.unit == 'm' else (180 / np.pi, 'deg')
        about = {
            'scene': scene,
            'name': self.subject,
            'unit': unit,
            'off': self.off * factor,
            'deviation': self.deviation * factor,
            'deviations': self.deviations,
            'alternatives': f'; or else {", ".join(self.alternatives)}' * bool(self.alternatives),
        }
        rows = [k for k, dimension in enumerate(dimensions) if dimension.name == self.subject]
        if not rows:
            return Finding('scene_places', values=about)
        before = [dimensions[k].value for k in rows]
        after = [dimensions[k].value + self.step.get(k, 0.0) for k in rows]
        for key, values in (('stated', before), ('right', after)):
            text = ', '.join(f'{value:.6g}' for value in values)
            about[key] = f'{f"[{text}]" if len(rows) > 1 else text} {self.unit}'
        return Finding('scene_dimension', values=about)


class _Candidate(NamedTuple):
    """A correction of some unknowns, and the reduction of the sum of squares by it."""

    subject: str
    unknowns: list[int]
    reduction: float

    @property
    def score(self) -> float:
        return self.reduction - _PRICE * len(self.unknowns)


def find_faults(
    equations: Equations,
    normal: Normal,
    measured: Sequence[str],
    excess: Callable[[list[int], Real], float],
) -> list[Fault]:
    """
    Find what is wrong with a scene, the most significant first.

    A point is wrong in both coordinates; all markers of a body may sit elsewhere. `measured` are
    the bodies with markers. `excess` is the factor of the variances once some unknowns are
    corrected by a change.
    """
    count = len(equations.dimensions)
    subjects = _dimensions_by_name(equations.dimensions)
    for b, body in enumerate(measured):
        first = count + 3 + 3 * b
        subjects[f'the markers of {body}'] = [first, first + 1, first + 2]
    free = always_free(equations)
    faults: list[Fault] = []
    while len(faults) < _MAX_FAULTS and subjects:
        base, _ = independent(normal.square, free)
        square, gradient = _eliminated(normal, base)
        candidates = [
            _candidate(subject, unknowns, square, gradient, np.diag(normal.square))
            for subject, unknowns in subjects.items()
        ]
        # Of two that are the same, as the ends of one link, the one that is not an origin.
        candidates.sort(
            key=lambda c: (-round(c.score, 3), -_magnitude(equations, subjects[c.subject]))
        )
        best = candidates[0]
        if not best.unknowns or best.reduction < _MIN_REDUCTION[len(best.unknowns) - 1]:
            break
        columns, covariance = independent(normal.square, [*base, *best.unknowns])
        change = -covariance @ normal.gradient[columns]
        factor = excess(columns, change)
        if best.reduction < _MIN_REDUCTION[len(best.unknowns) - 1] * factor:
            break
        as_good = [c.subject for c in candidates[1:] if c.score > best.score - _AS_GOOD * factor]
        kinds = {k: _kind(equations, k) for k in best.unknowns}
        kind = 'length' if 'length' in kinds.values() else 'angle'
        sized = [columns.index(k) for k in best.unknowns if kinds[k] == kind]
        size = float(np.linalg.norm(change[sized])) or 1e-300
        variance = change[sized] @ (covariance[np.ix_(sized, sized)] * factor) @ change[sized]
        faults.append(
            Fault(
                best.subject,
                {'length': 'm', 'angle': 'rad'}[kind],
                size,
                deviation=float(np.sqrt(variance)) / size,
                deviations=float(np.sqrt(best.reduction / factor)),
                step={k: float(change[columns.index(k)]) for k in best.unknowns},
                alternatives=tuple(as_good),
            )
        )
        free += best.unknowns
        del subjects[best.subject]
    return faults


def _dimensions_by_name(dimensions: Sequence[Dimension]) -> dict[str, list[int]]:
    """Numbers of the dimensions that the scene's file states, by name: of both coordinates."""
    numbers: dict[str, list[int]] = {}
    for k, dimension in enumerate(dimensions):
        if dimension.path:
            numbers.setdefault(dimension.name, []).append(k)
    return numbers


def _magnitude(equations: Equations, unknowns: Sequence[int]) -> float:
    """Magnitude of a point, length or angle as the scene has it."""
    stated = [k for k in unknowns if k < len(equations.dimensions)]
    return float(np.linalg.norm([equations.dimensions[k].value for k in stated]))


def _kind(equations: Equations, unknown: int) -> str:
    """Whether an unknown is a 'length' or an 'angle'."""
    count = len(equations.dimensions)
    if unknown < count:
        return equations.dimensions[unknown].kind
    return 'angle' if (unknown - count) % 3 == 2 else 'length'


def _eliminated(normal: Normal, base: list[int]) -> tuple[Real, Real]:
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


def _candidate(
    subject: str, unknowns: Sequence[int], square: Real, gradient: Real, diagonal: Real
) -> _Candidate:
    """
    Try a correction of the `unknowns` that are independent of each other and of those eliminated.

    `diagonal` (U,) is that of the normal matrix before the elimination.
    """
    used: list[int] = []
    for k in unknowns:
        remainder = square[k, k]
        if used:
            across = np.linalg.solve(square[np.ix_(used, used)], square[used, k])
            remainder -= square[k, used] @ across
        if remainder > DEPENDENT * diagonal[k]:
            used.append(k)
    if not used:
        return _Candidate(subject, [], 0.0)
    step = np.linalg.solve(square[np.ix_(used, used)], gradient[used])
    return _Candidate(subject, used, float(gradient[used] @ step))
