"""The shape that most of the first frames of a body agree on, if some have outliers."""

from collections import Counter

import numpy as np

from kinpole_ros.planar import fit_pose
from kinpole_ros.planar._plane import Complex
from kinpole_ros.tracking.correction import correct_markers
from kinpole_ros.tracking.identity import predict_poses
from kinpole_ros.tracking.statistics import bulk_maximum, mean_square


def consensus_shape(
    points: Complex, sigmas: float, least: float
) -> tuple[Complex, Complex, Counter[str]] | None:
    """
    Find the shape of one body that most of its frames agree on, if some have outliers.

    The frame is taken as the shape that leaves the smallest residuals in all but the worst three
    tenths of the others. Frames with a marker beyond the limit are corrected, and the shape becomes
    the mean of all.

    Parameters
    ----------
    points : (T, n) complex
        Markers, m, NaN for none.
    sigmas, least : float
        Limit of a marker: so many times the rms residual, or this share of the size if larger.

    Returns
    -------
    shape : (n,) complex
        The shape, m.
    points : (T, n) complex
        The corrected markers, m.
    counts : Counter
        Numbers of corrected markers by kind. The result is None without outliers.

    """
    seen = ~np.isnan(points)
    count = seen.sum(axis=-1)
    full = points[count == count.max()]
    shared = (seen & ~np.isnan(full)[:, None]).astype(float)
    fits = fit_pose(np.broadcast_to(points, shared.shape), full[:, None], shared)
    squares = bulk_maximum(mean_square(fits.residual, fits.freedom)[0])
    best = int(np.where(np.isnan(squares), np.inf, squares).argmin())
    shape = full[best] - full[best, ~np.isnan(full[best])].mean()
    size = np.abs(shape[~np.isnan(shape)]).max()
    limit = max(sigmas * np.sqrt(squares[best]), least * size)
    residual = np.abs(fits.residual[best])
    worst = np.where(np.isnan(residual), 0.0, residual).max(axis=-1)
    if worst.max() <= limit:
        return None
    points, counts = points.copy(), Counter[str]()
    angles = np.where(worst > limit, np.nan, fits.angle[best])
    weights, limits = (~np.isnan(shape)).astype(float), np.full(len(shape), limit)
    middle = full[best, ~np.isnan(full[best])].mean()
    positions = fits.position[best] + np.exp(1j * fits.angle[best]) * middle
    for frame in np.flatnonzero(worst > limit):
        is_after = np.isfinite(angles[:frame]).any()
        before = slice(frame) if is_after else slice(None, frame, -1)
        known = angles[before, None], positions[before, None]
        predicted = predict_poses(np.arange(len(known[0]) + 1), *known)
        correction = correct_markers(points[frame], shape, weights, limits, predicted)
        points[frame] = correction.points
        counts.update(correction.counts)
    weights = (~np.isnan(points) & ~np.isnan(shape)).astype(float)
    residuals = fit_pose(points, np.broadcast_to(shape, points.shape), weights).residual
    fitted = ~np.isnan(residuals)
    mean = residuals.sum(axis=0, where=fitted) / np.maximum(fitted.sum(axis=0), 1)
    return np.where(np.isnan(shape), 0.0, shape + mean), points, counts
