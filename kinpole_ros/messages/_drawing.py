"""
The markers for RViz and Foxglove: bodies, poles with their ellipses, centrodes, relative centers.

Viewers drop a marker with a NaN in it, and keep a marker until it is deleted. So the names of the
markers are the same in every message, and one that is not drawn is deleted by name.
"""

import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.messages._cdr import HEAD, TIME, Writer, stamp_bytes
from kinpole_ros.messages._rows import Build, Built
from kinpole_ros.messages._types import Marker
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.reasons import KNOWN
from kinpole_ros.tracking.values import POLE_NAMES, Vectors, ellipse_axes, measured_pairs

COLORS = ((0.12, 0.47, 0.71), (1.0, 0.5, 0.05), (0.17, 0.63, 0.17), (0.84, 0.15, 0.16))
_GRAY = (0.4, 0.4, 0.4)
_DRAWING_INTERVAL = 100_000_000  # ns of the stamps
_LIFETIME = 2  # s: viewers remove a marker that is not drawn again
_TRAIL_POINTS = 200  # the poles of a centrode that are drawn
_TRAIL_STEP = 10_000_000  # ns between these
_ELLIPSE_SIGMAS = 2.0
_POLE_ALPHAS = (1.0, 0.5, 0.35, 0.25)  # from ICR to ISP
_VELOCITY_SCALE = 0.1  # s: an arrow is as long as the ICR moves in this time
_BODY_MARKERS = (
    'outline',
    'name',
    *POLE_NAMES,
    *(f'{pole}/deviation' for pole in POLE_NAMES),
    'icr_velocity',
    'centrode_fixed',
    'centrode_moving',
)
_Color = tuple[float, float, float, float]


class Trail(NamedTuple):
    """The last poles of a body: stamps, ns, in the frame of the ground and in its own; heights."""

    stamps: np.ndarray
    fixed: np.ndarray
    moving: np.ndarray
    heights: np.ndarray

    def until(self, stamps: np.ndarray) -> list[slice]:
        """Return the slice of the points that are drawn at each of the stamps."""
        ends = self.stamps.searchsorted(stamps, side='right').tolist()
        return [slice(max(0, end - _TRAIL_POINTS), end) for end in ends]


_NO_TRAIL = Trail(np.empty(0, np.int64), np.empty(0, complex), np.empty(0, complex), np.empty(0))


class Trails:
    """The trails of all bodies, with a pole every 10 ms."""

    def __init__(self, bodies: int) -> None:
        self._last_estimate: Estimate | None = None
        self._run = 0
        self._trails = [_NO_TRAIL] * bodies

    def until_last(self, estimate: Estimate) -> list[Trail]:
        """Return the trails up to the last instant of the newest estimate."""
        if estimate is not self._last_estimate:
            self._last_estimate = estimate
            self._append(estimate)
        return self._trails

    def _append(self, estimate: Estimate) -> None:
        if estimate.run != self._run:
            self._run, self._trails = estimate.run, [_NO_TRAIL] * len(self._trails)
        poles, stamps, angles = estimate.pole(1), estimate.stamp, estimate.angle[0]
        origins, heights = estimate.origin(0), estimate.height
        for b, trail in enumerate(self._trails):
            rows = poles.determined[:, b].nonzero()[0]
            if len(trail.stamps):
                rows = rows[stamps[rows] >= trail.stamps[-1] + _TRAIL_STEP]
            if not len(rows):
                continue
            rows = rows[_spaced(stamps[rows], _TRAIL_STEP)]
            fixed = poles.value[rows, b]
            moving = (fixed - origins[rows, b]) * np.exp(-1j * angles[rows, b])
            new = Trail(stamps[rows], fixed, moving, heights[rows, b])
            # Drawings of the instants of this estimate still need the points before them.
            pairs = zip(trail, new, strict=True)
            self._trails[b] = Trail(*(np.append(old[-_TRAIL_POINTS:], one) for old, one in pairs))


def _spaced(stamps: np.ndarray, step: int) -> list[int]:
    """Return the indices of the first stamp, and of each that is `step` after the last chosen."""
    if len(stamps) == 1:
        return [0]
    following = stamps.searchsorted(stamps + step).tolist()
    chosen, k = [], 0
    while k < len(following):
        chosen.append(k)
        k = following[k]
    return chosen


