"""
Many bags replayed, on the cores of this machine or on a Dask cluster, and a table over all.

Dask does the work of spreading; here is what makes a run of days bearable: each result appears
under its name only when it is whole, with a small file beside it that tells what it was made of,
so that a run that was stopped goes on where it was, and a bag that fails costs only itself.
"""

import csv
import fcntl
import hashlib
import json
import logging
import os
import signal
import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from io import StringIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from kinpole_ros import __version__
from kinpole_ros.bags import BagError, bag_files, replay, warnings_of
from kinpole_ros.mechanism import LinkageError, SceneError
from kinpole_ros.parameters import ParameterError, Settings

KINDS = ('mcap', 'csv', 'parquet')
_TOPIC = 'kinpole'  # of Dask's events
_PATIENCE = 30  # s, for a scheduler and its first worker
_LONGEST_NAME = 200  # bytes
_FIRST = ('bag', 'error', 'truncated', 'results', 'frames', 'estimates', 'start', 'end', 'seconds')
_EXPECTED = (BagError, LinkageError, ParameterError, SceneError, OSError)

# What the summary says of one bag: text and numbers by the name of their column.
Row = dict[str, Any]


def batch(
    bags: Sequence[str | Path],
    output: str | Path,
    settings: Settings,
    topic: str | None = None,
    kinds: Sequence[str] = ('mcap',),
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
    report: Callable[[Row], None] | None = None,
) -> list[Row]:
    """
    Replay every bag into the folder `output` and write summary.csv there; returns its rows.

    `kinds` are what is written of each bag: 'mcap', 'csv', 'parquet', as replay does. Results are
    called after the bag and a number made of its whole path, so bags of one name do not meet.
    `scheduler` is the address of a Dask scheduler whose workers have this package and see the
    same files; without it, `workers` processes here (as many as cores). Bags that are finished
    with the same settings are not done again.

    A row has the bag and its results, frames, estimates, the span of time, noise, resets, what
    was unreadable, the share of instants with each pole, where the bag was cut off ('truncated'),
    bodies known at no instant ('unknown'), and why it failed ('error'). A failed bag does not stop
    the rest; `report` is called with each row as it comes, `progress` with the share done of what
    was left to do, by bytes. Rows are in the order of `bags`, without results of earlier runs
    among them. Raises BagError when there is no Dask, no scheduler, or no place to write. An
    interruption leaves what is finished, and a summary of it.
    """
    folder = Path(os.path.abspath(output))
    paths = [path for path in dict.fromkeys(map(os.path.abspath, bags)) if not _ours(path, folder)]
    if not paths:
        raise BagError(f'all bags named are results of earlier runs in {folder}; name others')
    whole_folder = str(folder) in paths and not (folder / 'metadata.yaml').exists()
    if 'mcap' in kinds and whole_folder:
        raise BagError(
            f'{folder} is a bag to be replayed, and results would become a part of it, which is '
            'all .mcap files of its folder; name another folder for the results'
        )
    if settings.scene and Path(settings.scene).is_file():
        settings = replace(settings, scene=os.path.abspath(settings.scene))
    kinds = [kind for kind in KINDS if kind in kinds]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Said once now, not of every bag.
        TemporaryFile(dir=folder).close()
    except OSError as error:
        raise _unwritable(folder, error) from None
    rows: dict[str, Row] = {}
    bar = None if progress is None else _Progress(progress)
    try:
        for row in _rows(paths, folder, settings, topic, kinds, scheduler, workers, bar):
            rows[row['bag']] = row
            if report is not None:
                with nullcontext() if bar is None else bar.lock:
                    report(row)
    finally:
        # What was finished while we were being stopped counts too.
        told = [rows.get(path) or _finished(path, folder, settings, topic, kinds) for path in paths]
        listed = [row for row in told if row is not None]
        _write_summary(folder / 'summary.csv', listed)
    return listed


