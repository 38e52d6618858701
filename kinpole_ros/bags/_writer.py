"""Bags as rosbag2 writes them, so that `ros2 bag`, Foxglove and other tools read ours.

The records are mcap's; they are assembled here, since mcap's own writer takes four times as
long for a message, which is half of what a replay with all topics costs.
"""

import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Channel,
    DataEnd,
    Footer,
    Header,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from kinpole_ros.bags._chunk import CHUNK_SIZE, COUNTED, HEADS, MESSAGE_HEAD, PendingChunk, packed
from kinpole_ros.bags._files import LIBRARY, BagError, unwritable
from kinpole_ros.bags._schema import definition, message_class
from kinpole_ros.files import whole
from kinpole_ros.messages import serialize_message, type_name, with_zero_padding

_PIECE = 1 << 20  # bytes copied at a time
_FOOTER = struct.Struct('<BQQQ')  # all that the checksum in it covers


@dataclass
class _Channel:
    record: Channel
    message_type: type | str
    type_name: str
    messages: int = 0


@contextmanager
def in_place_of(path: str | Path) -> Iterator[Path]:
    """A place to write what is to become `path`, as `files.whole`; raises BagError."""
    try:
        with whole(path) as part:
            yield part
    except OSError as error:
        raise unwritable(path, error) from error


