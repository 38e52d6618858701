"""
Many bags replayed, on the cores of this machine or on a Dask cluster, and a table over all.

Each result appears under its name only when it is whole, with a small file next to it that says
what it was made of. So a run that was stopped goes on where it was, and a bag that fails costs
only itself.
"""

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from kinpole_ros.bags import BagError, bag_files
from kinpole_ros.bags.batch import _store
from kinpole_ros.bags.batch._cluster import TlsFiles, cluster_workers, is_open_to_all
from kinpole_ros.bags.batch._divided import assemble, replay_stretch, ways
from kinpole_ros.bags.batch._places import Places, absolute
from kinpole_ros.bags.batch._results import (
    EXPECTED,
    KINDS,
    Row,
    alone,
    is_result,
    replay_bag,
)
from kinpole_ros.bags.batch._workers import local_workers
from kinpole_ros.files import read_limited
from kinpole_ros.tracking.parameters import Settings

__all__ = ['KINDS', 'TlsFiles', 'batch', 'is_open_to_all', 'listed_bags']

# Bags that wait for each worker: the scheduler of a cluster slows down under more.
_AHEAD = 8
_MOST_LISTED = 64 << 20  # bytes: a hundred thousand paths of 600


def listed_bags(path: str | Path) -> list[str]:
    """
    The bags named by a file, one a line; empty lines and those that begin with # name none.

    Raises BagError when it cannot be read or names none.
    """
    try:
        lines = os.fsdecode(read_limited(path, _MOST_LISTED)).split('\n')
    except OSError as error:
        raise BagError(
            f'{path} cannot be read: {error.strerror}; fix: give a file that names a bag a line'
        ) from None
    names = [line.strip() for line in lines if line.strip() and not line.startswith('#')]
    if not names:
        raise BagError(f'{path} names no bags; fix: write the path of a bag in each line')
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
    Replay every bag into the folder `output` and write summary.csv there; returns its rows.

    `kinds` are what is written of each bag: 'mcap', 'csv', 'parquet', as replay does. Results are
    called after the bag and a number made of its whole path, so bags of one name do not meet.
    `scheduler` is the address of a Dask scheduler whose workers have this package and see the
    same files; `tls` are the files by which both know each other, where Dask's configuration does
    not name them. Without a scheduler, `workers` processes here (as many as cores) do the work,
    and listen to nobody but this one. Bags that are finished with the same settings are not done
    again.

    Bags and `output` may be URLs of any store that fsspec knows; a bag is then fetched to the disk
    of its worker, and results are sent from there. Of more than 10,000 bags results lie in folders
    of `output` named by two digits.

    A row has the bag and its results, frames, estimates, the span of time, noise, resets, what
    was unreadable, the share of instants with each pole, where the bag was cut off ('truncated'),
    bodies never estimated ('unknown'), and why it failed ('error'). A failed bag does not stop
    the rest; `report` is called with each row as it comes, `progress` with the share done of what
    was left to do, by bytes. Rows are in the order of `bags`, without results of earlier runs
    among them. Raises BagError when no worker or no place to write is there. An
    interruption leaves what is finished, and a summary of it.
    """
    places = Places(output)
    folder = places.folder
    paths = list(dict.fromkeys(map(absolute, bags)))
    if isinstance(folder, Path):
        paths = [path for path in paths if _store.is_url(path) or not is_result(path, folder)]
    if not paths:
        raise BagError(f'all bags named are results of earlier runs in {folder}; name others')
    places.divide(len(paths))
    alone_in = isinstance(folder, Path) and not (folder / 'metadata.yaml').exists()
    if 'mcap' in kinds and alone_in and str(folder) in paths:
        raise BagError(
            f'{folder} is a bag to be replayed, and results would become a part of it, which is '
            'all .mcap files of its folder; name another folder for the results'
        )
    if settings.scene and Path(settings.scene).is_file():
        settings = replace(settings, scene=os.path.abspath(settings.scene))
    kinds = [kind for kind in KINDS if kind in kinds]
    places.prepare()
    rows: dict[str, Row] = {}
    bar = None if progress is None else _Progress(progress)
    try:
        for row in _rows(paths, places, settings, topic, kinds, scheduler, workers, bar, tls):
            rows[row['bag']] = row
            if report is not None:
                with nullcontext() if bar is None else bar.lock:
                    report(row)
    finally:
        # What was finished while we were being stopped counts too.
        all_rows = [
            rows.get(path) or places.finished(path, settings, topic, kinds) for path in paths
        ]
        listed = [row for row in all_rows if row is not None]
        places.write_summary(listed)
    return listed


def _rows(
    bags: list[str],
    places: Places,
    settings: Settings,
    topic: str | None,
    kinds: list[str],
    scheduler: str | None,
    workers: int | None,
    bar: '_Progress | None',
    tls: TlsFiles | None,
) -> Iterator[Row]:
    """The row of each bag as it comes: first those that are there, then those made now."""
    left = []
    for bag in bags:
        row = places.finished(bag, settings, topic, kinds)
        if row is None:
            left.append(bag)
        else:
            yield row
    if not left:
        return
    most = workers or os.cpu_count() or 1
    divided = ways(left, places.folder, settings, most) if scheduler is None else [1] * len(left)
    jobs: dict[Future[Any], int] = {}
    futures: dict[int, list[Future[Any]]] = {}

    def job(number: int) -> tuple[str, Any, Settings, str | None, list[str]]:
        return left[number], places.home(left[number]), settings, topic, kinds

    if scheduler is None:
        here = any(map(_store.lives_in_this_process, (*left, places.folder)))
        started = local_workers(min(most, sum(divided)), here)
    else:
        started = cluster_workers(scheduler, tls)
    try:
        with ExitStack() as held, started as crew:
            if bar is not None:
                bar.begin([_size(bag) for bag in left])

            def begin(number: int) -> None:
                progress = None if bar is None else partial(bar.take, number)
                stretches = divided[number]
                if stretches > 1:
                    try:
                        held.enter_context(alone(*job(number)[:2], wait=False))
                    except BlockingIOError:
                        stretches = 1  # its worker waits for the other run
                if stretches == 1:
                    begun = [crew.submit(replay_bag, job(number), progress)]
                else:
                    last = stretches - 1  # it has the longest way
                    begun = [
                        crew.submit(
                            replay_stretch,
                            (*job(number), k, stretches),
                            progress if k == last else None,
                        )
                        for k in range(stretches)
                    ]
                futures[number] = begun
                jobs.update(dict.fromkeys(begun, number))

            waiting = iter(range(len(left)))
            for number in islice(waiting, _AHEAD * crew.count):
                begin(number)
            while jobs:
                for done in wait(jobs, return_when=FIRST_COMPLETED).done:
                    number = jobs.pop(done)
                    if number in jobs.values():
                        continue
                    for following in islice(waiting, 1):
                        begin(following)
                    if bar is not None:
                        bar.take(number, 1.0)
                    yield places.as_seen(_row(job(number), futures.pop(number)))
    finally:
        # Workers of our own are gone; others go on with what they began, and finish it.
        if scheduler is None:
            for number in set(jobs.values()):
                home = places.home(left[number])
                if isinstance(home, Path):
                    with suppress(OSError), alone(left[number], home, wait=False):
                        pass


def _row(job: tuple[str, Any, Settings, str | None, list[str]], futures: list[Future[Any]]) -> Row:
    """The row of a bag of which all is done."""
    errors = [error for error in (future.exception() for future in futures) if error is not None]
    try:
        if not errors:
            results = [future.result() for future in futures]
            return results[0] if len(results) == 1 else assemble(*job, results)
    except EXPECTED as error:
        errors = [error]
    text = str(errors[0])
    if not isinstance(errors[0], EXPECTED):
        # A worker that died, or one without this package; or a fault of ours.
        text = f'{type(errors[0]).__name__}: {text}'
    return {'bag': job[0], 'error': ' '.join(text.split())}


class _Progress:
    """
    The share done of all bags by bytes, from the share done of each.

    Shares come in other threads, which hold the `lock` while they report.
    """

    def __init__(self, progress: Callable[[float], None]) -> None:
        self.lock = threading.Lock()
        self._progress = progress

    def begin(self, sizes: list[int]) -> None:
        self._sizes, self._whole = sizes, sum(sizes)
        self._done, self._sum = [0] * len(sizes), 0
        self._progress(0.0)

    def take(self, number: int, share: float) -> None:
        with self.lock:
            done = int(share * self._sizes[number])
            # What was reported of a bag before its end may arrive after it.
            if done > self._done[number]:
                self._sum += done - self._done[number]
                self._done[number] = done
                self._progress(self._sum / self._whole)


def _size(bag: str) -> int:
    """Bytes of a bag, 1 at least."""
    try:
        if _store.is_url(bag):
            return max(1, _store.size(bag))
        return max(1, sum(file.stat().st_size for file in bag_files(bag)))
    except EXPECTED:
        return 1
