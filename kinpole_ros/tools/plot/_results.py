"""
The results in a bag as series over time.

They are read from the messages alone, so a recording of the live node is as good as a replay.
"""

import shlex
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.bags import BagError, Truncated, message_class, read_messages, topics
from kinpole_ros.messages import DRAWING, deserialize_message, stamp_to_ns
from kinpole_ros.tracking.plane import AXES, Plane, as_parameter, plane_along, plane_of, upward

POLES = ('icr', 'iap', 'ijp', 'isp')
_ODOMETRY = 'nav_msgs/msg/Odometry'
_MARKER_ARRAY = 'visualization_msgs/msg/MarkerArray'
_CURVATURE = 'centrode_curvature'
# Topics of a body whose vector is along the normal of the plane, and stands for a number.
_NUMBERS = ('angular_acceleration', 'angular_jerk', _CURVATURE, 'angular_snap')
# Topics of a body up to the jerk, and the others.
_USUAL_TOPICS: tuple[str, ...] = (
    *_NUMBERS[:3],
    *POLES[:3],
    *(f'{pole}/with_covariance' for pole in POLES[:3]),
    'icr_velocity',
    *(f'{name}/deviation' for name in (*_NUMBERS[:3], 'icr_velocity')),
)
_SNAP_TOPICS = ('angular_snap', 'isp', 'isp/with_covariance', 'angular_snap/deviation')
# The last drawings that are kept: a body may be missing in some.
_DRAWINGS = 20
# A normal this near to an axis is along it.
_AXIS_ROUNDING = 1e-9
# If bodies turn more than this fraction about other axes, they move in no common plane.
_OFF_AXIS = 1e-3

# Stamps (T,) and numbers (T, ...).
Rows = tuple[np.ndarray, np.ndarray]


class Series(NamedTuple):
    """
    One topic: `stamp` (T,), increasing, ns, and `value` (T,), complex for points and vectors.

    `covariance` (T, 2, 2) is NaN where it is not published.
    """

    stamp: np.ndarray
    value: np.ndarray
    covariance: np.ndarray


class Body(NamedTuple):
    """
    The results of one body at the stamps (T,) of its odometry; other topics are in `series`.

    `position` (T,) is complex, m, with `sigma` (T,) of one coordinate, and `velocity`, m/s; `angle`
    (T,), rad; `rate` and `rate_sigma` (T,), rad/s; `size`, m, is twice the root mean square
    distance of the markers from their mean, NaN if unknown; `outline` (n,) are the markers in the
    body's frame as they were drawn last, complex, m.
    """

    name: str
    stamp: np.ndarray
    position: np.ndarray
    angle: np.ndarray
    rate: np.ndarray
    rate_sigma: np.ndarray
    size: float
    series: dict[str, Series]
    velocity: np.ndarray
    sigma: np.ndarray
    outline: np.ndarray


class Results(NamedTuple):
    """
    The results in a bag: the plane, bodies in the order of the node, and relative instant centers.

    `relative` has names (j, i) of bodies as keys. `cut` says where a truncated bag ends, and
    `along` which directions x and y of the plane have in the frame of the markers.
    """

    plane: str
    bodies: list[Body]
    relative: dict[tuple[str, str], Series]
    cut: str
    along: tuple[str, str]


class Centrodes(NamedTuple):
    """
    The ICR at `stamp` (K,), complex, m: `fixed` in the plane, and `moving` in the body's frame.

    `rate` (K,) is the angular velocity, rad/s, and `sigma` (K,) the standard deviation of the ICR,
    m, NaN where it is not published.
    """

    stamp: np.ndarray
    fixed: np.ndarray
    moving: np.ndarray
    rate: np.ndarray
    sigma: np.ndarray


