"""A linkage discovered from markers: its bodies, joints, and the named points of the joints."""

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, count, takewhile
from typing import NamedTuple

import numpy as np

from kinpole_ros.findings import Finding
from kinpole_ros.linkage._body_poses import GROUND, GROUND_NUMBER, BodyPoses
from kinpole_ros.linkage._found_joints import FoundJoint, FoundRolling
from kinpole_ros.linkage._motion_plane import MotionPlane
from kinpole_ros.linkage._record import Stamps
from kinpole_ros.linkage._space import SpaceBodies

# The name of a point that fixes a line ends with this. Any other point of the line would do.
LINE = '_line'
# Two points of a body are one if they are closer than this many deviations, or than this share of
# their distance from the mean of the markers.
_SAME_SIGMAS, _SAME_SHARE = 6.0, 0.01
# Lengths below this many deviations are not listed.
_MIN_LENGTH = 3
_BODY_NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]+')
_SEPARATORS = re.compile(r'[.:/ -]+')
_LETTERS = 'ABCDEFGHIJKLMNPQRSTUVWXYZ'


class Place(NamedTuple):
    """
    A named point of a linkage.

    Attributes
    ----------
    name
        O, O2, ... for pins on the ground; A, B, ... for other points.
    kind
        'pin', 'slot', 'slide', 'trammel' or 'hub'.
    on
        Its position by number of the body, complex, m: on a body from the mean of its markers, on
        the ground (-1) in the plane.
    deviation
        Standard deviation per axis, m.

    """

    name: str
    kind: str
    on: dict[int, complex]
    deviation: float


class Length(NamedTuple):
    """
    The distance of two points of a body.

    Attributes
    ----------
    body
        Name of the body.
    one, other
        Names of the points.
    value, deviation
        The distance and its standard deviation, m.

    """

    body: str
    one: str
    other: str
    value: float
    deviation: float


class Linkage(NamedTuple):
    """
    The result of `discover`: lengths in m, angles in rad, in the axes of the plane.

    Attributes
    ----------
    names, poses
        Names of the bodies, and their motion over T frames.
    markers, columns
        By body, names of its markers and their columns in `tracks`.
    fixed, single
        Columns of markers that stand still, and of markers that are of no body.
    tracks
        All markers (T, N), complex, NaN for none.
    seconds
        Times of the frames (T,), s.
    ordered
        Whether the names of the markers are identities.
    labels
        Names of the columns, '' without.
    plane
        The plane of the motion.
    scale
        Length of a unit of the source, m.
    stamps
        Interval and jitter of the stamps.
    frame_id
        Frame of the markers.
    joints, rolling
        Joints, and wheels and gears, between bodies by number; the ground is -1.
    places
        Named points of the joints.
    freedom
        Degrees of freedom by Gruebler's count.
    notes
        What could not be determined, and why.
    space
        Bodies and joints in space, in units of the source, if the bodies do not move in one plane;
        then there are no joints in the plane.

    """

    names: list[str]
    poses: list[BodyPoses]
    markers: list[list[str]]
    columns: list[list[int]]
    fixed: list[int]
    single: list[int]
    tracks: np.ndarray
    seconds: np.ndarray
    ordered: bool
    labels: list[str]
    plane: MotionPlane
    scale: float
    stamps: Stamps
    frame_id: str
    joints: list[FoundJoint]
    rolling: list[FoundRolling]
    places: list[Place]
    freedom: int
    notes: list[Finding]
    space: SpaceBodies | None = None

    def name(self, number: int) -> str:
        """Name of a body, or of the ground."""
        return GROUND if number == GROUND_NUMBER else self.names[number]

    def lengths(self) -> list[Length]:
        """Distances of the points of each body, those of the ground last."""
        lengths = []
        for number in (*range(len(self.names)), GROUND_NUMBER):
            points = [
                point
                for point in self.places
                if number in point.on and not point.name.endswith(LINE)
            ]
            if len(points) == 1 and number != GROUND_NUMBER:
                lengths.append(self._to_farthest_marker(number, points[0]))
            for a, b in combinations(points, 2):
                distance = float(abs(a.on[number] - b.on[number]))
                deviation = float(np.hypot(a.deviation, b.deviation))
                if distance > _MIN_LENGTH * deviation:
                    names = self.name(number), a.name, b.name
                    lengths.append(Length(*names, distance, deviation))
        return lengths

    def _to_farthest_marker(self, number: int, point: Place) -> Length:
        """The length that is shown of a body with one joint."""
        pose = self.poses[number]
        distances = np.abs(pose.shape - point.on[number])
        farthest = int(distances.argmax())
        marker_deviation = np.sqrt(pose.noise**2 / max(int(pose.seen.sum()), 1))
        deviation = float(np.hypot(point.deviation, marker_deviation))
        names = self.names[number], point.name, self.markers[number][farthest]
        return Length(*names, float(distances[farthest]), deviation)


def connected(joints: Sequence[FoundJoint], rolling: Sequence[FoundRolling]) -> set[int]:
    """Numbers of the bodies that joints connect with the ground, and the ground's."""
    pairs = [{joint.one, joint.other} for joint in joints]
    pairs += [{wheel.one, wheel.other} for wheel in rolling]
    numbers = {GROUND_NUMBER}
    while reached := {k for pair in pairs if numbers & pair for k in pair} - numbers:
        numbers |= reached
    return numbers