def _rows(
    bags: list[str],
    folder: Path,
    settings: Settings,
    topic: str | None,
    kinds: list[str],
    scheduler: str | None,
    workers: int | None,
    bar: '_Progress | None',
) -> Iterator[Row]:
    """The row of each bag as it comes: first those that are there, then those made now."""
    left = []
    for bag in bags:
        row = _finished(bag, folder, settings, topic, kinds)
        if row is None:
            left.append(bag)
        else:
            yield row
    if not left:
        return
    try:
        with _cluster(scheduler, min(workers or os.cpu_count() or 1, len(left))) as client:
            from distributed import as_completed

            if bar is not None:
                bar.begin([_size(bag) for bag in left])
                client.subscribe_topic(_TOPIC, lambda event: bar.take(*event[1]))
            jobs = {}
            for number, bag in enumerate(left):
                known_as = None if bar is None else (bar.run, number)
                job = client.submit(
                    _replay_one, bag, folder, settings, topic, kinds, known_as, pure=False
                )
                jobs[job] = number
            for job in as_completed(jobs):
                bag = left[jobs[job]]
                error = job.exception()
                if bar is not None:
                    bar.take(bar.run, jobs[job], 1.0)
                if error is None:
                    yield job.result()
                else:  # a worker that died, or one without this package; or a fault of ours
                    text = ' '.join(f'{type(error).__name__}: {error}'.split())
                    yield {'bag': bag, 'error': text}
    finally:
        # Workers of our own are gone; others go on with what they began, and finish it.
        if scheduler is None:
            for bag in left:
                with suppress(OSError), _alone(bag, folder, wait=False):
                    pass


class _Progress:
    """
    The share done of all bags by bytes, from what workers tell of each by its number.

    They are heard in another thread, which holds the `lock` while it tells.
    """

    def __init__(self, progress: Callable[[float], None]) -> None:
        self.lock = threading.Lock()
        # Others may use the same cluster.
        self.run = uuid.uuid4().hex
        self._progress = progress

    def begin(self, sizes: list[int]) -> None:
        self._sizes, self._whole = sizes, sum(sizes)
        self._done, self._sum = [0] * len(sizes), 0
        self._progress(0.0)

    def take(self, run: str, number: int, share: float) -> None:
        with self.lock:
            done = int(share * self._sizes[number]) if run == self.run else 0
            # What was told of a bag before its end may arrive after it.
            if done > self._done[number]:
                self._sum += done - self._done[number]
                self._done[number] = done
                self._progress(self._sum / self._whole)


def _size(bag: str) -> int:
    """Bytes of a bag, 1 at least."""
    try:
        return max(1, sum(file.stat().st_size for file in bag_files(bag)))
    except _EXPECTED:
        return 1


@contextmanager
def _cluster(scheduler: str | None, workers: int) -> Iterator[Any]:
    """A client of the cluster at that address, or of processes of our own."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise BagError("many bags need Dask; mend: pip install 'kinpole_ros[batch]'") from None
    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    if scheduler is None:
        try:
            with _interrupts_ignored():
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    dashboard_address=None,
                    # It listens for browsers all the same: here, where nothing else does.
                    scheduler_kwargs={'dashboard_address': '127.0.0.1:0'},
                    silence_logs=logging.CRITICAL,
                )
        except (OSError, RuntimeError) as error:
            raise BagError(
                f'no worker processes can be started ({error}); mend: see to the memory and the '
                'processes this machine has to spare, or give fewer --workers'
            ) from None
        with cluster, Client(cluster) as client:
            yield client
        return
    try:
        client = Client(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        raise BagError(
            f'no Dask scheduler answers at {scheduler} ({error}); mend: give the address that '
            '`dask scheduler` prints, such as tcp://10.0.0.5:8786'
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError:
            raise BagError(
                f'the Dask scheduler at {scheduler} has no workers; mend: start some, with '
                f'`dask worker {scheduler}`'
            ) from None
        yield client


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Workers started meanwhile leave Ctrl-C to us; a terminal sends it to all of them."""
    here = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if here else None
    try:
        yield
    finally:
        if here:
            signal.signal(signal.SIGINT, before)


