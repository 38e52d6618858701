"""
Residuals of a scene's joints at given poses, with their derivatives by poses and dimensions.

All functions take T instants at once. A pose is a complex position, m, and an angle with whole
turns.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import Dimension, Equation, Equations, Part
from kinpole_ros.planar._plane import Complex, Real


class Residuals(NamedTuple):
    """
    Residuals (T, m), m or rad: two rows for a pin, in the ground's axes, or those of its kind.

    `by_pose` (T, m, bodies, 3) are their derivatives by x, y (m) and angle of each body, and
    `by_dimension` (T, m, dimensions) those by the dimensions. `joint` (m,) numbers the joints.
    """

    value: Real
    by_pose: Real
    by_dimension: Real
    joint: np.ndarray

    def without(self, rows: np.ndarray) -> 'Residuals':
        """The same without the rows of a mask (m,)."""
        value, by_pose, by_dimension = (array[:, ~rows] for array in self[:3])
        return Residuals(value, by_pose, by_dimension, self.joint[~rows])


# First pose of each wheel, by its joint: slide or direction of the hub, and angles of both bodies.
Anchors = dict[int, tuple[float, float, float]]


class _Row(NamedTuple):
    """An equation (T,) with its derivatives by poses (T, bodies, 3) and by dimensions (T, n)."""

    value: Complex
    by_pose: Complex
    by_dimension: Complex

    def times(self, factor: Complex | complex) -> '_Row':
        factor = np.broadcast_to(factor, self.value.shape)
        return _Row(
            factor * self.value,
            factor[:, None, None] * self.by_pose,
            factor[:, None] * self.by_dimension,
        )


def point_position(parts: Sequence[Part], values: Real) -> tuple[complex, Complex]:
    """A point as a sum of parts (complex, m), and its derivatives by the dimensions (n,)."""
    total, by = 0j, np.zeros(len(values), complex)
    for part in parts:
        first, second = values[part.first], values[part.second]
        if part.polar:
            turn = part.sign * np.exp(1j * second)
            total += first * turn
            by[part.first] += turn
            by[part.second] += 1j * first * turn
        else:
            total += part.sign * (first + 1j * second)
            by[part.first] += part.sign
            by[part.second] += 1j * part.sign
    return total, by


def residuals(
    equations: Equations, values: Real, position: Complex, angle: Real, anchors: Anchors
) -> Residuals:
    """
    Residuals of the bodies of `equations` at poses (T, bodies), with dimensions of these `values`.

    No scene says which tooth is in which gap: the first pose of each wheel is kept in `anchors`,
    and its later poses are compared with it.
    """
    poses = _Poses(equations, values, position, angle, anchors)
    rows = [(k, row) for k, joint in enumerate(equations.joints) for row in poses.rows(k, joint)]
    columns = zip(*(row for _, row in rows), strict=True)
    value, by_pose, by_dimension = (
        np.stack([array.real for array in column], axis=1) for column in columns
    )
    return Residuals(value, by_pose, by_dimension, np.array([k for k, _ in rows]))


class _Poses:
    """Poses of the bodies, of which the rows of each joint are computed."""

    def __init__(
        self, equations: Equations, values: Real, position: Complex, angle: Real, anchors: Anchors
    ) -> None:
        self._number = {body: k for k, body in enumerate(equations.bodies)}
        self._values, self._position, self._angle = values, position, angle
        self._turn = np.exp(1j * angle)
        self._anchors, self._dimensions = anchors, equations.dimensions

    def rows(self, number: int, joint: Equation) -> list[_Row]:
        """The rows of a joint; their real parts are its residuals."""
        i, j = self._number[joint.one], self._number[joint.other]
        values, turn = self._values, self._turn
        (a, by_a), (b, by_b) = point_position(joint.a, values), point_position(joint.b, values)
        # From the point of the one body to that of the other.
        between = self._position[:, j] + b * turn[:, j] - self._position[:, i] - a * turn[:, i]
        by_pose = np.zeros((*self._angle.shape, 3), complex)
        by_pose[:, i, :2] -= 1.0, 1j
        by_pose[:, j, :2] += 1.0, 1j
        by_pose[:, i, 2] -= 1j * a * turn[:, i]
        by_pose[:, j, 2] += 1j * b * turn[:, j]
        row = _Row(between, by_pose, turn[:, j, None] * by_b - turn[:, i, None] * by_a)
        if joint.circle is not None:
            return self._on_circle(number, joint, i, j, row)
        if joint.along is None:
            return [row, row.times(-1j)]
        # The real part is along the line of the joint, the imaginary part off it.
        row = row.times(turn[:, i].conj() * np.exp(-1j * values[joint.along]))
        row.by_pose[:, i, 2] -= 1j * row.value
        row.by_dimension[:, joint.along] -= 1j * row.value
        off = row.times(-1j)
        if joint.radius is not None:
            return self._on_line(number, joint, i, j, row, off)
        if joint.turned is None:
            return [off]
        angle = self._angle[:, j] - self._angle[:, i] - values[joint.turned]
        turned = _Row(
            ((angle + np.pi) % (2 * np.pi) - np.pi).astype(complex),
            np.zeros_like(row.by_pose),
            np.zeros_like(row.by_dimension),
        )
        turned.by_pose[:, j, 2], turned.by_pose[:, i, 2] = 1.0, -1.0
        turned.by_dimension[:, joint.turned] = -1.0
        return [off, turned]

    def _on_line(
        self, number: int, joint: Equation, i: int, j: int, row: _Row, off: _Row
    ) -> list[_Row]:
        """A wheel on a line: the distance of its hub less the radius, and its slip."""
        assert joint.radius is not None and joint.start is not None
        radius = self._values[joint.radius]
        off = off._replace(value=off.value - radius)
        off.by_dimension[:, joint.radius] -= 1.0
        slid, *turned = self._since_first(number, row.value.real, i, j)
        row.by_pose[:, j, 2] += radius
        row.by_pose[:, i, 2] -= radius
        row.by_dimension[:, joint.radius] += turned[1] - turned[0]
        row.by_dimension[:, joint.start] -= 1.0
        slip = slid + (radius * (turned[1] - turned[0]) - self._start_change(joint.start))
        return [off, row._replace(value=_without_turns(slip, radius))]

    def _on_circle(self, number: int, joint: Equation, i: int, j: int, row: _Row) -> list[_Row]:
        """A wheel on a circle: the distance of the centers less that of the radii, and its slip."""
        assert joint.circle is not None and joint.radius is not None and joint.start is not None
        circle, radius = self._values[joint.circle], self._values[joint.radius]
        arm = circle + radius
        length = np.maximum(np.abs(row.value), 1e-300)
        # The real part is along the line of centers, the imaginary part across.
        along = row.times(row.value.conj() / length)
        off = along._replace(
            value=(length - abs(arm)).astype(complex), by_dimension=along.by_dimension.copy()
        )
        off.by_dimension[:, [joint.circle, joint.radius]] -= np.sign(arm)
        direction = np.angle(row.value * np.sign(arm))
        direction, *turned = self._since_first(number, direction, i, j)
        # Whole turns of the direction are those that the turns of both bodies lead to.
        rolled = (circle * turned[0] + radius * turned[1]) / arm
        direction = direction + 2 * np.pi * np.round((rolled - direction) / (2 * np.pi))
        slip = arm * (direction - rolled - self._start_change(joint.start))
        across = along.times(-1j * arm / length)
        across.by_pose[:, i, 2] -= circle
        across.by_pose[:, j, 2] -= radius
        across.by_dimension[:, joint.circle] += direction - turned[0]
        across.by_dimension[:, joint.radius] += direction - turned[1]
        across.by_dimension[:, joint.start] -= arm
        return [off, across._replace(value=_without_turns(slip, radius))]

    def _since_first(self, number: int, hub: Real, i: int, j: int) -> tuple[Real, Real, Real]:
        """Motion of the hub and turns of both bodies since the wheel was first seen."""
        first = float(hub[0]), float(self._angle[0, i]), float(self._angle[0, j])
        a, b, c = self._anchors.setdefault(number, first)
        return hub - a, self._angle[:, i] - b, self._angle[:, j] - c

    def _start_change(self, start: int) -> float:
        return float(self._values[start] - self._dimensions[start].value)


def _without_turns(slip: Real, radius: float) -> Complex:
    """A slip (T,), m, of a wheel without whole turns."""
    circumference = 2 * np.pi * radius
    return ((slip + circumference / 2) % circumference - circumference / 2).astype(complex)


def point_dimensions(dimensions: Sequence[Dimension]) -> dict[str, list[int]]:
    """Numbers of the dimensions that the scene's file states, by name: of both coordinates."""
    numbers: dict[str, list[int]] = {}
    for k, dimension in enumerate(dimensions):
        if dimension.path:
            numbers.setdefault(dimension.name, []).append(k)
    return numbers
