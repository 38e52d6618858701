"""
What rclpy has and does not document: each in one function, and nowhere else.

test/test_private.py holds each against the rclpy that is installed, and finds private names that
are used elsewhere.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rclpy.topic_endpoint_info import TopicEndpointInfo

# What nearly every call of rclpy raises when rcl fails. rclpy.exceptions does not have it; its
# public base is RuntimeError, which errors in our own code are too.
RCLError: type[RuntimeError] = rclpy_implementation.RCLError


class PreparedWait:
    """
    A wait set for some subscriptions and services, made once for many waits.

    Executors wait for all entities of a node, and make a wait set for each wait: 0.2 ms. Public
    would be an executor that waits for some of them; rclpy.wait_for_message subscribes anew each
    time. The entities must not be destroyed before the last wait. Raises AttributeError or
    TypeError where rclpy has other internals than these.
    """

    def __init__(
        self,
        context: Context,
        subscriptions: Sequence[Subscription] = (),
        services: Sequence[Service] = (),
    ) -> None:
        self._subscriptions = [each.handle for each in subscriptions]
        self._services = [each.handle for each in services]
        counts = len(subscriptions), 0, 0, 0, len(services), 0
        self._wait_set = rclpy_implementation.WaitSet(*counts, context.handle)
        # Other internals are found out here.
        self.wait(0.0)

    def wait(self, seconds: float) -> bool:
        """Wait so long until a message or a request can be taken; whether one can be."""
        wait_set = self._wait_set
        wait_set.clear_entities()
        with ExitStack() as stack:
            for handle in self._subscriptions:
                stack.enter_context(handle)
                wait_set.add_subscription(handle)
            for handle in self._services:
                stack.enter_context(handle)
                wait_set.add_service(handle)
            wait_set.wait(round(seconds * 1e9))
        return bool(
            wait_set.get_ready_entities('subscription') or wait_set.get_ready_entities('service')
        )


def call(timer: Timer) -> None:
    """
    Begin the next period of a timer that is ready, and run its callback, which is no coroutine.

    Executors make a wait set and a task for it. Public would be a method of the timer.
    """
    with timer.handle:
        timer.handle.call_timer()
    timer.callback()


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
