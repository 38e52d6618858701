"""Dask, which does the work of spreading: by processes of our own, or a cluster elsewhere."""

import logging
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from kinpole_ros.bags import BagError
from kinpole_ros.packages import install_command

_PATIENCE = 30  # s, for a scheduler and its first worker


@contextmanager
def cluster(scheduler: str | None, workers: int, here: bool = False) -> Iterator[Any]:
    """
    A client of the cluster at that address, or of processes of our own.

    `here`: of one thread of this process instead, which alone can see some stores.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise BagError(f'many bags need Dask; fix: {install_command("batch")}') from None
    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    if scheduler is None:
        try:
            with _interrupts_ignored():
                cluster = LocalCluster(
                    n_workers=1 if here else workers,
                    processes=not here,
                    threads_per_worker=1,
                    dashboard_address=None,
                    # It listens for browsers all the same: here, where nothing else does.
                    scheduler_kwargs={'dashboard_address': '127.0.0.1:0'},
                    silence_logs=logging.CRITICAL,
                )
        except (OSError, RuntimeError) as error:
            raise BagError(
                f'no worker processes can be started ({error}); fix: see to the memory and the '
                'processes this machine has to spare, and that /dev/shm, where there is one, can '
                'be written to; or give fewer --workers'
            ) from None
        with cluster, Client(cluster) as client:
            yield client
        return
    try:
        client = Client(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        raise BagError(
            f'no Dask scheduler answers at {scheduler} ({error}); fix: give the address that '
            '`dask scheduler` prints, such as tcp://10.0.0.5:8786'
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError:
            raise BagError(
                f'the Dask scheduler at {scheduler} has no workers; fix: start some, with '
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
