"""Bags as rosbag2 writes them, so that `ros2 bag`, Foxglove and other tools read ours."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, Writer
from rclpy.serialization import serialize_message

from kinpole_ros.bags._reader import BagError
from kinpole_ros.bags._schema import definition, message_class, type_name

# What a kill can lose, and what a reader must hold: small enough for both, large for zstd.
_CHUNK_SIZE = 256 * 1024


@dataclass
class _Channel:
    id: int
    message_type: type
    type_name: str
    messages: int = 0


class BagWriter:
    """Writes ROS 2 messages to an .mcap file; use it in a `with` block.

    The file is written under its own name from the start, replacing one that was there, and folders
    above it are made. A program that dies leaves all finished chunks (256 KiB of messages) to be
    read; `flush` finishes the present one. Equal data make equal files, for nothing of the clock
    or the machine goes in; but rclpy leaves the padding in its data to chance, so compare bags
    by their decoded messages.

    Raises BagError when the file cannot be written; after that the file is left as it is, and
    what was written before can be read.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[str, int] = {}
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(self._path, 'wb')  # noqa: SIM115 - close() does
            self._writer = Writer(
                self._file, chunk_size=_CHUNK_SIZE, compression=CompressionType.ZSTD
            )
            self._writer.start(profile='ros2', library='kinpole_ros')
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
            with suppress(BagError):  # what went wrong first is what the user should see
                self.close()

    def write(self, topic: str, message: Any, log_time: int) -> None:
        """Write an rclpy message; `log_time` in ns."""
        self.write_raw(topic, type(message), serialize_message(message), log_time)

    def write_raw(self, topic: str, message_type: type | str, data: bytes, log_time: int) -> None:
        """Write a message that is CDR already; its type is a class or 'package/msg/Name'."""
        if self._file.closed:
            raise BagError(f'{self._path} is closed; mend: write before that')
        if log_time < 0:
            raise BagError(
                f"{self._path}: a message for '{topic}' has the log time {log_time} ns; "
                'mend: give stamps from 0 up'
            )
        try:
            channel = self._channels.get(topic) or self._add_channel(topic, message_type)
            if message_type not in (channel.message_type, channel.type_name):
                raise BagError(
                    f"{self._path}: topic '{topic}' holds {channel.type_name}, so a message of "
                    f'type {message_type} cannot be added; mend: use another topic'
                )
            self._writer.add_message(
                channel_id=channel.id,
                log_time=log_time,
                publish_time=log_time,
                sequence=channel.messages,
                data=data,
            )
            channel.messages += 1
        except OSError as error:
            raise self._failed(error) from error

    def add_topic(self, topic: str, message_type: type) -> None:
        """Have the topic in the bag, even if no message comes."""
        try:
            if topic not in self._channels:
                self._add_channel(topic, message_type)
        except OSError as error:
            raise self._failed(error) from error

    def flush(self) -> None:
        """Hand all messages so far to the operating system, as a chunk that can be read."""
        try:
            self._writer.flush()
        except OSError as error:
            raise self._failed(error) from error

    def close(self) -> None:
        """Write what remains and the index; a second call does nothing."""
        if self._file.closed:
            return
        try:
            self._writer.finish()
            self._file.close()
        except OSError as error:
            raise self._failed(error) from error

    def _add_channel(self, topic: str, message_type: type | str) -> _Channel:
        cls = message_class(message_type) if isinstance(message_type, str) else message_type
        name = type_name(cls)
        if name not in self._schemas:
            text = definition(cls).encode()
            self._schemas[name] = self._writer.register_schema(name, 'ros2msg', text)
        # rosbag2 keeps the publishers' QoS here; empty means unknown, and it takes its default.
        qos = {'offered_qos_profiles': ''}
        channel_id = self._writer.register_channel(topic, 'cdr', self._schemas[name], qos)
        self._channels[topic] = _Channel(channel_id, cls, name)
        return self._channels[topic]

    def _failed(self, error: OSError) -> BagError:
        # Nothing more must follow a chunk that was written in part; the rest of it is lost.
        if hasattr(self, '_file'):
            with suppress(OSError):
                self._file.close()
        return BagError(
            f'{self._path} cannot be written: {error.strerror}; '
            'mend: check the path, its rights and the space on the disk'
        )
