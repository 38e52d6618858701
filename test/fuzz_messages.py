"""
Corrupted messages by the thousand: each is read as rclpy reads it, or refused in one line.

`python test/fuzz_messages.py [COUNT [SEED]]` runs as many as you like, 100,000 unless told; the
test suite runs some. Damage is done to bytes, to sizes where the message has them, to texts, by
putting parts of messages together, and to the fields of messages that are then serialized again:
such a message is sound, and may be refused only where `ordinary` refuses it. In the long run,
messages that took the reader where none did before are damaged further. That helps damage that
knows nothing of messages (2 to 8 lines more from 3,000); with all of it 100,000 reach the same.
"""

import random
import struct
import tempfile
from collections import Counter
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fuzzing import EXTREMES, Reached, damaged, fuzz, tell
from geometry_msgs.msg import Point, Pose
from rclpy.serialization import deserialize_message, serialize_message
from read_objects import ordinary
from sensor_msgs.msg import PointField
from std_msgs.msg import ColorRGBA
from test_marker_messages import one_by_one
from visualization_msgs.msg import Marker, MarkerArray, UVCoordinate

from kinpole_ros import messages as package
from kinpole_ros.messages import (
    MARKER_TYPES,
    ROS_TYPE_NAMES,
    MarkerReader,
    MessageError,
    installed_class,
    to_message,
)
from kinpole_ros.messages._offsets import MessageOffsets

# Those of markers known by their place, and of an array.
_IDENTITIES = ('auto', 'index', 'id'), ('auto', 'index', 'id', 'ns', 'ns_id')
# What refusals say that rclpy does not share: it goes on behind what is missing.
_MISSING = ('the sizes in them claim more', 'they do not start as plain CDR')
# A reader remembers what it has met; so many times it is used before another takes its place.
_USES = 1000
# Bytes of a message put together of others, which could grow and grow.
_LONGEST = 100_000


class Sample(NamedTuple):
    """A message of the type `kind` as bytes; `sound` when rclpy has written it."""

    kind: str
    data: bytes
    sound: bool = True


def fuzz_messages(
    count: int, seed: int = 0, folder: str | Path | None = None, reached: Reached | None = None
) -> Counter[str]:
    """
    Read `count` messages with damage that follows from `seed`; returns how many ended in which way.

    Padding differs from run to run, as rclpy leaves in it what it finds.
    Raises AssertionError, with the last one left in `folder`, for one that is read otherwise than
    `ordinary` does, that is refused in anything but one line, or that breaks a limit of
    `fuzz`, which also says what `reached` is for.
    """
    place = Path(folder or tempfile.mkdtemp(prefix='fuzz_messages_'))
    generator = random.Random(seed)
    readers: dict[tuple[str, str], tuple[MarkerReader, int]] = {}

    def ending(sample: Sample) -> str:
        kind, data = sample[:2]
        identity = generator.choice(_IDENTITIES[kind == 'marker_array'])
        reader, uses = readers.get((kind, identity), (None, 0))
        if reader is None or uses == _USES:
            reader, uses = MarkerReader(kind, identity), 0
        readers[kind, identity] = reader, uses + 1
        amid = generator.choice(_good(kind)).data
        try:
            found = one_by_one(reader.read([amid, data, data, amid]))
            assert len(found) == 4
            for one, other in zip(found, found[::-1], strict=True):
                _check_same(one, other)
            _check_same(found[0], ordinary(kind, amid, identity))
            return f'{kind} {_check(found[1], sample, identity)}'
        except BaseException:
            (place / f'{kind}_{identity}').write_bytes(data)
            raise

    seeds = [sample for kind in MARKER_TYPES for sample in _good(kind)]
    return fuzz(count, generator, place, seeds, _fuzzed, ending, reached)


def _check(found: Any, sample: Sample, identity: str) -> str:
    """Hold what a reader made of a message against rclpy's; returns what it is."""
    if isinstance(found, MessageError):
        text = str(found)
        assert text.isprintable()
        if not sample.sound and any(words in text for words in _MISSING):
            return 'refused for its sizes'
    _check_same(found, ordinary(*sample[:2], identity))
    return 'refused' if isinstance(found, MessageError) else 'read'


def _check_same(found: Any, expected: Any) -> None:
    assert isinstance(found, type(expected)), f'{found!r}, expected {expected!r}'
    if not isinstance(expected, MessageError):
        assert found.stamps.tolist() == expected.stamps.tolist()
        assert found[1:3] == expected[1:3]
        np.testing.assert_array_equal(found.points, expected.points, strict=True)


