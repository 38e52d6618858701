"""
The results of one bag: made by one run at a time, and named only when they are complete.

A small file next to them says what they are made of, so that they are not made twice.
"""

import glob
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kinpole_ros import __version__
from kinpole_ros.bags import BagError, Replayed, bag_files
from kinpole_ros.bags._replay import replay_into
from kinpole_ros.bags.batch import _store
from kinpole_ros.files import lock, read_limited, whole_file
from kinpole_ros.files.bounded_yaml import MOST_YAML
from kinpole_ros.mechanism import LinkageError, SceneError
from kinpole_ros.settings import ParameterError, Settings

KINDS = ('mcap', 'csv', 'parquet')
EXPECTED = (BagError, LinkageError, ParameterError, SceneError, OSError)
_LONGEST_NAME = 200  # bytes of a name, which may have 255 with its endings
_MOST_RECORD_BYTES = 16 << 20
# What JSON of another form raises.
_MALFORMED = (ValueError, LookupError, TypeError, RecursionError)

# What the summary says of one bag: text and numbers by the name of their column.
Row = dict[str, Any]


def result_name(bag: str) -> str:
    """Return the name of the results of a bag: its own, and a number that only its path has."""
    name = Path(bag).name.removesuffix('.zstd').removesuffix('.mcap')
    name = os.fsdecode(os.fsencode(name)[:_LONGEST_NAME])
    return f'{name}-{hashlib.sha256(os.fsencode(bag)).hexdigest()[:10]}'


@dataclass(frozen=True)
class Job:
    """A bag to be replayed, and its results to be made."""

    bag: str
    root: Path | str  # of all results: a folder, or a URL where it is text
    settings: Settings
    kinds: Sequence[str]
    shard: str = ''  # folder in the root; '' for none

    @property
    def name(self) -> str:
        """Return the name of the results, without ending."""
        return result_name(self.bag)

    @property
    def folder(self) -> Path:
        """Return the folder of the results, which is not in a store."""
        return Path(self.root) / self.shard

    @property
    def url(self) -> str:
        """Return the address of the folder of the results, in a store."""
        return f'{self.root}/{self.shard}'.rstrip('/')

    def files(self, folder: Path) -> dict[str, Path]:
        """Return the files by kind to write results to."""
        return {kind: folder / f'{self.name}.{kind}.part' for kind in self.kinds}

    def fingerprint(self) -> list[Any]:
        """Return what is equal as long as all that results depend on is unchanged."""
        if _store.is_url(self.bag):
            files: list[Any] = list(_store.identity(self.bag))
        else:
            stats = ((file.name, file.stat()) for file in bag_files(self.bag))
            files = [(name, stat.st_size, stat.st_mtime_ns) for name, stat in stats]
        content = repr((__version__, self.settings, files)).encode()
        scene = Path(self.settings.scene)
        if self.settings.scene and scene.is_file():
            content += read_limited(scene, MOST_YAML)
        return [__version__, hashlib.sha256(content).hexdigest()]


def replay_bag(job: Job, progress: Callable[[float], None] | None = None) -> Row:
    """
    Replay one bag, in any process, and return its row; what is wrong with the bag is in the row.

    It waits for the end of another run that is at this bag, except in a store, where both do it.
    `progress` is called with the share done.
    """
    try:
        if isinstance(job.root, str):
            with TemporaryDirectory(prefix='kinpole') as scratch:
                row = _make(job, Path(scratch), progress)
                names = [f'{job.name}.{kind}' for kind in job.kinds]
                _store.send(Path(scratch), names, f'{job.name}.json', job.url)
            return row
        with alone(job):
            return finished(job) or _make(job, job.folder, progress)
    except EXPECTED as error:
        text = str(error)
    except Exception as error:  # a fault of ours
        text = f'{type(error).__name__}: {error}'
    return {'bag': job.bag, 'error': ' '.join(text.split())}


def _make(job: Job, folder: Path, progress: Callable[[float], None] | None) -> Row:
    """Replay one bag into a folder; raises what replay does, and OSError."""
    fingerprint = job.fingerprint()
    is_url = _store.is_url(job.bag)
    with _store.fetched(job.bag) if is_url else nullcontext(job.bag) as source:
        outcome = replay_into(source, job.settings, job.files(folder), progress)
    return _name_results(job, folder, fingerprint, outcome)


def bag_size(bag: str) -> int:
    """Return the bytes of a bag, 1 at least."""
    try:
        if _store.is_url(bag):
            return max(1, sum(size for _, size, _ in _store.identity(bag)))
        return max(1, sum(file.stat().st_size for file in bag_files(bag)))
    except EXPECTED:
        return 1


