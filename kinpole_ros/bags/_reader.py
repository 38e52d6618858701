"""Recorders get killed and disks fill up, so bags are read to the last message that is there.

mcap's own reader gives up on a file without a good end, and trusts the sizes a file claims. Here
the file is laid out first, as the list of its stretches that hold messages (from its index, or
from the heads of its records where there is no index), and then read in file order, whole or not,
by the same code. Messages are handed on as soon as no later stretch can hold an earlier one, so
memory stays bounded. A file compressed as a whole is read twice from front to back, and unpacked
to nowhere.
"""

import io
import re
import struct
import zlib
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from heapq import heappop, heappush
from io import BytesIO
from itertools import accumulate, chain
from operator import attrgetter
from pathlib import Path, PurePath
from typing import BinaryIO, NamedTuple, cast

import lz4.frame
import yaml
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Footer, Schema
from mcap.writer import MCAP0_MAGIC

_HEAD = struct.Struct('<BQ')  # of every record: opcode, length of the rest
_MESSAGE = struct.Struct('<H4xQ8x')  # channel, (sequence,) log time (, publish time)
_TIME = struct.Struct('<Q')
_NEVER = 2**64
_FARTHEST = 2**62
_MESSAGE_RECORD = int(Opcode.MESSAGE)
_FOOTER_SIZE = _HEAD.size + 20
_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # no CDR starts with it
# What may be claimed to be unpacked, in bytes: real recordings stay far below, bombs do not.
_LARGEST = 1 << 30
_ALWAYS = 1 << 26
_RATIO = 1000
_RUN = 1 << 20
# What a block holds at most, but for single messages and chunks larger than that.
_BLOCK_MESSAGES = 1000
_BLOCK_BYTES = 1 << 20
# Of YAML: dates and numbers that are none, other things than expected, nesting without end.
_MALFORMED = (ValueError, LookupError, TypeError, AttributeError, RecursionError)
_FOREIGN = {
    b'SQLite f': 'is a bag in sqlite3',
    b'#ROSBAG ': 'is a ROS 1 bag',
}
_CONVERT = 'mend: `rosbags-convert --src {} --dst NEW --dst-storage mcap` (pip install rosbags)'


class BagError(ValueError):
    """A bag or table that cannot be read or written: one line that names it and the mend."""


class Truncated(BagError):
    """The end of a bag is missing or damaged; all that comes before was handed out."""


class BagMessage(NamedTuple):
    """One message as recorded: `data` is CDR, `log_time` in ns."""

    topic: str
    type_name: str
    data: bytes
    log_time: int


class _Span(NamedTuple):
    """A stretch of the file that holds messages or describes them: a chunk, or plain records.

    `time` is the earliest log time in it, ns.
    """

    offset: int
    length: int
    chunk: bool
    time: int

    @property
    def end(self) -> int:
        return self.offset + self.length


def bag_files(path: str | Path) -> list[Path]:
    """The .mcap files of a bag, in order.

    `path` is an .mcap file or a rosbag2 folder, whose metadata.yaml names the files; without
    one, all *.mcap files of the folder by name, numbers in names counted as numbers.

    Raises BagError when there is no bag, or one that is not MCAP.
    """
    path = Path(path)
    try:
        if path.is_dir():
            files = _folder_files(path)
        elif path.is_file():
            files = [path]
        else:
            raise BagError(f'no such bag: {path}; mend: give an .mcap file or a rosbag2 folder')
        _check_magic(files[0])
    except OSError as error:
        raise _unreadable(path, error) from error
    return files


def topics(path: str | Path) -> dict[str, str]:
    """Topics of a bag and their types, such as {'/markers': 'visualization_msgs/msg/MarkerArray'}.

    A bag that is cut off or damaged gives those found in what is left, without complaint.
    Raises BagError when there is no bag.
    """
    found: dict[str, str] = {}
    for one in bag_files(path):
        try:
            with _open(one) as file:
                found |= _file_topics(one, file)
        except OSError as error:
            raise _unreadable(one, error) from error
    return found


