"""The plane of a recorded motion, the unit of length, and the noise of tracks."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.plane import AXES, NORMALS, Plane, plane_along

# A plane nearer than this, deg, to one of the axes is taken for that: it costs 0.004% of a length.
_LEVEL_DEG = 0.5
# The motion is along a line, which lies in many planes, if its extent across is below one of these:
# a share of that along; or a larger share, and this many times the extent out of the plane.
_LINE, _WIDE_LINE, _LINE_RATIO = 1e-3, 0.05, 3.0
# No body is larger than this, m; a larger one is in mm.
_MAX_BODY_SIZE = 20.0


class MotionPlane(NamedTuple):
    """
    The plane of a motion.

    `tilt` is the angle to the nearest plane of the axes, deg. `source` is 'motion', 'layout' (of
    the markers, for a motion along one line) or 'given'. `spread` is the rms motion out of the
    plane, `across` and `size` are the least and the largest rms motion in it.
    """

    plane: Plane
    tilt: float
    source: str
    spread: float
    across: float
    size: float

    @property
    def name(self) -> str:
        """xy, yz or zx where the plane is one of these, else ''."""
        return next((name for name, axes in AXES.items() if axes == self.plane.axes), '')

    @property
    def normal(self) -> np.ndarray:
        """The unit normal (3,)."""
        return self.plane.normal

    def project(self, points: np.ndarray) -> Complex:
        """Points (..., 3) as complex numbers of the plane (...)."""
        return self.plane.project(points)[0]


def fit_plane(
    points: np.ndarray, given: np.ndarray | None = None, turns: np.ndarray | float = 0.0
) -> MotionPlane:
    """
    Fit the plane of the motion of tracks (T, n, 3), NaN for none.

    The normal is the direction of least scatter of the markers about their means, to which `turns`
    (3, 3) may add the scatter of rotation vectors about the other axes. A normal `given` (3,) is
    taken as it is. Where all moves along one line, the arrangement of the markers decides which
    plane through the line is taken.
    """
    scatter = _scatter(points, 0)
    values, vectors = np.linalg.eigh(scatter + turns)
    sizes = np.sqrt(np.maximum(values, 0))
    is_line = sizes[1] < _WIDE_LINE * sizes[2] and (
        sizes[1] < max(_LINE * sizes[2], _LINE_RATIO * sizes[0])
    )
    if given is not None:
        normal, source = given / np.linalg.norm(given), 'given'
    else:
        normal, source = vectors[:, 0], 'motion'
        if is_line:
            along = np.outer(vectors[:, 2], vectors[:, 2])
            layout = (np.eye(3) - along) @ _scatter(points, 1) @ (np.eye(3) - along)
            # The normal must not be along the line, where no scatter is left.
            layout += np.trace(layout) * along + along
            normal, source = np.linalg.eigh(layout)[1][:, 0], 'layout'
        normal = normal * np.sign(normal[np.abs(normal).argmax()])
    cosines = {name: float(normal @ axis) for name, axis in NORMALS.items()}
    nearest = max(cosines, key=lambda name: abs(cosines[name]))
    tilt = float(np.degrees(np.arccos(min(abs(cosines[nearest]), 1.0))))
    if tilt < _LEVEL_DEG and cosines[nearest] > 0:
        normal = np.array(NORMALS[nearest])
    plane = plane_along(normal)
    axes = plane.basis[:2]
    inside = np.sqrt(np.maximum(np.linalg.eigvalsh(axes @ scatter @ axes.T), 0))
    spread = float(np.sqrt(max(normal @ scatter @ normal, 0.0)))
    return MotionPlane(plane, tilt, source, spread, float(inside[0]), float(inside[1]))


def _scatter(points: np.ndarray, axis: int) -> np.ndarray:
    """
    Mean scatter (3, 3) of points (T, n, 3), NaN for none.

    For `axis` 0 about the mean of each marker over time, for 1 about that of each frame.
    """
    seen = np.isfinite(points[..., :1])
    count = np.maximum(seen.sum(axis=axis, keepdims=True), 1)
    off = points - np.where(seen, points, 0.0).sum(axis=axis, keepdims=True) / count
    off = np.where(seen, off, 0.0).reshape(-1, 3)
    return np.asarray(off.T @ off / max(int(seen.sum()), 1))


def unit_scale(largest: float) -> float:
    """Length of a unit, m: 1 or 0.001, by the largest distance of two markers of one body."""
    return 0.001 if largest > _MAX_BODY_SIZE else 1.0


def track_noise(tracks: Complex) -> Real:
    """
    Noise (n,) of tracks (T, n) per axis, by the median of fourth differences; NaN for too few.

    The motion hardly contributes to these differences, and points of other markers do not change
    the median.
    """
    steep = tracks[:-4] - 4 * tracks[1:-3] + 6 * tracks[2:-2] - 4 * tracks[3:-1] + tracks[4:]
    values = np.concatenate((steep.real, steep.imag))
    seen = np.isfinite(np.concatenate((steep.real, steep.real)))
    values[~seen] = np.nan
    has_enough = seen.sum(axis=0) >= 10
    values[:, ~has_enough] = 0.0
    # 0.67449: median over standard deviation; 70: sum of the squared coefficients.
    noise = np.nanmedian(np.abs(values), axis=0) / (0.67449 * np.sqrt(70))
    return np.where(has_enough, noise, np.nan)


def space_noise(points: np.ndarray) -> Real:
    """Noise (n,) of tracks (T, n, 3) per axis, as `track_noise` has it."""
    planes = [track_noise(points[..., k] + 1j * points[..., (k + 1) % 3]) for k in range(3)]
    return np.asarray(np.sqrt(np.mean(np.stack(planes) ** 2, axis=0)))
