"""
The dimensions of a scene from measured markers: least squares over the poses of all frames.

Dimensions that the data do not determine keep the scene's values.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._least_squares import Adjustment
from kinpole_ros.linkage.positions import Positions
from kinpole_ros.linkage.theory import Theory
from kinpole_ros.mechanism import Dimension, Equations, Part, Scene, SceneError
from kinpole_ros.mechanism._equations import part_sum
from kinpole_ros.planar._plane import Real
from kinpole_ros.tracking.estimate import Estimate

# Instants, evenly over the recording; more take time and change little.
_MAX_INSTANTS = 6000
# Newton steps. A radius is off by a share of 1e-4, which squared twice is below rounding.
_MESH_STEPS = 3
# Factor of the variances from which the lines mention it.
_NOTED_EXCESS = 1.5


class Fitted(NamedTuple):
    """
    A fitted dimension of a scene: its `value` and standard `deviation`, m or rad.

    `undetermined` says that the data do not determine it; then the value is the scene's.
    """

    dimension: Dimension
    value: float
    deviation: float
    undetermined: bool


class SceneFit(NamedTuple):
    """
    Fitted dimensions, and chi^2 over its degrees of freedom, before and after.

    Variances were scaled by `excess`, since residuals are correlated over time.
    """

    dimensions: list[Fitted]
    ratio_before: float
    ratio: float
    freedom: int
    excess: float
    instants: int


def free_dimensions(scene: Scene, names: Sequence[str]) -> list[int]:
    """
    Numbers of the dimensions of these names, of all for none.

    A name is that of a point (rocker.B), of a vector's length or angle (r2.length), or of a vector
    (r2), joint (piston) or body (rocker) with all of its dimensions. Raises SceneError for others.
    """
    dimensions = scene.equations.dimensions
    used = [k for k in _used_dimensions(scene.equations) if dimensions[k].path]
    # Zeros come last: of dimensions that only place a frame, they are the ones that stay.
    used.sort(key=lambda k: not dimensions[k].value)
    if not names:
        return used
    numbers: list[int] = []
    for name in names:
        own = [k for k in used if f'{dimensions[k].name}.'.startswith(f'{name}.')]
        if not own:
            valid = ', '.join(dict.fromkeys(dimensions[k].name for k in used))
            raise SceneError(f'--free {name} is no dimension that joints use: give some of {valid}')
        numbers += [k for k in own if k not in numbers]
    return numbers


def _used_dimensions(equations: Equations) -> list[int]:
    """Numbers of the dimensions on which joints depend."""
    used: set[int] = set()
    for joint in equations.joints:
        used |= {k for part in (*joint.a, *joint.b) for k in (part.first, part.second)}
        used |= {number for name, number in joint.sizes.items() if name != 'start'}
    return sorted(used)


def fit_scene(theory: Theory, estimates: Iterable[Estimate], free: Sequence[int]) -> SceneFit:
    """
    Fit the dimensions `free` of the scene to estimates (T, B).

    Raises SceneError where no joint connects bodies that are seen.
    """
    positions = Positions(theory.scene, theory.matches, _MAX_INSTANTS)
    for estimate in estimates:
        positions.append(estimate)
    before, after = positions.solve(), positions.solve(tuple(free))
    if before is None or after is None:
        raise SceneError(
            f'{theory.scene.name}: no joint of the scene is between bodies that are seen at the '
            'same time: see that parameters and scene have the same names, and the view of markers'
        )
    equations = theory.scene.equations
    solution, first = meshed(equations, after[0]), before[0]
    deviations = np.sqrt(np.diag(solution.covariance)).tolist()
    deviation = dict(zip(solution.free, deviations, strict=True))
    rows = [
        Fitted(
            equations.dimensions[k],
            float(solution.values[k]),
            deviation.get(k, 0.0),
            k not in deviation,
        )
        for k in free
    ]
    return SceneFit(
        rows,
        ratio_before=first.normal.chi_square / first.freedom,
        ratio=solution.normal.chi_square / solution.freedom,
        freedom=round(solution.freedom),
        excess=solution.excess,
        instants=after[1].instants,
    )


def fitted_lines(fit: SceneFit) -> list[str]:
    """Describe a fit in lines for a terminal."""
    lines = []
    width = max(len(_label(row.dimension)) for row in fit.dimensions)
    for row in sorted(
        fit.dimensions, key=lambda row: (str(row.dimension.path), row.dimension.axis)
    ):
        factor, unit = (1.0, 'm') if row.dimension.kind == 'length' else (180 / np.pi, 'deg')
        line = f'{_label(row.dimension):{width}}  {row.value * factor:.9g} {unit}, '
        if row.undetermined:
            line += 'held: the data do not tell it from the others'
        else:
            stated = row.dimension.value
            line += (
                f'deviation {row.deviation * factor:.2g}; the scene has {stated * factor:.9g}, '
                f'{(row.value - stated) * factor:+.3g}'
            )
        lines.append(line)
    lines.append(
        f'chi^2/n {fit.ratio:.4g} (n = {fit.freedom}, {fit.instants} instants), with the scene as '
        f'it is {fit.ratio_before:.4g}'
    )
    if fit.excess > _NOTED_EXCESS:
        lines.append(
            'residuals last from instant to instant: deviations are '
            f'{fit.excess**0.5:.2g} times as large as by the noise of the markers alone'
        )
    return lines


def _label(dimension: Dimension) -> str:
    if dimension.path[0] != 'bodies':
        return dimension.name
    return f'{dimension.name} {"xy"[dimension.axis]}'


_Point = tuple[str, tuple[Part, ...]]  # of a body


class _Arm(NamedTuple):
    """A body between the hubs of two gears: its points there, and the numbers of the radii."""

    center: tuple[Part, ...]
    hub: tuple[Part, ...]
    circle: int
    radius: int


def meshed(equations: Equations, solution: Adjustment) -> Adjustment:
    """
    Correct the dimensions of a solution so that the radii of gears add up to their arms.

    The poses determine each of these lengths with its own noise, but gears whose radii do not add
    up never mesh. The corrections are as small as the covariance allows.
    """
    arms = list(_arms(equations))
    if not arms:
        return solution
    values, covariance = solution.values.copy(), solution.covariance
    own = [k for k, number in enumerate(solution.free) if number < len(values)]
    numbers = [solution.free[k] for k in own]
    for _ in range(_MESH_STEPS):
        misfit, by = _arm_misfits(arms, values)
        slopes = np.zeros((len(arms), len(covariance)))
        slopes[:, own] = by[:, numbers]
        gain = covariance @ slopes.T @ np.linalg.pinv(slopes @ covariance @ slopes.T)
        values[numbers] -= (gain @ misfit)[own]
    projection = np.eye(len(covariance)) - gain @ slopes
    return solution._replace(values=values, covariance=projection @ covariance @ projection.T)


def _arms(equations: Equations) -> Iterator[_Arm]:
    pins = _pinned_points(equations)
    for joint in equations.joints:
        if 'circle' not in joint.sizes:
            continue
        # Points by body, at the center of the circle and at the hub of the wheel.
        centers, hubs = (
            dict(next((points for points in pins if point in points), {point}))
            for point in ((joint.one, joint.a), (joint.other, joint.b))
        )
        if arms := sorted(centers.keys() & hubs.keys()):
            yield _Arm(
                centers[arms[0]], hubs[arms[0]], joint.sizes['circle'], joint.sizes['radius']
            )


def _pinned_points(equations: Equations) -> list[set[_Point]]:
    """The sets of points of bodies that pins hold at one place."""
    sets: list[set[_Point]] = []
    for joint in equations.joints:
        if not joint.sizes:
            points: set[_Point] = {(joint.one, joint.a), (joint.other, joint.b)}
            connected = [group for group in sets if group & points]
            sets = [group for group in sets if not group & points]
            sets.append(points.union(*connected))
    return sets


def _arm_misfits(arms: Sequence[_Arm], values: Real) -> tuple[Real, Real]:
    """Length of each arm (k,) less that of its radii, m, and its derivatives (k, dimensions)."""
    misfit, slopes = np.empty(len(arms)), np.empty((len(arms), len(values)))
    for row, arm in enumerate(arms):
        (a, by_a), (b, by_b) = part_sum(arm.center, values), part_sum(arm.hub, values)
        total = values[arm.circle] + values[arm.radius]
        misfit[row] = abs(b - a) - abs(total)
        slopes[row] = ((by_b - by_a) * np.conj(b - a)).real / abs(b - a)
        slopes[row, [arm.circle, arm.radius]] -= np.sign(total)
    return misfit, slopes
