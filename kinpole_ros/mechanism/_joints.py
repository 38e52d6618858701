"""
The kinds of joints, and what each says of its two bodies.

A joint relates the point `a` of the body `one` to the point `b` of the body `other`. `loop_form`
writes it as vectors from `a` to `b`, of which `_assembly` makes the vector loops that are solved.
`constraint_rows` writes it as equations between the poses of the two bodies; reactions, verdicts
and fits of dimensions follow from these and their derivatives.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real

GROUND = 'ground'
# Columns of the derivatives in `constraint_rows`: poses of both bodies, then sizes of the joint.
X, Y, ANGLE, OTHER_X, OTHER_Y, OTHER_ANGLE = range(6)
A, _, B, _, ALONG, TURNED, RADIUS, CIRCLE, START = range(6, 15)
POSE_COLUMNS, COLUMNS = 6, 15
# Directions of a constraint: along the axis of the joint, across it (to the left), and a turn.
ALONG_AXIS, ACROSS_AXIS, TURN = range(3)


class Revolute(NamedTuple):
    """A pin through the point `a` of the body `one` and the point `b` of `other` (complex, m)."""

    name: str
    one: str
    a: complex
    other: str
    b: complex


class Slot(NamedTuple):
    """
    The point `b` of `other` slides on a line of `one`, through `a` in the direction `along` (rad).

    With `turned` (rad) it is a prismatic joint: the angle of `other` is that of `one` plus
    `turned`. The slide, from `a` on, is a variable with the name of the joint.
    """

    name: str
    one: str
    a: complex
    along: float
    other: str
    b: complex
    turned: float | None = None


class Rolling(NamedTuple):
    """
    A wheel, the body `other` with its hub at `b` and `radius` (m), rolls on `one` without slip.

    It rolls on the left side of a line through `a` in the direction `along`, or on a circle of
    radius `circle` about `a`: outside of it, or inside if `circle` is negative. The variable with
    the name of the joint is the slide of the hub along the line, or the direction from the point of
    contact to the hub. That variable is `start` when all angles are zero. With a `pressure` angle
    (rad) the wheels have teeth, which push each other away with the tangent of that angle times the
    force that they transmit; other joints then hold the hub at its distance.
    """

    name: str
    one: str
    a: complex
    other: str
    b: complex
    radius: float
    along: float = 0.0
    circle: float = 0.0
    start: float = 0.0
    pressure: float | None = None

    @property
    def arm(self) -> float:
        """Signed distance of the hub from the center of the circle, m."""
        return self.circle + self.radius


class Strut(NamedTuple):
    """
    A cylinder or spring from the point `a` of `one` to `b` of `other`; it constrains nothing.

    Its length is a variable with its name, which a driver may prescribe. Its direction is the
    variable NAME.angle.
    """

    name: str
    one: str
    a: complex
    other: str
    b: complex


class Belt(NamedTuple):
    """
    One taut strand of a belt, chain or rope, from a wheel on the body `one` to one on `other`.

    The wheels have their hubs at `a` and `b` and the given `radii` (m), positive where the strand
    runs on the left of the hub; a radius of zero ties that end to the point. The strand does not
    slip. Its variables are those of a strut: the length of the straight part and its direction.
    The length is `length` where the strand points to `direction` (rad) and both wheels are at angle
    zero. A `carrier` is a body that has both hubs: it turns the strand and keeps its length.
    """

    name: str
    one: str
    a: complex
    other: str
    b: complex
    radii: tuple[float, float]
    length: float
    direction: float
    carrier: str | None = None


Joint = Revolute | Slot | Rolling | Strut | Belt


class Term(NamedTuple):
    """
    The vector length · e^{i(θ + offset)}, where θ is the angle of `turn`, a body or a variable.

    With the name of a variable in `slide` its length is `length` times that variable.
    """

    length: float
    offset: float
    turn: str
    slide: str = ''


class Tie(NamedTuple):
    """The linear equation Σ weight · variable = value. Angles of bodies are variables."""

    weights: dict[str, float]
    value: float


class LoopForm(NamedTuple):
    """The variables of a joint, the vectors that lead from `a` to `b`, and its linear equations."""

    variables: tuple[str, ...] = ()
    terms: tuple[Term, ...] = ()
    ties: tuple[Tie, ...] = ()


def loop_form(joint: Joint) -> LoopForm:
    """
    Write a joint as terms of a vector loop.

    Parameters
    ----------
    joint
        The joint.

    Returns
    -------
    LoopForm
        Its variables, terms, m and rad, and linear equations.

    Notes
    -----
    The ties of a wheel state that both bodies move alike at the point of contact. On a circle of
    radius R, a wheel of radius r with its hub in the direction φ has
    (R + r) φ' = R θ_one' + r θ_other'. Of a belt they state the length that its wheels unwind:
    s' = r_one (φ' - θ_one') - r_other (φ' - θ_other').
    """
    match joint:
        case Slot(name, one, _, along, other, _, turned):
            guide = () if turned is None else (Tie({other: 1.0, one: -1.0}, turned),)
            return LoopForm((name,), (Term(1.0, along, one, name),), guide)
        case Rolling(name, one, _, other, _, radius, along, circle, start):
            if circle:
                tie = Tie({name: joint.arm, one: -circle, other: -radius}, joint.arm * start)
                return LoopForm((name,), (Term(joint.arm, 0.0, name),), (tie,))
            slide, up = Term(1.0, along, one, name), Term(radius, along + np.pi / 2, one)
            return LoopForm(
                (name,), (slide, up), (Tie({name: 1.0, other: radius, one: -radius}, start),)
            )
        case Strut(name):
            angle = f'{name}.angle'
            return LoopForm((name, angle), (Term(1.0, 0.0, angle, name),))
        case Belt(name, one, _, other, _, (first, last), length, direction, carrier):
            angle = f'{name}.angle'
            straight, step = Term(1.0, 0.0, angle, name), Term(first - last, np.pi / 2, angle)
            weights = {name: 1.0, angle: last - first, one: first, other: -last}
            ties = [Tie(weights, length + (last - first) * direction)]
            if carrier is not None:
                ties[:0] = Tie({name: 1.0}, length), Tie({angle: 1.0, carrier: -1.0}, direction)
            terms = (straight,) if first == last else (straight, step)
            return LoopForm((name, angle), terms, tuple(ties))
    return LoopForm()


class Pose(NamedTuple):
    """Position, complex, m, of a body's origin, and its angle, rad: (T,) each."""

    position: Complex
    angle: Real

    def point(self, point: complex) -> Complex:
        """Where a point of the body's frame lies in the plane."""
        return np.asarray(self.position + point * np.exp(1j * self.angle))


