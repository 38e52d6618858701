"""What a bag lost is told of where its statistics or checksums tell, and the rest of it is read."""

import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from fuzz_bags import records_of
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType, Writer

from kinpole_ros.bags import BagError, BagMessage, Truncated, read_messages
from kinpole_ros.tools.cli import main

COUNT = 200


def written(path: Path, **options) -> list[bytes]:
    """The records of a bag of COUNT messages on each of two topics, in small chunks."""
    with open(path, 'wb') as file:
        writer = Writer(file, chunk_size=1500, **options)
        writer.start('ros2', 'test')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        ids = [writer.register_channel(topic, 'cdr', schema) for topic in ('/a', '/b')]
        for k in range(COUNT):
            for channel in ids:
                data = f'{k:04d}'.encode() * 10
                writer.add_message(channel, 10**9 + 10 * k + channel, data, 10**9, k)
        writer.finish()
    return records_of(path.read_bytes())


def read(path: Path, *topics: str) -> tuple[list[BagMessage], str]:
    messages: list[BagMessage] = []
    try:
        for message in read_messages(path, topics or None):
            messages.append(message)
    except Truncated as error:
        assert str(error).isprintable()
        return messages, str(error)
    return messages, ''


def put(path: Path, records: list[bytes]) -> None:
    path.write_bytes(MCAP0_MAGIC + b''.join(records) + MCAP0_MAGIC)


