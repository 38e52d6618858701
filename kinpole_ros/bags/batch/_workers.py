"""
Where the bags of a batch are replayed: here, in processes of this machine, or on a Dask cluster.

The last two are schedulers of Dask for one map over the bags. Dask's local cluster would listen on
a port at which any user of the machine could run code, so the processes are reached through pipes.
"""

import asyncio
import logging
import multiprocessing
import os
import signal
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from kinpole_ros.bags import BagError
from kinpole_ros.bags.batch._jobs import Job, Row, alone, replay_bag
from kinpole_ros.packages import install_command

# Called with the number of a job, and with its row or with the share of it that is done.
Take = Callable[[int, Row], None]
Share = Callable[[int, float], None]

# Not 'forkserver', the default on Linux from Python 3.14 on: that one listens on a socket.
_CONTEXT = multiprocessing.get_context('spawn')
_CONNECT_TIMEOUT = 30  # s, for a scheduler to answer and for its first worker to connect
_CHECK_INTERVAL = 5.0  # s between two looks whether a cluster has workers
_TOPIC = 'kinpole'  # of the events by which Dask workers report the share done
_DIED = (
    'its worker process ended; fix: run the same command again, with fewer --workers if memory is '
    'short'
)
_TLS = ('tls', 'wss')  # Dask's protocols in which both ends show certificates


def replay_here(jobs: Sequence[Job], take: Take, share: Share) -> None:
    """Replay the bags in this process, one after another."""
    for number, job in enumerate(jobs):
        take(number, replay_bag(job, partial(share, number)))


def replay_in_processes(jobs: Sequence[Job], workers: int, take: Take, share: Share) -> None:
    """
    Replay the bags in worker processes of this machine.

    A process that dies takes Dask's pool with it. Those bags that had begun are then tried again,
    each by itself, so that one that ends its process costs only itself. Raises BagError where no
    process can be started.
    """
    left = dict(enumerate(jobs))

    def finish(number: int, row: Row) -> None:
        del left[number]
        take(number, row)

    while left:
        begun: set[int] = set()
        try:
            _replay_in_pool(left, workers, finish, share, begun)
            return
        except BrokenProcessPool:
            # A process that dies at its start has begun none.
            for number in sorted(begun & left.keys()) or [*left][:1]:
                try:
                    _replay_in_pool({number: jobs[number]}, 1, finish, share, set())
                except BrokenProcessPool:
                    finish(number, {'bag': jobs[number].bag, 'error': _DIED})


def _replay_in_pool(
    jobs: Mapping[int, Job], workers: int, take: Take, share: Share, begun: set[int]
) -> None:
    """Replay bags by number in a pool of processes; adds those that began to `begun`."""
    from dask.callbacks import Callback

    rows = _mapped(jobs, _send_share)
    shares, shares_end = _CONTEXT.Pipe(duplex=False)
    life_end, life = _CONTEXT.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, _CONTEXT, _begin_worker, (shares_end, life_end))
    left = set(jobs)

    def take_rows(task: Any, result: Any, *state: Any) -> None:
        # Dask names its tasks, and adds others, as it likes. A row may come twice.
        for done in result if isinstance(result, list) else ():
            if isinstance(done, Done) and done.number in left:
                left.remove(done.number)
                take(*done)

    def read_shares() -> None:
        with suppress(EOFError):
            while True:
                number, done = shares.recv()
                begun.add(number)
                share(number, done)

    reader = threading.Thread(target=read_shares, daemon=True)
    try:
        _start(pool, workers)
        reader.start()
        with Callback(posttask=take_rows):
            rows.compute(scheduler='processes', pool=pool, chunksize=1)
    finally:
        # The end of its pipe ends a worker, also in the middle of a bag.
        life.close()
        shares_end.close()
        pool.shutdown(cancel_futures=True)
        if reader.ident is not None:
            reader.join()
        for number in begun & left:
            if not isinstance(jobs[number].root, str):
                with suppress(OSError), alone(jobs[number], wait=False):
                    pass  # it removes unfinished parts


def _mapped(jobs: Mapping[int, Job], share: Share) -> Any:
    """Return the bag of Dask with the numbers and rows of the jobs, one in each partition."""
    from dask import bag

    return bag.from_sequence([*jobs.items()], npartitions=len(jobs)).map(_replay, share=share)


class Done(NamedTuple):
    """The row of the job of this number."""

    number: int
    row: Row


def _replay(numbered: tuple[int, Job], share: Share) -> Done:
    """Replay a bag in a worker."""
    number, job = numbered
    share(number, 0.0)
    return Done(number, replay_bag(job, partial(share, number)))


def _start(pool: ProcessPoolExecutor, workers: int) -> None:
    """Start the processes, which ignore Ctrl-C: a terminal sends it to all, and this one ends."""
    try:
        with _interrupts_blocked():
            for _ in range(workers):
                pool.submit(int)
    except (OSError, RuntimeError) as error:
        raise BagError(
            f'no worker processes can be started ({error}); fix: see to the memory and the '
            'processes this machine has to spare, or give fewer --workers'
        ) from None