class _Schedule:
    """Decides which instants of a run are drawn: at most one in a tenth of a second of stamps."""

    def __init__(self) -> None:
        self._run = 0
        self._last: int | None = None

    def is_idle(self, estimate: Estimate) -> bool:
        """Whether none of the instants can be due."""
        if estimate.run != self._run:
            self._run, self._last = estimate.run, None
        return self._last is not None and int(estimate.stamp[-1]) < self._last + _DRAWING_INTERVAL

    def due(self, stamps: np.ndarray, instants: np.ndarray) -> list[int]:
        """Return those of the `instants`, indices of `stamps` in order, that are due."""
        if self._last is not None:
            instants = instants[stamps[instants] >= self._last + _DRAWING_INTERVAL]
        if not len(instants):
            return []
        due: list[int] = instants[_spaced(stamps[instants], _DRAWING_INTERVAL)].tolist()
        self._last = int(stamps[due[-1]])
        return due


def centrode(b: int, given: Plane, trails: Trails, frame: str | None) -> Build:
    """Return a function that makes paths of a centrode: on the ground, or on the body's `frame`."""
    schedule = _Schedule()

    def build(estimate: Estimate) -> Built:
        trail = trails.until_last(estimate)[b]
        if schedule.is_idle(estimate) or not len(trail.stamps):
            return [], []
        is_drawn = (estimate.reason[:, b] == KNOWN) & (estimate.stamp >= trail.stamps[0])
        due = schedule.due(estimate.stamp, is_drawn.nonzero()[0])
        if not due:
            return [], []
        frame_id = estimate.frame_id if frame is None else frame
        values, heights = (trail.moving, 0.0) if frame else (trail.fixed, trail.heights)
        points = (estimate.plane or given).in_space(values, heights)
        slices = zip(due, trail.until(estimate.stamp[due]), strict=True)
        return due, [
            _path(int(estimate.stamp[t]), frame_id, trail.stamps[drawn], points[drawn])
            for t, drawn in slices
        ]

    return build


def _path(stamp: int, frame_id: str, stamps: np.ndarray, positions: np.ndarray) -> bytes:
    """Write a nav_msgs/Path of poses at `stamps` (n,) and positions (n, 3), not turned."""
    writer = Writer()
    writer.header(stamp, frame_id)
    writer.pack('I', len(stamps))
    poses = np.zeros((len(stamps), 7))
    poses[:, :3] = positions
    poses[:, 6] = 1.0
    # The header of the first pose may begin between multiples of 8 bytes, all others at one.
    writer.header(int(stamps[0]), frame_id)
    writer.doubles(poses[0])
    following = Writer()
    following.header(0, frame_id)
    following.align(8)
    head = bytes(following.data[HEAD:])
    rows = np.empty((len(stamps) - 1, len(head) + 56), np.uint8)
    rows[:, : len(head)] = np.frombuffer(head, np.uint8)
    rows[:, : TIME.size] = stamp_bytes(stamps[1:])
    rows[:, len(head) :] = poses[1:].astype('<f8').view(np.uint8)
    return bytes(writer.data + rows.tobytes())


class _Drawn(NamedTuple):
    """
    A marker at `points` (n, 3), m.

    A sphere or text is at the first of them, turned by the `quaternion` x, y, z, w.
    """

    kind: int
    points: np.ndarray
    scale: tuple[float, float, float]
    color: _Color
    quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0)
    text: str = ''


