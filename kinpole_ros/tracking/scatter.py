"""
Scatter of markers in space, as sums over blocks of the recent frames.

Blocks are of groups of frames, which do not depend on how many frames come at once, so live and
replay agree.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

# Frames of a group, the smallest unit.
GROUP = 16
# Groups that are kept: the last 4096 frames; most blocks of these.
_MAX_GROUPS, _MAX_BLOCKS = 256, 32
# A second difference of so many times the median of its marker is an outlier.
_OUTLIER_RATIO = 10.0


class Sums(NamedTuple):
    """
    Sums over k blocks of frames, for B bodies of w markers and p pairs of markers.

    Of the markers, relative to where each was first seen: count, first and second moments. Of their
    second differences: squares and count. Of the distances of pairs, relative to the first ones:
    count, first and second moment, count and squares of the second differences.
    """

    count: np.ndarray  # (k, B, w)
    first: np.ndarray  # (k, B, w, 3)
    second: np.ndarray  # (k, B, 3, 3)
    rough: np.ndarray  # (k, B, 3, 3)
    rough_count: np.ndarray  # (k, B)
    pairs: np.ndarray  # (k, B, p, 5)


class Scatter:
    """
    Sums over the recent frames of `bodies` bodies of up to `width` markers.

    `sums` are those of the blocks at the last `update`, oldest first; the last may be shorter.
    """

    sums: Sums

    def __init__(self, bodies: int, width: int) -> None:
        self._center = np.full((bodies, width, 3), np.nan)
        self._distance = np.full((bodies, _pairs(width)[0].size), np.nan)
        self._groups: deque[Sums] = deque(maxlen=_MAX_GROUPS)

    def add(self, points: np.ndarray) -> None:
        """Add groups of markers (k, GROUP, B, w, 3), m, NaN for none."""
        sums = self._sums_of(points)
        self._groups.extend(map(Sums._make, zip(*sums, strict=True)))

    def update(self) -> bool:
        """Update `sums` with all groups; return whether there are any."""
        count = len(self._groups)
        if count:
            begins = np.arange(0, count, -(-count // _MAX_BLOCKS))
            parts = zip(*self._groups, strict=True)
            self.sums = Sums._make(np.add.reduceat(np.stack(part), begins) for part in parts)
        return count > 0

    def about_means(self) -> np.ndarray:
        """Return the scatter (k, B, 3, 3) of the markers about their means over all blocks."""
        count, first, second = self.sums[:3]
        mean = first.sum(0) / np.maximum(count.sum(0), 1)[..., None]
        cross = np.einsum('kbwi,bwj->kbij', first, mean)
        even = np.einsum('kbw,bwi,bwj->kbij', count, mean, mean)
        return np.asarray(second - cross - cross.swapaxes(-1, -2) + even)

    def size(self) -> np.ndarray:
        """Return the diameters (B,) of bodies in space: twice the rms distance from the mean."""
        count, off = np.moveaxis(self.sums.pairs[..., :2].sum(0), -1, 0)
        seen = np.count_nonzero(self.sums.count.any(axis=0), axis=-1)
        with np.errstate(invalid='ignore', divide='ignore'):
            mean = self._distance + off / count
            square = np.where(count > 0, mean**2, 0.0).sum(-1) / np.count_nonzero(count, axis=-1)
            # Squared distances of pairs are 2 n / (n - 1) times those from the mean of n markers.
            return np.asarray(np.sqrt(2 * square * (seen - 1) / seen))

    def stretch(self) -> np.ndarray:
        """Return the change (B,) of the distances of markers beyond their noise, m per axis."""
        count, change, square, rough_count, rough = np.moveaxis(self.sums.pairs.sum(0), -1, 0)
        spread = (square - change**2 / np.maximum(count, 1)).sum(-1)
        with np.errstate(invalid='ignore', divide='ignore'):
            variance = spread / count.sum(-1) - rough.sum(-1) / np.maximum(rough_count.sum(-1), 1)
        # The distance is along one line; infinite if no two markers are seen at once.
        return np.where(count.any(-1), np.sqrt(np.maximum(variance, 0.0) / 2), np.inf)

    def _sums_of(self, points: np.ndarray) -> Sums:
        """Sums over groups of markers (k, G, B, w, 3)."""
        unseen = np.isnan(points[..., 0])
        bent = points[:, :-2] - 2 * points[:, 1:-1] + points[:, 2:]
        size = np.sqrt(np.einsum('...i,...i', bent, bent))
        # NaN is sorted to the end.
        ranked = np.sort(size, axis=1)
        middle = np.maximum(np.count_nonzero(~np.isnan(size), axis=1) - 1, 0) // 2
        median = np.take_along_axis(ranked, middle[:, None], axis=1)
        is_outlier = size > _OUTLIER_RATIO * median
        if is_outlier.any():
            bent[is_outlier] = np.nan
            for k in range(3):
                unseen[:, k : k + is_outlier.shape[1]] |= is_outlier
        bent = np.where(np.isnan(bent), 0.0, bent)
        rough_count = np.count_nonzero(bent.any(axis=-1), axis=(1, 3))
        new = np.isnan(self._center[..., 0])
        if new.any():
            self._center[new] = _first_seen(points, unseen)[new]
        seen = ~unseen
        off = np.where(seen[..., None], points - self._center, 0.0)
        i, j = _pairs(points.shape[3])
        distance = points[:, :, :, j] - points[:, :, :, i]
        distance = np.sqrt(np.einsum('...i,...i', distance, distance))
        pair_seen = seen[..., i] & seen[..., j]
        new = np.isnan(self._distance)
        if new.any():
            self._distance[new] = _first_seen(distance, ~pair_seen)[new]
        change = np.where(pair_seen, distance - self._distance, 0.0)
        distance[~pair_seen] = np.nan
        bent_distance = distance[:, :-2] - 2 * distance[:, 1:-1] + distance[:, 2:]
        has_difference = ~np.isnan(bent_distance)
        rough_distance = np.where(has_difference, bent_distance, 0.0) ** 2 / 6
        terms = pair_seen, change, change**2, has_difference, rough_distance
        pairs = np.stack([term.sum(1) for term in terms], axis=-1)
        return Sums(
            count=seen.sum(1, dtype=float),
            first=off.sum(1),
            second=_squares(off),
            # The second difference of white noise has six times its variance.
            rough=_squares(bent) / 6,
            rough_count=rough_count.astype(float),
            pairs=pairs,
        )


def _pairs(width: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (p,) of markers: each with the next and the one after that."""
    markers = np.arange(width)
    return (
        np.concatenate((markers[:-1], markers[:-2])),
        np.concatenate((markers[1:], markers[2:])),
    )


def _first_seen(values: np.ndarray, unseen: np.ndarray) -> np.ndarray:
    """The first visible values of (k, G, B, w, ...); NaN if none is."""
    values = values.reshape(-1, *values.shape[2:])
    unseen = unseen.reshape(-1, *unseen.shape[2:])
    first = np.argmin(unseen, axis=0)
    at = (first, *np.ogrid[tuple(slice(n) for n in first.shape)])
    first_values = values[at]
    first_values[unseen[at]] = np.nan
    return np.asarray(first_values)


def _squares(vectors: np.ndarray) -> np.ndarray:
    """Sums (k, B, 3, 3) of the outer squares of vectors (k, G, B, w, 3)."""
    rows = vectors.swapaxes(1, 2)
    rows = rows.reshape(*rows.shape[:2], -1, 3)
    return np.asarray(rows.swapaxes(-1, -2) @ rows)
