"""Recorders get killed and disks fill up, so bags are read to the last message that is there.

mcap's own reader gives up on a file without a good end. Here the file is laid out first, as the
list of its records that hold messages (from its index, or from the records' headers where there
is no index), and then read in file order, whole or not, by the same code. A message is handed on
as soon as no later record can hold an earlier one, so memory stays bounded.
"""

import re
import struct
import zlib
from collections import deque
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from heapq import heappop, heappush
from io import SEEK_CUR, BytesIO
from itertools import accumulate
from operator import attrgetter
from pathlib import Path, PurePath
from typing import BinaryIO, NamedTuple

import lz4.frame
import yaml
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Schema
from mcap.writer import MCAP0_MAGIC

_HEAD = struct.Struct('<BQ')  # of every record: opcode, length of the rest
_MESSAGE = struct.Struct('<H4xQ8x')  # channel, (sequence,) log time (, publish time)
_TIME = struct.Struct('<Q')
_NEVER = 2**64
_MESSAGE_RECORD = int(Opcode.MESSAGE)
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
    """A record, all of it, that holds messages or describes them.

    `time` is the earliest log time in it, ns.
    """

    offset: int
    length: int
    opcode: int
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
            with open(one, 'rb') as file:
                found |= _file_topics(one, file, one.stat().st_size)
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
    wanted = None if topics is None else frozenset(topics)
    return _read_files(bag_files(path), wanted, progress or (lambda fraction: None))


def _file_topics(path: Path, file: BinaryIO, size: int) -> dict[str, str]:
    channels = _Channels(path, frozenset())
    spans, _ = _layout(file, size, channels)
    if not channels.types:
        with suppress(Exception):  # damaged bytes: what came before them counts
            for span in spans:
                deque(channels.messages(_records(file, span, size)), maxlen=0)
    return channels.types


def _folder_files(folder: Path) -> list[Path]:
    metadata = folder / 'metadata.yaml'
    if not metadata.exists():
        files = sorted(
            folder.glob('*.mcap'),
            key=lambda file: [int(s) if s.isdigit() else s for s in re.split(r'(\d+)', file.name)],
        )
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
        storage, names = about['storage_identifier'], about['relative_file_paths']
        compressed = about.get('compression_format')
        paths = [PurePath(name) for name in names]
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, AttributeError) as error:
        raise BagError(
            f'{metadata} is not the metadata of a rosbag2 bag; '
            f'mend: `ros2 bag reindex {folder}`, or remove it to read all .mcap files there'
        ) from error
    if storage != 'mcap' or compressed:
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


def _check_magic(path: Path) -> None:
    with open(path, 'rb') as file:
        magic = file.read(len(MCAP0_MAGIC))
    if not magic:
        raise BagError(f'{path} is empty (0 bytes); mend: record again')
    if magic in _FOREIGN:
        raise BagError(f'{path} {_FOREIGN[magic]}; {_CONVERT.format(path)}')
    if not MCAP0_MAGIC.startswith(magic):
        mend = 'give an .mcap file or a rosbag2 folder'
        if path.suffix == '.zstd':
            mend = f'`zstd -d {path}`'
        raise BagError(f'{path} is not an MCAP file: it starts otherwise; mend: {mend}')


def _unreadable(path: Path, error: OSError) -> BagError:
    return BagError(f'{path} cannot be read: {error.strerror}; mend: check the path and its rights')


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

    def messages(self, records: bytes) -> Iterator[BagMessage]:
        """The chosen messages in a run of records; raises where the last one is cut."""
        # By hand, since this is the hot loop: mcap's own takes three times as long, and copies
        # also what nobody asked for, such as the images beside the markers.
        end = 0
        while end < len(records):
            opcode, length = _HEAD.unpack_from(records, end)
            start = end + _HEAD.size
            end = start + length
            if end > len(records):
                raise ValueError('a record is cut')
            if opcode == _MESSAGE_RECORD:
                channel_id, log_time = _MESSAGE.unpack_from(records, start)
                if channel_id in self._refused:
                    raise BagError(self._refused[channel_id])
                if channel_id not in self._chosen:
                    raise ValueError(f'a message of channel {channel_id}, which is not described')
                if (chosen := self._chosen[channel_id]) is not None:
                    yield BagMessage(*chosen, records[start + _MESSAGE.size : end], log_time)
            elif opcode == Opcode.SCHEMA:
                self.add(Schema.read(ReadDataStream(BytesIO(records[start:end]))))
            elif opcode == Opcode.CHANNEL:
                self.add(Channel.read(ReadDataStream(BytesIO(records[start:end]))))


def _read_files(
    files: list[Path], wanted: frozenset[str] | None, progress: Callable[[float], None]
) -> Iterator[BagMessage]:
    sizes = [file.stat().st_size for file in files]
    before, reported = 0, 0.0

    def report(position: int) -> None:
        nonlocal reported
        fraction = (before + position) / sum(sizes)
        if fraction - reported >= 0.005:
            reported = fraction
            progress(fraction)

    for path, size in zip(files, sizes, strict=True):
        try:
            _check_magic(path)
            with open(path, 'rb') as file:
                yield from _read_file(path, file, size, wanted, report)
        except OSError as error:
            raise _unreadable(path, error) from error
        before += size
    progress(1.0)


