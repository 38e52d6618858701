"""The marker frames of a bag, as arrays, for who needs them all at once."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from kinpole_ros.bags._reader import BagError, Truncated, read_blocks, topics
from kinpole_ros.messages import ROS_TYPE_NAMES, MarkerReader, MessageError
from kinpole_ros.tracking.frame import MarkerFrames, part_of

_SECOND = 1_000_000_000  # ns


def read_frames(
    bag: str | Path,
    topic: str | None = None,
    seconds: float | None = None,
    progress: Callable[[float], None] | None = None,
    report: Callable[[Truncated], None] | None = None,
    identity: str = 'auto',
) -> tuple[list[MarkerFrames], str]:
    """
    Frames of a bag's markers, in order, of its first `seconds` or all, and the topic's full name.

    Without `topic` it is /markers, else the only one of a type that holds markers. A bag that is
    not whole gives what there is, and `report` is called with what it lacks; messages that cannot
    be read are left out. Raises BagError when there is no bag, no such topic, or nothing on it that
    can be read. `identity` is as the parameter marker_identity.
    """
    name, kind = _topic(bag, topic)
    reader = MarkerReader(kind, identity)
    wanted = ROS_TYPE_NAMES[kind]
    found: list[MarkerFrames] = []
    problem = ''
    first: int | None = None
    blocks = read_blocks(bag, [name], progress)
    while True:
        try:
            block = next(blocks, None)
        except Truncated as error:
            if report is not None:
                report(error)
            break
        if block is None:
            break
        for part in reader.read([one.data for one in block if one.type_name == wanted]):
            if isinstance(part, MessageError):
                problem = problem or str(part)
                continue
            first = int(part.stamps[0]) if first is None else first
            found.append(part)
        if seconds is not None and first is not None and found:
            latest = int(found[-1].stamps[-1])
            if latest - first > seconds * _SECOND:
                break
    if not found:
        why = f': {problem}' if problem else ''
        raise BagError(
            f'{bag}: no message on {name} can be read{why}; fix: name another with --topic'
        )
    return _within(found, first or 0, seconds), name


def _within(found: list[MarkerFrames], first: int, seconds: float | None) -> list[MarkerFrames]:
    if seconds is None:
        return found
    kept = []
    for part in found:
        late = part.stamps - first > seconds * _SECOND
        cut = int(np.argmax(late)) if late.any() else len(late)
        if cut:
            kept.append(part_of(part, slice(cut)))
    return kept


def _topic(bag: str | Path, topic: str | None) -> tuple[str, str]:
    """The topic's full name and the short name of its type."""
    kinds = {ros: kind for kind, ros in ROS_TYPE_NAMES.items()}
    there = topics(bag)
    fit = {name: kinds[kind] for name, kind in there.items() if kind in kinds}
    name = topic if topic is None or topic.startswith('/') else f'/{topic}'
    if name is None:
        name = '/markers' if '/markers' in fit or len(fit) != 1 else next(iter(fit))
    if name in fit:
        return name, fit[name]
    what = f'is {there[name]}, which holds no markers' if name in there else 'is not there'
    listed, fix = ', '.join(sorted(fit)), 'name one with --topic'
    if not fit:
        listed = 'no topic of markers'
        fix = f'`kinpole import {bag} --output NEW.mcap` reads poses and messages of trackers'
    raise BagError(f'{bag}: topic {name} {what}; it holds {listed}; fix: {fix}')
