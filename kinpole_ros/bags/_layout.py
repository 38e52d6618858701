"""The layout of an MCAP file, found by the heads of its records.

mcap's StreamReader reads the same messages, but all of them: the CPU time of `replay` of 12,000
marker arrays among 72,000 messages of other topics is 1.17 times as long with it (median of five
alternating runs; 1.00 of markers alone). Hence heads are read here, and records by mcap.
"""

import io
import struct
import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Schema, Statistics

from kinpole_ros.bags import _channels
from kinpole_ros.bags._files import MCAP_MAGIC, BagError, Unpacked

NEVER = 2**64  # later than any log time
_FARTHEST = 2**62  # bytes: beyond the end of any file
_TIME = struct.Struct('<Q')
_SPAN_OPCODES = (Opcode.CHUNK, Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL)
_CLAIMS = Opcode.STATISTICS, Opcode.DATA_END
_RUN_BYTES = 1 << 20  # messages outside of chunks are read in runs of this size
_PIECE_BYTES = 1 << 20  # that lz4 unpacks, or a checksum reads, at a time


@dataclass
class Span:
    """A chunk, or a run of records outside of chunks, with messages or their descriptions."""

    offset: int
    length: int
    is_chunk: bool
    time: int  # the earliest log time, ns
    channels: set[int] = field(default_factory=set)  # in the message indexes behind a chunk

    @property
    def end(self) -> int:
        return self.offset + self.length


@dataclass
class FileLayout:
    """The spans of a file in file order, and what the file says of itself."""

    size: int  # bytes, unpacked, that can be read
    spans: list[Span] = field(default_factory=list)
    trouble: str = ''  # why reading ends before the end of the file; '' if it does not
    statistics: Statistics | None = None
    data_end: int = _FARTHEST
    data_checksum: int = 0  # 0 if there is none
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


def lay_out(path: Path, file: BinaryIO) -> FileLayout:
    """Return the layout of an open file."""
    disk_size = path.stat().st_size
    raw = getattr(file, 'raw', None)
    layout = FileLayout(_FARTHEST if isinstance(raw, Unpacked) else disk_size)
    try:
        _scan(file, layout, disk_size)
    except ValueError as error:
        layout.trouble = f'is damaged at byte {layout.size} ({error})'
    if isinstance(raw, Unpacked) and raw.trouble:
        layout.trouble = f'is damaged at byte {layout.size} of its content ({raw.trouble})'
    return layout


