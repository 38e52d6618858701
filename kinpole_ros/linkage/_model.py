"""What was found: bodies, what joins them and where, and what could not be determined."""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._joints import Joint
from kinpole_ros.linkage._plane import Plane
from kinpole_ros.linkage._poses import GROUND, Pose
from kinpole_ros.linkage._record import Stamps
from kinpole_ros.linkage._rolling import Rolling
from kinpole_ros.linkage._solid import GROUND_NUMBER
from kinpole_ros.linkage._space import SpaceBodies

# What the name of a point ends with that a line goes through: any point of it would do.
LINE = '_line'


class Place(NamedTuple):
    """
    A named point of the linkage: where it is on each body that has it, by number (-1: ground).

    On a body complex, m, about the mean of its markers; on the ground in the plane. `deviation` is
    per axis, m. `kind` is pin, slot, slide, trammel or hub.
    """

    name: str
    kind: str
    on: dict[int, complex]
    deviation: float


class Length(NamedTuple):
    """The distance of two places on a body, m."""

    body: str
    one: str
    other: str
    value: float
    deviation: float


class Linkage(NamedTuple):
    """
    All that `discover` finds; lengths in m, angles in rad, in the plane's axes.

    `names` are those of the bodies, `poses` their motion over the record's `seconds` (T,), and
    `markers` their markers' names, `columns` their columns of `tracks` (T, N). `joints` and
    `rolling` are between bodies by number, -1 for the ground. `places` are the points of the
    joints. `freedom` is Gruebler's count, `notes` what could not be determined, and why. `space`
    are the bodies and joints in space, in units of the source, where they do not move in one
    plane: then there are no joints in the plane.
    """

    names: list[str]
    poses: list[Pose]
    markers: list[list[str]]
    columns: list[list[int]]
    fixed: list[int]
    single: list[int]
    tracks: np.ndarray
    seconds: np.ndarray
    ordered: bool
    labels: list[str]
    plane: Plane
    scale: float
    stamps: Stamps
    frame_id: str
    joints: list[Joint]
    rolling: list[Rolling]
    places: list[Place]
    freedom: int
    notes: list[str]
    space: SpaceBodies | None = None

    def name(self, number: int) -> str:
        """Name of a body, the ground's too."""
        return GROUND if number == GROUND_NUMBER else self.names[number]

    def lengths(self) -> list[Length]:
        """Distances of the places of each body, the ground's last."""
        found = []
        for number in (*range(len(self.names)), GROUND_NUMBER):
            there = [place for place in self.places if number in place.on]
            # Where a line is begun to be measured along is anybody's choice.
            there = [place for place in there if not place.name.endswith(LINE)]
            if len(there) == 1 and number != GROUND_NUMBER:
                found += self._reach(number, there[0])
            for one, other in combinations(there, 2):
                distance = abs(one.on[number] - other.on[number])
                deviation = float(np.hypot(one.deviation, other.deviation))
                if distance > 3 * deviation:
                    found.append(
                        Length(self.name(number), one.name, other.name, float(distance), deviation)
                    )
        return found

    def _reach(self, number: int, place: Place) -> list[Length]:
        """The distance of a body's one joint to its farthest marker: its length is not known."""
        pose = self.poses[number]
        distances = np.abs(pose.shape - place.on[number])
        far = int(distances.argmax())
        marker = self.markers[number][far]
        known = np.sqrt(pose.noise**2 / max(int(pose.seen.sum()), 1))
        deviation = float(np.hypot(place.deviation, known))
        return [Length(self.names[number], place.name, marker, float(distances[far]), deviation)]
