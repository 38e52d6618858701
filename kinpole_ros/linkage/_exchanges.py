"""
Names that two markers exchange from a frame on: each goes on where the other one was going.

What is off by one step is seen against where the markers lead; markers that just pass each other go
on where they lead themselves. A marker that was hidden may lead past another one by chance, so
names are exchanged only where distances to the other markers of the bodies are kept better by it
than chance explains.
"""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.linkage._near import near_pairs
from kinpole_ros.tracking.thresholds import N_SIGMA

# Two names are exchanged where their points are so many times nearer to where the other one leads.
_NEARER = 10.0
# Frames that are examined at once, and before them, which tell where markers lead that are not seen
# and how well they keep their distances.
_BLOCK, _BEFORE = 250, 250
# Fewer frames do not tell how well two markers keep their distance.
_FEWEST = 10
# Distances that spread by up to so many times the least of a marker are to markers of its body.
_LOOSER = 2.5
# Share of a distance that is rounding.
_ROUNDING = 1e-9


def correct_exchanges(
    points: np.ndarray, steps: np.ndarray
) -> tuple[np.ndarray, list[tuple[int, int, int]]]:
    """
    Points (T, n, 3), NaN for none, as if no names had been exchanged, and where they were.

    `steps` (T,) number the frames. An exchange is a frame and the columns of two markers.
    """
    corrected, found, first = points.copy(), [], 0
    while first < len(points):
        start = max(first - _BEFORE, 0)
        rows = slice(start, first + _BLOCK)
        one = _first_exchange(corrected[rows], steps[rows], first - start)
        if one is None:
            first += _BLOCK
            continue
        first, two = first + one[0], [one[1], one[2]]
        # What comes next goes on from there.
        corrected[first:, two] = corrected[first:, two[::-1]]
        found.append((first, two[0], two[1]))
    return corrected, found


def _first_exchange(
    points: np.ndarray, steps: np.ndarray, begin: int
) -> tuple[int, int, int] | None:
    """How many frames after `begin` names are exchanged first, and the two columns."""
    ahead = _ahead(points, steps)[begin:]
    whole, points = points, points[begin:]
    for frame, (now, leads) in enumerate(zip(points, ahead, strict=True)):
        # How far each point is from where its own marker leads, and which others lead nearer.
        own = np.linalg.norm(now - leads, axis=-1)
        ones, others = near_pairs(now, leads, own / _NEARER)
        nearer = _NEARER * np.linalg.norm(now[ones] - leads[others], axis=-1) < own[ones]
        pairs = set(zip(ones[nearer].tolist(), others[nearer].tolist(), strict=True))
        for one, other in sorted(pairs):
            # One of two that is not seen then may have gone anywhere.
            if (other, one) not in pairs and not np.isnan(now[other, 0]):
                continue
            two = [min(one, other), max(one, other)]
            if _keeps_distances_better(whole[: begin + frame], now, two):
                return frame, two[0], two[1]
    return None


def _keeps_distances_better(before: np.ndarray, now: np.ndarray, two: Sequence[int]) -> bool:
    """
    Whether the points `now` (n, 3) keep distances better with the names `two` exchanged.

    Distances are those `before` (F, n, 3) to the markers that a marker has kept its distance to
    best, in standard deviations. A body of just these two markers has none: there only the motion
    tells.
    """
    exchanged = now.copy()
    exchanged[two] = now[two[::-1]]
    excess = 0.0
    for own, other in (two, two[::-1]):
        distances = np.linalg.norm(before - before[:, own, None], axis=-1)
        seen = np.isfinite(distances)
        # Medians, so that names that were wrong in a few frames do not count.
        few = seen.sum(axis=0) < _FEWEST
        distances[:, few] = 0.0
        mean = np.nanmedian(distances, axis=0)
        spread = 1.4826 * np.nanmedian(np.abs(distances - mean), axis=0)
        spread[few | (np.arange(len(now)) == own)] = np.inf
        to_other, spread[other] = spread[other], np.inf
        least = float(spread.min())
        if _LOOSER * to_other < least and np.isfinite(now[two, 0]).all():
            # Only the two themselves keep their distance.
            return True
        mates = spread < _LOOSER * least
        for points, sign in ((now, 1.0), (exchanged, -1.0)):
            off = np.linalg.norm(points[mates] - points[own], axis=-1) - mean[mates]
            seen_now = np.isfinite(off)
            floor = _ROUNDING * np.maximum(mean[mates], 1e-300)
            deviations = np.abs(off) / np.maximum(spread[mates], floor)
            excess += sign * float(np.sum(deviations[seen_now] ** 2))
    return excess > N_SIGMA**2


def _ahead(points: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Where the last two places of each marker lead (T, n, 3), NaN where there are none."""
    number = np.arange(len(points))[:, None]
    seen = np.isfinite(points[..., 0])
    # The last frames before each in which a marker was seen, -1 for none.
    last = np.maximum.accumulate(np.where(seen, number, -1), axis=0)
    last = np.vstack((np.full((1, seen.shape[1]), -1), last[:-1]))
    before = np.where(last > 0, np.take_along_axis(last, np.maximum(last, 0), axis=0), -1)
    one, two = (
        np.take_along_axis(points, np.maximum(k, 0)[..., None], axis=0) for k in (last, before)
    )
    interval = steps[np.maximum(last, 0)] - steps[np.maximum(before, 0)]
    gap = steps[:, None] - steps[np.maximum(last, 0)]
    speed = (one - two) / np.maximum(interval, 1)[..., None]
    return np.where((before >= 0)[..., None], one + gap[..., None] * speed, np.nan)
