"""
The unknowns that explain best what is left of measured poses: by least squares, with deviations.

Where the ground of the scene lies, and how its wheels stand, are always unknown.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._adjust import Left, left_over
from kinpole_ros.linkage._residuals import Anchors
from kinpole_ros.linkage._scene_poses import ScenePoses
from kinpole_ros.mechanism import Equations
from kinpole_ros.planar._plane import Complex, Real

# A column that the ones before leave so little of, squared, is told from them by nothing.
_DEPENDENT = 1e-8
# The ground is looked for from so many directions, on so many instants, in so many steps.
_DIRECTIONS, _FEW, _LOOKS = 8, 40, 8
# Mean square of residuals in deviations with which no other direction is tried.
_GOOD = 4.0
# Steps of least squares; they end where all are a small share of their deviations.
_MOST_STEPS, _SMALL = 20, 1e-3
# Blocks by whose means it is seen whether residuals go on from instant to instant.
_BLOCKS = 20


# Where the bodies may be that have no markers: of poses, and the ground's pose, (T, bodies) each.
Guess = Callable[[ScenePoses, Real], tuple[Complex, Real]]


class Normal(NamedTuple):
    """
    Normal equations of unknowns as `Left` numbers them: `square` (U, U), `gradient` (U,).

    `chi_square` is the sum of squares without corrections, over so many residuals `used`.
    """

    square: Real
    gradient: Real
    chi_square: float
    used: float

    def corrected(self, unknowns: Sequence[int], change: Real) -> float:
        """The sum of squares with the `unknowns` corrected by `change`."""
        some = list(unknowns)
        part = self.square[np.ix_(some, some)] @ change
        return self.chi_square + float(change @ (part + 2 * self.gradient[some]))


class Solved(NamedTuple):
    """
    Dimensions `values` and the `ground` (3,) as fitted, and what is `left`.

    `covariance` is that of the unknowns `free`, numbered as in `Left`; those that nothing tells
    are `held`. `excess` (1 or more) is by how much variances are to be larger, as residuals that go
    on from instant to instant tell.
    """

    values: Real
    ground: Real
    left: Left
    normal: Normal
    free: tuple[int, ...]
    held: tuple[int, ...]
    covariance: Real
    excess: float

    @property
    def freedom(self) -> float:
        """Residuals less unknowns."""
        return max(self.normal.used - len(self.free), 1.0)


def normal_of(left: Left) -> Normal:
    """The normal equations of all instants."""
    columns, value = left.by.reshape(-1, left.by.shape[-1]), left.value.ravel()
    return Normal(columns.T @ columns, columns.T @ value, float(value @ value), left.used)


def always_free(equations: Equations) -> list[int]:
    """The unknowns that no scene tells: the pose of the ground, and how wheels stand."""
    count = len(equations.dimensions)
    starts = [joint.start for joint in equations.joints if joint.start is not None]
    return [count, count + 1, count + 2, *starts]


def solve(
    equations: Equations,
    values: Real,
    ground: Real,
    poses: ScenePoses,
    free: Sequence[int],
    anchors: Anchors,
    guess: Guess | None = None,
    steps: int = _MOST_STEPS,
) -> Solved:
    """Least squares with the dimensions `free`, the ground and what no scene states unknown."""
    values, ground = values.copy(), ground.copy()
    count = len(values)
    asked = [*always_free(equations), *free]
    hidden = None if guess is None else guess(poses, ground)
    left = left_over(equations, values, ground, poses, anchors, hidden)
    for _ in range(max(steps, 1)):
        normal = normal_of(left)
        used, held, inverse = independent(normal.square, asked)
        step = -inverse @ normal.gradient[used]
        deviation = np.sqrt(np.diag(inverse))
        was = values, ground, left
        # A step too long to be linear, as along a direction that data hardly tell, is halved.
        for _ in range(max(steps, 1)):
            moved = np.concatenate((was[0], was[1]))
            moved[used] += step
            values, ground = moved[:count], moved[count:]
            left = left_over(equations, values, ground, poses, anchors, hidden)
            better = normal_of(left).chi_square <= normal.chi_square
            if not free or better or (np.abs(step) <= _SMALL * deviation).all():
                break
            step = step / 2
        else:
            values, ground, left = was
            break
        if (np.abs(step) <= _SMALL * deviation).all():
            break
    excess = excess_of(left.value)
    return Solved(
        values,
        ground,
        left,
        normal_of(left),
        tuple(used),
        tuple(held),
        inverse * excess,
        excess,
    )


def independent(every: Real, asked: Sequence[int]) -> tuple[list[int], list[int], Real]:
    """
    Which of the unknowns `asked`, in that order, are told from those before, which are not, and the
    covariance of the former, by the normal matrix of `every` unknown.
    """
    square = every[np.ix_(asked, asked)]
    size = np.sqrt(np.diag(square))
    kept: list[int] = []
    for k in range(len(asked)):
        if size[k] == 0:
            continue
        trial = [*kept, k]
        part = square[np.ix_(trial, trial)] / np.outer(size[trial], size[trial])
        rest = 1.0
        if kept:
            rest = 1.0 - float(part[-1, :-1] @ np.linalg.solve(part[:-1, :-1], part[:-1, -1]))
        if rest > _DEPENDENT:
            kept.append(k)
    inverse = np.linalg.inv(square[np.ix_(kept, kept)] / np.outer(size[kept], size[kept]))
    inverse /= np.outer(size[kept], size[kept])
    return [asked[k] for k in kept], [asked[k] for k in range(len(asked)) if k not in kept], inverse


def excess_of(value: Real) -> float:
    """
    How much more the means of residuals (T, m) over blocks vary than those of independent ones.

    1 at least. More is what lasts: markers that are not where they seem, joints with play.
    """
    used = value[:, (value != 0).any(axis=0)]
    length = len(used) // min(_BLOCKS, max(len(used) // 5, 1))
    if not used.size or not length:
        return 1.0
    blocks = used[: len(used) // length * length].reshape(-1, length, used.shape[1]).sum(axis=1)
    return max(1.0, float((blocks**2).mean() / length))


def find_ground(
    equations: Equations,
    values: Real,
    poses: ScenePoses,
    anchors: Anchors,
    guess: Guess | None = None,
) -> Real:
    """Where the ground of the scene lies (x, y, angle) so that joints fit best, from scratch."""
    some = np.unique(np.linspace(0, len(poses.stamp) - 1, _FEW).astype(int))
    few = poses.part(some)
    best, least = np.zeros(3), np.inf
    for direction in np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS:
        begin = np.array([0.0, 0.0, direction])
        try:
            found = solve(equations, values, begin, few, (), anchors, guess, _LOOKS)
        except np.linalg.LinAlgError:
            continue
        if found.normal.chi_square < 0.99 * least:
            best, least = found.ground, found.normal.chi_square
        if least < _GOOD * found.freedom:
            break
    return best
