"""Frames on /tf, each in its parent, multiplied out into one fixed frame."""

from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags.formats._cells import listed, shown
from kinpole_ros.bags.formats._file import File
from kinpole_ros.bags.formats._series import MessageSeries
from kinpole_ros.messages import chains_of, multiply_out

_STATIC = '_static'  # the ending of the topic of frames that do not move


class Links(NamedTuple):
    """The parents of each frame on /tf, and the frames that do not move."""

    parents: dict[str, dict[str, None]]
    static: set[str]

    def add(self, transforms: Any, topic: str) -> None:
        """Note the frames in a message."""
        for one in transforms:
            parent, child = str(one.header.frame_id), str(one.child_frame_id)
            self.parents.setdefault(child, {})[parent] = None
            if topic.endswith(_STATIC):
                self.static.add(child)


def multiplied_out(file: File, series: list[MessageSeries], links: Links) -> list[MessageSeries]:
    """
    Return series of bodies in one fixed frame; those of frames that do not move are left out.

    Notes chains, and bodies in frames that do not meet. Raises BagError where a frame has several
    parents, or where the frames of a chain never have one stamp.
    """
    of_frame = {part.source: part for part in series if part.source in links.parents}
    moving = [name for name in of_frame if name not in links.static]
    if not moving:
        return series
    for name in of_frame:
        if len(several := links.parents[name]) > 1:
            raise BagError(
                f'{file.path}: {shown(name)} has several parents, '
                f'{listed([shown(parent) for parent in several])}; fix: record those of one alone'
            )
    parents = {name: next(iter(links.parents[name])) for name in of_frame}
    chains = chains_of(moving, parents, links.static)
    fixed, _ = Counter(chain[0] for chain in chains.values()).most_common(1)[0]
    separate = [shown(name) for name, chain in chains.items() if chain[0] != fixed]
    if separate:
        file.notes.append(
            f'{file.path}: frames that nothing connects to {shown(fixed)} were not read: '
            f'{listed(separate)}'
        )
    result = [part for part in series if part.source not in links.parents]
    chained = []
    for name, chain in chains.items():
        if chain[0] != fixed:
            continue
        if len(chain) > 2:
            chained.append(f'{shown(name)} on {shown(chain[-2])}')
        result.append(_in_fixed_frame(file, [of_frame[frame] for frame in chain[1:]], links))
    if chained:
        file.notes.append(
            f'{file.path}: frames are multiplied out into {shown(fixed)}: {listed(chained)}'
        )
    return result


def _in_fixed_frame(file: File, chain: list[MessageSeries], links: Links) -> MessageSeries:
    """Multiply a chain at the stamps that all of its frames have; the last one is the body."""
    body = chain[-1]
    moving = [part for part in chain if part.source not in links.static]
    stamps = moving[0].stamps
    for part in moving[1:]:
        stamps = np.intersect1d(stamps, part.stamps)
    if len(moving) == 1:
        if len(chain) == 1:
            return body
        stamps = np.unique(stamps)
    if not len(stamps):
        raise BagError(
            f'{file.path}: {shown(body.source)} is on {shown(moving[-2].source)}, and these never '
            'have one stamp, so it is not known where it is; fix: have both sent with one stamp'
        )
    if lost := len(np.unique(body.stamps)) - len(stamps):
        file.notes.append(
            f'{file.path}: {lost} poses of {shown(body.source)} are left out, since the frames '
            'below it have none of their stamps'
        )
    rows = {part.source: _rows_at(part.stamps, stamps) for part in moving}
    poses = [
        part.values[rows[part.source], 0] if part.source in rows else part.values[-1:, 0]
        for part in chain
    ]
    log_times = body.log_times[rows[body.source]]
    values = np.broadcast_to(multiply_out(poses), (len(stamps), 7))[:, None]
    return body._replace(stamps=stamps, log_times=log_times, values=values)


def _rows_at(own: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Return the first row of each of some stamps, which all are among these."""
    order = np.argsort(own, kind='stable')
    return np.asarray(order[np.searchsorted(own[order], stamps)])
