"""
Workers of a batch: processes of this machine, or a Dask cluster.

Dask's local cluster would listen on a port at which any user of the machine could run code. A
`ProcessPoolExecutor` fails all of its jobs when one process dies, has no messages of progress, and
leaves its processes running when it is killed. So processes here are reached through pipes.
"""

import asyncio
import logging
import multiprocessing
import os
import signal
import threading
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from kinpole_ros.bags import BagError
from kinpole_ros.packages import install_command

# The function of a job takes its arguments, and a function to call with the share done, 0 to 1.
Job = Callable[..., Any]
Arguments = tuple[Any, ...]
Progress = Callable[[float], None]

# Not 'forkserver', the default on Linux from Python 3.14 on: that one listens on a socket.
_CONTEXT = multiprocessing.get_context('spawn')
_SHARE, _RESULT, _ERROR = range(3)  # the kinds of message that a worker process sends
_CONNECT_TIMEOUT = 30  # s, for a scheduler to answer and for its first worker to connect
_TOPIC = 'kinpole'  # of the events by which Dask workers report their progress
_TLS = ('tls', 'wss')  # Dask's protocols in which both ends show certificates


class Workers(Protocol):
    """Runs the jobs of a batch."""

    count: int  # jobs that run at a time

    def submit(self, job: Job, arguments: Arguments, progress: Progress | None) -> Future[Any]:
        """Begin a job; `progress` is called, in any thread, with the share that is done."""

    def trouble(self) -> str:
        """Return what keeps all jobs waiting; '' for nothing."""


class _LocalWorkers:
    """Worker processes, with a thread here for each; or one thread of this process."""

    def __init__(
        self, threads: ThreadPoolExecutor, processes: '_Processes | None', count: int
    ) -> None:
        self.count = count
        self._threads, self._processes = threads, processes

    def submit(self, job: Job, arguments: Arguments, progress: Progress | None) -> Future[Any]:
        if self._processes is None:
            return self._threads.submit(job, *arguments, progress or _ignore)
        return self._threads.submit(self._processes.run, job, arguments, progress)

    def trouble(self) -> str:
        return ''


class _Processes:
    """
    Worker processes at pipes that nobody else can use.

    A process that dies costs the job it was at; the next job gets a new process.
    """

    def __init__(self, count: int) -> None:
        self._lock = threading.Lock()
        self._is_closed = False
        self._started: set[Any] = set()
        self._idle: SimpleQueue[tuple[Any, Connection]] = SimpleQueue()
        # Its start unblocks the signals that a process to be started should have blocked.
        with suppress(AttributeError):  # Windows has none
            resource_tracker.ensure_running()
        try:
            for _ in range(count):
                self._idle.put(self._start())
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End all processes, and with them their jobs."""
        with self._lock:
            self._is_closed = True
            processes, self._started = self._started, set()
        for process in processes:
            # Its pipe is closed by the thread that may be reading it.
            process.kill()
            process.join()

    def _start(self) -> tuple[Any, Connection]:
        with self._lock:
            if self._is_closed:
                raise BagError('the batch is stopped')
            try:
                pipe, other_end = _CONTEXT.Pipe()
                # The end of the pipe ends it. A daemon could start no processes of its own.
                process = _CONTEXT.Process(target=_serve, args=(other_end,))
                with other_end, _interrupts_blocked():
                    process.start()
            except (OSError, RuntimeError) as error:
                raise BagError(
                    f'no worker processes can be started ({error}); fix: see to the memory and '
                    'the processes this machine has to spare, or give fewer --workers'
                ) from None
            self._started.add(process)
        return process, pipe

    def run(self, job: Job, arguments: Arguments, progress: Progress | None) -> Any:
        """Return the result of a job, run by an idle process; raises what the job raises."""
        try:
            process, pipe = self._idle.get_nowait()
        except Empty:
            process, pipe = self._start()
        try:
            pipe.send((job, arguments))
            while (message := pipe.recv())[0] == _SHARE:
                if progress is not None:
                    progress(message[1])
        except (EOFError, OSError):
            with self._lock:
                self._started.discard(process)
            process.join()
            raise BagError(
                f'its worker process ended ({_reason(process.exitcode)}); fix: run the '
                'same command again, with fewer --workers if memory is short'
            ) from None
        self._idle.put((process, pipe))
        kind, value = message
        if kind == _ERROR:
            raise value
        return value


@contextmanager
def local_workers(count: int, here: bool = False) -> Iterator[Workers]:
    """
    Start so many worker processes of this machine, which are killed at the end.

    With `here` it is one thread of this process, which has access to its memory. Raises BagError
    when no process can be started.
    """
    with ThreadPoolExecutor(1 if here else count) as threads:
        processes = None if here else _Processes(count)
        try:
            yield _LocalWorkers(threads, processes, 1 if here else count)
        finally:
            threads.shutdown(wait=False, cancel_futures=True)
            if processes is not None:
                processes.close()


def _end_with_parent() -> None:
    """End this process with the one that started it, in the middle of a job too."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _serve(pipe: Connection) -> None:
    """Run the jobs that come through a pipe, until it is closed; runs in a worker process."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            job, arguments = pipe.recv()
            try:
                message = _RESULT, job(*arguments, lambda share: pipe.send((_SHARE, share)))
            except Exception as error:
                message = _ERROR, error
            try:
                pipe.send(message)
            except OSError:
                raise
            except Exception:  # an error that cannot be pickled
                pipe.send((_ERROR, RuntimeError(f'{type(message[1]).__name__}: {message[1]}')))


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Start processes that ignore Ctrl-C, which a terminal sends to all; this one ends them."""
    if not hasattr(signal, 'pthread_sigmask'):
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _reason(exit_code: int | None) -> str:
    if exit_code is None or exit_code >= 0:
        return f'exit status {exit_code}'
    with suppress(ValueError):
        return signal.Signals(-exit_code).name
    return f'signal {-exit_code}'