def contact(joint: Joint, one: Pose, other: Pose) -> tuple[Complex, Complex]:
    """
    Point at which the two bodies act on each other, and the joint's axis, complex of length 1.

    The axis is that of the slot, the strut, the strand or the tangent of the wheel, which lies to
    its left. A pin has the x axis of the ground.
    """
    hub = other.point(joint.b)
    if isinstance(joint, Revolute):
        return hub, np.ones_like(hub)
    if isinstance(joint, Slot):
        return hub, np.exp(1j * (one.angle + joint.along))
    between = hub - one.point(joint.a)
    if isinstance(joint, Rolling):
        axis = np.exp(1j * (one.angle + joint.along))
        if joint.circle:
            axis = -1j * np.sign(joint.arm) * between / np.abs(between)
        return hub - 1j * joint.radius * axis, axis
    if isinstance(joint, Belt):
        axis = strand(joint, between)[1]
        return hub + 1j * joint.radii[1] * axis, axis
    with np.errstate(invalid='ignore'):
        return hub, between / np.abs(between)


def strand(joint: Belt, hubs: Complex) -> tuple[Real, Complex]:
    """Length and direction, complex of length 1, of a belt's strand, from hub to hub (complex)."""
    step = joint.radii[0] - joint.radii[1]
    length = np.sqrt(np.maximum(np.abs(hubs) ** 2 - step**2, 0.0))
    return length, hubs / (length + 1j * step)


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
        Of a pin the distances along x and y; of a slot the distance across it; of a guide also the
        turn; of a wheel the error of the distance of its hub, and its slip; of a belt the slack. A
        strut has no rows.

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
            gap = _hub_distance(joint, one, between, slope)
            return _rows(gap, _slip(joint, one, other, between, slope, anchor))
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
    turn, other_turn = np.exp(1j * one.angle), np.exp(1j * other.angle)
    slope = np.zeros((len(turn), COLUMNS), complex)
    slope[:, [X, Y, OTHER_X, OTHER_Y]] = -1, -1j, 1, 1j
    slope[:, ANGLE], slope[:, OTHER_ANGLE] = -1j * joint.a * turn, 1j * joint.b * other_turn
    slope[:, A], slope[:, A + 1] = -turn, -1j * turn
    slope[:, B], slope[:, B + 1] = other_turn, 1j * other_turn
    return other.position + joint.b * other_turn - one.position - joint.a * turn, slope


