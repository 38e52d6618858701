"""
Many bags replayed, on the cores of this machine or on a Dask cluster, and a table over all.

Each result gets its name only when it is complete, with a small file next to it that says what it
was made of. So a run that was stopped goes on where it was, and a bag that fails costs only itself.
"""

import logging
import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from kinpole_ros.bags import BagError
from kinpole_ros.bags.batch import _store
from kinpole_ros.bags.batch._folder import ResultFolder, absolute, row_in_folder
from kinpole_ros.bags.batch._results import KINDS, Job, Row, bag_size, is_result
from kinpole_ros.bags.batch._workers import (
    Share,
    Take,
    TlsFiles,
    is_open_to_all,
    replay_here,
    replay_in_processes,
    replay_on_cluster,
)
from kinpole_ros.files import read_limited
from kinpole_ros.packages import install_command
from kinpole_ros.settings import Settings

__all__ = ['KINDS', 'TlsFiles', 'batch', 'is_open_to_all', 'listed_bags']

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
        of cores by default. Without Dask, bags are replayed in this process.
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
    bar = _Progress(progress)

    def add(job: Job, row: Row) -> None:
        rows[job.bag] = row
        if report is not None:
            with bar.lock:
                report(row)

    def take(number: int, row: Row) -> None:
        bar.take(number, 1.0)
        add(waiting[number], row_in_folder(waiting[number], row))

    try:
        for job in jobs:
            if (row := folder.finished(job)) is not None:
                add(job, row)
        if waiting := [job for job in jobs if job.bag not in rows]:
            bar.begin([bag_size(job.bag) for job in waiting])
            _run(waiting, scheduler, workers, tls, take, bar.take)
    finally:
        # Bags that were finished while we were being stopped count too.
        listed = [rows.get(job.bag) or folder.finished(job) for job in jobs]
        summary = [row for row in listed if row is not None]
        folder.write_summary(summary)
    return summary


def _run(
    jobs: list[Job],
    scheduler: str | None,
    workers: int | None,
    tls: TlsFiles | None,
    take: Take,
    share: Share,
) -> None:
    """Replay the bags on a cluster or here, and call `take` with the row of each as it comes."""
    if scheduler is not None:
        replay_on_cluster(jobs, scheduler, tls, take, share)
        return
    count = min(workers or os.cpu_count() or 1, len(jobs))
    has_dask = find_spec('dask') is not None
    if count > 1 and not has_dask:
        logging.getLogger(__name__).warning(
            'bags are replayed one after another, since Dask, which uses all cores, is not '
            'installed; fix: %s',
            install_command('batch'),
        )
    # No other process has access to what is in the memory of this one.
    if has_dask and not any(_store.is_in_memory(path) for j in jobs for path in (j.bag, j.root)):
        replay_in_processes(jobs, count, take, share)
    else:
        replay_here(jobs, take, share)


class _Progress:
    """
    The share done of all bags by bytes, from the share done of each.

    Shares come in other threads, which hold the `lock` while they report.
    """

    def __init__(self, progress: Callable[[float], None] | None) -> None:
        self.lock = threading.Lock()
        self._progress = progress or (lambda share: None)

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
