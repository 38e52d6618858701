"""
The kinds of joints, and what each says of its two bodies.

A joint relates the point `a` of the body `one` to the point `b` of the body `other`. `loop_form`
writes it as vectors from `a` to `b`, of which `_assembly` makes the vector loops that are solved.
`contact` gives its point and axis, and `_constraints` its equations between the poses of the two
bodies.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real

GROUND = 'ground'


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
    Write a joint as terms of a vector loop: its variables, terms, m and rad, and linear equations.

    The ties of a wheel state that both bodies have one velocity at the point of contact. On a
    circle of radius R, a wheel of radius r with its hub in the direction φ has
    (R + r) φ' = R θ_one' + r θ_other'. Those of a belt state the length that its wheels unwind:
    s' = r_one (φ' - θ_one') - r_other (φ' - θ_other').
    """
    match joint:
        case Slot(name, one, _, along, other, _, turned):
            guide = () if turned is None else (Tie({other: 1.0, one: -1.0}, turned),)
            return LoopForm((name,), (Term(1.0, along, one, name),), guide)
        case Rolling(name, one, _, other, _, radius, along, circle, start):
            if circle:
                tie = Tie({name: -joint.arm, one: circle, other: radius}, -joint.arm * start)
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


@dataclass(frozen=True, eq=False)
class Pose:
    """Position, complex, m, of a body's origin, and its angle, rad: (T,) each."""

    position: Complex
    angle: Real

    @cached_property
    def turn(self) -> Complex:
        """The direction e^{iθ} of the body's x axis."""
        return np.exp(1j * self.angle)

    def point(self, point: complex) -> Complex:
        """The position in the plane of a point of the body's frame."""
        return np.asarray(self.position + point * self.turn)


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
        return hub, one.turn * np.exp(1j * joint.along)
    between = hub - one.point(joint.a)
    if isinstance(joint, Rolling):
        axis = one.turn * np.exp(1j * joint.along)
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
