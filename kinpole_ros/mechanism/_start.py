"""
The position of a linkage before it is driven, and its mobility there.

Slides, struts and guided angles follow from the angles of the bodies, so that a scene has to state
little.
"""

from collections.abc import Mapping

import numpy as np

from kinpole_ros.mechanism._assembly import Assembly, poses_of
from kinpole_ros.mechanism._loops import Loops, loop_jacobian
from kinpole_ros.planar._plane import Real

# A singular value below this share of the largest counts as zero.
_RANK_TOLERANCE = 1e-9
# Positions from which loops that do not close from the stated start are tried again.
_TRIALS = 24
# Weight of ties and drivers relative to loops where slides cannot meet all of them.
_TIE_WEIGHT = 1e3


def start_near(assembly: Assembly, stated: Mapping[str, float], drives: Real, inputs: Real) -> Real:
    """
    All variables (n,) near those `stated` (by name; angles else zero) that meet ties and drivers.

    `drives` (d, n) are the drivers' rows, `inputs` (d,) their values. The loops need not close yet:
    `Mechanism` solves them from here on.
    """
    loops = assembly.loops
    names = loops.variables
    rows = np.concatenate((loops.ties, drives))
    right = np.concatenate((loops.tie0, inputs))
    given = np.array([name in stated for name in names])
    values = np.array([stated.get(name, 0.0) for name in names])
    for law in loops.laws:
        argument = law.of @ _meet(rows, right, values, given)
        rows = np.concatenate((rows, law.row[None]))
        right = np.append(right, law.function(argument)[0])
    values = _with_slides(assembly, rows, right, _meet(rows, right, values, given), given)
    poses = poses_of(assembly, values[:, None])
    start = dict(zip(names, values.tolist(), strict=True))
    for joint in assembly.joints:
        between = poses[joint.other].point(joint.b)[0] - poses[joint.one].point(joint.a)[0]
        start |= joint.own_values(between, start)
    start |= stated
    return _meet(rows, right, np.array([start[name] for name in names]), given)


def close_near(loops: Loops, values: Real) -> tuple[Real, bool]:
    """
    The variables (n,) near `values` that close all loops and meet the ties, and whether they do.

    Steps of least norm (Gauss-Newton), none of the variables driven.
    """
    values = values.copy()
    gap, matrix = _gaps(loops, values)
    size = _size(loops, values)
    for _ in range(100):
        if np.abs(gap).max(initial=0.0) <= 1e-12 * size:
            return values, True
        step = -np.linalg.pinv(matrix, rcond=_RANK_TOLERANCE) @ gap
        step *= min(1.0, 0.3 * size / max(float(np.abs(step).max()), 1e-300))
        if not np.isfinite(step).all():
            break
        values += step
        gap, matrix = _gaps(loops, values)
    return values, bool(np.abs(gap).max(initial=0.0) <= 1e-9 * size)


def closing_starts(loops: Loops, values: Real, most: int = 4) -> list[Real]:
    """
    Up to `most` different positions (n,) that close all loops and meet the ties.

    The drivers stay at their `values` (n,). Angles all around are tried, the same at each call.
    """
    angles, driven = loops.is_angle, _with_drivers(loops, values)
    size, draw = _size(loops, values), np.random.default_rng(0)
    starts: list[Real] = []
    for _ in range(_TRIALS):
        spread = np.where(angles, np.pi, size) * draw.uniform(-1.0, 1.0, len(values))
        near, closed = close_near(driven, values + spread)
        start = np.where(angles, (near + np.pi) % (2 * np.pi) - np.pi, near)
        gaps = [np.abs(np.exp(1j * start) - np.exp(1j * earlier)) for earlier in starts]
        if closed and all(gap.max() > 1e-6 for gap in gaps):
            starts.append(start)
            if len(starts) == most:
                break
    return starts


