"""
Bags: of ROS 1, of rosbag2, and of message types that the tracker does not read itself.

Markers and poses are found in messages by the definitions in the bag, so that the packages of the
types need not be installed. Frames are assembled from several topics by their stamps.
"""

from array import array
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros import messages
from kinpole_ros.bags._bag_reader import read_messages, types_and_definitions
from kinpole_ros.bags._channels import BagMessage
from kinpole_ros.bags._files import (
    MCAP_MAGIC,
    ROS1_MAGIC,
    SQLITE_MAGIC,
    ZSTD_MAGIC,
    BagError,
    Truncated,
)
from kinpole_ros.bags._marker_frames import film_fix, read_frames
from kinpole_ros.bags._storages import ros1_messages, ros1_topics
from kinpole_ros.bags.formats import _series
from kinpole_ros.bags.formats._cells import check_cells, check_names, number_names, shown
from kinpole_ros.bags.formats._file import File, Format, Options, Points
from kinpole_ros.bags.formats._tf_series import Links, multiplied_out

_SECOND = 1_000_000_000  # ns
_LARGEST_MESSAGE = 1 << 22  # bytes; as objects these take 20 times as much
# Kinds of types by name: a list of markers or bodies, one body, or frames of bodies.
_KINDS = {
    **dict.fromkeys(('Markers', 'RigidBodies', 'NamedPoseArray'), 'tracker'),
    **dict.fromkeys(('PoseStamped', 'PoseWithCovarianceStamped', 'TransformStamped'), 'pose'),
    **dict.fromkeys(('TFMessage', 'tfMessage'), 'tf'),
}
_MARKERS = {
    messages.ROS_TYPE_NAMES[kind].replace('/msg/', '/'): kind for kind in messages.MARKER_TYPES
}
_IN_MM = ('vicon_bridge/Markers',)  # by no convention of ROS
# Those that bags of before ROS 2 Iron do not define.
_MESSAGES = {
    'mocap4r2_msgs/Marker': 'int8 id_type\nint32 marker_index\nstring marker_name\n'
    'geometry_msgs/Point translation\n',
    'mocap4r2_msgs/Markers': 'std_msgs/Header header\nuint32 frame_number\nMarker[] markers\n',
    'mocap4r2_msgs/RigidBody': 'string rigid_body_name\nMarker[] markers\n'
    'geometry_msgs/Pose pose\n',
    'mocap4r2_msgs/RigidBodies': 'std_msgs/Header header\nuint32 frame_number\n'
    'RigidBody[] rigidbodies\n',
    'motion_capture_tracking_interfaces/NamedPose': 'string name\ngeometry_msgs/Pose pose\n',
    'motion_capture_tracking_interfaces/NamedPoseArray': 'std_msgs/Header header\n'
    'NamedPose[] poses\n',
}


class _Observation(NamedTuple):
    """Markers or poses of one source in a message."""

    source: str  # topic, or body
    names: tuple[str, ...]
    stamp: int  # ns
    values: list[float]  # 3 for each marker, or 7 for each body


def _recognizes(file: File) -> bool:
    if file.is_folder:
        files = (file.path.glob(ending) for ending in ('metadata.yaml', '*.mcap*', '*.db3*'))
        return any(map(any, files))
    magics = MCAP_MAGIC, SQLITE_MAGIC, ROS1_MAGIC, ZSTD_MAGIC
    return file.head.startswith(magics)


