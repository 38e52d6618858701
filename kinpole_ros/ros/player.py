"""
Play a bag over DDS: a small `ros2 bag play` for machines with rclpy and no ROS installation.

In a loop the stamps of each pass follow those of the one before.
"""

import math
import struct
import time
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMessage

from kinpole_ros.bags import BagError, BagMessage, message_class, read_messages, topics
from kinpole_ros.messages import (
    RIG,
    deserialize_message,
    installed_class,
    serialize_message,
    stamp_to_ns,
)
from kinpole_ros.ros.executor import check_domain, reason_of
from kinpole_ros.ros.private import RCLError
from kinpole_ros.ros.publishers import LATCHED

_POLL_INTERVAL = 0.01  # s, while waiting for subscribers
_ACKNOWLEDGMENT_WAIT = Duration(seconds=0.1)
_LONGEST_ACKNOWLEDGMENT = 30.0  # s; Fast DDS drops a reader that died after 20
_SETTLED = 1.0  # s in which subscribers stay the same, after which all are taken to be there
_MAX_BEHIND = 0.5  # s behind the pace, after which a player says so
_DEPTH = 1000  # messages
# A stamp in serialized messages: s and ns; and s of one that is looked for.
_STAMP, _MARK = struct.Struct('<iI'), 0x5EEDC0D


def play(
    bag: str | Path,
    only: list[str] | None = None,
    speed: float = 1.0,
    wait: float = 10.0,
    progress: Callable[[float], None] | None = None,
    loop: bool = False,
    clock: float | None = None,
    subscribers: int | None = None,
) -> int:
    """
    Publish the messages of a bag at the pace at which they were recorded, times `speed`.

    Parameters
    ----------
    bag : str or Path
        The bag.
    only : list of str, optional
        Topics; by default all but the exact answers of `simulate`.
    speed : float
        Factor of the pace.
    wait : float
        s: the longest wait for subscribers.
    progress : callable, optional
        Called with the fraction done.
    loop : bool
        Play again until Ctrl-C. The stamps, and the time on /clock, of each pass follow those of
        the one before by one interval.
    clock : float, optional
        Hz: publish the time of the bag on /clock so often, for nodes with use_sim_time.
    subscribers : int, optional
        How many subscribers of each topic to wait for; by default until there are some, and no more
        come for a second. At the end it waits until reliable ones have all messages.

    Returns
    -------
    int
        The number of messages.

    Raises
    ------
    BagError
        As reading does, and for a speed, clock or number of subscribers that is not more than 0.
    """
    _check_options(speed, clock, subscribers)
    chosen = _chosen_topics(bag, only or [], clock is not None)
    context = own_context()
    node = Node('kinpole_player', context=context)
    try:
        publishers = _make_publishers(node, bag, chosen, is_strict=bool(only))
        clocks = None if clock is None else node.create_publisher(ClockMessage, '/clock', 1)
        _wait_for_subscribers(node, publishers, wait, subscribers)
        pace = _Pace(speed, clocks, clock)
        count = _publish(bag, publishers, pace, progress, loop, node)
        _wait_until_read(node, publishers)
    finally:
        node.destroy_node()
        context.try_shutdown()
    return count


def _check_options(speed: float, clock: float | None, subscribers: int | None) -> None:
    if not (math.isfinite(speed) and speed > 0):
        raise BagError(f'--speed is {speed}; it must be more than 0')
    if clock is not None and not (math.isfinite(clock) and clock > 0):
        raise BagError(f'--clock is {clock}; it must be more than 0 Hz')
    if subscribers is not None and subscribers < 1:
        raise BagError(f'--subscribers is {subscribers}; it must be 1 or more')


def _chosen_topics(bag: str | Path, only: list[str], has_clock: bool) -> dict[str, str]:
    """Return the types of the topics that are played, by name."""
    types = topics(bag)
    if has_clock:
        types.pop('/clock', None)
    ordinary = [name for name in types if '/truth/' not in name]
    names = [with_slash(name) for name in only]
    for name in names:
        if name not in types:
            raise BagError(f'{bag}: no topic {name}; it holds {", ".join(sorted(ordinary))}')
    return {name: types[name] for name in names or ordinary}


