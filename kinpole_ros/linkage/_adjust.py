"""
What is left of measured poses once they are moved, as little as can be, to where joints hold.

The general least squares of conditions with unknowns (Gauss-Helmert; Mikhail and Ackermann,
Observations and Least Squares, 1976): conditions g(y, x) = 0 between measured y, whose covariance
is known, and unknown x. Each instant has conditions of its own, and all share the dimensions.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._residuals import Anchors, Residuals, residuals
from kinpole_ros.linkage._scene_poses import ScenePoses
from kinpole_ros.mechanism import Equations
from kinpole_ros.planar._plane import Complex, Real

# A condition that follows from others, to this share of its variance, says nothing new.
_REDUNDANT = 1e-5
# Times that poses are moved and conditions taken anew there.
_ROUNDS = 2
# Steps to where a body without markers is.
_STEPS = 8
# m and rad: it is there.
_THERE = 1e-9


class Left(NamedTuple):
    """
    Residuals in deviations (T, m), each independent with variance 1 where the scene is right.

    Those that say nothing are 0; `used` is how many say something. `by` (T, m, unknowns) are
    their derivatives by the unknowns: dimensions, then the pose of the ground, and then, for each
    measured body, the pose of its markers in it. `joint` (T, joints) is how far each joint between
    measured bodies is off, as measured, and `joint_deviations` the same in deviations, NaN for
    others.
    """

    value: Real
    by: Real
    used: int
    joint: Real
    joint_deviations: Real


def left_over(
    equations: Equations,
    values: Real,
    ground: Real,
    poses: ScenePoses,
    anchors: Anchors,
    hidden: tuple[Complex, Real] | None = None,
) -> Left:
    """
    Of poses (T, B), all of them seen, with the dimensions at `values`.

    `ground` (3,) is where the scene's ground lies: x, y (m) and angle. `hidden` are about where the
    bodies of the equations are that are not measured, positions and angles (T, bodies).
    """
    count, bodies = len(poses.stamp), len(equations.bodies)
    measured = list(poses.bodies)
    position, angle = np.zeros((count, bodies), complex), np.zeros((count, bodies))
    if hidden is not None:
        position[...], angle[...] = hidden
    position[:, -1], angle[:, -1] = complex(*ground[:2]), ground[2]
    position[:, measured], angle[:, measured] = poses.position, poses.angle
    unseen = [b for b in range(bodies - 1) if b not in measured]

    def lacks() -> Residuals:
        now = residuals(equations, values, position, angle, anchors)
        return now.without(np.isin(now.joint, unturned)) if unturned else now

    # A wheel that nobody sees may have turned by any number of turns, and tells nothing.
    unturned = [
        k
        for k, joint in enumerate(equations.joints)
        if joint.radius is not None
        and {equations.bodies.index(joint.one), equations.bodies.index(joint.other)} & {*unseen}
    ]
    start = lacks()
    joint = _joints(equations, start.value, start.by_pose, start.joint, poses)
    for _ in range(_ROUNDS):
        for _ in range(_STEPS if unseen else 0):
            now = lacks()
            by = _flat(now.by_pose[:, :, unseen])
            step = -np.einsum('tkm,tm->tk', np.linalg.pinv(by, rcond=1e-9), now.value)
            step = step.reshape(count, -1, 3)
            position[:, unseen] += step[..., 0] + 1j * step[..., 1]
            angle[:, unseen] += step[..., 2]
            if np.abs(step).max() < _THERE:
                break
        now = lacks()
        between = poses.position - position[:, measured]
        moved = np.stack((between.real, between.imag, poses.angle - angle[:, measured]), axis=-1)
        by = now.by_pose[:, :, measured]
        lacking = now.value + np.einsum('tmbk,tbk->tm', by, moved)
        spread = np.einsum('tmbk,tbkl->tmbl', by, poses.covariance)
        variance = np.einsum('tmbl,tnbl->tmn', spread, by)
        whiten = _whitening(variance, _flat(now.by_pose[:, :, unseen]))
        value = np.einsum('tkm,tm->tk', whiten, lacking)
        back = np.einsum('tkm,tmbl,tk->tbl', whiten, spread, value)
        moved = moved - back
        position[:, measured] += moved[..., 0] + 1j * moved[..., 1]
        angle[:, measured] += moved[..., 2]
    turn = np.exp(1j * angle[:, measured])
    # The pose of the markers in a body: its frame moves in its own axes.
    shift = now.by_pose[:, :, measured].copy()
    across, along = shift[..., 0].copy(), shift[..., 1].copy()
    shift[..., 0] = across * turn.real[:, None] + along * turn.imag[:, None]
    shift[..., 1] = along * turn.real[:, None] - across * turn.imag[:, None]
    columns = (now.by_dimension, now.by_pose[:, :, -1], _flat(shift))
    by_unknown = np.einsum('tkm,tmu->tku', whiten, np.concatenate(columns, axis=-1))
    return Left(value, by_unknown, int(whiten.any(axis=-1).sum()), *joint)


def _flat(by_pose: Real) -> Real:
    return by_pose.reshape(*by_pose.shape[:2], -1)


def _whitening(variance: Real, unseen: Real) -> Real:
    """
    Matrices (T, m, m) that make residuals of covariance `variance` (T, m, m) independent, of
    variance 1, and free of what moves with the `unseen` (T, m, k); rows of zeros for the rest.
    """
    size = np.sqrt(np.einsum('tmm->tm', variance))
    scale = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 0.0)
    if unseen.shape[-1]:
        # Where nothing is measured a row is of use only together with others.
        scale = np.where(size > 0, scale, np.median(scale[scale > 0]) if scale.any() else 1.0)
        left, singular, _ = np.linalg.svd(scale[..., None] * unseen, full_matrices=True)
        rank = singular > 1e-9 * singular.max(axis=-1, keepdims=True, initial=0.0)
        used = np.zeros(left.shape[:2], bool)
        used[:, : rank.shape[1]] = rank
        free = np.where(used[:, None], 0.0, left).swapaxes(1, 2) * scale[:, None]
    else:
        free = scale[..., None] * np.eye(variance.shape[-1])
    inner = free @ variance @ free.swapaxes(1, 2)
    values, vectors = np.linalg.eigh(inner)
    good = values > _REDUNDANT * np.maximum(values[:, -1:], 1e-300)
    root = np.where(good, 1 / np.sqrt(np.where(good, values, 1.0)), 0.0)
    return root[..., None] * (vectors.swapaxes(1, 2) @ free)


def _joints(
    equations: Equations, value: Real, by_pose: Real, joint: np.ndarray, poses: ScenePoses
) -> tuple[Real, Real]:
    """How far (T, joints) each joint is off, and that in deviations; NaN for what is not seen."""
    off = np.full((len(value), len(equations.joints)), np.nan)
    deviations = off.copy()
    measured = {*poses.bodies, len(equations.bodies) - 1}
    for k, one in enumerate(equations.joints):
        if not {equations.bodies.index(body) for body in (one.one, one.other)} <= measured:
            continue
        rows = np.flatnonzero(joint == k)
        by = by_pose[:, rows][:, :, list(poses.bodies)]
        variance = np.einsum('tmbk,tbkl,tnbl->tmn', by, poses.covariance, by)
        part = value[:, rows]
        weighed = np.einsum('tm,tmn,tn->t', part, np.linalg.pinv(variance, hermitian=True), part)
        # All rows of a pin are lengths; of a wheel or a guide the first says how far it is off.
        lengths = part if one.along is None and one.radius is None else part[:, :1]
        off[:, k] = np.linalg.norm(lengths, axis=1)
        deviations[:, k] = np.sqrt(np.maximum(weighed, 0.0))
    return off, deviations
