"""Messages of a bag of results: those of estimates, of the rig, and diagnostics of each second."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeAlias

import numpy as np

from kinpole_ros import messages
from kinpole_ros.bags._marker_frames import NODE_NAME
from kinpole_ros.findings import Finding
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.registered import RegisteredQuantity
from kinpole_ros.tracking.tracker import Tracker

RIG_TOPIC = f'/{NODE_NAME}/{messages.RIG}'
# Topic, type, log times (ns) and messages, as `BagWriter.write_many` takes them.
Column: TypeAlias = tuple[str, type, Sequence[int], Sequence[bytes]]
SECOND = 1_000_000_000  # ns


def result_columns(
    outputs: list[messages.Output], estimate: Estimate, prefix: str, log_times: np.ndarray
) -> Iterator[Column]:
    """Yield the messages of T instants under `prefix`, logged at `log_times` (T,), ns."""
    for output in outputs:
        instants, data = output.build(estimate)
        if data:
            yield output.under(prefix), output.message_type, log_times[instants].tolist(), data


class RigColumn:
    """What a reader of the results has to know, first of all, and where it has changed."""

    def __init__(self, registered: Sequence[RegisteredQuantity]) -> None:
        self._registered = registered
        self._changes = messages.RigChanges()
        # Of this block: the number of the frame with which each holds, the run where it is new, 0
        # else, and the message.
        self._found: list[tuple[int, int, bytes]] = []

    def begin(self, tracker: Tracker) -> None:
        """Describe the tracker before the frames of a block."""
        self._look(tracker, 0)

    def watch(self, parts: Iterable[MarkerFrames], tracker: Tracker) -> Iterator[MarkerFrames]:
        """Yield the parts, and describe the tracker after each."""
        frames_before = 0
        for frames in parts:
            yield frames
            frames_before += len(frames.stamps)
            self._look(tracker, frames_before - 1)

    def _look(self, tracker: Tracker, number: int) -> None:
        new_run = 0 if self._changes.is_of(tracker.run) else tracker.run
        data = self._changes.message(tracker, self._registered)
        if data is not None:
            self._found.append((number, new_run, data))

    def column(self, estimates: list[Estimate], log_times: np.ndarray) -> Column:
        """Return the messages of a block; those of a new run go before its first results."""
        first = {one.run: int(one.due[0]) for one in reversed(estimates)}
        numbers = [min(number, first.get(run, number)) for number, run, _ in self._found]
        data = [data for _, _, data in self._found]
        self._found = []
        return RIG_TOPIC, messages.String, log_times[numbers].tolist(), data


class PeriodicDiagnostics:
    """
    The diagnostics of each second of stamps, as of its last frame, as the node publishes them.

    `trouble` is what was found of the input, for the next diagnostics.
    """

    def __init__(self, maker: messages.DiagnosticsMaker) -> None:
        self.trouble: list[Finding] = []
        self._maker = maker
        self._last_stamp: int | None = None  # of the last diagnostics
        # The newest estimate, if the last diagnostics do not describe it.
        self._undescribed: Estimate | None = None
        # Diagnostics of this block: the number of their frame, and a function that makes them from
        # the estimate then.
        self._begun: list[tuple[int, Callable[[Estimate | None], messages.DiagnosticArray]]] = []

    def split(self, blocks: Iterable[MarkerFrames], tracker: Tracker) -> Iterator[MarkerFrames]:
        """
        Yield the frames in parts that end where a second has passed, for the tracker.

        The tracker takes a part before it asks for the next one, so diagnostics that begin after a
        part describe the tracker as of the end of that part.
        """
        frames_before = 0
        for frames in blocks:
            stamps, first = frames.stamps, 0
            while first < len(stamps):
                previous = stamps[first] - SECOND if self._last_stamp is None else self._last_stamp
                is_due = np.abs(stamps[first:] - previous) >= SECOND
                end = first + int(is_due.argmax()) + 1 if is_due.any() else len(stamps)
                yield part_of(frames, slice(first, end))
                if is_due.any():
                    self._begin(frames_before + end - 1, int(stamps[end - 1]), tracker)
                first = end
            frames_before += len(stamps)

    def _begin(self, number: int, stamp: int, tracker: Tracker) -> None:
        """Begin the diagnostics of the second that ends with the frame of this number."""
        seconds = 0.0 if self._last_stamp is None else (stamp - self._last_stamp) / SECOND
        self._begun.append((number, self._maker.begin(stamp, tracker, seconds, self.trouble)))
        self._last_stamp, self.trouble = stamp, []

    def column(self, estimates: list[Estimate], log_times: np.ndarray) -> Column:
        """Return the diagnostics of the frames just taken, from the estimates of these frames."""
        data = []
        previous_number = -1
        for number, finish in self._begun:
            newest, self._undescribed = self._undescribed, None
            for estimate in estimates:
                count_due = int(np.searchsorted(estimate.due, number, side='right'))
                if count_due and estimate.due[count_due - 1] > previous_number:
                    newest = estimate[count_due - 1]
            data.append(messages.serialize_message(finish(newest)))
            previous_number = number
        times = [int(log_times[number]) for number, _ in self._begun]
        self._begun = []
        # An estimate has one instant at least.
        if estimates and estimates[-1].due[-1] > previous_number:
            self._undescribed = estimates[-1][-1]
        return '/diagnostics', messages.DiagnosticArray, times, data
