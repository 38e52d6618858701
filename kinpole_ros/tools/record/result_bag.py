"""
The record of a bag of results, from a replay or recorded live.

The topic `rig` says what the rows of the topic `state` are: the bodies, the plane, sizes and
outlines. Relative centers and events have topics of their own.
"""

import shlex
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kinpole_ros.bags import BagError, Truncated, message_class, read_messages, topics
from kinpole_ros.messages import (
    DRAWING,
    RIG,
    STATE,
    PointCloud2,
    StateBlock,
    String,
    deserialize_message,
    plane_of_rig,
    read_event,
    read_rig,
    read_state_blocks,
    stamp_to_ns,
    type_name,
    warnings_in,
)
from kinpole_ros.tools.record.lost import lost_count
from kinpole_ros.tools.record.record import Columns, MotionRecord, Series
from kinpole_ros.tracking.plane import AXES, plane_axes, plane_of
from kinpole_ros.tracking.quantities import withheld_quantities
from kinpole_ros.tracking.reasons import KNOWN, texts_of
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES, known_arrays, quantity_names

# Files with these endings are bags, even if they cannot be read.
_BAG_ENDINGS = ('.mcap', '.db3', '.bag')
_DIAGNOSTICS = '/diagnostics'
_OF_BODY = ('position', 'angle', 'velocity', *quantity_names(4))
# What columns hold at instants of which a node says nothing, where that is not NaN or ''.
_EMPTY = {'missing': 'not published'}
_MOST_NOTES = 20  # warnings of diagnostics, whose numbers differ from second to second


@dataclass
class _Run:
    """What a node published from a start on: what it said of itself last, and its states."""

    rig: dict[str, Any]
    states: list[bytes] = field(default_factory=list)

    @property
    def bodies(self) -> list[str]:
        """The bodies in the order of the rows."""
        return [body['name'] for body in self.rig['bodies']]

    def is_of(self, rig: Mapping[str, Any]) -> bool:
        """Whether a later message is of this run."""
        keys = 'run', 'frame_id', 'plane'
        names = [body['name'] for body in rig['bodies']]
        known = all(self.rig[key] in (None, '', rig[key]) for key in keys)
        return known and names == self.bodies


@dataclass
class _Messages:
    """What a bag holds, by node and by topic; of two rows with one stamp the last counts."""

    runs: dict[str, list[_Run]] = field(default_factory=lambda: defaultdict(list))
    rows: dict[str, dict[int, list[float]]] = field(default_factory=lambda: defaultdict(dict))
    warnings: dict[str, None] = field(default_factory=dict)
    cut: str = ''

    def add(self, topic: str, kind: str, data: bytes, early: dict[str, list[bytes]]) -> None:
        """Append a message; `early` are states that came before their node said what they are."""
        node, _, name = topic.rpartition('/')
        if topic == _DIAGNOSTICS:
            self.warnings |= dict.fromkeys(warnings_in(decode(kind, data).status))
        elif name == RIG:
            rig, runs = read_rig(data), self.runs[node]
            if runs and runs[-1].is_of(rig):
                runs[-1].rig = rig
            else:
                runs.append(_Run(rig, early.pop(node, [])))
        elif name == STATE and self.runs[node]:
            self.runs[node][-1].states.append(data)
        elif name == STATE:
            early[node].append(data)
        elif name == 'event':
            stamp, numbers = read_event(data)
            self.rows[topic][stamp] = [numbers['order']]
        else:
            decoded = decode(kind, data)
            self.rows[topic][stamp_to_ns(decoded.header.stamp)] = _ROWS[kind](decoded)

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
    return bool(result_nodes(topics(bag)))


def result_nodes(kinds: Mapping[str, str]) -> list[str]:
    """Return the nodes with a topic `state`, from the topics of a bag."""
    nodes = [
        topic.removesuffix(f'/{STATE}')
        for topic, kind in kinds.items()
        if topic.endswith(f'/{STATE}') and kind == type_name(PointCloud2)
    ]
    return sorted(n for n in nodes if kinds.keys() & {f'{n}/{RIG}', f'{n}/{DRAWING}'})


def require_results(bag: str | Path) -> tuple[dict[str, str], list[str]]:
    """
    Return the types of the topics of a bag of results by name, and its nodes.

    Raises BagError where it holds no results, or such as this version does not read.
    """
    kinds = topics(bag)
    nodes = result_nodes(kinds)
    anew = 'kinpole replay {} --output RESULT.mcap'
    if not nodes:
        raise BagError(
            f'{bag} holds no results (no topic {STATE} of a node); make them first: '
            + anew.format(shlex.quote(str(bag)))
        )
    nodes = [node for node in nodes if kinds.get(f'{node}/{RIG}') == type_name(String)]
    if not nodes:
        raise BagError(
            f'{bag} holds results of an earlier version, or was recorded without the topic {RIG}; '
            f'make them anew from its markers: {anew.format("MARKERS.mcap")}'
        )
    return kinds, nodes


