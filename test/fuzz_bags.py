"""
Corrupted bags by the thousand: each is read, or refused in one line, soon and in little memory.

What is lost of one is told of, unless no record of the file can tell: a message that no checksum
covers may change unseen, and these are counted.

`python test/fuzz_bags.py [COUNT [SEED]]` runs as many as you like, 10,000 unless told; the test
suite runs a few hundred. Damage is done to the bytes, to the order, lengths and contents of
records, and inside chunks that are then compressed again with their checksums put right, so that
it is not only the checksum that finds it.
"""

import random
import struct
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import yaml
import zstandard
from fuzzing import EXTREMES, damaged, fuzz, tell
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType, Writer

from kinpole_ros.bags import (
    BagError,
    BagMessage,
    definition,
    read_blocks,
    read_messages,
    replay,
    topics,
    type_name,
)
from kinpole_ros.messages import serialize_message, to_message
from kinpole_ros.settings import Settings

_HEAD = struct.Struct('<BQ')


class Bag(NamedTuple):
    """The bytes of a bag, and the messages of the sound one that they were made from."""

    content: bytes
    original: list[BagMessage]


def fuzz_bags(count: int, seed: int = 0, folder: str | Path | None = None) -> Counter[str]:
    """
    Read `count` bags with damage that follows from `seed`; returns how many ended in which way.

    Raises AssertionError, with the last one left in `folder`, for one that ends in anything but
    messages or a BagError of one line, that lost messages by its own records and does not say so,
    or that breaks a limit of `fuzz`. To go on from what got
    farthest was tried and reached no more lines: this damage knows records and chunks.
    """
    place = Path(folder or tempfile.mkdtemp(prefix='fuzz_bags_'))
    generator = random.Random(seed)
    sound = _sound_bags(place)

    def damage(generator: random.Random, bag: Bag) -> Bag:
        return bag._replace(content=_fuzzed(generator, bag.content))

    def ending(subject: Bag) -> str:
        bag, original = place / 'fuzzed.mcap', subject.original
        if generator.random() < 0.05:
            bag = _fuzzed_folder(generator, place / 'folder', generator.choice(sound).content)
            original = None
        else:
            bag.write_bytes(subject.content)
        return _ending(bag, original, with_replay=generator.random() < 0.2)

    return fuzz(count, generator, place, sound, damage, ending)


def _ending(bag: Path, original: list[BagMessage] | None, with_replay: bool) -> str:
    unseen = False
    try:
        topics(bag)
        found = [message for block in read_blocks(bag) for message in block]
        assert all(isinstance(message.data, bytes) for message in found)
        if original is not None and Counter(found) != Counter(original):
            known_by = _known_by(bag.read_bytes())
            assert known_by(found) == known_by(original), 'messages were lost without a word'
            unseen = True
        if with_replay:
            replay(bag, Settings())
    except BagError as error:
        text = str(error)
        assert text.isprintable()
        assert str(bag) in text
        return type(error).__name__
    return 'changed where no checksum is' if unseen else 'read'


def _known_by(content: bytes) -> Callable[[list[BagMessage]], object]:
    """What of messages a whole file has records of, beside the messages themselves."""
    if content.startswith(zstandard.FRAME_HEADER):
        content = zstandard.ZstdDecompressor().decompressobj().decompress(content)
    records = records_of(content)
    opcodes = {record[0] for record in records}
    for record in records:
        if record[0] == Opcode.DATA_END:
            assert record.endswith(bytes(4)), 'a checksum is wrong without a word'
    if Opcode.STATISTICS not in opcodes:
        return lambda messages: None
    return lambda messages: Counter((m.topic, m.type_name) for m in messages)


_OPTIONS: tuple[dict[str, Any], ...] = (
    {},
    {'use_chunking': False},
    {'use_chunking': False, 'enable_data_crcs': True},
    {'index_types': IndexType.NONE},
)


def _sound_bags(place: Path) -> list[Bag]:
    """Small bags of markers and something else, of every way to lay out a file."""
    generator = np.random.default_rng(0)
    names = ['a', 'b', 'c']
    kinds = ('point_cloud2', 'marker_array')
    found = []
    for kind in kinds:
        messages = [
            to_message(kind, stamp, 'world', names, generator.random((3, 3)))
            for stamp in range(10**9, 2 * 10**9, 10**8)
        ]
        data = [bytes(serialize_message(message)) for message in messages]
        schema = (type_name(type(messages[0])), definition(type(messages[0])).encode())
        for compression in CompressionType:
            for options in _OPTIONS:
                path = place / 'sound.mcap'
                writer = Writer(str(path), chunk_size=1500, compression=compression, **options)
                writer.start('ros2', 'fuzz')
                described = writer.register_schema(schema[0], 'ros2msg', schema[1])
                ids = [writer.register_channel(t, 'cdr', described) for t in ('/markers', '/b')]
                for k, content in enumerate(data):
                    packed = zstandard.compress(content) if k % 2 and not options else content
                    for channel, body in zip(ids, (content, packed), strict=True):
                        writer.add_message(channel, 10**9 + k, body, 10**9 + k, k)
                writer.finish()
                found.append(Bag(path.read_bytes(), [*read_messages(path)]))
    return found


