"""
Least squares of the dimensions of a scene from measured poses of its bodies.

The poses are moved as little as possible to where the joints hold: conditions g(y, x) = 0 between
measured y, whose covariance is known, and unknown x (Gauss-Helmert; Mikhail and Ackermann,
Observations and Least Squares, 1976). Each instant has conditions of its own; all instants share
the dimensions. The pose of the scene's ground and the phases of its wheels are always unknown.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._scene_poses import Anchors, Residuals, ScenePoses, residuals
from kinpole_ros.linkage.limits import DEPENDENT
from kinpole_ros.mechanism import Equations
from kinpole_ros.planar._plane import Complex, Real

# A condition whose variance is below this share of the largest follows from the others.
_REDUNDANT = 1e-5
# Rounds of moving the poses, each with the conditions linearized anew.
_ROUNDS = 2
# Newton steps that place a body without markers, until they are below this, m and rad.
_HIDDEN_STEPS, _HIDDEN_ACCURACY = 8, 1e-9
# Directions from which the pose of the ground is sought, and instants and steps of each search.
_DIRECTIONS, _GROUND_INSTANTS, _GROUND_STEPS = 8, 40, 8
# No other direction is tried if the mean square residual is below this.
_GOOD_SQUARE = 4.0
# A direction is better than another one if its sum of squares is below this share.
_BETTER = 0.99
# Steps of least squares, and the share of the deviations below which a step is the last.
_MAX_STEPS, _SMALL_STEP = 20, 1e-3
# Blocks whose means show whether residuals are correlated over time, and their least length.
_BLOCKS, _MIN_BLOCK = 20, 5

# Positions and angles (T, bodies) where bodies without markers may be, from poses and the ground.
Guess = Callable[[ScenePoses, Real], tuple[Complex, Real]]


class Problem(NamedTuple):
    """
    A scene to be compared with measured poses (T, B), all of them seen.

    `values` are its dimensions, `anchors` the first poses of its wheels. `guess` places the bodies
    without markers, None where there are none.
    """

    equations: Equations
    values: Real
    poses: ScenePoses
    anchors: Anchors
    guess: Guess | None

    def hidden(self, ground: Real) -> tuple[Complex, Real] | None:
        """Approximate positions and angles (T, bodies), for a ground (3,)."""
        return None if self.guess is None else self.guess(self.poses, ground)


class Adjusted(NamedTuple):
    """
    Normalized residuals (T, m): independent, with variance 1 where the scene is right.

    Redundant ones are 0; `used` counts the others. `by` (T, m, unknowns) are their derivatives by
    the unknowns: dimensions, pose of the ground, and for each measured body the pose of its markers
    in it. `joint` (T, joints) is how far each joint between measured bodies is off, as measured,
    m, and `joint_deviations` the same in standard deviations; NaN for other joints.
    """

    value: Real
    by: Real
    used: int
    joint: Real
    joint_deviations: Real


class Normal(NamedTuple):
    """
    Normal equations of the unknowns of `Adjusted`: `square` (U, U) and `gradient` (U,).

    `chi_square` is the sum of squares without corrections, of `used` residuals.
    """

    square: Real
    gradient: Real
    chi_square: float
    used: float

    def corrected(self, unknowns: Sequence[int], change: Real) -> float:
        """The sum of squares with the `unknowns` corrected by `change`."""
        rows = list(unknowns)
        product = self.square[np.ix_(rows, rows)] @ change
        return self.chi_square + float(change @ (product + 2 * self.gradient[rows]))


class Adjustment(NamedTuple):
    """
    Fitted dimensions `values` and `ground` pose (3,), with their residuals.

    `covariance` is that of the unknowns `free` that the data determine, numbered as in `Adjusted`.
    Variances are scaled by `excess`, 1 or more, since residuals may be correlated over time.
    """

    values: Real
    ground: Real
    adjusted: Adjusted
    normal: Normal
    free: tuple[int, ...]
    covariance: Real
    excess: float

    @property
    def freedom(self) -> float:
        """Degrees of freedom: residuals less unknowns."""
        return max(self.normal.used - len(self.free), 1.0)


def adjust(
    problem: Problem, values: Real, ground: Real, hidden: tuple[Complex, Real] | None
) -> Adjusted:
    """
    Adjust the poses to a scene with dimensions of these `values`.

    `ground` (3,) is the pose of the scene's ground: x, y (m) and angle. `hidden` are approximate
    positions and angles (T, bodies), of which those of bodies without markers are used.
    """
    equations, poses = problem.equations, problem.poses
    count, bodies = poses.instants, len(equations.bodies)
    measured = list(poses.bodies)
    position, angle = np.zeros((count, bodies), complex), np.zeros((count, bodies))
    if hidden is not None:
        position[...], angle[...] = hidden
    position[:, -1], angle[:, -1] = complex(*ground[:2]), ground[2]
    position[:, measured], angle[:, measured] = poses.position, poses.angle
    unseen = [b for b in range(bodies - 1) if b not in measured]
    unseen_names = {equations.bodies[b] for b in unseen}
    # A wheel without markers may have turned by any number of turns, and shows nothing.
    ignored = [
        k
        for k, joint in enumerate(equations.joints)
        if 'radius' in joint.sizes and {joint.one, joint.other} & unseen_names
    ]

    def current() -> Residuals:
        now = residuals(equations, values, position, angle, problem.anchors)
        return now.without(np.isin(now.joint, ignored)) if ignored else now

    joint_residuals = _joint_residuals(equations, current(), poses)
    for _ in range(_ROUNDS):
        for _ in range(_HIDDEN_STEPS if unseen else 0):
            now = current()
            inverse = np.linalg.pinv(_flat(now.by_pose[:, :, unseen]), rcond=1e-9)
            step = -np.einsum('tkm,tm->tk', inverse, now.value).reshape(count, -1, 3)
            position[:, unseen] += step[..., 0] + 1j * step[..., 1]
            angle[:, unseen] += step[..., 2]
            if np.abs(step).max() < _HIDDEN_ACCURACY:
                break
        now = current()
        by = now.by_pose[:, :, measured]
        off = poses.position - position[:, measured]
        moved = np.stack((off.real, off.imag, poses.angle - angle[:, measured]), axis=-1)
        value = now.value + np.einsum('tmbk,tbk->tm', by, moved)
        by_noise = np.einsum('tmbk,tbkl->tmbl', by, poses.covariance)
        variance = np.einsum('tmbl,tnbl->tmn', by_noise, by)
        whiten = _whitening(variance, _flat(now.by_pose[:, :, unseen]))
        normalized = np.einsum('tkm,tm->tk', whiten, value)
        moved = moved - np.einsum('tkm,tmbl,tk->tbl', whiten, by_noise, normalized)
        position[:, measured] += moved[..., 0] + 1j * moved[..., 1]
        angle[:, measured] += moved[..., 2]
    by_markers = _by_markers(now.by_pose[:, :, measured], angle[:, measured])
    columns = now.by_dimension, now.by_pose[:, :, -1], _flat(by_markers)
    by_unknown = np.einsum('tkm,tmu->tku', whiten, np.concatenate(columns, axis=-1))
    return Adjusted(normalized, by_unknown, int(whiten.any(axis=-1).sum()), *joint_residuals)


def _by_markers(by_pose: Real, angle: Real) -> Real:
    """
    Derivatives (T, m, B, 3) by the poses of the markers in their bodies, at angles (T, B).

    The frame of a body moves in its own axes.
    """
    turn, (x, y, about) = np.exp(1j * angle)[:, None], np.moveaxis(by_pose, -1, 0)
    return np.stack((x * turn.real + y * turn.imag, y * turn.real - x * turn.imag, about), axis=-1)


def _flat(by_pose: Real) -> Real:
    return by_pose.reshape(*by_pose.shape[:2], -1)


def _whitening(variance: Real, unseen: Real) -> Real:
    """
    Matrices (T, m, m) that normalize residuals of covariance `variance` (T, m, m).

    The results are independent with variance 1, and do not depend on what moves with the
    derivatives `unseen` (T, m, k); redundant rows are zero.
    """
    size = np.sqrt(np.einsum('tmm->tm', variance))
    scale = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 0.0)
    if unseen.shape[-1]:
        # A row between bodies that are not measured is of use only together with others.
        scale = np.where(size > 0, scale, np.median(scale[scale > 0]) if scale.any() else 1.0)
        u, singular, _ = np.linalg.svd(scale[..., None] * unseen, full_matrices=True)
        is_used = np.zeros(u.shape[:2], bool)
        is_used[:, : singular.shape[1]] = singular > 1e-9 * singular.max(
            axis=-1, keepdims=True, initial=0.0
        )
        free = np.where(is_used[:, None], 0.0, u).swapaxes(1, 2) * scale[:, None]
    else:
        free = scale[..., None] * np.eye(variance.shape[-1])
    values, vectors = np.linalg.eigh(free @ variance @ free.swapaxes(1, 2))
    is_new = values > _REDUNDANT * np.maximum(values[:, -1:], 1e-300)
    root = np.where(is_new, 1 / np.sqrt(np.where(is_new, values, 1.0)), 0.0)
    return root[..., None] * (vectors.swapaxes(1, 2) @ free)


def _joint_residuals(equations: Equations, now: Residuals, poses: ScenePoses) -> tuple[Real, Real]:
    """How far (T, joints) each joint is off, m, and in standard deviations; NaN if not measured."""
    off = np.full((len(now.value), len(equations.joints)), np.nan)
    deviations = off.copy()
    measured = {equations.bodies[b] for b in (*poses.bodies, -1)}
    for k, joint in enumerate(equations.joints):
        if not {joint.one, joint.other} <= measured:
            continue
        rows = np.flatnonzero(now.joint == k)
        value, by = now.value[:, rows], now.by_pose[:, rows][:, :, list(poses.bodies)]
        variance = np.einsum('tmbk,tbkl,tnbl->tmn', by, poses.covariance, by)
        weight = np.linalg.pinv(variance, hermitian=True)
        square = np.einsum('tm,tmn,tn->t', value, weight, value)
        # Both rows of a pin are lengths; of a wheel or a guide only the first is a distance.
        lengths = value[:, :1] if joint.sizes else value
        off[:, k] = np.linalg.norm(lengths, axis=1)
        deviations[:, k] = np.sqrt(np.maximum(square, 0.0))
    return off, deviations


def normal_of(adjusted: Adjusted) -> Normal:
    """The normal equations of all instants."""
    columns = adjusted.by.reshape(-1, adjusted.by.shape[-1])
    value = adjusted.value.ravel()
    return Normal(columns.T @ columns, columns.T @ value, float(value @ value), adjusted.used)


def always_free(equations: Equations) -> list[int]:
    """The unknowns that no scene states: the pose of the ground, and the phases of wheels."""
    count = len(equations.dimensions)
    starts = [joint.sizes['start'] for joint in equations.joints if 'start' in joint.sizes]
    return [count, count + 1, count + 2, *starts]


def solve(
    problem: Problem, ground: Real, free: Sequence[int], steps: int = _MAX_STEPS
) -> Adjustment:
    """Fit the dimensions `free`, the ground and what no scene states, by least squares."""
    unknowns = np.concatenate((problem.values, ground))
    requested = [*always_free(problem.equations), *free]
    hidden = problem.hidden(ground)

    def adjusted_at(unknowns: Real) -> Adjusted:
        values, ground = np.split(unknowns, [-3])
        return adjust(problem, values, ground, hidden)

    adjusted = adjusted_at(unknowns)
    for _ in range(max(steps, 1)):
        normal = normal_of(adjusted)
        used, inverse = independent(normal.square, requested)
        step = -inverse @ normal.gradient[used]
        deviation = np.sqrt(np.diag(inverse))
        # A step too long to be linear, in a direction that is hardly determined, is halved.
        for _ in range(max(steps, 1)):
            moved = unknowns.copy()
            moved[used] += step
            trial = adjusted_at(moved)
            is_better = normal_of(trial).chi_square <= normal.chi_square
            is_small = bool((np.abs(step) <= _SMALL_STEP * deviation).all())
            if not free or is_better or is_small:
                unknowns, adjusted = moved, trial
                break
            step = step / 2
        else:
            break
        if is_small:
            break
    values, ground = np.split(unknowns, [-3])
    excess = variance_excess(adjusted.value)
    return Adjustment(
        values, ground, adjusted, normal_of(adjusted), tuple(used), inverse * excess, excess
    )


def independent(square: Real, unknowns: Sequence[int]) -> tuple[list[int], Real]:
    """
    Those of the `unknowns` that are independent of the ones before, and their covariance.

    `square` is the normal matrix of all unknowns.
    """
    part = square[np.ix_(unknowns, unknowns)]
    size = np.sqrt(np.diag(part))
    used: list[int] = []
    for k in range(len(unknowns)):
        if size[k] == 0:
            continue
        trial = [*used, k]
        scaled = part[np.ix_(trial, trial)] / np.outer(size[trial], size[trial])
        remainder = 1.0
        if used:
            remainder -= float(scaled[-1, :-1] @ np.linalg.solve(scaled[:-1, :-1], scaled[:-1, -1]))
        if remainder > DEPENDENT:
            used.append(k)
    scale = np.outer(size[used], size[used])
    inverse = np.linalg.inv(part[np.ix_(used, used)] / scale) / scale
    return [unknowns[k] for k in used], inverse


def variance_excess(value: Real) -> float:
    """
    Variance of the means of residuals (T, m) over blocks, over that of independent ones, >= 1.

    It is larger where residuals are correlated over time: markers that are not where the scene has
    them, joints with play.
    """
    used = value[:, (value != 0).any(axis=0)]
    length = len(used) // min(_BLOCKS, max(len(used) // _MIN_BLOCK, 1))
    if not used.size or not length:
        return 1.0
    blocks = used[: len(used) // length * length].reshape(-1, length, used.shape[1]).sum(axis=1)
    return max(1.0, float((blocks**2).mean() / length))


def find_ground(problem: Problem) -> Real:
    """The pose of the scene's ground (x, y, angle) with which the joints fit best."""
    poses = problem.poses
    rows = np.unique(np.linspace(0, poses.instants - 1, _GROUND_INSTANTS).astype(int))
    few = problem._replace(poses=poses.at_instants(rows))
    best, least = np.zeros(3), np.inf
    for direction in np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS:
        try:
            solution = solve(few, np.array([0.0, 0.0, direction]), (), _GROUND_STEPS)
        except np.linalg.LinAlgError:
            continue
        if solution.normal.chi_square < _BETTER * least:
            best, least = solution.ground, solution.normal.chi_square
        if least < _GOOD_SQUARE * solution.freedom:
            break
    return best