@cache
def _good(kind: str) -> list[Sample]:
    """Messages of one kind, of few markers and of some, with much in them and little."""
    rows = np.random.default_rng(0).normal(size=(4, 3))
    found = []
    for count in (0, 1, 4):
        names = ['a', 'x', 'é\n', ''][:count]
        made = to_message(kind, 10**18 + count, 'lab', names, rows[:count])
        message = _of_rclpy(kind, package.serialize_message(made))
        found.append(_sample(kind, message))
        for one in getattr(message, 'markers', [message] if kind == 'marker' else []):
            one.colors = [ColorRGBA(r=0.5)] * count
            one.uv_coordinates = [UVCoordinate(u=0.5)]
            one.text, one.mesh_resource, one.texture_resource = 'text', 'package://mesh', 't'
            one.texture.format, one.mesh_file.filename = 'png', 'mesh.stl'
            one.texture.data = one.mesh_file.data = b'123'
        found.append(_sample(kind, message))
    if kind == 'point_cloud2':
        message.fields += [PointField(name='id', offset=0, datatype=PointField.UINT32, count=1)]
        found.append(_sample(kind, message))
        for field in message.fields[:3]:
            field.datatype = PointField.FLOAT32
            field.offset = field.offset // 2 + 4
        message.height, message.width, message.row_step = 2, 2, 48
        found.append(_sample(kind, message))
        message.is_bigendian = True
        found.append(_sample(kind, message))
    return found


def _of_rclpy(kind: str, data: bytes) -> Any:
    return deserialize_message(data, installed_class(ROS_TYPE_NAMES[kind]))


def _sample(kind: str, message: Any) -> Sample:
    return Sample(kind, bytes(serialize_message(message)))


def _fuzzed(generator: random.Random, sample: Sample) -> Sample:
    for _ in range(generator.choice((1, 1, 1, 2, 4))):
        sample = generator.choice(_DAMAGE)(generator, sample)
    return sample


def _bytes(generator: random.Random, sample: Sample) -> Sample:
    return Sample(sample.kind, damaged(generator, sample.data), False)


def _sizes(generator: random.Random, sample: Sample) -> Sample:
    """Let a sequence or string claim another size."""
    try:
        at = generator.choice(MessageOffsets(sample.kind, sample.data).sizes)
    except MessageError:
        return _bytes(generator, sample)
    true = int.from_bytes(sample.data[at : at + 4], 'little')
    sizes = (true - 1, true + 1, true + 4, 2 * true, len(sample.data), 2**20, 2**28, *EXTREMES)
    claimed = struct.pack('<I', generator.choice(sizes) % 2**32)
    return Sample(sample.kind, sample.data[:at] + claimed + sample.data[at + 4 :], False)


def _texts(generator: random.Random, sample: Sample) -> Sample:
    """Put what is no text, or no whole one, in the place of a name."""
    name = generator.choice((b'lab\0', b'x\0', b'a\0', b'id\0', b'text\0', b'mesh'))
    other = generator.choice(
        (b'\xff' * 9, b'\xc3\xc3\xc3', b'\0' * 9, b'a' * 9, b'\xed\xa0', b'a\0')
    )
    places = [k for k in range(len(sample.data)) if sample.data.startswith(name, k)]
    if not places:
        return _bytes(generator, sample)
    at = generator.choice(places)
    data = sample.data[:at] + other[: len(name)] + sample.data[at + len(other[: len(name)]) :]
    return Sample(sample.kind, data, False)


