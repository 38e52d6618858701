"""Play a bag over and over: shift the stamps of each loop so that they follow the last one."""

import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from kinpole_ros.bags import BagMessage
from kinpole_ros.messages import fields, message_class, ns_to_stamp, stamp_to_ns


class LoopShift:
    """
    Shifts the stamps of a bag's messages in all loops but the first.

    The first loop is published as it is, and read for its times. They tell how much later each
    loop begins than the one before, by the stamps of headers and by the times of logging.
    """

    def __init__(self) -> None:
        self._stamps: dict[str, array[int]] = {}
        self._log_times: dict[str, array[int]] = {}
        self._loops = 0
        self._stamp_length = self._log_length = 0

    @property
    def log_offset(self) -> int:
        """How much later than it was logged a message of this loop is due, ns."""
        return self._loops * self._log_length

    def begin_next_loop(self) -> None:
        """End a loop."""
        if not self._loops:
            self._stamp_length = loop_length(self._stamps)
            self._log_length = loop_length(self._log_times)
        self._loops += 1

    def shifted(self, message: BagMessage, cls: type) -> Any:
        """Return what to publish: the bytes, or a message whose stamps are those of this loop."""
        read = _read(message.data, cls)
        if not self._loops:
            self._keep_times(message, read)
            return message.data
        if read is None:
            return message.data
        for header in headers(read):
            stamp = stamp_to_ns(header.stamp)
            # A stamp of 0 stands for none, unless the clock of the bag begins there.
            if stamp or not message.log_time:
                header.stamp = ns_to_stamp(stamp + self._loops * self._stamp_length)
        return read

    def _keep_times(self, message: BagMessage, read: Any) -> None:
        self._log_times.setdefault(message.topic, array('q')).append(message.log_time)
        stamps = (stamp_to_ns(header.stamp) for header in headers(read))
        # A part may have no stamp, as the texture of a marker.
        stamp = min(filter(None, stamps), default=0)
        if stamp or not message.log_time:
            self._stamps.setdefault(message.topic, array('q')).append(stamp)


def loop_length(times: Mapping[str, Sequence[int]]) -> int:
    """
    Return how much later than a bag the next loop of it begins.

    Parameters
    ----------
    times : mapping of str to sequence of int
        Times of the messages of each topic, ns.

    Returns
    -------
    int
        The span of all times and one interval of the busiest topic (the median), ns.
    """
    if not times:
        return 0
    # Markers of one frame may come as a message each, with one stamp.
    busiest = np.unique(max(times.values(), key=len))
    interval = np.median(np.diff(busiest)) if len(busiest) > 1 else 0
    return max(map(max, times.values())) - min(map(min, times.values())) + int(interval)


def headers(message: Any) -> Iterator[Header]:
    """Yield all headers in a message, those of its parts too."""
    if message is None:
        return
    cls: Any = type(message)
    for name, is_list in _header_fields(cls):
        part = getattr(message, name)
        for one in part if is_list else (part,):
            if isinstance(one, Header):
                yield one
            else:
                yield from headers(one)


@cache
def _header_fields(cls: Any) -> list[tuple[str, bool]]:
    """Return the fields of a message class that hold headers, and whether each is a list."""
    found = []
    for name, kind in fields(cls).items():
        base = re.sub(r'[\[<].*', '', kind)
        part = message_class(base) if '/' in base else None
        if part is Header or (part is not None and _header_fields(part)):
            found.append((name, base != kind))
    return found


def _read(data: bytes, cls: type) -> Any:
    """Read a message that has headers; None for others, and for bytes that are none."""
    if not _header_fields(cls):
        return None
    try:
        return deserialize_message(data, cls)
    except (RuntimeError, ValueError):
        return None
