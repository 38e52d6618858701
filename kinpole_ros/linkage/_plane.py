"""The plane that markers move in, and the unit they are in, from their places alone."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.plane import NORMALS

# deg. A plane nearer to one of the axes' is taken for that: it costs 0.004% of a length.
_LEVEL = 0.5
# Of the largest extent: a motion narrower than that is a line, which lies in many planes.
_LINE = 1e-3
# The same where what is across the line is no more than this many times what is out of the plane.
_STRAIGHT, _NARROW = 0.05, 3.0
# m. A body larger than that is none; its unit is mm.
_LARGEST_BODY = 20.0


class Plane(NamedTuple):
    """
    `name` is xy, yz or zx where it is one of them, else ''; `normal` (3,), `axes` (2, 3) in it.

    `tilt` is the angle to the nearest of these three, deg; `source` says where it is from:
    'motion', 'layout' (of the markers, since all moves along one line) or 'given'. `spread` is the
    rms of what is out of the plane, `across` and `size` are those of the motion in it, least and
    largest.
    """

    name: str
    normal: np.ndarray
    axes: np.ndarray
    tilt: float
    source: str
    spread: float
    across: float
    size: float

    def project(self, points: np.ndarray) -> Complex:
        """Points (..., 3) in the plane, complex."""
        flat = points @ self.axes.T
        return np.asarray(flat[..., 0] + 1j * flat[..., 1])


def fit_plane(
    points: np.ndarray, given: np.ndarray | None = None, turns: np.ndarray | float = 0.0
) -> Plane:
    """
    Fit the plane of the motion of tracks (T, n, 3), NaN for none.

    Its normal is the direction in which they leave their means the least: the eigenvector of the
    smallest eigenvalue of their scatter, to which `turns` (3, 3) may add that of bodies about the
    other axes. The normal `given` (3,) is taken as it is. Where all moves along one line, the
    markers' own arrangement decides which plane through it is taken.
    """
    scatter = scatter_about(points, 0)
    values, vectors = np.linalg.eigh(scatter + turns)
    normal, source = vectors[:, 0], 'motion'
    sizes = np.sqrt(np.maximum(values, 0))
    if given is not None:
        normal, source = given / np.linalg.norm(given), 'given'
    elif sizes[1] < max(_LINE * sizes[2], _NARROW * sizes[0]) and sizes[1] < _STRAIGHT * sizes[2]:
        line = vectors[:, 2]
        across = np.eye(3) - np.outer(line, line)
        layout = across @ scatter_about(points, 1) @ across
        # Not the line itself, though nothing is left along it.
        layout += np.trace(layout) * np.outer(line, line) + np.outer(line, line)
        normal, source = np.linalg.eigh(layout)[1][:, 0], 'layout'
    if given is None:
        normal = normal * np.sign(normal[np.abs(normal).argmax()])
    cosines = {name: abs(float(normal @ axis)) for name, axis in NORMALS.items()}
    nearest = max(cosines, key=lambda name: cosines[name])
    tilt = float(np.degrees(np.arccos(min(cosines[nearest], 1.0))))
    is_level = tilt < _LEVEL and normal @ NORMALS[nearest] > 0
    name = nearest if is_level else ''
    if name:
        normal = np.array(NORMALS[name])
    axes = _axes(name, normal)
    inside = np.sqrt(np.maximum(np.linalg.eigvalsh(axes @ scatter @ axes.T), 0))
    spread = float(np.sqrt(max(normal @ scatter @ normal, 0.0)))
    return Plane(name, normal, axes, tilt, source, spread, float(inside[0]), float(inside[1]))


def scatter_about(points: np.ndarray, axis: int) -> np.ndarray:
    """
    Compute the mean scatter (3, 3) of points (T, n, 3), NaN for none, about their means.

    About those of each marker over time for `axis` 0, of each frame over the markers for 1.
    """
    seen = np.isfinite(points[..., :1])
    count = np.maximum(seen.sum(axis=axis, keepdims=True), 1)
    off = points - np.where(seen, points, 0.0).sum(axis=axis, keepdims=True) / count
    off = np.where(seen, off, 0.0).reshape(-1, 3)
    return np.asarray(off.T @ off / max(int(seen.sum()), 1))


def _axes(name: str, normal: np.ndarray) -> np.ndarray:
    """Two axes (2, 3) of the plane: of the frame where it is level, else the nearest to these."""
    k = (
        int(np.abs(normal).argmax())
        if not name
        else list('xyz').index({'xy': 'z', 'yz': 'x', 'zx': 'y'}[name])
    )
    first = np.eye(3)[(k + 1) % 3]
    first = first - (first @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack((first, np.cross(normal, first)))


def scale_of(largest: float) -> float:
    """Length of a unit, m, by the largest distance of two markers of one body."""
    return 0.001 if largest > _LARGEST_BODY else 1.0


def noise_of(tracks: Complex) -> Real:
    """
    Noise (n,) of tracks (T, n) per axis, from their fourth differences, which a motion hardly has.

    By the median, so that points of another marker do not count; NaN where there are too few.
    """
    steep = tracks[:-4] - 4 * tracks[1:-3] + 6 * tracks[2:-2] - 4 * tracks[3:-1] + tracks[4:]
    both = np.concatenate((steep.real, steep.imag))
    seen = np.isfinite(both) & np.isfinite(np.concatenate((steep.real, steep.real)))
    both[~seen] = np.nan
    enough = seen.sum(axis=0) >= 10
    both[:, ~enough] = 0.0
    noise = np.nanmedian(np.abs(both), axis=0) / (0.67449 * np.sqrt(70))
    return np.where(enough, noise, np.nan)


def noise_in_space(points: np.ndarray) -> Real:
    """Noise (n,) of tracks (T, n, 3) per axis, as `noise_of` has it."""
    planes = np.stack([noise_of(points[..., k] + 1j * points[..., (k + 1) % 3]) for k in range(3)])
    return np.asarray(np.sqrt(np.mean(planes**2, axis=0)))
