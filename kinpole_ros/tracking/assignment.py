"""
Which markers of a message belong to which body, and where they are.

Messages list their markers in their own order, and markers come and go; each body needs its markers
in fixed slots. Most layouts repeat, so the rows of each layout are looked up once.
"""

from collections.abc import Sequence
from ctypes import byref
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.core.bindings import Slots, library, pass_new_array
from kinpole_ros.settings import POSE_POINTS, Settings
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.plane import Plane

# Markers that a body of all markers takes at most: a driver that numbers its markers anew in every
# frame must not fill the memory.
MOST_MARKERS = 1024
_MOST_LAYOUTS = 64
# m. Distance from the origin of a pose to the points that stand for its axes.
_ARM = abs(POSE_POINTS[0])
# The part of a body's rotation that is in the plane, of 2; with less the body has turned over.
_MIN_ROTATION_IN_PLANE = 0.1
# m. Squares of smaller coordinates do not overflow; no marker is farther.
FARTHEST_MARKER = 1e15

# Points in the plane and their heights, m.
InPlane: TypeAlias = tuple[np.ndarray, np.ndarray]


class Layout(NamedTuple):
    """
    Where the markers are in messages with the same identities.

    `rows` (B, n) are the rows of the markers, the number of rows for none. `named_rows` are those
    by the names alone, and `absent` the markers of each body that are not named. `is_complete` says
    whether every slot has a row, `unassigned` are the rows in no slot, and `is_numbered` says
    whether the names are just 0, 1, 2... Of the markers in slots that the names do not give them,
    `foreign_names` have the name of another body's marker and `unknown_names` one of no body.
    """

    rows: np.ndarray
    named_rows: np.ndarray
    is_complete: bool
    absent: list[list[str]]
    foreign_names: int
    unknown_names: int
    unassigned: np.ndarray
    is_numbered: bool
    slots: 'MarkerSlots'


class MarkerSlots(Slots):
    """`Slots` of slots.h: the rows (...) of messages that slots take, `array`, and the plane."""

    def __init__(self, rows: np.ndarray, points: int, scale: float, plane: Plane | None) -> None:
        self.array = rows
        super().__init__(count=rows.size, points=points, scale=scale, farthest=FARTHEST_MARKER)
        self.bind('rows', np.ascontiguousarray(rows, np.int64))
        if plane is not None:
            self.has_axes, self.axes = plane.axes is not None, plane.axes or (0, 0, 0)
            self.basis = tuple(plane.basis.ravel().tolist())


@dataclass
class PlacedFrames:
    """
    Frames of one layout whose markers are in the slots of the bodies.

    Attributes
    ----------
    frames : MarkerFrames
        The frames, with contiguous points.
    layout : Layout
        Where their markers are in the message.
    points, heights : (T, B, n)
        Markers in the plane, complex, m, NaN for none, and for all while the plane is not known;
        their heights along its normal, m. C reads both; `Matcher` corrects rows before that.
    in_space : (T, B, n, 3) float or None
        Markers in the frame of the message, m, of poses or while the plane is not known.
    is_nameless : bool
        Whether the names are indices, which may change at any time.
    arranged : int
        The last of the frames that was matched by shape since it is nameless, -1 for none.

    """

    frames: MarkerFrames
    layout: Layout
    points: np.ndarray
    heights: np.ndarray
    in_space: np.ndarray | None
    is_nameless: bool = False
    arranged: int = -1

    @property
    def identities(self) -> tuple[str, ...]:
        """Names of the rows of the message."""
        return self.frames.identities


