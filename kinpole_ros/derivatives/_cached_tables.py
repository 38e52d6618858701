"""
Tables of _models.py in files: a table takes 8 to 300 ms to make, and 0.2 ms to read.

The folder is $KINPOLE_CACHE, else kinpole_ros in $XDG_CACHE_HOME or ~/.cache. With an empty
KINPOLE_CACHE nothing is read or written. A file counts if its first line says that the same code on
the same kind of processor made it, and its checksum is right: a table has the same bits as if made
anew. A failure to read or write is no error, since a table can be made.
"""

import os
import threading
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np

from kinpole_ros import __version__
from kinpole_ros.core.bindings import SIZES
from kinpole_ros.derivatives import _models
from kinpole_ros.planar._plane import Real

# Bytes of all files, of which the oldest are removed; a kind of window has 100 kB to 3 MB.
_MAX_FILE_BYTES = 64_000_000

Arrays = tuple[np.ndarray, Real]


def cached_table(kind: tuple[float, ...], make: Callable[[], Arrays]) -> Arrays:
    """Return the integers and numbers that `make` makes of a table, from its file if possible."""
    folder = _folder()
    if folder is None or not _maker():
        return make()
    first_line = f'{_maker()} {" ".join(float(number).hex() for number in kind)}\n'.encode()
    path = folder / f'{zlib.crc32(first_line):08x}.table'
    with suppress(OSError):
        if (arrays := _unpack(path.read_bytes(), first_line)) is not None:
            return arrays
    arrays = make()
    with suppress(OSError):
        _write(path, _pack(arrays, first_line))
    return arrays


def _folder() -> Path | None:
    """Return the folder of the files, or None for no files."""
    if (own := os.environ.get('KINPOLE_CACHE')) is not None:
        return Path(own) if own else None
    for caches in (os.environ.get('XDG_CACHE_HOME', ''), os.path.expanduser('~/.cache')):
        if os.path.isabs(caches):
            return Path(caches, 'kinpole_ros')
    return None


@cache
def _maker() -> str:
    """
    Return what tells apart programs and processors that make other bits of the same table.

    The operations that tables are made by have other roundings with other versions of their
    libraries and on other processors, so a small example of each is made. It is empty where the
    package is installed without its source.
    """
    try:
        source = Path(_models.__file__).read_bytes()
    except OSError:
        return ''
    waves = np.cos(np.outer(np.arange(1.0, 33.0), np.arange(1.0, 49.0)))
    waves *= np.exp(-np.arange(48.0) / 9)
    results = waves, waves @ waves.T, *np.linalg.svd(waves), *np.linalg.qr(waves)
    bits = b''.join(result.tobytes() for result in results)
    numbers = (zlib.crc32(part) for part in (source, repr(SIZES).encode(), bits))
    return ' '.join((__version__, np.__version__, *(f'{number:08x}' for number in numbers)))


def _pack(arrays: Arrays, first_line: bytes) -> bytes:
    """Return the content of a file: the line, checksum, number of integers, integers, numbers."""
    content = b''.join((np.int64(arrays[0].size).tobytes(), *(one.tobytes() for one in arrays)))
    return b''.join((first_line, np.int64(zlib.crc32(content)).tobytes(), content))


def _unpack(packed: bytes, first_line: bytes) -> Arrays | None:
    """Return the arrays in a file, or None if it is not what `_pack` makes with this line."""
    line, words = packed[: len(first_line)], packed[len(first_line) :]
    if line != first_line or len(words) < 16 or len(words) % 8:
        return None
    checksum, count = np.frombuffer(words, np.int64, 2).tolist()
    if checksum != zlib.crc32(memoryview(words)[8:]) or not 0 <= count <= len(words) // 8 - 2:
        return None
    integers = np.frombuffer(words, np.int64, count, 16)
    return integers, np.frombuffer(words, np.float64, -1, 16 + integers.nbytes)


def _write(path: Path, packed: bytes) -> None:
    """Write a file, which replaces another one when complete, and remove the oldest ones."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # An unfinished file is among them: the process that began it may have been killed.
    files = [(one.stat().st_mtime_ns, one) for one in path.parent.glob('*.table*')]
    excess = sum(one.stat().st_size for _, one in files) + len(packed) - _MAX_FILE_BYTES
    for _, oldest in sorted(files):
        if excess <= 0:
            break
        excess -= oldest.stat().st_size
        oldest.unlink()
    part = path.with_name(f'{path.name}.{os.getpid()}.{threading.get_ident()}.part')
    try:
        part.write_bytes(packed)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
