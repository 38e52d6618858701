"""
What the markers do in space: the plane of their motion, and how far they keep to it.

Each marker of a planar motion stays in a plane of its own, and all these planes are parallel: the
scatter of every marker about its own mean is least along their normal (total least squares). Its
deviation is that of errors which last: by how much blocks of frames pull at it (the sandwich
estimator of Liang and Zeger 1986).
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.tracking.plane import Plane, PlaneSetting, plane_along, plane_of, upward
from kinpole_ros.tracking.scatter import GROUP, Scatter
from kinpole_ros.tracking.thresholds import MIN_DOF, N_SIGMA, NEGLIGIBLE

# Frames that are measured at once, where nothing waits for it: several groups cost little more.
_AT_ONCE = 4 * GROUP
# The extent of a motion across over that along: below this it is as good as a straight line.
_STRAIGHT = 0.03
# The cosine to the normal from which on a line is as good as along it.
_UPRIGHT = 0.95
# rad. A plane is fitted when its normal is known so well; the second is for a motion that leaves
# any plane, of which the normal is never known better. That shows after so many frames.
_KNOWN, _NEARLY_KNOWN = np.radians(0.05), np.radians(5)
_NOT_PLANAR_FRAMES = 6 * GROUP
# rad. What rounds to 3 deg is worth a warning, if it is known to 1 deg at three deviations.
TILTED, _TILT_KNOWN = np.radians(2.5), np.radians(1 / 3)
# A body that leaves the plane may seem not to be rigid: the distances of its markers in space
# change by less than this share of that.
KEEPS = 0.25


class SpaceReport(NamedTuple):
    """
    How the motion of late lies in space.

    `plane` is the one in use, None while it is not known. `normal` (3,) is that of the motion, None
    where it does not show one; for a motion along a `line` it is the nearest to the plane that
    holds it. `tilt`, rad, is between the two, `deviation` that of the normal about any axis; both
    NaN where they are not known. By body: `size`, m, is its diameter in space; `off_plane`, m rms
    of a marker, how far it leaves the plane, 0 for no more than noise; `stretch`, m per axis, by
    how much the distances of its markers change beyond their noise. NaN where not known yet.
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
        """Whether the motion is tilted against the plane by enough to say so."""
        return bool(self.tilt >= TILTED)


def updated(before: SpaceReport, now: SpaceReport) -> SpaceReport:
    """The report of `now`, with what was known `before` where nothing is known now."""
    size, off, stretch = (
        np.where(np.isnan(new), old, new) for old, new in zip(before[-3:], now[-3:], strict=True)
    )
    motion = before if now.normal is None else now
    return motion._replace(
        plane=now.plane or before.plane, size=size, off_plane=off, stretch=stretch
    )