def name_points(
    bodies: Mapping[int, BodyPoses], joints: Sequence[FoundJoint], rolling: Sequence[FoundRolling]
) -> list[Place]:
    """Named points of joints, pins first; O, O2, ... are pins on the ground, A, B, ... others."""
    ground_names = (f'O{k}' if k > 1 else 'O' for k in count(1))
    names = _letters()
    points = []
    for on, deviation in merged_pins([joint for joint in joints if joint.kind == 'pin']):
        name = next(ground_names if GROUND_NUMBER in on else names)
        points.append(Place(name, 'pin', on, deviation))
    for joint in joints:
        if joint.kind in ('slot', 'slide'):
            name = next(names)
            points.append(Place(name, joint.kind, {joint.one: joint.on_one}, joint.deviation[0]))
            line = {joint.other: joint.on_other}
            points.append(Place(f'{name}{LINE}', joint.kind, line, joint.deviation[1]))
        elif joint.kind == 'trammel':
            for end in trammel_ends(joint):
                points.append(Place(next(names), 'trammel', {joint.one: end}, joint.deviation[0]))
            name = next(ground_names if joint.other == GROUND_NUMBER else names)
            center = {joint.other: joint.on_other}
            points.append(Place(name, 'trammel', center, joint.deviation[1]))
    for wheel in rolling:
        if wheel.arm == GROUND_NUMBER and not wheel.circle and bodies:
            name = next(names)
            points.append(Place(name, 'hub', {wheel.one: wheel.hub}, wheel.deviation))
            line = {wheel.other: wheel.at}
            points.append(Place(f'{name}{LINE}', 'slot', line, wheel.deviation))
    return points


def _letters() -> Iterator[str]:
    """A, B, ... without O, then A2, B2, ..."""
    yield from _LETTERS
    for number in count(2):
        yield from (f'{letter}{number}' for letter in _LETTERS)


def trammel_ends(joint: FoundJoint) -> tuple[complex, complex]:
    """
    The ends of a diameter of a trammel's circle that move along the axes of the other body.

    b = α + |β| e^{iφ} moves in the direction (φ + γ) / 2 + 90 deg, where β = |β| e^{iγ}.
    """
    first, second = (
        complex(joint.on_one + joint.radius * np.exp(1j * (2 * axis - np.pi - joint.along)))
        for axis in (0, np.pi / 2)
    )
    return first, second


def merged_pins(pins: Sequence[FoundJoint]) -> list[tuple[dict[int, complex], float]]:
    """Pins as points by body, those at one point of a body merged, with the least deviation."""
    points: list[tuple[dict[int, complex], float]] = []
    for pin in pins:
        ends = [(pin.one, pin.on_one, pin.other, pin.on_other)]
        ends.append((pin.other, pin.on_other, pin.one, pin.on_one))
        for body, here, partner, on_partner in ends:
            # The ground's origin is arbitrary, so the size is that on the moving body.
            size = abs(on_partner if body == GROUND_NUMBER else here)
            match = next(
                (
                    on
                    for on, deviation in points
                    if body in on
                    and abs(on[body] - here)
                    < max(_SAME_SIGMAS * np.hypot(deviation, pin.deviation[0]), _SAME_SHARE * size)
                ),
                None,
            )
            if match is not None:
                match.setdefault(partner, on_partner)
                break
        else:
            points.append(({pin.one: pin.on_one, pin.other: pin.on_other}, pin.deviation[0]))
    return points


def body_names(labels: list[list[str]]) -> list[str]:
    """A name for each body: how the names of its markers begin, else body_1, body_2, ..."""
    names = [_common_prefix(markers) for markers in labels]
    return [
        name if name and name != GROUND and names.count(name) == 1 else f'body_{k}'
        for k, name in enumerate(names, 1)
    ]


def _common_prefix(labels: list[str]) -> str:
    spaces = [label.rpartition('/')[0] or label for label in labels]
    # The first and the last in alphabetical order differ the most.
    letters = zip(min(spaces), max(spaces), strict=False)
    name = ''.join(a for a, _ in takewhile(lambda pair: pair[0] == pair[1], letters))
    name = _SEPARATORS.sub('_', name.rstrip('0123456789').rstrip('_-/. '))
    return name if _BODY_NAME.fullmatch(name) else ''


def marker_names(labels: list[str], bodies: list[list[int]], names: list[str]) -> list[list[str]]:
    """Names of the markers of each body: as short as is unique, or NAME_1, NAME_2, ..."""
    short = {}
    spaces = [label.rpartition('/')[0] for label in labels]
    for label, space in zip(labels, spaces, strict=True):
        short[label] = space if space and spaces.count(space) == 1 else label
    named: dict[int, str] = {}
    result = []
    for name, body in zip(names, bodies, strict=True):
        for number, k in enumerate(body, 1):
            # A marker on the axis of a pin is of two bodies, by one name.
            named.setdefault(k, short[labels[k]] if labels[k] else f'{name}_{number}')
        result.append([named[k] for k in body])
    return result
