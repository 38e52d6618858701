"""
What the markers do in space: the plane of their motion, and how far they keep to it.

Each marker of a planar motion stays in a plane of its own, and all these planes are parallel: the
scatter of every marker about its own mean is least along their normal (total least squares). Sums
are kept by blocks of frames, so that the deviation of the normal is that of errors which last: by
how much the blocks pull at it (the sandwich estimator of Liang and Zeger 1986).
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.plane import Plane, PlaneSetting, plane_along, plane_of, upward

# Frames of a group, the least that is measured, and of several at once.
_GROUP, _AT_ONCE = 16, 64
# Blocks that are kept, of up to so many groups each: the last 4096 frames at most. With fewer
# blocks than the fewest their pull does not tell a deviation.
_BLOCKS, _LONGEST, _FEWEST = 32, 8, 6
HISTORY = _GROUP * _BLOCKS * _LONGEST
# A second difference of so many times the median of its marker's is that of an outlier.
_OUTLIER = 10.0
# The variance of a motion, over that of its noise; its extent over the size of the bodies; and
# across over along: below these it shows no direction, or is as good as a straight line.
_MOVES, _EXTENT, _STRAIGHT = 9.0, 0.01, 0.03
# The cosine to the normal from which on a line is as good as along it.
_UPRIGHT = 0.95
# rad. A plane is fitted when its normal is known so well at once, or so well after a while (s).
_SURE, _KNOWN, _WHILE = np.radians(0.02), np.radians(0.1), 2.0
# rad. What rounds to 3 deg is worth a warning, if it is known to 1 deg at three deviations.
TILTED, _TILT_KNOWN = np.radians(2.5), np.radians(1 / 3)
# A body leaves the plane by so many times its noise and by this share of its size: as it does when
# it is not rigid. The distances of its markers change by less than this share of that.
_LEAVES, _LEAVES_SHARE, KEEPS = 5.0, 0.01, 0.25


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


class _Sums(NamedTuple):
    """
    Sums over k stretches of frames, for B bodies of w markers and p pairs of these.

    Of markers, less where each was first seen: how many, and their first and second moments; of
    their second differences, squared, and how many; of the distances of pairs, less the first ones:
    how many, first and second moment, second differences, how many and squared.
    """

    count: np.ndarray  # (k, B, w)
    first: np.ndarray  # (k, B, w, 3)
    second: np.ndarray  # (k, B, 3, 3)
    rough: np.ndarray  # (k, B, 3, 3)
    rough_count: np.ndarray  # (k, B)
    pairs: np.ndarray  # (k, B, p, 5)


class Space:
    """The motion in space of `bodies` bodies of up to `width` markers, and the plane it is in."""

    def __init__(self, setting: PlaneSetting, bodies: int, width: int) -> None:
        self.plane = plane_of(setting)
        # The stamps of the first and of the last frame, ns.
        self._begun = self._last = 0
        self._shape = bodies, width
        self._waiting: list[np.ndarray] = []
        self._number = 0
        self._forget()

    def _forget(self) -> None:
        bodies, width = self._shape
        self._center = np.full((bodies, width, 3), np.nan)
        self._apart = np.full((bodies, _pairs(width)[0].size), np.nan)
        self._blocks: _Sums | None = None
        # Groups that do not fill a block yet.
        self._rest: _Sums | None = None
        self._length = 1

    def widen(self, width: int) -> None:
        """Let bodies have more markers: their motion is measured anew."""
        self._shape = self._shape[0], width
        self._waiting, self._number = [], 0
        self._forget()

    def capacity(self, frames: int) -> int:
        """How many of so many frames can be taken before something may be learned from them."""
        if self.plane is not None:
            return frames
        self.settle()
        return min(frames, _GROUP - self._number)

    def add(self, stamps: np.ndarray, solid: np.ndarray) -> None:
        """Take frames at `stamps` (T,), ns, of markers (T, B, w, 3), m, NaN for none."""
        self.settle()
        if not self._begun:
            self._begun = int(stamps[0])
        self._last = int(stamps[-1])
        self._waiting.append(solid)
        self._number += len(solid)
        if len(solid) > _GROUP:
            self._measure()

    def settle(self) -> None:
        """Measure the frames taken since the last update, and the plane if it is to be fitted."""
        # Several groups cost little more than one, and only a plane to be fitted cannot wait.
        if self._number >= (_GROUP if self.plane is None else _AT_ONCE):
            self._measure()

    def _measure(self) -> None:
        groups = self._number // _GROUP
        if not groups:
            return
        every = np.concatenate(self._waiting)
        done = groups * _GROUP
        self._waiting = [every[done:].copy()]
        self._number -= done
        self._append(self._sums(every[:done].reshape(groups, _GROUP, *every.shape[1:])))
        if self.plane is None:
            normal, line, deviation = self._motion(None)
            seconds = 1e-9 * (self._last - self._begun)
            least = _KNOWN if seconds >= _WHILE else _SURE
            if normal is not None and not line and deviation < least:
                self.plane = plane_along(upward(normal))

    def report(self) -> SpaceReport:
        """How the motion of late lies in space."""
        size, off, stretch = (np.full(self._shape[0], np.nan) for _ in range(3))
        tilt = deviation = np.nan
        normal, line = None, False
        self._measure()
        if self._blocks is not None:
            normal, line, deviation = self._motion(self.plane)
            if normal is not None and self.plane is not None:
                cosine = abs(float(normal @ self.plane.normal))
                tilt = float(np.arctan2(np.sqrt(max(0.0, 1 - cosine**2)), cosine))
                if cosine < 0.1:
                    normal = upward(normal)
            across = normal if normal is not None else self.plane and self.plane.normal
            size = self._size()
            stretch = self._stretch()
            # A tilt would look like it before the motion shows one.
            if across is not None and len(self._blocks.count) >= _FEWEST:
                off = self._off_plane(across, size, stretch)
        return SpaceReport(self.plane, normal, line, tilt, deviation, size, off, stretch)

    def _sums(self, points: np.ndarray) -> _Sums:
        """Sums over groups of markers (k, G, B, w, 3)."""
        unseen = np.isnan(points[..., 0])
        bent = points[:, :-2] - 2 * points[:, 1:-1] + points[:, 2:]
        size = np.sqrt(np.einsum('...i,...i', bent, bent))
        # NaN is sorted to the end.
        ranked = np.sort(size, axis=1)
        middle = np.maximum(np.count_nonzero(~np.isnan(size), axis=1) - 1, 0) // 2
        median = np.take_along_axis(ranked, middle[:, None], axis=1)
        wild = size > _OUTLIER * median
        if wild.any():
            bent[wild] = np.nan
            for k in range(3):
                unseen[:, k : k + wild.shape[1]] |= wild
        bent = np.where(np.isnan(bent), 0.0, bent)
        rough_count = np.count_nonzero(bent.any(axis=-1), axis=(1, 3))
        new = np.isnan(self._center[..., 0])
        if new.any():
            self._center[new] = _first_seen(points, unseen)[new]
        seen = ~unseen
        # Zero where there is none.
        off = np.where(seen[..., None], points - self._center, 0.0)
        one, other = _pairs(points.shape[3])
        distance = points[:, :, :, other] - points[:, :, :, one]
        distance = np.sqrt(np.einsum('...i,...i', distance, distance))
        both = seen[..., one] & seen[..., other]
        new = np.isnan(self._apart)
        if new.any():
            self._apart[new] = _first_seen(distance, ~both)[new]
        change = np.where(both, distance - self._apart, 0.0)
        distance[~both] = np.nan
        bent_apart = distance[:, :-2] - 2 * distance[:, 1:-1] + distance[:, 2:]
        known = ~np.isnan(bent_apart)
        rough_apart = np.where(known, bent_apart, 0.0) ** 2 / 6
        sums = both, change, change**2, known, rough_apart
        pairs = np.stack([each.sum(1) for each in sums], axis=-1)
        return _Sums(
            seen.sum(1, dtype=float),
            off.sum(1),
            _squares(off),
            # Of white noise the second difference has six times the variance.
            _squares(bent) / 6,
            rough_count.astype(float),
            pairs,
        )

    def _append(self, groups: _Sums) -> None:
        """Add groups to the blocks: the same ones, however many come at once."""
        rest = groups if self._rest is None else _concatenated(self._rest, groups)
        blocks = self._blocks
        while len(rest.count) >= self._length:
            number = 0 if blocks is None else len(blocks.count)
            if number == _BLOCKS and self._length < _LONGEST:
                assert blocks is not None
                blocks, self._length = _merged(blocks, 2), 2 * self._length
                continue
            whole = len(rest.count) // self._length
            if self._length < _LONGEST:
                whole = min(whole, _BLOCKS - number)
            count = whole * self._length
            new = _merged(_Sums(*(part[:count] for part in rest)), self._length)
            rest = _Sums(*(part[count:] for part in rest))
            blocks = new if blocks is None else _concatenated(blocks, new)
            blocks = _Sums(*(part[-_BLOCKS:] for part in blocks))
        self._blocks, self._rest = blocks, rest

    def _scatter(self) -> np.ndarray:
        """Scatter (k, B, 3, 3) of the markers about their means over all blocks."""
        assert self._blocks is not None
        count, first, second = self._blocks[:3]
        mean = first.sum(0) / np.maximum(count.sum(0), 1)[..., None]
        cross = np.einsum('kbwi,bwj->kbij', first, mean)
        even = np.einsum('kbw,bwi,bwj->kbij', count, mean, mean)
        return np.asarray(second - cross - cross.swapaxes(-1, -2) + even)

    def _motion(self, plane: Plane | None) -> tuple[np.ndarray | None, bool, float]:
        """
        The normal (3,) of the motion, whether it is along a line, and the normal's deviation, rad.

        Of a line it is the nearest to the normal of the `plane`. None where no normal shows.
        """
        nothing = None, False, np.nan
        assert self._blocks is not None
        blocks = self._scatter().sum(axis=1)
        total = blocks.sum(axis=0)
        count = self._blocks.count.sum()
        if len(blocks) < _FEWEST or not count:
            return nothing
        rough = self._blocks.rough.sum((0, 1)) / max(self._blocks.rough_count.sum(), 1)
        values, vectors = np.linalg.eigh(total)
        least = np.nanmean(self._size()) * _EXTENT

        def shows(k: int) -> bool:
            extent, way = values[k] / count, vectors[:, k]
            return bool(extent > max(_MOVES * way @ rough @ way, least**2))

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

    def _size(self) -> np.ndarray:
        """Diameters (B,) of bodies in space: twice the rms distance of markers from their mean."""
        assert self._blocks is not None
        count, off = np.moveaxis(self._blocks.pairs[..., :2].sum(0), -1, 0)
        with np.errstate(invalid='ignore', divide='ignore'):
            mean = self._apart + off / count
            square = np.where(count > 0, mean**2, 0.0).sum(-1)
            return np.asarray(np.sqrt(2 * square / np.count_nonzero(count, axis=-1)))

    def _stretch(self) -> np.ndarray:
        """By how much (B,) the distances of markers change beyond their noise, m per axis."""
        assert self._blocks is not None
        count, change, square, rough_count, rough = np.moveaxis(self._blocks.pairs.sum(0), -1, 0)
        spread = (square - change**2 / np.maximum(count, 1)).sum(-1)
        with np.errstate(invalid='ignore', divide='ignore'):
            variance = spread / count.sum(-1) - rough.sum(-1) / np.maximum(rough_count.sum(-1), 1)
        # Along the line between two markers; infinite where no two are seen at once.
        return np.where(count.any(-1), np.sqrt(np.maximum(variance, 0.0) / 2), np.inf)

    def _off_plane(self, normal: np.ndarray, size: np.ndarray, stretch: np.ndarray) -> np.ndarray:
        """By how much (B,) rigid bodies leave the planes of this normal, m rms; 0 for noise."""
        assert self._blocks is not None
        scatter = self._scatter().sum(axis=0)
        count, rough_count = self._blocks.count.sum((0, 2)), self._blocks.rough_count.sum(0)
        with np.errstate(invalid='ignore', divide='ignore'):
            off = np.maximum(normal @ scatter @ normal, 0.0) / count
            noise = (normal @ self._blocks.rough.sum(0) @ normal) / rough_count
            path = np.trace(scatter, axis1=-2, axis2=-1) / count
            off = np.sqrt(off)
            least = _LEAVES_SHARE * np.maximum(size, np.sqrt(path))
            leaves = (off > np.maximum(_LEAVES * np.sqrt(noise), least)) & (stretch < KEEPS * off)
        return np.where(leaves, off, 0.0)


def _pairs(width: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (p,) of markers: each with the next and the one after that."""
    one = np.arange(width)
    return (
        np.concatenate((one[:-1], one[:-2])),
        np.concatenate((one[1:], one[2:])),
    )


def _first_seen(values: np.ndarray, unseen: np.ndarray) -> np.ndarray:
    """The first of the values (k, G, B, w, ...) that is seen; NaN where none is."""
    values = values.reshape(-1, *values.shape[2:])
    unseen = unseen.reshape(-1, *unseen.shape[2:])
    first = np.argmin(unseen, axis=0)
    at = (first, *np.ogrid[tuple(slice(n) for n in first.shape)])
    found = values[at]
    found[unseen[at]] = np.nan
    return np.asarray(found)


def _squares(vectors: np.ndarray) -> np.ndarray:
    """Sums (k, B, 3, 3) of the outer squares of vectors (k, G, B, w, 3)."""
    rows = vectors.swapaxes(1, 2)
    rows = rows.reshape(*rows.shape[:2], -1, 3)
    return np.asarray(rows.swapaxes(-1, -2) @ rows)


def _merged(sums: _Sums, by: int) -> _Sums:
    return _Sums(*(part.reshape(-1, by, *part.shape[1:]).sum(axis=1) for part in sums))


def _concatenated(one: _Sums, other: _Sums) -> _Sums:
    return _Sums(*(np.concatenate(parts) for parts in zip(one, other, strict=True)))
