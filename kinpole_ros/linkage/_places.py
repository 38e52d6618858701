"""The points of a linkage: pins at one place of a body are one, and each has a name."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import permutations

import numpy as np

from kinpole_ros.linkage._joints import Joint
from kinpole_ros.linkage._model import GROUND_NUMBER, LINE, Place
from kinpole_ros.linkage._poses import Pose
from kinpole_ros.linkage._rolling import Rolling
from kinpole_ros.planar import fit_pose
from kinpole_ros.tracking.thresholds import NEGLIGIBLE

# Two places of a body are one if they are no farther than so many deviations, or this share of the
# distance from the mean of the markers.
_SAME = 6.0
_NEAR = 0.01


def connected(joints: Sequence[Joint], rolling: Sequence[Rolling]) -> set[int]:
    """Bodies that joints connect with the ground, by number, the ground among them."""
    pairs = [(joint.one, joint.other) for joint in joints]
    pairs += [(wheel.one, wheel.other) for wheel in rolling]
    found = {GROUND_NUMBER}
    while more := {k for pair in pairs if found & {*pair} for k in pair} - found:
        found |= more
    return found


def make_places(
    bodies: Mapping[int, Pose], joints: Sequence[Joint], rolling: Sequence[Rolling]
) -> list[Place]:
    """Pins first, those on the ground named O, O2, ..., others A, B, ...; then the rest."""
    groups = _pin_groups([joint for joint in joints if joint.kind == 'pin'])
    of_ground = _names_of_ground()
    others = _names_of_others()
    places = []
    for on, deviation in groups:
        name = next(of_ground if GROUND_NUMBER in on else others)
        places.append(Place(name, 'pin', on, deviation))
    for joint in joints:
        if joint.kind in ('slot', 'slide'):
            name = next(others)
            places.append(Place(name, joint.kind, {joint.one: joint.on_one}, joint.deviation[0]))
            line = {joint.other: joint.on_other}
            places.append(Place(f'{name}{LINE}', joint.kind, line, joint.deviation[1]))
        elif joint.kind == 'trammel':
            for place in trammel_ends(joint):
                name = next(others)
                places.append(Place(name, 'trammel', {joint.one: place}, joint.deviation[0]))
            name = next(of_ground if joint.other == GROUND_NUMBER else others)
            at = {joint.other: joint.on_other}
            places.append(Place(name, 'trammel', at, joint.deviation[1]))
    for wheel in rolling:
        if wheel.arm == GROUND_NUMBER and not wheel.circle and bodies:
            name = next(others)
            places.append(Place(name, 'hub', {wheel.one: wheel.hub}, wheel.deviation))
            line = {wheel.other: wheel.at}
            places.append(Place(f'{name}{LINE}', 'slot', line, wheel.deviation))
    return places


def match_places(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Pair the markers of two drawings of one rigid body by their places alone.

    Parameters
    ----------
    one, other
        Places (m,) and (n,) of markers, complex, m, each in a frame of its own. The drawing with
        fewer markers is a part of the other one.

    Returns
    -------
    tuple of arrays or None
        Numbers (k,) of the paired markers in `one` and in `other`, k the smaller of m and n. None
        where no pose puts each marker on one of its own, to 1% of the size.

    """
    swap = len(one) > len(other)
    few, many = (other, one) if swap else (one, other)
    if len(few) < 2:
        return None
    # Each two markers of the larger drawing may be the two that are farthest apart in the smaller.
    first, last = np.unravel_index(np.abs(few[:, None] - few).argmax(), (len(few), len(few)))
    best, found = np.inf, None
    for begin, end in permutations(range(len(many)), 2):
        turn = np.exp(1j * np.angle((many[end] - many[begin]) / (few[last] - few[first])))
        middle = (many[begin] + many[end] - turn * (few[first] + few[last])) / 2
        nearest = np.abs(turn * few[:, None] + middle - many).argmin(axis=1)
        if len(set(nearest.tolist())) < len(few):
            continue
        residual = fit_pose(many[nearest], few, np.ones(len(few))).residual
        worst = float(np.abs(residual).max())
        if worst < best:
            best, found = worst, nearest
    if found is None or best > NEGLIGIBLE * abs(few[last] - few[first]):
        return None
    order = np.arange(len(few))
    return (found, order) if swap else (order, found)


def trammel_ends(joint: Joint) -> tuple[complex, complex]:
    """
    The ends of a diameter of a trammel's circle that move along the axes of the other body.

    b = α + |β| e^{iφ} moves in the direction (φ + γ) / 2 + 90 deg, where β = |β| e^{iγ}.
    """
    along = [
        joint.on_one + joint.radius * np.exp(1j * (2 * d - np.pi - joint.along))
        for d in (0, np.pi / 2)
    ]
    return complex(along[0]), complex(along[1])


def _pin_groups(pins: Sequence[Joint]) -> list[tuple[dict[int, complex], float]]:
    """Pins merged where they are at one place of a body: place by body, and the least deviation."""
    groups: list[tuple[dict[int, complex], float]] = []
    for pin in pins:
        ends = [(pin.one, pin.on_one, pin.other, pin.on_other)]
        ends.append((pin.other, pin.on_other, pin.one, pin.on_one))
        for body, place, far, there in ends:
            # The ground's origin is anywhere: only the distance on a moving body says how large.
            reach = abs(there if body == GROUND_NUMBER else place)
            home = next(
                (
                    group
                    for group in groups
                    if body in group[0]
                    and abs(group[0][body] - place)
                    < max(_SAME * np.hypot(group[1], pin.deviation[0]), _NEAR * reach)
                ),
                None,
            )
            if home is not None:
                home[0].setdefault(far, there)
                break
        else:
            groups.append(({pin.one: pin.on_one, pin.other: pin.on_other}, pin.deviation[0]))
    return groups


def _names_of_ground() -> Iterator[str]:
    yield 'O'
    number = 2
    while True:
        yield f'O{number}'
        number += 1


def _names_of_others() -> Iterator[str]:
    letters = [chr(code) for code in range(ord('A'), ord('Z') + 1) if chr(code) != 'O']
    yield from letters
    number = 2
    while True:
        yield from (f'{letter}{number}' for letter in letters)
        number += 1
