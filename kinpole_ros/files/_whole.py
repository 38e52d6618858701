"""Results are whole or not there: written beside what they replace, and named at the end."""

import glob
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from kinpole_ros.files._lock import lock

_LONGEST = 200  # bytes of a name, which may have 255 with what is added
# There a locked file cannot be written by who opens it again, and an open one not be removed.
_WINDOWS = os.name == 'nt'


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """
    A place to write what is to become the file `path`, which stays as it is until the block ends.

    Folders above it are made. Where the block fails nothing is left. A process that is killed
    leaves what it wrote as `NAME.….part`, which the next that is to write `path` removes. What is
    no regular file, as /dev/stdout, is written as it goes. Raises OSError where `path` cannot be
    written, at the beginning where that can be told.
    """
    # A link stays one, and what it leads to is replaced.
    target = Path(os.path.realpath(path))
    target.parent.mkdir(parents=True, exist_ok=True)
    mode = None
    if target.exists():
        about = target.stat()
        if not stat.S_ISREG(about.st_mode) and not stat.S_ISDIR(about.st_mode):
            yield Path(path)
            return
        # One that is not to be written must not be replaced either.
        open(target, 'ab').close()
        mode = stat.S_IMODE(about.st_mode)
    part, held = _begin(target)
    try:
        with held:
            if mode is not None:
                part.chmod(mode)
            yield part
            # Else a power cut may leave the new name without the content.
            os.fsync(held.fileno())
            if not _WINDOWS:
                part.replace(target)
        if _WINDOWS:
            part.replace(target)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _begin(target: Path) -> tuple[Path, BinaryIO]:
    """A new file beside `target`, ours as long as it is open; what the dead left is removed."""
    short = os.fsdecode(os.fsencode(target.name)[:_LONGEST])
    for left in target.parent.glob(f'{glob.escape(short)}.{"[0-9a-f]" * 8}.part'):
        with suppress(OSError):
            if _WINDOWS:
                left.unlink()
                continue
            with open(left, 'r+b') as theirs:
                if lock(theirs, wait=False):
                    left.unlink()
    while True:
        # A name of its own, for another process may be at the same result.
        part = target.with_name(f'{short}.{secrets.token_hex(4)}.part')
        held = open(part, 'xb')  # noqa: SIM115 - whoever asks for it closes it
        with suppress(BlockingIOError):
            if not _WINDOWS:
                lock(held, wait=False)
            # Else somebody took it for one that was left.
            if os.fstat(held.fileno()).st_nlink:
                return part, held
        held.close()
