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
from kinpole_ros.ros.live import starting
from kinpole_ros.ros.private import take
from kinpole_ros.ros.process import start_ros

# Of one topic. What comes between two looks is not missed, so long as one is at one instant still.
_DEPTH = 4
_ODOMETRY = 'nav_msgs/msg/Odometry'


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

    def nodes(self) -> dict[str, dict[str, str]]:
        """
        Nodes that publish results now, by full name, with all topics under it and their types.

        Exact answers of simulate are no node's.
        """
        kinds = {name: types[0] for name, types in self._node.get_topic_names_and_types()}
        found: dict[str, dict[str, str]] = {}
        for topic, kind in kinds.items():
            body, _, last = topic.rpartition('/')
            node = body.rpartition('/')[0]
            ours = kind == _ODOMETRY and last == 'odom' and f'{body}/icr_velocity' in kinds
            if not ours or not node or node.endswith('/truth') or node in found:
                continue
            # A topic is listed that is but listened to.
            if self._node.count_publishers(topic):
                found[node] = {t: kind for t, kind in kinds.items() if t.startswith(f'{node}/')}
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

    def take(self) -> None:
        """Take what has come; never waits."""
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