def _scan(file: BinaryIO, layout: FileLayout, disk_size: int) -> None:
    """Go forward from record to record; raises ValueError at one that cannot be."""
    limit, most = layout.size, _channels.largest(disk_size)
    # Progress is reported after each run, so a file has 200 or more of them.
    run_bytes = min(_RUN_BYTES, disk_size // 200)
    offset = len(MCAP_MAGIC)
    while offset <= limit:
        file.seek(offset)
        head = file.read(_channels.HEAD.size + _channels.MESSAGE.size)
        if len(head) < _channels.HEAD.size:
            break
        opcode, length = _channels.HEAD.unpack_from(head)
        layout.size = offset
        if opcode == 0:  # no record has this, but a disk may leave a run of zeros
            raise ValueError('zeros in place of a record')
        if opcode == Opcode.MESSAGE_INDEX and layout.spans and layout.spans[-1].is_chunk:
            layout.spans[-1].channels.add(
                int.from_bytes(head[_channels.HEAD.size : _channels.HEAD.size + 2], 'little')
            )
        elif opcode in _SPAN_OPCODES:
            if length > most:
                raise ValueError(f'a record that claims {length} bytes')
            span = _span(head, offset)
            if span is None:
                break
            _append(layout.spans, span, run_bytes)
        if length <= most and (offset > layout.data_end or opcode in _CLAIMS):
            file.seek(offset + _channels.HEAD.size)
            with suppress(Exception):  # a damaged one says nothing
                _add_summary(layout, opcode, file.read(length))
        if opcode == Opcode.DATA_END:
            layout.data_end = offset
        offset += _channels.HEAD.size + length
        if opcode == Opcode.FOOTER and offset <= limit:
            file.seek(offset)
            magic = file.read(2 * len(MCAP_MAGIC))
            if not magic.startswith(MCAP_MAGIC):
                break
            layout.size = offset
            if magic == 2 * MCAP_MAGIC:
                end = offset + len(MCAP_MAGIC)
                layout.trouble = (
                    f'holds another bag from byte {end} on, which needs a file of its own'
                )
            return
    layout.size = file.seek(0, io.SEEK_END)
    layout.trouble = f'is cut off at byte {layout.size}'


def _add_summary(layout: FileLayout, opcode: int, body: bytes) -> None:
    """Add a record that describes the file."""
    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        layout.summary.append(_channels.parse_description(opcode, body))
    elif opcode == Opcode.STATISTICS:
        layout.statistics = Statistics.read(ReadDataStream(BytesIO(body)))
    elif opcode == Opcode.DATA_END:
        layout.data_checksum = DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc


def is_data_changed(file: BinaryIO, layout: FileLayout) -> bool:
    """Return whether the data are not those of their checksum, where there is one."""
    if not layout.data_checksum:
        return False
    file.seek(0)
    remaining, checksum = layout.data_end, 0
    while remaining > 0 and (data := file.read(min(remaining, _PIECE_BYTES))):
        checksum = zlib.crc32(data, checksum)
        remaining -= len(data)
    return checksum != layout.data_checksum


def _span(head: bytes, offset: int) -> Span | None:
    """Return the span of one record; None where the file ends before its time."""
    opcode, length = _channels.HEAD.unpack_from(head)
    time = NEVER
    if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
        # The log time of a message follows its channel and sequence number.
        start = _channels.HEAD.size + (6 if opcode == Opcode.MESSAGE else 0)
        if len(head) < start + _TIME.size:
            return None
        (time,) = _TIME.unpack_from(head, start)
    return Span(offset, _channels.HEAD.size + length, opcode == Opcode.CHUNK, time)


def _append(spans: list[Span], span: Span, run_bytes: int) -> None:
    """Append a span, or lengthen the run of records that it follows."""
    last = spans[-1] if spans and not (span.is_chunk or spans[-1].is_chunk) else None
    if last is not None and last.end == span.offset and last.length < run_bytes:
        last.length += span.length
        last.time = min(last.time, span.time)
    else:
        spans.append(span)


def read_span(file: BinaryIO, span: Span, layout: FileLayout) -> bytes:
    """Return the records in a span, as far as the file goes."""
    if span.length > _channels.LARGEST:
        raise ValueError(f'a record that claims {span.length} bytes')
    if span.is_chunk and _channels.LARGEST_CHUNK < span.length <= layout.size - span.offset:
        raise _too_large(file, span)
    file.seek(span.offset)
    record = file.read(min(span.length, layout.size - span.offset))
    if not span.is_chunk:
        return record
    # Read this way, the data of a chunk that is cut are as short as the file leaves them.
    chunk = Chunk.read(ReadDataStream(BytesIO(record[_channels.HEAD.size :])))
    size = chunk.uncompressed_size
    if size > _channels.largest(len(chunk.data)):
        raise ValueError(f'a chunk that claims to be {size} bytes unpacked')
    # One byte more shows a claim that is too small, or a chunk that is too large.
    most = min(size, _channels.LARGEST_CHUNK) + 1
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
    if len(content) > _channels.LARGEST_CHUNK:
        raise _too_large(file, span)
    if len(record) == span.length:
        if len(content) != size:
            raise ValueError('a chunk of the wrong size')
        if chunk.uncompressed_crc not in (0, zlib.crc32(content)):
            raise ValueError('the checksum of a chunk is wrong')
    return content


def unpack_lz4(data: bytes, most: int) -> bytes:
    """Unpack at most so many bytes; in pieces, since lz4 takes twice the memory of each."""
    decompressor = lz4.frame.LZ4FrameDecompressor()
    content = BytesIO()  # gives its bytes away without a copy, as a list of pieces cannot
    piece = decompressor.decompress(data, min(most, _PIECE_BYTES))
    while content.write(piece) and content.tell() < most:
        if decompressor.eof or decompressor.needs_input:
            break
        piece = decompressor.decompress(b'', min(most - content.tell(), _PIECE_BYTES))
    return content.getvalue()


def _too_large(file: BinaryIO, span: Span) -> BagError:
    return BagError(
        f'{file.name}: the chunk at byte {span.offset} is larger than '
        f'{_channels.LARGEST_CHUNK >> 20} MiB unpacked; fix: `mcap compress {file.name} '
        '-o NEW.mcap`, which makes chunks of 4 MiB'
    )