def read_results(
    bag: str | Path, progress: Callable[[float], None] | None = None, with_snap: bool = False
) -> Results:
    """
    Read the results of a bag, without the exact motion of `kinpole simulate`.

    With `with_snap`, all topics of a body up to the snap are read, not only those up to the jerk.
    `progress` is called with the fraction of bytes read. Raises BagError if there are no results.
    """
    kinds = topics(bag)
    prefixes = _body_prefixes(kinds)
    if not prefixes:
        raise BagError(
            f'{bag} holds no results (no odometry of a body); make them first: '
            f'kinpole replay {shlex.quote(str(bag))} --output RESULT.mcap'
        )
    relative = {
        topic: (prefix, f'{prefix.rpartition("/")[0]}/{topic.split("/")[-2]}')
        for prefix in prefixes
        for topic in kinds
        if topic.startswith(f'{prefix}/wrt/') and topic.endswith('/icr')
    }
    names = _USUAL_TOPICS + _SNAP_TOPICS if with_snap else _USUAL_TOPICS
    to_read = {f'{prefix}/{name}' for prefix in prefixes for name in ('odom', *names)}
    with_covariance = {t for t in to_read & set(kinds) if t.endswith('/with_covariance')}
    to_read -= {topic.removesuffix('/with_covariance') for topic in with_covariance}
    to_read |= {*relative, *(f'{topic}/deviation' for topic in relative)}
    to_read |= {f'{prefix.rpartition("/")[0]}/{DRAWING}' for prefix in prefixes}
    rows, drawings, cut = _read_rows(bag, to_read, progress)
    odometry = {p: rows[f'{p}/odom'] for p in prefixes if f'{p}/odom' in rows}
    if not odometry:
        raise BagError(
            f'{bag} holds no pose of {", ".join(prefixes)}; see in its /diagnostics why, and '
            'whether the parameters name the markers as they are published'
        )
    plane = plane_of_motion(np.concatenate([values for _, values in odometry.values()]))
    several_nodes = len({prefix.rpartition('/')[0] for prefix in odometry}) > 1
    body_names = {p: p if several_nodes else p.rpartition('/')[2] for p in odometry}
    outlines = _outlines(drawings)
    bodies = []
    for prefix, pose_rows in odometry.items():
        series = _body_series(rows, prefix, names, plane)
        if f'{prefix}/{_CURVATURE}' in kinds:
            # An empty series: the ICR did not move measurably. That is more than not recorded.
            none = np.empty(0, int), np.empty((0, 3))
            series.setdefault(_CURVATURE, _series(none, plane, is_number=True))
        drawn = outlines.get(prefix, (0, np.empty((0, 3))))
        bodies.append(_body(body_names[prefix], pose_rows, plane, series, drawn))
    centers = {
        (body_names[j], body_names[i]): _with_deviation(
            _series(rows[topic], plane, is_number=False), rows.get(f'{topic}/deviation'), plane
        )
        for topic, (j, i) in relative.items()
        if topic in rows and j in body_names and i in body_names
    }
    along = plane.name[:1], plane.name[1:2]
    if plane.axes is None:
        along = f'along {as_parameter(plane.basis[0])}', f'along {as_parameter(plane.basis[1])}'
    return Results(plane.name, bodies, centers, cut, along)


def _body_prefixes(kinds: Mapping[str, str]) -> list[str]:
    """Return the topic prefixes of the bodies, as '/kinpole/crank', in the order of the node."""
    prefixes = [
        topic.removesuffix('/odom')
        for topic, kind in kinds.items()
        if topic.endswith('/odom') and topic.count('/') > 2 and kind == _ODOMETRY
    ]
    prefixes = [name for name in prefixes if not name.rpartition('/')[0].endswith('/truth')]
    # Each body has relative centers to all bodies before it.
    return sorted(prefixes, key=lambda prefix: sum(t.startswith(f'{prefix}/wrt/') for t in kinds))


