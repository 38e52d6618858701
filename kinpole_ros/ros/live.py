"""
Bags over DDS: play one into a running node and record what it says.

Small stand-ins for `ros2 bag play` and `ros2 bag record`, for machines that have rclpy and no ROS
installation, and for the demo and the tests, which must run there.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock as ClockMessage

from kinpole_ros.bags import (
    RECORDER,
    BagError,
    BagWriter,
    message_class,
    read_messages,
    topics,
    type_name,
)
from kinpole_ros.messages import ns_to_stamp
from kinpole_ros.ros.executor import SubscriptionGroup, make_executor
from kinpole_ros.ros.loop import LoopShift
from kinpole_ros.ros.private import RCLError, received_at, take
from kinpole_ros.ros.process import check_domain, reason_of, start_ros

# What a kill may lose of a recording.
_FLUSH_EVERY = 1.0
_LOOK_EVERY = 0.1
_DEEP = 1000
# A recorder without a topic for so long (s) says so.
_PATIENCE = 5.0


def play(
    bag: str | Path,
    only: list[str] | None = None,
    speed: float = 1.0,
    wait: float = 10.0,
    progress: Callable[[float], None] | None = None,
    loop: bool = False,
    clock: float | None = None,
    subscribers: int = 1,
) -> int:
    """
    Publish a bag's messages at the pace they were recorded, times `speed`.

    With `loop` over and over, until Ctrl-C; the stamps of each loop follow those of the last one
    by one interval, and so does the time on /clock. With `clock`, Hz, the time of the bag is on
    /clock so many times a second, for nodes with use_sim_time.

    `only` names the topics, None for all but the exact answers that simulate adds to the
    markers. Waits up to `wait` s for so many `subscribers` of each, and at the end until reliable
    ones have everything. Returns the number of messages. Raises BagError as reading does, and for
    a speed or clock that is not more than 0.
    """
    if not (math.isfinite(speed) and speed > 0):
        raise BagError(f'--speed is {speed}; it must be more than 0')
    if clock is not None and not (math.isfinite(clock) and clock > 0):
        raise BagError(f'--clock is {clock}; it must be more than 0 Hz')
    there = topics(bag)
    if clock is not None:
        there.pop('/clock', None)
    only = [_whole(name) for name in only or []]
    ordinary = [name for name in there if '/truth/' not in name]
    for name in only:
        if name not in there:
            raise BagError(f'{bag}: no topic {name}; it holds {", ".join(sorted(ordinary))}')
    chosen = only or ordinary
    context = own_context()
    node = Node('kinpole_player', context=context)
    count = 0
    try:
        qos = QoSProfile(depth=_DEEP)
        try:
            publishers = {}
            for name in chosen:
                try:
                    publishers[name] = node.create_publisher(message_class(there[name]), name, qos)
                except BagError as error:
                    if only:
                        raise
                    node.get_logger().warning(f'{name} is not played: {error}')
            chosen = list(publishers)
            clocks = None if clock is None else node.create_publisher(ClockMessage, '/clock', 1)
        except NameValidationException as error:
            reason = ' '.join(str(error).rstrip(' ^\n').split())
            raise BagError(f'{bag}: {reason}; name other topics with --topic') from None
        deadline = time.monotonic() + wait
        while time.monotonic() < deadline and context.ok():
            if all(p.get_subscription_count() >= subscribers for p in publishers.values()):
                break
            time.sleep(_LOOK_EVERY / 10)
        if context.ok():
            counts = {name: p.get_subscription_count() for name, p in publishers.items()}
            if unheard := [name for name, count in counts.items() if not count]:
                node.get_logger().warning(f'nobody listens to {", ".join(unheard)}')
        shift = LoopShift()
        pace = _Pace(speed, clocks, clock)
        again = True
        while again and context.ok():
            before = count
            for message in read_messages(bag, chosen, progress):
                pace.wait(message.log_time + shift.log_offset)
                if not context.ok():
                    break
                publisher = publishers[message.topic]
                publisher.publish(
                    shift.shifted(message, publisher.msg_type) if loop else message.data
                )
                count += 1
            again = loop and count > before
            shift.begin_next_loop()
        for publisher in publishers.values():
            # Step by step, so that Ctrl-C ends it: who reads may have stopped to.
            while not publisher.wait_for_all_acked(Duration(seconds=_LOOK_EVERY)):
                pass
    finally:
        node.destroy_node()
        context.try_shutdown()
    return count


class _Pace:
    """The pace of a bag, times `speed`, and its time on the topic of `clocks`, `rate` times a s."""

    def __init__(self, speed: float, clocks: Publisher | None, rate: float | None) -> None:
        self._speed = speed
        self._clocks = clocks
        self._period = math.inf if rate is None else 1 / rate
        self._next = 0.0
        self._start = time.monotonic()
        self._first: int | None = None

    def wait(self, log_time: int) -> None:
        """Until a message of that time, ns, is due."""
        first = self._first = log_time if self._first is None else self._first
        while True:
            passed = time.monotonic() - self._start
            left = (log_time - first) * 1e-9 / self._speed - passed
            if self._clocks is not None and passed >= self._next:
                # No later than the message that it waits for.
                now = min(first + int(passed * self._speed * 1e9), log_time)
                self._clocks.publish(ClockMessage(clock=ns_to_stamp(now)))
                self._next = passed + self._period
            if left <= 0:
                return
            time.sleep(min(left, self._period))


def _whole(topic: str) -> str:
    """A topic, or the beginning of one, that may lack its slash."""
    return topic if topic.startswith('/') else f'/{topic}'


def own_context() -> rclpy.Context:
    """Start ROS in a context of its own; raises BagError where it cannot."""
    context = rclpy.Context()
    with starting():
        check_domain()
        rclpy.init(args=[], context=context)
    return context


@contextmanager
def starting() -> Iterator[None]:
    """What is wrong with ROS_DOMAIN_ID and its like is no fault of ours."""
    try:
        yield
    except RCLError as error:
        raise BagError(f'ROS cannot start in this environment: {reason_of(error)}') from None


def _least_of(offers: Sequence[QoSProfile]) -> QoSProfile:
    """Reliable, and what was sent before, where all of them are."""
    qos = QoSProfile(depth=_DEEP)
    if any(o.reliability == ReliabilityPolicy.BEST_EFFORT for o in offers):
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
    if all(o.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in offers):
        qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
    return qos


class Recorder(Node):
    """Records every topic under some prefixes, from when it appears."""

    def __init__(self, writer: BagWriter, prefixes: list[str]) -> None:
        super().__init__('kinpole_recorder')
        self._writer = writer
        self._prefixes = tuple(map(_whole, prefixes))
        # The type a topic is recorded as, and others it was published as.
        self._seen: dict[str, set[str]] = {}
        self._recorded: list[tuple[Subscription, Callable[..., None]]] = []
        # Those with a publisher that offers less than was asked for.
        self._unheard: set[Subscription] = set()
        self.group = SubscriptionGroup()
        self.messages = 0
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_LOOK_EVERY, self._look, clock=steady)
        self.create_timer(_FLUSH_EVERY, writer.flush, clock=steady)
        self._waiting = self.create_timer(_PATIENCE, self._complain, clock=steady)
        self._look()

    @property
    def subscriptions(self) -> list[Subscription]:
        """Those that are recorded."""
        return [subscription for subscription, _ in self._recorded]

    def take_messages(self) -> None:
        """Record all that waits."""
        for subscription, save in self._recorded:
            # No more than wait at most, lest a flood keeps all others waiting.
            for data, info in take(subscription, _DEEP):
                save(data, received_at(info))

    def _complain(self) -> None:
        self._waiting.cancel()
        lacking = [p for p in self._prefixes if not any(name.startswith(p) for name in self._seen)]
        if lacking:
            names = ' or '.join(lacking)
            self.get_logger().warning(f'nobody publishes on a topic that begins with {names} yet')

    def _look(self) -> None:
        for name, types in self.get_topic_names_and_types():
            # Of those who listen too, and so of ourselves.
            known = name in self._seen and len(types) == 1
            if known or not name.startswith(self._prefixes):
                continue
            published = self.get_publishers_info_by_topic(name)
            if not published:
                continue
            if name in self._seen:
                self._note_other_types(name, {o.topic_type for o in published})
                continue
            # A topic has one type in a bag.
            kind = published[0].topic_type
            self._seen[name] = {kind}
            try:
                cls = message_class(kind)
            except BagError as error:
                self.get_logger().warning(f'{name} is not recorded: {error}')
                continue
            offers = [o.qos_profile for o in published if o.topic_type == kind]
            self._subscribe(name, cls, _least_of(offers))
        # Word of one that is no more may come late.
        for subscription, _ in list(self._recorded):
            if subscription in self._unheard:
                self._ask_for_less(subscription)

    def _subscribe(self, name: str, cls: type, qos: QoSProfile) -> None:
        save = self._saver(name, cls)
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda _: self._unheard.add(subscription)
        )
        subscription: Subscription = self.create_subscription(
            cls, name, save, qos, callback_group=self.group, event_callbacks=events, raw=True
        )
        self._recorded.append((subscription, save))

    def _ask_for_less(self, subscription: Subscription) -> None:
        """Subscribe anew where a publisher has come that offers less than those before."""
        name, cls, asked = subscription.topic_name, subscription.msg_type, subscription.qos_profile
        published, kind = self.get_publishers_info_by_topic(name), type_name(cls)
        offers = [o.qos_profile for o in published if o.topic_type == kind]
        less = [o for o in offers if qos_check_compatible(o, asked)[0] == QoSCompatibility.ERROR]
        if not less:  # not listed yet, or gone again
            return
        self.get_logger().info(f'{name} is recorded with less QoS from now on, as offered')
        self.take_messages()
        self._unheard.remove(subscription)
        self._recorded = [row for row in self._recorded if row[0] is not subscription]
        self.destroy_subscription(subscription)
        self._subscribe(name, cls, _least_of([asked, *less]))

    def _note_other_types(self, name: str, types: set[str]) -> None:
        if others := types - self._seen[name]:
            self._seen[name] |= others
            listed = ', '.join(sorted(others))
            self.get_logger().warning(
                f'{name} is published as {listed} too, and that is not recorded: one bag has one '
                'type for a topic; record anew'
            )

    def _saver(self, name: str, cls: type) -> Callable[..., None]:
        def save(data: bytes, received: int | None = None) -> None:
            # Not when its turn came, after all topics before it.
            when = received or self.get_clock().now().nanoseconds
            self._writer.write_raw(name, cls, data, when)
            self.messages += 1

        return save


def record(output: str | Path, prefixes: list[str]) -> int:
    """
    Record all topics that begin with one of `prefixes` until stopped (SIGINT or SIGTERM).

    Returns the number of messages. What was recorded is readable even if the process is killed,
    but for the last second. Raises BagError when the output cannot be written, or holds something
    already: what was recorded before cannot be made again.
    """
    there = Path(output)
    if there.is_file() and there.stat().st_size:
        raise BagError(f'{output} is there already; name another file, or remove that one first')
    with starting():
        stop_requested = start_ros([])
    try:
        with BagWriter(output, RECORDER) as writer:
            recorder = Recorder(writer, prefixes)
            executor = make_executor(recorder, recorder)
            try:
                while not stop_requested():
                    executor.spin_once()
                # What has come is recorded, however far behind this is.
                recorder.take_messages()
            finally:
                executor.shutdown()
                recorder.destroy_node()
            return recorder.messages
    finally:
        rclpy.try_shutdown()