def _read(file: File, options: Options) -> Points:
    is_ros1 = file.head.startswith(ROS1_MAGIC)
    types, definitions = (ros1_topics if is_ros1 else types_and_definitions)(file.path)
    topics = _choose_topics(file, types)
    if not is_ros1 and _kind(types[topics[0]]) == 'markers':
        frames, _ = read_frames(file.path, topics[0], report=lambda e: file.notes.append(str(e)))
        # Without stamps the order says nothing: the log times are the stamps then.
        count, has_stamps = 0, any(one.stamps.any() for one in frames)
        series = []
        for one in frames:
            order = np.arange(count, count + len(one.stamps)) if has_stamps else one.stamps
            series.append(_series.MessageSeries('', one.identities, one.stamps, order, one.points))
            count += len(one.stamps)
    else:
        links = Links({}, set())
        series = _read_series(
            file, topics, _make_decoder(file, types, topics, definitions, is_ros1), links
        )
        series = multiplied_out(file, series, links)
    if not any(part.stamps.any() for part in series):
        file.notes.append(f'{file.path} has no stamps in its messages: log times are taken')
        series = [part._replace(stamps=part.log_times) for part in series]
    series = _series.without_repeats(file, _series.first_pass(file, series))
    _series.check_clocks(file, series)
    stamps, rows = _series.group_into_frames(series)
    markers, bodies = (_series.number_columns(series, width) for width in (3, 7))
    names = list(markers or bodies)
    check_names(file.path, names)
    check_cells(file.path, len(stamps) * (3 * len(names) + 7 * len(bodies)))
    points = np.full((len(stamps), len(names), 3), np.nan)
    poses = np.full((len(stamps), len(bodies), 7), np.nan)
    for part, row in zip(series, rows, strict=True):
        if not markers or part.values.shape[-1] == 3:
            columns = [(markers or bodies)[name] for name in part.names]
            points[row[:, None], columns] = part.values[..., :3]
        if part.values.shape[-1] == 7:
            poses[row[:, None], [bodies[name] for name in part.names]] = part.values
    points[~np.isfinite(points).all(axis=-1)] = np.nan
    poses[~(np.isfinite(poses).all(axis=-1) & poses[..., 3:].any(axis=-1))] = np.nan
    return Points(
        names,
        points,
        np.arange(len(stamps)),
        None if options.rate is not None else stamps / _SECOND,
        'm',
        stamps=stamps,
        bodies=list(bodies),
        poses=poses if bodies else None,
    )


def _kind(type_name: str) -> str | None:
    """Return what messages of a type hold, None where that is neither markers nor poses."""
    short = _short_type(type_name)
    if short in _MARKERS:
        return 'markers'
    return None if short in _IN_MM else _KINDS.get(short.rpartition('/')[2])


def _short_type(type_name: str) -> str:
    """Return package and name of a type, without the msg between them of ROS 2."""
    return f'{type_name.partition("/")[0]}/{type_name.rpartition("/")[2]}'


def _choose_topics(file: File, types: dict[str, str]) -> list[str]:
    """
    Choose the topics to read: those of trackers, else the one of markers, else those of poses.

    Notes what is left out; raises BagError where there is nothing, or several topics of markers.
    """
    kinds: dict[str, list[str]] = {}
    for topic, name in sorted(types.items()):
        if kind := _kind(name):
            kinds.setdefault(kind, []).append(topic)
    for kind in ('tracker', 'markers', 'pose', 'tf'):
        topics = kinds.pop(kind, [])
        if kind == 'markers' and '/markers' in topics:
            topics = ['/markers']
        if kind == 'markers' and len(topics) > 1:
            raise BagError(
                f'{file.path} has several topics of markers, {", ".join(topics[:5])}; fix: call '
                'one /markers, or give the bag to replay or discover with --topic'
            )
        if topics:
            unread = [topic for names in kinds.values() for topic in names]
            if unread:
                file.notes.append(
                    f'{", ".join(topics[:5])} was read, and {", ".join(unread[:5])} was not'
                )
            return topics
    listed = ', '.join(f'{topic} ({kind})' for topic, kind in sorted(types.items())[:10])
    raise BagError(
        f'{file.path} has no topic of markers or poses, only {listed or "none"}; fix: '
        f'{film_fix(file.path, types) or "record one"}'
    )


