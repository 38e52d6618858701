"""Memory that the library works in belongs to its caller, and is freed with it."""

import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from kinpole_ros import track
from kinpole_ros.derivatives import Poses, Windows, derive_poses

MEMORY = Path('/proc/self/statm')
FRAMES, MIDDLE, STEP = 160, 100, 5_000_000
TIME = np.arange(FRAMES) * STEP
# A rate that steps by 20 rad/s, so that events are searched.
ANGLE = 20 * np.maximum(TIME - TIME[MIDDLE], 0) * 1e-9
ANGLE += np.random.default_rng(1).normal(scale=1e-3, size=FRAMES)

pytestmark = pytest.mark.skipif(not MEMORY.exists(), reason='needs /proc')


def derive() -> None:
    still, known = np.zeros((FRAMES, 1)), np.ones((FRAMES, 1))
    poses = Poses(TIME, ANGLE[:, None], still, still + 0j, known, known)
    windows = Windows(*(np.array([k]) for k in (MIDDLE, 40, FRAMES - 1)))
    derive_poses(poses, windows, np.zeros((1, 1), int), np.full((1, 1), 1e-3), 0.6, 4)


def track_markers() -> None:
    arms = np.exp(1j * (ANGLE[:, None] + np.arange(3)))
    points = np.stack((arms.real, arms.imag), axis=-1)
    track(points + 1e-4 * np.sin(1e3 * points), TIME, bodies={'crank': [0, 1, 2]})


def grown_bytes(work: Callable[[], None], threads: int) -> int:
    """Return how much the second of two equal rows of threads adds to the memory of this process.

    The first row fills what is kept for all of them: tables, and the arenas of malloc.
    """

    def run_threads() -> int:
        for _ in range(threads):
            thread = threading.Thread(target=work)
            thread.start()
            thread.join()
        return int(MEMORY.read_text(encoding='ascii').split()[1]) * 4096

    before = run_threads()
    return run_threads() - before


@pytest.mark.parametrize(('work', 'threads'), [(derive, 120), (track_markers, 10)])
def test_threads_that_end_leave_no_memory(work: Callable[[], None], threads: int) -> None:
    """Each left 0.3 to 5 MB while memory belonged to threads."""
    # In a process of its own: what other tests have left would be collected and filled meanwhile.
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as processes:
        assert processes.submit(grown_bytes, work, threads).result(timeout=300) < 10e6
