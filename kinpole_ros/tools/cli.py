"""
The command `kinpole`: one subcommand is run, and what goes wrong for the user is one line.

Exit status 0 is done, 2 bad usage or bad input with one line on stderr.
"""

import io
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING

# All else is imported in functions: until `main` runs, Ctrl-C ends in a traceback.
if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

# The products computed here are small. A BLAS that has them done by threads waits for these longer
# than it computes where other processes run: 207 us a frame of replay on 2 busy cores against 60.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

# What SIGTERM ends as Ctrl-C does: nothing is left of results that are not whole, and of a player
# others do not believe for many seconds that it is there.
_ENDED = ('replay', 'simulate', 'solve', 'tolerance', 'discover', 'plot', 'import', 'play')


# Those that start ROS, which takes over the signals: until then there is nothing to clean up.
_STARTS_ROS = (['node'], ['view'], ['record'])
_INTERRUPTED = 130


def main(args: Sequence[str] | None = None) -> int:
    """
    Run one subcommand; returns the exit status.

    Without `args` it is that of the command line, and Ctrl-C is handled for the whole process. With
    them the caller's signal handlers stay.
    """
    return _run_as_process(sys.argv[1:]) if args is None else _run(list(args))


def node() -> int:
    """Run the node as `ros2 run` and launch files do."""
    return _run_as_process(['node', *sys.argv[1:]])


def _run_as_process(words: list[str]) -> int:
    """
    Run one subcommand, with Ctrl-C as a quiet end at any moment.

    Amid imports nobody expects KeyboardInterrupt: extension modules make other errors of it, and
    callbacks of the import system swallow it. So the process ends at once there.
    """

    def interrupt(number: int, frame: 'FrameType | None') -> None:
        if words[:1] in _STARTS_ROS or _is_import(frame):
            os._exit(_INTERRUPTED)
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, interrupt)
    try:
        return _run(words)
    except KeyboardInterrupt:  # before the subcommand is known
        return _INTERRUPTED
    finally:
        # The interpreter, as it goes, would print a traceback too.
        if signal.getsignal(signal.SIGINT) is interrupt:
            signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED))


def _is_import(frame: 'FrameType | None') -> bool:
    """Whether a module is being imported in this frame or in one that called it."""
    while frame is not None:
        if frame.f_code.co_filename.startswith('<frozen importlib'):
            return True
        frame = frame.f_back
    return False


def _run(words: list[str]) -> int:
    """Run one subcommand, with one line for what goes wrong for the user."""
    from kinpole_ros.tools.commands import COMMANDS
    from kinpole_ros.tools.commands._shared import one_line
    from kinpole_ros.tools.usage import parse_words

    _fill_closed()
    if isinstance(sys.stdout, io.TextIOWrapper):
        # What a locale has no letter for, or a file name that is no text, is shown by its number.
        sys.stdout.reconfigure(errors='backslashreplace')
    try:
        if words[:1] == ['node'] and not {'-h', '--help'} & set(words):
            # All that follows belongs to ROS.
            from kinpole_ros.ros.node import main as run_node

            return run_node(['kinpole', *words[1:]])
        options = parse_words(words)
        with _ended_by_sigterm() if options.command in _ENDED else nullcontext():
            return COMMANDS[options.command].run(options)
    except KeyboardInterrupt:
        return _INTERRUPTED
    except BrokenPipeError:
        return 0
    except Exception as error:
        # Interrupted in an extension, which raises an error of its own for it.
        if isinstance(error.__cause__, KeyboardInterrupt):
            return _INTERRUPTED
        if isinstance(error.__cause__, SystemExit):
            return int(error.__cause__.code or 0)
        if not _is_for_the_user(error):
            raise
        print(f'kinpole {words[0]}: {one_line(error)}', file=sys.stderr)
        return 2


@contextmanager
def _ended_by_sigterm() -> 'Iterator[None]':
    """Have SIGTERM end it in good order meanwhile."""
    import threading

    here = threading.current_thread() is threading.main_thread()
    end = lambda number, _: sys.exit(128 + number)  # noqa: E731
    before = signal.signal(signal.SIGTERM, end) if here else None
    try:
        yield
    finally:
        if here:
            signal.signal(signal.SIGTERM, before)


def _fill_closed() -> None:
    """Open what is closed of stdin to stderr: else a bag takes its place, and gets the output."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)


def _is_for_the_user(error: Exception) -> bool:
    """Whether it is one of our own one-line errors, not a bug that deserves its traceback."""
    from kinpole_ros.tools.commands._shared import UsageError, package_missing

    if isinstance(error, OSError | MemoryError) or package_missing(error):
        return True
    from kinpole_ros.mechanism import LinkageError, SceneError
    from kinpole_ros.tracking.parameters import ParameterError

    ours: tuple[type[Exception], ...] = (LinkageError, ParameterError, SceneError, UsageError)
    with suppress(ImportError):  # without mcap, nothing can have raised it
        from kinpole_ros.bags import BagError

        ours = (*ours, BagError)
    return isinstance(error, ours)


if __name__ == '__main__':
    sys.exit(main())
