"""
Tags that turn out of the plane of the picture: doors, lids, knees seen from their side.

With a known camera the pose of a tag in space follows from its four corners. In a planar motion a
tag keeps its lean and its height over the plane, and only moves and turns in it. The plane, the
leans and heights, and the motion in the plane are fitted to the corners of the whole film.

The pose of a tag is known far less along the line of sight than across it, and its corners share
the error, which they do not show. So corners are scattered about the fitted pose, which stays as it
is, as independent corners would be that determine it no better: then results from them have
deviations that are large enough.
"""

from typing import NamedTuple

import cv2
import numpy as np

from kinpole_ros.film._ground import HUBER, MOST_OFF, SQUARE, PlaneMap, robust_cost

_ROUNDS = 30
_POSE_ROUNDS = 5  # by which one of the two poses is chosen that show a square alike
_MOST_VIEWS = 3000  # of tags by which the plane is found
_LEAST_VIEWS = 20
_PARTS = 10  # of a film, whose errors are independent
_STEP = 1e-6  # rad and m, for derivatives
# The normal points to the camera, or upward if it is in the picture, or else to the right.
_SIDE = np.array([0.1, -0.5, -1.0])


class Turning(NamedTuple):
    """
    Tags (n) of T pictures in the plane of motion.

    `corners` (T, n, 4), complex, m, are scattered as their poses are uncertain, NaN for none.
    `heights` (n, 4), m, are those of corners over the `plane`, of which `normal` (3,) is in the
    axes of the camera: right, down, away. `deviation`, rad, is that of the normal. `residual` is
    how far a corner is off, pixels rms; `along` and `across` are the deviations of the place of a
    tag, m, in the direction in which it is known least in the plane, and best; and `scatter` is
    that of a corner, m. They are medians.
    """

    corners: np.ndarray
    heights: np.ndarray
    plane: PlaneMap
    normal: np.ndarray
    deviation: float
    residual: float
    along: float
    across: float
    scatter: float


class _Motion(NamedTuple):
    """
    The motion of tags, in views (V).

    The rows of `frame` (3, 3) are the axes of the plane and its normal, in those of the camera;
    `leans` (n, 3, 3) turn the tags into the frame at angle 0, and `heights` (n,), m, are those of
    their centers. `places` (V,), complex, m, and `angles` (V,), rad, are those in the plane.
    """

    frame: np.ndarray
    leans: np.ndarray
    heights: np.ndarray
    places: np.ndarray
    angles: np.ndarray


class _View(NamedTuple):
    """Views: pixels (V, 4, 2) of a perfect lens, tags (V,) by column, and where they are (V, 2)."""

    pixels: np.ndarray
    tags: np.ndarray
    row: np.ndarray


def place_turning(
    pixels: np.ndarray, size: float, camera: np.ndarray, picture: tuple[int, int]
) -> Turning | None:
    """
    Place tags that move in one plane, which need not be that of the picture.

    Parameters
    ----------
    pixels : ndarray, shape (T, n, 4, 2)
        Corners as a perfect lens shows them, NaN for none.
    size : float
        Side of the tags, m.
    camera : ndarray, shape (3, 3)
        Matrix of the camera.
    picture : tuple of int
        Width and height, pixels.

    Returns
    -------
    Turning or None
        None if they are seen too seldom.

    """
    is_seen = np.isfinite(pixels).all(axis=(2, 3))
    place = np.argwhere(is_seen)
    if len(place) < _LEAST_VIEWS:
        return None
    views = _View(pixels[is_seen], place[:, 1], place)
    few = _few_of_each(views, pixels.shape[1])
    motion = _first_motion(few, pixels.shape[1], size, camera)
    motion, spread, deviation = _fit(motion, few, size, camera)
    if len(few.tags) == len(place):
        views = few
    else:
        start = _first_motion(views, pixels.shape[1], size, camera, motion)
        motion, spread, _ = _fit(start, views, size, camera, is_plane_known=True)
    return _placed(motion, views, (size, camera, picture), spread, deviation, pixels.shape)


