"""
The motion in space: its plane, and how far the markers leave it.

Each marker of a planar motion stays in a plane of its own, and all these planes are parallel. The
scatter of the markers about their own means is least along the normal (total least squares). The
standard deviation of the normal allows for correlated errors: it comes from the scatter between
blocks of frames (the sandwich estimator of Liang and Zeger 1986).
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.tracking.plane import Plane, PlaneSetting, plane_along, plane_of, upward
from kinpole_ros.tracking.scatter import GROUP, Scatter
from kinpole_ros.tracking.thresholds import MIN_DOF, N_SIGMA, NEGLIGIBLE

# Frames that are measured at once if the plane is known: several groups cost little more than one.
_FRAMES_AT_ONCE = 4 * GROUP
# A motion is along a line if its extent across is below this share of that along.
_LINE_SHARE = 0.03
# A line is along the normal if the cosine between them exceeds this.
_ALONG_NORMAL = 0.95
# rad. The standard deviation of the normal at which the plane is fitted; the second is for motion
# that is not planar, whose normal never gets better. It is tested after so many frames.
_MAX_DEVIATION, _MAX_DEVIATION_NOT_PLANAR = np.radians(0.05), np.radians(5)
_NOT_PLANAR_FRAMES = 6 * GROUP
# rad. A tilt is reported from this on, if its standard deviation is below the second.
TILTED, _MAX_TILT_DEVIATION = np.radians(2.5), np.radians(1 / 3)
# The body is rigid, and leaves the plane, if the distances of its markers change by less than this
# share of the distance from the plane.
MAX_STRETCH_SHARE = 0.25


class SpaceReport(NamedTuple):
    """
    How the recent motion lies in space; NaN where not known.

    `plane` is the one in use, None while it is not known. `normal` (3,) is that of the motion, None
    if it shows none; of a motion along a `line` it is the normal of the plane with the line that is
    nearest to `plane`. `tilt`, rad, is the angle between both normals, and `deviation` its standard
    deviation. By body: `size` is the diameter in space, m; `off_plane` the distance from the plane,
    m rms, 0 if it is within the noise; `stretch` the change of the distances of the markers beyond
    their noise, m per axis.
    """

    plane: Plane | None
    normal: np.ndarray | None
    line: bool
    tilt: float
    deviation: float
    size: np.ndarray
    off_plane: np.ndarray
    stretch: np.ndarray

    @property
    def is_tilted(self) -> bool:
        """Whether the tilt of the motion against the plane is worth a warning."""
        return bool(self.tilt >= TILTED)


def updated(before: SpaceReport, now: SpaceReport) -> SpaceReport:
    """Return the report `now`, completed by the one `before`."""
    of_bodies = {}
    for name in ('size', 'off_plane', 'stretch'):
        old, new = getattr(before, name), getattr(now, name)
        of_bodies[name] = np.where(np.isnan(new), old, new)
    motion = before if now.normal is None else now
    return motion._replace(plane=now.plane or before.plane, **of_bodies)


class Space:
    """The motion in space of `bodies` bodies of up to `width` markers, and its plane."""

    def __init__(self, setting: PlaneSetting, bodies: int, width: int) -> None:
        self.plane = plane_of(setting)
        self._shape = bodies, width
        self._waiting: list[np.ndarray] = []
        self._scatter = Scatter(*self._shape)

    @property
    def _number(self) -> int:
        """Number of the waiting frames."""
        return sum(map(len, self._waiting))

    def widen(self, width: int) -> None:
        """Make room for more markers per body; the motion is measured from the start."""
        self._shape = self._shape[0], width
        self._waiting = []
        self._scatter = Scatter(*self._shape)

    def add(self, points: np.ndarray) -> None:
        """Take frames of markers (T, B, w, 3), m, NaN for none."""
        if self._number >= (GROUP if self.plane is None else _FRAMES_AT_ONCE):
            self._measure()
        self._waiting.append(points)
        if len(points) > GROUP:
            self._measure()

    def _measure(self) -> None:
        """Measure the waiting frames, and fit the plane if it is not known."""
        groups = self._number // GROUP
        if not groups:
            return
        points = np.concatenate(self._waiting)
        done = groups * GROUP
        self._waiting = [points[done:].copy()]
        self._scatter.add(points[:done].reshape(groups, GROUP, *points.shape[1:]))
        if self.plane is None and self._scatter.update():
            normal, line, deviation = self._normal_of_motion(None)
            limit = _MAX_DEVIATION
            if normal is not None and not self._is_planar(normal):
                limit = _MAX_DEVIATION_NOT_PLANAR
            if normal is not None and not line and deviation < limit:
                self.plane = plane_along(upward(normal))

    def _is_planar(self, normal: np.ndarray) -> bool:
        """Whether the motion leaves planes with this normal by no more than its noise."""
        kept = self._scatter.sums
        if kept.count.sum() < _NOT_PLANAR_FRAMES * np.count_nonzero(kept.count.any(axis=0)):
            return True
        off = normal @ self._scatter.about_means().sum((0, 1)) @ normal / kept.count.sum()
        noise = normal @ kept.rough.sum((0, 1)) @ normal / max(kept.rough_count.sum(), 1)
        least = NEGLIGIBLE * np.nanmean(self._scatter.size())
        return bool(off <= max(N_SIGMA**2 * noise, least**2))

    def report(self) -> SpaceReport:
        """Return how the recent motion lies in space."""
        size, off, stretch = (np.full(self._shape[0], np.nan) for _ in range(3))
        tilt = deviation = np.nan
        normal, line = None, False
        self._measure()
        if self._scatter.update():
            normal, line, deviation = self._normal_of_motion(self.plane)
            if normal is not None and self.plane is not None:
                cosine = abs(float(normal @ self.plane.normal))
                tilt = float(np.arctan2(np.sqrt(max(0.0, 1 - cosine**2)), cosine))
                if cosine < 0.1:
                    normal = upward(normal)
            across = normal if normal is not None else self.plane and self.plane.normal
            size = self._scatter.size()
            stretch = self._scatter.stretch()
            # Before the normal of the motion is known, a tilt would look the same.
            if across is not None and len(self._scatter.sums.count) >= MIN_DOF:
                off = self._off_plane(across, size, stretch)
        return SpaceReport(
            plane=self.plane,
            normal=normal,
            line=line,
            tilt=tilt,
            deviation=deviation,
            size=size,
            off_plane=off,
            stretch=stretch,
        )

    def _normal_of_motion(self, plane: Plane | None) -> tuple[np.ndarray | None, bool, float]:
        """
        The normal (3,) of the motion, whether it is along a line, and its standard deviation, rad.

        Of a line the normal is the one nearest to that of the plane. None if no normal shows.
        """
        nothing = None, False, np.nan
        blocks = self._scatter.about_means().sum(axis=1)
        total = blocks.sum(axis=0)
        counts = self._scatter.sums.count.sum((1, 2))
        count = counts.sum()
        size = self._scatter.size()
        if len(blocks) < MIN_DOF or not np.isfinite(size).any():
            return nothing
        rough = self._scatter.sums.rough.sum((0, 1)) / max(self._scatter.sums.rough_count.sum(), 1)
        values, vectors = np.linalg.eigh(total)
        least = np.nanmean(size) * NEGLIGIBLE

        def is_seen(k: int) -> bool:
            # In the block with most motion: the bodies may have been at rest for long.
            axis = vectors[:, k]
            extent = (blocks @ axis @ axis / np.maximum(counts, 1)).max()
            return bool(extent > max(N_SIGMA**2 * axis @ rough @ axis, least**2))

        def variance(normal: np.ndarray, k: int) -> float:
            residual = float(normal @ total @ normal)
            scores = blocks @ normal @ vectors[:, k]
            gap = max(values[k] - residual, 0.0)
            # The scores of blocks vary at least as those of white noise.
            square = max(float(scores @ scores), max(residual, 0.0) * values[k] / count)
            return square / gap**2 if gap else np.inf

        if not is_seen(2):
            return nothing
        normal, line = vectors[:, 0], False
        deviation = np.inf
        if is_seen(1) and values[1] > _LINE_SHARE**2 * values[2]:
            deviation = float(np.sqrt(variance(normal, 1) + variance(normal, 2)))
        if plane is None:
            return (normal, False, deviation) if np.isfinite(deviation) else nothing
        if not deviation < _MAX_TILT_DEVIATION:
            # At best the direction of a line is known.
            line, axis = True, vectors[:, 2]
            near = plane.normal
            if abs(near @ axis) > _ALONG_NORMAL:
                near = plane.basis[0]
            normal = near - (near @ axis) * axis
            normal /= np.sqrt(normal @ normal)
            deviation = float(np.sqrt(variance(normal, 2)))
        if not deviation < _MAX_TILT_DEVIATION:
            return nothing
        return np.copysign(1.0, normal @ plane.normal) * normal, line, deviation

    def _off_plane(self, normal: np.ndarray, size: np.ndarray, stretch: np.ndarray) -> np.ndarray:
        """Distance (B,) of rigid bodies from planes with this normal, m rms; 0 within the noise."""
        scatter = self._scatter.about_means().sum(axis=0)
        count, rough_count = (
            self._scatter.sums.count.sum((0, 2)),
            self._scatter.sums.rough_count.sum(0),
        )
        with np.errstate(invalid='ignore', divide='ignore'):
            off = np.maximum(normal @ scatter @ normal, 0.0) / count
            noise = (normal @ self._scatter.sums.rough.sum(0) @ normal) / rough_count
            path = np.trace(scatter, axis1=-2, axis2=-1) / count
            off = np.sqrt(off)
            least = NEGLIGIBLE * np.maximum(size, np.sqrt(path))
            leaves = (off > np.maximum(N_SIGMA * np.sqrt(noise), least)) & (
                stretch < MAX_STRETCH_SHARE * off
            )
        return np.where(leaves, off, 0.0)
