"""Messages of rosbag2 files in SQLite (.db3), the storage before MCAP."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import BinaryIO

import zstandard

from kinpole_ros.bags._channels import BagMessage, unpacked_message
from kinpole_ros.bags._files import SQLITE_MAGIC, ZSTD_MAGIC, BagError, Truncated
from kinpole_ros.files import printable

_LARGEST = 1 << 25  # bytes of a message, unpacked
_BLOCK, _BLOCK_BYTES = 1000, 1 << 20  # messages read at a time
_TABLES = {'topics', 'messages'}


def is_sqlite(file: BinaryIO) -> bool:
    """Return whether an open file is one of SQLite, and go to its beginning."""
    magic = file.read(len(SQLITE_MAGIC))
    file.seek(0)
    return magic == SQLITE_MAGIC


@contextmanager
def _open(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a file to read it only, whatever its folder allows; errors of SQLite become BagError."""
    try:
        with closing(sqlite3.connect(f'{path.absolute().as_uri()}?immutable=1', uri=True)) as file:
            file.execute('PRAGMA trusted_schema = OFF')
            # A view could run for ever.
            tables = file.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
            if not {name for (name,) in tables} >= _TABLES:
                raise BagError(f'{path} has no tables of rosbag2; fix: record again')
            yield file
    except BagError:
        raise
    except (sqlite3.Error, zstandard.ZstdError, ValueError, OverflowError) as error:
        why = printable(str(error)[:80])
        raise Truncated(
            f'{path} is damaged ({why}); fix: record again, or `sqlite3 {path} .recover`'
        ) from error


def sqlite_topics(path: Path) -> tuple[dict[str, str], dict[str, str]]:
    """Read types by topic, and definitions by type, which files before ROS 2 Iron do not have."""
    with _open(path) as file:
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


def sqlite_blocks(path: Path, wanted: frozenset[str] | None) -> Iterator[list[BagMessage]]:
    """Yield messages on the `wanted` topics, or all that are CDR, in order of log time."""
    with _open(path) as file:
        found = file.execute("SELECT id, name, type FROM topics WHERE serialization_format = 'cdr'")
        topics = {number: (str(name), str(kind)) for number, name, kind in found}
        chosen = [k for k, (name, _) in topics.items() if wanted is None or name in wanted]
        marks = ','.join('?' * len(chosen))
        messages = file.execute(
            'SELECT topic_id, timestamp, data FROM messages '
            f'WHERE topic_id IN ({marks}) AND length(data) <= {_LARGEST} ORDER BY timestamp, id',
            chosen,
        )
        block: list[BagMessage] = []
        size = 0
        for topic, time, data in messages:
            if not (isinstance(time, int) and time >= 0 and isinstance(data, bytes)):
                raise Truncated(f'{path} is damaged at time {time}; fix: record again')
            if data.startswith(ZSTD_MAGIC):  # compressed message by message
                data = unpacked_message(data, _LARGEST)
            block.append(BagMessage(*topics[topic], data, time))
            size += len(data)
            if size > _BLOCK_BYTES or len(block) == _BLOCK:
                yield block
                block, size = [], 0
        if block:
            yield block