def _replay_one(
    bag: str,
    folder: Path,
    settings: Settings,
    topic: str | None,
    kinds: list[str],
    known_as: tuple[str, int] | None = None,
) -> Row:
    """
    Replay one bag, in whatever process this is; what is wrong with it is in the row.

    A worker tells how far it is to whoever has the bag `known_as` this run and number. Where
    another run is at this bag, its end is awaited.
    """
    progress = None
    if known_as is not None:
        from distributed import get_worker

        worker = get_worker()

        def progress(share: float) -> None:
            worker.log_event(_TOPIC, (*known_as, share))

    try:
        with _alone(bag, folder):
            row = _finished(bag, folder, settings, topic, kinds)
            return row or _make(bag, folder, settings, topic, kinds, progress)
    except _EXPECTED as error:
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
    name = _name(bag)
    parts = {kind: folder / f'{name}.{kind}.part' for kind in kinds}
    made_of = _made_of(bag, settings, topic)
    result = replay(
        bag,
        settings,
        output=parts.get('mcap'),
        csv=parts.get('csv'),
        topic=topic,
        progress=progress,
        parquet=parts.get('parquet'),
    )
    before = _told(bag, folder, made_of)
    there = [kind for kind in KINDS if kind in kinds or _has(before, bag, folder, kind)]
    row: Row = {
        'bag': bag,
        'error': '',
        'truncated': str(result.truncated or ''),
        'results': ' '.join(f'{name}.{kind}' for kind in there),
        'frames': result.frames,
        'estimates': result.estimates,
        'start': result.first / 1e9,
        'end': result.last / 1e9,
        'seconds': (result.last - result.first) / 1e9,
        'repeated': result.repeated,
        'late': result.late,
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
    _write_whole(about, json.dumps({'made_of': made_of, 'row': row}))
    return row


@contextmanager
def _alone(bag: str, folder: Path, wait: bool = True) -> Iterator[None]:
    """
    Keep other runs, of any process, off the results of a bag; in the end no parts are left of them.

    Raises BlockingIOError when another run is at them and this one is not to `wait`.
    """
    place = folder / f'{_name(bag)}.part'
    while True:
        with open(place, 'ab') as held:
            try:
                fcntl.flock(held, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                raise
            except OSError:
                pass  # a file system without locks
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
                    place.unlink(missing_ok=True)
                return


def _remove_parts(bag: str, folder: Path) -> None:
    """Remove what is left of results that were not finished, of this run or of one before."""
    for kind in (*KINDS, 'json'):
        with suppress(OSError):
            (folder / f'{_name(bag)}.{kind}.part').unlink()


def _finished(
    bag: str, folder: Path, settings: Settings, topic: str | None, kinds: list[str]
) -> Row | None:
    """The row of a bag whose results are there, made of the same bag with the same settings."""
    try:
        row = _told(bag, folder, _made_of(bag, settings, topic))
    except _EXPECTED:
        return None
    return row if all(_has(row, bag, folder, kind) for kind in kinds) else None


def _told(bag: str, folder: Path, made_of: list[Any]) -> Row | None:
    """The row of the results of a bag that are there, if they were made of this."""
    try:
        told = json.loads((folder / f'{_name(bag)}.json').read_text('utf-8'))
        row = told['row'] if told['made_of'] == made_of else None
    except (OSError, ValueError, LookupError, TypeError):
        return None
    return row if isinstance(row, dict) and row.get('bag') == bag else None


def _has(row: Row | None, bag: str, folder: Path, kind: str) -> bool:
    """Whether results of this kind are there and the row, if there is one, tells of them."""
    name = f'{_name(bag)}.{kind}'
    return row is not None and name in str(row.get('results')) and (folder / name).is_file()


def _ours(path: str, folder: Path) -> bool:
    """Whether it is a result of an earlier run into the folder of its bags, and no bag of these."""
    result = Path(path)
    if result.parent != folder:
        return False
    try:
        told = json.loads(result.with_suffix('.json').read_text('utf-8'))
        return _name(told['row']['bag']) == result.stem
    except (OSError, ValueError, LookupError, TypeError):
        return False


def _name(bag: str) -> str:
    """What the results of a bag are called: its own name, and a number that only its path has."""
    short = Path(bag).name.removesuffix('.zstd').removesuffix('.mcap')
    # A name of a file has 255 bytes, and there are endings to come.
    short = os.fsdecode(os.fsencode(short)[:_LONGEST_NAME])
    return f'{short}-{hashlib.sha256(os.fsencode(bag)).hexdigest()[:10]}'


def _made_of(bag: str, settings: Settings, topic: str | None) -> list[Any]:
    """All that the results depend on, such that equal is unchanged."""
    files = [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in bag_files(bag)]
    scene = Path(settings.scene)
    told = repr((__version__, topic, settings, files)).encode()
    if settings.scene and scene.is_file():
        told += scene.read_bytes()
    return [__version__, hashlib.sha256(told).hexdigest()]


def _write_summary(path: Path, rows: list[Row]) -> None:
    """One line a bag; a column for all that any of them has."""
    columns = dict.fromkeys(_FIRST) | dict.fromkeys(name for row in rows for name in row)
    text = StringIO(newline='')
    table = csv.DictWriter(text, list(columns))
    table.writeheader()
    table.writerows(rows)
    try:
        _write_whole(path, text.getvalue())
    except OSError as error:
        raise _unwritable(path, error) from None


def _write_whole(path: Path, text: str) -> None:
    part = path.with_name(f'{path.name}.part')
    try:
        # A file name need not be text.
        part.write_bytes(text.encode('utf-8', 'backslashreplace'))
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _unwritable(path: Path, error: OSError) -> BagError:
    return BagError(
        f'{path} cannot be written: {error.strerror}; '
        'mend: check the path, its rights and the space on the disk'
    )
