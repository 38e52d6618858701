"""What robot stacks read: the frames of the bodies on /tf, and joints between them."""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from kinpole_ros.messages._cdr import joint_data, stamped_doubles
from kinpole_ros.messages._loci import Build, Built
from kinpole_ros.pipeline.estimate import Estimate
from kinpole_ros.pipeline.parameters import GROUND
from kinpole_ros.rigid.plane import Plane

TF = '/tf'
"""The topic of frames, the same for all nodes."""
# Instants, as an index of arrays.
Chosen: TypeAlias = slice | np.ndarray


def frame_poses(estimate: Estimate, b: int, chosen: Chosen, given: Plane) -> np.ndarray:
    """
    Where the frame of body `b` is at `chosen` instants, (t, 7): a point, m, and a quaternion.

    In the frame of the markers; `given` is the plane of an estimate that does not say where it is.
    """
    plane = estimate.plane or given
    turn = np.exp(0.5j * estimate.angle[0, chosen, b])
    found = np.empty((len(turn), 7))
    found[:, :3] = plane.in_space(estimate.origin(0)[chosen, b], estimate.height[chosen, b])
    found[:, 3:6], found[:, 6] = plane.along_normal(turn.imag), turn.real
    return found


def frames(names: Sequence[str], given: Plane) -> Build:
    """A message of /tf for each body, whose frame has the name of these, at each instant."""

    def build(estimate: Estimate) -> Built:
        made: list[tuple[int, bytes]] = []
        for b, name in enumerate(names):
            when = (estimate.missing[:, b] == '').nonzero()[0]
            if not len(when):
                continue
            figures = frame_poses(estimate, b, when, given)
            stamps = estimate.stamp[when]
            data = stamped_doubles(stamps, estimate.frame_id, figures, name, listed=True)
            made += zip(when.tolist(), data, strict=True)
        return _in_order(made)

    return build


def joint_states(
    joints: Mapping[str, tuple[str, str]], bodies: Sequence[str], deviation: bool
) -> Build:
    """
    Angles and rates of joints, each of its second body against its first; or their deviations.

    Of those whose bodies are known. Angles, rad, within half a turn, are 0 where the axes of the
    bodies' frames are parallel: those of a body that is learned are along the ground's where it is
    first seen.
    """
    names = list(joints)
    # The ground is one more body.
    number = {GROUND: len(bodies)} | {body: b for b, body in enumerate(bodies)}
    first, second = (np.array([number[pair[k]] for pair in joints.values()]) for k in (0, 1))

    def between(values: np.ndarray, join: Callable[..., np.ndarray], ground: object) -> np.ndarray:
        wide = np.concatenate((values, np.full((len(values), 1), ground)), axis=1)
        return join(wide[:, second], wide[:, first])

    def build(estimate: Estimate) -> Built:
        known = between(estimate.missing == '', np.logical_and, True)
        rate = estimate.rate(1)
        if deviation:
            variances = estimate.angle_covariance[0, 0], rate.variance
            found = [np.sqrt(between(each, np.add, 0.0)) for each in variances]
        else:
            angle = between(estimate.angle[0], np.subtract, 0.0)
            found = [np.angle(np.exp(1j * angle)), between(rate.value, np.subtract, 0.0)]
        made: list[tuple[int, bytes]] = []
        for seen in np.unique(known[known.any(axis=1)], axis=0):
            when = (known == seen).all(axis=1).nonzero()[0]
            called = [name for name, there in zip(names, seen, strict=True) if there]
            figures = (each[np.ix_(when, seen)] for each in found)
            data = joint_data(estimate.stamp[when], called, *figures)
            made += zip(when.tolist(), data, strict=True)
        return _in_order(made)

    return build


def _in_order(made: list[tuple[int, bytes]]) -> Built:
    """Messages by the instants that they are of."""
    made.sort(key=lambda row: row[0])
    return [when for when, _ in made], [data for _, data in made]
