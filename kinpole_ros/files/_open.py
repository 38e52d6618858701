"""
Only regular files are opened: a FIFO or a device would keep a program waiting, or never end.

All that is wrong is an OSError, as of `open`.
"""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO


def open_regular(path: str | Path) -> BinaryIO:
    """A file to read, in binary; raises OSError, also for what is no regular file."""
    # A device may do something when it is opened.
    _check(os.stat(path), path)
    file = open(path, 'rb', opener=_not_waiting)  # noqa: SIM115 - whoever asks for it closes it
    try:
        _check(os.fstat(file.fileno()), path)
    except OSError:
        file.close()
        raise
    return file


def _not_waiting(path: str, flags: int) -> int:
    # Should the file be exchanged for a FIFO after it was looked at.
    return os.open(path, flags | getattr(os, 'O_NONBLOCK', 0))


def read_limited(path: str | Path, most: int) -> bytes:
    """What is in a regular file; raises OSError, also where it is more than `most` bytes."""
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(
            errno.EFBIG, f'it is larger than {most >> 20} MiB, as none need be', str(path)
        )
    return content


def _check(about: os.stat_result, path: str | Path) -> None:
    if stat.S_ISDIR(about.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(about.st_mode):
        raise OSError(errno.EINVAL, 'it is not a regular file', str(path))
