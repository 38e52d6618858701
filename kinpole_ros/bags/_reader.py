"""Recorders get killed and disks fill up, so bags are read to the last message that is there.

A file is laid out first, as the list of its stretches that hold messages, and then read in file
order, whole or not, by the same code. Messages are handed on as soon as no later stretch can hold
an earlier one, so memory stays bounded.
"""

import struct
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from heapq import heappop, heappush
from itertools import accumulate, chain
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO

from kinpole_ros.bags._channels import BagMessage, Channels, largest
from kinpole_ros.bags._claims import indexed_times
from kinpole_ros.bags._files import (
    BagError,
    Truncated,
    bag_files,
    check_magic,
    open_file,
    unreadable,
)
from kinpole_ros.bags._layout import NEVER, lay_out, records
from kinpole_ros.bags._sqlite import is_sqlite, sqlite_blocks, sqlite_topics

_LATEST = 2**63 - 1  # ns; ROS has no later time
_LOG_TIME, _TOPIC = attrgetter('log_time'), attrgetter('topic')
# What a block holds at most.
_BLOCK_MESSAGES = 1000
_BLOCK_BYTES = 1 << 20
# The same of large messages, as of many bodies: results have a cost for each block and body, which
# would grow with the square of the number of bodies if blocks had fewer frames for them.
_LARGE_BLOCK_MESSAGES = 32
_LARGE_BLOCK_BYTES = 1 << 24


def topics(path: str | Path) -> dict[str, str]:
    """Topics of a bag and their types, such as {'/markers': 'visualization_msgs/msg/MarkerArray'}.

    A bag that is cut off or damaged gives those found in what is left, without complaint.
    Raises BagError when there is no bag.
    """
    return described(path)[0]


def described(path: str | Path) -> tuple[dict[str, str], dict[str, str]]:
    """The topics of a bag and their types, and the definitions of types, as far as it has them."""
    types: dict[str, str] = {}
    definitions: dict[str, str] = {}
    for one in bag_files(path):
        try:
            with open_file(one) as file:
                of_file = sqlite_topics(one) if is_sqlite(file) else _file_topics(one, file)
        except OSError as error:
            raise unreadable(one, error) from error
        types |= of_file[0]
        definitions |= of_file[1]
    return types, definitions


