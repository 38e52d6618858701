"""
The dimensions of a scene from measured markers: least squares over the poses of all frames.

What the data do not tell is left as the scene has it, and said; what they tell has its deviation.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._gears import meshed
from kinpole_ros.linkage.positions import Positions
from kinpole_ros.linkage.theory import Theory
from kinpole_ros.mechanism import Dimension, Scene, SceneError
from kinpole_ros.tracking.estimate import Estimate

_MOST = 6000  # instants, evenly over the recording: more take time and tell little


class Fitted(NamedTuple):
    """
    A dimension of a scene as fitted: its `value` (m or rad) and the `deviation` of that.

    `held` where the data tell it from none of the others; then the value is the scene's.
    """

    dimension: Dimension
    value: float
    deviation: float
    held: bool


class Fit(NamedTuple):
    """
    What a fit came to: the dimensions, and chi^2 over its degrees of freedom, before and after.

    `excess` is what deviations were enlarged by, squared, since residuals last from instant to
    instant.
    """

    dimensions: list[Fitted]
    ratio_before: float
    ratio: float
    freedom: int
    excess: float
    instants: int


def free_dimensions(scene: Scene, names: Sequence[str]) -> list[int]:
    """
    The numbers of the dimensions of these names, of all for none.

    A name is that of a point (rocker.B), of a vector's length or angle (r2.length), of a vector
    (r2), a joint (piston) or a body (rocker): all of theirs. Raises SceneError for others.
    """
    dimensions = scene.equations.dimensions
    used = _used(scene)
    # Of those that only tell where a frame lies the ones at zero stay.
    free = sorted((k for k in used if dimensions[k].path), key=lambda k: not dimensions[k].value)
    if not names:
        return free
    found: list[int] = []
    for name in names:
        own = [
            k
            for k in free
            if dimensions[k].name == name or dimensions[k].name.startswith(f'{name}.')
        ]
        if not own:
            known = ', '.join(dict.fromkeys(dimensions[k].name for k in free))
            raise SceneError(f'--free {name} is no dimension that joints use: give some of {known}')
        found += [k for k in own if k not in found]
    return found


def _used(scene: Scene) -> list[int]:
    """The dimensions on which joints depend."""
    used: set[int] = set()
    for joint in scene.equations.joints:
        for part in (*joint.a, *joint.b):
            used |= {part.first, part.second}
        numbers = joint.along, joint.turned, joint.radius, joint.circle
        used |= {number for number in numbers if number is not None}
    return sorted(used)


def fit_scene(theory: Theory, estimates: Iterable[Estimate], free: Sequence[int]) -> Fit:
    """
    Fit the dimensions `free` of the scene to estimates (T, B).

    Raises SceneError where no joint connects bodies that are seen.
    """
    positions = Positions(theory.scene, theory.lies, _MOST)
    for estimate in estimates:
        positions.add(estimate)
    before = positions.solved()
    after = positions.solved(tuple(free))
    if before is None or after is None:
        raise SceneError(
            f'{theory.scene.name}: no joint of the scene is between bodies that are seen at the '
            'same time: see that parameters and scene have the same names, and the view of markers'
        )
    solved = meshed(theory.scene.equations, after[0])
    deviation = dict(zip(solved.free, np.sqrt(np.diag(solved.covariance)).tolist(), strict=True))
    dimensions = theory.scene.equations.dimensions
    rows = [
        Fitted(dimensions[k], float(solved.values[k]), deviation.get(k, 0.0), k not in deviation)
        for k in free
    ]
    first = before[0]
    return Fit(
        rows,
        first.normal.chi_square / first.freedom,
        solved.normal.chi_square / solved.freedom,
        round(solved.freedom),
        solved.excess,
        len(after[1].stamp),
    )


def fitted_lines(fit: Fit) -> list[str]:
    """What a fit came to, for people."""
    lines = []
    width = max(len(_label(row.dimension)) for row in fit.dimensions)
    for row in sorted(
        fit.dimensions, key=lambda row: (str(row.dimension.path), row.dimension.axis)
    ):
        size, unit = (1.0, 'm') if row.dimension.kind == 'length' else (180 / np.pi, 'deg')
        label = f'{_label(row.dimension):{width}}'
        if row.held:
            lines.append(
                f'{label}  {row.value * size:.9g} {unit}, held: the data do not tell it from the '
                'others'
            )
            continue
        change = (row.value - row.dimension.value) * size
        lines.append(
            f'{label}  {row.value * size:.9g} {unit}, deviation {row.deviation * size:.2g}; the '
            f'scene has {row.dimension.value * size:.9g}, {change:+.3g}'
        )
    lines.append(
        f'chi^2/n {fit.ratio:.4g} (n = {fit.freedom}, {fit.instants} instants), with the scene as '
        f'it is {fit.ratio_before:.4g}'
    )
    if fit.excess > 1.5:
        lines.append(
            'residuals last from instant to instant: deviations are '
            f'{fit.excess**0.5:.2g} times as large as by the noise of the markers alone'
        )
    return lines


def _label(dimension: Dimension) -> str:
    if dimension.path[0] != 'bodies':
        return dimension.name
    return f'{dimension.name} {"xy"[dimension.axis]}'
