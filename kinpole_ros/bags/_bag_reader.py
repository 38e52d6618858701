"""Recorders get killed and disks fill up, so bags are read to the last message that is there.

A file is laid out first, as the list of its spans that hold messages, and then read in file order.
Messages are yielded as soon as no later span can hold an earlier one, so memory stays bounded.
"""

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from itertools import accumulate, chain
from operator import attrgetter
from pathlib import Path
from typing import BinaryIO

from kinpole_ros.bags import _files
from kinpole_ros.bags._channels import BagMessage, Channels, largest
from kinpole_ros.bags._layout import NEVER, FileLayout, Span, is_data_changed, lay_out, read_span
from kinpole_ros.bags._storages import is_sqlite, sqlite_messages, sqlite_topics

_LATEST = 2**63 - 1  # ns; ROS has no later time
_LOG_TIME, _TOPIC = attrgetter('log_time'), attrgetter('topic')
_BLOCK_MESSAGES = 1000
_BLOCK_BYTES = 1 << 20
# Each block costs results some time per body, so blocks of large messages, as of many bodies, are
# not cut to few messages: the time would grow with the square of the number of bodies.
_LARGE_BLOCK_MESSAGES = 32
_LARGE_BLOCK_BYTES = 1 << 24

Progress = Callable[[float], None]


def topics(path: str | Path) -> dict[str, str]:
    """
    Return the topics of a bag and their types.

    Parameters
    ----------
    path : str or Path
        A file or folder, as for `bag_files`.

    Returns
    -------
    dict
        Types by topic, such as {'/markers': 'visualization_msgs/msg/MarkerArray'}. A bag that is
        cut off or damaged gives those that can be read.

    Raises
    ------
    BagError
        If there is no bag.

    """
    return types_and_definitions(path)[0]


def types_and_definitions(path: str | Path) -> tuple[dict[str, str], dict[str, str]]:
    """Return the types of a bag by topic, and their definitions by type where it has them."""
    types: dict[str, str] = {}
    definitions: dict[str, str] = {}
    for file_path in _files.bag_files(path):
        with _files.read_errors(file_path), _files.open_file(file_path) as file:
            if is_sqlite(file):
                file_types, file_definitions = sqlite_topics(file_path)
            else:
                channels = _described_channels(file_path, file)
                file_types, file_definitions = channels.types, channels.definitions
        types |= file_types
        definitions |= file_definitions
    return types, definitions


def read_messages(
    path: str | Path, topics: Collection[str] | None = None, progress: Progress | None = None
) -> Iterator[BagMessage]:
    """
    Read the messages of a bag, in order of log time.

    Messages of equal log time come in the order of the file; the files of a folder come one after
    the other.

    Parameters
    ----------
    path : str or Path
        A file or folder, as for `bag_files`.
    topics : collection of str, optional
        The topics to read; without it, all whose messages are CDR.
    progress : callable, optional
        Called with the fraction of bytes read, 0 to 1, at most some 200 times.

    Yields
    ------
    BagMessage

    Raises
    ------
    Truncated
        After the last message of a bag that is cut off, damaged or lacks messages. All messages
        before that place were yielded, also those in a chunk cut in the middle, and those of the
        following files of a folder.
    BagError
        At the call for what `bag_files` refuses; later for a requested topic that is not CDR, and
        for messages that are too far out of order.

    """
    return chain.from_iterable(read_blocks(path, topics, progress))


def read_blocks(
    path: str | Path, topics: Collection[str] | None = None, progress: Progress | None = None
) -> Iterator[list[BagMessage]]:
    """
    Read the messages of a bag in blocks.

    Parameters
    ----------
    path, topics, progress
        As for `read_messages`.

    Yields
    ------
    list of BagMessage
        The same messages in the same order: up to 1,000 of about 1 MiB in all; of messages of
        more than 32 KiB up to 32, of at most 16 MiB.

    Raises
    ------
    Truncated, BagError
        As `read_messages`, after the block with the last message.

    """
    requested = None if topics is None else frozenset(topics)
    return _blocks(
        _read_files(_files.bag_files(path), requested, progress or (lambda fraction: None))
    )


def _blocks(runs: Iterator[list[BagMessage]]) -> Iterator[list[BagMessage]]:
    """
    Regroup messages into blocks that are neither short nor long.

    Blocks depend on the messages alone, not on chunks and files: results may differ by rounding
    from block to block, and a bag must give the same results in any storage.
    """
    block: list[BagMessage] = []
    size = 0
    fault = None
    try:
        for run in runs:
            for message in run:
                size += len(message.data)
                is_short = len(block) < _LARGE_BLOCK_MESSAGES
                most = _LARGE_BLOCK_BYTES if is_short else _BLOCK_BYTES
                if block and (size > most or len(block) == _BLOCK_MESSAGES):
                    yield block
                    block, size = [], len(message.data)
                block.append(message)
    except _files.BagError as error:
        fault = error
    if block:
        yield block
    if fault is not None:
        raise fault


def _described_channels(path: Path, file: BinaryIO) -> Channels:
    """Return the channels of a file, by its summary if that is complete."""
    channels = Channels(path, frozenset())
    layout = lay_out(path, file)
    with suppress(Exception):  # damaged bytes: what came before them counts
        if layout.channels:
            channels.add_all(layout.summary)
        else:
            for span in layout.spans:
                channels.read(read_span(file, span, layout), [])
    return channels


