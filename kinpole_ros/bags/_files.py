"""Which files make up a bag, and their bytes, unpacked where they are compressed as a whole.

A file compressed by zstd is read forward as a stream and unpacked to nowhere, so that it takes
neither disk nor memory, whatever it claims to hold.
"""

import io
import os
import re
import struct
from contextlib import suppress
from pathlib import Path, PurePath
from typing import BinaryIO, cast

import yaml
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.records import Header
from mcap.writer import MCAP0_MAGIC

from kinpole_ros.files import cut, cut_line, open_regular, printable, read_limited
from kinpole_ros.files.bounded_yaml import MOST_YAML, load_yaml

LIBRARY = 'kinpole_ros'  # who writes bags here that can be made again
RECORDER = 'kinpole record'  # and those that cannot
_HEADER = 1000  # bytes of the first record that are looked at
ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # no CDR starts with it
_FARTHEST = 2**62  # bytes: beyond the end of any file
_PIECE = 1 << 20  # bytes unpacked at a time
# Of YAML and of records: other things than expected.
_MALFORMED = (ValueError, LookupError, TypeError, AttributeError)
SQLITE_MAGIC = b'SQLite f'
ROS1_MAGIC = b'#ROSBAG '
# Endings of files that `kinpole import` reads.
_POINTS = ('.csv', '.tsv', '.txt', '.trc', '.c3d', '.h5', '.xml', '.trk', '.json')
_IMPORT = 'fix: make a bag of it by `kinpole import {} --output {}`'
_CONVERT = 'fix: `rosbags-convert --src {} --dst NEW --dst-storage mcap` (pip install rosbags)'


class BagError(ValueError):
    """A bag or table that cannot be read or written: one line that names it and the fix."""


class Truncated(BagError):
    """A bag that was cut, is damaged or lacks messages; the rest of it was handed out."""


def bag_files(path: str | Path) -> list[Path]:
    """The .mcap or .db3 files of a bag, in order.

    `path` is such a file or a rosbag2 folder, whose metadata.yaml names the files; without one, all
    .mcap files of the folder, or all .db3 files, by name, numbers in names counted as numbers.

    Raises BagError when there is no bag, or one in another storage.
    """
    path = Path(path)
    try:
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
            raise BagError(f'no such bag: {path}; fix: give an .mcap file or a rosbag2 folder')
        # A recorder that was killed leaves empty files among others.
        check_magic(next((file for file in files if file.stat().st_size), files[0]))
    except OSError as error:
        raise unreadable(path, error) from error
    return files


def _folder_files(folder: Path) -> list[Path]:
    metadata = folder / 'metadata.yaml'
    if not os.path.lexists(metadata):
        plain = {file.name for file in folder.glob('*.mcap')}
        plain = plain or {file.name for file in folder.glob('*.db3')}
        # What was being compressed when its recorder died is there as both.
        packed = {file.name for file in folder.glob('*.mcap.zstd')}
        names = plain | {name for name in packed if name.removesuffix('.zstd') not in plain}
        if not names:
            raise BagError(
                f'{folder} has neither metadata.yaml nor .mcap or .db3 files; '
                'fix: give an .mcap file or a rosbag2 folder'
            )
        return _inside(folder, sorted(names, key=_by_number))
    _inside(folder, [metadata.name])
    try:
        content = load_yaml(read_limited(metadata, MOST_YAML))
        about = content['rosbag2_bagfile_information']
        storage, listed = about['storage_identifier'], about['relative_file_paths']
        compressed = about.get('compression_format')
        if isinstance(listed, str) or not all(isinstance(name, str) for name in listed):
            raise TypeError('no list of files')
    except (yaml.YAMLError, *_MALFORMED) as error:
        known = isinstance(error, yaml.YAMLError)
        why = f' ({cut_line(" ".join(str(error).split()), 300)})' if known else ''
        raise BagError(
            f'{metadata} is not the metadata of a rosbag2 bag{printable(why)}; '
            f'fix: `ros2 bag reindex {folder}`, or remove it to read all .mcap files there'
        ) from error
    if storage not in ('mcap', 'sqlite3') or compressed not in (None, '', 'zstd'):
        wrong = f'in {cut(str(storage))}'
        if compressed:
            wrong = f'compressed by rosbag2 ({cut(str(compressed))})'
        raise BagError(f'{folder} is a bag {wrong}; {_CONVERT.format(folder)}')
    if not listed:
        raise BagError(f'{metadata} names no files; fix: `ros2 bag reindex {folder}`')
    return _inside(folder, listed)


