"""
The results in a bag, as series over time: all that a picture is drawn of.

Read from the messages alone, so a recording of the live node is as good as a replay.
"""

import shlex
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rclpy.serialization import deserialize_message

from kinpole_ros.bags import BagError, Truncated, message_class, read_messages, topics
from kinpole_ros.messages import stamp_to_ns
from kinpole_ros.plane import AXES

POLES = ('icr', 'iap', 'ijp')


class Series(NamedTuple):
    """
    One topic: `stamp` (T,) in ns, rising, and `value` (T,), complex where it is of the plane.

    `covariance` (T, 2, 2), NaN where not published.
    """

    stamp: np.ndarray
    value: np.ndarray
    covariance: np.ndarray


class Body(NamedTuple):
    """
    What a bag tells of one body: from odom at `stamp` (T,) in ns, the rest by topic in `series`.

    `position` (T,) complex, m; `angle` (T,), rad; `rate` and its standard deviation `rate_sigma`
    (T,), rad/s; `size`, m, is twice the root mean square distance of the markers from their mean,
    NaN when it cannot be told.
    """

    name: str
    stamp: np.ndarray
    position: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    rate_sigma: np.ndarray
    size: float
    series: dict[str, Series]


class Results(NamedTuple):
    """A result bag: its plane, the bodies, and relative instant centers by names (j, i)."""

    plane: str
    bodies: list[Body]
    relative: dict[tuple[str, str], Series]
    cut: bool


class Centrodes(NamedTuple):
    """
    Loci of the ICR, both complex (K,) in m: `fixed` in the plane, `moving` in the body's frame.

    Taken at `stamp` (K,) in ns, where the body turned at `rate` (K,), rad/s; `sigma` (K,), m, is
    how well the ICR is known, NaN where not published.
    """

    stamp: np.ndarray
    fixed: np.ndarray
    moving: np.ndarray
    rate: np.ndarray
    sigma: np.ndarray


def read_results(bag: str | Path, progress: Callable[[float], None] | None = None) -> Results:
    """
    The results of a bag, whatever node published them; exact answers of simulate are left out.

    `progress` is called with the fraction of bytes read. Raises BagError when there are none.
    """
    kinds = topics(bag)
    prefixes = [
        topic.removesuffix('/odom')
        for topic, kind in kinds.items()
        if topic.endswith('/odom') and topic.count('/') > 2 and kind == 'nav_msgs/msg/Odometry'
    ]
    prefixes = [name for name in prefixes if not name.rpartition('/')[0].endswith('/truth')]
    # The order in which the node has them: each one is related to all before it.
    prefixes.sort(key=lambda prefix: sum(t.startswith(f'{prefix}/wrt/') for t in kinds))
    relative = {
        topic: (prefix, f'{prefix.rpartition("/")[0]}/{topic.split("/")[-2]}')
        for prefix in prefixes
        for topic in kinds
        if topic.startswith(f'{prefix}/wrt/') and topic.endswith('/icr')
    }
    if not prefixes:
        raise BagError(
            f'{bag} holds no results (no odometry of a body); make them first: '
            f'kinpole replay {shlex.quote(str(bag))} --output RESULT.mcap'
        )
    wanted = {f'{prefix}/{part}' for prefix in prefixes for part in ('odom', *_PARTS)}
    # Of a pole that comes with its covariance the plain one says nothing more.
    wanted -= {
        t.removesuffix('/with_covariance')
        for t in wanted & set(kinds)
        if t.endswith('/with_covariance')
    }
    rows, cut = _read(bag, wanted | set(relative), progress)
    bodies_there = [prefix for prefix in prefixes if f'{prefix}/odom' in rows]
    if not bodies_there:
        raise BagError(
            f'{bag} holds no pose of {", ".join(prefixes)}; see in its /diagnostics why, and '
            'whether the parameters name the markers as they are published'
        )
    prefixes = bodies_there
    odometry = {prefix: rows[f'{prefix}/odom'] for prefix in prefixes}
    plane = _plane(np.concatenate([values for _, values in odometry.values()]))
    axes = AXES[plane]
    nodes = {prefix.rpartition('/')[0] for prefix in prefixes}
    names = {
        prefix: prefix.rpartition('/')[2] if len(nodes) == 1 else prefix for prefix in prefixes
    }
    bodies = []
    for prefix, (stamp, values) in odometry.items():
        parts = {part: rows[name] for part in _PARTS if (name := f'{prefix}/{part}') in rows}
        for pole in POLES:
            if f'{pole}/with_covariance' in parts:
                parts[pole] = parts.pop(f'{pole}/with_covariance')
        series = {part: _series(*found, axes, part in _NUMBERS) for part, found in parts.items()}
        if f'{prefix}/{_CURVATURE}' in kinds:
            # Known at no instant: the ICR was not seen to move, which is more than not recorded.
            series.setdefault(_CURVATURE, _series(np.empty(0, int), np.empty((0, 3)), axes, True))
        bodies.append(_body(names[prefix], stamp, values, axes, series))
    between = {
        (names[j], names[i]): _series(*rows[topic], axes, False)
        for topic, (j, i) in relative.items()
        if topic in rows and j in names and i in names
    }
    return Results(plane, bodies, between, cut)


