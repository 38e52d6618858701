"""
Many bags replayed, on the cores of this machine or on a Dask cluster, and a table over all.

Each result gets its name only when it is complete, with a small file next to it that says what it
was made of. So a run that was stopped goes on where it was, and a bag that fails costs only itself.
"""

import logging
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from kinpole_ros.bags import BagError
from kinpole_ros.bags.batch import _store
from kinpole_ros.bags.batch._folder import ResultFolder, absolute, row_in_folder
from kinpole_ros.bags.batch._results import (
    EXPECTED,
    KINDS,
    Job,
    Row,
    alone,
    bag_size,
    is_result,
    join_parts,
    replay_bag,
    replay_part,
    stretch_counts,
)
from kinpole_ros.bags.batch._workers import (
    TlsFiles,
    Workers,
    cluster_workers,
    is_open_to_all,
    local_workers,
)
from kinpole_ros.files import read_limited
from kinpole_ros.settings import Settings

__all__ = ['KINDS', 'TlsFiles', 'batch', 'is_open_to_all', 'listed_bags']

_QUEUED = 8  # bags for each worker: the scheduler of a cluster slows down under more
_CHECK_INTERVAL = 5.0  # s without a result, after which to see whether there are workers
_MOST_LIST_BYTES = 64 << 20  # a hundred thousand paths of 600


def listed_bags(path: str | Path) -> list[str]:
    """
    Return the bags that a file names.

    Parameters
    ----------
    path : str or Path
        A text with a bag in each line; empty lines and those that begin with # name none.

    Returns
    -------
    list of str

    Raises
    ------
    BagError
        If it cannot be read or names none, or names an address that leads to another one.

    """
    try:
        lines = os.fsdecode(read_limited(path, _MOST_LIST_BYTES)).split('\n')
    except OSError as error:
        raise BagError(
            f'{path} cannot be read: {error.strerror}; fix: give a file that names a bag a line'
        ) from None
    names = [line.strip() for line in lines if line.strip() and not line.startswith('#')]
    if not names:
        raise BagError(f'{path} names no bags; fix: write the path of a bag in each line')
    if around := next(filter(_store.is_around_files, names), ''):
        raise BagError(
            f'{path}: {around} is a file of this machine, or one store in another; fix: write the '
            'path, or name the bag on the command line'
        )
    return names


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
    tls: TlsFiles | None = None,
) -> list[Row]:
    """
    Replay bags into a folder, and write summary.csv there.

    Bags that are finished with the same settings are not done again, and one that fails does not
    stop the others. An interruption leaves what is finished, and a summary of it.

    Parameters
    ----------
    bags : sequence of str or Path
        Files, folders, or URLs of any store that fsspec knows, which are fetched to the disk of the
        worker.
    output : str or Path
        A folder or the URL of one. Results are called after the bag and a number made of its whole
        path. Those of more than 10,000 bags lie in subfolders named by two digits.
    settings : Settings
        The parameters, for all bags.
    topic : str, optional
        The topic of the markers, instead of the settings' one.
    kinds : sequence of str
        The results of each bag: 'mcap', 'csv', 'parquet'.
    scheduler : str, optional
        The address of a Dask scheduler whose workers have this package and see the same files.
    workers : int, optional
        Without a scheduler, the number of processes here, which nobody else can reach; the number
        of cores by default.
    progress : callable, optional
        Called with the share done of what was not finished before, by bytes.
    report : callable, optional
        Called with each row as it comes.
    tls : TlsFiles, optional
        For a scheduler at tls://, where Dask's configuration does not name them.

    Returns
    -------
    list of dict
        A row for each bag, in the order of `bags`, without results of earlier runs among them: the
        bag and its results, frames, estimates, the span of time, noise, resets, what was
        unreadable, the share of instants with each pole, where the bag was cut off ('truncated'),
        bodies never estimated ('unknown'), and why it failed ('error').

    Raises
    ------
    BagError
        If there is no worker, or the output cannot be written.

    """
    paths = list(dict.fromkeys(map(absolute, bags)))
    folder = ResultFolder(output)
    root = folder.root
    if isinstance(root, Path):
        paths = [path for path in paths if _store.is_url(path) or not is_result(path, root)]
    if not paths:
        raise BagError(f'all bags named are results of earlier runs in {root}; name others')
    is_bag = isinstance(root, Path) and str(root) in paths
    if 'mcap' in kinds and is_bag and not (Path(root) / 'metadata.yaml').exists():
        raise BagError(
            f'{root} is a bag to be replayed, and results would become a part of it, which is '
            'all .mcap files of its folder; name another folder for the results'
        )
    if settings.scene and Path(settings.scene).is_file():
        settings = replace(settings, scene=os.path.abspath(settings.scene))
    kinds = [kind for kind in KINDS if kind in kinds]
    folder.prepare(len(paths))
    jobs = [folder.job(path, settings, topic, kinds) for path in paths]
    rows: dict[str, Row] = {}
    bar = None if progress is None else _Progress(progress)
    try:
        for job in jobs:
            if (row := folder.finished(job)) is not None:
                rows[job.bag] = row
                _report(report, row, bar)
        waiting = [job for job in jobs if job.bag not in rows]
        for row in _run(waiting, scheduler, workers, bar, tls) if waiting else ():
            rows[row['bag']] = row
            _report(report, row, bar)
    finally:
        # Bags that were finished while we were being stopped count too.
        listed = [rows.get(job.bag) or folder.finished(job) for job in jobs]
        summary = [row for row in listed if row is not None]
        folder.write_summary(summary)
    return summary


