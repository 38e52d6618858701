"""A chunk of a bag: the messages that wait for it, and its records once it is full."""

import struct
import zlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex, McapRecord

# What a kill can lose, and what a reader must hold: small enough for both, large for zstd.
CHUNK_SIZE = 256 * 1024
# Opcode, length, channel, sequence, log time, publish time: all before the data of a message; and
# the same of many.
MESSAGE_HEAD = struct.Struct('<BQHIQQ')
HEADS = np.dtype(
    [
        ('opcode', 'u1'),
        ('length', '<u8'),
        ('channel', '<u2'),
        ('sequence', '<u4'),
        ('log_time', '<u8'),
        ('publish_time', '<u8'),
    ]
)
# Of these bytes so many are in the length of the record.
COUNTED = HEADS.itemsize - 9
_INDEX_HEAD = struct.Struct('<BQHI')  # opcode, length, channel, bytes of index to come


class FinishedChunk(NamedTuple):
    """The records of a chunk and of the indexes behind it, its entry in the summary, its times."""

    records: bytes
    entry: bytes
    earliest: int
    latest: int


class PendingChunk:
    """Records not written yet: sizes, channels (0 for those that are no messages), log times."""

    def __init__(self) -> None:
        self.content: list[bytes] = []
        self.sizes: list[int] = []
        self.channels: list[int] = []
        self.times: list[int] = []
        self.size = 0

    def add(self, record: bytes, channel: int = 0, time: int = 0) -> None:
        self.content.append(record)
        self.sizes.append(len(record))
        self.channels.append(channel)
        self.times.append(time)
        self.size += len(record)

    def extend(self, heads: np.ndarray, data: Sequence[bytes]) -> None:
        """Take messages: their `HEADS` (n,) and what follows these."""
        size = HEADS.itemsize
        packed = heads.tobytes()
        pieces = [b''] * (2 * len(data))
        pieces[::2] = [packed[first : first + size] for first in range(0, len(packed), size)]
        pieces[1::2] = data
        self.content += pieces
        sizes = heads['length'] + np.uint64(size - COUNTED)
        self.sizes += sizes.tolist()
        self.channels += heads['channel'].tolist()
        self.times += heads['log_time'].tolist()
        self.size += int(sizes.sum())

    def finish(self, place: int) -> FinishedChunk | None:
        """The chunk as it is to be written at this place of the file; None without messages."""
        channels = np.array(self.channels)
        if not channels.any():
            return None
        content = b''.join(self.content)
        ends = np.cumsum(self.sizes)
        starts = np.concatenate(([0], ends[:-1]))
        places = np.empty((len(starts), 2), '<u8')
        places[:, 0], places[:, 1] = self.times, starts
        times = places[channels > 0, 0]
        earliest, latest = int(times.min()), int(times.max())
        compressed = zstandard.compress(content)
        chunk = packed(
            Chunk(
                compression='zstd',
                data=compressed,
                message_start_time=earliest,
                message_end_time=latest,
                uncompressed_crc=zlib.crc32(content),
                uncompressed_size=len(content),
            )
        )
        offsets = {}
        indexes = bytearray()
        for number in dict.fromkeys(channels[channels > 0].tolist()):
            offsets[number] = place + len(chunk) + len(indexes)
            pairs = places[channels == number].tobytes()
            indexes += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(pairs), number, len(pairs))
            indexes += pairs
        entry = ChunkIndex(
            chunk_start_offset=place,
            chunk_length=len(chunk),
            message_start_time=earliest,
            message_end_time=latest,
            message_index_offsets=offsets,
            message_index_length=len(indexes),
            compression='zstd',
            compressed_size=len(compressed),
            uncompressed_size=len(content),
        )
        return FinishedChunk(chunk + indexes, packed(entry), earliest, latest)


def packed(*records: McapRecord) -> bytes:
    """Records as they are in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())