def _few_of_each(views: _View, count: int) -> _View:
    """Return views of each tag, all through the film, by which the plane is found."""
    kept = []
    for tag in range(count):
        own = np.flatnonzero(views.tags == tag)
        kept.append(own[:: max(1, -(-len(own) * count // _MOST_VIEWS))])
    rows = np.concatenate(kept)
    return _View(*(part[rows] for part in views))


def _first_motion(
    views: _View, count: int, size: float, camera: np.ndarray, known: _Motion | None = None
) -> _Motion:
    """Return the motion of tags by their poses; that in a plane which is `known` already."""
    turns, places = _two_poses(views.pixels, size, camera)
    rows = np.arange(len(places))
    chosen = np.zeros(len(places), int)
    frame = _frame(np.array([0, 0, -1.0])) if known is None else known.frame
    for _ in range(_POSE_ROUNDS):
        turn, place = turns[rows, chosen], places[rows, chosen]
        if known is None:
            frame = _frame(_normal(turn, place, views.tags, size))
        # The normal as the tag sees it, which stays.
        own = np.einsum('vpij,i->vpj', turns, frame[2])
        usual = _medians(own[rows, chosen], views.tags, count)
        usual /= np.maximum(np.linalg.norm(usual, axis=-1, keepdims=True), 1e-12)
        chosen = np.einsum('vpj,vj->vp', own, usual[views.tags]).argmax(axis=1)
    turn, place = turns[rows, chosen], places[rows, chosen]
    leans = np.stack([_lean(normal) for normal in usual]) if known is None else known.leans
    inner = np.einsum('ij,vjk,vlk->vil', frame, turn, leans[views.tags])
    angles = np.arctan2(inner[:, 1, 0] - inner[:, 0, 1], inner[:, 0, 0] + inner[:, 1, 1])
    flat = place @ frame.T
    heights = _medians(flat[:, 2], views.tags, count) if known is None else known.heights
    return _Motion(frame, leans, heights, flat[:, 0] + 1j * flat[:, 1], angles)


def _medians(values: np.ndarray, tags: np.ndarray, count: int) -> np.ndarray:
    """Return the medians (count, ...) of the values (V, ...) of each tag, 0 where it has none."""
    medians = np.zeros((count, *values.shape[1:]))
    for k in np.unique(tags):
        medians[k] = np.median(values[tags == k], axis=0)
    return medians


def _two_poses(
    pixels: np.ndarray, size: float, camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return both turns (V, 2, 3, 3) and places (V, 2, 3), m, that show a square as it is seen."""
    square = size * np.column_stack((SQUARE.real, SQUARE.imag, np.zeros(4)))
    turns, places = np.empty((len(pixels), 2, 3, 3)), np.empty((len(pixels), 2, 3))
    for k, corners in enumerate(pixels):
        _, turned, moved, _ = cv2.solvePnPGeneric(
            square, corners, camera, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
        )
        for p in range(2):
            turns[k, p] = cv2.Rodrigues(turned[min(p, len(turned) - 1)])[0]
            places[k, p] = moved[min(p, len(moved) - 1)].ravel()
    return turns, places


def _normal(turns: np.ndarray, places: np.ndarray, tags: np.ndarray, size: float) -> np.ndarray:
    """Return the direction (3,) along which tags move least, and that turns least in their axes."""
    total = np.zeros((3, 3))
    for k in np.unique(tags):
        own, place = turns[tags == k], places[tags == k]
        mean = own.sum(axis=0)
        turned = len(own) * np.eye(3) - mean @ mean.T / len(own)
        off = place - place.mean(axis=0)
        total += turned * (size / 2) ** 2 + off.T @ off
    return np.asarray(np.linalg.eigh(total)[1][:, 0])


def _frame(normal: np.ndarray) -> np.ndarray:
    """Return the axes (3, 3) of the plane and its normal, as rows: x to the right, else away."""
    normal = normal * (1 if normal @ _SIDE > 0 else -1)
    first = np.array([1.0, 0, 0]) - normal * normal[0]
    if np.linalg.norm(first) < 0.5:
        first = np.array([0, 0, 1.0]) - normal * normal[2]
    first /= np.linalg.norm(first)
    return np.stack((first, np.cross(normal, first), normal))


def _lean(normal: np.ndarray) -> np.ndarray:
    """Return a turn (3, 3) of the axes of a tag that turns a direction (3,) of it into z."""
    first = np.eye(3)[np.abs(normal).argmin()]
    first = first - normal * (first @ normal)
    first /= max(np.linalg.norm(first), 1e-12)
    return np.stack((first, np.cross(normal, first), normal))


def _points(motion: _Motion, tags: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (V, 4) in the plane, complex, m, and their heights."""
    square = size * np.stack((SQUARE.real, SQUARE.imag, np.zeros(4)))
    x, y, z = np.moveaxis(motion.leans @ square, 1, 0)
    flat = (x + 1j * y)[tags] * np.exp(1j * motion.angles)[:, None] + motion.places[:, None]
    return flat, (z + motion.heights[:, None])[tags]


def _shown(motion: _Motion, tags: np.ndarray, size: float, camera: np.ndarray) -> np.ndarray:
    """Return the pixels (V, 8) of corners."""
    flat, heights = _points(motion, tags, size)
    seen = np.stack((flat.real, flat.imag, heights), axis=-1) @ motion.frame @ camera.T
    return (seen[..., :2] / seen[..., 2:]).reshape(len(tags), 8)


def _moved(motion: _Motion, shared: np.ndarray, own: np.ndarray, local: np.ndarray) -> _Motion:
    """Return a motion with a plane turned by (2,), tags leaned by and lifted (n, 3), and moved."""
    turn = cv2.Rodrigues(np.array([*shared, 0.0]))[0]
    leans = [
        cv2.Rodrigues(np.array([a, b, 0.0]))[0] @ lean
        for (a, b, _), lean in zip(own, motion.leans, strict=True)
    ]
    return _Motion(
        turn @ motion.frame,
        np.stack(leans),
        motion.heights + own[:, 2],
        motion.places + local[:, 0] + 1j * local[:, 1],
        motion.angles + local[:, 2],
    )


def _slopes(
    motion: _Motion, views: _View, size: float, camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the slopes of pixels by place and angle (V, 8, 3), and by plane and tag (V, 8, 5)."""
    count, number = len(motion.heights), len(views.tags)
    now = _shown(motion, views.tags, size, camera)
    slopes = []
    for k in range(8):
        step = _STEP * (np.arange(8) == k)
        other = _moved(
            motion,
            step[3:5],
            np.broadcast_to(step[5:], (count, 3)),
            np.broadcast_to(step[:3], (number, 3)),
        )
        slopes.append((_shown(other, views.tags, size, camera) - now) / _STEP)
    return np.stack(slopes[:3], axis=-1), np.stack(slopes[3:], axis=-1)


def _fit(
    motion: _Motion, views: _View, size: float, camera: np.ndarray, is_plane_known: bool = False
) -> tuple[_Motion, float, float]:
    """
    Fit a motion to views; also return the spread of a pixel, and the deviation of the normal, rad.

    Gauss and Newton, damped. Places and angles are of one view each, so they are eliminated first.
    """
    count = len(motion.heights)
    seen = views.pixels.reshape(-1, 8)
    now, damping = seen - _shown(motion, views.tags, size, camera), 1e-3
    # The columns, in all that is shared, of the plane and of the tag of each view.
    columns = np.column_stack(
        (np.tile([0, 1], (len(seen), 1)), 2 + 3 * views.tags[:, None] + [0, 1, 2])
    )
    for _ in range(_ROUNDS):
        spread = 1.4826 * float(np.median(np.abs(now))) + 1e-9
        root = np.sqrt(np.minimum(1, HUBER * spread / np.maximum(np.abs(now), 1e-12)))
        local, shared = (root[..., None] * part for part in _slopes(motion, views, size, camera))
        solve = np.linalg.inv(
            np.swapaxes(local, 1, 2) @ local * (1 + damping * np.eye(3))
        ) @ np.swapaxes(local, 1, 2)
        left = shared - local @ (solve @ shared)
        right = root * now - (local @ (solve @ (root * now)[..., None]))[..., 0]
        normal, vector = np.zeros((2 + 3 * count,) * 2), np.zeros(2 + 3 * count)
        product = np.swapaxes(left, 1, 2) @ left
        np.add.at(normal, (columns[:, :, None], columns[:, None]), product)
        np.add.at(vector, columns, np.einsum('vij,vi->vj', left, right))
        damped = normal + damping * np.diag(np.diagonal(normal)) + 1e-12 * np.eye(len(normal))
        change = np.linalg.solve(damped, vector) * (not is_plane_known)
        rest = (root * now)[..., None] - shared @ change[columns][..., None]
        other = _moved(motion, change[:2], change[2:].reshape(-1, 3), (solve @ rest)[..., 0])
        trial = seen - _shown(other, views.tags, size, camera)
        gain = robust_cost(now, spread) - robust_cost(trial, spread)
        if gain > 0:
            motion, now, damping = other, trial, damping / 10
            if gain < 1e-9 * robust_cost(now, spread):
                break
        else:
            damping *= 10
    # Three of eight coordinates fit each view.
    spread = float(np.sqrt(np.median(now**2) / 0.455 * 8 / 5))
    scores = np.zeros((len(seen), len(vector)))
    np.put_along_axis(scores, columns, np.einsum('vij,vi->vj', left, right), axis=1)
    inverse = np.linalg.pinv(normal)[:, :2]
    deviation = _deviation(scores @ inverse, views.row[:, 0], inverse[:2] * spread**2)
    return motion, spread, deviation


def _deviation(moved: np.ndarray, time: np.ndarray, white: np.ndarray) -> float:
    """
    Return the deviation of the normal, rad, that is `moved` (V, 2) by views at times (V,).

    Errors of a lens, or of a bent tag, last: the parts of a film show how much (Liang and Zeger
    1986). It is no less than that of `white` noise, of a variance (2, 2).
    """
    order = np.argsort(time, kind='stable')
    parts = np.stack([part.sum(axis=0) for part in np.array_split(moved[order], _PARTS)])
    variance = parts.T @ parts * _PARTS / (_PARTS - 1)
    return float(np.sqrt(max(np.linalg.eigvalsh(kind)[-1] for kind in (variance, white))))


def _placed(
    motion: _Motion,
    views: _View,
    scene: tuple[float, np.ndarray, tuple[int, int]],
    spread: float,
    deviation: float,
    shape: tuple[int, ...],
) -> Turning:
    """Return what is placed of a fitted motion, `shape` being that of all pixels."""
    size, camera, picture = scene
    off = views.pixels.reshape(-1, 8) - _shown(motion, views.tags, size, camera)
    local, _ = _slopes(motion, views, size, camera)
    flat, _ = _points(motion, views.tags, size)
    arms = flat - motion.places[:, None]
    variance = np.linalg.inv(np.swapaxes(local, 1, 2) @ local) * spread**2
    sides = np.sqrt(np.linalg.eigvalsh(variance[:, :2, :2]))
    scattered, scale = _scatter(arms, variance)
    flat = flat + scattered
    side = np.linalg.norm(np.roll(views.pixels, -1, axis=1) - views.pixels, axis=-1).max(axis=1)
    hidden = np.abs(off).max(axis=1) > MOST_OFF * side
    flat[hidden] = np.nan
    corners = np.full(shape[:3], complex(np.nan, np.nan))
    corners[views.row[:, 0], views.row[:, 1]] = flat
    base = float(np.median(motion.heights[views.tags]))
    plane = _plane_map(motion.frame, base, camera, picture)._replace(residual=spread)
    heights = np.zeros(shape[1:3])
    every = np.arange(len(motion.heights))
    heights[every] = _points(motion._replace(places=0 * every, angles=0 * every), every, size)[1]
    heights[every] -= base
    across, along = np.median(sides, axis=0).tolist()
    return Turning(
        corners, heights, plane, motion.frame[2], deviation, spread, along, across, scale
    )


def _scatter(arms: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, float]:
    """
    Return displacements (V, 4), complex, m, that leave the mean pose as it is; their deviation.

    Corners with `arms` (V, 4), m, from their center have five coordinates more than a pose. These
    are as large as independent noise of corners by which a pose has the `variance` (V, 3, 3), m and
    rad, or a larger one.
    """
    one, zero = np.ones(arms.shape), np.zeros(arms.shape)
    columns = [(one, zero), (zero, one), (-arms.imag, arms.real)]
    moves = np.stack([np.stack(pair, axis=-1).reshape(-1, 8) for pair in columns], axis=-1)
    basis = np.linalg.qr(moves)[0]
    known = np.sqrt((moves**2).sum(axis=1))
    weighted = known[:, :, None] * variance * known[:, None]
    scale = np.sqrt(np.linalg.eigvalsh(weighted)[:, -1])
    # The same for the same film.
    noise = np.random.default_rng(0).standard_normal((len(arms), 8, 1))
    noise -= basis @ (np.swapaxes(basis, 1, 2) @ noise)
    moved = (scale[:, None] * noise[..., 0]).reshape(-1, 4, 2) @ (1, 1j)
    return np.asarray(moved), float(np.median(scale))


def _plane_map(
    frame: np.ndarray, height: float, camera: np.ndarray, picture: tuple[int, int]
) -> PlaneMap:
    """Return the map of the plane at a height over the camera, m, along its normal."""
    center, scale = np.array(picture) / 2 - 0.5, max(picture) / 2
    to_pixels = np.array([[scale, 0, center[0]], [0, -scale, center[1]], [0, 0, 1]])
    # A plane through the camera is seen as a line.
    height = height if abs(height) > 1e-6 else 1e-6
    seen = camera @ np.column_stack((frame[0], frame[1], height * frame[2]))
    matrix = np.linalg.inv(seen) @ to_pixels
    return PlaneMap(center, scale, 0.0, matrix / np.abs(matrix).max(), 0.0, 0j, -height)
