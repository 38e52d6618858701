"""
Derivatives of landmarks, each by itself, and the seeds' formulas on them (seed 000).

It costs a signal for each marker, and markers that come and go part its windows; the poses of
`_poses` are what to use. It is there to compare with.
"""

import numpy as np

from kinpole_ros.planar import landmark_kinematics, to_plane
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.window._choice import differentiate
from kinpole_ros.window._runs import Windows, joined, runs
from kinpole_ros.window._spectrum import Spectrum


class LandmarkFilter:
    """Finds the derivatives of the poses of B bodies from those of their n landmarks."""

    def __init__(self) -> None:
        self._spectrum = Spectrum()

    def derivatives(
        self,
        stamps: np.ndarray,
        windows: Windows,
        points: Complex,
        noise: Real,
        order: int,
    ) -> tuple[Complex, Real, Real, Real, Real, Real]:
        """
        Derivatives up to `order` of bodies at T instants, by their `points`.

        These (frames, B, n) are NaN where not seen; `stamps` and `windows` are as in `runs`;
        `noise` (T, B) is that of one coordinate of a marker, m. Returns position and angle
        (K, T, B), their covariances (K, K, T, B) between orders, and span and degree (T, B) as of
        `Derivatives`; the angle counts from the instant itself.
        """
        bodies, width = points.shape[1:]
        signals = to_plane(points.reshape(len(points), -1))
        there = np.where(np.isfinite(signals[..., 0]), 1.0, 0.0)
        dimensions = np.full(bodies * width, 2)
        found = []
        for run in runs(stamps, windows, signals, there, np.repeat(noise, width, axis=1)):
            one = differentiate(*run, dimensions, order, self._spectrum)
            found.append((*np.moveaxis(one.values, -1, 0), *one[1:]))
        x, y, covariance, span, degree = joined(found)
        shape = len(noise), bodies, width
        derivatives = np.stack((x, y), axis=-1).reshape(order + 1, *shape, 2)
        here = np.asarray(np.isfinite(derivatives).all(axis=(0, -1)))
        landmarks, *given = np.where(here[..., None], derivatives, 0.0)
        motion = landmark_kinematics(landmarks, *given, weights=here.astype(float))  # type: ignore[misc]
        covariance = np.where(here, covariance.reshape(order + 1, order + 1, *shape), 0.0)
        with np.errstate(divide='ignore', invalid='ignore'):
            number = here.sum(axis=-1)
            arms = np.where(here, _squared_arms(landmarks, here), 0.0)
            position_covariance = covariance.sum(axis=-1) / number**2
            angle_covariance = (covariance * arms).sum(axis=-1) / arms.sum(axis=-1) ** 2
        return (
            motion.position[: order + 1].copy(),
            motion.angle[: order + 1].copy(),
            position_covariance,
            angle_covariance,
            span.reshape(shape).mean(axis=-1),
            degree.reshape(shape).mean(axis=-1),
        )


def _squared_arms(points: np.ndarray, here: np.ndarray) -> np.ndarray:
    """Squared distances (..., n) of the markers that are here from their mean."""
    number = np.maximum(here.sum(axis=-1), 1)
    mean = (points * here[..., None]).sum(axis=-2) / number[..., None]
    return np.asarray(((points - mean[..., None, :]) ** 2).sum(axis=-1))
