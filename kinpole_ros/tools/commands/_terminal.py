"""Output of commands on the terminal: a progress bar, and errors in one line."""

import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress

from kinpole_ros.files import cut_line, printable
from kinpole_ros.packages import broken_import, install_command, package_of

_FIXES_OF_PACKAGES = {
    **dict.fromkeys(
        ('av', 'cv2'),
        f'films need OpenCV and PyAV; install them with {install_command("film")}',
    ),
    'bench': 'the benchmarks are in a checkout of the source, not in an installed package: run '
    'kinpole bench from one, after pip install --editable .',
    'matplotlib': f'drawing needs matplotlib; install it with {install_command("plot")}',
    'mcap': "reading and writing bags needs mcap; install it with pip install 'mcap>=1.5'",
}
_NO_ROS = (
    'source a ROS 2 installation first, or the .venv that `make demo` sets up, or get the wheels '
    f'for Linux on x86-64 with {install_command("ros")}'
)
_BROKEN_ROS = (
    'run kinpole with the Python and in the environment of that ROS 2 installation, or in the '
    '.venv that `make demo` sets up'
)
# Characters. A message may list the topics or markers of a bag, of which there is no limit.
_LONGEST_LINE = 5000


class UsageError(Exception):
    """Words of a command line that cannot be used; one line with the fix."""


def package_missing(error: object) -> str:
    """Return the foreign package whose import failed; '' if that is not the error."""
    package = package_of(error) if isinstance(error, ImportError) else ''
    return '' if package == 'kinpole_ros' else package


def is_user_error(error: Exception) -> bool:
    """Return whether an error is the user's to fix, not a bug that deserves its traceback."""
    if isinstance(error, OSError | MemoryError) or package_missing(error):
        return True
    from kinpole_ros.mechanism import LinkageError, SceneError
    from kinpole_ros.settings import ParameterError

    types: tuple[type[Exception], ...] = (LinkageError, ParameterError, SceneError, UsageError)
    with suppress(ImportError):  # without mcap, nothing can have raised BagError
        from kinpole_ros.bags import BagError

        types = (*types, BagError)
    return isinstance(error, types)


def one_line(error: object) -> str:
    """Return what is wrong and the fix as one line that a terminal can show."""
    if package := package_missing(error):
        ros = package == 'rclpy' or package.endswith(('_msgs', '_interfaces'))
        if isinstance(error, ImportError) and (reason := broken_import(error)):
            fix = _BROKEN_ROS if ros else f'pip install --force-reinstall {package}'
            return f'{cut_line(printable(reason), _LONGEST_LINE)}; fix: {fix}'
        fix = _NO_ROS if ros else f'install it with pip install {package}'
        default = f'the Python package {package} cannot be imported; {fix}'
        return _FIXES_OF_PACKAGES.get(package, default)
    text = cut_line(printable(' '.join(str(error).split())), _LONGEST_LINE)
    if isinstance(error, OSError) and error.strerror:
        # An error of the system that no code has reworded.
        fix = 'check the path, its rights and the space on the disk'
        return f'{error.filename or "a file"} cannot be used: {error.strerror}; fix: {fix}'
    if isinstance(error, MemoryError):
        return f'the memory is too small for this ({text or "full"}); fix: do it in shorter parts'
    return text


def print_error(command: str, error: object) -> None:
    """Print an error or warning as one line on stderr."""
    print(f'kinpole {command}: {one_line(error)}', file=sys.stderr)


def print_lines(lines: Iterable[str]) -> None:
    """Print lines that may hold names from files."""
    print('\n'.join(map(printable, lines)))


def on_terminal() -> bool:
    """Return whether stderr, which may be closed, is a terminal."""
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def progress_bar(title: str) -> Iterator[Callable[[float], None] | None]:
    """Yield a function that draws the fraction done on a terminal; None in a pipe."""
    if not on_terminal():
        yield None
        return
    start = drawn = time.monotonic()

    def draw(fraction: float) -> None:
        nonlocal drawn
        now = time.monotonic()
        if now - drawn < 0.1 and fraction < 1:
            return
        drawn = now
        bar = '#' * round(30 * fraction)
        seconds = (now - start) * (1 - fraction) / fraction if fraction > 0.01 else None
        remaining = '' if seconds is None else f'{seconds:4.0f} s left'
        text = f'{title} [{bar:<30}] {fraction:4.0%} {remaining:12}'[: _bar_width()]
        print(f'\r{text}', end='', file=sys.stderr, flush=True)

    try:
        yield draw
    finally:
        print(erased_bar(), end='', file=sys.stderr, flush=True)


def _bar_width() -> int:
    """Return the columns of a progress bar; one that wraps could not be erased."""
    return min(70, shutil.get_terminal_size().columns - 1)


def erased_bar() -> str:
    """Return the characters that erase a progress bar."""
    return f'\r{"":{_bar_width()}}\r'
