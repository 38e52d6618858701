"""
Bags and results in the stores that fsspec knows: s3://, gs://, memory:// and the like.

A bag is fetched to the disk of its worker, and results are sent when they are whole. What they are
made of is sent last, so a run that was stopped leaves nothing that passes for finished.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import unquote, urlsplit

from kinpole_ros.bags import BagError
from kinpole_ros.packages import install_command

# What stores call that which changes with the content of a file.
_VERSIONS = ('ETag', 'etag', 'md5Hash', 'content_md5', 'mtime', 'LastModified', 'created')


def is_url(path: str | Path) -> bool:
    """Whether it is in a store, and not on a disk."""
    return isinstance(path, str) and '://' in path and not path.startswith('file://')


def on_disk(path: str | Path) -> str | Path:
    """The path of a file:// URL; others as they are."""
    if isinstance(path, str) and path.startswith('file://'):
        return unquote(urlsplit(path).path)
    return path


def lives_in_this_process(path: str | Path) -> bool:
    """Whether no other process can see it."""
    return isinstance(path, str) and path.startswith('memory://')


def identity(bag: str) -> list[tuple[str, int, str]]:
    """Name, size and version of each file of a bag. Raises BagError when there is none."""
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


def size(bag: str) -> int:
    """Bytes of a bag."""
    return sum(file[1] for file in identity(bag))


@contextmanager
def fetched(bag: str) -> Iterator[str]:
    """The path of a copy of a bag, a file or a folder, on the disk of this machine."""
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
    """Send files of a folder to a store; `last` goes when all others are there."""
    with _errors(url, 'written'):
        store, path = _open(url)
        store.makedirs(path, exist_ok=True)
        if names and store.exists(f'{path}/{last}'):
            store.rm_file(f'{path}/{last}')
        for name in (*names, last):
            store.put_file(str(folder / name), f'{path}/{name}')


def recorded(url: str) -> tuple[dict[str, Any], set[str]]:
    """What is said of the results in a store, by path, and the paths of all files there."""
    with _errors(url):
        store, path = _open(url)
        # Another run may have written since it was last looked at.
        store.invalidate_cache()
        names = store.find(path) if store.exists(path) else []
        entries = [name for name in names if name.endswith('.json')]
        # All at once: a store far away takes as long for one as for many.
        contents = store.cat(entries, on_error='omit') if entries else {}
        records = {}
        for name, content in contents.items():
            try:
                records[_within(name, path).removesuffix('.json')] = json.loads(content)
            except ValueError:
                continue
        return records, {_within(name, path) for name in names}


def _within(name: str, path: str) -> str:
    return name.removeprefix(path).lstrip('/')


def _open(url: str) -> tuple[Any, str]:
    """A store and the path in it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise BagError(f'{url} needs fsspec; fix: {install_command("batch")}') from None
    store, path = url_to_fs(url)
    return store, path.rstrip('/')


@contextmanager
def _errors(url: str, done: str = 'read') -> Iterator[None]:
    """What a store raises as a BagError: each has errors of its own."""
    try:
        yield
    except BagError:
        raise
    except ImportError as error:
        raise BagError(f'{url}: {error}; fix: pip install what it names') from error
    except Exception as error:
        text = ' '.join((getattr(error, 'strerror', None) or str(error)).split())
        raise BagError(
            f'{url} cannot be {done}: {text or type(error).__name__}; fix: check the address, the '
            'rights and the settings of the store'
        ) from error
