"""Bags: every message that is there comes out, in order; what is wrong is said in one line."""

import os
import resource
import signal
import subprocess
import sys
import tracemalloc
from contextlib import suppress
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseStamped, PoseWithCovarianceStamped, Quaternion
from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType, Writer
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header, String
from visualization_msgs.msg import Marker, MarkerArray

from kinpole_ros.bags import (
    BagError,
    BagMessage,
    BagWriter,
    Truncated,
    bag_files,
    definition,
    message_class,
    read_messages,
    topics,
    type_name,
)
from kinpole_ros.messages import installed_class

POINT = 'geometry_msgs/msg/Point'
COMPRESSIONS = list(CompressionType)


def payload(index: int, size: int = 48) -> bytes:
    """Bytes that differ for each message and cannot be compressed."""
    return np.random.default_rng(index).bytes(size)


def write_bag(
    target, times, compression=CompressionType.NONE, chunk_size=300, size=48, **options
) -> list[BagMessage]:
    """A bag made by mcap itself: messages on /a and /b in turn, returned in file order."""
    writer = Writer(target, chunk_size=chunk_size, compression=compression, **options)
    writer.start('ros2', 'test')
    schema = writer.register_schema(POINT, 'ros2msg', b'float64 x\n')
    channels = [writer.register_channel(topic, 'cdr', schema) for topic in ('/a', '/b')]
    messages = []
    for index, time in enumerate(times):
        data = payload(index, size)
        writer.add_message(channels[index % 2], time, data, time, index)
        messages.append(BagMessage(('/a', '/b')[index % 2], POINT, data, time))
    writer.finish()
    return messages


def read_all(path, **options) -> tuple[list[BagMessage], str]:
    """All messages, and what Truncated said after them ('' if nothing)."""
    messages = []
    try:
        for message in read_messages(path, **options):
            messages.append(message)
    except Truncated as error:
        return messages, str(error)
    return messages, ''


def one_line(error: pytest.ExceptionInfo) -> str:
    text = str(error.value)
    assert '\n' not in text
    assert 'fix: ' in text
    return text


# Reading what is whole


@pytest.mark.parametrize('compression', COMPRESSIONS)
def test_reads_what_mcap_wrote(tmp_path, compression):
    path = tmp_path / 'run.mcap'
    expected = write_bag(str(path), range(50), compression)
    assert read_all(path) == (expected, '')
    assert read_all(path, topics=['/b'])[0] == expected[1::2]
    assert read_all(path, topics=['/nothing'])[0] == []
    assert topics(path) == {'/a': POINT, '/b': POINT}


@given(
    times=st.lists(st.integers(0, 30), max_size=60),
    options=st.sampled_from(
        [
            {},
            {'index_types': IndexType.NONE},
            {'index_types': IndexType.CHUNK},
            {'repeat_channels': False},
            {'repeat_schemas': False},
            {'use_chunking': False},
        ]
    ),
    topic=st.sampled_from([None, '/a', '/b']),
)
def test_order_is_log_time_then_file_with_and_without_an_index(
    tmp_path_factory, times, options, topic
):
    path = tmp_path_factory.mktemp('order') / 'run.mcap'
    written = write_bag(str(path), times, **options)
    expected = [m for m in sorted(written, key=lambda m: m.log_time) if topic in (None, m.topic)]
    assert read_all(path, topics=topic and [topic]) == (expected, '')
    # The same file cut before its index keeps order and messages, and says that it is cut.
    content = path.read_bytes()
    path.write_bytes(content[:-20])
    messages, complaint = read_all(path, topics=topic and [topic])
    assert messages == expected
    assert 'is cut off at byte' in complaint
    if times:
        assert topics(path) == {'/a': POINT, '/b': POINT}


def test_memory_stays_bounded_by_chunks_not_by_the_file(tmp_path):
    path = tmp_path / 'run.mcap'
    write_bag(str(path), range(400), chunk_size=200_000, size=20_000)
    for size in (path.stat().st_size, path.stat().st_size - 100):
        os.truncate(path, size)
        tracemalloc.start()
        count = 0
        with suppress(Truncated):
            for _ in read_messages(path):
                count += 1
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert count == 400
        assert peak < 2e6 < size / 3