def drawing(bodies: tuple[str, ...], given: Plane, trails: Trails, highest: int) -> Build:
    """
    Return a function that draws these bodies and their pairs, ten times a second of stamps.

    Poles are drawn up to that of the `highest` derivative.
    """
    schedule = _Schedule()
    pairs = [f'{bodies[j]}/wrt/{bodies[i]}/icr' for i, j in measured_pairs(len(bodies))]
    names = [f'{body}/{name}' for body in bodies for name in _BODY_MARKERS] + pairs

    def build(estimate: Estimate) -> Built:
        last = trails.until_last(estimate)
        if schedule.is_idle(estimate):
            return [], []
        due = schedule.due(estimate.stamp, np.arange(len(estimate.stamp)))
        slices = [trail.until(estimate.stamp[due]) for trail in last]
        poles = [estimate.pole(order) for order in range(1, highest + 1)]
        plane = estimate.plane or given
        turn = _quaternion(plane)
        messages = []
        for k, t in enumerate(due):
            drawn: dict[str, _Drawn] = {}
            for b, body in enumerate(bodies):
                if estimate.reason[t, b] == KNOWN:
                    markers = _draw_body(estimate, (t, b), plane, turn, poles)
                    markers |= _draw_trail(estimate, (t, b), plane, last[b], slices[b][k])
                    drawn |= {f'{body}/{name}': one for name, one in markers.items()}
            if pairs:
                drawn |= _draw_pairs(estimate, t, plane, pairs)
            writer = Writer()
            writer.pack('I', len(names))
            for name in names:
                header = int(estimate.stamp[t]), (estimate.frame_id, name)
                _write_marker(writer, *header, drawn.get(name))
            messages.append(bytes(writer.data))
        return due, messages

    return build


def deletion_of_all(stamp: int, frame_id: str) -> bytes:
    """Write a MarkerArray, with a stamp in ns, that deletes all markers that were drawn."""
    writer = Writer()
    writer.pack('I', 1)
    _write_marker(writer, stamp, (frame_id, ''), None, Marker.DELETEALL)
    return bytes(writer.data)


def _draw_body(
    estimate: Estimate,
    index: tuple[int, int],
    plane: Plane,
    plane_turn: Sequence[float],
    poles: Sequence[Vectors],
) -> dict[str, _Drawn]:
    """Draw the outline, name and poles of a body at an instant, `index` (t, b)."""
    size, height = _size(estimate, index), estimate.height[index]
    color = COLORS[index[1] % len(COLORS)]
    markers = {}
    shape = estimate.shape[index]
    shape = shape[np.isfinite(shape)]
    if len(shape) > 1:
        around = shape[np.argsort(np.angle(shape - shape.mean()))]
        turn = np.exp(1j * estimate.angle[0][index])
        outline = estimate.origin(0)[index] + turn * np.append(around, around[:1])
        points = plane.in_space(outline, height)
        markers['outline'] = _line(points, size / 60, (*color, 0.8))
        middle = plane.in_space(outline[:-1].mean()[None], height)
        scale, text = (0.0, 0.0, size / 6), estimate.bodies[index[1]]
        markers['name'] = _Drawn(Marker.TEXT_VIEW_FACING, middle, scale, (*color, 1.0), text=text)
    for name, pole, alpha in zip(POLE_NAMES, poles, _POLE_ALPHAS, strict=False):
        if pole.determined[index]:
            tint = (*color, alpha)
            point = plane.in_space(pole.value[index][None], height)
            markers[name] = _Drawn(Marker.SPHERE, point, (size / 20,) * 3, tint)
            markers[f'{name}/deviation'] = _ellipse(
                *(pole.covariance[index], plane_turn, point, size / 200, tint)
            )
    if len(poles) > 1 and poles[0].determined[index] and estimate.icr_moves[index]:
        tail = poles[0].value[index]
        head = tail + _VELOCITY_SCALE * estimate.icr_velocity.value[index]
        points = plane.in_space(np.array([tail, head]), height)
        scale = (size / 50, size / 25, 0.0)
        markers['icr_velocity'] = _Drawn(Marker.ARROW, points, scale, (*color, 1.0))
    return markers


def _draw_trail(
    estimate: Estimate, index: tuple[int, int], plane: Plane, trail: Trail, drawn: slice
) -> dict[str, _Drawn]:
    """Draw both centrodes of a body."""
    if drawn.stop - drawn.start <= 1:
        return {}
    width, color = _size(estimate, index) / 100, COLORS[index[1] % len(COLORS)]
    turn = np.exp(1j * estimate.angle[0][index])
    moving = estimate.origin(0)[index] + turn * trail.moving[drawn]
    fixed, moving = (
        plane.in_space(points, estimate.height[index]) for points in (trail.fixed[drawn], moving)
    )
    return {
        'centrode_fixed': _line(fixed, width, (*color, 1.0)),
        'centrode_moving': _line(moving, width, (*color, 0.5)),
    }


