"""Points of interest: those that a scene names and no joint uses, on the bodies as measured."""

import re
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage.theory import Theory, body_frames, on_tracked
from kinpole_ros.mechanism import GROUND, Force
from kinpole_ros.planar import covariance, point_motion
from kinpole_ros.tracking.estimate import Estimate, Vectors

# What a topic may be called.
_TOKEN = re.compile(r'[A-Za-z][A-Za-z0-9_]*')


class PointOfInterest(NamedTuple):
    """A point `name` on the tracked body `body` (complex, m, in the scene's frame of it)."""

    body: str
    name: str
    place: complex


def points_of_interest(theory: Theory) -> list[PointOfInterest]:
    """Those of tracked bodies whose names may be part of a topic's."""
    used = {
        end
        for joint in theory.scene.mechanism.assembly.joints
        for end in ((joint.one, joint.a), (joint.other, joint.b))
    }
    found = []
    for name, (body, place) in theory.scene.points.items():
        if body == GROUND or (body, place) in used:
            continue
        there = on_tracked(theory.scene, Force(body, place, 0.0), theory.places)
        last = name.rpartition('.')[2]
        if there.body in theory.places and _TOKEN.fullmatch(last):
            assert isinstance(there, Force)
            found.append(PointOfInterest(there.body, last, complex(there.point)))
    return found


def measured_point(
    theory: Theory, point: PointOfInterest, order: int, estimate: Estimate
) -> Vectors:
    """Where a point is (T,), m, or its derivative of `order` 1 to 4; where its body is known."""
    b = theory.places[point.body][0]
    frames = body_frames(theory, estimate)
    if point.body not in frames:
        none = np.full(np.shape(estimate.stamp), complex(np.nan, np.nan))
        return Vectors(none, np.zeros((*none.shape, 2, 2)), np.zeros(none.shape, bool))
    place, turn = frames[point.body]
    position, angle = estimate.position[..., b], estimate.angle[..., b]
    arm = place + point.place * np.exp(1j * turn) - estimate.reference[..., b]
    found = point_motion(order, arm, position, angle)
    spread = covariance(
        found, estimate.position_covariance[..., b], estimate.angle_covariance[..., b]
    )
    known = np.isfinite(found.value) & np.isfinite(spread).all(axis=(-2, -1))
    return Vectors(found.value, spread, known & (estimate.missing[..., b] == ''))
