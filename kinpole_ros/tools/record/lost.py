"""Frames without any result: lost on the way. One that has a result may be undetermined instead."""

import numpy as np

# Intervals that differ by less than this factor count as one; the most frequent one is usual.
_ALIKE = 1.2
# A line crosses one lost frame, which cannot be seen, and no more.
_MOST_CROSSED = 1


def usual_interval(stamp: np.ndarray) -> float:
    """
    Return the interval of frames with stamps (T,), ns, also if most frames are lost.

    It is the most frequent interval, not the median, which two lost frames of three would change.
    """
    intervals = np.diff(stamp)
    intervals = intervals[intervals > 0]
    if not len(intervals):
        return float('inf')
    classes = np.round(np.log(intervals) / np.log(_ALIKE))
    values, counts = np.unique(classes, return_counts=True)
    usual = np.median(intervals[classes == values[counts.argmax()]])
    return float(np.median(intervals[np.abs(np.log(intervals / usual)) < 2 * np.log(_ALIKE)]))


def lost_frames(stamp: np.ndarray, interval: float) -> np.ndarray:
    """Return how many frames are lost (T - 1,) between stamps (T,), ns, for a usual interval."""
    return np.maximum(np.round(np.diff(stamp) / interval) - 1, 0).astype(np.int64)


def breaks_of(frames: np.ndarray, stamp: np.ndarray) -> np.ndarray:
    """Return the indices after which a line through `stamp` stops, for the stamps of all frames."""
    return np.flatnonzero(lost_frames(stamp, usual_interval(frames)) > _MOST_CROSSED)


def lost_count(frames: np.ndarray) -> int:
    """Return how many frames are lost between the first and the last one."""
    return int(lost_frames(frames, usual_interval(frames)).sum())


def lost_spans(frames: np.ndarray) -> np.ndarray:
    """Return start and length (K, 2), ns, of the times in which all frames are lost."""
    interval = usual_interval(frames)
    gaps = np.flatnonzero(lost_frames(frames, interval))
    return np.stack((frames[gaps] + interval / 2, np.diff(frames)[gaps] - interval), axis=-1)


def broken(values: np.ndarray, breaks: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """Return the values with NaN at each break, and the indices of isolated values."""
    values = np.insert(values, np.unique(breaks) + 1, np.nan)
    gap = np.concatenate([[True], np.isnan(values), [True]])
    isolated = ~gap[1:-1] & gap[:-2] & gap[2:]
    return values, np.flatnonzero(isolated).tolist()
