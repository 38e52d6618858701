"""The one thing every input becomes: the markers of one instant, as arrays without ROS."""

from typing import NamedTuple

import numpy as np


class MarkerFrame(NamedTuple):
    """Markers seen at one instant.

    `points` is float64 of shape (n, 3), in m in the frame `frame_id`; a row with a number that is
    not finite is a marker that was not seen. `identities` names the n rows. `stamp` is in ns.
    """

    stamp: int
    frame_id: str
    identities: tuple[str, ...]
    points: np.ndarray
