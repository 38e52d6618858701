"""
How markers scatter in space: sums over blocks of the frames of late.

The blocks are the same however many frames come at once, so that live and replay agree. They grow
with the time that has passed, up to a length, and then the oldest go.
"""

from typing import NamedTuple

import numpy as np

# Frames of a group, the least that is measured.
GROUP = 16
# Blocks that are kept, of up to so many groups each: the last 4096 frames at most.
_BLOCKS, _LONGEST = 32, 8
# A second difference of so many times the median of its marker's is that of an outlier.
_OUTLIER = 10.0


class Sums(NamedTuple):
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


class Scatter:
    """
    Sums over the frames of late of `bodies` bodies of up to `width` markers.

    `kept` are those of the last `look`: of blocks, oldest first, the last one maybe shorter.
    """

    kept: Sums

    def __init__(self, bodies: int, width: int) -> None:
        self._center = np.full((bodies, width, 3), np.nan)
        self._distance = np.full((bodies, _pairs(width)[0].size), np.nan)
        self._blocks: Sums | None = None
        # Groups that do not fill a block yet.
        self._rest: Sums | None = None
        self._length = 1

    def add(self, points: np.ndarray) -> None:
        """Add groups of markers (k, GROUP, B, w, 3), m, NaN for none, to the blocks."""
        groups = self._sums(points)
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
            new = _merged(Sums(*(part[:count] for part in rest)), self._length)
            rest = Sums(*(part[count:] for part in rest))
            blocks = new if blocks is None else _concatenated(blocks, new)
            blocks = Sums(*(part[-_BLOCKS:] for part in blocks))
        self._blocks, self._rest = blocks, rest

    def look(self) -> bool:
        """Whether there is anything to look at: blocks, and what does not fill one yet."""
        parts = []
        if self._blocks is not None:
            parts.append(self._blocks)
        if self._rest is not None and len(self._rest.count):
            parts.append(_merged(self._rest, len(self._rest.count)))
        if parts:
            self.kept = parts[0] if len(parts) == 1 else _concatenated(*parts)
        return bool(parts)

    def about_means(self) -> np.ndarray:
        """Scatter (k, B, 3, 3) of the markers about their means over all blocks."""
        count, first, second = self.kept[:3]
        mean = first.sum(0) / np.maximum(count.sum(0), 1)[..., None]
        cross = np.einsum('kbwi,bwj->kbij', first, mean)
        even = np.einsum('kbw,bwi,bwj->kbij', count, mean, mean)
        return np.asarray(second - cross - cross.swapaxes(-1, -2) + even)

    def size(self) -> np.ndarray:
        """Diameters (B,) of bodies in space: twice the rms distance of markers from their mean."""
        count, off = np.moveaxis(self.kept.pairs[..., :2].sum(0), -1, 0)
        seen = np.count_nonzero(self.kept.count.any(axis=0), axis=-1)
        with np.errstate(invalid='ignore', divide='ignore'):
            mean = self._distance + off / count
            square = np.where(count > 0, mean**2, 0.0).sum(-1) / np.count_nonzero(count, axis=-1)
            # Of n markers the distances have 2 n / (n - 1) times that, in the square.
            return np.asarray(np.sqrt(2 * square * (seen - 1) / seen))

    def stretch(self) -> np.ndarray:
        """By how much (B,) the distances of markers change beyond their noise, m per axis."""
        count, change, square, rough_count, rough = np.moveaxis(self.kept.pairs.sum(0), -1, 0)
        spread = (square - change**2 / np.maximum(count, 1)).sum(-1)
        with np.errstate(invalid='ignore', divide='ignore'):
            variance = spread / count.sum(-1) - rough.sum(-1) / np.maximum(rough_count.sum(-1), 1)
        # Along the line between two markers; infinite where no two are seen at once.
        return np.where(count.any(-1), np.sqrt(np.maximum(variance, 0.0) / 2), np.inf)

    def _sums(self, points: np.ndarray) -> Sums:
        """Sums over groups of markers (k, G, B, w, 3)."""
        unseen = np.isnan(points[..., 0])
        bent = points[:, :-2] - 2 * points[:, 1:-1] + points[:, 2:]
        size = np.sqrt(np.einsum('...i,...i', bent, bent))
        # NaN is sorted to the end.
        ranked = np.sort(size, axis=1)
        middle = np.maximum(np.count_nonzero(~np.isnan(size), axis=1) - 1, 0) // 2
        median = np.take_along_axis(ranked, middle[:, None], axis=1)
        outlying = size > _OUTLIER * median
        if outlying.any():
            bent[outlying] = np.nan
            for k in range(3):
                unseen[:, k : k + outlying.shape[1]] |= outlying
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
        new = np.isnan(self._distance)
        if new.any():
            self._distance[new] = _first_seen(distance, ~both)[new]
        change = np.where(both, distance - self._distance, 0.0)
        distance[~both] = np.nan
        bent_distance = distance[:, :-2] - 2 * distance[:, 1:-1] + distance[:, 2:]
        known = ~np.isnan(bent_distance)
        rough_distance = np.where(known, bent_distance, 0.0) ** 2 / 6
        sums = both, change, change**2, known, rough_distance
        pairs = np.stack([each.sum(1) for each in sums], axis=-1)
        return Sums(
            seen.sum(1, dtype=float),
            off.sum(1),
            _squares(off),
            # Of white noise the second difference has six times the variance.
            _squares(bent) / 6,
            rough_count.astype(float),
            pairs,
        )


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


def _merged(sums: Sums, by: int) -> Sums:
    return Sums(*(part.reshape(-1, by, *part.shape[1:]).sum(axis=1) for part in sums))


def _concatenated(one: Sums, other: Sums) -> Sums:
    return Sums(*(np.concatenate(parts) for parts in zip(one, other, strict=True)))