def _name_results(job: Job, folder: Path, fingerprint: list[Any], outcome: Replayed) -> Row:
    """Give the results of a bag, which are complete, their names, and return its row."""
    name = job.name
    earlier = _row_of(_read_record(folder / f'{name}.json'), job, fingerprint)
    kinds = [
        kind
        for kind in KINDS
        if kind in job.kinds
        or (f'.{kind}' in earlier.get('results', '') and (folder / f'{name}.{kind}').is_file())
    ]
    row: Row = {
        'bag': job.bag,
        'error': '',
        'truncated': str(outcome.truncated or ''),
        'results': ' '.join(f'{name}.{kind}' for kind in kinds),
        'frames': outcome.frames,
        'estimates': outcome.estimates,
        'markers': len(outcome.identities),
        'start': outcome.first / 1e9,
        'end': outcome.last / 1e9,
        'seconds': (outcome.last - outcome.first) / 1e9,
        'repeated': outcome.repeated,
        'late': outcome.late,
        'lost': outcome.lost,
        'resets': outcome.resets,
        'frame_changes': outcome.frame_changes,
        'unreadable': outcome.unreadable,
        'problem': outcome.problem,
        'unknown': ' '.join(outcome.unknown),
        'warnings': '; '.join(outcome.warnings),
    }
    for body, poles in outcome.determined.items():
        row[f'{body}_noise'] = outcome.noise[body] if outcome.noise[body] >= 0 else None
        row |= {f'{body}_{pole}_determined': share for pole, share in poles.items()}
    # Without a record, results are made again if we are stopped from here on.
    record = folder / f'{name}.json'
    record.unlink(missing_ok=True)
    for kind, part in job.files(folder).items():
        part.replace(folder / f'{name}.{kind}')
    with whole_file(record) as part:
        part.write_text(json.dumps({'made_of': fingerprint, 'row': row}), encoding='utf-8')
    return row


@contextmanager
def alone(job: Job, wait: bool = True) -> Iterator[None]:
    """
    Keep other runs, of any process, off the results of a bag; remove unfinished parts at the end.

    Raises BlockingIOError when another run is at them and this one is not to `wait`.
    """
    job.folder.mkdir(exist_ok=True)
    path = job.folder / f'{job.name}.part'
    while True:
        with open(path, 'ab') as file:
            lock(file, wait)
            # The last run removed the file, and another one may have locked a new one.
            is_same = False
            with suppress(FileNotFoundError):
                is_same = os.path.samestat(os.fstat(file.fileno()), os.stat(path))
            if is_same:
                try:
                    yield
                finally:
                    for part in job.folder.glob(f'{glob.escape(job.name)}.*.part'):
                        with suppress(OSError):
                            part.unlink()
                    # Windows removes no open file, nor one that others have opened meanwhile.
                    with suppress(PermissionError):
                        path.unlink(missing_ok=True)
                break
    if os.name == 'nt':
        with suppress(PermissionError):
            path.unlink(missing_ok=True)


def finished(job: Job, stored: _store.Content | None = None) -> Row | None:
    """
    Return the row of a bag whose results exist, made of the same bag with the same settings.

    Those in a store are looked up in its content.
    """
    try:
        fingerprint = job.fingerprint()
    except EXPECTED:
        return None
    if stored is None:
        record = _read_record(job.folder / f'{job.name}.json')
    else:
        path = f'{job.shard}/{job.name}'.lstrip('/')
        record = stored.records.get(path)
    row = _row_of(record, job, fingerprint)
    for kind in job.kinds:
        if f'.{kind}' not in str(row.get('results')):
            return None
        if stored is None:
            exists = (job.folder / f'{job.name}.{kind}').is_file()
        else:
            exists = f'{path}.{kind}' in stored.names
        if not exists:
            return None
    return row or None


def _read_record(path: Path) -> Any:
    """Return what is recorded of results; None where that cannot be read."""
    try:
        return json.loads(read_limited(path, _MOST_RECORD_BYTES))
    except (OSError, *_MALFORMED):
        return None


def _row_of(record: Any, job: Job, fingerprint: list[Any]) -> Row:
    """Return the row in a record of the same bag with this fingerprint; empty where it is not."""
    with suppress(*_MALFORMED):
        row = record['row']
        if record['made_of'] == fingerprint and isinstance(row, Mapping) and row['bag'] == job.bag:
            return dict(row)
    return {}


def is_result(path: str, folder: Path) -> bool:
    """Return whether a file is a result of an earlier run into the folder, and no bag of these."""
    result = Path(path)
    if folder not in (result.parent, result.parent.parent):
        return False
    with suppress(*_MALFORMED):
        return result_name(_read_record(result.with_suffix('.json'))['row']['bag']) == result.stem
    return False
