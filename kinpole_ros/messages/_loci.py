"""What is drawn now and then: centrodes of late as paths, and the markers for RViz and Foxglove."""

import struct
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from kinpole_ros.messages._cdr import Writer, path
from kinpole_ros.messages._types import Marker
from kinpole_ros.pipeline.estimate import POLE_NAMES, Estimate
from kinpole_ros.rigid.plane import Plane

# Instants as indices, in order, and the messages of these.
Built: TypeAlias = tuple[list[int], list[bytes]]
Build: TypeAlias = Callable[[Estimate], Built]
# Loci are drawn, not computed with: this much of them, this finely, this often (ns of stamps).
_TRAIL_POINTS = 200
_TRAIL_STEP = 10_000_000
_DRAWN_EVERY = 100_000_000
_COLORS = ((0.12, 0.47, 0.71), (1.0, 0.5, 0.05), (0.17, 0.63, 0.17), (0.84, 0.15, 0.16))


class Trail:
    """The ICR of late, as seen from the ground and from the body."""

    def __init__(self) -> None:
        self._taken: Estimate | None = None
        self._run = 0
        self._clear()

    def _clear(self) -> None:
        self.stamps = np.empty(0, np.int64)
        self.fixed = self.moving = np.empty(0, complex)
        self.heights = np.empty(0)

    def follow(self, estimate: Estimate, b: int) -> None:
        """Take the poles of these instants, unless it has them or ones hardly older."""
        if estimate is self._taken:
            return
        self._taken = estimate
        if estimate.run != self._run:
            self._run = estimate.run
            self._clear()
        pole = estimate.pole(1)
        known = pole.determined[:, b].nonzero()[0]
        if len(self.stamps):
            known = known[estimate.stamp[known] >= self.stamps[-1] + _TRAIL_STEP]
        if not len(known):
            return
        new = known[_spaced(estimate.stamp[known], _TRAIL_STEP)]
        fixed = pole.value[new, b]
        moving = (fixed - estimate.origin(0)[new, b]) * np.exp(-1j * estimate.angle[0, new, b])
        # What was drawn before is still needed by the drawings of these instants.
        old = slice(-_TRAIL_POINTS, None)
        self.stamps = np.concatenate((self.stamps[old], estimate.stamp[new]))
        self.fixed = np.concatenate((self.fixed[old], fixed))
        self.moving = np.concatenate((self.moving[old], moving))
        self.heights = np.concatenate((self.heights[old], estimate.height[new, b]))

    def until(self, stamps: np.ndarray) -> list[slice]:
        """The part of it that is of late at each of the stamps."""
        ends = self.stamps.searchsorted(stamps, side='right').tolist()
        return [slice(max(0, end - _TRAIL_POINTS), end) for end in ends]


def _spaced(stamps: np.ndarray, step: int) -> list[int]:
    """Places of the first of the stamps, in order, and of each that is `step` after the last."""
    if len(stamps) == 1:
        return [0]
    following = stamps.searchsorted(stamps + step).tolist()
    found, k = [], 0
    while k < len(following):
        found.append(k)
        k = following[k]
    return found


class _DrawingSchedule:
    """Which instants of a run are due to be drawn, at most every tenth of a second of stamps."""

    def __init__(self) -> None:
        self._run = 0
        self._last: int | None = None

    def rests(self, estimate: Estimate) -> bool:
        """Whether none of the instants can be due."""
        if estimate.run != self._run:
            self._run, self._last = estimate.run, None
        return self._last is not None and int(estimate.stamp[-1]) < self._last + _DRAWN_EVERY

    def due(self, stamps: np.ndarray, instants: np.ndarray) -> list[int]:
        """Those of the `instants`, indices of `stamps` in order, that are due."""
        if self._last is not None:
            instants = instants[stamps[instants] >= self._last + _DRAWN_EVERY]
        if not len(instants):
            return []
        due: list[int] = instants[_spaced(stamps[instants], _DRAWN_EVERY)].tolist()
        self._last = int(stamps[due[-1]])
        return due


def centrode(b: int, given: Plane, trail: Trail, frame: str | None) -> Build:
    """Paths of the centrode of body `b`, on the ground, or on the body in the `frame` it has."""
    schedule = _DrawingSchedule()

    def build(estimate: Estimate) -> Built:
        trail.follow(estimate, b)
        if schedule.rests(estimate) or not len(trail.stamps):
            return [], []
        drawn = (estimate.missing[:, b] == '') & (estimate.stamp >= trail.stamps[0])
        due = schedule.due(estimate.stamp, drawn.nonzero()[0])
        if not due:
            return [], []
        frame_id = estimate.frame_id if frame is None else frame
        values, heights = (trail.moving, 0.0) if frame else (trail.fixed, trail.heights)
        places = (estimate.plane or given).in_space(values, heights)
        parts = zip(due, trail.until(estimate.stamp[due]), strict=True)
        return due, [
            path(int(estimate.stamp[t]), frame_id, trail.stamps[part], places[part])
            for t, part in parts
        ]

    return build


