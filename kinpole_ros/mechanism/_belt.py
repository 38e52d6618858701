"""One taut strand of a belt, chain or rope between two wheels."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kinpole_ros.mechanism._joint_kinds import (
    ALONG,
    GROUND,
    Center,
    Contact,
    Joint,
    LoopForm,
    Pose,
    Rim,
    Term,
    Tie,
)
from kinpole_ros.planar._plane import Complex, Real


@dataclass(frozen=True)
class Belt(Joint):
    """
    One taut strand of a belt, chain or rope, from a wheel on the body `one` to one on `other`.

    The wheels have their hubs at `a` and `b` and the given `radii` (m), positive where the strand
    runs on the left of the hub; a radius of zero ties that end to the point. The strand does not
    slip. Its variables are those of a strut: the length of the straight part and its direction.
    The length is `length` where the strand points to `direction` (rad) and both wheels are at angle
    zero. A `carrier` is a body that has both hubs: it turns the strand and keeps its length.
    """

    radii: tuple[float, float]
    length: float
    direction: float
    carrier: str | None = None

    is_span, is_driven = True, False

    def loop_form(self) -> LoopForm:
        """
        The straight part, and the step between the radii; the last tie is what its wheels unwind.

        That is s' = r_one (φ' - θ_one') - r_other (φ' - θ_other').
        """
        (first, last), angle = self.radii, f'{self.name}.angle'
        straight, step = Term(1.0, 0.0, angle, self.name), Term(first - last, np.pi / 2, angle)
        weights = {self.name: 1.0, angle: last - first, self.one: first, self.other: -last}
        ties = [Tie(weights, self.length + (last - first) * self.direction)]
        if self.carrier is not None:
            held = Tie({angle: 1.0, self.carrier: -1.0}, self.direction)
            ties[:0] = Tie({self.name: 1.0}, self.length), held
        terms = (straight,) if first == last else (straight, step)
        return LoopForm((self.name, angle), terms, tuple(ties), (None, None, ALONG))

    def contact(self, one: Pose, other: Pose) -> Contact:
        """Where the strand leaves the wheel of `other`, and its direction."""
        hub = other.point(self.b)
        axis = strand(self, hub - one.point(self.a))[1]
        return hub + 1j * self.radii[1] * axis, axis

    def center(self) -> Center:
        """Anywhere on the strand."""
        return Center('line', f'the strand of {self.name}', 1.0)

    def rims(self) -> tuple[Rim, ...]:
        """Its wheels."""
        first, last = map(abs, self.radii)
        wheels = Rim(self.one, self.a, first), Rim(self.other, self.b, last)
        return tuple(wheel for wheel in wheels if wheel.radius)

    def own_values(self, between: complex, angles: Mapping[str, float]) -> dict[str, float]:
        """The strand between the hubs, whose direction is within half a turn of `direction`."""
        length, axis = strand(self, np.asarray(between))
        near = self.direction + angles.get(self.carrier or GROUND, 0.0)
        angle = near + float(np.angle(axis * np.exp(-1j * near)))
        return {self.name: float(length), f'{self.name}.angle': angle}

    @property
    def is_carried(self) -> bool:
        """Whether one body has both hubs."""
        return self.carrier is not None


def strand(joint: Belt, hubs: Complex) -> tuple[Real, Complex]:
    """Length and direction, complex of length 1, of a belt's strand, from hub to hub (complex)."""
    step = joint.radii[0] - joint.radii[1]
    length = np.sqrt(np.maximum(np.abs(hubs) ** 2 - step**2, 0.0))
    return length, hubs / (length + 1j * step)
