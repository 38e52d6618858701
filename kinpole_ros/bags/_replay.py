"""A bag of markers through the same tracker as the live node, to a bag or a table of results."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import chain, pairwise
from pathlib import Path
from typing import TypeAlias

import numpy as np

from kinpole_ros.bags._files import BagError, Truncated, bag_files, in_place_of
from kinpole_ros.bags._marker_frames import NODE_NAME, frame_blocks, input_topic
from kinpole_ros.bags._reader import Progress
from kinpole_ros.bags._replayed import Replayed, ReplayTotals
from kinpole_ros.bags._tables import CsvTable, ParquetTable
from kinpole_ros.bags._writer import BagWriter
from kinpole_ros.messages import (
    DiagnosticArray,
    DiagnosticsMaker,
    Output,
    PoseReader,
    outputs_of,
    reader_of,
    serialize_message,
    theory_of,
)
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.tracker import Tracker

_SECOND = 1_000_000_000  # ns
_MOST_REUSED_BYTES = 31 << 20  # glibc returns what is 32 MiB or larger to the system at once
# Diagnostics are of a second, and drawings show the centrodes of the two seconds before.
_WARM_UP = 3_000_000_000  # ns
# Share of the time of a replay. Measured with bags of markers alone: 0.13 where stamps jitter, 0.21
# where they are even; and up to 0.4 where no bag of results is written.
_LEARNING_SHARE = 0.25
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
    replaying = _Replaying(bag, settings, source, Stretch())
    with ExitStack() as stack:
        files = {kind: stack.enter_context(in_place_of(path)) for kind, path in targets.items()}
        return replaying.run(files, targets, progress, take)


def replay_stretch(
    bag: str | Path,
    settings: Settings,
    files: Mapping[str, Path],
    topic: str | None = None,
    progress: Progress | None = None,
    stretch: 'Stretch | None' = None,
) -> Replayed:
    """Replay a bag, or a stretch of it, directly into files by kind: 'mcap', 'csv', 'parquet'."""
    source = input_topic(bag, settings, topic)
    return _Replaying(bag, settings, source, stretch or Stretch()).run(files, files, progress, None)


def _check_targets(bag: str | Path, targets: Mapping[str, str | Path]) -> None:
    """Raise BagError where results would replace the bag, each other, or become a part of it."""
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
        uses[file_id] = 'the bag of results' if kind == 'mcap' else 'the CSV table'


def _file_id(path: Path) -> tuple[int, int] | Path:
    """Return what all names of one file have in common, also those of hard links."""
    try:
        about = path.stat()
    except OSError:
        return path.resolve()
    return about.st_dev, about.st_ino


def _files_without_metadata(bag: str | Path) -> list[str]:
    """Return the files of a bag, if several are one recording only as they are in one folder."""
    files = bag_files(bag)
    is_listed = not Path(bag).is_dir() or (Path(bag) / 'metadata.yaml').exists()
    return [] if is_listed or len(files) < 2 else [file.name for file in files]


class _Replaying:
    """A replay of a bag, its topic and the kind of its messages given as `source`."""

    def __init__(
        self, bag: str | Path, settings: Settings, source: tuple[str, str], stretch: 'Stretch'
    ) -> None:
        self._bag, self._settings, self._stretch = bag, settings, stretch
        self._topic, self._kind = source
        theory = theory_of(settings)
        self._tracker = Tracker(settings)
        self._reader = reader_of(self._kind, settings)
        self._order = settings.derivative_order or 4
        self._outputs = outputs_of(settings, theory)
        self._diagnostics = _PeriodicDiagnostics(DiagnosticsMaker(NODE_NAME, theory, self._topic))
        self._totals = ReplayTotals(settings, self._tracker, theory)
        self._share = 0.0  # of the bytes that have been read

    def run(
        self,
        files: Mapping[str, str | Path],
        names: Mapping[str, str | Path],
        progress: Progress | None,
        take: Callable[[Estimate], None] | None,
    ) -> Replayed:
        """Replay into files by kind, which messages call by `names`."""

        def report(share: float) -> None:
            self._share = share
            if progress is not None:
                progress(share)

        # glibc keeps freed memory of up to the size of the largest block freed so far, instead of
        # asking the system for the arrays of each block: a tenth of the time.
        np.empty(_MOST_REUSED_BYTES, np.uint8)
        with ExitStack() as stack:
            writer = None
            if 'mcap' in files:
                writer = stack.enter_context(BagWriter(files['mcap'], name=names['mcap']))
                for row in self._outputs:
                    writer.add_topic(row.under(f'/{NODE_NAME}'), row.message_type)
                writer.add_topic('/diagnostics', DiagnosticArray)
            tables = [
                stack.enter_context(table(files[kind], self._settings, names[kind]))
                for kind, table in (('csv', CsvTable), ('parquet', ParquetTable))
                if kind in files
            ]
            blocks = frame_blocks(self._bag, self._topic, self._kind, self._reader, report)
            for frames, log_times, error in blocks:
                self._note(error)
                if not frames:
                    continue
                self._stretch.update(self._share, frames[0].stamps)
                if self._stretch.is_over:
                    break
                for estimate in self._track(frames, log_times, writer):
                    self._totals.add_estimate(estimate)
                    for table in tables:
                        table.add(estimate)
                    if take is not None:
                        take(estimate)
            pose_problem = self._pose_problem()
        return self._totals.result(_files_without_metadata(self._bag), pose_problem)

    def _note(self, error: Exception | None) -> None:
        if isinstance(error, Truncated):
            self._totals.truncated = error
        elif error is not None:
            self._tracker.counts['unreadable'] += 1
            self._totals.problem = self._totals.problem or str(error)
            self._diagnostics.trouble['message'] = str(error)

    def _track(
        self, frames: list[MarkerFrames], log_times: np.ndarray, writer: BagWriter | None
    ) -> Sequence[Estimate]:
        """Return the estimates that the stretch has from these frames, and write their messages."""
        stretch, diagnostics = self._stretch, self._diagnostics
        diagnostics.silent = not stretch.is_estimated
        for part in frames:
            self._totals.add_frames(part)
        handed = frames if writer is None else diagnostics.split(frames, self._tracker)
        estimates = self._tracker.add_parts(handed, self._order if stretch.is_estimated else None)
        self._totals.update_space()
        if writer is not None:
            # An estimate is logged with the frames that made it due. Messages that are not written
            # are made all the same: some depend on those before.
            columns = [
                result_columns(self._outputs, estimate, f'/{NODE_NAME}', log_times[estimate.due])
                for estimate in estimates
            ]
            messages = list(chain(*columns, diagnostics.columns(estimates, log_times)))
            writer.write_many(messages if stretch.is_written else ())
        return estimates if stretch.is_written else ()

    def _pose_problem(self) -> str:
        """Return what is wrong with poses as input; raise BagError where nothing could be read."""
        counts = self._tracker.counts
        if counts['unreadable'] and not counts['frames']:
            raise BagError(
                f'{self._bag}: no message on {self._topic} can be read: {self._totals.problem}'
            )
        problem = self._reader.unseen_names() if isinstance(self._reader, PoseReader) else ''
        if problem and not counts['frames']:
            raise BagError(f'{self._bag}: on {self._topic} {problem}')
        return problem


class Stretch:
    """
    A stretch of a bag, by which several processes replay one bag.

    What is learned, of shapes, noise, pins and the clock, depends on all frames before. So the
    process of a stretch also learns from these, which takes a fraction of the time. Its results are
    those of the whole bag, to the last bit.

    It ends at two seams, each at a share of the bag's bytes, 0 to 1. A seam is where the stamps are
    3 s from those of the first frames beyond that share. Results are estimated from these first
    frames on, and written from the seam on.
    """

    def __init__(self, first: float = 0.0, last: float = 1.0) -> None:
        self.is_estimated = self.is_written = False
        self.is_over = False
        self._first, self._last = _Seam(first), _Seam(last)

    def update(self, share: float, stamps: np.ndarray) -> None:
        """The next frames have these `stamps`; with them this share of the bag has been read."""
        stamp = int(stamps[0])
        self.is_written = self._first.is_passed(share, stamp)
        self.is_estimated = self._first.stamp is not None
        self.is_over = self._last.is_passed(share, stamp)


class _Seam:
    def __init__(self, share: float) -> None:
        self._share = share
        self.stamp: int | None = None
        self._passed = False

    def is_passed(self, share: float, stamp: int) -> bool:
        if self.stamp is None and share >= self._share:
            self.stamp = stamp
            self._passed = self._share <= 0
        if self.stamp is not None and self._share < 1:
            self._passed = self._passed or abs(stamp - self.stamp) >= _WARM_UP
        return self._passed


def equal_stretches(count: int) -> list[Stretch]:
    """Return stretches that take `count` processes the same time."""
    ratio = 1 - _LEARNING_SHARE
    ends = [(1 - ratio**k) / (1 - ratio**count) for k in range(count + 1)]
    return [Stretch(first, last) for first, last in pairwise(ends)]


def result_columns(
    outputs: list[Output], estimate: Estimate, prefix: str, log_times: np.ndarray
) -> Iterator[Column]:
    """Yield the messages of T instants under `prefix`, logged at `log_times` (T,), ns."""
    for row in outputs:
        instants, data = row.build(estimate)
        if data:
            yield row.under(prefix), row.message_type, log_times[instants].tolist(), data


class _PeriodicDiagnostics:
    """
    The diagnostics of each second of stamps, as of its last frame, as the node publishes them.

    `trouble` names what is wrong, for the next. While `silent` none are made.
    """

    def __init__(self, maker: DiagnosticsMaker) -> None:
        self.trouble: dict[str, str] = {}
        self.silent = False
        self._maker = maker
        self._last_stamp: int | None = None
        # The last estimate since the last diagnostics.
        self._latest: Estimate | None = None
        # Number of the frame, and a function that makes its diagnostics from the estimate then.
        self._begun: list[tuple[int, Callable[[Estimate | None], DiagnosticArray]]] = []

    def split(self, blocks: Iterable[MarkerFrames], tracker: Tracker) -> Iterator[MarkerFrames]:
        """Yield the frames in parts that end where a second has passed, for the tracker."""
        count = 0
        for frames in blocks:
            stamps, first = frames.stamps, 0
            while first < len(stamps):
                previous = stamps[first] - _SECOND if self._last_stamp is None else self._last_stamp
                is_due = np.abs(stamps[first:] - previous) >= _SECOND
                end = first + int(is_due.argmax()) + 1 if is_due.any() else len(stamps)
                yield part_of(frames, slice(first, end))
                if is_due.any():
                    self._begin(count + end - 1, int(stamps[end - 1]), tracker)
                first = end
            count += len(stamps)

    def _begin(self, number: int, stamp: int, tracker: Tracker) -> None:
        seconds = 0.0 if self._last_stamp is None else (stamp - self._last_stamp) / _SECOND
        if not self.silent:
            finish = self._maker.begin(stamp, tracker, seconds, self.trouble)
            self._begun.append((number, finish))
        self._last_stamp, self.trouble = stamp, {}

    def columns(self, estimates: list[Estimate], log_times: np.ndarray) -> Iterator[Column]:
        """Yield the messages of these seconds, from the estimates of the same frames."""
        data = []
        published = -1
        for number, finish in self._begun:
            current, self._latest = self._latest, None
            for estimate in estimates:
                due = int(np.searchsorted(estimate.due, number, side='right'))
                if due and estimate.due[due - 1] > published:
                    current = estimate[due - 1]
            data.append(serialize_message(finish(current)))
            published = number
        times = [int(log_times[number]) for number, _ in self._begun]
        yield '/diagnostics', DiagnosticArray, times, data
        self._begun = []
        if estimates and estimates[-1].due[-1] > published:
            self._latest = estimates[-1][-1]