def open_gaps(loops: Loops, values: Real) -> Real:
    """
    How far each loop (m,) stays open, m, where they close as well as they can.

    The drivers stay at their `values` (n,). Angles all around are tried, the same at each call.
    """
    driven, ends = _with_drivers(loops, values), 2 * len(loops.loops)
    spread = np.where(loops.is_angle, np.pi, 0.1 * _size(loops, values))
    draw = np.random.default_rng(0)
    found = []
    for _ in range(_TRIALS // 3):
        gap = _least_gap(driven, ends, values + spread * draw.uniform(-1.0, 1.0, len(values)))
        found.append(np.abs(gap[: ends // 2] + 1j * gap[ends // 2 :]))
    return min(found, key=lambda gaps: float(gaps.max()))


def _least_gap(loops: Loops, ends: int, values: Real) -> Real:
    """The last `ends` residuals where all are least, by Levenberg's steps; ties all but hold."""

    def gaps(values: Real) -> tuple[Real, Real]:
        gap, matrix = _gaps(loops, values)
        weight = np.where(np.arange(len(gap)) < len(gap) - ends, _TIE_WEIGHT, 1.0)
        return weight * gap, weight[:, None] * matrix

    gap, matrix = gaps(values)
    ease = 1.0
    for _ in range(100):
        least = ease * np.eye(len(values))
        step = np.linalg.solve(matrix.T @ matrix + least, matrix.T @ gap)
        new_gap, new_matrix = gaps(values - step)
        is_better = new_gap @ new_gap < gap @ gap
        if is_better:
            values, gap, matrix = values - step, new_gap, new_matrix
        ease = max(ease * (0.3 if is_better else 4.0), 1e-12)
    return gap[-ends:]


def mobility(assembly: Assembly, values: Real) -> tuple[int, int]:
    """
    Degrees of freedom: by Gruebler's count, and by the rank of the loops' Jacobian.

    Parameters
    ----------
    assembly
        Bodies and joints.
    values
        The variables (n,), m and rad.

    Returns
    -------
    count, rank : int
        The count, variables less ties and laws less two for each loop, is 3 for each body, less 2
        for a pin, a prismatic or a rolling joint and 1 for a pin in a slot, a belt or a cam. It is
        wrong where lengths are special, as in a parallelogram with a third crank; the rank is not,
        but it is lower at a dead point.

    """
    loops = assembly.loops
    count = len(loops.variables)
    _, matrix = _gaps(loops, values)
    # Lengths as shares of the largest, so that the unit does not decide the rank.
    size = _size(loops, values)
    matrix = matrix * np.where(loops.is_angle, 1.0, size)
    ties = len(loops.ties) + len(loops.laws)
    matrix[:ties] /= np.abs(matrix[:ties]).max(axis=1, keepdims=True, initial=1e-300)
    matrix[ties:] /= size
    singular = np.linalg.svd(matrix, compute_uv=False) if len(matrix) else np.zeros(0)
    rank = int((singular > _RANK_TOLERANCE * singular.max(initial=1.0)).sum())
    return count - ties - 2 * len(loops.loops), count - rank


def _with_drivers(loops: Loops, values: Real) -> Loops:
    """The loops with ties that keep the drivers at their `values` (n,)."""
    return loops._replace(
        ties=np.concatenate((loops.ties, loops.drives)),
        tie0=np.concatenate((loops.tie0, loops.drives @ values)),
    )


def _gaps(loops: Loops, values: Real) -> tuple[Real, Real]:
    """Residuals of ties, laws and loops (k + 2m,), and their Jacobian (k + 2m, n)."""
    gap, slope = (part[..., 0] for part in loop_jacobian(loops, values[:, None]))
    rows, residual = loops.ties, loops.ties @ values - loops.tie0
    for law in loops.laws:
        value, rate = law.function(law.of @ values)[:2]
        residual = np.append(residual, law.row @ values - value)
        rows = np.concatenate((rows, (law.row - rate * law.of)[None]))
    return (
        np.concatenate((residual, gap.real, gap.imag)),
        np.concatenate((rows, slope.real, slope.imag)),
    )


def _size(loops: Loops, values: Real) -> float:
    return float(np.abs(loops.lengths @ values + loops.length0).max(initial=0.0)) or 1.0


def _meet(rows: Real, right: Real, values: Real, given: np.ndarray) -> Real:
    """`values` moved to meet rows @ values = right, the `given` ones as little as possible."""
    if not len(rows):
        return values
    ease = np.where(given, 1e-6, 1.0)
    pull = (rows * ease) @ rows.T
    return np.asarray(values + ease * (rows.T @ np.linalg.pinv(pull) @ (right - rows @ values)))


def _with_slides(
    assembly: Assembly, rows: Real, right: Real, values: Real, given: np.ndarray
) -> Real:
    """
    `values` with slides, unless `given`, that close the loops as well as possible.

    Loops are linear in the slides. Loops through a strut or belt do not count yet.
    """
    loops = assembly.loops._replace(ties=rows, tie0=right, laws=())
    names = loops.variables
    free = {name for j in assembly.joints if not j.is_span for name in j.loop_form().free_slides}
    slides = np.array([name in free for name in names]) & ~given
    struts = {f'{joint.name}.angle' for joint in assembly.joints if joint.is_span}
    with_strut = loops.angles[:, [name in struts for name in names]].any(axis=1)
    is_open = (loops.loops[:, with_strut] != 0).any(axis=1)
    gap, matrix = _gaps(loops, values)
    weight = np.concatenate((np.full(len(rows), _TIE_WEIGHT), np.tile(~is_open, 2)))
    step = np.linalg.pinv(weight[:, None] * matrix[:, slides]) @ (weight * gap)
    moved = values.copy()
    moved[slides] -= step
    return moved
