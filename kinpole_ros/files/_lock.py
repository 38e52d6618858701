"""A lock on an open file, on any system: fcntl's, or msvcrt's on Windows."""

import time
from importlib import import_module
from typing import IO, Any

_fcntl: Any
_msvcrt: Any
try:
    _fcntl, _msvcrt = import_module('fcntl'), None
except ImportError:
    _fcntl, _msvcrt = None, import_module('msvcrt')
# Windows has no lock to wait for without end, so it is asked for again.
_AGAIN = 0.1


def lock(file: IO[Any], wait: bool) -> bool:
    """
    Lock a file until it is closed; raises BlockingIOError if another has it and not to `wait`.

    Returns whether it is locked: on a file system without locks nothing is.
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
            # As msvcrt says that another has it.
            if _fcntl is not None:
                return False
            if not wait:
                raise BlockingIOError from None
            time.sleep(_AGAIN)
            continue
        except OSError:
            return False
        return True