def _make_publishers(
    node: Node, bag: str | Path, types: Mapping[str, str], is_strict: bool
) -> dict[str, Publisher]:
    """Make a publisher for each topic; one of an unknown type is an error if `is_strict`."""
    publishers = {}
    for name, kind in types.items():
        try:
            cls = installed_class(kind)
        except LookupError as error:
            if is_strict:
                raise BagError(str(error)) from None
            node.get_logger().warning(f'{name} is not played: {error}')
            continue
        try:
            qos = LATCHED if name.endswith(f'/{RIG}') else QoSProfile(depth=_DEPTH)
            publishers[name] = node.create_publisher(cls, name, qos)
        except NameValidationException as error:
            reason = ' '.join(str(error).rstrip(' ^\n').split())
            raise BagError(f'{bag}: {reason}; name other topics with --topic') from None
    return publishers


def _wait_until_read(node: Node, publishers: Mapping[str, Publisher]) -> None:
    """Wait until reliable subscribers have all messages; warn of one that does not take them."""
    deadline = time.monotonic() + _LONGEST_ACKNOWLEDGMENT
    for name, publisher in publishers.items():
        # Step by step, so that Ctrl-C ends it where a subscriber no longer reads.
        while not publisher.wait_for_all_acked(_ACKNOWLEDGMENT_WAIT):
            if time.monotonic() > deadline:
                node.get_logger().warning(
                    f'a subscriber of {name} does not take its messages; fix: end it if it hangs'
                )
                break


def _wait_for_subscribers(
    node: Node, publishers: Mapping[str, Publisher], wait: float, subscribers: int | None
) -> None:
    """Wait until all topics have subscribers, at most `wait` s, and log how many."""
    now = time.monotonic()
    deadline, since, counts = now + wait, now, [0]
    while now < deadline and node.context.ok():
        found = [publisher.get_subscription_count() for publisher in publishers.values()]
        if found != counts:
            since, counts = now, found
        if all(count >= (subscribers or 1) for count in counts) and (
            subscribers is not None or now - since >= _SETTLED
        ):
            break
        time.sleep(_POLL_INTERVAL)
        now = time.monotonic()
    if node.context.ok():
        named = {name: p.get_subscription_count() for name, p in publishers.items()}
        if heard := [f'{count} of {name}' for name, count in named.items() if count]:
            node.get_logger().info(f'the first messages go to the subscribers: {", ".join(heard)}')
        if unheard := [name for name, count in named.items() if not count]:
            node.get_logger().warning(f'nobody listens to {", ".join(unheard)}')


def _publish(
    bag: str | Path,
    publishers: Mapping[str, Publisher],
    pace: '_Pace',
    progress: Callable[[float], None] | None,
    loop: bool,
    node: Node,
) -> int:
    """Publish the messages; return their number."""
    shift = LoopShift()
    count = 0
    is_late = False
    while node.context.ok():
        count_before = count
        for number, message in enumerate(read_messages(bag, list(publishers), progress)):
            behind = pace.wait(message.log_time + shift.log_offset)
            if not node.context.ok():
                break
            if behind > _MAX_BEHIND and not is_late:
                is_late = True
                node.get_logger().warning(
                    f'the pace asked for is not held: {behind:.1f} s behind; lower --speed, or see '
                    'what else takes the processor'
                )
            publisher = publishers[message.topic]
            data = shift.shifted(number, message) if loop else message.data
            publisher.publish(data)
            count += 1
        if not loop or count == count_before:
            break
        shift.begin_next_loop()
    return count


class _Pace:
    """
    The pace of a bag, times `speed`.

    With `clocks` its time is published `rate` times a second of wall time.
    """

    def __init__(self, speed: float, clocks: Publisher | None, rate: float | None) -> None:
        self._speed = speed
        self._clocks = clocks
        self._period = math.inf if rate is None else 1 / rate
        self._clock_due = 0.0
        self._start = time.monotonic()
        self._first: int | None = None

    def wait(self, log_time: int) -> float:
        """Wait until a message of this log time, ns, is due; return by how much it is late, s."""
        first = self._first = log_time if self._first is None else self._first
        while True:
            passed = time.monotonic() - self._start
            remaining = (log_time - first) * 1e-9 / self._speed - passed
            if self._clocks is not None and passed >= self._clock_due:
                # No later than the message that is due next.
                now = min(first + int(passed * self._speed * 1e9), log_time)
                self._clocks.publish(ClockMessage(clock=Time(nanoseconds=now).to_msg()))
                self._clock_due = passed + self._period
            if remaining <= 0:
                return -remaining
            time.sleep(min(remaining, self._period))


