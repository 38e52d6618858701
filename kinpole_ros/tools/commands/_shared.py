"""What several commands need: files kept, settings, progress, and one line for what is wrong."""

import argparse
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from kinpole_ros.files import cut_line, printable
from kinpole_ros.packages import broken_import, install_command, package_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from kinpole_ros.tracking.parameters import Settings

# The endings of the files that commands write, by what a file is.
_ENDINGS = {
    'an HTML page': ('.html', '.htm'),
    'an MCAP bag': ('.mcap',),
    'a CSV table': ('.csv', '.tsv', '.txt'),
    'a Parquet table': ('.parquet',),
    'a YAML file': ('.yaml', '.yml'),
    'a Foxglove layout': ('.json',),
    'a PlotJuggler layout': ('.xml',),
    'a picture': ('.png', '.pdf', '.svg', '.jpg', '.jpeg'),
    'a pair of pitch curves': ('.csv', '.svg', '.dxf'),
}
# Browsers go by the ending of a page, and the ending says what pitch curves are written as.
_STRICT = ('an HTML page', 'a pair of pitch curves')


class UsageError(Exception):
    """Words of a command that cannot be used, in one line with the fix."""


# Packages that may be missing, and how to come by them.
_FIXES = {
    'bench': 'the benchmarks are in a checkout of the source, not in an installed package: run '
    'kinpole bench from one, after pip install --editable .',
    'matplotlib': f'drawing needs matplotlib; install it with {install_command("plot")}',
    'mcap': "reading and writing bags needs mcap; install it with pip install 'mcap>=1.5'",
}
# Characters: a bag may have any number of topics, and markers, with any names.
_LONGEST_LINE = 5000
_NO_ROS = (
    'source a ROS 2 installation first, or the .venv that `make demo` sets up, or get the wheels '
    f'for Linux on x86-64 with {install_command("ros")}'
)
_BROKEN_ROS = (
    'run kinpole with the Python and in the environment of that ROS 2 installation, or in the '
    '.venv that `make demo` sets up'
)


def package_missing(error: object) -> str:
    """The package, not one of ours, that could not be imported; '' if that is not the error."""
    package = package_of(error) if isinstance(error, ImportError) else ''
    return '' if package == 'kinpole_ros' else package


def one_line(error: object) -> str:
    """What is wrong, with the fix, in one line that a terminal can show."""
    if package := package_missing(error):
        ros = package == 'rclpy' or package.endswith(('_msgs', '_interfaces'))
        if isinstance(error, ImportError) and (reason := broken_import(error)):
            fix = _BROKEN_ROS if ros else f'pip install --force-reinstall {package}'
            return f'{cut_line(printable(reason), _LONGEST_LINE)}; fix: {fix}'
        fix = _NO_ROS if ros else f'install it with pip install {package}'
        return _FIXES.get(package, f'the Python package {package} cannot be imported; {fix}')
    text = cut_line(printable(' '.join(str(error).split())), _LONGEST_LINE)
    if isinstance(error, OSError) and error.strerror:
        # From wherever nobody had words of his own for it.
        fix = 'check the path, its rights and the space on the disk'
        return f'{error.filename or "a file"} cannot be used: {error.strerror}; fix: {fix}'
    if isinstance(error, MemoryError):
        return f'the memory is too small for this ({text or "full"}); fix: do it in shorter parts'
    return text


def reported(command: str, troubles: list[object]) -> int:
    """Tell what a bag lacks of which all the rest was used; the exit status."""
    for trouble in troubles:
        print(f'kinpole {command}: {one_line(trouble)}', file=sys.stderr)
    return 2 if troubles else 0


def on_terminal() -> bool:
    """Whether somebody watches stderr, which may be closed."""
    return sys.stderr is not None and sys.stderr.isatty()


def settings_of(options: argparse.Namespace) -> 'Settings':
    """Those of --config, or the defaults, with what --set says instead."""
    from kinpole_ros.tracking.parameters import assignments, load_settings, settings_from

    changes = assignments(options.set)
    if options.config:
        return load_settings(options.config, changes=changes)
    return settings_from(changes)


