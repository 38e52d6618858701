"""
Replay a bag of markers through the tracker of the live node, into a bag or a table of results.

As in the live node, results come `lag` behind the markers. There are none of the last `lag`. A bag
that is known as a whole is read twice: to learn from it, then for results, of all its frames.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np

from kinpole_ros import messages
from kinpole_ros.bags import _replayed
from kinpole_ros.bags._bag_reader import Progress
from kinpole_ros.bags._bag_writer import BagWriter
from kinpole_ros.bags._files import BagError, Truncated, bag_files, in_place_of
from kinpole_ros.bags._marker_frames import NODE_NAME, FrameBlock, frame_blocks, input_topic
from kinpole_ros.bags._repeated_frames import FEWEST_REPEATS, conversion_fault
from kinpole_ros.bags._replayed import Replayed
from kinpole_ros.bags._result_columns import (
    RIG_TOPIC,
    SECOND,
    Column,
    PeriodicDiagnostics,
    RigColumn,
    result_columns,
)
from kinpole_ros.bags._tables import TABLES
from kinpole_ros.findings import ERROR, Finding
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.rejection import HELD
from kinpole_ros.tracking.space import updated
from kinpole_ros.tracking.tracker import Tracker, learn_recording

# The share of the time that the first of two readings takes, for its progress.
_LEARNING_SHARE = 0.2
# Films are converted to 60 Hz at most; repeats of other recordings are found where they are exact.
_LEAST_FILM_INTERVAL = 15_000_000  # ns
_FILM_FRAMES = 1200  # by which it is found, 20 s at 60 Hz: all of a long bag takes memory


def replay(
    bag: str | Path,
    settings: Settings,
    output: str | Path | None = None,
    csv: str | Path | None = None,
    topic: str | None = None,
    progress: Progress | None = None,
    parquet: str | Path | None = None,
    take: Callable[[Estimate], None] | None = None,
    whole: bool = False,
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
    whole : bool
        Whether what is learned up to the last frame is known at the first one.

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
    replaying = _Replaying(bag, settings, source, whole)
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
    Replay a bag, known as a whole, into files by kind: 'mcap', 'csv', 'parquet'.

    Files are written where they are, while `replay` moves them there when they are complete.
    """
    source = input_topic(bag, settings, None)
    return _Replaying(bag, settings, source, whole=True).run(files, files, progress, None)


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


def _part_of_progress(progress: Progress, first: float, last: float, share: float) -> None:
    """Report the share of a part of the work, which goes from `first` to `last` of it."""
    progress(first + share * (last - first))


