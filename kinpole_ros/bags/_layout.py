"""The layout of an MCAP file, found by the heads of its records, and signs of lost messages.

mcap's own reader gives up on a file without a good end, and trusts the sizes a file claims.
"""

import io
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, ClassVar

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from kinpole_ros.bags._channels import (
    HEAD,
    LARGEST,
    LARGEST_CHUNK,
    MESSAGE,
    largest,
    parse_description,
)
from kinpole_ros.bags._files import BagError, Unpacked

NEVER = 2**64  # later than any log time
_FARTHEST = 2**62  # bytes: beyond the end of any file
_TIME = struct.Struct('<Q')
_SPAN_OPCODES = (Opcode.CHUNK, Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL)
_RUN_BYTES = 1 << 20  # messages outside of chunks are read in runs of this size
_LZ4_PIECE = 1 << 20  # bytes that lz4 unpacks at a time

_CHECKSUM_BYTES = 4  # at the end of the record, and of what it covers
_INDEX = struct.Struct('<BQHI')  # opcode, length, channel, bytes of entries
_READ_BYTES = 1 << 20  # at a time, for a checksum


class Integrity:
    """
    The statistics, chunk index and checksums that a file records of itself.

    A chunk that is missing leaves a file that can be read from end to end, but these, and the
    message indexes of its chunks, still show the loss. Records that a file lacks are not checked.
    """

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
                end = offset + HEAD.size + len(body) - _CHECKSUM_BYTES
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


@dataclass
class Span:
    """A chunk, or a run of records outside of chunks, with messages or their descriptions."""

    offset: int
    length: int
    is_chunk: bool
    time: int  # the earliest log time, ns
    index_length: int = 0  # bytes of message indexes behind a chunk
    channels: set[int] = field(default_factory=set)  # in these indexes

    @property
    def end(self) -> int:
        return self.offset + self.length


@dataclass
class Layout:
    """The spans of a file in file order, and what is wrong with the file ('' if nothing)."""

    size: int  # bytes, unpacked, that can be read
    spans: list[Span] = field(default_factory=list)
    trouble: str = ''  # where reading ends before the end of the file
    doubt: str = ''  # what contradicts the file's own statistics and indexes
    integrity: Integrity = field(default_factory=Integrity)
    data_end: int = _FARTHEST
    # Schemas and channels in the summary behind the data.
    summary: list[Schema | Channel] = field(default_factory=list)

    @property
    def channels(self) -> dict[int, str]:
        """Topics by channel, if the summary describes all channels; else empty."""
        schemas = {0, *(record.id for record in self.summary if isinstance(record, Schema))}
        listed = [record for record in self.summary if isinstance(record, Channel)]
        topics = {record.id: record.topic for record in listed}
        is_complete = all(record.schema_id in schemas for record in listed) and all(
            bool(span.channels) and span.channels <= topics.keys()
            if span.is_chunk
            else span.offset > self.data_end
            for span in self.spans
        )
        return topics if is_complete else {}


def lay_out(path: Path, file: BinaryIO) -> Layout:
    """Return the layout of an open file."""
    disk_size = path.stat().st_size
    raw = getattr(file, 'raw', None)
    layout = Layout(_FARTHEST if isinstance(raw, Unpacked) else disk_size)
    try:
        _scan(file, layout, disk_size)
    except ValueError as error:
        layout.trouble = f'is damaged at byte {layout.size} ({error})'
    if isinstance(raw, Unpacked) and raw.trouble:
        layout.trouble = f'is damaged at byte {layout.size} of its content ({raw.trouble})'
    return layout