def _fuzzed(generator: random.Random, content: bytes) -> bytes:
    if generator.random() < 0.6:
        records = records_of(content)
        if generator.random() < 0.5:
            records = [_fuzzed_chunk(generator, record) for record in records]
        for _ in range(generator.randint(0, 3)):
            generator.choice(_RECORD_DAMAGE)(generator, records)
        content = MCAP0_MAGIC + b''.join(records) + MCAP0_MAGIC
    if generator.random() < 0.6:
        content = damaged(generator, content)
    if generator.random() < 0.15:
        content = zstandard.compress(content)
        if generator.random() < 0.5:
            content = damaged(generator, content)
    return content


def records_of(content: bytes) -> list[bytes]:
    """The records of a sound file, or of a chunk."""
    at, end = 0, len(content)
    if content.startswith(MCAP0_MAGIC):
        at, end = len(MCAP0_MAGIC), len(content) - len(MCAP0_MAGIC)
    found = []
    while at < end:
        size = _HEAD.size + _HEAD.unpack_from(content, at)[1]
        found.append(content[at : at + size])
        at += size
    return found


def _fuzzed_chunk(generator: random.Random, record: bytes) -> bytes:
    """A chunk with damage inside of what it compresses, and its checksum mostly right."""
    if record[0] != Opcode.CHUNK:
        return record
    chunk = Chunk.read(ReadDataStream(BytesIO(record[_HEAD.size :])))
    inner = chunk.data
    if chunk.compression == 'zstd':
        inner = zstandard.decompress(inner)
    elif chunk.compression == 'lz4':
        inner = lz4.frame.decompress(inner)
    records = records_of(inner)
    for _ in range(generator.randint(0, 2)):
        generator.choice(_RECORD_DAMAGE)(generator, records)
    inner = b''.join(records)
    if generator.random() < 0.3:
        inner = damaged(generator, inner)
    chunk.uncompressed_size = generator.choice((len(inner),) * 5 + EXTREMES)
    chunk.uncompressed_crc = generator.choice((zlib.crc32(inner), 0, 0, 1))
    pack: dict[str, Callable[[bytes], bytes]] = {
        'zstd': zstandard.compress,
        'lz4': lz4.frame.compress,
        '': bytes,
    }
    chunk.data = pack[chunk.compression](inner)
    if generator.random() < 0.02:
        chunk.compression, chunk.data = 'zstd', _bomb()
        chunk.uncompressed_size = generator.choice((1000, 2**30, *EXTREMES))
    builder = RecordBuilder()
    chunk.write(builder)
    return bytes(builder.end())


@cache
def _bomb() -> bytes:
    """A gigabyte in some 30 kB."""
    packer = zstandard.ZstdCompressor().compressobj()
    packed = b''.join(packer.compress(bytes(2**24)) for _ in range(64))
    return packed + packer.flush()


def _exchange(generator: random.Random, records: list[bytes]) -> None:
    if records:
        at, other = generator.randrange(len(records)), generator.randrange(len(records))
        records[at], records[other] = records[other], records[at]


def _repeat(generator: random.Random, records: list[bytes]) -> None:
    if records:
        record = generator.choice(records)
        at = generator.randrange(len(records))
        records[at:at] = [record] * generator.choice((1, 3, 300))


def _drop(generator: random.Random, records: list[bytes]) -> None:
    if records:
        del records[generator.randrange(len(records))]


def _lie(generator: random.Random, records: list[bytes]) -> None:
    """Give a record another length or opcode."""
    if records:
        at = generator.randrange(len(records))
        opcode, length = _HEAD.unpack_from(records[at])
        if generator.random() < 0.5:
            length = generator.choice((*EXTREMES, length ^ 1, length >> 1))
        else:
            opcode = generator.randrange(256)
        records[at] = _HEAD.pack(opcode, length) + records[at][_HEAD.size :]


def _change(generator: random.Random, records: list[bytes]) -> None:
    """Damage a record behind its head."""
    if records:
        at = generator.randrange(len(records))
        head, body = records[at][: _HEAD.size], records[at][_HEAD.size :]
        records[at] = head + damaged(generator, body)[: len(body)].ljust(len(body), b'\0')


_RECORD_DAMAGE = (_exchange, _repeat, _drop, _lie, _change)


def _fuzzed_folder(generator: random.Random, folder: Path, content: bytes) -> Path:
    """A folder of split files whose metadata is damaged, or else one of its files."""
    folder.mkdir(exist_ok=True)
    names = ['run_0.mcap', 'run_1.mcap']
    about = {
        'version': 9,
        'storage_identifier': 'mcap',
        'compression_format': generator.choice(('', 'zstd')),
        'compression_mode': generator.choice(('', 'FILE', 'MESSAGE')),
        'relative_file_paths': names,
        'duration': {'nanoseconds': 10**9},
    }
    text = yaml.safe_dump({'rosbag2_bagfile_information': about}).encode()
    if generator.random() < 0.7:
        text = damaged(generator, text)
    (folder / 'metadata.yaml').write_bytes(text)
    for name in names:
        (folder / name).write_bytes(content)
        if generator.random() < 0.3:
            (folder / name).write_bytes(_fuzzed(generator, content))
    return folder


if __name__ == '__main__':
    tell('bags', 10_000, fuzz_bags)