def bodies_of(node: str, topics: Collection[str]) -> list[str]:
    """Return the bodies that a node publishes, in its order, from its topics."""
    split = (topic.rsplit('/', 2) for topic in topics)
    bodies = [words[1] for words in split if words[::2] == [node, 'odom']]
    return sorted(bodies, key=lambda b: sum(t.startswith(f'{node}/{b}/wrt/') for t in topics))


def read_truth(bag: str | Path, results: Results) -> dict[str, dict[str, Series]]:
    """
    Read the exact rates, curvature and ICR velocity of `kinpole simulate`, by body and topic.

    There are none if the plane is oblique.
    """
    plane = plane_of(results.plane) if results.plane in AXES else None
    if plane is None:
        return {}
    names = {
        f'/kinpole/truth/{body.name}/{name}': (body.name, name)
        for body in results.bodies
        for name in ('angular_velocity', *_NUMBERS[:3], 'icr_velocity')
    }
    truth: dict[str, dict[str, Series]] = {body.name: {} for body in results.bodies}
    for topic, rows in _read_rows(bag, names, None)[0].items():
        body, name = names[topic]
        truth[body][name] = _series(rows, plane, is_number=name != 'icr_velocity')
    return truth


def centrodes(body: Body) -> Centrodes:
    """Return both centrodes of a body, at the instants with a pose and an ICR."""
    if 'icr' not in body.series:
        none = np.empty(0)
        return Centrodes(none.astype(np.int64), none + 0j, none + 0j, none, none)
    icr = body.series['icr']
    stamp, pose, point = np.intersect1d(body.stamp, icr.stamp, return_indices=True)
    fixed = icr.value[point]
    moving = (fixed - body.position[pose]) * np.exp(-1j * body.angle[pose])
    sigma = np.sqrt(np.trace(icr.covariance[point], axis1=1, axis2=2))
    return Centrodes(stamp, fixed, moving, body.rate[pose], sigma)


def plane_of_motion(odometry: np.ndarray) -> Plane:
    """
    Return the plane whose normal the bodies turn about, or else that of the covariances.

    Rows of `odometry` (T, 40) are those of `row_of`.
    """
    turns = np.concatenate((odometry[:, 3:6], odometry[:, 7:10]))
    squares = turns.T @ turns
    if not turns.any():
        # Only the rotation about the normal is measured.
        squares = np.linalg.pinv(odometry[:, 19:28].reshape(-1, 3, 3).sum(axis=0), hermitian=True)
    values, vectors = np.linalg.eigh(squares)
    normal = upward(vectors[:, -1])
    is_oblique = np.abs(normal).max() < 1 - _AXIS_ROUNDING
    if is_oblique and values[1] < _OFF_AXIS * values[2]:
        return plane_along(normal)
    measure = np.abs(turns).sum(axis=0) if turns.any() else squares.diagonal()
    axis = max((2, 0, 1), key=lambda axis: measure[axis])  # a tie is the plane xy
    plane = plane_of(next(name for name, axes in AXES.items() if axes[2] == axis))
    assert plane is not None
    return plane


def _body_series(
    rows: Mapping[str, Rows], prefix: str, names: Iterable[str], plane: Plane
) -> dict[str, Series]:
    series = {}
    for name in names:
        if f'{prefix}/{name}' in rows:
            is_number = name.removesuffix('/deviation') in _NUMBERS
            key = name.removesuffix('/with_covariance')
            series[key] = _series(rows[f'{prefix}/{name}'], plane, is_number)
    return series


def _series(rows: Rows, plane: Plane, is_number: bool) -> Series:
    stamp, values = rows
    covariance = np.full((len(stamp), 2, 2), np.nan)
    if values.shape[1] > 3:
        matrix = values[:, 3:].reshape(-1, 6, 6)[:, :3, :3]
        covariance = plane.basis[:2] @ matrix @ plane.basis[:2].T
    in_plane, along_normal = plane.project(values[:, :3])
    return Series(stamp, along_normal if is_number else in_plane, covariance)


