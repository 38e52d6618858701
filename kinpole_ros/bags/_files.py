"""The files of a bag, and their bytes, unpacked where a file is compressed as a whole.

A file compressed by zstd is read as a stream, so that it takes neither disk nor memory, whatever
it claims to hold.
"""

import errno
import io
import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePath
from typing import BinaryIO, cast

import yaml
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.records import Header

from kinpole_ros.files import cut, cut_line, open_regular, printable, read_limited, whole_file
from kinpole_ros.files.bounded_yaml import MOST_YAML, load_yaml

LIBRARY = 'kinpole_ros'  # named in bags that can be made again
RECORDER = 'kinpole record'  # named in recordings, which cannot
# mcap.writer has it too, and takes longer to import than the rest of mcap.
MCAP_MAGIC = b'\x89MCAP0\r\n'
ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # no CDR starts with it
SQLITE_MAGIC = b'SQLite f'
ROS1_MAGIC = b'#ROSBAG '
_HEADER_BYTES = 1000  # of the first record
_FARTHEST = 2**62  # bytes: beyond the end of any file
_UNPACKED_BYTES = 1 << 20  # at a time
# What YAML and records of another form raise.
_MALFORMED = (ValueError, LookupError, TypeError, AttributeError)
# Endings of files that `kinpole import` reads.
_POINTS = (
    *('.csv', '.tsv', '.txt', '.trc', '.c3d', '.h5', '.nc', '.nwb', '.slp'),
    *('.xml', '.trk', '.json'),
)
_IMPORT = 'fix: make a bag of it by `kinpole import {} --output {}`'
CONVERT = 'fix: `rosbags-convert --src {} --dst NEW --dst-storage mcap` (pip install rosbags)'


class BagError(Exception):
    """A bag or table that cannot be read or written: one line that names it and the fix."""


class Truncated(BagError):
    """A bag that is cut off, damaged or lacks messages; its other messages were read."""


def bag_files(path: str | Path) -> list[Path]:
    """
    Return the files of a bag, in order.

    Parameters
    ----------
    path : str or Path
        An .mcap or .db3 file or a rosbag2 folder, whose metadata.yaml names the files. A folder
        without one has all its .mcap files, or all .db3 files, plain or compressed, by name;
        numbers in names count as numbers.

    Returns
    -------
    list of Path

    Raises
    ------
    BagError
        If there is no bag, or it is in another storage.

    """
    path = Path(path)
    with read_errors(path):
        if path.is_dir():
            files = _folder_files(path)
        elif path.is_file():
            files = [path]
        elif path.exists():
            raise BagError(
                f'{path} is neither a file nor a folder, and a bag is not read from front to back; '
                'fix: save what it gives as a file'
            )
        else:
            raise BagError(f'no such file or folder: {path}; fix: see to the path')
        # A recorder that was killed leaves empty files among others.
        check_magic(next((file for file in files if file.stat().st_size), files[0]))
    return files


def _folder_files(folder: Path) -> list[Path]:
    metadata = folder / 'metadata.yaml'
    if not os.path.lexists(metadata):
        found: set[str] = set()
        for ending in ('*.mcap', '*.db3'):
            plain = {file.name for file in folder.glob(ending)}
            # A file is there as both if its recorder died while it compressed it.
            packed = {file.name for file in folder.glob(f'{ending}.zstd')}
            packed = {name for name in packed if name.removesuffix('.zstd') not in plain}
            found = found or plain | packed
        if not found:
            raise BagError(
                f'{folder} has neither metadata.yaml nor .mcap or .db3 files; '
                'fix: give an .mcap file or a rosbag2 folder'
            )
        return _checked_files(folder, sorted(found, key=_by_number))
    _checked_files(folder, [metadata.name])
    try:
        content = load_yaml(read_limited(metadata, MOST_YAML))
        about = content['rosbag2_bagfile_information']
        storage, names = about['storage_identifier'], about['relative_file_paths']
        compression = about.get('compression_format')
        if isinstance(names, str) or not all(isinstance(name, str) for name in names):
            raise TypeError('no list of files')
    except (yaml.YAMLError, *_MALFORMED) as error:
        reason = ''
        if isinstance(error, yaml.YAMLError):
            reason = f' ({cut_line(" ".join(str(error).split()), 300)})'
        raise BagError(
            f'{metadata} is not the metadata of a rosbag2 bag{printable(reason)}; '
            f'fix: `ros2 bag reindex {folder}`, or remove it to read all .mcap files there'
        ) from error
    if compression not in (None, '', 'zstd'):
        storage = f'compressed by rosbag2 ({cut(str(compression))})'
        raise BagError(f'{folder} is a bag {storage}; {CONVERT.format(folder)}')
    if storage not in ('mcap', 'sqlite3'):
        raise BagError(f'{folder} is a bag in {cut(str(storage))}; {CONVERT.format(folder)}')
    if not names:
        raise BagError(f'{metadata} names no files; fix: `ros2 bag reindex {folder}`')
    return _checked_files(folder, names)


