"""
ROS in this process: start and stop requests, and an executor that waits for messages alone.

The signal handlers of rclpy shut ROS down in the middle of any call, which then may raise anything,
and a thread of theirs wakes executors that may be gone, which crashes. Here a signal is only noted.
The loop that spins asks for it after each callback, and needs a timer, since nothing else ends a
wait.
"""

import atexit
import os
import re
import signal
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from kinpole_ros.ros.private import PreparedWait, RCLError, call

_HANGUP = getattr(signal, 'SIGHUP', signal.SIGTERM)  # Windows has none
_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, _HANGUP)
_MAX_DOMAIN = 232  # beyond, DDS has no ports
# s. Timers, services and other subscriptions are served after the first message that comes when
# this has passed, since then most time is left before the next one; without a message, at once.
_OTHERS_INTERVAL = 0.05
_IDLE_INTERVAL = 0.1  # s: the same where no message comes; a wake costs 0.3 ms
_FULL_TURN_INTERVAL = 0.5  # s: clients, guard conditions and events are served as often
_MAX_CALLBACKS = 10  # of services and other subscriptions before the next message


def start_ros(words: Sequence[str]) -> Callable[[], bool]:
    """
    Start rclpy with these words; return a function that says whether a request to stop has come.

    That is SIGINT, SIGTERM, or SIGHUP of a closed terminal, unless nohup has it ignored. Raises
    RCLError where ROS cannot start.
    """
    check_domain()
    rclpy.init(args=list(words), signal_handler_options=SignalHandlerOptions.NO)
    received: list[int] = []
    for number in _STOP_SIGNALS:
        if number != _HANGUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda number, _: received.append(number))
    atexit.register(_ignore_signals)
    return lambda: bool(received)


def _ignore_signals() -> None:
    """Ignore signals while the interpreter ends: they would kill it and change the exit status."""
    for number in _STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def check_domain() -> None:
    """Raise RCLError for a domain beyond the last, for which Fast DDS ends the process."""
    domain = os.environ.get('ROS_DOMAIN_ID', '')
    if domain.isdecimal() and int(domain) > _MAX_DOMAIN:
        raise RCLError(f'ROS_DOMAIN_ID is {domain}; it must be a number from 0 to {_MAX_DOMAIN}')


def reason_of(error: Exception) -> str:
    """Return the text of an error of rcl without source lines, with the fix where one is known."""
    reason = re.sub(r', at \S+:\d+', '', str(error))
    if 'log directory' in reason or 'logging directory' in reason:
        reason += '; set ROS_LOG_DIR to a folder that can be written'
    return reason


class SubscriptionGroup(MutuallyExclusiveCallbackGroup):
    """Callbacks of subscriptions; where `is_polled`, rclpy does not take their messages."""

    is_polled = False

    def can_execute(self, entity: Any) -> bool:
        if self.is_polled and isinstance(entity, Subscription):
            return False
        return bool(super().can_execute(entity))


class MessageSource(Protocol):
    """Subscriptions of one group, and a function that takes their messages."""

    group: SubscriptionGroup

    @property
    def subscriptions(self) -> Sequence[Subscription]:
        """The present subscriptions."""

    def take_messages(self) -> object:
        """Take the messages that wait, and process them; does not wait."""


def make_executor(source: MessageSource, node: Node, kind: str = 'lean') -> Executor:
    """
    Make the executor of a node whose messages come from `source`: `lean`, or that of `rclpy`.

    For each callback the executor of rclpy builds a wait set of all entities of a node, and a task:
    half of the CPU time of a relay. The lean one waits for the messages alone, with a wait set that
    it builds again only when subscriptions or services are created or destroyed. Every 50 ms, or
    100 ms without messages, it calls the timers that are ready, and has rclpy run what else is. It
    relies on internals of rclpy (`PreparedWait`). Where these differ it warns once and behaves as
    that of rclpy.
    """
    executor = SingleThreadedExecutor() if kind == 'rclpy' else LeanExecutor(source)
    executor.add_node(node)
    return executor


class LeanExecutor(SingleThreadedExecutor):
    """The lean executor of `make_executor`."""

    def __init__(self, source: MessageSource) -> None:
        super().__init__()
        self._source = source
        self._is_supported = True
        self._is_stale = True
        # Whether a message came since everything else was served.
        self._has_taken = False
        self._message_wait: PreparedWait | None = None
        self._other_wait: PreparedWait | None = None
        self._others_due = self._full_turn_due = 0.0

    def wake(self) -> None:
        """Note that entities of a node were created or destroyed: rclpy calls this then."""
        self._is_stale = True
        super().wake()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Take the messages that wait, or run the callbacks of everything else that is ready."""
        if self._is_stale:
            self._prepare()
        if self._message_wait is None:
            super().spin_once(timeout_sec)
            return
        seconds = self._others_due - time.monotonic()
        if seconds > 0:
            if timeout_sec is not None and timeout_sec >= 0:
                seconds = min(seconds, timeout_sec)
            is_ready = self._message_wait.wait(seconds)
            if is_ready and self._source.subscriptions:
                self._has_taken, is_ready = True, False
                self._source.take_messages()
            # Without a subscription a service is ready.
            if not is_ready and time.monotonic() < self._others_due:
                return
        for node in self.get_nodes():
            for timer in node.timers:
                if timer.is_ready():
                    call(timer)
        for _ in range(_MAX_CALLBACKS):
            if self._is_stale or not self._is_other_ready():
                break
            self._full_turn_due = time.monotonic() + _FULL_TURN_INTERVAL
            super().spin_once(0)
        # Not before: after a callback that fails, the next ones are served at once.
        interval = _OTHERS_INTERVAL if self._has_taken else _IDLE_INTERVAL
        self._others_due, self._has_taken = time.monotonic() + interval, False

    def _is_other_ready(self) -> bool:
        """Whether rclpy has a callback to run, or everything is due to be served."""
        if time.monotonic() >= self._full_turn_due:
            return True
        return self._other_wait is not None and self._other_wait.wait(0.0)

    def _prepare(self) -> None:
        """Make the wait sets of the present entities."""
        self._message_wait = self._other_wait = None
        self._is_stale = False
        subscriptions = list(self._source.subscriptions)
        if not self._is_supported:
            return
        nodes = self.get_nodes()
        unpolled = [s for node in nodes for s in node.subscriptions if s not in subscriptions]
        services = [s for node in nodes for s in node.services]
        try:
            awaited = () if subscriptions else services
            self._message_wait = PreparedWait(self.context, subscriptions, awaited)
            self._other_wait = PreparedWait(self.context, unpolled, services)
        except (AttributeError, TypeError) as error:
            self._message_wait = self._other_wait = None
            self._is_supported = False
            for node in nodes:
                node.get_logger().warning(
                    f'this rclpy has other internals than are known ({error}), so its own executor '
                    'waits, at more CPU time; set the parameter executor to rclpy to have no '
                    'warning'
                )
        self._source.group.is_polled = self._is_supported