def _with_deviation(series: Series, rows: Rows | None, plane: Plane) -> Series:
    """Return a series of points with the variances of the coordinates from another topic."""
    if rows is None:
        return series
    _, own, its = np.intersect1d(series.stamp, rows[0], return_indices=True)
    deviation = plane.project(rows[1][its])[0]
    covariance = series.covariance.copy()
    covariance[own] = 0.0
    covariance[own, 0, 0], covariance[own, 1, 1] = deviation.real**2, deviation.imag**2
    return series._replace(covariance=covariance)


def _body(name: str, rows: Rows, plane: Plane, series: dict[str, Series], drawn: Rows) -> Body:
    stamp, values = rows
    first, normal = plane.basis[0], plane.normal
    position_covariance, angle_covariance, rate_covariance = np.moveaxis(
        values[:, 10:37].reshape(-1, 3, 3, 3), 1, 0
    )
    variance = first @ position_covariance @ first
    with np.errstate(divide='ignore', invalid='ignore'):
        # Marker noise moves the mean of the markers and turns them about it; the ratio is a length.
        angle_variance = normal @ angle_covariance @ normal
        size = 2 * np.sqrt(np.median(variance) / np.median(angle_variance))
    angle = 2 * np.arctan2(values[:, 3:6] @ normal, values[:, 6])
    position = plane.project(values[:, :3])[0]
    # A recording may end between a drawing and its poses.
    at = np.flatnonzero(stamp == drawn[0])[:1]
    corners = plane.project(drawn[1])[0] if len(at) else np.empty(0, complex)
    return Body(
        name,
        stamp,
        position,
        angle,
        values[:, 7:10] @ normal,
        np.sqrt(np.maximum(normal @ rate_covariance @ normal, 0)),
        float(size) if np.isfinite(size) else float('nan'),
        series,
        # The twist is in the frame of the body.
        plane.project(values[:, 37:40])[0] * np.exp(1j * angle),
        np.sqrt(np.maximum(variance, 0)),
        (corners - position[at]) * np.exp(-1j * angle[at]),
    )


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
    _ODOMETRY: _odometry_row,
    'geometry_msgs/msg/PointStamped': lambda message: _xyz(message.point),
    'geometry_msgs/msg/Vector3Stamped': lambda message: _xyz(message.vector),
    'geometry_msgs/msg/PoseWithCovarianceStamped': lambda message: [
        *_xyz(message.pose.pose.position),
        *message.pose.covariance,
    ],
}


def _read_rows(
    bag: str | Path, names: Collection[str], progress: Callable[[float], None] | None
) -> tuple[dict[str, Rows], dict[str, deque[bytes]], str]:
    """Return the rows by topic, the last drawings by topic, and where a truncated bag ends."""
    rows: dict[str, dict[int, list[float]]] = {}
    drawings: dict[str, deque[bytes]] = {}
    cut = ''
    try:
        for message in read_messages(bag, names, progress):
            if message.type_name == _MARKER_ARRAY:
                drawings.setdefault(message.topic, deque(maxlen=_DRAWINGS)).append(message.data)
            elif make_row := _ROWS.get(message.type_name):
                decoded = decode(message.type_name, message.data)
                # A bag played in a loop repeats stamps: the last message counts.
                stamp = stamp_to_ns(decoded.header.stamp)
                rows.setdefault(message.topic, {})[stamp] = make_row(decoded)
    except Truncated as error:
        cut = str(error)
    arrays = {}
    for topic, by_stamp in rows.items():
        stamp = np.fromiter(by_stamp, np.int64, len(by_stamp))
        order = np.argsort(stamp)
        arrays[topic] = stamp[order], np.array(list(by_stamp.values()), float)[order]
    return arrays, drawings, cut


def _outlines(drawings: Mapping[str, Iterable[bytes]]) -> dict[str, Any]:
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