class BagWriter:
    """Writes ROS 2 messages to an .mcap file; use it in a `with` block.

    The file is written under its own name from the start, replacing one that was there, and folders
    above it are made. A program that dies leaves all finished chunks (256 KiB of messages) to be
    read; `flush` finishes the present one. Equal messages make equal files, for nothing of the
    clock, the machine or its memory goes in: padding is zero, also in what `write_raw` is given.

    `library` is what the file says made it, and `name` what messages call the file, where that is
    not its path.

    Raises BagError when the file cannot be written; after that the file is left as it is, and
    what was written before can be read.
    """

    def __init__(
        self, path: str | Path, library: str = LIBRARY, name: str | Path | None = None
    ) -> None:
        self._path = Path(name or path)
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[str, Schema] = {}
        self._chunk = PendingChunk()
        self._place = 0
        # Packed, since a long bag has many of them.
        self._chunk_indexes = bytearray()
        self._chunk_count = 0
        self._earliest, self._latest = 2**64, 0
        try:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            self._file = open(path, 'wb')  # noqa: SIM115 - close() does
            self._put(MCAP0_MAGIC + packed(Header('ros2', library)))
            # A recording that cannot be should not seem to run until something comes.
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def __enter__(self) -> 'BagWriter':
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            # What went wrong first is what the user should see. It may have come, as SIGTERM does,
            # amid a chunk, and then that one cannot be finished.
            with suppress(Exception):
                self.close()

    def write(self, topic: str, message: Any, log_time: int) -> None:
        """Write a message object; `log_time` in ns."""
        self._write(
            self._channel(topic, type(message), log_time), serialize_message(message), log_time
        )

    def write_raw(self, topic: str, message_type: type | str, data: bytes, log_time: int) -> None:
        """
        Write a message that is CDR already; its type is a class or 'package/msg/Name'.

        Its padding becomes zero, and what is behind its last field is left out. Data that are no
        such message are written as they are.
        """
        channel = self._channel(topic, message_type, log_time)
        data = with_zero_padding(data, channel.message_type)
        self._write(channel, data, log_time)

    def _write(self, channel: _Channel, data: bytes, log_time: int) -> None:
        number, sequence = channel.record.id, channel.messages & 0xFFFFFFFF
        length = COUNTED + len(data)
        head = MESSAGE_HEAD.pack(Opcode.MESSAGE, length, number, sequence, log_time, log_time)
        self._chunk.add(head + data, number, log_time)
        channel.messages += 1
        if self._chunk.size > CHUNK_SIZE:
            self._finish_chunk()

    def write_many(
        self, columns: Iterable[tuple[str, type | str, Sequence[int], Sequence[bytes]]]
    ) -> None:
        """
        Write the messages of several topics: for each its name, type, log times (ns) and CDR data.

        They are written in order of log time, those of equal times in the order of `columns`, as
        if they had come singly in that order.
        """
        checked = []
        for topic, message_type, log_times, data in columns:
            if len(log_times) != len(data):
                raise ValueError(f"'{topic}': {len(log_times)} log times, {len(data)} messages")
            if len(data):
                checked.append(
                    (self._channel(topic, message_type, min(log_times)), log_times, data)
                )
        if not checked:
            return
        parts, content = [], list[bytes]()
        for channel, log_times, data in checked:
            heads = np.empty(len(data), HEADS)
            heads['opcode'] = Opcode.MESSAGE
            heads['length'] = np.fromiter(map(len, data), '<u8', len(data)) + np.uint64(COUNTED)
            heads['channel'] = channel.record.id
            heads['sequence'] = channel.messages + np.arange(len(data)) & 0xFFFFFFFF
            heads['log_time'] = heads['publish_time'] = log_times
            channel.messages += len(data)
            parts.append(heads)
            content += data
        heads = np.concatenate(parts)
        order = np.argsort(heads['log_time'], kind='stable')
        heads, content = heads[order], [content[k] for k in order.tolist()]
        ends = np.cumsum(heads['length'].astype(np.int64) + HEADS.itemsize - COUNTED)
        first = 0
        while first < len(content):
            # The chunk ends with the message that makes it too large.
            room = CHUNK_SIZE - self._chunk.size + (ends[first - 1] if first else 0)
            last = min(int(np.searchsorted(ends, room, side='right')) + 1, len(content))
            self._chunk.extend(heads[first:last], content[first:last])
            first = last
            if self._chunk.size > CHUNK_SIZE:
                self._finish_chunk()

    def append(self, path: Path) -> None:
        """
        Add all messages of another file that a BagWriter wrote, which come later.

        Its topics must be ours, in the same order, or be the first ones here.
        """
        self._finish_chunk()
        with open(path, 'rb') as file:
            summary = make_reader(file).get_summary()
            if summary is None or summary.statistics is None:
                raise ValueError(f'{path} has no summary')
            for number, record in sorted(summary.channels.items()):
                schema = summary.schemas[record.schema_id]
                channel = self._channels.get(record.topic)
                if channel is None:
                    self._schemas.setdefault(schema.name, schema)
                    channel = _Channel(record, schema.name, schema.name)
                    self._channels[record.topic] = channel
                if channel.record.id != number:
                    raise ValueError(f'{path} has other topics')
                channel.messages += summary.statistics.channel_message_counts.get(number, 0)
            indexes = summary.chunk_indexes
            if not indexes:
                return
            first, last = indexes[0], indexes[-1]
            end = last.chunk_start_offset + last.chunk_length + last.message_index_length
            file.seek(first.chunk_start_offset)
            shift = self._place - first.chunk_start_offset
            left = end - first.chunk_start_offset
            try:
                while left and (piece := file.read(min(left, _PIECE))):
                    self._put(piece)
                    left -= len(piece)
            except OSError as error:
                raise self._failed(error) from error
        for index in indexes:
            index.chunk_start_offset += shift
            places = index.message_index_offsets
            index.message_index_offsets = {number: at + shift for number, at in places.items()}
            self._chunk_indexes += packed(index)
        self._chunk_count += len(indexes)
        self._earliest = min(self._earliest, summary.statistics.message_start_time)
        self._latest = max(self._latest, summary.statistics.message_end_time)

    def add_topic(self, topic: str, message_type: type) -> None:
        """Have the topic in the bag, even if no message comes."""
        if topic not in self._channels:
            self._add_channel(topic, message_type)

    def flush(self) -> None:
        """Hand all messages so far to the operating system, as a chunk that can be read."""
        self._finish_chunk()

    def close(self) -> None:
        """Write what remains and the index; a second call does nothing."""
        if self._file.closed:
            return
        self._finish_chunk()
        try:
            self._put(packed(DataEnd(0)))
            self._put(self._summary())
            self._file.close()
        except OSError as error:
            raise self._failed(error) from error

    def _channel(self, topic: str, message_type: type | str, log_time: int) -> _Channel:
        """The topic's channel, once it is clear that a message may go there."""
        if self._file.closed:
            raise BagError(f'{self._path} is closed; fix: write before that')
        if log_time < 0:
            raise BagError(
                f"{self._path}: a message for '{topic}' has the log time {log_time} ns; "
                'fix: give stamps from 0 up'
            )
        channel = self._channels.get(topic) or self._add_channel(topic, message_type)
        if message_type not in (channel.message_type, channel.type_name):
            raise BagError(
                f"{self._path}: topic '{topic}' holds {channel.type_name}, so a message of "
                f'type {message_type} cannot be added; fix: use another topic'
            )
        return channel

    def _add_channel(self, topic: str, message_type: type | str) -> _Channel:
        cls = message_class(message_type) if isinstance(message_type, str) else message_type
        name = type_name(cls)
        if name not in self._schemas:
            number = len(self._schemas) + 1
            self._schemas[name] = Schema(
                id=number, data=definition(cls).encode(), encoding='ros2msg', name=name
            )
            self._chunk.add(packed(self._schemas[name]))
        # rosbag2 keeps the publishers' QoS here; empty means unknown, and it takes its default.
        qos = {'offered_qos_profiles': ''}
        record = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding='cdr',
            metadata=qos,
            schema_id=self._schemas[name].id,
        )
        self._chunk.add(packed(record))
        self._channels[topic] = _Channel(record, cls, name)
        return self._channels[topic]

    def _finish_chunk(self) -> None:
        chunk = self._chunk.finish(self._place)
        if chunk is None:
            return
        self._chunk_indexes += chunk.entry
        self._chunk_count += 1
        self._earliest = min(self._earliest, chunk.earliest)
        self._latest = max(self._latest, chunk.latest)
        self._chunk = PendingChunk()
        try:
            self._put(chunk.records)
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def _summary(self) -> bytes:
        counts = {c.record.id: c.messages for c in self._channels.values() if c.messages}
        statistics = Statistics(
            attachment_count=0,
            metadata_count=0,
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            chunk_count=self._chunk_count,
            message_count=sum(counts.values()),
            channel_message_counts=counts,
            message_start_time=self._earliest if counts else 0,
            message_end_time=self._latest,
        )
        groups = {
            Opcode.SCHEMA: packed(*self._schemas.values()),
            Opcode.CHANNEL: packed(*(channel.record for channel in self._channels.values())),
            Opcode.STATISTICS: packed(statistics),
            Opcode.CHUNK_INDEX: bytes(self._chunk_indexes),
        }
        summary = b''.join(groups.values())
        places = []
        place = self._place
        for opcode, group in groups.items():
            if group:
                places.append(SummaryOffset(opcode, group_start=place, group_length=len(group)))
            place += len(group)
        offsets = packed(*places)
        covered = summary + offsets + _FOOTER.pack(Opcode.FOOTER, 20, self._place, place)
        footer = packed(Footer(self._place, place, zlib.crc32(covered)))
        return summary + offsets + footer + MCAP0_MAGIC

    def _put(self, content: bytes) -> None:
        self._file.write(content)
        self._place += len(content)

    def _failed(self, error: OSError) -> BagError:
        # Nothing more must follow a chunk that was written in part; the rest of it is lost.
        if hasattr(self, '_file'):
            with suppress(OSError):
                self._file.close()
        return unwritable(self._path, error)