def _read_file(
    path: Path,
    file: BinaryIO,
    size: int,
    wanted: frozenset[str] | None,
    report: Callable[[int], None],
) -> Iterator[BagMessage]:
    channels = _Channels(path, wanted)
    spans, trouble = _layout(file, size, channels)
    # The earliest log time from each record on to the end of the file.
    earliest = [*accumulate(reversed([span.time for span in spans]), min, initial=_NEVER)][::-1]
    waiting: list[tuple[int, int, BagMessage]] = []
    count = last = 0
    for span, horizon in zip(spans, earliest[1:], strict=True):
        try:
            for message in channels.messages(_records(file, span, size)):
                heappush(waiting, (message.log_time, count, message))
                count += 1
        except (BagError, OSError):
            raise
        except Exception as error:  # mcap and each decompressor have their own for bad bytes
            horizon = _NEVER
            if span.end <= size:
                trouble = f'is damaged at byte {span.offset} ({error})'
        while waiting and waiting[0][0] <= horizon:
            last, _, message = heappop(waiting)
            yield message
        if horizon == _NEVER:
            break
        report(span.end)
    if trouble:
        read = f'{count} messages up to stamp {last / 1e9:.3f} s (log time) were read'
        raise Truncated(
            f'{path} {trouble}: {read if count else "there is no message before that"}; '
            f'mend: record again, or `mcap recover {path} -o NEW.mcap`'
        )


def _layout(file: BinaryIO, size: int, channels: _Channels) -> tuple[list[_Span], str]:
    """Where the messages are, in file order, and what is wrong with the file ('' if nothing)."""
    try:
        summary = SeekingReader(file).get_summary()
    except Exception:  # no summary, or any kind of damage to it
        summary = None
    # An index may leave out what the chunks say; then it is of no use here.
    if summary is not None and all(
        channel.schema_id in (0, *summary.schemas) for channel in summary.channels.values()
    ):
        for schema in summary.schemas.values():
            channels.add(schema)
        for channel in summary.channels.values():
            channels.add(channel)
        chunks = sorted(summary.chunk_indexes, key=attrgetter('chunk_start_offset'))
        ids = [chunk.message_index_offsets.keys() for chunk in chunks]
        if chunks and all(ids) and summary.channels.keys() >= set().union(*ids):
            return [
                _Span(c.chunk_start_offset, c.chunk_length, Opcode.CHUNK, c.message_start_time)
                for c in chunks
                if channels.want_any(c.message_index_offsets)
            ], ''
    return _scan(file, size)


def _scan(file: BinaryIO, size: int) -> tuple[list[_Span], str]:
    """The layout of a file without an index, from the heads of its records."""
    spans: list[_Span] = []
    offset = len(MCAP0_MAGIC)
    while offset + _HEAD.size <= size:
        file.seek(offset)
        opcode, length = _HEAD.unpack(file.read(_HEAD.size))
        span = _Span(offset, _HEAD.size + length, opcode, _NEVER)
        if opcode == 0:  # no record has this, but a disk may leave a run of zeros
            return spans, f'is damaged at byte {offset} (zeros in place of a record)'
        if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
            if opcode == Opcode.MESSAGE:
                file.seek(_MESSAGE.size - 2 * _TIME.size, SEEK_CUR)
            time = file.read(_TIME.size)
            if len(time) == _TIME.size:
                spans.append(span._replace(time=_TIME.unpack(time)[0]))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            spans.append(span)
        offset = span.end
        if opcode == Opcode.FOOTER and offset <= size:
            file.seek(offset)
            if file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
                return spans, ''
            break
    return spans, f'is cut off at byte {size}'


def _records(file: BinaryIO, span: _Span, size: int) -> bytes:
    """The records in a chunk, or a record by itself, as far as the file goes."""
    file.seek(span.offset)
    record = file.read(min(span.length, size - span.offset))
    if record[: _HEAD.size] != _HEAD.pack(span.opcode, span.length - _HEAD.size):
        raise ValueError('no record where the index has one')
    if span.opcode != Opcode.CHUNK:
        return record
    # Read this way, the data of a chunk that is cut are as short as the file leaves them.
    chunk = Chunk.read(ReadDataStream(BytesIO(record[_HEAD.size :])))
    if chunk.compression == 'zstd':
        records = zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data)
    elif chunk.compression == 'lz4':
        records = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data)
    elif chunk.compression == '':
        records = chunk.data
    else:
        raise BagError(
            f"{file.name}: chunks are compressed with '{chunk.compression}'; "
            f'mend: `mcap compress {file.name} -o NEW.mcap`'
        )
    if len(record) == span.length:
        if len(records) != chunk.uncompressed_size:
            raise ValueError('a chunk of the wrong size')
        if chunk.uncompressed_crc not in (0, zlib.crc32(records)):
            raise ValueError('the checksum of a chunk is wrong')
    return records
