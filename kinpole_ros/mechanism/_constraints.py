"""
Constraints of joints as equations between the poses of their bodies, with derivatives.

`constraint_rows` has the equations of one joint: `linkage` compares measured poses with them, and
fits dimensions. `constraints` has the Jacobian of a whole linkage, in absolute coordinates (x, y, θ
of each body), whose inverse gives the reactions.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import largest_length, poses_of
from kinpole_ros.mechanism._joints import (
    GROUND,
    Belt,
    Joint,
    Pose,
    Revolute,
    Rolling,
    Slot,
    contact,
    strand,
)
from kinpole_ros.mechanism._loads import Force, Load
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.planar._plane import ROUNDING, Complex, Real

# Sizes of a joint, and columns of the derivatives in `constraint_rows`: poses of both bodies, then
# these sizes.
SIZES = ('a.x', 'a.y', 'b.x', 'b.y', 'along', 'turned', 'radius', 'circle', 'start')
X, Y, ANGLE, OTHER_X, OTHER_Y, OTHER_ANGLE = range(6)
A_X, A_Y, B_X, B_Y, ALONG, TURNED, RADIUS, CIRCLE, START = range(6, 15)
POSE_COLUMNS, COLUMNS = 6, 15
# Directions of a constraint: along the axis of the joint, across it (to the left), and a turn.
ALONG_AXIS, ACROSS_AXIS, TURN = range(3)
# Next to a dead point positions, and so singular values, have errors of rounding over the least
# singular value: below the root of rounding that value counts as zero.
_SINGULAR_VALUE = np.sqrt(ROUNDING)
# A constraint with less than this share in a state of self-stress has a unique reaction.
UNSTRESSED = 1e-6


class Rows(NamedTuple):
    """
    The k equations of a joint at T instants: `value` (T, k), m or rad, zero where they hold.

    `slope` (T, k, 15) is the derivative by x, y and angle of both bodies and by the sizes of the
    joint: x and y of `a` and of `b`, along, turned, radius, circle and start. `direction` (k,)
    tells for each row whether it acts along the axis, across it, or is a turn.
    """

    value: Real
    slope: Real
    direction: tuple[int, ...]


# The slide of a wheel's hub, or its direction from the center, and the angles of both bodies.
Anchor = tuple[float, float, float]


def constraint_rows(joint: Joint, one: Pose, other: Pose, anchor: Anchor | None = None) -> Rows:
    """
    Equations of a joint between the poses of its bodies, with their derivatives.

    Parameters
    ----------
    joint
        The joint, with lengths in m and angles in rad.
    one, other
        Poses of its bodies at T instants.
    anchor
        The state from which the slip of a wheel is measured (`wheel_state`); without one it is
        measured from where the hub and both angles are zero.

    Returns
    -------
    Rows
        A pin has the distances along x and y; a slot the distance across it; a guide also the turn;
        a wheel the error of the distance of its hub, and its slip; a belt its slack. A strut has no
        rows.

    """
    between, slope = _between(joint, one, other)
    match joint:
        case Revolute():
            return _rows(
                (between.real, slope.real, ALONG_AXIS), (between.imag, slope.imag, ACROSS_AXIS)
            )
        case Slot():
            local, slope = _in_axes_of_line(joint, one, between, slope)
            across = local.imag, slope.imag, ACROSS_AXIS
            if joint.turned is None:
                return _rows(across)
            turned = other.angle - one.angle - joint.turned
            turned = (turned + np.pi) % (2 * np.pi) - np.pi
            by = np.zeros(slope.shape)
            by[:, [OTHER_ANGLE, ANGLE, TURNED]] = 1.0, -1.0, -1.0
            return _rows(across, (turned, by, TURN))
        case Rolling():
            return _wheel_rows(joint, one, other, between, slope, anchor)
        case Belt():
            return _rows(_unwound(joint, one, other, between, slope))
    return Rows(np.empty((len(between), 0)), np.empty((len(between), 0, COLUMNS)), ())


def wheel_state(joint: Rolling, one: Pose, other: Pose) -> Anchor:
    """
    Position of a wheel at the first instant, from which `constraint_rows` measures its slip.

    Parameters
    ----------
    joint
        The wheel.
    one, other
        Poses of its bodies at T instants.

    Returns
    -------
    tuple of float
        The slide of the hub, m, or its direction from the center of the circle, rad, and the angles
        of both bodies, rad.

    """
    between, slope = _between(joint, one, other)
    if joint.circle:
        hub = float(np.angle(between[0] * np.sign(joint.arm)))
    else:
        hub = float(_in_axes_of_line(joint, one, between, slope)[0][0].real)
    return hub, float(one.angle[0]), float(other.angle[0])


def variable_rates(joint: Joint, one: Pose, other: Pose) -> dict[str, Real]:
    """Derivatives (T, 6) of the joint's own variables by the poses of its bodies."""
    if isinstance(joint, Revolute):
        return {}
    between, slope = _between(joint, one, other)
    slope = slope[:, :POSE_COLUMNS]
    if isinstance(joint, Rolling) and joint.circle:
        return {joint.name: (slope / between[:, None]).imag}
    if isinstance(joint, Rolling | Slot):
        return {joint.name: _in_axes_of_line(joint, one, between, slope)[1].real}
    step = joint.radii[0] - joint.radii[1] if isinstance(joint, Belt) else 0.0
    length = np.sqrt(np.maximum(np.abs(between) ** 2 - step**2, 0.0))[:, None]
    slope = slope * ((length + 1j * step) / between[:, None])
    angle = slope.imag / length
    return {joint.name: slope.real + step * angle, f'{joint.name}.angle': angle}


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
    if slope.shape[1] == COLUMNS:
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
    return _rows((gap, by_gap, ACROSS_AXIS), (slip, by_slip, ALONG_AXIS))


