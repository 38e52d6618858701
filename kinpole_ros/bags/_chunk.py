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
# An entry of the map in a ChunkIndex: where in the file the index of a channel is.
_OFFSETS = np.dtype([('channel', '<u2'), ('place', '<u8')])
# Opcode and length of a ChunkIndex, what is before its map, and the bytes of the map.
_ENTRY_HEAD, _BEFORE_MAP, _MAP_SIZE = struct.Struct('<BQ'), 32, struct.Struct('<I')


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
        is_message = channels > 0
        indexes, offsets = _message_indexes(channels[is_message], places[is_message])
        offsets['place'] += np.uint64(place + len(chunk))
        entry = ChunkIndex(
            chunk_start_offset=place,
            chunk_length=len(chunk),
            message_start_time=earliest,
            message_end_time=latest,
            message_index_offsets={},
            message_index_length=len(indexes),
            compression='zstd',
            compressed_size=len(compressed),
            uncompressed_size=len(content),
        )
        return FinishedChunk(chunk + indexes, _with_offsets(entry, offsets), earliest, latest)


def _message_indexes(channels: np.ndarray, places: np.ndarray) -> tuple[bytes, np.ndarray]:
    """
    Pack the index records of messages, and list where each begins, as `_OFFSETS`, from the first.

    `channels` (n,) are those of the messages, `places` (n, 2) their times and where they begin.
    Channels come in the order of their first messages.
    """
    _, firsts, numbers, counts = np.unique(
        channels, return_index=True, return_inverse=True, return_counts=True
    )
    by_first = firsts.argsort()
    rank = np.empty_like(by_first)
    rank[by_first] = np.arange(len(by_first))
    pairs = places[rank[numbers].argsort(kind='stable')].tobytes()
    sizes = counts[by_first] * places.strides[0]
    offsets = np.empty(len(by_first), _OFFSETS)
    offsets['channel'] = channels[firsts[by_first]]
    offsets['place'] = np.cumsum(sizes + _INDEX_HEAD.size) - sizes - _INDEX_HEAD.size
    pieces, end = [], 0
    for channel, size in zip(offsets['channel'].tolist(), sizes.tolist(), strict=True):
        pieces.append(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size))
        pieces.append(pairs[end : end + size])
        end += size
    return b''.join(pieces), offsets


def _with_offsets(entry: ChunkIndex, offsets: np.ndarray) -> bytes:
    """Pack an entry without offsets, with these: mcap packs thousands of them one by one."""
    record, listed = packed(entry), offsets.tobytes()
    opcode, length = _ENTRY_HEAD.unpack_from(record)
    before = _ENTRY_HEAD.size + _BEFORE_MAP
    head = _ENTRY_HEAD.pack(opcode, length + len(listed)) + record[_ENTRY_HEAD.size : before]
    return head + _MAP_SIZE.pack(len(listed)) + listed + record[before + _MAP_SIZE.size :]


def packed(*records: McapRecord) -> bytes:
    """Records as they are in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())
