"""
Replay a bag of markers through the tracker of the live node, into a bag or a table of results.

As in the live node, results come `lag` behind the markers. There are none of the last `lag`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import TypeAlias

import numpy as np

from kinpole_ros import messages
from kinpole_ros.bags import _replayed
from kinpole_ros.bags._bag_reader import Progress
from kinpole_ros.bags._bag_writer import BagWriter
from kinpole_ros.bags._files import BagError, Truncated, bag_files, in_place_of
from kinpole_ros.bags._marker_frames import NODE_NAME, frame_blocks, input_topic
from kinpole_ros.bags._repeated_frames import FEWEST_REPEATS, conversion_fault
from kinpole_ros.bags._replayed import Replayed
from kinpole_ros.bags._tables import TABLES
from kinpole_ros.findings import ERROR, Finding
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.registered import RegisteredQuantity
from kinpole_ros.tracking.rejection import HELD
from kinpole_ros.tracking.space import updated
from kinpole_ros.tracking.tracker import Tracker

_SECOND = 1_000_000_000  # ns
# Films are converted to 60 Hz at most; repeats of other recordings are found where they are exact.
_LEAST_FILM_INTERVAL = 15_000_000  # ns
_FILM_FRAMES = 1200  # by which it is found, 20 s at 60 Hz: all of a long bag takes memory
_RIG_TOPIC = f'/{NODE_NAME}/{messages.RIG}'
# Topic, type, log times (ns) and messages, as `BagWriter.write_many` takes them.
Column: TypeAlias = tuple[str, type, Sequence[int], Sequence[bytes]]


def replay(
    bag: str | Path,
    settings: Settings,
    output: str | Path | None = None,
    csv: str | Path | None = None,
    topic: str | None = None,
    progress: Progress | None = None,
    parquet: str | Path | None = None,
    take: Callable[[Estimate], None] | None = None,
) -> Replayed:
    """
    Run the markers of a bag through the tracker, as fast as the machine goes.

    It is deterministic: the bag's stamps drive everything. Results replace the files of earlier
    ones when they are complete.

    Parameters
    ----------
    bag : str or Path
        An .mcap or .db3 file or a rosbag2 folder. One that is cut off gives the results of all that
        is before the cut.
    settings : Settings
        The parameters.
    output : str or Path, optional
        An .mcap file for the results, under /kinpole/....
    csv, parquet : str or Path, optional
        Files for tables of the results.
    topic : str, optional
        The topic of the markers, instead of the settings' one.
    progress : callable, optional
        Called with the fraction of bytes read, 0 to 1.
    take : callable, optional
        Called with the estimates of consecutive instants.

    Returns
    -------
    Replayed

    Raises
    ------
    BagError
        If the bag, its topic or an output cannot be used.

    """
    source = input_topic(bag, settings, topic)
    named = {'mcap': output, 'csv': csv, 'parquet': parquet}
    targets = {kind: path for kind, path in named.items() if path is not None}
    _check_targets(bag, targets)
    replaying = _Replaying(bag, settings, source)
    with ExitStack() as stack:
        files = {kind: stack.enter_context(in_place_of(path)) for kind, path in targets.items()}
        return replaying.run(files, targets, progress, take)


def replay_into(
    bag: str | Path,
    settings: Settings,
    files: Mapping[str, Path],
    progress: Progress | None = None,
) -> Replayed:
    """
    Replay a bag into files by kind: 'mcap', 'csv', 'parquet'.

    Files are written where they are, while `replay` moves them there when they are complete.
    """
    source = input_topic(bag, settings, None)
    return _Replaying(bag, settings, source).run(files, files, progress, None)


def _check_targets(bag: str | Path, targets: Mapping[str, str | Path]) -> None:
    """Raise BagError where results would replace the bag, each other, or become a part of it."""
    labels = {'mcap': 'the bag of results', 'csv': 'the CSV table', 'parquet': 'the Parquet table'}
    uses = {_file_id(file): 'the bag to be replayed' for file in bag_files(bag)}
    # Without metadata all files of a folder are the bag.
    folder = None if (Path(bag) / 'metadata.yaml').exists() else Path(bag).resolve()
    for kind, target in targets.items():
        file_id, path = _file_id(Path(target)), Path(target).resolve()
        if file_id in uses:
            raise BagError(f'{target} is {uses[file_id]}; name another file for the results')
        if path.parent == folder and path.suffix == '.mcap':
            raise BagError(
                f'{target} would be a part of the bag to be replayed, which is all .mcap files of '
                'its folder; name a file in another folder for the results'
            )
        uses[file_id] = labels[kind]


def _file_id(path: Path) -> tuple[int, int] | Path:
    """Return a value that is equal for all names of one file, also for hard links."""
    try:
        about = path.stat()
    except OSError:
        return path.resolve()
    return about.st_dev, about.st_ino


def _unlisted_files(bag: str | Path) -> list[str]:
    """Return the names of files that are read as one bag only because they share a folder."""
    files = bag_files(bag)
    is_listed = not Path(bag).is_dir() or (Path(bag) / 'metadata.yaml').exists()
    return [] if is_listed or len(files) < 2 else [file.name for file in files]


def _keep_freed_memory() -> None:
    """
    Have glibc reuse freed memory instead of returning it to the system: a tenth of the time.

    It keeps freed blocks up to the size of the largest one that was freed so far, but returns those
    of 32 MiB and larger at once. So freeing one block just below that is enough.
    """
    np.empty(31 << 20, np.uint8)


class _Replaying:
    """A replay of a bag; `source` is the topic and the kind of its messages."""

    def __init__(self, bag: str | Path, settings: Settings, source: tuple[str, str]) -> None:
        self._bag, self._settings = bag, settings
        self._topic, self._kind = source
        theory = self._positions = None
        if settings.scene:
            # Imported only with a scene: it takes longer than a short replay.
            from kinpole_ros.linkage.positions import Positions
            from kinpole_ros.linkage.theory import load_theory

            theory = load_theory(settings)
            self._positions = Positions(theory.scene, theory.matches)
        self._tracker = Tracker(settings)
        self._reader = messages.reader_of(self._kind, settings)
        self._registered = theory.quantities(tuple(settings.bodies)) if theory else []
        self._outputs = messages.outputs_of(settings, theory)
        compare = theory.comparison() if theory else None
        self._rig = _RigColumn(self._registered)
        self._diagnostics = _PeriodicDiagnostics(
            messages.DiagnosticsMaker(NODE_NAME, compare, self._topic)
        )
        self._outcome = _replayed.begin(settings, self._tracker)
        self._space_stamp = 0  # ns, at which the outcome has how the motion lies in space

    def run(
        self,
        files: Mapping[str, str | Path],
        names: Mapping[str, str | Path],
        progress: Progress | None,
        take: Callable[[Estimate], None] | None,
    ) -> Replayed:
        """Replay into files by kind; `names` are their names in messages of errors."""
        _keep_freed_memory()
        outcome = self._outcome
        with ExitStack() as stack:
            writer = None
            if 'mcap' in files:
                writer = stack.enter_context(BagWriter(files['mcap'], name=names['mcap']))
                self._add_topics(writer)
            takers = [
                stack.enter_context(
                    table(files[kind], self._settings, names[kind], self._registered)
                )
                for kind, table in TABLES.items()
                if kind in files
            ]
            takers += [take] if take is not None else []
            has_readers_of_events = writer is not None or bool(takers)
            blocks = frame_blocks(self._bag, self._topic, self._kind, self._reader, progress)
            for frames, log_times, error in blocks:
                if error is not None:
                    self._add_error(error)
                if not frames:
                    continue
                for estimate in self._track(frames, log_times, writer, has_readers_of_events):
                    _replayed.add_estimate(outcome, estimate)
                    if self._positions is not None:
                        self._positions.append(estimate)
                    for add in takers:
                        add(estimate)
            if isinstance(self._reader, messages.PoseReader):
                outcome.pose_fault = self._reader.fault()
            else:
                outcome.drawings = self._reader.fault()
            self._check_frames()
        outcome.concatenated = _unlisted_files(self._bag)
        if self._positions is not None:
            outcome.scene_positions = self._positions.report()
        outcome.converted = self._converted()
        return _replayed.finish(outcome, self._tracker)

    def _converted(self) -> Finding | None:
        """Return how frames repeat others, as of a film whose rate was changed, if they do."""
        counts, outcome = self._tracker.update_counts(), self._outcome
        is_slow = outcome.last - outcome.first > _LEAST_FILM_INTERVAL * counts['frames']
        is_held = counts[HELD] >= FEWEST_REPEATS
        if not is_held and not is_slow:
            return None
        reader = messages.reader_of(self._kind, self._settings)
        parts: list[MarkerFrames] = []
        for frames, _, _ in frame_blocks(self._bag, self._topic, self._kind, reader, None):
            parts += frames
            if not is_held and sum(len(part.stamps) for part in parts) > _FILM_FRAMES:
                break
        return conversion_fault(str(self._bag), parts)

    def _add_topics(self, writer: BagWriter) -> None:
        """Have all topics in the bag of results, also those without messages."""
        writer.add_topic(_RIG_TOPIC, messages.String, is_latched=True)
        for output in self._outputs:
            writer.add_topic(output.under(f'/{NODE_NAME}'), output.message_type)
        writer.add_topic('/diagnostics', messages.DiagnosticArray)

    def _add_error(self, error: Exception) -> None:
        if isinstance(error, Truncated):
            self._outcome.truncated = error
            return
        if isinstance(error, messages.NoMarkersError):
            self._outcome.empty += 1
            return
        self._tracker.count('unreadable')
        self._outcome.problem = self._outcome.problem or str(error)
        about = {'problem': str(error)}
        self._diagnostics.trouble = [Finding('unreadable_message', '', about, ERROR)]

    def _track(
        self,
        frames: list[MarkerFrames],
        log_times: np.ndarray,
        writer: BagWriter | None,
        has_readers_of_events: bool,
    ) -> Sequence[Estimate]:
        """Track a block of frames, and return its estimates and write their messages, if any."""
        for part in frames:
            _replayed.add_frames(self._outcome, part)
        parts: Iterable[MarkerFrames] = frames
        if writer is not None:
            self._rig.begin(self._tracker)
            parts = self._diagnostics.split(frames, self._tracker)
            parts = self._rig.watch(parts, self._tracker)
        order = self._settings.highest_order
        estimates = self._tracker.add_parts(parts, order, has_readers_of_events)
        if self._outcome.last - self._space_stamp >= _SECOND:
            self._space_stamp = self._outcome.last
            self._outcome.space = updated(self._outcome.space, self._tracker.space())
        if writer is not None:
            writer.write_many(self._messages(estimates, log_times))
        return estimates

    def _messages(self, estimates: list[Estimate], log_times: np.ndarray) -> list[Column]:
        """Return messages, logged with the frames with which their estimates fell due."""
        columns = [
            result_columns(self._outputs, estimate, f'/{NODE_NAME}', log_times[estimate.due])
            for estimate in estimates
        ]
        rig = self._rig.column(estimates, log_times)
        return [rig, *chain(*columns), self._diagnostics.column(estimates, log_times)]

    def _check_frames(self) -> None:
        """Raise BagError if no message could be read, or none has poses of the bodies."""
        counts, outcome = self._tracker.update_counts(), self._outcome
        if counts['frames']:
            return
        if counts['unreadable']:
            raise BagError(
                f'{self._bag}: no message on {self._topic} can be read: {outcome.problem}'
            )
        if outcome.empty:
            raise BagError(
                f'{self._bag}: no message on {self._topic} has markers; fix: see that the tracker '
                'sees them, or name another topic with --topic'
            )
        if outcome.pose_fault is not None:
            raise BagError(f'{self._bag}: on {self._topic} {outcome.pose_fault.words()}')


def result_columns(
    outputs: list[messages.Output], estimate: Estimate, prefix: str, log_times: np.ndarray
) -> Iterator[Column]:
    """Yield the messages of T instants under `prefix`, logged at `log_times` (T,), ns."""
    for output in outputs:
        instants, data = output.build(estimate)
        if data:
            yield output.under(prefix), output.message_type, log_times[instants].tolist(), data


class _RigColumn:
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
        return _RIG_TOPIC, messages.String, log_times[numbers].tolist(), data


class _PeriodicDiagnostics:
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
                previous = stamps[first] - _SECOND if self._last_stamp is None else self._last_stamp
                is_due = np.abs(stamps[first:] - previous) >= _SECOND
                end = first + int(is_due.argmax()) + 1 if is_due.any() else len(stamps)
                yield part_of(frames, slice(first, end))
                if is_due.any():
                    self._begin(frames_before + end - 1, int(stamps[end - 1]), tracker)
                first = end
            frames_before += len(stamps)

    def _begin(self, number: int, stamp: int, tracker: Tracker) -> None:
        """Begin the diagnostics of the second that ends with the frame of this number."""
        seconds = 0.0 if self._last_stamp is None else (stamp - self._last_stamp) / _SECOND
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