def _checked_files(folder: Path, names: list[str]) -> list[Path]:
    """
    Return the paths of the named files of a bag's folder.

    Raises BagError for a name that is no regular file, repeated, or outside of the folder: a bag
    from a stranger must not block us, nor read other files of this machine.
    """
    names_by_id: dict[tuple[int, int], str] = {}
    for name in names:
        path, shown, is_valid = folder / name, folder / cut(name), '\0' not in name
        is_outside = PurePath(name).is_absolute() or '..' in PurePath(name).parts
        if is_outside or (is_valid and not path.resolve().is_relative_to(folder.resolve())):
            raise BagError(
                f'{shown} is outside of the folder; fix: have all files of a bag in its folder, '
                'and no links to others'
            )
        if not is_valid or not path.exists():
            raise BagError(
                f'{shown}, named by metadata.yaml, is not there; fix: put it back, or '
                '`ros2 bag reindex`'
            )
        if not path.is_file():
            raise BagError(
                f'{shown} is not a regular file; fix: take it out of the folder, or save what it '
                'gives as a file'
            )
        about = path.stat()
        file_id = about.st_dev, about.st_ino
        if file_id in names_by_id:
            raise BagError(
                f"{shown} is the same file as '{cut(names_by_id[file_id])}'; fix: have and name "
                'each file once'
            )
        names_by_id[file_id] = name
    return [folder / name for name in names]


def _by_number(name: str) -> list[int | str]:
    return [int(s) if s.isdecimal() else s for s in re.split(r'(\d+)', name)]


def check_magic(path: Path) -> None:
    """Raise BagError where a file does not begin as an MCAP or SQLite file does."""
    with open_regular(path) as file:
        magic = file.read(len(MCAP_MAGIC))
    if not magic:
        raise Truncated(f'{path} is empty (0 bytes); fix: record again')
    if magic == SQLITE_MAGIC:
        return
    if magic == ROS1_MAGIC:
        raise BagError(f'{path} is a ROS 1 bag; {_IMPORT.format(path, path.with_suffix(".mcap"))}')
    if magic.startswith(ZSTD_MAGIC):
        with open_file(path) as unpacked:
            if unpacked.read(len(MCAP_MAGIC)) in (MCAP_MAGIC, SQLITE_MAGIC):
                return
        raise BagError(
            f'{path} is compressed, and what is in it is not an MCAP or SQLite file; '
            f'fix: see what `zstd -d {path}` gives'
        )
    if not MCAP_MAGIC.startswith(magic):
        if path.suffix.lower() in _POINTS:
            raise BagError(
                f'{path} is a file of points, not a bag; '
                f'{_IMPORT.format(path, path.with_suffix(".mcap"))}'
            )
        raise BagError(
            f'{path} is not an MCAP file: it starts otherwise; '
            'fix: give an .mcap file or a rosbag2 folder'
        )


def recorder_of(path: str | Path) -> str:
    """
    Return the program that recorded a bag.

    Parameters
    ----------
    path : str or Path
        An .mcap file.

    Returns
    -------
    str
        The name in its header; '' if there is none, or the bag is one that we can make again.

    """
    path = Path(path)
    with suppress(OSError, *_MALFORMED, struct.error, EndOfFile):
        if path.is_file():
            with open_file(path) as file:
                if file.read(len(MCAP_MAGIC)) == MCAP_MAGIC:
                    head = file.read(_HEADER_BYTES)
                    length = int.from_bytes(head[1:9], 'little')
                    library = Header.read(ReadDataStream(io.BytesIO(head[9 : 9 + length]))).library
                    return '' if library == LIBRARY else library or 'another program'
    return ''


@contextmanager
def read_errors(path: Path) -> Iterator[None]:
    """Turn OSError into the BagError of a file that cannot be read."""
    try:
        yield
    except OSError as error:
        fix = 'cut it into parts' if error.errno == errno.EFBIG else 'check the path and its rights'
        raise BagError(
            f'{error.filename or path} cannot be read: {error.strerror}; fix: {fix}'
        ) from error


@contextmanager
def write_errors(path: str | Path) -> Iterator[None]:
    """Turn OSError into the BagError of a file that cannot be written."""
    try:
        yield
    except OSError as error:
        raise BagError(
            f'{path} cannot be written: {error.strerror or error}; '
            'fix: check the path, its rights and the space on the disk'
        ) from error


@contextmanager
def in_place_of(path: str | Path) -> Iterator[Path]:
    """
    Give a path to write a file to, which replaces another one when the block ends.

    Parameters
    ----------
    path : str or Path
        The file to be replaced, as for `files.whole_file`.

    Yields
    ------
    Path

    Raises
    ------
    BagError
        If it cannot be written.

    """
    with write_errors(path), whole_file(path) as part:
        yield part


def open_file(path: Path) -> BinaryIO:
    """Open a file of a bag, or the content of one that rosbag2 compressed as a whole."""
    file = open_regular(path)
    is_packed = file.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
    file.seek(0)
    if not is_packed:
        return file
    return cast('BinaryIO', io.BufferedReader(Unpacked(file), _UNPACKED_BYTES))


class Unpacked(io.RawIOBase):
    """The content of a file compressed by zstd; to seek backward reads it from the start.

    It ends where zstd cannot go on, and `trouble` says why.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.name = file.name
        self.trouble = ''
        self._file = file
        self._restart()

    def _restart(self) -> None:
        self._file.seek(0)
        # rosbag2 writes one frame, other tools several.
        self._content = zstandard.ZstdDecompressor().stream_reader(
            self._file, read_across_frames=True, closefd=False
        )
        self._offset = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def readinto(self, buffer: 'bytearray | memoryview[int]') -> int:  # type: ignore[override]
        try:
            count = self._content.readinto(buffer)
        except zstandard.ZstdError as error:
            self.trouble = str(error)
            return 0
        self._offset += count
        return int(count)

    def tell(self) -> int:
        return self._offset

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        if whence == io.SEEK_END:
            offset = _FARTHEST
        if offset < self._offset:
            self._restart()
        skipped = memoryview(bytearray(min(_UNPACKED_BYTES, offset - self._offset)))
        while self._offset < offset and self.readinto(skipped[: offset - self._offset]):
            pass
        return self._offset

    def close(self) -> None:
        self._file.close()
        super().close()