@pytest.mark.parametrize('compression', list(CompressionType))
def test_a_chunk_too_large_for_the_memory_is_refused_by_name(tmp_path, compression, monkeypatch):
    largest = 1 << 21
    monkeypatch.setattr('kinpole_ros.bags._channels.LARGEST_CHUNK', largest)
    path = tmp_path / 'run.mcap'
    for count in (1, 200):  # of 20 kB
        write_bag(str(path), range(count), compression, chunk_size=1 << 30, size=20_000)
        tracemalloc.start()
        if count == 1:
            assert len(list(read_messages(path))) == 1
        else:
            with pytest.raises(BagError, match='larger than 2 MiB unpacked; fix: `mcap') as error:
                list(read_messages(path))
            assert str(path) in str(error.value)
            assert '\n' not in str(error.value)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    packed = path.stat().st_size if compression != CompressionType.NONE else 0
    assert peak < 2.5 * largest + 3 * packed


def test_progress_rises_to_one_in_few_calls(tmp_path):
    for name in ('run_0.mcap', 'run_1.mcap'):
        write_bag(str(tmp_path / name), range(2000), use_chunking=False)
    seen = []
    assert len(list(read_messages(tmp_path, progress=seen.append))) == 4000
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert 100 < len(seen) <= 201


def test_chunks_without_the_topics_asked_for_are_not_touched(tmp_path):
    path = tmp_path / 'run.mcap'
    writer = Writer(str(path), compression=CompressionType.NONE)
    writer.start()
    schema = writer.register_schema(POINT, 'ros2msg', b'')
    camera, markers = (writer.register_channel(t, 'cdr', schema) for t in ('/camera', '/markers'))
    writer.add_message(camera, 1, b'image' * 50, 1)
    writer.flush()
    writer.add_message(markers, 2, b'marker', 2)
    writer.finish()
    content = path.read_bytes()
    path.write_bytes(content.replace(b'image', b'IMAGE'))
    assert [m.data for m in read_messages(path, topics=['/markers'])] == [b'marker']
    assert 'checksum' in read_all(path)[1]


def test_other_encodings_are_left_out_of_all_and_refused_when_asked_for(tmp_path):
    path = tmp_path / 'run.mcap'
    writer = Writer(str(path))
    writer.start()
    schema = writer.register_schema('foxglove.Log', 'jsonschema', b'{}')
    point = writer.register_schema(POINT, 'ros2msg', b'')
    writer.add_message(writer.register_channel('/json', 'json', schema), 1, b'{}', 1)
    writer.add_message(writer.register_channel('/bare', 'cdr', 0), 2, b'x', 2)
    writer.add_message(writer.register_channel('/point', 'cdr', point), 3, b'y', 3)
    writer.finish()
    assert [m.data for m in read_messages(path)] == [b'y']
    assert topics(path) == {'/json': 'foxglove.Log', '/bare': '', '/point': POINT}
    for topic in ('/json', '/bare'):
        with pytest.raises(BagError, match=f"run.mcap: topic '{topic}'") as error:
            list(read_messages(path, topics=[topic]))
        one_line(error)


# Reading what is cut off or damaged


@pytest.mark.parametrize('options', [{}, {'use_chunking': False}, {'index_types': IndexType.NONE}])
def test_uncompressed_bag_cut_at_every_byte_gives_exactly_the_messages_before(tmp_path, options):
    path = tmp_path / 'run.mcap'
    written = write_bag(str(path), range(1_000_000_000, 1_000_000_012), **options)
    content = path.read_bytes()
    ends = [content.index(m.data) + len(m.data) for m in written]
    for cut in range(len(content) - 1, 0, -1):
        os.truncate(path, cut)
        messages, complaint = read_all(path)
        count = sum(end <= cut for end in ends)
        assert messages == written[:count]
        if cut < len(MCAP0_MAGIC):
            assert 'there is no message before that' in complaint
        assert f'run.mcap is cut off at byte {cut}: ' in complaint
        if count:
            assert f'{count} messages up to stamp 1.000 s (log time)' in complaint


