"""
Bags: of ROS 1, of rosbag2, and of message types that the tracker does not read itself.

Markers and poses are found in messages by the definitions in the bag, so that the packages of the
types need not be installed. Frames are put together from several topics by their stamps.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import MCAP0_MAGIC

from kinpole_ros.bags._channels import BagMessage
from kinpole_ros.bags._files import ROS1_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC, BagError, Truncated
from kinpole_ros.bags._frames import read_frames
from kinpole_ros.bags._reader import described, read_messages
from kinpole_ros.bags._ros1 import Ros1Message, ros1_messages
from kinpole_ros.bags.formats._file import File, Format, Points, Wanted
from kinpole_ros.bags.formats._sheet import check_cells, check_names, number_names, shown
from kinpole_ros.messages import (
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    MessageError,
    fields,
    message_class,
    octets,
    read_markers,
)

_SECOND = 1_000_000_000  # ns
_SAME_FRAME = 0.25  # share of the interval of a topic within which stamps are of one frame
# Names of types by what they hold: a list of markers or bodies, a body, frames that bodies may be.
_KINDS = {
    **dict.fromkeys(('Markers', 'RigidBodies', 'NamedPoseArray'), 'tracker'),
    **dict.fromkeys(('PoseStamped', 'PoseWithCovarianceStamped', 'TransformStamped'), 'pose'),
    **dict.fromkeys(('TFMessage', 'tfMessage'), 'tf'),
}
_MARKERS = {name.replace('/msg/', '/'): key for key, name in ROS_TYPE_NAMES.items()}
_IN_MM = ('vicon_bridge/Markers',)  # by no convention of ROS
# Those that bags of before ROS 2 Iron do not define.
_MARKER = 'int8 id_type\nint32 marker_index\nstring marker_name\ngeometry_msgs/Point translation\n'
_BODY = 'string rigid_body_name\n{0}/Marker[] markers\ngeometry_msgs/Pose pose\n'
_HEAD = 'std_msgs/Header header\nuint32 frame_number\n'
_MESSAGES = {
    **{
        f'{package}/{name}': text.format(package)
        for package in ('mocap4r2_msgs', 'mocap_msgs')
        for name, text in (
            ('Marker', _MARKER),
            ('Markers', _HEAD + '{0}/Marker[] markers\n'),
            ('RigidBody', _BODY),
            ('RigidBodies', _HEAD + '{0}/RigidBody[] rigidbodies\n'),
        )
    },
    'motion_capture_tracking_interfaces/NamedPose': 'string name\ngeometry_msgs/Pose pose\n',
    'motion_capture_tracking_interfaces/NamedPoseArray': 'std_msgs/Header header\n'
    'motion_capture_tracking_interfaces/NamedPose[] poses\n',
}


class _Seen(NamedTuple):
    """Markers or poses in T messages of one layout, of one source."""

    source: str  # topic, or body
    stamps: np.ndarray  # (T,), ns
    log_times: np.ndarray
    names: tuple[str, ...]
    points: np.ndarray  # (T, n, 3)
    turns: np.ndarray | None = None  # (T, n, 4), quaternions x, y, z, w


def _recognizes(file: File) -> bool:
    if file.is_folder:
        files = (file.path.glob(ending) for ending in ('metadata.yaml', '*.mcap*', '*.db3'))
        return any(map(any, files))
    magics = MCAP0_MAGIC, SQLITE_MAGIC, ROS1_MAGIC, ZSTD_MAGIC
    return file.head.startswith(magics)


def _read(file: File, wanted: Wanted) -> Points:
    seen: list[_Seen] = []
    size = 0
    for part in _of_ros1(file) if file.head.startswith(ROS1_MAGIC) else _of_ros2(file):
        seen.append(part)
        size += part.points.size + 20
        check_cells(file.path, size)
    if not seen:
        raise BagError(f'{file.path} has no messages that can be read; fix: record again')
    if not any(part.stamps.any() for part in seen):
        file.notes.append(f'{file.path} has no stamps in its messages: log times are taken')
        seen = [part._replace(stamps=part.log_times) for part in seen]
    stamps, rows = _frames(seen)
    markers, bodies = (_columns(seen, posed) for posed in (False, True))
    names = list(markers or bodies)
    check_names(file.path, names)
    check_cells(file.path, len(stamps) * (3 * len(names) + 7 * len(bodies)))
    points = np.full((len(stamps), len(names), 3), np.nan)
    poses = np.full((len(stamps), len(bodies), 7), np.nan)
    for part, row in zip(seen, rows, strict=True):
        if part.turns is None or not markers:
            columns = [(markers or bodies)[name] for name in part.names]
            points[row[:, None], columns] = part.points
        if part.turns is not None:
            columns = [bodies[name] for name in part.names]
            poses[row[:, None], columns] = np.concatenate((part.points, part.turns), axis=-1)
    points[~np.isfinite(points).all(axis=-1)] = np.nan
    poses[~(np.isfinite(poses).all(axis=-1) & poses[..., 3:].any(axis=-1))] = np.nan
    return Points(
        names,
        points,
        np.arange(len(stamps)),
        None if wanted.rate is not None else stamps / _SECOND,
        'm',
        stamps=stamps,
        bodies=list(bodies),
        poses=poses if bodies else None,
    )


def _columns(seen: list[_Seen], posed: bool) -> dict[str, int]:
    """The column of each marker, or of each body with a pose."""
    parts = (part.names for part in seen if (part.turns is not None) == posed)
    names = dict.fromkeys(name for part in dict.fromkeys(parts) for name in part)
    return {name: column for column, name in enumerate(names)}


def _frames(seen: list[_Seen]) -> tuple[np.ndarray, list[np.ndarray]]:
    """
    Stamps of frames, and the frame of each message of each part.

    A frame has one message of each source, none later than a share of the shortest interval.
    """
    stamps = np.concatenate([part.stamps for part in seen])
    sources = list(dict.fromkeys(part.source for part in seen))
    if len(sources) == 1:
        found, rows = np.unique(stamps, return_inverse=True)
    else:
        number = np.repeat([sources.index(p.source) for p in seen], [len(p.stamps) for p in seen])
        steps = [np.diff(np.unique(stamps[number == k])) for k in range(len(sources))]
        most = _SAME_FRAME * min((float(np.median(step)) for step in steps if len(step)), default=0)
        starts: list[int] = []
        rows = np.empty(len(stamps), np.intp)
        members: set[int] = set()
        for event in np.argsort(stamps, kind='stable').tolist():
            late = int(stamps[event]) - starts[-1] if starts else 0
            if not starts or late > most or (late and int(number[event]) in members):
                starts.append(int(stamps[event]))
                members.clear()
            members.add(int(number[event]))
            rows[event] = len(starts) - 1
        found = np.array(starts, np.int64)
    return found, np.split(rows, np.cumsum([len(part.stamps) for part in seen])[:-1])


def _kind(type_name: str) -> str | None:
    """What messages of a type hold, None where that is nothing for us."""
    short = _short(type_name)
    if short in _MARKERS:
        return 'markers'
    return None if short in _IN_MM else _KINDS.get(short.rpartition('/')[2])


def _short(type_name: str) -> str:
    """Package and name of a type, without what stands between them in ROS 2."""
    return f'{type_name.partition("/")[0]}/{type_name.rpartition("/")[2]}'


def _chosen(file: File, types: dict[str, str]) -> list[str]:
    """
    The topics to be read: those of trackers, else the one of markers, else those of poses.

    Notes what is left out, and raises BagError where there is nothing or no telling.
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
            others = [topic for rest in kinds.values() for topic in rest]
            if others:
                more = ', '.join(others[:5])
                file.notes.append(f'{", ".join(topics[:5])} was read, and {more} was not')
            return topics
    listed = ', '.join(f'{topic} ({kind})' for topic, kind in sorted(types.items())[:10])
    raise BagError(
        f'{file.path} has no topic of markers or poses, only {listed or "none"}; fix: record one'
    )