def read_messages(
    path: str | Path,
    topics: Collection[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Iterator[BagMessage]:
    """Messages of a bag, those on `topics` or all, in order of log time.

    Ties come in the order of the file; the files of a folder come one after the other. Messages
    that are not CDR are left out of all, and refused when asked for. `progress` is called with
    the fraction of bytes done, at most some 200 times in all.

    A file that is cut off or damaged gives every message before that place, also those in a
    chunk cut in the middle, and then raises Truncated, which says where. Other things wrong
    raise BagError: at the call what bag_files refuses, the rest when its turn comes.
    """
    return chain.from_iterable(read_blocks(path, topics, progress))


def read_blocks(
    path: str | Path,
    topics: Collection[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Iterator[list[BagMessage]]:
    """The same messages in the same order, a list of up to a thousand (about 1 MiB) at a time.

    What is wrong is raised as by read_messages, after a list of all that came before it.
    """
    wanted = None if topics is None else frozenset(topics)
    return _blocks(_read_files(bag_files(path), wanted, progress or (lambda fraction: None)))


def _blocks(parts: Iterator[list[BagMessage]]) -> Iterator[list[BagMessage]]:
    """The same messages in lists that are neither short nor long."""
    block: list[BagMessage] = []
    size = 0
    trouble = None
    try:
        for part in parts:
            for start in range(0, len(part), _BLOCK_MESSAGES):
                piece = part[start : start + _BLOCK_MESSAGES]
                more = sum([len(message.data) for message in piece])
                full = len(block) + len(piece) > _BLOCK_MESSAGES or size + more > _BLOCK_BYTES
                if block and full:
                    yield block
                    block, size = [], 0
                block += piece
                size += more
    except BagError as error:
        trouble = error
    if block:
        yield block
    if trouble is not None:
        raise trouble


def _file_topics(path: Path, file: BinaryIO) -> dict[str, str]:
    channels = _Channels(path, frozenset())
    layout = _layout(path, file, channels)
    if not channels.types:
        with suppress(Exception):  # damaged bytes: what came before them counts
            for span in layout.spans:
                channels.read(_records(file, span, layout), [])
    return channels.types


def _folder_files(folder: Path) -> list[Path]:
    metadata = folder / 'metadata.yaml'
    if not metadata.exists():
        plain = {file.name for file in folder.glob('*.mcap')}
        # What was being compressed when its recorder died is there as both.
        packed = {file.name for file in folder.glob('*.mcap.zstd')}
        names = plain | {name for name in packed if name.removesuffix('.zstd') not in plain}
        files = [folder / name for name in sorted(names, key=_by_number)]
        if not files:
            if any(folder.glob('*.db3')):
                raise BagError(f'{folder} is a bag in sqlite3; {_CONVERT.format(folder)}')
            raise BagError(
                f'{folder} has neither metadata.yaml nor .mcap files; '
                'mend: give an .mcap file or a rosbag2 folder'
            )
        return files
    try:
        about = yaml.safe_load(metadata.read_text('utf-8'))['rosbag2_bagfile_information']
        storage, listed = about['storage_identifier'], about['relative_file_paths']
        compressed = about.get('compression_format')
        paths = [PurePath(name) for name in listed]
    except (yaml.YAMLError, *_MALFORMED) as error:
        raise BagError(
            f'{metadata} is not the metadata of a rosbag2 bag; '
            f'mend: `ros2 bag reindex {folder}`, or remove it to read all .mcap files there'
        ) from error
    if storage != 'mcap' or compressed not in (None, '', 'zstd'):
        wrong = f'compressed by rosbag2 ({compressed})' if compressed else f'in {storage}'
        raise BagError(f'{folder} is a bag {wrong}; {_CONVERT.format(folder)}')
    if not paths:
        raise BagError(f'{metadata} names no files; mend: `ros2 bag reindex {folder}`')
    for name in paths:
        # A bag from elsewhere must not make us read other files of this machine.
        if name.is_absolute() or '..' in name.parts:
            raise BagError(
                f"{metadata}: '{name}' in relative_file_paths is outside of the folder; "
                'mend: name files in the folder only'
            )
        if not (folder / name).is_file():
            raise BagError(
                f'{folder / name}, named by metadata.yaml, is not there; mend: put it back, '
                'or `ros2 bag reindex`'
            )
    return [folder / name for name in paths]


def _by_number(name: str) -> list[int | str]:
    return [int(s) if s.isdecimal() else s for s in re.split(r'(\d+)', name)]


def _check_magic(path: Path) -> None:
    with open(path, 'rb') as file:
        magic = file.read(len(MCAP0_MAGIC))
    if not magic:
        raise BagError(f'{path} is empty (0 bytes); mend: record again')
    if magic in _FOREIGN:
        raise BagError(f'{path} {_FOREIGN[magic]}; {_CONVERT.format(path)}')
    if magic.startswith(_ZSTD_MAGIC):
        with _open(path) as unpacked:
            if unpacked.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
                return
        raise BagError(
            f'{path} is compressed, and what is in it is not an MCAP file; '
            f'mend: see what `zstd -d {path}` gives'
        )
    if not MCAP0_MAGIC.startswith(magic):
        raise BagError(
            f'{path} is not an MCAP file: it starts otherwise; '
            'mend: give an .mcap file or a rosbag2 folder'
        )


def _unreadable(path: Path, error: OSError) -> BagError:
    return BagError(f'{path} cannot be read: {error.strerror}; mend: check the path and its rights')


def _open(path: Path) -> BinaryIO:
    """A file of a bag, or the content of one that rosbag2 compressed as a whole."""
    file = open(path, 'rb')  # noqa: SIM115 - whoever asks for it closes it
    packed = file.read(len(_ZSTD_MAGIC)) == _ZSTD_MAGIC
    file.seek(0)
    return cast('BinaryIO', io.BufferedReader(_Unpacked(file), _RUN)) if packed else file


class _Unpacked(io.RawIOBase):
    """The content of a file compressed by zstd, read forward; to go back is to begin anew.

    It ends where zstd cannot go on, and `trouble` says why.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.trouble = ''
        self._file = file
        self._begin()

    def _begin(self) -> None:
        self._file.seek(0)
        # rosbag2 writes one frame, other tools several.
        self._content = zstandard.ZstdDecompressor().stream_reader(
            self._file, read_across_frames=True, closefd=False
        )
        self._place = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def readinto(self, buffer: 'bytearray | memoryview[int]') -> int:  # type: ignore[override]
        try:
            count = self._content.readinto(buffer)
        except zstandard.ZstdError as error:
            self.trouble = str(error)
            return 0
        self._place += count
        return int(count)

    def tell(self) -> int:
        return self._place

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        if whence == io.SEEK_END:
            offset = _FARTHEST
        if offset < self._place:
            self._begin()
        passed = memoryview(bytearray(min(_RUN, offset - self._place)))
        while self._place < offset and self.readinto(passed[: offset - self._place]):
            pass
        return self._place

    def close(self) -> None:
        self._file.close()
        super().close()


class _Channels:
    """What the schema and channel records met so far say, and the messages they explain."""

    def __init__(self, path: Path, wanted: frozenset[str] | None) -> None:
        self.types: dict[str, str] = {}
        self._path = path
        self._wanted = wanted
        self._schemas: dict[int, str] = {}
        self._chosen: dict[int, tuple[str, str] | None] = {}
        self._refused: dict[int, str] = {}

    def add(self, record: Schema | Channel) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record.name
            return
        name = self._schemas.get(record.schema_id, '')
        self.types[record.topic] = name
        asked_for = self._wanted is not None and record.topic in self._wanted
        if record.message_encoding == 'cdr' and name:
            chosen = asked_for or self._wanted is None
            self._chosen[record.id] = (record.topic, name) if chosen else None
        elif asked_for:
            self._refused[record.id] = (
                f"{self._path}: topic '{record.topic}' has messages in "
                f"'{record.message_encoding}' of type '{name}'; mend: give a topic of ROS 2 "
                'messages (cdr)'
            )
        else:
            self._chosen[record.id] = None

    def want_any(self, ids: Collection[int]) -> bool:
        return any(self._chosen.get(channel_id, True) for channel_id in ids)

    def read(self, records: bytes, found: list[BagMessage]) -> None:
        """Add the chosen messages in a run of records; raises where the last one is cut."""
        # By hand, since this is the hot loop: mcap's own takes three times as long, and copies
        # also what nobody asked for, such as the images beside the markers.
        end, size = 0, len(records)
        while end < size:
            opcode, length = _HEAD.unpack_from(records, end)
            start = end + _HEAD.size
            end = start + length
            if end > size:
                raise ValueError('a record is cut')
            if opcode == _MESSAGE_RECORD:
                channel_id, log_time = _MESSAGE.unpack_from(records, start)
                if channel_id not in self._chosen:
                    self._complain(channel_id)
                if (chosen := self._chosen[channel_id]) is not None:
                    data = records[start + _MESSAGE.size : end]
                    if data.startswith(_ZSTD_MAGIC):  # rosbag2 compressed message by message
                        data = _unpacked_message(data)
                    found.append(BagMessage(*chosen, data, log_time))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.add(_description(opcode, records[start:end]))
            elif opcode == 0:
                raise ValueError('zeros in place of a record')

    def _complain(self, channel_id: int) -> None:
        if channel_id in self._refused:
            raise BagError(self._refused[channel_id])
        raise ValueError(f'a message of channel {channel_id}, which is not described')


def _description(opcode: int, body: bytes) -> Schema | Channel:
    stream = ReadDataStream(BytesIO(body))
    return Schema.read(stream) if opcode == Opcode.SCHEMA else Channel.read(stream)


def _unpacked_message(data: bytes) -> bytes:
    claimed = zstandard.frame_content_size(data)
    largest = _largest(len(data))
    if claimed > largest:
        raise ValueError(f'a message that claims to be {claimed} bytes unpacked')
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=largest)


def _largest(packed: int) -> int:
    """How many bytes so many compressed ones may claim to be before it is taken for damage."""
    return min(_LARGEST, max(_ALWAYS, _RATIO * packed))


class _Layout(NamedTuple):
    """Where the messages of a file are, in file order, and what is wrong ('' if nothing).

    `size` is as far as it can be read, in bytes, unpacked.
    """

    spans: list[_Span]
    trouble: str
    size: int


def _read_files(
    files: list[Path], wanted: frozenset[str] | None, progress: Callable[[float], None]
) -> Iterator[list[BagMessage]]:
    sizes = [file.stat().st_size for file in files]
    before, reported = 0, 0.0

    def report(share: float) -> None:
        nonlocal reported
        fraction = (before + share * size) / sum(sizes)
        if fraction - reported >= 0.005:
            reported = fraction
            progress(fraction)

    for path, size in zip(files, sizes, strict=True):
        try:
            _check_magic(path)
            with _open(path) as file:
                yield from _read_file(path, file, wanted, report)
        except OSError as error:
            raise _unreadable(path, error) from error
        before += size
    progress(1.0)


def _read_file(
    path: Path, file: BinaryIO, wanted: frozenset[str] | None, report: Callable[[float], None]
) -> Iterator[list[BagMessage]]:
    channels = _Channels(path, wanted)
    layout = _layout(path, file, channels)
    trouble = layout.trouble
    # The earliest log time from each span on to the end of the file.
    times = [span.time for span in reversed(layout.spans)]
    earliest = [*accumulate(times, min, initial=_NEVER)][::-1]
    waiting: list[tuple[int, int, int, list[BagMessage]]] = []
    count = last = 0
    for number, (span, horizon) in enumerate(zip(layout.spans, earliest[1:], strict=True)):
        found: list[BagMessage] = []
        try:
            channels.read(_records(file, span, layout), found)
        except (BagError, OSError):
            raise
        except Exception as error:  # mcap and each decompressor have their own for bad bytes
            horizon = _NEVER
            if span.end <= layout.size:
                trouble = f'is damaged at byte {span.offset} ({error})'
        if found:
            count += len(found)
            found.sort(key=attrgetter('log_time'))
            heappush(waiting, (found[0].log_time, number, 0, found))
        for part in _until(horizon, waiting):
            last = part[-1].log_time
            yield part
        if horizon == _NEVER:
            break
        report(span.end / layout.size)
    if trouble:
        read = f'{count} messages up to stamp {last / 1e9:.3f} s (log time) were read'
        raise Truncated(
            f'{path} {trouble}: {read if count else "there is no message before that"}; '
            f'mend: record again, or `mcap recover {path} -o NEW.mcap`'
        )


def _until(
    horizon: int, waiting: list[tuple[int, int, int, list[BagMessage]]]
) -> Iterator[list[BagMessage]]:
    """Take what is no later than `horizon` (ns) out of a heap of runs, each sorted, in order.

    A run is the time of its next message, its place in the file, the index of that message, and
    the messages.
    """
    while waiting and waiting[0][0] <= horizon:
        _, number, start, run = heappop(waiting)
        end = horizon
        if waiting:  # of equal times those that come first in the file
            time, other = waiting[0][:2]
            end = min(end, time if number < other else time - 1)
        stop = len(run)
        if run[-1].log_time > end:
            stop = bisect_right(run, end, start, key=attrgetter('log_time'))
            heappush(waiting, (run[stop].log_time, number, stop, run))
        yield run[start:stop]


def _layout(path: Path, file: BinaryIO, channels: _Channels) -> _Layout:
    if isinstance(raw := getattr(file, 'raw', None), _Unpacked):
        layout = _scan(file, path.stat().st_size, _FARTHEST)
        if raw.trouble:
            trouble = f'is damaged at byte {layout.size} of its content ({raw.trouble})'
            layout = layout._replace(trouble=trouble)
        return layout
    size = file.seek(0, io.SEEK_END)
    with suppress(Exception):  # no index, or any kind of damage to it
        return _Layout(_indexed(file, size, channels), '', size)
    return _scan(file, size, size)


def _indexed(file: BinaryIO, size: int, channels: _Channels) -> list[_Span]:
    """The layout by the index at the end of a file; raises if it is not as good as the file."""
    file.seek(size - _FOOTER_SIZE - len(MCAP0_MAGIC))
    tail = file.read()
    opcode, length = _HEAD.unpack_from(tail)
    footer = Footer.read(ReadDataStream(BytesIO(tail[_HEAD.size :])))
    summary_size = size - len(tail) - footer.summary_start
    whole = opcode == Opcode.FOOTER and length == 20 and tail.endswith(MCAP0_MAGIC)
    if not whole or not footer.summary_start or not 0 <= summary_size <= _LARGEST:
        raise ValueError('no index')
    file.seek(footer.summary_start)
    summary = file.read(summary_size)
    # The checksum covers all up to itself.
    crc = zlib.crc32(tail[: _FOOTER_SIZE - 4], zlib.crc32(summary))
    if footer.summary_crc not in (0, crc):
        raise ValueError('a damaged index')
    described: list[Schema | Channel] = []
    chunks: list[ChunkIndex] = []
    end = 0
    while end < summary_size:
        opcode, length = _HEAD.unpack_from(summary, end)
        body = summary[end + _HEAD.size : end + _HEAD.size + length]
        end += _HEAD.size + length
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            described.append(_description(opcode, body))
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
        good &= bool(inside) and inside <= ids and chunk.chunk_start_offset >= place
        place = chunk.chunk_start_offset + chunk.chunk_length
    if not good or place > footer.summary_start:
        raise ValueError('an index that leaves out things')
    for record in sorted(described, key=lambda record: isinstance(record, Channel)):
        channels.add(record)
    return [
        _Span(c.chunk_start_offset, c.chunk_length, True, c.message_start_time)
        for c in chunks
        if channels.want_any(c.message_index_offsets)
    ]


def _scan(file: BinaryIO, size: int, farthest: int) -> _Layout:
    """The layout of a file of `size` bytes on the disk by the heads of its records.

    Goes only forward, and finds out by itself where the content ends, `farthest` at most.
    """
    spans: list[_Span] = []
    offset = len(MCAP0_MAGIC)
    # Plain records in a row are read together, but not so many that no progress could be seen.
    longest = min(_RUN, size // 200)
    while offset <= farthest:
        file.seek(offset)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            break
        opcode, length = _HEAD.unpack(head)
        if opcode == 0:  # no record has this, but a disk may leave a run of zeros
            trouble = f'is damaged at byte {offset} (zeros in place of a record)'
            return _Layout(spans, trouble, offset)
        if opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
            if length > _largest(size):
                trouble = f'is damaged at byte {offset} (a record that claims {length} bytes)'
                return _Layout(spans, trouble, offset)
            time = _NEVER
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                if opcode == Opcode.MESSAGE:
                    file.seek(offset + _HEAD.size + _MESSAGE.size - 2 * _TIME.size)
                tail = file.read(_TIME.size)
                if len(tail) < _TIME.size:
                    break
                time = _TIME.unpack(tail)[0]
            span = _Span(offset, _HEAD.size + length, opcode == Opcode.CHUNK, time)
            before = spans[-1] if spans else span
            row = not (span.chunk or before.chunk) and before.end == offset
            if row and before.length < longest:
                spans.pop()
                whole = before.length + span.length
                span = _Span(before.offset, whole, False, min(before.time, time))
            spans.append(span)
        offset += _HEAD.size + length
        if opcode == Opcode.FOOTER and offset <= farthest:
            file.seek(offset)
            if file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
                return _Layout(spans, '', offset)
            break
    end = file.seek(0, io.SEEK_END)
    return _Layout(spans, f'is cut off at byte {end}', end)


def _records(file: BinaryIO, span: _Span, layout: _Layout) -> bytes:
    """The records in a span, as far as the file goes."""
    if span.length > _LARGEST:
        raise ValueError(f'a record that claims {span.length} bytes')
    file.seek(span.offset)
    record = file.read(min(span.length, layout.size - span.offset))
    if not span.chunk:
        return record
    if record[: _HEAD.size] != _HEAD.pack(Opcode.CHUNK, span.length - _HEAD.size):
        raise ValueError('no record where the index has one')
    # Read this way, the data of a chunk that is cut are as short as the file leaves them.
    chunk = Chunk.read(ReadDataStream(BytesIO(record[_HEAD.size :])))
    claimed = chunk.uncompressed_size
    if claimed > _largest(len(chunk.data)):
        raise ValueError(f'a chunk that claims to be {claimed} bytes unpacked')
    if chunk.compression == 'zstd':
        records = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(claimed + 1)
    elif chunk.compression == 'lz4':
        records = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, claimed + 1)
    elif chunk.compression == '':
        records = chunk.data
    else:
        raise BagError(
            f"{file.name}: chunks are compressed with '{chunk.compression}'; "
            f'mend: `mcap compress {file.name} -o NEW.mcap`'
        )
    if len(record) == span.length:
        if len(records) != claimed:
            raise ValueError('a chunk of the wrong size')
        if chunk.uncompressed_crc not in (0, zlib.crc32(records)):
            raise ValueError('the checksum of a chunk is wrong')
    return records