def _report(report: Callable[[Row], None] | None, row: Row, bar: '_Progress | None') -> None:
    if report is not None:
        with nullcontext() if bar is None else bar.lock:
            report(row)


def _run(
    jobs: list[Job],
    scheduler: str | None,
    workers: int | None,
    bar: '_Progress | None',
    tls: TlsFiles | None,
) -> Iterator[Row]:
    """Run jobs on a cluster or here, and yield the row of each as it comes."""
    if scheduler is not None:
        return _rows(jobs, [1] * len(jobs), cluster_workers(scheduler, tls), bar)
    most = workers or os.cpu_count() or 1
    counts = stretch_counts(jobs, most)
    in_memory = any(_store.is_in_memory(path) for job in jobs for path in (job.bag, job.root))
    return _rows(jobs, counts, local_workers(min(most, sum(counts)), in_memory), bar, is_local=True)


def _rows(
    jobs: list[Job],
    counts: list[int],
    started: AbstractContextManager[Workers],
    bar: '_Progress | None',
    is_local: bool = False,
) -> Iterator[Row]:
    """Submit jobs, those of long bags in stretches, and yield the row of each as it comes."""
    numbers: dict[Future[Any], int] = {}
    try:
        with ExitStack() as locks, started as crew:
            yield from _submit(jobs, counts, crew, bar, locks, numbers)
    finally:
        # Local workers were killed and leave parts; those of a cluster finish their jobs.
        if is_local:
            for number in set(numbers.values()):
                if isinstance(jobs[number].root, Path):
                    with suppress(OSError), alone(jobs[number], wait=False):
                        pass


def _submit(
    jobs: list[Job],
    counts: list[int],
    crew: Workers,
    bar: '_Progress | None',
    locks: ExitStack,
    numbers: dict[Future[Any], int],
) -> Iterator[Row]:
    """Keep the crew busy; `numbers` are those of the jobs of the futures that are not done."""
    futures: dict[int, list[Future[Any]]] = {}
    fingerprints: dict[int, list[Any]] = {}  # of bags in stretches, as they were at the begin
    waiting = iter(range(len(jobs)))
    if bar is not None:
        bar.begin([bag_size(job.bag) for job in jobs])

    def begin(number: int) -> None:
        job, count = jobs[number], counts[number]
        progress = None if bar is None else partial(bar.take, number)
        if count > 1:
            try:
                fingerprints[number] = job.fingerprint()
                locks.enter_context(alone(job, wait=False))
            except EXPECTED:
                count = 1  # its worker reports an error, or waits for another run at the bag
        if count == 1:
            futures[number] = [crew.submit(replay_bag, (job,), progress)]
        else:
            # The last stretch takes the longest.
            futures[number] = [
                crew.submit(replay_part, (job, k, count), progress if k == count - 1 else None)
                for k in range(count)
            ]
        numbers.update(dict.fromkeys(futures[number], number))

    for number in islice(waiting, _QUEUED * crew.count):
        begin(number)
    trouble = ''
    while numbers:
        completed = wait(numbers, _CHECK_INTERVAL, return_when=FIRST_COMPLETED).done
        before, trouble = trouble, '' if completed else crew.trouble()
        if trouble != before and trouble:
            logging.getLogger(__name__).warning('%s', trouble)
        for done in completed:
            number = numbers.pop(done)
            if number in numbers.values():
                continue
            for following in islice(waiting, 1):
                begin(following)
            if bar is not None:
                bar.take(number, 1.0)
            row = _row(jobs[number], fingerprints.get(number), futures.pop(number))
            yield row_in_folder(jobs[number], row)


def _row(job: Job, fingerprint: list[Any] | None, futures: list[Future[Any]]) -> Row:
    """Return the row of a bag of which all is done; in stretches, with its fingerprint before."""
    errors = [error for future in futures if (error := future.exception()) is not None]
    try:
        if not errors:
            results = [future.result() for future in futures]
            if len(results) == 1 or fingerprint is None:
                row: Row = results[0]
                return row
            return join_parts(job, fingerprint, results)
    except EXPECTED as error:
        errors = [error]
    text = str(errors[0])
    if not isinstance(errors[0], EXPECTED):
        # A worker that died, or one without this package; or a fault of ours.
        text = f'{type(errors[0]).__name__}: {text}'
    return {'bag': job.bag, 'error': ' '.join(text.split())}


class _Progress:
    """
    The share done of all bags by bytes, from the share done of each.

    Shares come in other threads, which hold the `lock` while they report.
    """

    def __init__(self, progress: Callable[[float], None]) -> None:
        self.lock = threading.Lock()
        self._progress = progress

    def begin(self, sizes: list[int]) -> None:
        self._sizes, self._total = sizes, sum(sizes)
        self._done, self._sum = [0] * len(sizes), 0
        self._progress(0.0)

    def take(self, number: int, share: float) -> None:
        with self.lock:
            done = int(share * self._sizes[number])
            # A share of a bag may arrive after its end.
            if done > self._done[number]:
                self._sum += done - self._done[number]
                self._done[number] = done
                self._progress(self._sum / self._total)
