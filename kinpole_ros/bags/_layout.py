"""Where the messages of an MCAP file are: by its index, or else by the heads of its records.

mcap's own reader gives up on a file without a good end, and trusts the sizes a file claims.
"""

import io
import struct
import zlib
from contextlib import suppress
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Footer, Schema
from mcap.writer import MCAP0_MAGIC

from kinpole_ros.bags._channels import (
    HEAD,
    LARGEST,
    LARGEST_CHUNK,
    MESSAGE,
    Channels,
    description,
    largest,
)
from kinpole_ros.bags._claims import CLAIMING, Claims
from kinpole_ros.bags._files import BagError, Unpacked

NEVER = 2**64  # later than any log time
_FARTHEST = 2**62  # bytes: beyond the end of any file
_TIME = struct.Struct('<Q')
_FOOTER_SIZE = HEAD.size + 20
_RUN = 1 << 20  # bytes: messages so near each other are read together
_PIECE = 1 << 20  # bytes that lz4 unpacks at a time


class Span(NamedTuple):
    """A stretch of the file that holds messages or describes them: a chunk, or plain records.

    `time` is the earliest log time in it, ns. A chunk is followed by `indexes` bytes of indexes of
    its messages.
    """

    offset: int
    length: int
    chunk: bool
    time: int
    indexes: int = 0

    @property
    def end(self) -> int:
        return self.offset + self.length


class Layout(NamedTuple):
    """Where the messages of a file are, in file order, and what is wrong ('' if nothing).

    `size` is as far as it can be read, in bytes, unpacked. `claims` is what the file says of
    itself, and `doubt` what of that is wrong already.
    """

    spans: list[Span]
    trouble: str
    size: int
    claims: Claims
    doubt: str = ''


def lay_out(path: Path, file: BinaryIO, channels: Channels) -> Layout:
    """The layout of an open file; `channels` learns what the index says of them."""
    if isinstance(raw := getattr(file, 'raw', None), Unpacked):
        layout = _scan(file, path.stat().st_size, _FARTHEST)
        if raw.trouble:
            trouble = f'is damaged at byte {layout.size} of its content ({raw.trouble})'
            layout = layout._replace(trouble=trouble)
        return layout
    size = file.seek(0, io.SEEK_END)
    with suppress(Exception):  # no index, or any kind of damage to it
        return _indexed(file, size, channels)
    return _scan(file, size, size)


def _indexed(file: BinaryIO, size: int, channels: Channels) -> Layout:
    """The layout by the index at the end of a file; raises if it is not as good as the file."""
    file.seek(size - _FOOTER_SIZE - len(MCAP0_MAGIC))
    tail = file.read()
    opcode, length = HEAD.unpack_from(tail)
    footer = Footer.read(ReadDataStream(BytesIO(tail[HEAD.size :])))
    summary_size = size - len(tail) - footer.summary_start
    whole = opcode == Opcode.FOOTER and length == 20 and tail.endswith(MCAP0_MAGIC)
    if not whole or not footer.summary_start or not 0 <= summary_size <= LARGEST:
        raise ValueError('no index')
    file.seek(footer.summary_start)
    summary = file.read(summary_size)
    # The checksum covers all up to itself.
    crc = zlib.crc32(tail[: _FOOTER_SIZE - 4], zlib.crc32(summary))
    if footer.summary_crc not in (0, crc):
        raise ValueError('a damaged index')
    claims = Claims()
    described: list[Schema | Channel] = []
    chunks: list[ChunkIndex] = []
    end = 0
    while end < summary_size:
        opcode, length = HEAD.unpack_from(summary, end)
        body = summary[end + HEAD.size : end + HEAD.size + length]
        end += HEAD.size + length
        if opcode in CLAIMING:
            claims.note(opcode, body, 0)
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            described.append(description(opcode, body))
        elif opcode == Opcode.CHUNK_INDEX:
            chunks.append(ChunkIndex.read(ReadDataStream(BytesIO(body))))
    # An index may leave out what the chunks say; then it is of no use here.
    schemas = {record.id for record in described if isinstance(record, Schema)}
    listed = [record for record in described if isinstance(record, Channel)]
    ids = {record.id for record in listed}
    good = bool(chunks) and all(record.schema_id in (0, *schemas) for record in listed)
    chunks.sort(key=attrgetter('chunk_start_offset'))
    place = len(MCAP0_MAGIC)
    for chunk in chunks:
        inside = set(chunk.message_index_offsets)
        good = good and bool(inside) and inside <= ids
        good = good and not _messages_between(file, place, chunk.chunk_start_offset)
        place = chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length
    if not good or _messages_between(file, place, footer.summary_start, claims):
        raise ValueError('an index that leaves out things')
    for record in sorted(described, key=lambda record: isinstance(record, Channel)):
        channels.add(record)
    spans = [
        Span(
            c.chunk_start_offset,
            c.chunk_length,
            True,
            c.message_start_time,
            c.message_index_length,
        )
        for c in chunks
        if channels.want_any(c.message_index_offsets)
    ]
    doubt = claims.lacking([chunk.chunk_start_offset for chunk in chunks])
    return Layout(spans, '', size, claims, doubt)