def _store(types: set[str], definitions: dict[str, str], is_ros1: bool) -> Any:
    """A store of message types, as defined in the bag, or else as known here."""
    # Only bags need it.
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    known: dict[str, Any] = {}
    if not is_ros1:
        known |= get_typestore(Stores.ROS2_JAZZY).fielddefs
        for name, text in _MESSAGES.items():
            known |= get_types_from_msg(text, name)
    for name in types:
        text = definitions.get(name, '')
        if text.lstrip('=\n ').startswith('IDL: '):
            for part in text.split('=' * 80 + '\n')[1:]:
                known |= get_types_from_idl(part.partition('\n')[2])
        elif text.strip():
            known |= get_types_from_msg(text, name)
    store = get_typestore(Stores.EMPTY)
    store.register(known)
    return store


def _of_ros2(file: File) -> Iterator[_Seen]:
    types, definitions = described(file.path)
    topics = _chosen(file, types)
    if _kind(types[topics[0]]) == 'markers':
        parts, _ = read_frames(file.path, topics[0], report=lambda e: file.notes.append(str(e)))
        for frames in parts:
            yield _Seen('', frames.stamps, frames.stamps, frames.identities, frames.points)
        return
    read = _reader(file, {types[topic] for topic in topics}, definitions, is_ros1=False)
    names = _topic_names(topics)
    try:
        for message in read_messages(file.path, topics):
            yield from read(message, message.type_name, names[message.topic])
    except Truncated as error:
        file.notes.append(str(error))


def _of_ros1(file: File) -> Iterator[_Seen]:
    types: dict[str, str] = {}
    definitions: dict[str, str] = {}
    problem = ''
    try:
        for message in ros1_messages(file.path):
            types[message.topic] = message.type_name
            definitions[message.type_name] = message.definition
    except BagError as error:
        if not types:
            raise
        problem = str(error)
    topics = _chosen(file, types)
    read = _reader(file, {types[topic] for topic in topics}, definitions, is_ros1=True)
    names = _topic_names(topics)
    try:
        for message in ros1_messages(file.path):
            if message.topic in topics:
                name = message.type_name.replace('/', '/msg/')
                yield from read(message, name, names[message.topic])
    except BagError as error:
        if str(error) != problem:
            raise
        file.notes.append(problem)


