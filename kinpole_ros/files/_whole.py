"""Results are whole or not there: written beside what they replace, and named at the end."""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_LONGEST = 200  # bytes of a name, which may have 255 with what is added


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """
    A place to write what is to become the file `path`, which stays as it is until the block ends.

    Folders above it are made. Where the block fails nothing is left. A process that is killed
    leaves what it wrote as `NAME.….part`. What is no regular file, as /dev/stdout, is written as it
    goes. Raises OSError where `path` cannot be written, at the beginning where that can be told.
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
    short = os.fsdecode(os.fsencode(target.name)[:_LONGEST])
    # A name of its own, for another process may be at the same result.
    part = target.with_name(f'{short}.{secrets.token_hex(4)}.part')
    open(part, 'xb').close()
    try:
        if mode is not None:
            part.chmod(mode)
        yield part
        with open(part, 'rb') as file:
            # Else a power cut may leave the new name without the content.
            os.fsync(file.fileno())
        part.replace(target)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
