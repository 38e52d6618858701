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
from kinpole_ros.bags.batch._jobs import KINDS, Job, Row, bag_size, is_result
from kinpole_ros.bags.batch._workers import (
    Cluster,
    Share,
    Take,
    replay_here,
    replay_in_processes,
    replay_on_cluster,
)
from kinpole_ros.files import read_limited
from kinpole_ros.packages import install_command
from kinpole_ros.settings import Settings

__all__ = ['KINDS', 'Cluster', 'batch', 'listed_bags']

_MOST_LIST_BYTES = 64 << 20  # a hundred thousand paths of 600


def listed_bags(path: str | Path) -> list[str]:
    """
    Return the bags that a text names, one in each line; empty lines and those with # name none.

    Raises BagError if it cannot be read or names none, or names an address that leads to another
    one.
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
    kinds: Sequence[str] = ('mcap',),
    cluster: Cluster | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
    report: Callable[[Row], None] | None = None,
) -> list[Row]:
    """
    Replay bags into a folder, and write summary.csv there.

    Bags that are finished with the same settings are not done again, and one that fails does not
    stop the others. An interruption leaves what is finished, and a summary of it.

    Parameters
    ----------
    bags : sequence of str or Path
        Files, folders, or URLs of any store that fsspec knows, which the worker fetches.
    output : str or Path
        A folder or the URL of one. Results are called after the bag and a number made of its whole
        path. Those of more than 10,000 bags lie in subfolders named by two digits.
    settings : Settings
        The parameters, for all bags.
    kinds : sequence of str
        The results of each bag: 'mcap', 'csv', 'parquet'.
    cluster : Cluster, optional
        A Dask cluster whose workers have this package and see the same files.
    workers : int, optional
        Without a cluster, the number of processes here, which nobody else can reach; the number
        of cores by default. Without Dask, bags are replayed in this process.
    progress : callable, optional
        Called with the share done of what was not finished before, by bytes.
    report : callable, optional
        Called with each row as it comes.

    Returns
    -------
    list of dict
        A row of the summary for each bag, in the order of `bags`, without results of earlier runs
        among them. 'error' says why a bag failed, 'truncated' where it was cut off, 'unknown'
        which bodies were never estimated.

    Raises
    ------
    BagError
        If there is no worker, or the output cannot be written.
    """
    folder = ResultFolder(output)
    jobs = _make_jobs(folder, bags, settings, kinds)
    rows: dict[str, Row] = {}
    try:
        _add_rows(rows, folder, jobs, cluster, workers, progress, report)
    finally:
        # Bags that were finished while we were being stopped count too.
        listed = [rows.get(job.bag) or folder.finished(job) for job in jobs]
        summary = [row for row in listed if row is not None]
        folder.write_summary(summary)
    return summary


def _make_jobs(
    folder: ResultFolder, bags: Sequence[str | Path], settings: Settings, kinds: Sequence[str]
) -> list[Job]:
    """Return a job for each bag, and prepare the folder for their results."""
    paths = _bags_to_replay(bags, folder.root, kinds)
    if settings.scene and Path(settings.scene).is_file():
        settings = replace(settings, scene=os.path.abspath(settings.scene))
    folder.prepare(len(paths))
    kinds = [kind for kind in KINDS if kind in kinds]
    return [folder.job(path, settings, kinds) for path in paths]


def _bags_to_replay(
    bags: Sequence[str | Path], root: Path | str, kinds: Sequence[str]
) -> list[str]:
    """Return the names of bags, once each, without the results of earlier runs."""
    paths = list(dict.fromkeys(map(absolute, bags)))
    if isinstance(root, str):
        return paths
    paths = [path for path in paths if _store.is_url(path) or not is_result(path, root)]
    if not paths:
        raise BagError(f'all bags named are results of earlier runs in {root}; name others')
    if 'mcap' in kinds and str(root) in paths and not (root / 'metadata.yaml').exists():
        raise BagError(
            f'{root} is a bag to be replayed, and results would become a part of it, which is '
            'all .mcap files of its folder; name another folder for the results'
        )
    return paths


def _add_rows(
    rows: dict[str, Row],
    folder: ResultFolder,
    jobs: list[Job],
    cluster: Cluster | None,
    workers: int | None,
    progress: Callable[[float], None] | None,
    report: Callable[[Row], None] | None,
) -> None:
    """Add the rows of bags that are finished, and of the others as they come."""
    lock = threading.Lock()  # of `progress` and `report`, which are called in several threads

    def add(job: Job, row: Row) -> None:
        rows[job.bag] = row
        if report is not None:
            with lock:
                report(row)

    def take(number: int, row: Row) -> None:
        share(number, 1.0)
        add(waiting[number], row_in_folder(waiting[number], row))

    for job in jobs:
        if (row := folder.finished(job)) is not None:
            add(job, row)
    if waiting := [job for job in jobs if job.bag not in rows]:
        share = _share_of_all([bag_size(job.bag) for job in waiting], progress, lock)
        if cluster is None:
            _replay_on_this_machine(waiting, workers, take, share)
        else:
            replay_on_cluster(waiting, cluster, take, share)


def _replay_on_this_machine(jobs: list[Job], workers: int | None, take: Take, share: Share) -> None:
    """Replay the bags in processes, or in this one where it must be."""
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


def _share_of_all(
    sizes: list[int], progress: Callable[[float], None] | None, lock: threading.Lock
) -> Share:
    """Return a function of the share done of one bag that reports that of all, by bytes."""
    done, done_of_all, total = [0] * len(sizes), 0, sum(sizes)
    if progress is not None:
        progress(0.0)

    def share(number: int, fraction: float) -> None:
        nonlocal done_of_all
        size = int(fraction * sizes[number])
        with lock:
            # A share of a bag may arrive after its end.
            if size > done[number]:
                done_of_all += size - done[number]
                done[number] = size
                if progress is not None:
                    progress(done_of_all / total)

    return share