def _messages_between(file: BinaryIO, place: int, end: int, claims: Claims | None = None) -> bool:
    """Whether there are messages or chunks among the records there; raises if these do not fit."""
    while place < end:
        file.seek(place)
        opcode, length = HEAD.unpack(file.read(HEAD.size))
        if opcode in (Opcode.MESSAGE, Opcode.CHUNK):
            return True
        if opcode == Opcode.DATA_END and claims is not None:
            claims.note(opcode, file.read(min(length, _FOOTER_SIZE)), place)
        place += HEAD.size + length
    if place > end:
        raise ValueError('records where the index has others')
    return False


def _scan(file: BinaryIO, size: int, farthest: int) -> Layout:
    """The layout of a file of `size` bytes on the disk by the heads of its records.

    Goes only forward, and finds out by itself where the content ends, `farthest` at most.
    """
    spans: list[Span] = []
    claims = Claims()
    offset = len(MCAP0_MAGIC)
    # Plain records in a row are read at once, but not so many that no progress could be seen.
    longest = min(_RUN, size // 200)
    while offset <= farthest:
        file.seek(offset)
        head = file.read(HEAD.size)
        if len(head) < HEAD.size:
            break
        opcode, length = HEAD.unpack(head)
        if opcode == 0:  # no record has this, but a disk may leave a run of zeros
            trouble = f'is damaged at byte {offset} (zeros in place of a record)'
            return Layout(spans, trouble, offset, claims)
        if opcode in CLAIMING and length <= largest(size):
            claims.note(opcode, file.read(length), offset)
        if opcode == Opcode.MESSAGE_INDEX and spans and spans[-1].chunk:
            last = spans[-1]
            whole = last.indexes + HEAD.size + length
            if whole > largest(size):
                trouble = f'is damaged at byte {offset} (indexes that claim {whole} bytes)'
                return Layout(spans, trouble, offset, claims)
            if last.end + last.indexes == offset:
                spans[-1] = last._replace(indexes=whole)
        if opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
            if length > largest(size):
                trouble = f'is damaged at byte {offset} (a record that claims {length} bytes)'
                return Layout(spans, trouble, offset, claims)
            time = NEVER
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                if opcode == Opcode.MESSAGE:
                    file.seek(offset + HEAD.size + MESSAGE.size - 2 * _TIME.size)
                tail = file.read(_TIME.size)
                if len(tail) < _TIME.size:
                    break
                time = _TIME.unpack(tail)[0]
            span = Span(offset, HEAD.size + length, opcode == Opcode.CHUNK, time)
            before = spans[-1] if spans else span
            row = not (span.chunk or before.chunk) and before.end == offset
            if row and before.length < longest:
                spans.pop()
                whole = before.length + span.length
                span = Span(before.offset, whole, False, min(before.time, time))
            spans.append(span)
        offset += HEAD.size + length
        if opcode == Opcode.FOOTER and offset <= farthest:
            file.seek(offset)
            if file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
                end = offset + len(MCAP0_MAGIC)
                more = file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
                problem = f'holds another bag from byte {end} on, which needs a file of its own'
                doubt = claims.lacking([span.offset for span in spans if span.chunk])
                return Layout(spans, problem if more else '', offset, claims, doubt)
            break
    end = file.seek(0, io.SEEK_END)
    return Layout(spans, f'is cut off at byte {end}', end, claims)


def records(file: BinaryIO, span: Span, layout: Layout) -> tuple[bytes, bytes]:
    """The records in a span, as far as the file goes, and the indexes behind a whole chunk."""
    if span.length > LARGEST:
        raise ValueError(f'a record that claims {span.length} bytes')
    if span.chunk and LARGEST_CHUNK < span.length <= layout.size - span.offset:
        raise _too_large(file, span)
    file.seek(span.offset)
    record = file.read(min(span.length + span.indexes, layout.size - span.offset))
    if not span.chunk:
        return record, b''
    record, index = record[: span.length], record[span.length :]
    if record[: HEAD.size] != HEAD.pack(Opcode.CHUNK, span.length - HEAD.size):
        raise ValueError('no record where the index has one')
    # Read this way, the data of a chunk that is cut are as short as the file leaves them.
    chunk = Chunk.read(ReadDataStream(BytesIO(record[HEAD.size :])))
    claimed = chunk.uncompressed_size
    if claimed > largest(len(chunk.data)):
        raise ValueError(f'a chunk that claims to be {claimed} bytes unpacked')
    # One byte more tells a claim that is too small, or a chunk that is too large.
    most = min(claimed, LARGEST_CHUNK) + 1
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
        if len(content) != claimed:
            raise ValueError('a chunk of the wrong size')
        if chunk.uncompressed_crc not in (0, zlib.crc32(content)):
            raise ValueError('the checksum of a chunk is wrong')
    return content, index


def unpack_lz4(data: bytes, most: int) -> bytes:
    """Unpack so many bytes at most; in pieces, since lz4 takes twice the memory of each."""
    decompressor = lz4.frame.LZ4FrameDecompressor()
    pieces = [decompressor.decompress(data, min(most, _PIECE))]
    left = most - len(pieces[0])
    while left and pieces[-1] and not (decompressor.eof or decompressor.needs_input):
        pieces.append(decompressor.decompress(b'', min(left, _PIECE)))
        left -= len(pieces[-1])
    return b''.join(pieces)


def _too_large(file: BinaryIO, span: Span) -> BagError:
    return BagError(
        f'{file.name}: the chunk at byte {span.offset} is larger than {LARGEST_CHUNK >> 20} MiB '
        f'unpacked; fix: `mcap compress {file.name} -o NEW.mcap`, which makes chunks of 4 MiB'
    )
