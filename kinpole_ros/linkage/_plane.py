"""The plane that markers move in, and the unit they are in, from their places alone."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real

# deg. A plane nearer to one of the axes' is taken for that: it costs 0.004% of a length.
_LEVEL = 0.5
# Of the largest extent: a motion narrower than that is a line, which lies in many planes.
_LINE = 1e-3
# m. A body larger than that is none; its unit is mm.
_LARGEST_BODY = 20.0
_NORMALS = {'xy': (0.0, 0.0, 1.0), 'yz': (1.0, 0.0, 0.0), 'zx': (0.0, 1.0, 0.0)}


class Plane(NamedTuple):
    """
    `name` is xy, yz or zx where it is one of them, else ''; `normal` (3,), `axes` (2, 3) in it.

    `tilt` is the angle to the nearest of these three, deg; `determined` says whether the motion
    spans it. `spread` is the rms of what is out of the plane, and `size` that of the motion in it.
    """

    name: str
    normal: np.ndarray
    axes: np.ndarray
    tilt: float
    determined: bool
    spread: float
    size: float

    def project(self, points: np.ndarray) -> Complex:
        """Points (..., 3) in the plane, complex."""
        flat = points @ self.axes.T
        return np.asarray(flat[..., 0] + 1j * flat[..., 1])


def fit_plane(points: np.ndarray) -> Plane:
    """
    The plane of the motion of tracks (T, n, 3), NaN for none.

    Its normal is the direction in which they leave their means the least: the eigenvector of the
    smallest eigenvalue of their scatter.
    """
    with np.errstate(invalid='ignore'):
        seen = np.isfinite(points[..., 0])
        counts = np.maximum(seen.sum(axis=0), 1)
        off = np.where(seen[..., None], points, 0.0)
        off = np.where(seen[..., None], points - off.sum(axis=0) / counts[:, None], 0.0)
    scatter = np.einsum('tni,tnj->ij', off, off) / max(int(seen.sum()), 1)
    values, vectors = np.linalg.eigh(scatter)
    sizes = np.sqrt(np.maximum(values, 0))
    determined = bool(sizes[1] > _LINE * sizes[2] and sizes[1] > 3 * sizes[0])
    normal = vectors[:, 0] * np.sign(vectors[np.abs(vectors[:, 0]).argmax(), 0])
    if not determined:
        normal = np.array(_NORMALS['xy'])
    cosines = {name: abs(float(normal @ axis)) for name, axis in _NORMALS.items()}
    nearest = max(cosines, key=lambda name: cosines[name])
    tilt = float(np.degrees(np.arccos(min(cosines[nearest], 1.0))))
    name = nearest if tilt < _LEVEL else ''
    if name:
        normal = np.array(_NORMALS[name])
    return Plane(
        name, normal, _axes(name, normal), tilt, determined, float(sizes[0]), float(sizes[2])
    )


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