def _read_files(
    files: list[Path], requested: frozenset[str] | None, progress: Progress
) -> Iterator[list[BagMessage]]:
    sizes = [file.stat().st_size for file in files]
    size_before, last_fraction = 0, 0.0
    faults: list[str] = []

    def report(share: float) -> None:
        nonlocal last_fraction
        fraction = (size_before + share * size) / sum(sizes)
        if fraction - last_fraction >= 0.005:
            last_fraction = fraction
            progress(fraction)

    for path, size in zip(files, sizes, strict=True):
        try:
            with _files.read_errors(path):
                _files.check_magic(path)
                with _files.open_file(path) as file:
                    if is_sqlite(file):
                        yield from ([message] for message in sqlite_messages(path, requested))
                    else:
                        yield from _read_file(path, file, requested, report)
        except _files.Truncated as error:
            faults.append(str(error))
        size_before += size
    if faults:
        raise _files.Truncated('; '.join(faults))
    progress(1.0)


def _read_file(
    path: Path, file: BinaryIO, requested: frozenset[str] | None, report: Progress
) -> Iterator[list[BagMessage]]:
    """Yield runs of messages in order; raises Truncated at the end if messages are missing."""
    channels = Channels(path, requested)
    layout = lay_out(path, file)
    spans = _requested_spans(layout, channels)
    # No span has messages before its time, so messages up to the horizon can be yielded.
    times = [span.time for span in reversed(spans)]
    horizons = [*accumulate(times, min, initial=NEVER)][-2::-1]
    waiting: list[list[BagMessage]] = []  # messages later than the horizon, each list in order
    earliest, size, most = NEVER, 0, largest(path.stat().st_size)
    counts: Counter[str] = Counter()
    last = 0  # log time, ns
    for span, horizon in zip(spans, horizons, strict=True):
        messages, fault = _messages_in(file, span, layout, channels)
        if fault:
            horizon = NEVER
            if span.end <= layout.size:
                layout.trouble = f'is damaged at byte {span.offset} ({fault})'
        if messages:
            waiting.append(messages)
            earliest = min(earliest, messages[0].log_time)
            counts.update(map(_TOPIC, messages))
            size += sum([len(message.data) for message in messages])
        if waiting and earliest <= horizon:
            run = _take_until(horizon, waiting)
            earliest = min((later[0].log_time for later in waiting), default=NEVER)
            size -= sum([len(message.data) for message in run])
            last = run[-1].log_time
            yield run
        if fault:
            break
        if size > most:
            raise _files.BagError(
                f'{path}: messages are so far out of order that more than {most >> 20} MiB of '
                f'them would have to be held; fix: `mcap sort {path} -o NEW.mcap`'
            )
        report(span.end / layout.size)
    if layout.trouble:
        read = f'{counts.total()} messages up to stamp {last / 1e9:.3f} s (log time) were read'
        fault = f'{layout.trouble}: {read if counts else "there is no message before that"}'
    elif fault := _count_fault(layout, channels, counts) or (
        'the checksum of its data is wrong' if is_data_changed(file, layout) else ''
    ):
        fault = f'has lost messages, or was changed: {fault}; {counts.total()} messages were read'
    if fault:
        raise _files.Truncated(
            f'{path} {fault}; fix: record again, or `mcap recover {path} -o NEW.mcap` for what is '
            'left'
        )


def _messages_in(
    file: BinaryIO, span: Span, layout: FileLayout, channels: Channels
) -> tuple[list[BagMessage], str]:
    """Return the messages in a span, in order, and what is wrong with it, '' if nothing."""
    messages: list[BagMessage] = []
    fault = ''
    try:
        channels.read(read_span(file, span, layout), messages)
    except (_files.BagError, OSError):
        raise
    except Exception as error:  # mcap and each decompressor have their own for bad bytes
        fault = str(error) or type(error).__name__
    messages.sort(key=_LOG_TIME)
    if messages and messages[-1].log_time > _LATEST:
        del messages[bisect_right(messages, _LATEST, key=_LOG_TIME) :]
        fault = fault or 'a log time after the year 2262'
    return messages, fault


def _take_until(horizon: int, waiting: list[list[BagMessage]]) -> list[BagMessage]:
    """Remove the messages no later than `horizon`, ns, and return them in order."""
    taken: list[BagMessage] = []
    for messages in waiting:
        count = bisect_right(messages, horizon, key=_LOG_TIME)
        taken += messages[:count]
        del messages[:count]
    waiting[:] = filter(None, waiting)
    taken.sort(key=_LOG_TIME)  # those of equal times stay in the order of the file
    return taken


def _count_fault(layout: FileLayout, channels: Channels, counts: Counter[str]) -> str:
    """Compare the numbers of messages by topic with the statistics of the file; '' if equal."""
    if layout.statistics is None or not layout.statistics.channel_message_counts:
        return ''
    claimed: Counter[str] = Counter()
    for channel, topic in channels.topics.items():
        claimed[topic] += layout.statistics.channel_message_counts.get(channel, 0)
    for topic in claimed | counts:
        if claimed[topic] != counts[topic]:
            return (
                f'its statistics count {claimed[topic]} messages on {topic}, there are '
                f'{counts[topic]}'
            )
    return ''


def _requested_spans(layout: FileLayout, channels: Channels) -> list[Span]:
    """Leave out the chunks that have no requested messages by the file's indexes."""
    topics = layout.channels
    spans = [
        span
        for span in layout.spans
        if not (topics and span.is_chunk)
        or channels.are_requested([topics[channel] for channel in span.channels])
    ]
    if len(spans) < len(layout.spans):
        # A chunk that is left out may describe the channels of others.
        try:
            channels.add_all(layout.summary)
        except ValueError:
            return layout.spans
    return spans