@pytest.mark.parametrize('compression', COMPRESSIONS)
def test_compressed_bag_cut_at_many_bytes_gives_all_that_can_be_decompressed(tmp_path, compression):
    path = tmp_path / 'run.mcap'
    written = write_bag(str(path), range(300), compression, chunk_size=150_000, size=2_000)
    content = path.read_bytes()
    with path.open('rb') as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    assert len(chunks) > 3
    before = len(written)
    for cut in range(len(content) - 1, 0, -4_999):
        os.truncate(path, cut)
        messages, complaint = read_all(path)
        assert f'cut off at byte {cut}' in complaint
        assert messages == written[: len(messages)]
        assert len(messages) <= before
        before = len(messages)
        # The data are random, so as much of a chunk is there as of its bytes, less a block.
        assert len(messages) >= (cut - 130_000) / 2_040
        whole = [c for c in chunks if c.chunk_start_offset + c.chunk_length <= cut]
        assert len(messages) >= sum(c.uncompressed_size for c in whole) // 2_040


def test_a_bag_cut_at_200_random_bytes_gives_every_whole_message_before_the_cut(tmp_path):
    path = tmp_path / 'run.mcap'
    written = write_bag(str(path), range(2000), CompressionType.ZSTD, chunk_size=4_000)
    content = path.read_bytes()
    with path.open('rb') as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    ends = [chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks]
    counts = [0]
    for chunk in chunks:
        with path.open('rb') as file:
            file.seek(chunk.chunk_start_offset)
            (record,) = islice(StreamReader(file, skip_magic=True, emit_chunks=True).records, 1)
        counts.append(counts[-1] + sum(isinstance(r, Message) for r in breakup_chunk(record)))
    for cut in np.random.default_rng(0).integers(1, len(content), 200).tolist():
        path.write_bytes(content[:cut])
        messages, complaint = read_all(path)
        assert messages == written[: len(messages)]
        assert len(messages) >= counts[sum(end <= cut for end in ends)]
        assert f'is cut off at byte {cut}' in complaint


@pytest.mark.parametrize('compression', COMPRESSIONS)
def test_a_damaged_chunk_ends_the_reading_and_is_named(tmp_path, compression):
    path = tmp_path / 'run.mcap'
    written = write_bag(str(path), range(40), compression)
    with path.open('rb') as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    content = bytearray(path.read_bytes())
    content[chunks[2].chunk_start_offset + chunks[2].chunk_length - 20] ^= 1
    path.write_bytes(content)
    messages, complaint = read_all(path)
    per_chunk = len(written) // len(chunks)
    assert messages == written[: len(messages)]
    assert per_chunk * 2 <= len(messages) <= per_chunk * 2 + 4
    assert f'is damaged at byte {chunks[2].chunk_start_offset} (' in complaint
    assert 'mcap recover' in complaint


def test_a_file_that_ends_in_zeros_is_damaged_there(tmp_path):
    path = tmp_path / 'run.mcap'
    written = write_bag(str(path), range(40))
    with path.open('rb') as file:
        second = make_reader(file).get_summary().chunk_indexes[1].chunk_start_offset
    content = path.read_bytes()
    path.write_bytes(content[:second] + bytes(len(content) - second))
    messages, complaint = read_all(path)
    assert 0 < len(messages) < 20
    assert messages == written[: len(messages)]
    assert f'is damaged at byte {second} (zeros' in complaint
    assert f': {len(messages)} messages up to stamp' in complaint


def test_a_chunk_without_a_checksum_that_ends_in_zeros_is_damaged(tmp_path):
    path = tmp_path / 'run.mcap'
    written = write_bag(str(path), range(20), chunk_size=2000, enable_crcs=False)
    content = path.read_bytes()
    tenth = content.index(written[10].data)
    with path.open('rb') as file:
        chunk = make_reader(file).get_summary().chunk_indexes[0]
    place = tenth + len(written[10].data)
    end = chunk.chunk_start_offset + chunk.chunk_length
    path.write_bytes(content[:place] + bytes(end - place) + content[end:])
    messages, complaint = read_all(path)
    assert messages == written[:11]
    assert f'is damaged at byte {chunk.chunk_start_offset} (zeros' in complaint
    assert ': 11 messages up to stamp' in complaint


