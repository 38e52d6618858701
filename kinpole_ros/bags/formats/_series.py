"""Markers or poses that came by several topics, put into frames by their stamps."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._cells import shown
from kinpole_ros.bags.formats._file import File

_SECOND = 1_000_000_000  # ns
_SAME_RATE = 0.02  # of two trackers, whose clocks may differ
_SAME_FRAME = 0.25  # share of the interval of a topic within which stamps are of one frame
# Intervals that a stamp may be before the latest one of its source: messages overtake each other.
_MOST_BACK = 20


class MessageSeries(NamedTuple):
    """Markers or poses in T messages of one layout, of one source."""

    source: str
    names: tuple[str, ...]
    stamps: np.ndarray  # (T,), ns
    log_times: np.ndarray  # or other numbers that rise with the order of arrival
    values: np.ndarray  # (T, n, 3), points, or (T, n, 7), with quaternions x, y, z, w


def first_pass(file: File, series: list[MessageSeries]) -> list[MessageSeries]:
    """Leave out what came after stamps jumped back, as those of a bag played in a loop do."""
    end, note = np.inf, ''
    for source in dict.fromkeys(part.source for part in series):
        parts = [part for part in series if part.source == source]
        arrival = np.concatenate([part.log_times for part in parts])
        order = np.argsort(arrival, kind='stable')
        stamps = np.concatenate([part.stamps for part in parts])[order]
        back = np.maximum.accumulate(stamps) - stamps
        steps = np.diff(np.unique(stamps))
        late = back > _MOST_BACK * np.median(steps) if len(steps) else np.zeros(len(back), bool)
        if late.any() and arrival[order][first := int(late.argmax())] < end:
            end = arrival[order][first]
            note = (
                f'{file.path}: stamps jump back by {back[first] / _SECOND:.3g} s after message '
                f'{first}{f" of {shown(source)}" if source else ""}, as in a bag that was played '
                'in a loop; the messages before that are read'
            )
    if not note:
        return series
    file.notes.append(note)
    kept = [(part, part.log_times < end) for part in series]
    return [
        part._replace(stamps=part.stamps[k], log_times=part.log_times[k], values=part.values[k])
        for part, k in kept
        if k.any()
    ]


def without_repeats(file: File, series: list[MessageSeries]) -> list[MessageSeries]:
    """Leave out messages with a stamp that their source had before, and note how many say more."""
    kept = []
    for source in dict.fromkeys(part.source for part in series):
        parts = [part for part in series if part.source == source]
        stamps = np.concatenate([part.stamps for part in parts])
        order = np.argsort(np.concatenate([part.log_times for part in parts]), kind='stable')
        is_first = np.zeros(len(stamps), bool)
        is_first[order[np.unique(stamps[order], return_index=True)[1]]] = True
        repeated = len(stamps) - int(is_first.sum())
        first = 0
        for part in parts:
            rows = is_first[first : first + len(part.stamps)]
            first += len(part.stamps)
            kept.append(
                part._replace(
                    stamps=part.stamps[rows],
                    log_times=part.log_times[rows],
                    values=part.values[rows],
                )
            )
        if repeated and not _are_same(parts):
            file.notes.append(
                f'{file.path}: {repeated} of {len(stamps)} messages'
                f'{f" of {shown(source)}" if source else ""} have the stamp of one before them, '
                'and are left out; fix: have the driver stamp each with its time of capture'
            )
    return [part for part in kept if len(part.stamps)]


def _are_same(parts: list[MessageSeries]) -> bool:
    """Return whether messages of one stamp say the same, as those sent again on /tf."""
    if len(parts) > 1:
        return False
    (part,) = parts
    _, first, rows = np.unique(part.stamps, return_index=True, return_inverse=True)
    return np.array_equal(part.values, part.values[first][rows.reshape(-1)], equal_nan=True)


def check_clocks(file: File, series: list[MessageSeries]) -> None:
    """
    Raise BagError where sources that came together are stamped at other times: by two clocks.

    Note sources of other rates: frames lack what did not come with them.
    """
    spans, steps = {}, {}
    for part in sorted(series, key=lambda part: len(part.stamps)):  # the longest of a source counts
        stamps = np.sort(part.stamps)
        spans[part.source] = stamps[0], stamps[-1], part.log_times.min(), part.log_times.max()
        if len(stamps) > 1 and (step := float(np.median(np.diff(stamps)))) > 0:
            steps[part.source] = step
    (one, first), *others = spans.items()
    for other, span in others:
        came_together = first[2] < span[3] and span[2] < first[3]
        if came_together and (first[1] < span[0] or span[1] < first[0]):
            cause = 'by two clocks' if first[1] and span[1] else 'one of them with 0'
            gap = abs(int(span[0]) - int(first[0])) / _SECOND
            raise BagError(
                f'{file.path}: {shown(one)} and {shown(other)} came together, and are stamped '
                f'{gap:.6g} s apart, {cause}; fix: stamp both by one clock, or record each in a '
                'bag of its own'
            )
    if steps and max(steps.values()) > (1 + _SAME_RATE) * min(steps.values()):
        ends = min(steps, key=steps.__getitem__), max(steps, key=steps.__getitem__)
        rates = ' and '.join(f'{shown(one)} at {_SECOND / steps[one]:.4g} Hz' for one in ends)
        file.notes.append(
            f'{file.path}: {rates}: frames lack what did not come with them, and stamps may be '
            'uneven; fix: record each in a bag of its own, or set both to one rate'
        )


def number_columns(series: list[MessageSeries], width: int) -> dict[str, int]:
    """Number the markers, which have 3 values each, or the bodies, which have 7."""
    layouts = (part.names for part in series if part.values.shape[-1] == width)
    names = dict.fromkeys(name for layout in dict.fromkeys(layouts) for name in layout)
    return {name: column for column, name in enumerate(names)}


def group_into_frames(series: list[MessageSeries]) -> tuple[np.ndarray, list[np.ndarray]]:
    """
    Put messages into frames: the stamps of these, and the frame of each message of each series.

    A frame has one message of each source, none later than a share of the shortest interval.
    """
    stamps = np.concatenate([part.stamps for part in series])
    sources = list(dict.fromkeys(part.source for part in series))
    if len(sources) == 1:
        frame_stamps, rows = np.unique(stamps, return_inverse=True)
    else:
        number = np.repeat(
            [sources.index(p.source) for p in series], [len(p.stamps) for p in series]
        )
        steps = [np.diff(np.unique(stamps[number == k])) for k in range(len(sources))]
        most = _SAME_FRAME * min((float(np.median(step)) for step in steps if len(step)), default=0)
        starts: list[int] = []
        rows = np.empty(len(stamps), np.intp)
        members: set[int] = set()
        for event in np.argsort(stamps, kind='stable').tolist():
            late = int(stamps[event]) - starts[-1] if starts else 0
            if not starts or late > most or (late and int(number[event]) in members):
                starts.append(int(stamps[event]))
                members.clear()
            members.add(int(number[event]))
            rows[event] = len(starts) - 1
        frame_stamps = np.array(starts, np.int64)
    return frame_stamps, np.split(rows, np.cumsum([len(part.stamps) for part in series])[:-1])