def _in_axes_of_line(
    joint: Slot | Rolling, one: Pose, between: Complex, slope: Complex
) -> tuple[Complex, Complex]:
    """A vector and its derivatives in the axes of the joint's line, which turns with `one`."""
    turn = np.exp(-1j * (one.angle + joint.along))
    local, slope = turn * between, turn[:, None] * slope
    slope[:, ANGLE] -= 1j * local
    if slope.shape[1] == COLUMNS:
        slope[:, ALONG] -= 1j * local
    return local, slope


def _hub_distance(
    joint: Rolling, one: Pose, between: Complex, slope: Complex
) -> tuple[Real, Real, int]:
    """The row across of a wheel: the error of its hub's distance from the line or center."""
    if joint.circle:
        outward = (np.sign(joint.arm) * between / np.abs(between)).conj()
        gap, by = (outward * between).real - joint.arm, (outward[:, None] * slope).real
        by[:, CIRCLE] -= 1.0
    else:
        local, slope = _in_axes_of_line(joint, one, between, slope)
        gap, by = local.imag - joint.radius, slope.imag
    by[:, RADIUS] -= 1.0
    return gap, by, ACROSS_AXIS


def _slip(
    joint: Rolling, one: Pose, other: Pose, between: Complex, slope: Complex, anchor: Anchor | None
) -> tuple[Real, Real, int]:
    """The row along of a wheel: its slip since the anchor, but for whole turns of the wheel."""
    first_hub, first_angle, first_other = anchor or (0.0, 0.0, 0.0)
    angle, other_angle = one.angle - first_angle, other.angle - first_other
    radius, arm = joint.radius, joint.arm
    if joint.circle:
        # The direction of the hub is known but for whole turns; the angles tell how many.
        ahead = (joint.circle * angle + radius * other_angle) / arm + joint.start
        hub = np.angle(between * np.sign(arm)) - first_hub
        hub += 2 * np.pi * np.round((ahead - hub) / (2 * np.pi))
        slip, by = arm * (ahead - hub), -arm * (slope / between[:, None]).imag
        by[:, ANGLE] += joint.circle
        by[:, OTHER_ANGLE] += radius
        by[:, CIRCLE] += angle + joint.start - hub
        by[:, RADIUS] += other_angle + joint.start - hub
        by[:, START] += arm
    else:
        local, slope = _in_axes_of_line(joint, one, between, slope)
        turned = other_angle - angle
        slip, by = local.real - first_hub + radius * turned - joint.start, slope.real
        by[:, OTHER_ANGLE] += radius
        by[:, ANGLE] -= radius
        by[:, RADIUS] += turned
        by[:, START] -= 1.0
    circumference = 2 * np.pi * radius
    slip = (slip + circumference / 2) % circumference - circumference / 2
    return slip, by, ALONG_AXIS


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
