"""
Which markers of a message belong to which body, and where they are, in m.

Messages name their markers in their own order, and markers come and go; bodies want theirs always
in the same places. Most layouts come again and again, so each is looked up once.
"""

from collections.abc import Sequence

import numpy as np

from kinpole_ros.frame import MarkerFrames
from kinpole_ros.parameters import Settings

# A body of all markers takes new ones up to this many: a driver that numbers its markers anew in
# every frame must not fill the memory.
MOST_MARKERS = 1024
_MOST_LAYOUTS = 64
# m. No marker is that far, and the squares of what is nearer do not overflow.
FARTHEST_MARKER = 1e15


class Roster:
    """
    The markers of the bodies of `settings`.

    `markers` are the names of each body's, `width` is for how many markers a body there is room,
    `wanted` how many there are of all bodies, and `unknown` how many of the last new layout no body
    names. `absent` are the markers of each body that the last message lacks, and `identities` those
    it has.
    """

    def __init__(self, settings: Settings) -> None:
        self.markers = [list(markers) for markers in settings.bodies.values()]
        self._all_markers = not any(self.markers)
        self.scale = settings.scale
        self._places: dict[tuple[str, ...], tuple[np.ndarray, bool, list[list[str]]]] = {}
        self.width = max(2, *(len(markers) for markers in self.markers))
        self.wanted = sum(map(len, self.markers))
        self.unknown = 0
        self.absent: list[list[str]] = []
        self.identities: tuple[str, ...] = ()

    def sort(self, frames: MarkerFrames) -> np.ndarray:
        """
        The markers (T, B, width, 3) of each body, m, NaN for none.

        A body of all markers takes those not met before; it may be wider afterwards.
        """
        self.identities = frames.identities
        place, complete, self.absent = self._place(frames.identities)
        rows = frames.points
        if not complete:
            # One more row of NaN stands for every marker that is not in the message.
            padded = np.full((len(rows), rows.shape[1] + 1, 3), np.nan)
            padded[:, :-1] = rows
            rows = padded
        solid = rows.take(place, axis=1)
        if self.scale != 1.0:
            with np.errstate(over='ignore'):
                solid *= self.scale
        near = np.abs(solid) < FARTHEST_MARKER
        if np.count_nonzero(near) < near.size:
            solid[~near.all(axis=-1)] = np.nan
        return solid

    def places(self) -> list[list[int]]:
        """Where each body's markers are in the last message; none if some are not there."""
        if any(self.absent):
            return []
        place, _, _ = self._place(self.identities)
        both = zip(place.tolist(), self.markers, strict=True)
        return [row[: len(markers)] for row, markers in both]

    def _place(self, identities: tuple[str, ...]) -> tuple[np.ndarray, bool, list[list[str]]]:
        """
        Where (B, n) each body's markers are in a message, whether there are n of each in it, and
        which of each body it lacks.

        What is not there has the last place + 1.
        """
        found = self._places.get(identities)
        if found is None:
            if self._all_markers:
                self._take_new(identities)
            nowhere = len(identities)
            place = np.full((len(self.markers), self.width), nowhere)
            for body, markers in enumerate(self.markers):
                place[body, : len(markers)] = [find_marker(name, identities) for name in markers]
            absent = [
                [name for name, where in zip(markers, places, strict=False) if where == nowhere]
                for markers, places in zip(self.markers, place.tolist(), strict=True)
            ]
            self.unknown = len(set(range(nowhere)) - set(place.ravel().tolist()))
            if len(self._places) > _MOST_LAYOUTS:
                self._places.clear()
            complete = bool((place < nowhere).all())
            self._places[identities] = found = place, complete, absent
        return found

    def _take_new(self, identities: tuple[str, ...]) -> None:
        """A body of all markers: add those not met before."""
        markers = self.markers[0]
        known = set(markers)
        new = [name for name in dict.fromkeys(identities) if name not in known]
        markers += new[: MOST_MARKERS - len(markers)]
        self.wanted = len(markers)
        if len(markers) > self.width:
            self.width = len(markers)
            self._places.clear()


def find_marker(marker: str, identities: Sequence[str]) -> int:
    """
    Place of a marker in a message, len(identities) if it is not there.

    A name stands for the full identity, else for the one marker of that namespace, else for the
    one of that id: 'tip/3', 'tip' or '3'.
    """
    if marker in identities:
        return list(identities).index(marker)
    for part in (0, 2):
        found = [
            k
            for k, name in enumerate(identities)
            if '/' in name and name.rpartition('/')[part] == marker
        ]
        if len(found) == 1:
            return found[0]
    return len(identities)
