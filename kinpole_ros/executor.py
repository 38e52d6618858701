"""
How the node waits: for its markers alone, and every so often for all else.

rclpy looks at all that a node has, timers and a dozen services, whenever it waits: 0.2 ms of each
answer, where the whole of a plain relay's takes 0.6.
"""

import time

from rclpy.executors import SingleThreadedExecutor, TimeoutException

from kinpole_ros.source import MarkerSource

# s. All else has its turn after the first markers that come when this has passed, for then there is
# most time until the next; without any when as much again has passed.
_EVERY = 0.05


class MarkersFirst(SingleThreadedExecutor):
    """Runs a node whose markers come from `source`."""

    def __init__(self, source: MarkerSource) -> None:
        super().__init__()
        self._source = source
        self._due = 0.0

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Take markers, or run all else that is ready; without markers as rclpy's does."""
        if not self._source.found:
            super().spin_once(timeout_sec)
            return
        left = self._due + _EVERY - time.monotonic()
        if left > 0:
            came = self._source.wait(left if timeout_sec is None else min(left, timeout_sec))
            if not came or time.monotonic() < self._due:
                return
        self._due = time.monotonic() + _EVERY
        try:
            while True:
                run, _, _ = self.wait_for_ready_callbacks(timeout_sec=0)
                run()
                run.result()
        except TimeoutException:
            pass