def _unwound(
    joint: Belt, one: Pose, other: Pose, between: Complex, slope: Complex
) -> tuple[Real, Real, int]:
    """The row of a belt: by how much its free length differs from what its wheels unwound."""
    first, last = joint.radii
    length, axis = strand(joint, between)
    turned = np.angle(axis * np.exp(-1j * joint.direction))
    gap = length - joint.length + (last - first) * turned + first * one.angle - last * other.angle
    by = (axis.conj()[:, None] * slope).real
    by[:, ANGLE] += first
    by[:, OTHER_ANGLE] -= last
    return gap, by, ALONG_AXIS


def _rows(*rows: tuple[Real, Real, int]) -> Rows:
    value, slope, direction = zip(*rows, strict=True)
    return Rows(np.stack(value, axis=1), np.stack(slope, axis=1), direction)


class Constraints(NamedTuple):
    """
    The inverse of the constraint Jacobian at T positions, and what the constraints determine.

    `rows` are (joint, direction) of the R rows, which those of the drivers follow. `contact` and
    `axis` (J, T) are the points and directions of the joints. `motions` (3B, R + d, T) are the
    velocities of all bodies at unit rate of one row, all others held, NaN where no load can tell
    its multiplier. `stress` (R + d, T) is the share of each row in the reactions that are possible
    without any load.
    """

    poses: dict[str, Pose]
    rows: list[tuple[int, int]]
    contact: Complex
    axis: Complex
    motions: Real
    stress: Real
    rank: np.ndarray

    @property
    def determined(self) -> np.ndarray:
        """Positions (T,) at which the constraints determine the poses of all bodies."""
        return np.asarray(self.rank == len(self.motions))

    def multipliers(self, powers: Real) -> Real:
        """Multipliers (R + d, T) of the rows at the powers of all loads in their motions."""
        return np.where(np.isnan(self.motions[0]), np.nan, -powers.sum(axis=0))

    def powers(self, mechanism: Mechanism, loads: Sequence[Load]) -> Real:
        """Powers (loads, R + d, T) of the loads in the motions."""
        powers = np.empty((len(loads), *self.motions.shape[1:]))
        for power, load in zip(powers, loads, strict=True):
            if load.body == GROUND:
                power[...] = 0.0
                continue
            first = 3 * mechanism.bodies.index(load.body)
            x, y, turn = self.motions[first : first + 3]
            if isinstance(load, Force):
                pose, force = self.poses[load.body], np.asarray(load.force, complex)
                arm = pose.point(load.point) - pose.position
                power[...] = force.real * x + force.imag * y + (arm.conj() * force).imag * turn
            else:
                power[...] = load.torque * turn
        return powers


