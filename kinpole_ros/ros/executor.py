"""
How a node waits: for its messages alone, and every so often for all else.

rclpy looks at all that a node has, timers and a dozen services, whenever it waits: 0.2 ms of each
answer, where the whole of a plain relay's takes 0.6.
"""

import time
from typing import Any, Protocol

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.subscription import Subscription

# s. All else has its turn after the first messages that come when this has passed, for then there
# is most time until the next; without any when as much again has passed.
_EVERY = 0.05


class SubscriptionGroup(MutuallyExclusiveCallbackGroup):
    """Callbacks of subscriptions; an executor leaves their messages where `is_polled` is set."""

    is_polled = False

    def can_execute(self, entity: Any) -> bool:
        if self.is_polled and isinstance(entity, Subscription):
            return False
        return bool(super().can_execute(entity))


class Messages(Protocol):
    """Subscriptions with a way to wait for them alone; `found` once there are any."""

    @property
    def found(self) -> bool: ...

    def wait(self, seconds: float) -> bool:
        """Wait so long for messages and work on them; whether any came."""


class MessagesFirst(SingleThreadedExecutor):
    """Runs a node whose messages come from `source`."""

    def __init__(self, source: Messages) -> None:
        super().__init__()
        self._source = source
        self._due = 0.0

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Take messages, or run all else that is ready; without any to come as rclpy's does."""
        if not self._source.found:
            super().spin_once(timeout_sec)
            return
        left = self._due + _EVERY - time.monotonic()
        if left > 0:
            came = self._source.wait(left if timeout_sec is None else min(left, timeout_sec))
            if not came or time.monotonic() < self._due:
                return
        self._due = time.monotonic() + _EVERY
        try:
            while True:
                run, _, _ = self.wait_for_ready_callbacks(timeout_sec=0)
                run()
                run.result()
        except TimeoutException:
            pass