def read_messages(
    path: str | Path,
    topics: Collection[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Iterator[BagMessage]:
    """Messages of a bag, those on `topics` or all, in order of log time.

    Ties come in the order of the file; the files of a folder come one after the other. Messages
    that are not CDR are left out of all, and refused when asked for. `progress` is called with
    the fraction of bytes done, at most some 200 times in all.

    A file that is cut off or damaged gives every message before that place, also those in a
    chunk cut in the middle; the files of a folder after it are read as well, and then Truncated is
    raised, which says where. Other things wrong raise BagError: at the call what bag_files refuses,
    the rest when its turn comes.
    """
    return chain.from_iterable(read_blocks(path, topics, progress))


def read_blocks(
    path: str | Path,
    topics: Collection[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Iterator[list[BagMessage]]:
    """The same messages in the same order, a list of up to a thousand (about 1 MiB) at a time.

    Of messages of more than 32 KiB a list holds up to 32, but no more than 16 MiB.
    What is wrong is raised as by read_messages, after a list of all that came before it.
    """
    wanted = None if topics is None else frozenset(topics)
    return _blocks(_read_files(bag_files(path), wanted, progress or (lambda fraction: None)))


def _blocks(parts: Iterator[list[BagMessage]]) -> Iterator[list[BagMessage]]:
    """
    The same messages in lists that are neither short nor long.

    Where one ends goes by the messages alone, not by chunks and files: figures may differ by
    rounding from block to block, and a bag must give the same whichever way it is stored.
    """
    block: list[BagMessage] = []
    size = 0
    trouble = None
    try:
        for part in parts:
            for message in part:
                size += len(message.data)
                few = len(block) < _LARGE_BLOCK_MESSAGES
                most = _LARGE_BLOCK_BYTES if few else _BLOCK_BYTES
                if block and (size > most or len(block) == _BLOCK_MESSAGES):
                    yield block
                    block, size = [], len(message.data)
                block.append(message)
    except BagError as error:
        trouble = error
    if block:
        yield block
    if trouble is not None:
        raise trouble


def _file_topics(path: Path, file: BinaryIO) -> tuple[dict[str, str], dict[str, str]]:
    channels = Channels(path, frozenset())
    layout = lay_out(path, file, channels)
    if not channels.types:
        with suppress(Exception):  # damaged bytes: what came before them counts
            for span in layout.spans:
                channels.read(records(file, span, layout)[0], [])
    return channels.types, channels.definitions


def _read_files(
    files: list[Path], wanted: frozenset[str] | None, progress: Callable[[float], None]
) -> Iterator[list[BagMessage]]:
    sizes = [file.stat().st_size for file in files]
    before, reported = 0, 0.0
    troubles: list[str] = []

    def report(share: float) -> None:
        nonlocal reported
        fraction = (before + share * size) / sum(sizes)
        if fraction - reported >= 0.005:
            reported = fraction
            progress(fraction)

    for path, size in zip(files, sizes, strict=True):
        try:
            check_magic(path)
            with open_file(path) as file:
                if is_sqlite(file):
                    yield from sqlite_blocks(path, wanted)
                else:
                    yield from _read_file(path, file, wanted, report)
        except Truncated as error:
            troubles.append(str(error))
        except OSError as error:
            raise unreadable(path, error) from error
        before += size
    if troubles:
        raise Truncated('; '.join(troubles))
    progress(1.0)


def _read_file(
    path: Path, file: BinaryIO, wanted: frozenset[str] | None, report: Callable[[float], None]
) -> Iterator[list[BagMessage]]:
    channels = Channels(path, wanted)
    layout = lay_out(path, file, channels)
    trouble, doubt = layout.trouble, layout.doubt
    counts: Counter[str] = Counter()
    # The earliest log time from each span on to the end of the file.
    times = [span.time for span in reversed(layout.spans)]
    earliest = [*accumulate(times, min, initial=NEVER)][::-1]
    waiting = _Waiting()
    most = largest(path.stat().st_size)
    count = last = 0
    first, latest = NEVER, 0
    for number, (span, horizon) in enumerate(zip(layout.spans, earliest[1:], strict=True)):
        found: list[BagMessage] = []
        damaged = False
        try:
            content, index = records(file, span, layout)
            channels.read(content, found)
            found.sort(key=_LOG_TIME)
            if index and not doubt and (unlike := _unlike(index, found, channels)):
                doubt = f'the index of its chunk at byte {span.offset} {unlike}'
            if found and found[-1].log_time > _LATEST:
                del found[bisect_right(found, _LATEST, key=_LOG_TIME) :]
                raise ValueError('a log time after the year 2262')
        except (BagError, OSError):
            raise
        except Exception as error:  # mcap and each decompressor have their own for bad bytes
            horizon, damaged = NEVER, True
            if span.end <= layout.size:
                trouble = f'is damaged at byte {span.offset} ({error})'
        if found:
            first = min(first, found[0].log_time)
            latest = max(latest, found[-1].log_time)
            count += len(found)
            counts.update(map(_TOPIC, found))
            waiting.add(number, found)
        for part in waiting.until(horizon):
            last = part[-1].log_time
            yield part
        if damaged:
            break
        if waiting.size > most:
            raise BagError(
                f'{path}: messages are so far out of order that more than {most >> 20} MiB of '
                f'them would have to be held; fix: `mcap sort {path} -o NEW.mcap`'
            )
        report(span.end / layout.size)
    if not trouble:
        fault = doubt or channels.doubt or layout.claims.miscounted(counts, channels.topics)
        if count:
            fault = fault or layout.claims.untimely(first, latest)
        if fault := fault or layout.claims.wrong_sum(file):
            raise Truncated(
                f'{path} has lost messages, or was changed: {fault}; {count} messages were read; '
                f'fix: record again, or `mcap recover {path} -o NEW.mcap` for what is left'
            )
    if trouble:
        read = f'{count} messages up to stamp {last / 1e9:.3f} s (log time) were read'
        raise Truncated(
            f'{path} {trouble}: {read if count else "there is no message before that"}; '
            f'fix: record again, or `mcap recover {path} -o NEW.mcap`'
        )


def _unlike(index: bytes, found: list[BagMessage], channels: Channels) -> str:
    """How the indexes of a chunk differ from its messages, in order; '' if they do not."""
    try:
        times = indexed_times(index, channels.topics)
    except (ValueError, struct.error):
        return 'is damaged'
    if times == [message.log_time for message in found]:
        return ''
    if len(times) == len(found):
        return 'has messages of other times'
    return f'has {len(times)} messages, there are {len(found)}'


class _Waiting:
    """Runs of messages, each in order, that wait until nothing can come before them."""

    def __init__(self) -> None:
        # The time of the next message, the run's place in the file, the next one's index, the run.
        self._runs: list[tuple[int, int, int, list[BagMessage]]] = []
        self._sizes: dict[int, int] = {}
        self.size = 0

    def add(self, place: int, found: list[BagMessage]) -> None:
        found.sort(key=_LOG_TIME)  # what is sorted already costs next to nothing
        self._sizes[place] = sum([len(message.data) for message in found])
        self.size += self._sizes[place]
        heappush(self._runs, (found[0].log_time, place, 0, found))

    def until(self, horizon: int) -> Iterator[list[BagMessage]]:
        """Take out what is no later than `horizon` (ns), in order."""
        while self._runs and self._runs[0][0] <= horizon:
            _, place, start, run = heappop(self._runs)
            end = horizon
            if self._runs:  # of equal times those that come first in the file
                time, other = self._runs[0][:2]
                end = min(end, time if place < other else time - 1)
            stop = len(run)
            if run[-1].log_time > end:
                stop = bisect_right(run, end, start, key=_LOG_TIME)
                heappush(self._runs, (run[stop].log_time, place, stop, run))
            else:
                self.size -= self._sizes.pop(place)
            yield run[start:stop]