@given(st.data(), st.sampled_from(COMPRESSIONS))
def test_any_damage_gives_messages_or_a_bag_error_and_nothing_else(
    tmp_path_factory, data, compression
):
    path = tmp_path_factory.mktemp('damage') / 'run.mcap'
    write_bag(str(path), range(20), compression)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(8, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    topics(path)
    try:
        assert len(list(read_messages(path))) <= 20
    except BagError as error:
        assert 'fix: ' in str(error)


@given(st.binary(max_size=200))
def test_garbage_after_the_magic_is_a_bag_error(tmp_path_factory, garbage):
    path = tmp_path_factory.mktemp('garbage') / 'run.mcap'
    path.write_bytes(MCAP0_MAGIC + garbage)
    messages, complaint = read_all(path)
    assert messages == []
    assert complaint


def handmade(*records) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return MCAP0_MAGIC + builder.end()


def test_unknown_compression_is_refused_with_a_mend(tmp_path):
    path = tmp_path / 'run.mcap'
    path.write_bytes(handmade(Chunk('bz2', b'...', 2, 1, 0, 3)))
    with pytest.raises(BagError, match="chunks are compressed with 'bz2'") as error:
        list(read_messages(path))
    one_line(error)


def test_chunk_that_lies_about_its_size_and_messages_nobody_described(tmp_path):
    path = tmp_path / 'run.mcap'
    path.write_bytes(handmade(Chunk('', b'...', 2, 1, 0, 9)))
    assert 'a chunk of the wrong size' in read_all(path)[1]
    message = Message(7, 5, b'x', 5, 0)
    path.write_bytes(handmade(message))
    assert 'channel 7, which is not described' in read_all(path)[1]
    described = (Schema(1, b'', 'ros2msg', POINT), Channel(7, '/t', 'cdr', {}, 1))
    path.write_bytes(handmade(*described, message))
    assert read_all(path)[0] == [BagMessage('/t', POINT, b'x', 5)]


# Folders and other things a user may give


def write_metadata(folder: Path, names, storage='mcap', compression='') -> None:
    information = {
        'version': 9,
        'storage_identifier': storage,
        'relative_file_paths': names,
        'compression_format': compression,
    }
    text = yaml.safe_dump({'rosbag2_bagfile_information': information})
    (folder / 'metadata.yaml').write_text(text)


def test_folder_is_read_in_the_order_of_its_metadata(tmp_path):
    second = write_bag(str(tmp_path / 'a.mcap'), range(10, 20))
    first = write_bag(str(tmp_path / 'b.mcap'), range(10))
    write_bag(str(tmp_path / 'not_listed.mcap'), range(5))
    write_metadata(tmp_path, ['b.mcap', 'a.mcap'])
    assert bag_files(tmp_path) == [tmp_path / 'b.mcap', tmp_path / 'a.mcap']
    assert read_all(tmp_path) == (first + second, '')
    assert topics(tmp_path) == {'/a': POINT, '/b': POINT}


def test_folder_without_metadata_counts_the_numbers_in_names(tmp_path):
    for name in ('run_10.mcap', 'run_2.mcap', 'run_1.mcap'):
        write_bag(str(tmp_path / name), range(3))
    assert [file.name for file in bag_files(tmp_path)] == [
        'run_1.mcap',
        'run_2.mcap',
        'run_10.mcap',
    ]


def test_cut_file_of_a_folder_is_named_after_the_files_before_it(tmp_path):
    first = write_bag(str(tmp_path / 'run_0.mcap'), range(10))
    second = write_bag(str(tmp_path / 'run_1.mcap'), range(10))
    os.truncate(tmp_path / 'run_1.mcap', 500)
    messages, complaint = read_all(tmp_path)
    assert messages == (first + second)[: len(messages)]
    assert len(messages) > 10
    assert 'run_1.mcap is cut off at byte 500' in complaint
    (tmp_path / 'run_1.mcap').write_bytes(b'')
    messages, complaint = read_all(tmp_path)
    assert messages == first
    assert 'run_1.mcap is empty' in complaint


def test_what_is_lost_of_one_file_of_a_folder_costs_nothing_of_the_others(tmp_path):
    (tmp_path / 'run_0.mcap').write_bytes(b'')
    first = write_bag(str(tmp_path / 'run_1.mcap'), range(10))
    os.truncate(tmp_path / 'run_1.mcap', 500)
    second = write_bag(str(tmp_path / 'run_2.mcap'), range(10))
    messages, complaint = read_all(tmp_path)
    assert messages == first[: len(messages) - 10] + second
    assert 'run_0.mcap is empty' in complaint
    assert 'run_1.mcap is cut off at byte 500' in complaint


@pytest.mark.parametrize('name', ['../other.mcap', '/etc/other.mcap', 'sub/../../other.mcap'])
def test_metadata_cannot_name_files_outside_of_the_folder(tmp_path, name):
    folder = tmp_path / 'bag'
    folder.mkdir()
    write_bag(str(tmp_path / 'other.mcap'), range(3))
    write_metadata(folder, [name])
    with pytest.raises(BagError, match='is outside of the folder') as error:
        bag_files(folder)
    assert name in one_line(error)


@pytest.mark.parametrize(
    ('metadata', 'complaint'),
    [
        ({'names': ['x.db3'], 'storage': 'other'}, 'is a bag in other'),
        ({'names': ['x.mcap.lz4'], 'compression': 'lz4'}, r'compressed by rosbag2 \(lz4\)'),
        ({'names': []}, 'names no files'),
        ({'names': ['gone.mcap']}, 'gone.mcap, named by metadata.yaml, is not there'),
        ({'names': [1]}, '1, named by metadata.yaml, is not there'),
        ({'names': 'a.mcap'}, 'is not the metadata of a rosbag2 bag'),
        ({'names': None}, 'is not the metadata of a rosbag2 bag'),
    ],
)
def test_folder_that_cannot_be_read_is_refused_with_a_mend(tmp_path, metadata, complaint):
    write_metadata(tmp_path, **metadata)
    with pytest.raises(BagError, match=complaint) as error:
        read_messages(tmp_path)
    one_line(error)


@pytest.mark.parametrize('text', ['', '[', 'a: b', 'rosbag2_bagfile_information: 5', '\x00'])
def test_broken_metadata_is_named(tmp_path, text):
    (tmp_path / 'metadata.yaml').write_text(text)
    with pytest.raises(BagError, match=r'metadata\.yaml is not the metadata') as error:
        bag_files(tmp_path)
    one_line(error)


def test_folder_without_bags(tmp_path):
    with pytest.raises(BagError, match='has neither') as error:
        bag_files(tmp_path)
    one_line(error)
    (tmp_path / 'x.db3').write_bytes(b'')
    with pytest.raises(BagError, match=r'is empty \(0 bytes\)') as error:
        bag_files(tmp_path)
    one_line(error)


@pytest.mark.parametrize(
    ('name', 'content', 'complaint'),
    [
        ('run.mcap', b'', r'is empty \(0 bytes\)'),
        ('run.bag', b'#ROSBAG V2.0\n', 'is a ROS 1 bag; fix: .*kinpole import'),
        ('run.csv', b't,a_x,a_y\n', 'is a file of points, not a bag; fix: .*kinpole import'),
        ('run.mcap.zstd', b'\x28\xb5\x2f\xfd1234', 'zstd -d'),
    ],
)
def test_file_that_is_no_mcap_bag_is_refused_at_the_call(tmp_path, name, content, complaint):
    path = tmp_path / name
    path.write_bytes(content)
    for function in (bag_files, topics, read_messages):
        with pytest.raises(BagError, match=complaint) as error:
            function(path)
        assert str(path) in one_line(error)


def test_no_such_bag(tmp_path):
    with pytest.raises(BagError, match='no such file or folder: ') as error:
        read_messages(tmp_path / 'nothing.mcap')
    one_line(error)
    os.mkfifo(tmp_path / 'pipe')  # opening it would wait forever
    with pytest.raises(BagError, match='pipe is neither a file nor a folder, ') as error:
        topics(tmp_path / 'pipe')
    one_line(error)


# Writing


def header(stamp=3) -> Header:
    result = Header(frame_id='world')
    result.stamp.sec = stamp
    return result


def samples() -> dict[str, object]:
    """A message of each type that matters here, with no field left at its default."""
    pose = Pose(position=Point(x=1.0, y=2.0, z=3.0), orientation=Quaternion(x=0.6, w=0.8))
    marker = Marker(header=header(), ns='red', id=4, type=Marker.SPHERE, pose=pose, text='ä')
    marker.points = [Point(x=0.5), Point(y=-0.5)]
    field = PointField(name='x', offset=0, datatype=PointField.FLOAT32, count=1)
    cloud = PointCloud2(header=header(), height=1, width=2, fields=[field], point_step=4)
    cloud.row_step, cloud.data, cloud.is_dense = 8, np.float32([1.5, np.nan]).tobytes(), True
    odometry = Odometry(header=header(), child_frame_id='body')
    odometry.pose.pose = pose
    odometry.pose.covariance = np.arange(36.0)
    odometry.twist.twist.angular.z = -2.5
    path = PathMessage(header=header(), poses=[PoseStamped(header=header(5), pose=pose)])
    status = DiagnosticStatus(level=DiagnosticStatus.WARN, name='rate', message='slow')
    status.values = [KeyValue(key='Hz', value='199.5')]
    with_covariance = PoseWithCovarianceStamped(header=header())
    with_covariance.pose.pose = pose
    with_covariance.pose.covariance = np.arange(36.0)[::-1]
    return {
        '/markers': MarkerArray(markers=[marker, Marker(id=2)]),
        '/cloud': cloud,
        '/odom': odometry,
        '/path': path,
        '/diagnostics': DiagnosticArray(header=header(), status=[status]),
        '/pose': with_covariance,
    }


def write_samples(path) -> dict[str, object]:
    messages = samples()
    with BagWriter(path) as bag:
        for time, (topic, message) in enumerate(messages.items()):
            bag.write(topic, message, time)
            bag.write(topic, message, time + 10)
    return messages


def same(ours: object, theirs: object) -> bool:
    """Whether an rclpy message and another library's object have the same fields and values."""
    if hasattr(ours, 'get_fields_and_field_types'):
        names = ours.get_fields_and_field_types()
        return all(same(getattr(ours, name), getattr(theirs, name)) for name in names)
    if isinstance(ours, list | tuple):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    if isinstance(ours, bytes):  # one byte, which other libraries give as a number
        return ours[0] == theirs
    if isinstance(ours, str):
        return ours == theirs
    return np.array_equal(ours, list(theirs) if isinstance(theirs, bytes) else theirs)


def test_what_is_written_is_read_back_equal(tmp_path):
    path = tmp_path / 'made' / 'on the way' / 'out.mcap'
    written = write_samples(path)
    assert topics(path) == {topic: type_name(type(m)) for topic, m in written.items()}
    read = list(read_messages(path))
    assert [m.log_time for m in read] == [*range(6), *range(10, 16)]
    for message in read:
        cls = installed_class(message.type_name)
        assert deserialize_message(message.data, cls) == written[message.topic]


def test_written_records_follow_rosbag2(tmp_path):
    write_samples(tmp_path / 'out.mcap')
    with open(tmp_path / 'out.mcap', 'rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        for schema, channel, message in reader.iter_messages():
            assert schema.encoding == 'ros2msg'
            assert channel.message_encoding == 'cdr'
            assert channel.metadata == {'offered_qos_profiles': ''}
            assert message.publish_time == message.log_time
            assert message.sequence == message.log_time // 10


def test_a_latched_topic_has_its_qos_as_rosbag2_writes_it(tmp_path):
    """So `ros2 bag play` offers it as the node does; without, it takes its default, volatile."""
    with BagWriter(tmp_path / 'out.mcap') as bag:
        bag.add_topic('/kinpole/rig', String, is_latched=True)
        bag.write('/kinpole/rig', String(data='{}'), 1)
        bag.write('/other', String(data='{}'), 2)
    with open(tmp_path / 'out.mcap', 'rb') as file:
        found = {c.topic: c.metadata for _, c, _ in make_reader(file).iter_messages()}
    assert found['/other'] == {'offered_qos_profiles': ''}
    (qos,) = yaml.safe_load(found['/kinpole/rig']['offered_qos_profiles'])
    assert (qos['reliability'], qos['durability']) == ('reliable', 'transient_local')


def test_equal_data_make_equal_files(tmp_path):
    for name in ('a.mcap', 'b.mcap'):
        with BagWriter(tmp_path / name) as bag:
            for k in range(100):
                bag.write_raw(f'/{k % 3}', POINT, payload(k), k)
    assert (tmp_path / 'a.mcap').read_bytes() == (tmp_path / 'b.mcap').read_bytes()


def test_raw_messages_with_type_by_name_or_class_make_the_same_bag(tmp_path):
    write_samples(tmp_path / 'a.mcap')
    with BagWriter(tmp_path / 'b.mcap') as bag:
        for index, message in enumerate(read_messages(tmp_path / 'a.mcap')):
            by_class = message_class(message.type_name)
            kind = by_class if index % 2 else message.type_name
            bag.write_raw(message.topic, kind, message.data, message.log_time)
    assert list(read_messages(tmp_path / 'b.mcap')) == list(read_messages(tmp_path / 'a.mcap'))


def test_existing_file_is_replaced(tmp_path):
    path = tmp_path / 'out.mcap'
    path.write_bytes(b'old' * 100_000)
    with BagWriter(path):
        pass
    assert list(read_messages(path)) == []


def test_error_in_the_with_block_leaves_a_whole_bag(tmp_path):
    path = tmp_path / 'out.mcap'
    with pytest.raises(RuntimeError, match='later'), BagWriter(path) as bag:
        bag.write('/p', Point(x=1.0), 5)
        raise RuntimeError('later')
    assert [m.log_time for m in read_messages(path)] == [5]
    bag.close()  # again, for nothing
    with pytest.raises(BagError, match='is closed'):
        bag.write('/p', Point(), 6)


def test_killed_writer_leaves_what_was_flushed_and_all_finished_chunks(tmp_path):
    path = tmp_path / 'out.mcap'
    program = (
        'import os, sys; from geometry_msgs.msg import Point; from kinpole_ros.bags import *\n'
        'bag = BagWriter(sys.argv[1])\n'
        'for k in range(10_000): bag.write("/p", Point(x=float(k)), k)\n'
        'if sys.argv[2] == "flush": bag.flush()\n'
        f'os.kill(os.getpid(), {signal.SIGKILL:d})\n'
    )
    for mode, least in (('flush', 10_000), ('no', 6_000)):
        done = subprocess.run(
            [sys.executable, '-c', program, str(path), mode],
            cwd=Path(__file__).parents[2],
            timeout=60,
            check=False,
        )
        assert done.returncode == -signal.SIGKILL
        messages, complaint = read_all(path)
        assert 'is cut off' in complaint
        assert len(messages) >= least
        assert [m.log_time for m in messages] == list(range(len(messages)))


def test_full_disk_is_one_line_and_leaves_what_was_written(tmp_path):
    path = tmp_path / 'out.mcap'
    clouds = [PointCloud2(data=payload(k, 20_000)) for k in range(100)]
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, hard))
    try:
        with pytest.raises(BagError, match='cannot be written') as error, BagWriter(path) as bag:
            for k, cloud in enumerate(clouds):
                bag.write('/c', cloud, k)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    one_line(error)
    assert k < 99
    bag.close()
    messages, _ = read_all(path)
    assert [m.log_time for m in messages] == list(range(len(messages)))
    assert len(messages) >= 26
    assert deserialize_message(messages[-1].data, PointCloud2) == clouds[len(messages) - 1]


