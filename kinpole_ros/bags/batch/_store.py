"""
Bags and results in the stores that fsspec knows: s3://, gs://, memory:// and the like.

A bag is fetched to the disk of its worker, and results are sent when they are complete. Their
record is sent last, so a run that was stopped leaves nothing that seems finished.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

from kinpole_ros.bags import BagError
from kinpole_ros.packages import install_command

# Names in stores of properties that change with the content of a file.
_VERSIONS = ('ETag', 'etag', 'md5Hash', 'content_md5', 'mtime', 'LastModified', 'created')

# Protocols of fsspec that read the disk of this machine, by themselves or through another store.
_LOCAL = (
    *('local', 'git', 'generic', 'reference', 'dir', 'dask', 'zip', 'tar', 'libarchive'),
    *('cached', 'blockcache', 'filecache', 'simplecache', 'asyncwrapper', 'data'),
)


def is_url(path: str | Path) -> bool:
    """Return whether it is in a store, and not on a disk."""
    return isinstance(path, str) and '://' in path and not path.startswith('file://')


def is_around_files(path: str) -> bool:
    """Return whether a URL is one store in another, or reads files of this machine."""
    return is_url(path) and ('::' in path or path.partition('://')[0].lower() in _LOCAL)


def on_disk(path: str | Path) -> str | Path:
    """Return the path of a file:// URL; other paths unchanged."""
    if isinstance(path, str) and path.startswith('file://'):
        return unquote(urlsplit(path).path)
    return path


def is_in_memory(path: str | Path) -> bool:
    """Return whether no other process has access to it."""
    return isinstance(path, str) and path.startswith('memory://')


def identity(bag: str) -> list[tuple[str, int, str]]:
    """Return name, size and version of the files of a bag; raises BagError when there is none."""
    with _errors(bag):
        store, path = _open(bag)
        files = store.find(path, detail=True)
        if not files:
            raise FileNotFoundError(2, 'No such file or folder')
        return [
            (name.removeprefix(path), about['size'], _version(about))
            for name, about in sorted(files.items())
        ]


def _version(about: dict[str, Any]) -> str:
    return ' '.join(str(about[key]) for key in _VERSIONS if about.get(key) is not None)


@contextmanager
def fetched(bag: str) -> Iterator[str]:
    """Give the path of a copy of a bag, a file or a folder, on the disk of this machine."""
    with TemporaryDirectory(prefix='kinpole') as folder:
        with _errors(bag):
            store, path = _open(bag)
            copy = Path(folder) / (path.rstrip('/').rpartition('/')[2] or 'bag')
            if store.isdir(path):
                for name in store.find(path):
                    target = copy / _within(name, path)
                    if not target.resolve().is_relative_to(copy.resolve()):
                        raise OSError(f'{name} is outside of it')
                    target.parent.mkdir(parents=True, exist_ok=True)
                    store.get_file(name, str(target))
            else:
                store.get_file(path, str(copy))
        yield str(copy)


def send(folder: Path, names: list[str], last: str, url: str) -> None:
    """Send files of a folder to a store, `last` when all others are there."""
    with _errors(url, 'written'):
        store, path = _open(url)
        store.makedirs(path, exist_ok=True)
        if names and store.exists(f'{path}/{last}'):
            store.rm_file(f'{path}/{last}')
        for name in (*names, last):
            store.put_file(str(folder / name), f'{path}/{name}')


class Content(NamedTuple):
    """The records of the results in a store, by path without ending, and the paths of all files."""

    records: dict[str, Any]
    names: set[str]


def content(url: str) -> Content:
    """Read the records of the results in a store."""
    with _errors(url):
        store, path = _open(url)
        # Another run may have written since it was last read.
        store.invalidate_cache()
        names = store.find(path) if store.exists(path) else []
        entries = [name for name in names if name.endswith('.json')]
        # All at once: a remote store takes as long for one as for many.
        texts = store.cat(entries, on_error='omit') if entries else {}
        records = {}
        for name, text in texts.items():
            with suppress(ValueError):
                records[_within(name, path).removesuffix('.json')] = json.loads(text)
        return Content(records, {_within(name, path) for name in names})


def _within(name: str, path: str) -> str:
    return name.removeprefix(path).lstrip('/')


def _open(url: str) -> tuple[Any, str]:
    """Return a store and the path in it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise BagError(f'{url} needs fsspec; fix: {install_command("batch")}') from None
    store, path = url_to_fs(url)
    return store, path.rstrip('/')


@contextmanager
def _errors(url: str, action: str = 'read') -> Iterator[None]:
    """Turn what a store raises into BagError: each has errors of its own."""
    try:
        yield
    except BagError:
        raise
    except ImportError as error:
        raise BagError(f'{url}: {error}; fix: pip install what it names') from error
    except Exception as error:
        text = ' '.join((getattr(error, 'strerror', None) or str(error)).split())
        raise BagError(
            f'{url} cannot be {action}: {text or type(error).__name__}; fix: check the address, '
            'the rights and the settings of the store'
        ) from error