def _scan(file: BinaryIO, layout: Layout, disk_size: int) -> None:
    """Go forward from record to record; raises ValueError at one that cannot be."""
    limit, most = layout.size, largest(disk_size)
    # Progress is reported after each run, so a file has 200 or more of them.
    run_bytes = min(_RUN_BYTES, disk_size // 200)
    offset = len(MCAP0_MAGIC)
    while offset <= limit:
        file.seek(offset)
        head = file.read(HEAD.size + MESSAGE.size)
        if len(head) < HEAD.size:
            break
        opcode, length = HEAD.unpack_from(head)
        layout.size = offset
        if opcode == 0:  # no record has this, but a disk may leave a run of zeros
            raise ValueError('zeros in place of a record')
        if opcode in Integrity.OPCODES and length <= most:
            file.seek(offset + HEAD.size)
            layout.integrity.add(opcode, file.read(length), offset)
        if opcode == Opcode.DATA_END:
            layout.data_end = offset
        elif opcode == Opcode.MESSAGE_INDEX:
            _add_index(layout.spans, head, offset, most)
        elif opcode in _SPAN_OPCODES:
            if length > most:
                raise ValueError(f'a record that claims {length} bytes')
            span = _span(head, offset)
            if span is None:
                break
            _append(layout.spans, span, run_bytes)
            if offset > layout.data_end:
                file.seek(offset + HEAD.size)
                with suppress(Exception):  # a damaged one describes nothing
                    layout.summary.append(parse_description(opcode, file.read(length)))
        offset += HEAD.size + length
        if opcode == Opcode.FOOTER and offset <= limit:
            file.seek(offset)
            magic = file.read(2 * len(MCAP0_MAGIC))
            if not magic.startswith(MCAP0_MAGIC):
                break
            chunks = [span.offset for span in layout.spans if span.is_chunk]
            layout.size, layout.doubt = offset, layout.integrity.chunk_fault(chunks)
            if magic == 2 * MCAP0_MAGIC:
                end = offset + len(MCAP0_MAGIC)
                layout.trouble = (
                    f'holds another bag from byte {end} on, which needs a file of its own'
                )
            return
    layout.size = file.seek(0, io.SEEK_END)
    layout.trouble = f'is cut off at byte {layout.size}'


def _add_index(spans: list[Span], head: bytes, offset: int, most: int) -> None:
    """Note a message index that follows its chunk."""
    if not spans or not spans[-1].is_chunk:
        return
    chunk = spans[-1]
    length = chunk.index_length + HEAD.size + HEAD.unpack_from(head)[1]
    if length > most:
        raise ValueError(f'indexes that claim {length} bytes')
    if chunk.end + chunk.index_length == offset:
        chunk.index_length = length
        chunk.channels.add(int.from_bytes(head[HEAD.size : HEAD.size + 2], 'little'))


def _span(head: bytes, offset: int) -> Span | None:
    """Return the span of one record; None where the file ends before its time."""
    opcode, length = HEAD.unpack_from(head)
    time = NEVER
    if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
        # The log time of a message follows its channel and sequence number.
        start = HEAD.size + (6 if opcode == Opcode.MESSAGE else 0)
        if len(head) < start + _TIME.size:
            return None
        (time,) = _TIME.unpack_from(head, start)
    return Span(offset, HEAD.size + length, opcode == Opcode.CHUNK, time)


def _append(spans: list[Span], span: Span, run_bytes: int) -> None:
    """Append a span, or lengthen the run of records that it follows."""
    last = spans[-1] if spans and not (span.is_chunk or spans[-1].is_chunk) else None
    if last is not None and last.end == span.offset and last.length < run_bytes:
        last.length += span.length
        last.time = min(last.time, span.time)
    else:
        spans.append(span)


def read_span(file: BinaryIO, span: Span, layout: Layout) -> tuple[bytes, bytes]:
    """Return the records in a span, as far as the file goes, and the indexes behind a chunk."""
    if span.length > LARGEST:
        raise ValueError(f'a record that claims {span.length} bytes')
    if span.is_chunk and LARGEST_CHUNK < span.length <= layout.size - span.offset:
        raise _too_large(file, span)
    file.seek(span.offset)
    record = file.read(min(span.length + span.index_length, layout.size - span.offset))
    if not span.is_chunk:
        return record, b''
    record, index = record[: span.length], record[span.length :]
    # Read this way, the data of a chunk that is cut are as short as the file leaves them.
    chunk = Chunk.read(ReadDataStream(BytesIO(record[HEAD.size :])))
    size = chunk.uncompressed_size
    if size > largest(len(chunk.data)):
        raise ValueError(f'a chunk that claims to be {size} bytes unpacked')
    # One byte more shows a claim that is too small, or a chunk that is too large.
    most = min(size, LARGEST_CHUNK) + 1
    if chunk.compression == 'zstd':
        content = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(most)
    elif chunk.compression == 'lz4':
        content = unpack_lz4(chunk.data, most)
    elif chunk.compression == '':
        content = chunk.data
    else:
        raise BagError(
            f'{file.name}: chunks are compressed with {chunk.compression!r}; '
            f'fix: `mcap compress {file.name} -o NEW.mcap`'
        )
    if len(content) > LARGEST_CHUNK:
        raise _too_large(file, span)
    if len(record) == span.length:
        if len(content) != size:
            raise ValueError('a chunk of the wrong size')
        if chunk.uncompressed_crc not in (0, zlib.crc32(content)):
            raise ValueError('the checksum of a chunk is wrong')
    return content, index


def unpack_lz4(data: bytes, most: int) -> bytes:
    """Unpack at most so many bytes; in pieces, since lz4 takes twice the memory of each."""
    decompressor = lz4.frame.LZ4FrameDecompressor()
    content = BytesIO()  # gives its bytes away without a copy, as a list of pieces cannot
    piece = decompressor.decompress(data, min(most, _LZ4_PIECE))
    while content.write(piece) and content.tell() < most:
        if decompressor.eof or decompressor.needs_input:
            break
        piece = decompressor.decompress(b'', min(most - content.tell(), _LZ4_PIECE))
    return content.getvalue()


def _too_large(file: BinaryIO, span: Span) -> BagError:
    return BagError(
        f'{file.name}: the chunk at byte {span.offset} is larger than {LARGEST_CHUNK >> 20} MiB '
        f'unpacked; fix: `mcap compress {file.name} -o NEW.mcap`, which makes chunks of 4 MiB'
    )
