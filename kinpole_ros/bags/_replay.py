"""A bag of markers through the same tracker as the live node, to a bag or a table of results."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from kinpole_ros.bags._reader import BagError, Truncated, bag_files, read_messages, topics
from kinpole_ros.bags._table import CsvTable, ParquetTable
from kinpole_ros.bags._writer import BagWriter
from kinpole_ros.estimate import POLE_NAMES, Estimate
from kinpole_ros.messages import (
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    DiagnosticsMaker,
    MessageError,
    read_markers,
    result_outputs,
)
from kinpole_ros.parameters import Settings
from kinpole_ros.theory import load_theory
from kinpole_ros.tracker import Tracker

NODE_NAME = 'kinpole'
_SECOND = 1_000_000_000


class Replayed(NamedTuple):
    """
    What a replay came to: frames in, estimates out, and the share of these with each pole.

    `unreadable` counts messages that could not be read, `problem` is the first one's;
    `truncated` says where a damaged bag ended, None for a sound one. `repeated` and `resets` count
    stamps that came twice, and jumps. `noise` is that of a marker of each body at the end, per
    axis, m, NaN where it is not known; `first` and `last` are the stamps of these frames, ns.
    """

    frames: int
    estimates: int
    determined: dict[str, dict[str, float]]
    unreadable: int
    problem: str
    repeated: int
    resets: int
    truncated: Truncated | None
    noise: dict[str, float]
    first: int
    last: int


def replay(
    bag: str | Path,
    settings: Settings,
    output: str | Path | None = None,
    csv: str | Path | None = None,
    topic: str | None = None,
    progress: Callable[[float], None] | None = None,
    parquet: str | Path | None = None,
) -> Replayed:
    """
    Run the markers of a bag through the tracker, as fast as the machine goes.

    `bag` is an .mcap file or a rosbag2 folder; `topic` overrides the settings' marker topic.
    Results go to `output`, an .mcap under /kinpole/..., and to the tables `csv` and `parquet`.
    Deterministic: the bag's stamps drive everything. A bag that is cut off gives the results of
    all that is before the cut.
    Raises BagError when the bag, its topic or an output cannot be used.
    """
    name, kind = _marker_topic(bag, settings, topic)
    taken = {file.resolve(): 'the bag to be replayed' for file in bag_files(bag)}
    for target in (output, csv, parquet):
        if target is None:
            continue
        path = Path(target).resolve()
        if path in taken:
            raise BagError(f'{target} is {taken[path]}; name another file for the results')
        taken[path] = 'the bag of results' if target is output else 'the CSV table'
    theory = load_theory(settings)
    tracker = Tracker(settings)
    rows = [
        row
        for row in result_outputs(tuple(settings.bodies), settings.plane, theory)
        if row.order <= (settings.derivative_order or 4)
    ]
    order = settings.derivative_order or 4
    diagnostics = DiagnosticsMaker(NODE_NAME, theory)
    found = {body: dict.fromkeys(POLE_NAMES[:order], 0) for body in tracker.bodies}
    estimates = 0
    problem = ''
    trouble: dict[str, str] = {}
    told = first = last = 0
    latest: Estimate | None = None
    truncated: Truncated | None = None
    with ExitStack() as stack:
        writer = stack.enter_context(BagWriter(output)) if output is not None else None
        tables = [
            stack.enter_context(kind(target, settings))
            for kind, target in ((CsvTable, csv), (ParquetTable, parquet))
            if target is not None
        ]
        messages = read_messages(bag, [name], progress)
        while True:
            try:
                message = next(messages, None)
            except Truncated as error:
                truncated = error
                break
            if message is None:
                break
            try:
                frame = read_markers(_decoded(message.data, kind), settings.marker_identity)
            except MessageError as error:
                tracker.counts['unreadable'] += 1
                problem = problem or str(error)
                trouble['message'] = str(error)
                continue
            first, last = first or frame.stamp, frame.stamp
            for estimate in tracker.add(frame, order):
                latest = estimate
                estimates += 1
                _count(found, estimate)
                if writer is not None:
                    for row in rows:
                        result = row.build(estimate)
                        if result is not None:
                            topic_name = f'/{NODE_NAME}/{row.topic}'
                            writer.write(topic_name, result, message.log_time)
                for table in tables:
                    table.add(estimate)
            since = frame.stamp - told
            if writer is not None and (told == 0 or not 0 <= since < _SECOND):
                seconds = since / _SECOND if told else 0.0
                array = diagnostics.make(frame.stamp, tracker, latest, seconds, trouble)
                writer.write('/diagnostics', array, message.log_time)
                told = frame.stamp
                trouble = {}
        if writer is not None:
            # A topic that never had anything to say is still there to be asked for.
            for row in rows:
                writer.add_topic(f'/{NODE_NAME}/{row.topic}', row.message_type)
            writer.add_topic('/diagnostics', DiagnosticArray)
    counts = tracker.counts
    if counts['unreadable'] and not counts['frames']:
        raise BagError(f'{bag}: no message on {name} can be read: {problem}')
    share = {
        body: {pole: count / max(estimates, 1) for pole, count in poles.items()}
        for body, poles in found.items()
    }
    return Replayed(
        counts['frames'],
        estimates,
        share,
        counts['unreadable'],
        problem,
        counts['repeated'],
        counts['resets'],
        truncated,
        dict(zip(tracker.bodies, tracker.noise().tolist(), strict=True)),
        first,
        last,
    )


def _count(found: dict[str, dict[str, int]], estimate: Estimate) -> None:
    for k, poles in enumerate(found.values()):
        for order, pole in enumerate(poles, 1):
            poles[pole] += int(np.asarray(estimate.pole(order).determined)[k])


def _decoded(data: bytes, kind: str) -> Any:
    try:
        return deserialize_message(data, MARKER_TYPES[kind])
    except Exception as error:  # rclpy raises what its middleware makes of it
        raise MessageError(
            f'{len(data)} bytes are no {ROS_TYPE_NAMES[kind]} '
            f'({str(error).splitlines()[0]}); see that the bag is not damaged'
        ) from None


def _marker_topic(bag: str | Path, settings: Settings, topic: str | None) -> tuple[str, str]:
    """The topic's full name and the short name of its type."""
    name = topic or settings.marker_topic
    if name.startswith('~/'):
        name = f'/{NODE_NAME}/{name[2:]}'
    elif not name.startswith('/'):
        name = f'/{name}'
    there = topics(bag)
    if name not in there:
        listed = ', '.join(f'{t} ({kind})' for t, kind in sorted(there.items())) or 'no topics'
        raise BagError(f'{bag}: no topic {name}; it holds {listed}; name one with --topic')
    kinds = {ros: kind for kind, ros in ROS_TYPE_NAMES.items()}
    kind = kinds.get(there[name])
    if kind is None:
        raise BagError(
            f'{bag}: topic {name} is {there[name]}; markers must be one of {", ".join(kinds)}; '
            'name another with --topic'
        )
    if settings.marker_type not in ('auto', kind):
        raise BagError(
            f'{bag}: topic {name} is {there[name]}, but the parameter marker_type is '
            f'{settings.marker_type}; set it to {kind} or auto'
        )
    return name, kind
