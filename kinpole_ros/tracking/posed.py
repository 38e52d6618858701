"""
Bodies whose poses come as such, in place of markers.

Each pose stands for three points fixed to its body, which fit exactly. The noise is that of the
poses: of the angle, and of the point whose error is independent of that of the angle.
"""

import numpy as np

from kinpole_ros.rigid._pose_noise import PoseNoise
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.history import History

# Frames that the noise is estimated from.
NOISE_FRAMES = 512


class TiltedTurns:
    """
    Turns of B bodies about the normal beyond those of their headings, as they tilt.

    `total` (B,), rad, is the sum up to the last frame that is sure.
    """

    def __init__(self, bodies: int) -> None:
        self.total = np.zeros(bodies)
        self._heading = np.full(bodies, np.nan)
        self._tilt = np.full(bodies, complex(np.nan, np.nan))

    def follow(self, heading: np.ndarray, tilt: np.ndarray, sure: np.ndarray) -> np.ndarray:
        """The turns (B,), rad, up to a frame; those of bodies that are not `sure` are not kept."""
        turns = self.total + extra_turns(self._tilt, tilt, heading - self._heading)
        self.total = np.where(sure, turns, self.total)
        self._heading = np.where(sure, heading, self._heading)
        self._tilt = np.where(sure, tilt, self._tilt)
        return turns


def learn_poses(bodies: Bodies, history: History, given: float) -> None:
    """Update the noise of the poses, and what follows from it; `given`, m, is that of a position."""
    rows = slice(-NOISE_FRAMES, None)
    known = history['information'][rows, 0] > 0
    measured = PoseNoise(bodies.count)
    measured.add(
        history['time'][rows],
        np.where(known, history['position'][rows], np.nan),
        np.where(known, history['angle'][rows], np.nan),
    )
    bodies.angle_noise = measured.angle
    bodies.lasting = measured.underestimated
    bodies.noise = measured.position
    if given > 0:
        bodies.noise = np.where(np.isnan(measured.angle), np.nan, given)
    # How far markers with such noise would be from their mean.
    arm = bodies.noise / bodies.angle_noise
    scale = np.stack((arm**2, arm**2 / (arm**2 + np.abs(measured.middle) ** 2)))
    bodies.scale = np.where(np.isnan(scale), 1.0, scale)
    bodies.misfit = np.nan_to_num(bodies.noise**2)
    bodies.update()
    bodies.middle, bodies.size = measured.middle, 2 * arm


def extra_turns(before: np.ndarray, after: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """
    Compute how far bodies turned about the normal beyond the turn of their headings.

    The heading is the twist about the normal in the swing-twist decomposition. While a body is
    tilted, its rate is not the angular velocity along the normal, and the integral of the
    difference depends on the path: it does not return to zero with the pose.

    Parameters
    ----------
    before, after : array, shape (T, B), complex
        The tilts at the begin and the end of a rotation with constant angular velocity, as
        `Roster.tilts` returns them; NaN where not known.
    heading : array, shape (T, B), rad
        The change of the heading.

    Returns
    -------
    array, shape (T, B), rad
        The rotation vector along the normal less the change of the heading; 0 where not known.
    """
    # The quaternion of the rotation has the parts w + i z, `along`, and |x + i y|, `across`.
    cosines = [np.sqrt(np.maximum(1 - np.abs(tilt) ** 2, 0.0)) for tilt in (before, after)]
    ahead = cosines[0] * cosines[1] + after * before.conj()
    across = np.abs(cosines[0] * after - cosines[1] * before)
    turn = (heading + np.pi) % (2 * np.pi) - np.pi
    along = ahead * np.exp(0.5j * turn)
    sine = np.hypot(along.imag, across)
    with np.errstate(divide='ignore', invalid='ignore'):
        half = np.arctan2(sine, along.real) * (along.imag / sine)
        extra = 2 * np.angle(ahead) + 2 * (half - np.angle(along))
    return np.asarray(np.nan_to_num(extra))
