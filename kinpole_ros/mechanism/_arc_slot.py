"""A slot along an arc: a pin or a block that slides at a constant distance from a center."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from kinpole_ros.mechanism._joint_kinds import (
    ACROSS,
    TURN,
    Center,
    Contact,
    Joint,
    LoopForm,
    Pose,
    Term,
    Tie,
)


@dataclass(frozen=True)
class ArcSlot(Joint):
    """
    The point `b` of `other` slides on an arc of `one`, of the radius `circle` (m) about `a`.

    The variable with the name of the joint is the direction from `a` to `b`. With `turned` (rad) a
    block slides there: the angle of `other` is that direction plus `turned`. It then turns about
    the center of curvature, which is its instant center (seed 003, part 3).
    """

    circle: float
    turned: float | None = None

    has_play = True

    def loop_form(self) -> LoopForm:
        """The radius; a block turns with it."""
        block: tuple[Tie, ...] = ()
        if self.turned is not None:
            block = (Tie({self.other: 1.0, self.name: -1.0}, self.turned),)
        radius = Term(self.circle, 0.0, self.name)
        return LoopForm((self.name,), (radius,), block, (None, ACROSS, TURN))

    def contact(self, one: Pose, other: Pose) -> Contact:
        """The point that slides, and the tangent, which has the center to its left."""
        at = other.point(self.b)
        outward = at - one.point(self.a)
        return at, 1j * outward / np.abs(outward)

    def center(self) -> Center:
        """The center of curvature for a block; a pin leaves it anywhere on the normal."""
        if self.turned is None:
            return Center('line', f'the normal to slot {self.name} through its pin')
        return Center('contact', f'center of curvature of slot {self.name}', distance=self.circle)

    def sizes(self) -> dict[str, str]:
        """The radius, and the angle of a block."""
        return {'circle': 'length'} | ({} if self.turned is None else {'turned': 'angle'})

    def displaced(self, play: float) -> 'ArcSlot':
        """Off across the arc."""
        return replace(self, circle=self.circle + play)

    def own_values(self, between: complex, angles: Mapping[str, float]) -> dict[str, float]:
        """The direction of the point from the center."""
        return {self.name: float(np.angle(between))}