def scene(bodies: tuple[str, ...], given: Plane, trails: list[Trail]) -> Build:
    """Poles, both centrodes and the ICR's velocity of every body, for RViz and Foxglove."""
    schedule = _DrawingSchedule()

    def build(estimate: Estimate) -> Built:
        for b in range(len(bodies)):
            trails[b].follow(estimate, b)
        if schedule.rests(estimate):
            return [], []
        due = schedule.due(estimate.stamp, np.arange(len(estimate.stamp)))
        parts = [trail.until(estimate.stamp[due]) for trail in trails]
        found = []
        for k, t in enumerate(due):
            writer = Writer()
            writer.pack('I', len(_KINDS) * len(bodies))
            for b in range(len(bodies)):
                _draw(writer, estimate, t, b, given, trails[b], parts[b][k])
            found.append(bytes(writer.data))
        return due, found

    return build


def nothing_drawn(stamp: int, frame_id: str) -> bytes:
    """A MarkerArray that takes away all that was drawn; `stamp` in ns."""
    writer = Writer()
    writer.pack('I', 1)
    _write_marker(writer, stamp, (frame_id, ''), Marker.ARROW, Marker.DELETEALL)
    return bytes(writer.data)


# What is drawn of a body, in this order.
_KINDS = {
    POLE_NAMES[0]: Marker.SPHERE,
    POLE_NAMES[1]: Marker.SPHERE,
    'icr_velocity': Marker.ARROW,
    'centrode_fixed': Marker.LINE_STRIP,
    'centrode_moving': Marker.LINE_STRIP,
}


def _draw(
    writer: Writer, estimate: Estimate, t: int, b: int, given: Plane, trail: Trail, part: slice
) -> None:
    """The markers of body `b` at instant `t`."""
    stamp, body = int(estimate.stamp[t]), estimate.bodies[b]
    color = _COLORS[b % len(_COLORS)]
    size = float(estimate.size[t, b]) if estimate.size[t, b] > 0 else 1.0
    points = {} if estimate.missing[t, b] else _shown(estimate, t, b, trail, part)
    widths = (size / 20, size / 20, size / 50, size / 100, size / 100)
    alphas = (1.0, 0.5, 1.0, 1.0, 0.5)
    for (name, kind), width, alpha in zip(_KINDS.items(), widths, alphas, strict=True):
        names = (estimate.frame_id, f'{body}/{name}')
        if name not in points:
            # What is not there is deleted by name: a Marker with a NaN would be dropped whole.
            _write_marker(writer, stamp, names, kind, Marker.DELETE)
            continue
        places = (estimate.plane or given).in_space(points[name], estimate.height[t, b])
        scale = (width, 0.0, 0.0)
        if kind == Marker.SPHERE:
            scale = (width, width, width)
        elif kind == Marker.ARROW:
            scale = (width, 2 * width, 0.0)
        tint = (*color, alpha)
        _write_marker(writer, stamp, names, kind, Marker.ADD, places, scale, tint)


def _shown(estimate: Estimate, t: int, b: int, trail: Trail, part: slice) -> dict[str, np.ndarray]:
    """The points, complex, of all that can be drawn of body `b` at instant `t`."""
    found = {}
    for order in (1, 2):
        pole = estimate.pole(order)
        if pole.determined[t, b]:
            found[POLE_NAMES[order - 1]] = pole.value[t, b : b + 1]
    if estimate.pole(1).determined[t, b] and estimate.icr_moves[t, b]:
        tail = estimate.pole(1).value[t, b]
        # Drawn as far as the ICR goes in a tenth of a second.
        found['icr_velocity'] = np.array([tail, tail + 0.1 * estimate.icr_velocity.value[t, b]])
    if part.stop - part.start > 1:
        found['centrode_fixed'] = trail.fixed[part]
        turn = np.exp(1j * estimate.angle[0, t, b])
        found['centrode_moving'] = estimate.origin(0)[t, b] + turn * trail.moving[part]
    return found


def _write_marker(
    writer: Writer,
    stamp: int,
    names: tuple[str, str],
    kind: int,
    action: int,
    places: np.ndarray | None = None,
    scale: tuple[float, ...] = (0.0, 0.0, 0.0),
    color: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0),
) -> None:
    """Field after field, as visualization_msgs/msg/Marker has them; a sphere is at its pose."""
    frame_id, ns = names
    writer.header(stamp, frame_id)
    writer.string(ns)
    writer.pack('3i', 0, kind, action)
    pose = np.zeros(10)
    pose[6] = 1.0
    pose[7:] = scale
    points = np.empty((0, 3))
    if places is not None:
        if kind == Marker.SPHERE:
            pose[:3] = places[0]
        else:
            points = places
    writer.doubles(pose)
    writer.pack('4f2i?', *color, 0, 0, False)
    writer.pack('I', len(points))
    writer.doubles(points)
    writer.align(4)
    writer.data += _REST_OF_MARKER


def _rest_of_marker() -> bytes:
    """All after the points of a Marker, none of it used: colors, textures, text and meshes."""
    empty = struct.pack('<I4x', 1)
    header = bytes(8) + empty
    texture = header + empty + bytes(4)
    mesh_file = empty + bytes(4)
    return bytes(4) + empty + texture + bytes(4) + empty + empty + mesh_file + bytes(1)


_REST_OF_MARKER = _rest_of_marker()
