"""
Where a linkage stands before it is driven: a position near what is said, and its mobility there.

Slides, struts and guided angles follow from the angles of the bodies, so that a scene has to say
little.
"""

from collections.abc import Mapping

import numpy as np

from kinpole_ros.mechanism._assembly import GROUND, Assembly, Belt, Slot, Strut, strand
from kinpole_ros.mechanism._loops import Loops
from kinpole_ros.planar._plane import Complex, Real

# A singular value below this share of the largest counts as lost rank.
_LOST = 1e-9
# Positions from which it is tried to close loops that did not close from where they were said to.
_TRIALS = 24
# How much more ties and drivers weigh than loops, where slides meet all of them as well as can be.
_BINDING = 1e3


def start_near(assembly: Assembly, said: Mapping[str, float], drives: Real, inputs: Real) -> Real:
    """
    All variables (n,) near those `said` (by name; angles else zero) that meet ties and drivers.

    `drives` (d, n) are the drivers' rows, `inputs` (d,) their values. The loops need not close yet:
    `Mechanism` solves them from here on.
    """
    loops = assembly.loops
    names = loops.variables
    rows = np.concatenate((loops.ties, drives))
    right = np.concatenate((loops.tie0, inputs))
    given = np.array([name in said for name in names])
    values = np.array([said.get(name, 0.0) for name in names])
    for law in loops.laws:
        at = law.of @ _meet(rows, right, values, given)
        rows = np.concatenate((rows, law.row[None]))
        right = np.append(right, law.function(at)[0])
    values = _slide(assembly, rows, right, _meet(rows, right, values, given), given)
    place, turn = _poses(assembly, values)
    known = dict(zip(names, values, strict=True))
    for joint in assembly.joints:
        if not isinstance(joint, Strut | Belt):
            continue
        one, other = (
            place[body] + point * turn[body]
            for body, point in ((joint.one, joint.a), (joint.other, joint.b))
        )
        known[joint.name] = float(abs(other - one))
        known[f'{joint.name}.angle'] = float(np.angle(other - one))
        if isinstance(joint, Belt):
            length, along = strand(joint, other - one)
            near = joint.direction + known.get(joint.carrier or GROUND, 0.0)
            known[joint.name] = float(length)
            known[f'{joint.name}.angle'] = near + float(np.angle(along * np.exp(-1j * near)))
    known |= said
    return _meet(rows, right, np.array([known[name] for name in names]), given)


def close_near(loops: Loops, values: Real) -> tuple[Real, bool]:
    """
    The variables (n,) near `values` that close all loops and meet the ties, and whether found.

    Steps of least norm (Gauss-Newton), none of the variables driven.
    """
    values = values.copy()
    gap, matrix = _gaps(loops, values)
    size = _size(loops, values)
    for _ in range(100):
        if np.abs(gap).max(initial=0.0) <= 1e-12 * size:
            return values, True
        step = -np.linalg.pinv(matrix, rcond=_LOST) @ gap
        step *= min(1.0, 0.3 * size / max(float(np.abs(step).max()), 1e-300))
        if not np.isfinite(step).all():
            break
        values += step
        gap, matrix = _gaps(loops, values)
    return values, bool(np.abs(gap).max(initial=0.0) <= 1e-9 * size)


