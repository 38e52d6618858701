"""
Derivatives of landmarks, each by itself, and the seeds' formulas on them (seed 000).

It costs a signal for each marker. The poses are what to use: this is there to compare with.
"""

import numpy as np

from kinpole_ros.derivatives import Derivatives, Poses, Windows, derive_poses
from kinpole_ros.planar import landmark_kinematics, to_complex
from kinpole_ros.planar._plane import Complex, Real


def derive_landmarks(
    time: np.ndarray,
    points: Complex,
    windows: Windows,
    noise: Real,
    window: float,
    order: int,
    effort: str = 'normal',
) -> Derivatives:
    """
    Derivatives of bodies at T instants, by their `points` (N, B, n), complex, m, NaN if not seen.

    `noise` (T, B) is that of one coordinate of a marker, m; the rest is as for `derive_poses`. The
    angle counts from the instant itself.
    """
    instants, bodies = noise.shape
    width = points.shape[-1]
    flat = points.reshape(len(points), -1)
    seen = np.where(np.isnan(flat), 0.0, 1.0)
    poses = Poses(time, np.zeros(flat.shape), np.zeros(flat.shape), flat, seen, seen)
    nothing = np.zeros((instants, bodies * width), int)
    rounding = np.finfo(float).eps * np.abs(flat[windows.now])
    noise = np.maximum(np.repeat(noise, width, axis=1), rounding)
    found = derive_poses(poses, windows, nothing, noise, window, order, effort)
    shape = instants, bodies, width
    position = found.position.reshape(-1, *shape)
    here = np.isfinite(position).all(axis=0) & (seen[windows.now] > 0).reshape(shape)
    landmarks = np.where(here, position, 0.0)[..., None].view(float)
    first, *given = landmarks
    motion = landmark_kinematics(first, *given, weights=here.astype(float))  # type: ignore[misc]
    covariance = found.position_covariance.reshape(*position.shape[:1], *position.shape)
    covariance = np.where(here, covariance, 0.0)
    with np.errstate(divide='ignore', invalid='ignore'):
        number = here.sum(axis=-1)
        arms = np.where(here, _squared_arms(landmarks[0], here), 0.0)
        of_position = covariance.sum(axis=-1) / number**2
        of_angle = (covariance * arms).sum(axis=-1) / arms.sum(axis=-1) ** 2
        span, freedom = (
            np.where(here, each.reshape(shape), 0.0).sum(axis=-1) / number
            for each in (found.span, found.freedom)
        )
    some = slice(order + 1)
    mean = to_complex(motion.position[some])
    return Derivatives(mean, motion.angle[some], of_position, of_angle, span, freedom)


def _squared_arms(points: Real, here: np.ndarray) -> Real:
    """Squared distances (..., n) of the markers that are here from their mean."""
    number = np.maximum(here.sum(axis=-1), 1)
    mean = (points * here[..., None]).sum(axis=-2) / number[..., None]
    return np.asarray(((points - mean[..., None, :]) ** 2).sum(axis=-1))
