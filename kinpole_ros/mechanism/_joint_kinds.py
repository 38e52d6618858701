"""
The kinds of joints, and what each says of its two bodies.

A joint relates the point `a` of the body `one` to the point `b` of the body `other`. Its
`loop_form` is a chain of vectors from `a` to `b`, with linear ties: `_assembly` makes the vector
loops of it, `_virtual_motions` the efforts and reactions, `_constraints` its equations between the
poses of the two bodies. `contact` gives its point and axis; what else the package asks of a joint
has an answer in `Joint` that suits most kinds.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real

GROUND = 'ground'
# Directions of a reaction: along the axis of the joint, across it (to the left), and a moment.
ALONG, ACROSS, TURN = range(3)


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


# Point at which the two bodies act on each other, and the joint's axis, complex of length 1.
Contact = tuple[Complex, Complex]


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
    """
    The variables of a joint, the vectors that lead from `a` to `b`, and its linear equations.

    `bears` are the reactions of the chain along the joint's axis and across it, and of the last
    equation, None where there is none.
    """

    variables: tuple[str, ...] = ()
    terms: tuple[Term, ...] = ()
    ties: tuple[Tie, ...] = ()
    bears: tuple[int | None, int | None, int | None] = (None, None, None)

    @property
    def free_slides(self) -> tuple[str, ...]:
        """The variables that are lengths, and in no tie."""
        tied = {name for tie in self.ties for name in tie.weights}
        return tuple(term.slide for term in self.terms if term.slide and term.slide not in tied)


class Center(NamedTuple):
    """
    What a joint tells of the instant center of its two bodies.

    By its `kind` the center is at the 'pin' or the 'contact', at 'infinity', or anywhere on a
    'line' through the contact; these two lie in the direction `turn` times the joint's axis. A
    center of curvature is at a `distance` (m) from the contact, in the same direction. `text` is
    what an engineer writes for it. The kind '' tells nothing.
    """

    kind: str = ''
    text: str = ''
    turn: complex = 1j
    distance: float = 0.0


class Rim(NamedTuple):
    """A circle of a `body`, m, in its frame: a wheel, or else a circle that a wheel rolls on."""

    body: str
    hub: complex
    radius: float
    is_wheel: bool = True


@dataclass(frozen=True)
class Joint:
    """
    A joint, and what most kinds of joints answer.

    A kind is a frozen dataclass, which adds its own numbers to these fields: its name, both bodies,
    and the points where it is on them, complex, m, in their frames.
    """

    name: str
    one: str
    a: complex
    other: str
    b: complex
    # Strut and belt: the variables are the length NAME and the direction NAME.angle of a span that
    # may have any.
    is_span: ClassVar[bool] = False
    # A belt only holds: its variables are not driven.
    is_driven: ClassVar[bool] = True
    # Whether pin, slot or teeth have play.
    has_play: ClassVar[bool] = False

    def loop_form(self) -> LoopForm:
        """The chain of vectors from `a` to `b`, and its ties."""
        raise NotImplementedError

    def contact(self, one: Pose, other: Pose) -> Contact:
        """The point at which both bodies act on each other, and the axis of the joint."""
        raise NotImplementedError

    def center(self) -> Center:
        """What the joint tells of the instant center of its bodies."""
        return Center()

    def rims(self) -> tuple[Rim, ...]:
        """The circles of its bodies that roll, are rolled on, or carry belts."""
        return ()

    def sizes(self) -> dict[str, str]:
        """The fields besides both points that a fit may change: each a 'length' or an 'angle'."""
        return {}

    def displaced(self, play: float) -> 'Joint':
        """The joint off by its play, m: across a slot, or along the pitch line of wheels."""
        raise NotImplementedError

    def own_values(self, between: complex, angles: Mapping[str, float]) -> dict[str, float]:
        """Those of its variables that the vector from `a` to `b` and the angles of bodies give."""
        return {}

    @property
    def pressure(self) -> float | None:
        """The angle, rad, of teeth that push each other away."""
        return None

    @property
    def start(self) -> float:
        """Its own variable when all angles are zero."""
        return 0.0

    @property
    def is_carried(self) -> bool:
        """Whether one body has the hubs of both wheels of a belt, so that its loop never moves."""
        return False

    def changed(self, **fields: Any) -> Any:
        """The joint with other values of some fields."""
        return replace(self, **fields)


@dataclass(frozen=True)
class Revolute(Joint):
    """A pin through the point `a` of the body `one` and the point `b` of `other` (complex, m)."""

    has_play = True

    def loop_form(self) -> LoopForm:
        """No vectors: `a` and `b` coincide."""
        return LoopForm(bears=(ALONG, ACROSS, None))

    def contact(self, one: Pose, other: Pose) -> Contact:
        """The pin, and the x axis of the ground."""
        at = other.point(self.b)
        return at, np.ones_like(at)

    def center(self) -> Center:
        """The pin."""
        return Center('pin', f'pin {self.name}')


@dataclass(frozen=True)
class Slot(Joint):
    """
    The point `b` of `other` slides on a line of `one`, through `a` in the direction `along` (rad).

    With `turned` (rad) it is a prismatic joint: the angle of `other` is that of `one` plus
    `turned`. The slide, from `a` on, is a variable with the name of the joint.
    """

    along: float = 0.0
    turned: float | None = None

    has_play = True

    def loop_form(self) -> LoopForm:
        """The slide; a guide ties both angles."""
        guide: tuple[Tie, ...] = ()
        if self.turned is not None:
            guide = (Tie({self.other: 1.0, self.one: -1.0}, self.turned),)
        slide = Term(1.0, self.along, self.one, self.name)
        return LoopForm((self.name,), (slide,), guide, (None, ACROSS, TURN))

    def contact(self, one: Pose, other: Pose) -> Contact:
        """The point that slides, and the direction of the line."""
        return other.point(self.b), one.turn * np.exp(1j * self.along)

    def center(self) -> Center:
        """At infinity for a guide; a pin in a slot leaves it anywhere on the normal."""
        if self.turned is None:
            return Center('line', f'the normal to slot {self.name} through its pin')
        return Center('infinity', f'at infinity, normal to slide {self.name}')

    def sizes(self) -> dict[str, str]:
        """The direction, and the angle between both bodies of a guide."""
        return {'along': 'angle'} | ({} if self.turned is None else {'turned': 'angle'})

    def displaced(self, play: float) -> 'Slot':
        """Off across the line."""
        return replace(self, a=self.a + 1j * np.exp(1j * self.along) * play)


@dataclass(frozen=True)
class Rolling(Joint):
    """
    A wheel, the body `other` with its hub at `b` and `radius` (m), rolls on `one` without slip.

    It rolls on the left side of a line through `a` in the direction `along`, or on a circle of
    radius `circle` about `a`: outside of it, or inside if `circle` is negative. The variable with
    the name of the joint is the slide of the hub along the line, or the direction from the point of
    contact to the hub. That variable is `start` when all angles are zero. With a `pressure` angle
    (rad) the wheels have teeth, which push each other away with the tangent of that angle times the
    force that they transmit; other joints then hold the hub at its distance. If it `floats`, that
    distance is a variable too, NAME.distance, and only its turn is tied.
    """

    radius: float
    along: float = 0.0
    circle: float = 0.0
    start: float = 0.0
    pressure: float | None = None
    floats: bool = False

    has_play = True

    @property
    def arm(self) -> float:
        """Signed distance of the hub from the center of the circle, m."""
        return self.circle + self.radius

    def loop_form(self) -> LoopForm:
        """
        To the hub; the tie states that both bodies have one velocity at the point of contact.

        On a circle of radius R, a wheel of radius r with its hub in the direction φ has
        (R + r) φ' = R θ_one' + r θ_other'.
        """
        name, radius, bears = self.name, self.radius, (None, ACROSS, ALONG)
        distance = f'{name}.distance' if self.floats else ''
        names = (name, distance) if distance else (name,)
        if self.circle:
            weights = {name: -self.arm, self.one: self.circle, self.other: radius}
            arm = Term(1.0 if distance else self.arm, 0.0, name, distance)
            return LoopForm(names, (arm,), (Tie(weights, -self.arm * self.start),), bears)
        slide = Term(1.0, self.along, self.one, name)
        up = Term(1.0 if distance else radius, self.along + np.pi / 2, self.one, distance)
        tie = Tie({name: 1.0, self.other: radius, self.one: -radius}, self.start)
        return LoopForm(names, (slide, up), (tie,), bears)

    def contact(self, one: Pose, other: Pose) -> Contact:
        """The point of contact, and the tangent, which has the wheel to its left."""
        hub, axis = other.point(self.b), one.turn * np.exp(1j * self.along)
        if self.circle:
            between = hub - one.point(self.a)
            axis = -1j * np.sign(self.arm) * between / np.abs(between)
        return hub - 1j * self.radius * axis, axis

    def center(self) -> Center:
        """The point of contact."""
        return Center('contact', f'point of contact of {self.name}')

    def rims(self) -> tuple[Rim, ...]:
        """The wheel, and the circle that it rolls on."""
        wheel = Rim(self.other, self.b, self.radius)
        on = Rim(self.one, self.a, abs(self.circle), is_wheel=False)
        return (wheel, on) if self.circle else (wheel,)

    def sizes(self) -> dict[str, str]:
        """The radius, and of what it rolls on the direction or the radius, and the start."""
        if self.circle:
            return {'radius': 'length', 'start': 'angle', 'circle': 'length'}
        return {'radius': 'length', 'start': 'length', 'along': 'angle'}

    def displaced(self, play: float) -> 'Rolling':
        """Off along the pitch line."""
        return replace(self, start=self.start + play / (self.arm if self.circle else 1.0))


@dataclass(frozen=True)
class Strut(Joint):
    """
    A cylinder or spring from the point `a` of `one` to `b` of `other`; it constrains nothing.

    Its length is a variable with its name, which a driver may prescribe. Its direction is the
    variable NAME.angle.
    """

    is_span = True

    def loop_form(self) -> LoopForm:
        """One vector, whose length and direction are variables."""
        angle = f'{self.name}.angle'
        return LoopForm((self.name, angle), (Term(1.0, 0.0, angle, self.name),))

    def contact(self, one: Pose, other: Pose) -> Contact:
        """The end on `other`, and the direction of the strut."""
        end = other.point(self.b)
        between = end - one.point(self.a)
        with np.errstate(invalid='ignore'):
            return end, between / np.abs(between)

    def own_values(self, between: complex, angles: Mapping[str, float]) -> dict[str, float]:
        """Its length and direction."""
        return {self.name: abs(between), f'{self.name}.angle': float(np.angle(between))}
