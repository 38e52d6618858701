"""
The map from the picture to the plane of motion, from tags of known size in that plane.

One small tag tells little about the perspective of the whole picture. All tags do, as each must be
a square of its size wherever it is seen. The map that fits them best is found by least squares; the
tag on the ground then gives origin and axes.
"""

from typing import NamedTuple

import numpy as np

_MOST_SEEN = 2000  # squares that are fitted
_OF_A_PLACE = 5  # of one tag at one place
_ROUNDS = 30
_HUBER = 2.0  # robust scales of a residual beyond which it counts less
# A lens without a file may bend straight lines so far (standard deviation): 2% at the corners.
_BENDING = 0.02
_LEANING = 0.3  # the same for perspective: a camera that looks at the plane from its side
_SQUARE = np.array([-1 + 1j, 1 + 1j, 1 - 1j, -1 - 1j]) / 2


class PlaneMap(NamedTuple):
    """
    The map from pixels to the plane.

    `center` and `scale` make pixels numbers of about 1, y up; `bending` is the radial distortion
    k1 of these, `matrix` (3, 3) maps the straight ones to m. `residual` is how far a corner is off
    its square, pixels rms.
    """

    center: np.ndarray
    scale: float
    bending: float
    matrix: np.ndarray
    residual: float = 0.0

    def to_plane(self, pixels: np.ndarray) -> np.ndarray:
        """Return points of the plane (...), complex, m, under pixels (..., 2)."""
        numbers = (pixels - self.center) * (1, -1) / self.scale
        numbers = numbers * (1 + self.bending * (numbers**2).sum(axis=-1, keepdims=True))
        x, y, w = np.moveaxis(_homogeneous(numbers) @ self.matrix.T, -1, 0)
        with np.errstate(invalid='ignore'):
            return np.asarray((x + 1j * y) / w)

    def to_pixels(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels (..., 2) of points (...), complex, m; NaN behind the camera."""
        flat = np.stack((points.real, points.imag), axis=-1)
        numbers = _homogeneous(flat) @ np.linalg.inv(self.matrix).T
        depth = numbers[..., 2:]
        straight = numbers[..., :2] / np.where(depth > 0, depth, np.nan)
        bent = straight
        for _ in range(20):
            bent = straight / (1 + self.bending * (bent**2).sum(axis=-1, keepdims=True))
        return np.asarray(bent * (1, -1) * self.scale + self.center)

    def moved(self, place: complex, turn: float) -> 'PlaneMap':
        """Return the map to axes at `place` that are turned by `turn`, rad."""
        c, s = np.cos(turn), np.sin(turn)
        back = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        shift = np.array([[1, 0, -place.real], [0, 1, -place.imag], [0, 0, 1]])
        return self._replace(matrix=back @ shift @ self.matrix)


def map_of_ruler(ends: np.ndarray, length: float) -> PlaneMap:
    """Return the map of a camera square to the plane: from ends[0], x to ends[1], `length` m."""
    along = (ends[1] - ends[0]) @ (1, -1j)
    plane = PlaneMap(ends[0], float(abs(along)), 0.0, np.diag([length, length, 1.0]))
    return plane.moved(0j, float(np.angle(along)))


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.concatenate((points, np.ones((*points.shape[:-1], 1))), axis=-1)


def different_views(pixels: np.ndarray) -> np.ndarray:
    """
    Return corners (N, 4, 2) of the tags (T, n, 4, 2) that are seen, a few of each place.

    A tag that stands still tells no more in many pictures, which repeat its error.
    """
    is_seen = np.isfinite(pixels).all(axis=(2, 3))
    corners, (_, tag) = pixels[is_seen], np.nonzero(is_seen)
    side = np.median(np.linalg.norm(np.diff(corners, axis=1), axis=-1))
    cells = np.floor(corners.mean(axis=1) / (side / 2)).astype(int)
    _, cell = np.unique(np.column_stack((tag, cells)), axis=0, return_inverse=True)
    order = np.argsort(cell.reshape(-1), kind='stable')
    ordered = cell.reshape(-1)[order]
    rank = np.arange(len(order)) - ordered.searchsorted(ordered)
    return corners[order[rank < _OF_A_PLACE]]


def fit_plane(
    corners: np.ndarray, size: float, picture: tuple[int, int], has_lens: bool
) -> PlaneMap:
    """
    Fit the map to tags (N, 4, 2), pixels, that are squares of `size`, m.

    `picture` is its width and height; `has_lens` says that the lens was corrected.
    """
    step = max(1, len(corners) // _MOST_SEEN)
    corners = corners[::step]
    center, scale = np.array(picture) / 2 - 0.5, max(picture) / 2
    side = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
    pixel = size / np.median(side)  # m
    start = pixel * scale

    def mapped(values: np.ndarray) -> PlaneMap:
        a, b, c, g, h, bending = values
        matrix = np.array([[a * start, b * start, 0], [0, c * start, 0], [g, h, 1]])
        return PlaneMap(center, scale, bending, matrix)

    def residuals(values: np.ndarray) -> np.ndarray:
        """Return how far corners are off their squares (N, 8), pixels."""
        with np.errstate(all='ignore'):
            off = off_square(mapped(values).to_plane(corners), size) / pixel
        return np.nan_to_num(np.concatenate((off.real, off.imag), axis=-1), nan=1e3)

    values = np.array([1.0, 0, 1, 0, 0, 0])
    free = 5 if has_lens else 6
    known = np.array([np.inf, np.inf, np.inf, _LEANING, _LEANING, _BENDING])
    now = residuals(values)
    damping = 1e-3
    for _ in range(_ROUNDS):
        columns = []
        for k in range(free):
            other = values.copy()
            other[k] += 1e-6
            columns.append((residuals(other) - now).ravel() / 1e-6)
        jacobian = np.stack(columns, axis=-1)
        spread = 1.4826 * np.median(np.abs(now)) + 1e-9
        weight = np.minimum(1, _HUBER * spread / np.maximum(np.abs(now), 1e-12)).ravel()
        prior = (spread / known[:free]) ** 2
        normal = jacobian.T @ (weight[:, None] * jacobian) + np.diag(prior)
        right = jacobian.T @ (weight * now.ravel()) + prior * values[:free]
        step_values = np.zeros(6)
        step_values[:free] = -np.linalg.lstsq(
            normal + damping * np.diag(np.diagonal(normal)), right, rcond=None
        )[0]
        other = values + step_values
        trial = residuals(other)
        gain = _cost(now, spread) - _cost(trial, spread)
        gain += float(prior @ (values[:free] ** 2 - other[:free] ** 2)) / 2
        if gain > 0:
            values, now, damping = other, trial, damping / 10
            if np.abs(step_values).max() < 1e-9:
                break
        else:
            damping *= 10
    # Three of eight coordinates fit the square.
    residual = float(np.sqrt(np.median(now**2) / 0.455 * 8 / 5))
    return mapped(values)._replace(residual=residual)


def _cost(residual: np.ndarray, spread: float) -> float:
    size, limit = np.abs(residual), _HUBER * spread
    return float(np.where(size < limit, size**2 / 2, limit * (size - limit / 2)).sum())


def square_poses(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centers and the turns (...), complex unit numbers, of squares (..., 4)."""
    center = corners.mean(axis=-1)
    turn = ((corners - center[..., None]) * np.conj(_SQUARE)).sum(axis=-1)
    return center, turn / np.abs(turn)


def off_square(corners: np.ndarray, size: float) -> np.ndarray:
    """Return how far corners (..., 4), complex, are off the nearest square of `size`, m."""
    center, turn = square_poses(corners)
    return corners - center[..., None] - size * turn[..., None] * _SQUARE
