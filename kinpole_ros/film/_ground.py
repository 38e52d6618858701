"""
The map from the picture to the plane of motion, from tags of known size in that plane.

One small tag tells little about the perspective of the whole picture. All tags do, as each must be
a square of its size wherever it is seen. The map that fits them best is found by least squares; the
tag on the ground then gives origin and axes. With a known camera the tags may be at different
heights above the plane: a tag that is nearer looks larger.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

_MOST_SEEN = 2000  # squares that are fitted
_OF_A_PLACE = 5  # of one tag at one place
_ROUNDS = 30
HUBER = 2.0  # robust scales of a residual beyond which it counts less
# A lens without a file may bend straight lines so far (standard deviation): 2% at the corners.
_BENDING = 0.02
_LEANING = 0.3  # the same for perspective: a camera that looks at the plane from its side
_HEIGHT = 0.05  # the same for the height of a tag, of the distance of the camera
_FOCAL = 0.01  # the same for the focal length of a calibration, of itself
_MOST_HEIGHTS = 100  # tags whose heights are fitted
_STEP = 1e-6  # of a value, for derivatives
_LEAST_HEIGHT = 2e-3  # of this distance, 2 mm in 1 m: what noise makes of tags at one height
MOST_OFF = 0.05  # of the side: a tag whose corners are farther off their square is partly hidden
SQUARE = np.array([-1 + 1j, 1 + 1j, 1 - 1j, -1 - 1j]) / 2


class PlaneMap(NamedTuple):
    """
    The map from pixels to the plane.

    `center` and `scale` make pixels numbers of about 1, y up; `bending` is the radial distortion
    k1 of these, `matrix` (3, 3) maps the straight ones to m. `residual` is how far a corner is off
    its square, pixels rms. The camera is above `foot`, complex, m, at a `distance`, m, infinite if
    it is not known.
    """

    center: np.ndarray
    scale: float
    bending: float
    matrix: np.ndarray
    residual: float = 0.0
    foot: complex = 0j
    distance: float = np.inf

    def to_plane(self, pixels: np.ndarray, height: np.ndarray | float = 0.0) -> np.ndarray:
        """Return points (...), complex, m, under pixels (..., 2), `height` m above the plane."""
        numbers = (pixels - self.center) * (1, -1) / self.scale
        numbers = numbers * (1 + self.bending * (numbers**2).sum(axis=-1, keepdims=True))
        x, y, w = np.moveaxis(_homogeneous(numbers) @ self.matrix.T, -1, 0)
        with np.errstate(invalid='ignore'):
            points = (x + 1j * y) / w
            return np.asarray(points + (self.foot - points) * height / self.distance)

    def to_pixels(self, points: np.ndarray, height: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the pixels (..., 2) of points (...), complex, m; NaN behind the camera."""
        rest = 1 - height / self.distance
        points = self.foot + (points - self.foot) / rest
        flat = np.stack((points.real, points.imag), axis=-1)
        numbers = _homogeneous(flat) @ np.linalg.inv(self.matrix).T
        depth = numbers[..., 2:]
        # A point that is higher than the camera is beyond the plane of its own pixel.
        is_seen = depth * np.sign(np.broadcast_to(rest, points.shape))[..., None] > 0
        straight = numbers[..., :2] / np.where(is_seen, depth, np.nan)
        bent = straight
        for _ in range(20):
            bent = straight / (1 + self.bending * (bent**2).sum(axis=-1, keepdims=True))
        return np.asarray(bent * (1, -1) * self.scale + self.center)

    def moved(self, place: complex, turn: float) -> 'PlaneMap':
        """Return the map to axes at `place` that are turned by `turn`, rad."""
        c, s = np.cos(turn), np.sin(turn)
        back = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        shift = np.array([[1, 0, -place.real], [0, 1, -place.imag], [0, 0, 1]])
        foot = (self.foot - place) * (c - 1j * s)
        return self._replace(matrix=back @ shift @ self.matrix, foot=foot)


def map_of_ruler(ends: np.ndarray, length: float) -> PlaneMap:
    """Return the map of a camera square to the plane: from ends[0], x to ends[1], `length` m."""
    along = (ends[1] - ends[0]) @ (1, -1j)
    plane = PlaneMap(ends[0], float(abs(along)), 0.0, np.diag([length, length, 1.0]))
    return plane.moved(0j, float(np.angle(along)))