def _size(estimate: Estimate, index: tuple[int, int]) -> float:
    """The size of a body, m, which scales its markers."""
    return float(estimate.size[index]) if estimate.size[index] > 0 else 1.0


def _line(points: np.ndarray, width: float, color: _Color) -> _Drawn:
    return _Drawn(Marker.LINE_STRIP, points, (width, 0.0, 0.0), color)


def _draw_pairs(estimate: Estimate, t: int, plane: Plane, names: list[str]) -> dict[str, _Drawn]:
    """Draw the relative instant centers of pairs, at the height of the first body."""
    center, (_, first) = estimate.relative_icr, estimate.pairs
    markers = {}
    for k in center.determined[t].nonzero()[0].tolist():
        i = first[k]
        point = plane.in_space(center.value[t, k : k + 1], estimate.height[t, i])
        scale = (max(float(estimate.size[t, i]), 1e-3) / 25,) * 3
        markers[names[k]] = _Drawn(Marker.SPHERE, point, scale, (*_GRAY, 1.0))
    return markers


def _ellipse(
    covariance: np.ndarray,
    turn: Sequence[float],
    point: np.ndarray,
    thickness: float,
    color: _Color,
) -> _Drawn:
    """Draw the ellipse of two standard deviations about a pole in a plane, as a flat sphere."""
    major, minor, direction = (float(part) for part in ellipse_axes(covariance))
    # The plane turned about its normal, by a product of quaternions.
    (x, y, z, w), s, c = turn, math.sin(direction / 2), math.cos(direction / 2)
    quaternion = (x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s)
    first, second = (2 * _ELLIPSE_SIGMAS * sigma + 1e-12 for sigma in (major, minor))
    tint = (*color[:3], color[3] / 3)
    return _Drawn(Marker.SPHERE, point, (first, second, thickness), tint, quaternion)


def _quaternion(plane: Plane) -> tuple[float, ...]:
    """The quaternion x, y, z, w of the axes of a plane, as an eigenvector (Bar-Itzhack 2000)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = plane.basis.T.tolist()
    matrix = [
        [xx - yy - zz, yx + xy, zx + xz, zy - yz],
        [yx + xy, yy - xx - zz, zy + yz, xz - zx],
        [zx + xz, zy + yz, zz - xx - yy, yx - xy],
        [zy - yz, xz - zx, yx - xy, xx + yy + zz],
    ]
    return tuple(np.linalg.eigh(np.array(matrix) / 3)[1][:, -1].tolist())


def _write_marker(
    writer: Writer,
    stamp: int,
    names: tuple[str, str],
    drawn: _Drawn | None,
    action: int = Marker.DELETE,
) -> None:
    """Write the fields of a visualization_msgs/msg/Marker; without `drawn`, a deletion."""
    frame_id, ns = names
    writer.header(stamp, frame_id)
    writer.string(ns)
    pose, points = np.zeros(10), np.empty((0, 3))
    pose[6] = 1.0
    kind, color, text = Marker.ARROW, (0.0, 0.0, 0.0, 0.0), ''
    if drawn is not None:
        kind, action, color, text = drawn.kind, Marker.ADD, drawn.color, drawn.text
        pose[7:] = drawn.scale
        if kind in (Marker.SPHERE, Marker.TEXT_VIEW_FACING):
            pose[:3], pose[3:7] = drawn.points[0], drawn.quaternion
        else:
            points = drawn.points
    writer.pack('3i', 0, kind, action)
    writer.doubles(pose)
    writer.pack('4f2i?', *color, _LIFETIME, 0, False)
    writer.pack('I', len(points))
    writer.doubles(points)
    # No colors of points, no texture, no texture coordinates.
    writer.align(4)
    writer.data += bytes(4) + _EMPTY + bytes(8) + _EMPTY + _EMPTY + bytes(4) + bytes(4)
    writer.string(text)
    # No mesh.
    writer.align(4)
    writer.data += _EMPTY + _EMPTY + bytes(4) + bytes(1)


_EMPTY = struct.pack('<I4x', 1)  # an empty string with its padding
