"""
The results of a running node as they come: found in the graph, listened to while they are wanted.

Topics are taken as from sensors, a few messages deep: a slow reader loses some, and never holds up
the node.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from kinpole_ros.bags import message_class
from kinpole_ros.messages import DRAWING, PAGE_TOPICS
from kinpole_ros.ros.live import starting
from kinpole_ros.ros.private import PreparedWait, take
from kinpole_ros.ros.process import start_ros

# Of one topic: what comes between two looks.
_DEPTH = 4


class Arrived(NamedTuple):
    """A message, and when it was published, ns since 1970 by the clock of its machine."""

    data: bytes
    published: int


class Watcher:
    """Listens to some topics: `newest` has the last few messages of each, the newest last."""

    def __init__(self) -> None:
        self._node = Node('kinpole_view')
        self._subscriptions: dict[str, Subscription] = {}
        self.newest: dict[str, deque[Arrived]] = {}

    def close(self) -> None:
        """Listen to nothing more."""
        self.want({})
        self._node.destroy_node()

    def nodes(self) -> dict[str, str]:
        """
        Full names of nodes that publish what pages show, now, and on which of `PAGE_TOPICS`.

        Where a bag of results is played it is `state`; it has no topic `view`.
        """
        kinds = dict(self._node.get_topic_names_and_types())
        found: dict[str, str] = {}
        for topic in sorted(kinds):
            node, _, last = topic.rpartition('/')
            ours = kinds[topic] == [PAGE_TOPICS.get(last)] and f'{node}/{DRAWING}' in kinds
            # A topic is listed that is but listened to.
            if ours and self._node.count_publishers(topic):
                # In this order `view` comes last, and is the one where both are there.
                found[node] = last
        return found

    def want(self, topics: Mapping[str, str]) -> None:
        """Listen to these topics, of these types, and no others."""
        for name in self._subscriptions.keys() - topics.keys():
            self._node.destroy_subscription(self._subscriptions.pop(name))
            del self.newest[name]
        qos = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        for name in topics.keys() - self._subscriptions.keys():
            self.newest[name] = deque(maxlen=_DEPTH)
            self._subscriptions[name] = self._node.create_subscription(
                message_class(topics[name]),
                name,
                lambda _: None,
                qos,
                event_callbacks=quiet,
                raw=True,
            )

    def wait(self, seconds: float) -> None:
        """Wait so long for messages, and take them."""
        PreparedWait(self._node.context, list(self._subscriptions.values())).wait(seconds)
        for name, subscription in self._subscriptions.items():
            for data, info in take(subscription, _DEPTH):
                self.newest[name].append(Arrived(data, info['source_timestamp']))


@contextmanager
def watching() -> Iterator[tuple[Watcher, Callable[[], bool]]]:
    """A watcher, and what tells whether SIGINT or SIGTERM has come; BagError where ROS fails."""
    with starting():
        stop_requested = start_ros([])
    try:
        watcher = Watcher()
        try:
            yield watcher, stop_requested
        finally:
            watcher.close()
    finally:
        rclpy.try_shutdown()
