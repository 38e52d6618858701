"""Messages of ROS 1 bags (version 2.0), read from front to back, as one may be cut off."""

import bz2
import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from kinpole_ros.bags._files import BagError, Truncated
from kinpole_ros.bags._layout import unpack_lz4
from kinpole_ros.files import open_regular, printable

_MAGIC = b'#ROSBAG V2.0\n'
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7  # kinds of records
_LARGEST = 1 << 26  # bytes of a record, and of a chunk unpacked
_SIZE = struct.Struct('<I')


class Ros1Message(NamedTuple):
    """A message with its topic and type as described in the bag: 'package/Type' and its text."""

    topic: str
    type_name: str
    definition: str
    data: bytes
    log_time: int  # ns


def ros1_messages(path: Path) -> Iterator[Ros1Message]:
    """
    Yield the messages of a bag in file order.

    Raises Truncated at the place where the bag is cut or damaged.
    """
    connections: dict[bytes, tuple[str, str, str]] = {}
    with open_regular(path) as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise BagError(f'{path} is a ROS 1 bag of another version than 2.0; fix: `rosbag fix`')
        try:
            for fields, data in _records(file):
                kind = fields[b'op'][0]
                if kind != _CHUNK:
                    yield from _messages(kind, fields, data, connections)
                    continue
                for inner, content in _records(io.BytesIO(_unpack(fields, data))):
                    yield from _messages(inner[b'op'][0], inner, content, connections)
        except (struct.error, LookupError, ValueError, OSError, EOFError, RuntimeError) as error:
            why = printable(str(error)[:80]) or type(error).__name__
            raise Truncated(
                f'{path} is cut off or damaged before byte {file.tell()} ({why}); '
                f'fix: `rosbag reindex {path}`'
            ) from error


def _records(file: BinaryIO) -> Iterator[tuple[dict[bytes, bytes], bytes]]:
    """Yield the fields of the header and the data of each record."""
    while start := file.read(_SIZE.size):
        header = _read(file, *_SIZE.unpack(start))
        yield _fields(header), _read(file, *_SIZE.unpack(file.read(_SIZE.size)))


def _read(file: BinaryIO, size: int) -> bytes:
    if size > _LARGEST:
        raise ValueError(f'a record of {size} bytes')
    data = file.read(size)
    if len(data) < size:
        raise ValueError('a record is cut')
    return data


def _fields(header: bytes) -> dict[bytes, bytes]:
    fields, place = {}, 0
    while place < len(header):
        (size,) = _SIZE.unpack_from(header, place)
        place += _SIZE.size + size
        name, _, value = header[place - size : place].partition(b'=')
        fields[name] = value
    return fields


def _unpack(fields: dict[bytes, bytes], data: bytes) -> bytes:
    how = fields[b'compression']
    if how == b'bz2':
        return bz2.BZ2Decompressor().decompress(data, _LARGEST)
    if how == b'lz4':
        return unpack_lz4(data, _LARGEST)
    if how != b'none':
        raise ValueError(f'compression {how!r}')
    return data


def _messages(
    kind: int, fields: dict[bytes, bytes], data: bytes, known: dict[bytes, tuple[str, str, str]]
) -> Iterator[Ros1Message]:
    """Take note of a connection, or yield a message."""
    if kind == _CONNECTION:
        about = _fields(data)
        texts = fields[b'topic'], about[b'type'], about[b'message_definition']
        topic, name, definition = (text.decode() for text in texts)
        if not (topic.isprintable() and name.isprintable()):
            raise ValueError('a name that is none')
        known[fields[b'conn']] = topic, name, definition
    elif kind == _MESSAGE:
        seconds, rest = struct.unpack('<II', fields[b'time'])
        yield Ros1Message(*known[fields[b'conn']], data, seconds * 1_000_000_000 + rest)
