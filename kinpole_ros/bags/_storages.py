"""Messages of bags in other storages than MCAP: SQLite, rosbag2's former default, and ROS 1."""

import bz2
import io
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard

from kinpole_ros.bags._channels import BagMessage, unpack_message
from kinpole_ros.bags._files import SQLITE_MAGIC, ZSTD_MAGIC, BagError, Truncated
from kinpole_ros.bags._layout import unpack_lz4
from kinpole_ros.files import open_regular, printable

_LARGEST_MESSAGE = 1 << 25  # bytes of a message in SQLite, unpacked
_BLOCK, _BLOCK_BYTES = 1000, 1 << 20  # messages read at a time
_TABLES = {'topics', 'messages'}
_ROS1_MAGIC = b'#ROSBAG V2.0\n'
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7  # kinds of records in ROS 1
_LARGEST_RECORD = 1 << 26  # bytes of a record in ROS 1, and of a chunk unpacked
_SIZE = struct.Struct('<I')


def is_sqlite(file: BinaryIO) -> bool:
    """Return whether an open file is one of SQLite, and go to its beginning."""
    magic = file.read(len(SQLITE_MAGIC))
    file.seek(0)
    return magic == SQLITE_MAGIC


@contextmanager
def _open_sqlite(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a file read-only, whatever its folder allows; errors of SQLite become BagError."""
    try:
        with closing(sqlite3.connect(f'{path.absolute().as_uri()}?immutable=1', uri=True)) as file:
            file.execute('PRAGMA trusted_schema = OFF')
            # A view could run forever.
            tables = file.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
            if not {name for (name,) in tables} >= _TABLES:
                raise BagError(f'{path} has no tables of rosbag2; fix: record again')
            yield file
    except BagError:
        raise
    except (sqlite3.Error, zstandard.ZstdError, ValueError, OverflowError) as error:
        raise Truncated(
            f'{path} is damaged ({printable(str(error)[:80])}); fix: record again, or '
            f'`sqlite3 {path} .recover`'
        ) from error


def sqlite_topics(path: Path) -> tuple[dict[str, str], dict[str, str]]:
    """Read types by topic, and definitions by type, which files before ROS 2 Iron do not have."""
    with _open_sqlite(path) as file:
        topics = dict(file.execute('SELECT CAST(name AS TEXT), CAST(type AS TEXT) FROM topics'))
        tables = {name for (name,) in file.execute('SELECT name FROM sqlite_master')}
        definitions = {}
        if 'message_definitions' in tables:
            definitions = dict(
                file.execute(
                    'SELECT CAST(topic_type AS TEXT), CAST(encoded_message_definition AS TEXT) '
                    'FROM message_definitions'
                )
            )
    for name in (*topics, *topics.values()):
        if not (name and name.isprintable() and len(name) < 1000):
            raise BagError(f'{path} has a topic or type with no name; fix: record again')
    return topics, definitions


def sqlite_blocks(path: Path, requested: frozenset[str] | None) -> Iterator[list[BagMessage]]:
    """Yield messages on the requested topics, or all that are CDR, in order of log time."""
    with _open_sqlite(path) as file:
        rows = file.execute("SELECT id, name, type FROM topics WHERE serialization_format = 'cdr'")
        topics = {number: (str(name), str(kind)) for number, name, kind in rows}
        ids = [k for k, (name, _) in topics.items() if requested is None or name in requested]
        messages = file.execute(
            'SELECT topic_id, timestamp, data FROM messages '
            f'WHERE topic_id IN ({",".join("?" * len(ids))}) '
            f'AND length(data) <= {_LARGEST_MESSAGE} ORDER BY timestamp, id',
            ids,
        )
        block: list[BagMessage] = []
        size = 0
        for topic, time, data in messages:
            if not (isinstance(time, int) and time >= 0 and isinstance(data, bytes)):
                raise Truncated(f'{path} is damaged at time {time}; fix: record again')
            if data.startswith(ZSTD_MAGIC):  # compressed message by message
                data = unpack_message(data, _LARGEST_MESSAGE)
            block.append(BagMessage(*topics[topic], data, time))
            size += len(data)
            if size > _BLOCK_BYTES or len(block) == _BLOCK:
                yield block
                block, size = [], 0
        if block:
            yield block


class Ros1Message(NamedTuple):
    """A message of ROS 1 with its topic, and its type as described in the bag."""

    topic: str
    type_name: str  # 'package/Type'
    definition: str
    data: bytes
    log_time: int  # ns


def ros1_messages(path: Path) -> Iterator[Ros1Message]:
    """
    Yield the messages of a ROS 1 bag (version 2.0) in file order.

    Raises Truncated at the place where the bag is cut or damaged, since rosbags needs an index at
    its end.
    """
    connections: dict[bytes, tuple[str, str, str]] = {}
    with open_regular(path) as file:
        if file.read(len(_ROS1_MAGIC)) != _ROS1_MAGIC:
            raise BagError(f'{path} is a ROS 1 bag of another version than 2.0; fix: `rosbag fix`')
        try:
            for fields, data in _ros1_records(file):
                if fields[b'op'][0] == _CHUNK:
                    records = _ros1_records(io.BytesIO(_unpack(fields, data)))
                else:
                    records = iter([(fields, data)])
                for inner, content in records:
                    yield from _ros1_message(inner, content, connections)
        except (struct.error, LookupError, ValueError, OSError, EOFError, RuntimeError) as error:
            reason = printable(str(error)[:80]) or type(error).__name__
            raise Truncated(
                f'{path} is cut off or damaged before byte {file.tell()} ({reason}); '
                f'fix: `rosbag reindex {path}`'
            ) from error


def _ros1_records(file: BinaryIO) -> Iterator[tuple[dict[bytes, bytes], bytes]]:
    """Yield the fields of the header and the data of each record."""
    while start := file.read(_SIZE.size):
        header = _read(file, *_SIZE.unpack(start))
        yield _fields(header), _read(file, *_SIZE.unpack(file.read(_SIZE.size)))


def _read(file: BinaryIO, size: int) -> bytes:
    if size > _LARGEST_RECORD:
        raise ValueError(f'a record of {size} bytes')
    data = file.read(size)
    if len(data) < size:
        raise ValueError('a record is cut')
    return data


def _fields(header: bytes) -> dict[bytes, bytes]:
    fields, offset = {}, 0
    while offset < len(header):
        (size,) = _SIZE.unpack_from(header, offset)
        offset += _SIZE.size + size
        name, _, value = header[offset - size : offset].partition(b'=')
        fields[name] = value
    return fields


def _unpack(fields: dict[bytes, bytes], data: bytes) -> bytes:
    compression = fields[b'compression']
    if compression == b'bz2':
        return bz2.BZ2Decompressor().decompress(data, _LARGEST_RECORD)
    if compression == b'lz4':
        return unpack_lz4(data, _LARGEST_RECORD)
    if compression != b'none':
        raise ValueError(f'compression {compression!r}')
    return data


def _ros1_message(
    fields: dict[bytes, bytes], data: bytes, connections: dict[bytes, tuple[str, str, str]]
) -> Iterator[Ros1Message]:
    """Yield the message in a record, or add the connection that it describes."""
    kind = fields[b'op'][0]
    if kind == _CONNECTION:
        about = _fields(data)
        texts = fields[b'topic'], about[b'type'], about[b'message_definition']
        topic, name, definition = (text.decode() for text in texts)
        if not (topic.isprintable() and name.isprintable()):
            raise ValueError('a name that is none')
        connections[fields[b'conn']] = topic, name, definition
    elif kind == _MESSAGE:
        seconds, nanoseconds = struct.unpack('<II', fields[b'time'])
        log_time = seconds * 1_000_000_000 + nanoseconds
        yield Ros1Message(*connections[fields[b'conn']], data, log_time)