def _ignore(share: float) -> None:
    pass


@dataclass(frozen=True)
class TlsFiles:
    """
    PEM files by which this machine and a Dask cluster identify each other.

    Attributes
    ----------
    ca, certificate, key : str or None
        Paths; None for those in Dask's own configuration (distributed.comm.tls).

    """

    ca: str | None = None
    certificate: str | None = None
    key: str | None = None


def is_open_to_all(scheduler: str) -> bool:
    """
    Return whether anyone who reaches a scheduler can run code on its workers.

    Parameters
    ----------
    scheduler : str
        The address of a Dask scheduler.

    Returns
    -------
    bool
        Whether it is not one of TLS.

    """
    protocol, separator, _ = scheduler.partition('://')
    return not separator or protocol not in _TLS


class _ClusterWorkers:
    """The workers of a Dask client."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self.count = max(1, len(client.nthreads()))
        self._executor = client.get_executor(pure=False)
        # Other batches may use the same cluster.
        self._batch = uuid.uuid4().hex
        self._progress: list[Progress | None] = []
        client.subscribe_topic(_TOPIC, self._on_progress)

    def submit(self, job: Job, arguments: Arguments, progress: Progress | None) -> Future[Any]:
        number = len(self._progress)
        self._progress.append(progress)
        future: Future[Any] = self._executor.submit(_run, job, arguments, (self._batch, number))
        return future

    def _on_progress(self, event: tuple[Any, tuple[str, int, float]]) -> None:
        batch, number, share = event[1]
        progress = self._progress[number] if batch == self._batch else None
        if progress is not None:
            progress(share)

    def trouble(self) -> str:
        if self._client.nthreads():
            return ''
        address = self._client.scheduler.address
        return f'the Dask cluster has no worker; waiting for one: `dask worker {address}`'


def _run(job: Job, arguments: Arguments, job_id: tuple[str, int]) -> Any:
    """Run a job in a Dask worker, which reports its progress as an event."""
    from distributed import get_worker

    worker = get_worker()
    return job(*arguments, lambda share: worker.log_event(_TOPIC, (*job_id, share)))


@contextmanager
def cluster_workers(scheduler: str, tls: TlsFiles | None = None) -> Iterator[Workers]:
    """
    Connect to a Dask cluster by the address of its scheduler.

    Raises BagError when there is no Dask, no scheduler that answers, or no worker. Jobs that have
    begun go on when the connection ends, those that wait are given up.
    """
    try:
        from distributed import Client, Security
    except ImportError:
        fix = install_command('cluster')
        raise BagError(f'--scheduler needs Dask; fix: {fix}') from None
    security = None  # all is in Dask's configuration
    if tls is not None and tls != TlsFiles():
        files = {
            'tls_ca_file': tls.ca,
            'tls_client_cert': tls.certificate,
            'tls_client_key': tls.key,
        }
        given = {name: path for name, path in files.items() if path is not None}
        security = Security(require_encryption=True, **given)
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
            yield _ClusterWorkers(client)
        # Dask's own error of a lost connection is an OSError.
        except (CancelledError, OSError):
            if client.status == 'running':
                raise
            raise BagError(
                f'the Dask scheduler at {scheduler} ended; what is done is in the summary; fix: '
                'start it and its workers, and run the same command again'
            ) from None
