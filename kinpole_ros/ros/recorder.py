"""Record topics into a bag: a small `ros2 bag record` for rclpy without a ROS installation."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription

from kinpole_ros.bags import RECORDER, BagError, BagWriter
from kinpole_ros.messages import installed_class
from kinpole_ros.ros.executor import make_executor, start_ros
from kinpole_ros.ros.offered_qos import strictest_qos
from kinpole_ros.ros.player import bag_errors, with_slash
from kinpole_ros.ros.private import received_at, take

_FLUSH_INTERVAL = 1.0  # s: what a kill may lose of a recording
_DISCOVERY_INTERVAL = 0.1  # s
_DEPTH = 2000  # messages of a topic: 2 s at 1 kHz
_PATIENCE = 5.0  # s without a topic, after which a recorder warns


def record(output: str | Path, prefixes: list[str]) -> int:
    """
    Record all topics that begin with one of `prefixes` until SIGINT or SIGTERM.

    Returns the number of messages. All but the last second of the bag is readable even after a
    kill. Raises BagError where it cannot be written, or is a file that is not empty: a recording
    cannot be made again.
    """
    path = Path(output)
    if path.is_file() and path.stat().st_size:
        raise BagError(f'{output} is there already; name another file, or remove that one first')
    with bag_errors():
        stop_requested = start_ros([])
    try:
        with BagWriter(output, RECORDER) as writer:
            recorder = Recorder(writer, prefixes)
            executor = make_executor(recorder, recorder)
            try:
                while not stop_requested():
                    executor.spin_once()
                # Record what has arrived meanwhile.
                recorder.take_messages()
            finally:
                executor.shutdown()
                recorder.destroy_node()
            return recorder.messages
    finally:
        rclpy.try_shutdown()


class _Recorded(NamedTuple):
    """A topic that is recorded: its type, and what saves a message."""

    subscription: Subscription
    kind: str
    save: Callable[..., None]


class Recorder(Node):
    """Records every topic under some prefixes, from its first publisher on."""

    def __init__(self, writer: BagWriter, prefixes: list[str]) -> None:
        super().__init__('kinpole_recorder')
        self._writer = writer
        self._prefixes = tuple(map(with_slash, prefixes))
        # By topic: the type that is recorded, and other types that it was published as.
        self._types: dict[str, set[str]] = {}
        self._recorded: list[_Recorded] = []
        # Those with a publisher that offers less than was requested.
        self._incompatible: set[Subscription] = set()
        self.messages = 0
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_DISCOVERY_INTERVAL, self._discover, clock=steady)
        self.create_timer(_FLUSH_INTERVAL, writer.flush, clock=steady)
        self._patience = self.create_timer(_PATIENCE, self._warn_of_silence, clock=steady)
        self._discover()

    @property
    def subscriptions(self) -> list[Subscription]:
        """The subscriptions that are recorded."""
        return [recorded.subscription for recorded in self._recorded]

    def take_messages(self) -> None:
        """Record the messages that wait."""
        for subscription, _, save in self._recorded:
            # A bounded number, so that a busy topic does not delay the others.
            for data, info in take(subscription, _DEPTH):
                save(data, received_at(info))

    def _warn_of_silence(self) -> None:
        self._patience.cancel()
        silent = [p for p in self._prefixes if not any(name.startswith(p) for name in self._types)]
        if silent:
            names = ' or '.join(silent)
            self.get_logger().warning(f'nobody publishes on a topic that begins with {names} yet')

    def _discover(self) -> None:
        """Subscribe to new topics, and see to topics with other types or less QoS."""
        for name, types in self.get_topic_names_and_types():
            # `types` are also those of subscribers, and so of this recorder.
            is_recorded = name in self._types and len(types) == 1
            if is_recorded or not name.startswith(self._prefixes):
                continue
            published = self.get_publishers_info_by_topic(name)
            if not published:
                continue
            if name in self._types:
                self._note_other_types(name, {o.topic_type for o in published})
                continue
            # A topic has one type in a bag.
            kind = published[0].topic_type
            self._types[name] = {kind}
            try:
                installed_class(kind)
            except LookupError as error:
                self.get_logger().warning(f'{name} is not recorded: {error}')
                continue
            self._subscribe(name, kind, strictest_qos(published, kind, _DEPTH))
        # The event of an incompatible publisher may come after it is gone.
        for recorded in list(self._recorded):
            if recorded.subscription in self._incompatible:
                self._request_less(recorded)

    def _subscribe(self, name: str, kind: str, qos: QoSProfile) -> None:
        if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            self._writer.add_topic(name, kind, is_latched=True)
        save = self._saver(name, kind)
        events = SubscriptionEventCallbacks(
            incompatible_qos=lambda _: self._incompatible.add(subscription)
        )
        subscription: Subscription = self.create_subscription(
            installed_class(kind), name, save, qos, event_callbacks=events, raw=True
        )
        self._recorded.append(_Recorded(subscription, kind, save))

    def _request_less(self, recorded: '_Recorded') -> None:
        """Subscribe again with the QoS of a publisher that offers less than those before."""
        subscription = recorded.subscription
        name, requested = subscription.topic_name, subscription.qos_profile
        published = self.get_publishers_info_by_topic(name)
        qos = strictest_qos(published, recorded.kind, _DEPTH)
        # Publishers that are gone had offered enough.
        is_lower = qos_check_compatible(qos, requested)[0] == QoSCompatibility.ERROR
        if not is_lower:  # not in the graph yet, or gone again
            return
        self.get_logger().info(f'{name} is recorded with less QoS from now on, as offered')
        self.take_messages()
        self._incompatible.remove(subscription)
        self._recorded.remove(recorded)
        self.destroy_subscription(subscription)
        self._subscribe(name, recorded.kind, qos)

    def _note_other_types(self, name: str, types: set[str]) -> None:
        if new := types - self._types[name]:
            self._types[name] |= new
            listed = ', '.join(sorted(new))
            self.get_logger().warning(
                f'{name} is published as {listed} too, and that is not recorded: one bag has one '
                'type for a topic; record anew'
            )

    def _saver(self, name: str, kind: str) -> Callable[..., None]:
        def save(data: bytes, received: int | None = None) -> None:
            # The time of arrival: messages of other topics may be taken before this one.
            when = received or self.get_clock().now().nanoseconds
            self._writer.write_raw(name, kind, data, when)
            self.messages += 1

        return save
