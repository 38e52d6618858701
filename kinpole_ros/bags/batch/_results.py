"""
The results of one bag: made by one run at a time, and named only when they are whole.

A small file next to them says what they are made of, so that they are not made twice.
"""

import csv
import glob
import hashlib
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kinpole_ros import __version__
from kinpole_ros.bags import BagError, bag_files, warnings_of
from kinpole_ros.bags._files import unwritable
from kinpole_ros.bags._replay import replay
from kinpole_ros.bags._replayed import Replayed
from kinpole_ros.bags.batch import _store
from kinpole_ros.files import lock, read_limited
from kinpole_ros.files.bounded_yaml import MOST_YAML
from kinpole_ros.mechanism import LinkageError, SceneError
from kinpole_ros.tracking.parameters import ParameterError, Settings

KINDS = ('mcap', 'csv', 'parquet')
EXPECTED = (BagError, LinkageError, ParameterError, SceneError, OSError)
_LONGEST_NAME = 200  # bytes
_MOST = 16 << 20  # bytes of what is known of a bag
_FIRST = ('bag', 'error', 'truncated', 'results', 'frames', 'estimates', 'start', 'end', 'seconds')

# What the summary says of one bag: text and numbers by the name of their column.
Row = dict[str, Any]


def replay_bag(
    bag: str,
    folder: Path | str,
    settings: Settings,
    topic: str | None,
    kinds: list[str],
    progress: Callable[[float], None] | None = None,
) -> Row:
    """
    Replay one bag, in whatever process this is; what is wrong with it is in the row.

    `folder` is a URL where it is text. Where another run is at this bag, its end is awaited, but
    in a store, where both do it. `progress` is called with the share done.
    """
    try:
        if isinstance(folder, str):
            name = name_of(bag)
            with TemporaryDirectory(prefix='kinpole') as scratch:
                row = _make(bag, Path(scratch), settings, topic, kinds, progress)
                results = [f'{name}.{kind}' for kind in kinds]
                _store.send(Path(scratch), results, f'{name}.json', folder)
            return row
        with alone(bag, folder):
            before = finished(bag, folder, settings, topic, kinds)
            return before or _make(bag, folder, settings, topic, kinds, progress)
    except EXPECTED as error:
        return {'bag': bag, 'error': ' '.join(str(error).split())}


def _make(
    bag: str,
    folder: Path,
    settings: Settings,
    topic: str | None,
    kinds: list[str],
    progress: Callable[[float], None] | None,
) -> Row:
    """Replay one bag and give its results their names; raises what replay does, and OSError."""
    name = name_of(bag)
    parts = {kind: folder / f'{name}.{kind}.part' for kind in kinds}
    of_what = made_of(bag, settings, topic)
    with _store.fetched(bag) if _store.is_url(bag) else nullcontext(bag) as source:
        result = replay(
            source,
            settings,
            output=parts.get('mcap'),
            csv=parts.get('csv'),
            topic=topic,
            progress=progress,
            parquet=parts.get('parquet'),
            place=nullcontext,
        )
    return name_results(bag, folder, settings, of_what, parts, result)


def name_results(
    bag: str,
    folder: Path,
    settings: Settings,
    of_what: list[Any],
    parts: dict[str, Path],
    result: Replayed,
) -> Row:
    """Give the results of a bag, which are whole in `parts` by kind, their names; their row."""
    name = name_of(bag)
    before = _recorded_row(bag, folder, of_what)
    there = [kind for kind in KINDS if kind in parts or _has(before, bag, folder, kind)]
    row: Row = {
        'bag': bag,
        'error': '',
        'truncated': str(result.truncated or ''),
        'results': ' '.join(f'{name}.{kind}' for kind in there),
        'frames': result.frames,
        'estimates': result.estimates,
        'markers': len(result.identities),
        'start': result.first / 1e9,
        'end': result.last / 1e9,
        'seconds': (result.last - result.first) / 1e9,
        'repeated': result.repeated,
        'late': result.late,
        'lost': result.lost,
        'resets': result.resets,
        'frame_changes': result.frame_changes,
        'unreadable': result.unreadable,
        'problem': result.problem,
        'unknown': ' '.join(result.unknown),
        'warnings': '; '.join(warnings_of(result, settings)),
    }
    for body, poles in result.determined.items():
        row[f'{body}_noise'] = result.noise[body] if result.noise[body] >= 0 else None
        row |= {f'{body}_{pole}_determined': share for pole, share in poles.items()}
    # Stopped from here on, nothing tells what the results are made of, and they are made anew.
    about = folder / f'{name}.json'
    about.unlink(missing_ok=True)
    for kind, part in parts.items():
        part.replace(folder / f'{name}.{kind}')
    _write_whole(about, json.dumps({'made_of': of_what, 'row': row}))
    return row


