"""
What rclpy has and does not document: each in one function, and nowhere else.

test/test_private.py holds each against the rclpy that is installed, and finds private names that
are used elsewhere.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

# What nearly every call of rclpy raises when rcl fails. rclpy.exceptions does not have it; its
# public base is RuntimeError, which errors in our own code are too.
RCLError: type[RuntimeError] = rclpy_implementation.RCLError


def wait_for_messages(node: Node, subscriptions: Sequence[Subscription], seconds: float) -> None:
    """
    Wait so long until a message of one of the subscriptions can be taken; `take` says of which.

    Executors wait for all entities of a node, which takes 0.2 ms. Public would be an executor that
    waits for some of them; rclpy.wait_for_message subscribes anew each time.
    """
    with ExitStack() as stack:
        context = node.context.handle
        wait_set = rclpy_implementation.WaitSet(len(subscriptions), 0, 0, 0, 0, 0, context)
        wait_set.clear_entities()
        for subscription in subscriptions:
            stack.enter_context(subscription.handle)
            wait_set.add_subscription(subscription.handle)
        wait_set.wait(round(seconds * 1e9))


def take(subscription: Subscription, most: int) -> Iterator[tuple[bytes, Mapping[str, Any]]]:
    """
    Messages that wait, as bytes with their info, `most` at most; never waits for one.

    An executor takes one message each time it waits. Public would be `Subscription.take`, as in
    rclcpp.
    """
    handle = subscription.handle
    with handle:
        for _ in range(most):
            message = handle.take_message(subscription.msg_type, True)
            if message is None:
                return
            yield message


def sequence_number(info: Mapping[str, Any]) -> int | None:
    """
    How many messages the publisher has sent up to this one, where the middleware counts them.

    The keys of a message's info are not documented. Public would be an attribute of a MessageInfo.
    """
    return info.get('publication_sequence_number')


def received_at(info: Mapping[str, Any]) -> int | None:
    """
    When the middleware received a message, ns since 1970, where it says so.

    Public would be an attribute of a MessageInfo.
    """
    return info.get('received_timestamp') or None


def has_known_node(endpoint: TopicEndpointInfo) -> bool:
    """
    Whether the node of an endpoint is known yet: an endpoint is known a little before its node.

    Until then rmw_dds_common writes a name of its own. Public would be None for a name.
    """
    return bool(endpoint.node_name != '_NODE_NAME_UNKNOWN_')


def wrap_service(node: Node, kind: type, wrapper: Callable[..., Any]) -> None:
    """
    Have `wrapper(callback, request, response)` answer requests of this kind, of rclpy's own.

    ChangeState: rclpy raises out of the executor for a transition that is not possible now.
    SetParameters: it sets one after the other, however many. Public would be methods to override;
    rclpy's have mangled names.
    """
    (service,) = (each for each in node.services if each.srv_type is kind)
    service.callback = partial(wrapper, service.callback)
