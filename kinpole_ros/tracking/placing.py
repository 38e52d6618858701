"""
Which markers of a message belong to which body, and where they are.

Messages list their markers in their own order, and markers come and go; each body needs its markers
in fixed slots. Most layouts repeat, so the rows of each layout are looked up once.
"""

from collections import Counter
from ctypes import byref
from typing import TypeAlias

import numpy as np

from kinpole_ros.core.bindings import Slots, library, pass_new_array
from kinpole_ros.settings import POSE_POINTS, Settings
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.marker_rows import find_rows
from kinpole_ros.tracking.placed_frames import FrameLayout, PlacedFrames, count_misnamed
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.pose_points import ARM, project_poses, tilts_of
from kinpole_ros.tracking.rejection import (
    FARTHEST_MARKER,
    MOST_MARKERS,
    MOVED_FRAMES,
    TOO_FAR,
)

_MOST_LAYOUTS = 64
NOT_ORDERED = -1

# Points in the plane and their heights, m.
InPlane: TypeAlias = tuple[np.ndarray, np.ndarray]


class MarkerAssignment:
    """
    The slots of the bodies of `settings`, and the rows of messages that belong in them.

    Attributes
    ----------
    markers : list of list of str
        Names of the markers of each body.
    unknown : int
        Rows of the last new layout that no body names.
    posed : bool
        Whether a row is the pose of a body, and stands for all its points.
    plane : Plane or None
        The plane of the motion; None while it is not known.
    withheld : (B,) bool
        Bodies of which nothing is published, since their markers are not known.
    order : (B, n) int
        The marker of the message in each slot, where some were exchanged.
    takes_all : bool
        Whether the only body takes all markers.
    uncounted : (B,) int or None
        Frames in which exchanged markers are still to be counted; None for none.
    names_come : bool
        Whether names mean something, also where they are 0, 1, 2...: a driver that names markers
        once does so always.
    ordered_size : int
        Number of points of clouds without names whose order is known to be stable, or NOT_ORDERED.

    """

    def __init__(self, settings: Settings, posed: bool = False) -> None:
        self.posed, self._settings = posed, settings
        self.plane: Plane | None = None
        # Markers of a body that is known by its shape are numbered, for messages to the user.
        self.markers = [
            list(markers)
            or [f'{body}_{k}' for k in range(0 if posed else len(settings.shapes.get(body, ())))]
            for body, markers in settings.bodies.items()
        ]
        self.unknown, self.ordered_size = 0, NOT_ORDERED
        # A body of all markers takes any point for a marker.
        self.takes_all = not any(self.markers)
        has_indices = settings.marker_identity in ('auto', 'index', 'shape')
        self.names_come = self.takes_all or not has_indices
        self._layouts: dict[tuple[str, ...], FrameLayout] = {}
        # Slots (body, marker) that names stand for now, where these are not those of the
        # parameters, and the slot that takes the place of each, counted through all bodies.
        self._aliases: dict[str, tuple[int, int]] = {}
        self._regrouped: np.ndarray | None = None
        width = len(POSE_POINTS) if posed else max(2, *map(len, self.markers))
        self.order = np.tile(np.arange(width), (len(self.markers), 1))
        self.uncounted: np.ndarray | None = None
        self.withheld = np.zeros(len(self.markers), bool)
        # Of poses: see `project_poses`.
        self._upside_down = np.full(len(self.markers), -1)

    @property
    def width(self) -> int:
        """Number of slots of each body."""
        return self.order.shape[1]

    @property
    def points_each(self) -> int:
        """Number of points that stand for a marker."""
        return len(POSE_POINTS) if self.posed else 1

    @property
    def count(self) -> int:
        """Number of markers of all bodies."""
        return sum(map(len, self.markers))

    def set_plane(self, plane: Plane | None) -> None:
        """Put the markers of the next frames in this plane."""
        self.plane = plane
        self._layouts.clear()

    def assign(self, frames: MarkerFrames, counts: Counter[str]) -> PlacedFrames:
        """
        Put the markers of frames into the slots of the bodies.

        A body of all markers takes those that are new, and may have more slots afterwards.

        Parameters
        ----------
        frames : MarkerFrames
            Frames of one layout.
        counts : Counter
            Numbers of markers by what is wrong with them, updated.

        Returns
        -------
        PlacedFrames
            The markers by the names of their rows.

        """
        layout = self._layout_of(frames.identities)
        points = np.ascontiguousarray(frames.points, float)
        if points is not frames.points or not points.flags.writeable:
            frames = frames._replace(points=points if points.flags.writeable else points.copy())
        flat, heights, in_space, too_far = self._place(frames, layout, 0)
        if too_far:
            counts[TOO_FAR] += too_far
        if layout.foreign_names or layout.unknown_names:
            count_misnamed(counts, layout, len(points))
        tilts = None
        if in_space is not None and self.plane is not None:
            tilts = tilts_of(in_space, self.plane, self._upside_down)
        is_nameless = layout.is_numbered and not self.names_come
        size = points.shape[1]
        return PlacedFrames(frames, flat, heights, in_space, tilts, size, is_nameless)

    def layout_of(self, placed: PlacedFrames) -> FrameLayout:
        """Return the layout of frames, by what is known of names now."""
        return self._layout_of(placed.frames.identities)

    def assign_again(self, placed: PlacedFrames, first: int) -> None:
        """Place the frames from `first` on again, by what is known of names now."""
        points, heights, *_ = self._place(placed.frames, self.layout_of(placed), first)
        placed.points[first:], placed.heights[first:] = points, heights

    def _place(
        self, frames: MarkerFrames, layout: FrameLayout, first: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, int]:
        """Return points, heights and points in space from `first` on; how many are too far."""
        assert layout.slots is not None
        points, slots, shape = frames.points[first:], layout.slots, layout.rows.shape
        if not self.posed and self.plane is not None:
            flat, heights, too_far = self._in_plane(points, slots, shape)
            return flat, heights, None, too_far
        in_space = np.empty((len(points), *shape, 3))
        into = None, None, pass_new_array(in_space)
        too_far = library.kinpole_assign(byref(slots), pass_new_array(points), len(points), *into)
        if self.posed:
            assert frames.axes is not None
            axes = frames.axes[first:]
            none = np.full((len(axes), 1, 2, 3), np.nan)
            axes = np.concatenate((axes, none), axis=1).take(layout.rows[:, 0], axis=1)
            in_space[:, :, 1:] += ARM * axes
        if self.plane is None:
            nowhere = np.full((len(points), *shape), complex(np.nan, np.nan))
            return nowhere, np.ascontiguousarray(nowhere.real), in_space, too_far
        flat, heights, self._upside_down = project_poses(in_space, self.plane, self._upside_down)
        return flat, heights, in_space, too_far

    @staticmethod
    def _in_plane(
        points: np.ndarray, slots: Slots, shape: tuple[int, ...]
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """Return slots (...) of points (T, n, 3), complex, m, heights, and how many are too far."""
        shape = len(points), *shape
        flat, heights = np.empty(shape, complex), np.empty(shape)
        into = pass_new_array(flat), pass_new_array(heights), None
        too_far = library.kinpole_assign(byref(slots), pass_new_array(points), len(points), *into)
        return flat, heights, too_far

    def project_all(self, placed: PlacedFrames, k: int) -> InPlane:
        """Return all points (m,) of a frame in the plane, complex, m, and their heights."""
        points, layout = placed.frames.points[k], self.layout_of(placed)
        flat, heights, _ = self._in_plane(points[None], layout.all_rows, points.shape[:1])
        return flat[0], heights[0]

    def correct_names(self, placed: PlacedFrames, rows: np.ndarray, for_all: bool) -> None:
        """
        Use these rows for messages with the layout of `placed` from now on.

        Parameters
        ----------
        placed : PlacedFrames
            Frames of that layout; they are not placed again.
        rows : (B, n) int
            Rows of the markers, -1 for none.
        for_all : bool
            Whether the names of the rows stand for the same markers in other layouts too.

        """
        layout, identities = self.layout_of(placed), placed.identities
        none = len(identities)
        rows = np.where(rows < 0, none, rows)
        # What was exchanged within a body is right now.
        self.restore_order((rows != layout.rows).any(axis=1))
        self._layouts[identities] = self._make_layout(
            identities, rows, layout.named_rows, layout.absent
        )
        if not for_all:
            return
        for b, k in zip(*np.nonzero(rows < none), strict=True):
            name = identities[rows[b, k]]
            self._aliases.pop(name, None)
            if rows[b, k] != layout.named_rows[b, k]:
                self._aliases[name] = int(b), int(k)
        while len(self._aliases) > MOST_MARKERS:
            del self._aliases[next(iter(self._aliases))]

    def exchange(self, placed: PlacedFrames, k: int, order: np.ndarray) -> None:
        """
        Put exchanged markers into other slots in the frames after `k`, and in those to come.

        Parameters
        ----------
        placed, k : PlacedFrames, int
            The frames in hand, and the one in which the markers were found to be exchanged.
        order : (B, n) int
            The present slot of the marker that is to be in each slot.

        """
        self.order = np.take_along_axis(self.order, order, axis=1)
        left = 0 if self.uncounted is None else self.uncounted
        has_changed = (order != np.arange(self.width)).any(axis=1)
        # Markers that stay exchanged had wrong names before.
        self.uncounted = np.where(has_changed, MOVED_FRAMES, left)
        self._clear_slots()
        self.assign_again(placed, k + 1)

    def restore_order(self, which: np.ndarray) -> None:
        """Take the markers of some bodies (B,) to be in the slots of their names again."""
        in_order = np.arange(self.width)
        if (self.order[which] != in_order).any():
            self.order[which] = in_order
            self._clear_slots()

    def count_exchanged(self, frames: int) -> int:
        """Return how many markers were exchanged in so many frames, but those long exchanged."""
        if self.uncounted is None:
            return 0
        counted = np.minimum(self.uncounted, frames)
        self.uncounted = self.uncounted - counted if (counted < self.uncounted).any() else None
        return int(counted @ (self.order != np.arange(self.width)).sum(axis=1))

    def withhold(self, which: np.ndarray) -> None:
        """Publish nothing of some more bodies (B,), whose markers are not known."""
        self.withheld = self.withheld | which
        self._clear_slots()

    def restart(self) -> None:
        """Withhold no body, take all markers to be in order, and learn the size of clouds again."""
        self.withheld[:], self.ordered_size = False, NOT_ORDERED
        self.restore_order(np.ones(len(self.markers), bool))
        self._clear_slots()

    def _clear_slots(self) -> None:
        """Make the slots of all layouts anew when they are next needed."""
        self._layouts = {names: one._replace(slots=None) for names, one in self._layouts.items()}

    def permute(self, order: np.ndarray) -> None:
        """Exchange slots for good: each takes the slot in `order` (B, n), counted through."""
        before = self._regrouped
        self._regrouped = order if before is None else before.ravel()[order]
        self._layouts.clear()
        self._aliases.clear()

    def take_names(self, other: 'MarkerAssignment') -> None:
        """Take what another learned of names, before the first frame."""
        if self.takes_all:
            self._take_new(tuple(other.markers[0]))
        self._regrouped, self.names_come = other._regrouped, other.names_come
        self.ordered_size = other.ordered_size
        self.withhold(other.withheld)

    def absent_of_bodies(self, placed: PlacedFrames) -> list[list[str]]:
        """Return the markers that a message lacks, of bodies with less than two in it."""
        if self._settings.marker_identity == 'shape':
            return []
        layout = self.layout_of(placed)
        count = (layout.rows < len(placed.identities)).sum(axis=1).tolist()
        return [names if n < 2 else [] for n, names in zip(count, layout.absent, strict=True)]

    def _layout_of(self, identities: tuple[str, ...]) -> FrameLayout:
        """Look up the layout of a message, or make it, with its slots."""
        layout = self._layouts.get(identities)
        if layout is not None and layout.slots is not None:
            return layout
        layout = layout or self._new_layout(identities)
        rows = np.take_along_axis(layout.rows, self.order, axis=1)
        rows[self.withheld] = len(identities)
        layout = layout._replace(slots=self._slots_of(rows, len(identities)))
        self._layouts[identities] = layout
        return layout

    def _slots_of(self, rows: np.ndarray, points: int) -> Slots:
        """Return the slots that take these rows of so many points."""
        slots = Slots(
            slots=rows.size,
            point_count=points,
            scale=self._settings.scale,
            farthest=FARTHEST_MARKER,
        )
        slots.bind('row_of_slot', rows.astype(np.int64).ravel())
        if self.plane is not None:
            slots.has_axes = self.plane.axes is not None
            slots.axes = self.plane.axes or (0, 0, 0)
            slots.basis = tuple(self.plane.basis.ravel().tolist())
        return slots

    def _new_layout(self, identities: tuple[str, ...]) -> FrameLayout:
        """Return the layout of a message that was not seen before."""
        if self.takes_all:
            self._take_new(identities)
        none = len(identities)
        rows = np.full((len(self.markers), self.width), none)
        for body, markers in enumerate(self.markers):
            own = find_rows(identities, markers)
            if self.posed:
                rows[body] = own[0] if own else none
            else:
                rows[body, : len(markers)] = own
        absent = [
            [name for name, row in zip(markers, own, strict=False) if row == none]
            for markers, own in zip(self.markers, rows.tolist(), strict=True)
        ]
        if self._regrouped is not None:
            rows = rows.ravel()[self._regrouped]
        by_shape = self._settings.marker_identity == 'shape'
        self.unknown = 0 if by_shape else len(set(range(none)) - set(rows.ravel().tolist()))
        if len(self._layouts) > _MOST_LAYOUTS:
            self._layouts.clear()
        layout = self._make_layout(identities, self._with_aliases(identities, rows), rows, absent)
        self.names_come |= not layout.is_numbered and not by_shape
        return layout

    def _make_layout(
        self,
        identities: tuple[str, ...],
        rows: np.ndarray,
        named: np.ndarray,
        absent: list[list[str]],
    ) -> FrameLayout:
        """Return the layout of a message whose markers are in these rows; `named` by names."""
        none = len(identities)
        corrected = (rows != named) & (rows < none)
        foreign = int(np.isin(rows[corrected], named).sum())
        unknown = int(corrected.sum()) - foreign
        is_numbered = identities == tuple(map(str, range(none)))
        unassigned = np.flatnonzero(~np.isin(np.arange(none), rows))
        # Names of poses are taken at their word.
        if self.posed or self._settings.marker_identity == 'shape':
            unassigned = unassigned[:0]
        is_numbered &= not self.posed
        all_rows = self._slots_of(np.arange(none), none)
        return FrameLayout(
            rows=rows,
            named_rows=named,
            absent=absent,
            foreign_names=foreign,
            unknown_names=unknown,
            unassigned=unassigned,
            is_numbered=is_numbered,
            all_rows=all_rows,
        )

    def _with_aliases(self, identities: tuple[str, ...], named: np.ndarray) -> np.ndarray:
        """Rows with the markers that have other names for now; a name of its own goes first."""
        here = [name for name in self._aliases if name in identities]
        if not here:
            return named
        none, rows = len(identities), named.copy()
        for b, k in zip(*np.nonzero(named < none), strict=True):
            if identities[named[b, k]] in self._aliases:
                rows[b, k] = none
        for name in here:
            slot = self._aliases[name]
            if rows[slot] == none:
                rows[slot] = identities.index(name)
        return rows

    def _take_new(self, identities: tuple[str, ...]) -> None:
        """Add new markers to a body of all markers, `MOST_MARKERS` at most."""
        markers = self.markers[0]
        present = set(markers)
        new = [name for name in dict.fromkeys(identities) if name not in present]
        markers += new[: MOST_MARKERS - len(markers)]
        if len(markers) > self.width:
            self.order = np.hstack((self.order, np.arange(self.width, len(markers))[None]))
            self._layouts.clear()
