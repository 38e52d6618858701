"""The messages in a run of MCAP records, identified by the channels described there."""

import struct
from collections.abc import Collection
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from kinpole_ros.bags._files import ZSTD_MAGIC, BagError

HEAD = struct.Struct('<BQ')  # of every record: opcode, length of the rest
MESSAGE = struct.Struct('<H4xQ8x')  # channel, (sequence,) log time (, publish time)
_MESSAGE_RECORD = int(Opcode.MESSAGE)
# What may be claimed to be unpacked, in bytes: real recordings stay far below, bombs do not.
LARGEST = 1 << 30
LARGEST_CHUNK = 1 << 27  # bytes unpacked, all held at once: recorders make chunks of 1 to 4 MiB
_ALWAYS = 1 << 24
_RATIO = 1000
_LONGEST_NAME = 1000


class BagMessage(NamedTuple):
    """One message as recorded: `data` is CDR, `log_time` in ns."""

    topic: str
    type_name: str
    data: bytes
    log_time: int


class Channels:
    """What the schema and channel records met so far say, and the messages they explain."""

    def __init__(self, path: Path, wanted: frozenset[str] | None) -> None:
        self.types: dict[str, str] = {}
        self.definitions: dict[str, str] = {}  # by type
        # What is wrong with the descriptions; '' if nothing.
        self.doubt = ''
        self._path = path
        self._wanted = wanted
        self._schemas: dict[int, str] = {}
        self._described: dict[tuple[str, int], Schema | Channel] = {}
        self._chosen: dict[int, tuple[str, str] | None] = {}
        self._refused: dict[int, str] = {}
        self._untyped: dict[int, str] = {}

    def add(self, record: Schema | Channel) -> None:
        """Take note of a description; raises ValueError for names that no user should be shown."""
        name = record.name if isinstance(record, Schema) else record.topic
        if not name.isprintable() or len(name) > _LONGEST_NAME:
            raise ValueError('a name that is none')
        kind = type(record).__name__
        if self._described.setdefault((kind, record.id), record) != record:
            self.doubt = f'it describes {kind.lower()} {record.id} in two ways'
        if isinstance(record, Schema):
            self._schemas[record.id] = record.name
            self.definitions[record.name] = record.data.decode(errors='replace')
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
                f"{record.message_encoding!r} of type '{name}'; fix: give a topic of ROS 2 "
                'messages (cdr)'
            )
        elif self._wanted is None and record.schema_id not in (0, *self._schemas):
            self._untyped[record.id] = record.topic
        else:
            self._chosen[record.id] = None

    @property
    def topics(self) -> dict[int, str]:
        """The topics of the channels whose messages are handed out."""
        return {number: row[0] for number, row in self._chosen.items() if row is not None}

    def want_any(self, ids: Collection[int]) -> bool:
        return any(self._chosen.get(channel_id, True) for channel_id in ids)

    def read(self, records: bytes, found: list[BagMessage]) -> None:
        """Add the chosen messages in a run of records; raises where the last one is cut."""
        # By hand, since this is the hot loop: mcap's own takes three times as long, and copies
        # also what nobody asked for, such as images recorded with the markers.
        end, size = 0, len(records)
        room = largest(size)
        while end < size:
            opcode, length = HEAD.unpack_from(records, end)
            start = end + HEAD.size
            end = start + length
            if end > size:
                raise ValueError('a record is cut')
            if opcode == _MESSAGE_RECORD:
                channel_id, log_time = MESSAGE.unpack_from(records, start)
                if channel_id not in self._chosen:
                    self._complain(channel_id)
                if (chosen := self._chosen[channel_id]) is not None:
                    data = records[start + MESSAGE.size : end]
                    if data.startswith(ZSTD_MAGIC):  # rosbag2 compressed message by message
                        data = unpacked_message(data, room)
                        room -= len(data)
                    found.append(BagMessage(*chosen, data, log_time))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.add(description(opcode, records[start:end]))
            elif opcode == 0:
                raise ValueError('zeros in place of a record')

    def _complain(self, channel_id: int) -> None:
        if channel_id in self._untyped:
            self.doubt = f'it does not describe the type of {self._untyped[channel_id]}'
            self._chosen[channel_id] = None
            return
        if channel_id in self._refused:
            raise BagError(self._refused[channel_id])
        raise ValueError(f'a message of channel {channel_id}, which is not described')


def description(opcode: int, body: bytes) -> Schema | Channel:
    stream = ReadDataStream(BytesIO(body))
    return Schema.read(stream) if opcode == Opcode.SCHEMA else Channel.read(stream)


def unpacked_message(data: bytes, room: int) -> bytes:
    """Unpack a message that rosbag2 compressed, to so many bytes at most."""
    claimed = zstandard.frame_content_size(data)
    if claimed > room:
        raise ValueError(f'a message that claims to be {claimed} bytes unpacked')
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(room, 1))


def largest(packed: int) -> int:
    """How many bytes so many compressed ones may claim to be before it is taken for damage."""
    return min(LARGEST, max(_ALWAYS, _RATIO * packed))