# A map from some numbers, their start, and how well they are known beforehand (deviations).
_Model: TypeAlias = tuple[Callable[[np.ndarray], PlaneMap], list[float], list[float]]


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.concatenate((points, np.ones((*points.shape[:-1], 1))), axis=-1)


def different_views(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Return corners (N, 4, 2) of the tags (T, n, 4, 2) that are seen, a few of each place.

    The second array (N,) has the columns of these tags. A tag that stands still tells no more in
    many pictures, which repeat its error.
    """
    is_seen = np.isfinite(pixels).all(axis=(2, 3))
    corners, (_, tag) = pixels[is_seen], np.nonzero(is_seen)
    side = np.median(np.linalg.norm(np.diff(corners, axis=1), axis=-1))
    cells = np.floor(corners.mean(axis=1) / (side / 2)).astype(int)
    _, cell = np.unique(np.column_stack((tag, cells)), axis=0, return_inverse=True)
    order = np.argsort(cell.reshape(-1), kind='stable')
    ordered = cell.reshape(-1)[order]
    rank = np.arange(len(order)) - ordered.searchsorted(ordered)
    kept = order[rank < _OF_A_PLACE]
    return corners[kept], tag[kept]


def fit_plane(
    corners: np.ndarray,
    tags: np.ndarray,
    size: float,
    picture: tuple[int, int],
    camera: np.ndarray | None,
) -> tuple[PlaneMap, np.ndarray]:
    """
    Fit the map to tags (N, 4, 2), pixels, that are squares of `size`, m.

    `tags` are their columns, `picture` is its width and height, and `camera` the matrix (3, 3) of a
    camera whose lens was corrected. Also returns the heights (n,), m, of the columns.
    """
    step = max(1, len(corners) // _MOST_SEEN)
    corners, tags = corners[::step], tags[::step]
    side = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
    pixel = float(size / np.median(side))  # m
    count = int(tags.max()) + 1
    if camera is not None and count <= _MOST_HEIGHTS:
        plane, heights = _fit(_known_camera(camera, picture, pixel), corners, tags, size)
        if np.ptp(heights) > _LEAST_HEIGHT:
            return plane, heights * plane.distance
    plane, _ = _fit(_shapes_only(picture, pixel, camera is None), corners, 0 * tags[:0], size)
    return plane, np.zeros(count)


def _fit(
    model: _Model, corners: np.ndarray, tags: np.ndarray, size: float
) -> tuple[PlaneMap, np.ndarray]:
    """
    Fit a map to tags (N, 4, 2), and a height for each column in `tags` (N,), if it is not empty.

    The heights are parts of the distance of the camera.
    """
    mapped, start, known = model
    free, count = len(start), int(tags.max()) + 1 if len(tags) else 0
    pixel = size / np.median(np.linalg.norm(np.diff(corners, axis=1), axis=-1))

    def residuals(values: np.ndarray) -> np.ndarray:
        """Return how far corners are off their squares (N, 8), pixels."""
        nearer = 1 - values[free:][tags, None] if count else 1.0
        with np.errstate(all='ignore'):
            points = mapped(values[:free]).to_plane(corners) * nearer
            off = off_square(points, size) / pixel
        return np.nan_to_num(np.concatenate((off.real, off.imag), axis=-1), nan=1e3)

    def slopes(values: np.ndarray, now: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals (8 N, K)."""
        slope = np.zeros((*now.shape, free + count))
        for k in range(free):
            slope[..., k] = residuals(values + _STEP * (np.arange(len(values)) == k)) - now
        if count:  # a height moves its own tag alone
            other = residuals(values + _STEP * (np.arange(len(values)) >= free)) - now
            slope[np.arange(len(now)), :, free + tags] = other
        return slope.reshape(now.size, -1) / _STEP

    prior = np.array(known + [_HEIGHT] * count)
    values, residual = _least_squares(residuals, slopes, np.array(start + [0.0] * count), prior)
    return mapped(values[:free])._replace(residual=residual), values[free:]


def _shapes_only(picture: tuple[int, int], pixel: float, may_bend: bool) -> _Model:
    """Return the map of a camera of which nothing is known, from six numbers; the last bends it."""
    center, scale = np.array(picture) / 2 - 0.5, max(picture) / 2
    start = pixel * scale

    def mapped(values: np.ndarray) -> PlaneMap:
        a, b, c, g, h, bending = values
        matrix = np.array([[a * start, b * start, 0], [0, c * start, 0], [g, h, 1]])
        return PlaneMap(center, scale, bending, matrix)

    return (
        mapped,
        [1.0, 0, 1, 0, 0, 0],
        [np.inf] * 3 + [_LEANING] * 2 + [_BENDING if may_bend else 1e-9],
    )


def _known_camera(camera: np.ndarray, picture: tuple[int, int], pixel: float) -> _Model:
    """Return the map of a camera, from two tilts, rad, log of distance, and log of focal length."""
    center, scale = np.array(picture) / 2 - 0.5, max(picture) / 2
    to_pixels = np.array([[scale, 0, center[0]], [0, -scale, center[1]], [0, 0, 1]])
    start = pixel * camera[0, 0]

    def mapped(values: np.ndarray) -> PlaneMap:
        (a, b), (c, d) = np.cos(values[:2]), np.sin(values[:2])
        # The axes of the plane, as the camera sees them: right, down and away.
        x, y = np.array([b, 0, d]), np.array([c * d, -a, -c * b])
        away = np.array([0, 0, start * np.exp(values[2])])
        above = -np.array([x, y, np.cross(x, y)]) @ away
        focal = np.diag([np.exp(values[3]), np.exp(values[3]), 1])
        seen = camera @ focal @ np.column_stack((x, y, away))
        matrix = np.linalg.inv(seen) @ to_pixels
        matrix = matrix / matrix[2, 2]
        return PlaneMap(center, scale, 0.0, matrix, 0.0, above[0] + 1j * above[1], above[2])

    return mapped, [0.0] * 4, [_LEANING] * 2 + [np.inf, _FOCAL]


def _least_squares(
    residuals: Callable[[np.ndarray], np.ndarray],
    slopes: Callable[[np.ndarray, np.ndarray], np.ndarray],
    values: np.ndarray,
    known: np.ndarray,
) -> tuple[np.ndarray, float]:
    """
    Return the values (K,) with the least robust residuals (N, 8), and their spread.

    `known` are the standard deviations of what is known of the values beforehand, about the start.
    """
    start, now, damping = values, residuals(values), 1e-3
    for _ in range(_ROUNDS):
        jacobian = slopes(values, now)
        spread = 1.4826 * np.median(np.abs(now)) + 1e-9
        weight = np.minimum(1, HUBER * spread / np.maximum(np.abs(now), 1e-12)).ravel()
        prior = (spread / known) ** 2
        normal = jacobian.T @ (weight[:, None] * jacobian) + np.diag(prior)
        right = jacobian.T @ (weight * now.ravel()) + prior * (values - start)
        damped = normal + damping * np.diag(np.diagonal(normal))
        other = values - np.linalg.lstsq(damped, right, rcond=None)[0]
        trial = residuals(other)
        gain = robust_cost(now, spread) - robust_cost(trial, spread)
        gain += float(prior @ ((values - start) ** 2 - (other - start) ** 2)) / 2
        if gain > 0:
            is_done = np.abs(other - values).max() < 1e-9
            values, now, damping = other, trial, damping / 10
            if is_done:
                break
        else:
            damping *= 10
    # Three of eight coordinates fit the square.
    return values, float(np.sqrt(np.median(now**2) / 0.455 * 8 / 5))


def robust_cost(residual: np.ndarray, spread: float) -> float:
    """Return half the sum of squares, beyond `HUBER` spreads that of sizes."""
    size, limit = np.abs(residual), HUBER * spread
    return float(np.where(size < limit, size**2 / 2, limit * (size - limit / 2)).sum())


def square_poses(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centers and the turns (...), complex unit numbers, of squares (..., 4)."""
    center = corners.mean(axis=-1)
    turn = ((corners - center[..., None]) * np.conj(SQUARE)).sum(axis=-1)
    with np.errstate(invalid='ignore'):
        return center, turn / np.abs(turn)


def off_square(corners: np.ndarray, size: float) -> np.ndarray:
    """Return how far corners (..., 4), complex, are off the nearest square of `size`, m."""
    center, turn = square_poses(corners)
    return corners - center[..., None] - size * turn[..., None] * SQUARE


def leave_out_hidden(corners: np.ndarray, size: float) -> None:
    """Set the corners (..., 4) of tags that are no squares of `size`, m, to NaN, in place."""
    with np.errstate(invalid='ignore'):
        off = np.abs(off_square(corners, size)).max(axis=-1)
    corners[~(off < MOST_OFF * size)] = np.nan
