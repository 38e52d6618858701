"""Frames whose markers are in the slots of the bodies, and where these are in their message."""

from collections import Counter
from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import Slots
from kinpole_ros.tracking.frame import MarkerFrames

# What is counted: markers with the name of another body's marker, and with a name of no body.
OTHERS, RENAMED = 'markers_of_others', 'markers_renamed'


class FrameLayout(NamedTuple):
    """
    Where the markers are in messages with the same identities.

    `rows` (B, n) are the rows of the markers, the number of rows for none. `named_rows` are those
    by the names alone, and `absent` the markers of each body that are not named. `unassigned` are
    the rows in no slot, none where names mean nothing, and `is_numbered` says whether the names are
    just 0, 1, 2... Of the markers in slots that the names do not give them, `foreign_names` have
    the name of another body's marker and `unknown_names` one of no body. `slots` are the rows as
    the slots take them: in the order of exchanged markers, and without withheld bodies; None while
    they are to be made. `all_rows` take the rows as they are.
    """

    rows: np.ndarray
    named_rows: np.ndarray
    absent: list[list[str]]
    foreign_names: int
    unknown_names: int
    unassigned: np.ndarray
    is_numbered: bool
    all_rows: Slots
    slots: Slots | None = None


class PlacedFrames(NamedTuple):
    """
    Frames of one layout whose markers are in the slots of the bodies.

    Attributes
    ----------
    frames : MarkerFrames
        The frames, with contiguous points.
    points, heights : (T, B, n)
        Markers in the plane, complex, m, NaN for none, and for all while the plane is not known;
        their heights along its normal, m. C reads both; `correct_next` corrects rows before that.
    in_space : (T, B, n, 3) float or None
        Markers in the frame of the message, m, of poses or while the plane is not known.
    tilts : (T, B) complex or None
        Tilts of poses, see `tilts_of`; None for markers, and while the plane is not known.
    size : int
        Number of rows of the message.
    is_nameless : bool
        Whether the names are indices, which may change at any time.

    """

    frames: MarkerFrames
    points: np.ndarray
    heights: np.ndarray
    in_space: np.ndarray | None
    tilts: np.ndarray | None
    size: int
    is_nameless: bool

    @property
    def identities(self) -> tuple[str, ...]:
        """Names of the rows of the message."""
        return self.frames.identities


def count_misnamed(counts: Counter[str], layout: FrameLayout, frames: int) -> None:
    """Count the markers with wrong names in so many frames; take them back if it is negative."""
    if layout.foreign_names:
        counts[OTHERS] += frames * layout.foreign_names
    if layout.unknown_names:
        counts[RENAMED] += frames * layout.unknown_names
