"""
What an MCAP file says of itself, held against what was read of it: loss must not pass unseen.

A chunk that is gone leaves a file that can be read from end to end. But its statistics, the index
of its chunks, their indexes of messages and the checksum of its data still tell of it.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Collection, Mapping
from contextlib import suppress
from io import BytesIO
from typing import BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, DataEnd, Footer, Statistics

CLAIMING = (Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.DATA_END, Opcode.FOOTER)
_SUM = 4  # bytes of a checksum, at the end of what it covers and of its record
_INDEX = struct.Struct('<BQHI')  # opcode, length, channel, bytes of index to come
_HEAD = 9  # bytes of opcode and length of a record
_PIECE = 1 << 20  # bytes read at a time


class Claims:
    """What the records of a file say that it holds; what they leave out is not asked for."""

    def __init__(self) -> None:
        self._statistics: Statistics | None = None
        self._chunks: set[int] = set()
        # Where the data and the summary begin and end, and the checksums of both.
        self._sums: dict[str, tuple[int, int, int]] = {}

    def note(self, opcode: int, body: bytes, offset: int) -> None:
        """Take note of a record, one of those CLAIMING, that begins at `offset`."""
        stream = ReadDataStream(BytesIO(body))
        # One that is damaged tells nothing.
        with suppress(Exception):
            if opcode == Opcode.STATISTICS:
                self._statistics = Statistics.read(stream)
            elif opcode == Opcode.CHUNK_INDEX:
                self._chunks.add(ChunkIndex.read(stream).chunk_start_offset)
            elif opcode == Opcode.DATA_END:
                self._sums['data'] = 0, offset, DataEnd.read(stream).data_section_crc
            elif opcode == Opcode.FOOTER:
                footer = Footer.read(stream)
                end = offset + _HEAD + len(body) - _SUM
                self._sums['summary'] = footer.summary_start, end, footer.summary_crc

    def lacking(self, chunks: Collection[int]) -> str:
        """What is wrong with the chunks, by where they begin; '' if nothing."""
        if self._chunks and self._chunks != set(chunks):
            if len(self._chunks) == len(chunks):
                return 'its index names chunks at places where there are others'
            return f'its index names {_number(len(self._chunks), "chunk")}, there are {len(chunks)}'
        if self._statistics is not None and self._statistics.chunk_count != len(chunks):
            number = _number(self._statistics.chunk_count, 'chunk')
            return f'its statistics count {number}, there are {len(chunks)}'
        return ''

    def miscounted(self, counts: Mapping[str, int], topics: Mapping[int, str]) -> str:
        """What is wrong with how many messages there are on topics, these by channel; or ''."""
        claimed: Counter[str] = Counter()
        if self._statistics is not None and self._statistics.channel_message_counts:
            for channel, topic in topics.items():
                claimed[topic] += self._statistics.channel_message_counts.get(channel, 0)
            for topic in claimed | Counter(counts):
                if claimed[topic] != counts.get(topic, 0):
                    number = _number(claimed[topic], 'message')
                    there = counts.get(topic, 0)
                    return f'its statistics count {number} on {topic}, there are {there}'
        return ''

    def untimely(self, first: int, last: int) -> str:
        """What is wrong with messages from `first` to `last`, log times in ns; '' if nothing."""
        known = self._statistics
        if known is None or known.message_start_time <= first <= last <= known.message_end_time:
            return ''
        span = f'{known.message_start_time / 1e9:.3f} to {known.message_end_time / 1e9:.3f} s'
        there = f'{first / 1e9:.3f} to {last / 1e9:.3f} s'
        return f'its statistics tell of log times {span}, there are {there}'

    def wrong_sum(self, file: BinaryIO) -> str:
        """What is wrong with the checksums of data and summary, if there are any; '' if nothing."""
        for what, (start, end, claimed) in self._sums.items():
            if not claimed:
                continue
            file.seek(min(start, end))
            left, found = end - start, 0
            while left > 0 and (piece := file.read(min(left, _PIECE))):
                found = zlib.crc32(piece, found)
                left -= len(piece)
            if found != claimed:
                return f'the checksum of its {what} is wrong'
        return ''


def indexed_times(index: bytes, channels: Collection[int]) -> list[int]:
    """Log times, in order, of the messages of these channels by a chunk's indexes of messages."""
    times: list[int] = []
    start, end = 0, len(index)
    while start < end:
        opcode, length, channel, size = _INDEX.unpack_from(index, start)
        if opcode != Opcode.MESSAGE_INDEX or length != 6 + size or size % 16:
            raise ValueError('no index of messages')
        start += _INDEX.size
        if channel in channels:
            times += np.frombuffer(index, '<u8', size // 8, start)[::2].tolist()
        start += size
    times.sort()
    return times


def _number(count: int, what: str) -> str:
    return f'{count} {what}{"s"[: count != 1]}'
