"""Errors of the stamps of frames by the motion: they move points along their paths, not across."""

from collections.abc import Callable, Sequence

import numpy as np

_FAST = 0.6  # of the fastest point of a frame: so fast are those that tell
_NEAR = 2  # frames from a repeat, where its stamps are tested
# Times the noise across the path. Noise goes 1.2 times as far along it, and a vibration that stops
# at each third frame of a drift 29 times and more.
_ALONG = 3.0
_ROUNDING = 1e-3  # of the way around a step, along which it is none


def stamp_error(
    points: np.ndarray,
    times: np.ndarray,
    repeats: np.ndarray,
    scales: Sequence[Callable[[np.ndarray], float]],
) -> float:
    """
    Return how far stamps (n,) are off near repeats, of a step, where it is no noise.

    `scales` return the size of errors, of which the largest counts.

    Each point is compared with the cubic through two frames before and after: stamps that are off
    move it along its path.
    """
    middle = np.unique(repeats[:, None] + np.arange(-_NEAR + 1, _NEAR + 1))
    middle = middle[(middle >= 2) & (middle < len(times) - 2)]
    if not len(middle):
        return 0.0
    along, across, step = path_errors(points, times, middle)
    errors = [(scale(along), scale(across)) for scale in scales]
    return max([own / step for own, other in errors if step and own > _ALONG * other], default=0.0)


def path_errors(
    points: np.ndarray, times: np.ndarray, middle: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return errors of fast points of frames along and across their paths, and their usual step."""
    others = np.array([-2, -1, 1, 2])
    near = times[middle[:, None] + others] - times[middle, None]
    predicted = 0.0
    for k in range(4):
        share = np.ones(len(middle))
        for j in range(4):
            if j != k:
                share = share * near[:, j] / (near[:, j] - near[:, k])
        predicted = predicted + share[:, None, None] * points[middle + others[k]]
    error = points[middle] - predicted
    path = (points[middle + 1] - points[middle - 1]) / 2
    length = np.linalg.norm(path, axis=-1)
    with np.errstate(invalid='ignore', divide='ignore'):
        is_fast = length > _FAST * np.nanmax(length, axis=1, initial=0.0)[:, None]
        along = np.where(is_fast, (error * path).sum(axis=-1) / length, np.nan)
        total = np.where(is_fast, (error**2).sum(axis=-1), np.nan)
        across = np.sqrt(np.maximum(total - along**2, 0) / max(points.shape[-1] - 1, 1))
    step = median_size(np.where(is_fast, length, np.nan))
    return along, across, step


def median_size(values: np.ndarray) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return float(np.median(finite)) if len(finite) else 0.0


def rms_size(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else 0.0


def largest_size(values: np.ndarray) -> float:
    """Return the standard deviation of which the largest values, but for 2%, would be."""
    finite = np.abs(values[np.isfinite(values)])
    return float(np.quantile(finite, 0.98)) / 2.33 if len(finite) else 0.0


def go_along_paths(points: np.ndarray, still: list[tuple[int, int]]) -> bool:
    """
    Return whether points (T, N, D) that hardly move go along their paths, as noise does not.

    `still` are the first and the last of frames between which they hardly move.
    """
    along, across, ways = [], [], []
    for first, last in still:
        step, way = points[last] - points[first], points[last + 1] - points[first - 1]
        way, seen = np.nan_to_num(way).ravel(), np.isfinite(step).sum()
        ways.append(float(way @ way))
        along.append(float(np.nan_to_num(step).ravel() @ way) ** 2 / max(ways[-1], 1e-300))
        across.append((float(np.nansum(step**2)) - along[-1]) / max(seen - 1, 1))
    least = max(_ALONG**2 * sum(across), _ROUNDING**2 * sum(ways))
    return sum(along) > least