def _reader(
    file: File, types: set[str], definitions: dict[str, str], is_ros1: bool
) -> Callable[[BagMessage | Ros1Message, str, str], list[_Seen]]:
    """What finds markers or poses in a message of one of these types; it raises BagError."""

    def fail(what: str, error: Exception) -> BagError:
        why = shown(' '.join(str(error).split()))
        return BagError(f'{file.path}: {what} cannot be read ({why}); fix: record again')

    try:
        store = _store(types, definitions, is_ros1)
    except Exception as error:  # of the parser, and of names that are none
        raise fail(f'the definition of {shown(", ".join(types))}', error) from error
    decode = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr

    def read(message: BagMessage | Ros1Message, name: str, topic: str) -> list[_Seen]:
        try:
            return list(_parts(file, decode(message.data, name), name, topic, message.log_time))
        except Exception as error:  # of the reading of bytes, and where a type is defined otherwise
            raise fail(f'a message of {name}', error) from error

    return read


def _topic_names(topics: list[str]) -> dict[str, str]:
    """Short names of topics: what differs of /vrpn/arm/pose and /vrpn/rod/pose."""
    parts = {topic: topic.strip('/').split('/') for topic in topics}
    rows = list(parts.values())
    if len(rows) == 1:
        kept = [part for part in rows[0] if part not in ('pose', 'tf')] or rows[0]
        return {topics[0]: kept[-1]}
    first, last = 0, 0
    least = min(map(len, rows)) - 1
    while first < least and len({row[first] for row in rows}) == 1:
        first += 1
    while last < least - first and len({row[-1 - last] for row in rows}) == 1:
        last += 1
    return {topic: '/'.join(row[first : len(row) - last]) for topic, row in parts.items()}


def _parts(file: File, message: Any, type_name: str, topic: str, log_time: int) -> Iterator[_Seen]:
    """Markers or poses in a decoded message."""
    times, kind = np.array([log_time]), _kind(type_name)
    if kind == 'markers':
        with suppress(MessageError):
            cls = MARKER_TYPES[_MARKERS[_short(type_name)]]
            frames = read_markers(_converted(message, cls))
            yield _Seen('', frames.stamps, times, frames.identities, frames.points)
        return
    items = [message]
    if kind != 'pose':
        items = next(value for value in vars(message).values() if isinstance(value, list))
    # The bodies of a tracker are of one instant, others each of its own.
    for group in [items][: len(items)] if kind == 'tracker' else [[item] for item in items]:
        stamp = (group[0] if kind == 'tf' else message).header.stamp
        stamps = np.array([stamp.sec * _SECOND + stamp.nanosec])
        if not 0 <= stamps[0] < 2**31 * _SECOND:
            continue
        notes: list[str] = []
        names = [topic if kind == 'pose' else _name(one, k) for k, one in enumerate(group)]
        names = number_names(file.path, names, notes)
        file.notes += [note for note in notes if note not in file.notes]
        values = np.array([[_place(one) for one in group]], float)
        turns = values[..., 3:] if values.shape[-1] == 7 else None
        source = topic if kind == 'tracker' else names[0]
        yield _Seen(source, stamps, times, tuple(names), values[..., :3], turns)


def _name(item: Any, index: int) -> str:
    """The name that a marker or body says, else its number, else its place."""
    values = {k: value for k, value in vars(item).items() if not k.startswith('__')}
    if values.get('id_type') == 1:  # of mocap4r2: the number is meant
        return str(item.marker_index)
    named = (value for value in values.values() if isinstance(value, str) and value)
    numbers = (str(value) for k, value in values.items() if k in ('marker_index', 'id'))
    return next(named, next(numbers, str(index)))


def _place(item: Any) -> list[float]:
    """The point of a marker, or the point and quaternion of a body."""
    if hasattr(item, 'translation') and not hasattr(item, 'rotation'):
        return [item.translation.x, item.translation.y, item.translation.z]
    pose = getattr(item, 'pose', None) or item.transform
    pose = getattr(pose, 'pose', pose)
    point = getattr(pose, 'position', None) or pose.translation
    turn = getattr(pose, 'orientation', None) or pose.rotation
    return [point.x, point.y, point.z, turn.x, turn.y, turn.z, turn.w]


def _converted(message: Any, cls: type) -> Any:
    """The message in a class of ours, field by field; the fields that it lacks have defaults."""
    values = {}
    for name, kind in fields(cls).items():
        value = getattr(message, name, None)
        if value is None:
            continue
        base = kind.partition('[')[0]
        if '/' in base:
            convert = partial(_converted, cls=message_class(base))
            value = [convert(one) for one in value] if '[' in kind else convert(value)
        elif kind == 'uint8[]':
            value = octets(bytes(value))
        values[name] = value
    return cls(**values)


FORMAT = Format(
    'bag',
    'bags of ROS 1 (.bag) and rosbag2 (.db3, .mcap), of markers, poses or the types of trackers',
    '(binary)',
    _recognizes,
    _read,
)