class Space:
    """The motion in space of `bodies` bodies of up to `width` markers, and the plane it is in."""

    def __init__(self, setting: PlaneSetting, bodies: int, width: int) -> None:
        self.plane = plane_of(setting)
        self._shape = bodies, width
        self._waiting: list[np.ndarray] = []
        self._number = 0
        self._scatter = Scatter(*self._shape)

    def widen(self, width: int) -> None:
        """Let bodies have more markers: their motion is measured anew."""
        self._shape = self._shape[0], width
        self._waiting, self._number = [], 0
        self._scatter = Scatter(*self._shape)

    def add(self, solid: np.ndarray) -> None:
        """Take frames of markers (T, B, w, 3), m, NaN for none."""
        self.settle()
        self._waiting.append(solid)
        self._number += len(solid)
        if len(solid) > GROUP:
            self._measure()

    def settle(self) -> None:
        """Measure the frames taken since the last update, and the plane if it is to be fitted."""
        # Only a plane to be fitted cannot wait.
        if self._number >= (GROUP if self.plane is None else _AT_ONCE):
            self._measure()

    def _measure(self) -> None:
        groups = self._number // GROUP
        if not groups:
            return
        every = np.concatenate(self._waiting)
        done = groups * GROUP
        self._waiting = [every[done:].copy()]
        self._number -= done
        self._scatter.add(every[:done].reshape(groups, GROUP, *every.shape[1:]))
        if self.plane is None and self._scatter.look():
            normal, line, deviation = self._motion(None)
            known = _KNOWN if normal is None or self._is_planar(normal) else _NEARLY_KNOWN
            if normal is not None and not line and deviation < known:
                self.plane = plane_along(upward(normal))

    def _is_planar(self, normal: np.ndarray) -> bool:
        """Whether the motion of late leaves planes of this normal by no more than its noise."""
        kept = self._scatter.kept
        if kept.count.sum() < _NOT_PLANAR_FRAMES * np.count_nonzero(kept.count.any(axis=0)):
            return True
        off = normal @ self._scatter.about_means().sum((0, 1)) @ normal / kept.count.sum()
        noise = normal @ kept.rough.sum((0, 1)) @ normal / max(kept.rough_count.sum(), 1)
        least = NEGLIGIBLE * np.nanmean(self._scatter.size())
        return bool(off <= max(N_SIGMA**2 * noise, least**2))

    def report(self) -> SpaceReport:
        """How the motion of late lies in space."""
        size, off, stretch = (np.full(self._shape[0], np.nan) for _ in range(3))
        tilt = deviation = np.nan
        normal, line = None, False
        self._measure()
        if self._scatter.look():
            normal, line, deviation = self._motion(self.plane)
            if normal is not None and self.plane is not None:
                cosine = abs(float(normal @ self.plane.normal))
                tilt = float(np.arctan2(np.sqrt(max(0.0, 1 - cosine**2)), cosine))
                if cosine < 0.1:
                    normal = upward(normal)
            across = normal if normal is not None else self.plane and self.plane.normal
            size = self._scatter.size()
            stretch = self._scatter.stretch()
            # A tilt would look like it before the motion shows one.
            if across is not None and len(self._scatter.kept.count) >= MIN_DOF:
                off = self._off_plane(across, size, stretch)
        return SpaceReport(self.plane, normal, line, tilt, deviation, size, off, stretch)

    def _motion(self, plane: Plane | None) -> tuple[np.ndarray | None, bool, float]:
        """
        The normal (3,) of the motion, whether it is along a line, and the normal's deviation, rad.

        Of a line it is the nearest to the normal of the `plane`. None where no normal shows.
        """
        nothing = None, False, np.nan
        blocks = self._scatter.about_means().sum(axis=1)
        total = blocks.sum(axis=0)
        counts = self._scatter.kept.count.sum((1, 2))
        count = counts.sum()
        size = self._scatter.size()
        if len(blocks) < MIN_DOF or not np.isfinite(size).any():
            return nothing
        rough = self._scatter.kept.rough.sum((0, 1)) / max(self._scatter.kept.rough_count.sum(), 1)
        values, vectors = np.linalg.eigh(total)
        least = np.nanmean(size) * NEGLIGIBLE

        def shows(k: int) -> bool:
            # Where it moves most: it may have been at rest for long.
            way = vectors[:, k]
            extent = (blocks @ way @ way / np.maximum(counts, 1)).max()
            return bool(extent > max(N_SIGMA**2 * way @ rough @ way, least**2))

        def variance(normal: np.ndarray, k: int) -> float:
            way = vectors[:, k]
            left = float(normal @ total @ normal)
            pull = blocks @ normal @ way
            gap = max(values[k] - left, 0.0)
            # The pull of blocks is no less than that of white noise.
            square = max(float(pull @ pull), max(left, 0.0) * values[k] / count)
            return square / gap**2 if gap else np.inf

        if not shows(2):
            return nothing
        normal, line = vectors[:, 0], False
        deviation = np.inf
        if shows(1) and values[1] > _STRAIGHT**2 * values[2]:
            deviation = float(np.sqrt(variance(normal, 1) + variance(normal, 2)))
        if plane is None:
            return (normal, False, deviation) if np.isfinite(deviation) else nothing
        if not deviation < _TILT_KNOWN:
            # The way it goes is known at best.
            line, way = True, vectors[:, 2]
            # Along the normal of the plane, any other that holds the line will do.
            near = plane.normal
            if abs(near @ way) > _UPRIGHT:
                near = plane.basis[0]
            normal = near - (near @ way) * way
            normal /= np.sqrt(normal @ normal)
            deviation = float(np.sqrt(variance(normal, 2)))
        if not deviation < _TILT_KNOWN:
            return nothing
        return np.copysign(1.0, normal @ plane.normal) * normal, line, deviation

    def _off_plane(self, normal: np.ndarray, size: np.ndarray, stretch: np.ndarray) -> np.ndarray:
        """By how much (B,) rigid bodies leave the planes of this normal, m rms; 0 for noise."""
        scatter = self._scatter.about_means().sum(axis=0)
        count, rough_count = (
            self._scatter.kept.count.sum((0, 2)),
            self._scatter.kept.rough_count.sum(0),
        )
        with np.errstate(invalid='ignore', divide='ignore'):
            off = np.maximum(normal @ scatter @ normal, 0.0) / count
            noise = (normal @ self._scatter.kept.rough.sum(0) @ normal) / rough_count
            path = np.trace(scatter, axis1=-2, axis2=-1) / count
            off = np.sqrt(off)
            least = NEGLIGIBLE * np.maximum(size, np.sqrt(path))
            leaves = (off > np.maximum(N_SIGMA * np.sqrt(noise), least)) & (stretch < KEEPS * off)
        return np.where(leaves, off, 0.0)
