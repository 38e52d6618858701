"""The one thing every input becomes: the markers of consecutive instants, as arrays without ROS."""

from typing import NamedTuple

import numpy as np


class MarkerFrames(NamedTuple):
    """
    Consecutive frames of one layout of markers.

    `stamps` is int64 of shape (T,), in ns; `points` is float64 of shape (T, n, 3), in m in the
    frame `frame_id`; a row with a number that is not finite is a marker that was not seen, and NaN
    as a whole. `identities` names the n markers.
    """

    stamps: np.ndarray
    frame_id: str
    identities: tuple[str, ...]
    points: np.ndarray


class MarkerFrame(NamedTuple):
    """One frame of MarkerFrames, for a tracker that takes them one by one."""

    stamp: int
    frame_id: str
    identities: tuple[str, ...]
    points: np.ndarray
