"""
The command `kinpole`: one subcommand is run, and what goes wrong for the user is one line.

Exit status 0 is done, 2 bad usage or bad input with one line on stderr.
"""

import io
import os
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import contextmanager, nullcontext, suppress
from typing import TYPE_CHECKING

from kinpole_ros.tools.commands import COMMANDS
from kinpole_ros.tools.commands._shared import UsageError, one_line, package_missing
from kinpole_ros.tools.usage import parse_words

if TYPE_CHECKING:
    from collections.abc import Iterator

# The products computed here are small. A BLAS that has them done by threads waits for these longer
# than it computes where other processes run: 207 us a frame of replay on 2 busy cores against 60.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

# What SIGTERM ends as Ctrl-C does: nothing is left of results that are not whole, and of a player
# others do not believe for many seconds that it is there.
_ENDED = ('replay', 'simulate', 'solve', 'discover', 'plot', 'import', 'play')


def main(args: Sequence[str] | None = None) -> int:
    """Run one subcommand; returns the exit status."""
    words = list(sys.argv[1:] if args is None else args)
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
        return 130
    except BrokenPipeError:
        return 0
    except Exception as error:
        # Interrupted in an extension, which raises an error of its own for it.
        if isinstance(error.__cause__, KeyboardInterrupt):
            return 130
        if isinstance(error.__cause__, SystemExit):
            return int(error.__cause__.code or 0)
        if not _is_for_the_user(error):
            raise
        print(f'kinpole {words[0]}: {one_line(error)}', file=sys.stderr)
        return 2


@contextmanager
def _ended_by_sigterm() -> 'Iterator[None]':
    """Have SIGTERM end it in good order meanwhile."""
    here = threading.current_thread() is threading.main_thread()
    end = lambda number, _: sys.exit(128 + number)  # noqa: E731
    before = signal.signal(signal.SIGTERM, end) if here else None
    try:
        yield
    finally:
        if here:
            signal.signal(signal.SIGTERM, before)


def node() -> int:
    """Run the node as `ros2 run` and launch files do."""
    return main(['node', *sys.argv[1:]])


def _fill_closed() -> None:
    """Open what is closed of stdin to stderr: else a bag takes its place, and gets the output."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)


def _is_for_the_user(error: Exception) -> bool:
    """Whether it is one of our own one-line errors, not a bug that deserves its traceback."""
    if isinstance(error, OSError | MemoryError) or package_missing(error):
        return True
    from kinpole_ros.mechanism import LinkageError, SceneError
    from kinpole_ros.pipeline.parameters import ParameterError

    ours: tuple[type[Exception], ...] = (LinkageError, ParameterError, SceneError, UsageError)
    with suppress(ImportError):  # without mcap, nothing can have raised it
        from kinpole_ros.bags import BagError

        ours = (*ours, BagError)
    return isinstance(error, ours)


if __name__ == '__main__':
    sys.exit(main())
