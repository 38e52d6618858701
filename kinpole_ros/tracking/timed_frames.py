"""Frames with the times at which they were captured."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.history import History

# ns. The least time between two frames.
MIN_STEP = 1000


class TimedFrames(NamedTuple):
    """
    Frames of one layout whose times are certain.

    `times` (T,), ns, and `counts` (T,) are those for the history. `numbers` (T,) are the frames,
    counted through one call of the tracker, with which each became certain.
    """

    frames: MarkerFrames
    times: np.ndarray
    counts: np.ndarray
    numbers: np.ndarray


def split_certain(
    parts: Sequence[MarkerFrames], times: np.ndarray, counts: np.ndarray, numbers: np.ndarray
) -> tuple[list[TimedFrames], list[MarkerFrames]]:
    """Split frames, of which the first T have these times (T,), from those that have to wait."""
    certain, waiting, first = [], [], 0
    for part in parts:
        number = min(len(part.stamps), len(counts) - first)
        rows = slice(first, first + number)
        if number:
            frames = part_of(part, slice(number))
            certain.append(TimedFrames(frames, times[rows], counts[rows], numbers[rows]))
        if number < len(part.stamps):
            waiting.append(part_of(part, slice(number, None)))
        first += number
    return certain, waiting


def times_at_stamps(parts: list[np.ndarray], history: History, may_repeat: bool) -> np.ndarray:
    """
    Return times (T,), ns, of the next frames, which are not counted, from parts of their stamps.

    These may repeat, or step back, if frames come late.
    """
    before = int(parts[0][0]) - MIN_STEP
    if history.end > history.first:
        before = int(history.columns['time'][history.end - 1])
    times = []
    for stamps in parts:
        increase = stamps[0] > before
        if len(stamps) > 1:
            increase = increase and not (stamps[1:] <= stamps[:-1]).any()
        if may_repeat or not increase:
            stamps = increasing(np.concatenate(((before,), stamps)))[1:]
        times.append(stamps)
        before = int(stamps[-1])
    return np.concatenate(times) if times[1:] else times[0]


def increasing(stamps: np.ndarray) -> np.ndarray:
    """Return times (T,) that increase, from stamps that may not."""
    least = MIN_STEP * np.arange(len(stamps))
    return np.asarray(np.maximum.accumulate(stamps - least) + least)