class _Replaying:
    """A replay of a bag; `source` is the topic and the kind of its messages."""

    def __init__(
        self, bag: str | Path, settings: Settings, source: tuple[str, str], whole: bool
    ) -> None:
        settings = settings.of_recording() if whole else settings
        self._bag, self._settings, self._whole = bag, settings, whole
        self._topic, self._kind = source
        theory = self._positions = None
        if settings.scene:
            # Imported only with a scene: it takes longer than a short replay.
            from kinpole_ros.linkage.positions import Positions
            from kinpole_ros.linkage.theory import load_theory

            theory = load_theory(settings)
            self._positions = Positions(theory.scene, theory.matches)
        # The tracker of the results, and the one that learns.
        self._tracker = self._learned = Tracker(settings)
        self._reader = messages.reader_of(self._kind, settings)
        self._registered = theory.quantities(tuple(settings.bodies)) if theory else []
        self._outputs = messages.outputs_of(settings, theory)
        compare = theory.comparison() if theory else None
        self._rig = RigColumn(self._registered)
        self._diagnostics = PeriodicDiagnostics(
            messages.DiagnosticsMaker(NODE_NAME, compare, self._topic)
        )
        self._outcome = _replayed.begin(settings, self._tracker, whole)
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
        if self._whole:
            self._learn(progress)
            progress = progress and partial(_part_of_progress, progress, _LEARNING_SHARE, 1.0)
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
            last_time = np.zeros(0, np.int64)
            for frames, log_times, error in self._blocks(self._reader, progress):
                if error is not None:
                    self._add_error(error)
                if not frames:
                    continue
                last_time = log_times[-1:]
                self._add(self._track(frames, log_times, writer, has_readers_of_events), takers)
            if self._whole:
                self._add(self._track_to_end(last_time, writer), takers)
            if isinstance(self._reader, messages.PoseReader):
                outcome.pose_fault = self._reader.fault()
            else:
                outcome.drawings = self._reader.fault()
            self._check_frames()
        outcome.concatenated = _unlisted_files(self._bag)
        if self._positions is not None:
            outcome.scene_positions = self._positions.report()
        outcome.converted = self._converted()
        return _replayed.finish(outcome, self._learned)

    def _learn(self, progress: Progress | None) -> None:
        """Read the bag a first time, and have a tracker that knows what is learned from it."""
        begun = progress and partial(_part_of_progress, progress, 0.0, _LEARNING_SHARE)
        reader = messages.reader_of(self._kind, self._settings)
        parts = chain.from_iterable(frames for frames, _, _ in self._blocks(reader, begun))
        self._learned, recording = learn_recording(self._settings, parts)
        self._tracker = Tracker(self._settings, recording)

    def _blocks(
        self, reader: messages.MarkerReader | messages.PoseReader, progress: Progress | None
    ) -> Iterator[FrameBlock]:
        """Return the blocks of frames of the bag."""
        return frame_blocks(self._bag, self._topic, self._kind, reader, progress)

    def _add(
        self, estimates: Sequence[Estimate], takers: Iterable[Callable[[Estimate], None]]
    ) -> None:
        """Add estimates of consecutive instants to the outcome, and pass them to the takers."""
        for estimate in estimates:
            _replayed.add_estimate(self._outcome, estimate)
            if self._positions is not None:
                self._positions.append(estimate)
            for take in takers:
                take(estimate)

    def _converted(self) -> Finding | None:
        """Return how frames repeat others, as of a film whose rate was changed, if they do."""
        counts, outcome = self._tracker.update_counts(), self._outcome
        is_slow = outcome.last - outcome.first > _LEAST_FILM_INTERVAL * counts['frames']
        is_held = counts[HELD] >= FEWEST_REPEATS
        if not is_held and not is_slow:
            return None
        reader = messages.reader_of(self._kind, self._settings)
        parts: list[MarkerFrames] = []
        for frames, _, _ in self._blocks(reader, None):
            parts += frames
            if not is_held and sum(len(part.stamps) for part in parts) > _FILM_FRAMES:
                break
        return conversion_fault(str(self._bag), parts)

    def _add_topics(self, writer: BagWriter) -> None:
        """Have all topics in the bag of results, also those without messages."""
        writer.add_topic(RIG_TOPIC, messages.String, is_latched=True)
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
        for tracker in {self._tracker, self._learned}:
            tracker.count('unreadable')
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
        if self._outcome.last - self._space_stamp >= SECOND:
            self._space_stamp = self._outcome.last
            self._outcome.space = updated(self._outcome.space, self._tracker.space())
        if writer is not None:
            writer.write_many(self._messages(estimates, log_times))
        return estimates

    def _track_to_end(self, last_time: np.ndarray, writer: BagWriter | None) -> Sequence[Estimate]:
        """Return the estimates after the last frame, logged at its time (1,), ns, if any."""
        estimates = self._tracker.finish(self._settings.highest_order)
        if writer is not None:
            columns = (self._columns(one, last_time[np.zeros(len(one), int)]) for one in estimates)
            writer.write_many([*chain.from_iterable(columns)])
        return estimates

    def _columns(self, estimate: Estimate, log_times: np.ndarray) -> Iterator[Column]:
        """Return the messages of an estimate at instants logged at these times (T,), ns."""
        return result_columns(self._outputs, estimate, f'/{NODE_NAME}', log_times)

    def _messages(self, estimates: list[Estimate], log_times: np.ndarray) -> list[Column]:
        """Return messages, logged with the frames with which their estimates fell due."""
        columns = [self._columns(estimate, log_times[estimate.due]) for estimate in estimates]
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