def closing_starts(loops: Loops, values: Real, most: int = 4) -> list[Real]:
    """
    Up to `most` different positions (n,) that close all loops, meet the ties and keep the drivers
    where they are at `values` (n,): found from angles all round, the same at each call.
    """
    angles = ~(loops.lengths != 0).any(axis=0)
    held = loops._replace(
        ties=np.concatenate((loops.ties, loops.drives)),
        tie0=np.concatenate((loops.tie0, loops.drives @ values)),
    )
    size, draw = _size(loops, values), np.random.default_rng(0)
    found: list[Real] = []
    for _ in range(_TRIALS):
        spread = np.where(angles, np.pi, size) * draw.uniform(-1.0, 1.0, len(values))
        near, closed = close_near(held, values + spread)
        turned = np.where(angles, (near + np.pi) % (2 * np.pi) - np.pi, near)
        gaps = [np.abs(np.exp(1j * turned) - np.exp(1j * other)) for other in found]
        if closed and all(gap.max() > 1e-6 for gap in gaps):
            found.append(turned)
            if len(found) == most:
                break
    return found


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
        for a pin, a prismatic or a rolling joint and 1 for a pin in a slot, a belt or a cam. It
        lies where lengths are special, as in a parallelogram with a third crank; the rank does not,
        but at a dead point it is lower.

    """
    loops = assembly.loops
    count = len(loops.variables)
    _, matrix = _gaps(loops, values)
    # Lengths as shares of the largest, so that the unit does not decide the rank.
    size = _size(loops, values)
    matrix = matrix * np.where((loops.lengths != 0).any(axis=0), size, 1.0)
    ties = len(loops.ties) + len(loops.laws)
    matrix[:ties] /= np.abs(matrix[:ties]).max(axis=1, keepdims=True, initial=1e-300)
    matrix[ties:] /= size
    singular = np.linalg.svd(matrix, compute_uv=False) if len(matrix) else np.zeros(0)
    rank = int((singular > _LOST * singular.max(initial=1.0)).sum())
    return count - ties - 2 * len(loops.loops), count - rank


def _gaps(loops: Loops, values: Real) -> tuple[Real, Real]:
    """What ties, laws and loops lack (k + 2m,), and its Jacobian (k + 2m, n)."""
    length = loops.lengths @ values + loops.length0
    turn = np.exp(1j * (loops.angles @ values + loops.angle0))
    gap = loops.loops @ (length * turn)
    by = turn[:, None] * (loops.lengths + 1j * length[:, None] * loops.angles)
    matrix = loops.loops @ by
    rows, lack = loops.ties, loops.ties @ values - loops.tie0
    for law in loops.laws:
        value, slope = law.function(law.of @ values)[:2]
        lack = np.append(lack, law.row @ values - value)
        rows = np.concatenate((rows, (law.row - slope * law.of)[None]))
    return (
        np.concatenate((lack, gap.real, gap.imag)),
        np.concatenate((rows, matrix.real, matrix.imag)),
    )


def _size(loops: Loops, values: Real) -> float:
    return float(np.abs(loops.lengths @ values + loops.length0).max(initial=0.0)) or 1.0


def _meet(rows: Real, right: Real, values: Real, given: np.ndarray) -> Real:
    """`values` moved to meet rows @ values = right, those `given` as little as can be."""
    if not len(rows):
        return values
    ease = np.where(given, 1e-6, 1.0)
    pull = (rows * ease) @ rows.T
    return np.asarray(values + ease * (rows.T @ np.linalg.pinv(pull) @ (right - rows @ values)))


def _slide(assembly: Assembly, rows: Real, right: Real, values: Real, given: np.ndarray) -> Real:
    """
    `values` with the slides that are not `given` as the angles have them.

    All others held, loops are linear in them, and closed as far as that can be. Loops that go
    through a strut tell nothing yet.
    """
    loops = assembly.loops._replace(ties=rows, tie0=right, laws=())
    names = loops.variables
    slots = {joint.name for joint in assembly.joints if isinstance(joint, Slot)}
    slides = np.array([name in slots for name in names]) & ~given
    struts = {f'{j.name}.angle' for j in assembly.joints if isinstance(j, Strut | Belt)}
    with_strut = loops.angles[:, [name in struts for name in names]].any(axis=1)
    open_ended = (loops.loops[:, with_strut] != 0).any(axis=1)
    gap, matrix = _gaps(loops, values)
    weight = np.concatenate((np.full(len(rows), _BINDING), np.tile(~open_ended, 2)))
    step = np.linalg.pinv(weight[:, None] * matrix[:, slides]) @ (weight * gap)
    found = values.copy()
    found[slides] -= step
    return found


def _poses(assembly: Assembly, values: Real) -> tuple[dict[str, complex], dict[str, complex]]:
    """Origins and directions e^{iθ} of all bodies, the ground too."""
    loops = assembly.loops
    terms: Complex = (loops.lengths @ values + loops.length0) * np.exp(
        1j * (loops.angles @ values + loops.angle0)
    )
    places = assembly.places @ terms
    turns = np.exp(1j * (assembly.turns @ values))
    place = {GROUND: 0j} | {
        body: complex(z) for body, z in zip(assembly.bodies, places, strict=True)
    }
    turn = {GROUND: 1 + 0j} | {
        body: complex(z) for body, z in zip(assembly.bodies, turns, strict=True)
    }
    return place, turn