class MarkerAssignment:
    """
    The slots of the bodies of `settings`, and the rows of messages that belong in them.

    Attributes
    ----------
    markers : list of list of str
        Names of the markers of each body.
    width : int
        Number of slots of each body.
    count : int
        Number of markers of all bodies.
    unknown : int
        Rows of the last new layout that no body names.
    posed : bool
        Whether a row is the pose of a body, and stands for all its points.
    plane : Plane or None
        The plane of the motion; None while it is not known.

    """

    def __init__(self, settings: Settings, posed: bool = False) -> None:
        self.posed = posed
        self.scale = settings.scale
        self.plane: Plane | None = None
        # Markers of a body that is known by its shape are numbered, for messages to the user.
        self.markers = [
            list(markers)
            or [f'{body}_{k}' for k in range(0 if posed else len(settings.shapes.get(body, ())))]
            for body, markers in settings.bodies.items()
        ]
        self._by_shape = settings.marker_identity == 'shape'
        self.takes_all = not any(self.markers)
        self._layouts: dict[tuple[str, ...], Layout] = {}
        self.width = (
            len(POSE_POINTS) if posed else max(2, *(len(markers) for markers in self.markers))
        )
        self.count = sum(map(len, self.markers))
        self.unknown = 0
        # Slots (body, marker) that names stand for now, where these are not those of the
        # parameters, and the slot that takes the place of each, counted through all bodies.
        self._aliases: dict[str, tuple[int, int]] = {}
        self._order: np.ndarray | None = None
        # Of poses: whether the z axis of a body points against the normal, -1 while not known.
        self._upside_down = np.full(len(self.markers), -1)

    def set_plane(self, plane: Plane | None) -> None:
        """Put the markers of the next frames in this plane."""
        self.plane = plane
        self._layouts.clear()

    def assign(self, frames: MarkerFrames) -> PlacedFrames:
        """
        Put the markers of frames into the slots of the bodies.

        A body of all markers takes those that are new, and may have more slots afterwards.

        Parameters
        ----------
        frames : MarkerFrames
            Frames of one layout.

        Returns
        -------
        PlacedFrames
            The markers by the names of their rows.

        """
        layout = self._layout_of(frames.identities)
        points = np.ascontiguousarray(frames.points, float)
        if points is not frames.points or not points.flags.writeable:
            frames = frames._replace(points=points if points.flags.writeable else points.copy())
        return PlacedFrames(frames, layout, *self._place(frames, layout, 0))

    def assign_again(self, placed: PlacedFrames, first: int) -> None:
        """Place the frames from `first` on again, by what is known of names now."""
        placed.layout = self._layout_of(placed.identities)
        points, heights, _ = self._place(placed.frames, placed.layout, first)
        placed.points[first:], placed.heights[first:] = points, heights

    def _place(
        self, frames: MarkerFrames, layout: Layout, first: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return points, heights and points in space of the frames from `first` on."""
        points, slots = frames.points[first:], layout.slots
        if not self.posed and self.plane is not None:
            return *self._in_plane(points, slots), None
        in_space = np.empty((len(points), *slots.array.shape, 3))
        into = None, None, pass_new_array(in_space)
        library.kinpole_assign(byref(slots), pass_new_array(points), len(points), *into)
        if self.posed:
            assert frames.axes is not None
            axes = frames.axes[first:]
            none = np.full((len(axes), 1, 2, 3), np.nan)
            axes = np.concatenate((axes, none), axis=1).take(slots.array[:, 0], axis=1)
            in_space[:, :, 1:] += _ARM * axes
        if self.plane is not None:
            return *map(np.ascontiguousarray, self._project_poses(in_space)), in_space
        return *map(np.ascontiguousarray, self._in_plane(points, slots)), in_space

    def _in_plane(self, points: np.ndarray, slots: MarkerSlots) -> InPlane:
        """Return slots (...) of points (T, n, 3) in the plane; NaN while it is not known."""
        shape = len(points), *slots.array.shape
        if self.plane is None:
            nowhere = np.full(shape, complex(np.nan, np.nan))
            return nowhere, nowhere.real
        flat, heights = np.empty(shape, complex), np.empty(shape)
        into = pass_new_array(flat), pass_new_array(heights), None
        library.kinpole_assign(byref(slots), pass_new_array(points), len(points), *into)
        return flat, heights

    def _project_poses(self, poses: np.ndarray) -> InPlane:
        """
        Project poses (T, B, 3, 3), each its origin and a point on either axis, as POSE_POINTS.

        Only the rotation about the normal counts; the rest is how the frame sits on the body, and
        noise. The angle is 0 where the axes of the body are parallel to those of the plane, or
        turned by half a turn about the first of them.
        """
        assert self.plane is not None
        origin, height = self.plane.project(poses[:, :, 0])
        axes = _axes_of(poses)
        # The images of the axes of the plane. Summed term by term, since the rounding of a matrix
        # product depends on the number of frames.
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
        rotates = length > _MIN_ROTATION_IN_PLANE
        turn = np.where(rotates, turn, complex(np.nan, np.nan)) / np.where(rotates, length, 1.0)
        points = origin[..., None] + turn[..., None] * np.array(POSE_POINTS)
        return points, np.where(np.isnan(points.real), np.nan, height[..., None])

    def tilts(self, poses: np.ndarray) -> np.ndarray:
        """
        Compute how far poses are tilted out of the plane, and in which direction.

        Parameters
        ----------
        poses : (T, B, 3, 3) float
            Poses in space as `assign` returns them, m.

        Returns
        -------
        (T, B) complex
            The normal of the plane as seen from the frame of the body, in Lambert's equal-area
            projection: the sine of half the tilt, in the direction in which the normal leans.

        """
        assert self.plane is not None
        # Summed term by term, for the reason given in `_project_poses`.
        x, y, z = self.plane.normal
        axes = _axes_of(poses)
        own = x * axes[..., 0] + y * axes[..., 1] + z * axes[..., 2]
        first, second, third = (
            x * own[0] + y * own[1] + z * own[2] for x, y, z in self.plane.basis
        )
        side = np.where(self._upside_down > 0, -1.0, 1.0)
        with np.errstate(divide='ignore', invalid='ignore'):
            return np.asarray((first + 1j * side * second) / np.sqrt(2 * (1 + side * third)))

    def project_rows(self, points: np.ndarray, rows: np.ndarray) -> InPlane:
        """Return rows (m,) of the points (n, 3) of a frame in the plane, and their heights, m."""
        slots = MarkerSlots(rows, len(points), self.scale, self.plane)
        flat, heights = self._in_plane(points[None], slots)
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
        layout, identities = placed.layout, placed.identities
        none = len(identities)
        rows = np.where(rows < 0, none, rows)
        self._layouts[identities] = placed.layout = self._make_layout(
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

    def permute(self, order: np.ndarray) -> None:
        """Exchange slots for good: each takes the slot in `order` (B, n), counted through."""
        self._order = order if self._order is None else self._order.ravel()[order]
        self._layouts.clear()
        self._aliases.clear()

    def absent_of_bodies(self, placed: PlacedFrames) -> list[list[str]]:
        """Return the markers that a message lacks, of bodies with less than two in it."""
        if self._by_shape:
            return []
        count = (placed.layout.rows < len(placed.identities)).sum(axis=1).tolist()
        return [
            names if n < 2 else [] for n, names in zip(count, placed.layout.absent, strict=True)
        ]

    def _layout_of(self, identities: tuple[str, ...]) -> Layout:
        """Look up the layout of a message, or make it."""
        layout = self._layouts.get(identities)
        if layout is not None:
            return layout
        if self.takes_all:
            self._take_new(identities)
        none, lookup = len(identities), MarkerPlaces(identities)
        rows = np.full((len(self.markers), self.width), none)
        for body, markers in enumerate(self.markers):
            own = [lookup.find(name) for name in markers]
            if self.posed:
                rows[body] = own[0] if own else none
            else:
                rows[body, : len(markers)] = own
        absent = [
            [name for name, row in zip(markers, own, strict=False) if row == none]
            for markers, own in zip(self.markers, rows.tolist(), strict=True)
        ]
        if self._order is not None:
            rows = rows.ravel()[self._order]
        self.unknown = 0 if self._by_shape else len(set(range(none)) - set(rows.ravel().tolist()))
        if len(self._layouts) > _MOST_LAYOUTS:
            self._layouts.clear()
        layout = self._make_layout(identities, self._with_aliases(identities, rows), rows, absent)
        if self.posed:
            # Names of poses are taken at their word.
            layout = layout._replace(unassigned=layout.unassigned[:0], is_numbered=False)
        self._layouts[identities] = layout
        return layout

    def _make_layout(
        self,
        identities: tuple[str, ...],
        rows: np.ndarray,
        named: np.ndarray,
        absent: list[list[str]],
    ) -> Layout:
        none = len(identities)
        corrected = (rows != named) & (rows < none)
        foreign = int(np.isin(rows[corrected], named).sum())
        unknown = int(corrected.sum()) - foreign
        unassigned = np.setdiff1d(np.arange(none), rows)
        is_numbered = identities == tuple(map(str, range(none)))
        is_complete = bool((rows < none).all())
        slots = MarkerSlots(rows, none, self.scale, self.plane)
        counts = foreign, unknown
        return Layout(rows, named, is_complete, absent, *counts, unassigned, is_numbered, slots)

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
        """Add new markers to a body of all markers."""
        markers = self.markers[0]
        present = set(markers)
        new = [name for name in dict.fromkeys(identities) if name not in present]
        markers += new[: MOST_MARKERS - len(markers)]
        self.count = len(markers)
        if len(markers) > self.width:
            self.width = len(markers)
            self._layouts.clear()


def _axes_of(poses: np.ndarray) -> np.ndarray:
    """The unit axes (3, T, B, 3) of the frames of poses (T, B, 3, 3), m."""
    arms = (poses[:, :, 1:] - poses[:, :, :1]) / _ARM
    return np.stack((*arms.transpose(2, 0, 1, 3), np.cross(arms[:, :, 0], arms[:, :, 1])))


class MarkerPlaces:
    """
    The rows of the markers in a message, for many look-ups.

    A name stands for the full identity, else for the one marker of that namespace, else for the
    one of that id: 'tip/3', 'tip' or '3'.
    """

    def __init__(self, identities: Sequence[str]) -> None:
        self._none = len(identities)
        self._by_identity: dict[str, int] = {}
        by_namespace: dict[str, int] = {}
        by_id: dict[str, int] = {}
        for row, identity in enumerate(identities):
            self._by_identity.setdefault(identity, row)
            namespace, slash, number = identity.rpartition('/')
            if slash:
                for rows, name in ((by_namespace, namespace), (by_id, number)):
                    # A name that two markers share stands for neither.
                    rows[name] = self._none if name in rows else row
        self._shortened = by_namespace, by_id

    def find(self, marker: str) -> int:
        """Return the row of a marker; the number of identities if it is not in the message."""
        row = self._by_identity.get(marker, self._none)
        for rows in self._shortened:
            if row == self._none:
                row = rows.get(marker, self._none)
        return row
