"""The messages in a run of MCAP records, by the channels described there."""

import struct
from collections.abc import Collection, Iterable
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from kinpole_ros import messages
from kinpole_ros.bags._files import ZSTD_MAGIC, BagError

HEAD = struct.Struct('<BQ')  # of every record: opcode, length of the body
MESSAGE = struct.Struct('<H4xQ8x')  # channel, (sequence,) log time (, publish time)
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
# Limits of what a file may claim to be unpacked: real recordings stay far below, bombs do not.
LARGEST = 1 << 30  # bytes
LARGEST_CHUNK = 1 << 27  # bytes, all in memory at once: recorders make chunks of 1 to 4 MiB
_ALWAYS_ALLOWED = 1 << 24  # bytes
_LARGEST_RATIO = 1000
_LONGEST_NAME = 1000  # characters


def message_class(name: str) -> type:
    """
    Return the class of a message type.

    Parameters
    ----------
    name : str
        'package/msg/Name' or 'package/Name'.

    Returns
    -------
    type

    Raises
    ------
    BagError
        If the type is not installed.

    """
    try:
        cls: type = messages.message_class(name)
    except LookupError as error:
        raise BagError(str(error)) from error
    return cls


class BagMessage(NamedTuple):
    """One message as recorded.

    Attributes
    ----------
    topic : str
    type_name : str
        Such as 'visualization_msgs/msg/MarkerArray'.
    data : bytes
        The message in CDR.
    log_time : int
        ns

    """

    topic: str
    type_name: str
    data: bytes
    log_time: int


class Channels:
    """The schemas and channels described so far, and the messages of the requested topics."""

    def __init__(self, path: Path, topics: frozenset[str] | None) -> None:
        self.types: dict[str, str] = {}  # by topic
        self.definitions: dict[str, str] = {}  # by type
        self._path = path
        self._requested = topics
        self._schemas: dict[int, str] = {}
        self._records: dict[tuple[str, int], Schema | Channel] = {}
        # Topic and type of each channel; None where its messages are not requested.
        self._channels: dict[int, tuple[str, str] | None] = {}
        self._refused: dict[int, str] = {}

    def add(self, record: Schema | Channel) -> None:
        """Add a description; raises ValueError for one that cannot be, or contradicts another."""
        name = record.name if isinstance(record, Schema) else record.topic
        if not name.isprintable() or len(name) > _LONGEST_NAME:
            raise ValueError('a name that is none')
        kind = type(record).__name__
        if self._records.setdefault((kind, record.id), record) != record:
            raise ValueError(f'it describes {kind.lower()} {record.id} in two ways')
        if isinstance(record, Schema):
            self._schemas[record.id] = record.name
            self.definitions[record.name] = record.data.decode(errors='replace')
            return
        type_name = self._schemas.get(record.schema_id, '')
        self.types[record.topic] = type_name
        by_name = self._requested is not None and record.topic in self._requested
        if record.message_encoding == 'cdr' and type_name:
            is_requested = by_name or self._requested is None
            self._channels[record.id] = (record.topic, type_name) if is_requested else None
        elif by_name:
            self._refused[record.id] = (
                f"{self._path}: topic '{record.topic}' has messages in "
                f"{record.message_encoding!r} of type '{type_name}'; fix: give a topic of ROS 2 "
                'messages (cdr)'
            )
        elif self._requested is not None or record.schema_id in (0, *self._schemas):
            self._channels[record.id] = None

    def add_all(self, records: Iterable[Schema | Channel]) -> None:
        """Add descriptions in any order, as those of a summary."""
        for record in sorted(records, key=lambda record: isinstance(record, Channel)):
            self.add(record)

    @property
    def topics(self) -> dict[int, str]:
        """The requested topics by channel."""
        return {number: row[0] for number, row in self._channels.items() if row is not None}

    def are_requested(self, topics: Collection[str]) -> bool:
        """Return whether any of these topics is requested."""
        return self._requested is None or not self._requested.isdisjoint(topics)

    def read(self, records: bytes, messages: list[BagMessage]) -> None:
        """Append the requested messages in a run of records; raises where the last one is cut."""
        # See _layout for the cost of mcap's own loop.
        end, size = 0, len(records)
        remaining = largest(size)
        while end < size:
            opcode, length = HEAD.unpack_from(records, end)
            start = end + HEAD.size
            end = start + length
            if end > size:
                raise ValueError('a record is cut')
            if opcode == _MESSAGE_OPCODE:
                channel_id, log_time = MESSAGE.unpack_from(records, start)
                if channel_id in self._refused:
                    raise BagError(self._refused[channel_id])
                if channel_id not in self._channels:
                    raise ValueError(f'a message of channel {channel_id}, which is not described')
                if (channel := self._channels[channel_id]) is not None:
                    data = records[start + MESSAGE.size : end]
                    if data.startswith(ZSTD_MAGIC):  # rosbag2 compressed message by message
                        data = unpack_message(data, remaining)
                        remaining -= len(data)
                    messages.append(BagMessage(*channel, data, log_time))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.add(parse_description(opcode, records[start:end]))
            elif opcode == 0:
                raise ValueError('zeros in place of a record')


def parse_description(opcode: int, body: bytes) -> Schema | Channel:
    """Return the schema or channel in the body of its record."""
    stream = ReadDataStream(BytesIO(body))
    return Schema.read(stream) if opcode == Opcode.SCHEMA else Channel.read(stream)


def unpack_message(data: bytes, most: int) -> bytes:
    """Unpack a message that rosbag2 compressed, to at most so many bytes."""
    size = zstandard.frame_content_size(data)
    if size > most:
        raise ValueError(f'a message that claims to be {size} bytes unpacked')
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(most, 1))


def largest(packed: int) -> int:
    """Return how many bytes so many compressed ones may unpack to, before it is damage."""
    return min(LARGEST, max(_ALWAYS_ALLOWED, _LARGEST_RATIO * packed))
