"""Markers of a live topic for some seconds, as arrays: what a bag of them would hold."""

import time
from collections.abc import Callable

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from kinpole_ros.bags import BagError
from kinpole_ros.messages import MARKER_TYPES, ROS_TYPE_NAMES, MarkerReader, MessageError
from kinpole_ros.ros.live import own_context
from kinpole_ros.ros.source import MAX_MESSAGE_BYTES, SUBSCRIPTION_DEPTH, describe_excess
from kinpole_ros.tracking.frame import MarkerFrames

# s. A publisher is known to others within a second or two; more is for those that start just now.
_PATIENCE = 10.0
_LOOK_EVERY = 0.1
# Bytes of messages that are kept: ten seconds of 100 markers at 1 kHz.
_MAX_KEPT_BYTES = 1 << 28


def listen(
    topic: str, seconds: float, progress: Callable[[float], None] | None = None
) -> tuple[list[MarkerFrames], str]:
    """
    Frames of `topic` from the first message on, for so many seconds, and the topic's full name.

    Messages that are too large for the node are left out. Raises BagError where nobody publishes
    markers on it, or more than can be kept.
    """
    name = topic if topic.startswith('/') else f'/{topic}'
    context = own_context()
    node = Node('kinpole_discover', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    kept = _Messages(name)
    try:
        kind = _kind(node, executor, name)
        qos = QoSProfile(depth=SUBSCRIPTION_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(MARKER_TYPES[kind], name, kept.keep, qos, raw=True)
        end = time.monotonic() + _PATIENCE
        begun = False
        while time.monotonic() < end and context.ok():
            executor.spin_once(timeout_sec=_LOOK_EVERY)
            if kept.size > _MAX_KEPT_BYTES:
                raise BagError(
                    f'more than {_MAX_KEPT_BYTES >> 20} MiB came on {name}; fix: listen for fewer '
                    'seconds, or record a bag and read that'
                )
            if kept.messages and not begun:
                begun, end = True, time.monotonic() + seconds
            if begun and progress is not None:
                progress(min(1.0, 1 - (end - time.monotonic()) / seconds))
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
    read = MarkerReader(kind).read(kept.messages)
    found = [part for part in read if not isinstance(part, MessageError)]
    if not found:
        errors = [str(part) for part in read if isinstance(part, MessageError)] or kept.refused
        why = f': {errors[0]}' if errors else ''
        raise BagError(
            f'no markers came on {name} that can be read{why}; fix: see that its publisher runs'
        )
    return found, name


class _Messages:
    """Messages of a topic that are not too large, and their `size` in bytes."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self.messages: list[bytes] = []
        self.size = 0
        # What is wrong with the first message that was left out.
        self.refused: list[str] = []

    def keep(self, data: bytes) -> None:
        """Append a message, or leave it out."""
        if len(data) <= MAX_MESSAGE_BYTES:
            self.messages.append(data)
            self.size += len(data)
        elif not self.refused:
            self.refused.append(describe_excess(self._topic, len(data)))


def _kind(node: Node, executor: SingleThreadedExecutor, name: str) -> str:
    """The short name of the type that the topic is published as."""
    kinds = {ros: kind for kind, ros in ROS_TYPE_NAMES.items()}
    end = time.monotonic() + _PATIENCE
    published: set[str] = set()
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=_LOOK_EVERY)
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
