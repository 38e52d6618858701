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
from contextlib import suppress
from typing import Any, Protocol

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from kinpole_ros.ros.private import PreparedWait, RCLError

_HANGUP = getattr(signal, 'SIGHUP', signal.SIGTERM)  # Windows has none
_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, _HANGUP)
_MAX_DOMAIN = 232  # beyond, DDS has no ports
# s. Timers, services and other subscriptions are served after the first message that comes when
# this has passed, since then most time is left before the next one; without a message later.
_OTHERS_INTERVAL, _IDLE_INTERVAL = 0.05, 0.1


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


class MessageSource(Protocol):
    """Subscriptions, and a function that takes their messages."""

    @property
    def subscriptions(self) -> list[Subscription]:
        """The present subscriptions."""

    def take_messages(self) -> object:
        """Take the messages that wait, and process them; does not wait."""


def make_executor(source: MessageSource, node: Node, kind: str = 'lean') -> Executor:
    """
    Make the executor of a node whose messages come from `source`: `lean`, or that of `rclpy`.

    For each callback the executor of rclpy builds a wait set of all entities of a node, and a task:
    half of the CPU time of a relay. The lean one waits for the messages alone, with a wait set that
    it builds again only when other subscriptions replace them. It relies on internals of rclpy
    (`PreparedWait`). Where these differ it warns once and behaves as that of rclpy.
    """
    executor = SingleThreadedExecutor() if kind == 'rclpy' else LeanExecutor(source)
    executor.add_node(node)
    return executor


class LeanExecutor(SingleThreadedExecutor):
    """The lean executor of `make_executor`; without subscriptions rclpy waits for all else."""

    def __init__(self, source: MessageSource) -> None:
        super().__init__()
        self._source = source
        self._is_supported = True
        # The subscriptions whose messages rclpy does not take, and what waits for these.
        self._polled: list[Subscription] = []
        self._wait: PreparedWait | None = None
        self._last_served = 0.0

    def can_execute(self, entity: Any) -> bool:
        """Whether rclpy may run the callback of an entity."""
        return entity not in self._polled and bool(super().can_execute(entity))

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Take the messages that wait, or run the callbacks of everything else that is ready."""
        subscriptions = self._source.subscriptions
        if subscriptions != self._polled and self._is_supported:
            self._prepare(subscriptions)
        if self._wait is None:
            super().spin_once(timeout_sec)
            return
        seconds = self._last_served + _IDLE_INTERVAL - time.monotonic()
        if timeout_sec is not None and timeout_sec >= 0:
            seconds = min(seconds, timeout_sec)
        # Not if it is negative: where all messages fail, everything else has its turn still.
        if seconds >= 0 and self._wait.wait(seconds):
            self._source.take_messages()
        if time.monotonic() >= self._last_served + _OTHERS_INTERVAL:
            self._serve_others()

    def _serve_others(self) -> None:
        """Run each callback that is ready once, but those of the messages."""
        with suppress(TimeoutException):
            while True:
                callback, _, _ = self.wait_for_ready_callbacks(0)
                callback()
                callback.result()  # raises its error
        # Not before: after a callback that fails, the next ones are served at once.
        self._last_served = time.monotonic()

    def _prepare(self, subscriptions: list[Subscription]) -> None:
        """Wait for the messages of these subscriptions from now on."""
        self._polled, self._wait = [], None
        if not subscriptions:
            return
        try:
            self._wait = PreparedWait(self.context, subscriptions)
            self._polled = list(subscriptions)
        except (AttributeError, TypeError) as error:
            self._is_supported = False
            for node in self.get_nodes():
                node.get_logger().warning(
                    f'this rclpy has other internals than are known ({error}), so its own executor '
                    'waits, at more CPU time; set the parameter executor to rclpy to have no '
                    'warning'
                )