def _inside(folder: Path, names: list[str]) -> list[Path]:
    """
    Files of a bag's folder by their names in it.

    Raises BagError for what is none, is there twice, or is elsewhere: a bag from a stranger must
    not make us wait, or read other files of this machine.
    """
    whole = folder.resolve()
    found: dict[tuple[int, int], str] = {}
    for name in names:
        path, shown, is_name = folder / name, folder / cut(name), '\0' not in name
        outside = PurePath(name).is_absolute() or '..' in PurePath(name).parts
        if outside or (is_name and not path.resolve().is_relative_to(whole)):
            raise BagError(
                f'{shown} is outside of the folder; fix: have all files of a bag in its folder, '
                'and no links to others'
            )
        if not is_name or not path.exists():
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
        identity = about.st_dev, about.st_ino
        if identity in found:
            raise BagError(
                f"{shown} is the same file as '{cut(found[identity])}'; fix: have and name each "
                'file once'
            )
        found[identity] = name
    return [folder / name for name in names]


def _by_number(name: str) -> list[int | str]:
    return [int(s) if s.isdecimal() else s for s in re.split(r'(\d+)', name)]


def check_magic(path: Path) -> None:
    with open_regular(path) as file:
        magic = file.read(len(MCAP0_MAGIC))
    if not magic:
        raise Truncated(f'{path} is empty (0 bytes); fix: record again')
    if magic == SQLITE_MAGIC:
        return
    if magic == ROS1_MAGIC:
        raise BagError(f'{path} is a ROS 1 bag; {_IMPORT.format(path, path.with_suffix(".mcap"))}')
    if magic.startswith(ZSTD_MAGIC):
        with open_file(path) as unpacked:
            if unpacked.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
                return
        raise BagError(
            f'{path} is compressed, and what is in it is not an MCAP file; '
            f'fix: see what `zstd -d {path}` gives'
        )
    if not MCAP0_MAGIC.startswith(magic):
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
    """What program says in a file that it recorded it; '' if none does, or we can make it again."""
    path = Path(path)
    with suppress(OSError, *_MALFORMED, struct.error, EndOfFile):
        if path.is_file():
            with open_file(path) as file:
                if file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
                    head = file.read(_HEADER)
                    length = int.from_bytes(head[1:9], 'little')
                    library = Header.read(ReadDataStream(io.BytesIO(head[9 : 9 + length]))).library
                    return '' if library == LIBRARY else library or 'another program'
    return ''


def unreadable(path: Path, error: OSError) -> BagError:
    path = error.filename or path
    return BagError(f'{path} cannot be read: {error.strerror}; fix: check the path and its rights')


def unwritable(path: str | Path, error: OSError) -> BagError:
    return BagError(
        f'{path} cannot be written: {error.strerror or error}; '
        'fix: check the path, its rights and the space on the disk'
    )


def open_file(path: Path) -> BinaryIO:
    """A file of a bag, or the content of one that rosbag2 compressed as a whole."""
    file = open_regular(path)
    packed = file.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
    file.seek(0)
    return cast('BinaryIO', io.BufferedReader(Unpacked(file), _PIECE)) if packed else file


class Unpacked(io.RawIOBase):
    """The content of a file compressed by zstd, read forward; to go back is to begin anew.

    It ends where zstd cannot go on, and `trouble` says why.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.name = file.name
        self.trouble = ''
        self._file = file
        self._begin()

    def _begin(self) -> None:
        self._file.seek(0)
        # rosbag2 writes one frame, other tools several.
        self._content = zstandard.ZstdDecompressor().stream_reader(
            self._file, read_across_frames=True, closefd=False
        )
        self._place = 0

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
        self._place += count
        return int(count)

    def tell(self) -> int:
        return self._place

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        if whence == io.SEEK_END:
            offset = _FARTHEST
        if offset < self._place:
            self._begin()
        passed = memoryview(bytearray(min(_PIECE, offset - self._place)))
        while self._place < offset and self.readinto(passed[: offset - self._place]):
            pass
        return self._place

    def close(self) -> None:
        self._file.close()
        super().close()
