"""
Which frames follow those before, by their stamps.

A frame that comes late is left out, and so is one that comes twice. A clock that steps back, or a
gap longer than the window, restarts everything.
"""

from typing import NamedTuple

import numpy as np


class LastFrame(NamedTuple):
    """The last frame that came, used or not: its stamp, ns, and points; the latest stamp so far."""

    stamp: int
    newest: int
    points: np.ndarray | None


class Arrivals(NamedTuple):
    """
    The verdicts on the first n of the next frames.

    `is_used` (n,) says which frames are used, and `is_new` (n,) which are not repeated. `late` and
    `repeated` are how many are left out for which reason. `last` is frame n - 1. If n is less than
    the number of frames, frame n restarts everything.
    """

    is_used: np.ndarray
    is_new: np.ndarray
    late: int
    repeated: int
    last: LastFrame


def judge_arrivals(
    last: LastFrame,
    stamps: np.ndarray,
    points: np.ndarray,
    window: int,
    max_lateness: int,
    may_be_late: bool,
) -> Arrivals:
    """
    Decide which of the next frames are used.

    Parameters
    ----------
    last : LastFrame
        The frame before.
    stamps : (T,) int64
        Stamps, ns.
    points : (T, ...) float
        Markers, which distinguish a repeated frame from one with the same stamp.
    window : int
        The longest step between two frames, ns.
    max_lateness : int
        The most that a frame may be late, ns.
    may_be_late : bool
        Whether late frames are used. Otherwise each frame has to be later than all before.

    Returns
    -------
    Arrivals
        The verdicts.

    """
    # The latest stamp before each frame.
    latest = np.maximum.accumulate(np.concatenate(((last.newest,), stamps[:-1])))
    before = np.concatenate(((last.stamp,), stamps[:-1]))
    ahead = stamps - latest
    too_late = ahead <= -max_lateness
    # A frame that is too late is just late. Two in a row, the second newer than the first, come
    # from a clock that was set back.
    restarts = too_late & (before < latest) & (before < stamps)
    restarts |= np.abs(ahead) > window
    end = int(restarts.argmax()) if restarts.any() else len(stamps)
    ahead, too_late = ahead[:end], too_late[:end]
    repeated = _find_repeated((stamps == before)[:end], points, last.points)
    if may_be_late:
        late, twice, is_used = too_late, repeated, ~(too_late | repeated)
    else:
        late, twice, is_used = ahead < 0, ahead == 0, ahead > 0
    if end:
        newest = max(last.newest, int(np.maximum.reduce(stamps[:end])))
        last = LastFrame(int(stamps[end - 1]), newest, points[end - 1].copy())
    return Arrivals(is_used, ~repeated, int(late.sum()), int(twice.sum()), last)


def _find_repeated(
    same_stamp: np.ndarray, points: np.ndarray, before: np.ndarray | None
) -> np.ndarray:
    """Find the frames (T,) that are equal to the one before, of those with the same stamp."""
    repeated = np.zeros(len(same_stamp), bool)
    for k in same_stamp.nonzero()[0].tolist():
        earlier = points[k - 1] if k else before
        repeated[k] = earlier is not None and np.array_equal(points[k], earlier, equal_nan=True)
    return repeated
