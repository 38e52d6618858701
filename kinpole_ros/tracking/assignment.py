"""
Which markers of a message belong to which body, and where they are.

Messages list their markers in their own order, and markers come and go; each body needs its markers
in fixed slots. Most layouts repeat, so the rows of each layout are looked up once.
"""

from collections.abc import Sequence
from ctypes import Structure, byref, c_double, c_longlong, c_void_p
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.compiled import address_of, library
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.parameters import POSE_POINTS, Settings
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

_assign = library.kinpole_assign
_assign.argtypes = [c_void_p, c_void_p, c_longlong, c_void_p, c_void_p, c_void_p]
_assign.restype = None


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


class _Slots(Structure):
    """`Slots` of _assign.c: which rows of messages the slots take, and the plane."""

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in ('count', 'points', 'has_axes')),
        *(('axes', 3 * c_longlong), ('scale', c_double), ('farthest', c_double)),
        *(('basis', 9 * c_double), ('rows', c_void_p)),
    ]

    def __init__(self, rows: np.ndarray, points: int, scale: float, plane: Plane | None) -> None:
        self.array, self.plane = rows, plane
        self._contiguous = np.ascontiguousarray(rows, np.int64)
        super().__init__(count=rows.size, points=points, scale=scale, farthest=FARTHEST_MARKER)
        self.rows = address_of(self._contiguous)
        if plane is not None:
            self.has_axes, self.axes = plane.axes is not None, plane.axes or (0, 0, 0)
            self.basis = tuple(plane.basis.ravel().tolist())


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
    absent : list of list of str
        Markers of each body that the last message lacks.
    identities : tuple of str
        Names of the rows of the last message.
    posed : bool
        Whether a row is the pose of a body, and stands for all its points.
    plane : Plane or None
        The plane of the motion; None while it is not known.
    layout : Layout or None
        That of the last message.

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
        self.absent: list[list[str]] = []
        self.identities: tuple[str, ...] = ()
        # Slots (body, marker) that names stand for now, where these are not those of the
        # parameters, and the slot that takes the place of each, counted through all bodies.
        self._aliases: dict[str, tuple[int, int]] = {}
        self._order: np.ndarray | None = None
        self._points = np.zeros((0, 0, 3))
        # The slots of the last layout and plane.
        self._slots: _Slots | None = None
        # Of poses: their axes, and whether the z axis of a body points against the normal, -1 while
        # not known.
        self._axes = np.zeros((0, 0, 2, 3))
        self._upside_down = np.full(len(self.markers), -1)
        self.layout: Layout | None = None

    def assign(self, frames: MarkerFrames) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """
        Put the markers of frames into the slots of the bodies.

        A body of all markers takes those that are new, and may have more slots afterwards.

        Parameters
        ----------
        frames : MarkerFrames
            Frames of one layout.

        Returns
        -------
        points : (T, B, width) complex
            Markers in the plane, m, NaN for none, and for all while the plane is not known.
        heights : (T, B, width) float
            Their heights along its normal, m.
        in_space : (T, B, width, 3) float or None
            Markers in the frame of the message, m, of poses or while the plane is not known.

        """
        self.identities = frames.identities
        self.layout = self._layout_of(frames.identities)
        self.absent = self.layout.absent
        self._points = np.ascontiguousarray(frames.points, float)
        if frames.axes is not None:
            self._axes = frames.axes
        return self.assign_again(0)

    def assign_again(self, first: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return the same of the last frames from `first` on, by what is known of names now."""
        assert self.layout is not None
        rows, points = self.layout.rows, self._points[first:]
        if not self.posed and self.plane is not None:
            return *self._in_plane(points, rows), None
        in_space = np.empty((len(points), *rows.shape, 3))
        slots = byref(self._slots_of(rows))
        _assign(slots, address_of(points), len(points), None, None, address_of(in_space))
        if self.posed:
            axes = self._axes[first:]
            none = np.full((len(axes), 1, 2, 3), np.nan)
            axes = np.concatenate((axes, none), axis=1).take(rows[:, 0], axis=1)
            in_space[:, :, 1:] += _ARM * axes
        if self.plane is not None:
            return *self._project_poses(in_space), in_space
        return *self._in_plane(points, rows), in_space

    def _slots_of(self, rows: np.ndarray) -> _Slots:
        """Return the slots that take these rows; the last ones if nothing has changed."""
        slots = self._slots
        if slots is None or slots.array is not rows or slots.plane is not self.plane:
            self._slots = slots = _Slots(rows, len(self.identities), self.scale, self.plane)
        return slots

    def _in_plane(self, points: np.ndarray, rows: np.ndarray) -> InPlane:
        """Return these rows (...) of points (T, n, 3) in the plane; NaN while it is not known."""
        shape = len(points), *rows.shape
        if self.plane is None:
            nowhere = np.full(shape, complex(np.nan, np.nan))
            return nowhere, nowhere.real
        flat, heights = np.empty(shape, complex), np.empty(shape)
        into = address_of(flat), address_of(heights), None
        _assign(byref(self._slots_of(rows)), address_of(points), len(points), *into)
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

    def project_all(self, frame: int) -> InPlane:
        """Return all points (m,) of one of the last frames in the plane, and their heights, m."""
        points = self._points[frame][None]
        flat, heights = self._in_plane(points, np.arange(points.shape[1]))
        return flat[0], heights[0]

    def project_unassigned(self, frame: int) -> np.ndarray:
        """Return the points (e,) of one of the last frames that are in no slot, in the plane."""
        assert self.layout is not None
        return self._in_plane(self._points[frame][None], self.layout.unassigned)[0][0]

    def correct_names(self, rows: np.ndarray, for_all: bool) -> None:
        """
        Use these rows for messages of the last layout from now on.

        Parameters
        ----------
        rows : (B, n) int
            Rows of the markers, -1 for none.
        for_all : bool
            Whether the names of the rows stand for the same markers in other layouts too.

        """
        layout = self.layout
        assert layout is not None
        none = len(self.identities)
        rows = np.where(rows < 0, none, rows)
        self._layouts[self.identities] = self.layout = _make_layout(
            self.identities, rows, layout.named_rows, layout.absent
        )
        if not for_all:
            return
        for b, k in zip(*np.nonzero(rows < none), strict=True):
            name = self.identities[rows[b, k]]
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
        if self.identities:
            self.layout = self._layout_of(self.identities)

    def absent_of_bodies(self) -> list[list[str]]:
        """Return the markers that the last message lacks, of bodies with less than two in it."""
        if self.layout is None or self._by_shape:
            return []
        count = (self.layout.rows < len(self.identities)).sum(axis=1).tolist()
        return [names if n < 2 else [] for n, names in zip(count, self.absent, strict=True)]

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
        layout = _make_layout(identities, self._with_aliases(identities, rows), rows, absent)
        if self.posed:
            # Names of poses are taken at their word.
            layout = layout._replace(unassigned=layout.unassigned[:0], is_numbered=False)
        self._layouts[identities] = layout
        return layout

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


def _make_layout(
    identities: tuple[str, ...], rows: np.ndarray, named: np.ndarray, absent: list[list[str]]
) -> Layout:
    none = len(identities)
    corrected = (rows != named) & (rows < none)
    foreign = int(np.isin(rows[corrected], named).sum())
    unknown = int(corrected.sum()) - foreign
    unassigned = np.setdiff1d(np.arange(none), rows)
    is_numbered = identities == tuple(map(str, range(none)))
    is_complete = bool((rows < none).all())
    return Layout(rows, named, is_complete, absent, foreign, unknown, unassigned, is_numbered)


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