def test_places_that_cannot_be_written_are_refused(tmp_path):
    (tmp_path / 'file').write_text('')
    for path in (tmp_path, tmp_path / 'file' / 'out.mcap'):
        with pytest.raises(BagError, match='cannot be written: ') as error:
            BagWriter(path)
        assert str(path) in one_line(error)


def test_messages_that_do_not_fit_are_refused_and_the_bag_goes_on(tmp_path):
    path = tmp_path / 'out.mcap'
    with BagWriter(path) as bag:
        bag.write('/p', Point(), 0)
        with pytest.raises(BagError, match=r"'/p' holds geometry_msgs/msg/Point") as error:
            bag.write('/p', Quaternion(), 1)
        one_line(error)
        with pytest.raises(BagError, match='log time -1 ns') as error:
            bag.write('/p', Point(), -1)
        one_line(error)
        for name in ('no_such_msgs/msg/Thing', 'geometry_msgs/msg/Thing', 'Thing'):
            with pytest.raises(BagError, match='is not installed') as error:
                bag.write_raw('/q', name, b'', 1)
            one_line(error)
        bag.write('/p', Point(), 2)
    assert [m.log_time for m in read_messages(path)] == [0, 2]


def test_a_type_without_its_parts_is_refused_and_the_bag_goes_on(tmp_path, monkeypatch):
    with BagWriter(tmp_path / 'out.mcap') as bag:
        with monkeypatch.context() as lacking:
            refusal = BagError("message type 'x' is not installed; fix: source it")
            raising = mock.Mock(side_effect=refusal)
            lacking.setattr('kinpole_ros.bags._bag_writer.definition', raising)
            with pytest.raises(BagError, match='is not installed'):
                bag.write('/p', Point(), 0)
        bag.write('/p', Point(), 1)
    assert [m.log_time for m in read_messages(tmp_path / 'out.mcap')] == [1]


