"""Frames with the times at which they were captured."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.tracking.frame import MarkerFrames, part_of


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