def at(records: list[bytes], opcode: int) -> int:
    """The place of the record in the middle of those of this kind."""
    places = [k for k, record in enumerate(records) if record[0] == opcode]
    return places[len(places) // 2]


def rechunked(record: bytes, change: Callable[[list[bytes]], None]) -> bytes:
    """A chunk whose records were changed, its size and checksum right."""
    chunk = Chunk.read(ReadDataStream(BytesIO(record[9:])))
    unpack = {'zstd': zstandard.decompress, 'lz4': lz4.frame.decompress, '': bytes}
    pack = {'zstd': zstandard.compress, 'lz4': lz4.frame.compress, '': bytes}
    inner = records_of(unpack[chunk.compression](chunk.data))
    change(inner)
    content = b''.join(inner)
    chunk.data = pack[chunk.compression](content)
    chunk.uncompressed_size, chunk.uncompressed_crc = len(content), zlib.crc32(content)
    builder = RecordBuilder()
    chunk.write(builder)
    return bytes(builder.end())


def without_a_chunk(records: list[bytes]) -> None:
    del records[at(records, Opcode.CHUNK)]


def without_a_chunk_and_its_index(records: list[bytes]) -> None:
    del records[at(records, Opcode.CHUNK)]
    del records[at(records, Opcode.CHUNK_INDEX)]


def with_one_chunk_for_another(records: list[bytes]) -> None:
    place = at(records, Opcode.CHUNK)
    del records[place]
    records.insert(place, next(record for record in records if record[0] == Opcode.CHUNK))


def with_a_chunk_of_another_kind(records: list[bytes]) -> None:
    place = at(records, Opcode.CHUNK)
    records[place] = b'\x81' + records[place][1:]


def with_a_chunk_twice(records: list[bytes]) -> None:
    place = at(records, Opcode.CHUNK)
    records.insert(place, records[place])


def in_the_middle(records: list[bytes], change: Callable[[list[bytes], int], None]) -> None:
    place = at(records, Opcode.CHUNK)
    records[place] = rechunked(records[place], lambda inner: change(inner, len(inner) // 2))


def without_a_message(records: list[bytes]) -> None:
    in_the_middle(records, lambda inner, k: inner.pop(k))


def without_the_end_of_the_data(records: list[bytes]) -> None:
    del records[at(records, Opcode.CHUNK) :]
    records += whole_summary


def without_a_plain_message(records: list[bytes]) -> None:
    del records[at(records, Opcode.MESSAGE)]


def with_a_plain_message_changed(records: list[bytes]) -> None:
    place = at(records, Opcode.MESSAGE)
    records[place] = records[place][:-1] + b'!'


whole_summary: list[bytes] = []
CHUNKED = [
    without_a_chunk,
    without_a_chunk_and_its_index,
    with_one_chunk_for_another,
    with_a_chunk_of_another_kind,
    with_a_chunk_twice,
    without_a_message,
    without_the_end_of_the_data,
]
PLAIN = [without_a_plain_message, with_a_plain_message_changed]


@pytest.mark.parametrize('packed', [False, True], ids=['', 'packed'])
@pytest.mark.parametrize(
    ('spoil', 'options'),
    [(spoil, {'compression': kind}) for spoil in CHUNKED for kind in CompressionType]
    + [(spoil, {'use_chunking': False, 'enable_data_crcs': True}) for spoil in PLAIN]
    + [(without_a_plain_message, {'use_chunking': False})]
    + [(without_a_chunk, {'index_types': IndexType.NONE})],
)
def test_what_was_lost_is_told_of_and_the_rest_is_read(tmp_path, spoil, options, packed) -> None:
    path = tmp_path / 'run.mcap'
    records = written(path, **options)
    sound, complaint = read(path)
    assert (len(sound), complaint) == (2 * COUNT, '')
    end = next(k for k, record in enumerate(records) if record[0] == Opcode.DATA_END)
    whole_summary[:] = records[end:]
    spoil(records)
    put(path, records)
    if packed:
        path.write_bytes(zstandard.compress(path.read_bytes()))
    for topics in ((), ('/a',), ('/b',)):
        messages, complaint = read(path, *topics)
        wanted = [m for m in sound if not topics or m.topic in topics]
        assert 'fix: ' in complaint or (topics and messages == wanted)
        assert len(messages) >= 0.4 * len(wanted)
        if 'with_' not in spoil.__name__:
            assert set(messages) <= set(wanted)


def test_descriptions_that_contradict_each_other_are_told_of(tmp_path) -> None:
    path = tmp_path / 'run.mcap'
    records = written(path, use_chunking=False)
    schema, channel = (
        next(k for k, record in enumerate(records) if record[0] == opcode)
        for opcode in (Opcode.SCHEMA, Opcode.CHANNEL)
    )
    renamed = records[channel].replace(b'/a', b'/c')
    put(path, [*records[:channel], renamed, *records[channel + 1 :]])
    assert 'it describes channel 1 in two ways' in read(path, '/a')[1]
    # The first to be found is the one behind the messages.
    del records[schema]
    put(path, records)
    assert '(a message of channel 1, which is not described)' in read(path)[1]
    with pytest.raises(BagError, match="topic '/a' has messages in 'cdr' of type ''"):
        read(path, '/a')


@pytest.fixture
def spoiled(tmp_path) -> tuple[Path, Path]:
    """A bag of markers, and its results, both without a chunk."""
    bag, result = tmp_path / 'bag.mcap', tmp_path / 'result.mcap'
    words = ['--duration', '0.5', '--rate', '400', '--noise', '1e-5', '--output', str(bag)]
    assert main(['simulate', 'cardan', *words]) == 0
    assert main(['replay', str(bag), '--output', str(result)]) == 0
    for path in (bag, result):
        records = records_of(path.read_bytes())
        without_a_chunk(records)
        put(path, records)
    return bag, result


def test_every_command_that_reads_a_bag_tells_what_it_lost(spoiled, tmp_path, capsys) -> None:
    pytest.importorskip('matplotlib')
    bag, result = spoiled
    capsys.readouterr()
    for words in (
        ['replay', bag, '--csv', tmp_path / 'out.csv'],
        ['plot', result, '--output', tmp_path / 'out.png'],
        ['discover', bag, '--output', tmp_path / 'out.yaml'],
    ):
        assert main([str(word) for word in words]) == 2
        assert Path(words[-1]).stat().st_size > 100
        said = capsys.readouterr().err.splitlines()[-1]
        assert f'{words[1]} has lost messages, or was changed: its statistics' in said
