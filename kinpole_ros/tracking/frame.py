"""
The one thing every input becomes: the markers of some instants, as arrays without ROS.

Poses of bodies that come as such are points with axes.
"""

from typing import NamedTuple

import numpy as np


class MarkerFrames(NamedTuple):
    """
    Markers seen at T instants, one frame after the other, all of one layout.

    `stamps` (T,) int64, ns, as they came; those of messages are so far from the ends of int64 that
    their differences fit, and so must others be. `points` (T, n, 3) float64, m, in the frame
    `frame_id`; a row with a number that is not finite is a marker that was not seen. `identities`
    names the n rows.

    Where rows are poses, `axes` (T, n, 2, 3) are the unit x and y axes of their frames, and points
    are their origins.
    """

    stamps: np.ndarray
    frame_id: str
    identities: tuple[str, ...]
    points: np.ndarray
    axes: np.ndarray | None = None


def part_of(frames: MarkerFrames, part: slice | np.ndarray) -> MarkerFrames:
    """Some of the frames."""
    axes = None if frames.axes is None else frames.axes[part]
    return frames._replace(stamps=frames.stamps[part], points=frames.points[part], axes=axes)
