"""
The record of a bag of results, from a replay or recorded live.

All numbers are those of the topic `state`. Odometry tells the names of the bodies and the plane,
which a state has not; relative centers, outlines and events have topics of their own.
"""

import shlex
from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.bags import BagError, Truncated, message_class, read_messages, topics
from kinpole_ros.messages import (
    DRAWING,
    STATE,
    deserialize_message,
    read_event,
    read_states,
    stamp_to_ns,
)
from kinpole_ros.tools.record.diagnostics_log import DiagnosticsLog
from kinpole_ros.tools.record.lost import lost_count
from kinpole_ros.tools.record.record import Columns, MotionRecord, Series, quantity_columns
from kinpole_ros.tracking.plane import AXES, Plane, as_parameter, plane_along, plane_of, upward
from kinpole_ros.tracking.values import (
    POLE_NAMES,
    RATE_NAMES,
    Numbers,
    Vectors,
    quantity_names,
)

# Files with these endings are bags, even if they cannot be read.
_BAG_ENDINGS = ('.mcap', '.db3', '.bag')
ODOMETRY = 'nav_msgs/msg/Odometry'
_MARKER_ARRAY = 'visualization_msgs/msg/MarkerArray'
_DIAGNOSTICS = '/diagnostics'
_OF_BODY = ('position', 'angle', 'velocity', *quantity_names(4))
# Quantities that may be withheld while the pose is known.
_WITHHELD = (*POLE_NAMES, 'centrode_curvature', 'inflection_circle')
# The last drawings that are kept: a body may be missing in some.
_DRAWINGS = 20
# Odometry that is read: all of the first messages of a body, and one of so many afterwards.
_FIRST_ODOMETRY, _ODOMETRY_STEP = 50, 10
# A normal this near to an axis is along it.
_AXIS_ROUNDING = 1e-9
# If bodies turn more than this fraction about other axes, they move in no common plane.
_OFF_AXIS = 1e-3

# Stamps (T,) and quantities (T, B) of a node, by name.
States = list[tuple[np.ndarray, dict[str, Numbers | Vectors]]]