def check_outputs(inputs: Iterable[str | None], outputs: Iterable[str | None]) -> None:
    """
    Refuse outputs that would lose something, before anything is read or written.

    An output must not be one of the files that are read, by whatever name, nor that of another
    output, nor a recording, which cannot be made again. Inputs and outputs that are None or '' are
    not there; an input that is a folder is a bag, and names that are no files are passed over.

    Raises FileExistsError for the first output that must not be written.
    """
    taken: dict[object, tuple[str, str]] = {}
    for path in filter(None, inputs):
        for file in _files_of(path):
            taken[_identity(file)] = file, 'is to be read'
    for output in filter(None, outputs):
        if os.path.exists(output) and not os.path.isfile(output):
            continue  # a folder is refused where it is opened; what a device is given is no file
        identity = _identity(output)
        if identity in taken:
            other, use = taken[identity]
            also = '' if other == output else f'is the same file as {other}, which '
            raise FileExistsError(f'{output} {also}{use}; name another file to write')
        taken[identity] = output, 'is to be written too'
        if os.path.isfile(output) and (recorder := _recorder_of(output)):
            raise FileExistsError(
                f'{output} is a recording, made by {recorder!r}; name another file to write, or '
                'remove that one first'
            )


def check_ending(option: str, output: str | None, kind: str) -> None:
    """
    Refuse to write a file under a name that says that it is of another kind.

    Parameters
    ----------
    option : str
        The option that names the file, as '--csv'.
    output : str or None
        The file; None if it is not asked for.
    kind : str
        What is written: a key of `_ENDINGS`. Those of `_STRICT` need one of their endings; the
        others may have any ending that is not another kind's.

    Raises
    ------
    UsageError
        With the ending to use.
    """
    ending = os.path.splitext(output or '')[1].lower()
    own = _ENDINGS[kind]
    others = {other for endings in _ENDINGS.values() for other in endings}
    if output is None or ending in own or (kind not in _STRICT and ending not in others):
        return
    raise UsageError(f'{option} {output}: the output is {kind}; end its name in {" or ".join(own)}')


def _files_of(path: str) -> list[str]:
    """The files that are read where this path, of a file or of the folder of a bag, is named."""
    if not os.path.isdir(path):
        return [path] if os.path.isfile(path) else []
    from kinpole_ros.bags import BagError, bag_files

    with suppress(BagError):  # it is refused where it is read
        return [os.path.join(path, 'metadata.yaml'), *map(str, bag_files(path))]
    return []


def _identity(path: str) -> object:
    """What two names of one file have in common, whether it is there or not."""
    with suppress(OSError):
        found = os.stat(path)
        return found.st_dev, found.st_ino
    return os.path.realpath(path)


def _recorder_of(path: str) -> str:
    with suppress(ImportError):  # solve does without mcap
        from kinpole_ros.bags import recorder_of

        return recorder_of(path)
    return ''


@contextmanager
def progress_bar(what: str) -> 'Iterator[Callable[[float], None] | None]':
    """A bar on a terminal, nothing in a pipe."""
    if not on_terminal():
        yield None
        return
    start = shown = time.monotonic()

    def show(share: float) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown < 0.1 and share < 1:
            return
        shown = now
        left = (now - start) * (1 - share) / share if share > 0.01 else float('nan')
        bar = '#' * round(30 * share)
        tail = f'{left:4.0f} s left' if left == left else ''
        text = f'{what} [{bar:<30}] {share:4.0%} {tail:12}'[: _width()]
        print(f'\r{text}', end='', file=sys.stderr, flush=True)

    try:
        yield show
    finally:
        print(cleared(), end='', file=sys.stderr, flush=True)


def _width() -> int:
    """Columns of a line of progress: one that wraps is not gone back over."""
    return min(70, shutil.get_terminal_size().columns - 1)


def cleared() -> str:
    """What takes a bar of progress away."""
    return f'\r{"":{_width()}}\r'


def add_set(command: argparse.ArgumentParser) -> None:
    """--set, for what takes --config."""
    command.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME:=VALUE',
        help='a parameter instead of what the file says, as ros2 run takes it after -p; repeatable',
    )
