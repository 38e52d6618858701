"""HDF5 files of strangers: all that is read of one lies in the file and fits in memory."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._cells import MOST_COLUMNS, listed, shown
from kinpole_ros.bags.formats._file import File
from kinpole_ros.packages import install_command

HDF_MAGIC = b'\x89HDF\r\n\x1a\n'
MOST_NAME_BYTES = 1 << 20  # of all names in a file
_CHUNK_BYTES = 32 << 20  # that one chunk may unpack to; those of PyTables have some 100 kB


@contextmanager
def opened_hdf(file: File, program: str, fix: str) -> Iterator[Any]:
    """Open the file by h5py; what h5py and pickle raise for wrong bytes becomes a BagError."""
    try:
        import h5py
    except ImportError:
        raise BagError(
            f'{file.path} is HDF5, which needs h5py; fix: {install_command("formats")}, or give '
            'the .csv'
        ) from None
    try:
        yield h5py.File(io.BytesIO(file.data), 'r')
    except BagError:
        raise
    except Exception as error:
        raise BagError(f'{file.path} is not an .h5 of {program}; fix: {fix}') from error


def hdf_item(file: File, group: Any, name: str, fix: str) -> Any:
    """
    Return a group or dataset of a group, whose bytes are in that file.

    Raises BagError for links and storage that lead to other files, and where a row or a chunk alone
    unpacks to more than `_CHUNK_BYTES`.
    """
    import h5py

    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise BagError(f"{file.path}: '{shown(name)}' is a link; fix: {fix}")
    item = group[name]
    if not isinstance(item, h5py.Dataset):
        return item
    if item.external or item.is_virtual:
        raise BagError(f"{file.path}: the rows of '{shown(name)}' are elsewhere; fix: {fix}")
    # HDF5 unpacks one chunk at a time. Python integers, since the product may be large.
    size = item.dtype.itemsize
    for length in item.chunks or ():
        size *= length
    if size > _CHUNK_BYTES:
        raise BagError(
            f'{file.path}: a chunk of {(item.chunks or [1])[0]} rows is more than '
            f'{_CHUNK_BYTES >> 20} MiB; fix: {fix}'
        )
    return item


def hdf_texts(file: File, content: Any, name: str, fix: str) -> list[str]:
    """Read a dataset of names; raises ValueError for what is none, or too long."""
    item = hdf_item(file, content, name, fix)
    if item.size > MOST_COLUMNS or item.dtype.itemsize * item.size > MOST_NAME_BYTES:
        raise ValueError('names that are not')
    texts, size = [], 0
    for number in range(item.size):
        text = item[number]
        texts.append(text.decode() if isinstance(text, bytes) else str(text))
        # Texts of any length may all be one in the file.
        size += len(texts[-1])
        if size > MOST_NAME_BYTES:
            raise ValueError('names that are not')
    return texts


def unknown_hdf(file: File, content: Any) -> BagError:
    """Return the error of an HDF5 file of none of the programs that are known: what it holds."""
    names = sorted(map(shown, content))
    if {'frames', 'instances', 'metadata'} <= set(names):
        return BagError(
            f'{file.path} is a project of SLEAP (.slp); fix: export an analysis .h5 or .csv from it'
        )
    return BagError(
        f'{file.path} is HDF5 of no program that is known here, with '
        f'{listed(names) or "nothing"} in it; fix: export the points as .csv'
    )


def no_scores(file: File, name: str = 'scores') -> BagError:
    return BagError(f'{file.path} has no {name} of points; fix: leave that option out')
