"""Kennedy's theorem on measured bodies: three instant centers of three bodies are on a line."""

import numpy as np

from kinpole_ros import planar
from kinpole_ros.tracking.estimate import Estimate


def distances_from_pins_line(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """
    Return distances of relative centers from the line through the pins, for all pairs of bodies.

    In m, and in standard deviations. NaN unless both bodies are pinned: only pins are found
    without the velocities (`planar.kennedy_residual`).
    """
    j, i = estimate.pairs
    center = estimate.relative_icr
    even = estimate.pin_variance[..., None, None] * np.eye(2)
    distance, deviations = planar.kennedy_residual(
        np.stack((estimate.pin[..., i], estimate.pin[..., j], center.value)),
        np.stack((even[..., i, :, :], even[..., j, :, :], center.covariance)),
    )
    usable = estimate.pinned[..., i] & estimate.pinned[..., j] & center.determined
    return np.where(usable, distance, np.nan), np.where(usable, deviations, np.nan)