class _Messages(NamedTuple):
    """What a bag holds, by topic; rows are by stamp, and of two with one stamp the last counts."""

    states: dict[str, States]
    rows: dict[str, dict[int, list[float]]]
    drawings: dict[str, deque[bytes]]
    diagnostics: DiagnosticsLog
    cut: str

    def table(self, topic: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the stamps (T,) and rows (T, ...) of a topic."""
        rows = self.rows.get(topic, {})
        return np.array(list(rows), np.int64), np.array(list(rows.values()), float)


def is_bag(file: str) -> bool:
    """Return whether a path is a bag, not a file or folder of points or parameters."""
    if not Path(file).exists() or Path(file).suffix.lower() in _BAG_ENDINGS:
        return True
    try:
        topics(file)
    except BagError:
        return False
    return True


def has_results(bag: str | Path) -> bool:
    """Return whether a bag has results of a node, not only the exact motion of simulate."""
    return bool(bodies_by_node(topics(bag)))


def bodies_by_node(kinds: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the bodies of each node with a topic `state`, from the topics of a bag."""
    nodes: dict[str, list[str]] = {}
    for topic, kind in kinds.items():
        node, _, body = topic.removesuffix('/odom').rpartition('/')
        if topic.endswith('/odom') and kind == ODOMETRY and f'{node}/{STATE}' in kinds:
            nodes.setdefault(node, []).append(body)
    return nodes


def read_record(bag: str | Path, progress: Callable[[float], None] | None = None) -> MotionRecord:
    """
    Read the results of a bag, without the exact motion of `kinpole simulate`.

    `progress` is called with the fraction of bytes read. Raises BagError if there are no results.
    """
    nodes = bodies_by_node(topics(bag))
    if not nodes:
        raise BagError(
            f'{bag} holds no results (no topic {STATE} with odometry of a body beside it); make '
            f'them first: kinpole replay {shlex.quote(str(bag))} --output RESULT.mcap'
        )
    found = _read(bag, nodes, progress)
    prefixes = [f'{node}/{body}' for node, bodies in nodes.items() for body in bodies]
    odometry = {p: table for p in prefixes if len((table := found.table(f'{p}/odom'))[0])}
    if not odometry or not any(found.states.values()):
        raise BagError(
            f'{bag} holds no pose of {" or ".join(prefixes)}; replay its markers with '
            'parameters that name the markers as they are published'
        )
    plane = plane_of_motion(np.concatenate([rows for _, rows in odometry.values()]))
    stamp = np.unique(np.concatenate([s for states in found.states.values() for s, _ in states]))
    columns: Columns = {}
    bodies: dict[str, str] = {}  # prefixes of topics by name
    for node in nodes:
        own = {p: table for p, table in odometry.items() if p.startswith(f'{node}/')}
        names = {p: p if len(nodes) > 1 else p.rpartition('/')[2] for p in own}
        numbered: dict[str, int] = {}
        for stamps, quantities in found.states.get(node, []):
            numbered |= _numbers_of(own, stamps, quantities, plane)
            at = stamp.searchsorted(stamps)
            for prefix, number in numbered.items():
                _fill(columns, names[prefix], quantities, number, at, len(stamp))
        bodies |= {names[p]: p for p in sorted(numbered, key=lambda p: numbered[p])}
    for body in bodies:
        _add_reasons(columns, body, stamp, found.diagnostics)
    _add_pairs(columns, bodies, found, stamp, plane)
    along = plane.name[:1], plane.name[1:2]
    if plane.axes is None:
        along = f'along {as_parameter(plane.basis[0])}', f'along {as_parameter(plane.basis[1])}'
    events = {
        body: [(at, int(order)) for at, (order,) in found.rows.get(f'{prefix}/event', {}).items()]
        for body, prefix in bodies.items()
    }
    record = MotionRecord(stamp, len(stamp), tuple(bodies), columns, {}, {}, along, events)
    return record._replace(
        sizes={body: _size(columns, body) for body in bodies},
        outlines=_outlines(record, bodies, found, plane),
        lost=lost_count(stamp),
        notes=found.diagnostics.notes,
        cut=found.cut,
    )


def _read(
    bag: str | Path, nodes: Mapping[str, list[str]], progress: Callable[[float], None] | None
) -> _Messages:
    wanted = {_DIAGNOSTICS}
    for node, bodies in nodes.items():
        wanted |= {f'{node}/{STATE}', f'{node}/{DRAWING}'}
        wanted |= {f'{node}/{body}/{name}' for body in bodies for name in ('odom', 'event')}
        centers = (f'{node}/{j}/wrt/{i}/icr' for j in bodies for i in bodies if i != j)
        wanted |= {topic + end for topic in centers for end in ('', '/deviation')}
    states: dict[str, list[bytes]] = defaultdict(list)
    counts: dict[str, int] = defaultdict(int)
    found = _Messages({}, defaultdict(dict), {}, DiagnosticsLog(), '')
    cut = ''
    try:
        for message in read_messages(bag, wanted, progress):
            topic, name = message.topic, message.topic.rpartition('/')[2]
            if name == STATE:
                states[topic.removesuffix(f'/{STATE}')].append(message.data)
            elif name == DRAWING:
                found.drawings.setdefault(topic, deque(maxlen=_DRAWINGS)).append(message.data)
            elif name == 'event':
                stamp, numbers = read_event(message.data)
                found.rows[topic][stamp] = [numbers['order']]
            elif topic == _DIAGNOSTICS:
                found.diagnostics.add(decode(message.type_name, message.data))
            else:
                counts[topic] += 1
                is_read = counts[topic] <= _FIRST_ODOMETRY or not counts[topic] % _ODOMETRY_STEP
                if name != 'odom' or is_read:
                    decoded = decode(message.type_name, message.data)
                    stamp = stamp_to_ns(decoded.header.stamp)
                    found.rows[topic][stamp] = _ROWS[message.type_name](decoded)
    except Truncated as error:
        cut = str(error)
    for node, messages in states.items():
        with suppress(ValueError):  # clouds of another program
            found.states[node] = list(read_states(messages))
    return found._replace(cut=cut)


def decode(type_name: str, data: bytes) -> Any:
    """Return a message of a bag as an object of its type."""
    return deserialize_message(data, message_class(type_name))


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def odometry_row(message: Any) -> list[float]:
    """Return position and axis of rotation, angular velocity, and covariance (3 x 3) of angles."""
    pose, covariance = message.pose.pose, message.pose.covariance
    angles = [covariance[6 * i + j] for i in (3, 4, 5) for j in (3, 4, 5)]
    return [
        *_xyz(pose.position),
        *_xyz(pose.orientation),
        *_xyz(message.twist.twist.angular),
        *angles,
    ]


_ROWS: dict[str, Callable[[Any], list[float]]] = {
    ODOMETRY: odometry_row,
    'geometry_msgs/msg/PointStamped': lambda message: _xyz(message.point),
    'geometry_msgs/msg/Vector3Stamped': lambda message: _xyz(message.vector),
}


def plane_of_motion(odometry: np.ndarray) -> Plane:
    """
    Return the plane whose normal the bodies turn about, or else that of the covariances.

    Rows of `odometry` (T, 18) are those of `odometry_row`.
    """
    turns = np.concatenate((odometry[:, 3:6], odometry[:, 6:9]))
    squares = turns.T @ turns
    if not turns.any():
        # Only the rotation about the normal is measured.
        squares = np.linalg.pinv(odometry[:, 9:].reshape(-1, 3, 3).sum(axis=0), hermitian=True)
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


def _numbers_of(
    odometry: Mapping[str, tuple[np.ndarray, np.ndarray]],
    stamps: np.ndarray,
    quantities: Mapping[str, Numbers | Vectors],
    plane: Plane,
) -> dict[str, int]:
    """Return which body of the states has the poses of which odometry."""
    position = quantities['position']
    numbers = {}
    for prefix, (own_stamps, rows) in odometry.items():
        _, its, own = np.intersect1d(stamps, own_stamps, return_indices=True)
        if len(own):
            distance = np.abs(position.value[its] - plane.project(rows[own, :3])[0][:, None])
            distance[~position.determined[its]] = np.inf
            numbers[prefix] = int(np.median(distance, axis=0).argmin())
    return numbers


def _fill(
    columns: Columns,
    body: str,
    quantities: Mapping[str, Numbers | Vectors],
    number: int,
    at: np.ndarray,
    instants: int,
) -> None:
    """Write the quantities of a body of states at the indices `at` (T,) of the record."""
    # Not those of the points that a scene names, which no page shows.
    own = {name: quantities[name] for name in _OF_BODY if name in quantities}
    for name, values in quantity_columns(own, number):
        if (body, name) not in columns:
            columns[body, name] = np.full((instants, *values.shape[1:]), np.nan, values.dtype)
        columns[body, name][at] = values
    columns[body, 'position_sigma'] = np.sqrt(columns[body, 'position_covariance'][:, 0, 0])


def _add_reasons(
    columns: Columns, body: str, stamp: np.ndarray, diagnostics: DiagnosticsLog
) -> None:
    missing = ~np.isfinite(columns[body, 'position'])
    columns[body, 'missing'] = diagnostics.reasons(body, '', stamp, missing)
    for name in _WITHHELD:
        if (body, name) in columns:
            withheld = ~missing & ~np.isfinite(columns[body, name])
            columns[body, f'{name}_withheld'] = diagnostics.reasons(body, name, stamp, withheld)


def _add_pairs(
    columns: Columns, bodies: Mapping[str, str], found: _Messages, stamp: np.ndarray, plane: Plane
) -> None:
    """Add the relative centers that have topics, with the deviations of their coordinates."""
    for j, prefix in bodies.items():
        for i, other in bodies.items():
            topic = f'{prefix}/wrt/{other.rpartition("/")[2]}/icr'
            if topic not in found.rows or other.rpartition('/')[0] != prefix.rpartition('/')[0]:
                continue
            center = np.full(len(stamp), np.nan, complex)
            covariance = np.full((len(stamp), 2, 2), np.nan)
            stamps, rows = found.table(topic)
            _, at, own = np.intersect1d(stamp, stamps, return_indices=True)
            center[at] = plane.project(rows[own])[0]
            stamps, rows = found.table(f'{topic}/deviation')
            _, at, own = np.intersect1d(stamp, stamps, return_indices=True)
            if len(own):
                sigma = plane.project(rows[own])[0]
                covariance[at] = 0.0
                covariance[at, 0, 0], covariance[at, 1, 1] = sigma.real**2, sigma.imag**2
            columns[(j, i), 'icr'], columns[(j, i), 'icr_covariance'] = center, covariance


def _size(columns: Columns, body: str) -> float:
    """Return twice the root mean square distance of the markers from their mean, m."""
    position, angle = (columns[body, f'{name}_sigma'] for name in ('position', 'angle'))
    with np.errstate(divide='ignore', invalid='ignore'):
        # Marker noise moves the mean of the markers and turns them about it; the ratio is a length.
        size = 2 * np.median(position[position >= 0]) / np.median(angle[angle >= 0])
    return float(size) if np.isfinite(size) else float('nan')


def _outlines(
    record: MotionRecord, bodies: Mapping[str, str], found: _Messages, plane: Plane
) -> dict[str, list[tuple[int, np.ndarray]]]:
    """Return the markers (n,) in the frames of the bodies as they were drawn last."""
    outlines: dict[str, list[tuple[int, np.ndarray]]] = {body: [] for body in bodies}
    # A node that restarts defines new frames of its bodies; the last outlines are for the new ones.
    if found.diagnostics.restarted:
        return outlines
    names = {prefix: body for body, prefix in bodies.items()}
    for topic, arrays in found.drawings.items():
        for marker in (m for data in arrays for m in decode(_MARKER_ARRAY, data).markers):
            prefix, _, name = f'{topic.removesuffix(DRAWING)}{marker.ns}'.rpartition('/')
            if name != 'outline' or not marker.points or prefix not in names:
                continue
            body, stamp = names[prefix], stamp_to_ns(marker.header.stamp)
            # A recording may end between a drawing and its poses.
            at = np.flatnonzero(record.stamp == stamp)
            position, angle = (record.columns[body, key][at] for key in ('position', 'angle'))
            if np.isfinite(position).any():
                corners = np.array([_xyz(point) for point in marker.points[:-1]])
                own = (plane.project(corners)[0] - position) * np.exp(-1j * angle)
                outlines[body] = [(0, own)]
    return outlines


def read_truth(bag: str | Path, record: MotionRecord) -> dict[str, dict[str, Series]]:
    """
    Read the exact rates, poles and curvature of `kinpole simulate`, by body and quantity.

    There are none if the plane is oblique.
    """
    name = ''.join(record.along)
    plane = plane_of(name) if name in AXES else None
    if plane is None:
        return {}
    vectors = (*POLE_NAMES[:3], 'icr_velocity')
    numbers = (*RATE_NAMES[:3], 'centrode_curvature')
    names = {
        f'/kinpole/truth/{body}/{quantity}': (body, quantity)
        for body in record.bodies
        for quantity in (*numbers, *vectors)
    }
    rows: dict[str, list[tuple[int, list[float]]]] = defaultdict(list)
    for message in read_messages(bag, names):
        decoded = decode(message.type_name, message.data)
        row = stamp_to_ns(decoded.header.stamp), _ROWS[message.type_name](decoded)
        rows[message.topic].append(row)
    truth: dict[str, dict[str, Series]] = {body: {} for body in record.bodies}
    for topic, own in rows.items():
        body, quantity = names[topic]
        in_plane, along_normal = plane.project(np.array([row for _, row in own]))
        value = in_plane if quantity in vectors else along_normal
        stamp = np.array([stamp for stamp, _ in own], np.int64)
        truth[body][quantity] = Series(stamp, value, np.full(len(stamp), np.nan))
    return truth
