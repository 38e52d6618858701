"""The diagnostics of each second of a replay, as the node would have published them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeAlias

import numpy as np

from kinpole_ros.messages import DiagnosticArray, DiagnosticsMaker, serialize_message
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.tracker import Tracker

_SECOND = 1_000_000_000  # ns
# Topic, type, log times (ns) and messages, as `BagWriter.write_many` takes them.
Column: TypeAlias = tuple[str, type, Sequence[int], Sequence[bytes]]


class PeriodicDiagnostics:
    """
    Diagnostics of each second of stamps, as of its last frame, out of long parts of a bag.

    `trouble` names what is wrong, for the next. While `silent` none are made.
    """

    def __init__(self, maker: DiagnosticsMaker) -> None:
        self.trouble: dict[str, str] = {}
        self.silent = False
        self._maker = maker
        self._last: int | None = None
        # Of the frames since the last diagnostics.
        self._latest: Estimate | None = None
        # Number of the frame, and what is to be finished with the estimate of that time.
        self._begun: list[tuple[int, Callable[[Estimate | None], DiagnosticArray]]] = []

    def parts(self, given: Iterable[MarkerFrames], tracker: Tracker) -> Iterator[MarkerFrames]:
        """The frames in parts that end where a second has passed, for the tracker to take."""
        before = 0
        for frames in given:
            stamps, first = frames.stamps, 0
            while first < len(stamps):
                previous = stamps[first] - _SECOND if self._last is None else self._last
                over = np.abs(stamps[first:] - previous) >= _SECOND
                end = first + int(over.argmax()) + 1 if over.any() else len(stamps)
                yield part_of(frames, slice(first, end))
                if over.any():
                    stamp = int(stamps[end - 1])
                    seconds = 0.0 if self._last is None else (stamp - self._last) / _SECOND
                    if not self.silent:
                        begun = self._maker.begin(stamp, tracker, seconds, self.trouble)
                        self._begun.append((before + end - 1, begun))
                    self._last, self.trouble = stamp, {}
                first = end
            before += len(stamps)

    def columns(self, known: list[Estimate], log_times: np.ndarray) -> Iterator[Column]:
        """What these seconds have to say; `known` are the estimates of the same frames."""
        data = []
        published = -1
        for number, finish in self._begun:
            now, self._latest = self._latest, None
            for estimate in known:
                due = int(np.searchsorted(estimate.due, number, side='right'))
                if due and estimate.due[due - 1] > published:
                    now = estimate[due - 1]
            data.append(serialize_message(finish(now)))
            published = number
        at = [int(log_times[number]) for number, _ in self._begun]
        yield '/diagnostics', DiagnosticArray, at, data
        self._begun = []
        if known and known[-1].due[-1] > published:
            self._latest = known[-1][-1]