def read_record(bag: str | Path, progress: Callable[[float], None] | None = None) -> MotionRecord:
    """
    Read the results of a bag, without the exact motion of `kinpole simulate`.

    `progress` is called with the fraction of bytes read. Raises BagError if there are no results.
    """
    kinds, nodes = require_results(bag)
    found = _read(bag, kinds, nodes, progress)
    blocks: list[tuple[str, _Run, StateBlock]] = []
    for node in nodes:
        for run in found.runs[node]:
            try:
                blocks += [(node, run, block) for block in read_state_blocks(run.states)]
            except ValueError as error:
                raise BagError(f'{bag}: topic {node}/{STATE}: {error}') from None
    if not any(block.quantities['position'].determined.any() for _, _, block in blocks):
        raise BagError(
            f'{bag} holds no pose of {" or ".join(nodes)}; replay its markers with '
            'parameters that name the markers as they are published'
        )
    stamp = np.unique(np.concatenate([block.stamps for _, _, block in blocks]))
    names = {
        (node, body): f'{node}/{body}' if len(nodes) > 1 else body
        for node, run, _ in blocks
        for body in run.bodies
    }
    columns: Columns = {}
    record = MotionRecord(stamp, len(stamp), tuple(names.values()), columns, {}, {}, ('x', 'y'))
    for node, run, block in blocks:
        at = stamp.searchsorted(block.stamps)
        # Not the quantities of the points that a scene names, which no page shows.
        shown = {name: block.quantities[name] for name in _OF_BODY if name in block.quantities}
        arrays = known_arrays(shown) | _reason_arrays(block)
        for b, body in enumerate(run.bodies):
            _fill(columns, names[node, body], arrays, b, at, len(stamp))
    _add_pairs(columns, names, found, stamp)
    _add_outlines(record, names, blocks)
    events = {
        name: [
            (at, int(order)) for at, (order,) in found.rows.get(f'{node}/{body}/event', {}).items()
        ]
        for (node, body), name in names.items()
    }
    return record._replace(
        along=plane_axes(plane_of_rig(blocks[-1][1].rig)),
        events=events,
        lost=lost_count(stamp),
        notes=tuple(found.warnings)[:_MOST_NOTES],
        cut=found.cut,
    )


def _read(
    bag: str | Path,
    kinds: Mapping[str, str],
    nodes: list[str],
    progress: Callable[[float], None] | None,
) -> _Messages:
    wanted = {_DIAGNOSTICS, *(f'{node}/{name}' for node in nodes for name in (STATE, RIG))}
    for topic in kinds:
        is_of_node = topic.startswith(tuple(f'{node}/' for node in nodes))
        is_center = '/wrt/' in topic and topic.removesuffix('/deviation').endswith('/icr')
        if is_of_node and (is_center or topic.endswith('/event')):
            wanted.add(topic)
    found, early = _Messages(), defaultdict[str, list[bytes]](list)
    try:
        for message in read_messages(bag, wanted, progress):
            try:
                found.add(message.topic, message.type_name, message.data, early)
            except ValueError as error:
                raise BagError(f'{bag}: topic {message.topic}: {error}') from None
    except Truncated as error:
        found.cut = str(error)
    return found


def decode(type_name: str, data: bytes) -> Any:
    """Return a message of a bag as an object of its type."""
    return deserialize_message(data, message_class(type_name))


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


_ROWS: dict[str, Callable[[Any], list[float]]] = {
    'geometry_msgs/msg/PointStamped': lambda message: _xyz(message.point),
    'geometry_msgs/msg/Vector3Stamped': lambda message: _xyz(message.vector),
}


def _reason_arrays(block: StateBlock) -> dict[str, np.ndarray]:
    """Return why bodies have no pose, and why quantities of those that have are withheld."""
    missing = block.reasons['pose']
    arrays = {'missing': texts_of(missing)}
    for name in withheld_quantities(4).values():
        if name in block.reasons:
            withheld = np.where(missing == KNOWN, block.reasons[name], KNOWN)
            arrays[f'{name}_withheld'] = texts_of(withheld)
    return arrays


def _fill(
    columns: Columns,
    body: str,
    arrays: Mapping[str, np.ndarray],
    number: int,
    at: np.ndarray,
    instants: int,
) -> None:
    """Write the arrays (T, B, ...) of a body of states at the indices `at` (T,) of the record."""
    for name, values in arrays.items():
        if (body, name) not in columns:
            empty = _EMPTY.get(name, '' if values.dtype == object else np.nan)
            columns[body, name] = np.full((instants, *values.shape[2:]), empty, values.dtype)
        columns[body, name][at] = values[:, number]
    columns[body, 'position_sigma'] = np.sqrt(columns[body, 'position_covariance'][:, 0, 0])


def _add_pairs(
    columns: Columns, names: Mapping[tuple[str, str], str], found: _Messages, stamp: np.ndarray
) -> None:
    """Add the relative centers that have topics, with the deviations of their coordinates."""
    for node, runs in found.runs.items():
        plane = plane_of_rig(runs[-1].rig)
        for j, i in (pair for run in runs for pair in run.rig['pairs']):
            topic = f'{node}/{j}/wrt/{i}/icr'
            if topic not in found.rows or not {(node, j), (node, i)} <= names.keys():
                continue
            pair = names[node, j], names[node, i]
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
            columns[pair, 'icr'], columns[pair, 'icr_covariance'] = center, covariance


def _add_outlines(
    record: MotionRecord,
    names: Mapping[tuple[str, str], str],
    blocks: list[tuple[str, _Run, StateBlock]],
) -> None:
    """Add sizes, and the markers (n,) in the frames of the bodies from the start of each run on."""
    record.sizes.update(dict.fromkeys(record.bodies, float('nan')))
    record.outlines.update({body: [] for body in record.bodies})
    outlined: set[int] = set()
    for node, run, block in blocks:
        if id(run) in outlined:
            continue
        outlined.add(id(run))
        start = int(record.stamp.searchsorted(block.stamps.min()))
        for body in run.rig['bodies']:
            name = names[node, body['name']]
            if body['size'] is not None:
                record.sizes[name] = body['size']
                outline = np.array(body['outline']) @ [1, 1j]
                record.outlines[name].append((start, outline))


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
