"""
Workers of a batch: processes of this machine, reached through pipes, or a Dask cluster.

All of them take jobs the same way, as `Workers` says, and give back `concurrent.futures.Future`.
"""

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from kinpole_ros.bags import BagError

# What a job does: it takes the arguments of the job, and a function that it calls with the share
# of the job that is done, from 0 to 1.
Job = Callable[..., Any]
Arguments = tuple[Any, ...]
Progress = Callable[[float], None]

# Not 'forkserver', the default on Linux from Python 3.14 on: that one listens on a socket.
_CONTEXT = multiprocessing.get_context('spawn')
_SHARE, _RESULT, _ERROR = range(3)  # the kinds of message that a worker process sends


class Workers(Protocol):
    """What does the jobs of a batch."""

    count: int  # jobs that run at a time

    def submit(self, job: Job, arguments: Arguments, progress: Progress | None) -> Future[Any]:
        """Begin a job; `progress` is called, in any thread, with the share that is done."""


class _SameThreads:
    """One thread of this process, which sees the stores that live in its memory."""

    count = 1

    def __init__(self, threads: ThreadPoolExecutor) -> None:
        self._threads = threads

    def submit(self, job: Job, arguments: Arguments, progress: Progress | None) -> Future[Any]:
        return self._threads.submit(job, *arguments, progress or _ignore)


class _EndedError(Exception):
    """A worker process ended before its job did."""


class _Process:
    """A worker process and this end of its pipe."""

    def __init__(self) -> None:
        self.pipe, other_end = _CONTEXT.Pipe()
        # Not a daemon, which may start no processes of its own: the end of the pipe ends it.
        self.process = _CONTEXT.Process(target=_serve, args=(other_end,))
        with other_end, _interrupts_blocked():
            self.process.start()

    def run(self, job: Job, arguments: Arguments, progress: Progress | None) -> Any:
        """The result of a job. Raises what the job raises, and _EndedError if the process ends."""
        try:
            self.pipe.send((job, arguments))
            while (message := self.pipe.recv())[0] == _SHARE:
                if progress is not None:
                    progress(message[1])
        except (EOFError, OSError) as error:
            raise _EndedError from error
        if message[0] == _ERROR:
            raise message[1]
        return message[1]

    def end(self) -> None:
        # The pipe is left to the thread that may be reading it.
        self.process.kill()
        self.process.join()


class _Processes:
    """
    Worker processes. Each has a thread here, which waits for it at a pipe that nobody else can use.

    A process that dies costs the job it was at; the next job gets a new process.
    """

    def __init__(self, count: int, threads: ThreadPoolExecutor) -> None:
        self.count = count
        self._threads = threads
        self._lock = threading.Lock()
        self._closed = False
        self._all: set[_Process] = set()
        self._idle: SimpleQueue[_Process] = SimpleQueue()
        # It unblocks the signals that a process to be started should have blocked.
        with suppress(AttributeError):  # Windows has none
            resource_tracker.ensure_running()
        try:
            for _ in range(count):
                self._idle.put(self._start())
        except BaseException:
            self.close()
            raise

    def submit(self, job: Job, arguments: Arguments, progress: Progress | None) -> Future[Any]:
        return self._threads.submit(self._run, job, arguments, progress)

    def close(self) -> None:
        """End all processes, and with them the jobs that they are at."""
        with self._lock:
            self._closed = True
            processes, self._all = self._all, set()
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.end()

    def _start(self) -> _Process:
        with self._lock:
            if self._closed:
                raise BagError('the batch is stopped')
            try:
                process = _Process()
            except (OSError, RuntimeError) as error:
                raise BagError(
                    f'no worker processes can be started ({error}); fix: see to the memory and '
                    'the processes this machine has to spare, or give fewer --workers'
                ) from None
            self._all.add(process)
        return process

    def _run(self, job: Job, arguments: Arguments, progress: Progress | None) -> Any:
        try:
            process = self._idle.get_nowait()
        except Empty:
            process = self._start()
        try:
            result = process.run(job, arguments, progress)
        except _EndedError:
            with self._lock:
                self._all.discard(process)
            process.process.join()
            raise BagError(
                f'its worker process ended ({_reason(process.process.exitcode)}); fix: run the '
                'same command again, with fewer --workers if memory is short'
            ) from None
        except BaseException:
            self._idle.put(process)
            raise
        self._idle.put(process)
        return result


@contextmanager
def local_workers(count: int, here: bool = False) -> Iterator[Workers]:
    """
    So many worker processes of this machine, or with `here` one thread of this process.

    Raises BagError when no process can be started. Processes are killed at the end.
    """
    with ThreadPoolExecutor(1 if here else count) as threads:
        if here:
            try:
                yield _SameThreads(threads)
            finally:
                threads.shutdown(wait=False, cancel_futures=True)
            return
        processes = _Processes(count, threads)
        try:
            yield processes
        finally:
            processes.close()


def _serve(pipe: Connection) -> None:
    """Do the jobs that come through a pipe, until it is closed; runs in a worker process."""
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
    """Start processes that never see Ctrl-C, which a terminal sends to all; this one ends them."""
    if not hasattr(signal, 'pthread_sigmask'):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _reason(exit_code: int | None) -> str:
    if exit_code is None or exit_code >= 0:
        return f'exit status {exit_code}'
    with suppress(ValueError):
        return signal.Signals(-exit_code).name
    return f'signal {-exit_code}'


def _ignore(share: float) -> None:
    pass
