"""
Which markers of a message belong to which body, and where they are, in m.

Messages name their markers in their own order, and markers come and go; bodies want theirs always
in the same places. Most layouts come again and again, so each is looked up once.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.parameters import POSE_POINTS, Settings
from kinpole_ros.tracking.plane import Plane

# A body of all markers takes new ones up to this many: a driver that numbers its markers anew in
# every frame must not fill the memory.
MOST_MARKERS = 1024
_MOST_LAYOUTS = 64
# m, from the origin of a pose to the points in space that tell its axes.
_ARM = abs(POSE_POINTS[0])
# What of a body's turning is in the plane, of 2: with less it has turned over.
_LEAST_TURN = 0.1
# m. No marker is that far, and the squares of what is nearer do not overflow.
FARTHEST_MARKER = 1e15


class Layout(NamedTuple):
    """
    Where the markers are in messages with the same identities.

    `place` (B, n) is the row of each, the number of rows for none, and `named` the same by the
    names alone; `complete` says whether there are n of each body, and `absent` which are not named.
    `others` markers have the name of another body's, and `renamed` one that no body has; `extras`
    are the rows that are no marker, and `indexed` says whether the names are those of places.
    """

    place: np.ndarray
    named: np.ndarray
    complete: bool
    absent: list[list[str]]
    others: int
    renamed: int
    extras: np.ndarray
    indexed: bool


class Roster:
    """
    The markers of the bodies of `settings`.

    `markers` are the names of each body's, `width` is for how many markers a body there is room,
    `wanted` how many there are of all bodies, and `unknown` how many of the last new layout no body
    names. `absent` are the markers of each body that the last message lacks, and `identities` those
    it has. Where bodies are `posed` a message has one row of each, which stands for all its points.
    """

    def __init__(self, settings: Settings, posed: bool = False) -> None:
        self.posed = posed
        self.scale = settings.scale
        # The plane that points are matched in; None while it is not known.
        self.plane: Plane | None = None
        # Of a body that is known by its shape alone markers have names in words to the user only.
        self.markers = [
            list(markers)
            or [f'{body}_{k}' for k in range(0 if posed else len(settings.shapes.get(body, ())))]
            for body, markers in settings.bodies.items()
        ]
        self._by_shape = settings.marker_identity == 'shape'
        self.all_markers = not any(self.markers)
        self._places: dict[tuple[str, ...], Layout] = {}
        self.width = (
            len(POSE_POINTS) if posed else max(2, *(len(markers) for markers in self.markers))
        )
        self.wanted = sum(map(len, self.markers))
        self.unknown = 0
        self.absent: list[list[str]] = []
        self.identities: tuple[str, ...] = ()
        # What names stand for as far as that is not what the parameters say, and which slot of the
        # bodies, counted through, takes the place of which.
        self._aliases: dict[str, tuple[int, int]] = {}
        self._order: np.ndarray | None = None
        self._frames = np.zeros((0, 0, 3))
        # Of poses: the axes of their frames, and which bodies' z axes point against the normal, -1
        # while not known.
        self._axes = np.zeros((0, 0, 2, 3))
        self._upside_down = np.full(len(self.markers), -1)
        self.layout: Layout | None = None
        # Whether names in the last message say anything.
        self.in_order = True

    def sort(self, frames: MarkerFrames) -> np.ndarray:
        """
        The markers (T, B, width, 3) of each body, m, NaN for none.

        A body of all markers takes those not met before; it may be wider afterwards.
        """
        self.identities = frames.identities
        self.layout = self._place(frames.identities)
        self.absent = self.layout.absent
        self._frames = frames.points
        if frames.axes is not None:
            self._axes = frames.axes
        return self.sorted(0)

    def sorted(self, first: int) -> np.ndarray:
        """The same of the frames sorted last, from `first` on, as their names are known now."""
        assert self.layout is not None
        place, rows = self.layout.place, self._frames[first:]
        if not self.layout.complete:
            # One more row of NaN stands for every marker that is not in the message.
            padded = np.full((len(rows), rows.shape[1] + 1, 3), np.nan)
            padded[:, :-1] = rows
            rows = padded
        solid = self._in_meters(rows.take(place, axis=1))
        if self.posed:
            axes = self._axes[first:]
            none = np.full((len(axes), 1, 2, 3), np.nan)
            axes = np.concatenate((axes, none), axis=1).take(place[:, 0], axis=1)
            solid[:, :, 1:] += _ARM * axes
        return solid

    def flat(self, solid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Points (..., 3) in the plane, complex (...), and their heights, m.

        NaN while the plane is not known.
        """
        if self.plane is None:
            nowhere = np.full(solid.shape[:-1], complex(np.nan, np.nan))
            return nowhere, nowhere.real
        return self._turned(solid) if self.posed else self.plane.project(solid)

    def _turned(self, solid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        The same of poses (T, B, 3, 3), each its origin and a point on either axis: POSE_POINTS.

        Of how a body is turned, that about the normal counts: the rest is how its frame sits on it,
        and noise. Its angle is 0 where the axes of its frame are parallel to those of the plane, or
        turned by half a turn about the first of them.
        """
        assert self.plane is not None
        place, height = self.plane.project(solid[:, :, 0])
        axes = _axes_of(solid)
        # Where the axes of the plane come to, of a body that they are fixed to. Summed by hand, as
        # a matrix product rounds otherwise where there are more frames.
        first, second = (
            self.plane.project(x * axes[0] + y * axes[1] + z * axes[2])[0]
            for x, y, z in self.plane.basis[:2]
        )
        turns = np.stack((first - 1j * second, first + 1j * second))
        for b in np.flatnonzero(self._upside_down < 0).tolist():
            seen = np.flatnonzero(~np.isnan(turns[0, :, b]))
            if len(seen):
                self._upside_down[b] = int(np.argmax(np.abs(turns[:, seen[0], b])))
        turn = np.where(self._upside_down > 0, turns[1], turns[0])
        length = np.abs(turn)
        turned = length > _LEAST_TURN
        turn = np.where(turned, turn, complex(np.nan, np.nan)) / np.where(turned, length, 1.0)
        points = place[..., None] + turn[..., None] * np.array(POSE_POINTS)
        return points, np.where(np.isnan(points.real), np.nan, height[..., None])

    def tilts(self, solid: np.ndarray) -> np.ndarray:
        """
        Compute how far poses are tilted out of the plane, and in which direction.

        Parameters
        ----------
        solid : array, shape (T, B, 3, 3)
            Poses as `sort` returns them, m, for which `flat` was called before.

        Returns
        -------
        array, shape (T, B), complex
            The normal of the plane as seen from the frame of the body, in Lambert's equal-area
            projection: the sine of half the tilt, in the direction in which the normal leans.
        """
        assert self.plane is not None
        # Sums by hand, for the reason given in `_turned`.
        x, y, z = self.plane.normal
        axes = _axes_of(solid)
        own = x * axes[..., 0] + y * axes[..., 1] + z * axes[..., 2]
        first, second, third = (
            x * own[0] + y * own[1] + z * own[2] for x, y, z in self.plane.basis
        )
        side = np.where(self._upside_down > 0, -1.0, 1.0)
        with np.errstate(divide='ignore', invalid='ignore'):
            return np.asarray((first + 1j * side * second) / np.sqrt(2 * (1 + side * third)))

    def all_points(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """All points (m,) of a frame sorted last, complex, and their heights, m."""
        return self.flat(self._in_meters(np.array(self._frames[frame])))

    def extras(self, first: int, count: int) -> np.ndarray:
        """The points (T, e) that are no markers, of `count` frames sorted last from `first` on."""
        assert self.layout is not None
        rows = self._frames[first : first + count].take(self.layout.extras, axis=1)
        return self.flat(self._in_meters(rows))[0]

    def _in_meters(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) scaled in place; NaN where they cannot be of a marker."""
        if self.scale != 1.0:
            with np.errstate(over='ignore'):
                points *= self.scale
        near = np.abs(points) < FARTHEST_MARKER
        if np.count_nonzero(near) < near.size:
            points[~near.all(axis=-1)] = np.nan
        return points

    def correct(self, place: np.ndarray, for_all: bool) -> None:
        """
        The messages of the last layout have the markers at `place` (B, n), -1 for none.

        With `for_all` the names in them stand for the same markers in other layouts too.
        """
        layout = self.layout
        assert layout is not None
        nowhere = len(self.identities)
        place = np.where(place < 0, nowhere, place)
        self._places[self.identities] = self.layout = _layout(
            self.identities, place, layout.named, layout.absent
        )
        if not for_all:
            return
        for b, k in zip(*np.nonzero(place < nowhere), strict=True):
            name = self.identities[place[b, k]]
            self._aliases.pop(name, None)
            if place[b, k] != layout.named[b, k]:
                self._aliases[name] = int(b), int(k)
        while len(self._aliases) > MOST_MARKERS:
            del self._aliases[next(iter(self._aliases))]

    def permute(self, order: np.ndarray) -> None:
        """From now on slots of bodies stand for others: `order` (B, n), counted through."""
        self._order = order if self._order is None else self._order.ravel()[order]
        self._places.clear()
        self._aliases.clear()
        if self.identities:
            self.layout = self._place(self.identities)

    def lacking(self) -> list[list[str]]:
        """Markers of each body that the last message lacks, where less than two are there."""
        if self.layout is None or self._by_shape:
            return []
        there = (self.layout.place < len(self.identities)).sum(axis=1).tolist()
        return [names if n < 2 else [] for n, names in zip(there, self.absent, strict=True)]

    def places(self) -> list[list[int]]:
        """Where each body's markers are in the last message; none if that is not known of all."""
        if not self.in_order:
            return []
        place = self._place(self.identities).place
        both = zip(place.tolist(), self.markers, strict=True)
        found = [row[: len(markers)] for row, markers in both]
        return [] if any(len(self.identities) in row for row in found) else found

    def _place(self, identities: tuple[str, ...]) -> Layout:
        """Where each body's markers are in a message; what is not there has the last place + 1."""
        found = self._places.get(identities)
        if found is None:
            if self.all_markers:
                self._take_new(identities)
            nowhere, places = len(identities), MarkerPlaces(identities)
            place = np.full((len(self.markers), self.width), nowhere)
            for body, markers in enumerate(self.markers):
                where = [places.find(name) for name in markers]
                place[body] = where[0] if self.posed and where else place[body]
                if not self.posed:
                    place[body, : len(markers)] = where
            absent = [
                [name for name, where in zip(markers, row, strict=False) if where == nowhere]
                for markers, row in zip(self.markers, place.tolist(), strict=True)
            ]
            if self._order is not None:
                place = place.ravel()[self._order]
            self.unknown = len(set(range(nowhere)) - set(place.ravel().tolist()))
            if self._by_shape:
                self.unknown = 0
            if len(self._places) > _MOST_LAYOUTS:
                self._places.clear()
            named, place = place, self._with_aliases(identities, place)
            found = _layout(identities, place, named, absent)
            if self.posed:
                # Names of poses are what they say, and the others are of nobody.
                found = found._replace(extras=found.extras[:0], indexed=False)
            self._places[identities] = found
        return found

    def _with_aliases(self, identities: tuple[str, ...], named: np.ndarray) -> np.ndarray:
        """Where markers are, that have other names for now; a name of its own goes first."""
        here = [name for name in self._aliases if name in identities]
        if not here:
            return named
        nowhere, place = len(identities), named.copy()
        for b, k in zip(*np.nonzero(named < nowhere), strict=True):
            if identities[named[b, k]] in self._aliases:
                place[b, k] = nowhere
        for name in here:
            slot = self._aliases[name]
            if place[slot] == nowhere:
                place[slot] = identities.index(name)
        return place

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


def _axes_of(solid: np.ndarray) -> np.ndarray:
    """The unit axes (3, T, B, 3) of the frames of poses (T, B, 3, 3), m."""
    arms = (solid[:, :, 1:] - solid[:, :, :1]) / _ARM
    return np.stack((*arms.transpose(2, 0, 1, 3), np.cross(arms[:, :, 0], arms[:, :, 1])))


def _layout(
    identities: tuple[str, ...], place: np.ndarray, named: np.ndarray, absent: list[list[str]]
) -> Layout:
    nowhere = len(identities)
    other = (place != named) & (place < nowhere)
    others = int(np.isin(place[other], named).sum())
    extras = np.setdiff1d(np.arange(nowhere), place)
    indexed = identities == tuple(map(str, range(nowhere)))
    complete = bool((place < nowhere).all())
    renamed = int(other.sum()) - others
    return Layout(place, named, complete, absent, others, renamed, extras, indexed)


class MarkerPlaces:
    """
    The places of the markers in a message, for many look-ups.

    A name stands for the full identity, else for the one marker of that namespace, else for the
    one of that id: 'tip/3', 'tip' or '3'.
    """

    def __init__(self, identities: Sequence[str]) -> None:
        self._nowhere = len(identities)
        self._by_identity: dict[str, int] = {}
        by_namespace: dict[str, int] = {}
        by_id: dict[str, int] = {}
        for place, identity in enumerate(identities):
            self._by_identity.setdefault(identity, place)
            namespace, slash, number = identity.rpartition('/')
            if slash:
                for places, name in ((by_namespace, namespace), (by_id, number)):
                    # A name that two markers share stands for neither.
                    places[name] = self._nowhere if name in places else place
        self._by_part = by_namespace, by_id

    def find(self, marker: str) -> int:
        """Return the place of a marker, the number of identities if it is not there."""
        place = self._by_identity.get(marker, self._nowhere)
        for places in self._by_part:
            if place == self._nowhere:
                place = places.get(marker, self._nowhere)
        return place
