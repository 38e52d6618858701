"""
Poses of a scene's bodies as measured, frame by frame, with their covariances.

The tracker's frames lie anywhere in the bodies; the scene's markers tell how its own lie there.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism import Equations, part_sum
from kinpole_ros.planar import fit_pose
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.estimate import Estimate, FramePoses


class Lie(NamedTuple):
    """
    How a body of the scene lies among the tracked: it is their number `tracked`; `markers` (k,) of
    its markers are the scene's, at `known` (k,) in the scene's frame of it, complex, m.
    """

    tracked: int
    markers: np.ndarray
    known: Complex


class ScenePoses(NamedTuple):
    """
    Poses (T, B) of bodies in the plane of the markers: `position` (complex, m) and `angle` (rad).

    `cofactor` (T, B, 3, 3) is the covariance of x, y and angle over the square of the `noise`
    (T, B) of a marker, m; `seen` (T, B) is where all this is known, and `bodies` (B,) numbers them
    among those of the equations.
    """

    stamp: np.ndarray
    position: Complex
    angle: Real
    cofactor: Real
    noise: Real
    seen: np.ndarray
    bodies: tuple[int, ...]

    @property
    def covariance(self) -> Real:
        """That of x, y and angle (T, B, 3, 3)."""
        return self.cofactor * self.noise[..., None, None] ** 2

    def part(self, some: np.ndarray | slice) -> 'ScenePoses':
        """Some of the instants."""
        return self._replace(**{name: getattr(self, name)[some] for name in _BY_INSTANT})

    def of_bodies(self, some: np.ndarray) -> 'ScenePoses':
        """Some of the bodies, by where they are among the B."""
        parts = {name: getattr(self, name)[:, some] for name in _BY_INSTANT if name != 'stamp'}
        return self._replace(**parts, bodies=tuple(self.bodies[k] for k in some.tolist()))


_BY_INSTANT = ('stamp', 'position', 'angle', 'cofactor', 'noise', 'seen')


def scene_poses(
    equations: Equations, values: Real, lies: Mapping[str, Lie], estimate: Estimate
) -> ScenePoses | None:
    """
    The poses of the bodies of `equations` that estimates (T, B), or one (B,), tell, None if they
    keep none.

    Dimensions are at `values`, which place what is on one body.
    """
    if estimate.frame_poses is None:
        return None
    about = np.asarray(estimate.stamp), estimate.shape, estimate.missing, *estimate.frame_poses
    if not about[0].ndim:
        about = tuple(np.asarray(part)[None] for part in about)
    stamp, shapes, missing = about[:3]
    seen = FramePoses(*about[3:])
    parts, bodies = [], []
    for body, lie in lies.items():
        home, offset = equations.frames[body]
        number = equations.bodies.index(home)
        if number in bodies:
            continue
        bodies.append(number)
        b = lie.tracked
        marked = shapes[:, b, lie.markers]
        frame = fit_pose(marked, lie.known, np.isfinite(marked).astype(float))
        turn = np.exp(1j * frame.angle)
        origin = frame.position - turn * part_sum(offset, values)[0]
        known = (seen.angle_information[:, b] > 0) & (missing[:, b] == '')
        known &= np.isfinite(frame.angle)
        about_angle = 1 / np.where(known, seen.angle_information[:, b], 1.0)
        about_place = 1 / np.where(known, seen.position_information[:, b], 1.0)
        facing = np.exp(1j * seen.angle[:, b])
        middle = seen.middle[:, b]
        of_middle = np.maximum(about_place - np.abs(middle) ** 2 * about_angle, 0.0)
        arm = 1j * facing * (origin - middle)
        by_angle = np.stack((arm.real, arm.imag, np.ones(len(arm))), axis=-1)
        covariance = about_angle[:, None, None] * by_angle[:, :, None] * by_angle[:, None]
        covariance[:, [0, 1], [0, 1]] += of_middle[:, None]
        position = seen.position[:, b] + facing * origin
        angle = seen.angle[:, b] + frame.angle
        parts.append((position, angle, covariance, seen.noise[:, b], known))
    position, angle, cofactor, noise, known = (
        np.stack(part, axis=1) for part in zip(*parts, strict=True)
    )
    return ScenePoses(stamp, position, angle, cofactor, noise, known, tuple(bodies))


def concatenated(parts: Sequence[ScenePoses], most: int) -> ScenePoses:
    """
    All of them in one, of `most` instants at the most, evenly, with the noise as it was known but
    for the first quarter, when it was hardly known.
    """
    every = {name: np.concatenate([getattr(p, name) for p in parts]) for name in _BY_INSTANT}
    whole = parts[0]._replace(**every)
    for b in range(len(whole.bodies)):
        later = np.flatnonzero(whole.seen[:, b])
        later = later[len(later) // 4 :]
        whole.noise[:, b] = np.sqrt(np.mean(whole.noise[later, b] ** 2)) if len(later) else np.nan
    count = len(whole.stamp)
    return whole if count <= most else whole.part(np.arange(most) * count // most)