def _spliced(generator: random.Random, sample: Sample) -> Sample:
    """Go on in the same message, or in another one, before or behind."""
    other = sample.data
    if generator.random() < 0.5:
        other = generator.choice(_good(generator.choice(list(MARKER_TYPES)))).data
    ends = (generator.randrange(len(data) // 4 + 1) * 4 for data in (sample.data, other))
    data = sample.data[: next(ends)] + other[next(ends) :]
    return Sample(sample.kind, data[:_LONGEST], False)


def _fields(generator: random.Random, sample: Sample) -> Sample:
    """A sound message that says something else."""
    try:
        MessageOffsets(sample.kind, sample.data)
        message = _of_rclpy(sample.kind, sample.data)
        _CHANGES[sample.kind](generator, message)
        return _sample(sample.kind, message)
    except Exception:  # what rclpy cannot read, or what its fields cannot hold
        return _bytes(generator, sample)


def _change_header(generator: random.Random, header: Any) -> None:
    if generator.random() < 0.3:
        header.frame_id = generator.choice(('', 'lab', 'map', 'é'))
    else:
        header.stamp.sec = generator.choice((0, -1, 5, 2**31 - 1, 2**31 - 1, -(2**31)))
        header.stamp.nanosec = generator.choice((0, 10**9, 2**32 - 1))


def _change_marker(generator: random.Random, marker: Marker) -> None:
    number = generator.choice((0.0, 1.0, -2.5, 1e300, float('nan'), float('inf')))
    match generator.randrange(9):
        case 0:
            marker.action = generator.choice((0, 1, 2, 3, 3, 99, -1))
        case 1:
            marker.id = generator.choice((0, 1, 7, -1, 2**31 - 1, -(2**31)))
        case 2:
            marker.ns = generator.choice(('', 'a', 'b/0', 'a\nb', 'marker', '\U0001f4a5'))
        case 3 | 4:
            _change_header(generator, marker.header)
        case 5:
            _change_drawing(generator, marker)
        case 6:
            marker.pose.position.y = number
        case 7:
            marker.pose.orientation.z = number
        case _:
            marker.points = [Point(x=number, y=1.0)] * generator.randrange(6)


def _change_drawing(generator: random.Random, marker: Marker) -> None:
    """What is passed over, of sizes that move what comes after."""
    names, size = ('text', 'mesh_resource', 'texture_resource'), generator.randrange(9)
    setattr(marker, generator.choice(names), 'x' * size)
    marker.texture.format, marker.texture.data = 'y' * generator.randrange(9), bytes(size)
    marker.mesh_file.filename, marker.mesh_file.data = 'z' * size, bytes(generator.randrange(9))
    marker.uv_coordinates = [UVCoordinate(u=0.5)] * generator.randrange(3)
    marker.colors = [ColorRGBA(r=0.5)] * generator.randrange(3)


def _change_array(generator: random.Random, array: MarkerArray) -> None:
    way = generator.randrange(6)
    if way == 0 or not array.markers:
        array.markers.insert(generator.randrange(len(array.markers) + 1), Marker())
    elif way == 1:
        array.markers.pop(generator.randrange(len(array.markers)))
    elif way == 2:
        generator.shuffle(array.markers)
    elif way == 3:
        one, other = generator.choices(array.markers, k=2)
        one.ns, one.id = other.ns, other.id
    else:
        _change_marker(generator, generator.choice(array.markers))


def _change_poses(generator: random.Random, poses: Any) -> None:
    number = generator.choice((0.0, 1e300, float('nan'), float('-inf')))
    if generator.random() < 0.3:
        return _change_header(generator, poses.header)
    poses.poses.insert(generator.randrange(len(poses.poses) + 1), Pose(position=Point(x=number)))
    if generator.random() < 0.5:
        poses.poses = poses.poses[generator.randrange(len(poses.poses)) :]
    return None


def _change_cloud(generator: random.Random, cloud: Any) -> None:
    """Fields, offsets, steps and sizes, which all hang together."""
    sizes = (0, 1, 2, 3, 4, 7, 8, 12, 24, 48, 96, 2**16, 2**31, 2**32 - 1)
    field = generator.choice(cloud.fields) if cloud.fields else PointField()
    match generator.randrange(9):
        case 8:
            _change_header(generator, cloud.header)
        case 0:
            name = generator.choice(('height', 'width', 'point_step', 'row_step'))
            setattr(cloud, name, generator.choice(sizes))
        case 1:
            name = generator.choice(('offset', 'count'))
            setattr(field, name, generator.choice(sizes))
        case 2:
            field.datatype = generator.choice((*range(10), 255))
        case 3:
            field.name = generator.choice(('x', 'y', 'z', 'id', '', 'é', 'intensity'))
        case 4:
            cloud.is_bigendian = not cloud.is_bigendian
        case 5:
            cloud.data = cloud.data[: generator.randrange(len(cloud.data) + 1)]
        case 6:
            cloud.data = bytes(cloud.data) + generator.randbytes(generator.randrange(200))
        case _:
            cloud.fields = generator.sample(list(cloud.fields), generator.randint(0, 3))


_DAMAGE = (_bytes, _sizes, _texts, _spliced, _fields, _fields)
_CHANGES: dict[str, Any] = {
    'marker_array': _change_array,
    'marker': _change_marker,
    'pose_array': _change_poses,
    'point_cloud2': _change_cloud,
}


if __name__ == '__main__':
    reached = Reached(Path(package.__file__).parent)
    tell('messages', 100_000, partial(fuzz_messages, reached=reached))
    print(f'They reached {reached.lines} lines of the readers.')
