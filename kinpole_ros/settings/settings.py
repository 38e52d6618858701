"""Parameters as the pipeline uses them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeAlias

# A normal, or the name of a plane of the axes; 'fit' for one that is found from the motion.
PlaneSetting: TypeAlias = str | tuple[float, float, float]
# Columns of a marker that span the plane, and the one along its normal.
AXES = {'xy': (0, 1, 2), 'yz': (1, 2, 0), 'zx': (2, 0, 1)}
FIT = 'fit'


# Of the types of messages, those that carry poses of bodies and not markers.
POSE_TYPES = ('pose_stamped', 'body_poses', 'tf')
# m, complex, of the points that stand for such a pose, in its frame. Figures do not depend on them;
# drawings show them. Their mean is the origin, so that it is not rounded by how the body is turned.
POSE_POINTS = (0.1 + 0j, 0.1j, -0.1 - 0.1j)


class ParameterError(ValueError):
    """A parameter that is unknown, or whose value cannot be used; the message has the fix."""


@dataclass(frozen=True)
class Settings:
    """Parameters as the pipeline uses them. `bodies` maps a name to its markers, () for all."""

    marker_topic: str = 'markers'
    marker_type: str = 'auto'
    marker_identity: str = 'auto'
    plane: PlaneSetting = 'xy'
    scale: float = 1.0
    bodies: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {'body': ()})
    window: float = 0.3
    lag: float = 0.1
    derivative_order: int | None = None
    noise: float = 0.0
    stamps: str = 'auto'
    effort: str = 'normal'
    method: str = 'pose'
    scene: str = ''
    # By name, of the second body, or the ground, against the first.
    joints: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    joint_state_rate: float = 0.0
    publish_tf: bool = False
    frame_prefix: str = ''
    # Of the bodies that have one given: places of their markers, complex, m.
    shapes: Mapping[str, tuple[complex, ...]] = field(default_factory=dict)
    # Of the bodies that have one given: the pin on the ground, in the frame of the shape and in the
    # plane, complex, m.
    pins: Mapping[str, tuple[complex, ...]] = field(default_factory=dict)

    @property
    def highest_order(self) -> int:
        """The highest derivative of all results, also of those that no live topic asks for."""
        return self.derivative_order or 4

    @cached_property
    def window_ns(self) -> int:
        """The window in ns."""
        return round(self.window * 1e9)


# The name of the ground in a joint.
GROUND = 'ground'


def canonical_name(name: str) -> str:
    """The name of a plane of the axes whichever of its two axes is named first."""
    return name if name in AXES else next((k for k in AXES if k[::-1] == name), name)