# Schemas, judged by other libraries


def test_definition_lists_each_type_once_below_its_line():
    text = definition(MarkerArray)
    assert text.startswith('visualization_msgs/Marker[] markers\n' + '=' * 80 + '\nMSG: ')
    names = [line for line in text.splitlines() if line.startswith('MSG: ')]
    assert len(names) == len(set(names)) > 5
    assert 'int32 DELETEALL=3\n' in text
    assert 'float64[36] covariance\n' in definition(Odometry)
    assert 'byte WARN=1\n' in definition(DiagnosticArray)


@pytest.mark.parametrize(
    'package',
    [
        'builtin_interfaces',
        'std_msgs',
        'geometry_msgs',
        'sensor_msgs',
        'nav_msgs',
        'visualization_msgs',
        'diagnostic_msgs',
        'shape_msgs',
        'trajectory_msgs',
    ],
)
def test_definitions_agree_with_the_msg_files_rosbags_has(package):
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    module = pytest.importorskip(f'{package}.msg')
    compared = 0
    for cls in vars(module).values():
        # rosbags adds the field that DDS puts into an empty message; char is uint8 in ROS 2.
        if not isinstance(cls, type) or cls.__name__ in ('Empty', 'Char'):
            continue
        for name, (constants, fields) in typesys.get_types_from_msg(
            definition(cls), type_name(cls)
        ).items():
            if name in store.fielddefs:
                their_constants, their_fields = store.fielddefs[name]
                assert fields == their_fields, name
                assert [(k, v) for k, _, v in constants] == [(k, v) for k, _, v in their_constants]
                compared += 1
    assert compared


