"""
ROS in a process of its own: started, and asked to stop.

Not by rclpy's own signal handlers. They shut ROS down amid whatever is done, so that any call may
raise anything then, and a thread of theirs wakes executors that may be gone already, which crashes.
Here a signal is but noted; who spins asks for it after each callback, and needs a timer that beats,
since nothing else ends a wait.
"""

import atexit
import os
import re
import signal
from collections.abc import Callable, Sequence

import rclpy
from rclpy.signals import SignalHandlerOptions

from kinpole_ros.ros.private import RCLError

# Beyond, the ports of DDS are used up.
_LAST_DOMAIN = 232


def start_ros(words: Sequence[str]) -> Callable[[], bool]:
    """
    Start rclpy with these words; returns what tells whether SIGINT or SIGTERM has come since.

    Until it is started both do as ever. Raises RCLError where ROS cannot start.
    """
    check_domain()
    rclpy.init(args=list(words), signal_handler_options=SignalHandlerOptions.NO)
    come: list[int] = []
    for sign in (signal.SIGINT, signal.SIGTERM):
        signal.signal(sign, lambda number, _: come.append(number))
    atexit.register(_ignore_signals)
    return lambda: bool(come)


def check_domain() -> None:
    """Raise RCLError for a domain beyond the last, for which Fast DDS ends the process."""
    domain = os.environ.get('ROS_DOMAIN_ID', '')
    if domain.isdecimal() and int(domain) > _LAST_DOMAIN:
        message = f'ROS_DOMAIN_ID is {domain}; it must be a number from 0 to {_LAST_DOMAIN}'
        raise RCLError(message)


def _ignore_signals() -> None:
    """What it handles would kill the interpreter again while it goes, and spoil the exit status."""
    for sign in (signal.SIGINT, signal.SIGTERM):
        signal.signal(sign, signal.SIG_IGN)


def reason_of(error: Exception) -> str:
    """What rcl says is wrong, less the places in its source, and how to fix it where it can."""
    reason = re.sub(r', at \S+:\d+', '', str(error))
    if 'log directory' in reason or 'logging directory' in reason:
        reason += '; set ROS_LOG_DIR to a folder that can be written'
    return reason
