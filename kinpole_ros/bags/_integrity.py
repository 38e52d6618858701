"""What an MCAP file records of its own content, compared with what was read.

A chunk that is missing leaves a file that can be read from end to end. But its statistics, the
index of its chunks, their message indexes and the checksum of its data still show the loss.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Collection, Mapping
from contextlib import suppress
from io import BytesIO
from typing import BinaryIO, ClassVar

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, DataEnd, Footer, Statistics

_CHECKSUM_BYTES = 4  # at the end of the record, and of what it covers
_INDEX = struct.Struct('<BQHI')  # opcode, length, channel, bytes of entries
_HEAD_BYTES = 9  # opcode and length of a record
_READ_BYTES = 1 << 20  # at a time


class Integrity:
    """The statistics, chunk index and checksums of a file; those it lacks are not checked."""

    OPCODES: ClassVar = (Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.DATA_END, Opcode.FOOTER)

    def __init__(self) -> None:
        self._statistics: Statistics | None = None
        self._chunks: set[int] = set()
        # Start and end (bytes) of the data and of the summary, and their checksums.
        self._checksums: dict[str, tuple[int, int, int]] = {}

    def add(self, opcode: int, body: bytes, offset: int) -> None:
        """Add a record, one of OPCODES, that begins at `offset`; a damaged one is ignored."""
        stream = ReadDataStream(BytesIO(body))
        with suppress(Exception):
            if opcode == Opcode.STATISTICS:
                self._statistics = Statistics.read(stream)
            elif opcode == Opcode.CHUNK_INDEX:
                self._chunks.add(ChunkIndex.read(stream).chunk_start_offset)
            elif opcode == Opcode.DATA_END:
                self._checksums['data'] = 0, offset, DataEnd.read(stream).data_section_crc
            elif opcode == Opcode.FOOTER:
                footer = Footer.read(stream)
                end = offset + _HEAD_BYTES + len(body) - _CHECKSUM_BYTES
                self._checksums['summary'] = footer.summary_start, end, footer.summary_crc

    def chunk_fault(self, chunks: Collection[int]) -> str:
        """Compare the chunks, by their offsets; return what is wrong, '' if nothing."""
        if self._chunks and self._chunks != set(chunks):
            if len(self._chunks) == len(chunks):
                return 'its index names chunks at places where there are others'
            return (
                f'its index names {_counted(len(self._chunks), "chunk")}, there are {len(chunks)}'
            )
        if self._statistics is not None and self._statistics.chunk_count != len(chunks):
            number = _counted(self._statistics.chunk_count, 'chunk')
            return f'its statistics count {number}, there are {len(chunks)}'
        return ''

    def count_fault(self, counts: Mapping[str, int], topics: Mapping[int, str]) -> str:
        """Compare the numbers of messages by topic; `topics` are by channel."""
        if self._statistics is None or not self._statistics.channel_message_counts:
            return ''
        claimed: Counter[str] = Counter()
        for channel, topic in topics.items():
            claimed[topic] += self._statistics.channel_message_counts.get(channel, 0)
        for topic in claimed | Counter(counts):
            count = counts.get(topic, 0)
            if claimed[topic] != count:
                number = _counted(claimed[topic], 'message')
                return f'its statistics count {number} on {topic}, there are {count}'
        return ''

    def time_fault(self, first: int, last: int) -> str:
        """Compare the earliest and the latest log time, ns."""
        claim = self._statistics
        if claim is None or claim.message_start_time <= first <= last <= claim.message_end_time:
            return ''
        claimed_span = f'{claim.message_start_time / 1e9:.3f} to {claim.message_end_time / 1e9:.3f}'
        read_span = f'{first / 1e9:.3f} to {last / 1e9:.3f}'
        return f'its statistics tell of log times {claimed_span} s, there are {read_span} s'

    def checksum_fault(self, file: BinaryIO) -> str:
        """Compare the checksums of data and summary."""
        for section, (start, end, claimed) in self._checksums.items():
            if not claimed:
                continue
            file.seek(min(start, end))
            remaining, checksum = end - start, 0
            while remaining > 0 and (data := file.read(min(remaining, _READ_BYTES))):
                checksum = zlib.crc32(data, checksum)
                remaining -= len(data)
            if checksum != claimed:
                return f'the checksum of its {section} is wrong'
        return ''


def indexed_times(index: bytes, channels: Collection[int]) -> list[int]:
    """Return the sorted log times in the message indexes of a chunk, of these channels."""
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


def _counted(count: int, noun: str) -> str:
    return f'{count} {noun}{"s"[: count != 1]}'
