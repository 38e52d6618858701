"""
What this package uses of rclpy that is not documented, one function each, and nowhere else.

test/test_private.py checks each against the rclpy that is installed, and finds private names that
are used elsewhere.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

# Nearly every call of rclpy raises it when rcl fails. rclpy.exceptions does not have it, and its
# public base is RuntimeError, which other errors are too.
RCLError: type[RuntimeError] = rclpy_implementation.RCLError


class PreparedWait:
    """
    A wait set for some subscriptions, made once for many waits.

    Executors wait for all entities of a node, and make a wait set for each wait, which takes 0.2
    ms. The documented rclpy.wait_for_message subscribes for each wait. The subscriptions must not
    be destroyed before the last wait. Raises AttributeError or TypeError where the internals of
    rclpy differ.
    """

    def __init__(self, context: Context, subscriptions: Sequence[Subscription]) -> None:
        self._handles = [subscription.handle for subscription in subscriptions]
        self._wait_set = rclpy_implementation.WaitSet(
            len(subscriptions), 0, 0, 0, 0, 0, context.handle
        )
        # Fails here where the internals differ.
        self.wait(0.0)

    def wait(self, seconds: float) -> bool:
        """Wait until a message can be taken; return whether one can be."""
        wait_set = self._wait_set
        wait_set.clear_entities()
        with ExitStack() as stack:
            for handle in self._handles:
                stack.enter_context(handle)
                wait_set.add_subscription(handle)
            wait_set.wait(round(seconds * 1e9))
        return bool(wait_set.get_ready_entities('subscription'))


def take(subscription: Subscription, count: int) -> Iterator[tuple[bytes, Mapping[str, Any]]]:
    """
    Take up to `count` of the messages that wait, as bytes, each with its info; does not wait.

    An executor takes one message in each wait. rclcpp has a public `Subscription::take`.
    """
    handle = subscription.handle
    with handle:
        for _ in range(count):
            message = handle.take_message(subscription.msg_type, True)
            if message is None:
                return
            yield message


def sender(publisher: Publisher) -> Callable[[bytes], None]:
    """
    Return what publishes serialized messages, until the publisher is destroyed.

    `Publisher.publish` asks what type a message has, and whether its node is active: a quarter of
    the time that publishing takes.
    """
    send: Callable[[bytes], None] = publisher.handle.publish_raw
    return send


def sequence_number(info: Mapping[str, Any]) -> int | None:
    """The number that the publisher gave to a message, where the middleware counts them."""
    return info.get('publication_sequence_number')


def received_at(info: Mapping[str, Any]) -> int | None:
    """The time at which the middleware received a message, ns since 1970, where it has one."""
    return info.get('received_timestamp') or None


def has_known_node(endpoint: TopicEndpointInfo) -> bool:
    """Whether the node of an endpoint is known yet; rmw_dds_common has a fixed name until then."""
    return bool(endpoint.node_name != '_NODE_NAME_UNKNOWN_')


def wrap_service(node: Node, kind: type, wrapper: Callable[..., Any]) -> None:
    """
    Have `wrapper(callback, request, response)` answer requests of this type to rclpy's own service.

    ChangeState: rclpy raises out of the executor for a transition that is not possible now.
    SetParameters: rclpy sets any number of parameters one by one. The methods of rclpy that answer
    have mangled names.
    """
    (service,) = (service for service in node.services if service.srv_type is kind)
    service.callback = partial(wrapper, service.callback)