def _make_store(types: set[str], definitions: dict[str, str], is_ros1: bool) -> Any:
    """Make a store of message types as the bag defines them, or else as known here."""
    # Only bags need it.
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    types_by_name: dict[str, Any] = {}
    if not is_ros1:
        types_by_name |= get_typestore(Stores.ROS2_JAZZY).fielddefs
        for name, text in _MESSAGES.items():
            types_by_name |= get_types_from_msg(text, name)
    for name in types:
        text = definitions.get(name, '')
        if text.lstrip('=\n ').startswith('IDL: '):
            for part in text.split('=' * 80 + '\n')[1:]:
                types_by_name |= get_types_from_idl(part.partition('\n')[2])
        elif text.strip():
            types_by_name |= get_types_from_msg(text, name)
    store = get_typestore(Stores.EMPTY)
    store.register(types_by_name)
    return store


def _make_decoder(
    file: File,
    types: dict[str, str],
    topics: list[str],
    definitions: dict[str, str],
    is_ros1: bool,
) -> Callable[[BagMessage], Any]:
    """Return a function that decodes the messages on these topics."""
    names = {types[topic] for topic in topics}
    try:
        store = _make_store(names, definitions, is_ros1)
    except Exception as error:  # of the parser, and of names that are none
        raise BagError(
            f'{file.path}: the definition of {shown(", ".join(sorted(names)))} cannot be read '
            f'({shown(" ".join(str(error).split()))}); fix: record again'
        ) from error
    deserialize = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr
    return lambda one: deserialize(one.data, one.type_name)


def _read_series(
    file: File, topics: list[str], decode: Callable[[BagMessage], Any], links: Links
) -> list[_series.MessageSeries]:
    """
    Read the messages of these topics; those that cannot be read are left out, and noted.

    Adds the frames on /tf to `links`.
    """
    names = _shorten_topics(topics)
    columns: dict[tuple[Any, ...], tuple[array[int], array[int], array[float]]] = {}
    fault, fault_count, size = '', 0, 0
    read = ros1_messages if file.head.startswith(ROS1_MAGIC) else read_messages
    try:
        for message in read(file.path, topics):
            try:
                if len(message.data) > _LARGEST_MESSAGE:
                    raise ValueError(f'{len(message.data)} bytes')
                content = decode(message)
                observations = list(_observations(file, content, message, names[message.topic]))
                if _kind(message.type_name) == 'tf':
                    links.add(content.transforms, message.topic)
            except Exception as error:  # of the bytes, and where a type is not as its name says
                fault_count += 1
                reason = shown(' '.join(str(error).split()))
                fault = fault or f'{shown(message.type_name)} ({reason})'
                continue
            for source, markers, stamp, values in observations:
                key = source, markers, len(values) // len(markers)
                rows = columns.setdefault(key, (array('q'), array('q'), array('d')))
                rows[0].append(stamp)
                rows[1].append(message.log_time)
                rows[2].extend(values)
                size += len(values) + 2
            check_cells(file.path, size)
    except Truncated as error:
        file.notes.append(str(error))
    left_out = f'{fault_count} messages cannot be read, the first of {fault}'
    if not columns:
        reason = left_out if fault else 'the topics are empty'
        raise BagError(f'{file.path} has no markers or poses: {reason}; fix: record again')
    if fault:
        file.notes.append(f'{file.path}: {left_out}')
    return [
        _series.MessageSeries(
            source,
            markers,
            np.frombuffer(stamps, np.int64),
            np.frombuffer(log_times, np.int64),
            np.frombuffer(values).reshape(len(stamps), len(markers), width),
        )
        for (source, markers, width), (stamps, log_times, values) in columns.items()
    ]


def _shorten_topics(topics: list[str]) -> dict[str, str]:
    """Shorten topics to the part that differs: arm and rod of /vrpn/arm/pose and /vrpn/rod/pose."""
    names = {topic: topic.strip('/').split('/') for topic in topics}
    rows = list(names.values())
    if len(rows) == 1:
        specific = [name for name in rows[0] if name not in ('pose', 'tf')] or rows[0]
        return {topics[0]: specific[-1]}
    first, last = 0, 0
    least = min(map(len, rows)) - 1
    while first < least and len({row[first] for row in rows}) == 1:
        first += 1
    while last < least - first and len({row[-1 - last] for row in rows}) == 1:
        last += 1
    return {topic: '/'.join(row[first : len(row) - last]) for topic, row in names.items()}


