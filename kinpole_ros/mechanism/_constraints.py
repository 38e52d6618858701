"""
Constraints of joints as equations between the poses of their bodies, with derivatives.

`linkage` compares measured poses with them, and fits dimensions.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._joint_kinds import (
    Belt,
    Joint,
    Pose,
    Revolute,
    Rolling,
    Slot,
    strand,
)
from kinpole_ros.planar._plane import Complex, Real

# Sizes of a joint, and columns of the derivatives in `constraint_rows`: poses of both bodies, then
# these sizes.
SIZES = ('a.x', 'a.y', 'b.x', 'b.y', 'along', 'turned', 'radius', 'circle', 'start')
X, Y, ANGLE, OTHER_X, OTHER_Y, OTHER_ANGLE = range(6)
A_X, A_Y, B_X, B_Y, ALONG, TURNED, RADIUS, CIRCLE, START = range(6, 15)
COLUMNS = 15


class Rows(NamedTuple):
    """
    The k equations of a joint at T instants: `value` (T, k), m or rad, zero where they hold.

    `slope` (T, k, 15) is the derivative by x, y and angle of both bodies and by the sizes of the
    joint: x and y of `a` and of `b`, along, turned, radius, circle and start.
    """

    value: Real
    slope: Real


# The slide of a wheel's hub, or its direction from the center, and the angles of both bodies.
Anchor = tuple[float, float, float]


def constraint_rows(joint: Joint, one: Pose, other: Pose, anchor: Anchor | None = None) -> Rows:
    """
    Equations of a joint between the poses of its bodies at T instants, with their derivatives.

    A pin has the distances along x and y; a slot the distance across it; a guide also the turn; a
    wheel the error of the distance of its hub, and its slip; a belt its slack; a strut no rows. The
    slip is measured from `anchor` (`wheel_state`), or from where the hub and both angles are zero.
    """
    between, slope = _between(joint, one, other)
    match joint:
        case Revolute():
            return _rows((between.real, slope.real), (between.imag, slope.imag))
        case Slot():
            local, slope = _in_axes_of_line(joint, one, between, slope)
            across = local.imag, slope.imag
            if joint.turned is None:
                return _rows(across)
            turned = other.angle - one.angle - joint.turned
            turned = (turned + np.pi) % (2 * np.pi) - np.pi
            by = np.zeros(slope.shape)
            by[:, [OTHER_ANGLE, ANGLE, TURNED]] = 1.0, -1.0, -1.0
            return _rows(across, (turned, by))
        case Rolling():
            return _wheel_rows(joint, one, other, between, slope, anchor)
        case Belt():
            return _rows(_unwound(joint, one, other, between, slope))
    return Rows(np.empty((len(between), 0)), np.empty((len(between), 0, COLUMNS)))


def wheel_state(joint: Rolling, one: Pose, other: Pose) -> Anchor:
    """Where a wheel is at the first instant, from which `constraint_rows` measures its slip."""
    between, slope = _between(joint, one, other)
    if joint.circle:
        hub = float(np.angle(between[0] * np.sign(joint.arm)))
    else:
        hub = float(_in_axes_of_line(joint, one, between, slope)[0][0].real)
    return hub, float(one.angle[0]), float(other.angle[0])


def _between(joint: Joint, one: Pose, other: Pose) -> tuple[Complex, Complex]:
    """The vector (T,) from the point `a` to the point `b`, with its derivatives (T, 15)."""
    turn, other_turn = one.turn, other.turn
    slope = np.zeros((COLUMNS, len(turn)), complex).T
    slope[:, [X, Y, OTHER_X, OTHER_Y]] = -1, -1j, 1, 1j
    slope[:, ANGLE], slope[:, OTHER_ANGLE] = -1j * joint.a * turn, 1j * joint.b * other_turn
    slope[:, A_X], slope[:, A_Y] = -turn, -1j * turn
    slope[:, B_X], slope[:, B_Y] = other_turn, 1j * other_turn
    return other.position + joint.b * other_turn - one.position - joint.a * turn, slope


def _in_axes_of_line(
    joint: Slot | Rolling, one: Pose, between: Complex, slope: Complex
) -> tuple[Complex, Complex]:
    """A vector and its derivatives in the axes of the joint's line, which turns with `one`."""
    turn = one.turn.conj() * np.exp(-1j * joint.along)
    local, slope = turn * between, turn[:, None] * slope
    slope[:, ANGLE] -= 1j * local
    slope[:, ALONG] -= 1j * local
    return local, slope


def _wheel_rows(
    joint: Rolling, one: Pose, other: Pose, between: Complex, slope: Complex, anchor: Anchor | None
) -> Rows:
    """The rows of a wheel: the error of its hub's distance, and its slip but for whole turns."""
    first_hub, first_angle, first_other = anchor or (0.0, 0.0, 0.0)
    angle, other_angle = one.angle - first_angle, other.angle - first_other
    radius, arm = joint.radius, joint.arm
    if joint.circle:
        outward = (np.sign(arm) * between / np.abs(between)).conj()
        gap, by_gap = (outward * between).real - arm, (outward[:, None] * slope).real
        by_gap[:, CIRCLE] -= 1.0
        # The direction of the hub is known but for whole turns; the angles tell how many.
        ahead = (joint.circle * angle + radius * other_angle) / arm + joint.start
        hub = np.angle(between * np.sign(arm)) - first_hub
        hub += 2 * np.pi * np.round((ahead - hub) / (2 * np.pi))
        slip, by_slip = arm * (ahead - hub), -arm * (slope / between[:, None]).imag
        by_slip[:, ANGLE] += joint.circle
        by_slip[:, CIRCLE] += angle + joint.start - hub
        by_slip[:, RADIUS] += other_angle + joint.start - hub
        by_slip[:, START] += arm
    else:
        local, slope = _in_axes_of_line(joint, one, between, slope)
        gap, by_gap = local.imag - radius, slope.imag
        turned = other_angle - angle
        slip, by_slip = local.real - first_hub + radius * turned - joint.start, slope.real
        by_slip[:, ANGLE] -= radius
        by_slip[:, RADIUS] += turned
        by_slip[:, START] -= 1.0
    by_slip[:, OTHER_ANGLE] += radius
    by_gap[:, RADIUS] -= 1.0
    circumference = 2 * np.pi * radius
    slip = (slip + circumference / 2) % circumference - circumference / 2
    return _rows((gap, by_gap), (slip, by_slip))


def _unwound(
    joint: Belt, one: Pose, other: Pose, between: Complex, slope: Complex
) -> tuple[Real, Real]:
    """The row of a belt: by how much its free length differs from what its wheels unwound."""
    first, last = joint.radii
    length, axis = strand(joint, between)
    turned = np.angle(axis * np.exp(-1j * joint.direction))
    gap = length - joint.length + (last - first) * turned + first * one.angle - last * other.angle
    by = (axis.conj()[:, None] * slope).real
    by[:, ANGLE] += first
    by[:, OTHER_ANGLE] -= last
    return gap, by


def _rows(*rows: tuple[Real, Real]) -> Rows:
    value, slope = zip(*rows, strict=True)
    return Rows(np.stack(value, axis=1), np.stack(slope, axis=1))
