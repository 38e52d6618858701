"""Files that replace earlier ones when they are complete, and locks."""

import glob
import os
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import IO, Any, BinaryIO

_fcntl: Any
_msvcrt: Any
try:
    _fcntl, _msvcrt = import_module('fcntl'), None
except ImportError:
    _fcntl, _msvcrt = None, import_module('msvcrt')
_RETRY_INTERVAL = 0.1  # s; Windows cannot wait for a lock without end
_LONGEST_NAME = 200  # bytes; 255 are allowed with what is appended
# There a locked file cannot be opened again for writing, and an open one cannot be removed.
_WINDOWS = os.name == 'nt'
_FORMULA = ('=', '+', '-', '@', '\t', '\r')


def lock(file: IO[Any], wait: bool) -> bool:
    """
    Lock an open file until it is closed, and return whether it is locked.

    On a file system without locks nothing is. Raises BlockingIOError if another process has locked
    it, and this one is not to `wait`.
    """
    while True:
        try:
            if _fcntl is not None:
                _fcntl.flock(file, _fcntl.LOCK_EX | (0 if wait else _fcntl.LOCK_NB))
            else:
                _msvcrt.locking(file.fileno(), _msvcrt.LK_NBLCK, 1)
        except BlockingIOError:
            raise
        except PermissionError:
            # msvcrt raises it where another process has the lock.
            if _fcntl is not None:
                return False
            if not wait:
                raise BlockingIOError from None
            time.sleep(_RETRY_INTERVAL)
            continue
        except OSError:
            return False
        return True


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """
    Give a path to write a file to, which replaces another one when the block ends.

    Where the block fails, nothing changes. A process that is killed leaves `NAME.….part`, which the
    next one that writes the file removes. Folders above it are made. One that is no regular file,
    as /dev/stdout, is written directly. Raises OSError if it cannot be written, at the beginning
    where that can be known.
    """
    # The target of a link is replaced, not the link.
    target = Path(os.path.realpath(path))
    target.parent.mkdir(parents=True, exist_ok=True)
    mode = None
    if target.exists():
        about = target.stat()
        if not stat.S_ISREG(about.st_mode) and not stat.S_ISDIR(about.st_mode):
            yield Path(path)
            return
        # A file without the right to be written must not be replaced either.
        open(target, 'ab').close()
        mode = stat.S_IMODE(about.st_mode)
    part, part_file = _open_part(target)
    try:
        with part_file:
            if mode is not None:
                part.chmod(mode)
            yield part
            # Else a power cut may leave the new name without the content.
            os.fsync(part_file.fileno())
            if not _WINDOWS:
                part.replace(target)
        if _WINDOWS:
            part.replace(target)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _open_part(target: Path) -> tuple[Path, BinaryIO]:
    """Open a new file next to `target`, locked while open; remove those of killed processes."""
    name = os.fsdecode(os.fsencode(target.name)[:_LONGEST_NAME])
    for unfinished in target.parent.glob(f'{glob.escape(name)}.{"[0-9a-f]" * 8}.part'):
        with suppress(OSError):
            if _WINDOWS:
                unfinished.unlink()
                continue
            with open(unfinished, 'r+b') as file:
                if lock(file, wait=False):
                    unfinished.unlink()
    while True:
        # Its name is its own, for another process may write the same result.
        part = target.with_name(f'{name}.{os.urandom(4).hex()}.part')
        part_file = open(part, 'xb')  # noqa: SIM115 - the caller closes it
        with suppress(BlockingIOError):
            if not _WINDOWS:
                lock(part_file, wait=False)
            # Else another process took it for that of a killed one.
            if os.fstat(part_file.fileno()).st_nlink:
                return part, part_file
        part_file.close()


def as_cell(value: Any) -> Any:
    """Return a value for a CSV table, with ' before a text that a spreadsheet would run."""
    if not isinstance(value, str) or not value.startswith(_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value
