"""
Many bags replayed, on the cores of this machine or on a Dask cluster, and a table over all.

Dask does the work of spreading; here is what makes a run of days bearable: each result appears
under its name only when it is whole, with a small file next to it that says what it was made of,
so that a run that was stopped goes on where it was, and a bag that fails costs only itself.
"""

import os
import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from kinpole_ros.bags import BagError, bag_files
from kinpole_ros.bags.batch._cluster import cluster
from kinpole_ros.bags.batch._results import (
    EXPECTED,
    KINDS,
    Row,
    alone,
    finished,
    is_result,
    replay_bag,
    unwritable,
    write_summary,
)
from kinpole_ros.pipeline.parameters import Settings

__all__ = ['KINDS', 'batch']

_TOPIC = 'kinpole'  # of Dask's events


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
    bodies never estimated ('unknown'), and why it failed ('error'). A failed bag does not stop
    the rest; `report` is called with each row as it comes, `progress` with the share done of what
    was left to do, by bytes. Rows are in the order of `bags`, without results of earlier runs
    among them. Raises BagError when there is no Dask, no scheduler, or no place to write. An
    interruption leaves what is finished, and a summary of it.
    """
    folder = Path(os.path.abspath(output))
    paths = [
        path for path in dict.fromkeys(map(os.path.abspath, bags)) if not is_result(path, folder)
    ]
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
        raise unwritable(folder, error) from None
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
        all_rows = [
            rows.get(path) or finished(path, folder, settings, topic, kinds) for path in paths
        ]
        listed = [row for row in all_rows if row is not None]
        write_summary(folder / 'summary.csv', listed)
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
        row = finished(bag, folder, settings, topic, kinds)
        if row is None:
            left.append(bag)
        else:
            yield row
    if not left:
        return
    try:
        with cluster(scheduler, min(workers or os.cpu_count() or 1, len(left))) as client:
            from distributed import as_completed

            if bar is not None:
                bar.begin([_size(bag) for bag in left])
                client.subscribe_topic(_TOPIC, lambda event: bar.take(*event[1]))
            jobs: dict[Any, int] = {}
            for number, bag in enumerate(left):
                known_as = None if bar is None else (bar.run, number)
                job = (bag, folder, settings, topic, kinds)
                jobs[client.submit(_work, job, known_as, pure=False)] = number
            for done in as_completed(jobs):
                bag = left[jobs[done]]
                error = done.exception()
                if bar is not None:
                    bar.take(bar.run, jobs[done], 1.0)
                if error is None:
                    yield done.result()
                else:  # a worker that died, or one without this package; or a fault of ours
                    text = ' '.join(f'{type(error).__name__}: {error}'.split())
                    yield {'bag': bag, 'error': text}
    finally:
        # Workers of our own are gone; others go on with what they began, and finish it.
        if scheduler is None:
            for bag in left:
                with suppress(OSError), alone(bag, folder, wait=False):
                    pass


def _work(
    job: tuple[str, Path, Settings, str | None, list[str]], known_as: tuple[str, int] | None
) -> Row:
    """`replay_bag` in a worker, telling how far it is to whoever has the bag `known_as` this."""
    if known_as is None:
        return replay_bag(*job)
    from distributed import get_worker

    worker = get_worker()
    return replay_bag(*job, lambda share: worker.log_event(_TOPIC, (*known_as, share)))


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
            # What was reported of a bag before its end may arrive after it.
            if done > self._done[number]:
                self._sum += done - self._done[number]
                self._done[number] = done
                self._progress(self._sum / self._whole)


def _size(bag: str) -> int:
    """Bytes of a bag, 1 at least."""
    try:
        return max(1, sum(file.stat().st_size for file in bag_files(bag)))
    except EXPECTED:
        return 1
