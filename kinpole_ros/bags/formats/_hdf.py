"""HDF5 files of strangers: opened so that all that is read lies in the file and fits in memory."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._file import File
from kinpole_ros.bags.formats._sheet import shown
from kinpole_ros.packages import install_command

HDF = b'\x89HDF\r\n\x1a\n'
_CHUNK = 32 << 20  # bytes that one chunk may unpack to; those of PyTables have some 100 kB


def open_hdf(file: File) -> Any:
    """Open the file by h5py; raises BagError where that is not installed."""
    try:
        import h5py
    except ImportError:
        raise BagError(
            f'{file.path} is HDF5, which needs h5py; fix: {install_command("formats")}, or give '
            'the .csv'
        ) from None
    return h5py.File(io.BytesIO(file.data), 'r')


@contextmanager
def errors_of_hdf(file: File, program: str, fix: str) -> Iterator[None]:
    """Turn what h5py and pickle raise, which depends on the byte that is wrong, into BagError."""
    try:
        yield
    except BagError:
        raise
    except Exception as error:
        raise BagError(f'{file.path} is not an .h5 of {program}; fix: {fix}') from error


def own_item(file: File, group: Any, name: str, fix: str) -> Any:
    """
    Return a group or dataset of a group, whose bytes are in that file.

    Raises BagError for links and storage that lead to other files, and where a row or a chunk alone
    unpacks to more than `_CHUNK`.
    """
    import h5py

    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise BagError(f"{file.path}: '{shown(name)}' is a link; fix: {fix}")
    item = group[name]
    if not isinstance(item, h5py.Dataset):
        return item
    if item.external or item.is_virtual:
        raise BagError(f"{file.path}: the rows of '{shown(name)}' are elsewhere; fix: {fix}")
    # HDF5 unpacks one chunk as a whole.
    count = 1
    for length in item.chunks or ():
        count *= length
    if count * item.dtype.itemsize > _CHUNK:
        raise BagError(
            f'{file.path}: a chunk of {(item.chunks or [1])[0]} rows is more than '
            f'{_CHUNK >> 20} MiB; fix: {fix}'
        )
    return item
