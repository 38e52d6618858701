"""
The markers for RViz and Foxglove: bodies, poles with their ellipses, centrodes, relative centers.

Names stay the same from drawing to drawing, and what is not there is deleted by name: viewers drop
a marker with a NaN in it, and keep what nobody deletes.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.messages._cdr import Writer
from kinpole_ros.messages._loci import Build, Built, DrawingSchedule, Trail
from kinpole_ros.messages._types import Marker
from kinpole_ros.tracking.estimate import POLE_NAMES, Estimate, Vectors, measured_pairs
from kinpole_ros.tracking.plane import Plane

COLORS = ((0.12, 0.47, 0.71), (1.0, 0.5, 0.05), (0.17, 0.63, 0.17), (0.84, 0.15, 0.16))
_GRAY = (0.4, 0.4, 0.4)
# A drawing nobody renews goes by itself (s).
_LASTS = 2
# Ellipses are of so many deviations.
_DEVIATIONS = 2.0
# How opaque poles are, from ICR to ISP.
_OPAQUE = (1.0, 0.5, 0.35, 0.25)


class _Drawn(NamedTuple):
    """
    A marker at `places` (n, 3), m.

    A sphere or text is at the first of them, turned by the quaternion `turn`.
    """

    kind: int
    places: np.ndarray
    scale: tuple[float, float, float]
    color: tuple[float, float, float, float]
    turn: Sequence[float] = (0.0, 0.0, 0.0, 1.0)
    text: str = ''


def scene(bodies: tuple[str, ...], given: Plane, trails: list[Trail], highest: int) -> Build:
    """
    All that is drawn of these bodies and of pairs of them, ten times a second of stamps.

    Poles up to that of the `highest` derivative.
    """
    schedule = DrawingSchedule()
    pairs = [f'{bodies[j]}/wrt/{bodies[i]}/icr' for i, j in measured_pairs(len(bodies))]
    names = [f'{body}/{name}' for body in bodies for name in _OF_BODY] + pairs

    def build(estimate: Estimate) -> Built:
        for b in range(len(bodies)):
            trails[b].follow(estimate, b)
        if schedule.rests(estimate):
            return [], []
        due = schedule.due(estimate.stamp, np.arange(len(estimate.stamp)))
        parts = [trail.until(estimate.stamp[due]) for trail in trails]
        found = []
        for k, t in enumerate(due):
            plane = estimate.plane or given
            drawn: dict[str, _Drawn] = {}
            for b, body in enumerate(bodies):
                if not estimate.missing[t, b]:
                    shown = _of_body(estimate, t, b, plane, trails[b], parts[b][k], highest)
                    drawn |= {f'{body}/{name}': one for name, one in shown.items()}
            if pairs:
                drawn |= _of_pairs(estimate, t, plane, pairs)
            writer = Writer()
            writer.pack('I', len(names))
            for name in names:
                header = int(estimate.stamp[t]), (estimate.frame_id, name)
                _write_marker(writer, *header, drawn.get(name))
            found.append(bytes(writer.data))
        return due, found

    return build


def nothing_drawn(stamp: int, frame_id: str) -> bytes:
    """A MarkerArray that takes away all that was drawn; `stamp` in ns."""
    writer = Writer()
    writer.pack('I', 1)
    _write_marker(writer, stamp, (frame_id, ''), None, Marker.DELETEALL)
    return bytes(writer.data)


# What is drawn of a body, in this order.
_OF_BODY = (
    'outline',
    'name',
    *POLE_NAMES,
    *(f'{pole}/deviation' for pole in POLE_NAMES),
    'icr_velocity',
    'centrode_fixed',
    'centrode_moving',
)


def _of_body(
    estimate: Estimate,
    t: int,
    b: int,
    plane: Plane,
    trail: Trail,
    part: slice,
    highest: int,
) -> dict[str, _Drawn]:
    """All that can be drawn of body `b`, which is known, at instant `t`."""
    size = float(estimate.size[t, b]) if estimate.size[t, b] > 0 else 1.0
    height, origin = estimate.height[t, b], estimate.origin(0)[t, b]
    turn, color = np.exp(1j * estimate.angle[0, t, b]), COLORS[b % len(COLORS)]

    def line(points: np.ndarray, width: float, alpha: float) -> _Drawn:
        places = plane.in_space(points, height)
        return _Drawn(Marker.LINE_STRIP, places, (width, 0.0, 0.0), (*color, alpha))

    found = {}
    shape = estimate.shape[t, b]
    shape = shape[np.isfinite(shape)]
    if len(shape) > 1:
        around = shape[np.argsort(np.angle(shape - shape.mean()))]
        outline = origin + turn * np.append(around, around[:1])
        found['outline'] = line(outline, size / 60, 0.8)
        middle = plane.in_space(outline[:-1].mean()[None], height)
        label = (0.0, 0.0, size / 6)
        found['name'] = _Drawn(
            Marker.TEXT_VIEW_FACING, middle, label, (*color, 1.0), text=estimate.bodies[b]
        )
    for order, name in enumerate(POLE_NAMES[:highest], 1):
        pole = estimate.pole(order)
        if pole.determined[t, b]:
            tint = (*color, _OPAQUE[order - 1])
            place = plane.in_space(pole.value[t, b : b + 1], height)
            found[name] = _Drawn(Marker.SPHERE, place, (size / 20,) * 3, tint)
            found[f'{name}/deviation'] = _ellipse(pole, (t, b), plane, place, size / 200, tint)
    if highest > 1 and estimate.pole(1).determined[t, b] and estimate.icr_moves[t, b]:
        tail = estimate.pole(1).value[t, b]
        # Drawn as far as the ICR goes in a tenth of a second.
        points = np.array([tail, tail + 0.1 * estimate.icr_velocity.value[t, b]])
        found['icr_velocity'] = _Drawn(
            Marker.ARROW,
            plane.in_space(points, height),
            (size / 50, size / 25, 0.0),
            (*color, 1.0),
        )
    if part.stop - part.start > 1:
        found['centrode_fixed'] = line(trail.fixed[part], size / 100, 1.0)
        found['centrode_moving'] = line(origin + turn * trail.moving[part], size / 100, 0.5)
    return found


def _of_pairs(estimate: Estimate, t: int, plane: Plane, names: list[str]) -> dict[str, _Drawn]:
    """Relative instant centers of pairs, at the height of the first body."""
    center, (_, first) = estimate.relative_icr, estimate.pairs
    found = {}
    for k in center.determined[t].nonzero()[0].tolist():
        i = first[k]
        place = plane.in_space(center.value[t, k : k + 1], estimate.height[t, i])
        scale = (max(float(estimate.size[t, i]), 1e-3) / 25,) * 3
        found[names[k]] = _Drawn(Marker.SPHERE, place, scale, (*_GRAY, 1.0))
    return found


def _ellipse(
    pole: Vectors,
    at: tuple[int, int],
    plane: Plane,
    place: np.ndarray,
    thick: float,
    tint: tuple[float, float, float, float],
) -> _Drawn:
    """A flat ball about a pole, of its standard deviations."""
    variances, axes = np.linalg.eigh(pole.covariance[at])
    first, second = _DEVIATIONS * 2 * np.sqrt(np.maximum(variances, 0.0)) + 1e-12
    # Columns are the axes of the ball in space, right-handed.
    across = plane.basis[:2].T @ axes
    turn = _quaternion(np.column_stack((across, np.cross(*across.T))))
    color = (*tint[:3], tint[3] / 3)
    return _Drawn(Marker.SPHERE, place, (float(first), float(second), thick), color, turn)


def _quaternion(turn: np.ndarray) -> list[float]:
    """x, y, z and w of a rotation (3, 3): the eigenvector that it leaves (Bar-Itzhack 2000)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = turn.tolist()
    matrix = [
        [xx - yy - zz, yx + xy, zx + xz, zy - yz],
        [yx + xy, yy - xx - zz, zy + yz, xz - zx],
        [zx + xz, zy + yz, zz - xx - yy, yx - xy],
        [zy - yz, xz - zx, yx - xy, xx + yy + zz],
    ]
    found: list[float] = np.linalg.eigh(np.array(matrix) / 3)[1][:, -1].tolist()
    return found