def constraints(mechanism: Mechanism, values: Real) -> Constraints:
    """The constraints of all joints and drivers at variables (n, T)."""
    if reason := why_no_reactions(mechanism):
        raise LinkageError(reason)
    joints, poses = mechanism.assembly.joints, poses_of(mechanism.assembly, values)
    meeting = [contact(joint, poses[joint.one], poses[joint.other]) for joint in joints]
    at, axis = (np.array(part) for part in zip(*meeting, strict=True))
    rows, matrix = _jacobian(mechanism, poses)
    column = np.ones(3 * len(mechanism.bodies))
    column[2::3] = largest_length(mechanism.assembly, values)
    matrix = matrix / column[:, None]
    size = np.sqrt((matrix**2).sum(axis=1))
    matrix = np.moveaxis(matrix / size[:, None], -1, 0)
    is_finite = np.isfinite(matrix).all(axis=(1, 2), keepdims=True)
    u, s, vt = np.linalg.svd(np.where(is_finite, matrix, 0.0))
    is_zero = s <= _SINGULAR_VALUE * s[:, :1]
    rank = (~is_zero).sum(axis=1)
    with np.errstate(divide='ignore'):
        inverse_values = np.where(is_zero, 0.0, 1 / s)[:, None]
    most = s.shape[1]
    inverse = vt[:, :most].swapaxes(1, 2) * inverse_values @ u[:, :, :most].swapaxes(1, 2)
    motions = np.moveaxis(inverse, 0, -1) / column[:, None, None] / size
    stress = np.zeros(size.shape)
    if (rank < len(size)).any():
        # Left null space: reactions that balance each other without a load.
        beyond = np.arange(u.shape[2]) >= rank[:, None]
        balanced = np.moveaxis(np.where(beyond[:, None, :], u, 0.0), 0, -1)
        stress = np.sqrt((balanced**2).sum(axis=1))
        for row, (k, direction) in enumerate(rows):
            if isinstance(joints[k], Revolute) and direction == ALONG_AXIS:
                pin = slice(row, row + 2)
                with np.errstate(invalid='ignore'):
                    forces = balanced[pin] / size[pin, None]
                axis[k], stress[pin] = _main_axis(forces[0] + 1j * forces[1])
                x, y = motions[:, row].copy(), motions[:, row + 1].copy()
                motions[:, row] = axis[k].real * x + axis[k].imag * y
                motions[:, row + 1] = axis[k].real * y - axis[k].imag * x
        motions[:, (stress > UNSTRESSED) | (rank < len(column))] = np.nan
    return Constraints(poses, rows, at, axis, motions, stress, rank)


def _main_axis(forces: Complex) -> tuple[Complex, tuple[Real, Real]]:
    """The main axis (T,) of forces (n, T) that a pin can have without a load, and their sizes."""
    main = (forces**2).sum(axis=0)
    axis = np.where(np.abs(main) > UNSTRESSED**2, np.exp(0.5j * np.angle(main)), 1.0)
    turned = forces * axis.conj()
    return axis, (np.sqrt((turned.real**2).sum(axis=0)), np.sqrt((turned.imag**2).sum(axis=0)))


def _jacobian(mechanism: Mechanism, poses: dict[str, Pose]) -> tuple[list[tuple[int, int]], Real]:
    """The rows of the joints, as (joint, direction), and all derivatives (R + d, 3B, T)."""
    bodies, count = mechanism.bodies, len(poses[GROUND].angle)

    def spread(joint: Joint, slope: Real) -> Real:
        """Derivatives (3B, T) by all bodies from those (T, 6) by the two of a joint."""
        row = np.zeros((3 * len(bodies), count))
        for body, columns in ((joint.one, slope[:, :3]), (joint.other, slope[:, 3:])):
            if body != GROUND:
                first = 3 * bodies.index(body)
                row[first : first + 3] = columns.T
        return row

    rows: list[tuple[int, int]] = []
    matrix: list[Real] = []
    rates: dict[str, Real] = {}
    driven = mechanism.driver_rows
    names = mechanism.assembly.loops.variables
    for k, joint in enumerate(mechanism.assembly.joints):
        pair = poses[joint.one], poses[joint.other]
        constraint = constraint_rows(joint, *pair)
        for r in np.argsort(constraint.direction).tolist():
            direction = constraint.direction[r]
            # Other joints hold the distance of teeth with a pressure angle.
            if direction == ALONG_AXIS or not has_teeth(joint):
                rows.append((k, direction))
                matrix.append(spread(joint, constraint.slope[:, r, :POSE_COLUMNS]))
        for name, slope in variable_rates(joint, *pair).items():
            rates[name] = spread(joint, slope)
    for b, body in enumerate(bodies):
        rates[body] = np.zeros((3 * len(bodies), count))
        rates[body][3 * b + 2] = 1.0
    for row in driven:
        used = {names[k]: row[k] for k in np.flatnonzero(row)}
        matrix.append(sum((weight * rates[name] for name, weight in used.items()), np.zeros(())))
    return rows, np.array(matrix)


def has_teeth(joint: Joint) -> bool:
    """Whether a joint is one of teeth with a pressure angle."""
    return isinstance(joint, Rolling) and joint.pressure is not None


def why_no_reactions(mechanism: Mechanism) -> str:
    """
    The reason for which a linkage has no reactions in its joints.

    Parameters
    ----------
    mechanism
        The linkage.

    Returns
    -------
    str
        The reason, empty if it has them.

    """
    if not mechanism.assembly.joints:
        return 'vectors have no joints: for what these bear write bodies and joints'
    if mechanism.assembly.loops.laws:
        return (
            'what joints bear depends on where a cam or a Geneva wheel is touched, which its law '
            'does not say: only the efforts of the drivers are determined'
        )
    return ''