def centrodes(body: Body) -> Centrodes:
    """Both centrodes of a body, at the instants at which its pose and its ICR are known."""
    if 'icr' not in body.series:
        none = np.empty(0)
        return Centrodes(none.astype(np.int64), none + 0j, none + 0j, none, none)
    icr = body.series['icr']
    stamp, own, other = np.intersect1d(body.stamp, icr.stamp, return_indices=True)
    fixed = icr.value[other]
    moving = (fixed - body.position[own]) * np.exp(-1j * body.angle[own])
    sigma = np.sqrt(np.trace(icr.covariance[other], axis1=1, axis2=2))
    return Centrodes(stamp, fixed, moving, body.rate[own], sigma)


_CURVATURE = 'centrode_curvature'
_NUMBERS = ('angular_acceleration', 'angular_jerk', _CURVATURE)
_PARTS = (*_NUMBERS, *POLES, *(f'{pole}/with_covariance' for pole in POLES), 'icr_velocity')


def _xyz(part: Any) -> list[float]:
    return [part.x, part.y, part.z]


def _odometry_row(message: Any) -> list[float]:
    """Place, turn, twist, and the diagonals of their covariances; 3 + 4 + 3 + 6 + 6 numbers."""
    pose, twist = message.pose, message.twist
    turn = pose.pose.orientation
    return [
        *_xyz(pose.pose.position),
        *_xyz(turn),
        turn.w,
        *_xyz(twist.twist.angular),
        *pose.covariance[::7],
        *twist.covariance[::7],
    ]


_ROWS: dict[str, Callable[[Any], list[float]]] = {
    'nav_msgs/msg/Odometry': _odometry_row,
    'geometry_msgs/msg/PointStamped': lambda message: _xyz(message.point),
    'geometry_msgs/msg/Vector3Stamped': lambda message: _xyz(message.vector),
    'geometry_msgs/msg/PoseWithCovarianceStamped': lambda message: [
        *_xyz(message.pose.pose.position),
        *message.pose.covariance,
    ],
}


def _read(
    bag: str | Path, wanted: Collection[str], progress: Callable[[float], None] | None
) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], bool]:
    """Stamps (T,) and numbers (T, ...) of each topic with messages, and if the bag is cut off."""
    found: dict[str, dict[int, list[float]]] = {}
    cut = False
    try:
        for message in read_messages(bag, wanted, progress):
            row = _ROWS.get(message.type_name)
            if row is None:
                continue
            decoded: Any = deserialize_message(message.data, message_class(message.type_name))
            # A bag played in a loop says the same of an instant again: the last word counts.
            found.setdefault(message.topic, {})[stamp_to_ns(decoded.header.stamp)] = row(decoded)
    except Truncated:
        cut = True
    arrays = {}
    for topic, rows in found.items():
        stamp = np.fromiter(rows, np.int64, len(rows))
        order = np.argsort(stamp)
        arrays[topic] = stamp[order], np.array(list(rows.values()), float)[order]
    return arrays, cut


def _plane(odometry: np.ndarray) -> str:
    """The plane whose normal the bodies turn about; where none turns, the one that was measured."""
    turns = np.abs(odometry[:, 3:6]).sum(axis=0) + np.abs(odometry[:, 7:10]).sum(axis=0)
    unmeasured = odometry[:, 13:16].sum(axis=0)
    normals = {axes[2]: plane for plane, axes in AXES.items()}
    # From z on, so that a tie is the plane xy.
    z_first = [2, 0, 1]
    measure = turns if turns.any() else -unmeasured
    return normals[max(z_first, key=lambda axis: measure[axis])]


def _series(
    stamp: np.ndarray, values: np.ndarray, axes: tuple[int, int, int], number: bool
) -> Series:
    covariance = np.full((len(stamp), 2, 2), np.nan)
    if values.shape[1] > 3:
        matrix = values[:, 3:].reshape(-1, 6, 6)
        covariance = matrix[:, axes[:2]][:, :, axes[:2]]
    value = values[:, axes[2]] if number else values[:, axes[0]] + 1j * values[:, axes[1]]
    return Series(stamp, value, covariance)


def _body(
    name: str,
    stamp: np.ndarray,
    values: np.ndarray,
    axes: tuple[int, int, int],
    series: dict[str, Series],
) -> Body:
    first, second, normal = axes
    spread, turn_spread = values[:, 10 + first], values[:, 13 + normal]
    with np.errstate(divide='ignore', invalid='ignore'):
        # The noise of the markers moves their mean and turns them about it: that ratio is a length.
        size = 2 * np.sqrt(np.median(spread) / np.median(turn_spread))
    return Body(
        name,
        stamp,
        values[:, first] + 1j * values[:, second],
        2 * np.arctan2(values[:, 3 + normal], values[:, 6]),
        values[:, 7 + normal],
        np.sqrt(np.maximum(values[:, 19 + normal], 0)),
        float(size) if np.isfinite(size) else float('nan'),
        series,
    )