def _write_marker(
    writer: Writer,
    stamp: int,
    names: tuple[str, str],
    drawn: _Drawn | None,
    gone: int = Marker.DELETE,
) -> None:
    """Field after field, as visualization_msgs/msg/Marker has them."""
    frame_id, ns = names
    writer.header(stamp, frame_id)
    writer.string(ns)
    pose, points = np.zeros(10), np.empty((0, 3))
    pose[6] = 1.0
    kind, action, color, text = Marker.ARROW, gone, (0.0, 0.0, 0.0, 0.0), ''
    if drawn is not None:
        kind, action, color, text = drawn.kind, Marker.ADD, drawn.color, drawn.text
        pose[7:] = drawn.scale
        if kind in (Marker.SPHERE, Marker.TEXT_VIEW_FACING):
            pose[:3], pose[3:7] = drawn.places[0], drawn.turn
        else:
            points = drawn.places
    writer.pack('3i', 0, kind, action)
    writer.doubles(pose)
    writer.pack('4f2i?', *color, _LASTS, 0, False)
    writer.pack('I', len(points))
    writer.doubles(points)
    # No colors of points, no texture.
    writer.align(4)
    writer.data += bytes(4) + _EMPTY + bytes(8) + _EMPTY + _EMPTY + bytes(4)
    # No coordinates of a texture.
    writer.data += bytes(4)
    writer.string(text)
    # No mesh.
    writer.align(4)
    writer.data += _EMPTY + _EMPTY + bytes(4) + bytes(1)


# A string without letters, and what is after it before the next field.
_EMPTY = struct.pack('<I4x', 1)
