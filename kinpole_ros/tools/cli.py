"""
The command `kinpole`: run one subcommand, and report the user's errors in one line.

The exit status is 0 if all is done, 2 for bad usage or bad input, with one line on stderr, and 1
for a difference that `replay --strict` finds.
"""

import gc
import io
import os
import signal
import sys
from contextlib import contextmanager, nullcontext

# Other modules are imported in functions: until `main` runs, Ctrl-C ends in a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import FrameType

# The matrix products are small. With other processes running, the threads of a BLAS wait longer for
# each other than they compute: 207 us per frame of replay on 2 busy cores, against 60.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

# Commands that start ROS, which installs its own signal handlers. SIGTERM, and SIGHUP of a closed
# terminal, end all others like Ctrl-C, so that they remove incomplete results, and a player says
# goodbye to its subscribers.
_START_ROS = ('node', 'view', 'record', 'camera')
_INTERRUPTED = 130


def main(args: 'Sequence[str] | None' = None) -> int:
    """
    Run one subcommand and return the exit status.

    Without `args`, run the command line and handle Ctrl-C for the whole process. With `args`, leave
    the caller's signal handlers in place.
    """
    return _run_as_process(sys.argv[1:]) if args is None else _run(list(args))


def node() -> int:
    """Run the node as `ros2 run` and launch files do."""
    return _run_as_process(['node', *sys.argv[1:]])


def _run_as_process(words: list[str]) -> int:
    """
    Run one subcommand, with Ctrl-C as a quiet end at any moment.

    During imports the process ends at once: extension modules turn KeyboardInterrupt into errors of
    their own, and callbacks of the import system swallow it.
    """

    def interrupt(number: int, frame: 'FrameType | None') -> None:
        if (words[:1] and words[0] in _START_ROS) or _is_importing(frame):
            os._exit(_INTERRUPTED)
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, interrupt)
    # Modules are not garbage: a search among them for each 700 new objects takes 5% of a replay.
    gc.set_threshold(10_000)
    try:
        return _run(words)
    except KeyboardInterrupt:  # before the subcommand is known
        return _INTERRUPTED
    finally:
        # The interpreter would print a traceback too while it shuts down.
        if signal.getsignal(signal.SIGINT) is interrupt:
            signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED))


def _is_importing(frame: 'FrameType | None') -> bool:
    """Return whether this frame or one of its callers is importing a module."""
    while frame is not None:
        if frame.f_code.co_filename.startswith('<frozen importlib'):
            return True
        frame = frame.f_back
    return False


def _run(words: list[str]) -> int:
    """Run one subcommand; report an error of the user in one line."""
    from kinpole_ros.tools.commands import COMMANDS
    from kinpole_ros.tools.commands._terminal import is_user_error, print_error
    from kinpole_ros.tools.usage import parse_words

    _open_closed_streams()
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Letters that the locale lacks, and file names that are not text, are printed as numbers.
        sys.stdout.reconfigure(errors='backslashreplace')
    try:
        if words[:1] == ['node'] and not {'-h', '--help'} & set(words):
            # All following words belong to ROS.
            from kinpole_ros.ros.node import main as run_node

            return run_node(['kinpole', *words[1:]])
        options = parse_words(words)
        with nullcontext() if options.command in _START_ROS else _clean_up_when_stopped():
            return COMMANDS[options.command].run(options)
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:
        return 0
    except Exception as error:
        # Extension modules raise errors of their own when a signal interrupts them.
        if isinstance(error.__cause__, KeyboardInterrupt):
            return _INTERRUPTED
        if isinstance(error.__cause__, SystemExit):
            return int(error.__cause__.code or 0)
        if not is_user_error(error):
            raise
        print_error(words[0], error)
        return 2


@contextmanager
def _clean_up_when_stopped() -> 'Iterator[None]':
    """Turn SIGTERM and SIGHUP into SystemExit, so that context managers end in good order."""
    import threading

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = {signal.SIGTERM, getattr(signal, 'SIGHUP', signal.SIGTERM)}
    # As nohup has SIGHUP.
    used = [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]
    before = [signal.signal(number, lambda number, _: sys.exit(128 + number)) for number in used]
    try:
        yield
    finally:
        for number, handler in zip(used, before, strict=True):
            signal.signal(number, handler)


def _open_closed_streams() -> None:
    """Open stdin, stdout and stderr where closed; else a bag takes its number, and the output."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)


if __name__ == '__main__':
    sys.exit(main())
