"""
Names that two markers exchange from a frame on: each goes on where the other one was going.

What is off by one step is seen against where the markers lead; markers that just pass each other go
on where they lead themselves.
"""

import numpy as np

# Two names are exchanged where their points are so many times nearer to where the other one leads.
_NEARER = 10.0
# Frames that are examined at once, and before them, for where markers lead that are not seen.
_BLOCK, _BEFORE = 250, 25


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
    points = points[begin:]
    # (F, n, n): how far each point is from where each marker leads.
    off = np.linalg.norm(points[:, :, None] - ahead[:, None], axis=-1)
    own = np.diagonal(off, axis1=1, axis2=2)
    with np.errstate(invalid='ignore'):
        nearer = _NEARER * off < own[:, :, None]
    # One of two that is not seen then may have gone anywhere.
    unseen = np.isnan(points[..., 0])
    both = nearer & (nearer.swapaxes(1, 2) | unseen[:, None])
    found = np.argwhere(both)
    if not len(found):
        return None
    frame, one, other = found[0].tolist()
    return frame, min(one, other), max(one, other)


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
