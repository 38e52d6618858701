"""How a node waits: for its messages alone, and now and then for everything else."""

import time
from collections.abc import Sequence
from typing import Any, Protocol

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.subscription import Subscription

from kinpole_ros.ros.private import PreparedWait, call

# s. Timers, services and other subscriptions are looked at after the first message that comes when
# this has passed, as then there is most time until the next one; without a message when it passes.
_OTHERS_EVERY = 0.05
# s. Everything else of a node has a turn as often: clients, guard conditions, events.
_TURN_EVERY = 0.5
# Callbacks of services and other subscriptions in a row, with no message between them.
_MOST_IN_A_ROW = 10


class SubscriptionGroup(MutuallyExclusiveCallbackGroup):
    """Callbacks of subscriptions; rclpy leaves their messages where `is_polled` is set."""

    is_polled = False

    def can_execute(self, entity: Any) -> bool:
        if self.is_polled and isinstance(entity, Subscription):
            return False
        return bool(super().can_execute(entity))


class MessageSource(Protocol):
    """Subscriptions of one group, and what takes their messages."""

    group: SubscriptionGroup

    @property
    def subscriptions(self) -> Sequence[Subscription]:
        """The subscriptions as they are now, none while there are none yet."""

    def take_messages(self) -> object:
        """Take what waits, and work on it; does not wait."""


def make_executor(source: MessageSource, node: Node, kind: str = 'lean') -> Executor:
    """
    Make the executor of a node whose messages come from `source`.

    rclpy's own builds a wait set of all that a node has for each callback, and makes a task of it:
    half of the CPU time of a relay. The `lean` one waits for the messages alone, with a wait set
    that is made once and anew only when subscriptions or services come or go. Every 50 ms it calls
    the timers that are ready, and has rclpy run what else is ready. For that it relies on what
    rclpy does not document (`PreparedWait`). Where that is not as expected it warns once, and does
    as `rclpy`, the other kind.
    """
    executor = SingleThreadedExecutor() if kind == 'rclpy' else LeanExecutor(source)
    executor.add_node(node)
    return executor


class LeanExecutor(SingleThreadedExecutor):
    """The lean kind of `make_executor`."""

    def __init__(self, source: MessageSource) -> None:
        super().__init__()
        self._source = source
        self._is_lean = True
        self._is_stale = True
        self._message_wait: PreparedWait | None = None
        self._other_wait: PreparedWait | None = None
        self._others_due = self._turn_due = 0.0

    def wake(self) -> None:
        """Note that entities of a node were created or destroyed, as rclpy tells by this."""
        self._is_stale = True
        super().wake()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Take the messages that wait, or run callbacks of everything else that is ready."""
        if self._is_stale:
            self._prepare()
        if self._message_wait is None:
            # There is nothing to be lean about yet.
            super().spin_once(timeout_sec)
            return
        left = self._others_due - time.monotonic()
        if left > 0:
            if timeout_sec is not None and timeout_sec >= 0:
                left = min(left, timeout_sec)
            if self._message_wait.wait(left):
                self._source.take_messages()
            if time.monotonic() < self._others_due:
                return
        for node in self.get_nodes():
            for timer in node.timers:
                if timer.is_ready():
                    call(timer)
        for _ in range(_MOST_IN_A_ROW):
            if self._is_stale or not self._is_other_ready():
                break
            self._turn_due = time.monotonic() + _TURN_EVERY
            super().spin_once(0)
        # After a failure the rest goes on at once.
        self._others_due = time.monotonic() + _OTHERS_EVERY

    def _is_other_ready(self) -> bool:
        """Whether rclpy has to run a callback, or its turn of everything is due."""
        if time.monotonic() >= self._turn_due:
            return True
        return self._other_wait is not None and self._other_wait.wait(0.0)

    def _prepare(self) -> None:
        """Make the wait sets of the entities that there are now."""
        self._message_wait = self._other_wait = None
        self._is_stale = False
        subscriptions = list(self._source.subscriptions)
        if not self._is_lean or not subscriptions:
            return
        nodes = self.get_nodes()
        others = [s for node in nodes for s in node.subscriptions if s not in subscriptions]
        services = [s for node in nodes for s in node.services]
        try:
            self._message_wait = PreparedWait(self.context, subscriptions)
            self._other_wait = PreparedWait(self.context, others, services)
        except (AttributeError, TypeError) as error:
            self._message_wait = self._other_wait = None
            self._is_lean = False
            for node in nodes:
                node.get_logger().warning(
                    f'this rclpy has other internals than are known ({error}), so its own executor '
                    'waits, at more CPU time; set the parameter executor to rclpy to have no '
                    'warning'
                )
        self._source.group.is_polled = self._is_lean