def test_rosbags_reads_our_bags_by_our_schemas(tmp_path):
    if version('rosbags') < '0.11':
        pytest.skip('before 0.11 rosbags reads folders only')
    highlevel = pytest.importorskip('rosbags.highlevel')
    typesys = pytest.importorskip('rosbags.typesys')
    written = write_samples(tmp_path / 'out.mcap')
    empty = typesys.get_typestore(typesys.Stores.EMPTY)
    with highlevel.AnyReader([tmp_path / 'out.mcap']) as reader:
        for connection in reader.connections:
            empty.register(typesys.get_types_from_msg(connection.msgdef.data, connection.msgtype))
        seen = 0
        for connection, _, data in reader.messages():
            message = empty.deserialize_cdr(data, connection.msgtype)
            assert same(written[connection.topic], message), connection.topic
            seen += 1
    assert seen == 2 * len(written)


def test_mcap_ros2_decodes_our_bags_by_our_schemas(tmp_path):
    decoder = pytest.importorskip('mcap_ros2.decoder')
    written = write_samples(tmp_path / 'out.mcap')
    with open(tmp_path / 'out.mcap', 'rb') as file:
        reader = make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        decoded = [(c.topic, message) for _, c, _, message in reader.iter_decoded_messages()]
    assert len(decoded) == 2 * len(written)
    for topic, message in decoded:
        assert same(written[topic], message), topic