_shares: Connection | None = None  # of a worker process, to the one that started it


def _begin_worker(shares: Connection, life: Connection) -> None:
    """Keep the pipe for shares, and end with the other one; runs in a worker process."""
    global _shares
    _shares = shares

    def end() -> None:
        with suppress(EOFError, OSError):
            life.recv()
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()


def _send_share(number: int, done: float) -> None:
    if _shares is not None:
        _shares.send((number, done))


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    if not hasattr(signal, 'pthread_sigmask'):
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@dataclass(frozen=True)
class Cluster:
    """
    A Dask cluster, and PEM files by which this machine and the cluster identify each other.

    Files that are None are those in Dask's own configuration (distributed.comm.tls).
    """

    scheduler: str  # the address
    ca: str | None = None
    certificate: str | None = None
    key: str | None = None

    @property
    def is_open_to_all(self) -> bool:
        """Return whether anyone who reaches the scheduler can run code on its workers."""
        protocol, separator, _ = self.scheduler.partition('://')
        return not separator or protocol not in _TLS


def replay_on_cluster(jobs: Sequence[Job], cluster: Cluster, take: Take, share: Share) -> None:
    """
    Replay the bags on a Dask cluster.

    Bags that have begun go on when the connection ends, those that wait are given up. Raises
    BagError when there is no Dask, no scheduler that answers, or no worker.
    """
    with _client(cluster) as client:
        from distributed import as_completed

        topic = f'{_TOPIC}-{uuid.uuid4().hex}'  # other batches may use the same cluster
        client.subscribe_topic(topic, lambda event: share(*event[1]))
        rows = _mapped(dict(enumerate(jobs)), partial(_log_share, topic))
        futures = client.compute(rows.to_delayed())
        numbers = {future.key: number for number, future in enumerate(futures)}
        with _warning_without_workers(client):
            for future in as_completed(futures):
                number = numbers[future.key]
                # A worker that died, or one without this package.
                if future.status == 'error':
                    error = future.exception()
                    text = ' '.join(f'{type(error).__name__}: {error}'.split())
                    take(number, {'bag': jobs[number].bag, 'error': text})
                else:
                    (done,) = future.result()
                    take(*done)


def _log_share(topic: str, number: int, done: float) -> None:
    """Report the share of a bag in a Dask worker, as an event."""
    from distributed import get_worker

    get_worker().log_event(topic, (number, done))


@contextmanager
def _warning_without_workers(client: Any) -> Iterator[None]:
    """Warn while a cluster has no workers."""
    ended = threading.Event()

    def check() -> None:
        has_workers = True
        while not ended.wait(_CHECK_INTERVAL):
            with suppress(Exception):  # of a connection that is lost, the futures say more
                had_workers, has_workers = has_workers, bool(client.nthreads())
                if had_workers and not has_workers:
                    address = client.scheduler.address
                    logging.getLogger(__name__).warning(
                        'the Dask cluster has no worker; waiting for one: `dask worker %s`', address
                    )

    thread = threading.Thread(target=check, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()


@contextmanager
def _client(cluster: Cluster) -> Iterator[Any]:
    """Connect to a cluster; raises BagError where that fails, or the scheduler ends."""
    try:
        from distributed import Client, Security
        from distributed.comm import CommClosedError
    except ImportError:
        fix = install_command('cluster')
        raise BagError(f'--scheduler needs Dask; fix: {fix}') from None
    scheduler = cluster.scheduler
    files = {
        'tls_ca_file': cluster.ca,
        'tls_client_cert': cluster.certificate,
        'tls_client_key': cluster.key,
    }
    given = {name: path for name, path in files.items() if path is not None}
    # Without any, all is in Dask's configuration.
    security = Security(require_encryption=True, **given) if given else None
    for name in ('distributed', 'distributed.client', 'tornado.application'):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(scheduler, timeout=_CONNECT_TIMEOUT, security=security)
    except (OSError, ValueError, RuntimeError, TypeError, asyncio.TimeoutError) as error:
        raise BagError(
            f'no Dask scheduler answers at {scheduler} ({error}); fix: give the address that '
            '`dask scheduler` prints, such as tls://10.0.0.5:8786, and for tls:// the files that '
            'its machines use: --tls-ca, --tls-cert and --tls-key'
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_CONNECT_TIMEOUT)
        # That of asyncio is another one before Python 3.11.
        except (TimeoutError, asyncio.TimeoutError):
            raise BagError(
                f'the Dask scheduler at {scheduler} has no workers; fix: start some, with '
                f'`dask worker {scheduler}`'
            ) from None
        try:
            yield client
        except (CancelledError, CommClosedError) as error:
            if isinstance(error, CancelledError) and client.status == 'running':
                raise
            raise BagError(
                f'the Dask scheduler at {scheduler} ended; what is done is in the summary; fix: '
                'start it and its workers, and run the same command again'
            ) from None
