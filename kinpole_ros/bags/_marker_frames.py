"""The topic of markers or poses in a bag, and its frames as arrays."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import TypeAlias

import numpy as np

from kinpole_ros import messages
from kinpole_ros.bags._bag_reader import Progress, read_blocks, read_messages, topics
from kinpole_ros.bags._files import BagError, Truncated
from kinpole_ros.settings import Settings
from kinpole_ros.tracking.frame import MarkerFrames, part_of

NODE_NAME = 'kinpole'
# Frames with the log times, ns, of their messages, or an error.
FrameBlock: TypeAlias = tuple[
    list[MarkerFrames], np.ndarray, BagError | messages.MessageError | None
]
_SECOND = 1_000_000_000  # ns


def read_frames(
    bag: str | Path,
    topic: str | None = None,
    seconds: float | None = None,
    progress: Progress | None = None,
    report: Callable[[BagError], None] | None = None,
    identity: str = 'auto',
) -> tuple[list[MarkerFrames], str]:
    """
    Read the frames of the markers in a bag.

    Parameters
    ----------
    bag : str or Path
        A file or folder, as for `bag_files`.
    topic : str, optional
        The topic; without it /markers, else the only one of a type that holds markers.
    seconds : float, optional
        Length (s) of the part to read, by stamps; without it, all.
    progress : callable, optional
        Called with the fraction of bytes read, 0 to 1.
    report : callable, optional
        Called with what is missing of a bag that is not whole, and what of it is no marker.
    identity : str
        As the parameter `marker_identity`.

    Returns
    -------
    frames : list of MarkerFrames
        In order; consecutive frames of one layout are one element.
    topic : str
        The full name of the topic.

    Raises
    ------
    BagError
        If there is no bag, no such topic, or no message on it that can be read.

    """
    name, kind = _marker_topic(bag, topic)
    frames: list[MarkerFrames] = []
    problem = ''
    reader = messages.marker_reader(kind, identity)
    for group, _, error in frame_blocks(bag, name, kind, reader, progress):
        if isinstance(error, Truncated):
            if report is not None:
                report(error)
        elif error is not None:
            problem = problem or str(error)
        frames += group
        if seconds is not None and frames:
            duration = int(frames[-1].stamps[-1]) - int(frames[0].stamps[0])
            if duration > seconds * _SECOND:
                break
    if not frames:
        why = f': {problem}' if problem else ''
        raise BagError(f'{bag}: no message on {name} can be read{why}; fix: name another --topic')
    fault = reader.fault() if isinstance(reader, messages.MarkerReader) else None
    if report is not None and fault is not None:
        report(BagError(f'{bag}: {fault.words()}'))
    return frames if seconds is None else _first_part(frames, seconds), name


def _first_part(frames: list[MarkerFrames], seconds: float) -> list[MarkerFrames]:
    """Return the frames until one is later than the first by more than `seconds`, by stamps."""
    start = frames[0].stamps[0]
    shortened = []
    for group in frames:
        late = np.flatnonzero(group.stamps - start > seconds * _SECOND)
        count = int(late[0]) if len(late) else len(group.stamps)
        if count:
            shortened.append(part_of(group, slice(count)))
        if len(late):
            break
    return shortened


def frame_blocks(
    bag: str | Path,
    topic: str,
    kind: str,
    reader: messages.MarkerReader | messages.PoseReader,
    progress: Progress | None,
) -> Iterator[FrameBlock]:
    """
    Yield the frames of a bag with the log times (T,), ns, of their messages, or an error, in order.

    Those of messages of several layouts, as where markers come and go, are several `MarkerFrames`.
    """
    if kind == 'tf' and isinstance(reader, messages.PoseReader):
        _read_static(bag, f'{topic}_static', reader)
    blocks = read_blocks(bag, [topic], progress)
    no_times, type_name = np.zeros(0, np.int64), messages.INPUT_TYPE_NAMES[kind]
    while True:
        try:
            block = next(blocks, None)
        except Truncated as error:
            yield [], no_times, error
            return
        if block is None:
            return
        # Bytes of another type may be readable, as markers that are none.
        for message in block:
            if message.type_name != type_name:
                problem = (
                    f'{topic} has messages of {message.type_name} among those of {type_name}; see '
                    'that each type has a topic of its own'
                )
                yield [], no_times, messages.MessageError(problem)
        block = [message for message in block if message.type_name == type_name]
        log_times = np.array([message.log_time for message in block], np.int64)
        results = reader.read_numbered([message.data for message in block])
        for is_error, group in groupby(
            results, lambda pair: isinstance(pair[0], messages.MessageError)
        ):
            items, numbers = zip(*group, strict=True)
            if is_error:
                yield from (([], no_times, error) for error in items)
            else:
                yield list(items), log_times[np.concatenate(numbers)], None


def _read_static(bag: str | Path, topic: str, reader: messages.PoseReader) -> None:
    """Give a reader the frames that do not move in their parents, where a bag has any."""
    if topic in topics(bag):
        # A bag that is cut off is reported by its other messages.
        with suppress(Truncated):
            for message in read_messages(bag, [topic]):
                reader.add_static(message.data)


def _marker_topic(bag: str | Path, topic: str | None) -> tuple[str, str]:
    """Return the full name of a topic of markers and the short name of its type."""
    kinds = {ros: kind for kind, ros in messages.ROS_TYPE_NAMES.items()}
    types = topics(bag)
    candidates = {name: kinds[kind] for name, kind in types.items() if kind in kinds}
    name = topic if topic is None or topic.startswith('/') else f'/{topic}'
    if name is None:
        name = next(iter(candidates)) if len(candidates) == 1 else '/markers'
    if name in candidates:
        return name, candidates[name]
    fault = f'is {types[name]}, which holds no markers' if name in types else 'is not there'
    listed, fix = ', '.join(sorted(candidates)), 'name one with --topic'
    if not candidates:
        listed = 'no topic of markers'
        fix = film_fix(bag, types) or (
            f'`kinpole import {bag} --output NEW.mcap` reads poses and messages of trackers'
        )
    raise BagError(f'{bag}: topic {name} {fault}; it holds {listed}; fix: {fix}')


def film_fix(bag: str | Path, types: Mapping[str, str]) -> str:
    """Return how pictures or detected tags on topics become markers; '' where there are none."""
    kinds = {messages.IMAGE, messages.COMPRESSED_IMAGE, messages.DETECTIONS}
    return (
        f'`kinpole film {bag} --output NEW.mcap` finds tags in its pictures'
        if kinds & {*types.values()}
        else ''
    )


def input_topic(bag: str | Path, settings: Settings, topic: str | None) -> tuple[str, str]:
    """Return the full name of the tracker's input topic and the short name of its type."""
    name = topic or settings.marker_topic
    if name.startswith('~/'):
        name = f'/{NODE_NAME}/{name[2:]}'
    elif not name.startswith('/'):
        name = f'/{name}'
    types = topics(bag)
    input_types = set(messages.INPUT_TYPE_NAMES.values())
    if name not in types:
        # Topics of other types are listed only where there are no others.
        listed = {t: kind for t, kind in types.items() if kind in input_types} or types
        text = ', '.join(f'{t} ({kind})' for t, kind in sorted(listed.items())) or 'no topics'
        film = '' if input_types & {*types.values()} else film_fix(bag, types)
        fix = f'fix: {film}' if film else 'name one with --topic'
        raise BagError(f'{bag}: no topic {name}; it holds {text}; {fix}')
    marker_type, type_name = settings.marker_type, types[name]
    kind = messages.kind_of(type_name, marker_type)
    if kind is not None:
        return name, kind
    if type_name not in input_types:
        raise BagError(
            f'{bag}: topic {name} is {type_name}; markers must be one of '
            f'{", ".join(sorted(input_types))}; fix: name another with --topic, or have '
            f'`kinpole import {bag} --output NEW.mcap` read messages of trackers'
        )
    kinds = [one for one, ros in messages.INPUT_TYPE_NAMES.items() if ros == type_name]
    if messages.kind_of(type_name):
        kinds.append('auto')
    raise BagError(
        f'{bag}: topic {name} is {type_name}, but the parameter marker_type is {marker_type}; set '
        f'it to {" or ".join(kinds)}'
        f'{"" if messages.kind_of(type_name) else ", and name the frame of each body"}'
    )
