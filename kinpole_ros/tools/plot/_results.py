"""
The results in a bag as series over time.

They are read from the messages alone, so a recording of the live node is as good as a replay.
"""

import shlex
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinpole_ros.bags import BagError, topics
from kinpole_ros.messages import DRAWING, STATE
from kinpole_ros.tools.plot._topics import (
    ODOMETRY,
    Poses,
    Rows,
    Series,
    outlines_of,
    poses_of,
    read_topics,
    series_of,
    with_deviation,
    with_states,
)
from kinpole_ros.tracking.plane import AXES, Plane, as_parameter, plane_along, plane_of, upward

POLES = ('icr', 'iap', 'ijp', 'isp')
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
# A normal this near to an axis is along it.
_AXIS_ROUNDING = 1e-9
# If bodies turn more than this fraction about other axes, they move in no common plane.
_OFF_AXIS = 1e-3


class Body(NamedTuple):
    """
    The results of one body at the stamps (T,) of its poses; other topics are in `series`.

    `frames` (F,), ns, are the stamps with any result of the node. A frame that is not among them is
    lost; a quantity without a value in one that is, is undetermined.
    `position` (T,) is complex, m, with `sigma` (T,) of one coordinate, and `velocity`, m/s; `angle`
    (T,), rad; `rate` and `rate_sigma` (T,), rad/s; `size`, m, is twice the root mean square
    distance of the markers from their mean, NaN if unknown; `outline` (n,) are the markers in the
    body's frame as they were drawn last, complex, m. `events` (E,), ns, are the instants at which a
    derivative steps, and `event_orders` (E,) which.
    """

    name: str
    frames: np.ndarray
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
    events: np.ndarray
    event_orders: np.ndarray


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
    to_read |= {f'{prefix}/event' for prefix in prefixes}
    to_read |= {*relative, *(f'{topic}/deviation' for topic in relative)}
    to_read |= {f'{prefix.rpartition("/")[0]}/{DRAWING}' for prefix in prefixes}
    to_read |= {f'{prefix.rpartition("/")[0]}/{STATE}' for prefix in prefixes}
    found = read_topics(bag, to_read, progress)
    rows = found.rows
    odometry = {p: rows[f'{p}/odom'] for p in prefixes if f'{p}/odom' in rows}
    if not odometry:
        raise BagError(
            f'{bag} holds no pose of {", ".join(prefixes)}; see in its /diagnostics why, and '
            'whether the parameters name the markers as they are published'
        )
    plane = plane_of_motion(np.concatenate([values for _, values in odometry.values()]))
    several_nodes = len({prefix.rpartition('/')[0] for prefix in odometry}) > 1
    body_names = {p: p if several_nodes else p.rpartition('/')[2] for p in odometry}
    outlines = outlines_of(found.drawings)
    bodies, numbers = [], []
    for prefix, pose_rows in odometry.items():
        node = prefix.rpartition('/')[0]
        poses, series, number = with_states(
            poses_of(pose_rows, plane),
            _body_series(rows, prefix, names, plane),
            found.states.get(f'{node}/{STATE}', []),
        )
        if f'{prefix}/{_CURVATURE}' in kinds:
            # An empty series: the ICR did not move measurably. That is more than not recorded.
            none = np.empty(0, int), np.empty((0, 3))
            series.setdefault(_CURVATURE, series_of(none, plane, is_number=True))
        drawn = outlines.get(prefix, (0, np.empty((0, 3))))
        body = _body(
            body_names[prefix], found.frames(node), poses, series, _outline(drawn, poses, plane)
        )
        events, orders = rows.get(f'{prefix}/event', (np.empty(0, np.int64), np.empty((0, 1))))
        bodies.append(body._replace(events=events, event_orders=orders[:, 0].astype(int)))
        numbers.append(number)
    # A recording has its topics in the order in which they were found.
    bodies = [bodies[k] for k in sorted(range(len(bodies)), key=numbers.__getitem__)]
    centers = {
        (body_names[j], body_names[i]): with_deviation(
            series_of(rows[topic], plane, is_number=False), rows.get(f'{topic}/deviation'), plane
        )
        for topic, (j, i) in relative.items()
        if topic in rows and j in body_names and i in body_names
    }
    along = plane.name[:1], plane.name[1:2]
    if plane.axes is None:
        along = f'along {as_parameter(plane.basis[0])}', f'along {as_parameter(plane.basis[1])}'
    return Results(plane.name, bodies, centers, found.cut, along)


def _body_prefixes(kinds: Mapping[str, str]) -> list[str]:
    """Return the topic prefixes of the bodies, as '/kinpole/crank', in the order of the node."""
    prefixes = [
        topic.removesuffix('/odom')
        for topic, kind in kinds.items()
        if topic.endswith('/odom') and topic.count('/') > 2 and kind == ODOMETRY
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
    Read the exact rates, poles and curvature of `kinpole simulate`, by body and topic.

    There are none if the plane is oblique.
    """
    plane = plane_of(results.plane) if results.plane in AXES else None
    if plane is None:
        return {}
    vectors = (*POLES[:3], 'icr_velocity')
    names = {
        f'/kinpole/truth/{body.name}/{name}': (body.name, name)
        for body in results.bodies
        for name in ('angular_velocity', *_NUMBERS[:3], *vectors)
    }
    truth: dict[str, dict[str, Series]] = {body.name: {} for body in results.bodies}
    for topic, rows in read_topics(bag, names).rows.items():
        body, name = names[topic]
        truth[body][name] = series_of(rows, plane, is_number=name not in vectors)
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
            series[key] = series_of(rows[f'{prefix}/{name}'], plane, is_number)
    return series


def _body(
    name: str, frames: np.ndarray, poses: Poses, series: dict[str, Series], outline: np.ndarray
) -> Body:
    with np.errstate(divide='ignore', invalid='ignore'):
        # Marker noise moves the mean of the markers and turns them about it; the ratio is a length.
        size = float(2 * np.median(poses.sigma) / np.median(poses.angle_sigma))
    return Body(
        name,
        frames,
        poses.stamp,
        poses.position,
        poses.angle,
        poses.rate,
        poses.rate_sigma,
        size if np.isfinite(size) else float('nan'),
        series,
        poses.velocity,
        poses.sigma,
        outline,
        np.empty(0, np.int64),
        np.empty(0, int),
    )


def _outline(drawn: Rows, poses: Poses, plane: Plane) -> np.ndarray:
    """Return markers (n,) in the body's frame; none if they are drawn at a stamp without a pose."""
    # A recording may end between a drawing and its poses.
    at = np.flatnonzero(poses.stamp == drawn[0])[:1]
    corners = plane.project(drawn[1])[0] if len(at) else np.empty(0, complex)
    return (corners - poses.position[at]) * np.exp(-1j * poses.angle[at])
