"""
Files of strangers, read and shown such that none can block, fill or confuse a program.

Only regular files are opened: a FIFO or a device would keep a program waiting, or never end. All
faults are an OSError, as of `open`. Texts are shown in one short line without control characters.
"""

import errno
import os
import stat
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import BinaryIO

_MOST_SHOWN = 80  # characters of a value or name
MOST_OF_A_LINE = 1000  # characters: some lines of a terminal


def open_regular(path: str | Path) -> BinaryIO:
    """Open a regular file for reading; raises OSError, also for a path that is none."""
    # A device may do something when it is opened.
    _check(os.stat(path), path)
    file = open(path, 'rb', opener=_open_without_waiting)  # noqa: SIM115 - the caller closes it
    try:
        _check(os.fstat(file.fileno()), path)
    except OSError:
        file.close()
        raise
    return file


def _open_without_waiting(path: str, flags: int) -> int:
    # The file may have been exchanged for a FIFO after the check.
    return os.open(path, flags | getattr(os, 'O_NONBLOCK', 0))


def _check(about: os.stat_result, path: str | Path) -> None:
    if stat.S_ISDIR(about.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(about.st_mode):
        raise OSError(errno.EINVAL, 'it is not a regular file', str(path))


def read_limited(path: str | Path, most: int) -> bytes:
    """Read a regular file of at most so many bytes; raises OSError, also for a larger one."""
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(
            errno.EFBIG, f'it is larger than {most >> 20} MiB, as none need be', str(path)
        )
    return content


def cut(text: str, most: int = _MOST_SHOWN) -> str:
    """Return the beginning of a text, in Python's notation where it has control characters."""
    short = text[: most + 1]
    short = short if short.isprintable() else repr(short)
    return short if len(short) <= most else f'{short[:most]}...'


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return 'did you mean X? ' for the name that is nearest, '' if none is near."""
    closest = get_close_matches(name, list(names), n=1, cutoff=0.7)
    return f'did you mean {closest[0]}? ' if closest else ''


def printable(line: str) -> str:
    """Return a line with the number of each control character in its place, as ascii() has it."""
    if line.isprintable():
        return line
    return ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


def cut_line(line: str, most: int = MOST_OF_A_LINE) -> str:
    """Return a line without its middle, where it is too long."""
    return line if len(line) <= most else f'{line[: most // 2]} ... {line[-most // 2 :]}'