@contextmanager
def alone(bag: str, folder: Path, wait: bool = True) -> Iterator[None]:
    """
    Keep other runs, of any process, off the results of a bag; in the end no parts are left of them.

    Raises BlockingIOError when another run is at them and this one is not to `wait`.
    """
    place = folder / f'{name_of(bag)}.part'
    while True:
        with open(place, 'ab') as held:
            lock(held, wait)
            # Who was here before removed the file, and somebody else may be at a new one.
            try:
                mine = os.path.samestat(os.fstat(held.fileno()), os.stat(place))
            except FileNotFoundError:
                mine = False
            if mine:
                try:
                    yield
                finally:
                    _remove_parts(bag, folder)
                    # Windows removes no open file, nor one that others have opened meanwhile.
                    with suppress(PermissionError):
                        place.unlink(missing_ok=True)
                break
    if os.name == 'nt':
        with suppress(PermissionError):
            place.unlink(missing_ok=True)


def _remove_parts(bag: str, folder: Path) -> None:
    """Remove what is left of results that were not finished, of this run or of one before."""
    for part in folder.glob(f'{glob.escape(name_of(bag))}.*.part'):
        with suppress(OSError):
            part.unlink()


def finished(
    bag: str, folder: Path, settings: Settings, topic: str | None, kinds: list[str]
) -> Row | None:
    """The row of a bag whose results are there, made of the same bag with the same settings."""
    try:
        row = _recorded_row(bag, folder, made_of(bag, settings, topic))
    except EXPECTED:
        return None
    return row if all(_has(row, bag, folder, kind) for kind in kinds) else None


def finished_in_store(
    bag: str,
    home: str,
    known: tuple[dict[str, Any], set[str]],
    settings: Settings,
    topic: str | None,
    kinds: list[str],
) -> Row | None:
    """The same in a store, of which `known` is what it holds; `home` is the folder of the bag."""
    records, names = known
    place = f'{home}/{name_of(bag)}'.lstrip('/')
    try:
        record = records[place]
        row = record['row']
        if row['bag'] != bag or record['made_of'] != made_of(bag, settings, topic):
            return None
    except (LookupError, TypeError, *EXPECTED):
        return None
    there = all(f'{place}.{kind}' in names and f'.{kind}' in row['results'] for kind in kinds)
    return row if there else None


def _recorded_row(bag: str, folder: Path, of_what: list[Any]) -> Row | None:
    """The row of the results of a bag that are there, if they were made of this."""
    try:
        record = json.loads(read_limited(folder / f'{name_of(bag)}.json', _MOST))
        row = record['row'] if record['made_of'] == of_what else None
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None
    return row if isinstance(row, dict) and row.get('bag') == bag else None


def _has(row: Row | None, bag: str, folder: Path, kind: str) -> bool:
    """Whether results of this kind are there and the row, if there is one, tells of them."""
    name = f'{name_of(bag)}.{kind}'
    return row is not None and name in str(row.get('results')) and (folder / name).is_file()


def is_result(path: str, folder: Path) -> bool:
    """Whether it is a result of an earlier run into the folder of its bags, and no bag of these."""
    result = Path(path)
    if folder not in (result.parent, result.parent.parent):
        return False
    try:
        record = json.loads(read_limited(result.with_suffix('.json'), _MOST))
        return name_of(record['row']['bag']) == result.stem
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return False


def shard_of(bag: str) -> str:
    """The folder of the results of a bag among very many: one of 256."""
    return name_of(bag)[-10:-8]


def name_of(bag: str) -> str:
    """What the results of a bag are called: its own name, and a number that only its path has."""
    short = Path(bag).name.removesuffix('.zstd').removesuffix('.mcap')
    # A name of a file has 255 bytes, and there are endings to come.
    short = os.fsdecode(os.fsencode(short)[:_LONGEST_NAME])
    return f'{short}-{hashlib.sha256(os.fsencode(bag)).hexdigest()[:10]}'


def made_of(bag: str, settings: Settings, topic: str | None) -> list[Any]:
    """All that the results depend on, such that equal is unchanged."""
    if _store.is_url(bag):
        files: list[Any] = list(_store.identity(bag))
    else:
        stats = ((file.name, file.stat()) for file in bag_files(bag))
        files = [(name, stat.st_size, stat.st_mtime_ns) for name, stat in stats]
    scene = Path(settings.scene)
    described = repr((__version__, topic, settings, files)).encode()
    if settings.scene and scene.is_file():
        described += read_limited(scene, MOST_YAML)
    return [__version__, hashlib.sha256(described).hexdigest()]


def write_summary(path: Path, rows: list[Row]) -> None:
    """One line a bag; a column for all that any of them has."""
    columns = dict.fromkeys(_FIRST) | dict.fromkeys(name for row in rows for name in row)
    text = StringIO(newline='')
    table = csv.DictWriter(text, list(columns))
    table.writeheader()
    table.writerows(rows)
    try:
        _write_whole(path, text.getvalue())
    except OSError as error:
        raise unwritable(path, error) from None


def _write_whole(path: Path, text: str) -> None:
    part = path.with_name(f'{path.name}.part')
    try:
        # A file name need not be text.
        part.write_bytes(text.encode('utf-8', 'backslashreplace'))
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
