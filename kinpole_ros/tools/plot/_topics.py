"""The topics of a bag of results as arrays: poses and series of quantities over time."""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from kinpole_ros.bags import Truncated, message_class, read_messages
from kinpole_ros.messages import (
    DRAWING,
    STATE,
    deserialize_message,
    read_event,
    read_states,
    stamp_to_ns,
)
from kinpole_ros.tracking.plane import Plane
from kinpole_ros.tracking.values import Numbers, Vectors

ODOMETRY = 'nav_msgs/msg/Odometry'
_MARKER_ARRAY = 'visualization_msgs/msg/MarkerArray'
_CLOUD = 'sensor_msgs/msg/PointCloud2'
# The last drawings that are kept: a body may be missing in some.
_DRAWINGS = 20

# Stamps (T,) and numbers (T, ...).
Rows = tuple[np.ndarray, np.ndarray]
# Stamps (T,) and quantities (T, B) of a node, by name.
States = list[tuple[np.ndarray, dict[str, Numbers | Vectors]]]


class Series(NamedTuple):
    """
    One topic: `stamp` (T,), increasing, ns, and `value` (T,), complex for points and vectors.

    `covariance` (T, 2, 2) is NaN where it is not published.
    """

    stamp: np.ndarray
    value: np.ndarray
    covariance: np.ndarray


class Poses(NamedTuple):
    """Poses, velocities and rates (T,) of a body, with standard deviations, as in `Body`."""

    stamp: np.ndarray
    position: np.ndarray
    sigma: np.ndarray
    angle: np.ndarray
    angle_sigma: np.ndarray
    velocity: np.ndarray
    rate: np.ndarray
    rate_sigma: np.ndarray


class Topics(NamedTuple):
    """Rows, states and the last drawings by topic, and where a truncated bag ends."""

    rows: dict[str, Rows]
    states: dict[str, States]
    drawings: dict[str, deque[bytes]]
    cut: str

    def frames(self, node: str) -> np.ndarray:
        """Return the stamps (F,), ns, with a result of a node, if not of all its bodies."""
        stamps = [stamp for stamp, _ in self.states.get(f'{node}/{STATE}', [])]
        for topic, (stamp, _) in self.rows.items():
            if topic.startswith(f'{node}/') and not topic.endswith('/event'):
                stamps.append(stamp)
        return np.unique(np.concatenate(stamps))


def read_topics(
    bag: str | Path, names: Collection[str], progress: Callable[[float], None] | None = None
) -> Topics:
    """Read topics of results; of those with a stamp twice, the last message counts."""
    rows: dict[str, dict[int, list[float]]] = {}
    clouds: dict[str, list[bytes]] = {}
    drawings: dict[str, deque[bytes]] = {}
    cut = ''
    try:
        for message in read_messages(bag, names, progress):
            if message.type_name == _MARKER_ARRAY:
                drawings.setdefault(message.topic, deque(maxlen=_DRAWINGS)).append(message.data)
            elif message.type_name == _CLOUD and message.topic.endswith(f'/{STATE}'):
                clouds.setdefault(message.topic, []).append(message.data)
            elif message.type_name == _CLOUD:
                stamp, numbers = read_event(message.data)
                rows.setdefault(message.topic, {})[stamp] = [numbers['order']]
            elif make_row := _ROWS.get(message.type_name):
                decoded = decode(message.type_name, message.data)
                stamp = stamp_to_ns(decoded.header.stamp)
                rows.setdefault(message.topic, {})[stamp] = make_row(decoded)
    except Truncated as error:
        cut = str(error)
    arrays = {}
    for topic, by_stamp in rows.items():
        stamps = np.fromiter(by_stamp, np.int64, len(by_stamp))
        order = np.argsort(stamps)
        arrays[topic] = stamps[order], np.array(list(by_stamp.values()), float)[order]
    states: dict[str, States] = {}
    for topic, messages in clouds.items():
        with suppress(ValueError, RuntimeError):  # clouds of another program
            states[topic] = list(read_states(messages))
    return Topics(arrays, states, drawings, cut)


def decode(type_name: str, data: bytes) -> Any:
    """Return a message of a bag as an object of its type."""
    return deserialize_message(data, message_class(type_name))


def row_of(type_name: str, data: bytes) -> list[float]:
    """
    Return the numbers in a result message.

    For odometry they are position (3), quaternion (4), angular velocity (3), their covariances
    (3 times 3 x 3) and the velocity (3).
    """
    return _ROWS[type_name](decode(type_name, data))


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def _odometry_row(message: Any) -> list[float]:
    pose, twist = message.pose, message.twist
    blocks = ((pose.covariance, 0), (pose.covariance, 3), (twist.covariance, 3))
    return [
        *_xyz(pose.pose.position),
        *_xyz(pose.pose.orientation),
        pose.pose.orientation.w,
        *_xyz(twist.twist.angular),
        *(c[6 * (k + i) + k + j] for c, k in blocks for i in range(3) for j in range(3)),
        *_xyz(twist.twist.linear),
    ]


_ROWS: dict[str, Callable[[Any], list[float]]] = {
    ODOMETRY: _odometry_row,
    'geometry_msgs/msg/PointStamped': lambda message: _xyz(message.point),
    'geometry_msgs/msg/Vector3Stamped': lambda message: _xyz(message.vector),
    'geometry_msgs/msg/PoseWithCovarianceStamped': lambda message: [
        *_xyz(message.pose.pose.position),
        *message.pose.covariance,
    ],
}