def _observations(
    file: File, content: Any, message: BagMessage, topic: str
) -> Iterator[_Observation]:
    """Yield the markers or poses in the decoded content of a message."""
    kind = _kind(message.type_name)
    if kind == 'markers':
        own = _MARKERS[_short_type(message.type_name)]
        reader = messages.MarkerReader(own)
        converted = _convert(content, messages.MARKER_TYPES[own])
        (frames,) = reader.read([messages.serialize_message(converted)])
        if not isinstance(frames, messages.MessageError) and frames.identities:
            stamp, values = int(frames.stamps[0]), frames.points.ravel().tolist()
            yield _Observation('', frames.identities, stamp, values)
        if fault := reader.fault():
            note = f'{file.path}: {fault.words()}'
            file.notes += [note] if note not in file.notes else []
        return
    items = [content]
    if kind != 'pose':
        items = next(value for value in vars(content).values() if isinstance(value, list))
    # The bodies of a tracker are of one instant, others each of its own.
    for group in [items][: len(items)] if kind == 'tracker' else [[item] for item in items]:
        stamp = (group[0] if kind == 'tf' else content).header.stamp
        nanoseconds = int(stamp.sec) * _SECOND + int(stamp.nanosec)
        if not 0 <= nanoseconds < 2**31 * _SECOND:
            raise messages.MessageError(f'its stamp is {stamp.sec} s')
        notes: list[str] = []
        names = [topic if kind == 'pose' else _name(one, k) for k, one in enumerate(group)]
        names = number_names(file.path, names, notes)
        file.notes += [note for note in notes if note not in file.notes]
        values = [float(number) for one in group for number in _coordinates(one)]
        yield _Observation(
            topic if kind == 'tracker' else names[0], tuple(names), nanoseconds, values
        )


def _name(item: Any, index: int) -> str:
    """Return the name in the message of a marker or body, else its number, else its place."""
    values = {k: value for k, value in vars(item).items() if not k.startswith('__')}
    if values.get('id_type') == 1:  # of mocap4r2: the number is meant
        return str(item.marker_index)
    named = (value for value in values.values() if isinstance(value, str) and value)
    numbers = (str(value) for k, value in values.items() if k in ('marker_index', 'id'))
    return next(named, next(numbers, str(index)))


def _coordinates(item: Any) -> list[float]:
    """Return the point of a marker, or the point and quaternion of a body."""
    if hasattr(item, 'translation') and not hasattr(item, 'rotation'):
        return [item.translation.x, item.translation.y, item.translation.z]
    pose = getattr(item, 'pose', None) or item.transform
    pose = getattr(pose, 'pose', pose)
    point = getattr(pose, 'position', None) or pose.translation
    turn = getattr(pose, 'orientation', None) or pose.rotation
    return [point.x, point.y, point.z, turn.x, turn.y, turn.z, turn.w]


def _convert(message: Any, cls: type) -> Any:
    """Convert a message to a class of ours; the fields that it lacks have defaults."""
    values = {}
    for name, kind in messages.fields(cls).items():
        value = getattr(message, name, None)
        if value is None:
            continue
        base = kind.partition('[')[0]
        if '/' in base:
            convert = partial(_convert, cls=messages.message_class(base))
            value = [convert(one) for one in value] if '[' in kind else convert(value)
        elif kind == 'uint8[]':
            value = np.frombuffer(bytes(value), np.uint8)
        values[name] = value
    return cls(**values)


BAG = Format(
    'bag',
    'bags of ROS 1 (.bag) and rosbag2 (.db3, .mcap), of markers, poses or the types of trackers',
    '(binary)',
    _recognizes,
    _read,
)
