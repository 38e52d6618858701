"""
Workers of a Dask cluster, by the address of its scheduler.

Whoever reaches a scheduler can run code on its workers, so the address should be one of TLS.
"""

import asyncio
import logging
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from kinpole_ros.bags import BagError
from kinpole_ros.bags.batch._workers import Arguments, Job, Progress, Workers
from kinpole_ros.packages import install_command

_CONNECT_TIMEOUT = 30  # s, for a scheduler to answer and for its first worker to be there
_TOPIC = 'kinpole'  # of the events by which Dask workers tell their progress
_TLS = ('tls', 'wss')  # Dask's protocols in which both ends show certificates


@dataclass(frozen=True)
class TlsFiles:
    """
    Paths of PEM files by which this machine and a Dask cluster know each other.

    Those that are None are as Dask's own configuration has them (distributed.comm.tls).
    """

    ca: str | None = None
    certificate: str | None = None
    key: str | None = None


def is_open_to_all(scheduler: str) -> bool:
    """Whether anyone who reaches this address of a Dask scheduler can run code on its workers."""
    protocol, separator, _ = scheduler.partition('://')
    return not separator or protocol not in _TLS


class _ClusterWorkers:
    """The workers of a Dask client."""

    def __init__(self, client: Any) -> None:
        self.count = max(1, len(client.nthreads()))
        self._executor = client.get_executor(pure=False)
        # Other batches may use the same cluster.
        self._batch = uuid.uuid4().hex
        self._progress: list[Progress | None] = []
        client.subscribe_topic(_TOPIC, self._hear)

    def submit(self, job: Job, arguments: Arguments, progress: Progress | None) -> Future[Any]:
        number = len(self._progress)
        self._progress.append(progress)
        future: Future[Any] = self._executor.submit(_run, job, arguments, (self._batch, number))
        return future

    def _hear(self, event: tuple[Any, tuple[str, int, float]]) -> None:
        batch, number, share = event[1]
        progress = self._progress[number] if batch == self._batch else None
        if progress is not None:
            progress(share)


@contextmanager
def cluster_workers(scheduler: str, tls: TlsFiles | None = None) -> Iterator[Workers]:
    """
    Connect to a Dask cluster by the address of its scheduler.

    Raises BagError when there is no Dask, no scheduler that answers, or no worker. Jobs that have
    begun go on when the connection ends, those that wait are given up.
    """
    try:
        from distributed import Client
    except ImportError:
        fix = install_command('cluster')
        raise BagError(f'--scheduler needs Dask; fix: {fix}') from None
    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    try:
        client = Client(scheduler, timeout=_CONNECT_TIMEOUT, security=_security(tls))
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
        yield _ClusterWorkers(client)


def _security(tls: TlsFiles | None) -> Any:
    """Dask's settings of TLS; None leaves all to its configuration."""
    if tls is None or tls == TlsFiles():
        return None
    from distributed import Security

    named = {
        'tls_ca_file': tls.ca,
        'tls_client_cert': tls.certificate,
        'tls_client_key': tls.key,
    }
    given = {name: path for name, path in named.items() if path is not None}
    return Security(require_encryption=True, **given)


def _run(job: Callable[..., Any], arguments: Arguments, known_as: tuple[str, int]) -> Any:
    """Do a job in a Dask worker, which tells its progress as an event."""
    from distributed import get_worker

    worker = get_worker()
    return job(*arguments, lambda share: worker.log_event(_TOPIC, (*known_as, share)))
