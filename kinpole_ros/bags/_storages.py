"""Messages of bags in other storages than MCAP: SQLite, rosbag2's former default, and ROS 1."""

from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import zstandard

from kinpole_ros.bags._channels import BagMessage, unpack_message
from kinpole_ros.bags._files import (
    CONVERT,
    SQLITE_MAGIC,
    ZSTD_MAGIC,
    BagError,
    Truncated,
    open_file,
)
from kinpole_ros.bags._layout import unpack_lz4
from kinpole_ros.files import open_regular, printable

if TYPE_CHECKING:
    import sqlite3

_LARGEST_MESSAGE = 1 << 25  # bytes of a message in SQLite, unpacked
_COPIED_BYTES = 1 << 20  # at a time
_TABLES = {'topics', 'messages'}
_LARGEST_ROS1_CHUNK = 1 << 26  # bytes, unpacked; rosbag makes chunks of 768 KiB


def is_sqlite(file: BinaryIO) -> bool:
    """Return whether an open file is one of SQLite, and go to its beginning."""
    magic = file.read(len(SQLITE_MAGIC))
    file.seek(0)
    return magic == SQLITE_MAGIC


@contextmanager
def _whole_database(path: Path) -> Iterator[str]:
    """
    Return the address of a database with all that its recorder wrote; no file is changed.

    A recorder that was killed leaves messages in a -wal beside the file, or a -journal of what it
    had not finished. SQLite merges either only into a file that it may write, so a copy is made,
    and so is one of a file that is compressed as a whole.
    """
    journals = [Path(f'{path}{ending}') for ending in ('-wal', '-journal')]
    journals = [file for file in journals if file.is_file() and file.stat().st_size]
    with open_regular(path) as content:
        is_packed = content.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
    if not (is_packed or journals):
        yield f'{path.absolute().as_uri()}?immutable=1'
        return
    import shutil
    import tempfile

    with tempfile.TemporaryDirectory(prefix='kinpole_') as folder:
        copy = Path(folder) / 'copy.db3'
        with open_file(path) as source, open(copy, 'wb') as target:
            _copy_bounded(path, source, target, folder, shutil.disk_usage(folder).free)
        for file in journals:
            shutil.copyfile(file, f'{copy}{str(file).removeprefix(str(path))}')
        yield copy.as_uri()


def _copy_bounded(path: Path, source: BinaryIO, target: BinaryIO, folder: str, free: int) -> None:
    """Copy a file to a disk; raises BagError where it would take most of the `free` bytes."""
    size = 0
    while block := source.read(_COPIED_BYTES):
        size += len(block)
        if size > free / 2:
            raise BagError(
                f'{path} needs a copy of more than half of the free space of '
                f'{Path(folder).parent}, {free >> 20} MiB; fix: free some, or set TMPDIR to '
                'another folder'
            )
        target.write(block)


@contextmanager
def _open_sqlite(path: Path) -> 'Iterator[sqlite3.Connection]':
    """Open a file read-only, whatever its folder allows; errors of SQLite become BagError."""
    import sqlite3

    try:
        with (
            _whole_database(path) as address,
            closing(sqlite3.connect(address, uri=True)) as file,
        ):
            file.execute('PRAGMA trusted_schema = OFF')
            # A view could run forever.
            tables = file.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
            if not {name for (name,) in tables} >= _TABLES:
                raise BagError(f'{path} has no tables of rosbag2; fix: record again')
            yield file
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


def sqlite_messages(path: Path, requested: frozenset[str] | None) -> Iterator[BagMessage]:
    """Yield messages on the requested topics, or all that are CDR, in order of log time."""
    too_large = 0
    with _open_sqlite(path) as file:
        rows = file.execute("SELECT id, name, type FROM topics WHERE serialization_format = 'cdr'")
        topics = {number: (str(name), str(kind)) for number, name, kind in rows}
        ids = [k for k, (name, _) in topics.items() if requested is None or name in requested]
        messages = file.execute(
            'SELECT topic_id, timestamp, length(data), '
            f'CASE WHEN length(data) <= {_LARGEST_MESSAGE} THEN data END FROM messages '
            f'WHERE topic_id IN ({",".join("?" * len(ids))}) ORDER BY timestamp, id',
            ids,
        )
        for topic, time, length, data in messages:
            if data is None and length is not None:
                too_large += 1
                continue
            if not (isinstance(time, int) and time >= 0 and isinstance(data, bytes)):
                raise Truncated(f'{path} is damaged at time {time}; fix: record again')
            if data.startswith(ZSTD_MAGIC):  # compressed message by message
                data = unpack_message(data, _LARGEST_MESSAGE)
            yield BagMessage(*topics[topic], data, time)
    if too_large:
        raise Truncated(
            f'{path}: messages of more than {_LARGEST_MESSAGE >> 20} MiB, {too_large} of them, are '
            f'left out; {CONVERT.format(path)}'
        )


@contextmanager
def _open_ros1(path: Path) -> Iterator[Any]:
    """Open a whole bag of ROS 1 by rosbags, whose chunks unpack to a bounded size."""
    # Only these bags need it.
    from rosbags.rosbag1 import Reader
    from rosbags.rosbag1.reader import decompressors

    bounded = {decompressors['bz2']: _unpack_bz2, decompressors['lz4']: _unpack_lz4}
    try:
        with Reader(path) as bag:
            for position, chunk in bag.chunks.items():
                unpack = bounded.get(chunk.decompressor, chunk.decompressor)
                bag.chunks[position] = chunk._replace(decompressor=unpack)
            yield bag
    except Exception as error:  # rosbags and each decompressor have their own for bad bytes
        reason = printable(str(error)[:80]) or type(error).__name__
        raise BagError(
            f'{path} is not a whole ROS 1 bag, it is cut off or damaged ({reason}); '
            f'fix: `rosbag reindex {path}`, or record again'
        ) from error


def _unpack_bz2(data: bytes) -> bytes:
    import bz2

    return bz2.BZ2Decompressor().decompress(data, _LARGEST_ROS1_CHUNK)


def _unpack_lz4(data: bytes) -> bytes:
    return unpack_lz4(data, _LARGEST_ROS1_CHUNK)


def ros1_topics(path: Path) -> tuple[dict[str, str], dict[str, str]]:
    """Read types by topic, and definitions by type."""
    with _open_ros1(path) as bag:
        types = {one.topic: one.msgtype for one in bag.connections}
        return types, {one.msgtype: one.msgdef.data for one in bag.connections}


def ros1_messages(path: Path, topics: Collection[str]) -> Iterator[BagMessage]:
    """Yield the messages on these topics, in the encoding of ROS 1, in order of log time."""
    with _open_ros1(path) as bag:
        requested = [one for one in bag.connections if one.topic in topics]
        for one, log_time, data in bag.messages(requested) if requested else ():
            yield BagMessage(one.topic, one.msgtype, data, log_time)