def with_slash(topic: str) -> str:
    """Return a topic, or the beginning of one, with the slash that it may lack."""
    return topic if topic.startswith('/') else f'/{topic}'


def own_context() -> rclpy.Context:
    """Start ROS in a context of its own; BagError where it cannot start."""
    context = rclpy.Context()
    with bag_errors():
        check_domain()
        rclpy.init(args=[], context=context)
    return context


@contextmanager
def bag_errors() -> Iterator[None]:
    """Report that ROS cannot start, as for a wrong ROS_DOMAIN_ID, as a BagError."""
    try:
        yield
    except RCLError as error:
        raise BagError(f'ROS cannot start in this environment: {reason_of(error)}') from None


class LoopShift:
    """
    Shifts the stamps of the messages of a bag in all loops but the first.

    In the first loop the times of the messages are noted, and the places of their stamps. From the
    times follows how much later each loop begins than the one before, by the stamps of headers and
    by log times.
    """

    def __init__(self) -> None:
        self._stamps: dict[str, array[int]] = {}
        self._log_times: dict[str, array[int]] = {}
        # Of each message: its bytes if they are not those of the bag, and places of its stamps.
        self._prepared: list[tuple[bytes, list[tuple[int, int]]]] = []
        self._loops = 0
        self._stamp_length = self._log_length = 0

    @property
    def log_offset(self) -> int:
        """How much later than its log time a message of this loop is due, ns."""
        return self._loops * self._log_length

    def begin_next_loop(self) -> None:
        """End a loop."""
        if not self._loops:
            self._stamp_length = _loop_length(self._stamps)
            self._log_length = _loop_length(self._log_times)
        self._loops += 1

    def shifted(self, number: int, message: BagMessage) -> bytes:
        """Return a message, the one of this number in the loop, with the stamps of this loop."""
        if not self._loops:
            self._prepare(message)
            return message.data
        data, places = self._prepared[number]
        shifted = bytearray(data or message.data)
        for place, stamp in places:
            ns = stamp + self._loops * self._stamp_length
            _STAMP.pack_into(shifted, place, *divmod(ns, 10**9))
        return bytes(shifted)

    def _prepare(self, message: BagMessage) -> None:
        """Note the times of a message, and the places of its stamps."""
        self._log_times.setdefault(message.topic, array('q')).append(message.log_time)
        stamps, stamped = [], []
        # Errors of many kinds, for bytes that cannot be read.
        with suppress(Exception):
            read = deserialize_message(message.data, message_class(message.type_name))
            # 0 means no stamp, as of the texture of a marker, unless the clock of the bag begins at
            # 0.
            stamped = [h for h in headers(read) if stamp_to_ns(h.stamp) or not message.log_time]
            stamps = [stamp_to_ns(header.stamp) for header in stamped]
        if not stamps:
            self._prepared.append((b'', []))
            return
        self._stamps.setdefault(message.topic, array('q')).append(min(stamps))
        for number, header in enumerate(stamped):
            header.stamp.sec, header.stamp.nanosec = _MARK, number
        marked = serialize_message(read)
        places = [marked.index(_STAMP.pack(_MARK, k)) for k in range(len(stamps))]
        as_read = all(
            message.data[place : place + _STAMP.size] == _STAMP.pack(*divmod(stamp, 10**9))
            for place, stamp in zip(places, stamps, strict=True)
        )
        # Other encoders may order the bytes otherwise, or leave some out.
        data = b'' if as_read and len(message.data) == len(marked) else marked
        self._prepared.append((data, list(zip(places, stamps, strict=True))))


def _loop_length(times: Mapping[str, Sequence[int]]) -> int:
    """The span of the times of all topics plus a median interval of the busiest topic, ns."""
    if not times:
        return 0
    # The markers of one frame may come as one message each, with one stamp.
    busiest = np.unique(max(times.values(), key=len))
    interval = np.median(np.diff(busiest)) if len(busiest) > 1 else 0
    return max(map(max, times.values())) - min(map(min, times.values())) + int(interval)


def headers(message: Any) -> Iterator[Any]:
    """Yield all headers in a message, also those inside its fields."""
    for value in vars(message).values():
        for item in value if isinstance(value, list) else (value,):
            kind = getattr(item, '__msgtype__', '')
            if kind == 'std_msgs/msg/Header':
                yield item
            elif kind:
                yield from headers(item)
