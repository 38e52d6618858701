"""
Topics for the tools: markers for some seconds, and the results of a node as they come.

They are subscribed to as sensor data, so a slow reader loses messages and never delays a node.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from kinpole_ros.bags import BagError
from kinpole_ros.messages import (
    DRAWING,
    PAGE_TOPICS,
    RIG,
    ROS_TYPE_NAMES,
    MessageError,
    installed_class,
    marker_reader,
)
from kinpole_ros.ros.executor import start_ros
from kinpole_ros.ros.player import bag_errors, own_context, with_slash
from kinpole_ros.ros.private import PreparedWait, take
from kinpole_ros.ros.publishers import LATCHED
from kinpole_ros.ros.source import (
    MAX_MESSAGE_BYTES,
    SUBSCRIPTION_DEPTH,
    describe_excess,
    subscribed_class,
)
from kinpole_ros.tracking.frame import MarkerFrames

_PATIENCE = 10.0  # s, for a publisher that starts at the same time; discovery takes one or two
_POLL_INTERVAL = 0.1  # s
_MAX_KEPT_BYTES = 1 << 28  # ten seconds of 100 markers at 1 kHz
_RESULT_DEPTH = 4  # messages of a topic of results that are kept


def listen(
    topic: str, seconds: float, progress: Callable[[float], None] | None = None
) -> tuple[list[MarkerFrames], str]:
    """
    Receive the markers of a topic for so many seconds from its first message on.

    Returns the frames, without messages that are too large for the node, and the full name of the
    topic. `progress` is called with the fraction done. Raises BagError where nobody publishes
    markers on it, or too much to be kept.
    """
    name = with_slash(topic)
    context = own_context()
    node = Node('kinpole_discover', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        kind = _published_kind(node, executor, name)
        messages, refused = _received(node, executor, (kind, name), seconds, progress)
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
    results = marker_reader(kind, 'auto').read(messages)
    frames = [result for result in results if not isinstance(result, MessageError)]
    if not frames:
        errors = [str(result) for result in results] or refused
        reason = f': {errors[0]}' if errors else ''
        raise BagError(
            f'no markers came on {name} that can be read{reason}; fix: see that its publisher runs'
        )
    return frames, name


def _received(
    node: Node,
    executor: SingleThreadedExecutor,
    topic: tuple[str, str],
    seconds: float,
    progress: Callable[[float], None] | None,
) -> tuple[list[bytes], list[str]]:
    """Return the messages of a topic, of a kind and a name, and why one was refused, if any was."""
    kind, name = topic
    messages: list[bytes] = []
    refused: list[str] = []
    size = 0

    def receive(data: bytes) -> None:
        nonlocal size
        if len(data) <= MAX_MESSAGE_BYTES:
            messages.append(data)
            size += len(data)
        elif not refused:
            refused.append(describe_excess(name, len(data)))

    qos = QoSProfile(depth=SUBSCRIPTION_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(subscribed_class(kind), name, receive, qos, raw=True)
    end = time.monotonic() + _PATIENCE
    has_begun = False
    while time.monotonic() < end and node.context.ok():
        executor.spin_once(timeout_sec=_POLL_INTERVAL)
        if size > _MAX_KEPT_BYTES:
            raise BagError(
                f'more than {_MAX_KEPT_BYTES >> 20} MiB came on {name}; fix: listen for fewer '
                'seconds, or record a bag and read that'
            )
        if (messages or refused) and not has_begun:
            has_begun, end = True, time.monotonic() + seconds
        if has_begun and progress is not None:
            progress(min(1.0, 1 - (end - time.monotonic()) / seconds))
    return messages, refused


def _published_kind(node: Node, executor: SingleThreadedExecutor, name: str) -> str:
    """Return the type of the published markers, a key of ROS_TYPE_NAMES."""
    kinds = {ros: kind for kind, ros in ROS_TYPE_NAMES.items()}
    end = time.monotonic() + _PATIENCE
    published: set[str] = set()
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=_POLL_INTERVAL)
        published = {offer.topic_type for offer in node.get_publishers_info_by_topic(name)}
        if readable := [kinds[one] for one in sorted(published) if one in kinds]:
            return readable[0]
    if published:
        raise BagError(
            f'{name} is published as {", ".join(sorted(published))}; markers must be one of '
            f'{", ".join(kinds)}'
        )
    raise BagError(
        f'there is no bag {name[1:]}, and nobody publishes on {name}; fix: name a bag, or start '
        'the driver'
    )


class Arrived(NamedTuple):
    """A message, and when it was published, ns since 1970 by the clock of its machine."""

    data: bytes
    published: int


class Watcher:
    """Subscribes to results; `newest` has the last messages of each topic, the newest last."""

    def __init__(self) -> None:
        self._node = Node('kinpole_view')
        self._subscriptions: dict[str, Subscription] = {}
        self.newest: dict[str, deque[Arrived]] = {}

    def close(self) -> None:
        """Unsubscribe from all topics."""
        self.want({})
        self._node.destroy_node()

    def nodes(self) -> dict[str, str]:
        """
        Return the full names of nodes that publish what pages show, and on which of `PAGE_TOPICS`.

        A bag of results that is played has `state` alone, and no topic `view`.
        """
        types = dict(self._node.get_topic_names_and_types())
        nodes: dict[str, str] = {}
        for topic in sorted(types):
            node, _, last = topic.rpartition('/')
            is_page = types[topic] == [PAGE_TOPICS.get(last)] and f'{node}/{DRAWING}' in types
            # Topics with subscribers alone are in the list too.
            if is_page and self._node.count_publishers(topic):
                # `view` comes after `state` and replaces it.
                nodes[node] = last
        return nodes

    def want(self, topics: Mapping[str, str]) -> None:
        """Subscribe to these topics, of these types, and no others."""
        for name in self._subscriptions.keys() - topics.keys():
            self._node.destroy_subscription(self._subscriptions.pop(name))
            del self.newest[name]
        latest = QoSProfile(depth=_RESULT_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        no_events = SubscriptionEventCallbacks(use_default_callbacks=False)
        for name in topics.keys() - self._subscriptions.keys():
            qos = LATCHED if name.endswith(f'/{RIG}') else latest
            self.newest[name] = deque(maxlen=_RESULT_DEPTH)
            self._subscriptions[name] = self._node.create_subscription(
                installed_class(topics[name]),
                name,
                lambda _: None,
                qos,
                event_callbacks=no_events,
                raw=True,
            )

    def wait(self, seconds: float) -> None:
        """Wait for a message, and take all that have come."""
        PreparedWait(self._node.context, list(self._subscriptions.values())).wait(seconds)
        for name, subscription in self._subscriptions.items():
            for data, info in take(subscription, _RESULT_DEPTH):
                self.newest[name].append(Arrived(data, info['source_timestamp']))


@contextmanager
def watching() -> Iterator[tuple[Watcher, Callable[[], bool]]]:
    """
    Yield a watcher, and a function that says whether SIGINT or SIGTERM has come.

    Raises BagError where ROS cannot start.
    """
    with bag_errors():
        stop_requested = start_ros([])
    try:
        watcher = Watcher()
        try:
            yield watcher, stop_requested
        finally:
            watcher.close()
    finally:
        rclpy.try_shutdown()
