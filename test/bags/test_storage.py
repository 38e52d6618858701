"""Bags as they lie on disks: compressed as a whole or by message, in blocks, with false claims."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import yaml
import zstandard
from fuzz_bags import fuzz_bags
from geometry_msgs.msg import Point, Quaternion
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType, Writer

from kinpole_ros.bags import (
    BagError,
    BagMessage,
    BagWriter,
    Truncated,
    bag_files,
    definition,
    read_blocks,
    read_messages,
    topics,
    type_name,
)

POINT = 'geometry_msgs/msg/Point'


def write(path: Path, times, size=40, chunk_size=2000, **options) -> list[BagMessage]:
    """A bag of messages on /a and /b in turn, returned in order of log time."""
    generator = np.random.default_rng(1)
    writer = Writer(str(path), chunk_size=chunk_size, **options)
    writer.start('ros2', 'test')
    schema = writer.register_schema(POINT, 'ros2msg', b'float64 x\n')
    channels = [writer.register_channel(topic, 'cdr', schema) for topic in ('/a', '/b')]
    messages = []
    for index, time in enumerate(times):
        data = b'\x00\x01' + generator.bytes(size)
        writer.add_message(channels[index % 2], time, data, time, index)
        messages.append(BagMessage(('/a', '/b')[index % 2], POINT, data, time))
    writer.finish()
    return sorted(messages, key=lambda message: message.log_time)


def read(path: Path, only=None) -> tuple[list[BagMessage], str]:
    """All messages, and what Truncated said after them ('' if nothing)."""
    messages: list[BagMessage] = []
    try:
        for message in read_messages(path, only):
            messages.append(message)
    except Truncated as error:
        return messages, str(error)
    return messages, ''


def pack(path: Path) -> Path:
    """What rosbag2 makes of a file with --compression-mode file; the plain one is gone."""
    packed = path.with_name(path.name + '.zstd')
    packed.write_bytes(zstandard.compress(path.read_bytes()))
    path.unlink()
    return packed


def jittered(count: int) -> list[int]:
    times = np.arange(count) * 10 + np.random.default_rng(0).integers(0, 400, count)
    return [int(time) for time in times]


# In blocks


@pytest.mark.parametrize('options', [{}, {'use_chunking': False}, {'index_types': IndexType.NONE}])
def test_blocks_are_the_messages_a_thousand_at_a_time(tmp_path, options):
    expected = write(tmp_path / 'run.mcap', jittered(5000), **options)
    for only in (None, ['/a']):
        blocks = list(read_blocks(tmp_path / 'run.mcap', only))
        messages = [m for m in expected if only is None or m.topic in only]
        assert [message for block in blocks for message in block] == messages
        assert max(map(len, blocks)) <= 1000
        assert len(blocks) <= len(messages) / 400


def test_where_blocks_end_goes_by_the_messages_however_they_are_stored(tmp_path):
    ways = [{}, {'use_chunking': False}, {'chunk_size': 100}, {'chunk_size': 1 << 24}]
    for number, options in enumerate(ways):
        write(tmp_path / f'{number}.mcap', jittered(5000), size=700, **options)
    (tmp_path / 'split').mkdir()
    for number, part in enumerate((range(123), range(123, 5000))):
        write(tmp_path / 'split' / f'{number}.mcap', part, size=700)
    bags = [*tmp_path.glob('*.mcap'), tmp_path / 'split']
    ends = [[len(block) for block in read_blocks(bag)] for bag in bags]
    assert sum(ends[0]) == 5000
    assert all(one == ends[0] for one in ends)


@pytest.mark.parametrize('size', [100_000, 200_000, 400_000])
def test_the_number_of_blocks_does_not_grow_with_the_size_of_the_messages(tmp_path, size):
    """Results have a cost for each block and topic: with more bodies both numbers grew."""
    write(tmp_path / 'run.mcap', range(40), size=size)
    assert [len(block) for block in read_blocks(tmp_path / 'run.mcap')] == [32, 8]


def test_blocks_of_very_large_messages_are_short(tmp_path):
    write(tmp_path / 'run.mcap', range(12), size=3_000_000)
    assert [len(block) for block in read_blocks(tmp_path / 'run.mcap')] == [5, 5, 2]


def test_all_messages_before_the_damage_come_before_the_error(tmp_path):
    expected = write(tmp_path / 'run.mcap', range(700), compression=CompressionType.NONE)
    os.truncate(tmp_path / 'run.mcap', (tmp_path / 'run.mcap').stat().st_size // 2)
    blocks = read_blocks(tmp_path / 'run.mcap')
    first = next(blocks)
    assert 300 < len(first) < 400
    assert first == expected[: len(first)]
    with pytest.raises(Truncated, match=f'{len(first)} messages up to'):
        next(blocks)


def test_a_late_message_at_the_end_of_the_file_comes_first(tmp_path):
    expected = write(tmp_path / 'run.mcap', [*range(100, 3000), 5, *range(3000, 3100)])
    assert read(tmp_path / 'run.mcap') == (expected, '')
    assert expected[0].log_time == 5


@pytest.mark.parametrize('place', ['first', 'middle', 'last'])
@pytest.mark.parametrize('plain', [False, True])
def test_what_the_index_leaves_out_is_read_all_the_same(tmp_path, place, plain):
    path = tmp_path / 'run.mcap'
    expected = write(path, range(300), chunk_size=1000)
    with open(path, 'rb') as file:
        records = list(StreamReader(file, emit_chunks=True).records)
    chunks = [k for k, record in enumerate(records) if isinstance(record, Chunk)]
    left_out = chunks[{'first': 0, 'middle': len(chunks) // 2, 'last': -1}[place]]
    builder = RecordBuilder()
    starts, summary = {}, 0
    for k, record in enumerate(records):
        starts[k] = len(MCAP0_MAGIC) + builder.count
        if isinstance(record, ChunkIndex):
            k = chunks.pop(0)
            if k == left_out:
                continue
            record.chunk_start_offset = starts[k]
        elif isinstance(record, Footer):
            record = Footer(summary, 0, 0)
        for one in breakup_chunk(record) if plain and k == left_out else [record]:
            one.write(builder)
        if isinstance(record, DataEnd):
            summary = len(MCAP0_MAGIC) + builder.count
    path.write_bytes(MCAP0_MAGIC + builder.end() + MCAP0_MAGIC)
    assert read(path) == (expected, '')
    assert read(path, ['/a'])[0] == [m for m in expected if m.topic == '/a']


def test_bags_put_together_in_a_file_are_told_of(tmp_path):
    path = tmp_path / 'run.mcap'
    expected = write(path, range(300))
    content = path.read_bytes()
    told = f'holds another bag from byte {len(content)} on, which needs a file of its own'
    path.write_bytes(2 * content)
    for pack_it in (False, True):
        messages, complaint = read(pack(path) if pack_it else path)
        assert messages == expected
        assert told in complaint
    # What merely fills up the disk is no bag.
    path.write_bytes(content + bytes(100))
    assert read(path) == (expected, '')


# Compressed as a whole


@pytest.mark.parametrize('options', [{}, {'use_chunking': False}])
def test_a_compressed_file_reads_like_the_plain_one(tmp_path, options):
    expected = write(tmp_path / 'run.mcap', jittered(3000), **options)
    packed = pack(tmp_path / 'run.mcap')
    shown: list[float] = []
    assert list(read_messages(packed, progress=shown.append)) == expected
    assert shown == sorted(shown)
    assert shown[-1] == 1
    assert read(packed, ['/b'])[0] == [m for m in expected if m.topic == '/b']
    assert topics(packed) == {'/a': POINT, '/b': POINT}
    assert sorted(tmp_path.iterdir()) == [packed]


@pytest.mark.parametrize('described', [True, False])
def test_a_folder_of_split_compressed_files_is_read_in_order(tmp_path, described):
    expected = []
    for k in range(3):
        expected += write(tmp_path / f'run_{k}.mcap', range(100 * k, 100 * k + 100))
        pack(tmp_path / f'run_{k}.mcap')
    if described:
        about = {
            'storage_identifier': 'mcap',
            'relative_file_paths': [f'run_{k}.mcap.zstd' for k in range(3)],
            'compression_format': 'zstd',
            'compression_mode': 'FILE',
        }
        text = yaml.safe_dump({'rosbag2_bagfile_information': about})
        (tmp_path / 'metadata.yaml').write_text(text)
    assert read(tmp_path) == (expected, '')
    assert topics(tmp_path) == {'/a': POINT, '/b': POINT}


def test_of_a_file_that_was_being_compressed_the_plain_one_counts(tmp_path):
    expected = write(tmp_path / 'run_0.mcap', range(50))
    half = zstandard.compress((tmp_path / 'run_0.mcap').read_bytes())[:100]
    (tmp_path / 'run_0.mcap.zstd').write_bytes(half)
    assert bag_files(tmp_path) == [tmp_path / 'run_0.mcap']
    assert read(tmp_path) == (expected, '')


def test_a_compressed_file_cut_or_damaged_gives_what_can_be_unpacked(tmp_path):
    expected = write(tmp_path / 'run.mcap', range(20_000), compression=CompressionType.NONE)
    packed = pack(tmp_path / 'run.mcap')
    content = packed.read_bytes()
    packed.write_bytes(content[: len(content) // 2])
    messages, complaint = read(packed)
    assert 'is cut off at byte' in complaint
    assert 8000 < len(messages) < 12_000
    assert messages == expected[: len(messages)]
    assert topics(packed) == {'/a': POINT, '/b': POINT}
    damaged = bytearray(content)
    damaged[len(content) // 2 : len(content) // 2 + 4000] = bytes(4000)
    packed.write_bytes(damaged)
    messages, complaint = read(packed)
    assert 'is damaged at byte' in complaint
    assert messages == expected[: len(messages)]


def test_unknown_compression_in_a_compressed_file_is_refused_by_name(tmp_path):
    path = tmp_path / 'run.mcap'
    path.write_bytes(handmade(Chunk('bz\n2', b'...', 2, 1, 0, 3)))
    packed = pack(path)
    with pytest.raises(BagError, match=r"run\.mcap\.zstd: chunks are compressed with 'bz\\n2'"):
        list(read_messages(packed))


def test_what_is_packed_must_be_a_bag(tmp_path):
    path = tmp_path / 'table.mcap.zstd'
    path.write_bytes(zstandard.compress(b't,a_x,a_y\n' * 100))
    with pytest.raises(BagError, match=r'table\.mcap\.zstd is compressed, and what is in it'):
        read_messages(path)


def test_messages_compressed_one_by_one_come_unpacked(tmp_path):
    plain = [b'\x00\x01\x00\x00' + bytes([k]) * 300 for k in range(20)]
    writer = Writer(str(tmp_path / 'run.mcap'))
    writer.start()
    schema = writer.register_schema(POINT, 'ros2msg', b'')
    channel = writer.register_channel('/p', 'cdr', schema)
    for k, data in enumerate(plain):
        writer.add_message(channel, k, zstandard.compress(data), k)
    writer.finish()
    assert [m.data for m in read_messages(tmp_path / 'run.mcap')] == plain


# False claims


def bounded(path: Path, megabytes: int = 700) -> str:
    """What reading says in a process that may take no more memory than that, and no disk."""
    program = (
        'import resource, sys\n'
        'from kinpole_ros.bags import BagError, read_messages, topics\n'
        'used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()\n'
        f'most = used + {megabytes} * 2**20\n'
        'resource.setrlimit(resource.RLIMIT_AS, (most, most))\n'
        'try:\n'
        '    topics(sys.argv[1])\n'
        '    print(sum(len(m.data) for m in read_messages(sys.argv[1])))\n'
        'except BagError as error:\n'
        '    print(error)\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', program, str(path)],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=100,
        check=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)),
    )
    assert done.stdout.count('\n') == 1
    return done.stdout


def handmade(*records) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return MCAP0_MAGIC + builder.end()


DESCRIBED = (Schema(1, b'', 'ros2msg', POINT), Channel(7, '/t', 'cdr', {}, 1))
SOUND = Message(7, 5, b'sound', 5, 0)


@pytest.mark.parametrize('compression', ['', 'zstd', 'lz4'])
@pytest.mark.parametrize('claimed', [2**31, 2**40, 2**64 - 1])
def test_a_chunk_that_claims_too_much_is_damage(tmp_path, compression, claimed):
    path = tmp_path / 'run.mcap'
    chunk = Chunk(compression, b'....' * 50, 9, 9, 0, claimed)
    path.write_bytes(handmade(*DESCRIBED, SOUND, chunk))
    messages, complaint = read(path)
    assert [m.data for m in messages] == [b'sound']
    assert f'(a chunk that claims to be {claimed} bytes unpacked)' in complaint


def test_a_chunk_that_unpacks_to_more_than_it_claims_is_damage(tmp_path):
    path = tmp_path / 'run.mcap'
    bomb = zstandard.compress(bytes(2**31))
    path.write_bytes(handmade(*DESCRIBED, SOUND, Chunk('zstd', bomb, 9, 9, 0, 1000)))
    assert 'a chunk of the wrong size' in bounded(path, 300)


@pytest.mark.parametrize('compression', ['zstd', 'lz4'])
def test_a_chunk_takes_no_more_memory_than_it_unpacks_to(tmp_path, compression):
    path, size = tmp_path / 'run.mcap', 120 << 20
    pack = {'zstd': zstandard.compress, 'lz4': lz4.frame.compress}[compression]
    # Noise, so that it may unpack to as much as it claims.
    packed = pack(bytes(size) + os.urandom(1 << 18))
    chunk = Chunk(compression, packed, 9, 9, 0, size + (1 << 18))
    path.write_bytes(handmade(*DESCRIBED, SOUND, chunk))
    assert 'zeros in place of a record' in bounded(path, 220)


def test_a_record_that_claims_too_much_is_damage(tmp_path):
    path = tmp_path / 'run.mcap'
    lie = b'\x05' + (2**40).to_bytes(8, 'little') + bytes(100)
    path.write_bytes(handmade(*DESCRIBED, SOUND) + lie)
    messages, complaint = read(path)
    assert [m.data for m in messages] == [b'sound']
    assert f'(a record that claims {2**40} bytes)' in complaint


def test_a_bomb_fills_neither_memory_nor_disk(tmp_path):
    path = tmp_path / 'run.mcap.zstd'
    size = 3 * 2**30
    packer = zstandard.ZstdCompressor().compressobj()
    head = handmade(*DESCRIBED, SOUND) + b'\x05' + (size + 22).to_bytes(8, 'little')
    head += (7).to_bytes(2, 'little') + bytes(20)
    packed = packer.compress(head)
    for _ in range(size // 2**24):
        packed += packer.compress(bytes(2**24))
    path.write_bytes(packed + packer.flush())
    assert path.stat().st_size < 2**20
    assert f'a record that claims {size + 22} bytes' in bounded(path, 300)


def test_many_small_bombs_are_one_bomb(tmp_path):
    path = tmp_path / 'run.mcap'
    # Each by itself could be true, not all of them in one chunk.
    bomb = zstandard.compress(bytes(10 * 2**20))
    messages = [Message(7, 9, bomb, 9, 0) for _ in range(100)]
    together = handmade(*messages)[len(MCAP0_MAGIC) :]
    path.write_bytes(handmade(*DESCRIBED, Chunk('', together, 9, 9, 0, len(together))))
    assert 'a message that claims to be 10485760 bytes unpacked' in bounded(path, 300)
    # Nor in many, when all must wait, since the last message of the file comes first.
    inner = handmade(Message(7, 9, bytes(2**23), 9, 0))[len(MCAP0_MAGIC) :]
    packed = zstandard.compress(inner)
    chunks = [Chunk('zstd', packed, 9, 9, 0, len(inner)) for _ in range(200)]
    path.write_bytes(handmade(*DESCRIBED, *chunks, SOUND))
    assert 'so far out of order that more than' in bounded(path, 500)


@pytest.mark.parametrize(
    ('records', 'complaint'),
    [
        ((Channel(8, '/a\n\x1b[2J', 'cdr', {}, 1),), '(a name that is none)'),
        ((Channel(8, '/' * 5000, 'cdr', {}, 1),), '(a name that is none)'),
        ((Schema(2, b'', 'ros2msg', 'a\x00b'),), '(a name that is none)'),
        ((Message(7, 2**63, b'late', 9, 0),), '(a log time after the year 2262)'),
    ],
)
def test_names_and_times_that_cannot_be_are_damage(tmp_path, records, complaint):
    path = tmp_path / 'run.mcap'
    inner = handmade(*records)[len(MCAP0_MAGIC) :]
    path.write_bytes(handmade(*DESCRIBED, SOUND, Chunk('', inner, 9, 9, 0, len(inner))))
    messages, said = read(path)
    assert [m.data for m in messages] == [b'sound']
    assert complaint in said
    assert said.isprintable()
    assert topics(path) == {'/t': POINT}


def test_a_message_that_unpacks_to_too_much_is_damage(tmp_path):
    path = tmp_path / 'run.mcap'
    bomb = Message(7, 9, zstandard.compress(bytes(2**30)), 9, 0)
    path.write_bytes(handmade(*DESCRIBED, SOUND, bomb))
    assert 'a message that claims to be 1073741824 bytes unpacked' in bounded(path, 300)


@pytest.mark.parametrize(
    'text',
    [
        '[' * 100_000,
        'rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: 2001-99-99}',
        'rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: ["a\\0b"]}',
    ],
)
def test_metadata_that_cannot_be_is_named_in_one_line(tmp_path, text):
    (tmp_path / 'metadata.yaml').write_text(text)
    with pytest.raises(BagError, match=r'metadata\.yaml|is not there') as error:
        bag_files(tmp_path)
    assert '\n' not in str(error.value)


# Written in bulk


def columns(count: int) -> list[tuple[str, type, list[int], list[bytes]]]:
    """Three topics, the third with gaps, all with messages at the same instants."""
    generator = np.random.default_rng(2)
    times = list(range(0, 10 * count, 10))
    listed = [(f'/{name}', Point, times, [generator.bytes(200) for _ in times]) for name in 'ab']
    return [*listed, ('/c', Point, times[::3], [generator.bytes(90) for _ in times[::3]])]


def test_many_are_written_as_if_they_came_singly_in_order(tmp_path):
    given = columns(2700)
    with BagWriter(tmp_path / 'many.mcap') as bag:
        bag.write_many([])
        for third in range(3):
            part = [
                (topic, kind, times[a : a + n], data[a : a + n])
                for topic, kind, times, data in given
                for n in [len(times) // 3]
                for a in [third * n]
            ]
            bag.write_many([*part, ('/none', Point, [], [])])
    singly = sorted(
        (time, place, topic, content)
        for place, (topic, _, times, data) in enumerate(given)
        for time, content in zip(times, data, strict=True)
    )
    expected = [BagMessage(topic, POINT, content, time) for time, _, topic, content in singly]
    assert read(tmp_path / 'many.mcap') == (expected, '')
    with (tmp_path / 'many.mcap').open('rb') as file:
        found = [m for _, _, m in make_reader(file).iter_messages(log_time_order=False)]
    assert [message.data for message in found] == [message.data for message in expected]
    assert found[-1].sequence == 2699


def test_what_we_write_is_what_mcap_writes(tmp_path):
    given = columns(2000)
    with BagWriter(tmp_path / 'ours.mcap') as bag:
        bag.write_many(given)
        bag.add_topic('/empty', Quaternion)
        bag.flush()
        bag.write_raw('/c', Point, b'more', 5)
    messages = list(read_messages(tmp_path / 'ours.mcap'))
    writer = Writer(str(tmp_path / 'theirs.mcap'), chunk_size=256 * 1024)
    writer.start('ros2', 'kinpole_ros')
    qos = {'offered_qos_profiles': ''}
    schema = writer.register_schema(POINT, 'ros2msg', definition(Point).encode())
    ids = {t: writer.register_channel(t, 'cdr', schema, qos) for t in ('/a', '/b', '/c')}
    counts = dict.fromkeys(ids, 0)
    for topic, _, data, time in sorted(messages, key=lambda m: (m.data == b'more', m.log_time)):
        if data == b'more':
            other = writer.register_schema(
                type_name(Quaternion), 'ros2msg', definition(Quaternion).encode()
            )
            writer.register_channel('/empty', 'cdr', other, qos)
            writer.flush()
        writer.add_message(ids[topic], time, data, time, counts[topic])
        counts[topic] += 1
    writer.finish()
    assert len(messages) == 4668
    listed = [
        # mcap also says where the indexes of nothing would be, which the checksum covers.
        [
            record
            for record in StreamReader(str(tmp_path / name), emit_chunks=chunked).records
            if not isinstance(record, Footer) and getattr(record, 'group_length', True)
        ]
        for name in ('ours.mcap', 'theirs.mcap')
        for chunked in (True, False)
    ]
    assert sum(isinstance(record, Chunk) for record in listed[0]) > 3
    # The same records: messages and what describes them, and the whole index with its places.
    assert listed[0] == listed[2]
    assert listed[1] == listed[3]


def test_columns_that_do_not_fit_are_refused(tmp_path):
    with BagWriter(tmp_path / 'out.mcap') as bag:
        with pytest.raises(BagError, match='log time -1 ns'):
            bag.write_many([('/p', Point, [4, -1], [b'', b''])])
        with pytest.raises(ValueError, match="'/p': 2 log times, 1 messages"):
            bag.write_many([('/p', Point, [4, 5], [b''])])
        bag.write_many([('/p', Point, [6], [b'x'])])
        with pytest.raises(BagError, match=r"'/p' holds geometry_msgs/msg/Point"):
            bag.write_many([('/p', Quaternion, [7], [b''])])
    assert [m.log_time for m in read_messages(tmp_path / 'out.mcap')] == [6]


def test_corrupted_bags_are_read_or_refused_soon_and_in_little_memory(tmp_path):
    outcomes = fuzz_bags(300, seed=3, folder=tmp_path)
    assert sum(outcomes.values()) == 300
    assert min(outcomes[name] for name in ('read', 'BagError', 'Truncated')) > 10


@pytest.mark.parametrize('mode', ['FILE', 'MESSAGE'])
def test_what_rosbags_compresses_is_read(tmp_path, mode):
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    typesys = pytest.importorskip('rosbags.typesys')
    if not hasattr(rosbag2, 'StoragePlugin'):
        pytest.skip('this rosbags writes sqlite3 only')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    plain = [b'\x00\x01\x00\x00' + bytes([k]) * 24 for k in range(50)]
    writer = rosbag2.Writer(tmp_path / 'bag', version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
    writer.set_compression(getattr(rosbag2.CompressionMode, mode), rosbag2.CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection('/p', POINT, typestore=store)
        for k, data in enumerate(plain):
            writer.write(connection, k, data)
    assert read(tmp_path / 'bag') == (
        [BagMessage('/p', POINT, d, k) for k, d in enumerate(plain)],
        '',
    )
    assert topics(tmp_path / 'bag') == {'/p': POINT}
