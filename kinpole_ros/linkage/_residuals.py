"""
What the joints of a scene lack at given poses, g(poses, dimensions), with its derivatives.

All functions take T instants at once. A pose is complex m and an angle with whole turns.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import Dimension, Equation, Equations, Part
from kinpole_ros.planar._plane import Complex, Real


class Residuals(NamedTuple):
    """
    What is lacking (T, m), m or rad: two rows for a pin, in the ground's axes, less for others.

    `by_pose` (T, m, bodies, 3) are its derivatives by x, y (m) and angle of each body, and
    `by_dimension` (T, m, dimensions) those by the dimensions. `joint` (m,) numbers the joints.
    """

    value: Real
    by_pose: Real
    by_dimension: Real
    joint: np.ndarray

    def without(self, rows: np.ndarray) -> 'Residuals':
        """The same without some rows."""
        left = ~rows
        value, by_pose, by_dimension = (part[:, left] for part in self[:3])
        return Residuals(value, by_pose, by_dimension, self.joint[left])


# How each wheel stood first, by its joint: slide or direction of the hub, angles of both bodies.
Anchors = dict[int, tuple[float, float, float]]


def place(parts: Sequence[Part], values: Real) -> tuple[complex, Complex]:
    """A sum of parts (complex, m), and its derivatives by the dimensions, of which `values` are."""
    total, by = 0j, np.zeros(len(values), complex)
    for part in parts:
        one, other = values[part.first], values[part.second]
        if part.polar:
            turn = part.sign * np.exp(1j * other)
            total += one * turn
            by[part.first] += turn
            by[part.second] += 1j * one * turn
        else:
            total += part.sign * (one + 1j * other)
            by[part.first] += part.sign
            by[part.second] += 1j * part.sign
    return total, by


def residuals(
    equations: Equations, values: Real, position: Complex, angle: Real, anchors: Anchors
) -> Residuals:
    """
    Of the bodies of `equations` at (T, bodies), with the dimensions at `values`.

    How wheels stand at the first instant is kept in `anchors` and held against the others, since
    no scene knows which tooth is in which gap.
    """
    rows = _Rows(equations, values, position, angle, anchors)
    for k, joint in enumerate(equations.joints):
        rows.add(k, joint)
    return Residuals(
        np.stack(rows.value, axis=1),
        np.stack(rows.by_pose, axis=1),
        np.stack(rows.by_dimension, axis=1),
        np.array(rows.joint),
    )


class _Rows:
    """A growing list of rows, each the real part of a complex equation."""

    def __init__(
        self,
        equations: Equations,
        values: Real,
        position: Complex,
        angle: Real,
        anchors: Anchors,
    ) -> None:
        self._bodies = {body: k for k, body in enumerate(equations.bodies)}
        self._values, self._position, self._angle = values, position, angle
        self._turn = np.exp(1j * angle)
        self._anchors, self._starts = anchors, equations.dimensions
        self.value: list[Real] = []
        self.by_pose: list[Real] = []
        self.by_dimension: list[Real] = []
        self.joint: list[int] = []

    def add(self, number: int, joint: Equation) -> None:
        """Add the rows of a joint."""
        one, other = self._bodies[joint.one], self._bodies[joint.other]
        values, turn = self._values, self._turn
        (a, by_a), (b, by_b) = place(joint.a, values), place(joint.b, values)
        # From the point of the one body to that of the other.
        between = (
            self._position[:, other]
            + b * turn[:, other]
            - self._position[:, one]
            - a * turn[:, one]
        )
        count, bodies = self._angle.shape
        poses = np.zeros((count, bodies, 3), complex)
        poses[:, one] -= np.stack((np.ones(count), np.full(count, 1j), 1j * a * turn[:, one]), -1)
        poses[:, other] += np.stack(
            (np.ones(count), np.full(count, 1j), 1j * b * turn[:, other]), -1
        )
        dimensions = turn[:, other, None] * by_b - turn[:, one, None] * by_a
        whole = between, poses, dimensions
        if joint.circle is not None:
            self._on_circle(number, joint, one, other, whole)
            return
        if joint.along is None:
            for axis in (1.0, -1j):
                self._row(number, *(axis * part for part in whole))
            return
        # Along the line, and off it.
        line = turn[:, one].conj() * np.exp(-1j * values[joint.along])
        between, poses, dimensions = (
            line * between,
            line[:, None, None] * poses,
            line[:, None] * dimensions,
        )
        poses[:, one, 2] -= 1j * between
        dimensions[:, joint.along] -= 1j * between
        off = [-1j * part for part in (between, poses, dimensions)]
        if joint.radius is not None and joint.start is not None:
            off[0] = off[0] - values[joint.radius]
            off[2][:, joint.radius] -= 1.0
            self._row(number, *off)
            radius = values[joint.radius]
            slide, *turned = self._since(number, between.real, one, other)
            poses[:, other, 2] += radius
            poses[:, one, 2] -= radius
            dimensions[:, joint.radius] += turned[1] - turned[0]
            dimensions[:, joint.start] -= 1.0
            rolled = radius * (turned[1] - turned[0]) - self._moved(joint.start)
            self._phase(number, slide + rolled, poses, dimensions, radius)
            return
        self._row(number, *off)
        if joint.turned is not None:
            turned = self._angle[:, other] - self._angle[:, one] - values[joint.turned]
            poses, dimensions = np.zeros_like(poses), np.zeros_like(dimensions)
            poses[:, other, 2], poses[:, one, 2] = 1.0, -1.0
            dimensions[:, joint.turned] = -1.0
            turned = (turned + np.pi) % (2 * np.pi) - np.pi
            self._row(number, turned.astype(complex), poses, dimensions)

    def _on_circle(
        self,
        number: int,
        joint: Equation,
        one: int,
        other: int,
        whole: tuple[Complex, Complex, Complex],
    ) -> None:
        """A wheel on a circle: how far its hub is off, and how far it slipped."""
        assert joint.circle is not None and joint.radius is not None and joint.start is not None
        circle, radius = self._values[joint.circle], self._values[joint.radius]
        arm = circle + radius
        # Along the way from the one center to the other.
        between = whole[0]
        length = np.maximum(np.abs(between), 1e-300)
        out = between.conj() / length
        poses, dimensions = out[:, None, None] * whole[1], out[:, None] * whole[2]
        by_radii = np.zeros_like(dimensions)
        by_radii[:, [joint.circle, joint.radius]] = np.sign(arm)
        self._row(number, (length - abs(arm)).astype(complex), poses, dimensions - by_radii)
        # Which of the directions that look alike: the one to which the turns of both lead.
        heading, *turned = self._since(number, np.angle(between * np.sign(arm)), one, other)
        ahead = (circle * turned[0] + radius * turned[1]) / arm
        heading = heading + 2 * np.pi * np.round((ahead - heading) / (2 * np.pi))
        across = -1j * arm / length
        poses, dimensions = across[:, None, None] * poses, across[:, None] * dimensions
        poses[:, one, 2] -= circle
        poses[:, other, 2] -= radius
        dimensions[:, joint.circle] += heading - turned[0]
        dimensions[:, joint.radius] += heading - turned[1]
        dimensions[:, joint.start] -= arm
        slipped = arm * (heading - ahead - self._moved(joint.start))
        self._phase(number, slipped, poses, dimensions, radius)

    def _since(self, number: int, now: Real, one: int, other: int) -> tuple[Real, Real, Real]:
        """How far the hub and both bodies went since the wheel was first seen."""
        angles = self._angle[:, one], self._angle[:, other]
        first = tuple(float(part[0]) for part in (now, *angles))
        a, b, c = self._anchors.setdefault(number, (first[0], first[1], first[2]))
        return now - a, angles[0] - b, angles[1] - c

    def _moved(self, start: int) -> float:
        return float(self._values[start] - self._starts[start].value)

    def _phase(
        self, number: int, value: Real, poses: Complex, dimensions: Complex, radius: float
    ) -> None:
        """How far a wheel slipped since the first instant, but for whole turns."""
        round_ = 2 * np.pi * radius
        value = (value + round_ / 2) % round_ - round_ / 2
        self._row(number, value.astype(complex), poses, dimensions)

    def _row(self, number: int, value: Complex, poses: Complex, dimensions: Complex) -> None:
        self.value.append(value.real)
        self.by_pose.append(poses.real)
        self.by_dimension.append(dimensions.real)
        self.joint.append(number)


def point_dimensions(dimensions: Sequence[Dimension]) -> dict[str, list[int]]:
    """The numbers of the dimensions by what people may call wrong: a point, a length, an angle."""
    found: dict[str, list[int]] = {}
    for k, one in enumerate(dimensions):
        if one.path:
            found.setdefault(one.name, []).append(k)
    return found