def poses_of(rows: Rows, plane: Plane) -> Poses:
    """Return the poses in the rows of odometry."""
    stamp, values = rows
    normal = plane.normal
    blocks = np.moveaxis(values[:, 10:37].reshape(-1, 3, 3, 3), 1, 0)
    sigma, angle_sigma, rate_sigma = (
        np.sqrt(np.maximum(axis @ block @ axis, 0))
        for axis, block in zip((plane.basis[0], normal, normal), blocks, strict=True)
    )
    angle = 2 * np.arctan2(values[:, 3:6] @ normal, values[:, 6])
    position = plane.project(values[:, :3])[0]
    # The twist is in the frame of the body.
    velocity = plane.project(values[:, 37:40])[0] * np.exp(1j * angle)
    rate = values[:, 7:10] @ normal
    return Poses(stamp, position, sigma, angle, angle_sigma, velocity, rate, rate_sigma)


def series_of(rows: Rows, plane: Plane, is_number: bool) -> Series:
    """Return points or vectors, or the numbers that vectors along the normal stand for."""
    stamp, values = rows
    covariance = np.full((len(stamp), 2, 2), np.nan)
    if values.shape[1] > 3:
        matrix = values[:, 3:].reshape(-1, 6, 6)[:, :3, :3]
        covariance = plane.basis[:2] @ matrix @ plane.basis[:2].T
    in_plane, along_normal = plane.project(values[:, :3])
    return Series(stamp, along_normal if is_number else in_plane, covariance)


def with_deviation(series: Series, rows: Rows | None, plane: Plane) -> Series:
    """Return a series of points with the variances of the coordinates from another topic."""
    if rows is None:
        return series
    _, own, its = np.intersect1d(series.stamp, rows[0], return_indices=True)
    deviation = plane.project(rows[1][its])[0]
    covariance = series.covariance.copy()
    covariance[own] = 0.0
    covariance[own, 0, 0], covariance[own, 1, 1] = deviation.real**2, deviation.imag**2
    return series._replace(covariance=covariance)


def with_states(
    poses: Poses, series: dict[str, Series], states: States
) -> tuple[Poses, dict[str, Series], int]:
    """
    Return poses and series of a body with those of the states of its node added.

    Also the number of the body in the states, -1 where it is in none.
    """
    series, number = dict(series), -1
    for stamp, quantities in states:
        _, own, its = np.intersect1d(stamp, poses.stamp, return_indices=True)
        if not len(own):
            continue
        # A state has no names: its bodies are known by their poses.
        distance = np.abs(quantities['position'].value[own] - poses.position[its, None])
        distance[~quantities['position'].determined[own]] = np.inf
        number = body = int(np.median(distance, axis=0).argmin())
        columns: dict[str, np.ndarray] = {}
        for name, quantity in quantities.items():
            value, variance, determined = (part[:, body] for part in quantity)
            rows = np.flatnonzero(determined)[::-1]  # the last one of a stamp comes first
            at, value, variance = stamp[rows], value[rows], variance[rows]
            none = covariance = np.full((len(at), 2, 2), np.nan)
            if isinstance(quantity, Numbers):
                sigma = np.sqrt(variance)
            else:
                covariance = variance
                sigma = np.sqrt(variance[:, 0, 0]) + 1j * np.sqrt(variance[:, 1, 1])
            columns |= {name: value, f'{name}_sigma': sigma.real}
            if name == 'position':
                columns['stamp'] = at
            elif len(at):
                _add(series, name, Series(at, value, covariance))
                _add(series, f'{name}/deviation', Series(at, sigma, none))
        rates = {'rate': 'angular_velocity', 'sigma': 'position_sigma'}
        rates['rate_sigma'] = 'angular_velocity_sigma'
        poses = _merged(Poses(*(columns[rates.get(n, n)] for n in Poses._fields)), poses)
    return poses, series, number


def _add(series: dict[str, Series], name: str, more: Series) -> None:
    series[name] = _merged(more, series[name]) if name in series else more


_Columns = TypeVar('_Columns', Series, Poses)


def _merged(first: _Columns, second: _Columns) -> _Columns:
    """Return the rows of both, by stamp; of two with one stamp, that of the first."""
    rows = np.unique(np.concatenate((first[0], second[0])), return_index=True)[1]
    columns = (np.concatenate(pair)[rows] for pair in zip(first, second, strict=True))
    return type(first)(*columns)


def outlines_of(drawings: Mapping[str, Iterable[bytes]]) -> dict[str, Any]:
    """Return the stamp and the markers (n, 3) of the last outlines, by prefix of the body."""
    outlines = {}
    for topic, arrays in drawings.items():
        for data in arrays:
            for marker in decode(_MARKER_ARRAY, data).markers:
                body, _, name = marker.ns.rpartition('/')
                if name == 'outline' and marker.points:
                    corners = np.array([_xyz(point) for point in marker.points[:-1]])
                    stamp = stamp_to_ns(marker.header.stamp)
                    outlines[f'{topic.removesuffix(DRAWING)}{body}'] = stamp, corners
    return outlines
